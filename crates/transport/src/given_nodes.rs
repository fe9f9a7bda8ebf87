//! Geometry between clusters from given factors between elements: no scene.
//!
//! The kernel of two elements is A_i F_ij / (A_i A_j), and the samples of two nodes are all
//! their pairs, so bounds and means are exact. With it, solvers that link clusters are compared
//! with the others on the very same system; over [`crate::Constant`] it is the null
//! implementation, in which one link says all.
//!
//! Time and memory grow with the square of the elements: for tests.

use crate::contract::{FactorRow, FormFactors, KernelSample, LocalLines, NodeFactors};
use crate::lines::FactorLines;
use luxel_core::hierarchy::Node;
use luxel_core::{DVec3, ElementId, Hierarchy, Vec3};

/// Nodes over elements whose factors are known.
pub struct GivenNodes {
    tree: Hierarchy,
    lines: FactorLines,
    areas: Vec<f64>,
    /// A_i F_ij, m², row by row.
    exchange: Vec<f64>,
    outside: Vec<f64>,
    centres: Vec<DVec3>,
}

/// A tree that halves the elements in the order of their numbers, without bounds or areas.
pub fn halves(elements: usize) -> Hierarchy {
    let node = |first: usize, count: usize| Node {
        low: Vec3::ZERO,
        high: Vec3::ZERO,
        area: 0.0,
        axis: Vec3::ZERO,
        cos_half_angle: -1.0,
        first_child: 0,
        children: 0,
        first: first as u32,
        count: count as u32,
    };
    let mut nodes = Vec::new();
    if elements > 0 {
        nodes.push(node(0, elements));
    }
    let mut at = 0;
    while at < nodes.len() {
        let (first, count) = (nodes[at].first as usize, nodes[at].count as usize);
        if count > 1 {
            (nodes[at].first_child, nodes[at].children) = (nodes.len() as u32, 2);
            nodes.push(node(first, count / 2));
            nodes.push(node(first + count / 2, count - count / 2));
        }
        at += 1;
    }
    Hierarchy {
        nodes,
        order: (0..elements).map(ElementId::from).collect(),
    }
}

impl GivenNodes {
    /// From factors and areas, m², under a tree that halves the order of the elements. `centres`
    /// are the places of the elements, metres; all zero where there is no space.
    ///
    /// Precondition: as many areas and centres as elements, and reciprocal factors.
    pub fn new(factors: &dyn FormFactors, areas: &[f64], centres: Vec<DVec3>) -> Self {
        let n = factors.len();
        debug_assert!(areas.len() == n && centres.len() == n);
        let mut exchange = vec![0.0; n * n];
        let mut outside = Vec::with_capacity(n);
        let mut row = FactorRow::default();
        for i in 0..n {
            factors.row(ElementId::from(i), &mut row);
            for (j, f) in &row.entries {
                exchange[i * n + j.index()] = areas[i] * f;
            }
            outside.push(row.outside);
        }
        let mut tree = halves(n);
        for node in &mut tree.nodes {
            let run = node.first as usize..(node.first + node.count) as usize;
            node.area = areas[run.clone()].iter().sum::<f64>() as f32;
            let points = || centres[run.clone()].iter().map(|c| c.as_vec3());
            node.low = points().fold(Vec3::INFINITY, Vec3::min);
            node.high = points().fold(Vec3::NEG_INFINITY, Vec3::max);
        }
        GivenNodes {
            tree,
            lines: FactorLines::new(factors),
            areas: areas.to_vec(),
            exchange,
            outside,
            centres,
        }
    }

    fn kernel(&self, i: usize, j: usize) -> f64 {
        let product = self.areas[i] * self.areas[j];
        if product > 0.0 {
            self.exchange[i * self.areas.len() + j] / product
        } else {
            0.0
        }
    }

    /// Calls `with` for every pair of elements of two nodes.
    fn each_pair(&self, p: usize, q: usize, mut with: impl FnMut(u32, u32)) {
        let (a, b) = (&self.tree.nodes[p], &self.tree.nodes[q]);
        for i in a.first..a.first + a.count {
            for j in b.first..b.first + b.count {
                with(i, j);
            }
        }
    }
}

impl NodeFactors for GivenNodes {
    fn hierarchy(&self) -> &Hierarchy {
        &self.tree
    }

    fn lines(&self) -> &dyn LocalLines {
        &self.lines
    }

    fn exchange(&self, pairs: &[(ElementId, ElementId)], out: &mut Vec<f64>) {
        out.clear();
        let n = self.areas.len();
        out.extend(
            pairs
                .iter()
                .map(|(i, j)| self.exchange[i.index() * n + j.index()]),
        );
    }

    fn most(&self, p: usize, q: usize) -> f64 {
        let mut most = 0.0f64;
        self.each_pair(p, q, |i, j| {
            most = most.max(self.kernel(i as usize, j as usize));
        });
        most
    }

    fn sample(&self, p: usize, q: usize, _count: u32, samples: &mut Vec<KernelSample>) -> bool {
        samples.clear();
        self.each_pair(p, q, |i, j| {
            samples.push(KernelSample {
                at: [i, j],
                points: [self.centres[i as usize], self.centres[j as usize]],
                kernel: self.kernel(i as usize, j as usize),
                visible: 1.0,
                weight: self.areas[i as usize] * self.areas[j as usize],
            });
        });
        true
    }

    fn centres(&self) -> Vec<DVec3> {
        self.centres.clone()
    }

    fn outside(&self) -> Vec<f64> {
        self.outside.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Constant;

    #[test]
    fn a_sphere_has_one_kernel_everywhere() {
        // F_ij = A_j / A, so A_i F_ij / (A_i A_j) = 1 / A for every pair.
        let areas = vec![1.0, 2.0, 5.0, 0.5];
        let sphere = Constant::new(areas.clone());
        let nodes = GivenNodes::new(&sphere, &areas, vec![DVec3::ZERO; 4]);
        let mut samples = Vec::new();
        for p in 0..nodes.hierarchy().nodes.len() {
            for q in 0..nodes.hierarchy().nodes.len() {
                assert!(nodes.sample(p, q, 8, &mut samples));
                assert!((nodes.most(p, q) - 1.0 / 8.5).abs() < 1e-15);
                assert!(samples.iter().all(|s| (s.kernel - 1.0 / 8.5).abs() < 1e-15));
            }
        }
        let mut found = Vec::new();
        nodes.exchange(&[(ElementId(1), ElementId(2))], &mut found);
        assert!((found[0] - 10.0 / 8.5).abs() < 1e-15);
    }

    #[test]
    fn halves_hold_every_element_once() {
        for n in [0, 1, 2, 7, 64] {
            let tree = halves(n);
            let leaves: Vec<u32> = (tree.nodes.iter())
                .filter(|node| node.children == 0)
                .map(|node| node.first)
                .collect();
            let mut sorted = leaves.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..n as u32).collect::<Vec<_>>());
        }
    }
}
