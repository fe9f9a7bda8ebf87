use super::*;
use crate::document::GltfSource;
use luxel_core::texture::Wrap;
use luxel_core::{
    Emission, Finish, Group, GroupId, Luminaire, LuminaireKind, Surface, Texture, View as Look,
};

/// A textured floor, a lamp, a black box's face and a pane of glass, one triangle each.
fn scene() -> Scene {
    let texture = Texture {
        name: "boards".into(),
        width: 2,
        height: 1,
        rgba: vec![[255, 0, 0, 255], [0, 255, 0, 255]],
        wrap: [Wrap::Repeat, Wrap::Clamp],
    };
    let finish = |name: &str| Finish {
        name: name.into(),
        ..Finish::default()
    };
    let lamp = Emission {
        luminance: Rgb::splat(1000.0),
        texture: None,
        group: GroupId(0),
    };
    let finishes = vec![
        Finish {
            texture: Some(TextureId(0)),
            ..finish("floor")
        },
        Finish {
            emission: Some(lamp),
            ..finish("lamp")
        },
        Finish {
            reflectance: Rgb::BLACK,
            ..finish("black")
        },
        Finish {
            transparent: true,
            ..finish("glass")
        },
    ];
    let surface = |k: u32| Surface {
        name: format!("surface {k}"),
        finish: FinishId(k),
        triangles: k..k + 1,
        node: k,
        mesh: 0,
        primitive: k,
    };
    let corner = |k: u32| [0.0, 1.0, 2.0].map(|z| Vec3::new(k as f32, z * z, z));
    Scene {
        name: "test".into(),
        positions: (0..4).flat_map(corner).collect(),
        triangles: (0..4).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect(),
        uvs: vec![[Vec2::ZERO, Vec2::X, Vec2::Y]; 4],
        surface_of: (0..4).map(SurfaceId).collect(),
        source_triangle: vec![0; 4],
        surfaces: (0..4).map(surface).collect(),
        finishes,
        textures: vec![texture],
        luminaires: vec![Luminaire {
            name: "spot".into(),
            position: Vec3::new(1.0, 3.0, 1.0),
            direction: -Vec3::Y,
            kind: LuminaireKind::Spot {
                intensity: Rgb::new(100.0, 50.0, 25.0),
                range_m: f32::INFINITY,
                cos_inner: 0.9,
                cos_outer: 0.8,
            },
            group: GroupId(0),
        }],
        groups: vec![Group { name: "all".into() }],
        sky: None,
        views: vec![Look {
            name: "door".into(),
            eye: Vec3::new(0.0, 1.6, 5.0),
            forward: -Vec3::Z,
            up: Vec3::Y,
            vertical_angle: 1.0,
        }],
        up: Vec3::Y,
    }
}

const LUX: [f32; 3] = [0.0, 100.0, 500.0];

