//! Critical events drawn on the receivers: where umbra and penumbra end.
//!
//! Each source is held against each edge that can cast a shadow. Seen along the edge the source
//! fills an angle; its two limits are the planes that touch it (VE: a vertex of the source, the
//! edge). A plane counts if the faces at the edge lie on one side of it. In the same way each edge
//! of a flat source and each vertex of an occluder span a plane (EV). In such a plane light leaves
//! the source's vertex (edge) and passes the occluder's edge (vertex): a fan of lines. Some lines
//! of the fan are cast as rays, a hair's breadth outside the occluder. Where the first thing that
//! they meet beyond it is a lit receiver, the event is visible there; between two rays that meet
//! different things the place of the change is halved down. The line itself is the exact
//! projection of the fan onto the receiver's plane.
//!
//! What is narrower than the distance of two rays can be missed: a share of 1/6 of an occluder's
//! edge, or a quarter of an element for longer ones. The work is one look at each pair of source
//! and edge, and rays for those that count; both are bounded.
//!
//! Source: [Heckbert92] for VE and EV wedges and their visibility; [Nishita85] for the limits.
//! Differs: visibility by rays, not by clipping wedges.

use super::edges::{Edge, Vertex, edges};
use super::sources::{Eye, Source, sources};
use crate::contact::{Contact, Groups, Tree, drop_small, touches};
use crate::flat::{NONE, Plane};
use crate::sides::lit_side;
use luxel_core::{DVec3, Scene, Warnings};
use luxel_transport::{Hit, Ray, RayCaster};
use rayon::prelude::*;

/// Sources that cast lines: the strongest.
const MOST_SOURCES: usize = 64;
/// Pairs of source and edge that are looked at (about 0.3 s).
const MOST_PAIRS: usize = 1 << 19;
/// Events that are traced, of some 10 to 100 rays each (about 2 s).
const MOST_EVENTS: usize = 1 << 15;
/// Edges shorter than this share of an element's edge cast no lines.
const SHORTEST: f64 = 0.25;
/// Rays over an event: fewest, for each element's edge, most.
const RAYS: [f64; 3] = [6.0, 4.0, 64.0];
/// Halvings of the place where an event becomes visible: 1e-8 of the distance of two rays.
const HALVINGS: u32 = 26;
/// Distance of the rays from the occluder, in [`RayCaster::offset_m`].
const CLEARANCE: f64 = 4.0;

/// A plane that touches source and occluder: at parameter `s` light goes from `eyes` through
/// `passed`, of which one pair is a single point.
#[derive(Clone, Debug)]
struct Event {
    source: usize,
    eyes: [Eye; 2],
    passed: [DVec3; 2],
    /// Unit normal of the plane, away from the occluder.
    clear: DVec3,
    /// Rank: flux times length.
    weight: f64,
}

