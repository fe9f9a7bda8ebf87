//! View factors of a scene file: read, computed, repaired if asked, written with a report.
//!
//! The work goes in batches. What is done is kept in `OUTPUT.part` beside the output as soon as
//! it takes long, so a stop or a kill loses little; `resume` goes on from there.

pub mod report;
pub mod zones;

use crate::error::Error;
use crate::spare::replaced;
use crate::stage::{Clock, Stage, peak_memory_bytes};
use crate::watch::{Control, Status, Watch, enter};
use luxel_core::{DVec3, Facets, SparseRows, Warnings};
use luxel_io::{
    Batch as StoredBatch, BatchEntry, BatchFile, FacetDocument, FacetOptions, FactorFormat,
    Precision, WriteError, facets_fingerprint, read_facets, write_factors,
};
use luxel_transport::closure_repair::{ExchangeAreas, Repair, RepairSettings, repair_closure};
use luxel_transport::facets::{
    Batch, Counts, ExchangeMatrix, FacetFactors, FacetSettings, Triplet,
};
use rayon::prelude::*;
use report::FactorsReport;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use zones::{Table, ZoneWishes, Zones};

/// Work is kept at most this often.
const KEEP_EVERY: Duration = Duration::from_secs(5);

/// Rows that miss 1 by more than this on the mean, or a factor that would change by more than
/// that share of itself, are no errors of closed scenes.
const MOST_GAP: f64 = 0.02;
const MOST_CHANGE: f64 = 0.1;

/// A row may sum to 1 and this many times the promise.
const MOST_ABOVE: f64 = 20.0;

/// Bytes of an entry while it is found, and twice when it is stored.
const ENTRY_BYTES: u64 = 12 + 16;

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
    /// Whether to go on with work that was stopped.
    pub resume: bool,
    /// How numbers are stored.
    pub precision: Precision,
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
    /// Whether all that was asked is there.
    pub complete: bool,
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
    FactorFormat::of(&output).map_err(|e| Error::Setting(e.to_string()))?;
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
    if !job.resume && part.exists() {
        document.warnings.add(
            part.display().to_string(),
            "finished work of an earlier run is there; --resume would go on with it",
            1,
        );
    }
    let facets = &document.facets;
    let found = compute(job, facets, &work, &asked, &part, watch)?;
    clock.end(Stage::Factors);
    watch(&Status::begin(Stage::Write));

    let finished = work.finished(found.done);
    let keep: Vec<bool> = finished
        .iter()
        .enumerate()
        .map(|(row, &done)| done && asked.rows.contains(&(row as u32)))
        .collect();
    let complete = found.done == work.batches();
    let areas = facets.areas();
    let mut lost = vec![0.0; areas.len()];
    let mut matrix = assembled(&areas, &found.batches, job.threshold, &mut lost);
    report.counts(&found.counts, &areas);
    report.before(&matrix, &keep, &lost);
    if asked.enclosed && !(complete && asked.all_rows(areas.len())) {
        let what = "closure is not repaired: that takes all rows";
        document.warnings.add(document.facets.name.clone(), what, 1);
    } else if asked.enclosed {
        let repair = repair(&matrix);
        report.repaired(&repair);
        let open = repair.before.mean > MOST_GAP || repair.largest_change > MOST_CHANGE;
        if repair.negative.is_some() || open {
            let (gap, row) = (repair.before.worst, repair.before.worst_at.unwrap_or(0));
            let what = format!(
                "closure is not repaired: the scene is not closed, row {row} misses 1 by {gap:.3}"
            );
            document.warnings.add(document.facets.name.clone(), what, 1);
        } else {
            apply(&mut matrix, &repair);
            report.applied(&matrix);
        }
    }
    if report.row_sum_largest > 1.0 + MOST_ABOVE * asked.error {
        let what = format!(
            "a row sums to {:.4}: do facets lie in one another, or twice in one place?",
            report.row_sum_largest
        );
        document.warnings.add(document.facets.name.clone(), what, 1);
    }
    let facets = &document.facets;
    let kept = Kept {
        matrix: &matrix,
        keep: &keep,
    };
    let written = match &zones {
        None => {
            report.facets(facets, &areas);
            write_factors(&output, &kept, &areas, job.precision)
        }
        Some(zones) => {
            let table = Table::of_zones(&kept, &areas, zones, !job.to_zones, &keep);
            report.zones(zones, &areas, &table, !job.to_zones);
            let row_areas = if job.to_zones {
                areas.clone()
            } else {
                zones.areas(&areas)
            };
            if job.to_zones {
                report.facets(facets, &areas);
            }
            write_factors(&output, &table, &row_areas, job.precision)
        }
    };
    report.bytes = written.map_err(write_error)?;
    report.complete = complete;
    report.finished_rows = keep.iter().filter(|&&k| k).count();
    let report_path = finish(&mut report, &document.warnings, &mut clock, &output)?;
    if complete && let Some(file) = found.file {
        file.remove().map_err(write_error)?;
    }
    Ok(FactorsOutcome {
        output,
        report_path,
        report,
        warnings: document.warnings,
        complete,
    })
}

