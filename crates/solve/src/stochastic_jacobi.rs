//! Stochastic Jacobi with low-discrepancy local lines: the default.
//!
//! Jacobi iteration in which each product F B is an estimate from fresh random lines, so form
//! factors are sampled and never stored, and one line carries all columns. Two phases:
//!
//! 1. *Shooting*: passes of the unshot exitance alone, U <- rho F U, which shows a picture after
//!    the first pass and has all bounces after a few, with lines in proportion to what is left.
//! 2. *Regular* passes of all power, B' = E + rho F B. Each is an estimate of the fixed point
//!    of its own; their incident fluxes are averaged with the number of lines as weights.
//!
//! Two chains with random numbers of their own run side by side and never see each other. The
//! solution is their mean, and half their difference is its error: that stays honest where
//! passes of one chain depend on each other (each starts from the last one).
//!
//! A step is one pass of each chain. Passes grow, so that something can be shown early, and
//! stay bounded. How a pass works: `line_pass.rs`.
//!
//! Memory: 28 bytes an element and column, 32 bytes an element, 16 bytes a line of one pass.
//!
//! Sources: [Neumann95] (stochastic iteration for radiosity), [Bekaert99], chapter 6.

use crate::contract::{Problem, Progress, Solver, Transport};
use crate::kinds::SolverSettings;
use crate::line_pass::{Level, LinePlan, Sent};
use crate::photometry::{F32_RESOLUTION, absolute_flux, reflectance, rho, share, sum_over, weight};
use luxel_core::{FrontChange, Solution};
use luxel_transport::LocalLines;
use luxel_transport::sampling::hash;
use rayon::prelude::*;

/// Shooting ends when the light still to come is this share of what is there. The geometric
/// series of the last shot stands for it in the first regular pass, and each pass shrinks what
/// that is wrong by.
const STILL_TO_COME: f64 = 0.01;

/// Share of the foretold light that the geometric series may have put in the wrong places, where
/// a sum over all elements does not find it.
const MISPLACED: f64 = 0.1;

/// Old passes are forgotten by halves while the light that they lacked is more than this share
/// of the noise.
const BIAS_TO_NOISE: f64 = 0.25;

/// Lines an element from which a shot is told what the last one brought.
const LEVEL_LINES: u64 = 4;

/// Shooting ends after this many passes in any case. Closed white rooms come here.
const MOST_SHOTS: u32 = 64;

/// Stochastic Jacobi iteration.
#[derive(Clone, Debug)]
pub struct StochasticJacobi {
    lines_per_step: u32,
    chains: [Chain; 2],
    /// Result of an earlier run, averaged with the new passes.
    stored: Option<Stored>,
    /// Mean of the chains and of the stored result; empty before the first step.
    exitance: Vec<f32>,
    progress: Progress,
}

#[derive(Clone, Debug)]
struct Stored {
    exitance: Vec<f32>,
    relative_error: f64,
    lines: f64,
}

/// What the next pass of a chain does.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Nothing is known yet.
    Fresh,
    /// A carried solution was put in; find its residual.
    Residual,
    /// Sends unshot exitance; so many passes were made.
    Shooting(u32),
    /// Sends all; so many passes were made.
    Regular(u32),
}

/// One independent run.
#[derive(Clone, Debug)]
struct Chain {
    phase: Phase,
    /// Told apart from other chains and earlier runs.
    stream: u32,
    /// What the next pass sends: unshot exitance while shooting, then all of it.
    sent: Vec<f32>,
    /// Incident flux per area, lm/m²: sum over the shots, then mean of the regular passes.
    incident: Vec<f32>,
    /// Result of the last pass, or empty.
    fresh: Vec<f32>,
    /// Lines that `incident` is a mean of; 0 while shooting.
    lines: f64,
    /// Absolute unshot flux as a share of the emitted flux.
    unshot_share: f64,
    /// Bounces that are missing now, as a share of the RMS exitance if they fall evenly: foretold
    /// from the shots.
    to_come: f64,
    /// The same, mean over the passes in `incident`.
    foretold: f64,
    /// Flux by which regular passes found more than was sent, lm, mean over the same passes.
    found: f64,
    /// What the result lacks by that, as a share of the RMS exitance.
    missing: f64,
    /// The same with what may be in the wrong places.
    bias: f64,
    /// By how much a bounce shrinks the flux.
    decay: f64,
    plan: LinePlan,
}

