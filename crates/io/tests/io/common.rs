//! What the tests of the readers share: where foreign data lies, small files built in memory.

use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// A folder of the shared data beside the project, if it is there; says so if not.
pub fn shared(part: &str) -> Option<PathBuf> {
    let mut folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    while let Some(parent) = folder.parent() {
        let found = parent.join("shared").join(part);
        if found.is_dir() {
            return Some(found);
        }
        folder = parent;
    }
    eprintln!("skipped: no shared/{part} beside the project");
    None
}

/// No file but the one that is given.
pub fn alone(name: &str, _: u64) -> Result<Vec<u8>, String> {
    Err(format!("no file {name}"))
}

/// A GLB file of a JSON value and its binary chunk.
pub fn glb(json: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = serde_json::to_vec(json).expect("a value that was just made");
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bin = bin.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut out = Vec::new();
    out.extend(b"glTF");
    out.extend(2u32.to_le_bytes());
    out.extend((12 + 8 + text.len() as u32 + 8 + bin.len() as u32).to_le_bytes());
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(b"JSON");
    out.extend(&text);
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(&bin);
    out
}

/// A PNG file of RGBA texels.
pub fn png(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Vec<u8> {
    let image = image::RgbaImage::from_fn(width, height, |x, y| image::Rgba(texel(x, y)));
    let mut out = std::io::Cursor::new(Vec::new());
    image
        .write_to(&mut out, image::ImageFormat::Png)
        .expect("writing into memory");
    out.into_inner()
}

/// A square of two triangles with everything that the reader knows in one file: texture, sparse
/// accessor, strip, emission, lights, camera, two instances.
pub fn small_glb() -> Vec<u8> {
    let mut bin: Vec<u8> = Vec::new();
    let mut views: Vec<Value> = Vec::new();
    let mut view = |bytes: &[u8]| {
        while !bin.len().is_multiple_of(4) {
            bin.push(0);
        }
        views.push(json!({"buffer": 0, "byteOffset": bin.len(), "byteLength": bytes.len()}));
        bin.extend(bytes);
        views.len() - 1
    };
    let floats = |v: &[f32]| v.iter().flat_map(|f| f.to_le_bytes()).collect::<Vec<u8>>();
    let shorts = |v: &[u16]| v.iter().flat_map(|f| f.to_le_bytes()).collect::<Vec<u8>>();
    let places = view(&floats(&[0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0.]));
    let uvs = view(&shorts(&[0, 0, 65535, 0, 65535, 65535, 0, 65535]));
    let corners = view(&shorts(&[0, 1, 2, 0, 2, 3]));
    let strip = view(&[0u8, 1, 3, 2]);
    let changed = view(&shorts(&[2]));
    let moved = view(&floats(&[2., 2., 0.]));
    let picture = view(&png(4, 2, |x, y| [60 * x as u8, 120 * y as u8, 200, 255]));
    let buffer_length = bin.len();
    // Sine and cosine of half a quarter turn.
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    let json = json!({
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_texture_transform"],
        "extensionsRequired": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "point", "intensity": 10.0, "color": [1, 0.5, 0.25], "range": 7.0},
            {"type": "spot", "intensity": 20.0, "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.4}},
            {"type": "directional", "intensity": 1000.0}]}},
        "scene": 0,
        "scenes": [{"nodes": [0, 3]}],
        "nodes": [
            {"name": "room", "children": [1, 2, 4, 5], "translation": [0, 0, -3]},
            {"name": "wall", "mesh": 0, "scale": [2, 2, 2]},
            {"name": "mirrored wall", "mesh": 0, "matrix": [-1,0,0,0, 0,1,0,0, 0,0,1,0, 5,0,0,1]},
            {"name": "eye", "camera": 0, "rotation": [0, quarter, 0, quarter], "translation": [1, 2, 3]},
            {"name": "bulb", "extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": [1, 1, 1]},
            {"name": "spot", "extensions": {"KHR_lights_punctual": {"light": 1}}, "rotation": [-quarter, 0, 0, quarter],
             "children": [6]},
            {"extensions": {"KHR_lights_punctual": {"light": 2}}}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0},
            {"attributes": {"POSITION": 4}, "indices": 3, "mode": 5, "material": 1}]}],
        "materials": [
            {"name": "paper", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1],
                "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2], "offset": [0.25, 0]}}}},
             "alphaMode": "MASK"},
            {"name": "panel", "emissiveFactor": [1, 0.5, 0.25], "doubleSided": true,
             "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 2000.0}}}],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"wrapS": 33071, "wrapT": 33648}],
        "images": [{"bufferView": picture, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": places, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0,0,0], "max": [1,1,0]},
            {"bufferView": uvs, "componentType": 5123, "normalized": true, "count": 4, "type": "VEC2"},
            {"bufferView": corners, "componentType": 5123, "count": 6, "type": "SCALAR"},
            {"bufferView": strip, "componentType": 5121, "count": 4, "type": "SCALAR"},
            {"bufferView": places, "componentType": 5126, "count": 4, "type": "VEC3",
             "sparse": {"count": 1, "indices": {"bufferView": changed, "componentType": 5123},
                        "values": {"bufferView": moved}}}],
        "bufferViews": views,
        "buffers": [{"byteLength": buffer_length}],
    });
    glb(&json, &bin)
}

/// A small OBJ text with groups, a concave polygon, negative indices and a continued line.
pub const SMALL_OBJ: &str = "\
# two rooms
mtllib small.mtl
o floor
v 0 0 0
v 4 0 0
v 4 0 4
v 2 0 1 # concave here
v 0 0 4
vt 0 0
vt 1 0
vt 1 1
vn 0 1 0
usemtl wood
f 1/1/1 5/2/1 4/3/1 3/1/1 2/2/1
o lamp
g left
v 0 3 0
v 1 3 0
v 1 3 1
v 0 3 1
usemtl light
f -4 -3 \\
  -2 -1
l 1 2
";

/// The materials of [`SMALL_OBJ`].
pub const SMALL_MTL: &str =
    "newmtl wood\nKd 0.5 0.4 0.3\nnewmtl light\nKd .8 .8 .8\nKe 1000 900 800\n";

/// A resolver that knows `small.mtl`.
pub fn with_mtl(name: &str, _: u64) -> Result<Vec<u8>, String> {
    if name == "small.mtl" {
        Ok(SMALL_MTL.into())
    } else {
        Err(format!("no file {name}"))
    }
}
