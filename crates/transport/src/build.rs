//! Builds the tree of the ray engine: binned surface-area heuristic, then eight children a node.
//!
//! A binary tree first: at each step the triangles' centroids are sorted into a few bins along
//! each axis and the cut with the least expected work is taken, where work counts *leaves of
//! eight* rather than triangles, because a leaf costs the same half full. Both halves are built
//! in parallel. Each fork then knows, from its halves, the least work at which its subtree can be
//! handed to a wide node as one, two, ... seven children, and so where wide nodes should begin;
//! against opening the largest fork first this saves 3 to 7 % of the nodes a ray visits. Cuts
//! depend on the triangles alone, so the tree is the same for any number of threads.
//!
//! Source: [Wald07] for the bins, [Ylitie17] section 3.1 for the wide nodes.

use crate::arena::Arena;
use crate::bvh::{CHILD_IS_LEAF, EMPTY_LEAF, Leaf, Node, PARTIAL, Tree};
use crate::lanes::WIDTH;
use glam::Vec3A;
use luxel_core::{Alpha, Scene};
use rayon::prelude::*;
use std::sync::Arc;

/// Bins along each axis.
const BINS: usize = 16;
/// Work of testing eight boxes, in units of testing eight triangles. Between 0.5 and 3 the
/// trees hardly differ.
const FORK_WORK: f32 = 1.0;
/// From this depth on triangles are halved by number: bounds the depth whatever the scene.
const HEURISTIC_DEPTH: usize = 48;
/// Most levels of the binary tree: halving 2^31 triangles down to a leaf takes 28.
const MOST_LEVELS: usize = HEURISTIC_DEPTH + 28;
/// Most entries that wait while a tree is walked: each level leaves seven behind, and a packet
/// eight on the last.
pub(crate) const MOST_WAITING: usize = (WIDTH - 1) * MOST_LEVELS + WIDTH;
/// Triangles below which two halves are built one after the other.
const PARALLEL_FROM: usize = 4096;
/// Triangles a task looks at when one fork is cut in parallel.
const CHUNK: usize = 1 << 16;

/// A triangle while the tree is built.
#[derive(Clone, Copy)]
struct Item {
    low: Vec3A,
    high: Vec3A,
    triangle: u32,
}

impl Item {
    #[inline]
    fn centre(&self) -> Vec3A {
        self.low * 0.5 + self.high * 0.5
    }
}

/// An axis-parallel box.
#[derive(Clone, Copy)]
struct Bounds {
    low: Vec3A,
    high: Vec3A,
}

impl Bounds {
    const EMPTY: Bounds = Bounds {
        low: Vec3A::splat(f32::INFINITY),
        high: Vec3A::splat(f32::NEG_INFINITY),
    };

