//! Writes a [`Scene`] as plain glTF 2.0 binary, the same bytes each time.
//!
//! One node, mesh and primitive a surface, with accessors of its own: POSITION, the flat NORMAL,
//! TEXCOORD_0 where the finish has a picture, and indices. After them the cameras, then the
//! luminaires. Diffuse reflectance is baseColorFactor, luminance is emissiveFactor x
//! KHR_materials_emissive_strength in cd/m². Written for our own scenes, so it says nothing of
//! a sky or of Lambertian points, which glTF lacks.
//!
//! Source: [glTF2], [KHR_lights_punctual], [KHR_materials_emissive_strength],
//! [KHR_materials_transmission].

use luxel_core::{Alpha, Finish, LuminaireKind, Rgb, Scene, Texture, Vec2, Vec3, texture::Wrap};
use serde_json::{Map, Value, json};
use std::collections::{BTreeSet, HashMap};

const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;

/// The scene as a `.glb` file.
pub fn to_glb(scene: &Scene) -> Vec<u8> {
    to_glb_with_mirrors(scene, &[])
}

/// The scene as a `.glb` file in which finishes of these names are smooth metals: mirrors, which
/// a [`Scene`] takes as diffuse.
pub fn to_glb_with_mirrors(scene: &Scene, mirrors: &[&str]) -> Vec<u8> {
    let mut file = File::default();
    let images: Vec<Value> = scene
        .textures
        .iter()
        .map(|t| {
            let view = file.view(&png(t), None);
            json!({"name": t.name, "mimeType": "image/png", "bufferView": view})
        })
        .collect();
    let samplers: Vec<Value> = scene
        .textures
        .iter()
        .map(|t| json!({"wrapS": wrap(t.wrap[0]), "wrapT": wrap(t.wrap[1])}))
        .collect();
    let textures: Vec<Value> = (0..scene.textures.len())
        .map(|i| json!({"sampler": i, "source": i}))
        .collect();
    let materials: Vec<Value> = scene
        .finishes
        .iter()
        .map(|f| file.material(f, mirrors.contains(&f.name.as_str())))
        .collect();

    let mut nodes = Vec::new();
    let mut meshes = Vec::new();
    for (i, surface) in scene.surfaces.iter().enumerate() {
        let primitive = file.primitive(scene, i);
        meshes.push(json!({"name": surface.name, "primitives": [primitive]}));
        nodes.push(json!({"name": surface.name, "mesh": i}));
    }
    let mut cameras = Vec::new();
    for view in &scene.views {
        nodes.push(json!({
            "name": view.name,
            "camera": cameras.len(),
            "matrix": matrix(view.eye, view.forward, view.up),
        }));
        cameras.push(
            json!({"name": view.name, "type": "perspective", "perspective":
            {"yfov": exact(view.vertical_angle), "znear": 0.05}}),
        );
    }
    let mut lights = Vec::new();
    for lamp in &scene.luminaires {
        let Some(light) = light(&lamp.name, lamp.kind) else {
            continue;
        };
        file.used.insert("KHR_lights_punctual");
        let up = if lamp.direction.y.abs() > 0.9 {
            Vec3::X
        } else {
            Vec3::Y
        };
        let side = lamp.direction.cross(up).normalize();
        nodes.push(json!({
            "name": lamp.name,
            "matrix": matrix(lamp.position, lamp.direction, side.cross(lamp.direction)),
            "extensions": {"KHR_lights_punctual": {"light": lights.len()}},
        }));
        lights.push(light);
    }
    if !lights.is_empty() {
        file.extensions
            .insert("KHR_lights_punctual".into(), json!({"lights": lights}));
    }

    let mut root = Map::new();
    root.insert(
        "asset".into(),
        json!({"version": "2.0", "generator": "luxel-scenes"}),
    );
    root.insert("extensionsUsed".into(), json!(file.used));
    root.insert("extensions".into(), Value::Object(file.extensions));
    root.insert("scene".into(), json!(0));
    let all: Vec<usize> = (0..nodes.len()).collect();
    root.insert("scenes".into(), json!([{"name": scene.name, "nodes": all}]));
    for (key, list) in [
        ("nodes", nodes),
        ("meshes", meshes),
        ("materials", materials),
        ("textures", textures),
        ("samplers", samplers),
        ("images", images),
        ("cameras", cameras),
        ("accessors", file.accessors),
        ("bufferViews", file.views),
        ("buffers", vec![json!({"byteLength": file.bytes.len()})]),
    ] {
        root.insert(key.into(), Value::Array(list));
    }
    // glTF wants no empty lists or objects.
    root.retain(|_, v| match v {
        Value::Array(a) => !a.is_empty(),
        Value::Object(o) => !o.is_empty(),
        _ => true,
    });
    container(&Value::Object(root).to_string(), file.bytes)
}

