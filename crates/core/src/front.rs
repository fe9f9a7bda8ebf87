//! The elements in force: patches of the scene's surfaces, cut into cells.
//!
//! A [`Patch`] is one side of a flat parallelogram, of a triangle, or of a cluster of tiny
//! triangles. It carries a regular grid of cells, and each cell may be a quadtree. The leaves
//! are the elements. A ray's hit (triangle, side, point) finds its element in a few steps, so
//! rays can run against the source triangles and never meet the mesh.
//!
//! Affine coordinates `(s, t)` of a patch: `origin + s edge_u + t edge_v`. A parallelogram is
//! `0 <= s, t <= 1`; a triangle adds `s + t <= 1`.

use crate::element::{ElementId, GroupId, PatchId, SurfaceId};
use crate::polygon::Polygon;
use crate::quantity::Rgb;
use crate::scene::Scene;
use glam::Vec3;

/// Which side of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Corners are counter-clockwise.
    Front,
    /// Corners are clockwise.
    Back,
}

/// What a patch looks like before it is cut.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A flat parallelogram.
    Parallelogram {
        /// Corner at `s = t = 0`, metres.
        origin: Vec3,
        /// Edge along `s`, metres.
        edge_u: Vec3,
        /// Edge along `t`, metres.
        edge_v: Vec3,
    },
    /// A triangle.
    Triangle {
        /// Corner at `s = t = 0`, metres.
        origin: Vec3,
        /// Edge along `s`, metres.
        edge_u: Vec3,
        /// Edge along `t`, metres.
        edge_v: Vec3,
    },
    /// Several small triangles of one surface that share one element.
    Cluster {
        /// A run of [`Front::cluster_triangles`].
        triangles: std::ops::Range<u32>,
    },
}

impl Shape {
    /// Places of the four children of a cell at `[s0, t0, ds, dt]`; `None` for a cluster, which
    /// cannot be split.
    pub fn quarters(&self, [s0, t0, ds, dt]: [f32; 4]) -> Option<[[f32; 4]; 4]> {
        let (hs, ht) = (0.5 * ds, 0.5 * dt);
        let last = match self {
            Shape::Cluster { .. } => return None,
            Shape::Parallelogram { .. } => [s0 + hs, t0 + ht, hs, ht],
            Shape::Triangle { .. } => [s0 + hs, t0 + ht, -hs, -ht],
        };
        Some([
            [s0, t0, hs, ht],
            [s0 + hs, t0, hs, ht],
            [s0, t0 + ht, hs, ht],
            last,
        ])
    }
}

/// One side of a shape, with its grid of cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Patch {
    /// Surface it belongs to.
    pub surface: SurfaceId,
    /// Which side of the source triangles faces the light.
    pub side: Side,
    /// Geometry, oriented so that `edge_u x edge_v` points to the light.
    pub shape: Shape,
    /// Unit normal towards the light; the area-weighted mean for a cluster.
    pub normal: Vec3,
    /// Layer of its own emission; [`GroupId::NONE`] when it does not emit.
    pub group: GroupId,
    /// Cells along `s` and `t` (for a triangle `[n, n]` gives `n * n` cells).
    pub grid: [u32; 2],
    /// First cell, an index into [`Front::cells`].
    pub first_cell: u32,
    /// Vectors whose dot product with `point - origin` gives `s` and `t`.
    dual: [Vec3; 2],
}

/// A triangle of a cluster.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClusterTriangle {
    /// Source triangle.
    pub triangle: u32,
    /// Share of the cluster's area up to and including this triangle, rising to 1.
    pub cumulative: f32,
}

/// A cell: an element, or four cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// A leaf.
    Element(ElementId),
    /// Index into [`Front::tree`].
    Split(u32),
}

/// The elements in force.
///
/// Arrays of fields, one entry an element, all of the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Front {
    /// Patches.
    pub patches: Vec<Patch>,
    /// Patch on the front and on the back of each source triangle; `NONE` where a side is black.
    pub patch_of: Vec<[PatchId; 2]>,
    /// Cells of all patches, grid by grid.
    pub cells: Vec<Cell>,
    /// Inner nodes of the quadtrees.
    pub tree: Vec<[Cell; 4]>,
    /// Triangles of the clusters.
    pub cluster_triangles: Vec<ClusterTriangle>,
    /// Patch of each element.
    pub patch: Vec<PatchId>,
    /// Place of each element in its patch: `s0, t0, ds, dt`. In a triangle `ds == dt`, and a
    /// negative size is the inverted sub-triangle that points the other way.
    pub rect: Vec<[f32; 4]>,
    /// Area of each element, m².
    pub area: Vec<f32>,
    /// Mean diffuse reflectance of each element, 0..=1.
    pub reflectance: Vec<Rgb>,
    /// Mean own exitance of each element, lm/m², in the layer of its patch.
    pub emission: Vec<Rgb>,
}

