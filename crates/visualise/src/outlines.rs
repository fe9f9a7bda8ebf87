//! Outlines of the elements of one surface side, and the vertices that they come to share.
//!
//! The light at a vertex is asked a little inside its elements (see [`INSET`]): exactly on the
//! edge a receiver lies in the plane of the next wall, and rounding decides what it sees.
//!
//! Source: [Baum91] for the requirements on a mesh; the split by mutual sight is ours.

use crate::long_edges::halve;
use crate::places::{Places, Sources};
use crate::sets::Sets;
use luxel_core::{Buckets, Front, Patch, Scene, Shape, Side, Vec2, Vec3};
use luxel_gather::Receiver;
use luxel_transport::{Ray, RayCaster};
use std::ops::Range;

/// How far a receiver moves from a corner towards the centre of its element, as a share.
pub(crate) const INSET: f32 = 0.1;

/// Most vertices that dividing long edges may add, as a multiple of those that are there.
const MOST_ADDED: usize = 4;

/// Facets of a cluster whose normals differ by less than this share a vertex: cosine of 30 degrees.
const COS_CREASE: f32 = 0.866;

/// More elements than this around one vertex (the pole of a sphere) are not tested for sight.
const MAX_RING: usize = 16;

/// A finished vertex.
pub(crate) struct Vertex {
    pub position: Vec3,
    pub uv: Vec2,
    pub receiver: Receiver,
    /// Elements around it.
    pub elements: Vec<u32>,
}

/// What one part comes to: facets of clusters, then flat triangles, then pairs of them.
pub(crate) struct Built {
    pub vertices: Vec<Vertex>,
    pub facets: Vec<Drawn<3>>,
    pub triangles: Vec<Drawn<3>>,
    /// Corners of plain quadrilaterals in order.
    pub quads: Vec<Drawn<4>>,
}

/// Corners of something drawn.
#[derive(Clone, Copy)]
pub(crate) struct Drawn<const N: usize> {
    pub corners: [u32; N],
    /// A source triangle of the patch that it lies in; of a facet the one that it is.
    pub source: u32,
}

impl Built {
    /// Divides what has long edges; facets stay as the source has them.
    pub fn divided(mut self, longest_m: f32) -> Built {
        let positions: Vec<Vec3> = self.vertices.iter().map(|v| v.position).collect();
        let is_long =
            |a: u32, b: u32| (positions[a as usize] - positions[b as usize]).length() > longest_m;
        // The free diagonal of a quadrilateral does not count.
        self.quads.retain(|&Drawn { corners, source }| {
            let [a, b, c, d] = corners;
            let long = is_long(a, b) || is_long(b, c) || is_long(c, d) || is_long(d, a);
            if long {
                let halves = [[a, b, c], [a, c, d]];
                self.triangles
                    .extend(halves.map(|corners| Drawn { corners, source }));
            }
            !long
        });
        let most = MOST_ADDED * positions.len();
        let first = positions.len();
        let (triangles, middles) = halve(self.triangles, &positions, longest_m, most);
        self.triangles = triangles;
        for m in &middles {
            let [a, b] = m.between.map(|v| &self.vertices[v as usize]);
            // Those on both sides of the edge, which both ends touch.
            let mut elements = a.elements.clone();
            elements.retain(|e| b.elements.contains(e));
            let vertex = Vertex {
                position: m.position,
                uv: 0.5 * (a.uv + b.uv),
                receiver: Receiver {
                    position: Vec3::ZERO,
                    normal: a.receiver.normal,
                },
                elements,
            };
            self.vertices.push(vertex);
        }
        // As at corners: a little inside the triangles around, which cancels on inner edges.
        let mut around = vec![(Vec3::ZERO, 0.0); middles.len()];
        for t in self.triangles.iter().map(|t| t.corners) {
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

/// A corner of an element's outline at a place.
struct Corner {
    place: u32,
    element: u32,
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
    source: u32,
}

/// Outlines of one surface side.
pub(crate) struct Outlines {
    places: Places,
    corners: Vec<Corner>,
    outlines: Vec<Outline>,
}

impl Outlines {
    pub fn new(scene: &Scene, front: &Front, sources: &Sources, elements: &[u32]) -> Outlines {
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
        let mut b = Outlines {
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
                    b.add_facet(scene, e, c.triangle, patch.side);
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
                e,
                source,
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
    fn add_facet(&mut self, scene: &Scene, element: u32, triangle: u32, side: Side) {
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
            element,
            triangle,
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
        element: u32,
        source: u32,
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
                element,
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
            source,
        });
    }

    pub fn finish(self, caster: Option<&dyn RayCaster>) -> Built {
        let (vertex_of, mut vertices) = self.share(caster);
        let (mut facets, mut triangles, mut quads) = (Vec::new(), Vec::new(), Vec::new());
        for o in &self.outlines {
            let v = &vertex_of[o.corners.start as usize..o.corners.end as usize];
            let first = &self.corners[o.corners.start as usize];
            let source = o.source;
            match *v {
                // Corners closer than the tolerance are one place, and such a facet is a line.
                [a, b, c] if a == b || b == c || c == a => {}
                [a, b, c] if first.flat => triangles.push(Drawn {
                    corners: [a, b, c],
                    source,
                }),
                [a, b, c] => facets.push(Drawn {
                    corners: [a, b, c],
                    source,
                }),
                [a, b, c, d] if self.is_convex(o) => quads.push(Drawn {
                    corners: [a, b, c, d],
                    source,
                }),
                _ => {
                    let hub = vertices.len() as u32;
                    let receiver = Receiver {
                        position: o.centre,
                        normal: first.normal,
                    };
                    vertices.push(Vertex {
                        position: o.centre,
                        uv: o.uv,
                        receiver,
                        elements: vec![first.element],
                    });
                    let rim = (0..v.len()).map(|k| [v[k], v[(k + 1) % v.len()]]);
                    let fan = rim.filter(|[a, b]| a != b).map(|[a, b]| [hub, a, b]);
                    triangles.extend(fan.map(|corners| Drawn { corners, source }));
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
        let places = self.corners.iter().map(|c| c.place as usize);
        let by_place = Buckets::new(self.places.position.len(), places.zip(0..));
        let mut vertex_of = vec![u32::MAX; self.corners.len()];
        let mut vertices = Vec::new();
        // In runs of places, so that the segments of a million elements are never held at once.
        const RUN: usize = 1 << 14;
        for run in (0..self.places.position.len()).step_by(RUN) {
            let places = run..(run + RUN).min(self.places.position.len());
            let blocked = self.blocked_pairs(&by_place, places.clone(), caster);
            let mut next = 0;
            for place in places {
                let ring = by_place.of(place);
                let mut group = Sets::new(ring.len());
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
                            group.join(i as u32, j as u32);
                        }
                    }
                }
                for lead in 0..ring.len() as u32 {
                    if group.lead(lead) != lead {
                        continue;
                    }
                    let members: Vec<u32> = (lead..ring.len() as u32)
                        .filter(|&k| group.lead(k) == lead)
                        .map(|k| ring[k as usize])
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
        by_place: &Buckets,
        places: Range<usize>,
        caster: Option<&dyn RayCaster>,
    ) -> Vec<bool> {
        let Some(caster) = caster else {
            return Vec::new();
        };
        let mut segments = Vec::new();
        for place in places {
            let ring = by_place.of(place);
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
            elements: corners().map(|c| c.element).collect(),
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
