//! Jacobi: gather to all elements from the values of the sweep before.
//!
//! A step is one sweep, B' = E + rho (F B + F_out M_out): one more bounce of light. Starts from
//! B = E. What a sweep changed is exactly what has not been sent on yet.
//!
//! Source: [Cohen93], section 5.3.1.

use crate::contract::{Problem, Progress, Solver};
use crate::photometry::{gather, rho};
use crate::sweep::{Sweep, factors, reflected_outside};
use luxel_core::{ElementId, FrontChange, Solution};
use luxel_transport::FactorRow;
use rayon::prelude::*;

/// Jacobi iteration.
#[derive(Clone, Debug, Default)]
pub struct Jacobi {
    sweep: Sweep,
}

impl Jacobi {
    /// A solver at its start.
    pub fn new() -> Self {
        Jacobi::default()
    }

    /// Exitance of the present iterate, lm/m², element-major; empty before the first step.
    pub fn exitance(&self) -> &[f64] {
        &self.sweep.exitance
    }
}

impl Solver for Jacobi {
    fn step(&mut self, problem: &Problem<'_>) -> Progress {
        self.sweep.begin(problem);
        let columns = problem.columns();
        let (mut entries, mut from_outside) = (0, 0.0);
        if let Some(factors) = factors(problem) {
            let Sweep {
                exitance, change, ..
            } = &mut self.sweep;
            let old = &*exitance;
            let parts: Vec<(u64, f64)> = change
                .par_chunks_mut(columns)
                .enumerate()
                .map_init(
                    || (FactorRow::default(), vec![0.0; columns]),
                    |(row, incident), (i, change)| {
                        factors.row(ElementId::from(i), row);
                        gather(row, old, problem.outside, incident);
                        for (k, d) in change.iter_mut().enumerate() {
                            let at = i * columns + k;
                            *d = problem.emission[at] + rho(problem, i, k) * incident[k] - old[at];
                        }
                        (row.entries.len() as u64, reflected_outside(problem, i, row))
                    },
                )
                .collect();
            for (e, o) in parts {
                entries += e;
                from_outside += o;
            }
            for (b, d) in exitance.iter_mut().zip(change) {
                *b += *d;
            }
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
