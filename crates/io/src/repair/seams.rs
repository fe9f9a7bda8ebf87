//! Counting what a scene's edges tell: neighbours turned against each other, T-vertices.
//!
//! Nothing is changed: light does not leak through a T-vertex that lies on its edge, because rays
//! run against the source triangles. The counts tell the maker of a scene where to look.

use luxel_core::{Scene, Vec3, Warnings};
use rayon::prelude::*;

/// Triangles above which T-vertices are not looked for.
const MOST_TRIANGLES: usize = 1_000_000;

/// An edge of a triangle: smaller vertex, larger vertex, and whether it runs upwards.
type Edge = (u32, u32, bool);

/// Adds warnings with the counts.
pub(super) fn count(scene: &Scene, file: &str, tolerance: f64, warnings: &mut Warnings) {
    let mut edges: Vec<Edge> = Vec::with_capacity(scene.triangles.len() * 3);
    for &[a, b, c] in &scene.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            edges.push((from.min(to), from.max(to), from < to));
        }
    }
    edges.par_sort_unstable();
    let mut turned = 0;
    let mut open: Vec<(u32, u32)> = Vec::new();
    for run in edges.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
        match run {
            [one] => open.push((one.0, one.1)),
            [x, y] if x.2 == y.2 => turned += 1,
            _ => {}
        }
    }
    let what =
        "edges between faces of opposite winding: one of the two is probably the wrong way round";
    warnings.add(file, what, turned);
    if scene.triangles.len() <= MOST_TRIANGLES {
        let what = "T-vertices, inside the edge of another face, were left";
        warnings.add(file, what, t_vertices(scene, &open, tolerance));
    }
}

/// Vertices of open edges that lie inside another open edge.
///
/// Only open edges can have one: at a closed edge both neighbours end at the same vertices.
/// Vertices are sorted into cells as wide as the mean open edge; each edge visits the cells
/// along it. Steps are bounded, so the count may be low in scenes of a few huge and very many
/// tiny edges.
fn t_vertices(scene: &Scene, open: &[(u32, u32)], tolerance: f64) -> usize {
    let place = |i: u32| scene.positions[i as usize];
    let mut vertices: Vec<u32> = open.iter().flat_map(|e| [e.0, e.1]).collect();
    vertices.sort_unstable();
    vertices.dedup();
    if vertices.len() < 3 {
        return 0;
    }
    let whole: f64 = open
        .iter()
        .map(|e| place(e.0).distance(place(e.1)) as f64)
        .sum();
    let cell = (whole / open.len() as f64) as f32;
    if !(cell.is_normal() && tolerance > 0.0) {
        return 0;
    }
    let key = |p: Vec3| (p / cell).floor().to_array().map(|v| v as i32);
    let mut sorted: Vec<([i32; 3], u32)> = vertices.iter().map(|&v| (key(place(v)), v)).collect();
    sorted.par_sort_unstable();
    let slack = (8.0 * tolerance) as f32;
    const MOST_STEPS: usize = 4096;
    let mut hits: Vec<u32> = open
        .par_iter()
        .flat_map_iter(|&(a, b)| {
            let (p, q) = (place(a), place(b));
            let along = q - p;
            let length = along.length();
            let steps = ((length / cell).ceil() as usize).clamp(1, MOST_STEPS);
            let mut found: Vec<u32> = Vec::new();
            let mut previous: Option<([i32; 3], [i32; 3])> = None;
            for k in 0..steps {
                let (s, t) = (k as f32 / steps as f32, (k + 1) as f32 / steps as f32);
                let (x, y) = (p + along * s, p + along * t);
                let low = key(x.min(y) - Vec3::splat(slack));
                let high = key(x.max(y) + Vec3::splat(slack));
                if previous == Some((low, high)) {
                    continue;
                }
                previous = Some((low, high));
                for i in low[0]..=high[0] {
                    for j in low[1]..=high[1] {
                        // Cells that differ in z only lie together.
                        let from = sorted.partition_point(|c| c.0 < [i, j, low[2]]);
                        let to = sorted.partition_point(|c| c.0 <= [i, j, high[2]]);
                        for &(_, v) in sorted[from..to].iter().take(MOST_STEPS) {
                            if v == a || v == b {
                                continue;
                            }
                            let w = place(v) - p;
                            let at = w.dot(along) / length;
                            let off = w - along * (at / length);
                            if at > 4.0 * slack
                                && at < length - 4.0 * slack
                                && off.length() <= slack
                            {
                                found.push(v);
                            }
                        }
                    }
                }
            }
            found
        })
        .collect();
    hits.sort_unstable();
    hits.dedup();
    hits.len()
}
