//! Eight numbers in one AVX register, and the entry points that are compiled for AVX2 and FMA.
//!
//! Nothing here may run on a processor without both: [`available`] is asked once, when a tree
//! is built. The generic traversal is inlined whole into the entry points, so that the
//! compiler uses the wide instructions throughout.

use crate::bvh::Tree;
use crate::contract::{Hit, Ray};
use crate::lanes::{Kernel, Lanes, WIDTH};
use crate::packet::Packet;
use crate::{packet, traverse};
use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

/// Whether this processor runs the kernel.
pub(crate) fn available() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
}

/// [`traverse::closest`] of each ray.
///
/// # Safety
/// [`available`] holds.
#[target_feature(enable = "avx2,fma")]
pub(crate) unsafe fn closest(tree: &Tree, rays: &[Ray], hits: &mut [Hit]) {
    traverse::closest_batch::<Avx2>(tree, rays, hits);
}

/// [`packet::visibility_batch`].
///
/// # Safety
/// [`available`] holds.
#[target_feature(enable = "avx2,fma")]
pub(crate) unsafe fn visibility(tree: &Tree, segments: &[Ray], visible: &mut [f32]) {
    packet::visibility_batch::<Avx2>(tree, segments, visible);
}

#[target_feature(enable = "avx2,fma")]
#[inline(never)]
unsafe fn alone(tree: &Tree, segment: &Ray, root: u32) -> f32 {
    traverse::visibility::<Avx2>(tree, segment, root)
}

#[target_feature(enable = "avx2,fma")]
#[inline(never)]
unsafe fn together(tree: &Tree, segments: &[Ray], visible: &mut [f32], packet: &mut Packet) {
    packet::together::<Avx2>(tree, segments, visible, packet);
}

/// Eight `f32` in a register.
///
/// Safety of every method: values are made in [`closest`] and [`visibility`] and below them
/// only, so where there is one, [`available`] holds.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(__m256);

/// Eight truth values, as comparisons leave them.
#[derive(Clone, Copy)]
pub(crate) struct Truth(__m256);

impl BitAnd for Truth {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Truth(unsafe { _mm256_and_ps(self.0, other.0) })
    }
}

impl BitOr for Truth {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Truth(unsafe { _mm256_or_ps(self.0, other.0) })
    }
}

impl Add for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Avx2(unsafe { _mm256_add_ps(self.0, other.0) })
    }
}

impl Sub for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Avx2(unsafe { _mm256_sub_ps(self.0, other.0) })
    }
}

impl Mul for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Avx2(unsafe { _mm256_mul_ps(self.0, other.0) })
    }
}

impl Div for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Avx2(unsafe { _mm256_div_ps(self.0, other.0) })
    }
}

impl Lanes for Avx2 {
    type Mask = Truth;

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Avx2(unsafe { _mm256_set1_ps(value) })
    }

    #[inline(always)]
    fn load(from: &[f32; WIDTH]) -> Self {
        Avx2(unsafe { _mm256_loadu_ps(from.as_ptr()) })
    }

    #[inline(always)]
    fn store(self) -> [f32; WIDTH] {
        let mut to = [0.0; WIDTH];
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) };
        to
    }

    #[inline(always)]
    fn mul_sub(self, factor: Self, minus: Self) -> Self {
        Avx2(unsafe { _mm256_fmsub_ps(self.0, factor.0, minus.0) })
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Avx2(unsafe { _mm256_min_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Avx2(unsafe { _mm256_max_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn le(self, other: Self) -> Truth {
        Truth(unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0) })
    }

    #[inline(always)]
    fn lt(self, other: Self) -> Truth {
        Truth(unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) })
    }

    #[inline(always)]
    fn bits(mask: Truth) -> u32 {
        (unsafe { _mm256_movemask_ps(mask.0) }) as u32
    }
}

impl Kernel for Avx2 {
    // SAFETY of both: the type is named below `closest` and `visibility` only.
    #[inline(always)]
    fn alone(tree: &Tree, segment: &Ray, root: u32) -> f32 {
        unsafe { alone(tree, segment, root) }
    }

    #[inline(always)]
    fn together(tree: &Tree, segments: &[Ray], visible: &mut [f32], packet: &mut Packet) {
        unsafe { together(tree, segments, visible, packet) }
    }
}
