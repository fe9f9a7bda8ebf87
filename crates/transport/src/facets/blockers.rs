//! What stands in the way: convex polygons, as large as can be, and convex solids.
//!
//! Facets that share an edge in one plane block as one. They are merged, edge by edge, as long
//! as the union stays convex: a wall of a hundred facets becomes one rectangle. Polygons around
//! a convex solid then block as one body, whose shadow from a point is a single convex cone cut
//! by its near faces: a box takes the place of six rectangles. A solid that lacks one flat side
//! (a building on the ground) is closed by a lid, which counts for those who see it from above.
//!
//! Nothing here is needed for a right answer, only for a fast one: what does not merge blocks
//! as it is.

use luxel_core::DVec3;
use luxel_core::polygon::area_vector;
use std::collections::HashMap;

/// Most corners of a merged polygon.
const MOST_CORNERS: usize = 8;
/// Most faces of a solid: all are looked at for each point.
const MOST_FACES: usize = 2000;

/// A plane: `normal . x - offset` is the height in front.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    pub(crate) normal: DVec3,
    pub(crate) offset: f64,
}

impl Plane {
    pub(crate) fn of(corners: &[DVec3]) -> Plane {
        let normal = area_vector(corners).normalize_or_zero();
        let middle = corners.iter().copied().sum::<DVec3>() / corners.len().max(1) as f64;
        Plane {
            normal,
            offset: normal.dot(middle),
        }
    }

    /// The same plane seen from the other side.
    pub(crate) fn flipped(&self) -> Plane {
        Plane {
            normal: -self.normal,
            offset: -self.offset,
        }
    }

    #[inline]
    pub(crate) fn height(&self, p: DVec3) -> f64 {
        self.normal.dot(p) - self.offset
    }

    pub(crate) fn heights(&self, points: &[DVec3]) -> (f64, f64) {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for &p in points {
            let h = self.height(p);
            // One instruction each, which `min` and `max` are not for the sake of NaN.
            low = if h < low { h } else { low };
            high = if h > high { h } else { high };
        }
        (low, high)
    }
}

/// An edge of a blocker: `a` to `b` runs counter-clockwise around `face`, and the other way
/// around `other`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Edge {
    pub(crate) a: DVec3,
    pub(crate) b: DVec3,
    pub(crate) face: u32,
    /// [`Edge::NONE`] around a single polygon.
    pub(crate) other: u32,
}

impl Edge {
    pub(crate) const NONE: u32 = u32::MAX;

    /// Its ends clockwise around the line of sight from where faces look as `looks` says (above 0:
    /// at it); none if it is no edge of the outline.
    #[inline]
    pub(crate) fn in_outline(&self, looks: &[i8]) -> Option<(DVec3, DVec3)> {
        let one = looks[self.face as usize];
        if self.other != Edge::NONE && one == looks[self.other as usize] {
            return None;
        }
        Some(if one > 0 {
            (self.a, self.b)
        } else {
            (self.b, self.a)
        })
    }
}

/// A convex thing that blocks from all sides.
#[derive(Clone, Debug)]
pub(crate) struct Blocker {
    pub(crate) corners: Vec<DVec3>,
    /// One for a polygon; all of them, pointing outwards, for a solid.
    pub(crate) faces: Vec<Plane>,
    pub(crate) edges: Vec<Edge>,
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
    /// Plane of the lid, pointing away from the solid.
    pub(crate) lid: Option<Plane>,
    /// The polygons of a solid one by one: a run of [`Blockers::polygons`].
    pub(crate) polygons: std::ops::Range<u32>,
}

impl Blocker {
    pub(crate) fn is_solid(&self) -> bool {
        self.faces.len() > 1
    }

    fn polygon(corners: Vec<DVec3>) -> Blocker {
        let n = corners.len();
        let edges = (0..n)
            .map(|k| Edge {
                a: corners[k],
                b: corners[(k + 1) % n],
                face: 0,
                other: Edge::NONE,
            })
            .collect();
        let (low, high) = bounds(&corners);
        Blocker {
            faces: vec![Plane::of(&corners)],
            edges,
            low,
            high,
            corners,
            lid: None,
            polygons: 0..0,
        }
    }
}

