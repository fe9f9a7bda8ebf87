//! Exchange area of two parts with something between them.
//!
//! From a point of the sender the shadow of a convex blocker on the receiver is one convex
//! polygon: the receiver, cut by the planes through the point and the edges of the blocker's
//! outline, and by the faces that look at the point. What is left is an integral over the sender,
//! which is smooth but for kinks where an edge of a blocker lines up with a corner of the
//! receiver, or a corner with an edge. Those lines are known: the sender is cut along them, and
//! a rule of few nodes on each piece is enough. Pieces that do not agree with a coarser rule are
//! halved, the worst first, until the asked error is met.
//!
//! The volume of the tetrahedron of an edge, a point of the sender and one of the receiver is
//! linear in both points. Its signs at the corners therefore tell which edges of a blocker matter
//! to a pair at all, whether it hides nothing, and whether it hides everything.
//!
//! The rule only tells which share is hidden. It is taken of the exact free value: of the whole
//! where the rule meets it, else, near a common edge, where the kernel is steep, of each piece.
//!
//! Sources: exact shadows by polygon clipping [Nishita85]; critical lines of area light
//! [Lischinski92] (vertex-edge events; those of three edges are left to the error estimate).

use super::blockers::{Blocker, Edge, Plane};
use super::ring::{Chart, Line, MOST_HALVINGS, Ring};
use super::shaft::hides;
use crate::lambert::above_horizon;
use crate::polygon_pair::{ball, exchange_area};
use luxel_core::glam::DVec2;
use luxel_core::{DVec3, Polygon};
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::f64::consts::PI;
use std::ops::Range;

/// Critical lines along which a sender is cut, at most.
const MOST_CUTS: usize = 160;
/// Pieces that cutting may make, about; more lines are then left to halving.
const MOST_PIECES: usize = 400;
/// Shadows that a pair may cut, about, one a point and blocker: bounds the time for pairs with a
/// heap of things between them. What error is left is stated.
const MOST_SHADOWS: usize = 120_000;

/// Share of a sender with more lines than were cut, above which a piece that looks wholly seen or
/// wholly hidden is looked at again.
const DOUBTED: f64 = 0.01;

/// Edges and faces that matter, of all blockers of a pair.
#[derive(Default)]
struct Outlines {
    edges: Vec<OutlineEdge>,
    /// Faces that look at the sender and do not have all of the receiver behind them, as planes
    /// with the hidden side in front.
    faces: Vec<Plane>,
    /// Edges that are in the outline from some points of the sender only.
    turning: Vec<TurningEdge>,
    /// Which faces of the turning blockers look at the sender, 0 where it depends on the point.
    looks: Vec<i8>,
}

impl Outlines {
    fn clear(&mut self) {
        self.edges.clear();
        self.faces.clear();
        self.turning.clear();
        self.looks.clear();
    }
}

/// An edge, clockwise around the line of sight from the sender.
#[derive(Clone, Copy)]
struct OutlineEdge {
    a: DVec3,
    b: DVec3,
    /// Corners of the receiver whose plane with the edge crosses the sender, bit by bit.
    crossing: u32,
}

/// An edge whose place in the outline depends on the point.
#[derive(Clone, Copy)]
struct TurningEdge {
    edge: Edge,
    crossing: u32,
}

/// A value in m² and how far off it may be.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Exchange {
    pub(crate) value: f64,
    pub(crate) error: f64,
}

/// Buffers kept between pairs.
#[derive(Default)]
pub(crate) struct Scratch {
    cells: Vec<Ring>,
    found: Vec<Found>,
    shadows: Vec<Ring>,
    pieces: Vec<Ring>,
    cuts: Vec<Line>,
    outlines: Outlines,
    looks: Vec<i8>,
    /// Pairs that came to `between`, pieces, points: what work was done.
    pub(crate) counts: [u64; 3],
}

