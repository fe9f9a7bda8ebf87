//! Convex polygons of few corners in the plane of a part, without heap: what is cut a million
//! times.

use super::blockers::Plane;
use luxel_core::DVec3;
use luxel_core::glam::DVec2;

/// Most corners of a [`Ring`].
pub(crate) const MOST: usize = 16;
/// Times that a polygon is halved for the sake of its corners, at most: those of a piece that small
/// are within rounding of each other.
pub(crate) const MOST_HALVINGS: u32 = 24;

/// A plane with axes: the place of a part.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chart {
    pub(crate) origin: DVec3,
    pub(crate) u: DVec3,
    pub(crate) v: DVec3,
    pub(crate) normal: DVec3,
}

impl Chart {
    /// Around the first corner of a polygon.
    pub(crate) fn of(corners: &[DVec3], normal: DVec3) -> Chart {
        let edge = corners[1] - corners[0];
        let u = (edge - normal * normal.dot(edge)).normalize_or_zero();
        Chart {
            origin: corners[0],
            u,
            v: normal.cross(u),
            normal,
        }
    }

    #[inline]
    pub(crate) fn flat(&self, p: DVec3) -> DVec2 {
        let d = p - self.origin;
        DVec2::new(d.dot(self.u), d.dot(self.v))
    }

    #[inline]
    pub(crate) fn space(&self, p: DVec2) -> DVec3 {
        self.origin + self.u * p.x + self.v * p.y
    }

    pub(crate) fn ring(&self, corners: &[DVec3]) -> Ring {
        let mut ring = Ring::EMPTY;
        for &c in corners {
            ring.push(self.flat(c));
        }
        ring
    }

    /// Where the plane with this normal through `at` meets this one.
    #[inline]
    pub(crate) fn line(&self, normal: DVec3, at: DVec3) -> Line {
        Line {
            offset: normal.dot(self.origin - at),
            slope: DVec2::new(normal.dot(self.u), normal.dot(self.v)),
        }
    }

    /// Where a plane meets this one.
    #[inline]
    pub(crate) fn trace(&self, plane: &Plane) -> Line {
        self.line(plane.normal, plane.normal * plane.offset)
    }
}

/// A linear function in a plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    pub(crate) offset: f64,
    pub(crate) slope: DVec2,
}

impl Line {
    #[inline]
    pub(crate) fn at(&self, p: DVec2) -> f64 {
        self.offset + self.slope.dot(p)
    }

    #[inline]
    pub(crate) fn negated(self) -> Line {
        Line {
            offset: -self.offset,
            slope: -self.slope,
        }
    }
}

/// Corners of a convex polygon, counter-clockwise.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ring {
    corners: [DVec2; MOST],
    len: usize,
    /// Whether a corner did not fit.
    overfull: bool,
}

impl Ring {
    /// No corner, no area.
    pub(crate) const EMPTY: Ring = Ring {
        corners: [DVec2::ZERO; MOST],
        len: 0,
        overfull: false,
    };

    #[inline]
    fn push(&mut self, corner: DVec2) {
        if self.len < MOST {
            self.corners[self.len] = corner;
            self.len += 1;
        } else {
            self.overfull = true;
        }
    }

    #[inline]
    pub(crate) fn corners(&self) -> &[DVec2] {
        &self.corners[..self.len]
    }

    #[inline]
    pub(crate) fn is_empty(&self) -> bool {
        self.len < 3
    }

    /// Whether it had more corners than fit, so that something of it is missing: to be done again
    /// by halves.
    #[inline]
    pub(crate) fn is_overfull(&self) -> bool {
        self.overfull
    }

    pub(crate) fn middle(&self) -> DVec2 {
        self.corners().iter().copied().sum::<DVec2>() / self.len.max(1) as f64
    }

    pub(crate) fn area(&self) -> f64 {
        self.moments().0
    }

    /// Area and centroid.
    #[inline]
    pub(crate) fn moments(&self) -> (f64, DVec2) {
        let v = self.corners();
        if v.len() < 3 {
            return (0.0, DVec2::ZERO);
        }
        let o = v[0];
        let (mut twice, mut sum) = (0.0, DVec2::ZERO);
        let mut a = v[1] - o;
        for &c in &v[2..] {
            let b = c - o;
            let w = a.perp_dot(b);
            twice += w;
            sum += (a + b) * w;
            a = b;
        }
        if twice <= 0.0 {
            return (0.0, o);
        }
        (0.5 * twice, o + sum / (3.0 * twice))
    }

    /// Replaces this by another; copies only the corners that are there.
    #[inline]
    pub(crate) fn set(&mut self, other: &Ring) {
        self.len = other.len;
        self.overfull = other.overfull;
        for k in 0..other.len {
            self.corners[k] = other.corners[k];
        }
    }

    /// Takes away what is where the line is below zero.
    #[inline]
    pub(crate) fn cut(&mut self, line: Line) {
        let n = self.len;
        let mut heights = [0.0; MOST];
        // Corners below, bit by bit; most lines leave all or nothing.
        let mut below = 0_u32;
        for k in 0..n {
            heights[k] = line.at(self.corners[k]);
            below |= u32::from(heights[k] < 0.0) << k;
        }
        if below == 0 {
            return;
        }
        if below.count_ones() as usize == n {
            self.len = 0;
            return;
        }
        self.take_away(below, &heights);
    }

