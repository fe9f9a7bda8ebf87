//! A compressed matrix from the command line: all pairs of very many facets in one file.
//!
//! The same batches as without compression, each kept as pieces; at the end the product with
//! ones tells closure, and products with a few sources are held against rows that are computed
//! singly. A run that is stopped writes no matrix: a product with a part of it means nothing.

use super::report::{CompressedReport, FactorsReport, MeasuredProduct};
use super::{Asked, FactorsOutcome, batches, finish};
use crate::error::Error;
use crate::stage::{Clock, Stage};
use crate::watch::{Status, Watch};
use luxel_io::{FacetDocument, write_compressed};
use luxel_transport::facets::{CompressedBatch, CompressedMatrix, FacetFactors};
use std::path::Path;
use std::time::Instant;

/// Rows that products are measured on, about.
const MEASURED_ROWS: usize = 24;

/// One row in this many sends, in one of the products that are measured.
const FEW: usize = 97;

pub(super) fn compressed(
    asked: &Asked<'_>,
    mut document: FacetDocument,
    work: &FacetFactors,
    mut report: FactorsReport,
    mut clock: Clock,
    [output, part]: [&Path; 2],
    watch: &mut Watch<'_>,
) -> Result<FactorsOutcome, Error> {
    let mut found = batches::compute::<CompressedBatch>(
        &document.facets,
        work,
        asked,
        part,
        &mut document.warnings,
        watch,
    )?;
    clock.end(Stage::Factors);
    if found.batches.len() < work.batches() {
        found.say(&mut document.warnings);
        return Err(match found.kept_in() {
            Some(part) => Error::StoppedKept {
                part: part.to_owned(),
                percent: 100.0 * found.share,
            },
            None => Error::Stopped,
        });
    }
    found.keep_rest(work);
    found.say(&mut document.warnings);
    let areas = document.facets.areas();
    report.counts(&found.counts, &areas, &vec![true; areas.len()]);
    if let Some(what) = report.doubt() {
        document.warnings.add(document.facets.name.clone(), what, 1);
    }
    let whole = found.kept_in().is_some();
    let matrix = work.compressed(std::mem::take(&mut found.batches));
    // All is there: a stop from here on only hurries what is left.
    watch(&Status::begin(Stage::Measure));
    measure(&matrix, work, &mut report);
    clock.end(Stage::Measure);
    watch(&Status::begin(Stage::Write));
    report.facets(&document.facets, &matrix.areas);
    // The batches went into the matrix and cannot be kept again: a file of all work is as large and
    // leaves room for it, one of less is not given away.
    report.bytes = found.write(work, whole, || {
        write_compressed(output, &matrix.areas, matrix.part_rows(), matrix.pieces())
    })?;
    report.complete = true;
    report.finished_rows = matrix.areas.len();
    found.remove()?;
    let report_path = finish(&mut report, &document.warnings, &mut clock, output)?;
    Ok(FactorsOutcome {
        output: output.to_owned(),
        report_path,
        report,
        warnings: document.warnings,
        complete: true,
        kept_in: None,
    })
}

/// Closure by the product with ones, and the error of products.
fn measure(matrix: &CompressedMatrix, work: &FacetFactors, report: &mut FactorsReport) {
    let n = matrix.areas.len();
    let ones = vec![1.0; n];
    let few: Vec<f64> = (0..n)
        .map(|i| if i % FEW == 0 { 1.0 } else { 0.0 })
        .collect();
    // Fractions of multiples of the golden ratio have no pattern that a mesh could have.
    let mixed: Vec<f64> = (0..n)
        .map(|i| (0.618_033_988_749_895 * i as f64 * (i + 1) as f64).fract())
        .collect();
    let mut sums = vec![0.0; n];
    let began = Instant::now();
    matrix.apply(&ones, &mut sums);
    let product_seconds = began.elapsed().as_secs_f64();
    for (sum, area) in sums.iter_mut().zip(&matrix.areas) {
        *sum = if *area > 0.0 { *sum / area } else { 0.0 };
    }
    report.closure(sums, &matrix.areas);

    let sources: [(&str, &[f64]); 3] = [
        ("all rows alike", &ones),
        ("one row in 97", &few),
        ("0..1 without a pattern", &mixed),
    ];
    let errors = matrix.measured_errors(work, &sources.map(|s| s.1), MEASURED_ROWS);
    let measured = sources.iter().zip(errors).map(|(source, error)| {
        let share = |v: f64| if v.is_finite() { v } else { f64::MAX };
        MeasuredProduct {
            source: source.0.to_string(),
            rows: error.rows,
            worst: share(error.max),
            rms: share(error.rms),
        }
    });
    let stored = matrix.stored();
    report.compressed = Some(CompressedReport {
        memory_bytes: matrix.bytes() as u64,
        blocks: stored.blocks,
        block_pairs: stored.block_pairs,
        block_numbers: stored.block_numbers,
        tiles: stored.tiles,
        entries: stored.entries,
        product_seconds,
        product_errors: measured.collect(),
    });
}
