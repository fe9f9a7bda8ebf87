//! What a lit file is built on: an empty glTF, or the source file without its meshes.
//!
//! Of a source everything is kept that does not describe the old geometry: materials, textures
//! and pictures (embedded), cameras, lights, nodes with names and extras, scenes, animations,
//! extensions that are not known here. Meshes, skins and their data go; old nodes lose their
//! mesh. Old accessors and buffer views that nothing uses any more are dropped, unless an unknown
//! extension might point at them: then all stay where they are.

use crate::document::GltfSource;
use crate::json::as_whole;
use luxel_core::{Surface, Vec3};
use serde_json::{Map, Value, json};
use std::io;

/// Extensions whose contents never point at accessors or buffer views that are to go.
const HARMLESS: [&str; 10] = [
    "KHR_lights_punctual",
    "KHR_texture_transform",
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
    "KHR_xmp_json_ld",
    "KHR_mesh_quantization",
    "KHR_draco_mesh_compression",
    "EXT_mesh_gpu_instancing",
];

/// Extensions that speak of the old geometry only.
const GEOMETRIC: [&str; 6] = [
    "KHR_mesh_quantization",
    "KHR_draco_mesh_compression",
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_materials_variants",
];

/// A glTF in the making.
pub(super) struct Base {
    /// The whole JSON; always an object.
    pub json: Value,
    /// The binary buffer; its length is always a multiple of four.
    binary: Vec<u8>,
    /// Meshes of the source, for their extras and the materials of their primitives.
    old_meshes: Vec<Value>,
    /// The scene that is shown.
    scene: usize,
    /// Materials of the source; those after them are ours.
    old_materials: usize,
}

