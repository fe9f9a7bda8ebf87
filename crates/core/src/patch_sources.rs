//! From a patch back to the source triangles that it is made of.
//!
//! A wall of thousands of triangles becomes one patch; what only a source triangle knows (texture
//! coordinates, holes) is found again at any place of it. Patches with many triangles have a
//! regular grid over their coordinates, so that costs do not grow with their number.

use crate::buckets::Buckets;
use crate::front::{Front, Patch, Shape};
use crate::scene::Scene;
use glam::Vec2;
use std::collections::HashMap;

/// Source triangles of every patch of a front.
#[derive(Clone, Debug, Default)]
pub struct PatchSources {
    triangles: Buckets,
    /// Of textured patches with many triangles, those near each place.
    finders: HashMap<u32, Finder>,
}

/// Patches with more triangles than this have a finder.
const FEW: usize = 8;

impl PatchSources {
    /// Near linear in the triangles.
    pub fn new(scene: &Scene, front: &Front) -> PatchSources {
        let mut sources = PatchSources {
            triangles: triangles_of_patches(front),
            finders: HashMap::new(),
        };
        if !scene.uvs.is_empty() {
            for (p, patch) in front.patches.iter().enumerate() {
                let triangles = sources.of(p);
                if triangles.len() > FEW && !matches!(patch.shape, Shape::Cluster { .. }) {
                    let finder = Finder::new(scene, patch, triangles);
                    sources.finders.insert(p as u32, finder);
                }
            }
        }
        sources
    }

    /// All source triangles of a patch.
    pub fn of(&self, patch: usize) -> &[u32] {
        self.triangles.of(patch)
    }

    /// Source triangles of a patch among which the one at its coordinates `(s, t)` is. Never
    /// empty for a patch that has triangles.
    pub fn near(&self, patch: usize, st: [f32; 2]) -> &[u32] {
        let found = self.finders.get(&(patch as u32)).map(|f| f.near(st));
        found
            .filter(|f| !f.is_empty())
            .unwrap_or_else(|| self.of(patch))
    }
}

/// Source triangles of each patch of a front, ascending.
pub fn triangles_of_patches(front: &Front) -> Buckets {
    let pairs = front.patch_of.iter().enumerate().flat_map(|(t, sides)| {
        let some = sides.iter().filter(|id| id.is_some());
        some.map(move |id| (id.index(), t as u32))
    });
    Buckets::new(front.patches.len(), pairs)
}

/// Source triangles of one patch by the cell of a regular grid over its coordinates.
#[derive(Clone, Debug)]
struct Finder {
    /// Cells along each edge.
    cells: usize,
    near: Buckets,
}

impl Finder {
    /// About as many cells as triangles.
    fn new(scene: &Scene, patch: &Patch, triangles: &[u32]) -> Finder {
        let cells = (triangles.len() as f32).sqrt().ceil().clamp(1.0, 1024.0) as usize;
        let pairs = triangles.iter().flat_map(|&t| {
            let corners = scene.corners(t as usize);
            let st = corners.map(|p| Vec2::from(patch.coordinates(p)));
            // A hair wider, for places on an edge.
            let low = st[0].min(st[1]).min(st[2]) - 1e-4;
            let high = st[0].max(st[1]).max(st[2]) + 1e-4;
            let span = |low, high| Finder::cell(cells, low)..=Finder::cell(cells, high);
            let across = span(low.x, high.x);
            span(low.y, high.y).flat_map(move |j| across.clone().map(move |i| (j * cells + i, t)))
        });
        Finder {
            cells,
            near: Buckets::new(cells * cells, pairs),
        }
    }

    fn cell(cells: usize, v: f32) -> usize {
        ((v * cells as f32) as usize).min(cells - 1)
    }

    fn near(&self, [s, t]: [f32; 2]) -> &[u32] {
        let cell = |v| Finder::cell(self.cells, v);
        self.near.of(cell(t) * self.cells + cell(s))
    }
}