/// Header, JSON chunk filled up with blanks, binary chunk filled up with zeros.
fn container(json: &str, mut binary: Vec<u8>) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = 12 + 8 + json.len() + 8 + binary.len();
    let mut out = Vec::with_capacity(total);
    out.extend(b"glTF");
    for word in [2, total as u32, json.len() as u32] {
        out.extend(word.to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(json);
    out.extend((binary.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(binary);
    out
}

#[derive(Default)]
struct File {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    used: BTreeSet<&'static str>,
    extensions: Map<String, Value>,
}

impl File {
    fn view(&mut self, data: &[u8], target: Option<u32>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": data.len()
        });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.extend(data);
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, view: usize, component: u32, count: usize, shape: &str) -> usize {
        self.accessors.push(json!({
            "bufferView": view, "componentType": component, "count": count, "type": shape
        }));
        self.accessors.len() - 1
    }

    fn primitive(&mut self, scene: &Scene, surface: usize) -> Value {
        let surface = &scene.surfaces[surface];
        let pictured = scene.finishes[surface.finish.index()].texture.is_some();
        // A vertex is shared by triangles that agree in point, normal and picture coordinates.
        let mut index_of: HashMap<[u32; 8], u32> = HashMap::new();
        let mut vertices: Vec<(Vec3, Vec3, Vec2)> = Vec::new();
        let mut indices: Vec<u32> = Vec::new();
        for t in surface.triangles.start as usize..surface.triangles.end as usize {
            let [a, b, c] = scene.corners(t);
            let [u, v] = [b - a, c - a].map(|e| e.as_dvec3());
            let normal = u.cross(v).normalize().as_vec3() + Vec3::ZERO;
            for (k, p) in [a, b, c].into_iter().enumerate() {
                let uv = if pictured {
                    scene.uvs[t][k]
                } else {
                    Vec2::ZERO
                };
                let key =
                    [p.x, p.y, p.z, normal.x, normal.y, normal.z, uv.x, uv.y].map(f32::to_bits);
                indices.push(*index_of.entry(key).or_insert_with(|| {
                    vertices.push((p, normal, uv));
                    vertices.len() as u32 - 1
                }));
            }
        }

        let count = vertices.len();
        let points: Vec<f32> = vertices.iter().flat_map(|v| v.0.to_array()).collect();
        let normals: Vec<f32> = vertices.iter().flat_map(|v| v.1.to_array()).collect();
        let view = self.view(&le(&points), Some(ARRAY_BUFFER));
        let position = self.accessor(view, FLOAT, count, "VEC3");
        let low = vertices.iter().fold(Vec3::INFINITY, |m, v| m.min(v.0));
        let high = vertices.iter().fold(Vec3::NEG_INFINITY, |m, v| m.max(v.0));
        self.accessors[position]["min"] = json!(low.to_array().map(f64::from));
        self.accessors[position]["max"] = json!(high.to_array().map(f64::from));
        let view = self.view(&le(&normals), Some(ARRAY_BUFFER));
        let normal = self.accessor(view, FLOAT, count, "VEC3");
        let mut attributes = json!({"POSITION": position, "NORMAL": normal});
        if pictured {
            let uvs: Vec<f32> = vertices.iter().flat_map(|v| v.2.to_array()).collect();
            let view = self.view(&le(&uvs), Some(ARRAY_BUFFER));
            attributes["TEXCOORD_0"] = json!(self.accessor(view, FLOAT, count, "VEC2"));
        }
        // 65535 is the restart index and so may not be used.
        let (component, data) = if count < 65535 {
            let short = indices
                .iter()
                .flat_map(|&i| (i as u16).to_le_bytes())
                .collect();
            (UNSIGNED_SHORT, short)
        } else {
            (
                UNSIGNED_INT,
                indices
                    .iter()
                    .flat_map(|&i| i.to_le_bytes())
                    .collect::<Vec<u8>>(),
            )
        };
        let view = self.view(&data, Some(ELEMENT_ARRAY_BUFFER));
        let accessor = self.accessor(view, component, indices.len(), "SCALAR");
        json!({"attributes": attributes, "indices": accessor, "material": surface.finish.0})
    }

    fn material(&mut self, finish: &Finish, mirror: bool) -> Value {
        let [r, g, b] = finish.reflectance.to_array().map(decimal);
        let mut pbr = json!({
            "baseColorFactor": [r, g, b, decimal(finish.coverage)],
            "metallicFactor": if mirror { 1 } else { 0 },
            "roughnessFactor": if mirror || finish.transparent { 0 } else { 1 },
        });
        if let Some(texture) = finish.texture {
            pbr["baseColorTexture"] = json!({"index": texture.0});
        }
        let mut material = json!({"name": finish.name, "pbrMetallicRoughness": pbr});
        let mut extensions = Map::new();
        if let Some(emission) = &finish.emission {
            let strength = emission.luminance.max_band();
            material["emissiveFactor"] = bands(emission.luminance, strength);
            if let Some(texture) = emission.texture {
                material["emissiveTexture"] = json!({"index": texture.0});
            }
            let name = "KHR_materials_emissive_strength";
            extensions.insert(name.into(), json!({"emissiveStrength": decimal(strength)}));
            self.used.insert(name);
        }
        if finish.transparent {
            let name = "KHR_materials_transmission";
            extensions.insert(name.into(), json!({"transmissionFactor": 1}));
            self.used.insert(name);
        }
        if finish.back_reflects || finish.back_emits {
            material["doubleSided"] = json!(true);
        }
        match finish.alpha {
            Alpha::Opaque => {}
            Alpha::Mask { cutoff } => {
                material["alphaMode"] = json!("MASK");
                material["alphaCutoff"] = decimal(cutoff);
            }
            Alpha::Blend => material["alphaMode"] = json!("BLEND"),
        }
        if !extensions.is_empty() {
            material["extensions"] = Value::Object(extensions);
        }
        material
    }
}

fn light(name: &str, kind: LuminaireKind) -> Option<Value> {
    let (kind, amount, range, cone) = match kind {
        LuminaireKind::Point { intensity, range_m } => ("point", intensity, range_m, None),
        LuminaireKind::Spot {
            intensity,
            range_m,
            cos_inner,
            cos_outer,
        } => ("spot", intensity, range_m, Some((cos_inner, cos_outer))),
        LuminaireKind::Directional { illuminance } => {
            ("directional", illuminance, f32::INFINITY, None)
        }
        LuminaireKind::Lambertian { .. } => return None,
    };
    let strength = amount.max_band();
    let mut light = json!({
        "name": name,
        "type": kind,
        "intensity": decimal(strength),
        "color": bands(amount, strength),
    });
    if range.is_finite() {
        light["range"] = decimal(range);
    }
    if let Some((inner, outer)) = cone {
        light["spot"] = json!({
            "innerConeAngle": exact(inner.acos()), "outerConeAngle": exact(outer.acos())
        });
    }
    Some(light)
}

/// Column by column: glTF's cameras and lights look along -z.
fn matrix(place: Vec3, forward: Vec3, up: Vec3) -> Value {
    let side = forward.cross(up);
    let mut m = Vec::with_capacity(16);
    for (column, w) in [(side, 0.0), (up, 0.0), (-forward, 0.0), (place, 1.0)] {
        m.extend(column.to_array().map(|v| exact(v + 0.0)));
        m.push(exact(w));
    }
    Value::Array(m)
}

fn bands(amount: Rgb, strength: f32) -> Value {
    let share = |v: f32| {
        if strength > 0.0 {
            decimal(v / strength)
        } else {
            json!(0)
        }
    };
    Value::Array(amount.to_array().map(share).to_vec())
}

/// The shortest decimal that reads back as the same `f32`: 0.3, not 0.30000001192092896.
fn decimal(v: f32) -> Value {
    json!(
        v.to_string()
            .parse::<f64>()
            .expect("a number prints as a number")
    )
}

/// The number itself, for what readers compare or renormalise.
///
/// Seven decimals, since a sine's last bit differs between platforms.
fn exact(v: f32) -> Value {
    json!((f64::from(v) * 1e7).round() / 1e7)
}

fn le(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn wrap(wrap: Wrap) -> u32 {
    match wrap {
        Wrap::Repeat => 10497,
        Wrap::Mirror => 33648,
        Wrap::Clamp => 33071,
    }
}

/// As PNG: RGB when nothing is transparent, else RGBA.
fn png(texture: &Texture) -> Vec<u8> {
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    use image::{ExtendedColorType, ImageEncoder};
    let opaque = texture.rgba.iter().all(|t| t[3] == 255);
    let mut out = Vec::new();
    let encoder =
        PngEncoder::new_with_quality(&mut out, CompressionType::Best, FilterType::Adaptive);
    let (data, colour): (Vec<u8>, _) = if opaque {
        (
            texture
                .rgba
                .iter()
                .flat_map(|t| [t[0], t[1], t[2]])
                .collect(),
            ExtendedColorType::Rgb8,
        )
    } else {
        (texture.rgba.concat(), ExtendedColorType::Rgba8)
    };
    encoder
        .write_image(&data, texture.width, texture.height, colour)
        .expect("memory takes any picture of matching size");
    out
}