/// Samples stay this share of an element away from its edges: a ray that starts exactly in the
/// plane of a neighbouring wall would see through it.
const INSET: f32 = 1.0 / 1024.0;

impl Front {
    /// An empty front over `triangles` source triangles.
    pub fn new(triangles: usize) -> Self {
        Front {
            patch_of: vec![[PatchId::NONE; 2]; triangles],
            ..Front::default()
        }
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.area.len()
    }

    /// Whether there is no element.
    pub fn is_empty(&self) -> bool {
        self.area.is_empty()
    }

    /// Adds one side of a flat shape, cut into a `grid`, and the elements of its cells.
    ///
    /// `shape` is oriented towards the light already. `sources` are the triangles that it
    /// covers. Reflectance and emission of the new elements are zero until set.
    ///
    /// Precondition: the shape has area, `grid` is at least 1 x 1 and square for a triangle.
    pub fn add_patch(
        &mut self,
        surface: SurfaceId,
        side: Side,
        shape: Shape,
        grid: [u32; 2],
        group: GroupId,
        sources: &[u32],
    ) -> PatchId {
        let id = PatchId::from(self.patches.len());
        for &t in sources {
            self.patch_of[t as usize][side as usize] = id;
        }
        let (mut normal, mut dual) = (Vec3::ZERO, [Vec3::ZERO; 2]);
        if let Shape::Parallelogram { edge_u, edge_v, .. }
        | Shape::Triangle { edge_u, edge_v, .. } = shape
        {
            let n = edge_u.as_dvec3().cross(edge_v.as_dvec3());
            normal = n.normalize_or_zero().as_vec3();
            // Dual basis: dual_u . edge_u = 1, dual_u . edge_v = 0.
            dual = [
                (edge_v.as_dvec3().cross(n) / n.length_squared()).as_vec3(),
                (n.cross(edge_u.as_dvec3()) / n.length_squared()).as_vec3(),
            ];
        }
        let first_cell = self.cells.len() as u32;
        self.patches.push(Patch {
            surface,
            side,
            shape: shape.clone(),
            normal,
            group,
            grid,
            first_cell,
            dual,
        });
        let [nu, nv] = grid;
        match shape {
            Shape::Parallelogram { .. } => {
                let (ds, dt) = (1.0 / nu as f32, 1.0 / nv as f32);
                for j in 0..nv {
                    for i in 0..nu {
                        let e = self.add_element(id, [i as f32 * ds, j as f32 * dt, ds, dt]);
                        self.cells.push(Cell::Element(e));
                    }
                }
            }
            Shape::Triangle { .. } => {
                debug_assert!(nu == nv);
                let d = 1.0 / nu as f32;
                for j in 0..nu {
                    for i in 0..nu - j {
                        let e = self.add_element(id, [i as f32 * d, j as f32 * d, d, d]);
                        self.cells.push(Cell::Element(e));
                        if i + 1 < nu - j {
                            let rect = [(i + 1) as f32 * d, (j + 1) as f32 * d, -d, -d];
                            let e = self.add_element(id, rect);
                            self.cells.push(Cell::Element(e));
                        }
                    }
                }
            }
            Shape::Cluster { .. } => {
                let e = self.add_element(id, [0.0, 0.0, 1.0, 1.0]);
                self.cells.push(Cell::Element(e));
            }
        }
        id
    }

