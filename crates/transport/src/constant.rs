//! Form factors that need no scene: F_ij = A_j / A, as in an integrating sphere.
//!
//! Inside a sphere the factor between any two patches is the receiver's share of the whole
//! area, wherever they are. So solvers can be tested against closed forms without geometry.
//!
//! Source: [Jacquez55].

use crate::contract::{Arrival, FactorRow, FormFactors, LocalLines};
use crate::sampling::Sequence;
use luxel_core::ElementId;
use std::ops::Range;

/// Patches of an integrating sphere. F_ii is not zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Constant {
    areas: Vec<f64>,
    /// Share of the area up to and including each patch, rising to 1.
    cumulative: Vec<f64>,
}

impl Constant {
    /// A sphere whose patches have these areas, m².
    ///
    /// Precondition: each is above zero.
    pub fn new(areas: Vec<f64>) -> Self {
        debug_assert!(areas.iter().all(|a| *a > 0.0));
        let whole: f64 = areas.iter().sum();
        let mut sum = 0.0;
        let mut cumulative: Vec<f64> = areas
            .iter()
            .map(|a| {
                sum += a;
                sum / whole
            })
            .collect();
        if let Some(last) = cumulative.last_mut() {
            *last = 1.0;
        }
        Constant { areas, cumulative }
    }

    /// Area of each patch, m².
    pub fn areas(&self) -> &[f64] {
        &self.areas
    }
}

impl FormFactors for Constant {
    fn len(&self) -> usize {
        self.areas.len()
    }

    fn row(&self, _element: ElementId, row: &mut FactorRow) {
        let whole: f64 = self.areas.iter().sum();
        row.entries.clear();
        row.entries.extend(
            self.areas
                .iter()
                .enumerate()
                .map(|(j, a)| (ElementId::from(j), a / whole)),
        );
        row.outside = 0.0;
    }
}

impl LocalLines for Constant {
    fn len(&self) -> usize {
        self.areas.len()
    }

    fn cast_each(&self, runs: &[(ElementId, Range<u32>)], seed: u32, arrivals: &mut Vec<Arrival>) {
        arrivals.clear();
        for (element, samples) in runs {
            let sequence = Sequence::new(seed, element.0);
            arrivals.extend(samples.clone().map(|k| {
                let u = sequence.point1(k);
                let j = self
                    .cumulative
                    .partition_point(|&c| c <= u)
                    .min(self.areas.len() - 1);
                Arrival::on(ElementId::from(j))
            }));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lines::FactorLines;

    #[test]
    fn rows_close_and_are_reciprocal() {
        // A_i A_j / A is symmetric and sums to A_i: rounding only.
        let sphere = Constant::new(vec![1.0, 2.0, 5.0]);
        let mut row = FactorRow::default();
        for i in 0..3 {
            sphere.row(ElementId(i), &mut row);
            assert!((row.closure() - 1.0).abs() < 1e-15);
            assert_eq!(row.entries[1].1, 0.25);
        }
    }

    #[test]
    fn lines_arrive_in_proportion_to_area() {
        // 4096 points stratified in 4096 intervals: each count is off by at most one at either
        // end of its interval. The same through the rows.
        let sphere = Constant::new(vec![1.0, 2.0, 5.0]);
        let through_rows = FactorLines::new(&sphere);
        let mut arrivals = Vec::new();
        for lines in [&sphere as &dyn LocalLines, &through_rows] {
            lines.cast(ElementId(1), 4096..8192, 5, &mut arrivals);
            for (j, share) in [0.125, 0.25, 0.625].iter().enumerate() {
                let n = arrivals
                    .iter()
                    .filter(|a| a.element() == Some(ElementId::from(j)))
                    .count();
                assert!((n as f64 - 4096.0 * share).abs() <= 2.0);
            }
        }
    }
}
