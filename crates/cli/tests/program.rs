//! The program as a user runs it: files, exit codes, messages.

mod common;

use common::{luxel, words};
use std::path::{Path, PathBuf};
use std::process::Output;

fn scenes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes")
}

/// Lights the Cornell box coarsely into a folder of its own.
fn light(folder: &Path, more: &[&str]) -> Output {
    let scene = scenes().join("cornell.glb");
    let (scene, folder) = (scene.display().to_string(), folder.display().to_string());
    let mut arguments = vec![
        "light",
        &scene,
        "-o",
        &folder,
        "--elements",
        "600",
        "--error",
        "10%",
    ];
    arguments.extend(more);
    luxel(&arguments)
}

#[test]
fn light_writes_files_that_hold_what_they_promise() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = light(folder.path(), &[]);
    assert!(out.status.success(), "{}", words(&out.stderr));
    assert!(
        words(&out.stdout).contains("energy"),
        "the table for people"
    );
    let report = std::fs::read(folder.path().join("report.json")).expect("a report");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("JSON");
    assert_eq!(report["state"], "finished");
    assert!(report["accuracy"]["reached"].as_f64().expect("a number") <= 0.1);
    let flux = &report["energy"]["total"];
    let of = |key: &str| flux[key].as_f64().expect("a number");
    // The two estimates that meet in the balance agree to the noise of coarse settings.
    assert!(of("imbalance_lm").abs() < 0.03 * of("emitted_lm"), "{flux}");
    let png = std::fs::read(folder.path().join("preview.png")).expect("a picture");
    assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
    let glb = std::fs::read(folder.path().join("scene.glb")).expect("a lit scene");
    assert_eq!(&glb[..4], b"glTF");
    // The lit scene is a scene: luxel reads it again.
    let lit = folder.path().join("scene.glb").display().to_string();
    assert!(luxel(&["inspect", &lit]).status.success());
}

#[test]
fn resume_goes_on_and_refuses_another_scene() {
    let folder = tempfile::tempdir().expect("a folder");
    assert!(light(folder.path(), &["--quiet"]).status.success());
    let again = light(folder.path(), &["--resume"]);
    assert!(again.status.success(), "{}", words(&again.stderr));
    let other = light(folder.path(), &["--resume", "--lamp", "100lm@0.2,0.2,0.2"]);
    assert_eq!(other.status.code(), Some(2));
    assert!(
        words(&other.stderr).contains("--resume"),
        "{}",
        words(&other.stderr)
    );
}

#[test]
fn probe_answers_in_the_order_given() {
    let folder = tempfile::tempdir().expect("a folder");
    let points = folder.path().join("points.txt");
    std::fs::write(
        &points,
        "# two\n0.278 0.001 0.28 0 1 0\n0.278 0.5 0.28 0 -1 0\n",
    )
    .expect("written");
    let scene = scenes().join("cornell.glb").display().to_string();
    let points = points.display().to_string();
    let out = luxel(&[
        "probe",
        &scene,
        "--points",
        &points,
        "--elements",
        "600",
        "--error",
        "5%",
        "--quiet",
    ]);
    assert!(out.status.success(), "{}", words(&out.stderr));
    let text = words(&out.stdout);
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "# x y z nx ny nz E_r E_g E_b E_lux err_lux");
    assert_eq!(lines.len(), 3);
    let row: Vec<f32> = lines[1]
        .split('\t')
        .map(|w| w.parse().expect("a number"))
        .collect();
    assert_eq!((row.len(), row[0], row[4]), (11, 0.278, 1.0));
    assert!(
        row[9] > 0.0 && row[10] <= 0.06 * row[9],
        "lux with its error: {row:?}"
    );
}

#[test]
fn mistakes_end_in_one_line_and_exit_code_2() {
    let scene = scenes().join("cornell.glb").display().to_string();
    let cases: [(&[&str], &str); 10] = [
        (&["light", "absent.glb"], "absent.glb"),
        (&["inspect", "Cargo.toml"], ".toml"),
        (&["light", &scene, "--lamp", "800"], "--lamp"),
        (&["light", &scene, "--emit", "Nothing=5"], "Nothing"),
        (&["light", &scene, "--view", "nowhere"], "nowhere"),
        (&["light", &scene, "--memory", "1MB"], "emory"),
        (&["light", &scene, "--error", "2parsecs"], "parsecs"),
        (&["light"], "expected <SCENE>"),
        (&["compare", &scene, "--mesh", "3d"], "--mesh"),
        (&["brighten", &scene], "found 'brighten'"),
    ];
    for (arguments, told) in cases {
        let out = luxel(arguments);
        let message = words(&out.stderr);
        assert_eq!(out.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(told), "{arguments:?}: {message}");
        assert!(!message.contains("panicked"), "{message}");
        let last = message.lines().last().expect("a line");
        assert!(last.starts_with("luxel: ") && last.contains(told), "{last}");
        assert!(!message.contains("Usage"), "{message}");
    }
    for shown in [&["--help"][..], &["--version"], &["factors", "--help"]] {
        let out = luxel(shown);
        assert_eq!(out.status.code(), Some(0), "{shown:?}");
        assert!(out.stderr.is_empty() && !out.stdout.is_empty(), "{shown:?}");
    }
}

