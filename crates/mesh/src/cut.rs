//! One triangle cut along lines: constrained Delaunay triangulation in coordinates in which its
//! border is exact.
//!
//! Coordinates are barycentric weights rounded to 2^-40 and stretched by powers of two to about
//! the true lengths. Then points on all three edges are collinear without rounding, the hull of
//! the triangulation is the triangle, and its pieces fill it. Lines are cut before where they cross
//! each other and at points near them (snapping), so that none cross in the triangulation.
//!
//! Where shadow lines cut, points are added about as far from each other as elements are wide: along
//! the lines, and inside on a grid along the triangle's legs. None is put within the circle over a
//! piece of line or border as its diameter, so that lines stay edges of good triangles [Ruppert95].
//!
//! Delaunay triangulation: crate spade, whose predicates are exact.

use luxel_core::DVec3;
use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, Triangulation};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// A point of the triangle: weights of corners 1 and 2, exact on the border.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weights {
    pub u: f64,
    pub v: f64,
}

/// Where a point lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum End {
    Corner(usize),
    /// On edge k (corner k to k + 1), that far along.
    Edge(usize, f64),
    Inside(Weights),
}

impl End {
    pub fn weights(self) -> Weights {
        match self {
            End::Corner(k) => on_edge(k, 0.0),
            End::Edge(k, t) => on_edge(k, t),
            End::Inside(w) => w,
        }
    }
}

/// What a contact line does to a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Effect {
    Nothing,
    /// It runs along edge k between two places, `0 <= from < to <= 1`.
    Along(usize, f64, f64),
    Cut(End, End),
}

/// Geometry of the triangle to be cut.
pub(crate) struct Frame {
    corners: [DVec3; 3],
    normal: DVec3,
    nn: f64,
    /// Height over each edge, metres.
    heights: [f64; 3],
    lengths: [f64; 3],
}

const GRID: f64 = (1u64 << 40) as f64;

fn on_grid(x: f64) -> f64 {
    (x * GRID).round() / GRID
}

impl Frame {
    pub fn new(corners: [DVec3; 3]) -> Frame {
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a);
        let lengths = [(b - a).length(), (c - b).length(), (a - c).length()];
        Frame {
            corners,
            normal,
            nn: normal.length_squared(),
            heights: lengths.map(|l| normal.length() / l),
            lengths,
        }
    }

    /// Weights of the corners opposite to edges 0, 1, 2, i.e. of corners 2, 0, 1: each is the
    /// distance from that edge as a share of the height over it.
    fn shares(&self, p: DVec3) -> [f64; 3] {
        std::array::from_fn(|k| {
            let (a, b) = (self.corners[k], self.corners[(k + 1) % 3]);
            (b - a).cross(p - a).dot(self.normal) / self.nn
        })
    }

    fn along(&self, k: usize, p: DVec3) -> f64 {
        let (a, b) = (self.corners[k], self.corners[(k + 1) % 3]);
        (p - a).dot(b - a) / (b - a).length_squared()
    }

    /// What a line in the plane does to this triangle; places within `tolerance` of a corner or
    /// an edge are on it.
    pub fn effect(&self, [p, q]: [DVec3; 2], tolerance: f64) -> Effect {
        let (dp, dq) = (self.shares(p), self.shares(q));
        for k in 0..3 {
            if dp[k].abs() * self.heights[k] <= tolerance
                && dq[k].abs() * self.heights[k] <= tolerance
            {
                let (s, t) = (self.along(k, p), self.along(k, q));
                let (from, to) = (s.min(t).clamp(0.0, 1.0), s.max(t).clamp(0.0, 1.0));
                let least = tolerance / self.lengths[k];
                return if to - from > least {
                    Effect::Along(k, from, to)
                } else {
                    Effect::Nothing
                };
            }
        }
        let (mut from, mut to) = (0.0f64, 1.0f64);
        for k in 0..3 {
            if dp[k] < 0.0 && dq[k] < 0.0 {
                return Effect::Nothing;
            }
            if dp[k] < 0.0 {
                from = from.max(dp[k] / (dp[k] - dq[k]));
            } else if dq[k] < 0.0 {
                to = to.min(dp[k] / (dp[k] - dq[k]));
            }
        }
        if (to - from) * (q - p).length() <= tolerance {
            return Effect::Nothing;
        }
        let ends = [
            self.end(p + (q - p) * from, tolerance),
            self.end(p + (q - p) * to, tolerance),
        ];
        let on = |end: End, edge: usize| match end {
            End::Corner(k) => k == edge || k == (edge + 1) % 3,
            End::Edge(k, _) => k == edge,
            End::Inside(_) => false,
        };
        if (0..3).any(|k| on(ends[0], k) && on(ends[1], k)) || ends[0] == ends[1] {
            return Effect::Nothing;
        }
        Effect::Cut(ends[0], ends[1])
    }

    fn end(&self, p: DVec3, tolerance: f64) -> End {
        for (k, c) in self.corners.iter().enumerate() {
            if p.distance(*c) <= tolerance {
                return End::Corner(k);
            }
        }
        let d = self.shares(p);
        let near = |k: usize| d[k] * self.heights[k];
        let k = (1..3).fold(0, |best, k| if near(k) < near(best) { k } else { best });
        if near(k) <= tolerance {
            return End::Edge(k, self.along(k, p).clamp(0.0, 1.0));
        }
        End::Inside(Weights {
            u: on_grid(d[2]),
            v: on_grid(d[0]),
        })
    }

    /// How much of `v` points along the normal.
    pub fn facing(&self, v: DVec3) -> f64 {
        v.dot(self.normal.normalize_or_zero())
    }

    /// The point with these weights, metres.
    pub fn point(&self, w: Weights) -> DVec3 {
        let [a, b, c] = self.corners;
        a + (b - a) * w.u + (c - a) * w.v
    }
}