/// What a job and its file ask for together.
pub(crate) struct Asked {
    pub(crate) error: f64,
    pub(crate) rows: Range<u32>,
    pub(crate) enclosed: bool,
}

impl Asked {
    fn new(job: &FactorsJob, document: &mut FacetDocument) -> Result<Asked, Error> {
        let place = document.facets.name.clone();
        let number = |document: &FacetDocument, name: &str| {
            document.control(name).and_then(|v| v.parse::<f64>().ok())
        };
        let count = document.facets.rows.len() as u32;
        let of_file = |document: &FacetDocument| match number(document, "row") {
            Some(row) if row >= 1.0 => (row as u32 - 1)..(row as u32),
            _ => 0..count,
        };
        let rows = job.rows.clone().unwrap_or_else(|| of_file(document));
        if rows.start >= count {
            return Err(Error::Setting(format!(
                "--rows: expected rows below {count}, found {}",
                rows.start
            )));
        }
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
        Ok(Asked {
            error: job
                .error
                .or(number(document, "eps").map(|e| e.clamp(1e-8, 0.1)))
                .unwrap_or(1e-4),
            rows: rows.start..rows.end.min(count),
            enclosed: job.enclosed || document.enclosed,
        })
    }

    fn all_rows(&self, rows: usize) -> bool {
        self.rows == (0..rows as u32)
    }
}

/// The batches that are done.
struct Found {
    batches: Vec<Batch>,
    counts: Counts,
    done: usize,
    file: Option<BatchFile>,
}

