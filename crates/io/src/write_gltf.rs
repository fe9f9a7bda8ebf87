//! The lit scene as a glTF binary that any viewer shows as it was lit.
//!
//! Materials are unlit and vertex colours carry the light, so a viewer shows
//! reflectance x COLOR_0 without a lamp of its own: COLOR_0 = illuminance x exposure, linear,
//! 16 bits, clipped to 0..1 as the format demands. Emitters show their luminance on the same
//! scale. The illuminance itself, unclipped in lux, stands in the attribute `_IRRADIANCE`, and
//! `asset.extras.luxel` says how the two belong together. With a lightmap, `TEXCOORD_1` reads its pages,
//! which are files beside this one.
//!
//! Geometry is in world space and metres, one node and one mesh for each surface, one primitive
//! for each side that is lit. Sides that are black and surfaces of clear glass are written so
//! that nothing is missing. What a glTF source holds beside its meshes is kept: see [`base`].
//!
//! Source: [GLTF20], KHR_materials_unlit, KHR_lights_punctual.

mod base;
mod views;

use crate::atomic;
use crate::document::Source;
use base::Base;
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::{Alpha, Finish, FinishId, Rgb, Scene, Side, SurfaceId, TextureId, Vec2, Vec3};
use serde_json::{Map, Value, json};
use std::collections::HashMap;
use std::io;
use std::path::Path;
use views::add_views_and_luminaires;

/// One side of one surface with its light.
///
/// Slices of one entry a vertex have the same length; `uvs` may be empty. The corners of
/// `triangles` count from `first_vertex`, counter-clockwise seen from the lit side.
#[derive(Clone, Copy, Debug)]
pub struct LitPrimitive<'a> {
    /// Surface.
    pub surface: SurfaceId,
    /// Side that is lit.
    pub side: Side,
    /// World space, metres.
    pub positions: &'a [Vec3],
    /// Unit normals towards the light.
    pub normals: &'a [Vec3],
    /// Texture coordinates, as in [`Scene::uvs`].
    pub uvs: &'a [Vec2],
    /// Texture coordinates on a page of the lightmap; empty when there is none.
    pub texels: &'a [Vec2],
    /// The page of the lightmap.
    pub page: u32,
    /// Illuminance in linear bands, lux.
    pub irradiance: &'a [Rgb],
    /// Corners.
    pub triangles: &'a [[u32; 3]],
    /// What to subtract from the corners.
    pub first_vertex: u32,
}

/// How illuminance becomes a vertex colour, and where it is as texels.
#[derive(Clone, Debug, PartialEq)]
pub struct LitScale {
    /// COLOR_0 for each lux.
    pub colour_per_lux: f32,
    /// Files of the lightmap's pages, by name, with their width and height.
    pub pages: Vec<(String, [u32; 2])>,
}

