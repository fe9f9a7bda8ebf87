//! View factors of a scene file: read, computed, repaired if asked, written with a report.
//!
//! - `batches`: the work in batches, kept in `OUTPUT.part` beside the output
//! - `compressed`: the end of a run with a compressed matrix
//! - [`zones`]: facets taken together
//! - [`report`]: what was promised, what was measured

mod batches;
mod compressed;
pub mod report;
pub mod zones;

use crate::error::Error;
use crate::spare::replaced;
use crate::stage::{Clock, Stage, peak_memory_bytes};
use crate::watch::{Control, Status, Watch, enter};
use luxel_core::{DVec3, Facets, SparseRows, Warnings};
use luxel_io::{FacetDocument, FacetOptions, FactorFormat, Precision, read_facets, write_factors};
use luxel_transport::closure_repair::{ExchangeAreas, Repair, RepairSettings, repair_closure};
use luxel_transport::facets::{Batch, ExchangeMatrix, FacetFactors, FacetSettings, Triplet};
use rayon::prelude::*;
use report::FactorsReport;
use std::ops::Range;
use std::path::{Path, PathBuf};
use zones::{Table, ZoneWishes, Zones, name_of};

/// Rows that miss 1 by more than this on the mean, or a factor that would change by more than
/// that share of itself, are no errors of closed scenes.
const MOST_GAP: f64 = 0.02;
const MOST_CHANGE: f64 = 0.1;

/// A row may sum to 1 and this many times the promise.
const MOST_ABOVE: f64 = 20.0;

/// What to compute and where to put it.
#[derive(Clone, Debug)]
pub struct FactorsJob {
    /// Scene file: STL, PLY, OBJ, glTF or VS3.
    pub scene: PathBuf,
    /// File to write, `.npz`, `.csv` or `.mtx`; `None` is `SCENE.factors.npz` beside the scene.
    pub output: Option<PathBuf>,
    /// Metres for each unit of the file.
    pub scale: f64,
    /// Whether to turn every facet over.
    pub flip: bool,
    /// Promise per factor; `None` is 1e-4, or what a VS3 file asks.
    pub error: Option<f64>,
    /// Rows that are wanted; `None` is all, or what a VS3 file asks.
    pub rows: Option<Range<u32>>,
    /// Factors below this are left out, and what is lost is reported.
    pub threshold: f64,
    /// Facets taken together.
    pub zones: ZoneWishes,
    /// Whether rows stay facets where columns are zones.
    pub to_zones: bool,
    /// Points to compute factors from, instead of from facets.
    pub points: Option<Vec<FactorPoint>>,
    /// Files that must not be replaced, besides the scene.
    pub spared: Vec<PathBuf>,
    /// Whether to repair closure: the scene is closed.
    pub enclosed: bool,
    /// Whether to keep blocks of low rank instead of all factors: for scenes whose factors do not
    /// fit into memory. All rows between facets, as `.npz`.
    pub compressed: bool,
    /// Whether to go on with work that was stopped.
    pub resume: bool,
    /// How numbers are stored; `None` is double.
    pub precision: Option<Precision>,
    /// Most memory to use, bytes.
    pub memory: u64,
}

/// A point to compute factors from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FactorPoint {
    /// Place, metres, in the coordinates of the scene after scaling.
    pub position: DVec3,
    /// Unit normal.
    pub normal: DVec3,
}

/// What came of it.
#[derive(Debug)]
pub struct FactorsOutcome {
    /// The matrix as written.
    pub output: PathBuf,
    /// The report beside it.
    pub report_path: PathBuf,
    /// What it says.
    pub report: FactorsReport,
    /// What was odd in the input.
    pub warnings: Warnings,
    /// Whether all that was asked is there. How accurate it is, is in the report.
    pub complete: bool,
    /// Where work is kept that a later run can go on with.
    pub kept_in: Option<PathBuf>,
}

