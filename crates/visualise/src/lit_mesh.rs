//! The mesh that is shown: the elements of a front as triangles that carry illuminance at their
//! vertices.
//!
//! Each surface side becomes one [`LitPart`]. Elements of flat patches are drawn as they are, so
//! a big wall has as many vertices as its light needs; triangles of clusters are drawn as in the
//! source. A vertex is shared where light is continuous: between elements of one patch, and of
//! coplanar patches of a surface whose source triangles share an edge. It is split where the
//! texture jumps, at folds, and where something stands on the surface so that the elements around
//! the vertex do not see each other (a wall's foot across a floor). Vertices of finer neighbours
//! on an edge are taken over by the coarser element, which is then a fan around its centre: no
//! cracks and no jump of light [Baum91].
//!
//! The vertices are found in `outlines`.
//!
//! Source: [Baum91] for the requirements on a mesh; the split by mutual sight is ours.

use crate::outlines::{Built, Outlines};
use crate::places::Sources;
use luxel_core::{Front, Rgb, Scene, Shape, Side, SurfaceId, Vec2, Vec3};
use luxel_gather::Receiver;
use luxel_transport::RayCaster;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::ops::Range;

/// Longest edge drawn without a vertex in between, in edges of a mean element: those of right
/// triangles stay whole.
const LONGEST_EDGE: f32 = 2.0;

/// One side of one surface in a [`LitMesh`].
#[derive(Clone, Debug, PartialEq)]
pub struct LitPart {
    /// Surface.
    pub surface: SurfaceId,
    /// Side that is lit and seen.
    pub side: Side,
    /// Its vertices, a run of [`LitMesh::positions`].
    pub vertices: Range<u32>,
    /// Its triangles, a run of [`LitMesh::triangles`].
    pub triangles: Range<u32>,
}

/// Triangles with illuminance at their vertices.
///
/// Arrays of one entry a vertex, all of the same length; parts own contiguous runs. Sides that
/// neither reflect nor emit have no elements and are not here.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LitMesh {
    /// Place of each vertex, metres.
    pub positions: Vec<Vec3>,
    /// Unit normal towards the light; flat, but for clusters, where it is the mean of the facets.
    pub normals: Vec<Vec3>,
    /// Texture coordinates of each vertex; empty when the scene has none.
    pub uvs: Vec<Vec2>,
    /// Where the light of each vertex is asked.
    pub receivers: Vec<Receiver>,
    /// Illuminance of each vertex in linear bands, all groups together, lux. Empty until set.
    pub irradiance: Vec<Rgb>,
    /// Standard error of the photometric value, lux. Empty until set.
    pub errors: Vec<f32>,
    /// Corners of each triangle, counter-clockwise seen from the lit side.
    pub triangles: Vec<[u32; 3]>,
    /// A source triangle of the patch that each triangle lies in; of a cluster the one that it is.
    pub sources: Vec<u32>,
    /// Surface sides, by ascending surface, front before back.
    pub parts: Vec<LitPart>,
    /// First of the two triangles of each plain quadrilateral element: its diagonal is free.
    quads: Vec<u32>,
    /// Elements around each vertex: the runs of `around` between two entries of `first_around`.
    first_around: Vec<u32>,
    around: Vec<u32>,
    /// Elements of the front that it was built for.
    elements: usize,
    /// Edge of a square as large as the mean flat element, weighted by area, metres; infinite
    /// when there is none.
    pub mean_edge_m: f32,
}

