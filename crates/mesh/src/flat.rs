//! Triangles joined into the flat shapes that become patches.
//!
//! Triangles of one surface that share an edge (two vertex indices) and a plane form a region.
//! A region whose outline is a parallelogram is one shape, however many triangles it has; of any
//! other region, pairs of triangles that form a parallelogram are joined, and what is left stays
//! a triangle. Triangles on both sides of a contact line share no edge by index (see
//! [`prepare`](crate::prepare)), so no shape crosses one.

use luxel_core::{DVec3, Scene, SurfaceId, Vec3};
use rayon::prelude::*;
use std::ops::Range;

/// A parallelogram or triangle made of source triangles, front side.
#[derive(Clone, Debug)]
pub(crate) struct Flat {
    pub surface: SurfaceId,
    pub origin: Vec3,
    pub edge_u: Vec3,
    pub edge_v: Vec3,
    pub parallelogram: bool,
    /// Run of [`Flats::triangles`].
    pub triangles: Range<u32>,
    pub area: f32,
    /// Region it came from, and that region's area.
    pub region: u32,
    pub region_area: f32,
}

#[derive(Default)]
pub(crate) struct Flats {
    pub list: Vec<Flat>,
    pub triangles: Vec<u32>,
}

/// No neighbour.
pub(crate) const NONE: u32 = u32::MAX;

/// For each triangle the neighbour of the same surface across edge k (corner k to k + 1), or
/// `NONE`: open edge, more than two triangles at it, or the neighbour is wound the other way.
pub(crate) fn adjacency(
    corners: &[[u32; 3]],
    surface_of: &[SurfaceId],
    wanted: &[bool],
) -> Vec<[u32; 3]> {
    let mut edges: Vec<(u64, u32)> = (0..corners.len())
        .into_par_iter()
        .filter(|&t| wanted[t])
        .flat_map_iter(|t| {
            let c = corners[t];
            (0..3).map(move |k| {
                let (a, b) = (c[k], c[(k + 1) % 3]);
                let key = ((a.min(b) as u64) << 32) | a.max(b) as u64;
                (key, (t * 3 + k) as u32)
            })
        })
        .collect();
    edges.par_sort_unstable();
    let mut next = vec![[NONE; 3]; corners.len()];
    for run in edges.chunk_by(|a, b| a.0 == b.0) {
        // Surfaces may share indices; sorted by triangle, those of one surface stand together.
        for same in
            run.chunk_by(|a, b| surface_of[a.1 as usize / 3] == surface_of[b.1 as usize / 3])
        {
            if let [(_, x), (_, y)] = *same {
                let (t, i, o, j) = (x / 3, x as usize % 3, y / 3, y as usize % 3);
                if t != o && corners[t as usize][i] != corners[o as usize][j] {
                    next[t as usize][i] = o;
                    next[o as usize][j] = t;
                }
            }
        }
    }
    next
}

/// Plane through a triangle, for the test whether others lie in it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    pub normal: DVec3,
    pub origin: DVec3,
    size: f64,
}

impl Plane {
    pub fn of(scene: &Scene, triangle: u32) -> Plane {
        let [a, b, c] = scene.corners(triangle as usize).map(|p| p.as_dvec3());
        let n = (b - a).cross(c - a);
        Plane {
            normal: n.normalize_or_zero(),
            origin: a,
            size: n.length().sqrt(),
        }
    }

    /// Signed distance of a point, metres.
    pub fn distance(&self, p: DVec3) -> f64 {
        (p - self.origin).dot(self.normal)
    }

    /// Whether a point is off by no more than rounding of coordinates to f32 explains: two units
    /// in the last place, enlarged by extrapolation from this triangle, but not above `most_m`.
    pub fn holds(&self, p: Vec3, most_m: f64) -> bool {
        let rel = p.as_dvec3() - self.origin;
        let ulp = p
            .abs()
            .max_element()
            .max(self.origin.abs().max_element() as f32) as f64
            * 1.2e-7;
        let far = 1.0 + rel.length() / self.size.max(1e-30);
        rel.dot(self.normal).abs() <= (2.0 * ulp * far + 1e-7 * rel.length()).min(most_m)
    }
}

