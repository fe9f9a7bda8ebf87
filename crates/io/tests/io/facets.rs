//! Facets out of every format: the same cube, foreign files, broken ones.

use crate::common::{self, SMALL_OBJ, alone, shared};
use crate::hostile::{bounded_run, files_under};
use luxel_core::{DVec3, Facets};
use luxel_io::{
    FacetDocument, FacetKind, FacetOptions, ReadOptions, read, read_facets, read_facets_bytes,
};
use proptest::prelude::*;
use serde_json::json;

/// Corners of a unit cube, by the bits of their index.
fn corner(k: usize) -> [f64; 3] {
    [k & 1, k >> 1 & 1, k >> 2 & 1].map(|b| b as f64)
}

/// Its triangles, fronts outside.
const TRIANGLES: [[usize; 3]; 12] = [
    [0, 2, 3],
    [0, 3, 1],
    [4, 5, 7],
    [4, 7, 6],
    [0, 1, 5],
    [0, 5, 4],
    [2, 6, 7],
    [2, 7, 3],
    [0, 4, 6],
    [0, 6, 2],
    [1, 3, 7],
    [1, 7, 5],
];

/// The cube in each format.
fn cubes() -> Vec<(FacetKind, &'static str, Vec<u8>)> {
    let at = |k: usize| corner(k).map(|v| v.to_string()).join(" ");
    let mut stl = String::from("solid cube\n");
    let mut stl_binary = vec![b's'; 80];
    stl_binary.extend(12u32.to_le_bytes());
    let mut obj = String::from("o cube\n");
    let mut ply_head = String::from("element vertex 8\n");
    ply_head += "property float x\nproperty float y\nproperty float z\nelement face 12\n";
    ply_head += "property list uchar int vertex_indices\nend_header\n";
    let mut ply = format!("ply\nformat ascii 1.0\n{ply_head}");
    let ply_binary = |order: &str| format!("ply\nformat binary_{order}_endian 1.0\n{ply_head}");
    let mut little = ply_binary("little").into_bytes();
    let mut big = ply_binary("big").into_bytes();
    let mut vs3 = String::from("C encl=1\nF 3\n");
    let mut planes = String::from("F 3a\n");
    let mut bin: Vec<u8> = Vec::new();
    for k in 0..8 {
        obj += &format!("v {}\n", at(k));
        ply += &format!("{}\n", at(k));
        vs3 += &format!("V {} {}\n", k + 1, at(k));
        for v in corner(k) {
            little.extend((v as f32).to_le_bytes());
            big.extend((v as f32).to_be_bytes());
            bin.extend((v as f32).to_le_bytes());
        }
    }
    for (n, t) in TRIANGLES.iter().enumerate() {
        stl += "facet normal 0 0 0\nouter loop\n";
        stl_binary.extend([0; 12]);
        for k in t {
            stl += &format!("vertex {}\n", at(*k));
            for v in corner(*k) {
                stl_binary.extend((v as f32).to_le_bytes());
            }
        }
        stl += "endloop\nendfacet\n";
        stl_binary.extend([0; 2]);
        let [a, b, c] = *t;
        obj += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
        ply += &format!("3 {a} {b} {c}\n");
        little.push(3);
        big.push(3);
        for k in t {
            little.extend((*k as i32).to_le_bytes());
            big.extend((*k as i32).to_be_bytes());
            bin.push(*k as u8);
        }
        let (a, b, c) = (a + 1, b + 1, c + 1);
        vs3 += &format!("S {} {a} {b} {c} 0 0 0 0.9 s{n}\n", n + 1);
        planes += &plane(n, t.map(|k| DVec3::from(corner(k))));
    }
    stl += "endsolid cube\n";
    vs3 += "End\n";
    let gltf = json!({
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0, "name": "cube"}],
        "materials": [{"name": "glass", "normalTexture": {"index": 7},
            "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1.0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 9}, "indices": 1, "material": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5121, "count": 36, "type": "SCALAR"}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 96},
            {"buffer": 0, "byteOffset": 96, "byteLength": 36}],
        "buffers": [{"byteLength": 132}],
    });
    vec![
        (FacetKind::Obj, "cube.obj", obj.into_bytes()),
        (FacetKind::Stl, "ascii.stl", stl.into_bytes()),
        (FacetKind::Stl, "binary.stl", stl_binary),
        (FacetKind::Ply, "ascii.ply", ply.into_bytes()),
        (FacetKind::Ply, "little.ply", little),
        (FacetKind::Ply, "big.ply", big),
        (FacetKind::Gltf, "cube.glb", common::glb(&gltf, &bin)),
        (FacetKind::Vs3, "cube.vs3", vs3.into_bytes()),
        (FacetKind::Vs3, "planes.vs3", planes.into_bytes()),
    ]
}

