//! A solution: exitance of every element of a front, in every column, and how good it is.

use crate::layers::{BANDS, Layers};
use crate::quantity::Rgb;

/// Reflected and carried light of every element, as a solver leaves it.
///
/// `exitance[element * columns + column]`, lm/m². It holds what the solver was given as
/// emission too (self-emission of surfaces that are gathered by rays, and the first reflection
/// of direct light), but not the self-emission of emitters whose direct light is computed apart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// Names of the columns.
    pub layers: Layers,
    /// Exitance, element by element, lm/m².
    pub exitance: Vec<f32>,
    /// Exitance not yet sent on, same shape; **signed**: after refinement an element may owe light.
    pub unshot: Vec<f32>,
    /// Estimated relative RMS error of the elements' exitance, 0 for a deterministic solver.
    pub relative_error: f32,
    /// Share of the emitted flux still unshot, absolute, 0..=1.
    pub unshot_share: f32,
    /// Rays or form factors used so far.
    pub work: u64,
}

impl Solution {
    /// Columns in a row.
    pub fn columns(&self) -> usize {
        self.layers.columns()
    }

    /// All columns of one element.
    pub fn of(&self, element: usize) -> &[f32] {
        let c = self.columns();
        &self.exitance[element * c..(element + 1) * c]
    }

    /// Sum over groups of one element.
    pub fn total(&self, element: usize) -> Rgb {
        crate::layers::total(self.of(element))
    }

    /// The same light with all groups in one.
    pub fn merged(&self) -> Solution {
        let merge = |rows: &[f32]| -> Vec<f32> {
            rows.chunks_exact(self.columns().max(BANDS))
                .flat_map(|row| crate::layers::total(row).to_array())
                .collect()
        };
        Solution {
            layers: self.layers.merged(),
            exitance: merge(&self.exitance),
            unshot: merge(&self.unshot),
            ..*self
        }
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.exitance.len() / self.columns().max(BANDS)
    }

    /// Whether it holds no element.
    pub fn is_empty(&self) -> bool {
        self.exitance.is_empty()
    }
}
