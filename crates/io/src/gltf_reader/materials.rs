//! Materials into finishes, and their textures. [GLTF20] 3.9, KHR_texture_transform.

use super::buffers::{Buffers, ExternalImages};
use crate::assemble::Assembly;
use crate::budget::Budget;
use crate::error::{Error, Within};
use crate::json::{Json, entry};
use crate::options::MOST_LIGHT;
use crate::picture;
use luxel_core::texture::Wrap;
use luxel_core::{Alpha, Emission, Finish, FinishId, GroupId, Rgb, Texture, TextureId, Vec2};
use serde_json::Value;
use std::collections::HashMap;

/// Which coordinates a texture uses, and how they are changed first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TexturePlace {
    pub set: usize,
    /// Rows of a 2 x 3 matrix.
    rows: [[f32; 3]; 2],
}

impl TexturePlace {
    pub(crate) fn apply(&self, uv: Vec2) -> Vec2 {
        let [x, y] = self.rows;
        let out = Vec2::new(
            x[0] * uv.x + x[1] * uv.y + x[2],
            y[0] * uv.x + y[1] * uv.y + y[2],
        );
        if out.is_finite() { out } else { Vec2::ZERO }
    }
}

/// A texture as a material uses it.
#[derive(Clone, Debug)]
pub(crate) struct TextureUse {
    pub texture: TextureId,
    pub place: TexturePlace,
}

/// A material before vertex colours.
#[derive(Clone)]
pub(crate) struct Material {
    pub finish: Finish,
    pub base: Option<TextureUse>,
    pub glow: Option<TextureUse>,
}

/// Materials of a file, made when first used.
pub(crate) struct Materials<'a> {
    json: &'a Value,
    made: HashMap<Option<usize>, Material>,
    plain: HashMap<Option<usize>, FinishId>,
    /// Textures by image and wrapping.
    textures: HashMap<(usize, [u8; 2]), Option<TextureId>>,
}

impl<'a> Materials<'a> {
    pub(crate) fn new(json: &'a Value) -> Self {
        Materials {
            json,
            made: HashMap::new(),
            plain: HashMap::new(),
            textures: HashMap::new(),
        }
    }

    /// The finish of a material without changes by vertex colours, once it is in the scene.
    pub(crate) fn plain(&self, index: Option<usize>) -> Option<FinishId> {
        self.plain.get(&index).copied()
    }

    pub(crate) fn set_plain(&mut self, index: Option<usize>, id: FinishId) {
        self.plain.insert(index, id);
    }

    /// Material `index`, or the default one.
    pub(crate) fn get(
        &mut self,
        index: Option<usize>,
        buffers: &Buffers,
        images: &mut ExternalImages<'_>,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Result<&Material, Error> {
        if !self.made.contains_key(&index) {
            let material = match index {
                None => Material {
                    finish: Finish {
                        name: "(default)".into(),
                        reflectance: Rgb::WHITE,
                        ..Finish::default()
                    },
                    base: None,
                    glow: None,
                },
                Some(k) => {
                    let value = entry(self.json, "materials", k)?;
                    let place = format!("material {k}");
                    self.read(value, &place, buffers, images, assembly, budget)
                        .within(|| &place)?
                }
            };
            self.made.insert(index, material);
        }
        Ok(&self.made[&index])
    }

