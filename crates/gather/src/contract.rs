//! What is asked at a receiver and what is answered.

use luxel_core::Vec3;

/// A point that light falls on: on a surface or a hair above it, or free in the room.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// Place, metres.
    pub position: Vec3,
    /// Unit normal of the plane whose irradiance is asked.
    pub normal: Vec3,
}

/// How good the answer has to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accuracy {
    /// Wanted standard error of the photometric total, relative to its value.
    pub relative: f32,
    /// Standard error that is good enough however dark it is, lux.
    pub floor_lux: f32,
    /// Fewest and most gather rays a receiver (powers of two).
    pub rays: [u32; 2],
    /// Seed of every random number.
    pub seed: u32,
}

/// Irradiance at a list of receivers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Irradiance {
    /// Columns a receiver (3 * group + band).
    pub columns: usize,
    /// `values[receiver * columns + column]`, lux of each band.
    pub values: Vec<f32>,
    /// Standard error of each layer's photometric value, `[receiver * groups + group]`, lux.
    pub layer_errors: Vec<f32>,
    /// Standard error of the photometric total, one a receiver, lux. Not the root of the sum of
    /// squares of the layers' errors: one ray carries all layers.
    pub errors: Vec<f32>,
    /// Gather and shadow rays used.
    pub rays: u64,
}
