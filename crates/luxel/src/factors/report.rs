//! The report beside a matrix of view factors: what was promised, what was measured.

use super::zones::{Table, Zones};
use super::{Asked, FactorsJob};
use crate::stage::{Clock, Stage};
use luxel_core::{Facets, SparseRows};
use luxel_io::Precision;
use luxel_transport::closure_repair::{Repair, RepairOutcome};
use luxel_transport::facets::{Counts, ExchangeMatrix};
use serde::Serialize;

/// Estimates of pieces come out low: the mean error of a row was 1.8 times what they add up to in
/// rooms with boxes (docs/view-factors.md).
const TOO_LOW: f64 = 2.0;

/// Errors of a row together may be this many times what was asked of a factor. Estimates are
/// only known added up, and those of a row are more than each of them: rooms with boxes, a town
/// and the Cornell box state 0.02 to 2.4 times what is asked from 1e-2 to 1e-5, where all factors
/// keep it. Far above lie scenes whose pairs were given up (docs/view-factors.md).
const ROW_PROMISE: f64 = 3.0;

/// All figures, in the order of the file. Areas in m², factors without unit, times in seconds.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FactorsReport {
    /// Name and version of the program.
    pub program: String,
    /// Name of the scene.
    pub scene: String,
    /// Rows of the scene.
    pub rows: usize,
    /// Convex parts that they are made of.
    pub parts: usize,
    /// Parts that only block.
    pub obstructions: usize,
    /// What stands in the way after merging; a solid counts once.
    pub blockers: usize,
    /// Area of all rows, m².
    pub area_m2: f64,
    /// Promise per factor.
    pub error_asked: f64,
    /// Mean over rows, by area, of the estimated error of a row's factors together.
    pub error_stated: f64,
    /// Whether it is small enough for what was asked.
    pub accuracy_met: bool,
    /// Whether all rows that were asked for are there.
    pub complete: bool,
    /// Rows that are there.
    pub finished_rows: usize,
    /// Factors above zero; not counted in a compressed matrix.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub entries: Option<u64>,
    /// |1 - sum over a row|, where a scene is closed: mean, and the largest.
    pub closure_mean: f64,
    /// Largest, and its row.
    pub closure_worst: f64,
    /// Row of it.
    pub closure_worst_row: usize,
    /// Largest sum over a row. Above 1 by no more than errors allow.
    pub row_sum_largest: f64,
    /// Largest |A_i F_ij - A_j F_ji| over the larger of both, as written; a compressed matrix has
    /// each pair once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reciprocity_worst: Option<f64>,
    /// Largest share that a row lost to --threshold.
    pub lost_worst: f64,
    /// Mean of it.
    pub lost_mean: f64,
    /// How pairs were settled.
    pub pairs: PairCounts,
    /// What a compressed matrix holds, and how good it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compressed: Option<CompressedReport>,
    /// Closure repair, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repair: Option<RepairReport>,
    /// Zones, where there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zones: Option<Vec<ZoneReport>>,
    /// Factors between zones: row by row, where rows are zones; null where rows are missing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zone_factors: Option<Vec<Option<Vec<f64>>>>,
    /// Wall seconds by stage.
    pub seconds: Vec<(String, f64)>,
    /// Processor seconds of all stages.
    pub cpu_seconds: f64,
    /// Largest memory of the process, bytes.
    pub memory_peak_bytes: u64,
    /// Size of the matrix as written.
    pub bytes: u64,
    /// What was odd in the input.
    pub warnings: Vec<String>,
    /// Sum of the factors of each row, where rows are facets or points.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub row_sum: Vec<f64>,
    /// Area of each row, m².
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub row_area_m2: Vec<f64>,
    /// Name of each row, if they have any.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub row_name: Vec<String>,
    #[serde(skip)]
    single: bool,
}

/// Pairs of convex parts by how they were settled.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PairCounts {
    /// Nothing between them.
    pub free: u64,
    /// In clusters that one blocker hides from each other.
    pub hidden_in_groups: u64,
    /// Something between them; worked out singly.
    pub shadowed: u64,
    /// Pieces that senders were cut into for those.
    pub pieces: u64,
    /// Points from which shadows were cut.
    pub points: u64,
}

