//! glTF 2.0 [GLTF20]: a row is a triangle, an object a primitive of a placed node.
//!
//! Triangles come in the order of nodes, primitives and indices, all of them: those without area
//! or on top of another too. Transparent materials are facets like others.

use super::numbers::Numbers;
use super::{FacetDocument, Input, Rows};
use crate::budget::Budget;
use crate::document::Resolver;
use crate::error::{Error, Within};
use crate::gltf_reader;
use crate::options::ReadOptions;

pub(super) fn read(
    input: Input<'_>,
    bytes: &[u8],
    resolver: &Resolver<'_>,
    budget: &mut Budget,
) -> Result<FacetDocument, Error> {
    // In units of the file: the scale is applied to doubles later.
    let options = ReadOptions::default();
    let (scene, warnings) =
        gltf_reader::read_triangles(input.file, bytes, resolver, &options, budget)?;
    let mut rows = Rows::new();
    let mut numbers = Numbers::new(input.options.scale, true);
    for surface in &scene.surfaces {
        let finish = &scene.finishes[surface.finish.index()];
        let object = rows.objects.another(surface.name.clone(), budget)?;
        let material = rows.materials.id(&finish.name, budget)?;
        for t in surface.triangles.start..surface.triangles.end {
            let corners = scene.corners(t as usize).map(|p| p.as_dvec3());
            for value in corners.iter().flat_map(|p| p.to_array()) {
                let place = || {
                    let number = scene.source_triangle[t as usize];
                    format!("'{}', triangle {number}", surface.name)
                };
                numbers.stored(value).within(place)?;
            }
            rows.push(corners.into_iter(), object, material, None, budget)?;
        }
    }
    rows.into_document(input, &numbers, warnings, budget)
}
