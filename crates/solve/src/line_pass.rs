//! One pass of random lines: the incident flux that given exitance causes everywhere.
//!
//! Lines start on every element, n_i of them from i, and are sampled anew in each pass; nothing
//! is stored of them. With q_i = n_i / A_i the expected number of lines between i and j, started
//! at either, is A_i F_ij (q_i + q_j). So a line carries
//!
//! - B_i / (q_i + q_j) lm to j and B_j / (q_i + q_j) lm to i: both directions at once, which is
//!   the balance heuristic over the two ways of finding it;
//! - M_out / q_i lm to i, if it left the scene, which only i can find.
//!
//! Every line from i ends somewhere, so what arrives can be measured against any level h_i:
//! A_i H_i = A_i h_i + sum over lines of (X - h_i) / (q_i + q_j), with X = 0 on black. This
//! control variate removes the noise of the number of lines that happen to arrive; what is left
//! is the variation of X over the half space of i.
//!
//! Each pass has a seed of its own. To go on in one sequence would make passes depend on each
//! other: what pass k sees too often, pass k + 1 sees too rarely, and light that returns over
//! the same pair of elements is lost (measured: 0.1 % of the incident flux with 40 elements).
//!
//! Deterministic: the pairs of a pass are binned by receiver and added in the order of their
//! senders, so there are no atomics, no overflow, and the same bits for any thread count.
//!
//! Sources: [Bekaert99], chapter 6 (stochastic Jacobi, bidirectional transfer, constant control
//! variates); [Veach95] (balance heuristic).

use crate::contract::Problem;
use crate::photometry::{reflectance, sum_over, weight};
use luxel_core::ElementId;
use luxel_core::layers::BANDS;
use luxel_transport::sampling::hash;
use luxel_transport::{Arrival, LocalLines, of_each};
use rayon::prelude::*;

/// Lines of one task. Independent of the thread count, or bits would depend on it.
const CHUNK_LINES: u64 = 1 << 15;

/// Elements of one task, however few lines they have.
const CHUNK_ELEMENTS: usize = 1 << 14;

/// Bytes of accumulators that one receiving task keeps close.
const BIN_BYTES: usize = 1 << 16;

/// How many lines start on each element.
///
/// Kept between passes to reuse memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct LinePlan {
    /// Lines of this pass.
    count: Vec<u32>,
    /// Expected lines per area, q_i, 1/m².
    density: Vec<f32>,
    /// Exitance of each element and its density behind it: what a line needs of its far end, in
    /// one place of memory.
    ends: Vec<f32>,
}

/// Level that arrivals are measured against.
#[derive(Clone, Copy)]
pub(crate) enum Level<'a> {
    /// The same for all elements, one a column.
    Everywhere(&'a [f32]),
    /// Incident flux per area as known so far, element-major.
    Incident(&'a [f32]),
}

/// What a pass sends.
#[derive(Clone, Copy)]
pub(crate) struct Sent<'a> {
    /// Exitance, element-major, lm/m², signed.
    pub exitance: &'a [f32],
    /// Exitance of the outside, one a column.
    pub outside: &'a [f32],
    /// Level to measure against.
    pub level: Level<'a>,
}

/// Area-weighted mean of each column.
pub(crate) fn mean(area: &[f64], values: &[f32], columns: usize) -> Vec<f32> {
    let sum = sum_over(area.len(), columns + 1, |i, sum| {
        sum[columns] += area[i];
        for (s, v) in sum.iter_mut().zip(&values[i * columns..(i + 1) * columns]) {
            *s += area[i] * *v as f64;
        }
    });
    let whole = sum[columns];
    sum[..columns]
        .iter()
        .map(|s| if whole > 0.0 { (s / whole) as f32 } else { 0.0 })
        .collect()
}