impl LitMesh {
    /// The mesh to show for `front`.
    ///
    /// With a `caster`, vertices are also split where something stands on the surface between
    /// the elements around them. The same mesh for any thread count.
    pub fn build(scene: &Scene, front: &Front, caster: Option<&dyn RayCaster>) -> LitMesh {
        let sources = Sources::new(scene, front);
        // Elements by surface side, then patch: split elements were appended far from their kin.
        let mut order: Vec<u32> = (0..front.len() as u32).collect();
        let key = |&e: &u32| {
            let patch = &front.patches[front.patch[e as usize].index()];
            (patch.surface, patch.side as u8, front.patch[e as usize], e)
        };
        order.par_sort_unstable_by_key(key);
        let runs: Vec<&[u32]> = order
            .chunk_by(|a, b| {
                let (a, b) = (key(a), key(b));
                (a.0, a.1) == (b.0, b.1)
            })
            .collect();
        let mean_edge_m = mean_edge(front);
        let built: Vec<Built> = runs
            .par_iter()
            .map(|elements| {
                Outlines::new(scene, front, &sources, elements)
                    .finish(caster)
                    .divided(LONGEST_EDGE * mean_edge_m)
            })
            .collect();
        let mut mesh = LitMesh {
            elements: front.len(),
            first_around: vec![0],
            mean_edge_m,
            ..LitMesh::default()
        };
        for (part, elements) in built.into_iter().zip(&runs) {
            mesh.append(part, front, elements, !scene.uvs.is_empty());
        }
        mesh
    }

    fn append(&mut self, part: Built, front: &Front, elements: &[u32], textured: bool) {
        let patch = &front.patches[front.patch[elements[0] as usize].index()];
        let (vertex, triangle) = (self.positions.len() as u32, self.triangles.len() as u32);
        for v in &part.vertices {
            self.positions.push(v.position);
            self.normals.push(v.receiver.normal);
            self.receivers.push(v.receiver);
            self.around.extend_from_slice(&v.elements);
            self.first_around.push(self.around.len() as u32);
            if textured {
                self.uvs.push(v.uv);
            }
        }
        for t in part.facets.iter().chain(&part.triangles) {
            self.triangles.push(t.corners.map(|i| i + vertex));
            self.sources.push(t.source);
        }
        for q in &part.quads {
            let [a, b, c, d] = q.corners.map(|i| i + vertex);
            self.quads.push(self.triangles.len() as u32);
            self.triangles.extend([[a, b, c], [a, c, d]]);
            self.sources.extend([q.source; 2]);
        }
        self.parts.push(LitPart {
            surface: patch.surface,
            side: patch.side,
            vertices: vertex..self.positions.len() as u32,
            triangles: triangle..self.triangles.len() as u32,
        });
    }

    /// Divides vertices that lie in several charts, and orders the triangles of each part by page.
    /// Answers with the chart of each vertex. `chart_of` knows the chart at one side of a source
    /// triangle, `page_of` the page of a chart.
    ///
    /// The light of the vertices is not kept.
    pub fn divide(
        &mut self,
        chart_of: impl Fn(u32, Side) -> u32,
        page_of: impl Fn(u32) -> u32,
    ) -> Vec<u32> {
        let old = std::mem::take(self);
        let mut charts = Vec::with_capacity(old.positions.len());
        let is_quad: HashSet<u32> = old.quads.iter().copied().collect();
        self.first_around.push(0);
        (self.elements, self.mean_edge_m) = (old.elements, old.mean_edge_m);
        for part in &old.parts {
            let (vertex, triangle) = (self.positions.len() as u32, self.triangles.len() as u32);
            let mut known: HashMap<(u32, u32), u32> = HashMap::new();
            let chart = |t: &u32| chart_of(old.sources[*t as usize], part.side);
            let mut order: Vec<u32> = part.triangles.clone().collect();
            // Both triangles of a quadrilateral are of one patch, so they stay together.
            order.sort_by_key(|t| page_of(chart(t)));
            for &t in &order {
                let chart = chart(&t);
                let corners = old.triangles[t as usize].map(|v| {
                    *known.entry((v, chart)).or_insert_with(|| {
                        let v = v as usize;
                        self.positions.push(old.positions[v]);
                        self.normals.push(old.normals[v]);
                        self.uvs.extend(old.uvs.get(v));
                        self.receivers.push(old.receivers[v]);
                        let around = old.first_around[v] as usize..old.first_around[v + 1] as usize;
                        self.around.extend_from_slice(&old.around[around]);
                        self.first_around.push(self.around.len() as u32);
                        charts.push(chart);
                        charts.len() as u32 - 1
                    })
                });
                if is_quad.contains(&t) {
                    self.quads.push(self.triangles.len() as u32);
                }
                self.triangles.push(corners);
                self.sources.push(old.sources[t as usize]);
            }
            self.parts.push(LitPart {
                vertices: vertex..self.positions.len() as u32,
                triangles: triangle..self.triangles.len() as u32,
                ..*part
            });
        }
        charts
    }

