//! Which pieces share a chart, and the lattice on which their texels lie.
//!
//! A *sheet* is all that lies in one plane of one surface side and hangs together, or a part of a
//! curved surface seen along one direction. It has one lattice, whose outermost points lie on its
//! borders. A *chart* is a part of a sheet that is one rectangle of texels in the atlas. Charts of
//! one sheet share its lattice: where light goes on smoothly from one to the other, both have the
//! same texels there, so that there is no seam to be seen.
//!
//! A sheet is one chart unless something stands on it. Growing from its largest piece, a chart
//! never takes pieces on both sides of a blocked joint within the reach of a texel, so that no
//! texel lies in two rooms. What is blocked by small things (the leg of a chair) is only left out.
//!
//! Curved parts are grown over facets that face about the same way, and never over themselves:
//! a planar projection, which stretches by at most 1 / [`COS_CHART`].

use super::pieces::Pieces;
use crate::sets::Sets;
use luxel_core::{Vec2, Vec3};
use std::collections::{HashMap, HashSet, VecDeque};

/// Cosine of the largest angle between a facet and its chart.
const COS_CHART: f32 = 0.6;
/// A lattice has at most so many points along one axis.
const LONGEST: f32 = 1000.0;
/// Extents under so many texels have a single texel.
const SINGLE: f32 = 0.5;
/// Blocked joints keep their two sides apart within so many texels.
const APART: f32 = 1.5;
/// Things that stand on a sheet with less than so many texels across do not part it.
const SMALL: f32 = 3.0;
/// So many of the longest hard edges are tried as axes.
const EDGES: usize = 12;
/// Cell of the grid in which blocked joints are looked up, texels.
const GRID: f32 = 8.0;

/// A plane with a lattice.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    pub origin: Vec3,
    pub axes: [Vec3; 2],
    /// Metres from point to point.
    pub step: [f32; 2],
    /// Metres from border to border.
    pub extent: [f32; 2],
    /// Points along each axis.
    pub size: [u32; 2],
    pub pieces: Vec<u32>,
    pub flat: bool,
    /// Blocked joints, metres on the sheet.
    pub blocked: Vec<[Vec2; 2]>,
}

impl Sheet {
    /// Metres on the sheet of a world point.
    pub fn project(&self, p: Vec3) -> Vec2 {
        let r = p - self.origin;
        Vec2::new(r.dot(self.axes[0]), r.dot(self.axes[1]))
    }

    /// Corners of a piece, metres on the sheet.
    pub fn ring(&self, pieces: &Pieces, piece: u32) -> Vec<Vec2> {
        let corners = pieces.corners(piece as usize);
        corners.iter().map(|c| self.project(*c)).collect()
    }

    /// Metres on the sheet of a lattice point.
    pub fn point(&self, i: u32, j: u32) -> Vec2 {
        let along = |axis: usize, k: u32| match self.size[axis] {
            1 => 0.5 * self.extent[axis],
            _ => k as f32 * self.step[axis],
        };
        Vec2::new(along(0, i), along(1, j))
    }

    /// Lattice coordinates of metres on the sheet.
    pub fn lattice(&self, p: Vec2) -> Vec2 {
        let along = |axis: usize, v: f32| match self.size[axis] {
            1 => 0.0,
            n => (v / self.step[axis]).clamp(0.0, (n - 1) as f32),
        };
        Vec2::new(along(0, p.x), along(1, p.y))
    }

    /// Whether a blocked joint lies between two points.
    pub fn is_parted(&self, p: Vec2, q: Vec2) -> bool {
        self.blocked.iter().any(|[a, b]| {
            let side = |o: Vec2, d: Vec2, x: Vec2| d.perp_dot(x - o);
            let (d, e) = (*b - *a, q - p);
            side(*a, d, p) * side(*a, d, q) <= 0.0 && side(p, e, *a) * side(p, e, *b) <= 0.0
        })
    }

