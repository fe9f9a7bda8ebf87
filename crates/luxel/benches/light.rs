//! The whole of `luxel light`, from a file to files, on corridors of 1,000 to 1,000,000 triangles
//! at 5 %, and how its time grows.
//!
//! `cargo bench -p luxel --bench light`. An argument bounds the largest corridor. Wall seconds of
//! each stage; the exponent is that of all stages together.

use luxel::{Control, LightJob, Settings};
use std::path::Path;

fn main() {
    let largest = std::env::args()
        .filter_map(|a| a.parse::<usize>().ok())
        .next()
        .unwrap_or(1_000_000);
    let folder = tempfile::tempdir().expect("a folder for the scenes");
    let mut before: Option<(f64, f64)> = None;
    for triangles in [1_000, 10_000, 100_000, 1_000_000] {
        if triangles > largest {
            break;
        }
        let seconds = light(folder.path(), triangles);
        if let Some((t, s)) = before {
            let size = (triangles as f64 / t).ln();
            println!("    exponent {:.2}", (seconds / s).ln() / size);
        }
        before = Some((triangles as f64, seconds));
    }
}

/// Wall seconds of all stages.
fn light(folder: &Path, triangles: usize) -> f64 {
    let scene = folder.join(format!("corridor-{triangles}.glb"));
    let bytes = luxel_scenes::to_glb(&luxel_scenes::corridor(triangles));
    std::fs::write(&scene, bytes).expect("room for the scene");
    let job = LightJob {
        scene,
        output: None,
        resume: false,
        view: None,
        settings: Settings {
            error: 0.05,
            ..Settings::default()
        },
    };
    let outcome = luxel::light(&job, &mut |_| Control::Go).expect("the scene is sound");
    let report = outcome.report;
    let seconds: f64 = report.stages.iter().map(|s| s.wall_s).sum();
    println!(
        "corridor {triangles}: {seconds:.1} s, {} elements, {} vertices, {} gather rays, {:.2} % \
         reached, peak {} MB since the start",
        report.counts.elements,
        report.counts.vertices,
        report.counts.gather_rays,
        100.0 * report.accuracy.reached.unwrap_or(f64::NAN),
        report.memory_peak_bytes.unwrap_or(0) / 1_000_000,
    );
    let stages = report.stages.iter();
    let line: Vec<String> = stages
        .map(|s| format!("{} {:.2}", s.name, s.wall_s))
        .collect();
    println!("    {}", line.join(", "));
    seconds
}
