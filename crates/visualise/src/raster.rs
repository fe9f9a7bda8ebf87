//! Which triangle is seen at each sample of a picture: a z-buffer in tiles.
//!
//! Triangles are clipped at the near plane, set up in double precision (a wall beside the eye
//! reaches far outside the picture), sorted into tiles and drawn tile by tile on all threads.
//! Only the index of the nearest triangle is kept; shading is done once afterwards for what is
//! seen. Edges reach a fiftieth of a sample further than they should, so that surfaces which
//! meet at unequal vertices show no pinholes.
//!
//! Source: [Pineda88] for edge functions.

use luxel_core::{Buckets, Vec2, Vec3, View};
use rayon::prelude::*;

/// Edge of a tile, samples.
const TILE: usize = 64;

/// Samples along each edge of a pixel.
pub(crate) const SUPER: usize = 2;

/// Overlap of neighbouring triangles, samples.
const OVERLAP: f64 = 0.02;

/// Factor on 1 / depth within the overlap: a neighbour in the same plane that really covers the
/// sample wins.
const BEHIND: f32 = 1.0 - 1e-4;

/// Nothing is seen.
pub(crate) const NOTHING: u32 = u32::MAX;

/// A pinhole camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Camera {
    pub eye: Vec3,
    right: Vec3,
    up: Vec3,
    forward: Vec3,
    /// Half the picture at distance 1.
    half: Vec2,
    /// Samples across and down.
    size: [usize; 2],
    near_m: f32,
}

impl Camera {
    /// For a picture of `width * height` pixels. `near_m`: what is closer is cut away.
    pub fn new(view: &View, width: usize, height: usize, near_m: f32) -> Camera {
        let forward = view.forward.normalize_or(Vec3::X);
        let right = forward.cross(view.up).normalize_or_zero();
        let right = if right == Vec3::ZERO {
            forward.any_orthonormal_vector()
        } else {
            right
        };
        let tall = (0.5 * view.vertical_angle.clamp(0.01, 3.0)).tan();
        let half = Vec2::new(tall * width as f32 / height as f32, tall);
        let size = [width * SUPER, height * SUPER];
        Camera {
            eye: view.eye,
            right,
            up: right.cross(forward),
            forward,
            half,
            size,
            near_m,
        }
    }

    /// Direction through a point of the picture in samples, with unit share along the sight.
    pub fn direction(&self, x: f32, y: f32) -> Vec3 {
        let across = (2.0 * x / self.size[0] as f32 - 1.0) * self.half.x;
        let rise = (1.0 - 2.0 * y / self.size[1] as f32) * self.half.y;
        self.forward + self.right * across + self.up * rise
    }

    /// Right, down and forward in camera space, in which a sample's place is x / z, y / z.
    fn place(&self, p: Vec3) -> [f64; 3] {
        let r = p - self.eye;
        let z = r.dot(self.forward) as f64;
        let x = r.dot(self.right) as f64 / self.half.x as f64;
        let y = -r.dot(self.up) as f64 / self.half.y as f64;
        [
            (x + z) * 0.5 * self.size[0] as f64,
            (y + z) * 0.5 * self.size[1] as f64,
            z,
        ]
    }
}

/// A triangle on the screen.
struct Setup {
    /// Edge functions a x + b y + c, inside where not negative, overlap included.
    edges: [[f64; 3]; 3],
    /// What the overlap adds to each.
    overlap: [f64; 3],
    /// 1 / depth as a function of x, y.
    depth: [f64; 3],
    /// First and last sample of its bounds.
    low: [u32; 2],
    high: [u32; 2],
    id: u32,
}

/// Index of the nearest triangle at each sample, row by row; [`NOTHING`] where there is none.
///
/// Triangles that turn their back (clockwise) are not drawn. `covers(id, x, y)` tells whether a
/// triangle for which `is_solid` is false is there at a sample.
pub(crate) fn visible(
    camera: &Camera,
    triangles: &(dyn Fn(u32) -> [Vec3; 3] + Sync),
    count: u32,
    is_solid: &(dyn Fn(u32) -> bool + Sync),
    covers: &(dyn Fn(u32, usize, usize) -> bool + Sync),
) -> Vec<u32> {
    let setups: Vec<Setup> = (0..count)
        .into_par_iter()
        .with_min_len(1024)
        .fold(Vec::new, |mut list, id| {
            set_up(camera, triangles(id), id, &mut list);
            list
        })
        .reduce(Vec::new, |mut a, mut b| {
            a.append(&mut b);
            a
        });
    let tiles = [camera.size[0].div_ceil(TILE), camera.size[1].div_ceil(TILE)];
    let spans = |s: &Setup| {
        let x = s.low[0] as usize / TILE..s.high[0] as usize / TILE + 1;
        let y = s.low[1] as usize / TILE..s.high[1] as usize / TILE + 1;
        y.flat_map(move |j| x.clone().map(move |i| j * tiles[0] + i))
    };
    let spans = &spans;
    let pairs = setups
        .iter()
        .enumerate()
        .flat_map(|(k, s)| spans(s).map(move |tile| (tile, k as u32)));
    let by_tile = Buckets::new(tiles[0] * tiles[1], pairs);
    // Bands of tiles write disjoint rows.
    let mut seen = vec![NOTHING; camera.size[0] * camera.size[1]];
    seen.par_chunks_mut(TILE * camera.size[0])
        .enumerate()
        .for_each(|(j, band)| {
            let mut depth = vec![0.0f32; TILE * TILE];
            for i in 0..tiles[0] {
                let tile = j * tiles[0] + i;
                depth.fill(0.0);
                for &k in by_tile.of(tile) {
                    let s = &setups[k as usize];
                    draw(
                        s,
                        [i * TILE, j * TILE],
                        camera.size,
                        &mut depth,
                        band,
                        is_solid(s.id),
                        covers,
                    );
                }
            }
        });
    seen
}

