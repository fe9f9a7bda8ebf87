//! Which corners of elements are one point of one flat piece of surface.
//!
//! A flat piece (component) is a set of patches that are coplanar and whose source triangles
//! share edges. A place is a point of a component; corners that rounding moved apart by a few
//! units in the last place are the same. Places are found through a hash grid; results depend on
//! the order of insertion only, never on the order of the hash.

use crate::sets::Sets;
use luxel_core::{Front, PatchId, PatchSources, Scene, Shape, Vec2, Vec3};
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// Facts about the patches' source triangles.
pub(crate) struct Sources {
    /// Flat piece of each patch.
    pub component: Vec<u32>,
    /// Whether a component has more than one patch.
    pub shared: Vec<bool>,
    /// Distance under which two points are one, metres.
    pub tolerance_m: f32,
    triangles: PatchSources,
    /// Whether one affine map gives the texture coordinates of the whole patch.
    one_map: Vec<bool>,
}

impl Sources {
    pub fn new(scene: &Scene, front: &Front) -> Sources {
        let patches = front.patches.len();
        let reach = scene
            .positions
            .iter()
            .fold(0.0f32, |m, p| m.max(p.abs().max_element()));
        let tolerance_m = (reach * 1e-6).max(f32::MIN_POSITIVE * 1e6);
        let component = components(scene, front);
        let mut count = vec![0u32; patches];
        for &c in &component {
            count[c as usize] += 1;
        }
        let shared = count.iter().map(|&n| n > 1).collect();
        let mut sources = Sources {
            component,
            shared,
            tolerance_m,
            triangles: PatchSources::new(scene, front),
            one_map: Vec::new(),
        };
        sources.one_map = (0..patches)
            .map(|p| sources.has_one_map(scene, p))
            .collect();
        sources
    }

    fn has_one_map(&self, scene: &Scene, patch: usize) -> bool {
        let list = self.triangles.of(patch);
        if scene.uvs.is_empty() || list.len() < 2 {
            return true;
        }
        list[1..].iter().all(|&t| {
            (0..3).all(|k| {
                let p = scene.corners(t as usize)[k];
                (scene.uvs[t as usize][k] - self.uv(scene, list[0], p))
                    .abs()
                    .max_element()
                    < 1e-3
            })
        })
    }

    /// The source triangle of a patch whose texture map holds at `p`.
    pub fn source_at(&self, scene: &Scene, front: &Front, patch: PatchId, p: Vec3) -> u32 {
        if self.one_map[patch.index()] {
            let first = self.triangles.of(patch.index()).first();
            return first.copied().unwrap_or(u32::MAX);
        }
        let st = front.patches[patch.index()].coordinates(p);
        let list = self.triangles.near(patch.index(), st);
        let inside = |t: u32| {
            let [u, v] = scene.barycentric(t as usize, p);
            u.min(v).min(1.0 - u - v)
        };
        let mut best = list[0];
        for &t in &list[1..] {
            if inside(t) > inside(best) {
                best = t;
            }
        }
        best
    }

    /// Texture coordinates at `p` by the affine map of a source triangle.
    pub fn uv(&self, scene: &Scene, triangle: u32, p: Vec3) -> Vec2 {
        if scene.uvs.is_empty() || triangle == u32::MAX {
            return Vec2::ZERO;
        }
        let [u, v] = scene.barycentric(triangle as usize, p);
        scene.uv_at(triangle as usize, u, v)
    }
}

/// First of the positions that are the same as each: an unwelded edge is shared all the same.
pub(crate) fn welded(scene: &Scene) -> Vec<u32> {
    let mut same: HashMap<[u32; 3], u32, BuildHasherDefault<Mix>> = HashMap::default();
    let bits = |p: &Vec3| (*p + Vec3::ZERO).to_array().map(f32::to_bits);
    (scene.positions.iter().zip(0..))
        .map(|(p, i)| *same.entry(bits(p)).or_insert(i))
        .collect()
}

/// Smallest patch of the flat piece that each patch belongs to.
fn components(scene: &Scene, front: &Front) -> Vec<u32> {
    let place = welded(scene);
    let mut edges: Vec<([u32; 2], u32)> = Vec::new();
    for (t, corners) in scene.triangles.iter().enumerate() {
        for id in front.patch_of[t].iter().filter(|p| p.is_some()) {
            if matches!(front.patches[id.index()].shape, Shape::Cluster { .. }) {
                continue;
            }
            for k in 0..3 {
                let (a, b) = (
                    place[corners[k] as usize],
                    place[corners[(k + 1) % 3] as usize],
                );
                edges.push(([a.min(b), a.max(b)], id.0));
            }
        }
    }
    edges.sort_unstable();
    let mut sets = Sets::new(front.patches.len());
    for around in edges.chunk_by(|a, b| a.0 == b.0) {
        for i in 1..around.len() {
            // An edge with many triangles is no wall; a few neighbours are enough to join.
            for j in i.saturating_sub(8)..i {
                let (a, b) = (around[i].1, around[j].1);
                let (p, q) = (&front.patches[a as usize], &front.patches[b as usize]);
                if a != b
                    && p.surface == q.surface
                    && p.side == q.side
                    && p.normal.dot(q.normal) > 1.0 - 1e-6
                {
                    sets.join(a, b);
                }
            }
        }
    }
    (0..front.patches.len() as u32)
        .map(|k| sets.lead(k))
        .collect()
}

