//! The space between two things, and what stands in it.
//!
//! All lines between two boxes lie in their convex hull. Its sides are the sides of the box
//! around both, and planes along an axis that touch both at the same corner. Whether a blocker
//! hides *every* line between two convex things needs only the lines between their corners:
//! where two lines from one point meet a convex blocker, so do all between them.
//!
//! Source: [Haines94] for the planes of the shaft.

use super::blockers::{Blocker, Plane, bounds};
use luxel_core::DVec3;

/// Convex hull of two boxes, from outside.
pub(crate) struct Shaft {
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
    planes: [Plane; 12],
    count: usize,
    near_m: f64,
}

impl Shaft {
    /// Between two boxes; what reaches less than `near_m` into it is outside.
    pub(crate) fn new(a: (DVec3, DVec3), b: (DVec3, DVec3), near_m: f64) -> Shaft {
        let none = Plane {
            normal: DVec3::ZERO,
            offset: 0.0,
        };
        let mut shaft = Shaft {
            low: a.0.min(b.0),
            high: a.1.max(b.1),
            planes: [none; 12],
            count: 0,
            near_m,
        };
        for (u, v) in [(0, 1), (1, 2), (2, 0)] {
            for (su, sv) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let corner = |c: (DVec3, DVec3), axis: usize, sign: f64| {
                    if sign > 0.0 { c.1[axis] } else { c.0[axis] }
                };
                let (pu, pv) = (corner(a, u, su), corner(a, v, sv));
                let (du, dv) = (corner(b, u, su) - pu, corner(b, v, sv) - pv);
                // Square to the line between the corners, outwards at both of them.
                let outwards = if dv * su >= 0.0 && -du * sv >= 0.0 {
                    1.0
                } else if dv * su <= 0.0 && -du * sv <= 0.0 {
                    -1.0
                } else {
                    continue;
                };
                let length = (du * du + dv * dv).sqrt();
                // Along an axis it is a side of the box around both.
                if du == 0.0 || dv == 0.0 {
                    continue;
                }
                let mut normal = DVec3::ZERO;
                normal[u] = outwards * dv / length;
                normal[v] = -outwards * du / length;
                shaft.planes[shaft.count] = Plane {
                    normal,
                    offset: normal[u] * pu + normal[v] * pv,
                };
                shaft.count += 1;
            }
        }
        shaft
    }

    /// Whether a box reaches into the shaft; says yes in doubt.
    #[inline]
    pub(crate) fn meets_box(&self, low: DVec3, high: DVec3) -> bool {
        let near = DVec3::splat(self.near_m);
        if low.cmpge(self.high - near).any() || high.cmple(self.low + near).any() {
            // A flat thing in a flat shaft: all in one plane.
            return false;
        }
        self.planes[..self.count].iter().all(|p| {
            let n = p.normal;
            let nearest = DVec3::new(
                if n.x > 0.0 { low.x } else { high.x },
                if n.y > 0.0 { low.y } else { high.y },
                if n.z > 0.0 { low.z } else { high.z },
            );
            n.dot(nearest) < p.offset - self.near_m
        })
    }

    /// The same for the corners of a convex thing.
    pub(crate) fn meets(&self, corners: &[DVec3]) -> bool {
        self.planes[..self.count].iter().all(|p| {
            corners
                .iter()
                .any(|&c| p.normal.dot(c) < p.offset - self.near_m)
        })
    }
}

/// Whether the segment between two points meets a blocker that neither touches.
pub(crate) fn meets_segment(blocker: &Blocker, p: DVec3, q: DVec3, near_m: f64) -> bool {
    if blocker.is_solid() {
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        for face in &blocker.faces {
            let (hp, hq) = (face.height(p), face.height(q));
            if hp >= -near_m && hq >= -near_m {
                return false;
            }
            let t = hp / (hp - hq);
            if hp > hq {
                enter = enter.max(t);
            } else if hp < hq {
                leave = leave.min(t);
            }
        }
        // Both ends outside, and a stretch inside that is more than rounding.
        return enter > 0.0 && leave < 1.0 && (leave - enter) * p.distance(q) > near_m;
    }
    let plane = &blocker.faces[0];
    let (hp, hq) = (plane.height(p), plane.height(q));
    if (hp <= near_m || hq >= -near_m) && (hp >= -near_m || hq <= near_m) {
        return false;
    }
    let x = p + (q - p) * (hp / (hp - hq));
    blocker.edges.iter().all(|e| {
        let inward = plane.normal.cross(e.b - e.a);
        inward.dot(x - e.a) >= 0.0
    })
}

/// Whether a blocker stands in every line between two convex things.
pub(crate) fn hides(blocker: &Blocker, from: &[DVec3], to: &[DVec3], near_m: f64) -> bool {
    let middle = |c: &[DVec3]| c.iter().copied().sum::<DVec3>() / c.len() as f64;
    meets_segment(blocker, middle(from), middle(to), near_m)
        && from
            .iter()
            .all(|&p| to.iter().all(|&q| meets_segment(blocker, p, q, near_m)))
}

/// Corners of a box; fewer where it is flat.
pub(crate) fn box_corners(low: DVec3, high: DVec3) -> ([DVec3; 8], usize) {
    let mut corners = [low; 8];
    let mut count = 1;
    for axis in 0..3 {
        if high[axis] > low[axis] {
            for k in 0..count {
                let mut c = corners[k];
                c[axis] = high[axis];
                corners[count + k] = c;
            }
            count *= 2;
        }
    }
    (corners, count)
}

/// A tree of boxes over the blockers.
pub(crate) struct BlockerTree {
    nodes: Vec<Node>,
}

