//! View factors stopped and gone on with: the same files as in one go, whatever happens between.

use luxel::factors::zones::ZoneWishes;
use luxel::{Control, Error, FactorsJob, Stage, Status, factors};
use std::fs;
use std::path::{Path, PathBuf};

fn job(folder: &Path, compressed: bool) -> FactorsJob {
    let scene = folder.join("boxes.obj");
    let facets = luxel_scenes::floating_boxes(1000);
    fs::write(&scene, luxel_scenes::facets::to_obj(&facets)).expect("a scene");
    FactorsJob {
        scene,
        output: Some(folder.join("f.npz")),
        scale: 1.0,
        flip: false,
        error: None,
        rows: None,
        threshold: 0.0,
        zones: ZoneWishes::default(),
        to_zones: false,
        points: None,
        spared: Vec::new(),
        enclosed: false,
        compressed,
        resume: false,
        precision: None,
        memory: 4 << 30,
    }
}

/// Stops where a share of the factors is there.
fn stop_at(share: f64) -> impl FnMut(&Status) -> Control {
    move |status| match status.stage == Stage::Factors && status.share > share {
        true => Control::Stop,
        false => Control::Go,
    }
}

fn go(_: &Status) -> Control {
    Control::Go
}

/// The matrix and the report without what differs from run to run.
fn results(folder: &Path) -> (Vec<u8>, serde_json::Value) {
    let text = fs::read(folder.join("f.json")).expect("a report");
    let mut report: serde_json::Value = serde_json::from_slice(&text).expect("JSON");
    for times in ["seconds", "cpu_seconds", "memory_peak_bytes"] {
        report.as_object_mut().expect("an object").remove(times);
    }
    if let Some(compressed) = report.get_mut("compressed") {
        compressed["product_seconds"] = 0.into();
    }
    (fs::read(folder.join("f.npz")).expect("a matrix"), report)
}

fn stopped_twice(compressed: bool, between: impl Fn(&Path)) {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut job, folder) = (job(folder.path(), compressed), folder.path());
    let (matrix, part): (PathBuf, PathBuf) = (folder.join("f.npz"), folder.join("f.npz.part"));
    factors(&job, &mut go).expect("in one go");
    let whole = results(folder);
    assert!(!part.exists());
    for share in [0.1, 0.5] {
        fs::remove_file(&matrix).expect("there");
        match factors(&job, &mut stop_at(share)) {
            Ok(outcome) => {
                assert!(!compressed && !outcome.complete && matrix.exists());
                assert_eq!(outcome.kept_in.as_ref(), Some(&part));
                assert!(!outcome.report.complete);
            }
            Err(Error::StoppedKept { part: kept, .. }) => {
                assert!(compressed && kept == part && !matrix.exists());
                fs::write(&matrix, "").expect("something to remove");
            }
            Err(other) => panic!("{other}"),
        }
        assert!(part.exists());
        between(&part);
        job.resume = true;
    }
    factors(&job, &mut go).expect("gone on with");
    let resumed = results(folder);
    assert!(whole.0 == resumed.0, "the same bytes");
    assert_eq!(whole.1, resumed.1);
    assert!(!part.exists());
}

#[test]
fn a_resumed_run_ends_as_one_in_one_go() {
    for compressed in [false, true] {
        stopped_twice(compressed, |_| ());
    }
}

#[test]
fn a_torn_file_of_saved_work_costs_work_and_nothing_else() {
    for compressed in [false, true] {
        stopped_twice(compressed, |part| {
            let bytes = fs::read(part).expect("there");
            fs::write(part, &bytes[..bytes.len() * 2 / 3]).expect("torn");
        });
    }
}

#[test]
fn saved_work_of_another_kind_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut job = job(folder.path(), true);
    factors(&job, &mut stop_at(0.1)).expect_err("stopped");
    (job.resume, job.compressed) = (true, false);
    let told = factors(&job, &mut go).expect_err("other work").to_string();
    assert!(told.contains("f.npz.part: expected the saved work of this input with these settings"));
    // A file of version 1 is named as that.
    let part = folder.path().join("f.npz.part");
    let mut bytes = fs::read(&part).expect("there");
    bytes[8] = 1;
    fs::write(&part, &bytes).expect("written");
    let told = factors(&job, &mut go).expect_err("version 1").to_string();
    assert!(
        told.contains("expected version 2, found version 1"),
        "{told}"
    );
    assert_eq!(fs::read(&part).expect("there"), bytes);
}

#[test]
fn damaged_work_is_done_again_with_a_warning() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut job = job(folder.path(), true);
    factors(&job, &mut go).expect("in one go");
    let whole = results(folder.path()).0;
    factors(&job, &mut stop_at(0.3)).expect_err("stopped");
    let part = folder.path().join("f.npz.part");
    let mut bytes = fs::read(&part).expect("there");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&part, &bytes).expect("written");
    job.resume = true;
    let outcome = factors(&job, &mut go).expect("gone on with");
    let said: Vec<String> = outcome.warnings.iter().map(|w| w.to_string()).collect();
    assert!(
        said.iter().any(|w| w.contains("saved work is damaged")),
        "{said:?}"
    );
    assert!(results(folder.path()).0 == whole, "the same bytes");
}
