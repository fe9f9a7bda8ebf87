//! Wavefront OBJ with MTL into a scene [OBJ95].
//!
//! `Kd` x `map_Kd` is the diffuse reflectance on both sides; `Ke` x `map_Ke` is a luminance in
//! cd/m², in front only: the format is silent on sides. Indices below zero count back from the
//! newest vertex *at that line*. Polygons are cut by ears. A surface is what shares object,
//! group and material.
//!
//! A broken line of geometry is an error with its number; a material that is missing or broken
//! is a warning, and 0.5 is taken.

mod mtl;
pub(crate) mod polygon;
pub(crate) mod text;

use crate::assemble::{Assembly, SurfaceOrigin};
use crate::budget::Budget;
use crate::document::{Document, Resolver, Source};
use crate::error::{Error, clean};
use crate::options::ReadOptions;
use luxel_core::{DVec3, FinishId, Vec2, Vec3};
use mtl::Library;
use std::collections::HashMap;
use text::Lines;

/// A surface that is being filled.
struct Part {
    place: usize,
    material: usize,
    triangles: Vec<[u32; 3]>,
    uvs: Vec<[Vec2; 3]>,
}

struct Reading<'r, 'o> {
    assembly: &'r mut Assembly<'o>,
    budget: &'r mut Budget,
    library: Library<'r>,
    positions: Vec<Vec3>,
    coordinates: Vec<Vec2>,
    /// Object and group names met, and their numbers.
    places: Vec<(String, String)>,
    place_of: HashMap<(String, String), usize>,
    parts: Vec<Part>,
    part_of: HashMap<(usize, usize), usize>,
    object: String,
    group: String,
    material: usize,
    /// The part for new faces; found when the next one comes.
    part: Option<usize>,
    scale: f32,
    bent: usize,
    corners: Vec<(u32, Option<u32>)>,
}

/// Reads an OBJ file.
pub(crate) fn read(
    file: &str,
    bytes: &[u8],
    resolver: &Resolver<'_>,
    options: &ReadOptions,
    budget: &mut Budget,
) -> Result<Document, Error> {
    let mut assembly = Assembly::new(file, options);
    budget.take(bytes.len(), 2)?;
    let text = text::decoded(bytes);
    let mut reading = Reading {
        assembly: &mut assembly,
        budget,
        library: Library::new(resolver),
        positions: Vec::new(),
        coordinates: Vec::new(),
        places: Vec::new(),
        place_of: HashMap::new(),
        parts: Vec::new(),
        part_of: HashMap::new(),
        object: String::new(),
        group: String::new(),
        material: 0,
        part: None,
        scale: options.scale,
        bent: 0,
        corners: Vec::new(),
    };
    for (number, line) in Lines::new(&text) {
        reading
            .statement(&line, number)
            .map_err(|e| e.at_line(number))?;
    }
    reading.into_surfaces()?;
    assembly.finish(Source::Obj)
}

impl Reading<'_, '_> {
    fn statement(&mut self, line: &str, number: usize) -> Result<(), Error> {
        let line = text::without_comment(line);
        let Some(word) = line.split_whitespace().next() else {
            return Ok(());
        };
        let rest = line.trim_start()[word.len()..].trim();
        match word {
            "v" => {
                let [x, y, z] = numbers(rest, "3 numbers")?;
                self.budget.take(1, 12)?;
                self.positions.push(Vec3::new(x, y, z) * self.scale);
            }
            "vt" => {
                let mut words = rest.split_whitespace();
                let u = number_of(words.next(), "1 to 3 numbers")?;
                let v = words
                    .next()
                    .map_or(Ok(0.0), |w| number_of(Some(w), "1 to 3 numbers"))?;
                self.budget.take(1, 8)?;
                // OBJ counts v from below, our textures from above.
                let uv = Vec2::new(u, 1.0 - v);
                self.coordinates
                    .push(if uv.is_finite() { uv } else { Vec2::ZERO });
            }
            "f" | "fo" => self.face(rest)?,
            "o" => {
                self.object = clean(rest);
                self.group.clear();
                self.part = None;
            }
            "g" => {
                self.group = clean(rest);
                self.part = None;
            }
            "usemtl" => {
                self.material = self.library.named(rest, number, self.assembly);
                self.part = None;
            }
            "mtllib" => self.library.load(rest, self.assembly, self.budget)?,
            "p" | "l" => {
                self.assembly
                    .warn("", "points and lines have no area and are left out", 1);
            }
            "curv" | "curv2" | "surf" => {
                self.assembly
                    .warn("", "free-form curves and surfaces are left out", 1);
            }
            "vn" | "vp" | "s" | "mg" | "lod" | "bevel" | "c_interp" | "d_interp" | "usemap"
            | "maplib" | "shadow_obj" | "trace_obj" | "cstype" | "deg" | "bmat" | "step"
            | "parm" | "trim" | "hole" | "scrv" | "sp" | "end" | "con" | "ctech" | "stech" => {}
            _ => self
                .assembly
                .warn("", "statements that OBJ does not have were ignored", 1),
        }
        Ok(())
    }

