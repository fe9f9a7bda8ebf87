//! Primitives into triangles: modes, indices, texture coordinates, vertex colours. [GLTF20] 3.7.2.

use super::buffers::{Accessor, Buffers, ExternalImages};
use super::materials::{Materials, TextureUse};
use crate::assemble::Assembly;
use crate::budget::Budget;
use crate::error::{Error, Within};
use crate::json::{Json, entry};
use luxel_core::texture::Wrap;
use luxel_core::{FinishId, Rgb, Texture, TextureId, Vec2, Vec3};
use serde_json::Value;
use std::collections::HashMap;
use std::rc::Rc;

/// A primitive in the space of its mesh.
pub(crate) struct Primitive {
    /// Index within its mesh.
    pub index: u32,
    pub positions: Vec<[f32; 3]>,
    /// In the order of the file: `k` is triangle `k` of the primitive.
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle, or empty.
    pub uvs: Vec<[Vec2; 3]>,
    pub finish: FinishId,
}

/// Meshes, decoded when first placed; kept when they are placed again.
pub(crate) struct Meshes<'a> {
    json: &'a Value,
    uses: HashMap<usize, usize>,
    decoded: HashMap<usize, Rc<Vec<Primitive>>>,
}

impl<'a> Meshes<'a> {
    pub(crate) fn new(json: &'a Value) -> Self {
        let mut uses = HashMap::new();
        for node in json.list("nodes").unwrap_or(&[]) {
            if let Ok(Some(mesh)) = node.whole("mesh") {
                *uses.entry(mesh).or_insert(0) += 1;
            }
        }
        Meshes {
            json,
            uses,
            decoded: HashMap::new(),
        }
    }

    pub(crate) fn name(&self, mesh: usize) -> Option<String> {
        entry(self.json, "meshes", mesh).ok()?.name()
    }

    /// Primitives of a mesh that have triangles.
    pub(crate) fn primitives(
        &mut self,
        mesh: usize,
        materials: &mut Materials<'a>,
        buffers: &Buffers,
        images: &mut ExternalImages<'_>,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Result<Rc<Vec<Primitive>>, Error> {
        if let Some(known) = self.decoded.get(&mesh) {
            return Ok(known.clone());
        }
        let value = entry(self.json, "meshes", mesh)?;
        let mut out = Vec::new();
        let list = value.list("primitives").within(|| format!("mesh {mesh}"))?;
        for (index, primitive) in list.iter().enumerate() {
            let place = format!("mesh {mesh}, primitive {index}");
            let mut reading = Reading {
                json: self.json,
                place: &place,
                materials,
                buffers,
                images,
                assembly,
                budget,
            };
            if let Some(p) = reading
                .primitive(primitive, index as u32)
                .within(|| &place)?
            {
                out.push(p);
            }
        }
        let out = Rc::new(out);
        if self.uses.get(&mesh).is_some_and(|&n| n > 1) {
            self.decoded.insert(mesh, out.clone());
        }
        Ok(out)
    }
}

/// Triangles of `count` corners under a primitive mode, as positions in the corner list.
///
/// 4 triangles, 5 strip, 6 fan: [GLTF20] 3.7.2.1, winding as there.
pub(crate) fn triangles_of_mode(mode: usize, count: usize) -> Vec<[usize; 3]> {
    match mode {
        4 => (0..count / 3)
            .map(|k| [3 * k, 3 * k + 1, 3 * k + 2])
            .collect(),
        5 => (0..count.saturating_sub(2))
            .map(|k| [k, k + 1 + k % 2, k + 2 - k % 2])
            .collect(),
        6 => (0..count.saturating_sub(2))
            .map(|k| [k + 1, k + 2, 0])
            .collect(),
        _ => Vec::new(),
    }
}

struct Reading<'r, 'a, 'i, 'o> {
    json: &'a Value,
    place: &'r str,
    materials: &'r mut Materials<'a>,
    buffers: &'r Buffers,
    images: &'r mut ExternalImages<'i>,
    assembly: &'r mut Assembly<'o>,
    budget: &'r mut Budget,
}

impl Reading<'_, '_, '_, '_> {
    fn warn(&mut self, what: &str) {
        self.assembly.warn(self.place, what, 1);
    }