/// A triangle of the cube as a surface of geometry 3a. Its plane stands on the first corner.
fn plane(n: usize, [a, b, c]: [DVec3; 3]) -> String {
    let normal = (b - a).cross(c - a).normalize();
    let tilt = normal.z.acos().to_degrees().round();
    let azimuth = normal.x.atan2(normal.y).to_degrees().round();
    // To the right and up, seen from the front, as the manual has them.
    let right = DVec3::new(-azimuth.to_radians().cos(), azimuth.to_radians().sin(), 0.0);
    let up = normal.cross(right);
    let local =
        [a, b, c].map(|p| format!("{} {}", (p - a).dot(right).round(), (p - a).dot(up).round()));
    format!(
        "S {} T 0 0 0.9 s{n}\n{} {} {} {azimuth} {tilt}\n{}\n",
        n + 1,
        a.x,
        a.y,
        a.z,
        local.join(" ")
    )
}

fn read_bytes_of(kind: FacetKind, name: &str, bytes: &[u8]) -> Result<FacetDocument, String> {
    let options = FacetOptions {
        memory: 300_000_000,
        ..FacetOptions::default()
    };
    let document = bounded_run(name, || {
        read_facets_bytes(kind, name, bytes.to_vec(), &alone, &options)
    })?;
    check(name, &document);
    Ok(document)
}

/// What `Facets` promises.
fn check(what: &str, document: &FacetDocument) {
    let f = &document.facets;
    assert!(!f.rows.is_empty(), "{what}");
    assert!(f.rounding_m.is_finite() && f.rounding_m >= 0.0, "{what}");
    for row in &f.rows {
        assert!((row.object as usize) < f.objects.len(), "{what}");
        assert!((row.material as usize) < f.materials.len(), "{what}");
    }
    let emissivity = &document.emissivity;
    assert!(
        emissivity.is_empty() || emissivity.len() == f.rows.len(),
        "{what}"
    );
    assert!(emissivity.iter().all(|e| (0.0..=1.0).contains(e)), "{what}");
    for part in &f.parts {
        let known = (part.row as usize) < f.rows.len() || part.row == Facets::NO_ROW;
        assert!(known, "{what}");
        let p = &part.polygon;
        assert!(p.vertices.iter().all(|v| v.is_finite()), "{what}");
        assert!(p.vertices.len() >= 3 && p.area() > 0.0, "{what}");
    }
}

#[test]
fn the_same_cube_from_every_format() {
    let cubes = cubes();
    let first = read_bytes_of(cubes[0].0, cubes[0].1, &cubes[0].2).unwrap();
    assert_eq!(first.facets.areas(), [0.5; 12]);
    for (kind, name, bytes) in &cubes {
        let d = read_bytes_of(*kind, name, bytes).unwrap();
        assert_eq!(d.facets.parts, first.facets.parts, "{name}");
        assert!(d.warnings.is_empty(), "{name}: {:?}", d.warnings);
        assert!(name.starts_with(&d.facets.name), "{name}");
        assert_eq!(d.enclosed, *name == "cube.vs3");
        let named: Vec<&String> = d.facets.objects.iter().filter(|o| !o.is_empty()).collect();
        let has_objects = !matches!(*name, "binary.stl") && name.rsplit('.').next() != Some("ply");
        let has_objects = has_objects && *kind != FacetKind::Vs3;
        assert_eq!(named.len(), has_objects as usize, "{name}: {named:?}");
        // Outwards: from the middle, all corners lie before the planes.
        for part in &d.facets.parts {
            let p = &part.polygon;
            let outwards = (p.centre() - DVec3::splat(0.5)).dot(p.normal());
            assert!((outwards - 0.5).abs() < 1e-12, "{name}");
        }
        let options = FacetOptions {
            scale: 2.0,
            flip: true,
            ..FacetOptions::default()
        };
        let turned = read_facets_bytes(*kind, name, bytes.clone(), &alone, &options).unwrap();
        for (a, b) in d.facets.parts.iter().zip(&turned.facets.parts) {
            assert_eq!(a.polygon.area_vector() * -4.0, b.polygon.area_vector());
        }
        assert_eq!(turned.facets.rounding_m, 2.0 * d.facets.rounding_m);
        assert_eq!(turned.fingerprint, d.fingerprint);
    }
}