/// What to ask of a pair.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asked {
    /// Exchange area without blockers, m².
    pub(crate) free: f64,
    /// Error allowed, m².
    pub(crate) tolerance: f64,
    /// Heights that are none, metres.
    pub(crate) near_m: f64,
    /// Kinks that close to an end of a piece, as a share of its area, are left in it.
    pub(crate) sliver: f64,
    /// Receivers farther than this many times their radius count by the kernel at the middle of
    /// what is seen of them.
    pub(crate) far: f64,
    /// Pieces of at most this share of the sender's area get one node.
    pub(crate) small: f64,
}

/// Exchange area past `blockers`. Both polygons lie wholly in front of each other.
pub(crate) fn between(
    from: &Polygon,
    to: &Polygon,
    blockers: &[&Blocker],
    asked: &Asked,
    scratch: &mut Scratch,
) -> Exchange {
    let free = Exchange {
        value: asked.free,
        error: 0.0,
    };
    let ((from_middle, rf), (to_middle, rt)) = (ball(from), ball(to));
    let (sender, receiver, reach) = if rf <= rt {
        (from, to, rt)
    } else {
        (to, from, rf)
    };
    let (s, r) = (&sender.vertices, &receiver.vertices);
    let mut casts = Vec::with_capacity(blockers.len());
    scratch.outlines.clear();
    for &blocker in blockers {
        match Cast::of(blocker, s, r, asked.near_m, &mut scratch.outlines) {
            Standing::Aside => {}
            Standing::Everywhere => return Exchange::default(),
            Standing::Between(cast) => casts.push(cast),
        }
    }
    if casts.is_empty() {
        return free;
    }
    scratch.counts[0] += 1;
    let pair = Pair {
        from: Chart::of(s, sender.normal()),
        to: Chart::of(r, receiver.normal()),
        far: from_middle.distance(to_middle) - rf.min(rt) > asked.far * reach,
    };
    let start = pair.from.ring(s);
    let outlines = std::mem::take(&mut scratch.outlines);
    let view = View::of(pair, receiver, &casts, &outlines, asked.near_m);
    critical_lines(&view, s, &start, r, asked.near_m, &mut scratch.cuts);
    let found = by_pieces(&view, start, asked, scratch);
    scratch.outlines = outlines;
    found
}

/// Configuration factor from a point with a unit normal to the front of a polygon past blockers.
/// The point lies in front of the polygon. Exact.
pub(crate) fn seen_from(
    x: DVec3,
    normal: DVec3,
    to: &Polygon,
    blockers: &[&Blocker],
    near_m: f64,
    scratch: &mut Scratch,
) -> f64 {
    let r = &to.vertices;
    let all = above_horizon(x, normal, r);
    let mut casts = Vec::with_capacity(blockers.len());
    scratch.outlines.clear();
    for &blocker in blockers {
        match Cast::of(blocker, &[x], r, near_m, &mut scratch.outlines) {
            Standing::Aside => {}
            Standing::Everywhere => return 0.0,
            Standing::Between(cast) => casts.push(cast),
        }
    }
    if all <= 0.0 || casts.is_empty() {
        return all;
    }
    let pair = Pair {
        from: Chart {
            origin: x,
            u: DVec3::ZERO,
            v: DVec3::ZERO,
            normal,
        },
        to: Chart::of(r, to.normal()),
        far: false,
    };
    let outlines = std::mem::take(&mut scratch.outlines);
    let view = View::of(pair, to, &casts, &outlines, near_m);
    let (hidden, all) = hidden_from(&view, DVec2::ZERO, scratch);
    scratch.outlines = outlines;
    all - hidden
}

/// Two polygons with axes on each.
struct Pair {
    from: Chart,
    to: Chart,
    /// Whether the receiver is small for its distance.
    far: bool,
}

/// A blocker as one pair meets it.
struct Cast<'a> {
    /// Run of the outlines' edges.
    edges: Range<usize>,
    /// Run of the outlines' faces.
    faces: Range<usize>,
    /// What is more, if its outline is not the same from everywhere on the sender.
    turning: Option<Turning<'a>>,
}

