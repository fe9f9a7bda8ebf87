//! What a file says is what the scene holds: one small file with everything, and one file for
//! each thing that is refused.

use crate::common::{SMALL_OBJ, alone, glb, png, small_glb, with_mtl};
use luxel_core::{Alpha, LuminaireKind, Rgb, Vec2, Vec3};
use luxel_io::{Back, Document, Error, Kind, ReadOptions, Source, Up, read_bytes};
use serde_json::{Value, json};

fn gltf(bytes: Vec<u8>, options: &ReadOptions) -> Result<Document, Error> {
    read_bytes(Kind::Gltf, "small.glb", bytes, &alone, options)
}

fn small(options: &ReadOptions) -> Document {
    gltf(small_glb(), options).unwrap_or_else(|e| panic!("{e}"))
}

fn close(a: Vec3, b: Vec3) {
    // f32 through a few rotations of unit size.
    assert!(a.distance(b) < 1e-5, "{a} is not {b}");
}

#[test]
fn places_names_and_instances() {
    let Document {
        scene,
        triangles_read,
        ..
    } = small(&ReadOptions::default());
    assert_eq!(
        (scene.name.as_str(), scene.up, triangles_read),
        ("small", Vec3::Y, 8)
    );
    let names: Vec<&str> = scene.surfaces.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "wall, paper",
            "wall, panel",
            "mirrored wall, paper",
            "mirrored wall, panel"
        ]
    );
    let s = &scene.surfaces[2];
    assert_eq!((s.node, s.mesh, s.primitive), (2, 0, 0));
    // wall: scale 2, then z - 3.
    let [a, b, c] = scene.corners(scene.surfaces[0].triangles.start as usize);
    close(a, Vec3::new(0.0, 0.0, -3.0));
    close(b, Vec3::new(2.0, 0.0, -3.0));
    close(c, Vec3::new(2.0, 2.0, -3.0));
    // mirrored wall: x becomes 5 - x, and the winding is turned so that the front stays at +z.
    for s in [&scene.surfaces[0], &scene.surfaces[2]] {
        let [a, b, c] = scene.corners(s.triangles.start as usize);
        close((b - a).cross(c - a).normalize(), Vec3::Z);
    }
    close(
        scene.corners(scene.surfaces[2].triangles.start as usize)[0],
        Vec3::new(5.0, 0.0, -3.0),
    );
    // The strip's sparse accessor moved corner 2 to (2, 2).
    let strip = &scene.surfaces[1];
    assert_eq!(strip.triangles.len(), 2);
    let far = strip
        .triangles
        .clone()
        .flat_map(|t| scene.corners(t as usize));
    assert!(
        far.into_iter()
            .any(|p| p.distance(Vec3::new(4.0, 4.0, -3.0)) < 1e-5)
    );
}

#[test]
fn finishes_textures_and_emission() {
    let Document { scene, .. } = small(&ReadOptions::default());
    let paper = scene.finish_of(0);
    assert_eq!(paper.reflectance, Rgb::splat(0.5));
    assert_eq!(paper.alpha, Alpha::Mask { cutoff: 0.5 });
    assert!(!paper.back_reflects && !paper.back_emits && paper.emission.is_none());
    // KHR_texture_transform: uv' = 2 uv + (0.25, 0). Corner 1 has uv (1, 0).
    assert_eq!(scene.uvs[0][1], Vec2::new(2.25, 0.0));
    let texture = &scene.textures[paper.texture.expect("a texture").index()];
    assert_eq!((texture.width, texture.height), (4, 2));
    assert_eq!(
        texture.wrap,
        [
            luxel_core::texture::Wrap::Clamp,
            luxel_core::texture::Wrap::Mirror
        ]
    );
    // Texel (3, 0) was written as red 180: 0.4564 linear; clamped beyond the right border.
    let reflected = scene.reflectance_at(0, 1.0, 0.0);
    assert!((reflected.r - 0.5 * 0.4564).abs() < 1e-4, "{reflected:?}");
    let panel = scene.finish_of(scene.surfaces[1].triangles.start as usize);
    let emission = panel.emission.as_ref().expect("it shines");
    assert_eq!(emission.luminance, Rgb::new(2000.0, 1000.0, 500.0));
    assert!(panel.back_reflects && panel.back_emits);
    let groups: Vec<&str> = scene.groups.iter().map(|g| g.name.as_str()).collect();
    assert_eq!(groups, ["panel", "bulb", "spot", "light 2"]);
}

