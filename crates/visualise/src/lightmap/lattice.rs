//! Texels of a chart: which lattice points it needs, and where their light is asked.
//!
//! A lattice point is needed when it is a corner of a cell that some piece of the chart reaches
//! into: bilinear interpolation of needed texels then answers everywhere on the chart. A point on
//! the chart (or on another chart of its sheet, with nothing between) is *regular*: its light is
//! asked just there. Any other takes the light of the nearest point of the chart that it can see,
//! so that a texel half behind a wall has light from its visible part alone. Next to hard edges
//! the place is moved inwards by a tenth of a texel: exactly on an edge a receiver lies in the plane
//! of the next wall, and rounding decides what it sees.
//!
//! On curved surfaces the normal is that of the smooth surface, and the place is lifted onto it
//! [Hanika21], or facets would shade each other.

use super::charts::{Group, Sheet, bounds, clip};
use super::pieces::{HardEdge, NONE, Pieces};
use luxel_core::{Vec2, Vec3};
use luxel_gather::Receiver;

/// Distance from hard edges, texels.
const INSET: f32 = 0.1;
/// Rounding of lattice coordinates.
const ROUNDING: f32 = 1e-3;

/// What a texel is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// No part of the chart needs it.
    Unused,
    /// Asked near its lattice point.
    Clamped,
    /// Asked at its lattice point.
    Regular,
}

/// Texels of one chart, row by row from its first lattice point.
#[derive(Clone, Debug)]
pub(crate) struct Texels {
    /// First lattice point.
    pub first: [u32; 2],
    /// Texels across and down.
    pub size: [u32; 2],
    pub kind: Vec<Kind>,
    pub receivers: Vec<Receiver>,
}

/// Piece of a sheet at each lattice point, [`NONE`] beside it; the first where several meet.
pub(crate) struct Cover {
    first: [u32; 2],
    size: [u32; 2],
    piece: Vec<u32>,
}

impl Cover {
    /// Of some pieces of a sheet, over the lattice points `first .. first + size`.
    pub fn new(
        pieces: &Pieces,
        sheet: &Sheet,
        list: &[u32],
        first: [u32; 2],
        size: [u32; 2],
    ) -> Cover {
        let mut piece = vec![NONE; (size[0] * size[1]) as usize];
        for &k in list {
            let ring = sheet.ring(pieces, k);
            let ([i0, j0], [i1, j1]) = points_within(sheet, &ring);
            for j in j0.max(first[1])..(j1 + 1).min(first[1] + size[1]) {
                for i in i0.max(first[0])..(i1 + 1).min(first[0] + size[0]) {
                    let at = ((j - first[1]) * size[0] + i - first[0]) as usize;
                    if piece[at] == NONE
                        && is_inside(&ring, sheet.point(i, j), ROUNDING * sheet.step[0])
                    {
                        piece[at] = k;
                    }
                }
            }
        }
        Cover { first, size, piece }
    }

    fn at(&self, i: u32, j: u32) -> u32 {
        let (x, y) = (i.wrapping_sub(self.first[0]), j.wrapping_sub(self.first[1]));
        if x >= self.size[0] || y >= self.size[1] {
            return NONE;
        }
        self.piece[(y * self.size[0] + x) as usize]
    }
}

