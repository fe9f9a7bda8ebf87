//! Geometry conformed to light: large surfaces are cut where others touch or cross them.
//!
//! A partition that stands on an undivided floor would share the floor's elements between its two
//! rooms, and light would pass under it. So each large flat group of triangles is cut along the
//! lines where others touch or cross it; pieces keep surface, source triangle and texture
//! coordinates. Every triangle that has a cut edge is divided at the same points (equal bits), so
//! no gap opens. Pieces on both sides of a contact line share no edge *by index*: that is how the
//! mesh strategies know not to join them again.
//!
//! Left alone, since what leaks there is bounded by its size: triangles below `min_area_m2` and
//! outlines of contact below `min_contact_m` (a chair's leg).
//!
//! Discontinuity lines of zeroth order in the sense of [Heckbert92]: contact edges, found
//! geometrically. See `contact` for the search and `cut` for the triangulation. For the
//! discontinuity mesh the limits of umbra and penumbra cut as well (see
//! [`discontinuity`](crate::discontinuity)), and what they cut is filled with triangles about as
//! large as elements. Contact lines go first: what is left out of shadow lines leaks nothing.

use crate::contact::{Contact, Contacts, Groups, Place, contacts, place, root};
use crate::contract::MeshSettings;
use crate::cut::{
    Effect, End, Filling, Frame, Pieces, Weights, crossing, cut, edges_of, fan, on_edge,
};
use crate::discontinuity::events::shadow_lines;
use crate::flat::{NONE, flats};
use crate::sides::{SIDES, lit_side};
use luxel_core::{DVec3, Scene, Vec2, Vec3, Warnings};
use luxel_transport::Bvh;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// What is cut, and how exactly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrepareSettings {
    /// Distance below which things touch and points are the same, metres. At most 1e-4 of the
    /// scene's diagonal and at least eight units in the last place of its coordinates are used.
    pub tolerance_m: f32,
    /// Parallel faces nearer than this shut light in between, metres.
    pub gap_m: f32,
    /// Smaller triangles are not cut, m².
    pub min_area_m2: f32,
    /// Smaller outlines of contact do not cut, metres (diagonal).
    pub min_contact_m: f32,
    /// Most contact lines on one triangle; the longest are kept, with a warning. Crossings of lines
    /// are bounded too, by the size of the triangle ([`CROSSINGS`]).
    pub max_lines: usize,
    /// The mesh whose elements are to follow the limits of shadows; `None` draws contacts alone.
    pub shadows: Option<MeshSettings>,
}

/// Metres of shadow lines on a triangle: this many element edges, and so many times the length at
/// which lines an element's edge apart fill it.
const SHADOW_LENGTH: [f64; 2] = [4.0, 1.0];

/// Most places where lines on a triangle cross each other: this many, and as many again for each
/// `min_area_m2` of it. Each makes two pieces, so that pieces stay in proportion to elements.
const CROSSINGS: [f64; 2] = [16.0, 1.0];

/// A gap counts as contact up to this share of an element's edge: what is lit within would be
/// spread over the part of the element that lies outside.
const GAP: f32 = 0.1;
/// And not more than this, metres: what is thicker has sides that touch.
const WIDEST_GAP_M: f32 = 0.005;

impl PrepareSettings {
    /// What suits a mesh: triangles from a quarter of an element on, contacts from an
    /// element's edge on.
    pub fn for_mesh(mesh: &MeshSettings) -> PrepareSettings {
        PrepareSettings {
            tolerance_m: 2e-4,
            gap_m: (GAP * mesh.max_area_m2.sqrt()).min(WIDEST_GAP_M),
            min_area_m2: 0.25 * mesh.max_area_m2,
            min_contact_m: mesh.max_area_m2.sqrt(),
            max_lines: 2000,
            shadows: None,
        }
    }
}