/// Places on the border of a component's elements, sorted along one axis.
pub(crate) struct Seam {
    axis: usize,
    places: Vec<(f32, u32)>,
}

/// Points that stand for several corners each.
pub(crate) struct Places {
    /// The point.
    pub position: Vec<Vec3>,
    component: Vec<u32>,
    tolerance_m: f32,
    cell_m: f32,
    first: HashMap<(u32, [i32; 3]), u32, BuildHasherDefault<Mix>>,
    next: Vec<u32>,
}

impl Places {
    /// Component of the facets of clusters, which are joined by their normals instead.
    pub const FACETS: u32 = u32::MAX;

    pub fn new(tolerance_m: f32) -> Places {
        Places {
            position: Vec::new(),
            component: Vec::new(),
            tolerance_m,
            cell_m: 16.0 * tolerance_m,
            first: HashMap::default(),
            next: Vec::new(),
        }
    }

    // 16 tolerances of 1e-6 of the largest coordinate: at most 62,500 cells from the origin.
    fn cell(&self, p: Vec3) -> [i32; 3] {
        (p / self.cell_m).floor().to_array().map(|v| v as i32)
    }

    pub fn find(&self, component: u32, p: Vec3) -> Option<u32> {
        let reach = Vec3::splat(self.tolerance_m);
        let (low, high) = (self.cell(p - reach), self.cell(p + reach));
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    let mut k = self
                        .first
                        .get(&(component, [x, y, z]))
                        .copied()
                        .unwrap_or(u32::MAX);
                    while k != u32::MAX {
                        let q = self.position[k as usize];
                        if (p - q).abs().max_element() <= self.tolerance_m {
                            return Some(k);
                        }
                        k = self.next[k as usize];
                    }
                }
            }
        }
        None
    }

    pub fn find_or_add(&mut self, component: u32, p: Vec3) -> u32 {
        if let Some(k) = self.find(component, p) {
            return k;
        }
        let k = self.position.len() as u32;
        self.position.push(p);
        self.component.push(component);
        let head = self
            .first
            .entry((component, self.cell(p)))
            .or_insert(u32::MAX);
        self.next.push(std::mem::replace(head, k));
        k
    }

    /// Appends the places strictly between `p` and `q`, in order: the finer neighbour in a
    /// quadtree always has the middle of the edge, so halves are looked up one after another.
    pub fn between(&self, component: u32, p: Vec3, q: Vec3, depth: u32, out: &mut Vec<Vec3>) {
        let middle = 0.5 * (p + q);
        if depth > 20 || (q - p).abs().max_element() <= 4.0 * self.tolerance_m {
            return;
        }
        if let Some(k) = self.find(component, middle) {
            self.between(component, p, middle, depth + 1, out);
            out.push(self.position[k as usize]);
            self.between(component, middle, q, depth + 1, out);
        }
    }

    /// The places `on_border`, by component, sorted along its longest axis. Only looked up, never
    /// walked.
    pub fn seams(&self, on_border: &[u32]) -> HashMap<u32, Seam> {
        let mut bounds: HashMap<u32, (Vec3, Vec3)> = HashMap::new();
        for &k in on_border {
            let p = self.position[k as usize];
            let b = bounds.entry(self.component[k as usize]).or_insert((p, p));
            *b = (b.0.min(p), b.1.max(p));
        }
        let mut seams: HashMap<u32, Seam> = HashMap::new();
        for &k in on_border {
            let c = self.component[k as usize];
            let (low, high) = bounds[&c];
            let axis = (high - low).max_position();
            let seam = seams.entry(c).or_insert(Seam {
                axis,
                places: Vec::new(),
            });
            seam.places.push((self.position[k as usize][axis], k));
        }
        for seam in seams.values_mut() {
            seam.places
                .sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
        seams
    }

    /// Appends the places of `seam` strictly between `p` and `q`, in order.
    pub fn on_seam(&self, seam: &Seam, p: Vec3, q: Vec3, out: &mut Vec<Vec3>) {
        let reach = 2.0 * self.tolerance_m;
        let (low, high) = (
            p[seam.axis].min(q[seam.axis]) - reach,
            p[seam.axis].max(q[seam.axis]) + reach,
        );
        let from = seam.places.partition_point(|x| x.0 < low);
        let along = (q - p).as_dvec3();
        let length = along.length();
        let mut found: Vec<(f64, u32)> = Vec::new();
        for &(x, k) in &seam.places[from..] {
            if x > high {
                break;
            }
            let r = (self.position[k as usize] - p).as_dvec3();
            let t = r.dot(along) / length;
            let margin = reach as f64;
            if t > margin && t < length - margin && (r - along * (t / length)).length() <= margin {
                found.push((t, k));
            }
        }
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        out.extend(found.iter().map(|f| self.position[f.1 as usize]));
    }
}

/// A fast hash for small integer keys (multiply and rotate, as FxHash does).
#[derive(Default)]
pub(crate) struct Mix(u64);

impl Hasher for Mix {
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }
    fn write_u32(&mut self, v: u32) {
        self.write_u64(v as u64);
    }
    fn write_i32(&mut self, v: i32) {
        self.write_u64(v as u32 as u64);
    }
    fn write_u64(&mut self, v: u64) {
        self.0 = (self.0.rotate_left(26) ^ v).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}