    fn primitive(&mut self, value: &Value, index: u32) -> Result<Option<Primitive>, Error> {
        let mode = value.whole("mode")?.unwrap_or(4);
        if mode > 6 {
            return Err(Error::new("a mode from 0 to 6", mode.to_string()).within("mode"));
        }
        if mode < 4 {
            self.assembly.warn(
                self.place,
                "points and lines have no area and are left out",
                1,
            );
            return Ok(None);
        }
        let attributes = value.object("attributes")?;
        let attributes = attributes.ok_or_else(|| Error::new("attributes", "none"))?;
        let Some(at) = attributes.whole("POSITION").within(|| "attributes")? else {
            self.warn("has no POSITION and is left out");
            return Ok(None);
        };
        let draco = value.extension("KHR_draco_mesh_compression")?.is_some();
        if !value.list("targets")?.is_empty() {
            self.warn("morph targets are ignored");
        }
        let positions = self.positions(at, draco)?;
        let corners = match value.whole("indices")? {
            None => None,
            Some(k) => Some(
                Accessor::new(self.json, self.buffers, k, &["SCALAR"])
                    .and_then(|a| a.indices(positions.len(), self.budget))
                    .within(|| "indices")?,
            ),
        };
        let count = corners.as_ref().map_or(positions.len(), Vec::len);
        if mode == 4 && count % 3 != 0 {
            self.warn("corners are left over after the last whole triangle");
        }
        self.budget.take(count, 24)?;
        let at = |i: usize| corners.as_ref().map_or(i as u32, |c| c[i]);
        let triangles: Vec<[u32; 3]> = triangles_of_mode(mode, count)
            .into_iter()
            .map(|t| t.map(at))
            .collect();
        if triangles.is_empty() {
            return Ok(None);
        }
        let (uvs, finish) = self.finish(value, attributes, &positions, &triangles)?;
        // What is held now is counted again where it is placed.
        Ok(Some(Primitive {
            index,
            positions,
            triangles,
            uvs,
            finish,
        }))
    }

    fn positions(&mut self, accessor: usize, draco: bool) -> Result<Vec<[f32; 3]>, Error> {
        let mut read = || {
            let a = Accessor::new(self.json, self.buffers, accessor, &["VEC3"])?;
            if draco && !a.has_bytes() {
                return Err(Error::new(
                    "plain positions",
                    "KHR_draco_mesh_compression, which is not read",
                ));
            }
            let flat = a.floats(self.budget)?;
            Ok(flat.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect())
        };
        read().within(|| "POSITION")
    }

    /// Texture coordinates for the triangles and the finish that goes with them.
    ///
    /// The scene has one set of texture coordinates. Where base colour and emission use two
    /// different ones, the emission becomes its mean over the primitive.
    fn finish(
        &mut self,
        primitive: &Value,
        attributes: &Value,
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
    ) -> Result<(Vec<[Vec2; 3]>, FinishId), Error> {
        let index = primitive.whole("material")?;
        let material =
            self.materials
                .get(index, self.buffers, self.images, self.assembly, self.budget)?;
        let (base, glow) = (material.base.clone(), material.glow.clone());
        let mut finish = material.finish.clone();
        let mut plain = true;
        let mut uvs = Vec::new();
        let mut holder = None;
        match self.vertex_colours(attributes, positions.len(), triangles)? {
            Colours::One(colour) if colour == Rgb::WHITE => {}
            Colours::One(colour) => {
                plain = false;
                finish.reflectance = finish.reflectance * colour;
            }
            Colours::Many(colours) if base.is_some() => {
                plain = false;
                let mean = mean_by_area(positions, triangles, |k| colours[k]);
                finish.reflectance = finish.reflectance * mean;
                self.warn("vertex colours under a texture were taken as their mean");
            }
            Colours::Many(colours) => {
                plain = false;
                let (texture, coordinates) = self.palette(&colours)?;
                finish.texture = Some(texture);
                uvs = coordinates;
                holder = Some(None);
            }
        }
        if let (Some(use_), None) = (&base, &holder) {
            uvs = self.coordinates(attributes, use_, positions.len(), triangles)?;
            holder = Some(Some(use_.place));
        }
        if let (Some(use_), Some(emission)) = (&glow, finish.emission.as_mut()) {
            match holder {
                None => uvs = self.coordinates(attributes, use_, positions.len(), triangles)?,
                Some(Some(place)) if place == use_.place => {}
                Some(_) => {
                    plain = false;
                    emission.texture = None;
                    let own = self.coordinates(attributes, use_, positions.len(), triangles)?;
                    let picture = &self.assembly.scene.textures[use_.texture.index()];
                    let mean = mean_by_area(positions, triangles, |k| mean_over(picture, &own[k]));
                    emission.luminance = emission.luminance * mean;
                    self.warn("emission on texture coordinates of its own was taken as its mean");
                }
            }
        }
        let key = index.unwrap_or(usize::MAX);
        let id = match (plain, self.materials.plain(index)) {
            (true, Some(id)) => id,
            (true, None) => {
                let id = self.assembly.add_finish(finish, key);
                self.materials.set_plain(index, id);
                id
            }
            (false, _) => self.assembly.add_finish(finish, key),
        };
        Ok((uvs, id))
    }

