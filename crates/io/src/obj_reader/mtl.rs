//! Material libraries of OBJ files.

use super::text::{Lines, decoded, without_comment};
use crate::assemble::Assembly;
use crate::budget::Budget;
use crate::document::Resolver;
use crate::error::{Error, clean};
use crate::options::MOST_LIGHT;
use crate::picture;
use luxel_core::texture::Wrap;
use luxel_core::{Alpha, Emission, Finish, GroupId, Rgb, Texture, TextureId, Vec2};
use std::collections::HashMap;

/// Scale and offset of texture coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Coordinates {
    scale: Vec2,
    offset: Vec2,
}

impl Coordinates {
    /// Our coordinates count v from above, the options from below.
    pub(super) fn apply(&self, uv: Vec2) -> Vec2 {
        let below = Vec2::new(uv.x, 1.0 - uv.y) * self.scale + self.offset;
        let out = Vec2::new(below.x, 1.0 - below.y);
        if out.is_finite() { out } else { Vec2::ZERO }
    }
}

/// A picture as a material names it.
#[derive(Clone, Copy, Debug)]
struct Map {
    texture: TextureId,
    coordinates: Coordinates,
}

struct Material {
    name: String,
    diffuse: Option<Rgb>,
    luminance: Rgb,
    coverage: f32,
    map: Option<Map>,
    glow: Option<Map>,
    glass: bool,
}

impl Material {
    fn new(name: &str) -> Self {
        Material {
            name: name.to_owned(),
            diffuse: None,
            luminance: Rgb::BLACK,
            coverage: 1.0,
            map: None,
            glow: None,
            glass: false,
        }
    }
}

/// All materials met so far. The first is the default: half grey.
pub(super) struct Library<'r> {
    resolver: &'r Resolver<'r>,
    materials: Vec<Material>,
    index: HashMap<String, usize>,
    textures: Vec<Texture>,
    /// Whether a texture has holes.
    see_through: Vec<bool>,
    pictures: HashMap<(String, bool), Option<TextureId>>,
    files: Vec<String>,
}

impl<'r> Library<'r> {
    pub(super) fn new(resolver: &'r Resolver<'r>) -> Self {
        Library {
            resolver,
            materials: vec![Material::new("(default)")],
            index: HashMap::new(),
            textures: Vec::new(),
            see_through: Vec::new(),
            pictures: HashMap::new(),
            files: Vec::new(),
        }
    }

    /// The material of a name; one that is not defined is half grey, and said.
    pub(super) fn named(&mut self, name: &str, line: usize, assembly: &mut Assembly<'_>) -> usize {
        if let Some(&known) = self.index.get(name) {
            return known;
        }
        let what = format!(
            "material '{}' is not defined: reflectance 0.5 is taken",
            clean(name)
        );
        assembly.warn(&format!("line {line}"), what, 1);
        self.materials.push(Material::new(&clean(name)));
        let new = self.materials.len() - 1;
        self.index.insert(name.to_owned(), new);
        new
    }

