//! Edges and vertices that can cast shadows, by place: surfaces that meet there share no indices.

use crate::contact::{Place, place};
use luxel_core::{DVec3, Scene};
use rayon::prelude::*;
use std::collections::HashMap;

/// An edge and the corners opposite to it in the triangles around it.
#[derive(Clone, Debug)]
pub(super) struct Edge {
    pub ends: [DVec3; 2],
    pub opposite: Vec<DVec3>,
}

impl Edge {
    pub fn length(&self) -> f64 {
        (self.ends[1] - self.ends[0]).length()
    }
}

/// A vertex and its neighbours.
#[derive(Clone, Debug)]
pub(super) struct Vertex {
    pub at: DVec3,
    pub around: Vec<DVec3>,
}

/// Edges of `blocks` triangles from `least_m` on that are no seams of a flat face, the longest
/// first and at most `most`; the vertices at their ends; how many edges were too many.
pub(super) fn edges(
    scene: &Scene,
    blocks: &[bool],
    least_m: f64,
    most: usize,
) -> (Vec<Edge>, Vec<Vertex>, usize) {
    let mut sides: Vec<((Place, Place), u32)> = (0..scene.triangles.len())
        .into_par_iter()
        .filter(|&t| blocks[t])
        .flat_map_iter(|t| {
            let c = scene.corners(t);
            (0..3).filter_map(move |k| {
                let (a, b) = (c[k], c[(k + 1) % 3]);
                let long = a.as_dvec3().distance(b.as_dvec3()) >= least_m;
                let (a, b) = (place(a), place(b));
                long.then_some(((a.min(b), a.max(b)), (3 * t + k) as u32))
            })
        })
        .collect();
    sides.par_sort_unstable();
    let mut all: Vec<Edge> = sides
        .chunk_by(|a, b| a.0 == b.0)
        .filter_map(|run| {
            let corners = |side: u32| {
                let c = scene.corners(side as usize / 3).map(|p| p.as_dvec3());
                let k = side as usize % 3;
                [c[k], c[(k + 1) % 3], c[(k + 2) % 3]]
            };
            let [a, b, _] = corners(run[0].1);
            let edge = Edge {
                ends: if run[0].0.0 == place(a.as_vec3()) {
                    [a, b]
                } else {
                    [b, a]
                },
                opposite: run.iter().map(|r| corners(r.1)[2]).collect(),
            };
            (!is_seam(&edge)).then_some(edge)
        })
        .collect();
    // Stable, and sides were sorted by place: the same order whatever the threads.
    all.sort_by(|a, b| b.length().total_cmp(&a.length()));
    let left_out = all.len().saturating_sub(most);
    all.truncate(most);

    let mut index: HashMap<Place, usize> = HashMap::new();
    let mut vertices: Vec<Vertex> = Vec::new();
    for p in all.iter().flat_map(|e| e.ends) {
        index.entry(place(p.as_vec3())).or_insert_with(|| {
            vertices.push(Vertex {
                at: p,
                around: Vec::new(),
            });
            vertices.len() - 1
        });
    }
    for t in (0..scene.triangles.len()).filter(|&t| blocks[t]) {
        let c = scene.corners(t);
        for k in 0..3 {
            if let Some(&i) = index.get(&place(c[k])) {
                let others = [c[(k + 1) % 3], c[(k + 2) % 3]];
                vertices[i].around.extend(others.map(|p| p.as_dvec3()));
            }
        }
    }
    (all, vertices, left_out)
}

/// Whether two triangles go on flat across an edge: never a silhouette.
fn is_seam(edge: &Edge) -> bool {
    let [p, q] = edge.opposite[..] else {
        return false;
    };
    let along = (edge.ends[1] - edge.ends[0]).normalize_or_zero();
    let across = |p: DVec3| {
        let r = p - edge.ends[0];
        (r - along * r.dot(along)).normalize_or_zero()
    };
    across(p).dot(across(q)) < -1.0 + 1e-9
}
