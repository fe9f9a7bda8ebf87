//! Uniform mesh: every patch cut into a regular grid of about equal elements.
//!
//! Flat shapes (parallelograms where triangles join to one, else triangles) get the coarsest
//! grid whose elements are no larger than asked and as square as possible. Shapes much smaller
//! than an element share clusters. When that gives more elements than allowed, the element size
//! is raised until it fits.
//!
//! Source: [Author99], 4.3.1, figure 4.6.

use crate::cluster::{Item, Limits, groups};
use crate::contract::{MeshSettings, Strategy};
use crate::flat::{Flat, Flats, flats};
use crate::shade::shade;
use crate::sides::{SIDES, lit_side};
use luxel_core::{Front, FrontChange, RefinementWish, Scene, Shape, Side, Solution};
use rayon::prelude::*;

/// Shapes below this share of the largest element are clustered.
const TINY: f32 = 1.0 / 8.0;
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
/// `settings.max_area_m2`, or more when `settings.max_elements` would be exceeded otherwise.
pub fn effective_max_area(scene: &Scene, settings: &MeshSettings) -> f32 {
    mesh(scene, settings, |n| n).1
}

/// How a scene is cut at one element size.
struct Plan {
    /// Index of a flat and its grid.
    patches: Vec<(u32, [u32; 2])>,
    /// Triangles of the clusters, group by group.
    clustered: Vec<u32>,
    /// Length of each group.
    groups: Vec<u32>,
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

    let largest: f64 = flats
        .list
        .iter()
        .map(|f| f.area as f64)
        .sum::<f64>()
        .max(1e-12);
    let mut area = settings.max_area_m2.max((largest * 1e-9) as f32);
    let mut cos_cone = CONE;
    let mut plan = Plan {
        patches: Vec::new(),
        clustered: Vec::new(),
        groups: Vec::new(),
    };
    for _ in 0..ROUNDS {
        // Grids alone first: cheap, and most often what exceeds the limit.
        let grids = |area: f32| -> usize {
            flats
                .list
                .par_iter()
                .filter(|f| !(settings.cluster && f.area < TINY * area))
                .map(|f| {
                    let [nu, nv] = grid(f, area).map(density);
                    nu as usize * nv as usize * sides(f)
                })
                .sum()
        };
        let mut patches = grids(area);
        while patches > settings.max_elements && area < largest as f32 {
            area *= 1.1;
            patches = grids(area);
        }
        plan = cut(scene, &flats, settings.cluster, area, cos_cone, density);
        let clusters: usize = {
            let mut first = 0;
            plan.groups
                .iter()
                .map(|&n| {
                    let t = plan.clustered[first] as usize;
                    first += n as usize;
                    lit[scene.surface_of[t].index()]
                        .iter()
                        .filter(|&&l| l)
                        .count()
                })
                .sum()
        };
        let count = patches + clusters;
        if count <= settings.max_elements || area >= largest as f32 {
            break;
        }
        area *= (count as f32 / settings.max_elements.max(1) as f32).clamp(1.2, 8.0);
        cos_cone = (cos_cone - 0.1).max(WIDEST_CONE);
    }
    (build(scene, &flats, &plan), area)
}

/// Cosine of the cone of a cluster's normals: 27 degrees.
const CONE: f32 = 0.89;
/// The same when clusters alone exceed the limit: 60 degrees, so that each of the six
/// directions of a box is still apart.
const WIDEST_CONE: f32 = 0.5;
/// Most attempts to get below the limit on elements.
const ROUNDS: usize = 12;

fn cut(
    scene: &Scene,
    flats: &Flats,
    cluster: bool,
    area: f32,
    cos_cone: f32,
    density: impl Fn(u32) -> u32,
) -> Plan {
    let mut plan = Plan {
        patches: Vec::new(),
        clustered: Vec::new(),
        groups: Vec::new(),
    };
    // (surface, region) of each tiny shape: pieces of a larger region stay within it, or a
    // cluster would join the two sides of a contact line.
    let mut tiny: Vec<(u32, u32, u32)> = Vec::new();
    for (i, flat) in flats.list.iter().enumerate() {
        if cluster && flat.area < TINY * area {
            let region = if flat.region_area > area {
                flat.region
            } else {
                u32::MAX
            };
            tiny.push((flat.surface.0, region, i as u32));
        } else {
            plan.patches
                .push((i as u32, grid(flat, area).map(&density)));
        }
    }
    tiny.par_sort_unstable();
    let limits = Limits {
        extent_m: area.sqrt(),
        area_m2: area,
        cos_cone,
    };
    let runs: Vec<&[(u32, u32, u32)]> = tiny.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).collect();
    let parts: Vec<(Vec<Item>, Vec<u32>)> = runs
        .par_iter()
        .map(|run| {
            let mut items: Vec<Item> = run
                .iter()
                .flat_map(|&(_, _, i)| {
                    let r = &flats.list[i as usize].triangles;
                    &flats.triangles[r.start as usize..r.end as usize]
                })
                .map(|&t| Item::of_triangle(scene, t))
                .collect();
            let lengths = groups(&mut items, limits);
            (items, lengths)
        })
        .collect();
    for (items, lengths) in parts {
        plan.clustered.extend(items.iter().map(|i| i.id));
        plan.groups.extend(lengths);
    }
    plan
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
    for &n in &plan.groups {
        let triangles = &plan.clustered[first..first + n as usize];
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
