//! The convex pieces that send and receive, with what the kernels ask of them, and a tree of
//! clusters over them.
//!
//! Pieces in one plane stay together in the tree as long as can be: they never see each other,
//! share one horizon, and a flat cluster sees another wholly or not at all more often than a
//! bulky one.

use super::blockers::{Blocker, Blockers, Edge, Plane, bounds};
use super::shaft::{BlockerTree, longest_axis};
use super::unbent;
use crate::polygon_pair::ball;
use crate::quadrature::gauss;
use luxel_core::{DVec3, Facets, Polygon};
use std::collections::HashMap;

/// Most corners of a part: leaves room for the cuts of a [`super::ring::Ring`].
const MOST_CORNERS: usize = 8;

/// A convex piece of a row.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    pub(crate) polygon: Polygon,
    pub(crate) plane: Plane,
    pub(crate) centre: DVec3,
    pub(crate) radius: f64,
    pub(crate) area: f64,
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
    pub(crate) row: u32,
    /// Blocker that it lies on, which lies behind it or in its plane and never in its way.
    pub(crate) lies_on: Option<u32>,
}

impl Part {
    pub(crate) fn new(polygon: Polygon, row: u32) -> Part {
        let (centre, radius) = ball(&polygon);
        let (low, high) = bounds(&polygon.vertices);
        Part {
            low,
            high,
            plane: Plane::of(&polygon.vertices),
            centre,
            radius,
            area: polygon.area(),
            row,
            lies_on: None,
            polygon,
        }
    }

    /// Takes the plane of the blocker that it lies on: what a small piece with rounded corners
    /// says of its plane is far off at the other end of a wall.
    fn settle(&mut self, blockers: &Blockers, tree: &BlockerTree, near_m: f64) {
        let near = DVec3::splat(near_m);
        let carries = |polygon: &Blocker| {
            let plane = &polygon.faces[0];
            let (low, high) = plane.heights(&self.polygon.vertices);
            let inside = |e: &Edge| {
                let inward = plane.normal.cross(e.b - e.a).normalize_or_zero();
                inward.dot(self.centre - e.a) >= -near_m
            };
            high.max(-low) <= near_m && polygon.edges.iter().all(inside)
        };
        let found = tree.find(self.low - near, self.high + near, |index| {
            let blocker = &blockers.list[index as usize];
            let faces = match blocker.is_solid() {
                true => blockers.faces(blocker),
                false => std::slice::from_ref(blocker),
            };
            let plane = faces.iter().find(|f| carries(f))?.faces[0];
            // Whoever looks into a solid from its side has it before them.
            let outwards = plane.normal.dot(self.plane.normal) > 0.0;
            match (outwards, blocker.is_solid()) {
                (true, _) => Some((index, plane)),
                (false, false) => Some((index, plane.flipped())),
                (false, true) => None,
            }
        });
        if let Some((index, plane)) = found {
            self.lies_on = Some(index);
            self.plane = plane;
        }
    }
}

/// Nodes of the Gauss rules of all parts, as arrays of coordinates, four and four.
#[derive(Default)]
pub(crate) struct Nodes {
    pub(crate) starts: Vec<u32>,
    pub(crate) x: Vec<f64>,
    pub(crate) y: Vec<f64>,
    pub(crate) z: Vec<f64>,
    /// Areas that the nodes stand for, m²; zero for those that fill up four.
    pub(crate) weight: Vec<f64>,
}

/// Nodes that are worked on together.
pub(crate) const LANES: usize = 4;

impl Nodes {
    fn of(parts: &[Part], order: usize) -> Nodes {
        let mut nodes = Nodes {
            starts: vec![0],
            ..Nodes::default()
        };
        for part in parts {
            let mut each = |p: DVec3, w: f64| {
                nodes.x.push(p.x);
                nodes.y.push(p.y);
                nodes.z.push(p.z);
                nodes.weight.push(w);
            };
            part_nodes(&part.polygon.vertices, order, &mut each);
            while !nodes.x.len().is_multiple_of(LANES) {
                nodes.x.push(part.centre.x);
                nodes.y.push(part.centre.y);
                nodes.z.push(part.centre.z);
                nodes.weight.push(0.0);
            }
            nodes.starts.push(nodes.x.len() as u32);
        }
        nodes
    }
}

