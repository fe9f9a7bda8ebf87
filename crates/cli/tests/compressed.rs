//! `luxel factors --compressed` as a user runs it. The file is decoded here after the guide
//! (docs/view-factors.md), not by the code that writes it.

mod common;

use common::{luxel, words};
use luxel_scenes::facets::to_obj;
use luxel_scenes::floating_boxes;
use std::collections::HashMap;
use std::io::Read;
use std::path::Path;

/// Arrays of an npz file: kind and bytes, by name.
struct Arrays(HashMap<String, (String, Vec<u8>)>);

impl Arrays {
    fn read(path: &Path) -> Arrays {
        let file = std::fs::File::open(path).expect("a file");
        let mut archive = zip::ZipArchive::new(file).expect("a ZIP file");
        let mut arrays = HashMap::new();
        for k in 0..archive.len() {
            let mut member = archive.by_index(k).expect("a member");
            let name = member.name().trim_end_matches(".npy").to_string();
            let mut bytes = Vec::new();
            member.read_to_end(&mut bytes).expect("whole");
            let start = 10 + u16::from_le_bytes([bytes[8], bytes[9]]) as usize;
            let head = String::from_utf8_lossy(&bytes[10..start]).into_owned();
            let kind = head.split('\'').nth(3).expect("a kind").to_string();
            arrays.insert(name, (kind, bytes.split_off(start)));
        }
        Arrays(arrays)
    }

    fn raw(&self, name: &str, kind: &str) -> &[u8] {
        let (found, bytes) = &self.0[name];
        assert_eq!(found, kind, "{name}");
        bytes
    }

    fn u32(&self, name: &str) -> Vec<usize> {
        let bytes = self.raw(name, "<u4").chunks_exact(4);
        bytes
            .map(|b| u32::from_le_bytes(b.try_into().expect("four")) as usize)
            .collect()
    }

    fn u64(&self, name: &str) -> Vec<u64> {
        let bytes = self.raw(name, "<u8").chunks_exact(8);
        bytes
            .map(|b| u64::from_le_bytes(b.try_into().expect("eight")))
            .collect()
    }

    fn f32(&self, name: &str) -> Vec<f64> {
        let bytes = self.raw(name, "<f4").chunks_exact(4);
        bytes
            .map(|b| f32::from_le_bytes(b.try_into().expect("four")) as f64)
            .collect()
    }

    fn f64(&self, name: &str) -> Vec<f64> {
        let bytes = self.raw(name, "<f8").chunks_exact(8);
        bytes
            .map(|b| f64::from_le_bytes(b.try_into().expect("eight")))
            .collect()
    }

    /// F x: what rows receive per m² times their share, by the formulas of the guide.
    fn product(&self, x: &[f64]) -> Vec<f64> {
        assert_eq!(self.raw("format", "|S18"), b"luxel-compressed-1");
        let (areas, part_row) = (self.f64("areas"), self.u32("part_row"));
        let from: Vec<f64> = part_row.iter().map(|&row| x[row]).collect();
        let mut to = vec![0.0; from.len()];
        let (first, count) = (self.u32("block_first"), self.u32("block_count"));
        let (u, v) = (self.f32("u"), self.f32("v"));
        let (mut at_u, mut at_v) = (0, 0);
        for (block, &rank) in self.u32("block_rank").iter().enumerate() {
            let [a, b] = [first[2 * block], first[2 * block + 1]];
            let [m, n] = [count[2 * block], count[2 * block + 1]];
            for _ in 0..rank {
                let of_u: f64 = (0..m).map(|i| u[at_u + i] * from[a + i]).sum();
                let of_v: f64 = (0..n).map(|j| v[at_v + j] * from[b + j]).sum();
                (0..m).for_each(|i| to[a + i] += of_v * u[at_u + i]);
                (0..n).for_each(|j| to[b + j] += of_u * v[at_v + j]);
                (at_u, at_v) = (at_u + m, at_v + n);
            }
        }
        assert_eq!((at_u, at_v), (u.len(), v.len()), "all numbers are used");
        let (row, column) = (self.u32("tile_row"), self.u32("tile_column"));
        let mut entries = self.f32("entries").into_iter();
        for (tile, bits) in self.u64("tile_bits").into_iter().enumerate() {
            for bit in (0..64).filter(|b| bits >> b & 1 == 1) {
                let (i, j) = (8 * row[tile] + bit / 8, 8 * column[tile] + bit % 8);
                let entry = entries.next().expect("an entry for each bit");
                to[i] += entry * from[j];
                to[j] += entry * from[i];
            }
        }
        assert_eq!(entries.next(), None, "a bit for each entry");
        let mut y = vec![0.0; areas.len()];
        for (part, &row) in part_row.iter().enumerate() {
            y[row] += to[part];
        }
        y.iter().zip(&areas).map(|(y, a)| y / a).collect()
    }
}