/// Light on the floor and on both sides of the lamp.
fn with_lit<T>(scene: &Scene, run: impl FnOnce(&[LitPrimitive<'_>]) -> T) -> T {
    let irradiance = LUX.map(|v| Rgb::new(v, 0.5 * v, 0.25 * v));
    let normals = [Vec3::X; 3];
    let part = |k: usize, side| LitPrimitive {
        surface: SurfaceId::from(k),
        side,
        positions: &scene.positions[3 * k..3 * k + 3],
        normals: &normals,
        uvs: scene.uvs.get(k).map_or(&[], |uv| &uv[..]),
        texels: &[],
        page: 0,
        irradiance: &irradiance,
        triangles: if side == Side::Front {
            &[[7, 8, 9]]
        } else {
            &[[7, 9, 8]]
        },
        first_vertex: 7,
    };
    run(&[
        part(0, Side::Front),
        part(1, Side::Front),
        part(1, Side::Back),
    ])
}

const SCALE: LitScale = LitScale {
    colour_per_lux: 0.004,
    pages: Vec::new(),
};

fn written(scene: &Scene, source: Option<&Source>) -> Vec<u8> {
    with_lit(scene, |lit| lit_glb(scene, source, lit, &SCALE)).expect("small")
}

/// Reads by the `gltf` crate, which checks the file against the format.
fn read_back(bytes: &[u8]) -> (gltf::Document, Vec<u8>) {
    let read = gltf::Gltf::from_slice(bytes).expect("a valid file");
    let blob = read.blob.clone().expect("a binary chunk");
    (read.document, blob)
}

#[test]
fn colours_are_light_times_exposure_and_lux_can_be_recovered() {
    let scene = scene();
    let (document, blob) = read_back(&written(&scene, None));
    let mesh = document.meshes().next().expect("the floor");
    assert_eq!(mesh.name(), Some("surface 0"));
    let primitive = mesh.primitives().next().expect("its front");
    assert!(primitive.material().unlit());
    let reader = primitive.reader(|_| Some(&blob));
    let colours: Vec<[f32; 4]> = reader
        .read_colors(0)
        .expect("colours")
        .into_rgba_f32()
        .collect();
    // 100 lux x 0.004 = 0.4, in steps of 1 / 65535; 500 lux would be 2 and is clipped with
    // its hue (1 : 0.5 : 0.25).
    for (colour, expected) in colours.iter().zip([0.0, 0.4, 1.0]) {
        for (band, share) in [1.0, 0.5, 0.25].iter().enumerate() {
            assert!((colour[band] - expected * share).abs() < 1e-5);
        }
    }
    let extras = document.into_json().asset.extras.expect("extras");
    let note: Value = serde_json::from_str(extras.get()).expect("JSON");
    let scale = note["luxel"]["scale"].as_f64().expect("a number");
    assert!(
        (colours[1][0] as f64 * scale - 100.0).abs() < 0.01,
        "COLOR_0 x scale = lux"
    );
}

#[test]
fn unclipped_lux_stand_in_their_own_attribute() {
    let bytes = written(&scene(), None);
    let (json, blob) = chunks(&bytes);
    let at = |index: &Value| &json["accessors"][index.as_u64().expect("an index") as usize];
    let accessor = at(&json["meshes"][0]["primitives"][0]["attributes"]["_IRRADIANCE"]);
    let view = &json["bufferViews"][accessor["bufferView"].as_u64().expect("a view") as usize];
    let start =
        view["byteOffset"].as_u64().unwrap_or(0) + accessor["byteOffset"].as_u64().unwrap_or(0);
    let red: Vec<f32> = (0..3)
        .map(|k| {
            let b = &blob[start as usize + 12 * k..][..4];
            f32::from_le_bytes([b[0], b[1], b[2], b[3]])
        })
        .collect();
    assert_eq!(red, LUX);
}

fn chunks(bytes: &[u8]) -> (Value, Vec<u8>) {
    let n = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
    (
        serde_json::from_slice(&bytes[20..20 + n]).expect("JSON"),
        bytes[28 + n..].to_vec(),
    )
}

#[test]
fn emitters_glow_and_nothing_is_missing() {
    let scene = scene();
    let (document, blob) = read_back(&written(&scene, None));
    let meshes: Vec<_> = document.meshes().collect();
    assert_eq!(meshes.len(), 4, "floor, lamp, black, glass");
    let colours = |mesh: usize, primitive: usize| -> Vec<[f32; 4]> {
        let p = meshes[mesh]
            .primitives()
            .nth(primitive)
            .expect("a primitive");
        p.reader(|_| Some(&blob))
            .read_colors(0)
            .expect("colours")
            .into_rgba_f32()
            .collect()
    };
    // The front emits 1000 cd/m²: pi * 1000 * 0.004 is far above white.
    assert!(colours(1, 0).iter().all(|c| c[0] > 0.99));
    // The back neither emits nor reflects: black.
    assert!(colours(1, 1).iter().all(|c| c[..3] == [0.0; 3]));
    assert!(colours(2, 0).iter().all(|c| c[..3] == [0.0; 3]));
    let glass = meshes[3].primitives().next().expect("a pane").material();
    assert_eq!(glass.alpha_mode(), gltf::material::AlphaMode::Blend);
    let floor = meshes[0].primitives().next().expect("a floor");
    assert!(
        floor
            .material()
            .pbr_metallic_roughness()
            .base_color_texture()
            .is_some()
    );
    assert!(floor.reader(|_| Some(&blob)).read_tex_coords(0).is_some());
}

#[test]
fn views_and_luminaires_of_other_formats_become_cameras_and_lights() {
    let mut scene = scene();
    let (document, _) = read_back(&written(&scene, None));
    let camera = document
        .nodes()
        .find(|n| n.camera().is_some())
        .expect("a camera");
    let [_, _, back, place] = camera.transform().matrix();
    assert_eq!((back, place), ([0.0, 0.0, 1.0, 0.0], [0.0, 1.6, 5.0, 1.0]));
    let node = document
        .nodes()
        .find(|n| n.light().is_some())
        .expect("a light");
    let light = node.light().expect("a light");
    assert_eq!(
        (light.intensity(), light.color()),
        (100.0, [1.0, 0.5, 0.25])
    );
    // -z of the node is the direction, straight down.
    assert!((node.transform().matrix()[2][1] - 1.0).abs() < 1e-6);
    scene.up = Vec3::Z;
    let (document, _) = read_back(&written(&scene, None));
    let root: Vec<_> = document.default_scene().expect("a scene").nodes().collect();
    assert_eq!(root.len(), 1);
    let [x, y, z, w] = root[0].transform().decomposed().1;
    // Half a right angle about -x takes z to y.
    assert!((x + w).abs() < 1e-6 && y == 0.0 && z == 0.0 && x < 0.0);
}

/// A source with all that has to survive.
fn source() -> GltfSource {
    let json = json!({
        "asset": { "version": "2.0", "generator": "modeller", "copyright": "someone",
            "extras": { "shot": 7 } },
        "extensionsUsed": ["KHR_lights_punctual", "KHR_texture_transform"],
        "extensions": { "KHR_lights_punctual": { "lights": [
            { "type": "point", "intensity": 10.0, "name": "bulb" }] } },
        "scene": 0,
        "scenes": [{ "nodes": [0, 1, 2], "name": "main" }],
        "nodes": [
            { "name": "wall node", "mesh": 0, "extras": { "id": "W1" } },
            { "name": "camera node", "camera": 0 },
            { "name": "light node", "extensions": { "KHR_lights_punctual": { "light": 0 } } },
        ],
        "cameras": [{ "type": "perspective", "perspective": { "yfov": 1.0, "znear": 0.1 } }],
        "meshes": [{ "extras": { "layer": 3 }, "primitives": [
            { "attributes": { "POSITION": 0 }, "material": 0 },
            { "attributes": { "POSITION": 0 }, "material": 1 }] }],
        "materials": [
            { "name": "brick", "extras": { "code": "B" }, "pbrMetallicRoughness": {
                "baseColorTexture": { "index": 0, "texCoord": 1 } },
              "normalTexture": { "index": 1 } },
            { "name": "other" }],
        "textures": [{ "source": 0 }, { "source": 1 }],
        "images": [
            { "name": "inside", "bufferView": 1, "mimeType": "image/png" },
            { "name": "beside", "uri": "normal.png" }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
              "min": [0.0, 0.0, 0.0], "max": [0.0, 0.0, 0.0] },
            { "bufferView": 2, "componentType": 5126, "count": 1, "type": "SCALAR",
              "min": [0.0], "max": [0.0] },
            { "bufferView": 3, "componentType": 5126, "count": 1, "type": "VEC3" }],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 36 },
            { "buffer": 0, "byteOffset": 36, "byteLength": 70 },
            { "buffer": 0, "byteOffset": 106, "byteLength": 4 },
            { "buffer": 0, "byteOffset": 110, "byteLength": 12 }],
        "buffers": [{ "byteLength": 122 }],
        "animations": [{ "channels": [{ "sampler": 0, "target": { "node": 1, "path": "translation" } }],
            "samplers": [{ "input": 1, "output": 2 }] }],
    });
    let mut buffer = vec![0u8; 122];
    let picture = base::png(&[1, 2, 3, 255], 1, 1);
    let n = picture.len().min(70);
    buffer[36..36 + n].copy_from_slice(&picture[..n]);
    buffer[110..114].copy_from_slice(&3.5f32.to_le_bytes());
    let beside = crate::document::ExternalImage {
        mime: "image/png",
        bytes: base::png(&[9, 9, 9, 255], 1, 1),
    };
    GltfSource {
        json,
        buffers: vec![buffer],
        images: vec![None, Some(beside)],
        scale: 1.0,
    }
}