    /// Reads the libraries of an `mtllib` line: one name with blanks, or several without.
    pub(super) fn load(
        &mut self,
        names: &str,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Result<(), Error> {
        let mut failed = match self.load_one(names, assembly, budget)? {
            Ok(()) => return Ok(()),
            Err(why) => vec![(names, why)],
        };
        if names.split_whitespace().count() > 1 {
            failed.clear();
            for name in names.split_whitespace() {
                if let Err(why) = self.load_one(name, assembly, budget)? {
                    failed.push((name, why));
                }
            }
        }
        for (name, why) in failed {
            assembly.warn(
                &clean(name),
                format!("material library cannot be read: {}", clean(&why)),
                1,
            );
        }
        Ok(())
    }

    fn load_one(
        &mut self,
        name: &str,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Result<Result<(), String>, Error> {
        if self.files.iter().any(|f| f == name) {
            return Ok(Ok(()));
        }
        let bytes = match (self.resolver)(name, budget.left()) {
            Ok(bytes) => bytes,
            Err(why) => return Ok(Err(why)),
        };
        budget.take(bytes.len(), 4)?;
        self.files.push(name.to_owned());
        let text = decoded(&bytes);
        // Materials take more memory than their text: at least `newmtl` and a line end each.
        let mut current = None;
        for (number, line) in Lines::new(&text) {
            let line = without_comment(&line);
            let Some(word) = line.split_whitespace().next() else {
                continue;
            };
            let rest = line.trim_start()[word.len()..].trim();
            if word == "newmtl" {
                budget.take(1, 256)?;
                let k = self.materials.len();
                self.materials.push(Material::new(&clean(rest)));
                self.index.insert(rest.to_owned(), k);
                current = Some(k);
            } else if let Some(k) = current
                && let Err(e) = self.statement(k, word, rest, name, assembly, budget)
            {
                let what = format!("ignored: expected {}, found {}", e.expected, e.found);
                assembly.warn(&format!("{}:{number}", clean(name)), what, 1);
            }
        }
        Ok(Ok(()))
    }

    fn statement(
        &mut self,
        k: usize,
        word: &str,
        rest: &str,
        library: &str,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Result<(), Error> {
        match word {
            "Kd" => {
                let diffuse = colour(rest)?;
                let bounded = diffuse.map(|v| v.max(0.0));
                if bounded != diffuse {
                    let place = format!("material '{}'", self.materials[k].name);
                    assembly.warn(&place, "negative reflectance was made 0", 1);
                }
                self.materials[k].diffuse = Some(bounded);
            }
            "Ke" => self.materials[k].luminance = colour(rest)?.map(|v| v.clamp(0.0, MOST_LIGHT)),
            "d" => self.materials[k].coverage = last_number(rest)?.clamp(0.0, 1.0),
            "Tr" => self.materials[k].coverage = (1.0 - last_number(rest)?).clamp(0.0, 1.0),
            "illum" => {
                // 4, 6, 7, 9: glass, as [OBJ95] lists them.
                let glass = matches!(last_number(rest)? as i32, 4 | 6 | 7 | 9);
                if glass && !self.materials[k].glass {
                    let place = format!("material '{}'", self.materials[k].name);
                    assembly.warn(&place, "glass: light passes as if it were not there", 1);
                }
                self.materials[k].glass = glass;
            }
            "map_Kd" => self.materials[k].map = self.map(rest, library, assembly, budget),
            "map_Ke" => self.materials[k].glow = self.map(rest, library, assembly, budget),
            _ => {}
        }
        Ok(())
    }

    /// A texture statement: options, then a file name that may have blanks.
    fn map(
        &mut self,
        rest: &str,
        library: &str,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Option<Map> {
        let (mut scale, mut offset, mut clamp) = (Vec2::ONE, Vec2::ZERO, false);
        let mut words = rest;
        let take = |words: &mut &str| -> String {
            let word = words.split_whitespace().next().unwrap_or("").to_owned();
            *words = words[word.len()..].trim_start();
            word
        };
        while words.starts_with('-') {
            let option = take(&mut words);
            match option.as_str() {
                "-o" | "-s" | "-t" => {
                    let mut values = Vec::new();
                    while values.len() < 3 {
                        let next = words.split_whitespace().next().unwrap_or("");
                        // A file may be called 1; the last word is never a number of an option.
                        let Ok(v) = next.parse::<f32>() else { break };
                        if words.len() == next.len() {
                            break;
                        }
                        take(&mut words);
                        values.push(v);
                    }
                    let target = match option.as_str() {
                        "-o" => &mut offset,
                        "-s" => &mut scale,
                        _ => continue,
                    };
                    if let Some(&u) = values.first() {
                        target.x = u;
                    }
                    if let Some(&v) = values.get(1) {
                        target.y = v;
                    }
                }
                "-clamp" => clamp = take(&mut words) == "on",
                "-mm" => {
                    take(&mut words);
                    take(&mut words);
                }
                _ => {
                    take(&mut words);
                }
            }
        }
        let folder = library.replace('\\', "/");
        let folder = folder
            .rsplit_once('/')
            .map_or(String::new(), |(f, _)| format!("{f}/"));
        let name = format!("{folder}{}", words.replace('\\', "/"));
        let texture = self.picture(&name, clamp, assembly, budget)?;
        Some(Map {
            texture,
            coordinates: Coordinates { scale, offset },
        })
    }

    fn picture(
        &mut self,
        name: &str,
        clamp: bool,
        assembly: &mut Assembly<'_>,
        budget: &mut Budget,
    ) -> Option<TextureId> {
        let key = (name.to_owned(), clamp);
        if let Some(known) = self.pictures.get(&key) {
            return *known;
        }
        let made = (self.resolver)(name, budget.left()).and_then(|b| picture::decode(&b, budget));
        let id = match made {
            Ok(picture::Picture {
                width,
                height,
                rgba,
            }) => {
                self.see_through.push(rgba.iter().any(|t| t[3] < 255));
                let wrap = [if clamp { Wrap::Clamp } else { Wrap::Repeat }; 2];
                self.textures.push(Texture {
                    name: clean(name),
                    width,
                    height,
                    rgba,
                    wrap,
                });
                Some(TextureId::from(self.textures.len() - 1))
            }
            Err(why) => {
                let what = format!(
                    "picture cannot be read, only the factor counts: {}",
                    clean(&why)
                );
                assembly.warn(&clean(name), what, 1);
                None
            }
        };
        self.pictures.insert(key, id);
        id
    }

    /// How a material changes texture coordinates; `None` when it has no texture.
    pub(super) fn coordinates(&self, material: usize) -> Option<Coordinates> {
        let m = &self.materials[material];
        m.map.or(m.glow).map(|map| map.coordinates)
    }

    /// The finish of a material.
    pub(super) fn finish(&mut self, material: usize) -> Finish {
        let m = &self.materials[material];
        let holes = m
            .map
            .is_some_and(|map| self.see_through[map.texture.index()]);
        let default = if m.map.is_some() { 1.0 } else { 0.5 };
        let emission = (m.luminance.max_band() > 0.0).then(|| Emission {
            luminance: m.luminance,
            texture: m.glow.map(|map| map.texture),
            group: GroupId::NONE,
        });
        Finish {
            name: if m.name.is_empty() {
                format!("material {material}")
            } else {
                m.name.clone()
            },
            reflectance: m.diffuse.unwrap_or(Rgb::splat(default)),
            texture: m.map.map(|map| map.texture),
            emission,
            back_reflects: true,
            back_emits: false,
            alpha: if holes || m.coverage < 1.0 {
                Alpha::Blend
            } else {
                Alpha::Opaque
            },
            coverage: m.coverage,
            transparent: m.glass,
        }
    }

    /// Hands the textures over to the scene, under the same numbers.
    pub(super) fn into_textures(self, assembly: &mut Assembly<'_>) {
        debug_assert!(assembly.scene.textures.is_empty());
        assembly.scene.textures = self.textures;
    }
}

/// One finite number, the last word of a line (`d -halo 0.5`).
fn last_number(rest: &str) -> Result<f32, Error> {
    let word = rest.split_whitespace().last();
    word.and_then(|w| w.parse().ok())
        .filter(|v: &f32| v.is_finite())
        .ok_or_else(|| Error::new("a number", format!("'{}'", clean(rest))))
}

/// Three bands, or one for all three.
fn colour(rest: &str) -> Result<Rgb, Error> {
    let wrong = || Error::new("1 or 3 numbers", format!("'{}'", clean(rest)));
    let words: Result<Vec<f32>, _> = rest.split_whitespace().take(3).map(str::parse).collect();
    match words.map_err(|_| wrong())?.as_slice() {
        [v] if v.is_finite() => Ok(Rgb::splat(*v)),
        [r, g, b] if r.is_finite() && g.is_finite() && b.is_finite() => Ok(Rgb::new(*r, *g, *b)),
        _ => Err(wrong()),
    }
}
