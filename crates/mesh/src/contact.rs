//! Where triangles touch or cross large flat groups: the contact lines.
//!
//! A group is a run of adjacent coplanar triangles of one surface, each large enough to matter.
//! Every other triangle that blocks light is held against the planes of the groups whose
//! triangles' bounds it meets (a tree over the large triangles only, so the many small ones cost
//! one walk each). Corners within the tolerance of the plane lie in it. The line of contact is an
//! edge that lies in the plane, or the chord where the triangle crosses it; end points depend only
//! on the corner or the edge and the plane, so that neighbours give the same bits and chords join
//! to outlines. A face that runs parallel to a group at a small distance (a lamp a hair below the
//! ceiling, a picture before the wall) is projected: light is shut in between as if it touched.
//! Outlines smaller than asked are dropped, and of too many lines the shortest on each triangle:
//! thousands of large faces that all cross each other would make as many lines as pairs.

use crate::flat::{NONE, Plane, adjacency};
use luxel_core::{DVec3, Scene, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// Bits of a position, -0 made 0: equal bits, same place.
pub(crate) type Place = [u32; 3];

pub(crate) fn place(p: Vec3) -> Place {
    (p + Vec3::ZERO).to_array().map(f32::to_bits)
}

/// Groups of large coplanar triangles.
pub(crate) struct Groups {
    /// Group of each triangle; `NONE` for the small ones.
    pub of: Vec<u32>,
    /// Neighbour across each edge, by position, within the surface and among the large.
    pub next: Vec<[u32; 3]>,
    pub planes: Vec<Plane>,
}

impl Groups {
    /// Groups of triangles of at least `min_area_m2` that are `wanted`.
    pub fn of(scene: &Scene, wanted: &[bool], min_area_m2: f32, tolerance_m: f64) -> Groups {
        let large: Vec<bool> = (0..scene.triangles.len())
            .into_par_iter()
            .map(|t| wanted[t] && scene.area(t) >= min_area_m2)
            .collect();
        // Ids in order of first use, so the map's own order is never seen.
        let mut ids: HashMap<Place, u32> = HashMap::new();
        let mut welded = vec![[0; 3]; scene.triangles.len()];
        for t in (0..scene.triangles.len()).filter(|&t| large[t]) {
            welded[t] = scene.corners(t).map(|p| {
                let fresh = ids.len() as u32;
                *ids.entry(place(p)).or_insert(fresh)
            });
        }
        let next = adjacency(&welded, &scene.surface_of, &large);
        let mut seeds: Vec<(i32, u32)> = (0..scene.triangles.len())
            .filter(|&t| large[t])
            .map(|t| (-(scene.area(t).max(1e-30).log2() as i32), t as u32))
            .collect();
        seeds.sort_unstable();
        let mut groups = Groups {
            of: vec![NONE; scene.triangles.len()],
            next,
            planes: Vec::new(),
        };
        let mut front = Vec::new();
        for (_, seed) in seeds {
            if groups.of[seed as usize] != NONE {
                continue;
            }
            let plane = Plane::of(scene, seed);
            let id = groups.planes.len() as u32;
            groups.planes.push(plane);
            groups.of[seed as usize] = id;
            front.push(seed);
            while let Some(t) = front.pop() {
                for o in groups.next[t as usize] {
                    if o == NONE || groups.of[o as usize] != NONE {
                        continue;
                    }
                    let corners = scene.corners(o as usize);
                    let [a, b, c] = corners.map(|p| p.as_dvec3());
                    let flat = corners.iter().all(|&p| {
                        plane.holds(p, tolerance_m)
                            || plane.distance(p.as_dvec3()).abs() < 0.1 * tolerance_m
                    });
                    if flat && (b - a).cross(c - a).dot(plane.normal) > 0.0 {
                        groups.of[o as usize] = id;
                        front.push(o);
                    }
                }
            }
        }
        groups
    }
}

/// A line of contact as one triangle of a group sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Contact {
    pub group: u32,
    /// Triangle of the group.
    pub triangle: u32,
    /// Ends, metres, in the plane of the group.
    pub ends: [DVec3; 2],
    /// Infinite for a contact line, which light must not cross; of a shadow line, what it matters.
    pub weight: f64,
}

impl Contact {
    /// Metres.
    pub fn length(&self) -> f64 {
        (self.ends[1] - self.ends[0]).length()
    }

    /// What tells ends apart: equal bits, same place.
    pub fn bits(&self) -> [[u64; 3]; 2] {
        self.ends.map(|p| p.to_array().map(f64::to_bits))
    }
}