    /// Number of elements of the front that the mesh was built for.
    pub fn elements(&self) -> usize {
        self.elements
    }

    /// Where light has to be asked: one receiver a vertex, in order.
    pub fn receivers(&self) -> &[Receiver] {
        &self.receivers
    }

    /// What each vertex has of its elements: the mean of those around it.
    ///
    /// `of_element` has an entry for each element of the front that the mesh was built for.
    pub fn of_elements(&self, of_element: &[Rgb]) -> Vec<Rgb> {
        let mean = |run: &[u32]| {
            let around = &self.around[run[0] as usize..run[1] as usize];
            let sum = around.iter().fold([0.0f64; 3], |sum, &e| {
                let e = of_element[e as usize].to_array();
                std::array::from_fn(|band| sum[band] + e[band] as f64)
            });
            Rgb::from(sum.map(|s| (s / around.len().max(1) as f64) as f32))
        };
        self.first_around.par_windows(2).map(mean).collect()
    }

    /// Takes the illuminance of all groups together, and its standard error, lux, at each vertex,
    /// and lays the diagonal of each quadrilateral element along the smaller step of light,
    /// which hides the mesh.
    ///
    /// Precondition: one entry a vertex.
    pub fn set_light(&mut self, irradiance: Vec<Rgb>, errors: Vec<f32>) {
        debug_assert_eq!(irradiance.len(), self.positions.len());
        debug_assert_eq!(errors.len(), self.positions.len());
        self.irradiance = irradiance;
        self.errors = errors;
        for &first in &self.quads {
            let first = first as usize;
            // A quadrilateral a b c d is stored as (a b c, a c d).
            let ([a, b, c], d) = (self.triangles[first], self.triangles[first + 1][2]);
            let e = |v: u32| self.irradiance[v as usize].luminance();
            if (e(a) - e(c)).abs() > (e(b) - e(d)).abs() {
                // Stored again as (b c d, b d a): the same form, so it can be turned again.
                self.triangles[first] = [b, c, d];
                self.triangles[first + 1] = [b, d, a];
            }
        }
    }

    /// Area that each vertex stands for, m²: a third of the triangles around it.
    pub fn vertex_areas(&self) -> Vec<f32> {
        let mut areas = vec![0.0; self.positions.len()];
        for (t, corners) in self.triangles.iter().enumerate() {
            let third = (self.area(t) / 3.0) as f32;
            corners.iter().for_each(|&v| areas[v as usize] += third);
        }
        areas
    }

    /// Area of a triangle, m².
    pub fn area(&self, triangle: usize) -> f64 {
        let [a, b, c] = self.triangles[triangle].map(|i| self.positions[i as usize].as_dvec3());
        0.5 * (b - a).cross(c - a).length()
    }
}

