//! Eight numbers as an array: runs everywhere, and a compiler makes of it what the processor
//! has (two NEON registers on 64-bit Arm, two SSE registers on any x86-64).

use crate::bvh::Tree;
use crate::contract::Ray;
use crate::lanes::{Kernel, Lanes, WIDTH};
use crate::packet::Packet;
use crate::{packet, traverse};
use std::ops::{Add, Div, Mul, Sub};

/// Eight `f32` in an array.
#[derive(Clone, Copy)]
#[repr(align(32))]
pub(crate) struct Portable([f32; WIDTH]);

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Portable(std::array::from_fn(|k| f(self.0[k], other.0[k])))
    }

    #[inline(always)]
    fn compare(self, other: Self, f: impl Fn(f32, f32) -> bool) -> u32 {
        let mut bits = 0;
        for k in 0..WIDTH {
            bits |= u32::from(f(self.0[k], other.0[k])) << k;
        }
        bits
    }
}

impl Add for Portable {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl Sub for Portable {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl Mul for Portable {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl Div for Portable {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

impl Lanes for Portable {
    type Mask = u32;

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Portable([value; WIDTH])
    }

    #[inline(always)]
    fn load(from: &[f32; WIDTH]) -> Self {
        Portable(*from)
    }

    #[inline(always)]
    fn store(self) -> [f32; WIDTH] {
        self.0
    }

    #[inline(always)]
    fn mul_sub(self, factor: Self, minus: Self) -> Self {
        self * factor - minus
    }

    // A comparison, not f32::min: that is one instruction on x86, and what NaN does is stated.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        self.compare(other, |a, b| a <= b)
    }

    #[inline(always)]
    fn lt(self, other: Self) -> u32 {
        self.compare(other, |a, b| a < b)
    }

    #[inline(always)]
    fn bits(mask: u32) -> u32 {
        mask
    }
}

impl Kernel for Portable {
    fn alone(tree: &Tree, segment: &Ray, root: u32) -> f32 {
        traverse::visibility::<Portable>(tree, segment, root)
    }

    fn together(tree: &Tree, segments: &[Ray], visible: &mut [f32], packet: &mut Packet) {
        packet::together::<Portable>(tree, segments, visible, packet);
    }
}