/// Weights of the place `t` along edge `k`, exact on the edge.
pub(crate) fn on_edge(k: usize, t: f64) -> Weights {
    let t = on_grid(t);
    match k {
        0 => Weights { u: t, v: 0.0 },
        1 => Weights { u: 1.0 - t, v: t },
        _ => Weights { u: 0.0, v: 1.0 - t },
    }
}

/// Where two lines cross, ends excluded.
pub(crate) fn crossing([p, q]: [Weights; 2], [r, s]: [Weights; 2]) -> Option<Weights> {
    let side =
        |a: Weights, b: Weights, c: Weights| (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
    let (a, b) = (side(r, s, p), side(r, s, q));
    if a * b >= 0.0 || side(p, q, r) * side(p, q, s) >= 0.0 {
        return None;
    }
    let t = a / (a - b);
    Some(Weights {
        u: on_grid(p.u + (q.u - p.u) * t),
        v: on_grid(p.v + (q.v - p.v) * t),
    })
}

/// Pieces of a triangle: corners as indices into `points` and whether each edge (corner k to
/// k + 1) is a cut.
pub(crate) struct Pieces {
    pub points: Vec<Weights>,
    pub triangles: Vec<([u32; 3], [bool; 3])>,
    /// Whether it is cut along all of every contact line.
    pub whole: bool,
}

/// How the lines of a triangle are treated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Filling {
    /// The first so many lines are contact lines.
    pub contacts: usize,
    /// Distance of the points to fill it with, metres, if it is to be filled.
    pub spacing_m: Option<f64>,
}

struct Vertex {
    position: Point2<f64>,
    id: u32,
}

impl HasPosition for Vertex {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.position
    }
}

/// Cuts a triangle along `lines` (pairs of indices into `points`), and fills it with points. The first three points are the
/// corners; points on the border are exact. `None` if the triangulation fails.
pub(crate) fn cut(
    frame: &Frame,
    points: Vec<Weights>,
    lines: &[[u32; 2]],
    filling: Filling,
    tolerance: f64,
) -> Option<Pieces> {
    // A failed assertion in the triangulation must not end a job of hours.
    catch_unwind(AssertUnwindSafe(|| {
        triangulate(frame, points, lines, filling, tolerance)
    }))
    .ok()
    .flatten()
}

