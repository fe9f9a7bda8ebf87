//! Gauss-Seidel: gather to one element after the other, using new values at once.
//!
//! A step is one sweep in the order of the elements:
//! B_i <- E_i + rho_i (sum_j F_ij B_j + F_i,out M_out), with B_j new for j < i. Starts from
//! B = E. Rows of factors are computed in parallel; the gathering order is that of one thread.
//!
//! Source: [Cohen93], section 5.3.1.

use crate::contract::{Problem, Progress, Solver};
use crate::photometry::{gather, rho};
use crate::sweep::{Sweep, factors, for_each_row, reflected_outside};
use luxel_core::{FrontChange, Solution};

/// Gauss-Seidel iteration. Unshot is what the last sweep changed.
#[derive(Clone, Debug, Default)]
pub struct GaussSeidel {
    sweep: Sweep,
}

impl GaussSeidel {
    /// A solver at its start.
    pub fn new() -> Self {
        GaussSeidel::default()
    }

    /// Exitance of the present iterate, lm/m², element-major; empty before the first step.
    pub fn exitance(&self) -> &[f64] {
        &self.sweep.exitance
    }
}

impl Solver for GaussSeidel {
    fn step(&mut self, problem: &Problem<'_>) -> Progress {
        self.sweep.begin(problem);
        let columns = problem.columns();
        let mut incident = vec![0.0; columns];
        let (mut entries, mut from_outside) = (0, 0.0);
        if let Some(factors) = factors(problem) {
            let Sweep {
                exitance, change, ..
            } = &mut self.sweep;
            for_each_row(factors, |i, row| {
                gather(row, exitance, problem.outside, &mut incident);
                for k in 0..columns {
                    let at = i * columns + k;
                    let new = problem.emission[at] + rho(problem, i, k) * incident[k];
                    change[at] = new - exitance[at];
                    exitance[at] = new;
                }
                entries += row.entries.len() as u64;
                from_outside += reflected_outside(problem, i, row);
            });
        }
        self.sweep.end(problem, entries, from_outside)
    }

    fn solution(&self, problem: &Problem<'_>) -> Solution {
        self.sweep.solution(problem)
    }

    fn restart(&mut self, change: &FrontChange, problem: &Problem<'_>) {
        self.sweep.restart(change, problem);
    }

    fn resume(&mut self, stored: &Solution, problem: &Problem<'_>) {
        self.sweep.resume(stored, problem);
    }
}
