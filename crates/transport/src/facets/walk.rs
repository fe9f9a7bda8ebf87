//! Which pairs of parts see each other: a walk over pairs of clusters.
//!
//! A pair of clusters carries the blockers that reach into the shaft between them, as nodes of
//! the blockers' tree that are opened as the clusters get smaller. No blocker left: all pairs
//! below see each other freely and are settled in one loop. One blocker in all lines: none do.
//! Otherwise the larger cluster is opened. Only pairs of single parts that still have something
//! between them are worked out with shadows.
//!
//! Sources: pairs of clusters [Hanrahan91], [Teller93] for the blockers they carry.

use super::blockers::{Blocker, Blockers, Plane};
use super::compressed::{Packer, by_parts};
use super::free::{self, Facing};
use super::parts::{Cluster, Part, Parts};
use super::shadow::{Asked, Exchange, Scratch, between, seen_from};
use super::shaft::{BlockerTree, Shaft, box_corners, hides};
use super::{Counts, Triplet};
use crate::polygon_pair::{exchange_area, facing_parts};
use luxel_core::DVec3;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

/// Candidates up to which each is asked whether it hides two whole clusters.
const FEW: usize = 24;

/// What all walks share.
pub(crate) struct Ground {
    pub(crate) parts: Parts,
    pub(crate) blockers: Blockers,
    pub(crate) tree: BlockerTree,
    pub(crate) near_m: f64,
    /// Promise per factor, absolute.
    pub(crate) error: f64,
    pub(crate) rows: usize,
    /// Whether a cluster holds a wanted row.
    pub(crate) wanted: Vec<bool>,
    pub(crate) wanted_rows: Range<u32>,
    /// Set by whoever wants no more: walks end at once, with a part of what they are for.
    pub(crate) stop: AtomicBool,
}

/// One walk: buffers and what it found.
#[derive(Default)]
pub(crate) struct Walk {
    /// Nodes of the blockers' tree, a stack of runs.
    candidates: Vec<u32>,
    scratch: Scratch,
    pub(crate) found: Vec<Triplet>,
    pub(crate) counts: Counts,
    /// Takes free pairs of clusters; what is found is then by parts.
    pub(crate) packer: Option<Packer>,
    /// Only pairs of this part.
    pub(crate) only: Option<usize>,
}

impl Walk {
    /// A walk that compresses what it finds.
    pub(crate) fn packing() -> Walk {
        Walk {
            packer: Some(Packer::default()),
            ..Walk::default()
        }
    }

    /// All pairs of a part below `a` and one below `b`, each once.
    pub(crate) fn pair(&mut self, ground: &Ground, a: u32, b: u32) {
        self.candidates.clear();
        self.candidates.extend(ground.tree.root());
        let all = 0..self.candidates.len();
        self.visit(ground, a, b, all);
        let [shadowed, pieces, points] = self.scratch.counts;
        self.counts.shadowed += shadowed;
        self.counts.pieces += pieces;
        self.counts.points += points;
        self.scratch.counts = [0; 3];
    }

    fn visit(&mut self, ground: &Ground, a: u32, b: u32, candidates: Range<usize>) {
        if ground.stop.load(Ordering::Relaxed) {
            return;
        }
        if !ground.wanted[a as usize] && !ground.wanted[b as usize] {
            return;
        }
        let clusters = &ground.parts.clusters;
        let (ca, cb) = (&clusters[a as usize], &clusters[b as usize]);
        if let Some(part) = self.only
            && !ca.run().contains(&part)
            && !cb.run().contains(&part)
        {
            return;
        }
        if a == b {
            if let (None, Some(first)) = (ca.flat, ca.children) {
                self.visit(ground, first, first, candidates.clone());
                self.visit(ground, first, first + 1, candidates.clone());
                self.visit(ground, first + 1, first + 1, candidates);
            }
            return;
        }
        if !sees(ca, cb, ground.near_m) || !sees(cb, ca, ground.near_m) {
            return;
        }
        let start = self.candidates.len();
        let shaft = Shaft::new((ca.low, ca.high), (cb.low, cb.high), ground.near_m);
        self.narrow(
            ground,
            &shaft,
            candidates,
            ca.size().max(cb.size()),
            |_, blocker| {
                // All on one side of its plane, or behind a flat cluster.
                aside(blocker, ca, cb, ground.near_m)
            },
        );
        let kept = start..self.candidates.len();
        if kept.is_empty() {
            self.free(ground, ca, cb);
        } else if kept.len() <= FEW && self.hidden(ground, ca, cb, kept.clone()) {
            self.counts.hidden += ca.count as u64 * cb.count as u64;
        } else {
            match (ca.children, cb.children) {
                (None, None) => self.leaves(ground, ca, cb, kept),
                (Some(first), None) => self.open(ground, first, b, kept),
                (None, Some(first)) => self.open(ground, first, a, kept),
                (Some(one), Some(two)) => {
                    if ca.size() >= cb.size() {
                        self.open(ground, one, b, kept);
                    } else {
                        self.open(ground, two, a, kept);
                    }
                }
            }
        }
        self.candidates.truncate(start);
    }