    #[inline]
    fn and(self, other: Bounds) -> Bounds {
        Bounds {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }

    #[inline]
    fn half_area(&self) -> f32 {
        let d = (self.high - self.low).max(Vec3A::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// The binary tree.
enum Branch {
    Leaf {
        bounds: Bounds,
        first: usize,
        count: usize,
    },
    Fork {
        bounds: Bounds,
        plan: Plan,
        halves: Box<[Branch; 2]>,
    },
}

impl Branch {
    fn bounds(&self) -> &Bounds {
        match self {
            Branch::Leaf { bounds, .. } | Branch::Fork { bounds, .. } => bounds,
        }
    }

    /// Least expected work as at most `children` children of a node.
    fn work(&self, children: usize) -> f32 {
        match self {
            Branch::Leaf { bounds, .. } => bounds.half_area(),
            Branch::Fork { plan, .. } => plan.work[children - 1],
        }
    }

    /// Adds the subtree to a node as at most `children` children.
    fn hand_over<'a>(&'a self, children: usize, to: &mut Vec<&'a Branch>) {
        let Branch::Fork { plan, .. } = self else {
            return to.push(self);
        };
        // The fewest children with the least work.
        let least = plan.work[children - 1];
        match plan.work[..children].iter().position(|&work| work <= least) {
            Some(more @ 1..) => self.hand_over_halves(more + 1, to),
            _ => to.push(self),
        }
    }

    /// Adds both halves to a node as at most `children` children together.
    fn hand_over_halves<'a>(&'a self, children: usize, to: &mut Vec<&'a Branch>) {
        if let Branch::Fork { plan, halves, .. } = self {
            let left = usize::from(plan.left[children - 2]);
            halves[0].hand_over(left, to);
            halves[1].hand_over(children - left, to);
        }
    }

    fn leaf_count(&self) -> usize {
        match self {
            Branch::Leaf { .. } => 1,
            Branch::Fork { halves, .. } => halves[0].leaf_count() + halves[1].leaf_count(),
        }
    }
}

/// How a subtree is best handed to wide nodes.
struct Plan {
    /// `work[k]`: least expected work of the subtree as at most `k + 1` children of a node.
    work: [f32; WIDTH - 1],
    /// `left[k]`: of `k + 2` children, how many go to the left half.
    left: [u8; WIDTH - 1],
}

impl Plan {
    fn new(halves: &[Branch; 2], area: f32) -> Plan {
        let mut divided = [f32::INFINITY; WIDTH + 1];
        let mut left = [1; WIDTH - 1];
        for children in 2..=WIDTH {
            for of_left in 1..children {
                let work = halves[0].work(of_left) + halves[1].work(children - of_left);
                if work < divided[children] {
                    divided[children] = work;
                    left[children - 2] = of_left as u8;
                }
            }
        }
        let mut work = [0.0; WIDTH - 1];
        work[0] = area * FORK_WORK + divided[WIDTH];
        for children in 2..WIDTH {
            work[children - 1] = divided[children].min(work[children - 2]);
        }
        Plan { work, left }
    }
}

/// How a triangle meets rays.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Presence {
    Absent,
    Solid,
    Partial,
}

/// A constant coverage is settled here, so that only textured surfaces are looked at per ray.
pub(crate) fn presence(scene: &Scene, triangle: usize) -> Presence {
    let finish = scene.finish_of(triangle);
    let constant = finish.texture.is_none();
    match finish.alpha {
        _ if finish.transparent => Presence::Absent,
        Alpha::Opaque => Presence::Solid,
        Alpha::Mask { cutoff } if constant && finish.coverage < cutoff => Presence::Absent,
        Alpha::Mask { .. } if constant => Presence::Solid,
        Alpha::Blend if constant && finish.coverage >= 1.0 => Presence::Solid,
        Alpha::Blend if finish.coverage <= 0.0 => Presence::Absent,
        Alpha::Mask { .. } | Alpha::Blend => Presence::Partial,
    }
}

/// Builds the tree over all triangles of `scene` that a ray can meet.
pub(crate) fn build(scene: &Arc<Scene>) -> Tree {
    let mut items: Vec<Item> = (0..scene.triangles.len())
        .into_par_iter()
        .filter_map(|triangle| {
            let flag = match presence(scene, triangle) {
                Presence::Absent => return None,
                Presence::Solid => 0,
                Presence::Partial => PARTIAL,
            };
            let [a, b, c] = scene.corners(triangle).map(Vec3A::from);
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            Some(Item {
                low,
                high,
                triangle: triangle as u32 | flag,
            })
        })
        .collect();
    let has_partial = items.iter().any(|item| item.triangle & PARTIAL != 0);

    let branch = if items.is_empty() {
        None
    } else {
        Some(grow(&mut items, 0, 0))
    };
    let leaf_count = branch.as_ref().map_or(0, Branch::leaf_count);
    // There are fewer nodes than leaves.
    let mut arena = Arena::with_room((leaf_count + 1) * (size_of::<Leaf>() + size_of::<Node>()));
    arena.push(&Leaf::EMPTY);
    let (mut root, mut extent) = (EMPTY_LEAF, 0.0);
    if let Some(branch) = branch {
        let bounds = branch.bounds();
        extent = bounds.low.abs().max(bounds.high.abs()).max_element();
        root = widen(&branch, &items, scene, &mut arena);
    }
    Tree {
        root,
        extent,
        arena,
        has_partial,
        scene: Arc::clone(scene),
    }
}

/// The cut of least work: where it is, and how much.
#[derive(Clone, Copy)]
struct Cut {
    axis: usize,
    last_bin_left: usize,
    work: f32,
}

/// How centroids map to bins.
#[derive(Clone, Copy)]
struct Binning {
    low: Vec3A,
    scale: Vec3A,
}

impl Binning {
    fn new(centres: &Bounds) -> Binning {
        let extent = centres.high - centres.low;
        let scale =
            Vec3A::splat(BINS as f32 * 0.9999) / extent.max(Vec3A::splat(f32::MIN_POSITIVE));
        // Overflow in either place leaves everything in one bin: no cut, so the halves are even.
        let scale = Vec3A::select(scale.cmplt(Vec3A::splat(f32::INFINITY)), scale, Vec3A::ZERO);
        Binning {
            low: centres.low,
            scale,
        }
    }