    /// Takes away the corners whose bits are set, some but not all. They are one run around the
    /// ring, but for corners within rounding of the line.
    fn take_away(&mut self, below: u32, heights: &[f64; MOST]) {
        let n = self.len;
        let whole = self.corners;
        self.len = 0;
        let mut last = n - 1;
        for k in 0..n {
            let (h, g) = (heights[last], heights[k]);
            // Where the edge crosses zero; not where it starts or ends there.
            if (below >> last ^ below >> k) & 1 == 1 && h != 0.0 && g != 0.0 {
                self.push(whole[last] + (whole[k] - whole[last]) * (h / (h - g)));
            }
            if below >> k & 1 == 0 {
                self.push(whole[k]);
            }
            last = k;
        }
        if self.len < 3 {
            self.len = 0;
        }
    }

    /// Whether a line has corners on both sides.
    #[inline]
    pub(crate) fn is_crossed(&self, line: Line) -> bool {
        let (mut above, mut below) = (false, false);
        for &c in self.corners() {
            let h = line.at(c);
            above |= h > 0.0;
            below |= h < 0.0;
        }
        above && below
    }

    /// What is where the line is above zero, and what is where it is below.
    pub(crate) fn split(&self, line: Line) -> (Ring, Ring) {
        let (mut above, mut below) = (*self, *self);
        above.cut(line);
        below.cut(line.negated());
        (above, below)
    }

    /// Low and high corner of the rectangle around it.
    #[inline]
    pub(crate) fn bounds(&self) -> (DVec2, DVec2) {
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for &c in self.corners() {
            low = low.min(c);
            high = high.max(c);
        }
        (low, high)
    }

    /// Where this lies left of its edge from corner `k` on, above zero.
    #[inline]
    fn side(&self, k: usize) -> Line {
        let v = self.corners();
        let slope = (v[(k + 1) % v.len()] - v[k]).perp();
        Line {
            offset: -slope.dot(v[k]),
            slope,
        }
    }

    /// Whether it has no area in common with another: an edge of one of them keeps them apart.
    /// `bounds` are those of the other.
    #[inline]
    pub(crate) fn is_apart(&self, other: &Ring, bounds: (DVec2, DVec2)) -> bool {
        let (low, high) = self.bounds();
        let keeps = |one: &Ring, two: &Ring| {
            (0..one.len).any(|k| {
                let side = one.side(k);
                two.corners().iter().all(|&c| side.at(c) <= 0.0)
            })
        };
        low.cmpge(bounds.1).any()
            || high.cmple(bounds.0).any()
            || keeps(other, self)
            || keeps(self, other)
    }

    /// Pushes the parts of this ring outside of `other`.
    pub(crate) fn outside(&self, other: &Ring, rest: &mut Vec<Ring>) {
        self.outside_by_halves(other, rest, MOST_HALVINGS);
    }

    fn outside_by_halves(&self, other: &Ring, rest: &mut Vec<Ring>, halvings: u32) {
        let start = rest.len();
        let mut inside = *self;
        for k in 0..other.len {
            let (within, without) = inside.split(other.side(k));
            if halvings > 0 && (within.overfull || without.overfull) {
                rest.truncate(start);
                let (one, two) = self.halves();
                one.outside_by_halves(other, rest, halvings - 1);
                two.outside_by_halves(other, rest, halvings - 1);
                return;
            }
            if !without.is_empty() {
                rest.push(without);
            }
            inside = within;
            if inside.is_empty() {
                return;
            }
        }
    }

    /// Two halves, cut through the middle square to the longest edge.
    pub(crate) fn halves(&self) -> (Ring, Ring) {
        let v = self.corners();
        let mut slope = DVec2::ZERO;
        for k in 0..v.len() {
            let edge = v[(k + 1) % v.len()] - v[k];
            if edge.length_squared() > slope.length_squared() {
                slope = edge;
            }
        }
        self.split(Line {
            offset: -slope.dot(self.middle()),
            slope,
        })
    }

    /// Points and areas of a rule that is exact for cubic functions on parallelograms and for
    /// quadratic ones on triangles; other polygons are cut into those.
    #[inline]
    pub(crate) fn nodes(&self, mut each: impl FnMut(DVec2, f64)) {
        let v = self.corners();
        let mut k = 1;
        while k + 1 < v.len() {
            if k + 2 < v.len() {
                let (a, b, c, d) = (v[0], v[k], v[k + 1], v[k + 2]);
                let (u, w, skew) = (b - a, d - a, (a - b) + (c - d));
                for s in GAUSS {
                    for t in GAUSS {
                        let jacobian = (u + skew * t).perp_dot(w + skew * s).abs();
                        each(a + u * s + w * t + skew * (s * t), 0.25 * jacobian);
                    }
                }
                k += 2;
            } else {
                let (a, b, c) = (v[0], v[k], v[k + 1]);
                let third = (b - a).perp_dot(c - a).abs() / 6.0;
                let sum = (a + b + c) / 6.0;
                for corner in [a, b, c] {
                    each(sum + corner * 0.5, third);
                }
                k += 1;
            }
        }
    }
}

/// Gauss's two nodes on 0..1.
pub(crate) const GAUSS: [f64; 2] = [0.211_324_865_405_187_13, 0.788_675_134_594_812_9];
