//! Eight numbers at a time: what the ray kernel asks of a processor.
//!
//! The traversal is written once over this trait and compiled for each kernel
//! (`kernel_avx2`, `kernel_portable`). Sums, products and quotients round once each, so both
//! kernels give the same bits; only [`Lanes::mul_sub`], used where a margin absorbs it, may
//! round once or twice.

use crate::bvh::Tree;
use crate::contract::Ray;
use crate::packet::Packet;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

/// Numbers in a [`Lanes`]; also children of a node and triangles of a leaf.
pub(crate) const WIDTH: usize = 8;

/// Eight `f32`.
pub(crate) trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// Eight truth values.
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask>;

    /// The same number eight times.
    fn splat(value: f32) -> Self;

    /// Eight numbers from memory.
    fn load(from: &[f32; WIDTH]) -> Self;

    /// Eight numbers to memory.
    fn store(self) -> [f32; WIDTH];

    /// `self * factor - minus`, rounded once or twice.
    fn mul_sub(self, factor: Self, minus: Self) -> Self;

    /// The smaller of each pair; `other` where one is not a number.
    fn min(self, other: Self) -> Self;

    /// The larger of each pair; `other` where one is not a number.
    fn max(self, other: Self) -> Self;

    /// `self <= other`; false where one is not a number.
    fn le(self, other: Self) -> Self::Mask;

    /// `self < other`; false where one is not a number.
    fn lt(self, other: Self) -> Self::Mask;

    /// Bit k is the truth value of lane k.
    fn bits(mask: Self::Mask) -> u32;
}

/// Lanes for which parts of the walk are compiled as functions of their own.
///
/// All else is inlined whole into a kernel's entry points; these two are not, because together
/// in one function they would be short of registers.
pub(crate) trait Kernel: Lanes {
    /// [`crate::traverse::visibility`].
    fn alone(tree: &Tree, segment: &Ray, root: u32) -> f32;

    /// [`crate::packet::together`].
    fn together(tree: &Tree, segments: &[Ray], visible: &mut [f32], packet: &mut Packet);
}