pub(crate) fn bounds(points: &[DVec3]) -> (DVec3, DVec3) {
    points.iter().fold(
        (DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY)),
        |(low, high), &p| (low.min(p), high.max(p)),
    )
}

/// All that blocks in a scene.
#[derive(Debug, Default)]
pub(crate) struct Blockers {
    /// Solids, and polygons that belong to none.
    pub(crate) list: Vec<Blocker>,
    /// Polygons of the solids.
    pub(crate) polygons: Vec<Blocker>,
}

impl Blockers {
    /// The polygons of a solid.
    pub(crate) fn faces(&self, solid: &Blocker) -> &[Blocker] {
        &self.polygons[solid.polygons.start as usize..solid.polygons.end as usize]
    }
}

/// Merges `polygons`, whose corners are known to `rounding_m`.
pub(crate) fn merge(polygons: &[Vec<DVec3>], rounding_m: f64) -> Blockers {
    let mut welded = Welded::new(polygons, rounding_m);
    // Both sides of a sheet share all edges; they would keep each other from merging.
    welded.drop_doubles();
    welded.merge_while(4);
    welded.merge_while(MOST_CORNERS);
    welded.drop_doubles();
    welded.into_blockers()
}

/// Polygons as cycles of numbered points.
struct Welded {
    points: Vec<DVec3>,
    /// Empty when merged into another.
    cycles: Vec<Vec<u32>>,
    /// Polygons by directed edge; an edge that several have is not merged over.
    at_edge: HashMap<(u32, u32), u32>,
    near_m: f64,
}

const SHARED: u32 = u32::MAX;

impl Welded {
    fn new(polygons: &[Vec<DVec3>], rounding_m: f64) -> Welded {
        let largest = polygons
            .iter()
            .flatten()
            .map(|p| p.abs().max_element())
            .fold(0.0, f64::max);
        let near_m = (2.0 * rounding_m)
            .max(1e-9 * largest)
            .max(f64::MIN_POSITIVE);
        let mut known: HashMap<[i64; 3], u32> = HashMap::new();
        let mut points = Vec::new();
        let mut cycles = Vec::with_capacity(polygons.len());
        for corners in polygons {
            let mut cycle: Vec<u32> = corners
                .iter()
                .map(|&p| {
                    let key = (p / near_m).round().to_array().map(|x| x as i64);
                    *known.entry(key).or_insert_with(|| {
                        points.push(p);
                        points.len() as u32 - 1
                    })
                })
                .collect();
            cycle.dedup();
            while cycle.len() > 1 && cycle.first() == cycle.last() {
                cycle.pop();
            }
            cycles.push(cycle);
        }
        let mut welded = Welded {
            points,
            cycles,
            at_edge: HashMap::new(),
            near_m,
        };
        for polygon in 0..welded.cycles.len() {
            welded.enter(polygon);
        }
        welded
    }