impl Chain {
    fn new(stream: u32) -> Self {
        Chain {
            phase: Phase::Fresh,
            stream,
            sent: Vec::new(),
            incident: Vec::new(),
            fresh: Vec::new(),
            lines: 0.0,
            unshot_share: 1.0,
            to_come: 1.0,
            foretold: 1.0,
            found: 0.0,
            missing: 1.0,
            bias: 1.0,
            decay: 1.0,
            plan: LinePlan::default(),
        }
    }

    /// Exitance as this chain knows it: E + rho H.
    #[inline]
    fn exitance(&self, problem: &Problem<'_>, i: usize, k: usize) -> f64 {
        let at = i * problem.columns() + k;
        let incident = self.incident.get(at).map_or(0.0, |h| *h as f64);
        problem.emission[at] + rho(problem, i, k) * incident
    }

    /// Lines of the next pass when a full one has `lines`.
    fn load(&self, lines: u64, elements: u64, cap: u64) -> u64 {
        match self.phase {
            Phase::Fresh | Phase::Residual => lines,
            // A shot of little flux may be rough.
            Phase::Shooting(_) => {
                let left = (lines as f64 * self.unshot_share.clamp(0.0, 1.0)) as u64;
                left.max(lines / 4).max(elements / 2)
            }
            Phase::Regular(passes) => (lines << (passes / 2).min(20)).min(cap),
        }
    }

    fn pass(&mut self, problem: &Problem<'_>, local: &dyn LocalLines, lines: u64) -> u64 {
        let columns = problem.columns();
        let size = problem.len() * columns;
        let nothing = vec![0.0; columns];
        let outside: Vec<f32> = problem.outside.iter().map(|v| *v as f32).collect();
        if self.phase == Phase::Fresh {
            self.sent = problem.emission.iter().map(|v| *v as f32).collect();
            self.incident = vec![0.0; size];
        }

        // Shots are measured without their sign, a whole solution with it.
        let measure: fn(f32) -> f64 = match self.phase {
            Phase::Regular(_) => f64::from,
            _ => unsigned,
        };
        let flux_before = flux(problem, &self.sent, measure);
        let count = match self.phase {
            Phase::Fresh | Phase::Residual => 0,
            Phase::Shooting(n) | Phase::Regular(n) => n,
        };
        let seed = hash([problem.seed, self.stream, self.phase.tag(), count]);
        // A shot is expected to bring what the last one brought, less the loss of a bounce. All
        // levels are local, so a room that no light reaches stays exactly dark. With few lines an
        // element the last shot is mostly noise, which each further shot would hand on and add to.
        let told = lines >= LEVEL_LINES * problem.len() as u64;
        let expected: Vec<f32> = match self.phase {
            Phase::Shooting(_) if told && self.fresh.len() == size => {
                self.fresh.iter().map(|h| h * self.decay as f32).collect()
            }
            _ => nothing.clone(),
        };
        let sent = Sent {
            exitance: &self.sent,
            // The sky shines once while shooting.
            outside: if matches!(self.phase, Phase::Shooting(_)) {
                &nothing
            } else {
                &outside
            },
            level: match self.phase {
                Phase::Residual | Phase::Regular(_) => Level::Incident(&self.incident),
                Phase::Shooting(_) if expected.len() == size => Level::Incident(&expected),
                Phase::Fresh | Phase::Shooting(_) => Level::Everywhere(&nothing),
            },
        };
        self.plan
            .distribute(problem, &sent, lines, hash([seed, self.phase.tag(), count]));
        let mut fresh = std::mem::take(&mut self.fresh);
        let cast = self.plan.cast(problem, local, &sent, seed, &mut fresh);
        self.fresh = fresh;

        match self.phase {
            Phase::Fresh | Phase::Shooting(_) => {
                for (h, new) in self.incident.iter_mut().zip(&self.fresh) {
                    *h += new;
                }
                let fresh = &self.fresh;
                fill(&mut self.sent, columns, |at, i, k| {
                    rho(problem, i, k) * fresh[at] as f64
                });
                self.after_shot(problem, flux_before, count + 1);
            }
            Phase::Residual => {
                // R = E + rho F B - B, signed: a darkened place owes light.
                self.incident = std::mem::take(&mut self.fresh);
                let before = std::mem::take(&mut self.sent);
                self.sent = vec![0.0; size];
                let incident = &self.incident;
                fill(&mut self.sent, columns, |at, i, k| {
                    let new = problem.emission[at] + rho(problem, i, k) * incident[at] as f64;
                    new - before[at] as f64
                });
                self.after_shot(problem, flux_before, 0);
            }
            Phase::Regular(passes) => {
                self.lines += cast as f64;
                let gain = cast as f64 / self.lines.max(1.0);
                self.to_come *= self.decay;
                self.unshot_share *= self.decay;
                self.foretold += (self.to_come - self.foretold) * gain;
                self.incident
                    .par_iter_mut()
                    .zip(&self.fresh)
                    .for_each(|(h, new)| *h += (new - *h) * gain as f32);
                let fresh = &self.fresh;
                fill(&mut self.sent, columns, |at, i, k| {
                    problem.emission[at] + rho(problem, i, k) * fresh[at] as f64
                });
                // If B is sent and B' found, (B' - B) d / (1 - d) is still to come to B'.
                let net = flux(problem, &self.sent, measure) - flux_before;
                self.found += (net - self.found) * gain;
                let missing = self.found.abs() * self.series();
                self.missing = share(missing, self.rms_flux(problem));
                self.bias = self.missing.max(MISPLACED * self.foretold);
                self.phase = Phase::Regular(passes + 1);
            }
        }
        cast
    }

