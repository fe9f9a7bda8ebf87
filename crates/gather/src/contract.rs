//! What is asked at a receiver and what is answered.

use luxel_core::{Rgb, Vec3, layers};

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
    /// Standard error of the photometric total, one a receiver, lux: 1.96 times it is half of a 95 %
    /// interval. Not the root of the sum of
    /// squares of the layers' errors: one ray carries all layers.
    pub errors: Vec<f32>,
    /// Gather and shadow rays used.
    pub rays: u64,
}

impl Irradiance {
    /// All groups together at a receiver, lux of each band. What is random in it may lie a hair
    /// below zero or, from absurd input, be no number: both are 0 here.
    pub fn total(&self, receiver: usize) -> Rgb {
        let lit = |v: f32| if v.is_finite() { v.max(0.0) } else { 0.0 };
        Rgb::from(layers::total(self.row(receiver)).to_array().map(lit))
    }

    /// Photometric total at a receiver, lux.
    pub fn lux(&self, receiver: usize) -> f32 {
        layers::luminance(self.row(receiver))
    }

    /// How many receivers no light reaches.
    pub fn dark(&self) -> usize {
        let dark = |&receiver: &usize| self.row(receiver).iter().all(|&v| v == 0.0);
        (0..self.errors.len()).filter(dark).count()
    }

    fn row(&self, receiver: usize) -> &[f32] {
        &self.values[receiver * self.columns..(receiver + 1) * self.columns]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_summed_and_bad_numbers_are_dark() {
        let answers = Irradiance {
            columns: 6,
            values: vec![
                1.0,
                2.0,
                3.0,
                10.0,
                20.0,
                30.0,
                f32::NAN,
                -1.0,
                1.0,
                0.0,
                0.5,
                0.0,
            ],
            ..Irradiance::default()
        };
        assert_eq!(answers.total(0), Rgb::new(11.0, 22.0, 33.0));
        assert_eq!(answers.total(1), Rgb::new(0.0, 0.0, 1.0));
    }

    #[test]
    fn loosened_asks_for_fewer_rays() {
        let accuracy = Accuracy {
            relative: 0.02,
            floor_lux: 0.1,
            rays: [256, 16384],
            seed: 1,
        };
        assert_eq!(accuracy.loosened(0.5), accuracy);
        let loose = accuracy.loosened(2.0);
        assert_eq!((loose.relative, loose.rays), (0.04, [64, 4096]));
        assert_eq!(accuracy.loosened(8.0).rays, [16, 256]);
    }
}
