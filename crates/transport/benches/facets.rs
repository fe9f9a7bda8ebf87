//! View factors of a room with four boxes: time, error against a far stricter run, closure.
//!
//! `cargo bench -p luxel-transport --bench facets [-- [city] [compressed] N ...]`. With
//! `compressed`: time, memory and error of the compressed matrix. CPU time of the process; figures
//! are printed, nothing is asserted.

use luxel_core::Facets;
use luxel_scenes::{city_block, floating_boxes};
use luxel_transport::facets::{
    Batch, CompressedMatrix, Counts, ExchangeMatrix, FacetFactors, FacetSettings,
};
use std::time::Instant;

fn main() {
    let words: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| a != "--bench")
        .collect();
    let sizes: Vec<usize> = words.iter().filter_map(|w| w.parse().ok()).collect();
    let strict = words.iter().any(|w| w == "strict");
    let city = words.iter().any(|w| w == "city");
    let sizes = if sizes.is_empty() {
        vec![1000, 2000, 5000]
    } else {
        sizes
    };
    for n in sizes {
        let facets = if city {
            city_block(n)
        } else {
            floating_boxes(n)
        };
        if words.iter().any(|w| w == "compressed") {
            compressed(&facets);
            continue;
        }
        let (matrix, counts) = run(&facets, 1e-4);
        let sums = matrix.row_sums();
        let closure: f64 = sums.iter().map(|s| (1.0 - s).abs()).sum::<f64>() / sums.len() as f64;
        let worst = sums
            .iter()
            .map(|s| s - 1.0)
            .fold(f64::NEG_INFINITY, f64::max);
        println!(
            "  closure: mean {closure:.2e}, most above 1 {worst:.1e}; {} entries; pieces {:.1} and points {:.1} a shadowed pair; stated {:.1e}",
            matrix.columns.len(),
            counts.pieces as f64 / counts.shadowed.max(1) as f64,
            counts.points as f64 / counts.shadowed.max(1) as f64,
            counts.error / matrix.areas.iter().sum::<f64>(),
        );
        if strict {
            let (exact, _) = run(&facets, 2e-6);
            let mut sum = 0.0;
            for i in 0..sums.len() {
                sum += difference(&matrix, &exact, i);
            }
            println!(
                "  mean over rows of sum |F - strict|: {:.2e}",
                sum / sums.len() as f64
            );
        }
    }
}

fn run(facets: &Facets, error: f64) -> (ExchangeMatrix, Counts) {
    let (start, wall) = (cpu_s(), Instant::now());
    let work = FacetFactors::new(
        facets,
        &FacetSettings {
            error,
            ..FacetSettings::default()
        },
    );
    let prepared = cpu_s() - start;
    let batches: Vec<Batch> = (0..work.batches()).map(|b| work.compute(b)).collect();
    let found = cpu_s() - start;
    let matrix = work.matrix(&batches);
    let mut counts = Counts::default();
    for batch in &batches {
        counts.add(&batch.counts);
    }
    println!(
        "{} facets, to {error:.0e}: {:.2} CPU s ({prepared:.2} to prepare, {:.2} for the matrix), {:.2} s; {} blockers; free {} hidden {} shadowed {}",
        facets.rows.len(),
        cpu_s() - start,
        cpu_s() - start - found,
        wall.elapsed().as_secs_f64(),
        work.blockers(),
        counts.free,
        counts.hidden,
        counts.shadowed
    );
    (matrix, counts)
}