    fn texel(&self) -> f32 {
        let [x, y] = self.step;
        if self.size[0] == 1 { y } else { x }
    }
}

/// Pieces that share a rectangle of texels.
#[derive(Clone, Debug)]
pub(crate) struct Group {
    pub sheet: u32,
    pub pieces: Vec<u32>,
}

/// Sheets and charts of all pieces. Every piece is in exactly one chart.
pub(crate) fn group(pieces: &Pieces, texel_m: f32, most_in_sheet: f64) -> (Vec<Sheet>, Vec<Group>) {
    let (mut sheets, mut groups) = (Vec::new(), Vec::new());
    let open = neighbours(pieces);
    flat_sheets(
        pieces,
        texel_m,
        most_in_sheet,
        &open,
        &mut sheets,
        &mut groups,
    );
    curved_sheets(pieces, texel_m, &open, &mut sheets, &mut groups);
    (sheets, groups)
}

/// Pieces across open joints.
fn neighbours(pieces: &Pieces) -> luxel_core::Buckets {
    let pairs = pieces.joints.iter().filter(|j| !j.blocked).flat_map(|j| {
        let [a, b] = j.pieces;
        [(a as usize, b), (b as usize, a)]
    });
    luxel_core::Buckets::new(pieces.len(), pairs)
}

fn flat_sheets(
    pieces: &Pieces,
    texel_m: f32,
    most: f64,
    open: &luxel_core::Buckets,
    sheets: &mut Vec<Sheet>,
    groups: &mut Vec<Group>,
) {
    let mut sets = Sets::new(pieces.len());
    for joint in &pieces.joints {
        let [a, b] = joint.pieces;
        if pieces.flat[a as usize] {
            sets.join(a, b);
        }
    }
    // By leader, which is the first of each sheet.
    let mut of_leader: HashMap<u32, usize> = HashMap::new();
    let mut members: Vec<Vec<u32>> = Vec::new();
    for piece in (0..pieces.len() as u32).filter(|&p| pieces.flat[p as usize]) {
        let leader = sets.lead(piece);
        let at = *of_leader.entry(leader).or_insert_with(|| {
            members.push(Vec::new());
            members.len() - 1
        });
        members[at].push(piece);
    }
    let mut hard: Vec<Vec<[Vec3; 2]>> = vec![Vec::new(); members.len()];
    for edge in &pieces.hard {
        if let Some(&at) = of_leader.get(&sets.lead(edge.piece)) {
            hard[at].push(edge.ends);
        }
    }
    let mut blocked: Vec<Vec<[Vec3; 2]>> = vec![Vec::new(); members.len()];
    for joint in pieces.joints.iter().filter(|j| j.blocked) {
        let leader = sets.lead(joint.pieces[0]);
        if let Some(&at) = of_leader.get(&leader) {
            blocked[at].push(joint.ends);
        }
    }
    for ((members, blocked), hard) in members.into_iter().zip(blocked).zip(hard) {
        let area: f64 = members
            .iter()
            .map(|&p| pieces.area[p as usize] as f64)
            .sum();
        let wider = (area / (texel_m as f64).powi(2) / most).sqrt().max(1.0) as f32;
        let mut sheet = lay(pieces, members, &hard, texel_m * wider);
        sheet.blocked = blocked
            .iter()
            .map(|e| e.map(|p| sheet.project(p)))
            .collect();
        let index = sheets.len() as u32;
        for group in part(pieces, &sheet, open) {
            groups.push(Group {
                sheet: index,
                pieces: group,
            });
        }
        sheets.push(sheet);
    }
}