/// The scene with its large surfaces cut along contact lines.
///
/// Lights, finishes and surfaces stay; triangles and positions are added, and the ranges of the
/// surfaces follow. A scene without contacts comes back as it was. Warns of lines that were left
/// out, of triangles that could not be cut, and of large triangles that lie in the place of
/// others (a rug exactly in the floor): those are not solved.
pub fn prepare(scene: Scene, settings: &PrepareSettings, warnings: &mut Warnings) -> Scene {
    let largest = scene.largest_coordinate() as f64;
    let tolerance = (settings.tolerance_m as f64)
        .min(1e-4 * scene.diagonal() as f64)
        .max(largest * 8.0 * f32::EPSILON as f64);
    let finish = |t: usize| scene.finish_of(t);
    let lit: Vec<bool> = (0..scene.triangles.len())
        .map(|t| {
            SIDES
                .iter()
                .any(|&side| lit_side(finish(t), side).is_some())
        })
        .collect();
    let blocks: Vec<bool> = (0..scene.triangles.len())
        .map(|t| !finish(t).transparent)
        .collect();
    let groups = Groups::of(&scene, &lit, settings.min_area_m2, tolerance);
    let Contacts {
        mut lines,
        doubled,
        mut left_out,
        unsearched,
    } = contacts(
        &scene,
        &groups,
        &blocks,
        tolerance,
        settings.gap_m as f64,
        settings.min_contact_m,
    );
    warnings.add(
        scene.name.as_str(),
        "large triangles lie in the same place as others; the light there is uncertain",
        doubled,
    );
    warnings.add(
        scene.name.as_str(),
        "triangles were not searched for contacts: too many meet each other; light may leak there",
        unsearched,
    );
    let mut scene = scene;
    if let Some(mesh) = &settings.shadows {
        let shared = Arc::new(scene);
        let caster = Bvh::build(&shared);
        let element_m = (mesh.max_area_m2 as f64).sqrt();
        let shadows = shadow_lines(
            &shared, &caster, &groups, &blocks, tolerance, element_m, warnings,
        );
        drop(caster);
        scene = Arc::try_unwrap(shared).unwrap_or_else(|shared| (*shared).clone());
        lines.extend(shadows);
        lines.sort_by_key(|c| (c.group, c.triangle));
    }
    if lines.is_empty() {
        return scene;
    }
    let mut areas = vec![0.0f32; groups.planes.len()];
    for t in (0..scene.triangles.len()).filter(|&t| groups.of[t] != NONE) {
        areas[groups.of[t] as usize] += scene.area(t);
    }

    let mut shadows_left_out = 0;
    let mut edges = Edges::default();
    let mut cuts: Vec<Cut> = Vec::new();
    for run in lines.chunk_by(|a, b| a.triangle == b.triangle) {
        let t = run[0].triangle;
        let frame = Frame::new(scene.corners(t as usize).map(|p| p.as_dvec3()));
        let mut inside: Vec<Inside> = Vec::new();
        let spacing = settings.shadows.map(|mesh| {
            let region = areas[groups.of[t as usize] as usize] / mesh.max_per_region.max(1) as f32;
            (mesh.max_area_m2.max(region) as f64).sqrt()
        });
        let kept;
        let run = match spacing {
            Some(spacing) => {
                let area = scene.area(t as usize) as f64;
                let most_m = SHADOW_LENGTH[0] * spacing + SHADOW_LENGTH[1] * area / spacing;
                kept = keep_heaviest(run, most_m);
                shadows_left_out += run.len() - kept.len();
                &kept
            }
            None => run,
        };
        for line in run {
            match frame.effect(line.ends, tolerance) {
                Effect::Nothing => {}
                Effect::Along(k, from, to) => {
                    // Only between pieces of one group does it matter on which side one is.
                    let o = groups.next[t as usize][k];
                    if o != NONE && groups.of[o as usize] == line.group {
                        edges.add_run(&scene, t, k, from, to);
                    }
                }
                Effect::Cut(a, b) => {
                    inside.push(Inside {
                        weight: line.weight,
                        length: line.length(),
                        a,
                        b,
                    });
                }
            }
        }
        let size = scene.area(t as usize) / settings.min_area_m2;
        let crossings = CROSSINGS[0] + CROSSINGS[1] * size as f64;
        let dropped = thin(&mut inside, settings.max_lines, crossings as usize);
        left_out += dropped[0];
        shadows_left_out += dropped[1];
        for line in &inside {
            for end in [line.a, line.b] {
                if let End::Edge(k, at) = end {
                    edges.add(&scene, t, k, at);
                }
            }
        }
        if !inside.is_empty() {
            let has_shadow = inside.iter().any(|l| l.weight.is_finite());
            if has_shadow {
                // Contact lines first: nothing is in their way then.
                inside.sort_by(|a, b| b.weight.total_cmp(&a.weight));
            }
            cuts.push(Cut {
                triangle: t,
                contacts: inside.iter().filter(|l| l.weight.is_infinite()).count(),
                lines: inside.into_iter().map(|l| (l.a, l.b)).collect(),
                spacing_m: spacing.filter(|_| has_shadow),
            });
        }
    }
    warnings.add(
        scene.name.as_str(),
        "contact lines left out: too many on one triangle; light may leak along them",
        left_out,
    );
    warnings.add(
        scene.name.as_str(),
        "shadow lines left out: too many on one triangle",
        shadows_left_out,
    );
    if edges.map.is_empty() && cuts.is_empty() {
        return scene;
    }
    // Lines came group by group; a triangle is in one group only.
    cuts.sort_unstable_by_key(|c| c.triangle);
    edges.settle(tolerance);
    edges.fill(&scene, &lit, &cuts);
    let (pieces, failed) = divide(&scene, &edges, &cuts, tolerance);
    warnings.add(
        scene.name.as_str(),
        "triangles could not be cut along contact lines; light may leak there",
        failed,
    );
    rebuild(scene, &groups, pieces)
}