/// Finds the texels of a chart. `around` covers the whole sheet when it has several charts. `hard`
/// are the hard edges of the chart's pieces.
pub(crate) fn texels(
    pieces: &Pieces,
    sheet: &Sheet,
    group: &Group,
    around: Option<&Cover>,
    hard: &[HardEdge],
) -> Texels {
    let rings: Vec<Vec<Vec2>> = group
        .pieces
        .iter()
        .map(|&k| sheet.ring(pieces, k))
        .collect();
    // Lattice points of the cells that it reaches into.
    let (mut low, mut high) = ([u32::MAX; 2], [0u32; 2]);
    for ring in &rings {
        let (a, b) = cells_within(sheet, ring);
        for axis in 0..2 {
            low[axis] = low[axis].min(a[axis]);
            high[axis] = high[axis].max(b[axis]);
        }
    }
    let size = [0, 1].map(|axis| high[axis] - low[axis] + 1);
    let count = (size[0] * size[1]) as usize;
    let at = |i: u32, j: u32| ((j - low[1]) * size[0] + i - low[0]) as usize;
    let own = Cover::new(pieces, sheet, &group.pieces, low, size);
    let mut kind = vec![Kind::Unused; count];
    let mut place = vec![Vec2::ZERO; count];
    let mut owner = vec![NONE; count];
    let mut distance = vec![f32::INFINITY; count];
    for (&k, ring) in group.pieces.iter().zip(&rings) {
        for_cells(sheet, ring, |i, j| {
            for (x, y) in [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)] {
                let (x, y) = (x.min(high[0]), y.min(high[1]));
                let t = at(x, y);
                let p = sheet.point(x, y);
                let inside = own.at(x, y);
                if inside != NONE {
                    if kind[t] == Kind::Unused {
                        (kind[t], place[t], owner[t], distance[t]) =
                            (Kind::Regular, p, inside, 0.0);
                    }
                    continue;
                }
                let (nearest, far) = nearest(ring, p);
                if far < distance[t] {
                    (kind[t], place[t], owner[t], distance[t]) = (Kind::Clamped, nearest, k, far);
                }
            }
        });
    }
    // Just across the border of a chart whose neighbour goes on smoothly.
    if let Some(around) = around {
        for j in low[1]..=high[1] {
            for i in low[0]..=high[0] {
                let (t, p) = (at(i, j), sheet.point(i, j));
                let beyond = around.at(i, j);
                if kind[t] != Kind::Clamped || beyond == NONE {
                    continue;
                }
                // From within the piece: the nearest point may lie on what parts them.
                let centre = sheet.project(pieces.centre(owner[t] as usize));
                let within = place[t].lerp(centre, 0.1);
                if !sheet.is_parted(within, p) {
                    (kind[t], place[t], owner[t]) = (Kind::Regular, p, beyond);
                }
            }
        }
    }
    let inset = INSET * sheet.step[0].min(sheet.step[1]);
    for edge in hard {
        keep_off(
            pieces,
            sheet,
            edge,
            inset,
            &mut |i, j| {
                let inside = (low[0]..=high[0]).contains(&i) && (low[1]..=high[1]).contains(&j);
                inside
                    .then(|| at(i, j))
                    .filter(|&t| kind[t] != Kind::Unused)
            },
            &mut place,
            &owner,
        );
    }
    let receivers = (0..count)
        .map(|t| match kind[t] {
            Kind::Unused => Receiver {
                position: Vec3::ZERO,
                normal: Vec3::ZERO,
            },
            _ => receiver(pieces, sheet, owner[t] as usize, place[t]),
        })
        .collect();
    Texels {
        first: low,
        size,
        kind,
        receivers,
    }
}

/// Moves the places of texels away from a hard edge, into the piece that it borders.
fn keep_off(
    pieces: &Pieces,
    sheet: &Sheet,
    edge: &HardEdge,
    inset: f32,
    texel: &mut dyn FnMut(u32, u32) -> Option<usize>,
    place: &mut [Vec2],
    owner: &[u32],
) {
    let [a, b] = edge.ends.map(|p| sheet.project(p));
    let along = (b - a).normalize_or_zero();
    let centre = sheet.project(pieces.centre(edge.piece as usize));
    let inward = along.perp() * along.perp_dot(centre - a).signum();
    let (low, high) = (
        a.min(b) - Vec2::from(sheet.step),
        a.max(b) + Vec2::from(sheet.step),
    );
    let ([i0, j0], [i1, j1]) = points_within(sheet, &[low, high]);
    for j in j0..=j1 {
        for i in i0..=i1 {
            let Some(t) = texel(i, j) else { continue };
            let p = place[t];
            let x = along.dot(p - a);
            if x < -inset || x > (b - a).length() + inset {
                continue;
            }
            let off = inward.dot(p - a);
            if off.abs() >= inset || owner[t] == NONE {
                continue;
            }
            let moved = p + inward * (inset - off);
            let ring = sheet.ring(pieces, owner[t]);
            place[t] = if is_inside(&ring, moved, 0.0) {
                moved
            } else {
                // A sliver, or a corner of one: towards its middle.
                let centre = sheet.project(pieces.centre(owner[t] as usize));
                let (p, _) = nearest(&ring, p);
                p + (centre - p) * (inset / (centre - p).length().max(inset)).min(0.5)
            };
        }
    }
}

/// Lattice points in the bounds of a ring, first and last.
fn points_within(sheet: &Sheet, ring: &[Vec2]) -> ([u32; 2], [u32; 2]) {
    let (low, high) = bounds(ring);
    let along = |axis: usize, v: f32, up: bool| {
        let n = sheet.size[axis];
        let at = v / sheet.step[axis];
        let at = if up {
            (at + ROUNDING).floor()
        } else {
            (at - ROUNDING).ceil()
        };
        if n == 1 {
            0
        } else {
            at.clamp(0.0, (n - 1) as f32) as u32
        }
    };
    (
        [along(0, low.x, false), along(1, low.y, false)],
        [along(0, high.x, true), along(1, high.y, true)],
    )
}