/// A lattice over flat pieces, along the edge that gives the smallest rectangle.
fn lay(pieces: &Pieces, members: Vec<u32>, edges: &[[Vec3; 2]], texel_m: f32) -> Sheet {
    let normal = pieces.normal[members[0] as usize];
    let ring = pieces.corners(members[0] as usize);
    let first = ring[1] - ring[0];
    let mut along: Vec<Vec3> = edges.iter().map(|[p, q]| *q - *p).collect();
    along.sort_by(|a, b| b.length_squared().total_cmp(&a.length_squared()));
    along.truncate(EDGES);
    along.insert(0, first);
    let base = ring[0];
    let mut best: Option<(f32, Vec3)> = None;
    for edge in along {
        let u = (edge - normal * edge.dot(normal)).normalize_or(normal.any_orthonormal_vector());
        let [w, h] = extent(pieces, &members, base, [u, normal.cross(u)]).1;
        // Not for the last digit.
        if best.is_none_or(|(area, _)| w * h < 0.999 * area) {
            best = Some((w * h, u));
        }
    }
    let u = best.map_or(normal.any_orthonormal_vector(), |b| b.1);
    Sheet {
        flat: true,
        ..lay_along(pieces, members, texel_m, [u, normal.cross(u)])
    }
}

/// Lowest corner, metres from `base` along the axes, and extent of some pieces.
fn extent(pieces: &Pieces, members: &[u32], base: Vec3, axes: [Vec3; 2]) -> (Vec2, [f32; 2]) {
    let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    for &p in members {
        for c in pieces.corners(p as usize) {
            let at = Vec2::new((*c - base).dot(axes[0]), (*c - base).dot(axes[1]));
            (low, high) = (low.min(at), high.max(at));
        }
    }
    (low, (high - low).to_array())
}

/// Parts a sheet into charts that lie on one side of what stands on it.
fn part(pieces: &Pieces, sheet: &Sheet, open: &luxel_core::Buckets) -> Vec<Vec<u32>> {
    if sheet.blocked.is_empty() {
        return vec![sheet.pieces.clone()];
    }
    let texel = sheet.texel();
    let keeps_apart = large_contours(sheet, SMALL * texel);
    let reach = APART * texel;
    let cell = GRID * texel;
    let cells = |low: Vec2, high: Vec2| {
        let (low, high) = ((low / cell).floor(), (high / cell).floor());
        (low.x as i32..=high.x as i32)
            .flat_map(move |i| (low.y as i32..=high.y as i32).map(move |j| (i, j)))
    };
    let mut near: HashMap<(i32, i32), Vec<u32>> = HashMap::new();
    for (k, [a, b]) in sheet.blocked.iter().enumerate() {
        if keeps_apart[k] {
            for c in cells(a.min(*b) - reach, a.max(*b) + reach) {
                near.entry(c).or_default().push(k as u32);
            }
        }
    }
    // Sides of the blocked joints on which a piece lies: +1 left, -1 right.
    let sides = |piece: u32| {
        let ring = sheet.ring(pieces, piece);
        let (low, high) = bounds(&ring);
        let mut list: Vec<u32> = cells(low, high)
            .filter_map(|c| near.get(&c))
            .flatten()
            .copied()
            .collect();
        list.sort_unstable();
        list.dedup();
        let mut out: Vec<(u32, i8)> = Vec::new();
        for k in list {
            for side in [1i8, -1] {
                if lies_beside(&ring, sheet.blocked[k as usize], side as f32, reach) {
                    out.push((k, side));
                }
            }
        }
        out
    };
    let mut order = sheet.pieces.clone();
    order.sort_by(|a, b| {
        let area = |p: &u32| pieces.area[*p as usize];
        area(b).total_cmp(&area(a)).then(a.cmp(b))
    });
    let mut taken: HashSet<u32> = HashSet::new();
    let mut charts = Vec::new();
    for &seed in &order {
        if taken.contains(&seed) {
            continue;
        }
        let mut claims: HashMap<u32, i8> = HashMap::new();
        let mut chart = Vec::new();
        let mut queue = VecDeque::from([seed]);
        while let Some(piece) = queue.pop_front() {
            if taken.contains(&piece) {
                continue;
            }
            let sides = sides(piece);
            let fits = |(k, side): &(u32, i8)| claims.get(k).is_none_or(|c| c == side);
            if piece != seed && !sides.iter().all(fits) {
                continue;
            }
            for (k, side) in sides {
                claims.entry(k).or_insert(side);
            }
            taken.insert(piece);
            chart.push(piece);
            queue.extend(
                open.of(piece as usize)
                    .iter()
                    .filter(|p| !taken.contains(p)),
            );
        }
        chart.sort_unstable();
        charts.push(chart);
    }
    charts
}