#[derive(Clone, Copy)]
pub(crate) struct Node {
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
    /// First of two children; the blocker of a leaf.
    pub(crate) index: u32,
    pub(crate) leaf: bool,
}

impl BlockerTree {
    pub(crate) fn new(list: &[Blocker]) -> BlockerTree {
        let mut order: Vec<u32> = (0..list.len() as u32).collect();
        let mut tree = BlockerTree { nodes: Vec::new() };
        if !order.is_empty() {
            tree.nodes.push(Node {
                low: DVec3::ZERO,
                high: DVec3::ZERO,
                index: 0,
                leaf: true,
            });
            tree.fill(0, &mut order, list);
        }
        tree
    }

    fn fill(&mut self, at: usize, run: &mut [u32], list: &[Blocker]) {
        let corners: Vec<DVec3> = run
            .iter()
            .flat_map(|&b| [list[b as usize].low, list[b as usize].high])
            .collect();
        let (low, high) = bounds(&corners);
        if run.len() == 1 {
            self.nodes[at] = Node {
                low,
                high,
                index: run[0],
                leaf: true,
            };
            return;
        }
        let first = self.nodes.len();
        self.nodes[at] = Node {
            low,
            high,
            index: first as u32,
            leaf: false,
        };
        let middle = |b: u32| list[b as usize].low + list[b as usize].high;
        let middles: Vec<DVec3> = run.iter().map(|&b| middle(b)).collect();
        let (a, b) = bounds(&middles);
        let axis = longest_axis(b - a);
        let half = run.len() / 2;
        run.select_nth_unstable_by(half, |&x, &y| {
            middle(x)[axis].total_cmp(&middle(y)[axis]).then(x.cmp(&y))
        });
        self.nodes.extend([self.nodes[at]; 2]);
        let (left, right) = run.split_at_mut(half);
        self.fill(first, left, list);
        self.fill(first + 1, right, list);
    }

    /// The first answer that a blocker gives whose box touches this one.
    pub(crate) fn find<T>(
        &self,
        low: DVec3,
        high: DVec3,
        mut ask: impl FnMut(u32) -> Option<T>,
    ) -> Option<T> {
        let mut waiting: Vec<u32> = self.root().into_iter().collect();
        while let Some(index) = waiting.pop() {
            let node = self.node(index);
            if node.low.cmpgt(high).any() || node.high.cmplt(low).any() {
                continue;
            }
            if !node.leaf {
                waiting.extend([node.index + 1, node.index]);
            } else if let Some(found) = ask(node.index) {
                return Some(found);
            }
        }
        None
    }

    /// The root, if there is anything.
    pub(crate) fn root(&self) -> Option<u32> {
        (!self.nodes.is_empty()).then_some(0)
    }

    #[inline]
    pub(crate) fn node(&self, index: u32) -> &Node {
        &self.nodes[index as usize]
    }
}

pub(crate) fn longest_axis(size: DVec3) -> usize {
    if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    }
}

#[cfg(test)]
mod tests {
    use super::super::blockers::merge;
    use super::*;

    fn square(o: DVec3, u: DVec3, v: DVec3) -> Vec<DVec3> {
        vec![o, o + u, o + u + v, o + v]
    }

    fn random(seed: &mut u64) -> f64 {
        *seed = seed
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (*seed >> 11) as f64 / (1u64 << 53) as f64
    }

    #[test]
    fn what_a_shaft_leaves_out_meets_no_line() {
        // Random boxes; lines between random points of two never meet a third that is left out.
        let mut seed = 7;
        let mut boxed = || {
            let c = DVec3::new(random(&mut seed), random(&mut seed), random(&mut seed));
            let d = DVec3::new(random(&mut seed), random(&mut seed), random(&mut seed));
            (c, c + d * 0.4)
        };
        let sets: Vec<_> = (0..2000).map(|_| (boxed(), boxed(), boxed())).collect();
        let (mut out, mut inside) = (0, 0);
        for (a, b, c) in sets {
            let shaft = Shaft::new(a, b, 1e-12);
            let meets = shaft.meets_box(c.0, c.1);
            let mut hit = false;
            for _ in 0..50 {
                let mut point = |(l, h): (DVec3, DVec3)| {
                    l + (h - l)
                        * DVec3::new(random(&mut seed), random(&mut seed), random(&mut seed))
                };
                let (p, q) = (point(a), point(b));
                let x = p + (q - p) * random(&mut seed);
                hit |= x.cmpgt(c.0).all() && x.cmplt(c.1).all();
            }
            assert!(meets || !hit);
            out += usize::from(!meets);
            inside += usize::from(hit);
        }
        assert!(out > 300 && inside > 100, "{out} {inside}");
    }

    #[test]
    fn a_lid_hides_and_a_plate_aside_does_not() {
        let floor = square(DVec3::ZERO, DVec3::X, DVec3::Y);
        let top = square(DVec3::Z, DVec3::Y, DVec3::X);
        let plate = |o: DVec3, s: f64| merge(&[square(o, DVec3::X * s, DVec3::Y * s)], 0.0);
        let lid = plate(DVec3::new(-1.0, -1.0, 0.5), 3.0);
        assert!(hides(&lid.list[0], &floor, &top, 1e-9));
        let small = plate(DVec3::new(0.2, 0.2, 0.5), 0.5);
        assert!(!hides(&small.list[0], &floor, &top, 1e-9));
        let aside = plate(DVec3::new(1.0, 0.2, 0.5), 0.5);
        assert!(!hides(&aside.list[0], &floor, &top, 1e-9));
        let below = plate(DVec3::new(0.2, 0.2, -0.5), 0.5);
        assert!(!hides(&below.list[0], &floor, &top, 1e-9));
    }
}
