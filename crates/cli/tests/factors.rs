//! `luxel factors` as a user runs it: matrices, zones, points, stop and resume.

mod common;

use common::{luxel, words};
use std::path::Path;
use std::process::Command;

/// A room of 3 x 4 x 2.5 m with a box of 1 m on the floor, as two objects and two materials;
/// fronts towards the air. The floor is a ring of four around the box.
const ROOM: &str = "\
o shell
usemtl white
v 0 0 0
v 3 0 0
v 3 4 0
v 0 4 0
v 0 0 2.5
v 3 0 2.5
v 3 4 2.5
v 0 4 2.5
v 1 1 0
v 2 1 0
v 2 2 0
v 1 2 0
v 1 1 1
v 2 1 1
v 2 2 1
v 1 2 1
f 1 2 10 9
f 2 3 11 10
f 3 4 12 11
f 4 1 9 12
f 5 8 7 6
f 1 5 6 2
f 2 6 7 3
f 3 7 8 4
f 4 8 5 1
o box
usemtl grey
f 13 14 15 16
f 9 10 14 13
f 10 11 15 14
f 11 12 16 15
f 12 9 13 16
";

/// Writes the room, runs `luxel factors` on it and reads the triplets that it wrote.
fn factors(folder: &Path, more: &[&str]) -> (Vec<(usize, usize, f64)>, serde_json::Value) {
    let (scene, out) = (folder.join("room.obj"), folder.join("f.csv"));
    std::fs::write(&scene, ROOM).expect("a scene");
    let (scene, out) = (scene.display().to_string(), out.display().to_string());
    let mut arguments = vec!["factors", &scene, "-o", &out];
    arguments.extend(more);
    let answer = luxel(&arguments);
    assert!(answer.status.success(), "{}", words(&answer.stderr));
    let text = std::fs::read_to_string(&out).expect("a matrix");
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("row,column,factor"));
    let triplets = lines
        .map(|line| {
            let mut fields = line.split(',');
            let mut next = || fields.next().expect("three fields");
            (
                next().parse().expect("a row"),
                next().parse().expect("a column"),
                next().parse().expect("a factor"),
            )
        })
        .collect();
    let report = std::fs::read(folder.join("f.json")).expect("a report");
    (triplets, serde_json::from_slice(&report).expect("JSON"))
}

fn row_sum(triplets: &[(usize, usize, f64)], row: usize) -> f64 {
    triplets.iter().filter(|t| t.0 == row).map(|t| t.2).sum()
}

#[test]
fn rows_close_and_repair_says_what_it_did() {
    let folder = tempfile::tempdir().expect("a folder");
    let (triplets, report) = factors(folder.path(), &[]);
    // Closed: a few times the promise of 1e-4 for each of 14 factors.
    for row in 0..14 {
        let sum = row_sum(&triplets, row);
        assert!((sum - 1.0).abs() < 5e-4, "row {row}: {sum}");
    }
    assert_eq!(report["rows"], 14);
    assert!(report["reciprocity_worst"].as_f64().expect("a number") < 1e-7);
    let (repaired, report) = factors(folder.path(), &["--enclosed"]);
    for row in 0..14 {
        // What is stored has 24 bits.
        assert!((row_sum(&repaired, row) - 1.0).abs() < 1e-6);
    }
    assert_eq!(report["repair"]["applied"], true);
    let change = report["repair"]["largest_change"]
        .as_f64()
        .expect("a number");
    assert!(change > 0.0 && change < 1e-2, "{change}");
}

#[test]
fn zones_rows_and_points_are_parts_of_the_same() {
    let folder = tempfile::tempdir().expect("a folder");
    let (all, _) = factors(folder.path(), &[]);
    let (some, _) = factors(folder.path(), &["--rows", "4..6"]);
    let wanted: Vec<_> = all
        .iter()
        .copied()
        .filter(|t| (4..6).contains(&t.0))
        .collect();
    assert_eq!(some, wanted);
    let (to_zones, report) = factors(folder.path(), &["--by", "material", "--to-zones"]);
    assert_eq!(report["zones"][1]["name"], "grey");
    let to_box: f64 = all
        .iter()
        .filter(|t| t.0 == 4 && t.1 >= 9)
        .map(|t| t.2)
        .sum();
    let found = to_zones
        .iter()
        .find(|t| (t.0, t.1) == (4, 1))
        .expect("an entry")
        .2;
    assert!((to_box - found).abs() < 1e-12);
    // The box sees nothing of itself: it is convex.
    let (zones, _) = factors(folder.path(), &["--group", "crate=box"]);
    assert!(!zones.iter().any(|t| (t.0, t.1) == (0, 0)));
    assert!(
        (zones
            .iter()
            .find(|t| (t.0, t.1) == (0, 1))
            .expect("an entry")
            .2
            - 1.0)
            .abs()
            < 5e-4
    );
    // A point sees as much in all directions as there is: 1. Exact.
    let points = folder.path().join("points.txt");
    std::fs::write(&points, "0.5 0.5 1.2  0 0 1\n2.5 3 0.1  1 1 -0.4\n").expect("points");
    let points = points.display().to_string();
    let (seen, report) = factors(folder.path(), &["--points", &points]);
    assert_eq!(report["finished_rows"], 2);
    for row in 0..2 {
        assert!((row_sum(&seen, row) - 1.0).abs() < 1e-9);
    }
}