/// For each blocked joint whether it belongs to a line of them that is larger than `size_m`.
fn large_contours(sheet: &Sheet, size_m: f32) -> Vec<bool> {
    let n = sheet.blocked.len();
    let mut sets = Sets::new(n);
    let mut at: HashMap<[u32; 2], u32> = HashMap::new();
    for (k, ends) in sheet.blocked.iter().enumerate() {
        for end in ends {
            let key = (*end + Vec2::ZERO).to_array().map(f32::to_bits);
            let other = *at.entry(key).or_insert(k as u32);
            sets.join(k as u32, other);
        }
    }
    let mut bounds = vec![(Vec2::INFINITY, Vec2::NEG_INFINITY); n];
    for (k, [a, b]) in sheet.blocked.iter().enumerate() {
        let (low, high) = &mut bounds[sets.lead(k as u32) as usize];
        (*low, *high) = (low.min(*a).min(*b), high.max(*a).max(*b));
    }
    (0..n as u32)
        .map(|k| {
            let (low, high) = bounds[sets.lead(k) as usize];
            (high - low).length() > size_m
        })
        .collect()
}

/// Whether a convex polygon has area within `reach` of a segment, on one side of it and not beyond
/// its ends.
fn lies_beside(ring: &[Vec2], [a, b]: [Vec2; 2], side: f32, reach: f32) -> bool {
    let length = (b - a).length();
    if length == 0.0 {
        return false;
    }
    let t = (b - a) / length;
    let n = t.perp() * side;
    let trim = 0.02 * length;
    let mut ring = ring.to_vec();
    for (normal, offset) in [
        (t, t.dot(a) + trim),
        (-t, -t.dot(b) + trim),
        (n, n.dot(a)),
        (-n, -n.dot(a) - reach),
    ] {
        ring = clip(&ring, normal, offset);
    }
    area(&ring) > 1e-3 * reach * reach.min(length)
}

/// Lowest and highest coordinates of some points.
pub(crate) fn bounds(points: &[Vec2]) -> (Vec2, Vec2) {
    let low = points.iter().copied().fold(Vec2::INFINITY, Vec2::min);
    let high = points.iter().copied().fold(Vec2::NEG_INFINITY, Vec2::max);
    (low, high)
}

/// The part of a convex polygon with `normal . p >= offset`.
pub(crate) fn clip(ring: &[Vec2], normal: Vec2, offset: f32) -> Vec<Vec2> {
    let mut out = Vec::with_capacity(ring.len() + 1);
    for k in 0..ring.len() {
        let (p, q) = (ring[k], ring[(k + 1) % ring.len()]);
        let (d, e) = (normal.dot(p) - offset, normal.dot(q) - offset);
        if d >= 0.0 {
            out.push(p);
        }
        if (d >= 0.0) != (e >= 0.0) {
            out.push(p + (q - p) * (d / (d - e)));
        }
    }
    out
}

/// Area of a polygon in order, whatever its turn.
pub(crate) fn area(ring: &[Vec2]) -> f32 {
    let twice: f32 = (2..ring.len())
        .map(|k| (ring[k - 1] - ring[0]).perp_dot(ring[k] - ring[0]))
        .sum();
    0.5 * twice.abs()
}