    fn read(
        &mut self,
        value: &Value,
        place: &str,
        buffers: &Buffers,
        images: &mut ExternalImages<'_>,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Result<Material, Error> {
        let name = value.name().unwrap_or_else(|| place.to_owned());
        let shown = format!("{place} '{name}'");
        let pbr = value
            .object("pbrMetallicRoughness")?
            .unwrap_or(&Value::Null);
        let factor = pbr
            .numbers::<4>("baseColorFactor")
            .within(|| "pbrMetallicRoughness")?
            .unwrap_or([1.0; 4])
            .map(|v| v as f32);
        let bounded = factor.map(|v| v.clamp(0.0, 1.0));
        if bounded != factor {
            assembly.warn(&shown, "base colour outside 0 to 1 was clamped", 1);
        }
        let [r, g, b, coverage] = bounded;
        let two_sided = value.flag("doubleSided")?;
        let alpha = match value.text("alphaMode")?.unwrap_or("OPAQUE") {
            "OPAQUE" => Alpha::Opaque,
            "MASK" => {
                let cutoff = value.number("alphaCutoff")?.unwrap_or(0.5);
                Alpha::Mask {
                    cutoff: cutoff as f32,
                }
            }
            "BLEND" => Alpha::Blend,
            other => {
                return Err(
                    Error::new("OPAQUE, MASK or BLEND", format!("'{other}'")).within("alphaMode")
                );
            }
        };
        let transmission = match value.extension("KHR_materials_transmission")? {
            Some(t) => t.number("transmissionFactor")?.unwrap_or(0.0),
            None => 0.0,
        };
        let transparent = transmission > 0.5;
        if transparent {
            assembly.warn(&shown, "glass: light passes as if it were not there", 1);
        } else if transmission > 0.0 {
            assembly.warn(&shown, "transmission of 0.5 or less is taken as opaque", 1);
        }
        let base = match pbr
            .object("baseColorTexture")
            .within(|| "pbrMetallicRoughness")?
        {
            Some(t) if !transparent => self
                .texture(t, &shown, buffers, images, assembly, budget)
                .within(|| "baseColorTexture")?,
            _ => None,
        };
        let (emission, glow) = self.emission(value, &shown, buffers, images, assembly, budget)?;
        let finish = Finish {
            name,
            reflectance: Rgb::new(r, g, b),
            texture: base.as_ref().map(|t| t.texture),
            emission,
            back_reflects: two_sided,
            back_emits: two_sided,
            alpha,
            coverage,
            transparent,
        };
        Ok(Material { finish, base, glow })
    }

    fn emission(
        &mut self,
        value: &Value,
        shown: &str,
        buffers: &Buffers,
        images: &mut ExternalImages<'_>,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Result<(Option<Emission>, Option<TextureUse>), Error> {
        let factor = value.numbers::<3>("emissiveFactor")?.unwrap_or([0.0; 3]);
        let strength = match value.extension("KHR_materials_emissive_strength")? {
            Some(e) => e
                .number("emissiveStrength")
                .within(|| "KHR_materials_emissive_strength")?
                .unwrap_or(1.0),
            None => 1.0,
        };
        let product = factor.map(|f| (f * strength) as f32);
        let bounded = product.map(|v| v.clamp(0.0, MOST_LIGHT));
        if bounded != product {
            assembly.warn(
                shown,
                format!("luminance outside 0 to {MOST_LIGHT:e} cd/m² was clamped"),
                1,
            );
        }
        let luminance = Rgb::from(bounded);
        if luminance.max_band() <= 0.0 {
            return Ok((None, None));
        }
        let glow = match value.object("emissiveTexture")? {
            Some(t) => self
                .texture(t, shown, buffers, images, assembly, budget)
                .within(|| "emissiveTexture")?,
            None => None,
        };
        if glow.is_some() && value.extension("KHR_materials_unlit")?.is_some() {
            let what = "is unlit and has an emissive texture, probably light that was baked: it is read as a light";
            assembly.warn(shown, what, 1);
        }
        let texture = glow.as_ref().map(|t| t.texture);
        Ok((
            Some(Emission {
                luminance,
                texture,
                group: GroupId::NONE,
            }),
            glow,
        ))
    }