    /// Decides whether shooting goes on. `before` is the flux, lm, that the pass has sent.
    fn after_shot(&mut self, problem: &Problem<'_>, before: f64, passes: u32) {
        let columns = problem.columns();
        let unshot = flux(problem, &self.sent, unsigned);
        let emitted = absolute_flux(problem.area, problem.emission, columns);
        // Without emission of its own the scene emits what the sky gave first.
        let emitted = if emitted > 0.0 {
            emitted
        } else {
            unshot.max(before)
        };
        if passes > 0 {
            let most = problem.reflectance.iter().copied().fold(0.0, f64::max);
            self.decay = share(unshot, before).min(most);
        }
        self.unshot_share = share(unshot, emitted);
        // The geometric series of bounces, spread evenly, beside the RMS exitance.
        self.to_come = share(unshot * self.series(), self.rms_flux(problem));
        (self.foretold, self.bias) = (self.to_come, self.to_come);
        self.phase = Phase::Shooting(passes);
        let done = passes > 0 && self.to_come < STILL_TO_COME;
        if done || passes >= MOST_SHOTS || unshot == 0.0 {
            self.begin_regular(problem);
        }
    }

    /// What all further bounces bring, as a multiple of what the next one is sent.
    fn series(&self) -> f64 {
        self.decay / (1.0 - self.decay).max(1e-6)
    }

    /// Flux of the RMS exitance over all elements, lm.
    fn rms_flux(&self, problem: &Problem<'_>) -> f64 {
        let columns = problem.columns();
        let sums = sum_over(problem.len(), 2, |i, sum| {
            let b: f64 = (0..columns)
                .map(|k| weight(k) * self.exitance(problem, i, k))
                .sum();
            sum[0] += problem.area[i];
            sum[1] += problem.area[i] * b * b;
        });
        (sums[0] * sums[1]).sqrt()
    }

    fn begin_regular(&mut self, problem: &Problem<'_>) {
        self.phase = Phase::Regular(0);
        (self.lines, self.found) = (0.0, 0.0);
        let columns = problem.columns();
        let still = self.series();
        let (incident, last) = (&self.incident, &self.fresh);
        fill(&mut self.sent, columns, |at, i, k| {
            let to_come = last.get(at).map_or(0.0, |h| still * *h as f64);
            problem.emission[at] + rho(problem, i, k) * (incident[at] as f64 + to_come)
        });
    }
}

impl Phase {
    fn tag(self) -> u32 {
        match self {
            Phase::Fresh => 0,
            Phase::Residual => 1,
            Phase::Shooting(_) => 2,
            Phase::Regular(_) => 3,
        }
    }
}

/// Sets every value of a row-major array from its place, element and column.
fn fill(values: &mut [f32], columns: usize, value: impl Fn(usize, usize, usize) -> f64 + Sync) {
    values
        .par_chunks_mut(columns)
        .enumerate()
        .for_each(|(i, row)| {
            for (k, v) in row.iter_mut().enumerate() {
                *v = value(i * columns + k, i, k) as f32;
            }
        });
}

fn unsigned(exitance: f32) -> f64 {
    exitance.abs().into()
}

/// Photometric flux of what `measure` makes of the exitance, lm.
fn flux(problem: &Problem<'_>, exitance: &[f32], measure: fn(f32) -> f64) -> f64 {
    let columns = problem.columns();
    sum_over(problem.len(), 1, |i, sum| {
        for (k, v) in exitance[i * columns..(i + 1) * columns].iter().enumerate() {
            sum[0] += problem.area[i] * weight(k) * measure(*v);
        }
    })[0]
}