    /// Texture coordinates of each triangle's corners under a use of a texture.
    fn coordinates(
        &mut self,
        attributes: &Value,
        use_: &TextureUse,
        vertices: usize,
        triangles: &[[u32; 3]],
    ) -> Result<Vec<[Vec2; 3]>, Error> {
        self.budget.take(triangles.len(), 24)?;
        let name = format!("TEXCOORD_{}", use_.place.set);
        let Some(accessor) = attributes.whole(&name).within(|| "attributes")? else {
            self.warn(&format!(
                "has a texture but no {name}: the first texel is taken everywhere"
            ));
            return Ok(vec![[Vec2::ZERO; 3]; triangles.len()]);
        };
        let mut read = || {
            let a = Accessor::new(self.json, self.buffers, accessor, &["VEC2"])?;
            if a.count < vertices {
                return Err(Error::new(
                    format!("{vertices} values"),
                    a.count.to_string(),
                ));
            }
            a.floats(self.budget)
        };
        let flat = read().within(|| name)?;
        let at = |i: u32| {
            let i = i as usize;
            use_.place.apply(Vec2::new(flat[2 * i], flat[2 * i + 1]))
        };
        Ok(triangles.iter().map(|t| t.map(at)).collect())
    }

    /// The mean of the corners' COLOR_0, one for each triangle or one for all.
    fn vertex_colours(
        &mut self,
        attributes: &Value,
        vertices: usize,
        triangles: &[[u32; 3]],
    ) -> Result<Colours, Error> {
        let Some(accessor) = attributes.whole("COLOR_0").within(|| "attributes")? else {
            return Ok(Colours::One(Rgb::WHITE));
        };
        let mut read = || {
            let a = Accessor::new(self.json, self.buffers, accessor, &["VEC3", "VEC4"])?;
            if a.count < vertices {
                return Err(Error::new(
                    format!("{vertices} values"),
                    a.count.to_string(),
                ));
            }
            Ok((a.width, a.floats(self.budget)?))
        };
        let (width, flat) = read().within(|| "COLOR_0")?;
        let bounded = |v: f32| {
            if v.is_finite() {
                v.clamp(0.0, 1.0)
            } else {
                1.0
            }
        };
        let at = |i: u32| {
            let k = i as usize * width;
            Rgb::new(bounded(flat[k]), bounded(flat[k + 1]), bounded(flat[k + 2]))
        };
        let mean = |t: &[u32; 3]| (at(t[0]) + at(t[1]) + at(t[2])) * (1.0 / 3.0);
        let first = mean(&triangles[0]);
        let near = |c: Rgb| {
            let d = c - first;
            d.r.abs().max(d.g.abs()).max(d.b.abs()) < 1e-4
        };
        if triangles.iter().all(|t| near(mean(t))) {
            // Mean of three thirds: 1 may come out as 0.99999994.
            let white = (first - Rgb::WHITE).map(f32::abs).max_band() < 1e-4;
            return Ok(Colours::One(if white { Rgb::WHITE } else { first }));
        }
        self.budget.take(triangles.len(), 12)?;
        Ok(Colours::Many(triangles.iter().map(mean).collect()))
    }