/// Order 2 or 3 for quadrilaterals; rules of like accuracy on triangles.
fn part_nodes(v: &[DVec3], order: usize, each: &mut impl FnMut(DVec3, f64)) {
    let mut k = 1;
    while k + 1 < v.len() {
        if k + 2 < v.len() {
            let (a, b, c, d) = (v[0], v[k], v[k + 1], v[k + 2]);
            let (u, w, skew) = (b - a, d - a, (a - b) + (c - d));
            for &(s, ws) in gauss(order) {
                for &(t, wt) in gauss(order) {
                    let (s, t) = (0.5 + 0.5 * s, 0.5 + 0.5 * t);
                    let jacobian = (u + skew * t).cross(w + skew * s).length();
                    each(
                        a + u * s + w * t + skew * (s * t),
                        0.25 * ws * wt * jacobian,
                    );
                }
            }
            k += 2;
        } else {
            let (a, b, c) = (v[0], v[k], v[k + 1]);
            let area = 0.5 * (b - a).cross(c - a).length();
            // Three nodes of degree 2; six of degree 4 [Strang73]. Each is a corner's weight
            // besides that of the sum of all corners.
            let rule: &[(f64, f64)] = match order {
                2 => &[(1.0 / 6.0, 1.0 / 3.0)],
                _ => &[
                    (0.445_948_490_915_965, 0.223_381_589_678_011),
                    (0.091_576_213_509_771, 0.109_951_743_655_322),
                ],
            };
            for &(t, w) in rule {
                let sum = (a + b + c) * t;
                for corner in [a, b, c] {
                    each(sum + corner * (1.0 - 3.0 * t), w * area);
                }
            }
            k += 1;
        }
    }
}

/// A cluster of parts.
#[derive(Clone, Debug)]
pub(crate) struct Cluster {
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
    /// Plane of all parts, if they share one.
    pub(crate) flat: Option<Plane>,
    /// Run of [`Parts::list`].
    pub(crate) first: u32,
    pub(crate) count: u32,
    /// First of two children; none for a leaf.
    pub(crate) children: Option<u32>,
}

impl Cluster {
    pub(crate) fn size(&self) -> f64 {
        (self.high - self.low).length()
    }

    pub(crate) fn run(&self) -> std::ops::Range<usize> {
        self.first as usize..(self.first + self.count) as usize
    }
}

/// All parts in the order of the tree.
pub(crate) struct Parts {
    pub(crate) list: Vec<Part>,
    pub(crate) clusters: Vec<Cluster>,
    /// Nodes of order 2 and of order 3.
    pub(crate) nodes: [Nodes; 2],
}

/// Parts of a leaf.
const LEAF: usize = 8;

impl Parts {
    pub(crate) fn new(
        facets: &Facets,
        blockers: &Blockers,
        tree: &BlockerTree,
        near_m: f64,
    ) -> Parts {
        let mut list = Vec::with_capacity(facets.parts.len());
        for part in facets.parts.iter().filter(|p| p.row != Facets::NO_ROW) {
            for v in unbent(&part.polygon.vertices, near_m) {
                // A fan of pieces with few corners each.
                let mut k = 1;
                while k + 1 < v.len() {
                    let end = (k + MOST_CORNERS - 2).min(v.len() - 1);
                    let mut corners = vec![v[0]];
                    corners.extend_from_slice(&v[k..=end]);
                    let mut piece = Part::new(Polygon::new(corners), part.row);
                    if piece.area > 0.0 {
                        piece.settle(blockers, tree, near_m);
                        list.push(piece);
                    }
                    k = end;
                }
            }
        }
        let mut order: Vec<u32> = (0..list.len() as u32).collect();
        let mut parts = Parts {
            list,
            clusters: Vec::new(),
            nodes: Default::default(),
        };
        if !order.is_empty() {
            let planes = parts.planes(near_m);
            parts.clusters.push(parts.cluster(&order, &planes, 0));
            parts.fill(0, &mut order, &planes, 0);
            parts.list = order
                .iter()
                .map(|&p| parts.list[p as usize].clone())
                .collect();
        }
        parts.nodes = [2, 3].map(|m| Nodes::of(&parts.list, m));
        parts
    }