struct Turning<'a> {
    blocker: &'a Blocker,
    /// Run of the outlines' turning edges.
    edges: Range<usize>,
    /// Run of the outlines' looks, one a face.
    looks: Range<usize>,
}

/// Which way the volumes of an edge, the sender and the receiver are turned.
enum Side {
    /// The receiver is wholly where the edge hides nothing.
    Clear,
    /// Wholly where it leaves all to the other edges.
    Dark,
    /// On both sides.
    Both,
}

enum Standing<'a> {
    Aside,
    Everywhere,
    Between(Cast<'a>),
}

impl<'a> Cast<'a> {
    fn of(
        blocker: &'a Blocker,
        s: &[DVec3],
        r: &[DVec3],
        near_m: f64,
        outlines: &mut Outlines,
    ) -> Standing<'a> {
        let start = (
            outlines.edges.len(),
            outlines.faces.len(),
            outlines.turning.len(),
            outlines.looks.len(),
        );
        let cast = Cast::sort(blocker, s, r, near_m, outlines);
        if !matches!(cast, Standing::Between(_)) {
            outlines.edges.truncate(start.0);
            outlines.faces.truncate(start.1);
            outlines.turning.truncate(start.2);
        }
        if !matches!(&cast, Standing::Between(Cast { turning, .. }) if turning.is_some()) {
            outlines.looks.truncate(start.3);
        }
        cast
    }

    /// Sorts faces and edges into those that matter, always or from some points, and others.
    fn sort(
        blocker: &'a Blocker,
        s: &[DVec3],
        r: &[DVec3],
        near_m: f64,
        outlines: &mut Outlines,
    ) -> Standing<'a> {
        let Outlines {
            edges,
            faces,
            turning,
            looks,
        } = outlines;
        let start = (edges.len(), faces.len(), turning.len(), looks.len());
        let single = !blocker.is_solid();
        // 1: looks at all of the sender; -1: at none of it; 0: at some.
        let mut turns = false;
        let mut any = false;
        for face in &blocker.faces {
            let (low, high) = face.heights(s);
            let look = if low >= -near_m {
                1_i8
            } else if high <= near_m {
                -1
            } else {
                turns = true;
                0
            };
            looks.push(look);
            if look == 1 || (single && look == -1) {
                any = true;
                // The hidden side in front.
                let dark = if look > 0 { face.flipped() } else { *face };
                let (low, high) = dark.heights(r);
                if high <= near_m {
                    return Standing::Aside;
                }
                if low < -near_m {
                    faces.push(dark);
                }
            }
        }
        if turns {
            if hides(blocker, s, r, near_m) {
                return Standing::Everywhere;
            }
        } else if !any {
            return Standing::Aside;
        }
        let looks = &looks[start.3..];
        for edge in &blocker.edges {
            let other = match edge.other {
                // The back of a single polygon looks where its front does not.
                Edge::NONE => -looks[edge.face as usize],
                other => looks[other as usize],
            };
            let one = looks[edge.face as usize];
            if one == other && one != 0 {
                continue;
            }
            // One that is known tells which way round the edge is, if it is in the outline.
            let (a, b) = if one > 0 || other < 0 {
                (edge.a, edge.b)
            } else {
                (edge.b, edge.a)
            };
            let (side, crossing) = side((a, b), s, r, near_m);
            if one == 0 && other == 0 {
                turning.push(TurningEdge {
                    edge: *edge,
                    crossing,
                });
                continue;
            }
            let always = one != 0 && other != 0;
            match side {
                Side::Clear if always => return Standing::Aside,
                Side::Dark => {}
                _ if always => edges.push(OutlineEdge { a, b, crossing }),
                _ => turning.push(TurningEdge {
                    edge: *edge,
                    crossing,
                }),
            }
        }
        if !turns && start.0 == edges.len() && start.1 == faces.len() {
            return Standing::Everywhere;
        }
        Standing::Between(Cast {
            edges: start.0..edges.len(),
            faces: start.1..faces.len(),
            turning: turns.then(|| Turning {
                blocker,
                edges: start.2..turning.len(),
                looks: start.3..start.3 + looks.len(),
            }),
        })
    }

    /// Adds what it hides of `receiver` from `point` to the first `count` shadows: one polygon, or
    /// several where that has too many corners for one.
    fn shadows(
        &self,
        point: DVec3,
        (receiver, halvings): (&Ring, u32),
        view: &View<'_>,
        looks: &mut Vec<i8>,
        shadows: &mut Vec<Ring>,
        count: &mut usize,
    ) {
        if shadows.len() <= *count {
            shadows.push(Ring::EMPTY);
        }
        let dark = &mut shadows[*count];
        dark.set(receiver);
        self.cut(point, view, looks, dark);
        if dark.is_overfull() && halvings > 0 {
            let (one, two) = receiver.halves();
            for half in [one, two] {
                self.shadows(point, (&half, halvings - 1), view, looks, shadows, count);
            }
        } else {
            *count += usize::from(!dark.is_empty());
        }
    }

    /// Takes away what it does not hide from `point`.
    #[inline]
    fn cut(&self, point: DVec3, view: &View<'_>, looks: &mut Vec<i8>, dark: &mut Ring) {
        let chart = &view.pair.to;
        for edge in &view.outlines.edges[self.edges.clone()] {
            let inward = (edge.b - point).cross(edge.a - point);
            dark.cut(chart.line(inward, point));
            if dark.is_empty() {
                return;
            }
        }
        for face in &view.outlines.faces[self.faces.clone()] {
            dark.cut(chart.trace(face));
        }
        if let Some(turning) = &self.turning
            && !dark.is_empty()
        {
            turning.cut(point, view, looks, dark);
        }
    }
}

