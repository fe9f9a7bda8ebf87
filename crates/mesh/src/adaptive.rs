//! Adaptive mesh: uniform at first, then elements that differ from their neighbours are split.
//!
//! An element whose wish exceeds the threshold is split into four, unless its edge would fall
//! below the smallest allowed. Elements keep their exitance: children start with their parent's
//! (the old values are re-used). Neighbours differ by at most one level within a patch, and by
//! about that across patches; a neighbour that is too coarse is split first.
//!
//! Source: [Yeap99], 6.3.1, figures 6.4 and 6.5. Differs: exitance differences are divided by
//! reflectance, so that the pattern of a texture is not taken for a shadow.

use crate::contract::{MeshSettings, Strategy};
use crate::neighbours::Neighbours;
use crate::shade::shade;
use crate::uniform::mesh;
use luxel_core::{ElementId, Front, FrontChange, Patch, RefinementWish, Scene, Shape, Solution};
use rayon::prelude::*;

/// Elements whose wish is above this are split: a step of 5 % of the mean exitance.
pub const THRESHOLD: f32 = 0.05;

/// The adaptive strategy.
#[derive(Clone, Debug)]
pub struct Adaptive {
    settings: MeshSettings,
    threshold: f32,
}

impl Adaptive {
    /// With these settings and the default [`THRESHOLD`].
    pub fn new(settings: MeshSettings) -> Self {
        Adaptive {
            settings,
            threshold: THRESHOLD,
        }
    }

    /// With a wish above which elements are split.
    pub fn with_threshold(settings: MeshSettings, threshold: f32) -> Self {
        Adaptive {
            settings,
            threshold,
        }
    }
}

impl Strategy for Adaptive {
    fn initial(&mut self, scene: &Scene) -> Front {
        // Half of the elements are left to refinement.
        let settings = MeshSettings {
            max_elements: (self.settings.max_elements / 2).max(1),
            ..self.settings
        };
        mesh(scene, &settings, |n| n).0
    }

    fn refine(
        &mut self,
        scene: &Scene,
        front: &Front,
        _: &Solution,
        wish: &RefinementWish,
    ) -> Option<(Front, FrontChange)> {
        let mut wanted: Vec<(f32, u32)> = wish
            .0
            .iter()
            .take(front.len())
            .enumerate()
            .filter(|&(_, &w)| w > self.threshold)
            .map(|(e, &w)| (w, e as u32))
            .collect();
        // The keenest first: the limit on elements cuts the rest.
        wanted.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut next = Refined {
            scene,
            neighbours: Neighbours::of(scene, front),
            old: (0..front.len() as u32).map(ElementId).collect(),
            front: front.clone(),
            settings: self.settings,
        };
        for (_, e) in wanted {
            // A neighbour may have split it already.
            if next.front.area[e as usize] == front.area[e as usize] {
                next.split(ElementId(e), 0);
            }
        }
        if next.front.len() == front.len() {
            return None;
        }
        let mut new = next.front;
        shade(scene, &mut new);
        let change = FrontChange {
            offsets: (0..=new.len() as u32).collect(),
            sources: next.old.into_iter().map(|o| (o, 1.0)).collect(),
        };
        Some((new, change))
    }
}

/// A front under refinement.
struct Refined<'a> {
    scene: &'a Scene,
    neighbours: Neighbours,
    front: Front,
    /// Old element that each inherits from.
    old: Vec<ElementId>,
    settings: MeshSettings,
}

impl Refined<'_> {
    /// Splits `e` after the neighbours that would be more than one level coarser; whether it did.
    fn split(&mut self, e: ElementId, depth: u32) -> bool {
        if depth > 32 || !may_split(&self.front, e, &self.settings) {
            return false;
        }
        let mut around = Vec::new();
        self.neighbours
            .around(self.scene, &self.front, e, &mut around);
        for n in around {
            if coarser(&self.front, n, e) && !self.split(n, depth + 1) {
                // Across patches a coarse neighbour that may not be split (a cluster, the limit)
                // is no obstacle.
                if self.front.patch[n.index()] == self.front.patch[e.index()] {
                    return false;
                }
            }
        }
        if self.front.len() + 3 > self.settings.max_elements {
            return false;
        }
        let Some(children) = self.front.split(e) else {
            return false;
        };
        let parent = self.old[e.index()];
        self.old.resize(self.front.len(), parent);
        debug_assert_eq!(children[0], e);
        true
    }
}

/// Whether the children of an element would be large enough; a cluster has none.
pub(crate) fn may_split(front: &Front, e: ElementId, settings: &MeshSettings) -> bool {
    let shape = &front.patches[front.patch[e.index()].index()].shape;
    // A halved edge just at the limit is allowed; 1e-3 is above f32 rounding.
    0.5 * edge_m(front, e) >= settings.min_edge_m * (1.0 - 1e-3)
        && !matches!(shape, Shape::Cluster { .. })
}

/// Whether `n` is so coarse that splitting `e` would leave more than one level between them.
fn coarser(front: &Front, n: ElementId, e: ElementId) -> bool {
    if front.patch[n.index()] == front.patch[e.index()] {
        // Sizes are the patch's own divided by powers of two.
        front.rect[n.index()][2].abs() > 1.5 * front.rect[e.index()][2].abs()
    } else {
        edge_m(front, n) > 3.0 * edge_m(front, e)
    }
}

/// Shorter edge of an element, metres.
fn edge_m(front: &Front, e: ElementId) -> f32 {
    let patch: &Patch = &front.patches[front.patch[e.index()].index()];
    let [_, _, ds, dt] = front.rect[e.index()];
    match &patch.shape {
        Shape::Parallelogram { edge_u, edge_v, .. } | Shape::Triangle { edge_u, edge_v, .. } => {
            (edge_u.length() * ds.abs()).min(edge_v.length() * dt.abs())
        }
        Shape::Cluster { .. } => 0.0,
    }
}

/// How much each element differs from its neighbours: the largest step of exitance across its
/// edges as a share of the mean exitance of the front. 0 where there is no neighbour.
///
/// Photometric, all layers together. Between elements of different reflectance the step is that
/// of the light they receive, times their mean reflectance.
pub fn neighbour_difference(scene: &Scene, front: &Front, solution: &Solution) -> RefinementWish {
    let count = front.len().min(solution.len());
    let value: Vec<f32> = (0..count).map(|e| solution.total(e).luminance()).collect();
    let flux: f64 = value
        .iter()
        .zip(&front.area)
        .map(|(&v, &a)| v as f64 * a as f64)
        .sum();
    let mean = (flux / front.total_area().max(1e-30)) as f32;
    if mean <= 0.0 || mean.is_nan() {
        return RefinementWish(vec![0.0; front.len()]);
    }
    let neighbours = Neighbours::of(scene, front);
    let rho: Vec<f32> = front.reflectance.iter().map(|r| r.luminance()).collect();
    let wish = (0..front.len())
        .into_par_iter()
        .map_init(Vec::new, |around, e| {
            if e >= count {
                return 0.0;
            }
            neighbours.around(scene, front, ElementId::from(e), around);
            let mut most = 0.0f32;
            for n in around.iter().map(|n| n.index()).filter(|&n| n < count) {
                let step = if rho[e] > 0.01 && rho[n] > 0.01 {
                    (value[e] / rho[e] - value[n] / rho[n]) * 0.5 * (rho[e] + rho[n])
                } else {
                    value[e] - value[n]
                };
                most = most.max(step.abs());
            }
            most / mean
        })
        .collect();
    RefinementWish(wish)
}