/// All contact lines of a triangle, and the heaviest shadow lines up to `most_m` in all.
fn keep_heaviest(run: &[Contact], most_m: f64) -> Vec<Contact> {
    let mut sorted = run.to_vec();
    sorted.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let mut sum = 0.0;
    sorted.retain(|c| {
        if c.weight.is_finite() {
            sum += c.length();
        }
        sum <= most_m
    });
    sorted
}

/// A line within a triangle.
struct Inside {
    weight: f64,
    length: f64,
    a: End,
    b: End,
}

/// Leaves the heaviest lines of a triangle, of contact lines the longest, as many as allowed; how
/// many contact and shadow lines are dropped.
fn thin(lines: &mut Vec<Inside>, most_lines: usize, most_crossings: usize) -> [usize; 2] {
    let harmless = lines.len() * lines.len().saturating_sub(1) / 2 <= most_crossings;
    if lines.len() <= most_lines && harmless {
        return [0, 0];
    }
    let count = |lines: &[Inside]| {
        let contacts = lines.iter().filter(|l| l.weight.is_infinite()).count();
        [contacts, lines.len() - contacts]
    };
    let before = count(lines);
    lines.sort_by(|a, b| {
        let heavier = b.weight.total_cmp(&a.weight);
        heavier.then(b.length.total_cmp(&a.length))
    });
    lines.truncate(most_lines);
    let placed: Vec<[Weights; 2]> = lines
        .iter()
        .map(|l| [l.a.weights(), l.b.weights()])
        .collect();
    let mut crossings = 0;
    let kept = placed.iter().enumerate().position(|(i, &line)| {
        crossings += placed[..i]
            .iter()
            .filter(|&&o| crossing(line, o).is_some())
            .count();
        crossings > most_crossings
    });
    lines.truncate(kept.unwrap_or(lines.len()));
    let after = count(lines);
    [before[0] - after[0], before[1] - after[1]]
}

/// Lines inside one triangle.
struct Cut {
    triangle: u32,
    lines: Vec<(End, End)>,
    /// The first so many of them are contact lines.
    contacts: usize,
    /// Distance of the points with which it is filled, metres, if it has shadow lines.
    spacing_m: Option<f64>,
}

/// Points on the edges of triangles, the same for all triangles of an edge.
#[derive(Default)]
struct Edges {
    /// From the edge's lesser place to its greater.
    map: HashMap<(Place, Place), OnEdge>,
    touched: HashSet<Place>,
}

#[derive(Default)]
struct OnEdge {
    length: f64,
    /// Places along it, 0..1 without the ends.
    at: Vec<f64>,
    /// Where a contact line runs along it.
    runs: Vec<(f64, f64)>,
}

impl Edges {
    /// Key of edge `k`, and whether the triangle runs along it the other way.
    fn key(scene: &Scene, t: u32, k: usize) -> ((Place, Place), bool) {
        let c = scene.corners(t as usize);
        let (a, b) = (place(c[k]), place(c[(k + 1) % 3]));
        if a <= b {
            ((a, b), false)
        } else {
            ((b, a), true)
        }
    }

    fn entry(&mut self, scene: &Scene, t: u32, k: usize) -> (&mut OnEdge, bool) {
        let (key, turned) = Edges::key(scene, t, k);
        self.touched.extend([key.0, key.1]);
        let c = scene.corners(t as usize);
        let edge = self.map.entry(key).or_default();
        edge.length = (c[(k + 1) % 3] - c[k]).as_dvec3().length();
        (edge, turned)
    }