/// Writes the lit scene as a GLB file, whole or not at all.
///
/// `source` is the file that the scene came from, if there was one; of a glTF file everything
/// but the meshes is kept.
pub fn write_lit_glb(
    scene: &Scene,
    source: Option<&Source>,
    lit: &[LitPrimitive<'_>],
    scale: &LitScale,
    path: &Path,
) -> io::Result<()> {
    let bytes = lit_glb(scene, source, lit, scale)?;
    atomic::write(path, &bytes)
}

/// The bytes of the GLB file. Fails above 4 GiB, which the format cannot hold.
pub fn lit_glb(
    scene: &Scene,
    source: Option<&Source>,
    lit: &[LitPrimitive<'_>],
    scale: &LitScale,
) -> io::Result<Vec<u8>> {
    let mut base = match source {
        Some(Source::Gltf(file)) => Base::of_source(file),
        _ => {
            let mut fresh = Base::fresh();
            add_views_and_luminaires(&mut fresh, scene);
            fresh
        }
    };
    let pages: Vec<Value> = (scale.pages.iter())
        .map(|(file, [w, h])| json!({ "file": file, "width": w, "height": h }))
        .collect();
    let scale = if scale.colour_per_lux.is_finite() && scale.colour_per_lux > 0.0 {
        scale.colour_per_lux
    } else {
        1.0 / LAMBERTIAN
    };
    Writer::new(scene, &mut base, scale).write(lit);
    if scene.up.z > 0.9 {
        base.turn_z_up();
    }
    let mut note = json!({
        "exposure": scale,
        "scale": 1.0 / scale,
        "unit": "COLOR_0 x scale = illuminance in lux, where COLOR_0 is below 1",
        "irradiance": "_IRRADIANCE is the illuminance in lux, linear RGB (Rec. 709 primaries)",
        "shown": "baseColor x COLOR_0 = reflectance x illuminance x exposure",
    });
    if !pages.is_empty() {
        note["lightmaps"] = pages.into();
        note["lightmap"] = "TEXCOORD_1 reads the page that extras.luxel.lightmap of the primitive \
                            names: illuminance in lux, linear RGB, first row at the top"
            .into();
    }
    base.note(note);
    base.into_glb()
}

/// How a side is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Look {
    /// Reflectance times light.
    Lit,
    /// Light by itself: reflected and own luminance are in the vertex colours.
    Glow,
    /// Light by itself, with the picture of the emission.
    GlowPicture,
    /// Clear glass.
    Glass,
}

struct Writer<'a> {
    scene: &'a Scene,
    base: &'a mut Base,
    scale: f32,
    materials: HashMap<(FinishId, Look), usize>,
    pictures: HashMap<TextureId, usize>,
    means: HashMap<TextureId, Rgb>,
    views: Views,
}

/// Bytes of each attribute of all primitives.
#[derive(Default)]
struct Views {
    positions: Vec<u8>,
    normals: Vec<u8>,
    uvs: Vec<u8>,
    texels: Vec<u8>,
    colours: Vec<u8>,
    irradiance: Vec<u8>,
    indices: Vec<u8>,
}

/// Which of the seven views an accessor reads; the order in which they are added.
#[derive(Clone, Copy)]
enum View {
    Positions,
    Normals,
    Uvs,
    Texels,
    Colours,
    Irradiance,
    Indices,
}

impl<'a> Writer<'a> {
    fn new(scene: &'a Scene, base: &'a mut Base, scale: f32) -> Self {
        Writer {
            scene,
            base,
            scale,
            materials: HashMap::new(),
            pictures: HashMap::new(),
            means: HashMap::new(),
            views: Views::default(),
        }
    }

