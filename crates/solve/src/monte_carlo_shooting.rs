//! Monte Carlo shooting: random lines from the elements that still hold unshot flux.
//!
//! While any element holds more unshot flux than the tolerance, all that do are shot: an
//! element spreads its unshot flux evenly over a number of lines in proportion to it, and what a
//! line strikes gains rho times its load, in exitance and in unshot. (Printed versions of the
//! loop have the test the other way round, and stop at once.)
//!
//! A step is one round or a few over the elements that are above the tolerance. When none is,
//! one run is complete; the next step begins another with lines of its own. Complete runs are averaged, and
//! their spread is the error. What stays below the tolerance in every run is a bias: at most the
//! tolerance times the number of elements, and reported as unshot.
//!
//! Sources: [Shirley91] (shooting with random lines), [Bekaert99], section 5.3.

use crate::contract::{Problem, Progress, Solver, Transport};
use crate::kinds::SolverSettings;
use crate::photometry::{
    F32_RESOLUTION, absolute, absolute_flux, has_outside, luminance, rho, share, solution,
    sum_over, widened,
};
use crate::sweep::carry;
use luxel_core::{ElementId, FrontChange, Solution};
use luxel_transport::sampling::hash;
use luxel_transport::{Arrival, LocalLines};
use rayon::prelude::*;

/// Elements of one task.
const CHUNK: usize = 256;

/// Monte Carlo shooting.
#[derive(Clone, Debug)]
pub struct MonteCarloShooting {
    settings: SolverSettings,
    /// The present run.
    exitance: Vec<f64>,
    unshot: Vec<f64>,
    begun: Begun,
    /// Number of casts so far; each has a seed of its own.
    casts: u32,
    /// Complete runs: how many, mean of their exitance, sum of squared photometric deviations.
    runs: u32,
    mean: Vec<f64>,
    spread: Vec<f64>,
    /// Unshot flux that the last complete run left, beside its exitance.
    bias: f64,
    /// Result of an earlier run of the program.
    stored: Option<Stored>,
    /// Flux, lm, that shares are shares of.
    emitted: f64,
    /// Tells the samples of this solver from those of an earlier one.
    stream: u32,
    progress: Progress,
}

/// A resumed result, which weighs as much as its lines.
#[derive(Clone, Debug)]
struct Stored {
    exitance: Vec<f64>,
    relative_error: f64,
    lines: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Begun {
    /// The next step begins a run.
    No,
    /// The next step finds the residual of carried exitance.
    Carried,
    /// A run is under way.
    Yes,
}

impl MonteCarloShooting {
    /// A solver at its start.
    pub fn new(settings: SolverSettings) -> Self {
        MonteCarloShooting {
            settings,
            exitance: Vec::new(),
            unshot: Vec::new(),
            begun: Begun::No,
            casts: 0,
            runs: 0,
            mean: Vec::new(),
            spread: Vec::new(),
            bias: 0.0,
            stored: None,
            emitted: 0.0,
            stream: 0,
            progress: Progress::default(),
        }
    }

    /// Complete runs.
    pub fn runs(&self) -> u32 {
        self.runs
    }

    /// Most unshot flux that an element may keep, lm.
    fn threshold(&self, problem: &Problem<'_>) -> f64 {
        self.settings.tolerance * self.emitted / problem.len().max(1) as f64
    }

    /// Lines that carry the whole emitted flux.
    fn lines(&self, problem: &Problem<'_>) -> f64 {
        match self.settings.lines_per_step {
            0 => (16 * problem.len()).clamp(1 << 15, 1 << 21) as f64,
            most => most as f64,
        }
    }

    /// Casts `count(i)` lines from each element. Returns where they arrived, in the order of the
    /// elements.
    fn cast(
        &mut self,
        problem: &Problem<'_>,
        local: &dyn LocalLines,
        count: impl Fn(usize) -> u32 + Sync,
    ) -> Vec<Vec<(u32, Vec<Arrival>)>> {
        let seed = hash([problem.seed, self.stream, self.casts, 0x5007]);
        self.casts += 1;
        let n = problem.len();
        let cast: Vec<Vec<(u32, Vec<Arrival>)>> = (0..n.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let mut list = Vec::new();
                for i in chunk * CHUNK..n.min((chunk + 1) * CHUNK) {
                    let lines = count(i);
                    if lines > 0 {
                        let mut arrivals = Vec::new();
                        local.cast(ElementId::from(i), 0..lines, seed, &mut arrivals);
                        list.push((i as u32, arrivals));
                    }
                }
                list
            })
            .collect();
        let lines: usize = cast.iter().flatten().map(|(_, a)| a.len()).sum();
        self.progress.work += lines as u64;
        cast
    }