    #[inline]
    fn bins(&self, item: &Item) -> [usize; 3] {
        let place = (item.centre() - self.low) * self.scale;
        // A cast saturates and takes NaN to 0.
        [place.x as usize, place.y as usize, place.z as usize].map(|k| k.min(BINS - 1))
    }
}

/// What fell into the bins of each axis.
#[derive(Clone)]
struct Bins {
    bounds: [[Bounds; BINS]; 3],
    count: [[usize; BINS]; 3],
}

impl Bins {
    const EMPTY: Bins = Bins {
        bounds: [[Bounds::EMPTY; BINS]; 3],
        count: [[0; BINS]; 3],
    };

    fn of(items: &[Item], binning: Binning) -> Bins {
        let mut bins = Bins::EMPTY;
        for item in items {
            let bounds = Bounds {
                low: item.low,
                high: item.high,
            };
            for (axis, bin) in binning.bins(item).into_iter().enumerate() {
                bins.bounds[axis][bin] = bins.bounds[axis][bin].and(bounds);
                bins.count[axis][bin] += 1;
            }
        }
        bins
    }

    fn and(mut self, other: Bins) -> Bins {
        for axis in 0..3 {
            for bin in 0..BINS {
                self.bounds[axis][bin] = self.bounds[axis][bin].and(other.bounds[axis][bin]);
                self.count[axis][bin] += other.count[axis][bin];
            }
        }
        self
    }