fn triangulate(
    frame: &Frame,
    mut points: Vec<Weights>,
    lines: &[[u32; 2]],
    filling: Filling,
    tolerance: f64,
) -> Option<Pieces> {
    add_crossings(frame, &mut points, lines, tolerance);
    // The corner nearest to a right angle becomes the origin.
    let skew = |k: usize| {
        let [a, b, c] = [0, 1, 2].map(|i| frame.corners[(k + i) % 3]);
        ((b - a).dot(c - a) / ((b - a).length() * (c - a).length())).abs()
    };
    let k = (1..3).fold(0, |best, k| if skew(k) < skew(best) { k } else { best });
    let mut chains = chains(frame, &points, lines, tolerance);
    if let Some(spacing_m) = filling.spacing_m {
        fill(frame, &mut points, &mut chains, k, spacing_m, tolerance);
    }
    // Scaled so that the longer leg is about 1: spade dislikes neither, and f64 has room.
    let longer = frame.lengths[k].max(frame.lengths[(k + 2) % 3]);
    let power = |length: f64| (length / longer).max(1e-9).log2().round().exp2();
    let (x, y) = (power(frame.lengths[k]), power(frame.lengths[(k + 2) % 3]));
    let to_plane = |w: Weights| {
        let all = [1.0 - w.u - w.v, w.u, w.v];
        Point2::new(all[(k + 1) % 3] * x, all[(k + 2) % 3] * y)
    };
    let mut net = ConstrainedDelaunayTriangulation::<Vertex>::new();
    let mut handles = Vec::with_capacity(points.len());
    for (i, &w) in points.iter().enumerate() {
        handles.push(
            net.insert(Vertex {
                position: to_plane(w),
                id: i as u32,
            })
            .ok()?,
        );
    }
    let mut whole = true;
    let pieces = chains
        .iter()
        .enumerate()
        .flat_map(|(i, c)| c.windows(2).map(move |w| (i, w[0], w[1])));
    for (line, from, to) in pieces {
        if handles[from as usize] != handles[to as usize]
            && !on_one_edge(points[from as usize], points[to as usize])
        {
            let [from, to] = [from, to].map(|i| handles[i as usize]);
            // Snapping can make two pieces of lines cross that did not before.
            if net.can_add_constraint(from, to) {
                net.add_constraint(from, to);
            } else if line < filling.contacts {
                whole = false;
            }
        }
    }
    let triangles = net.inner_faces().map(|face| {
        let edges = face.adjacent_edges();
        (
            edges.map(|e| e.from().data().id),
            edges.map(|e| e.is_constraint_edge()),
        )
    });
    Some(Pieces {
        triangles: triangles.collect(),
        points,
        whole,
    })
}

/// Each line as the points on it, from end to end. Points near a line become part of it, or
/// hair-thin gaps would join both sides.
fn chains(frame: &Frame, points: &[Weights], lines: &[[u32; 2]], tolerance: f64) -> Vec<Vec<u32>> {
    let placed: Vec<DVec3> = points.iter().map(|&w| frame.point(w)).collect();
    let mut near: Vec<(f64, u32)> = Vec::new();
    let mut all = Vec::with_capacity(lines.len());
    for &[a, b] in lines {
        let (p, q) = (placed[a as usize], placed[b as usize]);
        let length = (q - p).length();
        if length == 0.0 {
            all.push(vec![a]);
            continue;
        }
        let direction = (q - p) / length;
        near.clear();
        for (i, &r) in placed.iter().enumerate() {
            let t = (r - p).dot(direction);
            if t > 0.0 && t < length && (r - p - direction * t).length() <= tolerance {
                near.push((t, i as u32));
            }
        }
        near.sort_by(|s, t| s.0.total_cmp(&t.0).then(s.1.cmp(&t.1)));
        let inner = near.iter().map(|c| c.1);
        all.push([a].into_iter().chain(inner).chain([b]).collect());
    }
    all
}

/// Points that fill a triangle keep this share of the spacing from others, and from lines and
/// border.
const APART: f64 = 0.3;