    /// Adds a cluster of tiny triangles of one surface as a single element.
    pub fn add_cluster(
        &mut self,
        scene: &Scene,
        surface: SurfaceId,
        side: Side,
        group: GroupId,
        sources: &[u32],
    ) -> PatchId {
        let first = self.cluster_triangles.len() as u32;
        let areas: Vec<f64> = sources
            .iter()
            .map(|&t| scene.area(t as usize) as f64)
            .collect();
        let whole: f64 = areas.iter().sum();
        let (mut sum, mut normal) = (0.0, Vec3::ZERO);
        for (&triangle, area) in sources.iter().zip(&areas) {
            sum += area;
            self.cluster_triangles.push(ClusterTriangle {
                triangle,
                cumulative: (sum / whole) as f32,
            });
            let [a, b, c] = scene.corners(triangle as usize);
            normal += (b - a).cross(c - a);
        }
        let shape = Shape::Cluster {
            triangles: first..self.cluster_triangles.len() as u32,
        };
        let id = self.add_patch(surface, side, shape, [1, 1], group, sources);
        let sign = if side == Side::Front { 1.0 } else { -1.0 };
        self.patches[id.index()].normal = normal.normalize_or_zero() * sign;
        *self.area.last_mut().expect("add_patch adds an element") = whole as f32;
        id
    }

    fn add_element(&mut self, patch: PatchId, rect: [f32; 4]) -> ElementId {
        let id = ElementId::from(self.area.len());
        let area = match &self.patches[patch.index()].shape {
            Shape::Parallelogram { edge_u, edge_v, .. } => {
                edge_u.cross(*edge_v).length() * rect[2] * rect[3]
            }
            Shape::Triangle { edge_u, edge_v, .. } => {
                0.5 * edge_u.cross(*edge_v).length() * rect[2] * rect[3]
            }
            Shape::Cluster { .. } => 0.0,
        };
        self.patch.push(patch);
        self.rect.push(rect);
        self.area.push(area);
        self.reflectance.push(Rgb::BLACK);
        self.emission.push(Rgb::BLACK);
        id
    }

    /// Splits a leaf of a patch into four. The first child keeps the id of `element`; the other
    /// three are appended, and get its reflectance and emission until set anew.
    ///
    /// A cluster cannot be split: returns `None`.
    pub fn split(&mut self, element: ElementId) -> Option<[ElementId; 4]> {
        let patch_id = self.patch[element.index()];
        let rects = self.patches[patch_id.index()]
            .shape
            .quarters(self.rect[element.index()])?;
        let centre = self.centre_st(element);
        let (reflectance, emission) = (
            self.reflectance[element.index()],
            self.emission[element.index()],
        );
        let quarter = self.area[element.index()] * 0.25;
        let mut children = [element; 4];
        self.rect[element.index()] = rects[0];
        self.area[element.index()] = quarter;
        for k in 1..4 {
            let e = self.add_element(patch_id, rects[k]);
            self.area[e.index()] = quarter;
            self.reflectance[e.index()] = reflectance;
            self.emission[e.index()] = emission;
            children[k] = e;
        }
        let node = self.tree.len() as u32;
        self.tree.push(children.map(Cell::Element));
        // Find the leaf from the top: cells do not know their parents.
        let mut place = self.base_cell(patch_id, centre);
        let first = self.patches[patch_id.index()].first_cell as usize;
        match self.cells[first + place.0] {
            Cell::Element(_) => self.cells[first + place.0] = Cell::Split(node),
            Cell::Split(mut at) => loop {
                let k = self.child(patch_id, &mut place.1, centre);
                match self.tree[at as usize][k] {
                    Cell::Split(deeper) => at = deeper,
                    Cell::Element(_) => {
                        self.tree[at as usize][k] = Cell::Split(node);
                        break;
                    }
                }
            },
        }
        Some(children)
    }

    /// Patch coordinates of the middle of an element.
    fn centre_st(&self, element: ElementId) -> [f32; 2] {
        let [s0, t0, ds, dt] = self.rect[element.index()];
        let share = match self.patches[self.patch[element.index()].index()].shape {
            Shape::Triangle { .. } => 1.0 / 3.0,
            _ => 0.5,
        };
        [s0 + share * ds, t0 + share * dt]
    }

