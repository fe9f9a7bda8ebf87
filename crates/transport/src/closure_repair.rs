//! Closure repair: the least change of stored factors after which rows sum to one, without
//! giving up reciprocity.
//!
//! Exchange areas G_ij = A_i F_ij are symmetric, and in a closed scene row i sums to A_i. Computed
//! ones miss that by their errors. Wanted is the symmetric dG that mends it with the least
//! sum_ij dG_ij^2 / G_ij: what is zero stays zero, and an entry gives in proportion to its size, as
//! independent errors with a variance like G_ij would have it. The method of Lagrange leaves one
//! number a row:
//!
//! ```text
//! dG_ij = G_ij (l_i + l_j),   (D + G) l = A - r,   r_i = sum_j G_ij,   D = diag(r)
//! ```
//!
//! x^T (D + G) x = 1/2 sum_ij G_ij (x_i + x_j)^2, so the matrix is positive semidefinite, and
//! conjugate gradients with D + diag(G) before them solve it in few steps. It is singular where rows
//! fall into two sides that see only each other, as two plates do: both sides must then have the
//! same area. Such parts are found by colouring rather than by a breakdown of the iteration,
//! which rounding hides; where the areas differ, the lack is shared so that each of their rows
//! misses its area by the same share.
//!
//! Only for scenes that are closed. What leaves an open scene is no error, and must be left out
//! of the areas that are handed over.
//!
//! Sources: consistent factors out of inexact ones [vanLeersum89]; least squares for exchange
//! areas [Larsen86], [Lawson95]; conjugate gradients [Golub13], chapter 11.

use rayon::prelude::*;

/// Symmetric exchange areas, m², as sparse rows: both G_ij and G_ji are there, with the same bits.
#[derive(Clone, Copy, Debug)]
pub struct ExchangeAreas<'a> {
    /// Row i is `offsets[i]..offsets[i + 1]` of the next two; one more than rows.
    pub offsets: &'a [usize],
    /// Columns, ascending within a row.
    pub columns: &'a [u32],
    /// G_ij, m², finite and not negative.
    pub values: &'a [f32],
}

impl<'a> ExchangeAreas<'a> {
    /// Columns and values of a row, without zeros.
    fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + use<'a> {
        let range = self.offsets[i]..self.offsets[i + 1];
        let columns = self.columns[range.clone()].iter();
        columns
            .zip(&self.values[range])
            .map(|(&j, &g)| (j as usize, g as f64))
            .filter(|&(_, g)| g > 0.0)
    }

    /// Whether every entry stands on the other side of the diagonal too. For debugging.
    fn is_symmetric(&self) -> bool {
        let at = |i: usize, j: usize| {
            let range = self.offsets[i]..self.offsets[i + 1];
            let place = self.columns[range.clone()].binary_search(&(j as u32));
            place.ok().map(|k| self.values[range.start + k] as f64)
        };
        (0..self.offsets.len() - 1).all(|i| self.row(i).all(|(j, g)| at(j, i) == Some(g)))
    }
}

/// When the iteration ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RepairSettings {
    /// Largest |1 - sum_j F_ij| that is good enough. Below 1e-14 nothing is.
    pub tolerance: f64,
    /// Most steps; each reads all entries once.
    pub most_steps: u32,
}

impl Default for RepairSettings {
    fn default() -> Self {
        // Well below what an entry loses when it is stored as f32.
        RepairSettings {
            tolerance: 1e-9,
            most_steps: 1000,
        }
    }
}

/// How far rows are from summing to one. Over the rows that the repair cares for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Closure {
    /// Mean of |1 - sum_j F_ij|.
    pub mean: f64,
    /// The largest of them.
    pub worst: f64,
    /// Its row.
    pub worst_at: Option<u32>,
}