    fn add(&mut self, scene: &Scene, t: u32, k: usize, at: f64) {
        let (edge, turned) = self.entry(scene, t, k);
        edge.at.push(if turned { 1.0 - at } else { at });
    }

    fn add_run(&mut self, scene: &Scene, t: u32, k: usize, from: f64, to: f64) {
        let (edge, turned) = self.entry(scene, t, k);
        let (from, to) = if turned {
            (1.0 - to, 1.0 - from)
        } else {
            (from, to)
        };
        edge.at.extend([from, to]);
        edge.runs.push((from, to));
    }

    /// Makes points closer than the tolerance one, and those at the ends none.
    fn settle(&mut self, tolerance: f64) {
        for edge in self.map.values_mut() {
            let least = tolerance / edge.length.max(1e-30);
            edge.at.sort_by(f64::total_cmp);
            let mut last = 0.0;
            edge.at.retain(|&t| {
                let keep = t - last > least && 1.0 - t > least;
                if keep {
                    last = t;
                }
                keep
            });
        }
    }

    /// Divides the edges of triangles that are filled into pieces no longer than their spacing.
    ///
    /// A neighbour that is not filled gets a fan of slivers; that does not matter where they are
    /// joined to one parallelogram again, or make no elements. Other edges stay as they are.
    fn fill(&mut self, scene: &Scene, lit: &[bool], cuts: &[Cut]) {
        let mut wanted: HashMap<(Place, Place), f64> = HashMap::new();
        let filled = |t: u32| {
            let i = cuts.binary_search_by_key(&t, |c| c.triangle).ok()?;
            cuts[i].spacing_m
        };
        for cut in cuts {
            let Some(spacing) = cut.spacing_m else {
                continue;
            };
            for k in 0..3 {
                let (key, _) = Edges::key(scene, cut.triangle, k);
                let known = wanted.entry(key).or_insert(spacing);
                *known = known.min(spacing);
            }
        }
        if wanted.is_empty() {
            return;
        }
        let mut joins = vec![false; scene.triangles.len()];
        let flats = flats(scene, lit);
        for flat in flats.list.iter().filter(|f| f.parallelogram) {
            if flat.area >= 0.999 * flat.region_area {
                let run = flat.triangles.start as usize..flat.triangles.end as usize;
                flats.triangles[run]
                    .iter()
                    .for_each(|&t| joins[t as usize] = true);
            }
        }
        let corners: HashSet<Place> = wanted.keys().flat_map(|k| [k.0, k.1]).collect();
        for t in (0..scene.triangles.len() as u32).filter(|&t| lit[t as usize]) {
            let near = scene
                .corners(t as usize)
                .map(|p| corners.contains(&place(p)));
            if joins[t as usize] || near.iter().filter(|&&n| n).count() < 2 || filled(t).is_some() {
                continue;
            }
            for k in 0..3 {
                wanted.remove(&Edges::key(scene, t, k).0);
            }
        }
        for cut in cuts.iter().filter(|c| c.spacing_m.is_some()) {
            for k in 0..3 {
                let (key, _) = Edges::key(scene, cut.triangle, k);
                let Some(spacing) = wanted.remove(&key) else {
                    continue;
                };
                let (edge, _) = self.entry(scene, cut.triangle, k);
                let least = spacing / edge.length;
                let ends = [0.0]
                    .into_iter()
                    .chain(edge.at.iter().copied())
                    .chain([1.0]);
                let ends: Vec<f64> = ends.collect();
                edge.at = ends
                    .windows(2)
                    .flat_map(|w| {
                        let n = ((w[1] - w[0]) / least - 0.01).ceil().max(1.0) as usize;
                        let (from, step) = (w[0], (w[1] - w[0]) / n as f64);
                        (0..n).map(move |i| from + step * i as f64)
                    })
                    .skip(1)
                    .collect();
            }
        }
    }

    fn of(&self, scene: &Scene, t: u32, k: usize) -> Option<(&OnEdge, bool)> {
        let (key, turned) = Edges::key(scene, t, k);
        self.map.get(&key).map(|e| (e, turned))
    }
}

/// Pieces of one triangle with their places.
struct Divided {
    triangle: u32,
    pieces: Pieces,
    /// World position of each point of `pieces`.
    positions: Vec<Vec3>,
}