/// Joins the `wanted` triangles into flat shapes. Deterministic; near-linear time.
pub(crate) fn flats(scene: &Scene, wanted: &[bool]) -> Flats {
    let next = adjacency(&scene.triangles, &scene.surface_of, wanted);
    let mut out = Flats::default();
    // Rays start eight units in the last place of the largest coordinate above a patch
    // (`RayCaster::offset_m`); a source triangle may not come nearer than that. Four corners
    // that are off by two each are off by eight at worst.
    let most_m = 2.0 * f32::EPSILON as f64 * scene.largest_coordinate() as f64;
    let mut region_of = vec![NONE; scene.triangles.len()];
    // Large triangles first: the plane of a sliver is uncertain.
    let mut seeds: Vec<(i32, u32)> = (0..scene.triangles.len())
        .into_par_iter()
        .filter(|&t| wanted[t])
        .map(|t| (-(scene.area(t).max(1e-30).log2() as i32), t as u32))
        .collect();
    seeds.par_sort_unstable();
    let mut region = Vec::new();
    let mut count = 0;
    for (_, seed) in seeds {
        if region_of[seed as usize] != NONE {
            continue;
        }
        let plane = Plane::of(scene, seed);
        region.clear();
        region.push(seed);
        region_of[seed as usize] = count;
        let mut at = 0;
        while at < region.len() {
            for o in next[region[at] as usize] {
                if o == NONE || region_of[o as usize] != NONE {
                    continue;
                }
                let corners = scene.corners(o as usize);
                let [a, b, c] = corners.map(|p| p.as_dvec3());
                if (b - a).cross(c - a).dot(plane.normal) > 0.0
                    && corners.iter().all(|&p| plane.holds(p, most_m))
                {
                    region_of[o as usize] = count;
                    region.push(o);
                }
            }
            at += 1;
        }
        region.sort_unstable();
        add_region(scene, &next, &region_of, &region, count, &mut out);
        count += 1;
    }
    out
}

fn add_region(
    scene: &Scene,
    next: &[[u32; 3]],
    region_of: &[u32],
    region: &[u32],
    id: u32,
    out: &mut Flats,
) {
    let region_area = region
        .iter()
        .map(|&t| scene.area(t as usize) as f64)
        .sum::<f64>() as f32;
    let mut add = |corners: [Vec3; 3], parallelogram: bool, triangles: &[u32]| {
        let first = out.triangles.len() as u32;
        out.triangles.extend_from_slice(triangles);
        let [origin, b, c] = corners;
        let (edge_u, edge_v) = (b - origin, c - origin);
        let full = edge_u.cross(edge_v).length();
        out.list.push(Flat {
            surface: scene.surface_of[triangles[0] as usize],
            origin,
            edge_u,
            edge_v,
            parallelogram,
            triangles: first..out.triangles.len() as u32,
            area: if parallelogram { full } else { 0.5 * full },
            region: id,
            region_area,
        });
    };
    if let [only] = *region {
        add(scene.corners(only as usize), false, region);
        return;
    }
    if let Some([a, b, _, d]) = outline(scene, next, region_of, region, id).filter(is_parallelogram)
    {
        let whole = (b - a).cross(d - a).length();
        // A folded region would cover its outline twice.
        if (whole - region_area).abs() <= 1e-3 * region_area {
            add([a, b, d], true, region);
            return;
        }
    }
    // Pairs across their common edge, the most nearly rectangular first.
    let mut pairs = Vec::new();
    for &t in region {
        for k in 0..3 {
            let o = next[t as usize][k];
            if o > t && o != NONE && region_of[o as usize] == id {
                let [b, c, a] = rotated(scene, t, k);
                let Some(d) = opposite(scene, o, t) else {
                    continue;
                };
                // a, b, d, c: the common edge b-c is the diagonal.
                if is_parallelogram(&[a, b, d, c]) {
                    let (u, v) = (b - a, c - a);
                    let skew = u.dot(v).abs() / (u.length() * v.length()).max(f32::MIN_POSITIVE);
                    pairs.push((skew, t, o, [a, b, c]));
                }
            }
        }
    }
    pairs.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    let mut taken = vec![false; region.len()];
    let place = |t: u32| region.binary_search(&t).unwrap_or(0);
    for (_, t, o, corners) in pairs {
        let (i, j) = (place(t), place(o));
        if !taken[i] && !taken[j] {
            taken[i] = true;
            taken[j] = true;
            add(corners, true, &[t, o]);
        }
    }
    for (i, &t) in region.iter().enumerate() {
        if !taken[i] {
            add(scene.corners(t as usize), false, &[t]);
        }
    }
}

