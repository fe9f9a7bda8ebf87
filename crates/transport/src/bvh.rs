//! The ray engine: an eight-wide bounding-volume hierarchy over the source triangles.
//!
//! Nodes hold eight boxes and leaves eight triangles, field by field, so that one instruction
//! tests eight. [`crate::build`] makes the tree, `traverse` walks it for one ray, `packet` for
//! up to sixteen coherent segments; which processor instructions do it is chosen when the tree
//! is built, and changes no bit of an answer.
//!
//! Source: [Wald08] for wide nodes on single rays, [Woop13] for the triangle test.

use crate::arena::{Arena, Lines};
use crate::contract::{Hit, Ray, RayCaster};
use crate::lanes::WIDTH;
use crate::{build, kernel_portable, packet, traverse};
use luxel_core::Scene;
use std::sync::Arc;

/// Bit of a child reference: the rest numbers a leaf, not a node.
pub(crate) const CHILD_IS_LEAF: u32 = 1 << 31;
/// The leaf that every tree starts with: no triangle.
pub(crate) const EMPTY_LEAF: u32 = CHILD_IS_LEAF;
/// Bit of a leaf's triangle: its coverage must be looked up.
pub(crate) const PARTIAL: u32 = 1 << 31;

/// Eight boxes and what is inside them.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Node {
    /// `planes[2 axis + side][child]`, side 0 low and 1 high, metres.
    pub(crate) planes: [[f32; WIDTH]; 6],
    /// References to nodes, or to leaves with [`CHILD_IS_LEAF`].
    pub(crate) child: [u32; WIDTH],
    /// Fills the last cache line.
    pub(crate) unused: [u32; WIDTH],
}

// SAFETY: f32 and u32 only, four lines of 64 bytes.
unsafe impl Lines for Node {}
const _: () = assert!(size_of::<Node>() == 4 * 64);

impl Node {
    /// Boxes that nothing enters, and should rounding disagree, the empty leaf behind them.
    pub(crate) const EMPTY: Node = Node {
        planes: [
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
        ],
        child: [EMPTY_LEAF; WIDTH],
        unused: [0; WIDTH],
    };
}

/// Up to eight triangles.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Leaf {
    /// `corners[corner][axis][triangle]`, metres; NaN where there is no triangle.
    pub(crate) corners: [[[f32; WIDTH]; 3]; 3],
    /// Source triangle, with [`PARTIAL`].
    pub(crate) triangle: [u32; WIDTH],
}

// SAFETY: f32 and u32 only, five lines of 64 bytes.
unsafe impl Lines for Leaf {}
const _: () = assert!(size_of::<Leaf>() == 5 * 64);

impl Leaf {
    /// No triangle: comparisons with NaN fail, so nothing is ever hit.
    pub(crate) const EMPTY: Leaf = Leaf {
        corners: [[[f32::NAN; WIDTH]; 3]; 3],
        triangle: [u32::MAX; WIDTH],
    };
}

/// The tree and what a walk through it needs.
pub(crate) struct Tree {
    /// Nodes and leaves; [`EMPTY_LEAF`] comes first.
    pub(crate) arena: Arena,
    pub(crate) root: u32,
    /// Largest absolute coordinate, metres.
    pub(crate) extent: f32,
    /// Whether any triangle is [`PARTIAL`].
    pub(crate) has_partial: bool,
    pub(crate) scene: Arc<Scene>,
}

impl Tree {
    /// A node by reference.
    #[inline(always)]
    pub(crate) fn node(&self, reference: u32) -> &Node {
        debug_assert!(reference & CHILD_IS_LEAF == 0);
        // SAFETY: references come from the root and from `child`, which the builder fills with
        // the names of what it has pushed, marking leaves; nothing changes them later.
        unsafe { self.arena.get(reference) }
    }

    /// A leaf by reference.
    #[inline(always)]
    pub(crate) fn leaf(&self, reference: u32) -> &Leaf {
        debug_assert!(reference & CHILD_IS_LEAF != 0);
        // SAFETY: as for `node`.
        unsafe { self.arena.get(reference & !CHILD_IS_LEAF) }
    }

    /// Starts to fetch a node or leaf that will be needed soon.
    #[inline(always)]
    pub(crate) fn prefetch(&self, reference: u32) {
        self.arena.prefetch(reference & !CHILD_IS_LEAF);
    }
}

/// Which instructions walk the tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// AVX2 and FMA, on x86-64 processors that have them.
    Avx2,
    /// Whatever the compiler makes of plain arrays.
    Portable,
}

impl Kernel {
    /// The fastest that this processor runs.
    pub fn best() -> Kernel {
        #[cfg(target_arch = "x86_64")]
        if crate::kernel_avx2::available() {
            return Kernel::Avx2;
        }
        Kernel::Portable
    }
}

/// A ray engine over one scene: closest hit and visibility, on the processor.
///
/// Built in time n log n; about 55 bytes a triangle ([`Bvh::bytes`]) beside the scene, which it
/// shares. Holds fewer than 2^31 triangles.
pub struct Bvh {
    tree: Tree,
    kernel: Kernel,
}

impl Bvh {
    /// Builds the tree over all triangles of `scene` but those of clear glass.
    ///
    /// Uses the current rayon pool; the tree is the same for any number of threads.
    pub fn build(scene: &Arc<Scene>) -> Bvh {
        Bvh {
            tree: build::build(scene),
            kernel: Kernel::best(),
        }
    }

    /// The same tree walked by the portable kernel: same answers, for processors to compare.
    pub fn into_portable(self) -> Bvh {
        Bvh {
            kernel: Kernel::Portable,
            ..self
        }
    }

    /// Which instructions walk the tree.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// Memory of nodes and leaves, bytes; the scene is not counted.
    pub fn bytes(&self) -> usize {
        self.tree.arena.bytes()
    }

    /// The scene that rays meet.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.tree.scene
    }
}

impl RayCaster for Bvh {
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]) {
        debug_assert_eq!(rays.len(), hits.len());
        match self.kernel {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Kernel::best` saw that the processor has the instructions.
            Kernel::Avx2 => unsafe { crate::kernel_avx2::closest(&self.tree, rays, hits) },
            _ => traverse::closest_batch::<kernel_portable::Portable>(&self.tree, rays, hits),
        }
    }

    fn visibility(&self, segments: &[Ray], visible: &mut [f32]) {
        debug_assert_eq!(segments.len(), visible.len());
        match self.kernel {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as for `closest`.
            Kernel::Avx2 => unsafe {
                crate::kernel_avx2::visibility(&self.tree, segments, visible)
            },
            _ => {
                packet::visibility_batch::<kernel_portable::Portable>(&self.tree, segments, visible)
            }
        }
    }

    /// Eight units in the last place of the largest coordinate. A point computed on a triangle
    /// is off by up to two, the triangle test by up to three.
    fn offset_m(&self) -> f32 {
        (8.0 * f32::EPSILON * self.tree.extent).max(f32::MIN_POSITIVE)
    }
}
