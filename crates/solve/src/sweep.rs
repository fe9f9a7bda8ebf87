//! State of the solvers that sweep over all elements, and what they have in common.

use crate::contract::{Problem, Progress, Transport};
use crate::photometry::{
    F32_RESOLUTION, absolute_flux, relative_bound, rho, share, solution, weight, widened,
};
use luxel_core::{ElementId, FrontChange, Solution};
use luxel_transport::{FactorRow, FormFactors};
use rayon::prelude::*;

/// Rows computed at once; each is used as soon as the block is complete.
const BLOCK: usize = 256;

/// Exitance and what it changed by in the last sweep.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sweep {
    pub exitance: Vec<f64>,
    pub change: Vec<f64>,
    pub step: u32,
    pub work: u64,
    progress: Progress,
}

/// The factors of a problem for a deterministic solver.
///
/// Precondition of these solvers: the problem brings factors, not lines.
pub(crate) fn factors<'a>(problem: &Problem<'a>) -> Option<&'a dyn FormFactors> {
    match problem.transport {
        Transport::Factors(f) => Some(f),
        _ => {
            debug_assert!(false, "a deterministic solver needs form factors");
            None
        }
    }
}

/// Calls `use_row` with every row in the order of the elements. Rows are computed in parallel,
/// block by block, so that nothing but a block is held.
pub(crate) fn for_each_row(factors: &dyn FormFactors, mut use_row: impl FnMut(usize, &FactorRow)) {
    let n = factors.len();
    let mut rows = vec![FactorRow::default(); BLOCK.min(n)];
    for first in (0..n).step_by(BLOCK) {
        let count = BLOCK.min(n - first);
        rows[..count]
            .par_iter_mut()
            .enumerate()
            .for_each(|(k, row)| factors.row(ElementId::from(first + k), row));
        for (k, row) in rows[..count].iter().enumerate() {
            use_row(first + k, row);
        }
    }
}

impl Sweep {
    /// Starts from B = E, once.
    pub fn begin(&mut self, problem: &Problem<'_>) {
        if self.exitance.len() != problem.emission.len() {
            self.exitance = problem.emission.to_vec();
            self.change = problem.emission.to_vec();
        }
    }

    /// Closes a sweep that used `entries` factors; `from_outside` is the flux, lm, that entered
    /// and was reflected at once.
    pub fn end(&mut self, problem: &Problem<'_>, entries: u64, from_outside: f64) -> Progress {
        self.step += 1;
        self.work += entries;
        let columns = problem.columns();
        let emitted = absolute_flux(problem.area, problem.emission, columns) + from_outside;
        let unshot = absolute_flux(problem.area, &self.change, columns);
        let relative_error = relative_bound(problem, &self.exitance, &self.change);
        self.progress = Progress {
            step: self.step,
            unshot_share: share(unshot, emitted),
            relative_error,
            work: self.work,
            finished: relative_error < F32_RESOLUTION,
        };
        self.progress
    }

    pub fn solution(&self, problem: &Problem<'_>) -> Solution {
        if self.exitance.is_empty() {
            return solution(problem, problem.emission, problem.emission, 1.0, 0);
        }
        solution(
            problem,
            &self.exitance,
            &self.change,
            self.progress.unshot_share,
            self.work,
        )
    }

    /// A sweep starts from the residual of whatever it is given, so carrying over is all.
    pub fn restart(&mut self, change: &FrontChange, problem: &Problem<'_>) {
        let columns = problem.columns();
        self.exitance = carry(change, &self.exitance, columns);
        self.change = carry(change, &self.change, columns);
    }

    pub fn resume(&mut self, stored: &Solution, problem: &Problem<'_>) {
        if let Some(exitance) = widened(&stored.exitance, problem) {
            self.change = widened(&stored.unshot, problem).unwrap_or(vec![0.0; exitance.len()]);
            self.exitance = exitance;
            self.work = stored.work;
        }
    }
}

/// [`FrontChange::carry`] in `f64`.
pub(crate) fn carry(change: &FrontChange, old: &[f64], columns: usize) -> Vec<f64> {
    let count = change.offsets.len().saturating_sub(1);
    let mut new = vec![0.0; count * columns];
    for (e, row) in new.chunks_exact_mut(columns).enumerate() {
        let run = change.offsets[e] as usize..change.offsets[e + 1] as usize;
        for &(o, w) in &change.sources[run] {
            let from = old
                .get(o.index() * columns..(o.index() + 1) * columns)
                .unwrap_or(&[]);
            for (v, b) in row.iter_mut().zip(from) {
                *v += w as f64 * b;
            }
        }
    }
    new
}

/// Photometric flux, lm, that comes from outside onto element `i` and is reflected once.
pub(crate) fn reflected_outside(problem: &Problem<'_>, i: usize, row: &FactorRow) -> f64 {
    let per_area: f64 = problem
        .outside
        .iter()
        .enumerate()
        .map(|(k, o)| weight(k) * rho(problem, i, k) * o.abs())
        .sum();
    problem.area[i] * row.outside * per_area
}