    fn best_cut(&self) -> Option<Cut> {
        let mut best: Option<Cut> = None;
        for axis in 0..3 {
            let (bounds, count) = (&self.bounds[axis], &self.count[axis]);
            let mut right = [(0.0f32, 0usize); BINS];
            let (mut grown, mut n) = (Bounds::EMPTY, 0);
            for bin in (1..BINS).rev() {
                grown = grown.and(bounds[bin]);
                n += count[bin];
                right[bin] = (grown.half_area(), n);
            }
            let (mut grown, mut n) = (Bounds::EMPTY, 0);
            for bin in 0..BINS - 1 {
                grown = grown.and(bounds[bin]);
                n += count[bin];
                let (right_area, right_n) = right[bin + 1];
                if n == 0 || right_n == 0 {
                    continue;
                }
                let work = grown.half_area() * leaves_of(n) + right_area * leaves_of(right_n);
                if work < best.map_or(f32::INFINITY, |b| b.work) {
                    best = Some(Cut {
                        axis,
                        last_bin_left: bin,
                        work,
                    });
                }
            }
        }
        best
    }
}

/// Leaves that `n` triangles fill.
#[inline]
fn leaves_of(n: usize) -> f32 {
    n.div_ceil(WIDTH) as f32
}

/// Bounds of the triangles and of their centroids.
fn measure(items: &[Item]) -> (Bounds, Bounds) {
    let mut all = Bounds::EMPTY;
    let mut centres = Bounds::EMPTY;
    for item in items {
        all = all.and(Bounds {
            low: item.low,
            high: item.high,
        });
        let c = item.centre();
        centres = centres.and(Bounds { low: c, high: c });
    }
    (all, centres)
}

/// The binary tree over `items`, which lie at `first` among all; sorts them as it goes.
fn grow(items: &mut [Item], first: usize, depth: usize) -> Branch {
    let n = items.len();
    // Minimum, maximum and counts do not depend on order, so neither do the parallel forms.
    let (bounds, centres) = if n > 2 * CHUNK {
        items.par_chunks(CHUNK).map(measure).reduce(
            || (Bounds::EMPTY, Bounds::EMPTY),
            |a, b| (a.0.and(b.0), a.1.and(b.1)),
        )
    } else {
        measure(items)
    };
    if n == 1 {
        return Branch::Leaf {
            bounds,
            first,
            count: n,
        };
    }
    let binning = Binning::new(&centres);
    let cut = if depth >= HEURISTIC_DEPTH {
        None
    } else if n > 2 * CHUNK {
        items
            .par_chunks(CHUNK)
            .map(|chunk| Bins::of(chunk, binning))
            .reduce(|| Bins::EMPTY, Bins::and)
            .best_cut()
    } else {
        Bins::of(items, binning).best_cut()
    };
    let area = bounds.half_area();
    let left = match cut {
        Some(cut) if n > WIDTH || FORK_WORK * area + cut.work < area * leaves_of(n) => {
            divide(items, |item| {
                binning.bins(item)[cut.axis] <= cut.last_bin_left
            })
        }
        _ if n <= WIDTH => {
            return Branch::Leaf {
                bounds,
                first,
                count: n,
            };
        }
        _ => n / 2,
    };
    let (a, b) = items.split_at_mut(left);
    let halves = if n > PARALLEL_FROM {
        let (left, right) = rayon::join(
            || grow(a, first, depth + 1),
            || grow(b, first + left, depth + 1),
        );
        [left, right]
    } else {
        [grow(a, first, depth + 1), grow(b, first + left, depth + 1)]
    };
    Branch::Fork {
        bounds,
        plan: Plan::new(&halves, bounds.half_area()),
        halves: Box::new(halves),
    }
}

/// Puts the items that belong left first, and returns how many they are.
fn divide(items: &mut [Item], is_left: impl Fn(&Item) -> bool) -> usize {
    let (mut i, mut end) = (0, items.len());
    while i < end {
        if is_left(&items[i]) {
            i += 1;
        } else {
            end -= 1;
            items.swap(i, end);
        }
    }
    i
}

/// Appends `branch` to the tree, eight children a node, and returns the reference to it.
fn widen(branch: &Branch, items: &[Item], scene: &Scene, arena: &mut Arena) -> u32 {
    if let Branch::Leaf { first, count, .. } = branch {
        let leaf = leaf_of(&items[*first..first + count], scene);
        return CHILD_IS_LEAF | arena.push(&leaf);
    }
    let mut children: Vec<&Branch> = Vec::with_capacity(WIDTH);
    branch.hand_over_halves(WIDTH, &mut children);
    let mut node = Node::EMPTY;
    // The node comes before its children; it is written again when they have names.
    let name = arena.push(&node);
    for (k, child) in children.iter().enumerate() {
        let bounds = child.bounds();
        for axis in 0..3 {
            node.planes[2 * axis][k] = bounds.low[axis];
            node.planes[2 * axis + 1][k] = bounds.high[axis];
        }
        node.child[k] = widen(child, items, scene, arena);
    }
    arena.set(name, &node);
    name
}

fn leaf_of(items: &[Item], scene: &Scene) -> Leaf {
    let mut leaf = Leaf::EMPTY;
    for (k, item) in items.iter().enumerate() {
        let corners = scene.corners((item.triangle & !PARTIAL) as usize);
        for (corner, position) in corners.iter().enumerate() {
            for axis in 0..3 {
                leaf.corners[corner][axis][k] = position[axis];
            }
        }
        leaf.triangle[k] = item.triangle;
    }
    leaf
}