impl LinePlan {
    /// Distributes about `lines` lines.
    ///
    /// Half by what elements receive: n_i ~ sqrt(A_i) max(rho_i, 0.1), which makes the
    /// area-weighted error least when the half spaces look equally varied. Half by what they
    /// send: A_i |B_i - mean|, summed over groups after each was scaled to the same whole, so
    /// that a dim group is served as well.
    ///
    /// Both are weighted with the importance of the element, if the problem has some.
    ///
    /// Counts are powers of two, and at least expected to be above zero on every element.
    pub fn distribute(&mut self, problem: &Problem<'_>, sent: &Sent<'_>, lines: u64, seed: u32) {
        let columns = problem.columns();
        let groups = columns / BANDS;
        let n = problem.len();
        let level = mean(problem.area, sent.exitance, columns);
        let deviation = |row: &[f32], g: usize| -> f64 {
            (BANDS * g..BANDS * (g + 1))
                .map(|k| weight(k) * (row[k] - level[k]).abs() as f64)
                .sum()
        };
        // Least is the error that matters with the root of the importance of what receives.
        let receives = |i: usize| -> f64 {
            let matters = problem.importance_of(i).sqrt();
            problem.area[i].sqrt() * reflectance(problem, i).max(0.1) * matters
        };

        let row = |i: usize| &sent.exitance[i * columns..(i + 1) * columns];
        let whole = sum_over(n, groups + 1, |i, sum| {
            for g in 0..groups {
                sum[g] += problem.importance_of(i) * problem.area[i] * deviation(row(i), g);
            }
            sum[groups] += receives(i);
        });
        let (whole, receiving) = (&whole[..groups], whole[groups]);
        let lit = whole.iter().filter(|w| **w > 0.0).count();
        let (by_receiving, by_sending) = if lit > 0 {
            (0.5, 0.5 / lit as f64)
        } else {
            (1.0, 0.0)
        };

        self.count.resize(n, 0);
        self.density.resize(n, 0.0);
        self.count
            .par_iter_mut()
            .zip(&mut self.density)
            .enumerate()
            .for_each(|(i, (count, q))| {
                let area = problem.area[i];
                if area <= 0.0 {
                    (*count, *q) = (0, 0.0);
                    return;
                }
                let sends: f64 = (0..groups)
                    .filter(|&g| whole[g] > 0.0)
                    .map(|g| problem.importance_of(i) * area * deviation(row(i), g) / whole[g])
                    .sum();
                let share = by_receiving * receives(i) / receiving + by_sending * sends;
                let expected = lines as f64 * share;
                let effective = if expected >= 1.0 {
                    // Nearest power of two: whole nets of the sequence are worth more than the
                    // exact number.
                    *count = 1 << (expected.log2().round() as u32).min(24);
                    *count as f64
                } else {
                    let dice = hash([seed, i as u32]) as f64 / (1u64 << 32) as f64;
                    *count = (dice < expected) as u32;
                    expected
                };
                *q = (effective / area) as f32;
            });
    }

    /// Casts the lines of the plan, the first of the sequences of `seed`. Replaces `incident` by the incident flux per area, lm/m²,
    /// and returns how many lines there were.
    pub fn cast(
        &mut self,
        problem: &Problem<'_>,
        lines: &dyn LocalLines,
        sent: &Sent<'_>,
        seed: u32,
        incident: &mut Vec<f32>,
    ) -> u64 {
        let columns = problem.columns();
        incident.clear();
        incident.resize(problem.len() * columns, 0.0);
        self.ends.resize(problem.len() * (columns + 1), 0.0);
        self.ends
            .par_chunks_mut(columns + 1)
            .zip(sent.exitance.par_chunks(columns))
            .zip(&self.density)
            .for_each(|((end, row), q)| {
                end[..columns].copy_from_slice(row);
                end[columns] = *q;
            });
        let cast = match columns {
            3 => self.accumulate::<3>(lines, sent, columns, seed, incident),
            _ => self.accumulate::<0>(lines, sent, columns, seed, incident),
        };
        incident
            .par_chunks_mut(columns)
            .enumerate()
            .for_each(|(i, row)| {
                let area = problem.area[i] as f32;
                for (v, h) in row.iter_mut().zip(sent.level.of(i, columns)) {
                    *v = if area > 0.0 { h + *v / area } else { 0.0 };
                }
            });
        cast
    }