/// Shadow lines on the `groups`, each with its weight (below infinity), as triangles of the
/// groups see them. `element_m` is the edge of an element. Warns of what is left out.
pub(crate) fn shadow_lines(
    scene: &Scene,
    caster: &dyn RayCaster,
    groups: &Groups,
    blocks: &[bool],
    tolerance_m: f64,
    element_m: f64,
    warnings: &mut Warnings,
) -> Vec<Contact> {
    let mut all = sources(scene, tolerance_m);
    let sources_left_out = all.len().saturating_sub(MOST_SOURCES);
    all.truncate(MOST_SOURCES);
    if all.is_empty() {
        return Vec::new();
    }
    let most = MOST_PAIRS / all.len();
    let (edges, vertices, edges_left_out) = edges(scene, blocks, SHORTEST * element_m, most);
    let mut events = events(&all, &edges, &vertices, tolerance_m);
    events.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let events_left_out = events.len().saturating_sub(MOST_EVENTS);
    events.truncate(MOST_EVENTS);
    let place = scene.name.as_str();
    warnings.add(
        place,
        "weak luminaires cast no shadow lines: too many",
        sources_left_out,
    );
    warnings.add(
        place,
        "short edges cast no shadow lines: too many",
        edges_left_out,
    );
    warnings.add(
        place,
        "shadow lines were not searched: too many edges before luminaires",
        events_left_out,
    );

    let look = Look {
        scene,
        caster,
        groups,
        sources: &all,
        tolerance_m,
        element_m,
        far_m: 2.0 * scene.diagonal() as f64,
    };
    let large: Vec<u32> = (0..scene.triangles.len() as u32)
        .filter(|&t| groups.of[t as usize] != NONE)
        .collect();
    let tree = Tree::new(scene, large, tolerance_m as f32);
    let whole: f64 = all.iter().map(|s| s.flux).sum();
    let mut lines: Vec<Contact> = events
        .par_iter()
        .flat_map_iter(|event| {
            let share = all[event.source].flux / whole;
            let mut out = Vec::new();
            for (group, ends) in look.trace(event) {
                let [p, q] = ends.map(|p| p.as_vec3());
                tree.each_near([p, q, q], |t| {
                    if groups.of[t as usize] == group && touches(scene, t, ends, tolerance_m) {
                        let weight = share * (ends[1] - ends[0]).length();
                        out.push(Contact {
                            group,
                            triangle: t,
                            ends,
                            weight,
                        });
                    }
                });
            }
            out
        })
        .collect();
    let key = |c: &Contact| (c.group, c.triangle, c.bits());
    lines.par_sort_by_key(key);
    lines.dedup_by_key(|c| key(c));
    drop_small(lines, element_m)
}

fn events(sources: &[Source], edges: &[Edge], vertices: &[Vertex], tolerance_m: f64) -> Vec<Event> {
    let mut all: Vec<Event> = edges
        .par_iter()
        .flat_map_iter(|edge| {
            let mut out = Vec::new();
            for (i, source) in sources.iter().enumerate() {
                edge_events(i, source, edge, tolerance_m, &mut out);
            }
            out
        })
        .collect();
    all.par_extend(vertices.par_iter().flat_map_iter(|vertex| {
        let mut out = Vec::new();
        for (i, source) in sources.iter().enumerate().filter(|s| s.1.is_flat) {
            vertex_events(i, source, vertex, tolerance_m, &mut out);
        }
        out
    }));
    all
}

/// The side of a plane on which all `corners` lie, rim allowed: +1 or -1. `None` if they lie on
/// both, or all in it.
fn one_side(origin: DVec3, normal: DVec3, corners: &[DVec3]) -> Option<f64> {
    let (mut low, mut high) = (0.0f64, 0.0f64);
    for &c in corners {
        // Corners are rounded to f32.
        let rim = 1e-6 * (c - origin).length() + 2e-7 * c.abs().max_element();
        let d = (c - origin).dot(normal);
        if d.abs() > rim {
            low = low.min(d);
            high = high.max(d);
        }
    }
    match (low < 0.0, high > 0.0) {
        (false, true) => Some(1.0),
        (true, false) => Some(-1.0),
        _ => None,
    }
}