    /// Incident flux per area that `sent` causes, shot from elements above `threshold` lm.
    fn shoot(
        &mut self,
        problem: &Problem<'_>,
        local: &dyn LocalLines,
        sent: &[f64],
        threshold: f64,
    ) -> Vec<f64> {
        let columns = problem.columns();
        let row = |i: usize| &sent[i * columns..(i + 1) * columns];
        let per_lm = share(self.lines(problem), self.emitted);
        let cast = self.cast(problem, local, |i| {
            let flux = problem.area[i] * absolute(row(i));
            if flux > threshold {
                power_of_two(flux * per_lm)
            } else {
                0
            }
        });
        let mut incident = vec![0.0; sent.len()];
        for (i, arrivals) in cast.iter().flatten() {
            let i = *i as usize;
            let load = problem.area[i] / arrivals.len() as f64;
            for j in arrivals.iter().filter_map(|a| a.element()) {
                let per_area = load / problem.area[j.index()];
                let to = &mut incident[j.index() * columns..(j.index() + 1) * columns];
                for (h, u) in to.iter_mut().zip(row(i)) {
                    *h += u * per_area;
                }
            }
        }
        incident
    }

    /// Incident flux per area from outside, by lines of the receivers.
    fn gather_outside(&mut self, problem: &Problem<'_>, local: &dyn LocalLines) -> Vec<f64> {
        let columns = problem.columns();
        let mut incident = vec![0.0; problem.emission.len()];
        if has_outside(problem) {
            let each = power_of_two(self.lines(problem) / problem.len().max(1) as f64).max(16);
            for (i, arrivals) in self.cast(problem, local, |_| each).iter().flatten() {
                let seen = arrivals.iter().filter(|a| **a == Arrival::OUTSIDE).count();
                let share = seen as f64 / arrivals.len().max(1) as f64;
                for (k, o) in problem.outside.iter().enumerate() {
                    incident[*i as usize * columns + k] = share * o;
                }
            }
        }
        incident
    }

    /// Starts a run from E and the first reflection of the outside.
    fn begin(&mut self, problem: &Problem<'_>, local: &dyn LocalLines) {
        let columns = problem.columns();
        let from_outside = self.gather_outside(problem, local);
        if self.begun == Begun::Carried {
            self.emitted = absolute_flux(problem.area, &self.exitance, columns);
            let sent = std::mem::take(&mut self.exitance);
            let inside = self.shoot(problem, local, &sent, 0.0);
            self.exitance = (0..sent.len())
                .map(|at| {
                    let incident = from_outside[at] + inside[at];
                    problem.emission[at] + rho(problem, at / columns, at % columns) * incident
                })
                .collect();
            self.unshot = self
                .exitance
                .iter()
                .zip(&sent)
                .map(|(new, old)| new - old)
                .collect();
        } else {
            self.exitance = (0..from_outside.len())
                .map(|at| {
                    let r = rho(problem, at / columns, at % columns);
                    problem.emission[at] + r * from_outside[at]
                })
                .collect();
            self.unshot = self.exitance.clone();
            self.emitted = absolute_flux(problem.area, &self.unshot, columns);
        }
        self.begun = Begun::Yes;
    }

    /// Shoots from every element above the tolerance once. Whether any is above it now.
    fn round(&mut self, problem: &Problem<'_>, local: &dyn LocalLines) -> bool {
        let columns = problem.columns();
        let threshold = self.threshold(problem);
        let mut sent = vec![0.0; self.unshot.len()];
        for (i, u) in self.unshot.chunks_exact_mut(columns).enumerate() {
            if problem.area[i] * absolute(u) > threshold {
                sent[i * columns..(i + 1) * columns].copy_from_slice(u);
                u.fill(0.0);
            }
        }
        let incident = self.shoot(problem, local, &sent, threshold);
        let mut above = false;
        for (i, u) in self.unshot.chunks_exact_mut(columns).enumerate() {
            for (k, u) in u.iter_mut().enumerate() {
                let at = i * columns + k;
                let gain = rho(problem, i, k) * incident[at];
                self.exitance[at] += gain;
                *u += gain;
            }
            above |= problem.area[i] * absolute(u) > threshold;
        }
        above
    }

    /// Takes the complete run into the mean [Welford62].
    fn complete(&mut self, problem: &Problem<'_>) {
        let columns = problem.columns();
        self.begun = Begun::No;
        self.runs += 1;
        if self.mean.len() != self.exitance.len() {
            self.mean = vec![0.0; self.exitance.len()];
            self.spread = vec![0.0; problem.len()];
        }
        for i in 0..problem.len() {
            let at = i * columns..(i + 1) * columns;
            let (new, mean) = (&self.exitance[at.clone()], &mut self.mean[at]);
            let before = luminance(new) - luminance(mean);
            for (m, b) in mean.iter_mut().zip(new) {
                *m += (b - *m) / self.runs as f64;
            }
            self.spread[i] += before * (luminance(new) - luminance(mean));
        }
    }

