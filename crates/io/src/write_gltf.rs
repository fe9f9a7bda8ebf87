//! The lit scene as a glTF binary that any viewer shows as it was lit.
//!
//! Materials are unlit and vertex colours carry the light, so a viewer shows
//! reflectance x COLOR_0 without a lamp of its own: COLOR_0 = illuminance x exposure, linear,
//! 16 bits, clipped to 0..1 as the format demands. Emitters show their luminance on the same
//! scale. The illuminance itself, unclipped in lux, stands in the attribute `_IRRADIANCE`, and
//! `asset.extras.luxel` says how the two belong together.
//!
//! Geometry is in world space and metres, one node and one mesh for each surface, one primitive
//! for each side that is lit. Sides that are black and surfaces of clear glass are written so
//! that nothing is missing. What a glTF source holds beside its meshes is kept: see [`base`].
//!
//! Source: [GLTF20], KHR_materials_unlit, KHR_lights_punctual.

mod base;

use crate::atomic;
use crate::document::Source;
use base::{Base, matrix};
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::{
    Alpha, Finish, FinishId, LuminaireKind, Rgb, Scene, Side, SurfaceId, TextureId, Vec2, Vec3,
};
use serde_json::{Map, Value, json};
use std::collections::HashMap;
use std::io;
use std::path::Path;

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
    /// Illuminance in linear bands, lux.
    pub irradiance: &'a [Rgb],
    /// Corners.
    pub triangles: &'a [[u32; 3]],
    /// What to subtract from the corners.
    pub first_vertex: u32,
}

/// How illuminance becomes a vertex colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitScale {
    /// COLOR_0 for each lux.
    pub colour_per_lux: f32,
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
    let scale = if scale.colour_per_lux.is_finite() && scale.colour_per_lux > 0.0 {
        scale.colour_per_lux
    } else {
        1.0 / LAMBERTIAN
    };
    Writer::new(scene, &mut base, scale).write(lit);
    if scene.up.z > 0.9 {
        base.turn_z_up();
    }
    base.note(json!({
        "exposure": scale,
        "scale": 1.0 / scale,
        "unit": "COLOR_0 x scale = illuminance in lux, where COLOR_0 is below 1",
        "irradiance": "_IRRADIANCE is the illuminance in lux, linear RGB (Rec. 709 primaries)",
        "shown": "baseColor x COLOR_0 = reflectance x illuminance x exposure",
    }));
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
    colours: Vec<u8>,
    irradiance: Vec<u8>,
    indices: Vec<u8>,
}

/// Which of the six views an accessor reads; the order in which they are added.
#[derive(Clone, Copy)]
enum View {
    Positions,
    Normals,
    Uvs,
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
        let first_view = self.base.reserve_views(6);
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
        Some(self.mesh(
            first_view,
            p.positions,
            p.normals,
            uvs,
            &colours,
            p.irradiance,
            triangles,
            material,
        ))
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
        for &uv in uvs {
            put(
                &mut v.uvs,
                &uv.to_array().map(|c| if c.is_finite() { c } else { 0.0 }),
            );
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
        attribute(
            "COLOR_0",
            accessor(View::Colours, start[3], 5123, "VEC4", n),
        );
        attribute(
            "_IRRADIANCE",
            accessor(View::Irradiance, start[4], 5126, "VEC3", n),
        );
        let indices = accessor(View::Indices, start[5], 5125, "SCALAR", corners);
        json!({ "attributes": attributes, "indices": indices, "material": material })
    }
}

fn put(out: &mut Vec<u8>, values: &[f32]) {
    values.iter().for_each(|v| out.extend(v.to_le_bytes()));
}

/// Cameras and punctual lights of a scene that came from no glTF file.
fn add_views_and_luminaires(base: &mut Base, scene: &Scene) {
    for view in &scene.views {
        let angle = view.vertical_angle.clamp(0.01, 3.1);
        let perspective = json!({ "yfov": angle, "znear": 0.01 });
        let camera =
            json!({ "name": view.name, "type": "perspective", "perspective": perspective });
        let camera = base.push("cameras", camera);
        let placed = matrix(view.eye, view.forward, view.up);
        let node = json!({ "name": view.name, "camera": camera, "matrix": placed });
        let node = base.push("nodes", node);
        base.add_root(node);
    }
    for l in &scene.luminaires {
        let (kind, strength) = match l.kind {
            LuminaireKind::Point { intensity, .. } => ("point", intensity),
            LuminaireKind::Spot { intensity, .. } => ("spot", intensity),
            LuminaireKind::Directional { illuminance } => ("directional", illuminance),
            // The format has no cosine; a half space is the nearest it can say.
            LuminaireKind::Lambertian { intensity } => ("spot", intensity),
        };
        let most = strength.max_band();
        let colour = if most > 0.0 {
            strength * (1.0 / most)
        } else {
            Rgb::WHITE
        };
        let mut light = json!({
            "name": l.name, "type": kind, "intensity": most.max(0.0), "color": colour.to_array(),
        });
        match l.kind {
            LuminaireKind::Point { range_m, .. } | LuminaireKind::Spot { range_m, .. }
                if range_m.is_finite() && range_m > 0.0 =>
            {
                light["range"] = json!(range_m);
            }
            _ => {}
        }
        let quarter = std::f32::consts::FRAC_PI_2;
        match l.kind {
            LuminaireKind::Spot {
                cos_inner,
                cos_outer,
                ..
            } => {
                let outer = cos_outer.clamp(0.0, 1.0).acos().clamp(1e-3, quarter);
                let inner = cos_inner.clamp(0.0, 1.0).acos().min(outer * 0.999);
                light["spot"] = json!({ "innerConeAngle": inner, "outerConeAngle": outer });
            }
            LuminaireKind::Lambertian { .. } => {
                light["spot"] = json!({ "innerConeAngle": 0.0, "outerConeAngle": quarter });
            }
            _ => {}
        }
        let index = base.push_light(light);
        let aim = l.direction.normalize_or(-Vec3::Y);
        let node = base.push(
            "nodes",
            json!({
                "name": l.name,
                "matrix": matrix(l.position, aim, scene.up),
                "extensions": { "KHR_lights_punctual": { "light": index } },
            }),
        );
        base.add_root(node);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::GltfSource;
    use luxel_core::texture::Wrap;
    use luxel_core::{Emission, Finish, Group, GroupId, Luminaire, Surface, Texture, View as Look};

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
            irradiance: &irradiance,
            triangles: &[[0, 1, 2]],
            first_vertex: 0,
        };
        let nowhere = LitScale {
            colour_per_lux: f32::NAN,
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
}