fn curved_sheets(
    pieces: &Pieces,
    texel_m: f32,
    open: &luxel_core::Buckets,
    sheets: &mut Vec<Sheet>,
    groups: &mut Vec<Group>,
) {
    let mut order: Vec<u32> = (0..pieces.len() as u32)
        .filter(|&p| !pieces.flat[p as usize])
        .collect();
    order.sort_by(|a, b| {
        let area = |p: &u32| pieces.area[*p as usize];
        area(b).total_cmp(&area(a)).then(a.cmp(b))
    });
    let mut taken = vec![false; pieces.len()];
    for &seed in &order {
        if taken[seed as usize] {
            continue;
        }
        // Projected along the seed's normal.
        let normal = pieces.normal[seed as usize];
        let u = normal.any_orthonormal_vector();
        let axes = [u, normal.cross(u)];
        let base = pieces.centre(seed as usize);
        let project = |p: Vec3| Vec2::new((p - base).dot(axes[0]), (p - base).dot(axes[1]));
        let longest = LONGEST * texel_m;
        let mut covered: HashSet<(i32, i32)> = HashSet::new();
        let mut chart = Vec::new();
        let mut queue = VecDeque::from([seed]);
        let mut looked: HashSet<u32> = HashSet::from([seed]);
        while let Some(piece) = queue.pop_front() {
            let ring: Vec<Vec2> = (pieces.corners(piece as usize).iter())
                .map(|c| project(*c))
                .collect();
            let faces = pieces.normal[piece as usize].dot(normal) >= COS_CHART;
            let near = ring.iter().all(|p| p.abs().max_element() < 0.5 * longest);
            let under = samples(&ring, 0.5 * texel_m);
            let alone = under.iter().all(|s| !covered.contains(s));
            if piece != seed && !(faces && near && alone) {
                continue;
            }
            covered.extend(under);
            taken[piece as usize] = true;
            chart.push(piece);
            for &next in open.of(piece as usize) {
                if !taken[next as usize] && looked.insert(next) {
                    queue.push_back(next);
                }
            }
        }
        chart.sort_unstable();
        let sheet = lay_along(pieces, chart.clone(), texel_m, axes);
        groups.push(Group {
            sheet: sheets.len() as u32,
            pieces: chart,
        });
        sheets.push(sheet);
    }
}

/// A lattice over some pieces, along given axes.
fn lay_along(pieces: &Pieces, members: Vec<u32>, texel_m: f32, axes: [Vec3; 2]) -> Sheet {
    let base = pieces.corners(members[0] as usize)[0];
    let (low, extent) = extent(pieces, &members, base, axes);
    let texel_m = texel_m.max(extent[0].max(extent[1]) / LONGEST);
    let size = extent.map(|e| match e < SINGLE * texel_m {
        true => 1,
        false => (e / texel_m - 0.01).ceil().max(1.0) as u32 + 1,
    });
    let step = [0, 1].map(|k| match size[k] {
        1 => texel_m,
        n => extent[k] / (n - 1) as f32,
    });
    Sheet {
        origin: base + axes[0] * low.x + axes[1] * low.y,
        axes,
        step,
        extent,
        size,
        pieces: members,
        flat: false,
        blocked: Vec::new(),
    }
}

/// Points of a fine grid that lie inside a triangle.
fn samples(ring: &[Vec2], step: f32) -> Vec<(i32, i32)> {
    let (low, high) = bounds(ring);
    let (low, high) = (low / step, high / step);
    let mut out = Vec::new();
    for j in low.y.floor() as i32..=high.y.ceil() as i32 {
        for i in low.x.floor() as i32..=high.x.ceil() as i32 {
            // Off the nodes, where regular meshes have their corners.
            let p = Vec2::new(i as f32 + 0.31, j as f32 + 0.47) * step;
            let inside = |k: usize| {
                let (a, b) = (ring[k], ring[(k + 1) % ring.len()]);
                (b - a).perp_dot(p - a)
            };
            if (0..ring.len()).all(|k| inside(k) > 0.0) || (0..ring.len()).all(|k| inside(k) < 0.0)
            {
                out.push((i, j));
            }
        }
    }
    out
}