impl Turning<'_> {
    /// Takes away what is not in the shadow for the faces and edges that depend on the point.
    fn cut(&self, point: DVec3, view: &View<'_>, looks: &mut Vec<i8>, dark: &mut Ring) {
        let chart = &view.pair.to;
        let single = !self.blocker.is_solid();
        looks.clear();
        looks.extend_from_slice(&view.outlines.looks[self.looks.clone()]);
        for (look, face) in looks.iter_mut().zip(&self.blocker.faces) {
            if *look != 0 {
                continue;
            }
            // In the plane of a face counts as looking at it: a point below something that stands
            // on its plane is then wholly dark.
            *look = if face.height(point) >= -view.near_m {
                1
            } else {
                -1
            };
            if *look > 0 {
                dark.cut(chart.trace(&face.flipped()));
            } else if single {
                dark.cut(chart.trace(face));
            }
        }
        if !single && looks.iter().all(|&l| l < 0) {
            *dark = Ring::EMPTY;
            return;
        }
        for turning in &view.outlines.turning[self.edges.clone()] {
            if dark.is_empty() {
                return;
            }
            if let Some((a, b)) = turning.edge.in_outline(looks) {
                dark.cut(chart.line((b - point).cross(a - point), point));
            }
        }
    }
}

/// Where the receiver is from an edge, seen from all of the sender, and the corners of the receiver
/// whose plane with the edge crosses the sender.
#[inline]
fn side((a, b): (DVec3, DVec3), s: &[DVec3], r: &[DVec3], near_m: f64) -> (Side, u32) {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    let (mut above, mut below) = (0_u32, 0_u32);
    for &x in s {
        let inward = (b - x).cross(a - x);
        for (k, &q) in r.iter().enumerate() {
            let volume = inward.dot(q - x);
            low = if volume < low { volume } else { low };
            high = if volume > high { volume } else { high };
            above |= u32::from(volume > 0.0) << k;
            below |= u32::from(volume < 0.0) << k;
        }
    }
    // A volume of a hair's breadth is none; how much that is is asked only in doubt.
    let breadth = || {
        s.iter()
            .map(|&x| (b - x).cross(a - x).length())
            .fold(f64::INFINITY, f64::min)
    };
    let doubt = 1e-6 * (high - low);
    let side = if high <= 0.0 || (high < doubt && high <= near_m * breadth()) {
        Side::Clear
    } else if low < 0.0 && (-low > doubt || -low > near_m * breadth()) {
        Side::Both
    } else {
        Side::Dark
    };
    (side, above & below)
}

