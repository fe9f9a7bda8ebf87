//! Geometry between clusters of a real scene: kernels by rays, bounds by boxes and cones.
//!
//! Between two nodes the kernel is sampled at stratified pairs of points, uniform by area over
//! each, with a segment of visibility each. Its upper bound follows from the distance of the
//! boxes and from how far each box rises before the other's cone of normals. Two elements get
//! what [`crate::Matrix::assemble`] would store for them.
//!
//! Sources: [Hanrahan91] (kernel between elements of a hierarchy), [Smits94] (clusters with
//! bounds of the kernel between them).

use crate::contract::{KernelSample, LocalLines, NodeFactors, Ray, RayCaster};
use crate::lines::FrontLines;
use crate::matrix::{Assembly, MatrixSettings};
use crate::sampling::{Sequence, hash};
use luxel_core::hierarchy::Node;
use luxel_core::{DVec3, ElementId, Front, Hierarchy, Scene, Vec3};
use std::f64::consts::PI;

/// A cone this narrow is rounding: all normals are the axis.
const FLAT_COSINE: f32 = 1.0 - 2e-6;

/// Exchange between the nodes of a tree over a front.
pub struct FrontNodes<'a> {
    scene: &'a Scene,
    front: &'a Front,
    caster: &'a dyn RayCaster,
    tree: &'a Hierarchy,
    lines: FrontLines<'a>,
    pairs: Assembly<'a>,
    /// Area of the elements before each place of the tree's order, m².
    before: Vec<f64>,
    seed: u32,
    flat_m: f64,
}

impl<'a> FrontNodes<'a> {
    /// Geometry between the nodes of `tree`, blocked by what `caster` holds.
    ///
    /// Precondition: all belong to the same scene and front.
    pub fn new(
        scene: &'a Scene,
        front: &'a Front,
        caster: &'a dyn RayCaster,
        tree: &'a Hierarchy,
        settings: &'a MatrixSettings,
    ) -> Self {
        debug_assert_eq!(tree.order.len(), front.len());
        let mut before = vec![0.0];
        let mut sum = 0.0;
        for e in &tree.order {
            sum += front.area[e.index()] as f64;
            before.push(sum);
        }
        FrontNodes {
            scene,
            front,
            caster,
            tree,
            lines: FrontLines::new(scene, front, caster),
            pairs: Assembly::new(scene, front, caster, settings),
            before,
            seed: settings.seed,
            flat_m: (4.0 * f32::EPSILON * scene.largest_coordinate()) as f64,
        }
    }

    /// A point of the node, uniform by area, with its normal and the place of its element.
    fn point(&self, node: &Node, u: f32, v: f32) -> (u32, Vec3, Vec3) {
        let (first, end) = (node.first as usize, (node.first + node.count) as usize);
        let (low, high) = (self.before[first], self.before[end]);
        let aim = low + u as f64 * (high - low);
        // What is left of the number within the element is as uniform as the number was.
        let run = &self.before[first + 1..end];
        let at = first + run.partition_point(|b| *b <= aim);
        let own = (self.before[at + 1] - self.before[at]).max(f64::MIN_POSITIVE);
        let rest = ((aim - self.before[at]) / own).clamp(0.0, 1.0) as f32;
        let (point, normal) = self
            .front
            .point_on(self.scene, self.tree.order[at], [rest, v]);
        (at as u32, point, normal)
    }

    /// Largest cosine at node `p` of a line to node `q`, when `near` is their least distance.
    fn cosine(&self, p: &Node, q: &Node, near: f64, far: f64) -> f64 {
        if p.cos_half_angle < 0.0 || p.axis == Vec3::ZERO {
            return 1.0;
        }
        let axis = p.axis.as_dvec3();
        let height = |n: &Node, sign: f64| {
            let (low, high) = (n.low.as_dvec3(), n.high.as_dvec3());
            axis.dot(0.5 * (low + high)) + sign * 0.5 * axis.abs().dot(high - low)
        };
        let rise = height(q, 1.0) - height(p, -1.0);
        // n . d <= d . axis + |d| sin of the cone's half angle.
        let sine = if p.cos_half_angle >= FLAT_COSINE {
            0.0
        } else {
            (1.0 - (p.cos_half_angle as f64).powi(2)).max(0.0).sqrt()
        };
        let rise = rise.max(0.0);
        if rise + far * sine <= self.flat_m {
            return 0.0;
        }
        if near <= 0.0 {
            return 1.0;
        }
        (rise / near + sine).min(1.0)
    }
}