#[test]
fn triangles_of_a_gltf_keep_their_order_whatever_a_scene_would_drop() {
    // The scene reader drops a triangle without area and the second of two; facets keep both.
    let corners: [f32; 12] = [0., 0., 0., 1., 0., 0., 0., 1., 0., 2., 0., 0.];
    let mut bin: Vec<u8> = corners.iter().flat_map(|v| v.to_le_bytes()).collect();
    bin.extend([0, 1, 2, 0, 1, 3, 0, 1, 2, 0, 2, 3]);
    let file = |second: u8| {
        let mut bin = bin.clone();
        bin[48 + 1] = second;
        let json = json!({
            "asset": {"version": "2.0"},
            "nodes": [{"mesh": 0, "name": "a"},
                {"mesh": 0, "matrix": [-1,0,0,0, 0,1,0,0, 0,0,1,0, 5,0,0,1]}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
                {"bufferView": 1, "componentType": 5121, "count": 12, "type": "SCALAR"}],
            "bufferViews": [
                {"buffer": 0, "byteOffset": 0, "byteLength": 48},
                {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
            "buffers": [{"byteLength": 60}],
        });
        common::glb(&json, &bin)
    };
    let d = read_bytes_of(FacetKind::Gltf, "x.glb", &file(1)).unwrap();
    let areas = [0.5, 0.0, 0.5, 1.0, 0.5, 0.0, 0.5, 1.0];
    assert_eq!(d.facets.areas(), areas);
    let said: Vec<String> = d.warnings.iter().map(|w| w.to_string()).collect();
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].starts_with("x.glb: facet 2: facets without area"));
    assert_eq!(d.facets.objects, ["a", "node 1"]);
    // A mirrored node turns the order of corners, not the front.
    let normals: Vec<f64> = d
        .facets
        .parts
        .iter()
        .map(|p| p.polygon.normal().z)
        .collect();
    assert_eq!(normals, [1.0, 1.0, -1.0, 1.0, 1.0, -1.0]);
}

#[test]
fn a_gltf_that_is_broken_says_where() {
    let corners = [0f32, 0., 0., 1., f32::NAN, 0., 0., 1., 0.];
    let bin: Vec<u8> = corners.iter().flat_map(|v| v.to_le_bytes()).collect();
    let json = json!({
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0, "name": "roof"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
    });
    assert_eq!(
        read_bytes_of(FacetKind::Gltf, "x.glb", &common::glb(&json, &bin)).unwrap_err(),
        "x.glb: 'roof', triangle 0: expected a finite coordinate, found NaN"
    );
}