    fn face(&mut self, rest: &str) -> Result<(), Error> {
        let mut corners = std::mem::take(&mut self.corners);
        corners.clear();
        for word in rest.split_whitespace() {
            let mut parts = word.split('/');
            let position = index(
                parts.next().unwrap_or(""),
                self.positions.len(),
                word,
                "vertices",
            )?;
            let coordinate = match parts.next() {
                None | Some("") => None,
                Some(t) => Some(index(
                    t,
                    self.coordinates.len(),
                    word,
                    "texture coordinates",
                )?),
            };
            corners.push((position, coordinate));
        }
        if corners.len() < 3 {
            self.assembly
                .warn("", "faces of less than three corners were dropped", 1);
            self.corners = corners;
            return Ok(());
        }
        let part = self.current_part();
        let ring: Vec<DVec3> = corners
            .iter()
            .map(|c| self.positions[c.0 as usize].as_dvec3())
            .collect();
        if ring.len() > polygon::MOST_CORNERS {
            let what = format!(
                "faces of more than {} corners were cut as fans",
                polygon::MOST_CORNERS
            );
            self.assembly.warn("", what, 1);
        }
        if !polygon::is_flat(&ring) {
            self.bent += 1;
        }
        self.budget.take(ring.len(), 12 + 24)?;
        let transform = self.library.coordinates(self.material);
        let part = &mut self.parts[part];
        for ear in polygon::ears(&ring) {
            part.triangles.push(ear.map(|k| corners[k].0));
            if let Some(transform) = transform {
                part.uvs.push(ear.map(|k| {
                    let uv = corners[k]
                        .1
                        .map_or(Vec2::ZERO, |t| self.coordinates[t as usize]);
                    transform.apply(uv)
                }));
            }
        }
        self.corners = corners;
        Ok(())
    }

    fn current_part(&mut self) -> usize {
        if let Some(part) = self.part {
            return part;
        }
        let names = (self.object.clone(), self.group.clone());
        let place = *self.place_of.entry(names).or_insert_with_key(|names| {
            self.places.push(names.clone());
            self.places.len() - 1
        });
        let part = *self
            .part_of
            .entry((place, self.material))
            .or_insert_with(|| {
                let (triangles, uvs) = (Vec::new(), Vec::new());
                self.parts.push(Part {
                    place,
                    material: self.material,
                    triangles,
                    uvs,
                });
                self.parts.len() - 1
            });
        self.part = Some(part);
        part
    }

    /// Moves what was read into the scene.
    fn into_surfaces(self) -> Result<(), Error> {
        let Reading {
            assembly,
            budget,
            mut library,
            positions,
            places,
            parts,
            bent,
            ..
        } = self;
        assembly.warn(
            "",
            "polygons that are not flat were split into triangles",
            bent,
        );
        assembly.add_positions(positions.into_iter(), budget)?;
        let mut materials = vec![0usize; places.len()];
        for part in &parts {
            materials[part.place] += 1;
        }
        let mut finishes: HashMap<usize, FinishId> = HashMap::new();
        for (k, part) in parts.into_iter().enumerate() {
            let finish = *finishes.entry(part.material).or_insert_with(|| {
                assembly.add_finish(library.finish(part.material), part.material)
            });
            let material = assembly.scene.finishes[finish.index()].name.clone();
            let (object, group) = &places[part.place];
            let name = place_name(object, group);
            let name = match (name.as_str(), materials[part.place]) {
                ("", _) => material,
                (_, 1) => name,
                _ => format!("{name}, {material}"),
            };
            let origin = SurfaceOrigin {
                name,
                node: u32::MAX,
                mesh: u32::MAX,
                primitive: k as u32,
            };
            let triangles = part
                .triangles
                .iter()
                .enumerate()
                .map(|(s, t)| (*t, s as u32));
            assembly.add_surface(origin, finish, triangles, &part.uvs, budget)?;
        }
        library.into_textures(assembly);
        Ok(())
    }
}