/// Divides all triangles that are cut or have a cut edge; also how many failed. `cuts` ascend by
/// triangle.
fn divide(scene: &Scene, edges: &Edges, cuts: &[Cut], tolerance: f64) -> (Vec<Divided>, usize) {
    let results: Vec<(Divided, bool)> = (0..scene.triangles.len() as u32)
        .into_par_iter()
        .filter(|&t| {
            let touched = scene
                .corners(t as usize)
                .iter()
                .filter(|&&p| edges.touched.contains(&place(p)))
                .count();
            touched >= 2 && (0..3).any(|k| edges.of(scene, t, k).is_some())
                || cuts.binary_search_by_key(&t, |c| c.triangle).is_ok()
        })
        .map(|t| {
            let cut = cuts.binary_search_by_key(&t, |c| c.triangle);
            divide_one(scene, edges, t, cut.ok().map(|i| &cuts[i]), tolerance)
        })
        .collect();
    let failed = results.iter().filter(|r| r.1).count();
    (results.into_iter().map(|r| r.0).collect(), failed)
}

fn divide_one(
    scene: &Scene,
    edges: &Edges,
    t: u32,
    lines: Option<&Cut>,
    tolerance: f64,
) -> (Divided, bool) {
    let corners = scene.corners(t as usize);
    let frame = Frame::new(corners.map(|p| p.as_dvec3()));
    let mut points = vec![
        Weights { u: 0.0, v: 0.0 },
        Weights { u: 1.0, v: 0.0 },
        Weights { u: 0.0, v: 1.0 },
    ];
    let mut positions = corners.to_vec();
    let mut border: [Vec<u32>; 3] = Default::default();
    let mut places: [Vec<f64>; 3] = Default::default();
    for k in 0..3 {
        let Some((edge, turned)) = edges.of(scene, t, k) else {
            continue;
        };
        let mut at = edge.at.clone();
        if turned {
            at.reverse();
        }
        // From the same end for every triangle of the edge: the bits must agree.
        let (a, b) = (corners[k], corners[(k + 1) % 3]);
        let (a, b) = if turned { (b, a) } else { (a, b) };
        for s in at {
            let here = if turned { 1.0 - s } else { s };
            border[k].push(points.len() as u32);
            places[k].push(here);
            points.push(on_edge(k, here));
            positions.push(between(a.as_dvec3(), b.as_dvec3(), s));
        }
    }
    let mut failed = false;
    let mut pieces = None;
    if let Some(lines) = lines {
        let mut inner: Vec<DVec3> = Vec::new();
        let first_inner = points.len() as u32;
        let mut index = |end: End, points: &mut Vec<Weights>, positions: &mut Vec<Vec3>| match end {
            End::Corner(k) => k as u32,
            End::Edge(k, at) => nearest(&border[k], &places[k], k, at),
            End::Inside(w) => {
                let p = frame.point(w);
                match inner.iter().position(|q| q.distance(p) <= tolerance) {
                    Some(i) => first_inner + i as u32,
                    None => {
                        inner.push(p);
                        points.push(w);
                        positions.push(p.as_vec3());
                        points.len() as u32 - 1
                    }
                }
            }
        };
        let pairs: Vec<[u32; 2]> = lines
            .lines
            .iter()
            .map(|&(a, b)| {
                [
                    index(a, &mut points, &mut positions),
                    index(b, &mut points, &mut positions),
                ]
            })
            .collect();
        let filling = Filling {
            contacts: lines.contacts,
            spacing_m: lines.spacing_m,
        };
        pieces = cut(&frame, points.clone(), &pairs, filling, tolerance);
        failed = pieces.as_ref().is_none_or(|p| !p.whole);
        if pieces.is_none() {
            points.truncate(first_inner as usize);
            positions.truncate(first_inner as usize);
        }
    }
    let mut pieces = pieces.unwrap_or_else(|| fan(points, &border));
    for w in &pieces.points[positions.len()..] {
        positions.push(frame.point(*w).as_vec3());
    }
    mark_runs(scene, edges, t, &mut pieces);
    // What rounding to f32 made flat has no area to receive light; what it turned over lies on
    // its neighbours, and its back would face the light.
    pieces.triangles.retain(|(c, _)| {
        let [a, b, c] = c.map(|i| positions[i as usize].as_dvec3());
        let size = (b - a).length().max((c - a).length());
        frame.facing((b - a).cross(c - a)) > 1e-9 * size * size
    });
    (
        Divided {
            triangle: t,
            pieces,
            positions,
        },
        failed,
    )
}