/// Computes and writes the view factors of a scene file. `watch` is told of every step and may
/// stop the work, which then ends with the rows that are finished.
pub fn factors(job: &FactorsJob, watch: &mut Watch<'_>) -> Result<FactorsOutcome, Error> {
    let mut clock = Clock::start();
    enter(watch, &Status::begin(Stage::Read))?;
    let output = job
        .output
        .clone()
        .unwrap_or_else(|| job.scene.with_extension("factors.npz"));
    let format = FactorFormat::of(&output).map_err(|e| Error::Setting(e.to_string()))?;
    if job.compressed {
        if let Some(name) = incompatible(job) {
            return Err(Error::Setting(format!(
                "--compressed: expected all rows between facets, without {name}, found {name}"
            )));
        }
        if format != FactorFormat::Npz {
            return Err(Error::Setting(format!(
                "--compressed: expected an output that ends in .npz, found {}",
                output.display()
            )));
        }
    }
    let read: Vec<PathBuf> = [&job.scene]
        .into_iter()
        .chain(&job.spared)
        .cloned()
        .collect();
    let written = [output.clone(), report_path(&output)];
    if let Some(path) = replaced(&read, &written) {
        return Err(Error::Setting(format!(
            "{}: expected an output that does not replace what is read",
            path.display()
        )));
    }
    if job.points.as_ref().is_some_and(Vec::is_empty) {
        return Err(Error::Setting(
            "--points: expected at least one point, found none".into(),
        ));
    }
    // Before the work, not after it.
    for path in &written {
        luxel_io::atomic::try_place(path).map_err(|source| Error::Write {
            path: path.clone(),
            source,
        })?;
    }
    let options = FacetOptions {
        scale: job.scale,
        flip: job.flip,
        memory: job.memory,
    };
    let mut document = read_facets(&job.scene, &options)?;
    let asked = Asked::new(job, &mut document)?;
    let facets = &document.facets;
    let zones = Zones::new(facets, &job.zones).map_err(Error::Setting)?;
    if job.to_zones && zones.is_none() {
        return Err(Error::Setting(
            "--to-zones: expected zones as well, by --by or --group".into(),
        ));
    }
    let doubt = zones.as_ref().and_then(|z| z.doubt(facets, job.zones.by));
    if let Some(what) = doubt {
        document.warnings.add(facets.name.clone(), what, 1);
    }
    clock.end(Stage::Read);
    enter(watch, &Status::begin(Stage::Prepare))?;
    let settings = FacetSettings {
        error: asked.error,
        rows: asked.rows.clone(),
    };
    let work = FacetFactors::new(facets, &settings);
    clock.end(Stage::Prepare);

    let mut report = FactorsReport::new(job, facets, &asked);
    report.blockers = work.blockers();
    if let Some(points) = &job.points {
        return from_points(
            job, &document, &work, points, zones, report, clock, &output, watch,
        );
    }
    let part = part_path(&output);
    if job.compressed {
        let places = [&*output, &*part];
        return compressed::compressed(&asked, document, &work, report, clock, places, watch);
    }
    let FacetDocument {
        facets, warnings, ..
    } = &mut document;
    let mut found = batches::compute::<Batch>(facets, &work, &asked, &part, warnings, watch)?;
    clock.end(Stage::Factors);
    watch(&Status::begin(Stage::Write));
    found.keep_rest(&work);
    found.say(warnings);

    let done = found.batches.len();
    let finished = work.finished(done);
    let keep: Vec<bool> = finished
        .iter()
        .enumerate()
        .map(|(row, &done)| done && asked.rows.contains(&(row as u32)))
        .collect();
    let complete = done == work.batches();
    let areas = facets.areas();
    let precision = job.precision.unwrap_or(Precision::Double);
    let mut lost = vec![0.0; areas.len()];
    let mut matrix = assembled(&areas, &found.batches, job.threshold, &mut lost);
    report.counts(&found.counts, &areas, &keep);
    report.before(&matrix, &keep, &lost);
    if let Some(what) = report.doubt() {
        document.warnings.add(document.facets.name.clone(), what, 1);
    }
    if asked.enclosed && !(complete && asked.all_rows(areas.len())) {
        let what = "closure is not repaired: that takes all rows";
        document.warnings.add(document.facets.name.clone(), what, 1);
    } else if asked.enclosed {
        let repair = repair(&matrix);
        report.repaired(&repair);
        let open = repair.before.mean > MOST_GAP || repair.largest_change > MOST_CHANGE;
        if repair.negative.is_some() || open {
            let (gap, row) = (repair.before.worst, repair.before.worst_at.unwrap_or(0));
            let row = named_row(&document.facets, row as usize);
            let what = format!(
                "closure is not repaired: the scene is not closed, {row} misses 1 by {gap:.3}"
            );
            document.warnings.add(document.facets.name.clone(), what, 1);
        } else {
            apply(&mut matrix, &repair);
            report.applied(&matrix);
        }
    }
    if report.row_sum_largest > 1.0 + MOST_ABOVE * asked.error {
        let most = report.row_sum_largest;
        let row = report.row_sum.iter().position(|&sum| sum == most);
        let row = named_row(&document.facets, row.unwrap_or(0));
        let what = format!(
            "{row} sums to {most:.4}: do facets lie in one another, or twice in one place?"
        );
        document.warnings.add(document.facets.name.clone(), what, 1);
    }
    let facets = &document.facets;
    let kept = Kept {
        matrix: &matrix,
        keep: &keep,
    };
    report.bytes = match &zones {
        None => {
            report.facets(facets, &areas);
            found.write(&work, complete, || {
                write_factors(&output, &kept, &areas, precision)
            })?
        }
        Some(zones) => {
            let table = Table::of_zones(&kept, &areas, zones, !job.to_zones, &keep);
            let whole = zones.complete(&keep);
            let empty = whole.iter().filter(|&&w| !w).count();
            if !job.to_zones {
                let what = "zones are left empty: not all their rows were computed";
                document.warnings.add(facets.name.clone(), what, empty);
            }
            report.zones(zones, &areas, &table, (!job.to_zones).then_some(&whole));
            let row_areas = if job.to_zones {
                areas.clone()
            } else {
                zones.areas(&areas)
            };
            if job.to_zones {
                report.facets(facets, &areas);
            }
            found.write(&work, complete, || {
                write_factors(&output, &table, &row_areas, precision)
            })?
        }
    };
    report.complete = complete;
    report.finished_rows = keep.iter().filter(|&&k| k).count();
    if complete {
        found.remove()?;
    }
    let report_path = finish(&mut report, &document.warnings, &mut clock, &output)?;
    let kept_in = found.kept_in().map(Path::to_owned);
    Ok(FactorsOutcome {
        output,
        report_path,
        report,
        warnings: document.warnings,
        complete,
        kept_in,
    })
}

