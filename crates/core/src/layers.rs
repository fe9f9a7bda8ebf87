//! Layers: bands times luminaire groups, the columns that every solution carries.
//!
//! Light is linear, so each luminaire group (and the sky) keeps columns of its own and dimming
//! is a sum. Column `3 * group + band`. Transport is shared by all columns.

use crate::quantity::{LUMINANCE_WEIGHTS, Rgb};

/// Number of bands in a group: linear red, green, blue.
pub const BANDS: usize = 3;

/// How many columns a solution has and what each is called.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layers {
    /// Name of each luminaire group, in the order of the columns.
    pub groups: Vec<String>,
}

impl Layers {
    /// Columns of a solution: three for each group. At least three.
    pub fn columns(&self) -> usize {
        BANDS * self.groups.len().max(1)
    }

    /// One group in place of all.
    pub fn merged(&self) -> Layers {
        Layers {
            groups: vec![self.groups.join(" + ")],
        }
    }
}

/// Sum over the groups: what all luminaires together give. `columns.len()` is a multiple of 3.
#[inline]
pub fn total(columns: &[f32]) -> Rgb {
    let mut sum = [0.0f64; BANDS];
    for group in columns.chunks_exact(BANDS) {
        for band in 0..BANDS {
            sum[band] += group[band] as f64;
        }
    }
    Rgb::new(sum[0] as f32, sum[1] as f32, sum[2] as f32)
}

/// Photometric sum over all columns.
#[inline]
pub fn luminance(columns: &[f32]) -> f32 {
    columns
        .chunks_exact(BANDS)
        .map(|g| {
            g[0] * LUMINANCE_WEIGHTS[0] + g[1] * LUMINANCE_WEIGHTS[1] + g[2] * LUMINANCE_WEIGHTS[2]
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn total_adds_groups_band_by_band() {
        assert_eq!(
            total(&[1.0, 2.0, 3.0, 10.0, 20.0, 30.0]),
            Rgb::new(11.0, 22.0, 33.0)
        );
    }
}