fn between(a: DVec3, b: DVec3, t: f64) -> Vec3 {
    (a + (b - a) * t).as_vec3()
}

/// Index of the border point or corner that stands for the place `at` on edge `k`.
fn nearest(border: &[u32], places: &[f64], k: usize, at: f64) -> u32 {
    let ends = [(0.0, k as u32), (1.0, (k as u32 + 1) % 3)];
    let all = places
        .iter()
        .copied()
        .zip(border.iter().copied())
        .chain(ends);
    let mut best = (f64::INFINITY, k as u32);
    for (t, i) in all {
        if (t - at).abs() < best.0 {
            best = ((t - at).abs(), i);
        }
    }
    best.1
}

/// Marks border edges of the pieces along which a contact line runs.
fn mark_runs(scene: &Scene, edges: &Edges, t: u32, pieces: &mut Pieces) {
    let along = |k: usize, w: Weights| match k {
        0 => w.u,
        1 => w.v,
        _ => 1.0 - w.v,
    };
    for k in 0..3 {
        let Some((edge, turned)) = edges.of(scene, t, k).filter(|(e, _)| !e.runs.is_empty()) else {
            continue;
        };
        for (corners, barriers) in &mut pieces.triangles {
            for i in 0..3 {
                let [a, b] = [corners[i], corners[(i + 1) % 3]].map(|c| pieces.points[c as usize]);
                if edges_of(a)[k] && edges_of(b)[k] {
                    let middle = 0.5 * (along(k, a) + along(k, b));
                    let middle = if turned { 1.0 - middle } else { middle };
                    barriers[i] |= edge.runs.iter().any(|r| r.0 < middle && middle < r.1);
                }
            }
        }
    }
}

/// A triangle of the new scene.
struct New {
    corners: [u32; 3],
    uvs: [Vec2; 3],
    source: u32,
}

fn rebuild(mut scene: Scene, groups: &Groups, divided: Vec<Divided>) -> Scene {
    let mut touched = vec![false; groups.planes.len()];
    for d in &divided {
        let group = groups.of[d.triangle as usize];
        if group != NONE {
            touched[group as usize] = true;
        }
    }
    // Corners of all pieces of a touched group, group by group; the rest as they come.
    let mut members: Vec<(u32, u32)> = (0..scene.triangles.len() as u32)
        .map(|t| (groups.of[t as usize], t))
        .filter(|&(g, _)| g != NONE && touched[g as usize])
        .collect();
    members.sort_unstable();
    let find = |t: u32| {
        divided
            .binary_search_by_key(&t, |d| d.triangle)
            .ok()
            .map(|i| &divided[i])
    };
    let mut positions = std::mem::take(&mut scene.positions);
    let mut fresh: HashMap<u32, Vec<New>> = HashMap::new();
    {
        // `scene.corners` needs the positions; these closures use them directly.
        let uv = |t: usize, w: Weights| {
            if scene.uvs.is_empty() {
                Vec2::ZERO
            } else {
                scene.uv_at(t, w.u as f32, w.v as f32)
            }
        };
        for run in members.chunk_by(|a, b| a.0 == b.0) {
            let mut loose: Vec<(u32, [Weights; 3], [Vec3; 3], [bool; 3])> = Vec::new();
            for &(_, t) in run {
                match find(t) {
                    Some(d) => {
                        for (c, barriers) in &d.pieces.triangles {
                            loose.push((
                                t,
                                c.map(|i| d.pieces.points[i as usize]),
                                c.map(|i| d.positions[i as usize]),
                                *barriers,
                            ));
                        }
                    }
                    None => {
                        let w = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(|(u, v)| Weights { u, v });
                        let p = scene.triangles[t as usize].map(|i| positions[i as usize]);
                        loose.push((t, w, p, [false; 3]));
                    }
                }
            }
            let corners = number(
                &loose.iter().map(|l| (l.2, l.3)).collect::<Vec<_>>(),
                &mut positions,
            );
            for ((t, w, _, _), corners) in loose.iter().zip(corners) {
                fresh.entry(*t).or_default().push(New {
                    corners,
                    uvs: w.map(|w| uv(*t as usize, w)),
                    source: scene.source_triangle[*t as usize],
                });
            }
        }
        // Neighbours outside the groups: only their edges were divided.
        let mut ids: HashMap<Place, u32> = HashMap::new();
        for d in divided
            .iter()
            .filter(|d| groups.of[d.triangle as usize] == NONE)
        {
            let t = d.triangle as usize;
            let index: Vec<u32> = d
                .positions
                .iter()
                .enumerate()
                .map(|(i, &p)| {
                    if i < 3 {
                        return scene.triangles[t][i];
                    }
                    *ids.entry(place(p)).or_insert_with(|| {
                        positions.push(p);
                        positions.len() as u32 - 1
                    })
                })
                .collect();
            for (c, _) in &d.pieces.triangles {
                fresh.entry(d.triangle).or_default().push(New {
                    corners: c.map(|i| index[i as usize]),
                    uvs: c.map(|i| uv(t, d.pieces.points[i as usize])),
                    source: scene.source_triangle[t],
                });
            }
        }
    }
    let mut new = Scene {
        positions,
        ..Scene::default()
    };
    let has_uvs = !scene.uvs.is_empty();
    for t in 0..scene.triangles.len() {
        let whole;
        let list: &[New] = match fresh.get(&(t as u32)) {
            Some(list) => list,
            None => {
                whole = [New {
                    corners: scene.triangles[t],
                    uvs: scene.uvs.get(t).copied().unwrap_or([Vec2::ZERO; 3]),
                    source: scene.source_triangle[t],
                }];
                &whole
            }
        };
        for n in list {
            new.triangles.push(n.corners);
            new.surface_of.push(scene.surface_of[t]);
            new.source_triangle.push(n.source);
            if has_uvs {
                new.uvs.push(n.uvs);
            }
        }
    }
    for surface in &mut scene.surfaces {
        surface.triangles = 0..0;
    }
    for (t, id) in new.surface_of.iter().enumerate() {
        let range = &mut scene.surfaces[id.index()].triangles;
        if range.end == 0 {
            range.start = t as u32;
        }
        range.end = t as u32 + 1;
    }
    Scene {
        positions: new.positions,
        triangles: new.triangles,
        uvs: new.uvs,
        surface_of: new.surface_of,
        source_triangle: new.source_triangle,
        ..scene
    }
}