    /// A number for the plane of each part. The same number only where all corners lie in the
    /// plane of the first that has it.
    fn planes(&self, near_m: f64) -> Vec<u32> {
        let mut known: HashMap<[i64; 4], Vec<u32>> = HashMap::new();
        let mut firsts: Vec<usize> = Vec::new();
        let turn = 1e-6;
        self.list
            .iter()
            .enumerate()
            .map(|(k, part)| {
                let n = (part.plane.normal / turn).round();
                let offset = (part.plane.offset / (16.0 * near_m.max(1e-12))).round();
                let key = [n.x as i64, n.y as i64, n.z as i64, offset as i64];
                let alike = known.entry(key).or_default();
                let same = alike.iter().find(|&&number| {
                    let plane = &self.list[firsts[number as usize]].plane;
                    let (low, high) = plane.heights(&part.polygon.vertices);
                    high.max(-low) <= near_m
                });
                match same {
                    Some(&number) => number,
                    None => {
                        let number = firsts.len() as u32;
                        firsts.push(k);
                        alike.push(number);
                        number
                    }
                }
            })
            .collect()
    }

    fn cluster(&self, run: &[u32], planes: &[u32], first: u32) -> Cluster {
        let corners: Vec<DVec3> = run
            .iter()
            .flat_map(|&p| self.list[p as usize].polygon.vertices.iter().copied())
            .collect();
        let (low, high) = bounds(&corners);
        let plane = planes[run[0] as usize];
        let flat = run
            .iter()
            .all(|&p| planes[p as usize] == plane)
            .then(|| self.list[run[0] as usize].plane);
        Cluster {
            low,
            high,
            flat,
            first,
            count: run.len() as u32,
            children: None,
        }
    }

    fn fill(&mut self, at: usize, run: &mut [u32], planes: &[u32], first: u32) {
        if run.len() <= LEAF && (self.clusters[at].flat.is_some() || run.len() == 1) {
            return;
        }
        let half = if self.clusters[at].flat.is_some() {
            self.halve(run)
        } else {
            self.part_planes(run, planes)
        };
        let (left, right) = run.split_at_mut(half);
        let second = first + half as u32;
        let children = self.clusters.len();
        self.clusters[at].children = Some(children as u32);
        let (a, b) = (
            self.cluster(left, planes, first),
            self.cluster(right, planes, second),
        );
        self.clusters.extend([a, b]);
        self.fill(children, left, planes, first);
        self.fill(children + 1, right, planes, second);
    }

    /// Along the longest axis, at the middle part.
    fn halve(&self, run: &mut [u32]) -> usize {
        let middle = |p: u32| self.list[p as usize].centre;
        let middles: Vec<DVec3> = run.iter().map(|&p| middle(p)).collect();
        let (low, high) = bounds(&middles);
        let axis = longest_axis(high - low);
        let half = run.len() / 2;
        run.select_nth_unstable_by(half, |&x, &y| {
            middle(x)[axis].total_cmp(&middle(y)[axis]).then(x.cmp(&y))
        });
        half
    }

    /// Several planes: whole planes to either side, in the order of their middles along the
    /// longest axis.
    fn part_planes(&self, run: &mut [u32], planes: &[u32]) -> usize {
        let mut middles: HashMap<u32, (DVec3, f64)> = HashMap::new();
        for &p in run.iter() {
            let entry = middles.entry(planes[p as usize]).or_default();
            entry.0 += self.list[p as usize].centre;
            entry.1 += 1.0;
        }
        let middle = |plane: u32| middles[&plane].0 / middles[&plane].1;
        let all: Vec<DVec3> = middles.keys().map(|&k| middle(k)).collect();
        let (low, high) = bounds(&all);
        let axis = longest_axis(high - low);
        run.sort_unstable_by(|&x, &y| {
            let (p, q) = (planes[x as usize], planes[y as usize]);
            middle(p)[axis]
                .total_cmp(&middle(q)[axis])
                .then(p.cmp(&q))
                .then(x.cmp(&y))
        });
        // The border between two planes that is nearest to half.
        let half = run.len() / 2;
        let border = |k: &usize| planes[run[k - 1] as usize] != planes[run[*k] as usize];
        let before = (1..=half).rev().find(border);
        let after = (half.max(1)..run.len()).find(border);
        match (before, after) {
            (Some(b), Some(a)) => {
                if half - b <= a - half {
                    b
                } else {
                    a
                }
            }
            (Some(k), None) | (None, Some(k)) => k,
            (None, None) => half,
        }
    }
}