    /// Cell of the grid that holds `(s, t)` (offset from the patch's first) and its rectangle.
    fn base_cell(&self, patch: PatchId, [s, t]: [f32; 2]) -> (usize, [f32; 4]) {
        let p = &self.patches[patch.index()];
        let [nu, nv] = p.grid;
        match p.shape {
            Shape::Cluster { .. } => (0, [0.0, 0.0, 1.0, 1.0]),
            Shape::Parallelogram { .. } => {
                let i = ((s * nu as f32) as u32).min(nu - 1);
                let j = ((t * nv as f32) as u32).min(nv - 1);
                let (ds, dt) = (1.0 / nu as f32, 1.0 / nv as f32);
                (
                    (j * nu + i) as usize,
                    [i as f32 * ds, j as f32 * dt, ds, dt],
                )
            }
            Shape::Triangle { .. } => {
                let n = nu;
                let j = ((t.max(0.0) * n as f32) as u32).min(n - 1);
                let i = ((s.max(0.0) * n as f32) as u32).min(n - 1 - j);
                let (fs, ft) = (s * n as f32 - i as f32, t * n as f32 - j as f32);
                let d = 1.0 / n as f32;
                let row = (2 * n * j - j * j) as usize;
                if fs + ft > 1.0 && i + 1 < n - j {
                    let rect = [(i + 1) as f32 * d, (j + 1) as f32 * d, -d, -d];
                    (row + 2 * i as usize + 1, rect)
                } else {
                    (row + 2 * i as usize, [i as f32 * d, j as f32 * d, d, d])
                }
            }
        }
    }

    /// Which quarter of `rect` holds `(s, t)`; narrows `rect` to it.
    fn child(&self, patch: PatchId, rect: &mut [f32; 4], [s, t]: [f32; 2]) -> usize {
        let [s0, t0, ds, dt] = *rect;
        let (a, b) = ((s - s0) / ds, (t - t0) / dt);
        let (hs, ht) = (0.5 * ds, 0.5 * dt);
        match self.patches[patch.index()].shape {
            Shape::Triangle { .. } => {
                let k = if a >= 0.5 {
                    1
                } else if b >= 0.5 {
                    2
                } else if a + b <= 0.5 {
                    0
                } else {
                    3
                };
                *rect = match k {
                    0 => [s0, t0, hs, ht],
                    1 => [s0 + hs, t0, hs, ht],
                    2 => [s0, t0 + ht, hs, ht],
                    _ => [s0 + hs, t0 + ht, -hs, -ht],
                };
                k
            }
            _ => {
                let (right, upper) = ((a >= 0.5) as usize, (b >= 0.5) as usize);
                *rect = [s0 + hs * right as f32, t0 + ht * upper as f32, hs, ht];
                right + 2 * upper
            }
        }
    }

    /// The element that holds `point` on one side of a source triangle; `None` where black.
    #[inline]
    pub fn element_at(&self, triangle: usize, side: Side, point: Vec3) -> Option<ElementId> {
        let id = self.patch_of[triangle][side as usize];
        if !id.is_some() {
            return None;
        }
        let patch = &self.patches[id.index()];
        if let Shape::Cluster { .. } = patch.shape {
            return match self.cells[patch.first_cell as usize] {
                Cell::Element(e) => Some(e),
                Cell::Split(_) => None,
            };
        }
        let st = patch.coordinates(point);
        let (cell, mut rect) = self.base_cell(id, st);
        let mut at = self.cells[patch.first_cell as usize + cell];
        loop {
            match at {
                Cell::Element(e) => return Some(e),
                Cell::Split(node) => at = self.tree[node as usize][self.child(id, &mut rect, st)],
            }
        }
    }

    /// A point of the element and the unit normal there, uniform by area for uniform `(u, v)`.
    #[inline]
    pub fn point_on(&self, scene: &Scene, element: ElementId, [u, v]: [f32; 2]) -> (Vec3, Vec3) {
        let patch = &self.patches[self.patch[element.index()].index()];
        let [s0, t0, ds, dt] = self.rect[element.index()];
        match &patch.shape {
            Shape::Parallelogram {
                origin,
                edge_u,
                edge_v,
            } => {
                let (u, v) = (inset(u), inset(v));
                (
                    *origin + *edge_u * (s0 + u * ds) + *edge_v * (t0 + v * dt),
                    patch.normal,
                )
            }
            Shape::Triangle {
                origin,
                edge_u,
                edge_v,
            } => {
                let (a, b) = in_triangle(u, v);
                (
                    *origin + *edge_u * (s0 + a * ds) + *edge_v * (t0 + b * dt),
                    patch.normal,
                )
            }
            Shape::Cluster { triangles } => {
                let run = &self.cluster_triangles[triangles.start as usize..triangles.end as usize];
                let k = run
                    .partition_point(|c| c.cumulative <= u)
                    .min(run.len() - 1);
                let before = if k == 0 { 0.0 } else { run[k - 1].cumulative };
                let width = (run[k].cumulative - before).max(f32::MIN_POSITIVE);
                let (a, b) = in_triangle(((u - before) / width).clamp(0.0, 1.0), v);
                let [p, q, r] = scene.corners(run[k].triangle as usize);
                let normal = (q - p)
                    .as_dvec3()
                    .cross((r - p).as_dvec3())
                    .normalize_or_zero()
                    .as_vec3();
                let sign = if patch.side == Side::Front { 1.0 } else { -1.0 };
                (p + (q - p) * a + (r - p) * b, normal * sign)
            }
        }
    }