    /// A texture reference of a material; `None` when its picture cannot be read.
    fn texture(
        &mut self,
        reference: &Value,
        shown: &str,
        buffers: &Buffers,
        images: &mut ExternalImages<'_>,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Result<Option<TextureUse>, Error> {
        let index = reference
            .whole("index")?
            .ok_or_else(|| Error::new("index", "none"))?;
        let mut set = reference.whole("texCoord")?.unwrap_or(0);
        let mut rows = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        if let Some(t) = reference.extension("KHR_texture_transform")? {
            let [sx, sy] = t.numbers("scale")?.unwrap_or([1.0; 2]);
            let [ox, oy] = t.numbers("offset")?.unwrap_or([0.0; 2]);
            let (sin, cos) = t.number("rotation")?.unwrap_or(0.0).sin_cos();
            rows =
                [[cos * sx, sin * sy, ox], [-sin * sx, cos * sy, oy]].map(|r| r.map(|v| v as f32));
            set = t.whole("texCoord")?.unwrap_or(set);
        }
        let texture = entry(self.json, "textures", index)?;
        let wrap = match texture.whole("sampler")? {
            None => [10497; 2],
            Some(k) => {
                let sampler = entry(self.json, "samplers", k)?;
                [
                    sampler.whole("wrapS")?.unwrap_or(10497),
                    sampler.whole("wrapT")?.unwrap_or(10497),
                ]
            }
        };
        let wrap = wrap.map(|code| match code {
            33071 => Wrap::Clamp,
            33648 => Wrap::Mirror,
            _ => Wrap::Repeat,
        });
        let Some(source) = texture.whole("source")? else {
            assembly.warn(
                shown,
                format!("texture {index} has no picture that is read here: only the factor counts"),
                1,
            );
            return Ok(None);
        };
        let key = (source, wrap.map(|w| w as u8));
        let id = match self.textures.get(&key) {
            Some(known) => *known,
            None => {
                let made = self.load(source, wrap, buffers, images, assembly, budget);
                let id = match made {
                    Ok(texture) => {
                        assembly.scene.textures.push(texture);
                        Some(TextureId::from(assembly.scene.textures.len() - 1))
                    }
                    Err(why) => {
                        let what = format!("picture cannot be read, only the factor counts: {why}");
                        assembly.warn(&format!("image {source}"), what, 1);
                        None
                    }
                };
                self.textures.insert(key, id);
                id
            }
        };
        Ok(id.map(|texture| TextureUse {
            texture,
            place: TexturePlace { set, rows },
        }))
    }

    /// Decodes an image.
    fn load(
        &self,
        index: usize,
        wrap: [Wrap; 2],
        buffers: &Buffers,
        images: &mut ExternalImages<'_>,
        assembly: &Assembly<'_>,
        budget: &mut Budget,
    ) -> Result<Texture, String> {
        let short = |e: Error| match &e.place {
            crate::error::Place::Part(part) => {
                format!("{part}: expected {}, found {}", e.expected, e.found)
            }
            _ => format!("expected {}, found {}", e.expected, e.found),
        };
        let image = entry(self.json, "images", index).map_err(short)?;
        let name = image.name().unwrap_or_else(|| format!("image {index}"));
        let other = self
            .textures
            .iter()
            .find_map(|(key, id)| (key.0 == index).then_some(*id));
        if let Some(Some(id)) = other {
            // The same picture, wrapped in another way.
            let known = &assembly.scene.textures[id.index()];
            budget.take(known.rgba.len(), 4).map_err(|e| e.found)?;
            return Ok(Texture {
                wrap,
                ..known.clone()
            });
        }
        let picture = match image.whole("bufferView").map_err(short)? {
            Some(view) => {
                picture::decode(buffers.view_bytes(self.json, view).map_err(short)?, budget)?
            }
            None if image.text("uri").map_err(short)?.is_some() => {
                let bytes = images.get(index, budget)?.to_vec();
                picture::decode(&bytes, budget)?
            }
            None => return Err("neither uri nor bufferView".into()),
        };
        let picture::Picture {
            width,
            height,
            rgba,
        } = picture;
        Ok(Texture {
            name,
            width,
            height,
            rgba,
            wrap,
        })
    }
}