/// Whether rows can sum to one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RepairOutcome {
    /// They do, to the tolerance.
    Closed,
    /// All do but the rows of `parts` parts of the scene, where two sides see only each other and
    /// differ in area. Those rows are left with up to `closure_left` = |A_1 - A_2| / (A_1 + A_2).
    TwoSided {
        /// Number of such parts.
        parts: u32,
        /// Largest |1 - sum_j F_ij| that no change of the factors takes away.
        closure_left: f64,
    },
    /// The steps were not enough.
    NotConverged {
        /// Steps done.
        steps: u32,
        /// Largest |1 - sum_j F_ij| beyond what two-sided parts are left with.
        residual: f64,
    },
}

/// Pairs whose exchange area would become negative, which no factor can be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NegativePairs {
    /// Number of pairs, i <= j.
    pub pairs: u64,
    /// The pair with the largest relative change.
    pub worst_at: [u32; 2],
    /// Its dG_ij / G_ij, below -1.
    pub worst_change: f64,
}

/// A proposed repair and what it does. Nothing is applied.
#[derive(Clone, Debug, PartialEq)]
pub struct Repair {
    /// l_i, no unit; 0 for rows left alone.
    pub multipliers: Vec<f64>,
    /// Whether rows sum to one.
    pub outcome: RepairOutcome,
    /// Largest |dG_ij| / G_ij.
    pub largest_change: f64,
    /// Largest sum_j |dG_ij| / A_i: the share of what a row sends that goes elsewhere, or is new.
    pub largest_row_change: f64,
    /// Closure of what was handed over.
    pub before: Closure,
    /// Closure after the repair, measured.
    pub after: Closure,
    /// Steps of the iteration.
    pub steps: u32,
    /// Rows left alone, as they have no entry above zero or no area.
    pub left_alone: u32,
    /// If there are any, the repair is not fit for use: the factors are too far off, or the scene
    /// is not closed.
    pub negative: Option<NegativePairs>,
}

impl Repair {
    /// What G_ij, F_ij and F_ji are to be multiplied by; the same bits for (i, j) and (j, i).
    /// Negative where `negative` says so.
    pub fn scale(&self, i: usize, j: usize) -> f64 {
        1.0 + (self.multipliers[i] + self.multipliers[j])
    }
}