/// Corners of a triangle from corner `k` on.
fn rotated(scene: &Scene, triangle: u32, k: usize) -> [Vec3; 3] {
    let c = scene.corners(triangle as usize);
    [c[k], c[(k + 1) % 3], c[(k + 2) % 3]]
}

/// Corner of `o` that is not on the edge it shares with `t`.
fn opposite(scene: &Scene, o: u32, t: u32) -> Option<Vec3> {
    let shared = scene.triangles[t as usize];
    let mut alone = scene.triangles[o as usize]
        .into_iter()
        .filter(|i| !shared.contains(i));
    let corner = alone.next()?;
    alone
        .next()
        .is_none()
        .then(|| scene.positions[corner as usize])
}

/// Whether four corners in order form a parallelogram, but for rounding of coordinates.
fn is_parallelogram(corners: &[Vec3; 4]) -> bool {
    let [a, b, c, d] = corners.map(|p| p.as_dvec3());
    let largest = corners
        .iter()
        .map(|p| p.abs().max_element())
        .fold(0.0, f32::max) as f64;
    let (u, v) = (b - a, d - a);
    let size = u.length().min(v.length());
    let defect = (a + c - b - d).length();
    defect <= 4.0 * 1.2e-7 * largest + 1e-6 * size && u.cross(v).length() > 1e-6 * size * size
}

/// The outline of a region if it is one closed line with four corners, counter-clockwise.
fn outline(
    scene: &Scene,
    next: &[[u32; 3]],
    region_of: &[u32],
    region: &[u32],
    id: u32,
) -> Option<[Vec3; 4]> {
    let mut border: Vec<(u32, u32)> = Vec::new();
    for &t in region {
        for k in 0..3 {
            let o = next[t as usize][k];
            if o == NONE || region_of[o as usize] != id {
                let c = scene.triangles[t as usize];
                border.push((c[k], c[(k + 1) % 3]));
            }
        }
    }
    border.sort_unstable();
    if border.windows(2).any(|w| w[0].0 == w[1].0) {
        return None;
    }
    let start = border.first()?.0;
    let mut line = Vec::with_capacity(border.len());
    let mut at = start;
    loop {
        line.push(scene.positions[at as usize]);
        let i = border.binary_search_by_key(&at, |e| e.0).ok()?;
        at = border[i].1;
        if at == start {
            break;
        }
        if line.len() >= border.len() {
            return None;
        }
    }
    if line.len() != border.len() {
        return None; // a second loop: a hole
    }
    let n = line.len();
    let corner = |i: usize| {
        let [p, q, r] = [line[(i + n - 1) % n], line[i], line[(i + 1) % n]].map(|p| p.as_dvec3());
        let (before, after) = (q - p, r - q);
        // How far q is from the straight line p-r.
        let off = before.cross(after).length() / (r - p).length().max(1e-30);
        let ulp = line[i].abs().max_element() as f64 * 1.2e-7;
        before.dot(after) <= 0.0 || off > 4.0 * ulp + 1e-6 * (r - p).length()
    };
    let corners: Vec<Vec3> = (0..n).filter(|&i| corner(i)).map(|i| line[i]).collect();
    corners.try_into().ok()
}