/// The compressed matrix, against rows that are computed singly.
fn compressed(facets: &Facets) {
    let n = facets.rows.len();
    // What dividing the scene took, gigabytes for a large one, does not count: the peak is from
    // here on.
    let made = peak_mb();
    let _ = std::fs::write("/proc/self/clear_refs", "5");
    let (start, wall) = (cpu_s(), Instant::now());
    let work = FacetFactors::new(facets, &FacetSettings::default());
    let prepared = peak_mb();
    let matrix = CompressedMatrix::assemble(&work);
    println!(
        "{n} facets compressed: {:.2} CPU s, {:.2} s; {:.1} MB, {:.0} bytes a facet; peak {:.0} MB ({made:.0} for the scene, {prepared:.0} to prepare)",
        cpu_s() - start,
        wall.elapsed().as_secs_f64(),
        1e-6 * matrix.bytes() as f64,
        matrix.bytes() as f64 / n as f64,
        peak_mb(),
    );
    let stored = matrix.stored();
    println!(
        "  {} blocks: {:.2e} pairs in {:.2e} numbers; {} tiles, {:.2e} entries; {:.2e} shadowed",
        stored.blocks,
        stored.block_pairs as f64,
        stored.block_numbers as f64,
        stored.tiles,
        stored.entries as f64,
        matrix.counts.shadowed as f64,
    );
    // Two sources that differ: everything alike, and a few bright facets.
    let alike = vec![1.0; n];
    let few: Vec<f64> = (0..n).map(|i| f64::from(i % 97 == 0)).collect();
    let mut y = vec![0.0; n];
    let wall = Instant::now();
    let times = 10;
    for _ in 0..times {
        matrix.apply(&alike, &mut y);
    }
    let apply = wall.elapsed().as_secs_f64() / times as f64;
    let [a, b] = [&alike, &few].map(|x| matrix.measured_error(&work, x, 40));
    let (mut sum, mut worst, mut most) = (0.0, 0.0_f64, 0.0_f64);
    let rows: Vec<usize> = (n / 40..n).step_by((n / 20).max(1)).collect();
    for &i in &rows {
        let (got, exact) = (matrix.row(i as u32), work.exact_row(i as u32));
        let differences = got
            .iter()
            .zip(&exact)
            .map(|(g, e)| (g - e).abs() / matrix.areas[i]);
        let all: f64 = differences.clone().sum();
        sum += all / rows.len() as f64;
        worst = worst.max(all);
        most = most.max(differences.fold(0.0, f64::max));
    }
    println!(
        "  product in {:.1} ms; error of {} rows: max {:.1e} rms {:.1e} of all alike, max {:.1e} rms {:.1e} of a few",
        1e3 * apply,
        a.rows,
        a.max,
        a.rms,
        b.max,
        b.rms,
    );
    println!(
        "  sum over a row of |F - exact|: mean {sum:.1e}, worst {worst:.1e}; one factor at most {most:.1e}; peak {:.0} MB",
        peak_mb()
    );
}

/// Most memory that this process had, MB.
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kb = line.and_then(|l| l.split_whitespace().next()?.parse::<f64>().ok());
    1e-3 * 1.024 * kb.unwrap_or(f64::NAN)
}

fn difference(one: &ExchangeMatrix, two: &ExchangeMatrix, row: usize) -> f64 {
    let entries = |m: &ExchangeMatrix| -> Vec<(u32, f64)> {
        let run = m.offsets[row]..m.offsets[row + 1];
        run.map(|k| (m.columns[k], m.exchange[k] as f64 / m.areas[row]))
            .collect()
    };
    let (a, b) = (entries(one), entries(two));
    let (mut i, mut j, mut sum) = (0, 0, 0.0);
    while i < a.len() || j < b.len() {
        let (ca, cb) = (
            a.get(i).map_or(u32::MAX, |e| e.0),
            b.get(j).map_or(u32::MAX, |e| e.0),
        );
        if ca == cb {
            sum += (a[i].1 - b[j].1).abs();
            i += 1;
            j += 1;
        } else if ca < cb {
            sum += a[i].1;
            i += 1;
        } else {
            sum += b[j].1;
            j += 1;
        }
    }
    sum
}

/// CPU seconds of this process.
fn cpu_s() -> f64 {
    // SAFETY: `usage` is a plain struct that the call fills.
    unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        libc::getrusage(libc::RUSAGE_SELF, &mut usage);
        let s = |t: libc::timeval| t.tv_sec as f64 + 1e-6 * t.tv_usec as f64;
        s(usage.ru_utime) + s(usage.ru_stime)
    }
}