/// The least change of `exchange` after which row i sums to `areas_m2[i]`, and how much of it is
/// reached. The same bits for any number of threads.
///
/// Rows without area or without an entry above zero are left alone: nothing is asked of them, but
/// what other rows exchange with them may change. Panics if lengths do not fit.
pub fn repair_closure(
    exchange: ExchangeAreas,
    areas_m2: &[f64],
    settings: RepairSettings,
) -> Repair {
    let n = areas_m2.len();
    assert_eq!(exchange.offsets.len(), n + 1, "one area a row");
    assert_eq!(exchange.columns.len(), exchange.values.len());
    debug_assert!(exchange.values.iter().all(|g| g.is_finite() && *g >= 0.0));
    debug_assert!(exchange.is_symmetric());

    let each_row =
        |f: &(dyn Fn(usize) -> f64 + Sync)| -> Vec<f64> { (0..n).into_par_iter().map(f).collect() };
    let sums = each_row(&|i| exchange.row(i).map(|(_, g)| g).sum());
    let asked: Vec<bool> = (0..n).map(|i| sums[i] > 0.0 && areas_m2[i] > 0.0).collect();
    let mut wanted: Vec<f64> = areas_m2.to_vec();
    let parts = level_two_sides(exchange, &asked, settings.tolerance, &mut wanted);
    let closure_left = (0..n)
        .filter(|&i| asked[i])
        .map(|i| (1.0 - wanted[i] / areas_m2[i]).abs())
        .fold(0.0, f64::max);

    // (D + G) x, for the rows that are asked.
    let times = |x: &[f64]| {
        each_row(&|i| match asked[i] {
            true => sums[i] * x[i] + exchange.row(i).map(|(j, g)| g * x[j]).sum::<f64>(),
            false => 0.0,
        })
    };
    let diagonal = each_row(&|i| {
        let own = exchange.row(i).find(|&(j, _)| j == i);
        sums[i] + own.map_or(0.0, |(_, g)| g)
    });
    let residual_of = |l: &[f64]| {
        let done = times(l);
        let left = |i: usize| match asked[i] {
            true => wanted[i] - sums[i] - done[i],
            false => 0.0,
        };
        (0..n).map(left).collect::<Vec<f64>>()
    };
    let worst = |r: &[f64]| {
        let share = |i: usize| r[i].abs() / areas_m2[i];
        (0..n).filter(|&i| asked[i]).map(share).fold(0.0, f64::max)
    };

    let mut l = vec![0.0; n];
    let mut steps = 0;
    let mut residual = residual_of(&l);
    let mut left = worst(&residual);
    // The recurrence may claim more than is true: then it begins again from where it is.
    while left > settings.tolerance && steps < settings.most_steps {
        let conditioned = |r: &[f64]| -> Vec<f64> {
            let scaled = |i: usize| if asked[i] { r[i] / diagonal[i] } else { 0.0 };
            (0..n).map(scaled).collect()
        };
        let mut z = conditioned(&residual);
        let mut direction = z.clone();
        let mut rz = dot(&residual, &z);
        let before = left;
        let mut best = (left, l.clone());
        while steps < settings.most_steps {
            let image = times(&direction);
            let curvature = dot(&direction, &image);
            // Not so where it can be solved, but for rounding: no way leads on from here.
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            steps += 1;
            let step = rz / curvature;
            for i in 0..n {
                l[i] += step * direction[i];
                residual[i] -= step * image[i];
            }
            left = worst(&residual);
            if left < best.0 {
                best = (left, l.clone());
            }
            if left <= settings.tolerance {
                break;
            }
            z = conditioned(&residual);
            let next = dot(&residual, &z);
            let keep = next / rz;
            rz = next;
            for i in 0..n {
                direction[i] = z[i] + keep * direction[i];
            }
        }
        l = best.1;
        residual = residual_of(&l);
        left = worst(&residual);
        if left.is_nan() || left > 0.5 * before {
            break;
        }
    }

    let outcome = if left.is_nan() || left > settings.tolerance {
        let residual = left;
        RepairOutcome::NotConverged { steps, residual }
    } else if closure_left > settings.tolerance {
        RepairOutcome::TwoSided {
            parts,
            closure_left,
        }
    } else {
        RepairOutcome::Closed
    };
    report(exchange, areas_m2, &asked, &sums, l, outcome, steps)
}

/// In every part of the scene where rows on two sides see only each other, makes the wanted sums
/// of both sides alike: each of its rows by the same share. Returns the number of parts where
/// that share is above `tolerance`.
fn level_two_sides(
    exchange: ExchangeAreas,
    asked: &[bool],
    tolerance: f64,
    wanted: &mut [f64],
) -> u32 {
    let n = asked.len();
    let mut side = vec![0i8; n];
    let mut part: Vec<usize> = Vec::new();
    let mut parts = 0;
    for first in 0..n {
        if !asked[first] || side[first] != 0 {
            continue;
        }
        part.clear();
        part.push(first);
        side[first] = 1;
        let mut two_sided = true;
        let mut next = 0;
        while next < part.len() {
            let i = part[next];
            next += 1;
            for (j, _) in exchange.row(i) {
                if !asked[j] || side[j] == side[i] {
                    // A row of which nothing is asked takes what is too much; so does one's own.
                    two_sided = false;
                } else if side[j] == 0 {
                    side[j] = -side[i];
                    part.push(j);
                }
            }
        }
        if !two_sided {
            continue;
        }
        let surplus: f64 = part.iter().map(|&i| side[i] as f64 * wanted[i]).sum();
        let share = surplus / part.iter().map(|&i| wanted[i]).sum::<f64>();
        if share.abs() > tolerance {
            parts += 1;
        }
        for &i in &part {
            wanted[i] -= side[i] as f64 * share * wanted[i];
        }
    }
    parts
}