/// A compressed matrix.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CompressedReport {
    /// Memory that it takes, bytes.
    pub memory_bytes: u64,
    /// Blocks of low rank.
    pub blocks: u64,
    /// Pairs of parts that they stand for.
    pub block_pairs: u64,
    /// Numbers in them.
    pub block_numbers: u64,
    /// Tiles of single entries.
    pub tiles: u64,
    /// Single entries: pairs of parts, each once.
    pub entries: u64,
    /// Wall time of one product.
    pub product_seconds: f64,
    /// Errors of a few products.
    pub product_errors: Vec<MeasuredProduct>,
}

/// Error of what rows receive, against rows that were computed singly; relative to the root mean
/// square over these rows.
#[derive(Clone, Debug, Default, Serialize)]
pub struct MeasuredProduct {
    /// What sends.
    pub source: String,
    /// Rows that were computed.
    pub rows: usize,
    /// Of the worst row.
    pub worst: f64,
    /// Root mean square over the rows.
    pub rms: f64,
}

/// What closure repair did.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RepairReport {
    /// `closed`, `two-sided` or `not converged`.
    pub outcome: String,
    /// Whether the factors as written are the repaired ones.
    pub applied: bool,
    /// Mean |1 - sum| before and after.
    pub closure_mean: [f64; 2],
    /// Largest |1 - sum| before and after.
    pub closure_worst: [f64; 2],
    /// Largest relative change of a factor.
    pub largest_change: f64,
    /// Largest sum over a row of the changes of its factors.
    pub largest_row_change: f64,
    /// Pairs that would have become negative; the repair is then not applied.
    pub negative_pairs: u64,
    /// Steps of the iteration.
    pub steps: u32,
}

/// A zone.
#[derive(Clone, Debug, Serialize)]
pub struct ZoneReport {
    /// Its name.
    pub name: String,
    /// Rows in it.
    pub rows: usize,
    /// Their area, m².
    pub area_m2: f64,
    /// Where rows are zones: whether all rows of this one are there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub complete: Option<bool>,
}

/// Zones up to which their factors are put into the report.
const FEW_ZONES: usize = 64;

impl FactorsReport {
    pub(super) fn new(job: &FactorsJob, facets: &Facets, asked: &Asked<'_>) -> FactorsReport {
        let obstructions = facets
            .parts
            .iter()
            .filter(|p| p.row == Facets::NO_ROW)
            .count();
        FactorsReport {
            program: format!("luxel {}", env!("CARGO_PKG_VERSION")),
            scene: facets.name.clone(),
            rows: facets.rows.len(),
            parts: facets.parts.len() - obstructions,
            obstructions,
            area_m2: facets.areas().iter().sum(),
            error_asked: asked.error,
            accuracy_met: true,
            single: job.precision == Some(Precision::Single),
            ..FactorsReport::default()
        }
    }

    /// How pairs were settled; `keep` says which rows are there, and with them the pairs that have
    /// at least one.
    pub(super) fn counts(&mut self, counts: &Counts, areas: &[f64], keep: &[bool]) {
        self.pairs = PairCounts {
            free: counts.free,
            hidden_in_groups: counts.hidden,
            shadowed: counts.shadowed,
            pieces: counts.pieces,
            points: counts.points,
        };
        let all: f64 = areas.iter().sum();
        let kept = areas.iter().zip(keep).filter(|a| *a.1).map(|a| a.0);
        let kept: f64 = kept.sum();
        // An error of G counts in both rows, if both are there: of pairs with at least one of a
        // share s, that is s / (2 - s).
        let rows = 2.0 / (2.0 - kept / all.max(f64::MIN_POSITIVE));
        if kept > 0.0 {
            self.error_stated = TOO_LOW * rows * counts.error / kept;
        }
        self.accuracy_met = self.error_stated <= ROW_PROMISE * self.error_asked;
    }

    /// What to say where the accuracy is not met.
    pub(super) fn doubt(&self) -> Option<String> {
        (!self.accuracy_met).then(|| {
            format!(
                "accuracy not met: errors of a row together are stated {:.1e} where {:e} was asked of each factor",
                self.error_stated, self.error_asked
            )
        })
    }

    /// Measures the matrix before any repair.
    pub(super) fn before(&mut self, matrix: &ExchangeMatrix, keep: &[bool], lost: &[f64]) {
        self.measure(matrix, keep);
        let kept = keep.iter().filter(|&&k| k).count().max(1) as f64;
        let losses = || lost.iter().zip(keep).filter(|l| *l.1).map(|l| *l.0);
        self.lost_mean = losses().sum::<f64>() / kept;
        self.lost_worst = losses().fold(0.0, f64::max);
    }