/// Lines on the sender where the hidden part of the receiver has a kink.
fn critical_lines(
    view: &View<'_>,
    s: &[DVec3],
    start: &Ring,
    r: &[DVec3],
    near_m: f64,
    cuts: &mut Vec<Line>,
) {
    cuts.clear();
    let pair = &view.pair;
    for cast in view.casts {
        let known = &view.outlines.edges[cast.edges.clone()];
        let mut turning = &[][..];
        if let Some(cast) = &cast.turning {
            // Where a face begins to show; and any edge may be one of the outline.
            let looks = &view.outlines.looks[cast.looks.clone()];
            for (face, _) in cast.blocker.faces.iter().zip(looks).filter(|f| *f.1 == 0) {
                if let Some(line) = crossing(pair.from.trace(face), start, near_m) {
                    push(cuts, line);
                }
            }
            turning = &view.outlines.turning[cast.edges.clone()];
        }
        let edges = known
            .iter()
            .map(|e| ((e.a, e.b), e.crossing))
            .chain(turning.iter().map(|t| ((t.edge.a, t.edge.b), t.crossing)));
        let mut seen = [DVec3::ZERO; 32];
        let mut count = 0;
        for ((a, b), crossing) in edges {
            // An edge of the blocker passes a corner of the receiver, where the edge itself, not
            // its extension, lies between the corner and the sender.
            for (_, &corner) in r.iter().enumerate().filter(|c| crossing >> c.0 & 1 == 1) {
                kink(
                    pair,
                    s,
                    start,
                    corner,
                    (a, b),
                    |way| way >= 1.0 - 1e-9,
                    near_m,
                    cuts,
                );
            }
            // A corner of the blocker passes an edge of the receiver: the corner lies between.
            for end in [a, b] {
                if seen[..count].contains(&end) {
                    continue;
                }
                if count < seen.len() {
                    seen[count] = end;
                    count += 1;
                }
                for k in 0..r.len() {
                    let edge = (r[k], r[(k + 1) % r.len()]);
                    kink(pair, s, start, end, edge, |way| way <= 1e-9, near_m, cuts);
                }
            }
        }
    }
}

/// Adds the line of the plane through `apex` and an edge, if for some point of the sender the
/// line from it through the apex meets the edge itself. `between` judges the point's place on
/// that line: 0 at the apex, 1 on the edge.
fn kink(
    pair: &Pair,
    s: &[DVec3],
    start: &Ring,
    apex: DVec3,
    (a, b): (DVec3, DVec3),
    between: impl Fn(f64) -> bool,
    near_m: f64,
    cuts: &mut Vec<Line>,
) {
    let along = b - a;
    let normal = along.cross(apex - a);
    // Most planes pass the sender by.
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for &x in s {
        let h = normal.dot(x - a);
        low = if h < low { h } else { low };
        high = if h > high { h } else { high };
    }
    if low >= 0.0 || high <= 0.0 {
        return;
    }
    let Some(line) = crossing(pair.from.line(normal, a), start, near_m) else {
        return;
    };
    let across = normal.cross(along);
    let h_apex = across.dot(apex - a);
    let length = along.length_squared();
    let (mut before, mut after, mut inside, mut met) = (true, true, false, 0);
    let corners = start.corners();
    let mut last = corners[corners.len() - 1];
    let mut h_last = line.at(last);
    for &corner in corners {
        let h = line.at(corner);
        if (h >= 0.0) != (h_last >= 0.0) {
            let x = pair
                .from
                .space(last + (corner - last) * (h_last / (h_last - h)));
            let way = 1.0 - across.dot(x - a) / h_apex;
            let foot = apex + (x - apex) / way;
            let t = (foot - a).dot(along) / length;
            // Not a number where the line runs along the edge: keep the kink.
            before &= t < -1e-9;
            after &= t > 1.0 + 1e-9;
            inside |= between(way) || !way.is_finite();
            met += 1;
        }
        (last, h_last) = (corner, h);
    }
    if met < 2 || !(before || after || !inside) {
        push(cuts, line);
    }
}

