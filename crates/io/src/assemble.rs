//! Putting a scene together out of surfaces, the same way for every format.

use crate::budget::Budget;
use crate::document::{Document, Source};
use crate::error::Error;
use crate::options::{Back, ReadOptions};
use crate::repair;
use luxel_core::{
    Finish, FinishId, Group, GroupId, Luminaire, Scene, Surface, SurfaceId, Vec2, Vec3, View,
    Warnings,
};
use std::collections::HashMap;
use std::path::Path;

/// Bytes that a triangle takes in the scene and while it is repaired.
pub(crate) const TRIANGLE_BYTES: usize = 12 + 24 + 4 + 4 + 96;
/// Bytes that a vertex takes in the scene and while it is welded.
pub(crate) const VERTEX_BYTES: usize = 12 + 64;

/// A scene that is being filled.
pub(crate) struct Assembly<'o> {
    pub scene: Scene,
    pub warnings: Warnings,
    /// Material of the file behind each finish: finishes of one material share a group.
    material_of: Vec<usize>,
    options: &'o ReadOptions,
    pub file: String,
    views: Names,
    /// How often each kind of warning was placed.
    placed: HashMap<String, usize>,
}

/// Places that are named for one kind of warning; the rest is counted for the file.
const MOST_PLACES: usize = 8;
/// Kinds of warnings that are told apart.
const MOST_KINDS: usize = 200;

/// What a surface is called and where it comes from.
pub(crate) struct SurfaceOrigin {
    pub name: String,
    pub node: u32,
    pub mesh: u32,
    pub primitive: u32,
}

impl<'o> Assembly<'o> {
    pub(crate) fn new(file: &str, options: &'o ReadOptions) -> Self {
        let stem = Path::new(file)
            .file_stem()
            .map(|s| s.to_string_lossy().into_owned());
        let scene = Scene {
            name: stem.unwrap_or_else(|| "scene".into()),
            up: options.up.unwrap_or(crate::options::Up::Y).vector(),
            ..Scene::default()
        };
        Assembly {
            scene,
            warnings: Warnings::default(),
            material_of: Vec::new(),
            options,
            file: file.to_owned(),
            views: Names::default(),
            placed: HashMap::new(),
        }
    }