#[test]
fn mistakes_end_in_one_line_and_exit_code_2() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("room.obj");
    std::fs::write(&scene, ROOM).expect("a scene");
    let broken = folder.path().join("broken.stl");
    std::fs::write(
        &broken,
        "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 x\n",
    )
    .expect("a file");
    let binary = folder.path().join("points.bin");
    std::fs::write(&binary, [255, 254, 0]).expect("a file");
    let [scene, broken, binary] = [scene, broken, binary].map(|p| p.display().to_string());
    for (arguments, said) in [
        (vec!["factors", &scene, "-o", "f.txt"], ".npz, .csv or .mtx"),
        (vec!["factors", &scene, "-o", &scene], ".npz"),
        (vec!["factors", &broken], "broken.stl:4: expected"),
        (vec!["factors", &scene, "--rows", "14..20"], "rows below 14"),
        (
            vec!["factors", &scene, "--rows", "3..9999"],
            "--rows: expected rows below 14, found 3..9999",
        ),
        (vec!["factors", &scene, "--rows", "14.."], "found 14.."),
        (
            vec!["factors", &scene, "--group", "x=3..900"],
            "--group x=3..900: expected rows below 14, found '3..900'",
        ),
        (
            vec!["factors", &scene, "-o", "no-such-folder/f.npz"],
            "no-such-folder/f.npz: could not be written",
        ),
        (vec!["factors", &scene, "--group", "a=nobody"], "'nobody'"),
        (
            vec!["factors", &scene, "--group", "rest=box"],
            "--group rest=...: expected a name that no other zone has, found",
        ),
        (vec!["factors", &scene, "--to-zones"], "--by or --group"),
        (vec!["factors", "missing.ply"], "missing.ply"),
        (
            vec!["factors", &scene, "--points", "missing.txt"],
            "luxel: missing.txt: expected a file of points, found no such file",
        ),
        (
            vec!["factors", &scene, "--points", "src"],
            "luxel: src: expected a file of points, found a folder",
        ),
        (
            vec!["factors", &scene, "--points", &binary],
            "points.bin: expected points as text, found something that is no UTF-8",
        ),
        (
            vec!["factors", &scene, "--error", "2"],
            "expected a number from",
        ),
    ] {
        let out = luxel(&arguments);
        assert_eq!(out.status.code(), Some(2), "{arguments:?}");
        let told = words(&out.stderr);
        assert!(told.contains(said), "{told}");
        // Before the progress there is nothing to say.
        assert!(!told.contains("form factors"), "{told}");
    }
    assert_eq!(std::fs::read_to_string(&scene).expect("still there"), ROOM);
}

#[test]
fn zones_without_all_their_rows_are_marked() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_, all) = factors(folder.path(), &["--by", "object"]);
    let (some, report) = factors(folder.path(), &["--by", "object", "--rows", "9..14"]);
    // The box is rows 9 to 13; of the shell none was asked for.
    assert_eq!(report["zones"][0]["complete"], false);
    assert_eq!(report["zones"][1]["complete"], true);
    assert!(report["zone_factors"][0].is_null());
    assert_eq!(report["zone_factors"][1], all["zone_factors"][1]);
    assert!(some.iter().all(|t| t.0 == 1));
    let warnings = report["warnings"].to_string();
    assert!(warnings.contains("zones are left empty"), "{warnings}");
    let scene = folder.path().join("room.obj").display().to_string();
    let out = folder.path().join("f.csv").display().to_string();
    let shown = luxel(&[
        "factors", &scene, "-o", &out, "--by", "object", "--rows", "9..14",
    ]);
    let shown = words(&shown.stdout);
    let row = shown
        .lines()
        .find(|l| l.trim_start().starts_with("shell") && l.contains('-'));
    let row = row.expect("a marked row");
    assert!(!row.contains("0.0000000"), "{shown}");
    assert!(shown.contains("not all rows of this zone"), "{shown}");
}