impl StochasticJacobi {
    /// A solver at its start.
    pub fn new(settings: SolverSettings) -> Self {
        StochasticJacobi {
            lines_per_step: settings.lines_per_step,
            chains: [Chain::new(0), Chain::new(1)],
            stored: None,
            exitance: Vec::new(),
            progress: Progress::default(),
        }
    }

    /// Whether the bounces have been followed and steps only reduce noise now.
    pub fn is_averaging(&self) -> bool {
        self.chains
            .iter()
            .all(|c| matches!(c.phase, Phase::Regular(_)))
    }

    /// Weight of the stored result beside the new one.
    fn stored_weight(&self) -> f64 {
        match &self.stored {
            Some(s) if self.is_averaging() => {
                let new: f64 = self.chains.iter().map(|c| c.lines).sum();
                share(s.lines, s.lines + new)
            }
            _ => 0.0,
        }
    }

    /// Weights of the chains.
    fn shares(&self) -> [f64; 2] {
        let [a, b] = [self.chains[0].lines, self.chains[1].lines];
        if a > 0.0 && b > 0.0 {
            [a / (a + b), b / (a + b)]
        } else {
            [0.5, 0.5]
        }
    }

    /// Mean of what is known, and how good it is.
    fn settle(&mut self, problem: &Problem<'_>) {
        let columns = problem.columns();
        let [a, b] = self.shares();
        let kept = self.stored_weight();
        let (chains, stored) = (&self.chains, &self.stored);
        self.exitance.resize(problem.len() * columns, 0.0);
        // Photometric square of the difference and of the mean, per element, so that the sums
        // below run in one order.
        let squares: Vec<[f64; 2]> = self
            .exitance
            .par_chunks_mut(columns)
            .enumerate()
            .map(|(i, row)| {
                let (mut difference, mut mean) = (0.0, 0.0);
                for (k, v) in row.iter_mut().enumerate() {
                    let [x, y] = [0, 1].map(|c: usize| chains[c].exitance(problem, i, k));
                    let old = stored
                        .as_ref()
                        .map_or(0.0, |s| s.exitance[i * columns + k] as f64);
                    let new = a * x + b * y;
                    *v = (new + kept * (old - new)) as f32;
                    difference += weight(k) * (x - y);
                    mean += weight(k) * *v as f64;
                }
                [difference * difference, mean * mean]
            })
            .collect();
        let (mut noise, mut whole) = (0.0, 0.0);
        for (area, [difference, mean]) in problem.area.iter().zip(&squares) {
            noise += area * difference;
            whole += area * mean;
        }
        // The variances are as 1/a and 1/b, so Var(a X + b Y) = a b Var(X - Y).
        let mut error = share(a * b * noise, whole).sqrt();
        if let Some(s) = &self.stored {
            error = if self.is_averaging() {
                (kept * s.relative_error).hypot((1.0 - kept) * error)
            } else {
                error.hypot(s.relative_error)
            };
        }
        let bias = self.chains.iter().map(|c| c.bias).fold(0.0, f64::max);
        for chain in self
            .chains
            .iter_mut()
            .filter(|c| c.bias > BIAS_TO_NOISE * error)
        {
            chain.lines *= 0.5;
        }
        self.progress.relative_error = error.hypot((1.0 - kept) * bias);
        let left = |c: &Chain| match c.phase {
            Phase::Regular(1..) => c.unshot_share.min(c.missing),
            _ => c.unshot_share,
        };
        self.progress.unshot_share = self.chains.iter().map(left).sum::<f64>() / 2.0;
        self.progress.finished = self.progress.relative_error < F32_RESOLUTION;
    }
}

impl Solver for StochasticJacobi {
    fn step(&mut self, problem: &Problem<'_>) -> Progress {
        let Transport::Lines(local) = problem.transport else {
            debug_assert!(false, "stochastic Jacobi needs lines");
            return Progress {
                finished: true,
                relative_error: 1.0,
                ..Progress::default()
            };
        };
        // Lines of one chain: a few an element first, enough to be worth the overhead of a step;
        // later as many as make good use of a low-discrepancy sequence.
        let n = problem.len() as u64;
        let cap = match self.lines_per_step {
            0 => (32 * n).clamp(1 << 17, 1 << 21),
            most => (most as u64 / 2).max(1),
        };
        let first = (2 * n).max(1 << 14).min(cap);
        for chain in &mut self.chains {
            let lines = chain.load(first, n, cap);
            self.progress.work += chain.pass(problem, local, lines);
        }
        self.progress.step += 1;
        self.settle(problem);
        self.progress
    }

