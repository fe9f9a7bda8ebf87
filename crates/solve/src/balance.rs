//! Energy balance of a solution: emitted = absorbed + escaped + unshot.
//!
//! Not taken from the solver's own books but measured again: what was sent on, S = B - U, is
//! distributed once more, and each share is absorbed, reflected or lost. Then
//!
//! emitted - absorbed - escaped - unshot = sum A (E + rho H_S - B),
//!
//! which is zero for exact exitance, for any U. A solution that is wrong shows up here.
//!
//! With form factors nothing is random. With lines each element spreads its flux evenly over its
//! own lines, so absorbed + reflected + escaped is exactly what was sent, and only the split
//! between them has noise, about one over the square root of the number of lines.
//!
//! Source: [Cohen93], section 2.6 (conservation of power in the discrete system).

use crate::contract::{Problem, Transport};
use crate::photometry::weight;
use crate::sweep::for_each_row;
use luxel_core::layers::BANDS;
use luxel_core::{ElementId, Solution};
use luxel_transport::sampling::hash;
use luxel_transport::{Arrival, LocalLines, of_each};
use rayon::prelude::*;

/// Elements of one task.
const CHUNK: usize = 1024;

/// Where the flux of one luminaire group, or of all, has gone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Account {
    /// Flux of all emission and what enters from outside, lm.
    pub emitted_lm: f64,
    /// Flux absorbed by elements and by black sides, lm. With estimated form factors it holds
    /// their closure defect too: what a row lacks to 1 counts as black.
    pub absorbed_lm: f64,
    /// Flux that left the scene, lm.
    pub escaped_lm: f64,
    /// Flux not sent on yet, lm, signed.
    pub unshot_lm: f64,
    /// (emitted - absorbed - escaped - unshot) / emitted, signed; 0 without emission.
    pub imbalance: f64,
}

/// Energy balance of a solution, photometric.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EnergyBalance {
    /// All groups together.
    pub total: Account,
    /// Each group, in the order of the layers.
    pub groups: Vec<Account>,
}

/// Sums for each column, lm.
#[derive(Clone, Debug)]
struct Sums {
    emitted: Vec<f64>,
    absorbed: Vec<f64>,
    escaped: Vec<f64>,
    unshot: Vec<f64>,
}

impl Sums {
    fn new(columns: usize) -> Self {
        let zero = || vec![0.0; columns];
        Sums {
            emitted: zero(),
            absorbed: zero(),
            escaped: zero(),
            unshot: zero(),
        }
    }

    fn add(&mut self, other: &Sums) {
        for (to, from) in [
            (&mut self.emitted, &other.emitted),
            (&mut self.absorbed, &other.absorbed),
            (&mut self.escaped, &other.escaped),
            (&mut self.unshot, &other.unshot),
        ] {
            for (t, f) in to.iter_mut().zip(from) {
                *t += f;
            }
        }
    }

    /// What element `i` emits, keeps and gets from outside when it sees a share `outside` of it.
    fn element(&mut self, problem: &Problem<'_>, solution: &Solution, i: usize, outside: f64) {
        let columns = problem.columns();
        let area = problem.area[i];
        for k in 0..columns {
            let at = i * columns + k;
            let entering = area * outside * problem.outside[k];
            let rho = problem.reflectance[BANDS * i + k % BANDS];
            self.emitted[k] += area * problem.emission[at] + entering;
            self.absorbed[k] += (1.0 - rho) * entering;
            self.unshot[k] += area * solution.unshot[at] as f64;
        }
    }

    /// Flux `load` (lm a column, times `share`) that reaches element `j`.
    fn arrive(&mut self, problem: &Problem<'_>, load: &[f64], share: f64, j: usize) {
        for (k, flux) in load.iter().enumerate() {
            self.absorbed[k] += (1.0 - problem.reflectance[BANDS * j + k % BANDS]) * share * flux;
        }
    }

    fn balance(&self) -> EnergyBalance {
        let account = |columns: std::ops::Range<usize>| {
            let sum = |of: &[f64]| columns.clone().map(|k| weight(k) * of[k]).sum::<f64>();
            let mut account = Account {
                emitted_lm: sum(&self.emitted),
                absorbed_lm: sum(&self.absorbed),
                escaped_lm: sum(&self.escaped),
                unshot_lm: sum(&self.unshot),
                imbalance: 0.0,
            };
            if account.emitted_lm > 0.0 {
                let left = account.emitted_lm
                    - account.absorbed_lm
                    - account.escaped_lm
                    - account.unshot_lm;
                account.imbalance = left / account.emitted_lm;
            }
            account
        };
        let columns = self.emitted.len();
        EnergyBalance {
            total: account(0..columns),
            groups: (0..columns / BANDS)
                .map(|g| account(BANDS * g..BANDS * (g + 1)))
                .collect(),
        }
    }
}