fn compute(
    job: &FactorsJob,
    facets: &Facets,
    work: &FacetFactors,
    asked: &Asked,
    part: &Path,
    watch: &mut Watch<'_>,
) -> Result<Found, Error> {
    let settings = [format!("{:e}", asked.error), format!("{:?}", asked.rows)];
    let words: Vec<&str> = settings.iter().map(String::as_str).collect();
    let fingerprint = facets_fingerprint(facets, &words);
    let mut found = Found {
        batches: Vec::new(),
        counts: Counts::default(),
        done: 0,
        file: None,
    };
    if job.resume && part.exists() {
        let (file, stored, _) = BatchFile::resume(part, fingerprint)?;
        for batch in stored {
            // In order from the first; what follows a gap is done again.
            if batch.id as usize == found.done {
                found.batches.push(from_stored(&batch));
                found.done += 1;
            }
        }
        found.file = Some(file);
    }
    let began = Instant::now();
    let total: f64 = (0..work.batches()).map(|b| work.share(b)).sum();
    let mut share: f64 = (0..found.done).map(|b| work.share(b)).sum();
    let (start_share, mut kept, mut kept_at) = (share, found.done, Instant::now());
    let mut entries: u64 = found.batches.iter().map(|b| b.found.len() as u64).sum();
    while found.done < work.batches() {
        let advanced = share - start_share;
        let status = Status {
            share: (share / total.max(f64::MIN_POSITIVE)).max(0.0),
            left_s: (advanced > 0.02 * total)
                .then(|| began.elapsed().as_secs_f64() * (total - share) / advanced),
            ..Status::begin(Stage::Factors)
        };
        let stop = watch(&status) == Control::Stop;
        if stop || kept_at.elapsed() > KEEP_EVERY {
            keep(&mut found, kept, part, fingerprint)?;
            (kept, kept_at) = (found.done, Instant::now());
        }
        if stop {
            break;
        }
        let Some(batch) = watched(work, found.done, &status, watch) else {
            keep(&mut found, kept, part, fingerprint)?;
            break;
        };
        entries += batch.found.len() as u64;
        found.counts.add(&batch.counts);
        found.batches.push(batch);
        share += work.share(found.done);
        found.done += 1;
        if entries * ENTRY_BYTES > job.memory {
            let needed = entries as f64 * ENTRY_BYTES as f64 * total / share;
            keep(&mut found, kept, part, fingerprint)?;
            return Err(Error::Memory {
                scene: format!(
                    "{}: {} factors so far; take rows in parts (--rows 0..1000)",
                    facets.name, entries
                ),
                needed_mb: needed as u64 / 1_000_000,
                bound_mb: job.memory / 1_000_000,
            });
        }
    }
    Ok(found)
}

/// Computes a batch and asks the watcher now and then; nothing if it wants no more.
fn watched(
    work: &FacetFactors,
    batch: usize,
    status: &Status,
    watch: &mut Watch<'_>,
) -> Option<Batch> {
    const EVERY: Duration = Duration::from_millis(50);
    std::thread::scope(|scope| {
        let (send, receive) = std::sync::mpsc::channel();
        scope.spawn(move || send.send(work.compute(batch)));
        loop {
            match receive.recv_timeout(EVERY) {
                Ok(batch) => return Some(batch),
                Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {
                    if watch(status) == Control::Stop {
                        work.stop();
                        return None;
                    }
                }
                // The computing thread panicked; the scope passes that on.
                Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => return None,
            }
        }
    })
}

/// Appends the batches from `first` on to the file of the work.
fn keep(found: &mut Found, first: usize, part: &Path, fingerprint: u64) -> Result<(), Error> {
    if found.batches.len() <= first {
        return Ok(());
    }
    if found.file.is_none() {
        found.file = Some(BatchFile::create(part, fingerprint)?);
    }
    if let Some(file) = &mut found.file {
        for (id, batch) in found.batches.iter().enumerate().skip(first) {
            file.append(&to_stored(id, batch)).map_err(write_error)?;
        }
    }
    Ok(())
}

fn to_stored(id: usize, batch: &Batch) -> StoredBatch {
    StoredBatch {
        id: id as u32,
        entries: batch
            .found
            .iter()
            .map(|t| BatchEntry {
                row: t.row,
                column: t.column,
                value: t.exchange,
            })
            .collect(),
    }
}

fn from_stored(batch: &StoredBatch) -> Batch {
    Batch {
        found: batch
            .entries
            .iter()
            .map(|e| Triplet {
                row: e.row,
                column: e.column,
                exchange: e.value,
            })
            .collect(),
        counts: Counts::default(),
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
    report.bytes = write_factors(output, &table, &areas, job.precision).map_err(write_error)?;
    report.complete = complete;
    let report_path = finish(&mut report, &document.warnings, &mut clock, output)?;
    Ok(FactorsOutcome {
        output: output.to_owned(),
        report_path,
        report,
        warnings: document.warnings.clone(),
        complete,
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

fn write_error(error: WriteError) -> Error {
    match error {
        WriteError::System { path, source } => Error::Write { path, source },
        other => Error::Setting(other.to_string()),
    }
}
