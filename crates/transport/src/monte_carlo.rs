//! Form factors counted from local lines, with their own standard error.
//!
//! F_ij is the share of lines from i that arrive on j: unbiased, occlusion included, no pair is
//! ever looked at. Lines of a low-discrepancy sequence do better than N^-1/2; the error is
//! judged from several independently scrambled batches, so it sees that gain.
//!
//! Sources: [Bekaert99], section 4.3; batches [Owen97].

use crate::contract::{Arrival, FactorRow, FormFactors, LocalLines};
use crate::sampling::hash;
use luxel_core::ElementId;

/// Independent batches that the error is judged from.
const BATCHES: u32 = 8;

/// Rows of form factors counted on demand, the same for the same seed.
pub struct MonteCarloFactors<'a> {
    lines: &'a dyn LocalLines,
    count: u32,
    seed: u32,
}

/// Error of a counted row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowError {
    /// Standard error of each entry of the row, in its order. At least one line's worth over
    /// the number of lines: counts cannot tell less.
    pub entries: Vec<f64>,
    /// Standard error of the share outside.
    pub outside: f64,
}

impl<'a> MonteCarloFactors<'a> {
    /// Rows from `count` lines an element (rounded up to a multiple of 8; 8 times a power of two
    /// is best spread).
    pub fn new(lines: &'a dyn LocalLines, count: u32, seed: u32) -> Self {
        MonteCarloFactors {
            lines,
            count: count
                .clamp(BATCHES, u32::MAX - BATCHES)
                .next_multiple_of(BATCHES),
            seed,
        }
    }

    /// Replaces `row` by the factors from `element` and returns their standard errors.
    pub fn row_with_error(&self, element: ElementId, row: &mut FactorRow) -> RowError {
        let each = self.count / BATCHES;
        // One sorted (arrival, batch) list: no table as long as the front.
        let mut all: Vec<(u32, u32)> = Vec::with_capacity(self.count as usize);
        let mut arrivals = Vec::new();
        for batch in 0..BATCHES {
            self.lines
                .cast(element, 0..each, hash([self.seed, batch]), &mut arrivals);
            all.extend(arrivals.iter().map(|&a| (key(a), batch)));
        }
        all.sort_unstable();
        row.entries.clear();
        row.outside = 0.0;
        let mut error = RowError {
            entries: Vec::new(),
            outside: 1.0 / self.count as f64,
        };
        for run in all.chunk_by(|a, b| a.0 == b.0) {
            let mut counts = [0.0_f64; BATCHES as usize];
            for &(_, batch) in run {
                counts[batch as usize] += 1.0;
            }
            let n = BATCHES as f64;
            let mean = run.len() as f64 / n;
            let spread = counts.iter().map(|c| (c - mean) * (c - mean)).sum::<f64>();
            let standard = (spread / (n * (n - 1.0))).sqrt() / each as f64;
            let share = mean / each as f64;
            let standard = standard.max(1.0 / self.count as f64);
            match run[0].0 {
                OUTSIDE => (row.outside, error.outside) = (share, standard),
                BLACK => {}
                e => {
                    row.entries.push((ElementId(e), share));
                    error.entries.push(standard);
                }
            }
        }
        error
    }
}

const OUTSIDE: u32 = u32::MAX;
const BLACK: u32 = u32::MAX - 1;

fn key(arrival: Arrival) -> u32 {
    match arrival.element() {
        Some(e) => e.0,
        None if arrival == Arrival::OUTSIDE => OUTSIDE,
        None => BLACK,
    }
}

impl FormFactors for MonteCarloFactors<'_> {
    fn len(&self) -> usize {
        self.lines.len()
    }

    fn row(&self, element: ElementId, row: &mut FactorRow) {
        self.row_with_error(element, row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Constant;
    use crate::lines::FrontLines;
    use crate::testing::{BruteForce, cube};

    /// Opposite faces of a cube [Howell10] C-11.
    const OPPOSITE: f64 = 0.199_824_895_698;

    fn factor(lines: &dyn LocalLines, count: u32, seed: u32, to: u32) -> (f64, f64) {
        let mut row = FactorRow::default();
        let error =
            MonteCarloFactors::new(lines, count, seed).row_with_error(ElementId(0), &mut row);
        let at = row
            .entries
            .iter()
            .position(|e| e.0 == ElementId(to))
            .expect("it is seen");
        (row.entries[at].1, error.entries[at])
    }

    #[test]
    fn mean_of_a_hundred_seeds_is_right_within_three_sigma() {
        // Unbiased but for the start of each line: points keep 1/1024 of an element off its
        // edges, which costs opposite faces less than 1e-4 and so stays below the noise here.
        let (scene, front) = cube(1);
        let caster = BruteForce::new(&scene);
        let lines = FrontLines::new(&scene, &front, &caster);
        let values: Vec<f64> = (0..100)
            .map(|seed| factor(&lines, 256, seed, 1).0)
            .collect();
        let mean = values.iter().sum::<f64>() / 100.0;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 99.0;
        let sigma = (variance / 100.0).sqrt();
        assert!((mean - OPPOSITE).abs() < 3.0 * sigma, "{mean} +- {sigma}");
        // The error it reports is the error it has, to a factor of 1.5 on average over seeds.
        let told = (0..100)
            .map(|seed| factor(&lines, 256, seed, 1).1.powi(2))
            .sum::<f64>()
            / 100.0;
        let ratio = (told / variance).sqrt();
        assert!(
            (0.66..1.5).contains(&ratio),
            "told over true error: {ratio}"
        );
    }

    #[test]
    fn error_falls_at_least_with_the_root_of_the_count() {
        // Root mean square error over 32 seeds at 64, 512 and 4096 lines: each factor of 8 gains
        // at least sqrt 8 (less 30 % for the spread of such an estimate, 1/sqrt(2 * 32) = 12 %).
        let (scene, front) = cube(1);
        let caster = BruteForce::new(&scene);
        let lines = FrontLines::new(&scene, &front, &caster);
        let rms = |count| {
            let sum: f64 = (0..32)
                .map(|seed| (factor(&lines, count, seed, 1).0 - OPPOSITE).powi(2))
                .sum();
            (sum / 32.0).sqrt()
        };
        let errors = [64, 512, 4096].map(rms);
        eprintln!("rms error at 64, 512, 4096 lines: {errors:?}");
        assert!(errors[0] / errors[1] > 0.7 * 8.0_f64.sqrt(), "{errors:?}");
        assert!(errors[1] / errors[2] > 0.7 * 8.0_f64.sqrt(), "{errors:?}");
    }

    #[test]
    fn rows_of_closed_scenes_close_exactly() {
        // Every line arrives somewhere: counts over their number.
        let sphere = Constant::new(vec![1.0, 2.0, 5.0]);
        let mut row = FactorRow::default();
        MonteCarloFactors::new(&sphere, 4096, 3).row(ElementId(2), &mut row);
        assert!((row.closure() - 1.0).abs() < 1e-12);
        assert!((row.entries[1].1 - 0.25).abs() < 2e-3);
    }
}