/// Least and greatest distance between points of two boxes.
fn distances(p: &Node, q: &Node) -> (f64, f64) {
    let (pl, ph) = (p.low.as_dvec3(), p.high.as_dvec3());
    let (ql, qh) = (q.low.as_dvec3(), q.high.as_dvec3());
    let gap = (ql - ph).max(pl - qh).max(DVec3::ZERO);
    let span = (qh - pl).abs().max((ph - ql).abs());
    (gap.length(), span.length())
}

impl NodeFactors for FrontNodes<'_> {
    fn hierarchy(&self) -> &Hierarchy {
        self.tree
    }

    fn lines(&self) -> &dyn LocalLines {
        &self.lines
    }

    fn exchange(&self, pairs: &[(ElementId, ElementId)], out: &mut Vec<f64>) {
        self.pairs.exchange(pairs, out);
    }

    fn most(&self, p: usize, q: usize) -> f64 {
        let (p, q) = (&self.tree.nodes[p], &self.tree.nodes[q]);
        let (near, far) = distances(p, q);
        let cosines = self.cosine(p, q, near, far) * self.cosine(q, p, near, far);
        if cosines == 0.0 {
            0.0
        } else {
            // Boxes that touch: a division by zero is the answer.
            cosines / (PI * near * near)
        }
    }

    fn sample(&self, p: usize, q: usize, count: u32, samples: &mut Vec<KernelSample>) -> bool {
        samples.clear();
        let (a, b) = (&self.tree.nodes[p], &self.tree.nodes[q]);
        let sequence = Sequence::new(self.seed, hash([p as u32, q as u32]));
        let offset_m = self.caster.offset_m();
        let (mut segments, mut of) = (Vec::new(), Vec::new());
        for k in 0..count {
            let [s, t, u, v] = sequence.point4(k);
            let ((i, x, nx), (j, y, ny)) = (self.point(a, s, t), self.point(b, u, v));
            let along = y - x;
            let square = along.length_squared() as f64;
            let (cx, cy) = (nx.dot(along) as f64, -ny.dot(along) as f64);
            let kernel = if cx > 0.0 && cy > 0.0 && square > 0.0 {
                let origin = x + nx * offset_m;
                segments.push(Ray {
                    origin,
                    t_min: 0.0,
                    direction: y + ny * offset_m - origin,
                    t_max: 1.0,
                });
                of.push(samples.len());
                cx * cy / (PI * square * square)
            } else {
                0.0
            };
            samples.push(KernelSample {
                at: [i, j],
                points: [x.as_dvec3(), y.as_dvec3()],
                kernel,
                visible: 1.0,
                weight: 1.0,
            });
        }
        let mut visible = vec![0.0; segments.len()];
        self.caster.visibility(&segments, &mut visible);
        for (k, v) in of.into_iter().zip(visible) {
            samples[k].visible = v as f64;
        }
        false
    }

    fn centres(&self) -> Vec<DVec3> {
        let centre = |list: &Vec<luxel_core::Polygon>| {
            let (mut sum, mut area) = (DVec3::ZERO, 0.0);
            for polygon in list {
                sum += polygon.area() * polygon.centre();
                area += polygon.area();
            }
            if area > 0.0 { sum / area } else { DVec3::ZERO }
        };
        self.pairs.polygons.iter().map(centre).collect()
    }

    fn outside(&self) -> Vec<f64> {
        self.pairs.all_lost().0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contract::{FactorRow, FormFactors};
    use crate::given_nodes::halves;
    use crate::matrix::Matrix;
    use crate::testing::{BruteForce, cube};

    /// The halving tree of an order, with boxes and cones of the elements.
    fn tree_of(scene: &Scene, front: &Front) -> Hierarchy {
        let mut tree = halves(front.len());
        let order = tree.order.clone();
        for node in &mut tree.nodes {
            let run = &order[node.first as usize..(node.first + node.count) as usize];
            let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            let mut sum = Vec3::ZERO;
            for e in run {
                for v in front.polygons(scene, *e).iter().flat_map(|p| &p.vertices) {
                    low = low.min(v.as_vec3());
                    high = high.max(v.as_vec3());
                }
                sum += front.normal(*e);
                node.area += front.area[e.index()];
            }
            (node.low, node.high) = (low, high);
            node.axis = sum.normalize_or_zero();
            let least = run
                .iter()
                .map(|e| front.normal(*e).dot(node.axis))
                .fold(1.0, f32::min);
            node.cos_half_angle = if least > 0.0 { least - 1e-6 } else { -1.0 };
        }
        tree
    }

    #[test]
    fn elements_exchange_what_the_matrix_stores() {
        let (scene, front) = cube(3);
        let caster = BruteForce::new(&scene);
        let settings = MatrixSettings::default();
        let matrix = Matrix::assemble(&scene, &front, &caster, &settings);
        let tree = tree_of(&scene, &front);
        let nodes = FrontNodes::new(&scene, &front, &caster, &tree, &settings);
        let (mut row, mut found) = (FactorRow::default(), Vec::new());
        for i in (0..54).step_by(5) {
            let i = ElementId::from(i);
            matrix.row(i, &mut row);
            let pairs: Vec<_> = (0..54).map(|j| (i, ElementId::from(j))).collect();
            nodes.exchange(&pairs, &mut found);
            for (j, g) in found.iter().enumerate() {
                let stored = matrix.factor(i, ElementId::from(j)) * front.area[i.index()] as f64;
                assert!((g - stored).abs() < 1e-15, "{j}: {g} for {stored}");
            }
        }
    }

    #[test]
    fn bounds_hold_every_sample_and_a_wall_is_proved_not_to_see_itself() {
        let (scene, front) = cube(4);
        let caster = BruteForce::new(&scene);
        let settings = MatrixSettings::default();
        let tree = tree_of(&scene, &front);
        let nodes = FrontNodes::new(&scene, &front, &caster, &tree, &settings);
        let mut samples = Vec::new();
        let (mut finite, mut blind) = (0, 0);
        for p in 0..tree.nodes.len() {
            for q in p..tree.nodes.len() {
                let most = nodes.most(p, q);
                assert!(!nodes.sample(p, q, 8, &mut samples));
                let wall = |n: usize| {
                    let n = tree.nodes[n];
                    (n.first / 16 == (n.first + n.count - 1) / 16).then_some(n.first / 16)
                };
                if wall(p).is_some() && wall(p) == wall(q) {
                    assert_eq!(most, 0.0, "nodes {p} and {q} of one wall");
                    blind += 1;
                }
                finite += most.is_finite() as u32;
                for s in &samples {
                    // f32 points.
                    assert!(s.kernel <= most * 1.001 + 1e-6, "{p} {q}: {most} {s:?}");
                }
            }
        }
        assert!(finite > 1000 && blind > 1000, "{finite} {blind}");
    }

    #[test]
    fn samples_tend_to_the_exchange() {
        // Opposite faces of a cube: A F = 0.199824895698 [Howell10] C-11, without singularities.
        // 4096 stratified samples of a kernel within 0..1/pi: about 1e-3.
        let (scene, front) = cube(1);
        let caster = BruteForce::new(&scene);
        let settings = MatrixSettings::default();
        let tree = tree_of(&scene, &front);
        let nodes = FrontNodes::new(&scene, &front, &caster, &tree, &settings);
        let leaf = |e: u32| {
            let at = |n: &Node| n.children == 0 && tree.order[n.first as usize].0 == e;
            tree.nodes.iter().position(at).expect("a leaf")
        };
        let mut samples = Vec::new();
        nodes.sample(leaf(0), leaf(1), 4096, &mut samples);
        let mean = samples.iter().map(|s| s.kernel * s.visible).sum::<f64>() / 4096.0;
        assert!((mean - 0.199_824_895_698).abs() < 2e-3, "{mean}");
    }
}