    /// The planar polygons of an element, fronts towards the light: one, or a cluster's triangles.
    pub fn polygons(&self, scene: &Scene, element: ElementId) -> Vec<Polygon> {
        let patch = &self.patches[self.patch[element.index()].index()];
        let [s0, t0, ds, dt] = self.rect[element.index()];
        match &patch.shape {
            Shape::Parallelogram { .. } => {
                let at = |s, t| patch.point(s, t).as_dvec3();
                vec![Polygon::new(vec![
                    at(s0, t0),
                    at(s0 + ds, t0),
                    at(s0 + ds, t0 + dt),
                    at(s0, t0 + dt),
                ])]
            }
            Shape::Triangle { .. } => {
                let at = |s, t| patch.point(s, t).as_dvec3();
                vec![Polygon::new(vec![
                    at(s0, t0),
                    at(s0 + ds, t0),
                    at(s0, t0 + dt),
                ])]
            }
            Shape::Cluster { triangles } => self.cluster_triangles
                [triangles.start as usize..triangles.end as usize]
                .iter()
                .map(|c| {
                    let corners = scene.corners(c.triangle as usize).map(|p| p.as_dvec3());
                    let polygon = Polygon::new(corners.to_vec());
                    if patch.side == Side::Front {
                        polygon
                    } else {
                        polygon.flipped()
                    }
                })
                .collect(),
        }
    }

    /// Unit normal of an element towards the light (mean, for a cluster).
    pub fn normal(&self, element: ElementId) -> Vec3 {
        self.patches[self.patch[element.index()].index()].normal
    }

    /// Surface of an element.
    pub fn surface(&self, element: ElementId) -> SurfaceId {
        self.patches[self.patch[element.index()].index()].surface
    }

    /// Layer of an element's own emission.
    pub fn group(&self, element: ElementId) -> GroupId {
        self.patches[self.patch[element.index()].index()].group
    }

    /// Area of all elements, m².
    pub fn total_area(&self) -> f64 {
        self.area.iter().map(|&a| a as f64).sum()
    }
}

impl Patch {
    /// World point of patch coordinates `(s, t)`. Not for a cluster, whose answer is the origin.
    pub fn point(&self, s: f32, t: f32) -> Vec3 {
        match &self.shape {
            Shape::Parallelogram {
                origin,
                edge_u,
                edge_v,
            }
            | Shape::Triangle {
                origin,
                edge_u,
                edge_v,
            } => *origin + *edge_u * s + *edge_v * t,
            Shape::Cluster { .. } => Vec3::ZERO,
        }
    }

    /// Patch coordinates `(s, t)` of the foot of a world point. Zero for a cluster.
    #[inline]
    pub fn coordinates(&self, point: Vec3) -> [f32; 2] {
        let origin = match self.shape {
            Shape::Parallelogram { origin, .. } | Shape::Triangle { origin, .. } => origin,
            Shape::Cluster { .. } => Vec3::ZERO,
        };
        let rel = point - origin;
        [rel.dot(self.dual[0]), rel.dot(self.dual[1])]
    }
}

#[inline]
fn inset(u: f32) -> f32 {
    INSET + u * (1.0 - 2.0 * INSET)
}

/// Uniform point of the unit triangle, away from its edges; little distortion [Heitz19].
#[inline]
fn in_triangle(u: f32, v: f32) -> (f32, f32) {
    let (a, b) = if v > u {
        (0.5 * u, v - 0.5 * u)
    } else {
        (u - 0.5 * v, 0.5 * v)
    };
    (
        INSET + a * (1.0 - 3.0 * INSET),
        INSET + b * (1.0 - 3.0 * INSET),
    )
}

