//! The ambient term: a guess of the light not yet sent on, for display only.
//!
//! What is unshot will be reflected again and again; if all surfaces saw each other equally,
//! the incident flux per area that it still brings would be
//! ambient = (sum A U / sum A) / (1 - rho_mean), with rho_mean = sum A rho / sum A,
//! in each column. Shown is B + rho ambient. It falls to 0 as the unshot flux does. Nothing
//! here can change a solution: it is only read.
//!
//! Source: [Cohen88], section 5.

use crate::contract::Problem;
use crate::photometry::rho;
use luxel_core::Solution;
use luxel_core::layers::BANDS;

/// A closed white room reflects for ever; its ambient term stops at this many times the unshot.
const MOST_BOUNCES: f64 = 1000.0;

/// Ambient incident flux per area of each column, lm/m², signed, from unshot exitance
/// (element-major, `columns` an element).
///
/// Source: [Cohen88].
pub fn from_unshot(problem: &Problem<'_>, unshot: impl Fn(usize) -> f64) -> Vec<f64> {
    let columns = problem.columns();
    let whole: f64 = problem.area.iter().sum();
    if whole <= 0.0 {
        return vec![0.0; columns];
    }
    let mut reflectance = [0.0; BANDS];
    let mut sum = vec![0.0; columns];
    for (i, area) in problem.area.iter().enumerate() {
        for (band, r) in reflectance.iter_mut().enumerate() {
            *r += area * rho(problem, i, band);
        }
        for (k, s) in sum.iter_mut().enumerate() {
            *s += area * unshot(i * columns + k);
        }
    }
    sum.iter()
        .enumerate()
        .map(|(k, s)| {
            let lost = 1.0 - reflectance[k % BANDS] / whole;
            s / whole / lost.max(1.0 / MOST_BOUNCES)
        })
        .collect()
}

/// Ambient incident flux per area of each column of a solution, lm/m², signed.
pub fn ambient(problem: &Problem<'_>, solution: &Solution) -> Vec<f32> {
    from_unshot(problem, |at| solution.unshot[at] as f64)
        .iter()
        .map(|v| *v as f32)
        .collect()
}

/// What to show: B + rho ambient, element-major, lm/m². Accuracy of f32.
pub fn displayed(problem: &Problem<'_>, solution: &Solution) -> Vec<f32> {
    let columns = problem.columns();
    let ambient = ambient(problem, solution);
    solution
        .exitance
        .iter()
        .enumerate()
        .map(|(at, b)| b + rho(problem, at / columns, at % columns) as f32 * ambient[at % columns])
        .collect()
}