/// A row in words, with the names that it has: `row 7 (facet 'sill', object 'window')`.
fn named_row(facets: &Facets, row: usize) -> String {
    let facet = &facets.rows[row];
    let names = [
        ("facet", &*facet.name),
        ("object", name_of(&facets.objects, facet.object)),
        ("material", name_of(&facets.materials, facet.material)),
    ];
    let named = names.iter().filter(|n| !n.1.is_empty());
    let names: Vec<String> = named
        .map(|(what, name)| format!("{what} '{name}'"))
        .collect();
    match names.is_empty() {
        true => format!("row {row}"),
        false => format!("row {row} ({})", names.join(", ")),
    }
}

/// The option that does not go with a compressed matrix, if there is one.
fn incompatible(job: &FactorsJob) -> Option<&'static str> {
    [
        (job.rows.is_some(), "--rows"),
        (job.threshold > 0.0, "--threshold"),
        (job.enclosed, "--enclosed"),
        (job.zones.by.is_some(), "--by"),
        (!job.zones.groups.is_empty(), "--group"),
        (job.to_zones, "--to-zones"),
        (job.points.is_some(), "--points"),
        (job.precision.is_some(), "--precision"),
    ]
    .into_iter()
    .find_map(|(asked, name)| asked.then_some(name))
}