    fn measure(&mut self, matrix: &ExchangeMatrix, keep: &[bool]) {
        let written = |f: f64| if self.single { f as f32 as f64 } else { f };
        let (mut entries, mut reciprocity) = (0, 0.0_f64);
        let mut sums = matrix.row_sums();
        // What has no area has no sum to be off.
        let mut areas = matrix.areas.clone();
        for i in 0..keep.len() {
            if !keep[i] {
                (sums[i], areas[i]) = (0.0, 0.0);
                continue;
            }
            let run = matrix.offsets[i]..matrix.offsets[i + 1];
            entries += run.len() as u64;
            let a = matrix.areas[i];
            if a <= 0.0 {
                continue;
            }
            for k in run {
                let (j, g) = (matrix.columns[k] as usize, matrix.exchange[k] as f64);
                let b = matrix.areas[j];
                let (there, back) = (a * written(g / a), b * written(g / b));
                reciprocity = reciprocity.max((there - back).abs() / there.max(back));
            }
        }
        (self.entries, self.reciprocity_worst) = (Some(entries), Some(reciprocity));
        self.closure(sums, &areas);
    }

    /// What rows sum to; those without area do not count.
    pub(super) fn closure(&mut self, sums: Vec<f64>, areas: &[f64]) {
        (self.closure_mean, self.closure_worst, self.row_sum_largest) = (0.0, 0.0, 0.0);
        let mut counted = 0;
        for (i, &sum) in sums.iter().enumerate().filter(|s| areas[s.0] > 0.0) {
            let gap = (1.0 - sum).abs();
            self.closure_mean += gap;
            counted += 1;
            if gap > self.closure_worst {
                (self.closure_worst, self.closure_worst_row) = (gap, i);
            }
            self.row_sum_largest = self.row_sum_largest.max(sum);
        }
        self.closure_mean /= f64::from(counted.max(1));
        self.row_sum = sums;
    }

    pub(super) fn repaired(&mut self, repair: &Repair) {
        self.repair = Some(RepairReport {
            outcome: match &repair.outcome {
                RepairOutcome::Closed => "closed",
                RepairOutcome::TwoSided { .. } => "two-sided",
                RepairOutcome::NotConverged { .. } => "not converged",
            }
            .to_string(),
            applied: false,
            closure_mean: [repair.before.mean, repair.after.mean],
            closure_worst: [repair.before.worst, repair.after.worst],
            largest_change: repair.largest_change,
            largest_row_change: repair.largest_row_change,
            negative_pairs: repair.negative.as_ref().map_or(0, |n| n.pairs),
            steps: repair.steps,
        });
    }

    /// Measures the matrix as it is after the repair.
    pub(super) fn applied(&mut self, matrix: &ExchangeMatrix) {
        self.measure(matrix, &vec![true; matrix.areas.len()]);
        if let Some(repair) = &mut self.repair {
            repair.applied = true;
            repair.closure_mean[1] = self.closure_mean;
            repair.closure_worst[1] = self.closure_worst;
        }
    }

    pub(super) fn facets(&mut self, facets: &Facets, areas: &[f64]) {
        self.row_area_m2 = areas.to_vec();
        if facets.rows.iter().any(|r| !r.name.is_empty()) {
            self.row_name = facets.rows.iter().map(|r| r.name.clone()).collect();
        }
    }

    /// Factors to zones; from zones as well where `complete` says which have all their rows.
    pub(super) fn zones(
        &mut self,
        zones: &Zones,
        areas: &[f64],
        table: &Table,
        complete: Option<&[bool]>,
    ) {
        let zone_areas = zones.areas(areas);
        let list = zones.names.iter().enumerate().map(|(k, name)| ZoneReport {
            name: name.clone(),
            rows: zones.of.iter().filter(|&&z| z as usize == k).count(),
            area_m2: zone_areas[k],
            complete: complete.map(|c| c[k]),
        });
        self.zones = Some(list.collect());
        if let Some(complete) = complete {
            self.row_sum.clear();
            if zones.names.len() <= FEW_ZONES {
                let rows = dense(table).into_iter().zip(complete);
                self.zone_factors = Some(rows.map(|(row, &all)| all.then_some(row)).collect());
            }
        }
    }

    pub(super) fn points(&mut self, table: &Table, zones: Option<&Zones>, areas: &[f64]) {
        self.entries = Some(table.entries());
        let mut entries = Vec::new();
        for row in 0..table.shape()[0] {
            table.row(row, &mut entries);
            self.row_sum.push(entries.iter().map(|e| e.1).sum());
        }
        self.row_sum_largest = self.row_sum.iter().copied().fold(0.0, f64::max);
        if let Some(zones) = zones {
            self.zones(zones, areas, table, None);
        }
    }