#[test]
fn accuracy_that_is_not_met_is_said_and_ends_with_exit_code_1() {
    // Two plates and three triangles in the air between them: pairs are given up at about 5e-7.
    let text = "\
v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nv 0 0 1.2\nv 0 2 1.2\nv 2 2 1.2\nv 2 0 1.2
v 0.7 1.1 0.5\nv 0.9 1.1 0.6\nv 0.8 1.3 0.5\nv 1.2 0.4 0.8\nv 1.4 0.5 0.7\nv 1.2 0.6 0.9
v 1.0 1.0 0.3\nv 1.2 1.2 0.4\nv 1.1 1.1 0.6\nf 1 2 3 4\nf 5 6 7 8\nf 9 10 11\nf 12 13 14\nf 15 16 17
";
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("plates.obj");
    std::fs::write(&scene, text).expect("a scene");
    let scene = scene.display().to_string();
    let report = folder.path().join("plates.factors.json");
    for (error, rows, code) in [
        ("1e-4", "0..", Some(0)),
        ("1e-8", "0..", Some(1)),
        ("1e-8", "0", Some(1)),
    ] {
        let out = luxel(&["factors", &scene, "--error", error, "--rows", rows]);
        let told = words(&out.stderr);
        assert_eq!(out.status.code(), code, "{told}");
        let report = std::fs::read(&report).expect("a report");
        let report: serde_json::Value = serde_json::from_slice(&report).expect("JSON");
        assert_eq!(report["accuracy_met"], code == Some(0));
        assert_eq!(report["complete"], true);
        let said = "warning: plates: accuracy not met: errors of a row together are stated";
        assert_eq!(told.contains(said), code == Some(1), "{told}");
    }
}

#[test]
fn warnings_name_the_row_and_what_the_file_has_no_names_for() {
    // A plate of 1 m under another, and a part of that a second time in the same place.
    let text = "\
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 .01\nv 0 1 .01\nv 1 1 .01\nv 1 0 .01
v 0.1 0.1 0.01\nv 0.1 0.9 0.01\nv 0.9 0.9 0.01\nv 0.9 0.1 0.01
usemtl tin\nf 1 2 3 4\nf 5 6 7 8\nf 9 10 11 12
";
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("plates.obj");
    std::fs::write(&scene, text).expect("a scene");
    let scene = scene.display().to_string();
    let out = luxel(&["factors", &scene, "--by", "object", "--enclosed"]);
    let told = words(&out.stderr);
    for said in [
        "warning: plates: row 0 (material 'tin') sums to 1.",
        "not closed, row 0 (material 'tin') misses 1 by",
        "warning: plates: the file names no objects: all facets that no group names are one zone",
    ] {
        assert!(told.contains(said), "{told}");
    }
    assert!(!words(&luxel(&["factors", &scene, "--by", "material"]).stderr).contains("names no"));
}

/// SIGINT is what Ctrl-C sends.
#[cfg(unix)]
#[test]
fn a_stop_keeps_finished_rows_and_resume_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("boxes.obj");
    let facets = luxel_scenes::floating_boxes(1500);
    std::fs::write(&scene, luxel_scenes::facets::to_obj(&facets)).expect("a scene");
    let run = |more: &[&str], output: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
        command.args(["factors", "-q"]).arg(&scene);
        command.arg("-o").arg(folder.path().join(output)).args(more);
        command
    };
    let mut child = run(&[], "f.csv").spawn().expect("luxel runs");
    std::thread::sleep(std::time::Duration::from_millis(700));
    // SAFETY: kill sends a signal to the child, which is ours and not yet waited for.
    unsafe { libc::kill(child.id() as i32, libc::SIGINT) };
    let status = child.wait().expect("it ends");
    if status.code() == Some(1) {
        // A fast machine may have finished.
        assert!(folder.path().join("f.csv.part").exists());
        assert!(folder.path().join("f.csv").exists());
    }
    let resumed = run(&["--resume"], "f.csv").status().expect("luxel runs");
    assert_eq!(resumed.code(), Some(0));
    assert!(!folder.path().join("f.csv.part").exists());
    assert_eq!(
        run(&[], "g.csv").status().expect("luxel runs").code(),
        Some(0)
    );
    let read = |name: &str| std::fs::read(folder.path().join(name)).expect("a matrix");
    assert!(read("f.csv") == read("g.csv"), "the same bits as in one go");
}
