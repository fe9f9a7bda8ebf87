//! A flat ring of corners that may touch or retrace itself, into triangles.
//!
//! A constrained Delaunay triangulation of the ring's edges (crate spade, whose predicates are
//! exact); a triangle belongs to the facet where the ring goes round it (winding number not 0
//! [Sunday21]). So a spike encloses nothing, rings that touch at a corner enclose both, a hole on a
//! bridge stays open, and what is gone round twice counts once. Edges that cross are not taken:
//! where they do is rounded, and the triangulation may then go on for ever.

use crate::obj_reader::polygon::area_vector;
use luxel_core::DVec3;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Areas that are rounding, for a ring of size 1.
const ROUNDING: f64 = 1e-12;

/// What a ring encloses.
#[derive(Clone, Debug, Default)]
pub(super) struct Enclosed {
    /// Counter-clockwise about the normal, as positions in the ring.
    pub triangles: Vec<[usize; 3]>,
    /// The ring goes round some part backwards or more than once.
    pub crossed: bool,
}

/// What `ring` encloses in the plane with the unit `normal`; `size`: of the ring, above 0.
///
/// `None` where edges cross, or the triangles miss the ring's area.
pub(super) fn enclosed(ring: &[DVec3], normal: DVec3, size: f64) -> Option<Enclosed> {
    let (along, across) = normal.any_orthonormal_pair();
    // `any_orthonormal_pair` is right-handed with the normal: along x across = normal.
    let flat: Vec<Point2<f64>> = ring
        .iter()
        .map(|q| (*q - ring[0]) / size)
        .map(|d| spade::mitigate_underflow(Point2::new(d.dot(along), d.dot(across))))
        .collect();
    // Spade checks its own structure in places; a file must not end the program there.
    let worked_out = catch_unwind(AssertUnwindSafe(|| {
        let mut cdt = ConstrainedDelaunayTriangulation::<Point2<f64>>::new();
        let mut vertices = Vec::with_capacity(flat.len());
        for &q in &flat {
            vertices.push(cdt.insert(q).ok()?);
        }
        let mut first_here = vec![usize::MAX; cdt.num_vertices()];
        for (k, v) in vertices.iter().enumerate().rev() {
            first_here[v.index()] = k;
        }
        for k in 0..vertices.len() {
            let (a, b) = (vertices[k], vertices[(k + 1) % vertices.len()]);
            if a == b {
                continue;
            }
            if !cdt.can_add_constraint(a, b) {
                return None;
            }
            cdt.add_constraint(a, b);
        }
        let mut crossed = false;
        let mut gone_round = 0.0;
        let mut triangles = Vec::new();
        for face in cdt.inner_faces() {
            let turns = winding(&flat, face.center());
            let area = face.area();
            gone_round += f64::from(turns) * area;
            crossed |= !(0..=1).contains(&turns) && area > ROUNDING;
            if turns != 0 {
                triangles.push(face.vertices().map(|v| first_here[v.index()]));
            }
        }
        let wanted = area_vector(ring).dot(normal) / (size * size);
        ((gone_round - wanted).abs() < ROUNDING * ring.len() as f64)
            .then_some(Enclosed { triangles, crossed })
    }));
    worked_out.ok().flatten()
}

/// How often a ring goes round a point, counter-clockwise counted positive [Sunday21].
fn winding(ring: &[Point2<f64>], at: Point2<f64>) -> i32 {
    let mut turns = 0;
    for (k, a) in ring.iter().enumerate() {
        let b = ring[(k + 1) % ring.len()];
        let left = (b.x - a.x) * (at.y - a.y) - (at.x - a.x) * (b.y - a.y);
        if a.y <= at.y && b.y > at.y && left > 0.0 {
            turns += 1;
        } else if a.y > at.y && b.y <= at.y && left < 0.0 {
            turns -= 1;
        }
    }
    turns
}