fn set_up(camera: &Camera, corners: [Vec3; 3], id: u32, out: &mut Vec<Setup>) {
    let [a, b, c] = corners;
    let facing = (b - a).cross(c - a).dot(camera.eye - a);
    if facing.is_nan() || facing <= 0.0 {
        return;
    }
    let points = corners.map(|p| camera.place(p));
    let near = camera.near_m as f64;
    if points.iter().all(|p| p[2] >= near) {
        return project(camera, points, id, out);
    }
    // Sutherland-Hodgman against one plane.
    let mut ring: [[f64; 3]; 4] = [[0.0; 3]; 4];
    let mut n = 0;
    for k in 0..3 {
        let (p, q) = (points[k], points[(k + 1) % 3]);
        if p[2] >= near {
            ring[n] = p;
            n += 1;
        }
        if (p[2] >= near) != (q[2] >= near) {
            let t = (near - p[2]) / (q[2] - p[2]);
            ring[n] = std::array::from_fn(|i| p[i] + t * (q[i] - p[i]));
            n += 1;
        }
    }
    for k in 2..n {
        project(camera, [ring[0], ring[k - 1], ring[k]], id, out);
    }
}

fn project(camera: &Camera, points: [[f64; 3]; 3], id: u32, out: &mut Vec<Setup>) {
    let p = points.map(|p| [p[0] / p[2], p[1] / p[2], 1.0 / p[2]]);
    let bound = |axis: usize| {
        let low = p[0][axis].min(p[1][axis]).min(p[2][axis]);
        let high = p[0][axis].max(p[1][axis]).max(p[2][axis]);
        let last = camera.size[axis] as f64 - 1.0;
        // Sample k has its centre at k + 1/2.
        let low = (low - 0.5 - OVERLAP).ceil().max(0.0);
        let high = (high - 0.5 + OVERLAP).floor().min(last);
        (low <= high).then_some((low as u32, high as u32))
    };
    let (Some(x), Some(y)) = (bound(0), bound(1)) else {
        return;
    };
    // Counter-clockwise in the world is clockwise with y down.
    let area =
        (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[2][0] - p[0][0]) * (p[1][1] - p[0][1]);
    if area.abs() < 1e-12 || !area.is_finite() {
        return;
    }
    let mut edges = [[0.0; 3]; 3];
    let mut overlap = [0.0; 3];
    let mut depth = [0.0; 3];
    for k in 0..3 {
        let (q, r) = (p[(k + 1) % 3], p[(k + 2) % 3]);
        // Weight of corner k: 1 there, 0 on the opposite edge.
        let (a, b) = ((q[1] - r[1]) / area, (r[0] - q[0]) / area);
        let c = -(a * q[0] + b * q[1]);
        for (i, v) in [a, b, c].into_iter().enumerate() {
            depth[i] += v * p[k][2];
        }
        overlap[k] = OVERLAP * a.hypot(b);
        edges[k] = [a, b, c + overlap[k]];
    }
    out.push(Setup {
        edges,
        overlap,
        depth,
        low: [x.0, y.0],
        high: [x.1, y.1],
        id,
    });
}

fn draw(
    s: &Setup,
    tile: [usize; 2],
    size: [usize; 2],
    depth: &mut [f32],
    band: &mut [u32],
    is_solid: bool,
    covers: &(dyn Fn(u32, usize, usize) -> bool + Sync),
) {
    let (left, right) = (
        (s.low[0] as usize).max(tile[0]),
        (s.high[0] as usize).min(tile[0] + TILE - 1),
    );
    let (top, bottom) = (
        (s.low[1] as usize).max(tile[1]),
        (s.high[1] as usize).min(tile[1] + TILE - 1),
    );
    for y in top..=bottom {
        let v = y as f64 + 0.5;
        // The run of samples inside all three edges.
        let (mut from, mut to) = (left as f64, right as f64);
        for [a, b, c] in s.edges {
            let rest = b * v + c;
            if a > 0.0 {
                from = from.max((-rest / a - 0.5).ceil());
            } else if a < 0.0 {
                to = to.min((-rest / a - 0.5).floor());
            } else if rest < 0.0 {
                to = -1.0;
            }
        }
        if from > to {
            continue;
        }
        let (from, to) = (from as usize, to as usize);
        let row = s.depth[1] * v + s.depth[2];
        let zs = &mut depth[(y - tile[1]) * TILE..(y - tile[1] + 1) * TILE];
        let ids = &mut band[(y - tile[1]) * size[0]..(y - tile[1] + 1) * size[0]];
        for x in from..=to {
            let mut z = (s.depth[0] * (x as f64 + 0.5) + row) as f32;
            if z <= zs[x - tile[0]] {
                continue;
            }
            let u = x as f64 + 0.5;
            let outside = |([a, b, c], extra): (&[f64; 3], &f64)| a * u + b * v + c < *extra;
            if s.edges.iter().zip(&s.overlap).any(outside) {
                z *= BEHIND;
            }
            if z > zs[x - tile[0]] && (is_solid || covers(s.id, x, y)) {
                zs[x - tile[0]] = z;
                ids[x] = s.id;
            }
        }
    }
}