#[test]
fn files_are_known_by_their_extension() {
    let error = read_facets("room.dxf".as_ref(), &FacetOptions::default()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "room.dxf: expected a file of facets .stl, .ply, .obj, .glb, .gltf or .vs3, found .dxf"
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("Cube.STL");
    std::fs::write(&path, &cubes()[2].2).unwrap();
    let d = read_facets(&path, &FacetOptions::default()).unwrap();
    assert_eq!(d.facets.name, "Cube");
    let small = FacetOptions {
        memory: 100,
        ..FacetOptions::default()
    };
    let error = read_facets(&path, &small).unwrap_err().to_string();
    assert!(
        error.contains("more than the 1 kB that may be used"),
        "{error}"
    );
}

#[test]
fn foreign_scenes_have_the_area_that_the_scene_reader_finds() {
    let Some(folder) = shared("data/scenes") else {
        return;
    };
    for (name, rows) in [
        // Quads of the box stay whole: 36 triangles, 18 faces.
        ("cornell-original/CornellBox-Original.obj", 18),
        ("pandora/pandora.obj", 0),
        ("veach-ajar/veach-ajar.glb", 4_546),
        ("bevy-cornell-baked/CornellBox.glb", 36),
    ] {
        let path = folder.join(name);
        let start = std::time::Instant::now();
        let d = read_facets(&path, &FacetOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        check(name, &d);
        let f = &d.facets;
        eprintln!(
            "{name}: {} rows, {} parts, {} objects, {} materials, known to {:.1e} m, {:?}",
            f.rows.len(),
            f.parts.len(),
            f.objects.len(),
            f.materials.len(),
            f.rounding_m,
            start.elapsed()
        );
        d.warnings.iter().for_each(|w| eprintln!("  {w}"));
        assert!(
            rows == 0 || f.rows.len() == rows,
            "{name}: {}",
            f.rows.len()
        );
        let area: f64 = f.areas().iter().sum();
        let document = read(&path, &ReadOptions::default()).unwrap();
        let scene = &document.scene;
        let other: f64 = (0..scene.triangles.len())
            .map(|t| scene.area(t) as f64)
            .sum();
        // The scene has lost coincident triangles, never gained any.
        assert!(area >= other * (1.0 - 1e-5), "{name}: {area} and {other}");
        assert!(area <= other * 1.1, "{name}: {area} and {other}");
    }
}

#[test]
fn hostile_files_end_in_facets_or_in_one_line() {
    let Some(folder) = shared("data/hostile") else {
        return;
    };
    let (mut good, mut all) = (0, 0);
    for path in files_under(&folder) {
        let what = path.display().to_string();
        let options = FacetOptions {
            memory: 300_000_000,
            ..FacetOptions::default()
        };
        match bounded_run(&what, || read_facets(&path, &options)) {
            Ok(d) => {
                check(&what, &d);
                good += 1;
            }
            // Light needs more of a file than facets do.
            Err(why) => {
                let scene = read(&path, &ReadOptions::default());
                assert!(scene.is_err(), "{why}, but a scene reads");
            }
        }
        all += 1;
        // And as what it is not.
        let bytes = std::fs::read(&path).unwrap();
        for (kind, name, _) in cubes() {
            let _ = read_bytes_of(kind, name, &bytes);
        }
    }
    eprintln!("{good} of {all} files read");
    assert!(good > 50, "{good} of {all}");
}

/// Sound files of every format, small ones.
fn sound() -> Vec<(FacetKind, &'static str, Vec<u8>)> {
    let mut files = cubes();
    files.push((FacetKind::Obj, "small.obj", SMALL_OBJ.into()));
    files.push((FacetKind::Gltf, "small.glb", common::small_glb()));
    let wall = "T a wall\nC eps=1e-4\nF 3\nV 1 0 0 0\nV 2 4 0 0\nV 3 4 3 0\nV 4 0 3 0\n\
        V 5 1 1 0\nV 6 2 1 0\nV 7 2 2 0\nV 8 1 2 0\nS 1 1 2 3 4 0 0 .9 wall\n\
        S 2 5 6 7 8 1 0 .8 window\nN 3 5 6 7 0 2 0 .8 hole\nS 4 4 3 2 1 0 1 .5 back\nO 5 1 2 3 4\n";
    files.push((FacetKind::Vs3, "wall.vs3", wall.into()));
    files
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_end_in_facets_or_in_one_line(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        for (kind, name, _) in sound() {
            let _ = read_bytes_of(kind, name, &bytes);
        }
    }

    #[test]
    fn changed_files_end_in_facets_or_in_one_line(
        changes in proptest::collection::vec((any::<u32>(), any::<u8>()), 1..6),
        cut in proptest::option::of(any::<u32>()),
        swap in any::<(u32, u32, u8)>(),
    ) {
        for (kind, name, mut bytes) in sound() {
            for (at, value) in &changes {
                let at = *at as usize % bytes.len();
                // Mostly what the text is made of, or a bit.
                bytes[at] = match value % 4 {
                    0 => b"0123456789-+.e \n/!,SNOEf"[*value as usize / 4 % 24],
                    1 => *value,
                    _ => bytes[at] ^ 1 << (value / 4 % 8),
                };
            }
            let (from, to, length) = swap;
            let from = from as usize % bytes.len();
            let end = (from + length as usize % 40).min(bytes.len());
            let piece = bytes[from..end].to_vec();
            let to = to as usize % bytes.len();
            bytes.splice(to..to, piece);
            if let Some(cut) = cut {
                bytes.truncate(cut as usize % bytes.len());
            }
            let _ = read_bytes_of(kind, name, &bytes);
        }
    }
}

/// Bytes without a pattern, the same each time (splitmix64).
fn noise(count: usize, seed: u64) -> Vec<u8> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    (0..count).map(|_| next() as u8).collect()
}

#[test]
fn noise_is_refused_in_a_short_line_that_can_be_shown() {
    for (name, says) in [
        ("x.stl", "a text that begins with 'solid', or 50 bytes"),
        (
            "x.ply",
            "x.ply:1: expected 'ply', found bytes that are no text",
        ),
        (
            "x.obj",
            "x.obj: expected a text with lines 'v' and 'f', found bytes that are no text",
        ),
        (
            "x.glb",
            "x.glb: expected 'glTF' and binary data, or JSON, found bytes that are no text",
        ),
        (
            "x.vs3",
            "x.vs3: expected a text with lines T, C, F, V, S, N, O or E, found bytes",
        ),
    ] {
        let kind = FacetKind::of(std::path::Path::new(name)).expect("known");
        let read = |bytes: Vec<u8>| {
            read_facets_bytes(kind, name, bytes, &alone, &FacetOptions::default())
                .map(|_| ())
                .expect_err("noise")
                .to_string()
        };
        let fit = |told: &str| {
            let shown = |c: char| !c.is_control() && c != char::REPLACEMENT_CHARACTER;
            told.chars().all(shown) && told.chars().count() < 160
        };
        for seed in 0..40 {
            let told = read(noise(3000, seed));
            assert!(told.contains(says) && fit(&told), "{seed}: {told}");
            // Of short ones too little is seen to say what they are.
            for count in [0, 1, 3, 20, 90, 200] {
                let told = read(noise(count, 100 + seed));
                assert!(fit(&told), "{seed}, {count}: {told}");
            }
        }
    }
}