#[test]
fn a_source_keeps_all_but_its_meshes() {
    let scene = scene();
    let source = source();
    let bytes = written(&scene, Some(&Source::Gltf(Box::new(source.clone()))));
    read_back(&bytes);
    let (json, blob) = chunks(&bytes);
    assert_eq!(json["asset"]["copyright"], "someone");
    assert_eq!(json["asset"]["extras"]["shot"], 7);
    assert_eq!(
        json["asset"]["extras"]["luxel"]["source_generator"],
        "modeller"
    );
    assert_eq!(
        json["nodes"][0],
        json!({ "name": "wall node", "extras": { "id": "W1" } })
    );
    assert_eq!(json["nodes"][1], source.json["nodes"][1]);
    assert_eq!(json["nodes"][2], source.json["nodes"][2]);
    for key in ["cameras", "extensions"] {
        assert_eq!(json[key], source.json[key]);
    }
    assert_eq!(json["materials"][0], source.json["materials"][0]);
    // The floor came from primitive 0 of mesh 0, so it wears the brick's picture, plain.
    let floor = &json["meshes"][0];
    assert_eq!(floor["extras"]["layer"], 3);
    let lit =
        &json["materials"][floor["primitives"][0]["material"].as_u64().expect("one") as usize];
    assert_eq!(
        lit["pbrMetallicRoughness"]["baseColorTexture"],
        json!({ "index": 0 })
    );
    assert_eq!(
        lit["extras"],
        json!({ "code": "B", "luxel": { "lit_from_material": 0 } })
    );
    // Both pictures are inside, byte for byte.
    let bytes_of = |image: usize| {
        let view = &json["bufferViews"][json["images"][image]["bufferView"]
            .as_u64()
            .expect("a view") as usize];
        let start = view["byteOffset"].as_u64().expect("an offset") as usize;
        &blob[start..start + view["byteLength"].as_u64().expect("a length") as usize]
    };
    assert_eq!(bytes_of(0), &source.buffers[0][36..106]);
    assert_eq!(bytes_of(1), source.images[1].as_ref().expect("there").bytes);
    assert!(json["images"][1].get("uri").is_none());
    // The animation still finds its data, and the old positions are gone.
    let output = &json["accessors"][json["animations"][0]["samplers"][0]["output"]
        .as_u64()
        .expect("one") as usize];
    let view = &json["bufferViews"][output["bufferView"].as_u64().expect("a view") as usize];
    let start = view["byteOffset"].as_u64().expect("an offset") as usize;
    assert_eq!(blob[start..start + 4], 3.5f32.to_le_bytes());
    assert_eq!(
        json["accessors"]
            .as_array()
            .expect("a list")
            .iter()
            .filter(|a| a["count"] == 1)
            .count(),
        2
    );
}