/// Measures what the repair with these multipliers does.
fn report(
    exchange: ExchangeAreas,
    areas_m2: &[f64],
    asked: &[bool],
    sums: &[f64],
    multipliers: Vec<f64>,
    outcome: RepairOutcome,
    steps: u32,
) -> Repair {
    let l = &multipliers;
    let mut after = sums.to_vec();
    let mut largest_change = 0.0f64;
    let mut largest_row_change = 0.0f64;
    let mut negative: Option<NegativePairs> = None;
    for i in 0..areas_m2.len() {
        let (mut sum, mut moved) = (0.0, 0.0);
        for (j, g) in exchange.row(i) {
            let change = l[i] + l[j];
            sum += g * (1.0 + change);
            moved += g * change.abs();
            largest_change = largest_change.max(change.abs());
            if change < -1.0 && i <= j {
                let known = negative.get_or_insert(NegativePairs {
                    pairs: 0,
                    worst_at: [i as u32, j as u32],
                    worst_change: change,
                });
                known.pairs += 1;
                if change < known.worst_change {
                    known.worst_at = [i as u32, j as u32];
                    known.worst_change = change;
                }
            }
        }
        after[i] = sum;
        if asked[i] {
            largest_row_change = largest_row_change.max(moved / areas_m2[i]);
        }
    }
    Repair {
        before: closure(sums, areas_m2, asked),
        after: closure(&after, areas_m2, asked),
        left_alone: asked.iter().filter(|a| !**a).count() as u32,
        multipliers,
        outcome,
        largest_change,
        largest_row_change,
        steps,
        negative,
    }
}

fn closure(sums: &[f64], areas_m2: &[f64], asked: &[bool]) -> Closure {
    let mut closure = Closure::default();
    let mut rows = 0;
    for i in (0..sums.len()).filter(|&i| asked[i]) {
        let off = (1.0 - sums[i] / areas_m2[i]).abs();
        closure.mean += off;
        rows += 1;
        if off > closure.worst {
            closure.worst = off;
            closure.worst_at = Some(i as u32);
        }
    }
    closure.mean /= rows.max(1) as f64;
    closure
}