/// VE: the limits of a source as seen past an edge.
fn edge_events(i: usize, source: &Source, edge: &Edge, tolerance_m: f64, out: &mut Vec<Event>) {
    let [a, b] = edge.ends;
    let along = (b - a).normalize_or_zero();
    let across = |r: DVec3| r - along * r.dot(along);
    let mut add = |eye: Eye, normal: DVec3| {
        if let Some(side) = one_side(a, normal, &edge.opposite) {
            out.push(Event {
                source: i,
                eyes: [eye; 2],
                passed: edge.ends,
                clear: -side * normal,
                weight: source.flux * edge.length(),
            });
        }
    };
    if let [only] = source.eyes[..] {
        let towards = across(match only {
            Eye::At(p) => p - a,
            Eye::Along(d) => -d,
        });
        if towards.length() > 1e-6 {
            add(only, along.cross(towards).normalize_or_zero());
        }
        return;
    }
    // Angles around the edge, from the middle of the source.
    let seen: Vec<(DVec3, DVec3)> = source
        .eyes
        .iter()
        .filter_map(|e| match *e {
            Eye::At(p) => Some((p, across(p - a))),
            Eye::Along(_) => None,
        })
        .collect();
    let middle = seen.iter().map(|s| s.1).sum::<DVec3>() / seen.len().max(1) as f64;
    let near = seen.iter().any(|s| s.1.length() <= tolerance_m);
    if near || middle.length() <= tolerance_m {
        return; // The edge touches the source or passes through it.
    }
    let x = middle.normalize();
    let y = along.cross(x);
    let angles: Vec<f64> = seen.iter().map(|s| s.1.dot(y).atan2(s.1.dot(x))).collect();
    let low = angles.iter().copied().fold(f64::INFINITY, f64::min);
    let high = angles.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if high - low > 3.1 {
        return;
    }
    let limits: &[f64] = if high - low < 1e-7 {
        &[low]
    } else {
        &[low, high]
    };
    for &limit in limits {
        let normal = y * limit.cos() - x * limit.sin();
        // A source's edge parallel to this edge: both its ends are in the plane, and between the
        // fans from them lie those of the vertices.
        let mut ends: [Option<(f64, DVec3)>; 2] = [None; 2];
        for (k, &(p, r)) in seen.iter().enumerate() {
            if (angles[k] - limit).abs() > 1e-6 && r.dot(normal).abs() > 1e-7 * p.length() {
                continue;
            }
            let place = (p - a).dot(along);
            if ends[0].is_none_or(|e| place < e.0) {
                ends[0] = Some((place, p));
            }
            if ends[1].is_none_or(|e| place > e.0) {
                ends[1] = Some((place, p));
            }
        }
        if let [Some(p), Some(q)] = ends {
            add(Eye::At(p.1), normal);
            if p.1 != q.1 {
                add(Eye::At(q.1), normal);
            }
        }
    }
}

/// EV: the edges of a flat source as seen past a vertex.
fn vertex_events(
    i: usize,
    source: &Source,
    vertex: &Vertex,
    tolerance_m: f64,
    out: &mut Vec<Event>,
) {
    let n = source.eyes.len();
    for k in 0..n {
        let (Eye::At(p), Eye::At(q)) = (source.eyes[k], source.eyes[(k + 1) % n]) else {
            return;
        };
        let cross = (q - p).cross(vertex.at - p);
        let length = (q - p).length();
        if cross.length() <= tolerance_m * length {
            continue;
        }
        let normal = cross.normalize_or_zero();
        // Only if the whole source is on one side: not from within its plane.
        let eyes: Vec<DVec3> = source
            .eyes
            .iter()
            .filter_map(|e| match *e {
                Eye::At(p) => Some(p),
                Eye::Along(_) => None,
            })
            .collect();
        if one_side(p, normal, &eyes).is_none() {
            continue;
        }
        if let Some(side) = one_side(vertex.at, normal, &vertex.around) {
            out.push(Event {
                source: i,
                eyes: [Eye::At(p), Eye::At(q)],
                passed: [vertex.at; 2],
                clear: -side * normal,
                weight: source.flux * length,
            });
        }
    }
}

impl Event {
    fn passed(&self, s: f64) -> DVec3 {
        // The ends have their own bits: neighbours join there.
        match s {
            0.0 => self.passed[0],
            1.0 => self.passed[1],
            _ => self.passed[0] + (self.passed[1] - self.passed[0]) * s,
        }
    }

    /// Where light comes from at `s`, and the way to what it passes.
    fn line(&self, s: f64, far_m: f64) -> (DVec3, DVec3) {
        let y = self.passed(s);
        match self.eyes {
            [Eye::At(p), Eye::At(q)] => {
                let eye = match s {
                    0.0 => p,
                    1.0 => q,
                    _ => p + (q - p) * s,
                };
                (eye, y - eye)
            }
            [Eye::Along(d), _] | [_, Eye::Along(d)] => (y - d * far_m, d * far_m),
        }
    }

    /// Foot of the fan's line at `s` on a plane beyond.
    fn foot(&self, s: f64, far_m: f64, plane: &Plane) -> Option<DVec3> {
        let (eye, way) = self.line(s, far_m);
        let t = -plane.distance(eye) / way.dot(plane.normal);
        // From the passed point, so that it does not move with the eye.
        let foot = self.passed(s) + way * (t - 1.0);
        (t.is_finite() && foot.is_finite()).then_some(foot)
    }
}