/// A line with slope 1, if it has more than a hair of the ring on either side.
fn crossing(line: Line, ring: &Ring, near_m: f64) -> Option<Line> {
    let length = line.slope.length();
    if length.partial_cmp(&0.0) != Some(Ordering::Greater) {
        return None;
    }
    let line = Line {
        offset: line.offset / length,
        slope: line.slope / length,
    };
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for &c in ring.corners() {
        let h = line.at(c);
        low = if h < low { h } else { low };
        high = if h > high { h } else { high };
    }
    (low < -near_m && high > near_m).then_some(line)
}

fn push(cuts: &mut Vec<Line>, line: Line) {
    let same = |c: &Line| {
        let along = c.slope.dot(line.slope).signum();
        (c.slope - line.slope * along).length_squared() < 1e-16
            && (c.offset - line.offset * along).abs() <= 1e-9 * (1e-3 + line.offset.abs())
    };
    if cuts.len() < MOST_CUTS && !cuts.iter().any(same) {
        cuts.push(line);
    }
}

/// What the rule found on a piece of the sender, m².
#[derive(Clone, Copy, Default)]
struct Found {
    hidden: f64,
    all: f64,
    error: f64,
}

/// A piece in the queue: the largest error first, the older first among equals.
struct Waiting {
    error: f64,
    piece: usize,
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Waiting {}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        self.error
            .total_cmp(&other.error)
            .then(other.piece.cmp(&self.piece))
    }
}

/// What the points of a sender are asked about.
struct View<'a> {
    pair: Pair,
    to: &'a Polygon,
    receiver: Ring,
    receiver_area: f64,
    receiver_middle: DVec3,
    casts: &'a [Cast<'a>],
    outlines: &'a Outlines,
    near_m: f64,
}

impl<'a> View<'a> {
    fn of(
        pair: Pair,
        to: &'a Polygon,
        casts: &'a [Cast<'a>],
        outlines: &'a Outlines,
        near_m: f64,
    ) -> View<'a> {
        let receiver = pair.to.ring(&to.vertices);
        let (receiver_area, centroid) = receiver.moments();
        View {
            receiver_middle: pair.to.space(centroid),
            pair,
            to,
            receiver,
            receiver_area,
            casts,
            outlines,
            near_m,
        }
    }
}