/// What was found.
#[derive(Default)]
pub(crate) struct Contacts {
    /// Sorted by group, then triangle.
    pub lines: Vec<Contact>,
    /// Large triangles that lie in the same place as one of another group, facing the same way.
    pub doubled: usize,
    /// Lines that were too many to be kept.
    pub left_out: usize,
    /// Triangles that were not held against the groups: too many meet too many.
    pub unsearched: usize,
}

/// What one task finds.
#[derive(Default)]
struct Found {
    lines: Vec<Contact>,
    doubled: Vec<u32>,
    pairs: usize,
}

/// Most lines that are kept: this many, and [`LINES_PER_TRIANGLE`] for each triangle of the scene.
const MOST_LINES: usize = 1 << 16;
const LINES_PER_TRIANGLE: usize = 4;
/// Most pairs of triangles that are looked at (about 10 s on two cores), counted likewise.
const MOST_PAIRS: usize = 1 << 24;
const PAIRS_PER_TRIANGLE: usize = 64;
/// Triangles whose contacts are searched before it is seen whether there are too many. A constant,
/// so that the same are left out on every machine.
const BLOCK: usize = 1 << 7;

/// All contact lines on the groups, but those of outlines smaller than `min_contact_m`.
pub(crate) fn contacts(
    scene: &Scene,
    groups: &Groups,
    blocks: &[bool],
    tolerance_m: f64,
    gap_m: f64,
    min_contact_m: f32,
) -> Contacts {
    let large: Vec<u32> = (0..scene.triangles.len() as u32)
        .filter(|&t| groups.of[t as usize] != NONE)
        .collect();
    let tree = Tree::new(scene, large, gap_m.max(tolerance_m) as f32);
    let count = scene.triangles.len();
    let most = MOST_LINES + LINES_PER_TRIANGLE * count;
    let mut searches = MOST_PAIRS + PAIRS_PER_TRIANGLE * count;
    let mut out = Contacts::default();
    let mut doubled = vec![false; count];
    for first in (0..count).step_by(BLOCK) {
        if searches == 0 {
            out.unsearched = count - first;
            break;
        }
        let block = first..(first + BLOCK).min(count);
        let found: Vec<Found> = block
            .into_par_iter()
            .with_min_len(8)
            .filter(|&q| blocks[q])
            .fold(Found::default, |mut found, q| {
                tree.each_near(scene.corners(q), |t| {
                    let reach = [tolerance_m, gap_m];
                    meet(scene, groups, q as u32, t, reach, &mut found);
                });
                found
            })
            .collect();
        for f in found {
            out.lines.extend(f.lines);
            f.doubled.iter().for_each(|&t| doubled[t as usize] = true);
            searches = searches.saturating_sub(f.pairs);
        }
        if out.lines.len() > most {
            out.left_out += keep_longest(&mut out.lines, most / 2);
        }
    }
    out.doubled = doubled.iter().filter(|&&d| d).count();
    let key = |c: &Contact| (c.group, c.triangle, c.bits());
    out.lines.par_sort_by_key(key);
    out.lines.dedup_by_key(|c| key(c));
    out.lines = drop_small(out.lines, min_contact_m as f64);
    out
}