/// What a job and its file ask for together.
pub(crate) struct Asked<'a> {
    pub(crate) job: &'a FactorsJob,
    pub(crate) error: f64,
    pub(crate) rows: Range<u32>,
    pub(crate) enclosed: bool,
}

impl<'a> Asked<'a> {
    fn new(job: &'a FactorsJob, document: &mut FacetDocument) -> Result<Asked<'a>, Error> {
        let place = document.facets.name.clone();
        let number = |document: &FacetDocument, name: &str| {
            document.control(name).and_then(|v| v.parse::<f64>().ok())
        };
        let count = document.facets.rows.len() as u32;
        let all = 0..count;
        let of_file = number(document, "row").filter(|&row| row >= 1.0);
        let rows = match (&job.rows, of_file) {
            (Some(rows), _) => {
                let open = rows.end == u32::MAX;
                if rows.start >= count || (rows.end > count && !open) {
                    let end = if open {
                        String::new()
                    } else {
                        rows.end.to_string()
                    };
                    return Err(Error::Setting(format!(
                        "--rows: expected rows below {count}, found {}..{end}",
                        rows.start
                    )));
                }
                rows.start..rows.end.min(count)
            }
            (None, Some(row)) if row > count as f64 => {
                return Err(Error::Setting(format!(
                    "{}: row: expected a row from 1 to {count}, found {row}",
                    job.scene.display()
                )));
            }
            (None, Some(row)) if !job.compressed => (row as u32 - 1)..(row as u32),
            _ => all,
        };
        for (name, what) in [
            (
                "emit",
                "emit=1 asks for factors with reflections; those of black surfaces are written",
            ),
            ("col", "col asks for one column; all columns are written"),
        ] {
            if number(document, name).is_some_and(|v| v > 0.0) {
                document.warnings.add(place.clone(), what, 1);
            }
        }
        if job.compressed && of_file.is_some() {
            let what = "row asks for one row; --compressed takes all";
            document.warnings.add(place.clone(), what, 1);
        }
        if job.compressed && document.enclosed {
            let what = "encl=1 asks for rows that sum to 1; --compressed does not repair closure";
            document.warnings.add(place, what, 1);
        }
        Ok(Asked {
            job,
            error: job
                .error
                .or(number(document, "eps").map(|e| e.clamp(1e-8, 0.1)))
                .unwrap_or(1e-4),
            rows,
            enclosed: job.enclosed || document.enclosed,
        })
    }

    fn all_rows(&self, rows: usize) -> bool {
        self.rows == (0..rows as u32)
    }

    /// What would have to be given up for a compressed matrix.
    pub(crate) fn not_compressed(&self) -> Option<&'static str> {
        incompatible(self.job)
            .filter(|&name| name != "--precision")
            .or((self.enclosed).then_some("encl=1"))
    }
}

/// The matrix without factors that are below the threshold in both directions.
fn assembled(areas: &[f64], batches: &[Batch], threshold: f64, lost: &mut [f64]) -> ExchangeMatrix {
    let all = batches.iter().flat_map(|b| b.found.iter().copied());
    if threshold <= 0.0 {
        return ExchangeMatrix::new(areas, all);
    }
    let matters = |t: &Triplet| {
        let least = areas[t.row as usize].min(areas[t.column as usize]);
        t.exchange as f64 >= threshold * least
    };
    for t in all.clone().filter(|t| !matters(t)) {
        let (i, j) = (t.row as usize, t.column as usize);
        lost[i] += t.exchange as f64 / areas[i];
        if i != j {
            lost[j] += t.exchange as f64 / areas[j];
        }
    }
    ExchangeMatrix::new(areas, all.filter(matters))
}

fn repair(matrix: &ExchangeMatrix) -> Repair {
    let exchange = ExchangeAreas {
        offsets: &matrix.offsets,
        columns: &matrix.columns,
        values: &matrix.exchange,
    };
    repair_closure(exchange, &matrix.areas, RepairSettings::default())
}

fn apply(matrix: &mut ExchangeMatrix, repair: &Repair) {
    for i in 0..matrix.areas.len() {
        for k in matrix.offsets[i]..matrix.offsets[i + 1] {
            let j = matrix.columns[k] as usize;
            matrix.exchange[k] = (matrix.exchange[k] as f64 * repair.scale(i, j)) as f32;
        }
    }
}

