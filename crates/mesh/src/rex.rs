//! Radiosity textures as a mesh: one quadtree on each cell of a coarse grid, split and merged by
//! the light that is counted in its leaves.
//!
//! The first front is coarse: a quarter of the uniform mesh's cells along an edge. A leaf splits
//! where the step of light to its neighbours, times its own area, is large against the mean power
//! of a leaf: leaves come to hold about equal counts where light varies, however it is shared among
//! surfaces. Four leaves whose contrast is far below that are merged again; a merged leaf has the
//! mean of its four, so a change keeps flux either way.
//!
//! [`tree`] is the texture itself, a store of photons for one surface.
//!
//! Source: [Heckbert90], [Yeap99] 6.3.2, figures 6.6 and 6.7. Differs: contrast comes from the
//! solved elements ([`RefinementWish`]), so that any solver may count.

pub mod tree;

use crate::adaptive::may_split;
use crate::contract::{MeshSettings, Strategy};
use crate::shade::shade;
use crate::uniform::mesh;
use luxel_core::front::Cell;
use luxel_core::{ElementId, Front, FrontChange, PatchId, RefinementWish, Scene, Solution};
use std::collections::{HashMap, HashSet};

/// Cells of the uniform mesh along an edge of a cell of the first front.
const COARSER: u32 = 4;
/// Contrast of power above which a leaf is split: 5 % of the mean power of a leaf.
const SPLIT: f32 = 0.05;
/// Contrast below which four leaves are merged: a merged leaf has four times the area and is up to
/// twice as far from its neighbours, so it stays below [`SPLIT`].
const MERGE: f32 = SPLIT / 10.0;

/// The rex strategy.
#[derive(Clone, Debug)]
pub struct Rex {
    settings: MeshSettings,
    /// The first front, which every later one is split from.
    base: Front,
}

impl Rex {
    /// With these settings.
    pub fn new(settings: MeshSettings) -> Self {
        Rex {
            settings,
            base: Front::default(),
        }
    }
}

/// A node: patch, and place with its bits.
type Key = (PatchId, [u32; 4]);

fn key(patch: PatchId, rect: [f32; 4]) -> Key {
    (patch, rect.map(f32::to_bits))
}

/// A node of four leaves or deeper nodes.
struct Inner {
    key: Key,
    children: [Cell; 4],
}

impl Strategy for Rex {
    fn initial(&mut self, scene: &Scene) -> Front {
        self.base = mesh(scene, &self.settings, |n| n.div_ceil(COARSER)).0;
        self.base.clone()
    }

    fn refine(
        &mut self,
        scene: &Scene,
        front: &Front,
        _: &Solution,
        wish: &RefinementWish,
    ) -> Option<(Front, FrontChange)> {
        if front.patches != self.base.patches || wish.0.len() != front.len() {
            return None;
        }
        let mean_area = front.total_area() / front.len().max(1) as f64;
        let contrast = |e: usize| wish.0[e] * (front.area[e] as f64 / mean_area) as f32;
        let inner = self.inner(front);
        let mut split: HashSet<Key> = inner.iter().map(|n| n.key).collect();
        // Merges first: they make room.
        let mut count = front.len();
        for node in &inner {
            let leaves = node.children.iter().all(|c| match *c {
                Cell::Element(e) => contrast(e.index()) < MERGE,
                Cell::Split(_) => false,
            });
            if leaves && split.remove(&node.key) {
                count -= 3;
            }
        }
        let mut wanted: Vec<(f32, u32)> = (0..front.len())
            .filter(|&e| {
                contrast(e) > SPLIT && may_split(front, ElementId::from(e), &self.settings)
            })
            .map(|e| (contrast(e), e as u32))
            .collect();
        wanted.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        for (_, e) in wanted {
            if count + 3 > self.settings.max_elements {
                break;
            }
            count += 3;
            split.insert(key(front.patch[e as usize], front.rect[e as usize]));
        }
        if split.len() == inner.len() && inner.iter().all(|n| split.contains(&n.key)) {
            return None;
        }
        let (mut new, change) = self.grow(front, &inner, &split)?;
        shade(scene, &mut new);
        Some((new, change))
    }
}

impl Rex {
    /// Inner nodes of a front, in order of patch and depth.
    fn inner(&self, front: &Front) -> Vec<Inner> {
        let mut all = Vec::new();
        // Cells of the base are elements, and their rectangles the roots.
        for e in 0..self.base.len() {
            let patch = self.base.patch[e];
            let place = self.base.patches[patch.index()].first_cell as usize;
            // Elements of a patch follow each other as its cells do.
            let first = self.base.patch.partition_point(|&p| p < patch);
            let cell = front.cells[place + e - first];
            let mut stack = vec![(cell, self.base.rect[e])];
            while let Some((cell, rect)) = stack.pop() {
                let Cell::Split(node) = cell else { continue };
                let children = front.tree[node as usize];
                all.push(Inner {
                    key: key(patch, rect),
                    children,
                });
                let shape = &front.patches[patch.index()].shape;
                let quarters = shape.quarters(rect).into_iter().flatten();
                stack.extend(children.into_iter().zip(quarters));
            }
        }
        all
    }

    /// The front in which exactly the nodes of `split` are split, and what its elements inherit.
    fn grow(
        &self,
        old: &Front,
        inner: &[Inner],
        split: &HashSet<Key>,
    ) -> Option<(Front, FrontChange)> {
        let leaves: HashMap<Key, ElementId> = (0..old.len())
            .map(|e| (key(old.patch[e], old.rect[e]), ElementId::from(e)))
            .collect();
        let merged: HashMap<Key, [Cell; 4]> = inner.iter().map(|n| (n.key, n.children)).collect();
        let mut new = self.base.clone();
        // The old leaf that a new element lies in, once one is met on the way down.
        let mut heir: Vec<Option<ElementId>> = vec![None; new.len()];
        let mut at = 0;
        while at < new.len() {
            let node = key(new.patch[at], new.rect[at]);
            heir[at] = heir[at].or_else(|| leaves.get(&node).copied());
            if split.contains(&node) {
                let children = new.split(ElementId::from(at))?;
                heir.resize(new.len(), None);
                for child in children {
                    heir[child.index()] = heir[at];
                }
                // The first child has the parent's place in the list: look at it again.
            } else {
                at += 1;
            }
        }
        let mut change = FrontChange {
            offsets: vec![0],
            sources: Vec::with_capacity(new.len()),
        };
        for e in 0..new.len() {
            match heir[e] {
                Some(o) => change.sources.push((o, 1.0)),
                None => {
                    // Four equal leaves became this one.
                    for cell in merged.get(&key(new.patch[e], new.rect[e]))? {
                        let Cell::Element(o) = *cell else { return None };
                        change.sources.push((o, 0.25));
                    }
                }
            }
            change.offsets.push(change.sources.len() as u32);
        }
        Some((new, change))
    }
}