impl Base {
    /// Nothing but a scene without nodes.
    pub fn fresh() -> Base {
        let json =
            json!({ "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [] }] });
        Base {
            json,
            binary: Vec::new(),
            old_meshes: Vec::new(),
            scene: 0,
            old_materials: 0,
        }
    }

    /// The source without its meshes, in metres.
    pub fn of_source(source: &GltfSource) -> Base {
        let mut json = source.json.clone();
        if !json.is_object() {
            return Base::fresh();
        }
        let old_meshes = match json["meshes"].take() {
            Value::Array(list) => list,
            _ => Vec::new(),
        };
        let root = json.as_object_mut().expect("tested above");
        for key in ["meshes", "skins"] {
            root.remove(key);
        }
        for key in [
            "nodes",
            "scenes",
            "materials",
            "textures",
            "images",
            "samplers",
            "accessors",
            "bufferViews",
        ] {
            // A list that is none cannot be added to.
            if root.get(key).is_some_and(|v| !v.is_array()) {
                root.remove(key);
            }
        }
        let old_materials = list(root, "materials").len();
        for node in list_mut(root, "nodes") {
            let Some(node) = node.as_object_mut() else {
                continue;
            };
            for key in ["mesh", "skin", "weights"] {
                node.remove(key);
            }
            if let Some(Value::Object(extensions)) = node.get_mut("extensions") {
                extensions.shift_remove("EXT_mesh_gpu_instancing");
                if extensions.is_empty() {
                    node.remove("extensions");
                }
            }
        }
        let mut base = Base {
            json,
            binary: Vec::new(),
            old_meshes,
            scene: 0,
            old_materials,
        };
        base.choose_scene();
        base.keep_data(source);
        base.drop_geometric_extensions();
        if source.scale != 1.0 && source.scale.is_finite() && source.scale > 0.0 {
            let s = source.scale;
            // Cameras and lights stand in the file's unit, the lit meshes in metres.
            base.wrap_roots(json!({ "name": "source in metres", "scale": [s, s, s] }));
        }
        base
    }

    /// Sets the scene that is shown; makes one of all roots when there is none.
    fn choose_scene(&mut self) {
        let count = self.json["scenes"].as_array().map_or(0, Vec::len);
        if count == 0 {
            let nodes = self.json["nodes"].as_array().map_or(0, Vec::len);
            let mut is_child = vec![false; nodes];
            for node in self.json["nodes"].as_array().into_iter().flatten() {
                for child in node["children"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .filter_map(as_whole)
                {
                    if let Some(slot) = is_child.get_mut(child) {
                        *slot = true;
                    }
                }
            }
            let roots: Vec<usize> = (0..nodes).filter(|&k| !is_child[k]).collect();
            self.json["scenes"] = json!([{ "nodes": roots }]);
        }
        let chosen = as_whole(&self.json["scene"]).unwrap_or(0);
        self.scene = if chosen < count { chosen } else { 0 };
        self.json["scene"] = json!(self.scene);
        let scene = &mut self.json["scenes"][self.scene];
        if !scene.is_object() {
            *scene = json!({});
        }
        if !scene["nodes"].is_array() {
            scene["nodes"] = json!([]);
        }
    }

    /// Carries over the accessors, buffer views and pictures that are still of use.
    fn keep_data(&mut self, source: &GltfSource) {
        let old = &source.json;
        let used = |key: &str| -> Vec<String> {
            let names = old[key].as_array().into_iter().flatten();
            names
                .filter_map(|v| v.as_str().map(str::to_owned))
                .collect()
        };
        let names = used("extensionsUsed");
        let compressed = names.iter().any(|n| n.ends_with("meshopt_compression"));
        let keep_all = names.iter().any(|n| {
            !n.starts_with("KHR_materials_")
                && !HARMLESS.contains(&n.as_str())
                && !GEOMETRIC.contains(&n.as_str())
        });
        let accessors = old["accessors"].as_array().cloned().unwrap_or_default();
        let views = old["bufferViews"].as_array().cloned().unwrap_or_default();
        let mut keep_accessor = vec![keep_all; accessors.len()];
        if compressed {
            self.json
                .as_object_mut()
                .expect("an object")
                .remove("animations");
        }
        for sampler in samplers(&mut self.json) {
            for key in ["input", "output"] {
                if let Some(slot) = as_whole(&sampler[key]).and_then(|k| keep_accessor.get_mut(k)) {
                    *slot = true;
                }
            }
        }
        let mut keep_view = vec![keep_all; views.len()];
        let mut mark = |v: &Value| {
            if let Some(slot) = as_whole(v).and_then(|k| keep_view.get_mut(k)) {
                *slot = true;
            }
        };
        for (a, _) in accessors.iter().zip(&keep_accessor).filter(|x| *x.1) {
            mark(&a["bufferView"]);
            mark(&a["sparse"]["indices"]["bufferView"]);
            mark(&a["sparse"]["values"]["bufferView"]);
        }
        for image in old["images"].as_array().into_iter().flatten() {
            mark(&image["bufferView"]);
        }
        // Views in their order, the bytes one after another in the one buffer of a GLB.
        let mut new_view = vec![None; views.len()];
        let mut kept = Vec::new();
        for (k, view) in views.iter().enumerate().filter(|x| keep_view[x.0]) {
            let bytes = view_bytes(source, view);
            let mut view = view.clone();
            let Some(object) = view.as_object_mut() else {
                continue;
            };
            object.insert("buffer".into(), json!(0));
            object.insert("byteOffset".into(), json!(self.binary.len()));
            object.insert("byteLength".into(), json!(bytes.len().max(1)));
            if compressed {
                object.remove("extensions");
            }
            new_view[k] = Some(kept.len());
            kept.push(view);
            self.append(if bytes.is_empty() { &[0] } else { bytes });
        }
        let moved = |v: &mut Value| {
            if let Some(k) = as_whole(v) {
                *v = json!(new_view.get(k).copied().flatten().unwrap_or(0));
            }
        };
        let mut new_accessor = vec![None; accessors.len()];
        let mut kept_accessors = Vec::new();
        for (k, accessor) in accessors.iter().enumerate().filter(|x| keep_accessor[x.0]) {
            let mut accessor = accessor.clone();
            if let Some(v) = accessor.get_mut("bufferView") {
                moved(v);
            }
            for part in ["indices", "values"] {
                if let Some(v) = accessor.pointer_mut(&format!("/sparse/{part}/bufferView")) {
                    moved(v);
                }
            }
            new_accessor[k] = Some(kept_accessors.len());
            kept_accessors.push(accessor);
        }
        for sampler in samplers(&mut self.json) {
            for key in ["input", "output"] {
                if let Some(v) = sampler.get_mut(key)
                    && let Some(k) = as_whole(v)
                {
                    *v = json!(new_accessor.get(k).copied().flatten().unwrap_or(0));
                }
            }
        }
        let images = self.json["images"].as_array().map_or(0, Vec::len);
        let root = self.json.as_object_mut().expect("an object");
        root.insert("bufferViews".into(), Value::Array(kept));
        root.insert("accessors".into(), Value::Array(kept_accessors));
        root.remove("buffers");
        for k in 0..images {
            self.keep_image(source, k, &new_view);
        }
    }

    /// Puts picture `k` into the file, from wherever it was.
    fn keep_image(&mut self, source: &GltfSource, k: usize, new_view: &[Option<usize>]) {
        let old = self.json["images"][k].clone();
        if old["uri"].as_str().is_some_and(|u| u.starts_with("data:")) {
            return;
        }
        if let Some(view) =
            as_whole(&old["bufferView"]).and_then(|v| new_view.get(v).copied().flatten())
        {
            self.json["images"][k]["bufferView"] = json!(view);
            return;
        }
        let (mime, bytes) = match source.images.get(k) {
            Some(Some(image)) => (image.mime, image.bytes.clone()),
            // It could not be read; a white texel keeps the index and shows as if it were not there.
            _ => ("image/png", png(&[255; 4], 1, 1)),
        };
        let view = self.add_bytes(&bytes);
        let image = &mut self.json["images"][k];
        if !image.is_object() {
            *image = json!({});
        }
        let image = image.as_object_mut().expect("made so above");
        image.remove("uri");
        image.insert("bufferView".into(), json!(view));
        image.insert("mimeType".into(), json!(mime));
    }

    fn drop_geometric_extensions(&mut self) {
        let root = self.json.as_object_mut().expect("an object");
        for key in ["extensionsUsed", "extensionsRequired"] {
            if let Some(Value::Array(names)) = root.get_mut(key) {
                names.retain(|n| !n.as_str().is_some_and(|n| GEOMETRIC.contains(&n)));
                if names.is_empty() {
                    root.shift_remove(key);
                }
            }
        }
        if let Some(Value::Object(extensions)) = root.get_mut("extensions") {
            extensions.retain(|name, _| !GEOMETRIC.contains(&name.as_str()));
            if extensions.is_empty() {
                root.shift_remove("extensions");
            }
        }
    }

    /// Puts `parent` above all roots of the scene.
    fn wrap_roots(&mut self, mut parent: Value) {
        let roots = self.json["scenes"][self.scene]["nodes"].take();
        let list = match roots.as_array() {
            Some(list) if !list.is_empty() => list.clone(),
            _ => {
                self.json["scenes"][self.scene]["nodes"] = json!([]);
                return;
            }
        };
        parent["children"] = Value::Array(list);
        let node = self.push("nodes", parent);
        self.json["scenes"][self.scene]["nodes"] = json!([node]);
    }

    /// Turns everything from z up to the format's y up.
    pub fn turn_z_up(&mut self) {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        self.wrap_roots(json!({ "name": "z up", "rotation": [-half, 0.0, 0.0, half] }));
    }

    /// Adds to a list of the root; answers with the index.
    pub fn push(&mut self, list: &str, value: Value) -> usize {
        let slot = &mut self.json[list];
        if !slot.is_array() {
            *slot = json!([]);
        }
        let list = slot.as_array_mut().expect("made so above");
        list.push(value);
        list.len() - 1
    }

    /// Shows a node at the top of the scene.
    pub fn add_root(&mut self, node: usize) {
        let nodes = &mut self.json["scenes"][self.scene]["nodes"];
        nodes
            .as_array_mut()
            .expect("choose_scene saw to it")
            .push(json!(node));
    }

    /// Adds a punctual light; answers with its index.
    pub fn push_light(&mut self, light: Value) -> usize {
        self.use_extension("KHR_lights_punctual");
        let lights = &mut self.json["extensions"]["KHR_lights_punctual"]["lights"];
        if !lights.is_array() {
            *lights = json!([]);
        }
        let lights = lights.as_array_mut().expect("made so above");
        lights.push(light);
        lights.len() - 1
    }

    /// Names an extension among those used.
    pub fn use_extension(&mut self, name: &str) {
        let names = &mut self.json["extensionsUsed"];
        if !names.is_array() {
            *names = json!([]);
        }
        let names = names.as_array_mut().expect("made so above");
        if !names.iter().any(|n| n == name) {
            names.push(json!(name));
        }
    }

    /// Adds a picture file to the buffer; answers with the image's index.
    pub fn add_image(&mut self, name: &str, mime: &str, bytes: &[u8]) -> usize {
        let view = self.add_bytes(bytes);
        self.push(
            "images",
            json!({ "name": name, "mimeType": mime, "bufferView": view }),
        )
    }

    fn add_bytes(&mut self, bytes: &[u8]) -> usize {
        let view =
            json!({ "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len() });
        self.append(bytes);
        self.push("bufferViews", view)
    }

    fn append(&mut self, bytes: &[u8]) {
        self.binary.extend_from_slice(bytes);
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
    }

    /// Makes room for `count` buffer views whose bytes come later; answers with the first index.
    pub fn reserve_views(&mut self, count: usize) -> usize {
        let first = self.push("bufferViews", Value::Null);
        for _ in 1..count {
            self.push("bufferViews", Value::Null);
        }
        first
    }

    /// Fills reserved views with bytes, stride and target. Views that stay empty are legal only
    /// if they have a byte, so they get four.
    pub fn fill_views<const N: usize>(
        &mut self,
        first: usize,
        filled: [(Vec<u8>, Option<u32>, u32); N],
    ) {
        for (k, (bytes, stride, target)) in filled.into_iter().enumerate() {
            let mut view = json!({
                "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len().max(12),
                "target": target,
            });
            if let Some(stride) = stride {
                view["byteStride"] = json!(stride);
            }
            self.json["bufferViews"][first + k] = view;
            self.append(if bytes.is_empty() { &[0; 12] } else { &bytes });
        }
    }

    /// Material of the source that a surface had.
    pub fn source_material(&self, surface: &Surface) -> Option<usize> {
        let mesh = self.old_meshes.get(surface.mesh as usize)?;
        let primitive = mesh["primitives"].get(surface.primitive as usize)?;
        as_whole(&primitive["material"]).filter(|&m| m < self.old_materials)
    }

    /// Texture of the source with a surface's reflectance (or its emission).
    pub fn source_texture(&self, surface: &Surface, base: bool) -> Option<usize> {
        let material = &self.json["materials"][self.source_material(surface)?];
        let reference = if base {
            &material["pbrMetallicRoughness"]["baseColorTexture"]
        } else {
            &material["emissiveTexture"]
        };
        let index = as_whole(&reference["index"])?;
        let image = as_whole(&self.json["textures"].get(index)?["source"])?;
        self.json["images"].get(image).map(|_| index)
    }

    /// Extras of the mesh that a surface had.
    pub fn mesh_extras(&self, surface: &Surface) -> Option<&Value> {
        self.old_meshes.get(surface.mesh as usize)?.get("extras")
    }

    /// Writes `asset.generator` and `asset.extras.luxel`.
    pub fn note(&mut self, mut note: Value) {
        let generator = concat!("luxel ", env!("CARGO_PKG_VERSION"));
        let asset = &mut self.json["asset"];
        if !asset.is_object() {
            *asset = json!({});
        }
        asset["version"] = "2.0".into();
        note["generator"] = generator.into();
        if let Some(before) = asset.get("generator").filter(|g| g.is_string()) {
            note["source_generator"] = before.clone();
        }
        asset["generator"] = generator.into();
        match asset.get_mut("extras") {
            Some(Value::Object(extras)) => {
                extras.insert("luxel".into(), note);
            }
            Some(other) if !other.is_null() => {
                *other = json!({ "source_extras": other.clone(), "luxel": note });
            }
            _ => asset["extras"] = json!({ "luxel": note }),
        }
    }

    /// The GLB: header, JSON chunk, binary chunk.
    pub fn into_glb(mut self) -> io::Result<Vec<u8>> {
        let root = self.json.as_object_mut().expect("an object");
        // The format forbids empty lists.
        for key in [
            "accessors",
            "animations",
            "bufferViews",
            "cameras",
            "images",
            "materials",
            "meshes",
            "nodes",
            "samplers",
            "textures",
        ] {
            if root
                .get(key)
                .is_some_and(|v| v.as_array().is_none_or(Vec::is_empty))
            {
                root.shift_remove(key);
            }
        }
        for scene in list_mut(root, "scenes") {
            if scene["nodes"].as_array().is_some_and(Vec::is_empty)
                && let Some(scene) = scene.as_object_mut()
            {
                scene.shift_remove("nodes");
            }
        }
        root.insert(
            "buffers".into(),
            json!([{ "byteLength": self.binary.len() }]),
        );
        let mut text = serde_json::to_vec(&self.json)?;
        text.resize(text.len().next_multiple_of(4), b' ');
        let total = 12 + 8 + text.len() + 8 + self.binary.len();
        let length = |n: usize| {
            u32::try_from(n).map_err(|_| {
                io::Error::other(format!(
                    "the lit scene takes {n} bytes; a GLB file holds 4 GiB"
                ))
            })
        };
        let mut out = Vec::with_capacity(total);
        out.extend(b"glTF");
        out.extend(2u32.to_le_bytes());
        out.extend(length(total)?.to_le_bytes());
        out.extend(length(text.len())?.to_le_bytes());
        out.extend(b"JSON");
        out.extend(text);
        out.extend(length(self.binary.len())?.to_le_bytes());
        out.extend(b"BIN\0");
        out.append(&mut self.binary);
        Ok(out)
    }
}

/// Samplers of all animations.
fn samplers(json: &mut Value) -> impl Iterator<Item = &mut Value> {
    let animations = json.get_mut("animations").and_then(Value::as_array_mut);
    animations
        .into_iter()
        .flatten()
        .filter_map(|a| a.get_mut("samplers").and_then(Value::as_array_mut))
        .flatten()
}

fn list<'a>(root: &'a Map<String, Value>, key: &str) -> &'a [Value] {
    root.get(key)
        .and_then(Value::as_array)
        .map_or(&[], Vec::as_slice)
}

fn list_mut<'a>(root: &'a mut Map<String, Value>, key: &str) -> &'a mut [Value] {
    root.get_mut(key)
        .and_then(Value::as_array_mut)
        .map_or(&mut [], Vec::as_mut_slice)
}

/// Bytes of a buffer view of the source; fewer, or none, where the file lacks them.
fn view_bytes<'a>(source: &'a GltfSource, view: &Value) -> &'a [u8] {
    let buffer = as_whole(&view["buffer"]).and_then(|b| source.buffers.get(b));
    let bytes = buffer.map_or(&[][..], Vec::as_slice);
    let start = as_whole(&view["byteOffset"]).unwrap_or(0).min(bytes.len());
    let length = as_whole(&view["byteLength"])
        .unwrap_or(0)
        .min(bytes.len() - start);
    &bytes[start..start + length]
}

/// Column-major placement of a camera or light at `eye` that looks along `forward`.
pub(super) fn matrix(eye: Vec3, forward: Vec3, up: Vec3) -> [f32; 16] {
    let back = -forward.normalize_or(-Vec3::Z);
    let right = up.cross(back).normalize_or_zero();
    let right = if right == Vec3::ZERO {
        back.any_orthonormal_vector()
    } else {
        right
    };
    let up = back.cross(right);
    [
        right.x, right.y, right.z, 0.0, up.x, up.y, up.z, 0.0, back.x, back.y, back.z, 0.0, eye.x,
        eye.y, eye.z, 1.0,
    ]
}

/// A PNG of RGBA texels.
pub(super) fn png(rgba: &[u8], width: u32, height: u32) -> Vec<u8> {
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    let mut bytes = Vec::new();
    let encoder =
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
    image::ImageEncoder::write_image(
        encoder,
        rgba,
        width,
        height,
        image::ExtendedColorType::Rgba8,
    )
    .expect("a texture has as many texels as its size says, and memory can be written");
    bytes
}