/// Rule of few nodes on each piece of the sender; the worst pieces are halved.
fn by_pieces(view: &View<'_>, start: Ring, asked: &Asked, scratch: &mut Scratch) -> Exchange {
    let mut pieces = std::mem::take(&mut scratch.cells);
    let mut found = std::mem::take(&mut scratch.found);
    pieces.clear();
    pieces.push(start);
    let mut complete = scratch.cuts.len() < MOST_CUTS;
    let most_points = (MOST_SHADOWS / view.casts.len().max(1)).max(64);
    // Half of the points for the pieces to begin with, five each.
    let most_pieces = MOST_PIECES.min(most_points / 10);
    let start_m2 = start.area();
    // So little is at stake that any answer will do.
    let negligible = asked.free <= 2.0 * asked.tolerance;
    let small_m2 = if negligible {
        f64::INFINITY
    } else {
        // Shadows that overlap have kinks which no cut knows of.
        let several = if view.casts.len() > 1 { 0.5 } else { 1.0 };
        several * asked.small * start_m2
    };
    for &line in scratch.cuts.iter().filter(|_| !negligible) {
        if pieces.len() > most_pieces {
            complete = false;
            break;
        }
        for k in 0..pieces.len() {
            if !pieces[k].is_crossed(line) {
                continue;
            }
            let (front, behind) = pieces[k].split(line);
            let (a, b) = (front.area(), behind.area());
            let whole = !front.is_overfull() && !behind.is_overfull();
            if whole && a.min(b) > asked.sliver * (a + b) {
                pieces[k] = front;
                pieces.push(behind);
            }
        }
    }
    let before = scratch.counts[2];
    found.clear();
    let mut sum = Found::default();
    let unsure = !complete && !negligible;
    for piece in &pieces {
        let here = measure(view, piece, small_m2, unsure, scratch);
        sum.hidden += here.hidden;
        sum.all += here.all;
        sum.error += here.error;
        found.push(here);
    }
    // Errors of the rule count in units of the free value.
    let scale = asked.free / sum.all.max(f64::MIN_POSITIVE);
    if sum.error * scale > asked.tolerance {
        let waiting = |(piece, f): (usize, &Found)| Waiting {
            error: f.error,
            piece,
        };
        let mut queue: BinaryHeap<Waiting> = found.iter().enumerate().map(waiting).collect();
        while sum.error * scale > asked.tolerance && scratch.counts[2] - before < most_points as u64
        {
            let Some(Waiting { piece, error }) = queue.pop() else {
                break;
            };
            if error <= 0.0 {
                break;
            }
            let (one, two) = pieces[piece].halves();
            sum.error -= error;
            let second = pieces.len();
            pieces[piece] = one;
            pieces.push(two);
            found.push(Found::default());
            for piece in [piece, second] {
                // Of a sender in doubt only small pieces that agree are trusted.
                let unsure = unsure && pieces[piece].area() > DOUBTED * start_m2;
                found[piece] = measure(view, &pieces[piece], 0.0, unsure, scratch);
                sum.error += found[piece].error;
                queue.push(Waiting {
                    error: found[piece].error,
                    piece,
                });
            }
        }
        // Again in a fixed order: adding and taking away leaves rounding behind.
        sum = found.iter().fold(Found::default(), |sum, f| Found {
            hidden: sum.hidden + f.hidden,
            all: sum.all + f.all,
            error: sum.error + f.error,
        });
    }
    scratch.counts[1] += pieces.len() as u64;
    let Found { hidden, all, error } = sum;
    // Up to rounding of the sums.
    let (value, error) = if hidden >= all * (1.0 - 1e-12) {
        (0.0, 0.0)
    } else if hidden <= all * 1e-12 {
        (asked.free, 0.0)
    } else {
        let value = if view.pair.far || (all - asked.free).abs() <= asked.tolerance {
            asked.free * (1.0 - hidden / all)
        } else {
            pieces
                .iter()
                .zip(&found)
                .map(|(piece, f)| seen_exactly(view, piece, f))
                .sum()
        };
        (value.clamp(0.0, asked.free), error.max(0.0) * scale)
    };
    scratch.cells = pieces;
    scratch.found = found;
    Exchange { value, error }
}

/// Exchange of a piece of the sender: its exact free value times the share that is seen, m².
fn seen_exactly(view: &View<'_>, piece: &Ring, found: &Found) -> f64 {
    if found.all <= found.hidden {
        return 0.0;
    }
    let corners = piece.corners().iter().map(|&c| view.pair.from.space(c));
    let piece = Polygon::new(corners.collect());
    exchange_area(&piece, view.to, 1e-6) * (1.0 - found.hidden / found.all)
}