/// In the order of the rows, so that threads do not matter.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sparse rows of a full matrix.
    struct Stored {
        offsets: Vec<usize>,
        columns: Vec<u32>,
        values: Vec<f32>,
    }

    impl Stored {
        fn new(n: usize, g: impl Fn(usize, usize) -> f32) -> Stored {
            let mut s = Stored {
                offsets: vec![0],
                columns: vec![],
                values: vec![],
            };
            for i in 0..n {
                for j in (0..n).filter(|&j| g(i, j) != 0.0) {
                    s.columns.push(j as u32);
                    s.values.push(g(i, j));
                }
                s.offsets.push(s.columns.len());
            }
            s
        }
        fn view(&self) -> ExchangeAreas<'_> {
            ExchangeAreas {
                offsets: &self.offsets,
                columns: &self.columns,
                values: &self.values,
            }
        }
        fn repair(&self, areas: &[f64]) -> Repair {
            repair_closure(self.view(), areas, RepairSettings::default())
        }
    }

    /// 0..1 from a pair, the same for both orders.
    fn noise(i: usize, j: usize, seed: u64) -> f64 {
        let (a, b) = (i.min(j) as u64, i.max(j) as u64);
        let mut h = (a << 32 | b) ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        for _ in 0..3 {
            h = (h ^ (h >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        }
        (h >> 11) as f64 / (1u64 << 53) as f64
    }

    #[test]
    fn three_planes_get_their_only_solution() {
        // Three planar surfaces that enclose a space: G_12 = (A_1 + A_2 - A_3) / 2 and so on,
        // whatever the guess (textbook of enclosures without self-view).
        let a = [3.0, 4.0, 5.0];
        let guess = [[0.0, 0.8, 2.3], [0.8, 0.0, 2.7], [2.3, 2.7, 0.0]];
        let s = Stored::new(3, |i, j| guess[i][j]);
        let r = s.repair(&a);
        assert_eq!(r.outcome, RepairOutcome::Closed);
        for (i, j, expected) in [(0, 1, 1.0), (0, 2, 2.0), (1, 2, 3.0)] {
            let found = guess[i][j] as f64 * r.scale(i, j);
            // The tolerance of the rows, times the largest area.
            assert!((found - expected).abs() < 1e-8, "{i} {j}: {found}");
        }
        assert!(r.before.worst > 0.03 && r.after.worst <= 1e-9, "{r:?}");
        assert_eq!((r.negative, r.left_alone), (None, 0));
    }

    #[test]
    fn no_other_change_that_closes_is_smaller() {
        // Least squares: along every way that keeps all row sums (a four-cycle with alternating
        // sign) the sum of squares has its lowest point at the repair.
        let n = 12;
        let g = |i: usize, j: usize| (0.2 + noise(i, j, 1)) as f32;
        let s = Stored::new(n, g);
        let areas: Vec<f64> = (0..n)
            .map(|i| {
                let exact = |j| g(i, j) as f64 * (1.0 + 0.1 * (noise(i, j, 2) - 0.5));
                (0..n).map(exact).sum()
            })
            .collect();
        let r = s.repair(&areas);
        assert_eq!(r.outcome, RepairOutcome::Closed);
        assert!(r.negative.is_none() && r.largest_change < 0.1, "{r:?}");
        for [a, b, c, d] in [[0, 1, 2, 3], [4, 9, 1, 11], [7, 2, 5, 0]] {
            // dG changes by +t on ab, -t on bc, +t on cd, -t on da; the slope must be 0.
            let ratio = |i: usize, j: usize| r.scale(i, j) - 1.0;
            let slope = ratio(a, b) - ratio(b, c) + ratio(c, d) - ratio(d, a);
            assert!(slope.abs() < 1e-14, "{slope}");
        }
        // Closed: so it is the lowest point among those that close.
        assert!(r.after.worst <= 1e-9 && r.before.worst > 1e-3);
    }

    #[test]
    fn a_noisy_cube_closes_and_stays_reciprocal() {
        // Cube: 0.1998 opposite, 0.2000 beside; each face cut into 20 rows that see alike, each
        // factor 10 % wrong, with rows of very unlike area.
        let n = 120;
        let areas: Vec<f64> = (0..n).map(|i| 0.01 + noise(i, i, 5)).collect();
        let face: Vec<f64> = (0..6)
            .map(|f| areas[20 * f..20 * f + 20].iter().sum())
            .collect();
        let g = |i: usize, j: usize| {
            let share = areas[i] * areas[j] / face[i / 20].max(face[j / 20]);
            let factor = match (i / 20).abs_diff(j / 20) {
                0 => 0.0,
                3 => 0.1998,
                _ => 0.2,
            };
            (factor * share * (0.9 + 0.2 * noise(i, j, 6))) as f32
        };
        let r = Stored::new(n, g).repair(&areas);
        assert_eq!(r.outcome, RepairOutcome::Closed, "{r:?}");
        assert!(r.after.worst <= 1e-9 && r.steps < 60, "{r:?}");
        for (i, j) in [(0, 30), (5, 119), (17, 64)] {
            assert_eq!(r.scale(i, j).to_bits(), r.scale(j, i).to_bits());
        }
    }

    #[test]
    fn two_plates_close_only_if_their_areas_are_alike() {
        let s = Stored::new(2, |i, j| if i == j { 0.0 } else { 0.5 });
        let r = s.repair(&[1.0, 1.0]);
        assert_eq!(r.outcome, RepairOutcome::Closed);
        // G must become 1.
        assert!((r.scale(0, 1) - 2.0).abs() < 1e-9);

        // Areas 1 and 2: both rows sum to 4/3, each off by a third of its area.
        let r = s.repair(&[1.0, 2.0]);
        let RepairOutcome::TwoSided {
            parts,
            closure_left,
        } = r.outcome
        else {
            panic!("{r:?}")
        };
        assert_eq!(parts, 1);
        assert!((closure_left - 1.0 / 3.0).abs() < 1e-12);
        assert!((r.after.worst - 1.0 / 3.0).abs() < 1e-8, "{r:?}");
        assert!((r.after.mean - 1.0 / 3.0).abs() < 1e-8, "{r:?}");
        assert!((0.5 * r.scale(0, 1) - 4.0 / 3.0).abs() < 1e-8);

        // One that also sees itself can take the rest.
        let s = Stored::new(2, |i, j| [[0.0, 0.5], [0.5, 0.1]][i][j]);
        let r = s.repair(&[1.0, 2.0]);
        assert_eq!(r.outcome, RepairOutcome::Closed);
        assert!((0.1f32 as f64 * r.scale(1, 1) - 1.0).abs() < 1e-8);
    }

    #[test]
    fn rows_without_entries_or_area_are_left_alone() {
        let guess = [[0.0, 0.8, 2.3], [0.8, 0.0, 2.7], [2.3, 2.7, 0.0]];
        let s = Stored::new(5, |i, j| if i.max(j) < 3 { guess[i][j] } else { 0.0 });
        let r = s.repair(&[3.0, 4.0, 5.0, 7.0, 0.0]);
        assert_eq!((r.outcome, r.left_alone), (RepairOutcome::Closed, 2));
        assert_eq!(r.multipliers[3..], [0.0, 0.0]);
        // Two rows that see a third of which nothing is asked: both close.
        let s = Stored::new(3, |i, j| if i == j { 0.0 } else { 0.5 });
        let r = s.repair(&[1.0, 2.0, 0.0]);
        assert_eq!((r.outcome, r.left_alone), (RepairOutcome::Closed, 1));
        assert!(r.after.worst <= 1e-9);
        let none = Stored::new(0, |_, _| 0.0).repair(&[]);
        assert_eq!((none.outcome, none.steps), (RepairOutcome::Closed, 0));
    }

    #[test]
    fn factors_that_would_be_negative_are_told() {
        // A_3 > A_1 + A_2 cannot be enclosed: G_12 = (1 + 1 - 3) / 2 = -0.5.
        let s = Stored::new(3, |i, j| if i == j { 0.0 } else { 1.0 });
        let r = s.repair(&[1.0, 1.0, 3.0]);
        assert_eq!(r.outcome, RepairOutcome::Closed);
        let negative = r.negative.expect("a negative pair");
        assert_eq!((negative.pairs, negative.worst_at), (1, [0, 1]));
        assert!((negative.worst_change + 1.5).abs() < 1e-8);
    }

    #[test]
    fn too_few_steps_are_told_and_threads_change_no_bit() {
        // A chain of rows, each seeing its neighbours and a little of itself: slow to solve.
        let n = 400;
        let s = Stored::new(n, |i, j| match i.abs_diff(j) {
            0 => 0.01,
            1 => (0.4 + 0.1 * noise(i, j, 3)) as f32,
            _ => 0.0,
        });
        let areas: Vec<f64> = (0..n)
            .map(|i| s.view().row(i).map(|e| e.1).sum::<f64>() * (0.99 + 0.02 * noise(i, i, 4)))
            .collect();
        let few = RepairSettings {
            most_steps: 3,
            ..Default::default()
        };
        let r = repair_closure(s.view(), &areas, few);
        let RepairOutcome::NotConverged { steps, residual } = r.outcome else {
            panic!("{r:?}")
        };
        assert_eq!(steps, 3);
        assert!((residual - r.after.worst).abs() < 1e-12 && r.after.worst <= r.before.worst);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            pool.build().expect("threads").install(|| s.repair(&areas))
        };
        let (one, four) = (on(1), on(4));
        assert_eq!(one, four);
        assert_eq!(one.outcome, RepairOutcome::Closed);
    }
}