/// What is needed to trace an event.
struct Look<'a> {
    scene: &'a Scene,
    caster: &'a dyn RayCaster,
    groups: &'a Groups,
    sources: &'a [Source],
    tolerance_m: f64,
    element_m: f64,
    /// What lies so far away is outside of the scene.
    far_m: f64,
}

impl Look<'_> {
    fn ray(&self, event: &Event, s: f64) -> Ray {
        let offset = self.caster.offset_m() as f64;
        let (eye, way) = event.line(s, self.far_m);
        let way = way + event.clear * (CLEARANCE * offset);
        Ray {
            origin: eye.as_vec3(),
            t_min: (CLEARANCE * offset / way.length()) as f32,
            direction: way.as_vec3(),
            t_max: f32::INFINITY,
        }
    }

    /// The group on which the event is visible at `s`; `NONE` where it is hidden, or meets nothing
    /// that can be cut.
    fn group(&self, event: &Event, s: f64, hit: &Hit) -> u32 {
        let (_, way) = event.line(s, self.far_m);
        // What is met at the occluder is the occluder, or what it stands on.
        let beyond = 1.0 + 4.0 * self.tolerance_m / way.length();
        if !hit.is_hit() || hit.t as f64 <= beyond || !self.sources[event.source].shines(way) {
            return NONE;
        }
        let t = hit.triangle as usize;
        match lit_side(self.scene.finish_of(t), hit.side) {
            Some(lit) if lit.reflects => self.groups.of[t],
            _ => NONE,
        }
    }

    fn at(&self, event: &Event, s: f64) -> u32 {
        let mut hit = [Hit::MISS];
        self.caster.closest(&[self.ray(event, s)], &mut hit);
        self.group(event, s, &hit[0])
    }

    /// Place between `from`, where `group` is met, and `to`, where it is not, at which that ends.
    fn end(&self, event: &Event, group: u32, mut from: f64, mut to: f64) -> f64 {
        for _ in 0..HALVINGS {
            let middle = 0.5 * (from + to);
            if self.at(event, middle) == group {
                from = middle;
            } else {
                to = middle;
            }
        }
        from
    }

    /// Where the event is visible: group and ends of each line.
    fn trace(&self, event: &Event) -> Vec<(u32, [DVec3; 2])> {
        let [p, q] = [0.0, 1.0].map(|s| event.line(s, self.far_m));
        let size = (event.passed[1] - event.passed[0])
            .length()
            .max((q.0 - p.0).length());
        let n = (RAYS[1] * size / self.element_m).clamp(RAYS[0], RAYS[2]) as usize;
        // Not at the ends themselves, where neighbouring faces begin.
        const RIM: f64 = 1e-4;
        let places: Vec<f64> = (0..=n)
            .map(|i| RIM + (1.0 - 2.0 * RIM) * i as f64 / n as f64)
            .collect();
        let rays: Vec<Ray> = places.iter().map(|&s| self.ray(event, s)).collect();
        let mut hits = vec![Hit::MISS; rays.len()];
        self.caster.closest(&rays, &mut hits);
        let met: Vec<u32> = places
            .iter()
            .zip(&hits)
            .map(|(&s, hit)| self.group(event, s, hit))
            .collect();
        let mut out = Vec::new();
        let mut first = 0;
        for run in met.chunk_by(|a, b| a == b) {
            let (group, last) = (run[0], first + run.len() - 1);
            if group != NONE {
                let from = match first {
                    0 => 0.0,
                    _ => self.end(event, group, places[first], places[first - 1]),
                };
                let to = match last {
                    _ if last == n => 1.0,
                    _ => self.end(event, group, places[last], places[last + 1]),
                };
                let plane = &self.groups.planes[group as usize];
                let ends = [from, to].map(|s| event.foot(s, self.far_m, plane));
                if let [Some(a), Some(b)] = ends
                    && (b - a).length() > self.tolerance_m
                {
                    out.push((
                        group,
                        if a.to_array() <= b.to_array() {
                            [a, b]
                        } else {
                            [b, a]
                        },
                    ));
                }
            }
            first = last + 1;
        }
        out
    }
}