/// Factors of a piece times area, by its rule; the error from one node in its middle.
fn measure(
    view: &View<'_>,
    piece: &Ring,
    small_m2: f64,
    unsure: bool,
    scratch: &mut Scratch,
) -> Found {
    let (area, centroid) = piece.moments();
    if area <= 0.0 {
        return Found::default();
    }
    if !unsure && area <= small_m2 {
        // Too small for its kinks and its curvature to matter; what is linear is exact.
        scratch.counts[2] += 1;
        let (hidden, all) = hidden_from(view, centroid, scratch);
        return Found {
            hidden: hidden * area,
            all: all * area,
            error: 0.0,
        };
    }
    let mut found = Found::default();
    let mut points = 0;
    piece.nodes(|p, w| {
        let (h, o) = hidden_from(view, p, scratch);
        found.hidden += w * h;
        found.all += w * o;
        points += 1;
    });
    if found.hidden > 0.0 && found.hidden < found.all * (1.0 - 1e-12) {
        let (h, o) = hidden_from(view, centroid, scratch);
        points += 1;
        // The rule is two orders better than one node: a fifth of the difference bounds it
        // with room to spare. What both get wrong of the free part is no error of the shadow.
        let one = found.all * h / o.max(f64::MIN_POSITIVE);
        found.error = 0.2 * (found.hidden - one).abs();
    } else if unsure {
        found.error = 0.02 * found.all;
    }
    scratch.counts[2] += points;
    found
}

/// Configuration factors from a point of the sender to the hidden part of the receiver and to
/// all of it.
fn hidden_from(view: &View<'_>, point: DVec2, scratch: &mut Scratch) -> (f64, f64) {
    let x = view.pair.from.space(point);
    let all = if view.pair.far {
        kernel(&view.pair, x, view.receiver_middle, view.receiver_area)
    } else {
        factor(&view.pair, x, &view.receiver)
    };
    let mut count = 0;
    for cast in view.casts {
        let Scratch { looks, shadows, .. } = scratch;
        let whole = (&view.receiver, MOST_HALVINGS);
        cast.shadows(x, whole, view, looks, shadows, &mut count);
    }
    let hidden = match &scratch.shadows[..count] {
        [] => return (0.0, all),
        [one] => {
            if one.area() >= view.receiver_area * (1.0 - 1e-12) {
                return (all, all);
            }
            factor(&view.pair, x, one)
        }
        _ => {
            // What each leaves of what those before it left; the largest first.
            let shadows = &mut scratch.shadows[..count];
            shadows.sort_by(|a, b| b.area().total_cmp(&a.area()));
            scratch.pieces.clear();
            scratch.pieces.push(view.receiver);
            for shadow in shadows.iter() {
                let bounds = shadow.bounds();
                // What a piece leaves goes to the end, out of this shadow; most stay as they are.
                for k in (0..scratch.pieces.len()).rev() {
                    if !scratch.pieces[k].is_apart(shadow, bounds) {
                        let piece = scratch.pieces.swap_remove(k);
                        piece.outside(shadow, &mut scratch.pieces);
                    }
                }
                if scratch.pieces.is_empty() {
                    return (all, all);
                }
            }
            let least = 1e-13 * view.receiver_area;
            let seen: f64 = scratch
                .pieces
                .iter()
                .filter(|p| p.area() > least)
                .map(|p| factor(&view.pair, x, p))
                .sum();
            if seen <= 0.0 {
                return (all, all);
            }
            all - seen.min(all)
        }
    };
    (hidden.min(all), all)
}

/// Configuration factor from `x` to a piece of the receiver: Lambert's formula, or the kernel at
/// the centroid where the receiver is far for its size.
#[inline]
fn factor(pair: &Pair, x: DVec3, piece: &Ring) -> f64 {
    if pair.far {
        let (area, centroid) = piece.moments();
        return kernel(pair, x, pair.to.space(centroid), area);
    }
    let mut corners = [DVec3::ZERO; super::ring::MOST];
    let n = piece.corners().len();
    for (to, &c) in corners.iter_mut().zip(piece.corners()) {
        *to = pair.to.space(c);
    }
    if n < 3 {
        0.0
    } else {
        above_horizon(x, pair.from.normal, &corners[..n])
    }
}

/// `cos cos / (pi r^2)` times an area.
#[inline]
fn kernel(pair: &Pair, x: DVec3, middle: DVec3, area: f64) -> f64 {
    let d = middle - x;
    let square = d.length_squared();
    let cosines = d.dot(pair.from.normal) * -d.dot(pair.to.normal);
    (area * cosines / (PI * square * square)).max(0.0)
}
