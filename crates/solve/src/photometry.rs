//! Small sums that all solvers share: photometric weights, flux, distance to the fixed point.

use crate::contract::Problem;
use luxel_core::layers::BANDS;
use luxel_core::quantity::LUMINANCE_WEIGHTS;
use luxel_core::{ElementId, Solution};
use luxel_transport::FactorRow;
use rayon::prelude::*;

/// Share of an error below which an `f32` cannot show it.
pub(crate) const F32_RESOLUTION: f64 = 1.0 / (1 << 24) as f64;

/// Photometric weight of a band.
#[inline]
pub(crate) fn weight(column: usize) -> f64 {
    LUMINANCE_WEIGHTS[column % BANDS] as f64
}

/// Photometric value of a row, all groups.
#[inline]
pub(crate) fn luminance(row: &[f64]) -> f64 {
    row.iter().enumerate().map(|(k, v)| weight(k) * v).sum()
}

/// Photometric value of a row, all groups, each column counted without its sign.
#[inline]
pub(crate) fn absolute(row: &[f64]) -> f64 {
    row.iter()
        .enumerate()
        .map(|(k, v)| weight(k) * v.abs())
        .sum()
}

/// Photometric reflectance of an element.
#[inline]
pub(crate) fn reflectance(problem: &Problem<'_>, element: usize) -> f64 {
    luminance(&problem.reflectance[BANDS * element..BANDS * (element + 1)])
}

/// Elements of one partial sum. Independent of the thread count, or bits would depend on it.
const SUM_CHUNK: usize = 4096;

/// Sum of `terms` numbers over `n` elements, in parallel, in one order.
pub(crate) fn sum_over(n: usize, terms: usize, add: impl Fn(usize, &mut [f64]) + Sync) -> Vec<f64> {
    let parts: Vec<Vec<f64>> = (0..n.div_ceil(SUM_CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut sum = vec![0.0; terms];
            for i in chunk * SUM_CHUNK..n.min((chunk + 1) * SUM_CHUNK) {
                add(i, &mut sum);
            }
            sum
        })
        .collect();
    let mut whole = vec![0.0; terms];
    for part in &parts {
        for (w, p) in whole.iter_mut().zip(part) {
            *w += p;
        }
    }
    whole
}

/// Flux of exitance, lm: sum of A times the photometric absolute value.
pub(crate) fn absolute_flux(area: &[f64], exitance: &[f64], columns: usize) -> f64 {
    area.iter()
        .zip(exitance.chunks_exact(columns))
        .map(|(a, row)| a * absolute(row))
        .sum()
}

/// Reflectance of element `i` in a column.
#[inline]
pub(crate) fn rho(problem: &Problem<'_>, i: usize, column: usize) -> f64 {
    problem.reflectance[BANDS * i + column % BANDS]
}

/// Whether any light enters from outside.
pub(crate) fn has_outside(problem: &Problem<'_>) -> bool {
    problem.outside.iter().any(|v| *v != 0.0)
}

/// Incident flux per area of the element whose row this is: H_i = sum_j F_ij B_j + F_i,out M_out.
#[inline]
pub(crate) fn gather(row: &FactorRow, exitance: &[f64], outside: &[f64], incident: &mut [f64]) {
    let columns = incident.len();
    for (h, o) in incident.iter_mut().zip(outside) {
        *h = row.outside * o;
    }
    for &(ElementId(j), f) in &row.entries {
        let b = &exitance[j as usize * columns..][..columns];
        for (h, b) in incident.iter_mut().zip(b) {
            *h += f * b;
        }
    }
}

/// Distance to the fixed point when `change` is what has not been sent on yet.
///
/// In the norm sqrt(sum A x²) the operator rho F is at most rho_max, since F is symmetric
/// there and its rows sum to at most 1. With E + rho F B - B = rho F U, or smaller by entries,
/// the error is at most rho_max |U| / (1 - rho_max). Relative to the exitance, photometric;
/// columns are added up as if their errors had the same sign.
pub(crate) fn relative_bound(problem: &Problem<'_>, exitance: &[f64], change: &[f64]) -> f64 {
    let columns = problem.columns();
    let mut largest = [0.0f64; BANDS];
    for row in problem.reflectance.chunks_exact(BANDS) {
        for band in 0..BANDS {
            largest[band] = largest[band].max(row[band]);
        }
    }
    let mut squares = vec![0.0; columns];
    let mut whole = 0.0;
    for (i, area) in problem.area.iter().enumerate() {
        let at = i * columns..(i + 1) * columns;
        for (s, u) in squares.iter_mut().zip(&change[at.clone()]) {
            *s += area * u * u;
        }
        let b = luminance(&exitance[at]);
        whole += area * b * b;
    }
    let error: f64 = squares
        .iter()
        .enumerate()
        .map(|(k, s)| {
            // A band that loses nothing has no bound; one lost in a thousand stands for it.
            let r = largest[k % BANDS].min(0.999);
            weight(k) * s.sqrt() * r / (1.0 - r)
        })
        .sum();
    if whole > 0.0 {
        error / whole.sqrt()
    } else if error > 0.0 {
        1.0
    } else {
        0.0
    }
}

/// A ratio that is 0 when there is nothing to compare with.
#[inline]
pub(crate) fn share(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 0.0 }
}

/// The solution record of `f64` state.
pub(crate) fn solution(
    problem: &Problem<'_>,
    exitance: &[f64],
    unshot: &[f64],
    unshot_share: f64,
    work: u64,
) -> Solution {
    Solution {
        layers: problem.layers.clone(),
        exitance: exitance.iter().map(|v| *v as f32).collect(),
        unshot: unshot.iter().map(|v| *v as f32).collect(),
        relative_error: 0.0,
        unshot_share: unshot_share as f32,
        work,
    }
}

/// Stored values as `f64`, or nothing if they are of another shape.
pub(crate) fn widened(stored: &[f32], problem: &Problem<'_>) -> Option<Vec<f64>> {
    (stored.len() == problem.len() * problem.columns())
        .then(|| stored.iter().map(|v| *v as f64).collect())
}
