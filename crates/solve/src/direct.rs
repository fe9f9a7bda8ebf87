//! Direct: dense LU of I - rho F, one factorisation a band, all groups at once.
//!
//! The reference for all other solvers: O(n³) time, 8 n² bytes while it runs. Bands whose
//! reflectances are the same share a factorisation. One step solves everything.
//!
//! One thread, since a blocked product that is split over threads may add up in another order.
//!
//! Source: [Golub13], section 3.4 (partial pivoting).

use crate::contract::{Problem, Progress, Solver};
use crate::photometry::{gather, rho, share, solution, weight, widened};
use crate::sweep::{carry, factors, for_each_row};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::lu::partial_pivoting::{factor, solve as solve_lu};
use faer::{Mat, Par};
use luxel_core::layers::BANDS;
use luxel_core::{FrontChange, Solution};

/// Dense LU.
#[derive(Clone, Debug, Default)]
pub struct Direct {
    exitance: Vec<f64>,
    residual: Vec<f64>,
    progress: Progress,
}

impl Direct {
    /// Most elements it accepts: 1.2 GB of matrix.
    pub const MOST_ELEMENTS: usize = 12_000;

    /// A solver at its start.
    pub fn new() -> Self {
        Direct::default()
    }

    /// Whether a front of `elements` is small enough. Check it before the first step.
    pub fn fits(elements: usize) -> bool {
        elements <= Direct::MOST_ELEMENTS
    }

    /// Exitance, lm/m², element-major; empty before the step.
    pub fn exitance(&self) -> &[f64] {
        &self.exitance
    }

    /// E + rho (F B + F_out M_out) - B of the result, element-major, lm/m².
    pub fn residual(&self) -> &[f64] {
        &self.residual
    }
}

/// Replaces `right` by the solution and `matrix` by its factors, in one thread.
fn solve_in_place(matrix: &mut Mat<f64>, right: &mut Mat<f64>) {
    let (n, columns) = (matrix.nrows(), right.ncols());
    let (mut forward, mut backward) = (vec![0usize; n], vec![0usize; n]);
    let need = factor::lu_in_place_scratch::<usize, f64>(n, n, Par::Seq, Default::default());
    let mut memory = MemBuffer::new(need);
    let (_, permutation) = factor::lu_in_place(
        matrix.as_mut(),
        &mut forward,
        &mut backward,
        Par::Seq,
        MemStack::new(&mut memory),
        Default::default(),
    );
    let need = solve_lu::solve_in_place_scratch::<usize, f64>(n, columns, Par::Seq);
    let mut memory = MemBuffer::new(need);
    // Both factors lie in one matrix: each triangular solve reads its own half.
    solve_lu::solve_in_place(
        matrix.as_ref(),
        matrix.as_ref(),
        permutation,
        right.as_mut(),
        Par::Seq,
        MemStack::new(&mut memory),
    );
}

impl Solver for Direct {
    /// Solves. A front that does not fit ([`Direct::fits`]) is left at B = E, with an error of
    /// 1 and `finished`, since more steps would not help.
    fn step(&mut self, problem: &Problem<'_>) -> Progress {
        let (n, columns) = (problem.len(), problem.columns());
        self.progress.step += 1;
        self.exitance = problem.emission.to_vec();
        self.residual = vec![0.0; n * columns];
        let factors = factors(problem).filter(|_| Direct::fits(n));
        let Some(factors) = factors else {
            let step = self.progress.step;
            self.progress = Progress {
                step,
                unshot_share: 1.0,
                relative_error: 1.0,
                work: 0,
                finished: true,
            };
            return self.progress;
        };

        let mut done = [false; BANDS];
        for band in 0..BANDS {
            if done[band] {
                continue;
            }
            let alike: Vec<usize> = (band..BANDS)
                .filter(|&b| (0..n).all(|i| rho(problem, i, b) == rho(problem, i, band)))
                .collect();
            let of: Vec<usize> = (0..columns)
                .filter(|k| alike.contains(&(k % BANDS)))
                .collect();
            let mut matrix = Mat::<f64>::identity(n, n);
            let mut right = Mat::<f64>::zeros(n, of.len());
            for_each_row(factors, |i, row| {
                for &(j, f) in &row.entries {
                    matrix[(i, j.index())] -= rho(problem, i, band) * f;
                }
                for (c, &k) in of.iter().enumerate() {
                    let entering = rho(problem, i, band) * row.outside * problem.outside[k];
                    right[(i, c)] = problem.emission[i * columns + k] + entering;
                }
                self.progress.work += row.entries.len() as u64;
            });
            solve_in_place(&mut matrix, &mut right);
            for (c, &k) in of.iter().enumerate() {
                for i in 0..n {
                    self.exitance[i * columns + k] = right[(i, c)];
                }
            }
            for b in alike {
                done[b] = true;
            }
        }

        let mut incident = vec![0.0; columns];
        let (mut left, mut emitted) = (0.0, 0.0);
        for_each_row(factors, |i, row| {
            gather(row, &self.exitance, problem.outside, &mut incident);
            for k in 0..columns {
                let at = i * columns + k;
                let new = problem.emission[at] + rho(problem, i, k) * incident[k];
                self.residual[at] = new - self.exitance[at];
                left += problem.area[i] * weight(k) * self.residual[at].abs();
                emitted += problem.area[i] * weight(k) * self.exitance[at].abs();
            }
        });
        self.progress.unshot_share = share(left, emitted);
        self.progress.relative_error = self.progress.unshot_share;
        self.progress.finished = true;
        self.progress
    }

    fn solution(&self, problem: &Problem<'_>) -> Solution {
        if self.exitance.is_empty() {
            return solution(problem, problem.emission, problem.emission, 1.0, 0);
        }
        let p = &self.progress;
        let mut solution = solution(
            problem,
            &self.exitance,
            &self.residual,
            p.unshot_share,
            p.work,
        );
        solution.relative_error = p.relative_error as f32;
        solution
    }

    /// Carries the exitance for display; the next step solves anew.
    fn restart(&mut self, change: &FrontChange, problem: &Problem<'_>) {
        self.exitance = carry(change, &self.exitance, problem.columns());
        self.residual = carry(change, &self.residual, problem.columns());
        self.progress.finished = false;
    }

    fn resume(&mut self, stored: &Solution, problem: &Problem<'_>) {
        if let Some(exitance) = widened(&stored.exitance, problem) {
            self.residual = vec![0.0; exitance.len()];
            self.exitance = exitance;
        }
    }
}