/// Runs `luxel factors` on `scene`; the report.
fn factors(scene: &Path, output: &Path, more: &[&str]) -> serde_json::Value {
    let (scene, out) = (scene.display().to_string(), output.display().to_string());
    let mut arguments = vec!["factors", "-q", &scene, "-o", &out];
    arguments.extend(more);
    let answer = luxel(&arguments);
    assert!(answer.status.success(), "{}", words(&answer.stderr));
    let report = std::fs::read(output.with_extension("json")).expect("a report");
    serde_json::from_slice(&report).expect("JSON")
}

/// A room over an L of nine squares: floor and ceiling are one row of two parts each, walls are
/// quads of a metre.
fn l_shaped() -> String {
    let ring = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)];
    let mut text = String::new();
    for z in [0, 2] {
        for (x, y) in ring {
            text += &format!("v {x} {y} {z}\n");
        }
    }
    text += "f 1 2 3 4 5 6\nf 12 11 10 9 8 7\n";
    for k in 0..6 {
        let next = (k + 1) % 6;
        text += &format!("f {} {} {} {}\n", k + 1, k + 7, next + 7, next + 1);
    }
    text
}

#[test]
fn products_of_the_file_are_those_of_all_factors() {
    let folder = tempfile::tempdir().expect("a folder");
    // An empty room has many blocks of low rank, boxes make shadows, the L rows of several parts.
    let mut empty = floating_boxes(3000);
    let shell = empty.rows.iter().take_while(|r| r.object == 0).count();
    empty.rows.truncate(shell);
    empty.parts.truncate(shell);
    let scenes = [
        ("boxes", to_obj(&floating_boxes(1000))),
        ("empty", to_obj(&empty)),
        ("l", l_shaped()),
    ];
    for (name, text) in scenes {
        let scene = folder.path().join(format!("{name}.obj"));
        std::fs::write(&scene, text).expect("a scene");
        let (all, few) = (folder.path().join("all.csv"), folder.path().join("few.npz"));
        let plain = factors(&scene, &all, &[]);
        let report = factors(&scene, &few, &["--compressed"]);
        let rows = plain["rows"].as_u64().expect("a number") as usize;
        let arrays = Arrays::read(&few);
        let closure: f64 = arrays
            .product(&vec![1.0; rows])
            .iter()
            .map(|s| (1.0 - s).abs() / rows as f64)
            .sum();
        let said = report["closure_mean"].as_f64().expect("a number");
        assert!((closure - said).abs() < 1e-9, "{name}: {closure} {said}");
        let text = std::fs::read_to_string(&all).expect("a matrix");
        for source in 0..3 {
            let x: Vec<f64> = (0..rows)
                .map(|i| match source {
                    0 => 1.0,
                    1 => (i % 50 == 0) as u8 as f64,
                    _ => (0.618_033_988_75 * (i * (i + 3)) as f64).fract(),
                })
                .collect();
            let mut want = vec![0.0; rows];
            for line in text.lines().skip(1) {
                let mut fields = line.split(',');
                let mut next = || fields.next().expect("three fields");
                let (i, j): (usize, usize) = (
                    next().parse().expect("a row"),
                    next().parse().expect("a column"),
                );
                want[i] += next().parse::<f64>().expect("a factor") * x[j];
            }
            for (i, (got, want)) in arrays.product(&x).iter().zip(&want).enumerate() {
                // The promise, 1e-4, of what arrives from x <= 1.
                assert!((got - want).abs() <= 1e-4, "{name}, row {i}: {got} {want}");
            }
        }
        let compressed = &report["compressed"];
        let blocks = compressed["blocks"].as_u64().expect("a number");
        assert_eq!(blocks > 50, name == "empty", "{compressed}");
        for product in compressed["product_errors"].as_array().expect("a list") {
            let worst = product["worst"].as_f64().expect("a number");
            assert!(worst <= 1e-4, "{product}");
        }
        for (one, other) in [
            ("row_area_m2", "row_area_m2"),
            ("error_asked", "error_asked"),
        ] {
            assert_eq!(report[one], plain[other]);
        }
        let size = std::fs::metadata(&few).expect("there").len();
        assert_eq!(report["bytes"], size);
    }
}

#[test]
fn threads_do_not_change_a_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("boxes.obj");
    std::fs::write(&scene, to_obj(&floating_boxes(1000))).expect("a scene");
    let [one, two] = ["1", "2"].map(|threads| {
        let output = folder.path().join(format!("{threads}.npz"));
        let mut report = factors(&scene, &output, &["--compressed", "--threads", threads]);
        for times in ["seconds", "cpu_seconds", "memory_peak_bytes"] {
            report.as_object_mut().expect("an object").remove(times);
        }
        report["compressed"]["product_seconds"] = 0.into();
        (std::fs::read(&output).expect("a matrix"), report)
    });
    assert!(one.0 == two.0, "the same bytes");
    assert_eq!(one.1, two.1);
}