    /// A picture with a texel for each different colour, and coordinates in the middle of them.
    fn palette(&mut self, colours: &[Rgb]) -> Result<(TextureId, Vec<[Vec2; 3]>), Error> {
        // Texel centres of a power of two are exact in f32: bilinear lookup mixes nothing.
        const WIDTH: usize = 1024;
        self.budget.take(colours.len(), 4 + 24 + 24)?;
        let mut texels: Vec<[u8; 4]> = Vec::new();
        let mut known = HashMap::new();
        let places: Vec<usize> = colours
            .iter()
            .map(|c| {
                let [r, g, b] = c.to_array().map(srgb_from_linear);
                *known.entry([r, g, b]).or_insert_with(|| {
                    texels.push([r, g, b, 255]);
                    texels.len() - 1
                })
            })
            .collect();
        let height = texels.len().div_ceil(WIDTH).next_power_of_two();
        let width = if height == 1 {
            texels.len().next_power_of_two()
        } else {
            WIDTH
        };
        texels.resize(width * height, [255; 4]);
        let uvs = places
            .into_iter()
            .map(|k| {
                let (x, y) = ((k % width) as f32 + 0.5, (k / width) as f32 + 0.5);
                [Vec2::new(x / width as f32, y / height as f32); 3]
            })
            .collect();
        let textures = &mut self.assembly.scene.textures;
        textures.push(Texture {
            name: format!("vertex colours of {}", self.place),
            width: width as u32,
            height: height as u32,
            rgba: texels,
            wrap: [Wrap::Clamp; 2],
        });
        Ok((TextureId::from(textures.len() - 1), uvs))
    }
}

enum Colours {
    One(Rgb),
    Many(Vec<Rgb>),
}

/// Mean of a value over triangles, weighted by their areas.
fn mean_by_area(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    value: impl Fn(usize) -> Rgb,
) -> Rgb {
    let (mut sum, mut whole) = ([0.0f64; 3], 0.0f64);
    for (k, t) in triangles.iter().enumerate() {
        let [a, b, c] = t.map(|i| Vec3::from(positions[i as usize]).as_dvec3());
        let area = (b - a).cross(c - a).length();
        if !area.is_finite() {
            continue;
        }
        whole += area;
        for (slot, band) in sum.iter_mut().zip(value(k).to_array()) {
            *slot += area * band as f64;
        }
    }
    if whole > 0.0 {
        Rgb::from(sum.map(|s| (s / whole) as f32))
    } else {
        Rgb::WHITE
    }
}

/// Mean of a texture over a triangle, at 64 points of a low-discrepancy sequence [Roberts18].
fn mean_over(texture: &Texture, uv: &[Vec2; 3]) -> Rgb {
    let mut sum = Rgb::BLACK;
    for k in 0..64 {
        let mut s = (0.5 + k as f32 * 0.754_877_7).fract();
        let mut t = (0.5 + k as f32 * 0.569_840_3).fract();
        if s + t > 1.0 {
            (s, t) = (1.0 - s, 1.0 - t);
        }
        sum += texture
            .sample(uv[0] * (1.0 - s - t) + uv[1] * s + uv[2] * t)
            .0;
    }
    sum * (1.0 / 64.0)
}

/// Encodes one linear value, 0..=1, as an sRGB byte [IEC61966-2-1].
pub(crate) fn srgb_from_linear(v: f32) -> u8 {
    let v = v.clamp(0.0, 1.0);
    let encoded = if v <= 0.003_130_8 {
        v * 12.92
    } else {
        1.055 * v.powf(1.0 / 2.4) - 0.055
    };
    (encoded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_wind_as_the_specification_says() {
        // [GLTF20] 3.7.2.1: strip p_i = {v_i, v_(i+1+i%2), v_(i+2-i%2)}; fan {v_(i+1), v_(i+2), v_0}.
        assert_eq!(triangles_of_mode(4, 7), [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(triangles_of_mode(5, 5), [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        assert_eq!(triangles_of_mode(6, 4), [[1, 2, 0], [2, 3, 0]]);
        for mode in 4..7 {
            assert!(triangles_of_mode(mode, 2).is_empty());
        }
    }

    #[test]
    fn encoding_is_the_inverse_of_decoding() {
        for byte in 0..=255 {
            assert_eq!(
                srgb_from_linear(luxel_core::texture::linear_from_srgb(byte)),
                byte
            );
        }
    }
}