#[test]
fn luminaires_and_views() {
    let Document { scene, .. } = small(&ReadOptions {
        scale: 2.0,
        ..ReadOptions::default()
    });
    let [bulb, spot, sun] = scene.luminaires.as_slice() else {
        panic!("three lights")
    };
    // Place and range are lengths, intensity is none.
    close(bulb.position, Vec3::new(2.0, 2.0, -4.0));
    assert_eq!(
        bulb.kind,
        LuminaireKind::Point {
            intensity: Rgb::new(10.0, 5.0, 2.5),
            range_m: 14.0
        }
    );
    // A quarter turn around x: -z becomes -y.
    close(spot.direction, Vec3::NEG_Y);
    let LuminaireKind::Spot {
        cos_inner,
        cos_outer,
        range_m,
        ..
    } = spot.kind
    else {
        panic!()
    };
    assert!((cos_inner - 0.2f32.cos()).abs() < 1e-6 && (cos_outer - 0.4f32.cos()).abs() < 1e-6);
    assert!(range_m.is_infinite());
    close(sun.direction, Vec3::NEG_Y);
    let view = &scene.views[0];
    assert_eq!((view.name.as_str(), view.vertical_angle), ("eye", 0.8));
    close(view.eye, Vec3::new(2.0, 4.0, 6.0));
    close(view.forward, Vec3::NEG_X);
    close(view.up, Vec3::Y);
}

#[test]
fn options_overrule_the_file() {
    let options = ReadOptions {
        up: Some(Up::Z),
        back: Some(Back::Same),
        max_reflectance: 0.25,
        ..ReadOptions::default()
    };
    let Document {
        scene, warnings, ..
    } = small(&options);
    assert_eq!(scene.up, Vec3::Z);
    assert!(scene.finishes.iter().all(|f| f.back_reflects));
    assert!(!scene.finish_of(0).back_emits);
    assert!(warnings.iter().any(|w| w.what.contains("0.25")));
    let black = ReadOptions {
        back: Some(Back::Black),
        ..ReadOptions::default()
    };
    assert!(
        small(&black)
            .scene
            .finishes
            .iter()
            .all(|f| !f.back_reflects)
    );
    let tight = ReadOptions {
        memory_limit: 20_000,
        ..ReadOptions::default()
    };
    let line = gltf(small_glb(), &tight)
        .expect_err("not within 20 kB")
        .to_string();
    assert!(
        line.starts_with("small.glb: ") && line.contains("20 kB of memory"),
        "{line}"
    );
}

#[test]
fn the_source_keeps_json_and_bytes() {
    let Source::Gltf(source) = small(&ReadOptions::default()).source else {
        panic!("glTF")
    };
    assert_eq!(source.json["nodes"][3]["name"], "eye");
    let length = source.json["buffers"][0]["byteLength"]
        .as_u64()
        .expect("a number") as usize;
    assert!(source.buffers[0].len() >= length && length > 0);
}

/// A single triangle, with changes to the JSON.
fn triangle(change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let bin: Vec<u8> = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let mut json = json!({
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"name": "m"}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
    });
    change(&mut json);
    glb(&json, &bin)
}