    fn open(&mut self, ground: &Ground, first: u32, other: u32, candidates: Range<usize>) {
        self.visit(ground, first, other, candidates.clone());
        self.visit(ground, first + 1, other, candidates);
    }

    /// Pushes what of `candidates` may stand in the shaft; nodes that are larger than `size` are
    /// opened.
    fn narrow(
        &mut self,
        ground: &Ground,
        shaft: &Shaft,
        candidates: Range<usize>,
        size: f64,
        aside: impl Fn(u32, &Blocker) -> bool,
    ) {
        let mut stack = [0_u32; 64];
        for k in candidates {
            let mut waiting = 1;
            stack[0] = self.candidates[k];
            while waiting > 0 {
                waiting -= 1;
                let index = stack[waiting];
                let node = ground.tree.node(index);
                if !shaft.meets_box(node.low, node.high) {
                    continue;
                }
                if node.leaf {
                    let blocker = &ground.blockers.list[node.index as usize];
                    if shaft.meets(&blocker.corners) && !aside(node.index, blocker) {
                        self.candidates.push(index);
                    }
                } else if (node.high - node.low).length() > size && waiting + 2 <= stack.len() {
                    stack[waiting] = node.index;
                    stack[waiting + 1] = node.index + 1;
                    waiting += 2;
                } else {
                    self.candidates.push(index);
                }
            }
        }
    }

    /// Whether one of the candidates stands in all lines between two clusters.
    fn hidden(&self, ground: &Ground, a: &Cluster, b: &Cluster, candidates: Range<usize>) -> bool {
        let (ca, na) = box_corners(a.low, a.high);
        let (cb, nb) = box_corners(b.low, b.high);
        self.candidates[candidates].iter().any(|&index| {
            let node = ground.tree.node(index);
            if !node.leaf {
                return false;
            }
            let blocker = &ground.blockers.list[node.index as usize];
            above_lid(blocker, &ca[..na], &cb[..nb], ground.near_m)
                && hides(blocker, &ca[..na], &cb[..nb], ground.near_m)
        })
    }

    /// Factors from a point with a unit normal to all parts below a cluster, added by row.
    pub(crate) fn all_from_point(
        &mut self,
        ground: &Ground,
        x: DVec3,
        normal: DVec3,
        found: &mut Vec<(u32, f64)>,
    ) {
        self.candidates.clear();
        self.candidates.extend(ground.tree.root());
        let all = 0..self.candidates.len();
        if !ground.parts.clusters.is_empty() {
            self.point(ground, (x, normal), 0, all, found);
        }
    }

    fn point(
        &mut self,
        ground: &Ground,
        (x, normal): (DVec3, DVec3),
        cluster: u32,
        candidates: Range<usize>,
        found: &mut Vec<(u32, f64)>,
    ) {
        let c = &ground.parts.clusters[cluster as usize];
        let horizon = Plane {
            normal,
            offset: normal.dot(x),
        };
        if box_heights(&horizon, c.low, c.high).1 <= ground.near_m
            || c.flat.is_some_and(|plane| plane.height(x) <= ground.near_m)
        {
            return;
        }
        let start = self.candidates.len();
        let shaft = Shaft::new((x, x), (c.low, c.high), ground.near_m);
        self.narrow(ground, &shaft, candidates, c.size(), |_, blocker| {
            blocker.faces.iter().any(|face| {
                let (low, high) = box_heights(face, c.low, c.high);
                let h = face.height(x);
                let near = ground.near_m;
                (h >= -near && low >= -near) || (!blocker.is_solid() && h <= near && high <= near)
            })
        });
        let kept = start..self.candidates.len();
        match c.children {
            Some(first) if !kept.is_empty() => {
                self.point(ground, (x, normal), first, kept.clone(), found);
                self.point(ground, (x, normal), first + 1, kept, found);
            }
            _ => {
                for j in c.run() {
                    let part = &ground.parts.list[j];
                    if part.plane.height(x) <= ground.near_m {
                        continue;
                    }
                    let before = self.candidates.len();
                    let shaft = Shaft::new((x, x), (part.low, part.high), ground.near_m);
                    self.narrow(ground, &shaft, kept.clone(), 0.0, |index, blocker| {
                        behind(part, index, blocker, ground.near_m)
                    });
                    let corners = &part.polygon.vertices;
                    let blockers = self.blockers(ground, before, &[x], corners);
                    self.candidates.truncate(before);
                    let to = &part.polygon;
                    let seen =
                        seen_from(x, normal, to, &blockers, ground.near_m, &mut self.scratch);
                    if seen > 0.0 {
                        found.push((part.row, seen));
                    }
                }
            }
        }
        self.candidates.truncate(start);
    }