/// Adds the contact of triangle `q` with the large triangle `t`.
fn meet(
    scene: &Scene,
    groups: &Groups,
    q: u32,
    t: u32,
    [tolerance, gap]: [f64; 2],
    found: &mut Found,
) {
    found.pairs += 1;
    let group = groups.of[t as usize];
    if groups.of[q as usize] == group {
        return;
    }
    let plane = &groups.planes[group as usize];
    let corners = scene.corners(q as usize);
    let exact = corners.map(|p| p.as_dvec3());
    let d = exact.map(|p| {
        let d = plane.distance(p);
        if d.abs() <= tolerance { 0.0 } else { d }
    });
    let in_plane = |i: usize| exact[i] - plane.normal * plane.distance(exact[i]);
    let mut add = |a: DVec3, b: DVec3| {
        // In one order, so that an edge of two triangles counts once.
        let ends = if a.to_array() <= b.to_array() {
            [a, b]
        } else {
            [b, a]
        };
        if touches(scene, t, ends, tolerance) {
            found.lines.push(Contact {
                group,
                triangle: t,
                ends,
                weight: f64::INFINITY,
            });
        }
    };
    let zeros = d.iter().filter(|&&d| d == 0.0).count();
    // In the plane, or parallel to it and close.
    let (low, high) = (d[0].min(d[1]).min(d[2]), d[0].max(d[1]).max(d[2]));
    let is_near = high - low <= tolerance && high.max(-low) <= gap;
    let above = d.iter().filter(|&&d| d > 0.0).count();
    match zeros {
        _ if is_near => {
            if zeros == 3 && same_place(scene, q, t, plane.normal) {
                // Both see all there is to see; an edge of one is no edge of the other's light.
                found.doubled.push(t);
                return;
            }
            // The outline of a coplanar group; inner edges of it mean nothing.
            if groups.of[q as usize] != NONE {
                for k in 0..3 {
                    let o = groups.next[q as usize][k];
                    if o == NONE || groups.of[o as usize] != groups.of[q as usize] {
                        add(in_plane(k), in_plane((k + 1) % 3));
                    }
                }
            }
        }
        2 => {
            let off = d.iter().position(|&d| d != 0.0).unwrap_or(0);
            add(in_plane((off + 1) % 3), in_plane((off + 2) % 3));
        }
        _ if above == 0 || above + zeros == 3 => {}
        _ => {
            let mut ends = [DVec3::ZERO; 2];
            let mut n = 0;
            for k in 0..3 {
                let (i, j) = (k, (k + 1) % 3);
                if d[i] == 0.0 {
                    ends[n.min(1)] = in_plane(i);
                    n += 1;
                } else if d[i] * d[j] < 0.0 {
                    // From the same end whichever triangle asks.
                    let (i, j) = if corners[i].to_array() <= corners[j].to_array() {
                        (i, j)
                    } else {
                        (j, i)
                    };
                    let p = exact[i] + (exact[j] - exact[i]) * (d[i] / (d[i] - d[j]));
                    ends[n.min(1)] = p - plane.normal * plane.distance(p);
                    n += 1;
                }
            }
            if n == 2 {
                add(ends[0], ends[1]);
            }
        }
    }
}

/// Whether part of a line in the plane of `t` lies on the triangle, rim included.
pub(crate) fn touches(scene: &Scene, t: u32, [p, q]: [DVec3; 2], tolerance: f64) -> bool {
    let c = scene.corners(t as usize).map(|p| p.as_dvec3());
    let n = (c[1] - c[0]).cross(c[2] - c[0]);
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for k in 0..3 {
        let edge = c[(k + 1) % 3] - c[k];
        let inward = n.cross(edge).normalize_or_zero();
        let (dp, dq) = (
            (p - c[k]).dot(inward) + tolerance,
            (q - c[k]).dot(inward) + tolerance,
        );
        if dp < 0.0 && dq < 0.0 {
            return false;
        }
        if dp < 0.0 {
            from = from.max(dp / (dp - dq));
        } else if dq < 0.0 {
            to = to.min(dp / (dp - dq));
        }
    }
    (to - from) * (q - p).length() > tolerance
}

/// Whether two coplanar triangles face the same way and overlap, judged by their centres.
fn same_place(scene: &Scene, q: u32, t: u32, normal: DVec3) -> bool {
    let of = |t: u32| scene.corners(t as usize).map(|p| p.as_dvec3());
    let inside = |c: [DVec3; 3], p: DVec3| {
        let n = (c[1] - c[0]).cross(c[2] - c[0]);
        (0..3).all(|k| (c[(k + 1) % 3] - c[k]).cross(p - c[k]).dot(n) > 0.0)
    };
    let (a, b) = (of(q), of(t));
    let centre = |c: [DVec3; 3]| (c[0] + c[1] + c[2]) / 3.0;
    (a[1] - a[0]).cross(a[2] - a[0]).dot(normal) > 0.0
        && (inside(a, centre(b)) || inside(b, centre(a)))
}

/// Leaves at most about `most` lines: the longest on each triangle, equally many on those that have
/// too many. Returns how many are dropped; lines that came twice do not count.
fn keep_longest(lines: &mut Vec<Contact>, most: usize) -> usize {
    lines.par_sort_unstable_by(|a, b| {
        let longer = b.length().total_cmp(&a.length());
        let triangle = a.triangle.cmp(&b.triangle);
        triangle.then(longer).then_with(|| a.bits().cmp(&b.bits()))
    });
    lines.dedup_by(|a, b| a.triangle == b.triangle && a.bits() == b.bits());
    let counts: Vec<usize> = lines
        .chunk_by(|a, b| a.triangle == b.triangle)
        .map(<[Contact]>::len)
        .collect();
    let total = |quota: usize| counts.iter().map(|&n| n.min(quota)).sum::<usize>();
    let quotas: Vec<usize> = (1..=32).map(|power| 1 << power).collect();
    let quota = quotas[quotas.partition_point(|&q| total(q) <= most).max(1) - 1];
    let before = lines.len();
    let (mut triangle, mut count) = (NONE, 0);
    lines.retain(|c| {
        count = if c.triangle == triangle { count + 1 } else { 1 };
        triangle = c.triangle;
        count <= quota
    });
    before - lines.len()
}