/// How the elements of a new front inherit from those of an old one.
///
/// Element `e` of the new front is the weighted sum of the old elements
/// `sources[offsets[e]..offsets[e + 1]]`. For a density such as exitance the weights of one
/// element sum to 1; a change keeps flux: the sum of exitance times area is the same before
/// and after.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrontChange {
    /// Length new elements + 1.
    pub offsets: Vec<u32>,
    /// Old element and its weight.
    pub sources: Vec<(ElementId, f32)>,
}

impl FrontChange {
    /// Carries `columns` densities for each element over to the new front.
    pub fn carry(&self, old: &[f32], columns: usize) -> Vec<f32> {
        let count = self.offsets.len().saturating_sub(1);
        let mut new = vec![0.0; count * columns];
        for e in 0..count {
            let run = &self.sources[self.offsets[e] as usize..self.offsets[e + 1] as usize];
            for column in 0..columns {
                let sum: f64 = run
                    .iter()
                    .map(|&(o, w)| old[o.index() * columns + column] as f64 * w as f64)
                    .sum();
                new[e * columns + column] = sum as f32;
            }
        }
        new
    }
}

/// One number an element: how much it wants to be refined. Error, times importance, times
/// where the walker will go; only the order and the ratio to a threshold matter. Zero or more.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RefinementWish(pub Vec<f32>);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::element::FinishId;
    use crate::scene::{Finish, Surface};

    fn triangle_scene() -> Scene {
        Scene {
            positions: vec![Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 3.0],
            triangles: vec![[0, 1, 2]],
            surface_of: vec![SurfaceId(0)],
            source_triangle: vec![0],
            surfaces: vec![Surface {
                name: "s".into(),
                finish: FinishId(0),
                triangles: 0..1,
                node: 0,
                mesh: 0,
                primitive: 0,
            }],
            finishes: vec![Finish::default()],
            ..Scene::default()
        }
    }

    fn shape(parallelogram: bool) -> Shape {
        let (origin, edge_u, edge_v) = (Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 3.0);
        if parallelogram {
            Shape::Parallelogram {
                origin,
                edge_u,
                edge_v,
            }
        } else {
            Shape::Triangle {
                origin,
                edge_u,
                edge_v,
            }
        }
    }

    #[test]
    fn every_sampled_point_is_found_again_through_splits() {
        let scene = triangle_scene();
        for parallelogram in [false, true] {
            let mut front = Front::new(1);
            front.add_patch(
                SurfaceId(0),
                Side::Front,
                shape(parallelogram),
                [3, 3],
                GroupId::NONE,
                &[0],
            );
            let whole = front.total_area();
            for e in [0, 4, 7, 9, 12] {
                front.split(ElementId(e)).expect("not a cluster");
            }
            assert!(
                (front.total_area() - whole).abs() < 1e-5,
                "splitting keeps area"
            );
            for e in 0..front.len() {
                for u in [0.0, 0.13, 0.5, 0.99, 1.0] {
                    for v in [0.0, 0.31, 0.77, 1.0] {
                        let (p, n) = front.point_on(&scene, ElementId::from(e), [u, v]);
                        assert_eq!(n, Vec3::Z);
                        assert_eq!(
                            front.element_at(0, Side::Front, p),
                            Some(ElementId::from(e)),
                            "element {e} at {u} {v}"
                        );
                    }
                }
            }
            assert_eq!(
                front.element_at(0, Side::Back, Vec3::ZERO),
                None,
                "the back is black"
            );
        }
    }

    #[test]
    fn cells_and_polygons_fill_the_patch() {
        let scene = triangle_scene();
        for (parallelogram, area) in [(true, 6.0), (false, 3.0)] {
            let mut front = Front::new(1);
            front.add_patch(
                SurfaceId(0),
                Side::Front,
                shape(parallelogram),
                [4, 4],
                GroupId::NONE,
                &[0],
            );
            assert_eq!(front.len(), 16);
            let sum: f64 = (0..front.len())
                .flat_map(|e| front.polygons(&scene, ElementId::from(e)))
                .map(|p| p.area())
                .sum();
            assert!((sum - area).abs() < 1e-5);
        }
    }

    #[test]
    fn carry_keeps_flux_when_an_element_is_split() {
        let change = FrontChange {
            offsets: vec![0, 1, 2, 3, 4, 5],
            sources: [0, 1, 0, 0, 0].map(|o| (ElementId(o), 1.0)).to_vec(),
        };
        let new = change.carry(&[8.0, 3.0], 1);
        assert_eq!(new, vec![8.0, 3.0, 8.0, 8.0, 8.0]);
    }
}