    /// Nothing stands between the two.
    fn free(&mut self, ground: &Ground, a: &Cluster, b: &Cluster) {
        if let Some(packer) = &mut self.packer {
            packer.free(ground, a, b, &mut self.found, &mut self.counts);
            return;
        }
        let relative = ground.relative();
        for i in a.run() {
            for j in b.run() {
                if !self.wants(ground, i, j) {
                    continue;
                }
                let (p, q) = (&ground.parts.list[i], &ground.parts.list[j]);
                let facing = free::facing(p, q, ground.near_m);
                if facing != Facing::No {
                    let value = free::exchange(&ground.parts, (i, j), facing, relative);
                    self.counts.free += 1;
                    self.put(ground, (i, j), value);
                }
            }
        }
    }

    /// Parts one by one.
    fn leaves(&mut self, ground: &Ground, a: &Cluster, b: &Cluster, candidates: Range<usize>) {
        let relative = ground.relative();
        let start = self.candidates.len();
        for i in a.run() {
            for j in b.run() {
                if !self.wants(ground, i, j) || ground.stop.load(Ordering::Relaxed) {
                    continue;
                }
                let (p, q) = (&ground.parts.list[i], &ground.parts.list[j]);
                let facing = free::facing(p, q, ground.near_m);
                if facing == Facing::No {
                    continue;
                }
                let shaft = Shaft::new((p.low, p.high), (q.low, q.high), ground.near_m);
                self.narrow(ground, &shaft, candidates.clone(), 0.0, |index, blocker| {
                    [p, q]
                        .iter()
                        .any(|part| behind(part, index, blocker, ground.near_m))
                });
                let value = if self.candidates.len() == start {
                    self.counts.free += 1;
                    free::exchange(&ground.parts, (i, j), facing, relative)
                } else {
                    let found = self.past(ground, (i, j), facing, start);
                    self.counts.error += found.error;
                    found.value
                };
                self.candidates.truncate(start);
                self.put(ground, (i, j), value);
            }
        }
    }

    /// Exchange of two parts past the candidates from `start` on.
    fn past(
        &mut self,
        ground: &Ground,
        (i, j): (usize, usize),
        facing: Facing,
        start: usize,
    ) -> Exchange {
        let (p, q) = (&ground.parts.list[i], &ground.parts.list[j]);
        let clipped;
        let (from, to) = if facing == Facing::Partly {
            clipped = match facing_parts(&p.polygon, &q.polygon) {
                Some(both) => both,
                None => return Exchange::default(),
            };
            (&clipped.0, &clipped.1)
        } else {
            (&p.polygon, &q.polygon)
        };
        let blockers = self.blockers(ground, start, &from.vertices, &to.vertices);
        let relative = ground.relative();
        let free = if facing == Facing::Partly {
            exchange_area(from, to, relative)
        } else {
            free::exchange(&ground.parts, (i, j), facing, relative)
        };
        // Relative error of this pair: so that no factor is off by more than the promise, and
        // small ones, of which there are many, not by more than a row can bear.
        let smaller = p.area.min(q.area);
        let relative = (10.0 * ground.error).min(0.02 * ground.error * smaller / free);
        let asked = Asked {
            free,
            tolerance: (relative * free).max(ground.error * smaller / ground.rows as f64),
            near_m: ground.near_m,
            sliver: (0.63 * relative.sqrt()).min(0.05),
            far: 0.19 / relative.sqrt(),
            // Of a factor that matters every piece is looked at twice.
            small: if relative < 3.0 * ground.error {
                0.0
            } else {
                (4.7 * relative.sqrt()).min(0.2)
            },
        };
        between(from, to, &blockers, &asked, &mut self.scratch)
    }