/// Numbers the corners of the pieces of one group: the same place has the same number around a
/// corner as far as no contact line is crossed. New positions are appended.
fn number(pieces: &[([Vec3; 3], [bool; 3])], positions: &mut Vec<Vec3>) -> Vec<[u32; 3]> {
    let mut parent: Vec<usize> = (0..pieces.len() * 3).collect();
    let mut sides: Vec<((Place, Place), u32, u32)> = Vec::with_capacity(pieces.len() * 3);
    for (i, (c, _)) in pieces.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (place(c[k]), place(c[(k + 1) % 3]));
            sides.push(((a.min(b), a.max(b)), i as u32, k as u32));
        }
    }
    sides.sort_unstable();
    let mut barriers = Vec::new();
    for run in sides.chunk_by(|a, b| a.0 == b.0) {
        let [(_, i, k), (_, j, l)] = *run else {
            continue;
        };
        let (p, q) = (3 * i as usize, 3 * j as usize);
        let (k, l) = (k as usize, l as usize);
        if place(pieces[i as usize].0[k]) == place(pieces[j as usize].0[l]) {
            continue; // wound the same way: no neighbours
        }
        // k meets the end of the other edge.
        let pairs = [(p + k, q + (l + 1) % 3), (p + (k + 1) % 3, q + l)];
        if pieces[i as usize].1[k] || pieces[j as usize].1[l] {
            barriers.push(pairs);
            continue;
        }
        for (x, y) in pairs {
            let (x, y) = (root(&mut parent, x), root(&mut parent, y));
            let (low, high) = (x.min(y), x.max(y));
            parent[high] = low;
        }
    }
    let mut id = vec![NONE; parent.len()];
    for corner in 0..parent.len() {
        let head = root(&mut parent, corner);
        if id[head] == NONE {
            id[head] = positions.len() as u32;
            positions.push(pieces[head / 3].0[head % 3]);
        }
        id[corner] = id[head];
    }
    // A contact line whose two ends both hang free: one side gets a corner of its own.
    for [(a, x), (b, y)] in barriers {
        if id[a] == id[x] && id[b] == id[y] {
            id[x] = positions.len() as u32;
            positions.push(pieces[x / 3].0[x % 3]);
        }
    }
    id.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
}