#[test]
fn unknown_extensions_keep_all_data_and_a_scale_is_undone() {
    let scene = scene();
    let mut source = source();
    source.json["extensionsUsed"] = json!(["VENDOR_points_at_accessors"]);
    source.json["extensions"] = json!({ "VENDOR_points_at_accessors": { "accessor": 2 } });
    source.scale = 0.01;
    let (json, _) = chunks(&written(
        &scene,
        Some(&Source::Gltf(Box::new(source.clone()))),
    ));
    assert_eq!(json["extensions"], source.json["extensions"]);
    assert_eq!(json["accessors"][2]["type"], "VEC3");
    assert_eq!(json["accessors"][2]["bufferView"], 3);
    let roots = json["scenes"][0]["nodes"].as_array().expect("roots");
    let wrapper = &json["nodes"][roots[0].as_u64().expect("a node") as usize];
    assert_eq!(wrapper["children"], json!([0, 1, 2]));
    assert!((wrapper["scale"][0].as_f64().expect("a number") - 0.01).abs() < 1e-6);
}

#[test]
fn damaged_sources_never_panic() {
    // Every member in turn becomes something that it should not be.
    let scene = scene();
    let good = source();
    let mut pointers = Vec::new();
    fn walk(value: &Value, at: String, out: &mut Vec<String>) {
        match value {
            Value::Object(map) => map
                .iter()
                .for_each(|(k, v)| walk(v, format!("{at}/{k}"), out)),
            Value::Array(list) => list
                .iter()
                .enumerate()
                .for_each(|(k, v)| walk(v, format!("{at}/{k}"), out)),
            _ => {}
        }
        out.push(at);
    }
    walk(&good.json, String::new(), &mut pointers);
    assert!(pointers.len() > 100);
    for pointer in pointers {
        for bad in [
            json!(null),
            json!(-1),
            json!(4e9),
            json!("x"),
            json!([]),
            json!({}),
            json!([[1]]),
        ] {
            let mut source = good.clone();
            *source.json.pointer_mut(&pointer).expect("it was there") = bad;
            written(&scene, Some(&Source::Gltf(Box::new(source))));
        }
    }
    let mut cut = good.clone();
    cut.buffers.clear();
    cut.images.clear();
    written(&scene, Some(&Source::Gltf(Box::new(cut))));
}