    /// The candidates from `start` on as two polygons, or a point and one, meet them: solids as
    /// such where both lie outside of them.
    fn blockers<'g>(
        &self,
        ground: &'g Ground,
        start: usize,
        from: &[DVec3],
        to: &[DVec3],
    ) -> Vec<&'g Blocker> {
        let outside = |blocker: &Blocker, points: &[DVec3]| {
            blocker
                .faces
                .iter()
                .any(|f| points.iter().all(|&c| f.height(c) >= -ground.near_m))
        };
        let mut blockers = Vec::with_capacity(self.candidates.len() - start);
        for &index in &self.candidates[start..] {
            let blocker = &ground.blockers.list[ground.tree.node(index).index as usize];
            if !blocker.is_solid()
                || (above_lid(blocker, from, to, ground.near_m)
                    && outside(blocker, from)
                    && outside(blocker, to))
            {
                blockers.push(blocker);
            } else {
                blockers.extend(ground.blockers.faces(blocker));
            }
        }
        blockers
    }

    #[inline]
    fn wants(&self, ground: &Ground, i: usize, j: usize) -> bool {
        if self.only.is_some_and(|part| part != i && part != j) {
            return false;
        }
        let wanted = &ground.wanted_rows;
        wanted.contains(&ground.parts.list[i].row) || wanted.contains(&ground.parts.list[j].row)
    }

    #[inline]
    fn put(&mut self, ground: &Ground, (i, j): (usize, usize), value: f64) {
        if value > 0.0 {
            if self.packer.is_some() {
                self.found.push(by_parts(i, j, value));
                return;
            }
            let (p, q) = (&ground.parts.list[i], &ground.parts.list[j]);
            // Both ways within a row of several parts.
            let value = if p.row == q.row { 2.0 * value } else { value };
            self.found.push(Triplet {
                row: p.row.min(q.row),
                column: p.row.max(q.row),
                exchange: value as f32,
            });
        }
    }
}

impl Ground {
    /// Asked relative accuracy of free factors.
    pub(crate) fn relative(&self) -> f64 {
        (0.3 * self.error).clamp(1e-10, 3e-5)
    }
}

/// Whether something of `b` may be in front of something of `a`.
fn sees(a: &Cluster, b: &Cluster, near_m: f64) -> bool {
    a.flat
        .is_none_or(|plane| box_heights(&plane, b.low, b.high).1 > near_m)
}

/// Heights of a box over a plane.
pub(crate) fn box_heights(plane: &Plane, low: DVec3, high: DVec3) -> (f64, f64) {
    let middle = plane.height(0.5 * (low + high));
    let reach = (0.5 * (high - low)).dot(plane.normal.abs());
    (middle - reach, middle + reach)
}

/// Whether a blocker cannot be met by any line between two clusters, by planes at hand.
fn aside(blocker: &Blocker, a: &Cluster, b: &Cluster, near_m: f64) -> bool {
    for face in &blocker.faces {
        let ((la, ha), (lb, hb)) = (
            box_heights(face, a.low, a.high),
            box_heights(face, b.low, b.high),
        );
        if la >= -near_m && lb >= -near_m {
            return true;
        }
        if !blocker.is_solid() && ha <= near_m && hb <= near_m {
            return true;
        }
    }
    [a.flat, b.flat]
        .into_iter()
        .flatten()
        .any(|plane| plane.heights(&blocker.corners).1 <= near_m)
}

/// Whether a blocker lies behind a part or in its plane.
fn behind(part: &Part, index: u32, blocker: &Blocker, near_m: f64) -> bool {
    part.lies_on == Some(index) || part.plane.heights(&blocker.corners).1 <= near_m
}

/// Whether the lid of a blocker may be taken for a face: nobody looks at it from below.
fn above_lid(blocker: &Blocker, from: &[DVec3], to: &[DVec3], near_m: f64) -> bool {
    blocker.lid.is_none_or(|lid| {
        let above = |points: &[DVec3]| points.iter().all(|&p| lid.height(p) <= near_m);
        above(from) && above(to)
    })
}