/// Flux of S = B - U of element `i`, lm a column.
fn load(problem: &Problem<'_>, solution: &Solution, i: usize) -> Vec<f64> {
    let columns = problem.columns();
    (i * columns..(i + 1) * columns)
        .map(|at| problem.area[i] * (solution.exitance[at] as f64 - solution.unshot[at] as f64))
        .collect()
}

/// Measures the energy balance of `solution`.
///
/// `lines` is the number of lines to cast, if the problem brings lines: a million give about
/// 0.1 %. Costs one pass of lines, or every row of the factors once.
///
/// Precondition: the solution is one of this problem.
pub fn measure(problem: &Problem<'_>, solution: &Solution, lines: u64) -> EnergyBalance {
    debug_assert_eq!(solution.exitance.len(), problem.len() * problem.columns());
    debug_assert_eq!(solution.unshot.len(), solution.exitance.len());
    let mut sums = Sums::new(problem.columns());
    match problem.transport {
        Transport::Factors(factors) => for_each_row(factors, |i, row| {
            let load = load(problem, solution, i);
            let black = 1.0 - row.closure();
            for (k, flux) in load.iter().enumerate() {
                sums.escaped[k] += row.outside * flux;
                sums.absorbed[k] += black * flux;
            }
            for (j, f) in &row.entries {
                sums.arrive(problem, &load, *f, j.index());
            }
            sums.element(problem, solution, i, row.outside);
        }),
        Transport::Lines(local) => by_lines(problem, solution, local, lines, &mut sums),
        Transport::Nodes(nodes) => by_lines(problem, solution, nodes.lines(), lines, &mut sums),
    }
    sums.balance()
}

fn by_lines(
    problem: &Problem<'_>,
    solution: &Solution,
    local: &dyn LocalLines,
    lines: u64,
    sums: &mut Sums,
) {
    let n = problem.len();
    let flux: Vec<f64> = (0..n)
        .into_par_iter()
        .map(|i| {
            load(problem, solution, i)
                .iter()
                .enumerate()
                .map(|(k, v)| weight(k) * v.abs())
                .sum()
        })
        .collect();
    let whole: f64 = flux.iter().sum();
    let area: f64 = problem.area.iter().sum();
    // Lines of its own, or the audit would repeat the errors of the solver.
    let seed = hash([problem.seed, 0xba1a]);
    let parts: Vec<Sums> = (0..n.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut sums = Sums::new(problem.columns());
            let runs: Vec<_> = (chunk * CHUNK..n.min((chunk + 1) * CHUNK))
                .map(|i| {
                    let by_flux = if whole > 0.0 { flux[i] / whole } else { 0.0 };
                    let by_area = if area > 0.0 {
                        problem.area[i] / area
                    } else {
                        0.0
                    };
                    let expected = 0.5 * lines as f64 * (by_flux + by_area);
                    let count = 1u32 << (expected.max(1.0).log2().round() as u32).min(24);
                    (ElementId::from(i), 0..count)
                })
                .collect();
            let mut arrivals = Vec::new();
            local.cast_each(&runs, seed, &mut arrivals);
            for (element, own) in of_each(&runs, &arrivals) {
                let i = element.index();
                let each = 1.0 / own.len() as f64;
                let load = load(problem, solution, i);
                let (mut outside, mut black) = (0u32, 0u32);
                for arrival in own {
                    match arrival.element() {
                        Some(j) => sums.arrive(problem, &load, each, j.index()),
                        None if *arrival == Arrival::OUTSIDE => outside += 1,
                        None => black += 1,
                    }
                }
                for (k, flux) in load.iter().enumerate() {
                    sums.escaped[k] += outside as f64 * each * flux;
                    sums.absorbed[k] += black as f64 * each * flux;
                }
                sums.element(problem, solution, i, outside as f64 * each);
            }
            sums
        })
        .collect();
    for part in &parts {
        sums.add(part);
    }
}