/// Edge of a square as large as the mean flat element, weighted by area, metres.
fn mean_edge(front: &Front) -> f32 {
    let (mut sum, mut squares) = (0.0f64, 0.0f64);
    for (patch, &area) in front.patch.iter().zip(&front.area) {
        if !matches!(front.patches[patch.index()].shape, Shape::Cluster { .. }) {
            sum += area as f64;
            squares += area as f64 * area as f64;
        }
    }
    if sum > 0.0 {
        (squares / sum).sqrt() as f32
    } else {
        f32::INFINITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use luxel_core::{ElementId, Finish, GroupId};
    use luxel_scenes::Builder;

    /// Edges used in one direction only: the border, and every crack.
    fn open_edges(mesh: &LitMesh) -> Vec<[Vec3; 2]> {
        let mut edges: HashMap<[u32; 2], i32> = HashMap::new();
        for t in &mesh.triangles {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                *edges.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1 } else { -1 };
            }
        }
        let open = edges.into_iter().filter(|e| e.1 != 0);
        open.map(|(e, _)| e.map(|v| mesh.positions[v as usize]))
            .collect()
    }

    fn area(mesh: &LitMesh) -> f64 {
        (0..mesh.triangles.len()).map(|t| mesh.area(t)).sum()
    }

    fn square_front(grid: u32) -> (Scene, Front) {
        let scene = testing::square(Finish::default());
        let mut front = Front::new(2);
        let shape = Shape::Parallelogram {
            origin: Vec3::new(-1.0, 0.0, 1.0),
            edge_u: Vec3::X * 2.0,
            edge_v: Vec3::Z * -2.0,
        };
        front.add_patch(
            SurfaceId(0),
            Side::Front,
            shape,
            [grid, grid],
            GroupId::NONE,
            &[0, 1],
        );
        (scene, front)
    }

    #[test]
    fn elements_of_a_patch_share_vertices() {
        let (scene, front) = square_front(4);
        let mesh = LitMesh::build(&scene, &front, None);
        // A grid of 4 x 4 has 5 x 5 corners and two triangles a cell.
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (25, 32));
        assert!((area(&mesh) - 4.0).abs() < 1e-5, "f32 positions");
        assert_eq!(mesh.parts.len(), 1);
        assert_eq!(mesh.elements(), 16);
        for (p, r) in mesh.positions.iter().zip(mesh.receivers()) {
            assert_eq!(r.normal, Vec3::Y);
            let is_inner = p.x.abs() < 0.99 && p.z.abs() < 0.99;
            let moved = (*p - r.position).length();
            // A tenth of half a diagonal of 0.5 m cells, or of its mean over two; inner ones cancel.
            assert!(if is_inner {
                moved < 1e-6
            } else {
                (0.02..0.04).contains(&moved)
            });
            assert!(r.position.x.abs() < 0.98 && r.position.z.abs() < 0.98);
        }
    }

    #[test]
    fn quadtree_levels_leave_no_crack() {
        let (scene, mut front) = square_front(3);
        // Three levels beside one another, more than 2:1 balance would allow.
        let [a, _, _, d] = front.split(ElementId(4)).expect("no cluster");
        front.split(d).expect("no cluster");
        let [_, b, ..] = front.split(a).expect("no cluster");
        front.split(b).expect("no cluster");
        let mesh = LitMesh::build(&scene, &front, None);
        assert!((area(&mesh) - 4.0).abs() < 1e-5);
        for [p, q] in open_edges(&mesh) {
            let on_border = [p.x, p.z]
                .iter()
                .zip([q.x, q.z])
                .any(|(a, b)| *a == b && a.abs() == 1.0);
            assert!(on_border, "crack from {p} to {q}");
        }
    }

    #[test]
    fn patches_with_grids_that_do_not_match_leave_no_crack() {
        // The two triangles of the square with 3 and 4 cells along the shared diagonal.
        let scene = testing::square(Finish::default());
        let mut front = Front::new(2);
        for (t, n) in [(0usize, 3), (1, 4)] {
            let [a, b, c] = scene.corners(t);
            let shape = Shape::Triangle {
                origin: a,
                edge_u: b - a,
                edge_v: c - a,
            };
            front.add_patch(
                SurfaceId(0),
                Side::Front,
                shape,
                [n, n],
                GroupId::NONE,
                &[t as u32],
            );
        }
        let mesh = LitMesh::build(&scene, &front, None);
        assert!((area(&mesh) - 4.0).abs() < 1e-5);
        for [p, q] in open_edges(&mesh) {
            assert!((p.x == q.x && p.x.abs() == 1.0) || (p.z == q.z && p.z.abs() == 1.0));
        }
    }

    #[test]
    fn a_fold_splits_vertices_and_flat_neighbours_share_them() {
        let scene = testing::room();
        let mesh = LitMesh::build(&scene, &testing::front(&scene, 1.0, false), None);
        assert!((area(&mesh) - 94.0).abs() < 1e-3, "2 (15 + 12 + 20) m²");
        for [p, q] in open_edges(&mesh) {
            // Only along the twelve edges of the room.
            let flat = |v: f32, far: f32| v.abs() < 1e-5 || (v - far).abs() < 1e-5;
            let sides = [(p.x, q.x, 5.0), (p.y, q.y, 3.0), (p.z, q.z, 4.0)];
            let on = sides
                .iter()
                .filter(|(a, b, far)| flat(*a, *far) && flat(*b, *far))
                .count();
            assert!(on >= 2, "{p} to {q} is open inside a wall");
        }
        for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
            assert!((n.length() - 1.0).abs() < 1e-5);
            assert!(
                (Vec3::new(2.5, 1.5, 2.0) - *p).dot(*n) > 0.0,
                "normals point into the room"
            );
        }
    }

    #[test]
    fn a_wall_on_the_floor_splits_the_vertices_at_its_foot() {
        // A thin wall stands on x = 0, along the middle line of a grid of 4 x 4.
        let mut b = Builder::new("walled");
        let grey = b.thin("grey", 0.5, 0.5, 0.5);
        let p = Vec3::new;
        let floor = [
            p(-1.0, 0.0, 1.0),
            p(1.0, 0.0, 1.0),
            p(1.0, 0.0, -1.0),
            p(-1.0, 0.0, -1.0),
        ];
        b.on("floor", grey).polygon(&floor);
        let wall = [
            p(0.0, 0.0, 1.0),
            p(0.0, 0.0, -1.0),
            p(0.0, 1.0, -1.0),
            p(0.0, 1.0, 1.0),
        ];
        b.on("wall", grey).polygon(&wall);
        let scene = b.build();
        let (_, mut front) = square_front(4);
        front.patch_of.resize(4, [luxel_core::PatchId::NONE; 2]);
        let caster = testing::caster(&scene);
        assert_eq!(LitMesh::build(&scene, &front, None).positions.len(), 25);
        let mesh = LitMesh::build(&scene, &front, Some(&caster));
        // Each of the five vertices on the line becomes two.
        assert_eq!(mesh.positions.len(), 30);
        let foot: Vec<_> = (0..30)
            .filter(|&v| mesh.positions[v].x.abs() < 1e-6)
            .collect();
        assert_eq!(foot.len(), 10);
        for v in foot {
            assert!(
                mesh.receivers()[v].position.x.abs() > 0.004,
                "on one side of the wall"
            );
        }
    }

    #[test]
    fn texture_coordinates_follow_the_source_triangles() {
        let mut b = Builder::new("picture");
        let grey = b.matte("grey", 0.5, 0.5, 0.5);
        let p = |x, z| Vec3::new(x, 0.0, z);
        b.on("s", grey)
            .picture([p(-1.0, 1.0), p(1.0, 1.0), p(1.0, -1.0), p(-1.0, -1.0)]);
        let mut scene = b.build();
        let (_, front) = square_front(4);
        if scene.uvs.is_empty() {
            let corner = |q: Vec3| Vec2::new(0.5 + 0.5 * q.x, 0.5 + 0.5 * q.z);
            scene.uvs = (0..2).map(|t| scene.corners(t).map(corner)).collect();
        }
        let mesh = LitMesh::build(&scene, &front, None);
        assert_eq!(
            mesh.uvs.len(),
            25,
            "one affine map for both triangles: still shared"
        );
        for (p, uv) in mesh.positions.iter().zip(&mesh.uvs) {
            // Bottom left of the picture is (0, 1), bottom right (1, 1).
            let expected = Vec2::new(0.5 + 0.5 * p.x, 0.5 + 0.5 * p.z);
            assert!((*uv - expected).length() < 1e-5, "{p}: {uv} for {expected}");
        }
        // A picture that starts anew on the second triangle splits the diagonal's five vertices.
        scene.uvs[1] = scene.uvs[1].map(|uv| uv + Vec2::new(0.31, 0.0));
        let split = LitMesh::build(&scene, &front, None);
        assert!(split.positions.len() > 25);
    }

    #[test]
    fn facets_of_a_cluster_share_vertices_above_the_surface() {
        let mut b = Builder::new("ball");
        let grey = b.matte("grey", 0.5, 0.5, 0.5);
        b.on("ball", grey).ball(Vec3::ZERO, 1.0, 12, 24);
        let scene = b.build();
        let all: Vec<u32> = (0..scene.triangles.len() as u32).collect();
        let mut front = Front::new(all.len());
        front.add_cluster(&scene, SurfaceId(0), Side::Front, GroupId::NONE, &all);
        let mesh = LitMesh::build(&scene, &front, None);
        // Facets turn by 15 degrees from one to the next, less than the crease.
        assert_eq!(mesh.positions.len(), scene.positions.len());
        assert_eq!(mesh.triangles.len(), scene.triangles.len());
        for (p, r) in mesh.positions.iter().zip(mesh.receivers()) {
            assert!(r.normal.dot(p.normalize()) > 0.98, "smooth");
            // Outside of every facet's plane, but for rounding.
            for &t in &all {
                let [a, b, c] = scene.corners(t as usize);
                let n = (b - a).cross(c - a).normalize();
                if scene.triangles[t as usize]
                    .iter()
                    .any(|&i| scene.positions[i as usize] == *p)
                {
                    assert!((r.position - a).dot(n) > -1e-6);
                }
            }
        }
    }

    #[test]
    fn the_diagonal_follows_the_light() {
        let (scene, front) = square_front(1);
        // Two opposite corners bright: the diagonal joins equals, whichever way it was before.
        for bright in [1.0, -1.0] {
            let lux = |p: Vec3| Rgb::splat(if p.x * p.z * bright > 0.0 { 100.0 } else { 0.0 });
            let mut mesh = testing::lit(&scene, &front, lux);
            for _ in 0..2 {
                let [a, b] = [mesh.triangles[0], mesh.triangles[1]];
                let shared: Vec<f32> = a
                    .iter()
                    .filter(|v| b.contains(v))
                    .map(|&v| mesh.irradiance[v as usize].g)
                    .collect();
                assert_eq!(shared.len(), 2);
                assert_eq!(shared[0], shared[1]);
                assert!((area(&mesh) - 4.0).abs() < 1e-5);
                mesh.set_light(mesh.irradiance.clone(), mesh.errors.clone());
            }
        }
    }

    #[test]
    fn vertices_have_the_mean_of_their_elements() {
        let (scene, front) = square_front(2);
        let mesh = LitMesh::build(&scene, &front, None);
        let of_element: Vec<Rgb> = (0..4).map(|e| Rgb::splat(10.0 * e as f32)).collect();
        let values = mesh.of_elements(&of_element);
        for (p, value) in mesh.positions.iter().zip(&values) {
            // Element 0 lies at low x and high z, 1 beside it, 2 and 3 behind.
            let steps = |c: f32| {
                if c.abs() < 0.5 {
                    0.5
                } else {
                    f32::from(c > 0.0)
                }
            };
            let expected = 10.0 * steps(p.x) + 20.0 * (1.0 - steps(p.z));
            assert!((value.g - expected).abs() < 1e-4, "{p}: {}", value.g);
        }
    }

    #[test]
    fn the_same_mesh_for_any_thread_count() {
        let scene = testing::room();
        let front = testing::front(&scene, 0.05, true);
        let build = |n| {
            testing::on_threads(n, || {
                LitMesh::build(&scene, &front, Some(&testing::caster(&scene)))
            })
        };
        assert!(build(1) == build(4));
    }
}
