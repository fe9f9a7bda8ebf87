//! Importance: how much the flux that leaves each element adds to what is looked at.
//!
//! If a view or a set of receivers sees v_i of each lm that leaves element i, then what it gets
//! of that lm in the end, over all bounces, is
//! y_i = v_i + sum_j F_ij rho_j y_j: the adjoint of the radiosity equation. With z = rho y this
//! is z = rho v + rho F z, the radiosity equation itself with the emission rho v, so that any
//! solver finds importance, over the transport that it has. One more gather gives y on elements
//! that reflect nothing, lamps for one.
//!
//! Stochastic Jacobi, Southwell and the link solvers take it as a weight of where their work goes
//! ([`Problem::importance`]); the fixed point stays what it is. Sweeps have no order to choose.
//! Monte Carlo shooting does not heed it: with lines in proportion to power times importance its
//! error at equal lines was twice as large, as dim rooms then come in a few heavy lines.
//!
//! Source: [Smits92]. Differs: importance is not refined together with the light, but solved
//! first, roughly.

use crate::contract::{Problem, Solver, Transport};
use crate::kinds::SolverSettings;
use crate::line_pass::{Level, LinePlan, Sent};
use crate::photometry::{gather, luminance, rho};
use crate::sweep::for_each_row;
use crate::{GaussSeidel, LinkSolver, StochasticJacobi};
use luxel_core::Layers;
use luxel_core::layers::BANDS;
use luxel_transport::sampling::hash;

/// Steps of the adjoint solver at most.
const MOST_STEPS: u32 = 64;

/// Lines an element in the last gather, where there are lines.
const LAST_LINES: u64 = 32;

/// Share of the mean below which no importance falls: what is not looked at now must still be
/// found to be dark or bright.
const LEAST: f64 = 0.05;

/// What a view or receivers get in the end of a lm that leaves each element, photometric, in the
/// unit of `seen`.
///
/// `seen[i]` is what a view or receivers get directly of a lm that leaves element i, in any unit,
/// 0 or more. `error` is the relative error of the adjoint solution: a rough one does, say 0.1.
///
/// Precondition: one entry an element.
///
/// Source: [Smits92].
pub fn adjoint(problem: &Problem<'_>, seen: &[f64], error: f64) -> Vec<f64> {
    debug_assert_eq!(seen.len(), problem.len());
    let layers = Layers {
        groups: vec!["importance".into()],
    };
    let emission: Vec<f64> = (0..problem.len() * BANDS)
        .map(|at| problem.reflectance[at] * seen[at / BANDS])
        .collect();
    let adjoint = Problem {
        layers: &layers,
        emission: &emission,
        outside: &[0.0; BANDS],
        importance: None,
        seed: hash([problem.seed, 0x1a90]),
        ..*problem
    };
    let mut solver: Box<dyn Solver> = match problem.transport {
        Transport::Factors(_) => Box::new(GaussSeidel::new()),
        Transport::Lines(_) => Box::new(StochasticJacobi::new(SolverSettings::default())),
        Transport::Nodes(_) => Box::new(LinkSolver::new(crate::linear_wavelet::METHOD)),
    };
    for _ in 0..MOST_STEPS {
        let progress = solver.step(&adjoint);
        if progress.finished || progress.relative_error <= error {
            break;
        }
    }
    let found = solver.solution(&adjoint).exitance;
    let arriving = arriving(&adjoint, &found);
    (0..problem.len())
        .map(|i| seen[i] + luminance(&arriving[i * BANDS..(i + 1) * BANDS]))
        .collect()
}

/// [`adjoint`] as weights for [`Problem::importance`]: mean 1 by area, none far below; all 1 if
/// nothing is seen.
pub fn weights(problem: &Problem<'_>, seen: &[f64], error: f64) -> Vec<f64> {
    let mut found = adjoint(problem, seen, error);
    // Twice: what is lifted to the least share lifts the mean.
    for _ in 0..2 {
        let sum: f64 = found.iter().zip(problem.area).map(|(y, a)| y * a).sum();
        let mean = sum / problem.area.iter().sum::<f64>();
        if !(mean.is_finite() && mean > 0.0) {
            return vec![1.0; problem.len()];
        }
        found.iter_mut().for_each(|y| *y = (*y / mean).max(LEAST));
    }
    found
}

/// F z of every element: one gather over whatever transport there is.
fn arriving(problem: &Problem<'_>, sent: &[f32]) -> Vec<f64> {
    let mut incident = vec![0.0; sent.len()];
    let local = match problem.transport {
        Transport::Factors(factors) => {
            let wide: Vec<f64> = sent.iter().map(|v| *v as f64).collect();
            for_each_row(factors, |i, row| {
                let own = &mut incident[i * BANDS..(i + 1) * BANDS];
                gather(row, &wide, problem.outside, own);
            });
            return incident;
        }
        Transport::Lines(local) => local,
        Transport::Nodes(nodes) => nodes.lines(),
    };
    let nothing = [0.0; BANDS];
    let known: Vec<f32> = (0..sent.len())
        .map(|at| {
            let r = rho(problem, at / BANDS, at % BANDS);
            let reflected = sent[at] as f64 - problem.emission[at];
            if r > 0.0 { (reflected / r) as f32 } else { 0.0 }
        })
        .collect();
    let sent = Sent {
        exitance: sent,
        outside: &nothing,
        level: Level::Incident(&known),
    };
    let (mut plan, mut found) = (LinePlan::default(), Vec::new());
    let lines = LAST_LINES * problem.len() as u64;
    plan.distribute(problem, &sent, lines, problem.seed);
    plan.cast(problem, local, &sent, hash([problem.seed, 1]), &mut found);
    found.iter().map(|v| *v as f64).collect()
}