#[test]
fn odd_numbers_stay_out_of_the_file() {
    let mut scene = scene();
    scene.uvs[0][1] = Vec2::new(f32::NAN, 1.0);
    let irradiance = [
        Rgb::splat(f32::NAN),
        Rgb::splat(f32::INFINITY),
        Rgb::splat(-1.0),
    ];
    let lit = LitPrimitive {
        surface: SurfaceId(0),
        side: Side::Front,
        positions: &scene.positions[..3],
        normals: &[Vec3::ZERO; 3],
        uvs: &scene.uvs[0],
        texels: &[],
        page: 0,
        irradiance: &irradiance,
        triangles: &[[0, 1, 2]],
        first_vertex: 0,
    };
    let nowhere = LitScale {
        colour_per_lux: f32::NAN,
        pages: Vec::new(),
    };
    let bytes = lit_glb(&scene, None, &[lit], &nowhere).expect("small");
    let (document, blob) = read_back(&bytes);
    let p = document
        .meshes()
        .next()
        .expect("a mesh")
        .primitives()
        .next()
        .expect("one");
    let reader = p.reader(|_| Some(&blob));
    for n in reader.read_normals().expect("normals") {
        assert!((Vec3::from(n).length() - 1.0).abs() < 1e-6);
    }
    let uvs = reader.read_tex_coords(0).expect("coordinates").into_f32();
    assert!(uvs.flatten().all(f32::is_finite));
}

#[test]
fn texels_of_a_lightmap_are_the_second_coordinates_and_the_file_names_its_pages() {
    let scene = scene();
    let texels = [Vec2::new(0.25, 0.5), Vec2::X, Vec2::new(f32::NAN, 1.0)];
    let lit = LitPrimitive {
        surface: SurfaceId(0),
        side: Side::Front,
        positions: &scene.positions[..3],
        normals: &[Vec3::Y; 3],
        uvs: &[],
        texels: &texels,
        page: 1,
        irradiance: &[Rgb::WHITE; 3],
        triangles: &[[0, 1, 2]],
        first_vertex: 0,
    };
    let scale = LitScale {
        colour_per_lux: 0.004,
        pages: vec![("a.exr".into(), [64, 32]), ("b.exr".into(), [16, 16])],
    };
    let bytes = lit_glb(&scene, None, &[lit], &scale).expect("small");
    let (document, blob) = read_back(&bytes);
    let mesh = document.meshes().next().expect("a mesh");
    let p = mesh.primitives().next().expect("one");
    let read = p.reader(|_| Some(&blob)).read_tex_coords(1);
    let read: Vec<[f32; 2]> = read.expect("coordinates").into_f32().collect();
    assert_eq!(read, [[0.25, 0.5], [1.0, 0.0], [0.0, 1.0]]);
    let extras: serde_json::Value =
        serde_json::from_str(p.extras().as_ref().expect("extras").get()).expect("json");
    assert_eq!(extras["luxel"]["lightmap"], 1);
    let json = String::from_utf8_lossy(&bytes).into_owned();
    assert!(json.contains(r#""lightmaps":[{"file":"a.exr","width":64,"height":32}"#));
}