/// The name of what an object and a group hold together.
pub(crate) fn place_name(object: &str, group: &str) -> String {
    match (object, group) {
        (one, "") | ("", one) => one.to_owned(),
        (one, other) if one == other => one.to_owned(),
        (one, other) => format!("{one}, {other}"),
    }
}

fn number_of(word: Option<&str>, expected: &str) -> Result<f32, Error> {
    let found =
        |w: Option<&str>| w.map_or("the end of the line".into(), |w| format!("'{}'", clean(w)));
    word.and_then(|w| w.parse().ok())
        .ok_or_else(|| Error::new(expected, found(word)))
}

/// The first three numbers of a line; more may follow.
fn numbers(rest: &str, expected: &str) -> Result<[f32; 3], Error> {
    let mut words = rest.split_whitespace();
    let mut out = [0.0; 3];
    for slot in &mut out {
        *slot = number_of(words.next(), expected)?;
    }
    Ok(out)
}

/// The index that a word of a face means, from 0.
pub(crate) fn index(text: &str, count: usize, word: &str, things: &str) -> Result<u32, Error> {
    let wrong = || {
        let expected = match count {
            0 => format!("{things} before this line"),
            _ => format!("an index of {things} so far, 1 to {count} or -{count} to -1"),
        };
        Error::new(expected, format!("'{}'", clean(word)))
    };
    let number: i64 = text.parse().map_err(|_| wrong())?;
    let place = if number > 0 {
        number - 1
    } else {
        count as i64 + number
    };
    if number == 0 || place < 0 || place >= count as i64 {
        return Err(wrong());
    }
    Ok(place as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<Document, Error> {
        let resolver = |name: &str, _: u64| Err(format!("no file {name}"));
        let mut budget = Budget::new(1 << 26);
        read(
            "t.obj",
            text.as_bytes(),
            &resolver,
            &ReadOptions::default(),
            &mut budget,
        )
        .map_err(|e| e.in_file("t.obj"))
    }

    #[test]
    fn negative_indices_count_from_the_line_that_they_stand_on() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 1\nv 1 0 1\nv 0 1 1\nf -3 -2 -1\n";
        let scene = read_text(text).unwrap().scene;
        assert_eq!(scene.corners(0), [Vec3::ZERO, Vec3::X, Vec3::Y]);
        assert_eq!(
            scene.corners(1),
            [Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::new(0.0, 1.0, 1.0)]
        );
    }

    #[test]
    fn errors_name_the_line() {
        for (text, message) in [
            (
                "v 0 0\n",
                "t.obj:1: expected 3 numbers, found the end of the line",
            ),
            ("\n\\\nv 0 0 x\n", "t.obj:2: expected 3 numbers, found 'x'"),
            (
                "v 0 0 0\nf 1 2 3\n",
                "t.obj:2: expected an index of vertices so far, 1 to 1 or -1 to -1, found '2'",
            ),
            ("# nothing\n", "t.obj: expected triangles, found none"),
        ] {
            assert_eq!(read_text(text).unwrap_err().to_string(), message);
        }
    }

    #[test]
    fn missing_material_is_half_grey_on_both_sides_and_said() {
        let text = "mtllib no.mtl\nusemtl wood\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
        let document = read_text(text).unwrap();
        assert_eq!(document.scene.finishes[0].reflectance.g, 0.5);
        assert!(document.scene.finishes[0].back_reflects);
        let said: Vec<String> = document.warnings.iter().map(|w| w.to_string()).collect();
        assert!(said.iter().any(|w| w.contains("no.mtl")), "{said:?}");
        assert!(said.iter().any(|w| w.contains("'wood'")), "{said:?}");
    }
}