    /// Adds (X - h) w over the lines of each element to `sums`, which are zero. `C` is the
    /// number of columns when known at compile time, else 0.
    ///
    /// Differences are summed, not X and h apart: a thousand equal terms would drift in `f32`.
    fn accumulate<const C: usize>(
        &self,
        lines: &dyn LocalLines,
        sent: &Sent<'_>,
        columns: usize,
        seed: u32,
        sums: &mut [f32],
    ) -> u64 {
        let columns = if C > 0 { C } else { columns };
        let (ends, count) = (&self.ends[..], &self.count[..]);
        let n = count.len();
        let bin = (BIN_BYTES / (8 * columns))
            .next_power_of_two()
            .clamp(256, 1 << 14);
        let shift = bin.trailing_zeros();
        let bins = n.div_ceil(bin);
        let black = vec![0.0; columns];

        // Senders: each task owns a run of elements and their sums.
        let mut tasks = Vec::new();
        {
            let mut sums = &mut *sums;
            let mut first = 0;
            while first < n {
                let mut load = 0;
                let mut end = first;
                while end < n && end - first < CHUNK_ELEMENTS && load < CHUNK_LINES {
                    load += count[end] as u64;
                    end += 1;
                }
                let own;
                (own, sums) = sums.split_at_mut((end - first) * columns);
                tasks.push((first, own));
                first = end;
            }
        }
        let sorted: Vec<Binned> = tasks
            .into_par_iter()
            .map(|(first, sums)| {
                let runs: Vec<_> = (first..first + sums.len() / columns)
                    .filter(|&i| count[i] > 0)
                    .map(|i| (ElementId::from(i), 0..count[i]))
                    .collect();
                let mut arrivals = Vec::new();
                lines.cast_each(&runs, seed, &mut arrivals);
                let mut pairs = Vec::with_capacity(arrivals.len());
                for (ElementId(i), own) in of_each(&runs, &arrivals) {
                    let at = (i as usize - first) * columns;
                    let sum = &mut sums[at..at + columns];
                    let level = sent.level.of(i as usize, columns);
                    let (_, q) = end::<C>(ends, i as usize, columns);
                    for &arrival in own {
                        if let Some(ElementId(j)) = arrival.element() {
                            let (row, far) = end::<C>(ends, j as usize, columns);
                            add::<C>(sum, row, level, 1.0 / (q + far));
                            pairs.push((i, j));
                        } else {
                            let outside = arrival == Arrival::OUTSIDE;
                            let seen = if outside { sent.outside } else { &black };
                            add::<C>(sum, seen, level, 1.0 / q);
                        }
                    }
                }
                Binned::new(&pairs, shift, bins, arrivals.len() as u64)
            })
            .collect();

        // Receivers: each task owns a bin and takes the senders in their order.
        sums.par_chunks_mut(bin * columns)
            .enumerate()
            .for_each(|(b, sums)| {
                for &(i, j) in sorted.iter().flat_map(|s| s.of(b)) {
                    let (row, far) = end::<C>(ends, i as usize, columns);
                    let (_, q) = end::<C>(ends, j as usize, columns);
                    let level = sent.level.of(j as usize, columns);
                    let at = (j as usize - b * bin) * columns;
                    add::<C>(&mut sums[at..at + columns], row, level, 1.0 / (q + far));
                }
            });
        sorted.iter().map(|s| s.lines).sum()
    }
}

impl<'a> Level<'a> {
    #[inline(always)]
    fn of(self, i: usize, columns: usize) -> &'a [f32] {
        match self {
            Level::Everywhere(h) => h,
            Level::Incident(h) => &h[i * columns..(i + 1) * columns],
        }
    }
}

/// Exitance and density of an element.
#[inline(always)]
fn end<const C: usize>(ends: &[f32], i: usize, columns: usize) -> (&[f32], f32) {
    let columns = if C > 0 { C } else { columns };
    let end = &ends[i * (columns + 1)..(i + 1) * (columns + 1)];
    (&end[..columns], end[columns])
}

#[inline(always)]
fn add<const C: usize>(sum: &mut [f32], values: &[f32], level: &[f32], w: f32) {
    if C > 0 {
        let (sum, values, level) = (&mut sum[..C], &values[..C], &level[..C]);
        for k in 0..C {
            sum[k] += (values[k] - level[k]) * w;
        }
    } else {
        for ((s, v), h) in sum.iter_mut().zip(values).zip(level) {
            *s += (v - h) * w;
        }
    }
}

/// Pairs of one task, sorted by the bin of the receiver, in the order of the senders within.
struct Binned {
    pairs: Vec<(u32, u32)>,
    offsets: Vec<u32>,
    lines: u64,
}

impl Binned {
    fn new(pairs: &[(u32, u32)], shift: u32, bins: usize, lines: u64) -> Self {
        let mut offsets = vec![0u32; bins + 1];
        for (_, j) in pairs {
            offsets[(j >> shift) as usize + 1] += 1;
        }
        for b in 0..bins {
            offsets[b + 1] += offsets[b];
        }
        let mut at = offsets.clone();
        let mut sorted = vec![(0, 0); pairs.len()];
        for &pair in pairs {
            let slot = &mut at[(pair.1 >> shift) as usize];
            sorted[*slot as usize] = pair;
            *slot += 1;
        }
        Binned {
            pairs: sorted,
            offsets,
            lines,
        }
    }

    fn of(&self, bin: usize) -> &[(u32, u32)] {
        &self.pairs[self.offsets[bin] as usize..self.offsets[bin + 1] as usize]
    }
}