#[test]
fn what_does_not_go_with_it_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("l.obj");
    std::fs::write(&scene, l_shaped()).expect("a scene");
    let points = folder.path().join("points.txt");
    std::fs::write(&points, "0.5 0.5 1  0 0 1\n").expect("points");
    let [scene, points, output, csv] = [
        scene,
        points,
        folder.path().join("f.npz"),
        folder.path().join("f.csv"),
    ]
    .map(|p| p.display().to_string());
    for more in [
        vec!["--rows", "0..2"],
        vec!["--threshold", "1e-3"],
        vec!["--enclosed"],
        vec!["--by", "object"],
        vec!["--group", "a=0..2"],
        vec!["--to-zones"],
        vec!["--points", &points],
        vec!["--precision", "64"],
    ] {
        let mut arguments = vec!["factors", "-q", &scene, "-o", &output, "--compressed"];
        arguments.extend(&more);
        let answer = luxel(&arguments);
        let said = words(&answer.stderr);
        assert_eq!(answer.status.code(), Some(2), "{more:?}");
        let wanted = format!(
            "--compressed: expected all rows between facets, without {}",
            more[0]
        );
        assert!(
            said.contains(&wanted) && said.lines().count() == 1,
            "{said}"
        );
    }
    let answer = luxel(&["factors", "-q", &scene, "-o", &csv, "--compressed"]);
    let said = words(&answer.stderr);
    assert_eq!(answer.status.code(), Some(2));
    assert!(
        said.contains("ends in .npz, found") && said.lines().count() == 1,
        "{said}"
    );
    assert_eq!(
        std::fs::read_dir(folder.path()).expect("a folder").count(),
        2
    );
}

#[test]
fn too_little_memory_names_what_would_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("boxes.obj");
    std::fs::write(&scene, to_obj(&floating_boxes(3000))).expect("a scene");
    let output = folder.path().join("f.npz").display().to_string();
    let scene = scene.display().to_string();
    let run = |memory: &str, more: &[&str]| {
        let mut arguments = vec!["factors", "-q", &scene, "-o", &output, "--memory", memory];
        arguments.extend(more);
        let answer = luxel(&arguments);
        (answer.status.code(), words(&answer.stderr))
    };
    // 4.5 million pairs of which half see each other are 60 MB of the plain form; the program
    // itself takes some 15.
    let (code, said) = run("50MB", &[]);
    assert_eq!((code, said.lines().count()), (Some(2), 1), "{said}");
    assert!(said.contains("more than --memory allows (50 MB)"), "{said}");
    assert!(
        said.contains("pairs were found so far; --compressed takes all rows"),
        "{said}"
    );
    // What cannot be compressed is not told to.
    let (code, said) = run("50MB", &["--enclosed"]);
    assert_eq!(code, Some(2));
    assert!(
        said.contains("--rows 0..1000") && !said.contains("--compressed"),
        "{said}"
    );
    let (code, said) = run("15MB", &["--compressed"]);
    assert_eq!((code, said.lines().count()), (Some(2), 1), "{said}");
    assert!(said.contains("more than --memory allows (15 MB)"), "{said}");
    // Neither leaves anything behind: the work was short.
    assert_eq!(
        std::fs::read_dir(folder.path()).expect("a folder").count(),
        1
    );
    let (code, said) = run("50MB", &["--compressed"]);
    assert_eq!(code, Some(0), "{said}");
}

#[test]
fn the_balance_of_the_guide_closes() {
    let guide = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let there = std::process::Command::new("python3")
        .args(["-c", "import numpy, scipy.sparse.linalg"])
        .output();
    if !there.is_ok_and(|out| out.status.success()) {
        eprintln!("skipped: python3 with numpy and scipy is not there");
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("boxes.obj");
    std::fs::write(&scene, to_obj(&floating_boxes(1000))).expect("a scene");
    let matrix = folder.path().join("f.npz");
    factors(&scene, &matrix, &["--compressed"]);
    let out = std::process::Command::new("python3")
        .arg(guide.join("view-factors-compressed.py"))
        .arg(&matrix)
        .args(["0..165=30", "165..330=18", "--enclosed"])
        .output()
        .expect("python3 runs");
    let said = words(&out.stdout);
    assert!(out.status.success(), "{said}{}", words(&out.stderr));
    let watts = |name: &str| -> f64 {
        let line = said.lines().find(|l| l.trim_start().starts_with(name));
        let mut fields = line.expect("a line").split_whitespace().rev();
        assert_eq!(fields.next(), Some("W"));
        fields
            .next()
            .and_then(|w| w.parse().ok())
            .expect("a number")
    };
    // The guide's balance with the full matrix after closure repair: 353.6746 W. An error of a
    // row, 1e-4 on the mean, is as much of the heat.
    assert!((watts("0..165") - 353.6746).abs() < 0.035, "{said}");
    assert!(watts("sum").abs() < 1e-4, "{said}");
}