    pub(crate) fn options(&self) -> &'o ReadOptions {
        self.options
    }

    /// Adds a warning about a part of the file.
    ///
    /// A file may be odd in a million places: a few are named, the rest is counted.
    pub(crate) fn warn(&mut self, part: &str, what: impl Into<String>, count: usize) {
        if count == 0 {
            return;
        }
        let mut what = what.into();
        if self.placed.len() >= MOST_KINDS && !self.placed.contains_key(&what) {
            what = "more that is odd".into();
        }
        let places = self.placed.entry(what.clone()).or_insert(0);
        *places += 1;
        let place = if part.is_empty() || *places > MOST_PLACES {
            self.file.clone()
        } else {
            format!("{}: {part}", self.file)
        };
        self.warnings.add(place, what, count);
    }

    /// Adds a finish of a material of the file. Its emission gets a group in the end.
    pub(crate) fn add_finish(&mut self, mut finish: Finish, material: usize) -> FinishId {
        match self.options.back {
            Some(Back::Same) => finish.back_reflects = true,
            Some(Back::Black) => finish.back_reflects = false,
            None => {}
        }
        if finish
            .emission
            .as_ref()
            .is_some_and(|e| e.luminance.max_band() <= 0.0)
        {
            finish.emission = None;
        }
        self.scene.finishes.push(finish);
        self.material_of.push(material);
        FinishId::from(self.scene.finishes.len() - 1)
    }

    /// Adds vertices, in metres, and returns the index of the first.
    pub(crate) fn add_positions(
        &mut self,
        positions: impl ExactSizeIterator<Item = Vec3>,
        budget: &mut Budget,
    ) -> Result<u32, Error> {
        budget.take(positions.len(), VERTEX_BYTES)?;
        let first = self.scene.positions.len();
        if first + positions.len() >= u32::MAX as usize {
            return Err(Error::new("less than 2^32 vertices", "more"));
        }
        self.scene.positions.extend(positions);
        Ok(first as u32)
    }

    /// Adds a surface of triangles over vertices that are there.
    ///
    /// `uvs`: one entry a triangle, or empty. `sources`: index of each within its primitive.
    pub(crate) fn add_surface(
        &mut self,
        origin: SurfaceOrigin,
        finish: FinishId,
        triangles: impl ExactSizeIterator<Item = ([u32; 3], u32)>,
        uvs: &[[Vec2; 3]],
        budget: &mut Budget,
    ) -> Result<(), Error> {
        let scene = &mut self.scene;
        budget.take(triangles.len(), TRIANGLE_BYTES)?;
        let first = scene.triangles.len();
        let end = first + triangles.len();
        if end >= u32::MAX as usize {
            return Err(Error::new("less than 2^32 triangles", "more"));
        }
        let id = SurfaceId::from(scene.surfaces.len());
        for (corners, source) in triangles {
            scene.triangles.push(corners);
            scene.source_triangle.push(source);
        }
        scene.surface_of.resize(end, id);
        if !uvs.is_empty() {
            scene.uvs.resize(first, [Vec2::ZERO; 3]);
            scene.uvs.extend_from_slice(uvs);
        }
        let SurfaceOrigin {
            name,
            node,
            mesh,
            primitive,
        } = origin;
        let triangles = first as u32..end as u32;
        scene.surfaces.push(Surface {
            name,
            finish,
            triangles,
            node,
            mesh,
            primitive,
        });
        Ok(())
    }

    /// Adds a luminaire; its group gets its name.
    pub(crate) fn add_luminaire(&mut self, mut luminaire: Luminaire) {
        luminaire.group = GroupId::NONE;
        self.scene.luminaires.push(luminaire);
    }

    /// Adds a view under a name of its own.
    pub(crate) fn add_view(&mut self, mut view: View) {
        view.name = self.views.unique(&view.name);
        self.scene.views.push(view);
    }

    /// Repairs the scene, makes the groups and hands it over.
    pub(crate) fn finish(mut self, source: Source) -> Result<Document, Error> {
        let triangles_read = self.scene.triangles.len();
        if triangles_read == 0 {
            return Err(Error::new("triangles", "none"));
        }
        if !self.scene.uvs.is_empty() {
            self.scene.uvs.resize(triangles_read, [Vec2::ZERO; 3]);
        }
        let origin = repair::repair(
            &mut self.scene,
            &self.file,
            self.options.max_reflectance,
            &mut self.warnings,
        );
        self.scene.positions.shrink_to_fit();
        if self.scene.triangles.is_empty() {
            let found = format!("{triangles_read} without area, too far away or not finite");
            return Err(Error::new("triangles with an area", found));
        }
        self.make_groups(&origin);
        let Assembly {
            scene, warnings, ..
        } = self;
        Ok(Document {
            scene,
            warnings,
            source,
            triangles_read,
            files: Vec::new(),
        })
    }

    /// One group for each material that shines and for each luminaire. `origin`: the finish that
    /// the reader made behind each finish after repairs.
    fn make_groups(&mut self, origin: &[FinishId]) {
        let scene = &mut self.scene;
        let mut used = vec![false; scene.finishes.len()];
        for surface in &scene.surfaces {
            used[surface.finish.index()] = true;
        }
        let mut taken = Names::default();
        let mut group_of = HashMap::new();
        for (k, finish) in scene.finishes.iter_mut().enumerate() {
            let Some(emission) = finish.emission.as_mut() else {
                continue;
            };
            if !used[k] {
                finish.emission = None;
                continue;
            }
            let material = self.material_of[origin[k].index()];
            emission.group = *group_of.entry(material).or_insert_with(|| {
                scene.groups.push(Group {
                    name: taken.unique(&finish.name),
                });
                GroupId::from(scene.groups.len() - 1)
            });
        }
        for luminaire in &mut scene.luminaires {
            luminaire.group = GroupId::from(scene.groups.len());
            scene.groups.push(Group {
                name: taken.unique(&luminaire.name),
            });
        }
        if scene.groups.is_empty() {
            scene.groups.push(Group {
                name: NO_LIGHT.into(),
            });
        }
    }
}

/// Name of the one group of a scene in which nothing shines.
pub(crate) const NO_LIGHT: &str = "no light";

/// Names that are taken, each by one thing.
#[derive(Default)]
pub(crate) struct Names {
    /// The number that is tried next for a name that was asked for.
    next: HashMap<String, usize>,
}

impl Names {
    /// The names of things that have one of their own already.
    pub(crate) fn of<'a>(names: impl Iterator<Item = &'a String>) -> Self {
        Names {
            next: names.map(|n| (n.clone(), 2)).collect(),
        }
    }

    /// `name`, or `name (2)` and so on when it is taken.
    pub(crate) fn unique(&mut self, name: &str) -> String {
        let Some(&from) = self.next.get(name) else {
            self.next.insert(name.to_owned(), 2);
            return name.to_owned();
        };
        let mut k = from;
        let mut out = format!("{name} ({k})");
        while self.next.contains_key(&out) {
            k += 1;
            out = format!("{name} ({k})");
        }
        self.next.insert(name.to_owned(), k + 1);
        self.next.insert(out.clone(), 2);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_given_once() {
        let mut names = Names::of([String::from("a (2)")].iter());
        let given: Vec<String> = ["a", "a", "a", "b", "a (2)"]
            .map(|n| names.unique(n))
            .into();
        assert_eq!(given, ["a", "a (3)", "a (4)", "b", "a (2) (2)"]);
    }
}