    fn edges(cycle: &[u32]) -> impl Iterator<Item = (u32, u32)> + '_ {
        (0..cycle.len()).map(|k| (cycle[k], cycle[(k + 1) % cycle.len()]))
    }

    fn enter(&mut self, polygon: usize) {
        for edge in Welded::edges(&self.cycles[polygon]) {
            self.at_edge
                .entry(edge)
                .and_modify(|p| *p = SHARED)
                .or_insert(polygon as u32);
        }
    }

    fn leave(&mut self, polygon: usize) {
        for edge in Welded::edges(&self.cycles[polygon]) {
            if self.at_edge.get(&edge) == Some(&(polygon as u32)) {
                self.at_edge.remove(&edge);
            }
        }
    }

    /// Merges neighbours until no union of at most `most` corners is convex.
    fn merge_while(&mut self, most: usize) {
        loop {
            let mut merged = false;
            for polygon in 0..self.cycles.len() {
                while let Some((other, union)) = self.partner(polygon, most) {
                    self.leave(polygon);
                    self.leave(other);
                    self.cycles[other].clear();
                    self.cycles[polygon] = union;
                    self.enter(polygon);
                    merged = true;
                }
            }
            if !merged {
                return;
            }
        }
    }

    /// A neighbour in the same plane and the union with it; over the longest edge first, which
    /// puts the halves of a quad together.
    fn partner(&self, polygon: usize, most: usize) -> Option<(usize, Vec<u32>)> {
        let cycle = &self.cycles[polygon];
        if cycle.len() < 3 {
            return None;
        }
        let mut edges: Vec<usize> = (0..cycle.len()).collect();
        let length = |k: usize| {
            let (a, b) = (cycle[k], cycle[(k + 1) % cycle.len()]);
            self.points[a as usize].distance_squared(self.points[b as usize])
        };
        if cycle.len() == 3 {
            edges.sort_by(|&i, &j| length(j).total_cmp(&length(i)));
        }
        for k in edges {
            let (a, b) = (cycle[k], cycle[(k + 1) % cycle.len()]);
            if self.at_edge.get(&(a, b)) != Some(&(polygon as u32)) {
                continue;
            }
            let Some(&other) = self.at_edge.get(&(b, a)).filter(|&&p| p != SHARED) else {
                continue;
            };
            let other = other as usize;
            if other == polygon || self.cycles[other].len() + cycle.len() > 2 * MOST_CORNERS {
                continue;
            }
            if let Some(union) = self.union(cycle, &self.cycles[other], a, b, most) {
                return Some((other, union));
            }
        }
        None
    }

    fn union(&self, one: &[u32], two: &[u32], a: u32, b: u32, most: usize) -> Option<Vec<u32>> {
        let at = |i: u32| self.points[i as usize];
        let corners: Vec<DVec3> = one.iter().map(|&i| at(i)).collect();
        let plane = Plane::of(&corners);
        let others: Vec<DVec3> = two.iter().map(|&i| at(i)).collect();
        let (low, high) = plane.heights(&others);
        if low < -self.near_m
            || high > self.near_m
            || plane.normal.dot(Plane::of(&others).normal) < 0.999
        {
            return None;
        }
        // one from b round to a, then two from a round to b.
        let turned = |cycle: &[u32], first: u32| -> Vec<u32> {
            let start = cycle.iter().position(|&i| i == first).unwrap_or(0);
            (0..cycle.len())
                .map(|k| cycle[(start + k) % cycle.len()])
                .collect()
        };
        let mut union = turned(one, b);
        let second = turned(two, a);
        union.extend_from_slice(&second[1..second.len() - 1]);
        // Corners in a line are no corners.
        let mut k = 0;
        while union.len() > 3 && k < union.len() {
            let n = union.len();
            let (p, q, r) = (union[(k + n - 1) % n], union[k], union[(k + 1) % n]);
            let along = (at(r) - at(p)).normalize_or_zero();
            let aside = (at(q) - at(p)).cross(along).length();
            if (q == a || q == b) && aside <= self.near_m {
                union.remove(k);
            } else {
                k += 1;
            }
        }
        if union.len() > most {
            return None;
        }
        let n = union.len();
        for k in 0..n {
            let (p, q, r) = (at(union[k]), at(union[(k + 1) % n]), at(union[(k + 2) % n]));
            let turn = (q - p).cross(r - q).dot(plane.normal);
            if turn < 0.0 || (turn == 0.0 && (q - p).dot(r - q) < 0.0) {
                return None;
            }
        }
        // A corner met twice: the union goes round a hole or touches itself.
        let mut sorted = union.clone();
        sorted.sort_unstable();
        sorted.windows(2).all(|w| w[0] != w[1]).then_some(union)
    }

    /// Of polygons with the same corners (two sides of a sheet) one blocks.
    fn drop_doubles(&mut self) {
        let mut known: HashMap<Vec<u32>, usize> = HashMap::new();
        for polygon in 0..self.cycles.len() {
            let mut key = self.cycles[polygon].clone();
            key.sort_unstable();
            if !key.is_empty() && known.insert(key, polygon).is_some() {
                self.leave(polygon);
                self.cycles[polygon].clear();
            }
        }
        self.at_edge.clear();
        for polygon in 0..self.cycles.len() {
            self.enter(polygon);
        }
    }

    fn into_blockers(self) -> Blockers {
        let polygons: Vec<usize> = (0..self.cycles.len())
            .filter(|&p| self.cycles[p].len() >= 3)
            .collect();
        let mut planes: HashMap<usize, Plane> = HashMap::new();
        for &p in &polygons {
            planes.insert(p, Plane::of(&self.corners(p)));
        }
        let mut out = Blockers::default();
        let mut seen = vec![false; self.cycles.len()];
        for &first in &polygons {
            if seen[first] {
                continue;
            }
            // All that hangs together by convex edges.
            let (mut group, mut next) = (vec![first], 0);
            seen[first] = true;
            while next < group.len() {
                let p = group[next];
                next += 1;
                for (a, b) in Welded::edges(&self.cycles[p]) {
                    let Some(q) = self.behind_edge(p, a, b, &planes) else {
                        continue;
                    };
                    if !seen[q] {
                        seen[q] = true;
                        group.push(q);
                    }
                }
            }
            group.sort_unstable();
            match self.body(&group, &planes) {
                Some(mut body) => {
                    let start = out.polygons.len() as u32;
                    let faces = group.iter().map(|&p| Blocker::polygon(self.corners(p)));
                    out.polygons.extend(faces);
                    body.polygons = start..out.polygons.len() as u32;
                    out.list.push(body);
                }
                None => {
                    let faces = group.iter().map(|&p| Blocker::polygon(self.corners(p)));
                    out.list.extend(faces);
                }
            }
        }
        out
    }

    fn corners(&self, polygon: usize) -> Vec<DVec3> {
        self.cycles[polygon]
            .iter()
            .map(|&i| self.points[i as usize])
            .collect()
    }

    /// The polygon on the other side of an edge, if the two turn away from each other there.
    fn behind_edge(
        &self,
        polygon: usize,
        a: u32,
        b: u32,
        planes: &HashMap<usize, Plane>,
    ) -> Option<usize> {
        if self.at_edge.get(&(a, b)) != Some(&(polygon as u32)) {
            return None;
        }
        let &other = self.at_edge.get(&(b, a)).filter(|&&p| p != SHARED)?;
        let (low, high) = planes[&polygon].heights(&self.corners(other as usize));
        (high <= self.near_m && low < -self.near_m).then_some(other as usize)
    }

    /// A group of polygons as one convex solid, closed or with one side for a lid.
    fn body(&self, group: &[usize], planes: &HashMap<usize, Plane>) -> Option<Blocker> {
        if group.len() < 3 || group.len() >= MOST_FACES {
            return None;
        }
        let mut corners: Vec<u32> = group
            .iter()
            .flat_map(|&p| self.cycles[p].iter().copied())
            .collect();
        corners.sort_unstable();
        corners.dedup();
        let corners: Vec<DVec3> = corners.iter().map(|&i| self.points[i as usize]).collect();
        let mut faces: Vec<Plane> = group.iter().map(|p| planes[p]).collect();
        if faces
            .iter()
            .any(|f| f.heights(&corners).1 > self.near_m || f.heights(&corners).0 > -self.near_m)
        {
            return None;
        }
        let (mut edges, mut open) = (Vec::new(), Vec::new());
        for (k, &p) in group.iter().enumerate() {
            for (a, b) in Welded::edges(&self.cycles[p]) {
                let (from, to) = (self.points[a as usize], self.points[b as usize]);
                match self.behind_edge(p, a, b, planes) {
                    Some(q) => {
                        let other = group.iter().position(|&g| g == q)?;
                        if k < other {
                            edges.push(Edge {
                                a: from,
                                b: to,
                                face: k as u32,
                                other: other as u32,
                            });
                        }
                    }
                    None => open.push((from, to, k as u32)),
                }
            }
        }
        let mut lid = None;
        if !open.is_empty() {
            // One closed loop in one plane, with the solid on one side of it.
            let mut rim = vec![open[0]];
            while rim.len() < open.len() {
                let end = rim[rim.len() - 1].0;
                // Around the lid the edges run the other way.
                rim.push(*open.iter().find(|e| e.1 == end)?);
            }
            if rim[rim.len() - 1].0 != rim[0].1 {
                return None;
            }
            let loop_corners: Vec<DVec3> = rim.iter().map(|e| e.1).collect();
            let plane = Plane::of(&loop_corners);
            let (low, high) = plane.heights(&loop_corners);
            if plane.normal == DVec3::ZERO || low < -self.near_m || high > self.near_m {
                return None;
            }
            let (low, high) = plane.heights(&corners);
            if high > self.near_m || low > -self.near_m {
                return None;
            }
            let face = faces.len() as u32;
            faces.push(plane);
            edges.extend(rim.iter().map(|&(a, b, k)| Edge {
                a,
                b,
                face: k,
                other: face,
            }));
            lid = Some(plane);
        }
        let (low, high) = bounds(&corners);
        Some(Blocker {
            corners,
            faces,
            edges,
            low,
            high,
            lid,
            polygons: 0..0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(o: DVec3, u: DVec3, v: DVec3, n: usize, triangles: bool) -> Vec<Vec<DVec3>> {
        let at = |i: usize, j: usize| o + u * (i as f64 / n as f64) + v * (j as f64 / n as f64);
        let mut out = Vec::new();
        for j in 0..n {
            for i in 0..n {
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                if triangles {
                    out.extend([vec![a, b, c], vec![a, c, d]]);
                } else {
                    out.push(vec![a, b, c, d]);
                }
            }
        }
        out
    }

    /// Faces of a box pointing outwards, the floor last.
    fn cube(n: usize, triangles: bool) -> Vec<Vec<DVec3>> {
        let (x, y, z, o) = (DVec3::X, DVec3::Y, DVec3::Z, DVec3::ZERO);
        [
            (z, x, y),
            (o, x, z),
            (y, z, x),
            (o, z, y),
            (x, y, z),
            (o, y, x),
        ]
        .into_iter()
        .flat_map(|(o, u, v)| grid(o, u, v, n, triangles))
        .collect()
    }

    #[test]
    fn a_grid_becomes_one_rectangle() {
        for triangles in [false, true] {
            for n in [2, 5, 7] {
                let o = DVec3::new(0.1, -0.3, 7.0);
                let (u, v) = (DVec3::new(0.7, 0.1, 0.3), DVec3::new(-0.2, 1.1, 0.2));
                let merged = merge(&grid(o, u, v, n, triangles), 0.0);
                assert_eq!(merged.list.len(), 1, "{n} {triangles}");
                assert_eq!(merged.list[0].corners.len(), 4);
            }
        }
    }

    #[test]
    fn a_box_becomes_one_body_with_or_without_its_floor() {
        for triangles in [false, true] {
            let closed = cube(3, triangles);
            let merged = merge(&closed, 0.0);
            assert_eq!(merged.list.len(), 1);
            let body = &merged.list[0];
            assert_eq!(
                (body.faces.len(), body.edges.len(), body.corners.len()),
                (6, 12, 8)
            );
            assert!(body.lid.is_none() && merged.polygons.len() == 6);
            let floor = if triangles { 18 } else { 9 };
            let open = merge(&closed[..closed.len() - floor], 0.0);
            assert_eq!(open.list.len(), 1);
            assert!(
                open.list[0]
                    .lid
                    .is_some_and(|l| l.normal.distance(-DVec3::Z) < 1e-12)
            );
            assert_eq!(open.list[0].edges.len(), 12);
        }
    }

    #[test]
    fn a_room_is_no_body_and_a_sheet_with_two_sides_blocks_once() {
        let room: Vec<Vec<DVec3>> = cube(2, false)
            .into_iter()
            .map(|mut c| {
                c.reverse();
                c
            })
            .collect();
        let merged = merge(&room, 0.0);
        assert!(merged.list.len() == 6 && merged.list.iter().all(|b| !b.is_solid()));
        let sheet = grid(DVec3::ZERO, DVec3::X, DVec3::Y, 2, false);
        let back: Vec<Vec<DVec3>> = sheet
            .iter()
            .map(|c| c.iter().rev().copied().collect())
            .collect();
        assert_eq!(merge(&[sheet, back].concat(), 0.0).list.len(), 1);
    }

    #[test]
    fn an_l_stays_in_convex_pieces() {
        let mut cells = grid(DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 4.0, 4, false);
        cells.retain(|c| !(c[0].x >= 2.0 && c[0].y >= 2.0));
        let merged = merge(&cells, 0.0);
        let area: f64 = merged
            .list
            .iter()
            .map(|b| luxel_core::Polygon::new(b.corners.clone()).area())
            .sum();
        assert!((area - 12.0).abs() < 1e-12 && merged.list.len() <= 3);
    }
}
