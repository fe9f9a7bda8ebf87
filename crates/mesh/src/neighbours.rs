//! The elements across the edges of an element.
//!
//! A point a little beyond an edge is looked up: within the patch by its coordinates, beyond the
//! patch in the triangle of the same surface that shares the edge by index. So there are no
//! neighbours across a crease of more than 25 degrees, across a contact line, or at a T-vertex.

use crate::flat::{NONE, adjacency};
use luxel_core::{Buckets, ElementId, Front, PatchId, Scene, Shape, Vec3, triangles_of_patches};

/// What is needed to look up neighbours. Stays valid when elements are split.
pub(crate) struct Neighbours {
    next: Vec<[u32; 3]>,
    triangles: Buckets,
}

/// Cosine of the largest angle between patches that count as one smooth surface.
const SMOOTH: f32 = 0.9;

impl Neighbours {
    pub fn of(scene: &Scene, front: &Front) -> Neighbours {
        let wanted: Vec<bool> = front
            .patch_of
            .iter()
            .map(|ids| ids.iter().any(|id| id.is_some()))
            .collect();
        Neighbours {
            next: adjacency(&scene.triangles, &scene.surface_of, &wanted),
            triangles: triangles_of_patches(front),
        }
    }

    /// Source triangles of a patch.
    pub fn triangles_of(&self, patch: PatchId) -> &[u32] {
        self.triangles.of(patch.index())
    }

    /// Replaces `out` by the elements across the edges of `e`, each once. A cluster has none.
    pub fn around(&self, scene: &Scene, front: &Front, e: ElementId, out: &mut Vec<ElementId>) {
        out.clear();
        let id = front.patch[e.index()];
        let patch = &front.patches[id.index()];
        let [s0, t0, ds, dt] = front.rect[e.index()];
        let (quad, triangle) = match patch.shape {
            Shape::Parallelogram { .. } => (true, false),
            Shape::Triangle { .. } => (false, true),
            Shape::Cluster { .. } => return,
        };
        let Some(&first) = self.triangles_of(id).first() else {
            return;
        };
        // Places on the edges in units of the element, and the step outward; two on each edge,
        // so that both of two finer neighbours are seen. A triangle's edge that is joined to
        // finer ones has its middle on a vertex: quarters avoid it.
        const Q: f32 = 0.25;
        const OUT: f32 = 1.0 / 16.0;
        let of_quad = [
            ([Q, 0.0], [0.0, -OUT]),
            ([1.0 - Q, 0.0], [0.0, -OUT]),
            ([Q, 1.0], [0.0, OUT]),
            ([1.0 - Q, 1.0], [0.0, OUT]),
            ([0.0, Q], [-OUT, 0.0]),
            ([0.0, 1.0 - Q], [-OUT, 0.0]),
            ([1.0, Q], [OUT, 0.0]),
            ([1.0, 1.0 - Q], [OUT, 0.0]),
        ];
        let of_triangle = [
            ([Q, 0.0], [OUT, -OUT]),
            ([1.0 - Q, 0.0], [0.0, -OUT]),
            ([0.0, Q], [-OUT, OUT]),
            ([0.0, 1.0 - Q], [-OUT, 0.0]),
            ([Q, 1.0 - Q], [OUT, OUT]),
            ([1.0 - Q, Q], [OUT, OUT]),
        ];
        let probes: &[([f32; 2], [f32; 2])] = if quad { &of_quad } else { &of_triangle };
        for &([a, b], [da, db]) in probes {
            let (s, t) = (s0 + (a + da) * ds, t0 + (b + db) * dt);
            let inside = s >= 0.0
                && t >= 0.0
                && if triangle {
                    s + t <= 1.0
                } else {
                    s <= 1.0 && t <= 1.0
                };
            let point = patch.point(s, t);
            let found = if inside {
                front.element_at(first as usize, patch.side, point)
            } else {
                let edge = patch.point(s0 + a * ds, t0 + b * dt);
                self.beyond(scene, front, id, edge, point)
            };
            if let Some(n) = found.filter(|&n| n != e && !out.contains(&n)) {
                out.push(n);
            }
        }
    }

    /// The element at `point`, just beyond the border of `patch` at `edge`.
    fn beyond(
        &self,
        scene: &Scene,
        front: &Front,
        patch: PatchId,
        edge: Vec3,
        point: Vec3,
    ) -> Option<ElementId> {
        let side = front.patches[patch.index()].side;
        // The border edge of the patch's triangles that is nearest to the place.
        let mut best = (f32::INFINITY, NONE);
        for &t in self.triangles_of(patch) {
            let c = scene.corners(t as usize);
            for k in 0..3 {
                let o = self.next[t as usize][k];
                if o != NONE && front.patch_of[o as usize][side as usize] == patch {
                    continue;
                }
                let (p, q) = (c[k], c[(k + 1) % 3]);
                let along = ((edge - p).dot(q - p) / (q - p).length_squared()).clamp(0.0, 1.0);
                let distance = edge.distance_squared(p + (q - p) * along);
                if distance < best.0 {
                    best = (distance, o);
                }
            }
        }
        let (_, other) = best;
        if other == NONE {
            return None;
        }
        let id = front.patch_of[other as usize][side as usize];
        if !id.is_some() || matches!(front.patches[id.index()].shape, Shape::Cluster { .. }) {
            return None;
        }
        let smooth = front.patches[id.index()]
            .normal
            .dot(front.patches[patch.index()].normal);
        if smooth < SMOOTH {
            return None;
        }
        front.element_at(other as usize, side, point)
    }
}