/// Adds points along the lines, which become part of their chains, and between them. Those of the
/// grid are multiples of the legs at corner `k`.
fn fill(
    frame: &Frame,
    points: &mut Vec<Weights>,
    chains: &mut [Vec<u32>],
    k: usize,
    spacing_m: f64,
    tolerance: f64,
) {
    let least = (APART * spacing_m).max(4.0 * tolerance);
    let mut taken = Places::new(frame, spacing_m);
    points.iter().for_each(|&w| taken.add_point(frame.point(w)));
    for pair in chains.iter().flat_map(|c| c.windows(2)) {
        taken.add_piece(pair.iter().map(|&i| frame.point(points[i as usize])));
    }
    for chain in &mut *chains {
        let mut filled = vec![chain[0]];
        for pair in chain.windows(2) {
            let [p, q] = [pair[0], pair[1]].map(|i| frame.point(points[i as usize]));
            let n = ((q - p).length() / spacing_m - 0.01).ceil().max(1.0) as usize;
            for i in 1..n {
                let share = i as f64 / n as f64;
                let r = p + (q - p) * share;
                // Another line that runs close by goes straight past this place.
                if taken.is_clear(r, least, Some([p, q])) {
                    let [a, b] = [pair[0], pair[1]].map(|i| points[i as usize]);
                    filled.push(points.len() as u32);
                    points.push(Weights {
                        u: on_grid(a.u + (b.u - a.u) * share),
                        v: on_grid(a.v + (b.v - a.v) * share),
                    });
                    taken.add_point(r);
                }
            }
            filled.push(pair[1]);
        }
        *chain = filled;
    }
    // Pieces as they are now, and those of the border.
    let mut circles = Places::new(frame, spacing_m);
    for w in points.iter() {
        circles.add_point(frame.point(*w));
    }
    for edge in 0..3 {
        let mut at: Vec<DVec3> = points
            .iter()
            .filter(|&&w| edges_of(w)[edge])
            .map(|&w| frame.point(w))
            .collect();
        let origin = frame.corners[edge];
        at.sort_by(|a, b| a.distance(origin).total_cmp(&b.distance(origin)));
        at.windows(2)
            .for_each(|w| circles.add_piece(w.iter().copied()));
    }
    for pair in chains.iter().flat_map(|c| c.windows(2)) {
        circles.add_piece(pair.iter().map(|&i| frame.point(points[i as usize])));
    }
    // Rows are a spacing apart, measured across them.
    let cells = |length: f64| (length / spacing_m - 0.01).ceil().clamp(1.0, 4096.0) as usize;
    let (n, m) = (cells(frame.lengths[k]), cells(frame.heights[k]));
    for j in 1..m {
        for i in 1..n {
            let mut weights = [0.0; 3];
            weights[(k + 1) % 3] = i as f64 / n as f64;
            weights[(k + 2) % 3] = j as f64 / m as f64;
            weights[k] = 1.0 - weights[(k + 1) % 3] - weights[(k + 2) % 3];
            if weights[k] <= 0.0 {
                break;
            }
            let w = Weights {
                u: on_grid(weights[1]),
                v: on_grid(weights[2]),
            };
            let p = frame.point(w);
            let share = frame.shares(p);
            let inside = (0..3).all(|e| share[e] * frame.heights[e] > least);
            if inside && circles.is_clear(p, least, None) && !circles.is_in_circle(p) {
                points.push(w);
            }
        }
    }
}

/// Points and pieces of lines by cells of space.
struct Places {
    origin: DVec3,
    axes: [DVec3; 2],
    cell_m: f64,
    points: HashMap<[i64; 2], Vec<DVec3>>,
    pieces: HashMap<[i64; 2], Vec<[DVec3; 2]>>,
    /// Pieces longer than a few cells.
    long: Vec<[DVec3; 2]>,
}

impl Places {
    fn new(frame: &Frame, cell_m: f64) -> Places {
        let x = (frame.corners[1] - frame.corners[0]).normalize_or_zero();
        Places {
            origin: frame.corners[0],
            axes: [x, frame.normal.normalize_or_zero().cross(x)],
            cell_m,
            points: HashMap::new(),
            pieces: HashMap::new(),
            long: Vec::new(),
        }
    }

    fn cell(&self, p: DVec3) -> [i64; 2] {
        self.axes
            .map(|a| ((p - self.origin).dot(a) / self.cell_m).floor() as i64)
    }

    fn add_point(&mut self, p: DVec3) {
        self.points.entry(self.cell(p)).or_default().push(p);
    }