    pub(super) fn seconds(&mut self, clock: &Clock) {
        let spent = |stage: &Stage| (stage.name().to_string(), clock.of(*stage).wall);
        self.seconds = Stage::ALL
            .iter()
            .map(spent)
            .filter(|(_, wall)| *wall > 0.0)
            .collect();
        self.cpu_seconds = Stage::ALL.iter().map(|&s| clock.of(s).cpu).sum();
    }

    /// A short table for people.
    pub fn table(&self) -> String {
        let mut out = String::new();
        let mut line = |name: &str, value: String| {
            out.push_str(&format!("{name:>22}  {value}\n"));
        };
        line(
            "facets",
            format!("{} ({} blockers after merging)", self.rows, self.blockers),
        );
        if let Some(entries) = self.entries {
            line("factors above zero", entries.to_string());
        }
        if let Some(c) = &self.compressed {
            line(
                "compressed",
                format!(
                    "{} blocks for {} pairs, {} single entries, {} MB",
                    c.blocks,
                    c.block_pairs,
                    c.entries,
                    c.memory_bytes / 1_000_000
                ),
            );
            for product in &c.product_errors {
                line(
                    "error of a product",
                    format!(
                        "{:.1e}, worst of {} rows: {}",
                        product.worst, product.rows, product.source
                    ),
                );
            }
        }
        if !self.row_area_m2.is_empty() || self.zone_factors.is_some() {
            line(
                "closure |1 - sum|",
                format!(
                    "mean {:.1e}, largest {:.1e} (row {})",
                    self.closure_mean, self.closure_worst, self.closure_worst_row
                ),
            );
            if let Some(defect) = self.reciprocity_worst {
                line("reciprocity defect", format!("{defect:.1e}"));
            }
            line(
                "error",
                format!(
                    "asked {:e}, stated {:.1e}{}",
                    self.error_asked,
                    self.error_stated,
                    if self.accuracy_met { "" } else { " (not met)" }
                ),
            );
        }
        line("largest row sum", format!("{:.7}", self.row_sum_largest));
        if self.lost_worst > 0.0 {
            line(
                "lost to threshold",
                format!(
                    "mean {:.1e}, largest {:.1e}",
                    self.lost_mean, self.lost_worst
                ),
            );
        }
        if let Some(repair) = &self.repair {
            line(
                "closure repair",
                format!(
                    "{}, {}: factors change by up to {:.1e} of themselves, rows by {:.1e}",
                    repair.outcome,
                    if repair.applied {
                        "applied"
                    } else {
                        "not applied"
                    },
                    repair.largest_change,
                    repair.largest_row_change
                ),
            );
        }
        if let (Some(zones), Some(factors)) = (&self.zones, &self.zone_factors)
            && zones.len() <= 12
        {
            let name = |z: &ZoneReport| z.name.chars().take(12).collect::<String>();
            let heads: String = zones.iter().map(|z| format!("{:>13}", name(z))).collect();
            out.push_str(&format!("\n{:>14}{heads}\n", "from \\ to"));
            for (zone, row) in zones.iter().zip(factors) {
                let cells = match row {
                    Some(row) => row.iter().map(|f| format!("{f:>13.7}")).collect(),
                    None => format!("{:>13}", "-").repeat(zones.len()),
                };
                out.push_str(&format!("{:>14}{cells}\n", name(zone)));
            }
            if factors.iter().any(Option::is_none) {
                out.push_str("             -  not all rows of this zone were computed\n");
            }
            out.push('\n');
        }
        let wall: f64 = self.seconds.iter().map(|s| s.1).sum();
        out.push_str(&format!(
            "{:>22}  {wall:.2} s, {:.2} processor seconds, {} MB\n",
            "time and memory",
            self.cpu_seconds,
            self.memory_peak_bytes / 1_000_000
        ));
        out
    }
}

fn dense(table: &Table) -> Vec<Vec<f64>> {
    let [rows, columns] = table.shape();
    let mut entries = Vec::new();
    (0..rows)
        .map(|row| {
            table.row(row, &mut entries);
            let mut out = vec![0.0; columns];
            entries.iter().for_each(|&(j, f)| out[j as usize] = f);
            out
        })
        .collect()
}
