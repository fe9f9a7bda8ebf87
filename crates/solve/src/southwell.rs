//! Southwell's order, known as progressive refinement: shoot from the element with the most
//! unshot flux.
//!
//! A shot from i takes row i of the factors; the column follows by reciprocity,
//! F_ji = F_ij A_i / A_j, and every j that is seen gains rho_j F_ji U_i, in exitance and in
//! unshot. So a picture is worth showing after every step, where Gauss-Seidel needs a sweep.
//! The invariant is B = E + rho F (B - U).
//!
//! Source: [Cohen88], sections 3 and 4. Differs: unshot is signed, so the largest absolute
//! value is shot, and light from outside joins the emission at the start.

use crate::ambient::from_unshot;
use crate::contract::{Problem, Progress, Solver};
use crate::kinds::SolverSettings;
use crate::photometry::{
    F32_RESOLUTION, absolute, absolute_flux, gather, has_outside, relative_bound, rho, share,
    solution, widened,
};
use crate::sweep::{carry, factors, for_each_row};
use luxel_core::{ElementId, FrontChange, Solution};
use luxel_transport::FactorRow;

/// Progressive refinement.
#[derive(Clone, Debug)]
pub struct Southwell {
    shots_per_step: u32,
    exitance: Vec<f64>,
    unshot: Vec<f64>,
    row: FactorRow,
    last_shot: ElementId,
    progress: Progress,
    /// Flux, lm, that the unshot share is a share of.
    emitted: f64,
    /// Carried exitance waits for its residual.
    residual_due: bool,
    work: u64,
}

impl Southwell {
    /// A solver at its start.
    pub fn new(settings: SolverSettings) -> Self {
        Southwell {
            shots_per_step: settings.shots_per_step.max(1),
            exitance: Vec::new(),
            unshot: Vec::new(),
            row: FactorRow::default(),
            last_shot: ElementId::NONE,
            progress: Progress::default(),
            emitted: 0.0,
            residual_due: false,
            work: 0,
        }
    }

    /// Exitance now, lm/m², element-major; empty before the first step.
    pub fn exitance(&self) -> &[f64] {
        &self.exitance
    }

    /// Unshot exitance now, lm/m², element-major, signed; empty before the first step.
    pub fn unshot(&self) -> &[f64] {
        &self.unshot
    }

    /// Element of the last shot; [`ElementId::NONE`] before the first.
    pub fn last_shot(&self) -> ElementId {
        self.last_shot
    }

    /// Ambient incident flux per area, one a column, lm/m²; for display only.
    pub fn ambient(&self, problem: &Problem<'_>) -> Vec<f64> {
        from_unshot(problem, |at| self.unshot.get(at).copied().unwrap_or(0.0))
    }

    fn begin(&mut self, problem: &Problem<'_>) {
        let fresh = self.exitance.len() != problem.emission.len();
        if !fresh && !self.residual_due {
            return;
        }
        let Some(factors) = factors(problem) else {
            return;
        };
        let columns = problem.columns();
        let mut incident = vec![0.0; columns];
        let mut entries = 0;
        if fresh {
            // B = U = E + rho F_out M_out.
            self.exitance = problem.emission.to_vec();
            if has_outside(problem) {
                for_each_row(factors, |i, row| {
                    for (k, o) in problem.outside.iter().enumerate() {
                        self.exitance[i * columns + k] += rho(problem, i, k) * row.outside * o;
                    }
                    entries += row.entries.len() as u64;
                });
            }
            self.unshot = self.exitance.clone();
            self.emitted = absolute_flux(problem.area, &self.unshot, columns);
        } else {
            // U = R = E + rho F B - B, and B + R is what has been seen now.
            let mut new = vec![0.0; problem.emission.len()];
            self.emitted = absolute_flux(problem.area, problem.emission, columns);
            for_each_row(factors, |i, row| {
                gather(row, &self.exitance, problem.outside, &mut incident);
                for k in 0..columns {
                    let at = i * columns + k;
                    new[at] = problem.emission[at] + rho(problem, i, k) * incident[k];
                }
                entries += row.entries.len() as u64;
                self.emitted += crate::sweep::reflected_outside(problem, i, row);
            });
            self.unshot = new.iter().zip(&self.exitance).map(|(n, b)| n - b).collect();
            self.exitance = new;
        }
        self.residual_due = false;
        self.work += entries;
    }

    fn shoot(&mut self, problem: &Problem<'_>) {
        let Some(factors) = factors(problem) else {
            return;
        };
        let columns = problem.columns();
        // Compare absolute unshot flux: refinement leaves elements that must give light back.
        let mut best = (0.0, None);
        for (i, u) in self.unshot.chunks_exact(columns).enumerate() {
            let flux = problem.area[i] * absolute(u) * problem.importance_of(i);
            if flux > best.0 {
                best = (flux, Some(i));
            }
        }
        let Some(i) = best.1 else { return };
        self.last_shot = ElementId::from(i);
        let mut row = std::mem::take(&mut self.row);
        factors.row(self.last_shot, &mut row);
        let sent: Vec<f64> = self.unshot[i * columns..(i + 1) * columns].to_vec();
        self.unshot[i * columns..(i + 1) * columns].fill(0.0);
        for &(ElementId(j), f) in &row.entries {
            let j = j as usize;
            let back = f * problem.area[i] / problem.area[j];
            for (k, u) in sent.iter().enumerate() {
                let gain = rho(problem, j, k) * back * u;
                self.exitance[j * columns + k] += gain;
                self.unshot[j * columns + k] += gain;
            }
        }
        self.work += row.entries.len() as u64;
        self.row = row;
    }
}

impl Solver for Southwell {
    fn step(&mut self, problem: &Problem<'_>) -> Progress {
        self.begin(problem);
        for _ in 0..self.shots_per_step {
            self.shoot(problem);
        }
        let unshot = absolute_flux(problem.area, &self.unshot, problem.columns());
        let relative_error = relative_bound(problem, &self.exitance, &self.unshot);
        self.progress = Progress {
            step: self.progress.step + 1,
            unshot_share: share(unshot, self.emitted),
            relative_error,
            work: self.work,
            finished: relative_error < F32_RESOLUTION,
        };
        self.progress
    }

    fn solution(&self, problem: &Problem<'_>) -> Solution {
        if self.exitance.is_empty() {
            return solution(problem, problem.emission, problem.emission, 1.0, 0);
        }
        let share = self.progress.unshot_share;
        solution(problem, &self.exitance, &self.unshot, share, self.work)
    }

    fn restart(&mut self, change: &FrontChange, problem: &Problem<'_>) {
        if self.exitance.is_empty() {
            return;
        }
        self.exitance = carry(change, &self.exitance, problem.columns());
        self.unshot = carry(change, &self.unshot, problem.columns());
        self.residual_due = true;
    }

    fn resume(&mut self, stored: &Solution, problem: &Problem<'_>) {
        let columns = problem.columns();
        let state = (
            widened(&stored.exitance, problem),
            widened(&stored.unshot, problem),
        );
        if let (Some(exitance), Some(unshot)) = state {
            self.work = stored.work;
            self.emitted = share(
                absolute_flux(problem.area, &unshot, columns),
                stored.unshot_share as f64,
            );
            (self.exitance, self.unshot) = (exitance, unshot);
            self.progress = Progress {
                unshot_share: stored.unshot_share as f64,
                ..Progress::default()
            };
        }
    }
}
