//! Uniform mesh: every patch cut into a regular grid of about equal elements.
//!
//! Flat shapes (parallelograms where triangles join to one, else triangles) get the coarsest
//! grid whose elements are no larger than asked and as square as possible. Shapes much smaller
//! than an element share clusters. When that gives more elements than allowed, the element size
//! is raised until it fits.
//!
//! Source: [Yeap99], 4.3.1, figure 4.6.

use crate::cluster::{Clusters, Limits, Tiny, clusters};
use crate::contract::{MeshSettings, Strategy};
use crate::flat::{Flat, Flats, flats};
use crate::shade::shade;
use crate::sides::{SIDES, lit_side};
use luxel_core::{Front, FrontChange, RefinementWish, Scene, Shape, Side, Solution};
use rayon::prelude::*;

/// Shapes below this share of the largest element are clustered, unless they are long.
const TINY: f32 = 1.0 / 4.0;
/// An element edge is at most this many times the edge of the largest square element.
const STRETCH: f32 = 2.0;

/// The uniform strategy: one front, never refined.
#[derive(Clone, Debug)]
pub struct Uniform {
    settings: MeshSettings,
}

impl Uniform {
    /// With these settings.
    pub fn new(settings: MeshSettings) -> Self {
        Uniform { settings }
    }
}

impl Strategy for Uniform {
    fn initial(&mut self, scene: &Scene) -> Front {
        mesh(scene, &self.settings, |n| n).0
    }

    fn refine(
        &mut self,
        _: &Scene,
        _: &Front,
        _: &Solution,
        _: &RefinementWish,
    ) -> Option<(Front, FrontChange)> {
        None
    }
}

/// The largest element area that a uniform mesh under `settings` really keeps, m².
///
/// `settings.max_area_m2`, or more when `settings.max_elements` would be exceeded otherwise. The
/// number of elements cannot fall below about six for each surface and side with tiny triangles,
/// nor, without clusters, below one for each flat shape.
pub fn effective_max_area(scene: &Scene, settings: &MeshSettings) -> f32 {
    mesh(scene, settings, |n| n).1
}

/// How a scene is cut at one element size.
#[derive(Default)]
struct Plan {
    /// Index of a flat and its grid.
    patches: Vec<(u32, [u32; 2])>,
    clusters: Clusters,
}

impl Plan {
    fn elements(&self, scene: &Scene, flats: &Flats, lit: &[[bool; 2]]) -> usize {
        let sides = |surface: usize| lit[surface].iter().filter(|&&l| l).count();
        let mut count = 0;
        for &(i, [nu, nv]) in &self.patches {
            let surface = flats.list[i as usize].surface;
            count += nu as usize * nv as usize * sides(surface.index());
        }
        let mut first = 0;
        for &n in &self.clusters.lengths {
            let t = self.clusters.triangles[first] as usize;
            first += n as usize;
            count += sides(scene.surface_of[t].index());
        }
        count
    }
}

/// A shaded front, and the element area it kept. `density` maps the cells along an edge of a
/// uniform mesh to those wanted.
pub(crate) fn mesh(
    scene: &Scene,
    settings: &MeshSettings,
    density: impl Fn(u32) -> u32 + Copy + Sync,
) -> (Front, f32) {
    let lit: Vec<[bool; 2]> = scene
        .surfaces
        .iter()
        .map(|s| SIDES.map(|side| lit_side(&scene.finishes[s.finish.index()], side).is_some()))
        .collect();
    let wanted: Vec<bool> = scene
        .surface_of
        .iter()
        .map(|s| lit[s.index()].contains(&true))
        .collect();
    let flats = flats(scene, &wanted);
    let sides = |flat: &Flat| lit[flat.surface.index()].iter().filter(|&&l| l).count();

    let whole = flats
        .list
        .iter()
        .map(|f| f.area as f64)
        .sum::<f64>()
        .max(1e-12) as f32;
    let mut area = settings.max_area_m2.max(whole * 1e-9);
    let mut plan = Plan::default();
    for round in 0..ROUNDS {
        // Grids alone first: cheap, and most often what exceeds the limit.
        let grids = |area: f32| -> usize {
            flats
                .list
                .par_iter()
                .filter(|f| !(settings.cluster && is_tiny(f, area)))
                .map(|f| {
                    let [nu, nv] = grid(f, settings.area_in(f, area)).map(density);
                    nu as usize * nv as usize * sides(f)
                })
                .sum()
        };
        let mut patches = grids(area);
        while patches > settings.max_elements && area < whole {
            area *= 1.1;
            patches = grids(area);
        }
        // The first attempt has narrow cones; where even that is too much, the six directions
        // of a box are kept apart and no more.
        let (directions, cos_cone) = if round == 0 { NARROW } else { WIDE };
        let limits = Limits {
            cube_m: area.sqrt(),
            area_m2: area,
            directions,
            cos_cone,
        };
        plan = cut(scene, &flats, settings, limits, density);
        let count = plan.elements(scene, &flats, &lit);
        if count <= settings.max_elements || area >= whole || !settings.cluster {
            break;
        }
        if round > 0 {
            area *= (count as f32 / settings.max_elements.max(1) as f32).clamp(1.15, 8.0);
        }
    }
    (build(scene, &flats, &plan), area)
}