    fn write(mut self, lit: &[LitPrimitive<'_>]) {
        let mut sides: Vec<Vec<&LitPrimitive<'_>>> = vec![Vec::new(); self.scene.surfaces.len()];
        for p in lit {
            sides[p.surface.index()].push(p);
        }
        let first_view = self.base.reserve_views(7);
        for (k, sides) in sides.iter().enumerate() {
            let mut primitives = Vec::new();
            for p in sides {
                primitives.extend(self.primitive(p, first_view));
            }
            if primitives.is_empty() {
                primitives.extend(self.dark(k, first_view));
            }
            if primitives.is_empty() {
                continue;
            }
            let surface = &self.scene.surfaces[k];
            let mut mesh = json!({ "name": surface.name, "primitives": primitives });
            if let Some(extras) = self.base.mesh_extras(surface) {
                mesh["extras"] = extras.clone();
            }
            let mesh = self.base.push("meshes", mesh);
            let node = self
                .base
                .push("nodes", json!({ "name": surface.name, "mesh": mesh }));
            self.base.add_root(node);
        }
        let v = self.views;
        let filled = [
            (v.positions, Some(12), 34962),
            (v.normals, Some(12), 34962),
            (v.uvs, Some(8), 34962),
            (v.texels, Some(8), 34962),
            (v.colours, Some(8), 34962),
            (v.irradiance, Some(12), 34962),
            (v.indices, None, 34963),
        ];
        self.base.fill_views(first_view, filled);
        self.base.use_extension("KHR_materials_unlit");
    }

    /// A lit side; `None` when it has no triangle.
    fn primitive(&mut self, p: &LitPrimitive<'_>, first_view: usize) -> Option<Value> {
        if p.triangles.is_empty() {
            return None;
        }
        let surface = &self.scene.surfaces[p.surface.index()];
        let finish = &self.scene.finishes[surface.finish.index()];
        let (look, glow) = self.look(finish, p);
        let reflectance = match (look, finish.texture) {
            (Look::Lit, _) => Rgb::WHITE,
            (Look::GlowPicture, _) => Rgb::BLACK,
            (_, Some(t)) => finish.reflectance * self.mean(t),
            (_, None) => finish.reflectance,
        };
        let reflects = p.side == Side::Front || finish.back_reflects;
        let reflectance = if reflects { reflectance } else { Rgb::BLACK };
        let colour = |e: &Rgb| reflectance * *e + glow;
        let colours: Vec<Rgb> = p.irradiance.iter().map(colour).collect();
        let triangles = p.triangles.iter().map(|t| t.map(|i| i - p.first_vertex));
        let material = self.material(p.surface, look);
        let uvs = if self.is_pictured(material) {
            p.uvs
        } else {
            &[]
        };
        // What glows is brighter than its light: its vertex colours hold both.
        let texels = if look == Look::Lit { p.texels } else { &[] };
        let mut mesh = self.mesh(
            first_view,
            p.positions,
            p.normals,
            uvs,
            texels,
            &colours,
            p.irradiance,
            triangles,
            material,
        );
        if !texels.is_empty() {
            mesh["extras"] = json!({ "luxel": { "lightmap": p.page } });
        }
        Some(mesh)
    }

    /// A surface of which no side is lit: its front, black, or as glass.
    fn dark(&mut self, surface: usize, first_view: usize) -> Option<Value> {
        let s = &self.scene.surfaces[surface];
        let look = match self.scene.finishes[s.finish.index()].transparent {
            true => Look::Glass,
            false => Look::Lit,
        };
        let (mut positions, mut normals, mut uvs) = (Vec::new(), Vec::new(), Vec::new());
        for t in s.triangles.clone() {
            let [a, b, c] = self.scene.corners(t as usize);
            let normal = (b - a).cross(c - a).normalize_or(Vec3::Y);
            positions.extend([a, b, c]);
            normals.extend([normal; 3]);
            uvs.extend(self.scene.uvs.get(t as usize).into_iter().flatten());
        }
        if positions.is_empty() {
            return None;
        }
        // Glass is no receiver: it is shown at the brightness of a surface in full light.
        let shown = if look == Look::Glass {
            Rgb::splat(1.0 / self.scale)
        } else {
            Rgb::BLACK
        };
        let colours = vec![shown; positions.len()];
        let irradiance = vec![Rgb::BLACK; positions.len()];
        let triangles = (0..positions.len() as u32 / 3).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]);
        let material = self.material(SurfaceId::from(surface), look);
        if !self.is_pictured(material) {
            uvs.clear();
        }
        Some(self.mesh(
            first_view,
            &positions,
            &normals,
            &uvs,
            &[],
            &colours,
            &irradiance,
            triangles,
            material,
        ))
    }

    /// How a side is shown, and what it gives by itself, lm/m² (for the vertex colours).
    fn look(&mut self, finish: &Finish, p: &LitPrimitive<'_>) -> (Look, Rgb) {
        let emits = p.side == Side::Front || finish.back_emits;
        let Some(emission) = finish.emission.as_ref().filter(|_| emits) else {
            return (Look::Lit, Rgb::BLACK);
        };
        let exitance = emission.luminance * LAMBERTIAN;
        if emission.texture.is_none() && finish.texture.is_none() {
            return (Look::Glow, exitance);
        }
        // The holes are in the texture of the reflectance, so that one must stay.
        if finish.alpha != Alpha::Opaque && finish.texture.is_some() {
            return (Look::Lit, Rgb::BLACK);
        }
        // Only one texture can be shown: that of the stronger light.
        let own = emission.texture.map_or(Rgb::WHITE, |t| self.mean(t)) * exitance;
        let base = finish.texture.map_or(Rgb::WHITE, |t| self.mean(t)) * finish.reflectance;
        let mut sum = Rgb::BLACK;
        p.irradiance.iter().for_each(|e| sum += *e);
        let reflected = base * sum * (1.0 / p.irradiance.len().max(1) as f32);
        match (
            own.luminance() >= reflected.luminance(),
            emission.texture.is_some(),
        ) {
            (false, _) => (Look::Lit, Rgb::BLACK),
            (true, true) => (Look::GlowPicture, exitance),
            (true, false) => (Look::Glow, exitance),
        }
    }

    fn mean(&mut self, texture: TextureId) -> Rgb {
        let scene = self.scene;
        *self
            .means
            .entry(texture)
            .or_insert_with(|| scene.textures[texture.index()].mean())
    }

    fn material(&mut self, surface: SurfaceId, look: Look) -> usize {
        let s = &self.scene.surfaces[surface.index()];
        if let Some(&known) = self.materials.get(&(s.finish, look)) {
            return known;
        }
        let finish = &self.scene.finishes[s.finish.index()];
        let coverage = finish.coverage.clamp(0.0, 1.0);
        let (factor, alpha, texture) = match look {
            Look::Lit => (
                finish.reflectance,
                coverage,
                finish.texture.map(|t| (t, "base")),
            ),
            Look::Glow => (Rgb::WHITE, coverage, None),
            Look::GlowPicture => {
                let picture = finish.emission.as_ref().and_then(|e| e.texture);
                (Rgb::WHITE, coverage, picture.map(|t| (t, "emission")))
            }
            Look::Glass => (finish.reflectance, 0.12, None),
        };
        let [r, g, b] = factor.map(|v| v.clamp(0.0, 1.0)).to_array();
        let mut pbr = json!({
            "baseColorFactor": [r, g, b, alpha],
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0,
        });
        if let Some((t, role)) = texture {
            let own = self.base.source_texture(s, role == "base");
            let index = own.unwrap_or_else(|| self.picture(t));
            pbr["baseColorTexture"] = json!({ "index": index });
        }
        let mut material = json!({
            "name": finish.name,
            "pbrMetallicRoughness": pbr,
            "extensions": { "KHR_materials_unlit": {} },
        });
        match (look, finish.alpha) {
            (Look::Glass, _) => {
                material["alphaMode"] = "BLEND".into();
                material["doubleSided"] = true.into();
            }
            (_, Alpha::Opaque) => {}
            (_, Alpha::Mask { cutoff }) => {
                material["alphaMode"] = "MASK".into();
                material["alphaCutoff"] = json!(cutoff.max(0.0));
            }
            (_, Alpha::Blend) => material["alphaMode"] = "BLEND".into(),
        }
        if let Some(index) = self.base.source_material(s) {
            if let Some(extras) = self.base.json["materials"][index].get("extras") {
                material["extras"] = extras.clone();
            }
            // A `luxel` member of other extras would lose its owner's meaning: objects only.
            let extras = material
                .as_object_mut()
                .expect("made as an object")
                .entry("extras");
            if let Some(extras) = extras.or_insert_with(|| json!({})).as_object_mut() {
                extras.insert("luxel".into(), json!({ "lit_from_material": index }));
            }
        }
        let index = self.base.push("materials", material);
        self.materials.insert((s.finish, look), index);
        index
    }

    fn is_pictured(&self, material: usize) -> bool {
        !self.base.json["materials"][material]["pbrMetallicRoughness"]["baseColorTexture"].is_null()
    }

    /// A texture of the scene that no source file has, as an embedded PNG.
    fn picture(&mut self, id: TextureId) -> usize {
        if let Some(&known) = self.pictures.get(&id) {
            return known;
        }
        let texture = &self.scene.textures[id.index()];
        let flat: Vec<u8> = texture.rgba.iter().flatten().copied().collect();
        let bytes = base::png(&flat, texture.width, texture.height);
        let image = self.base.add_image(&texture.name, "image/png", &bytes);
        let wrap = texture.wrap.map(|w| match w {
            luxel_core::texture::Wrap::Repeat => 10497,
            luxel_core::texture::Wrap::Mirror => 33648,
            luxel_core::texture::Wrap::Clamp => 33071,
        });
        let sampler = json!({
            "magFilter": 9729, "minFilter": 9987, "wrapS": wrap[0], "wrapT": wrap[1],
        });
        let sampler = self.base.push("samplers", sampler);
        let index = self
            .base
            .push("textures", json!({ "source": image, "sampler": sampler }));
        self.pictures.insert(id, index);
        index
    }

    fn mesh(
        &mut self,
        first_view: usize,
        positions: &[Vec3],
        normals: &[Vec3],
        uvs: &[Vec2],
        texels: &[Vec2],
        colours: &[Rgb],
        irradiance: &[Rgb],
        triangles: impl Iterator<Item = [u32; 3]>,
        material: usize,
    ) -> Value {
        let v = &mut self.views;
        let n = positions.len();
        let mut low = Vec3::splat(f32::INFINITY);
        let mut high = Vec3::splat(f32::NEG_INFINITY);
        let start = [
            &v.positions,
            &v.normals,
            &v.uvs,
            &v.texels,
            &v.colours,
            &v.irradiance,
            &v.indices,
        ]
        .map(Vec::len);
        for &p in positions {
            (low, high) = (low.min(p), high.max(p));
            put(&mut v.positions, &p.to_array());
        }
        for &normal in normals {
            // Viewers and validators want units, whatever rounding left.
            put(&mut v.normals, &normal.normalize_or(Vec3::Y).to_array());
        }
        for (out, list) in [(&mut v.uvs, uvs), (&mut v.texels, texels)] {
            for uv in list {
                put(
                    out,
                    &uv.to_array().map(|c| if c.is_finite() { c } else { 0.0 }),
                );
            }
        }
        for &c in colours {
            let c = (c * self.scale).map(|b| if b.is_finite() { b.max(0.0) } else { 0.0 });
            // What is too bright keeps its hue.
            let c = c * (1.0 / c.max_band().max(1.0));
            for band in c.to_array() {
                v.colours
                    .extend(((band * 65535.0 + 0.5) as u16).to_le_bytes());
            }
            v.colours.extend(u16::MAX.to_le_bytes());
        }
        for &e in irradiance {
            put(
                &mut v.irradiance,
                &e.to_array().map(|b| if b.is_finite() { b } else { 0.0 }),
            );
        }
        let mut corners = 0;
        for t in triangles {
            corners += 3;
            t.iter().for_each(|i| v.indices.extend(i.to_le_bytes()));
        }
        let mut accessor = |view: View, at: usize, kind: u32, form: &str, count: usize| {
            let mut value = json!({
                "bufferView": first_view + view as usize,
                "byteOffset": at,
                "componentType": kind,
                "count": count,
                "type": form,
            });
            match view {
                View::Positions => {
                    value["min"] = json!(low.to_array());
                    value["max"] = json!(high.to_array());
                }
                View::Colours => value["normalized"] = true.into(),
                _ => {}
            }
            self.base.push("accessors", value)
        };
        let mut attributes = Map::new();
        let mut attribute = |name: &str, index: usize| attributes.insert(name.into(), json!(index));
        attribute(
            "POSITION",
            accessor(View::Positions, start[0], 5126, "VEC3", n),
        );
        attribute("NORMAL", accessor(View::Normals, start[1], 5126, "VEC3", n));
        if uvs.len() == n {
            attribute("TEXCOORD_0", accessor(View::Uvs, start[2], 5126, "VEC2", n));
        }
        if texels.len() == n {
            attribute(
                "TEXCOORD_1",
                accessor(View::Texels, start[3], 5126, "VEC2", n),
            );
        }
        attribute(
            "COLOR_0",
            accessor(View::Colours, start[4], 5123, "VEC4", n),
        );
        attribute(
            "_IRRADIANCE",
            accessor(View::Irradiance, start[5], 5126, "VEC3", n),
        );
        let indices = accessor(View::Indices, start[6], 5125, "SCALAR", corners);
        json!({ "attributes": attributes, "indices": indices, "material": material })
    }
}

fn put(out: &mut Vec<u8>, values: &[f32]) {
    values.iter().for_each(|v| out.extend(v.to_le_bytes()));
}

#[cfg(test)]
mod tests;