#[test]
fn refusals_name_place_expected_and_found() {
    type Change = fn(&mut Value);
    let cases: [(Change, &str); 9] = [
        (
            |j| j["accessors"][0]["type"] = json!("VEC2"),
            "mesh 0, primitive 0, POSITION, accessor 0: expected VEC3, found 'VEC2'",
        ),
        (
            |j| j["accessors"][0]["count"] = json!(4_000_000_000u64),
            "accessor 0: expected 48000000000 bytes for 4000000000 values, found 36 bytes in its buffer view",
        ),
        (
            |j| j["nodes"][0]["mesh"] = json!(7),
            "node 0: expected one of 1 meshes, found index 7",
        ),
        (
            |j| j["nodes"][0]["children"] = json!([0]),
            "expected triangles, found none",
        ),
        (
            |j| {
                j["scenes"] = json!([{"nodes": [0]}]);
                j["nodes"][0]["children"] = json!([0]);
            },
            "node 0: expected a tree of nodes, found a second parent or a loop",
        ),
        (
            |j| j["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]),
            "found required KHR_draco_mesh_compression",
        ),
        (
            |j| j["buffers"][0]["uri"] = json!("../secret.bin"),
            "buffer 0: expected 36 bytes, found '../secret.bin': no file ../secret.bin",
        ),
        (
            |j| j["bufferViews"][0]["byteOffset"] = json!(u64::MAX),
            "bufferView 0: expected bytes 18446744073709551615 to 18446744073709551615, found 36 bytes in buffer 0",
        ),
        (
            |j| j["asset"]["version"] = json!("1.0"),
            "asset: expected glTF 2, found version '1.0'",
        ),
    ];
    for (change, expected) in cases {
        let line = gltf(triangle(change), &ReadOptions::default())
            .expect_err(expected)
            .to_string();
        assert!(
            line.starts_with("small.glb: ") && line.contains(expected),
            "{line}\n{expected}"
        );
    }
}

#[test]
fn node_errors_and_draco_without_plain_data_are_refused_by_name() {
    let bytes = triangle(|j| {
        j["accessors"][0]
            .as_object_mut()
            .expect("an object")
            .remove("bufferView");
        j["meshes"][0]["primitives"][0]["extensions"] = json!({"KHR_draco_mesh_compression": {}});
    });
    let line = gltf(bytes, &ReadOptions::default())
        .expect_err("compressed")
        .to_string();
    assert!(line.contains("KHR_draco_mesh_compression"), "{line}");
    let bytes = triangle(|j| {
        j["buffers"] = json!([{"byteLength": 36}, {"byteLength": 36}]);
        j["bufferViews"][0]["buffer"] = json!(1);
        j["bufferViews"][0]["extensions"] = json!({"EXT_meshopt_compression": {}});
    });
    let line = gltf(bytes, &ReadOptions::default())
        .expect_err("compressed")
        .to_string();
    assert!(line.contains("EXT_meshopt_compression"), "{line}");
}

#[test]
fn glass_blend_and_unread_pictures_are_said() {
    let document = gltf(
        triangle(|j| {
            j["materials"][0] = json!({"name": "pane", "alphaMode": "BLEND",
                "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.25], "baseColorTexture": {"index": 0}},
                "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1.0}}});
            j["textures"] = json!([{"extensions": {"EXT_texture_webp": {"source": 0}}}]);
            j["extensionsRequired"] = json!(["EXT_texture_webp"]);
        }),
        &ReadOptions::default(),
    )
    .unwrap_or_else(|e| panic!("{e}"));
    let pane = document.scene.finish_of(0);
    assert!(pane.transparent && pane.alpha == Alpha::Blend && pane.coverage == 0.25);
    let said: Vec<String> = document.warnings.iter().map(|w| w.to_string()).collect();
    assert!(said.iter().any(|w| w.contains("'pane': glass")), "{said:?}");
    assert_eq!(
        document.scene.groups.len(),
        1,
        "one group even when nothing shines"
    );
}

#[test]
fn vertex_colours_multiply_the_base_colour() {
    // COLOR_0 of the corners: the reader takes each triangle's mean, as the light oracle does.
    let bytes = |second: [f32; 3]| {
        let mut bin = Vec::new();
        for p in [
            [0f32, 0., 0.],
            [1., 0., 0.],
            [0., 1., 0.],
            [0., 0., 1.],
            [1., 0., 1.],
            [0., 1., 1.],
        ] {
            bin.extend(p.iter().flat_map(|v| v.to_le_bytes()));
        }
        for c in [[0.2f32, 0.4, 0.8]; 3].into_iter().chain([second; 3]) {
            bin.extend(c.iter().flat_map(|v| v.to_le_bytes()));
        }
        glb(
            &json!({"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "material": 0}]}],
                "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]}}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": 6, "type": "VEC3"},
                    {"bufferView": 0, "byteOffset": 72, "componentType": 5126, "count": 6, "type": "VEC3"}],
                "bufferViews": [{"buffer": 0, "byteLength": 144}], "buffers": [{"byteLength": 144}]}),
            &bin,
        )
    };
    let scene = gltf(bytes([0.2, 0.4, 0.8]), &ReadOptions::default())
        .expect("sound")
        .scene;
    assert!(scene.finish_of(0).texture.is_none());
    let r = scene.reflectance_at(0, 0.3, 0.3);
    assert!((r.r - 0.1).abs() < 1e-6 && (r.g - 0.2).abs() < 1e-6 && (r.b - 0.4).abs() < 1e-6);
    let scene = gltf(bytes([0.9, 0.1, 0.5]), &ReadOptions::default())
        .expect("sound")
        .scene;
    for (t, expected) in [(0, [0.1, 0.2, 0.4]), (1, [0.45, 0.05, 0.25])] {
        let r = scene.reflectance_at(t, 0.3, 0.3).to_array();
        for band in 0..3 {
            // Kept as an sRGB byte: half a step of it is at most 1 % at these values.
            assert!(
                (r[band] - expected[band]).abs() < 0.01 * expected[band],
                "{r:?}"
            );
        }
    }
}

#[test]
fn emission_on_other_coordinates_becomes_its_mean() {
    // Half of the picture is white, half black; the triangle's second coordinates cover all of
    // the white half only.
    let picture = png(8, 8, |x, _| if x < 4 { [255; 4] } else { [0, 0, 0, 255] });
    let mut bin: Vec<u8> = Vec::new();
    let floats: [f32; 21] = [
        0., 0., 0., 1., 0., 0., 0., 1., 0., // places
        0., 0., 1., 0., 0., 1., // first coordinates
        0.1, 0.1, 0.3, 0.1, 0.1, 0.9, // second coordinates
    ];
    bin.extend(floats.iter().flat_map(|v| v.to_le_bytes()));
    bin.extend(&picture);
    let bytes = glb(
        &json!({"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1, "TEXCOORD_1": 2}, "material": 0}]}],
            "materials": [{"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0, "texCoord": 1},
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
                "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 100}}}],
            "textures": [{"source": 0}], "images": [{"bufferView": 1}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
                {"bufferView": 0, "byteOffset": 36, "componentType": 5126, "count": 3, "type": "VEC2"},
                {"bufferView": 0, "byteOffset": 60, "componentType": 5126, "count": 3, "type": "VEC2"}],
            "bufferViews": [{"buffer": 0, "byteLength": 84}, {"buffer": 0, "byteOffset": 84, "byteLength": picture.len()}],
            "buffers": [{"byteLength": bin.len()}]}),
        &bin,
    );
    let document = gltf(bytes, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    let emission = document
        .scene
        .finish_of(0)
        .emission
        .as_ref()
        .expect("it shines");
    assert!(emission.texture.is_none());
    assert!((emission.luminance.g - 100.0).abs() < 1e-3, "{emission:?}");
}

#[test]
fn obj_surfaces_materials_and_polygons() {
    let bytes = SMALL_OBJ.as_bytes().to_vec();
    let document = read_bytes(
        Kind::Obj,
        "small.obj",
        bytes,
        &with_mtl,
        &ReadOptions::default(),
    )
    .unwrap_or_else(|e| panic!("{e}"));
    let scene = &document.scene;
    let names: Vec<&str> = scene.surfaces.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["floor", "lamp, left"]);
    // A square of 4 m with a triangle of 4 m x 3 m cut out of one side: 16 - 6.
    let area: f32 = scene.surfaces[0]
        .triangles
        .clone()
        .map(|t| scene.area(t as usize))
        .sum();
    assert!((area - 10.0).abs() < 1e-5, "{area}");
    let light = scene.finish_of(scene.surfaces[1].triangles.start as usize);
    assert_eq!(
        light.emission.as_ref().expect("it shines").luminance,
        Rgb::new(1000.0, 900.0, 800.0)
    );
    assert!(light.back_reflects && !light.back_emits);
    let said: Vec<String> = document.warnings.iter().map(|w| w.to_string()).collect();
    assert_eq!(
        said,
        ["small.obj: points and lines have no area and are left out"]
    );
}

#[test]
fn lamps_emission_sky_and_groups_from_the_command_line() {
    use luxel_io::scene_ops::{add_lamp, merge_groups, set_emission, set_sky};
    let mut scene = gltf(triangle(|_| ()), &ReadOptions::default())
        .expect("sound")
        .scene;
    assert_eq!(scene.groups.len(), 1);
    add_lamp(&mut scene, "10cd@0,3,0>0,-2,0:15,22.5*1,0.5,0").expect("a spot");
    add_lamp(&mut scene, "1000lx@0,-1,0").expect("a sun");
    set_emission(&mut scene, "m=5000").expect("a material");
    set_sky(&mut scene, "3000").expect("a sky");
    let names = |s: &luxel_core::Scene| -> Vec<String> {
        s.groups.iter().map(|g| g.name.clone()).collect()
    };
    assert_eq!(
        names(&scene),
        [
            "10cd@0,3,0>0,-2,0:15,22.5*1,0.5,0",
            "1000lx@0,-1,0",
            "m",
            "sky"
        ]
    );
    let LuminaireKind::Spot {
        intensity,
        cos_outer,
        ..
    } = scene.luminaires[0].kind
    else {
        panic!()
    };
    assert_eq!(intensity, Rgb::new(10.0, 5.0, 0.0));
    assert!((cos_outer - 22.5f32.to_radians().cos()).abs() < 1e-6);
    assert_eq!(scene.luminaires[0].direction, Vec3::NEG_Y);
    merge_groups(&mut scene, "day=sky,1000lx@0,-1,0").expect("two groups");
    assert_eq!(
        names(&scene),
        ["10cd@0,3,0>0,-2,0:15,22.5*1,0.5,0", "day", "m"]
    );
    assert_eq!(
        scene.sky.as_ref().expect("a sky").group,
        scene.luminaires[1].group
    );
    set_emission(&mut scene, "m=0").expect("out");
    assert_eq!(names(&scene).len(), 2);
    for bad in [
        "800lm",
        "800lm@1,2",
        "lm@1,2,3",
        "5lm@1,2,3>0,0,1",
        "9lx@0,0,0",
        "5cd@0,0,0>1,0,0:30,20",
        "é",
        "",
    ] {
        let line = add_lamp(&mut scene, bad).expect_err(bad);
        assert!(line.contains("expected 800lm@x,y,z"), "{line}");
    }
    let line = set_emission(&mut scene, "wood=5").expect_err("no such material");
    assert_eq!(line, "no material 'wood'; there are: m");
    let line = merge_groups(&mut scene, "a=lamp").expect_err("no such group");
    assert!(
        line.starts_with("no light group 'lamp'; there are: "),
        "{line}"
    );
    assert!(set_sky(&mut scene, "blue").is_err());
}
