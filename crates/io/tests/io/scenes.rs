//! Real scenes: counts as their makers and other programs have them.

use crate::common::shared;
use luxel_core::{LuminaireKind, Vec3};
use luxel_io::{Document, ReadOptions, Source, read};

fn scene(name: &str) -> Option<Document> {
    let path = shared("data/scenes")?.join(name);
    Some(read(&path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}")))
}

/// Triangles that were dropped, by the warnings.
fn dropped(document: &Document) -> usize {
    document
        .warnings
        .iter()
        .filter(|w| w.what.starts_with("dropped triangles"))
        .map(|w| w.count)
        .sum()
}

#[test]
fn all_eleven_scenes_have_the_triangles_of_the_table() {
    // The table of the data's README: triangles as another program loaded them; emitting
    // materials and lights as its column says.
    let table = [
        (
            "cornell-original/CornellBox-Original.obj",
            36,
            vec!["light"],
            0,
        ),
        ("veach-ajar/veach-ajar.glb", 4_546, vec!["emitter_1000"], 0),
        ("grey-white-room/grey-white-room.glb", 143_163, vec![], 0),
        (
            "japanese-classroom/japanese-classroom.glb",
            103_832,
            vec![],
            0,
        ),
        (
            "contemporary-bathroom/contemporary-bathroom.glb",
            380_290,
            vec!["emitter_30"],
            0,
        ),
        ("godot-living-room/living_room.glb", 5_088, vec![], 0),
        ("vr-gallery/vr-gallery.glb", 1_930, vec!["VR_Gallery"], 0),
        ("pandora/pandora.obj", 60_810, vec![], 0),
        (
            "bimwhale-largebuilding/bimwhale-largebuilding.glb",
            35_458,
            vec![],
            0,
        ),
        (
            "bevy-cornell-baked/CornellBox.glb",
            36,
            vec!["Emitter_Light_temp"],
            0,
        ),
        ("lights-punctual/Lights.glb", 12, vec![], 4),
    ];
    for (name, triangles, emitters, lights) in table {
        let start = std::time::Instant::now();
        let Some(document) = scene(name) else { return };
        let took = start.elapsed();
        let s = &document.scene;
        assert_eq!(document.triangles_read, triangles, "{name}");
        assert_eq!(s.triangles.len() + dropped(&document), triangles, "{name}");
        // What is dropped has no area to speak of: at most one in twenty.
        assert_eq!(s.luminaires.len(), lights, "{name}");
        let mut found: Vec<&str> = s
            .finishes
            .iter()
            .filter(|f| f.emission.is_some())
            .map(|f| f.name.as_str())
            .collect();
        found.dedup();
        assert_eq!(found, emitters, "{name}");
        assert_eq!(s.groups.len(), (emitters.len() + lights).max(1), "{name}");
        eprintln!(
            "{name}: {} of {triangles} triangles, {} vertices, {} surfaces, {} textures, {} views, {took:.2?}",
            s.triangles.len(),
            s.positions.len(),
            s.surfaces.len(),
            s.textures.len(),
            s.views.len()
        );
    }
}

#[test]
fn lights_stand_where_the_file_says() {
    // Nodes and lights as in the file: point 5 cd, spots 10 cd, sun 1 lx (data README).
    let Some(Document { scene, source, .. }) = scene("lights-punctual/Lights.glb") else {
        return;
    };
    let mut kinds = [0; 3];
    for l in &scene.luminaires {
        assert!((l.direction.length() - 1.0).abs() < 1e-6);
        match l.kind {
            LuminaireKind::Point { intensity, .. } => {
                kinds[0] += 1;
                assert!((intensity.max_band() - 5.0).abs() < 1e-5);
            }
            LuminaireKind::Spot {
                intensity,
                cos_inner,
                cos_outer,
                ..
            } => {
                kinds[1] += 1;
                assert!((intensity.max_band() - 10.0).abs() < 1e-5);
                assert!(cos_inner > cos_outer);
            }
            LuminaireKind::Directional { illuminance } => {
                kinds[2] += 1;
                assert!((illuminance.max_band() - 1.0).abs() < 1e-5);
            }
            LuminaireKind::Lambertian { .. } => panic!("glTF has none"),
        }
    }
    assert_eq!(kinds, [1, 2, 1]);
    let Source::Gltf(source) = source else {
        panic!("a glTF file")
    };
    assert_eq!(source.json["asset"]["version"], "2.0");
    assert_eq!(source.buffers.len(), 1);
}

#[test]
fn emitters_are_where_the_notes_say() {
    // Data README, "How to light them": centre, size and direction of the rectangles.
    for (name, group, centre, area, normal) in [
        (
            "veach-ajar/veach-ajar.glb",
            "emitter_1000",
            Vec3::new(-4.439, 1.507, -4.444),
            1.461 * 2.643,
            Vec3::NEG_Z,
        ),
        (
            "contemporary-bathroom/contemporary-bathroom.glb",
            "emitter_30",
            Vec3::new(-2.898, 1.405, -1.393),
            1.303 * 2.0,
            Vec3::X,
        ),
    ] {
        let Some(Document { scene, .. }) = scene(name) else {
            return;
        };
        let (mut sum, mut middle, mut facing) = (0.0, Vec3::ZERO, Vec3::ZERO);
        for t in 0..scene.triangles.len() {
            let Some(e) = &scene.finish_of(t).emission else {
                continue;
            };
            assert_eq!(scene.groups[e.group.index()].name, group);
            let [a, b, c] = scene.corners(t);
            sum += scene.area(t);
            middle += (a + b + c) / 3.0 * scene.area(t);
            facing += (b - a).cross(c - a);
        }
        // The notes have three decimals.
        assert!(
            (middle / sum).distance(centre) < 2e-3,
            "{name}: {}",
            middle / sum
        );
        assert!((sum - area).abs() < 5e-3, "{name}: {sum}");
        assert!(facing.normalize().dot(normal) > 0.999, "{name}: {facing}");
    }
}

#[test]
fn what_the_living_room_loses_has_no_area() {
    // Counted by a script of its own over the file: 3,537 triangles with an area of exactly zero
    // and 36 less than a micrometre high; all others are more than a millimetre high.
    let Some(document) = scene("godot-living-room/living_room.glb") else {
        return;
    };
    let flat: usize = document
        .warnings
        .iter()
        .filter(|w| w.what.ends_with("without area"))
        .map(|w| w.count)
        .sum();
    assert_eq!(flat, 3537 + 36);
}

/// The gltf crate is another reader of the same files: every placed triangle must be where it
/// has it.
#[test]
fn positions_agree_with_the_gltf_crate() {
    let Some(folder) = shared("data/scenes") else {
        return;
    };
    for name in [
        "veach-ajar/veach-ajar.glb",
        "godot-living-room/living_room.glb",
        "bevy-cornell-baked/CornellBox.glb",
    ] {
        let path = folder.join(name);
        let document = read(&path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let (other, buffers, _) = gltf::import(&path).expect("a sound file");
        let mut area = 0.0f64;
        let mut moment = luxel_core::DVec3::ZERO;
        let mut stack: Vec<_> = other
            .default_scene()
            .expect("a scene")
            .nodes()
            .map(|n| (n, luxel_core::glam::DMat4::IDENTITY))
            .collect();
        while let Some((node, parent)) = stack.pop() {
            let own = luxel_core::glam::Mat4::from_cols_array_2d(&node.transform().matrix());
            let world = parent * own.as_dmat4();
            stack.extend(node.children().map(|n| (n, world)));
            for primitive in node.mesh().iter().flat_map(|m| m.primitives()) {
                let reader = primitive.reader(|b| Some(&buffers[b.index()]));
                let p: Vec<_> = reader
                    .read_positions()
                    .expect("positions")
                    .map(|p| world.transform_point3(Vec3::from(p).as_dvec3()))
                    .collect();
                let i: Vec<u32> = reader.read_indices().expect("indices").into_u32().collect();
                for t in i.chunks_exact(3) {
                    let [a, b, c] = [0, 1, 2].map(|k| p[t[k] as usize]);
                    let double = (b - a).cross(c - a);
                    area += 0.5 * double.length();
                    moment += (a + b + c) * double.length();
                }
            }
        }
        let s = &document.scene;
        let (mut own_area, mut own_moment) = (0.0f64, luxel_core::DVec3::ZERO);
        for t in 0..s.triangles.len() {
            let [a, b, c] = s.corners(t).map(|p| p.as_dvec3());
            let double = (b - a).cross(c - a);
            own_area += 0.5 * double.length();
            own_moment += (a + b + c) * double.length();
        }
        // Coincident triangles are dropped here, and f32 keeps seven digits.
        let slack = 1e-5 + 2.0 * dropped(&document) as f64 / s.triangles.len() as f64;
        assert!(
            (own_area / area - 1.0).abs() < slack,
            "{name}: {own_area} and {area}"
        );
        let scale = s.diagonal() as f64 * area;
        assert!(
            (own_moment - moment).length() < slack * 6.0 * scale,
            "{name}: {own_moment} and {moment}"
        );
    }
}
