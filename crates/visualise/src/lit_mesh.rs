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
//! The light at a vertex is asked a little inside its elements (see [`INSET`]): exactly on the
//! edge a receiver lies in the plane of the next wall, and rounding decides what it sees.
//!
//! Source: [Baum91] for the requirements on a mesh; the split by mutual sight is ours.

use crate::long_edges::halve;
use crate::places::{Places, Sources};
use luxel_core::{Front, Patch, Rgb, Scene, Shape, Side, SurfaceId, Vec2, Vec3};
use luxel_gather::{Irradiance, Receiver};
use luxel_transport::{Ray, RayCaster};
use rayon::prelude::*;
use std::ops::Range;

/// How far a receiver moves from a corner towards the centre of its element, as a share.
pub const INSET: f32 = 0.1;

/// Longest edge drawn without a vertex in between, in edges of a mean element: those of right
/// triangles stay whole.
const LONGEST_EDGE: f32 = 2.0;

/// Most vertices that dividing long edges may add, as a multiple of those that are there.
const MOST_ADDED: usize = 4;

/// Facets of a cluster whose normals differ by less than this share a vertex: cosine of 30 degrees.
const COS_CREASE: f32 = 0.866;

/// More elements than this around one vertex (the pole of a sphere) are not tested for sight.
const MAX_RING: usize = 16;

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
    /// Surface sides, by ascending surface, front before back.
    pub parts: Vec<LitPart>,
    /// First of the two triangles of each plain quadrilateral element: its diagonal is free.
    quads: Vec<u32>,
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
                Builder::new(scene, front, &sources, elements)
                    .finish(caster)
                    .divided(LONGEST_EDGE * mean_edge_m)
            })
            .collect();
        let mut mesh = LitMesh {
            elements: front.len(),
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
            if textured {
                self.uvs.push(v.uv);
            }
        }
        let single = part.facets.iter().chain(&part.triangles);
        self.triangles.extend(single.map(|t| t.map(|i| i + vertex)));
        for q in &part.quads {
            let [a, b, c, d] = q.map(|i| i + vertex);
            self.quads.push(self.triangles.len() as u32);
            self.triangles.extend([[a, b, c], [a, c, d]]);
        }
        self.parts.push(LitPart {
            surface: patch.surface,
            side: patch.side,
            vertices: vertex..self.positions.len() as u32,
            triangles: triangle..self.triangles.len() as u32,
        });
    }

    /// Number of elements of the front that the mesh was built for.
    pub fn elements(&self) -> usize {
        self.elements
    }

    /// Where light has to be asked: one receiver a vertex, in order.
    pub fn receivers(&self) -> &[Receiver] {
        &self.receivers
    }

    /// Takes the answers for [`LitMesh::receivers`], sums the groups, and lays the diagonal of
    /// each quadrilateral element along the smaller step of light, which hides the mesh.
    ///
    /// Precondition: one answer a vertex.
    pub fn set_irradiance(&mut self, answers: &Irradiance) {
        self.set_dimmed(answers, &[]);
    }

    /// As [`LitMesh::set_irradiance`], with a factor for each group (missing factors are 1).
    pub fn set_dimmed(&mut self, answers: &Irradiance, dimming: &[f32]) {
        let columns = answers.columns.max(3);
        debug_assert_eq!(answers.values.len(), columns * self.positions.len());
        let row = |values: &[f32]| {
            let mut sum = [0.0f64; 3];
            for (group, bands) in values.chunks_exact(3).enumerate() {
                let factor = dimming.get(group).copied().unwrap_or(1.0) as f64;
                for band in 0..3 {
                    sum[band] += bands[band] as f64 * factor;
                }
            }
            // An estimate may fall a hair under zero; light does not.
            Rgb::from(sum.map(|v| {
                if v.is_finite() {
                    v.max(0.0) as f32
                } else {
                    0.0
                }
            }))
        };
        self.irradiance = answers.values.par_chunks(columns).map(row).collect();
        self.irradiance.resize(self.positions.len(), Rgb::BLACK);
        self.errors = answers.errors.clone();
        self.errors.resize(self.positions.len(), 0.0);
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

/// A finished vertex.
struct Vertex {
    position: Vec3,
    uv: Vec2,
    receiver: Receiver,
}

/// What one part comes to: facets of clusters, then flat triangles, then pairs of them.
struct Built {
    vertices: Vec<Vertex>,
    facets: Vec<[u32; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Corners of plain quadrilaterals in order.
    quads: Vec<[u32; 4]>,
}

impl Built {
    /// Divides what has long edges; facets stay as the source has them.
    fn divided(mut self, longest_m: f32) -> Built {
        let positions: Vec<Vec3> = self.vertices.iter().map(|v| v.position).collect();
        let is_long =
            |a: u32, b: u32| (positions[a as usize] - positions[b as usize]).length() > longest_m;
        // The free diagonal of a quadrilateral does not count.
        self.quads.retain(|&[a, b, c, d]| {
            let long = is_long(a, b) || is_long(b, c) || is_long(c, d) || is_long(d, a);
            if long {
                self.triangles.extend([[a, b, c], [a, c, d]]);
            }
            !long
        });
        let most = MOST_ADDED * positions.len();
        let first = positions.len();
        let (triangles, middles) = halve(self.triangles, &positions, longest_m, most);
        self.triangles = triangles;
        for m in &middles {
            let [a, b] = m.between.map(|v| &self.vertices[v as usize]);
            let vertex = Vertex {
                position: m.position,
                uv: 0.5 * (a.uv + b.uv),
                receiver: Receiver {
                    position: Vec3::ZERO,
                    normal: a.receiver.normal,
                },
            };
            self.vertices.push(vertex);
        }
        // As at corners: a little inside the triangles around, which cancels on inner edges.
        let mut around = vec![(Vec3::ZERO, 0.0); middles.len()];
        for t in &self.triangles {
            let [a, b, c] = t.map(|v| self.vertices[v as usize].position);
            let centre = (a + b + c) / 3.0;
            for v in t.map(|v| v as usize).into_iter().filter(|&v| v >= first) {
                let p = self.vertices[v].position;
                around[v - first].0 += (centre - p) * INSET;
                around[v - first].1 += 1.0;
            }
        }
        for (v, (moved, count)) in self.vertices[first..].iter_mut().zip(around) {
            v.receiver.position = v.position + moved / f32::max(count, 1.0);
        }
        self
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

/// A corner of an element's outline at a place.
struct Corner {
    place: u32,
    uv: Vec2,
    inset: Vec3,
    normal: Vec3,
    weight: f32,
    flat: bool,
}

/// An outline: a run of corners, and the centre around which to draw it if it is a fan.
struct Outline {
    corners: Range<u32>,
    centre: Vec3,
    uv: Vec2,
    normal: Vec3,
}

struct Builder {
    places: Places,
    corners: Vec<Corner>,
    outlines: Vec<Outline>,
}

impl Builder {
    fn new(scene: &Scene, front: &Front, sources: &Sources, elements: &[u32]) -> Builder {
        let mut places = Places::new(sources.tolerance_m);
        // Corners of all elements first: an element must know its finer neighbours.
        let (mut ring, mut on_border) = (Vec::new(), Vec::new());
        for &e in elements {
            let patch = front.patch[e as usize];
            if matches!(front.patches[patch.index()].shape, Shape::Cluster { .. }) {
                continue;
            }
            outline(front, e, &mut ring);
            let component = sources.component[patch.index()];
            for &(p, st) in &ring {
                let place = places.find_or_add(component, p);
                if sources.shared[component as usize]
                    && borders(&front.patches[patch.index()], st) != 0
                {
                    on_border.push(place);
                }
            }
        }
        on_border.sort_unstable();
        on_border.dedup();
        let seams = places.seams(&on_border);
        let mut b = Builder {
            places,
            corners: Vec::new(),
            outlines: Vec::new(),
        };
        let mut points = Vec::new();
        for &e in elements {
            let id = front.patch[e as usize];
            let patch = &front.patches[id.index()];
            if let Shape::Cluster { triangles } = &patch.shape {
                for c in &front.cluster_triangles[triangles.start as usize..triangles.end as usize]
                {
                    b.add_facet(scene, c.triangle, patch.side);
                }
                continue;
            }
            outline(front, e, &mut ring);
            let component = sources.component[id.index()];
            points.clear();
            for k in 0..ring.len() {
                let ((p, from), (q, to)) = (ring[k], ring[(k + 1) % ring.len()]);
                points.push(p);
                match seams.get(&component) {
                    // Neighbouring patches need not halve each other's edges.
                    Some(seam) if borders(patch, from) & borders(patch, to) != 0 => {
                        b.places.on_seam(seam, p, q, &mut points)
                    }
                    _ => b.places.between(component, p, q, 0, &mut points),
                }
            }
            let centre = ring.iter().map(|r| r.0).sum::<Vec3>() / ring.len() as f32;
            let source = sources.source_at(scene, front, id, centre);
            let uv = |p: Vec3| sources.uv(scene, source, p);
            b.add_outline(
                component,
                &points,
                centre,
                patch.normal,
                front.area[e as usize],
                true,
                uv,
            );
        }
        b
    }

    /// A triangle of a cluster, as in the source.
    fn add_facet(&mut self, scene: &Scene, triangle: u32, side: Side) {
        let [a, mut b, mut c] = scene.corners(triangle as usize);
        let mut uvs = scene
            .uvs
            .get(triangle as usize)
            .copied()
            .unwrap_or_default();
        if side == Side::Back {
            std::mem::swap(&mut b, &mut c);
            uvs.swap(1, 2);
        }
        let cross = (b - a).as_dvec3().cross((c - a).as_dvec3());
        let (normal, area) = (
            cross.normalize_or_zero().as_vec3(),
            (0.5 * cross.length()) as f32,
        );
        let points = [a, b, c];
        let uv = |p: Vec3| {
            points
                .iter()
                .position(|q| *q == p)
                .map_or(Vec2::ZERO, |k| uvs[k])
        };
        self.add_outline(
            Places::FACETS,
            &points,
            (a + b + c) / 3.0,
            normal,
            area,
            false,
            uv,
        );
    }

    fn add_outline(
        &mut self,
        component: u32,
        points: &[Vec3],
        centre: Vec3,
        normal: Vec3,
        weight: f32,
        flat: bool,
        uv: impl Fn(Vec3) -> Vec2,
    ) {
        let first = self.corners.len() as u32;
        for &p in points {
            let place = self.places.find_or_add(component, p);
            let inset = p + (centre - p) * INSET;
            self.corners.push(Corner {
                place,
                uv: uv(p),
                inset,
                normal,
                weight,
                flat,
            });
        }
        let corners = first..self.corners.len() as u32;
        self.outlines.push(Outline {
            corners,
            centre,
            uv: uv(centre),
            normal,
        });
    }

    fn finish(self, caster: Option<&dyn RayCaster>) -> Built {
        let (vertex_of, mut vertices) = self.share(caster);
        let (mut facets, mut triangles, mut quads) = (Vec::new(), Vec::new(), Vec::new());
        for o in &self.outlines {
            let v = &vertex_of[o.corners.start as usize..o.corners.end as usize];
            match *v {
                // Corners closer than the tolerance are one place, and such a facet is a line.
                [a, b, c] if a == b || b == c || c == a => {}
                [a, b, c] if self.corners[o.corners.start as usize].flat => {
                    triangles.push([a, b, c])
                }
                [a, b, c] => facets.push([a, b, c]),
                [a, b, c, d] if self.is_convex(o) => quads.push([a, b, c, d]),
                _ => {
                    let hub = vertices.len() as u32;
                    let receiver = Receiver {
                        position: o.centre,
                        normal: o.normal,
                    };
                    vertices.push(Vertex {
                        position: o.centre,
                        uv: o.uv,
                        receiver,
                    });
                    let rim = (0..v.len()).map(|k| [v[k], v[(k + 1) % v.len()]]);
                    triangles.extend(rim.filter(|[a, b]| a != b).map(|[a, b]| [hub, a, b]));
                }
            }
        }
        Built {
            vertices,
            facets,
            triangles,
            quads,
        }
    }

    /// Whether four corners make a quadrilateral, and not a triangle with a point on an edge.
    fn is_convex(&self, o: &Outline) -> bool {
        let p = |k: usize| {
            self.places.position[self.corners[o.corners.start as usize + k % 4].place as usize]
        };
        (0..4).all(|k| {
            let (a, b) = (p(k + 1) - p(k), p(k + 2) - p(k + 1));
            a.cross(b).length() > 1e-3 * a.length() * b.length()
        })
    }

    /// Corners into vertices: those at one place that agree share one.
    fn share(&self, caster: Option<&dyn RayCaster>) -> (Vec<u32>, Vec<Vertex>) {
        // Corners by place, in order.
        let mut start = vec![0u32; self.places.position.len() + 1];
        for c in &self.corners {
            start[c.place as usize + 1] += 1;
        }
        for k in 1..start.len() {
            start[k] += start[k - 1];
        }
        let (mut at, mut by_place) = (start.clone(), vec![0u32; self.corners.len()]);
        for (k, c) in self.corners.iter().enumerate() {
            by_place[at[c.place as usize] as usize] = k as u32;
            at[c.place as usize] += 1;
        }
        let mut vertex_of = vec![u32::MAX; self.corners.len()];
        let mut vertices = Vec::new();
        // In runs of places, so that the segments of a million elements are never held at once.
        const RUN: usize = 1 << 14;
        for run in (0..self.places.position.len()).step_by(RUN) {
            let places = run..(run + RUN).min(self.places.position.len());
            let blocked = self.blocked_pairs(&start, &by_place, places.clone(), caster);
            let mut next = 0;
            for place in places {
                let ring = &by_place[start[place] as usize..start[place + 1] as usize];
                let mut group: Vec<usize> = (0..ring.len()).collect();
                for i in 0..ring.len() {
                    for j in 0..i {
                        let (a, b) = (
                            &self.corners[ring[j] as usize],
                            &self.corners[ring[i] as usize],
                        );
                        if !agree(a, b) {
                            continue;
                        }
                        let parted = is_tested(a, b, ring.len(), caster.is_some()) && {
                            next += 1;
                            blocked[next - 1]
                        };
                        if !parted {
                            join(&mut group, i, j);
                        }
                    }
                }
                for lead in 0..ring.len() {
                    if group[lead] != lead {
                        continue;
                    }
                    let members: Vec<u32> = (lead..ring.len())
                        .filter(|&k| root(&group, k) == lead)
                        .map(|k| ring[k])
                        .collect();
                    for &k in &members {
                        vertex_of[k as usize] = vertices.len() as u32;
                    }
                    vertices.push(self.vertex(place, &members));
                }
            }
        }
        (vertex_of, vertices)
    }

    /// For each agreeing pair of corners around each place, in the order in which `share` asks:
    /// whether something stands between them.
    fn blocked_pairs(
        &self,
        start: &[u32],
        by_place: &[u32],
        places: Range<usize>,
        caster: Option<&dyn RayCaster>,
    ) -> Vec<bool> {
        let Some(caster) = caster else {
            return Vec::new();
        };
        let mut segments = Vec::new();
        for place in places {
            let ring = &by_place[start[place] as usize..start[place + 1] as usize];
            for i in 0..ring.len() {
                for j in 0..i {
                    let (a, b) = (
                        &self.corners[ring[j] as usize],
                        &self.corners[ring[i] as usize],
                    );
                    if agree(a, b) && is_tested(a, b, ring.len(), true) {
                        // Lifted by half the inset: what is lower than that casts no shadow that
                        // elements of this size could show.
                        let step = (a.inset - self.places.position[place]).length();
                        let lift = a.normal * (0.5 * step + caster.offset_m());
                        segments.push(Ray {
                            origin: a.inset + lift,
                            t_min: 0.0,
                            direction: b.inset - a.inset,
                            t_max: 1.0,
                        });
                    }
                }
            }
        }
        let mut visible = vec![1.0; segments.len()];
        caster.visibility(&segments, &mut visible);
        visible.iter().map(|&v| v < 0.5).collect()
    }

    fn vertex(&self, place: usize, members: &[u32]) -> Vertex {
        let position = self.places.position[place];
        let corners = || members.iter().map(|&k| &self.corners[k as usize]);
        let first = &self.corners[members[0] as usize];
        let normal = if first.flat {
            first.normal
        } else {
            corners()
                .map(|c| c.normal * c.weight)
                .sum::<Vec3>()
                .normalize_or(first.normal)
        };
        // The mean over a full ring is the vertex itself; on a border it lies inside.
        let inset = corners().map(|c| c.inset).sum::<Vec3>() / members.len() as f32;
        // Above every facet around it: on a convex fold the mean lies in the solid.
        let lift = corners()
            .map(|c| (position - inset).dot(c.normal) / normal.dot(c.normal).max(0.5))
            .fold(0.0f32, f32::max);
        let lift = if first.flat { 0.0 } else { lift };
        let receiver = Receiver {
            position: inset + normal * lift,
            normal,
        };
        Vertex {
            position,
            uv: first.uv,
            receiver,
        }
    }
}

/// Corners of a flat element in order, with their patch coordinates.
fn outline(front: &Front, element: u32, ring: &mut Vec<(Vec3, [f32; 2])>) {
    let patch = &front.patches[front.patch[element as usize].index()];
    let [s, t, ds, dt] = front.rect[element as usize];
    ring.clear();
    let mut push = |s: f32, t: f32| ring.push((patch.point(s, t), [s, t]));
    push(s, t);
    push(s + ds, t);
    if matches!(patch.shape, Shape::Parallelogram { .. }) {
        push(s + ds, t + dt);
    }
    push(s, t + dt);
}

/// On which edges of its patch a point lies, one bit each.
fn borders(patch: &Patch, [s, t]: [f32; 2]) -> u8 {
    let near = |v: f32| v.abs() < 1e-5;
    let far = match patch.shape {
        Shape::Triangle { .. } => (near(s + t - 1.0) as u8) << 2,
        _ => (near(s - 1.0) as u8) << 2 | (near(t - 1.0) as u8) << 3,
    };
    near(s) as u8 | (near(t) as u8) << 1 | far
}

/// Whether two corners at one place may share a vertex as far as form and texture go.
fn agree(a: &Corner, b: &Corner) -> bool {
    let near = |p: f32, q: f32| (p - q).abs() <= 1e-4 * p.abs().max(1.0);
    a.flat == b.flat
        && near(a.uv.x, b.uv.x)
        && near(a.uv.y, b.uv.y)
        && a.normal.dot(b.normal) >= COS_CREASE
}

/// Whether sight between two agreeing corners is tested: facets of clusters are too small.
fn is_tested(a: &Corner, b: &Corner, ring: usize, has_caster: bool) -> bool {
    has_caster && a.flat && b.flat && ring <= MAX_RING
}

fn root(group: &[usize], mut k: usize) -> usize {
    while group[k] != k {
        k = group[k];
    }
    k
}

fn join(group: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(group, a), root(group, b));
    group[a.max(b)] = a.min(b);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use luxel_core::{ElementId, Finish, GroupId};
    use luxel_scenes::Builder;
    use std::collections::HashMap;

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
                let again = mesh.irradiance.iter().flat_map(|e| e.to_array()).collect();
                let answers = Irradiance {
                    columns: 3,
                    values: again,
                    ..Irradiance::default()
                };
                mesh.set_irradiance(&answers);
            }
        }
    }

    #[test]
    fn dimming_scales_one_group_and_bad_numbers_become_dark() {
        let (scene, front) = square_front(1);
        let mut mesh = LitMesh::build(&scene, &front, None);
        let mut values = [1.0, 2.0, 3.0, 10.0, 20.0, 30.0].repeat(4);
        values[6] = f32::NAN;
        let answers = Irradiance {
            columns: 6,
            values,
            ..Irradiance::default()
        };
        mesh.set_dimmed(&answers, &[1.0, 0.5]);
        assert_eq!(mesh.irradiance[0], Rgb::new(6.0, 12.0, 18.0));
        assert_eq!(mesh.irradiance[1].r, 0.0);
    }

    #[test]
    fn the_same_mesh_for_any_thread_count() {
        let scene = testing::room();
        let front = testing::front(&scene, 0.05, true);
        let build = |n| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(n)
                .build()
                .expect("threads");
            pool.install(|| LitMesh::build(&scene, &front, Some(&testing::caster(&scene))))
        };
        assert!(build(1) == build(4));
    }
}