#[test]
fn edges_are_taken_and_absurd_numbers_refused() {
    let scene = scenes().join("cornell.glb").display().to_string();
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path().display().to_string();
    let run = |more: &[&str]| {
        let mut arguments = vec!["light", &scene, "-o", &place, "-q"];
        arguments.extend(more);
        luxel(&arguments).status.code()
    };
    assert_eq!(run(&["--edge", "20cm", "--error", "10%"]), Some(0));
    for wrong in [
        ["--edge", "0m"],
        ["--error", "0"],
        ["--threads", "1000"],
        ["--edge", "0.01mm"],
        ["--lamp", "1e38lm@1,1,1"],
        ["--sky", "1e13"],
        ["--memory", "100MB"],
    ] {
        assert_eq!(run(&wrong), Some(2), "{wrong:?}");
    }
}

#[test]
fn the_scene_is_never_replaced_by_what_is_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("scene.glb");
    std::fs::copy(scenes().join("cornell.glb"), &scene).expect("a copy");
    let before = std::fs::read(&scene).expect("bytes");
    let (path, place) = (
        scene.display().to_string(),
        folder.path().display().to_string(),
    );
    let out = luxel(&["light", &path, "-o", &place, "--error", "20%"]);
    assert_eq!(out.status.code(), Some(2));
    assert!(words(&out.stderr).contains("would replace it"));
    assert_eq!(std::fs::read(&scene).expect("bytes"), before);
}

#[test]
fn files_that_the_scene_names_are_not_replaced_either() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let obj = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n";
    std::fs::write(at("s.obj"), obj).expect("written");
    std::fs::write(at("m.mtl"), "newmtl m\nmap_Kd preview.png\n").expect("written");
    let picture = scenes().join("../docs/two-rooms.png");
    std::fs::copy(picture, at("preview.png")).expect("a copy");
    let before = std::fs::read(at("preview.png")).expect("bytes");
    let (path, place) = (
        at("s.obj").display().to_string(),
        folder.path().display().to_string(),
    );
    let out = luxel(&["light", &path, "--sky", "1000", "-o", &place]);
    assert_eq!(out.status.code(), Some(2), "{}", words(&out.stderr));
    assert!(words(&out.stderr).contains("would replace it"));
    assert_eq!(std::fs::read(at("preview.png")).expect("bytes"), before);
    // A file is no folder.
    let out = luxel(&["light", &path, "--sky", "1000", "-o", &path]);
    assert_eq!(out.status.code(), Some(2));
    assert!(words(&out.stderr).contains("found a file"));
}

#[test]
fn memory_is_kept_by_larger_elements() {
    let scene = scenes().join("two-rooms.glb").display().to_string();
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path().display().to_string();
    let arguments = [
        "light", &scene, "-o", &place, "--memory", "140MB", "--error", "20%", "--json",
    ];
    let out = luxel(&arguments);
    assert_eq!(out.status.code(), Some(0), "{}", words(&out.stderr));
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).expect("a report");
    let peak = report["memory_peak_bytes"].as_u64().expect("bytes");
    assert!(peak <= 140_000_000, "{peak}");
    assert!(report["warnings"].to_string().contains("--memory"));
}

#[test]
fn a_cut_file_ends_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let whole = std::fs::read(scenes().join("cornell.glb")).expect("the scene");
    for share in [0, 5, 12, 100, whole.len() / 2, whole.len() - 1] {
        let path = folder.path().join("cut.glb");
        std::fs::write(&path, &whole[..share]).expect("written");
        let out = luxel(&["inspect", &path.display().to_string()]);
        let message = words(&out.stderr);
        assert_eq!(out.status.code(), Some(2), "{share} bytes: {message}");
        assert_eq!(
            message.trim_end().lines().count(),
            1,
            "{share} bytes: {message}"
        );
    }
}

#[test]
fn compare_prints_a_table_and_writes_a_plot() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scenes().join("cornell.glb");
    let run = |more: &[&str]| {
        let mut arguments = vec!["compare", scene.to_str().unwrap(), "--elements", "200"];
        arguments.extend(["--error", "2%", "-o", folder.path().to_str().unwrap()]);
        arguments.extend(more);
        luxel(&arguments)
    };
    let done = run(&["--solver", "jacobi,southwell"]);
    assert_eq!(done.status.code(), Some(0));
    let table = String::from_utf8(done.stdout).unwrap();
    assert!(table.contains("southwell") && !table.contains("stochastic-jacobi"));
    assert!(folder.path().join("compare.svg").exists());
    for wrong in [&["--solver", "jacobi,magic"][..], &["--mesh", "adaptive"]] {
        let refused = run(wrong);
        assert_eq!(refused.status.code(), Some(2));
        assert!(refused.stdout.is_empty());
    }
}