    /// Share of the stored result in what is shown.
    fn kept(&self) -> f64 {
        match &self.stored {
            Some(_) if self.runs == 0 => 1.0,
            Some(s) => share(s.lines, self.progress.work as f64),
            None => 0.0,
        }
    }

    /// Relative error of what is shown: of the new runs from their spread, beside the stored.
    fn error(&self, problem: &Problem<'_>) -> f64 {
        let runs = self.runs as f64;
        let new = if self.runs < 2 {
            // One run has no spread. Error falls with the square root of the lines.
            self.stored.as_ref().map_or(1.0, |s| {
                let lines = self.progress.work as f64 - s.lines;
                s.relative_error * (s.lines / lines.max(1.0)).sqrt()
            })
        } else {
            let sums = sum_over(problem.len(), 2, |i, sum| {
                let row = &self.mean[i * problem.columns()..][..problem.columns()];
                sum[0] += problem.area[i] * self.spread[i] / (runs * (runs - 1.0));
                sum[1] += problem.area[i] * luminance(row).powi(2);
            });
            share(sums[0], sums[1]).sqrt().hypot(self.bias)
        };
        let kept = self.kept();
        match &self.stored {
            Some(s) if self.runs > 0 => (kept * s.relative_error).hypot((1.0 - kept) * new),
            Some(s) => s.relative_error,
            None => new,
        }
    }

    fn shown(&self) -> Vec<f64> {
        match &self.stored {
            Some(s) if self.runs == 0 => s.exitance.clone(),
            Some(s) => {
                let kept = self.kept();
                self.mean
                    .iter()
                    .zip(&s.exitance)
                    .map(|(new, old)| new + kept * (old - new))
                    .collect()
            }
            None if self.runs > 0 => self.mean.clone(),
            None => self.exitance.clone(),
        }
    }
}

/// Nearest power of two, at least 1.
fn power_of_two(expected: f64) -> u32 {
    1 << (expected.max(1.0).log2().round() as u32).min(24)
}

impl Solver for MonteCarloShooting {
    fn step(&mut self, problem: &Problem<'_>) -> Progress {
        let Transport::Lines(local) = problem.transport else {
            debug_assert!(false, "Monte Carlo shooting needs lines");
            return Progress {
                finished: true,
                relative_error: 1.0,
                ..Progress::default()
            };
        };
        let columns = problem.columns();
        self.progress.step += 1;
        if self.begun != Begun::Yes {
            self.begin(problem, local);
        }
        let enough = self.progress.work + (self.lines(problem) / 8.0) as u64;
        // The loop goes on *while* any element is above the tolerance.
        loop {
            let above = self.round(problem, local);
            let left = absolute_flux(problem.area, &self.unshot, columns);
            self.progress.unshot_share = share(left, self.emitted);
            if !above {
                self.bias = share(left, absolute_flux(problem.area, &self.exitance, columns));
                self.complete(problem);
                break;
            }
            if self.progress.work >= enough {
                break;
            }
        }
        self.progress.relative_error = self.error(problem);
        self.progress.finished = self.progress.relative_error < F32_RESOLUTION;
        self.progress
    }

    fn solution(&self, problem: &Problem<'_>) -> Solution {
        let shown = self.shown();
        if shown.is_empty() {
            let mut start = solution(problem, problem.emission, problem.emission, 1.0, 0);
            start.relative_error = 1.0;
            return start;
        }
        let nothing = vec![0.0; shown.len()];
        let settled = self.runs > 0 || self.stored.is_some();
        let unshot = if settled { &nothing } else { &self.unshot };
        let p = &self.progress;
        let mut solution = solution(problem, &shown, unshot, p.unshot_share, p.work);
        solution.relative_error = p.relative_error as f32;
        solution
    }

    fn restart(&mut self, change: &FrontChange, problem: &Problem<'_>) {
        let shown = self.shown();
        if shown.is_empty() {
            return;
        }
        self.exitance = carry(change, &shown, problem.columns());
        self.unshot = vec![0.0; self.exitance.len()];
        (self.runs, self.stored) = (0, None);
        (self.mean, self.spread) = (Vec::new(), Vec::new());
        self.stream = hash([self.stream, self.progress.step, problem.len() as u32]);
        self.begun = Begun::Carried;
    }

    fn resume(&mut self, stored: &Solution, problem: &Problem<'_>) {
        let Some(exitance) = widened(&stored.exitance, problem) else {
            return;
        };
        *self = MonteCarloShooting::new(self.settings);
        self.stored = Some(Stored {
            exitance,
            relative_error: stored.relative_error as f64,
            lines: stored.work as f64,
        });
        self.stream = hash([stored.work as u32, (stored.work >> 32) as u32]);
        self.progress = Progress {
            relative_error: stored.relative_error as f64,
            unshot_share: stored.unshot_share as f64,
            work: stored.work,
            ..Progress::default()
        };
    }
}