    fn add_piece(&mut self, mut ends: impl Iterator<Item = DVec3>) {
        let (Some(p), Some(q)) = (ends.next(), ends.next()) else {
            return;
        };
        if (q - p).length() > 2.0 * self.cell_m {
            self.long.push([p, q]);
        } else {
            self.pieces
                .entry(self.cell(0.5 * (p + q)))
                .or_default()
                .push([p, q]);
        }
    }

    /// What is stored within `reach` cells of that of `p`.
    fn around<'a, T>(
        &self,
        map: &'a HashMap<[i64; 2], Vec<T>>,
        p: DVec3,
        reach: i64,
    ) -> impl Iterator<Item = &'a T> {
        let [x, y] = self.cell(p);
        (-reach..=reach)
            .flat_map(move |i| (-reach..=reach).map(move |j| [x + i, y + j]))
            .filter_map(|cell| map.get(&cell))
            .flatten()
    }

    /// Whether no point and no piece but `own` is nearer than `least`, which is below a cell.
    fn is_clear(&self, p: DVec3, least: f64, own: Option<[DVec3; 2]>) -> bool {
        let near = |&[a, b]: &[DVec3; 2]| {
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            own != Some([a, b]) && p.distance(a + (b - a) * t) < least
        };
        self.around(&self.points, p, 1)
            .all(|q| q.distance(p) >= least)
            && !self.around(&self.pieces, p, 2).any(near)
            && !self.long.iter().any(near)
    }

    /// Whether `p` is in the circle that has a piece as its diameter.
    fn is_in_circle(&self, p: DVec3) -> bool {
        let inside = |&[a, b]: &[DVec3; 2]| (a - p).dot(b - p) < 0.0;
        self.around(&self.pieces, p, 1).any(inside) || self.long.iter().any(inside)
    }
}

/// Adds the points where lines cross, but where one is near already.
fn add_crossings(frame: &Frame, points: &mut Vec<Weights>, lines: &[[u32; 2]], tolerance: f64) {
    let ends: Vec<[Weights; 2]> = lines
        .iter()
        .map(|line| line.map(|i| points[i as usize]))
        .collect();
    let mut placed: Vec<DVec3> = points.iter().map(|&w| frame.point(w)).collect();
    for (i, &a) in ends.iter().enumerate() {
        for &b in &ends[..i] {
            let Some(w) = crossing(a, b) else { continue };
            let p = frame.point(w);
            if placed.iter().all(|q| q.distance(p) > tolerance) {
                points.push(w);
                placed.push(p);
            }
        }
    }
}

/// Edges that a point is on.
pub(crate) fn edges_of(w: Weights) -> [bool; 3] {
    [w.v == 0.0, w.u + w.v == 1.0, w.u == 0.0]
}

fn on_one_edge(a: Weights, b: Weights) -> bool {
    let (a, b) = (edges_of(a), edges_of(b));
    (0..3).any(|k| a[k] && b[k])
}

/// The pieces of a triangle whose border has more points but nothing inside: no triangulation
/// can fail here. `border[k]` are the indices of the points on edge k in order.
pub(crate) fn fan(points: Vec<Weights>, border: &[Vec<u32>; 3]) -> Pieces {
    let mut triangles = Vec::new();
    split(
        [0, 1, 2],
        [&border[0], &border[1], &border[2]],
        &mut triangles,
    );
    Pieces {
        points,
        triangles,
        whole: true,
    }
}

/// Splits at the middle point of the fullest edge, towards the corner across.
fn split(corners: [u32; 3], border: [&[u32]; 3], out: &mut Vec<([u32; 3], [bool; 3])>) {
    let k = (1..3).fold(0, |best, k| {
        if border[k].len() > border[best].len() {
            k
        } else {
            best
        }
    });
    let full = border[k];
    if full.is_empty() {
        out.push((corners, [false; 3]));
        return;
    }
    let middle = full.len() / 2;
    let [a, b, c] = [0, 1, 2].map(|i| corners[(k + i) % 3]);
    let p = full[middle];
    split([a, p, c], [&full[..middle], &[], border[(k + 2) % 3]], out);
    split(
        [p, b, c],
        [&full[middle + 1..], border[(k + 1) % 3], &[]],
        out,
    );
}