    fn solution(&self, problem: &Problem<'_>) -> Solution {
        let size = problem.len() * problem.columns();
        let started = self.exitance.len() == size;
        let emission = || {
            problem
                .emission
                .iter()
                .map(|v| *v as f32)
                .collect::<Vec<f32>>()
        };
        let mut unshot = if started {
            vec![0.0f32; size]
        } else {
            emission()
        };
        for chain in self
            .chains
            .iter()
            .filter(|c| matches!(c.phase, Phase::Shooting(_)))
        {
            for (u, v) in unshot.iter_mut().zip(&chain.sent) {
                *u += 0.5 * v;
            }
        }
        Solution {
            layers: problem.layers.clone(),
            exitance: if started {
                self.exitance.clone()
            } else {
                emission()
            },
            unshot,
            relative_error: if started {
                self.progress.relative_error as f32
            } else {
                1.0
            },
            unshot_share: if started {
                self.progress.unshot_share as f32
            } else {
                1.0
            },
            work: self.progress.work,
        }
    }

    fn noise(&self, problem: &Problem<'_>) -> Vec<f32> {
        // Right after a start or a resumption the chains hold the same.
        if self.progress.step == 0 || self.exitance.is_empty() {
            return Vec::new();
        }
        let columns = problem.columns();
        // Var(a X + b Y) = a b Var(X - Y), and the stored result has its part of the mean.
        let [a, b] = self.shares();
        let part = (a * b).sqrt() * (1.0 - self.stored_weight());
        let [x, y] = [&self.chains[0], &self.chains[1]];
        let wrong = |i: usize| {
            (0..columns)
                .map(|k| weight(k) * (x.exitance(problem, i, k) - y.exitance(problem, i, k)))
                .sum::<f64>()
        };
        (0..problem.len())
            .into_par_iter()
            .map(|i| (part * wrong(i)) as f32)
            .collect()
    }

    fn restart(&mut self, change: &FrontChange, problem: &Problem<'_>) {
        if self.exitance.is_empty() {
            return;
        }
        let columns = problem.columns();
        // Both chains start from the mean of what is known; their residuals are independent.
        self.exitance = change.carry(&self.exitance, columns);
        self.stored = None;
        for chain in &mut self.chains {
            chain.incident = change.carry(&chain.incident, columns);
            chain.sent = self.exitance.clone();
            chain.phase = Phase::Residual;
            chain.lines = 0.0;
            // Not the lines that the carried result was made of.
            chain.stream = hash([chain.stream, self.progress.step, problem.len() as u32]);
        }
    }

    fn resume(&mut self, stored: &Solution, problem: &Problem<'_>) {
        let columns = problem.columns();
        let size = problem.len() * columns;
        if stored.exitance.len() != size || stored.unshot.len() != size {
            return;
        }
        self.exitance = stored.exitance.clone();
        self.progress = Progress {
            step: 0,
            unshot_share: stored.unshot_share as f64,
            relative_error: stored.relative_error as f64,
            work: stored.work,
            finished: false,
        };
        let shooting = stored.unshot.iter().any(|u| *u != 0.0);
        // About what a bounce leaves.
        let sums = sum_over(problem.len(), 2, |i, sum| {
            sum[0] += problem.area[i] * reflectance(problem, i);
            sum[1] += problem.area[i];
        });
        let mean_reflectance = share(sums[0], sums[1]);
        for (number, chain) in self.chains.iter_mut().enumerate() {
            // Not the lines that the stored result was made of.
            *chain = Chain::new(hash([
                number as u32,
                stored.work as u32,
                (stored.work >> 32) as u32,
            ]));
            // B = E + rho H; where rho is 0 nothing of H matters to the result.
            chain.incident = (0..size)
                .map(|at| {
                    let rho = rho(problem, at / columns, at % columns);
                    let reflected = stored.exitance[at] as f64 - problem.emission[at];
                    if rho > 0.0 {
                        (reflected / rho) as f32
                    } else {
                        0.0
                    }
                })
                .collect();
            chain.unshot_share = stored.unshot_share as f64;
            if shooting {
                chain.sent = stored.unshot.clone();
                chain.phase = Phase::Shooting(1);
            } else {
                chain.sent = stored.exitance.clone();
                chain.phase = Phase::Regular(0);
                (chain.to_come, chain.foretold, chain.bias) = (0.0, 0.0, 0.0);
                chain.decay = mean_reflectance;
            }
        }
        self.stored = Some(Stored {
            exitance: stored.exitance.clone(),
            relative_error: stored.relative_error as f64,
            lines: if shooting { 0.0 } else { stored.work as f64 },
        });
    }
}
