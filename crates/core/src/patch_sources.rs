//! From a patch back to the source triangles that it is made of.
//!
//! A wall of thousands of triangles becomes one patch; what only a source triangle knows (texture
//! coordinates, holes) is found again at any place of it. Patches with many triangles have a
//! regular grid over their coordinates, so that costs do not grow with their number.

use crate::front::{Front, Patch, Shape};
use crate::scene::Scene;
use glam::Vec2;
use std::collections::HashMap;

/// Source triangles of every patch of a front.
#[derive(Clone, Debug, Default)]
pub struct PatchSources {
    /// Triangles of patch `p` are `list[start[p]..start[p + 1]]`, ascending.
    start: Vec<u32>,
    list: Vec<u32>,
    /// Of textured patches with many triangles, those near each place.
    finders: HashMap<u32, Finder>,
}

/// Patches with more triangles than this have a finder.
const FEW: usize = 8;

impl PatchSources {
    /// Near linear in the triangles.
    pub fn new(scene: &Scene, front: &Front) -> PatchSources {
        let pairs = front.patch_of.iter().enumerate().flat_map(|(t, sides)| {
            let some = sides.iter().filter(|id| id.is_some());
            some.map(move |id| (id.index(), t as u32))
        });
        let (start, list) = by_bucket(front.patches.len(), pairs);
        let mut sources = PatchSources {
            start,
            list,
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
        &self.list[self.start[patch] as usize..self.start[patch + 1] as usize]
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

/// Source triangles of one patch by the cell of a regular grid over its coordinates.
#[derive(Clone, Debug)]
struct Finder {
    /// Cells along each edge.
    cells: usize,
    start: Vec<u32>,
    list: Vec<u32>,
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
        let (start, list) = by_bucket(cells * cells, pairs);
        Finder { cells, start, list }
    }

    fn cell(cells: usize, v: f32) -> usize {
        ((v * cells as f32) as usize).min(cells - 1)
    }

    fn near(&self, [s, t]: [f32; 2]) -> &[u32] {
        let c = Finder::cell(self.cells, t) * self.cells + Finder::cell(self.cells, s);
        &self.list[self.start[c] as usize..self.start[c + 1] as usize]
    }
}

/// Values by their bucket, in the order given: those of bucket `b` are
/// `list[start[b]..start[b + 1]]`.
fn by_bucket(
    buckets: usize,
    pairs: impl Iterator<Item = (usize, u32)> + Clone,
) -> (Vec<u32>, Vec<u32>) {
    let mut start = vec![0u32; buckets + 1];
    pairs.clone().for_each(|(b, _)| start[b + 1] += 1);
    for b in 0..buckets {
        start[b + 1] += start[b];
    }
    let (mut at, mut list) = (start.clone(), vec![0; start[buckets] as usize]);
    for (b, value) in pairs {
        list[at[b] as usize] = value;
        at[b] += 1;
    }
    (start, list)
}