/// The rows of a matrix that are complete and wanted; others are empty.
struct Kept<'a> {
    matrix: &'a ExchangeMatrix,
    keep: &'a [bool],
}

impl SparseRows for Kept<'_> {
    fn shape(&self) -> [usize; 2] {
        self.matrix.shape()
    }

    fn entries(&self) -> u64 {
        (0..self.keep.len())
            .filter(|&i| self.keep[i])
            .map(|i| (self.matrix.offsets[i + 1] - self.matrix.offsets[i]) as u64)
            .sum()
    }

    fn row(&self, row: usize, entries: &mut Vec<(u32, f64)>) {
        if self.keep[row] {
            self.matrix.row(row, entries);
        } else {
            entries.clear();
        }
    }
}

/// Factors from points: one row a point, to facets or zones.
fn from_points(
    job: &FactorsJob,
    document: &FacetDocument,
    work: &FacetFactors,
    points: &[FactorPoint],
    zones: Option<Zones>,
    mut report: FactorsReport,
    mut clock: Clock,
    output: &Path,
    watch: &mut Watch<'_>,
) -> Result<FactorsOutcome, Error> {
    const CHUNK: usize = 256;
    let mut rows: Vec<Vec<(u32, f64)>> = Vec::with_capacity(points.len());
    let mut complete = true;
    for chunk in points.chunks(CHUNK) {
        let status = Status {
            share: rows.len() as f64 / points.len() as f64,
            ..Status::begin(Stage::Factors)
        };
        if watch(&status) == Control::Stop {
            complete = false;
            break;
        }
        rows.par_extend(chunk.par_iter().map(|point| {
            let found = work.from_point(point.position, point.normal);
            match &zones {
                None => found,
                Some(zones) => {
                    let mut sums = vec![0.0; zones.names.len()];
                    for (row, f) in found {
                        sums[zones.of[row as usize] as usize] += f;
                    }
                    let all = sums.iter().enumerate().filter(|(_, f)| **f > 0.0);
                    all.map(|(zone, &f)| (zone as u32, f)).collect()
                }
            }
        }));
    }
    clock.end(Stage::Factors);
    report.finished_rows = rows.len();
    rows.resize(points.len(), Vec::new());
    let columns = zones
        .as_ref()
        .map_or(document.facets.rows.len(), |z| z.names.len());
    let table = Table::new(columns, rows);
    report.points(&table, zones.as_ref(), &document.facets.areas());
    // A point has no area.
    let areas = vec![0.0; points.len()];
    let precision = job.precision.unwrap_or(Precision::Double);
    report.bytes = write_factors(output, &table, &areas, precision)?;
    report.complete = complete;
    let report_path = finish(&mut report, &document.warnings, &mut clock, output)?;
    Ok(FactorsOutcome {
        output: output.to_owned(),
        report_path,
        report,
        warnings: document.warnings.clone(),
        complete,
        kept_in: None,
    })
}

fn finish(
    report: &mut FactorsReport,
    warnings: &Warnings,
    clock: &mut Clock,
    output: &Path,
) -> Result<PathBuf, Error> {
    clock.end(Stage::Write);
    report.seconds(clock);
    report.memory_peak_bytes = peak_memory_bytes();
    report.warnings = warnings.iter().map(|w| w.to_string()).collect();
    let path = report_path(output);
    let text = serde_json::to_string_pretty(report).map_err(|e| Error::Write {
        path: path.clone(),
        source: std::io::Error::other(e),
    })?;
    luxel_io::write_atomic(&path, (text + "\n").as_bytes()).map_err(|source| Error::Write {
        path: path.clone(),
        source,
    })?;
    Ok(path)
}

/// Where finished work is kept: `room.npz.part`.
fn part_path(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".part");
    PathBuf::from(name)
}

/// Where the report goes: `room.json`.
fn report_path(output: &Path) -> PathBuf {
    output.with_extension("json")
}