/// Lattice points around the cells that the bounds of a ring reach into, first and last.
fn cells_within(sheet: &Sheet, ring: &[Vec2]) -> ([u32; 2], [u32; 2]) {
    let (low, high) = bounds(ring);
    let first = |axis: usize, v: f32| {
        let n = sheet.size[axis];
        let at = (v / sheet.step[axis] + ROUNDING).floor();
        if n == 1 {
            0
        } else {
            at.clamp(0.0, (n - 2) as f32) as u32
        }
    };
    let last = |axis: usize, v: f32, from: u32| {
        let n = sheet.size[axis];
        let at = (v / sheet.step[axis] - ROUNDING).ceil();
        if n == 1 {
            0
        } else {
            (at.clamp(0.0, (n - 1) as f32) as u32).max(from + 1)
        }
    };
    let from = [first(0, low.x), first(1, low.y)];
    (from, [last(0, high.x, from[0]), last(1, high.y, from[1])])
}

/// Calls `each` with the first corner of every cell that a convex ring reaches into.
fn for_cells(sheet: &Sheet, ring: &[Vec2], mut each: impl FnMut(u32, u32)) {
    let (first, last) = cells_within(sheet, ring);
    let rows = first[1]..last[1].max(first[1] + 1);
    for j in rows {
        let mut strip = ring.to_vec();
        if sheet.size[1] > 1 {
            let y = sheet.step[1];
            strip = clip(&strip, Vec2::Y, j as f32 * y);
            strip = clip(&strip, Vec2::NEG_Y, -((j + 1) as f32) * y);
        }
        if strip.is_empty() {
            continue;
        }
        let (from, to) = cells_within(sheet, &strip);
        for i in from[0]..to[0].max(from[0] + 1) {
            each(i, j);
        }
    }
}

/// Whether a point lies in a convex ring or closer than `slack` to it.
fn is_inside(ring: &[Vec2], p: Vec2, slack: f32) -> bool {
    let mut turn = 0.0f32;
    for k in 1..ring.len() - 1 {
        turn += (ring[k] - ring[0]).perp_dot(ring[k + 1] - ring[0]);
    }
    (0..ring.len()).all(|k| {
        let (a, b) = (ring[k], ring[(k + 1) % ring.len()]);
        let along = (b - a).normalize_or_zero();
        along.perp_dot(p - a) * turn.signum() >= -slack
    })
}

/// Point of a convex ring that is nearest to a point outside, and how far it is.
fn nearest(ring: &[Vec2], p: Vec2) -> (Vec2, f32) {
    let mut best = (ring[0], f32::INFINITY);
    if is_inside(ring, p, 0.0) {
        return (p, 0.0);
    }
    for k in 0..ring.len() {
        let (a, b) = (ring[k], ring[(k + 1) % ring.len()]);
        let d = b - a;
        let t = ((p - a).dot(d) / d.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        let q = a + d * t;
        let far = (p - q).length();
        if far < best.1 {
            best = (q, far);
        }
    }
    best
}

/// The receiver at a place on a piece.
fn receiver(pieces: &Pieces, sheet: &Sheet, piece: usize, place: Vec2) -> Receiver {
    let corners = pieces.corners(piece);
    if sheet.flat {
        let position = sheet.origin + sheet.axes[0] * place.x + sheet.axes[1] * place.y;
        // Exactly in the plane of its piece, whatever rounding there is in the axes.
        let n = pieces.normal[piece];
        return Receiver {
            position: position - n * n.dot(position - corners[0]),
            normal: n,
        };
    }
    let [a, b, c] = [corners[0], corners[1], corners[2]];
    let [p, q, r] = [a, b, c].map(|v| sheet.project(v));
    let whole = (q - p).perp_dot(r - p);
    let (mut v, mut w) = if whole.abs() > f32::MIN_POSITIVE {
        (
            (place - p).perp_dot(r - p) / whole,
            (q - p).perp_dot(place - p) / whole,
        )
    } else {
        (1.0 / 3.0, 1.0 / 3.0)
    };
    (v, w) = (v.clamp(0.0, 1.0), w.clamp(0.0, 1.0));
    let over = (v + w).max(1.0);
    (v, w) = (v / over, w / over);
    let weights = [1.0 - v - w, v, w];
    let flat = a * weights[0] + b * weights[1] + c * weights[2];
    let normals = pieces.normals(piece);
    let normal: Vec3 = (0..3).map(|k| normals[k] * weights[k]).sum();
    let lifted: Vec3 = (0..3)
        .map(|k| normals[k] * (weights[k] * normals[k].dot(corners[k] - flat).max(0.0)))
        .sum();
    Receiver {
        position: flat + lifted,
        normal: normal.normalize_or(pieces.normal[piece]),
    }
}