/// Directions and cosine of the cone (27 degrees) of a cluster's normals.
const NARROW: (u32, f32) = (3, 0.89);
/// The same when clusters would exceed the limit on elements: a face of the cube map reaches to
/// 55 degrees from its axis, 70 from a mean near its rim.
const WIDE: (u32, f32) = (1, 0.34);
/// Most attempts to get below the limit on elements.
const ROUNDS: usize = 16;

fn cut(
    scene: &Scene,
    flats: &Flats,
    settings: &MeshSettings,
    limits: Limits,
    density: impl Fn(u32) -> u32,
) -> Plan {
    let area = limits.area_m2;
    let mut plan = Plan::default();
    // (surface, region) of each tiny shape: pieces of a larger region, or of a triangle that was
    // cut, stay within theirs, or a cluster would join the two sides of a contact line.
    let source = |t: usize| {
        let id = scene.source_triangle.get(t)?;
        Some((scene.surface_of[t], *id))
    };
    let is_piece = |t: u32| {
        let t = t as usize;
        source(t) == source(t + 1) || t > 0 && source(t) == source(t - 1)
    };
    let mut tiny: Vec<(u32, u32, u32)> = Vec::new();
    for (i, flat) in flats.list.iter().enumerate() {
        if settings.cluster && is_tiny(flat, area) {
            let run = flat.triangles.start as usize..flat.triangles.end as usize;
            let cut = flats.triangles[run].iter().any(|&t| is_piece(t));
            let region = if cut || flat.region_area > area {
                flat.region
            } else {
                u32::MAX
            };
            tiny.push((flat.surface.0, region, i as u32));
        } else {
            plan.patches.push((
                i as u32,
                grid(flat, settings.area_in(flat, area)).map(&density),
            ));
        }
    }
    tiny.par_sort_unstable();
    let mut members = Vec::new();
    for (family, run) in tiny.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).enumerate() {
        for &(_, _, i) in run {
            let flat = &flats.list[i as usize];
            let share = if flat.parallelogram { 0.5 } else { 1.0 / 3.0 };
            let centre = flat.origin + (flat.edge_u + flat.edge_v) * share;
            let run = flat.triangles.start as usize..flat.triangles.end as usize;
            let family = family as u32;
            members.extend(flats.triangles[run].iter().map(|&triangle| Tiny {
                family,
                triangle,
                centre,
            }));
        }
    }
    let mut flat_of = vec![u32::MAX; scene.triangles.len()];
    for &(_, _, i) in &tiny {
        let r = &flats.list[i as usize].triangles;
        for &t in &flats.triangles[r.start as usize..r.end as usize] {
            flat_of[t as usize] = i;
        }
    }
    let all = clusters(scene, &members, limits);
    let mut first = 0;
    for &n in &all.lengths {
        let group = &all.triangles[first..first + n as usize];
        first += n as usize;
        // A shape that shares with no other stays what it is: flat, and able to be split.
        let flat = flat_of[group[0] as usize];
        if flats.list[flat as usize].triangles.len() == group.len()
            && group.iter().all(|&t| flat_of[t as usize] == flat)
        {
            plan.patches.push((flat, [1, 1]));
        } else {
            plan.clusters.triangles.extend_from_slice(group);
            plan.clusters.lengths.push(n);
        }
    }
    plan
}

