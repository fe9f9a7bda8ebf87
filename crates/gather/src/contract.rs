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

/// Fewest gather rays of a receiver whose accuracy is loosened.
const FEWEST_LOOSENED: u32 = 16;

impl Accuracy {
    /// What errors so many times as large ask for; `slack` is at least 1. The fewest and most rays
    /// shrink with its square, to 16.
    pub fn loosened(&self, slack: f32) -> Accuracy {
        if slack <= 1.0 {
            return *self;
        }
        let fewer = |rays: u32| {
            let loosened = (rays as f32 / (slack * slack)) as u32;
            loosened.max(FEWEST_LOOSENED).min(rays)
        };
        Accuracy {
            relative: self.relative * slack,
            floor_lux: self.floor_lux * slack,
            rays: self.rays.map(fewer),
            seed: self.seed,
        }
    }
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