/// Leaves out the lines of connected outlines whose bounds' diagonal is below `least`.
pub(crate) fn drop_small(lines: Vec<Contact>, least: f64) -> Vec<Contact> {
    let mut kept = Vec::with_capacity(lines.len());
    for run in lines.chunk_by(|a, b| a.group == b.group) {
        let mut ids: HashMap<[u64; 3], usize> = HashMap::new();
        let mut parent: Vec<usize> = Vec::new();
        let mut bounds: Vec<(DVec3, DVec3)> = Vec::new();
        let ends: Vec<[usize; 2]> = run
            .iter()
            .map(|c| {
                let bits = c.bits();
                [0, 1].map(|end| {
                    *ids.entry(bits[end]).or_insert_with(|| {
                        parent.push(parent.len());
                        bounds.push((c.ends[end], c.ends[end]));
                        parent.len() - 1
                    })
                })
            })
            .collect();
        for &[a, b] in &ends {
            let (a, b) = (root(&mut parent, a), root(&mut parent, b));
            if a != b {
                let (child, head) = (a.max(b), a.min(b));
                parent[child] = head;
                bounds[head].0 = bounds[head].0.min(bounds[child].0);
                bounds[head].1 = bounds[head].1.max(bounds[child].1);
            }
        }
        for (c, &[a, _]) in run.iter().zip(&ends) {
            let (low, high) = bounds[root(&mut parent, a)];
            if (high - low).length() >= least {
                kept.push(*c);
            }
        }
    }
    kept
}

/// Head of a union-find set, shortening the path.
pub(crate) fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

/// A bounding-volume tree over the large triangles.
pub(crate) struct Tree {
    /// Low and high corner; children follow at `left + 1` and `right`, or a run of `order`.
    nodes: Vec<(Vec3, Vec3, u32, u32)>,
    order: Vec<u32>,
    bounds: Vec<(Vec3, Vec3)>,
    margin: Vec3,
}

const LEAF: usize = 4;

impl Tree {
    pub fn new(scene: &Scene, triangles: Vec<u32>, margin: f32) -> Tree {
        let mut boxes: Vec<(Vec3, Vec3, u32)> = triangles
            .iter()
            .map(|&t| {
                let [a, b, c] = scene.corners(t as usize);
                (a.min(b).min(c), a.max(b).max(c), t)
            })
            .collect();
        let mut nodes = Vec::new();
        if !boxes.is_empty() {
            build(&mut boxes, 0, &mut nodes);
        }
        Tree {
            nodes,
            order: boxes.iter().map(|b| b.2).collect(),
            bounds: boxes.iter().map(|b| (b.0, b.1)).collect(),
            margin: Vec3::splat(margin),
        }
    }

    pub fn each_near(&self, [a, b, c]: [Vec3; 3], mut found: impl FnMut(u32)) {
        let low = a.min(b).min(c) - self.margin;
        let high = a.max(b).max(c) + self.margin;
        let meets = |l: Vec3, h: Vec3| l.cmple(high).all() && h.cmpge(low).all();
        let mut stack = [0u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let at = stack[depth] as usize;
            let (l, h, first, count) = self.nodes[at];
            if !meets(l, h) {
                continue;
            }
            if count > 0 {
                for i in first as usize..(first + count) as usize {
                    if meets(self.bounds[i].0, self.bounds[i].1) {
                        found(self.order[i]);
                    }
                }
            } else {
                // Halves of equal count: the depth is below 32.
                stack[depth] = first;
                stack[depth + 1] = at as u32 + 1;
                depth += 2;
            }
        }
    }
}

fn build(boxes: &mut [(Vec3, Vec3, u32)], first: u32, nodes: &mut Vec<(Vec3, Vec3, u32, u32)>) {
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    for b in boxes.iter() {
        low = low.min(b.0);
        high = high.max(b.1);
    }
    let at = nodes.len();
    nodes.push((low, high, first, boxes.len() as u32));
    if boxes.len() <= LEAF {
        return;
    }
    let axis = (high - low).max_position();
    let middle = boxes.len() / 2;
    boxes.select_nth_unstable_by(middle, |a, b| {
        (a.0[axis] + a.1[axis])
            .total_cmp(&(b.0[axis] + b.1[axis]))
            .then(a.2.cmp(&b.2))
    });
    let (left, right) = boxes.split_at_mut(middle);
    build(left, first, nodes);
    nodes[at].2 = nodes.len() as u32;
    nodes[at].3 = 0;
    build(right, first + middle as u32, nodes);
}