/// Whether a flat shape is to share an element: much smaller than one, and not so long that it
/// would be alone in its group anyway.
fn is_tiny(flat: &Flat, area: f32) -> bool {
    let (u, v) = (flat.edge_u, flat.edge_v);
    let across = if flat.parallelogram {
        (u + v).length_squared()
    } else {
        0.0
    };
    let longest = u
        .length_squared()
        .max(v.length_squared())
        .max((u - v).length_squared());
    flat.area < TINY * area && longest.max(across) <= 4.0 * area
}

impl MeshSettings {
    /// Largest element area within a flat shape, m², where it is `area` elsewhere.
    fn area_in(&self, flat: &Flat, area: f32) -> f32 {
        area.max(flat.region_area / self.max_per_region.max(1) as f32)
    }
}

/// Cells along both edges of a flat shape for elements no larger than `area`.
fn grid(flat: &Flat, area: f32) -> [u32; 2] {
    const MOST: f32 = 4096.0;
    let cells = |n: f32| n.clamp(1.0, MOST) as u32;
    // 1e-4: a wall of exactly four elements shall not get five by rounding.
    let needed = (flat.area / area - 1e-4).max(1.0);
    if !flat.parallelogram {
        let n = cells(needed.sqrt().ceil());
        return [n, n];
    }
    let (a, b) = (flat.edge_u.length(), flat.edge_v.length());
    let longest = STRETCH * area.sqrt();
    let least = [
        cells((a / longest - 1e-4).ceil()),
        cells((b / longest - 1e-4).ceil()),
    ];
    let ideal = (needed * a / b).sqrt();
    let mut best = ([1, 1], f32::INFINITY);
    for nu in [cells(ideal.floor()), cells(ideal.ceil())] {
        let nu = nu.max(least[0]);
        let nv = cells((needed / nu as f32).ceil()).max(least[1]);
        let ratio = (a / nu as f32) / (b / nv as f32);
        let cost = ratio.max(1.0 / ratio) * (nu as f32 * nv as f32);
        if cost < best.1 {
            best = ([nu, nv], cost);
        }
    }
    best.0
}

fn build(scene: &Scene, flats: &Flats, plan: &Plan) -> Front {
    let mut front = Front::new(scene.triangles.len());
    for &(i, [nu, nv]) in &plan.patches {
        let flat = &flats.list[i as usize];
        let run = flat.triangles.start as usize..flat.triangles.end as usize;
        let finish = &scene.finishes[scene.surfaces[flat.surface.index()].finish.index()];
        for side in SIDES {
            let Some(lit) = lit_side(finish, side) else {
                continue;
            };
            // Seen from behind, the edges change places.
            let (edge_u, edge_v, grid) = match side {
                Side::Front => (flat.edge_u, flat.edge_v, [nu, nv]),
                Side::Back => (flat.edge_v, flat.edge_u, [nv, nu]),
            };
            let origin = flat.origin;
            let shape = if flat.parallelogram {
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
            };
            front.add_patch(
                flat.surface,
                side,
                shape,
                grid,
                lit.group,
                &flats.triangles[run.clone()],
            );
        }
    }
    let mut first = 0;
    for &n in &plan.clusters.lengths {
        let triangles = &plan.clusters.triangles[first..first + n as usize];
        first += n as usize;
        let t = triangles[0] as usize;
        let surface = scene.surface_of[t];
        for side in SIDES {
            let Some(lit) = lit_side(scene.finish_of(t), side) else {
                continue;
            };
            if let [_] = triangles {
                let [origin, b, c] = scene.corners(t);
                let (edge_u, edge_v) = match side {
                    Side::Front => (b - origin, c - origin),
                    Side::Back => (c - origin, b - origin),
                };
                let shape = Shape::Triangle {
                    origin,
                    edge_u,
                    edge_v,
                };
                front.add_patch(surface, side, shape, [1, 1], lit.group, triangles);
            } else {
                front.add_cluster(scene, surface, side, lit.group, triangles);
            }
        }
    }
    shade(scene, &mut front);
    front
}
