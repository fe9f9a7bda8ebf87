//! Visibility of many segments: coherent runs walk the tree together.
//!
//! Segments between two small patches, or from a point to one, visit almost the same nodes.
//! Consecutive segments that stay close at both ends form a packet of up to sixteen. At a node
//! the packet is first taken as one: an interval of origins and of reciprocal directions
//! [Boulos06] against eight boxes at a time; what survives is tested box by box against eight
//! segments at a time, so that each subtree knows which segments enter it. Where only a few
//! do, they go on one by one.
//!
//! A triangle is tested by the arithmetic of the single ray, lanes being segments instead of
//! triangles, so the answer is the same to the bit.

use crate::bvh::{CHILD_IS_LEAF, Leaf, Node, Tree};
use crate::contract::Ray;
use crate::lanes::{Kernel, Lanes, WIDTH};
use crate::traverse::{LEAST_SLOPE, MARGIN, Room, crossing, dominant_axis, is_usable, splat};
use luxel_core::Vec3;

/// Most segments in a packet.
const MOST: usize = 16;
/// Least segments worth a packet.
const LEAST: usize = 6;
/// Segments in a subtree from which on they go together.
const TOGETHER: u32 = 4;
/// Most groups: sixteen segments along three axes fill at most four.
const GROUPS: usize = 4;
/// Largest sum of the sizes of both ends, as a share of the length.
const SPREAD: f32 = 0.35;

/// Share of light that passes along each segment.
#[inline(always)]
pub(crate) fn visibility_batch<K: Kernel>(tree: &Tree, segments: &[Ray], visible: &mut [f32]) {
    let count = segments.len().min(visible.len());
    let mut from = 0;
    if count >= LEAST {
        let mut packet = Packet::new();
        while from < count {
            let run = from..from + coherent(&segments[from..count]);
            from = run.end;
            if run.len() >= LEAST {
                let (segments, visible) = (&segments[run.clone()], &mut visible[run]);
                K::together(tree, segments, visible, &mut packet);
            } else {
                for k in run {
                    visible[k] = K::alone(tree, &segments[k], tree.root);
                }
            }
        }
    }
    for k in from..count {
        visible[k] = K::alone(tree, &segments[k], tree.root);
    }
}

/// How many segments from the first on are close to each other; at least one.
#[inline(always)]
fn coherent(segments: &[Ray]) -> usize {
    let mut origins = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let mut ends = origins;
    let mut allowed = f32::INFINITY;
    for (k, ray) in segments.iter().take(MOST).enumerate() {
        let reach = ray.direction * ray.t_max;
        let end = ray.origin + reach;
        origins = (origins.0.min(ray.origin), origins.1.max(ray.origin));
        ends = (ends.0.min(end), ends.1.max(end));
        allowed = allowed.min(SPREAD * SPREAD * reach.length_squared());
        let (a, b) = (origins.1 - origins.0, ends.1 - ends.0);
        // False if anything is infinite or not a number.
        let close = 2.0 * (a.length_squared() + b.length_squared()) <= allowed;
        if !close || !allowed.is_finite() || !ray.t_min.is_finite() || !is_usable(ray) {
            return k.max(1);
        }
    }
    segments.len().min(MOST)
}

/// A subtree that waits, and the lanes of the segments that enter it.
#[derive(Clone, Copy)]
struct Waiting {
    reference: u32,
    segments: u32,
}

/// What a packet needs while it walks; made once a batch.
pub(crate) struct Packet {
    groups: [Group; GROUPS],
    /// Which segment is in which lane.
    numbers: [u8; GROUPS * WIDTH],
    room: Room<Waiting>,
}

impl Packet {
    fn new() -> Packet {
        Packet {
            groups: [Group::EMPTY; GROUPS],
            numbers: [0; GROUPS * WIDTH],
            room: Room::new(),
        }
    }

    /// Sorts segments into groups; returns how many groups, and the lanes in use.
    #[inline(always)]
    fn fill(&mut self, segments: &[Ray], extent: f32) -> (usize, u32) {
        let mut used = 0u32;
        let mut group_count = 0;
        for z in 0..3 {
            let first = group_count * WIDTH;
            let mut end = first;
            for (number, ray) in segments.iter().enumerate() {
                if dominant_axis(ray) == z {
                    self.numbers[end] = number as u8;
                    used |= 1 << end;
                    end += 1;
                }
            }
            for lanes in self.numbers[first..end].chunks(WIDTH) {
                self.groups[group_count].fill(segments, lanes, z, extent);
                group_count += 1;
            }
        }
        (group_count, used)
    }
}

/// Up to eight segments with the same dominant axis, field by field.
#[derive(Clone, Copy)]
#[repr(align(32))]
struct Group {
    inverse: [[f32; WIDTH]; 3],
    near: [[f32; WIDTH]; 3],
    far: [[f32; WIDTH]; 3],
    /// In the order of `axes`.
    origin: [[f32; WIDTH]; 3],
    slope: [[f32; WIDTH]; 2],
    inverse_z: [f32; WIDTH],
    t_min: [f32; WIDTH],
    t_max: [f32; WIDTH],
    axes: [usize; 3],
}

impl Group {
    const EMPTY: Group = Group {
        inverse: [[0.0; WIDTH]; 3],
        near: [[0.0; WIDTH]; 3],
        far: [[0.0; WIDTH]; 3],
        origin: [[0.0; WIDTH]; 3],
        slope: [[0.0; WIDTH]; 2],
        inverse_z: [0.0; WIDTH],
        t_min: [0.0; WIDTH],
        t_max: [0.0; WIDTH],
        axes: [0; 3],
    };

    /// Lanes beyond `numbers` get an empty range.
    #[inline(always)]
    fn fill(&mut self, segments: &[Ray], numbers: &[u8], z: usize, extent: f32) {
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        self.axes = [x, y, z];
        let mut direction = [[1.0f32; WIDTH]; 3];
        let mut reach = [extent; WIDTH];
        self.t_min = [f32::INFINITY; WIDTH];
        self.t_max = [f32::NEG_INFINITY; WIDTH];
        for (lane, &number) in numbers.iter().enumerate() {
            let ray = &segments[number as usize];
            for (k, axis) in [x, y, z].into_iter().enumerate() {
                self.origin[k][lane] = ray.origin[axis];
                direction[k][lane] = ray.direction[axis];
            }
            reach[lane] += ray.origin.abs().max_element();
            self.t_min[lane] = ray.t_min;
            self.t_max[lane] = ray.t_max;
        }
        // From here on eight at a time; the same operations as in `traverse::prepare`.
        for (k, axis) in [x, y, z].into_iter().enumerate() {
            for lane in 0..WIDTH {
                let least = direction[2][lane].abs() * LEAST_SLOPE;
                let d = direction[k][lane];
                let inverse = 1.0
                    / if d.abs() < least {
                        least.copysign(d)
                    } else {
                        d
                    };
                let widened = MARGIN * reach[lane] * inverse.abs();
                let start = self.origin[k][lane] * inverse;
                self.inverse[axis][lane] = inverse;
                self.near[axis][lane] = start + widened;
                self.far[axis][lane] = start - widened;
            }
        }
        for lane in 0..WIDTH {
            let inverse_z = 1.0 / direction[2][lane];
            self.inverse_z[lane] = inverse_z;
            self.slope[0][lane] = direction[0][lane] * inverse_z;
            self.slope[1][lane] = direction[1][lane] * inverse_z;
        }
    }

    /// Which segments enter one child's box, as bits.
    #[inline(always)]
    fn enters<L: Lanes>(&self, node: &Node, child: usize) -> u32 {
        let mut enter = L::load(&self.t_min);
        let mut leave = L::load(&self.t_max);
        for axis in 0..3 {
            let inverse = L::load(&self.inverse[axis]);
            let a = L::splat(node.planes[2 * axis][child]) * inverse;
            let b = L::splat(node.planes[2 * axis + 1][child]) * inverse;
            enter = (a.min(b) - L::load(&self.near[axis])).max(enter);
            leave = (a.max(b) - L::load(&self.far[axis])).min(leave);
        }
        L::bits(enter.le(leave))
    }

    /// Which segments cross one triangle, as bits.
    #[inline(always)]
    fn cross_one<L: Lanes>(&self, leaf: &Leaf, triangle: usize) -> u32 {
        let [x, y, z] = self.axes;
        let [a, b, c] = &leaf.corners;
        let corners = [
            splat([a[x][triangle], a[y][triangle], a[z][triangle]]),
            splat([b[x][triangle], b[y][triangle], b[z][triangle]]),
            splat([c[x][triangle], c[y][triangle], c[z][triangle]]),
        ];
        let origin = load(&self.origin);
        let slope = [L::load(&self.slope[0]), L::load(&self.slope[1])];
        let (t_min, t_max) = (L::load(&self.t_min), L::load(&self.t_max));
        match crossing(
            corners,
            origin,
            slope,
            L::load(&self.inverse_z),
            t_min,
            t_max,
        ) {
            Some(crossing) => crossing.bits,
            None => 0,
        }
    }

    /// Which triangles one segment crosses, as bits.
    #[inline(always)]
    fn one_crosses<L: Lanes>(&self, leaf: &Leaf, lane: usize) -> u32 {
        let [x, y, z] = self.axes;
        let [a, b, c] = &leaf.corners;
        let corners = [
            [L::load(&a[x]), L::load(&a[y]), L::load(&a[z])],
            [L::load(&b[x]), L::load(&b[y]), L::load(&b[z])],
            [L::load(&c[x]), L::load(&c[y]), L::load(&c[z])],
        ];
        let origin = splat([
            self.origin[0][lane],
            self.origin[1][lane],
            self.origin[2][lane],
        ]);
        let slope = [L::splat(self.slope[0][lane]), L::splat(self.slope[1][lane])];
        let (t_min, t_max) = (L::splat(self.t_min[lane]), L::splat(self.t_max[lane]));
        let inverse_z = L::splat(self.inverse_z[lane]);
        match crossing(corners, origin, slope, inverse_z, t_min, t_max) {
            Some(crossing) => crossing.bits,
            None => 0,
        }
    }
}

#[inline(always)]
fn load<L: Lanes>(from: &[[f32; WIDTH]; 3]) -> [L; 3] {
    [L::load(&from[0]), L::load(&from[1]), L::load(&from[2])]
}

/// All segments of a packet as one: intervals instead of numbers.
struct Shaft<L> {
    /// Box around the segments.
    low: [L; 3],
    high: [L; 3],
    /// Axes along which all run the same way, so that slabs tell something.
    axes: [Option<Interval<L>>; 3],
    t_min: L,
    t_max: L,
}

/// Origins and reciprocal directions along one axis.
#[derive(Clone, Copy)]
struct Interval<L> {
    /// Plane that is met first: 0 the low one.
    near_side: usize,
    /// Origin from which the first plane is nearest, and the other plane farthest.
    nearest: L,
    farthest: L,
    inverse: [L; 2],
}

impl<L: Lanes> Interval<L> {
    #[inline(always)]
    fn new(origins: [f32; 2], ways: [f32; 2], margin: f32) -> Interval<L> {
        let negative = usize::from(ways[1] < 0.0);
        let (low, high) = (origins[0] - margin, origins[1] + margin);
        let (nearest, farthest) = if negative == 0 {
            (high, low)
        } else {
            (low, high)
        };
        Interval {
            near_side: negative,
            nearest: L::splat(nearest),
            farthest: L::splat(farthest),
            inverse: [L::splat(1.0 / ways[0]), L::splat(1.0 / ways[1])],
        }
    }
}

impl<L: Lanes> Shaft<L> {
    #[inline(always)]
    fn new(segments: &[Ray], extent: f32) -> Shaft<L> {
        let mut low = Vec3::INFINITY;
        let mut high = Vec3::NEG_INFINITY;
        let (mut origin_low, mut origin_high) = (low, high);
        let (mut way_low, mut way_high) = (low, high);
        let (mut t_min, mut t_max) = (f32::INFINITY, f32::NEG_INFINITY);
        for ray in segments {
            for t in [ray.t_min, ray.t_max] {
                let end = ray.origin + ray.direction * t;
                low = low.min(end);
                high = high.max(end);
            }
            origin_low = origin_low.min(ray.origin);
            origin_high = origin_high.max(ray.origin);
            way_low = way_low.min(ray.direction);
            way_high = way_high.max(ray.direction);
            t_min = t_min.min(ray.t_min);
            t_max = t_max.max(ray.t_max);
        }
        // As for a single ray, and as much again for the intervals' own rounding.
        let reach = origin_low.abs().max(origin_high.abs()).max_element() + extent;
        let margin = 2.0 * MARGIN * reach;
        // Along an axis that a segment hardly follows the interval would tell nothing.
        let least = way_low.abs().max(way_high.abs()).max_element() * 1e-6;
        let mut axes = [None; 3];
        for axis in 0..3 {
            let (origins, ways) = (
                [origin_low[axis], origin_high[axis]],
                [way_low[axis], way_high[axis]],
            );
            if ways[0] > least || ways[1] < -least {
                axes[axis] = Some(Interval::new(origins, ways, margin));
            }
        }
        Shaft {
            low: splat((low - margin).to_array()),
            high: splat((high + margin).to_array()),
            axes,
            t_min: L::splat(t_min),
            t_max: L::splat(t_max),
        }
    }

    /// Which boxes any of the segments can enter, as bits.
    #[inline(always)]
    fn enters(&self, node: &Node) -> u32 {
        let mut enter = self.t_min;
        let mut leave = self.t_max;
        let mut bits = (1 << WIDTH) - 1;
        for axis in 0..3 {
            let low = L::load(&node.planes[2 * axis]);
            let high = L::load(&node.planes[2 * axis + 1]);
            bits &= L::bits(low.le(self.high[axis]) & self.low[axis].le(high));
            if let Some(interval) = &self.axes[axis] {
                let [a, b] = interval.inverse;
                let (first, second) = if interval.near_side == 0 {
                    (low, high)
                } else {
                    (high, low)
                };
                let first = first - interval.nearest;
                let second = second - interval.farthest;
                enter = (first * a).min(first * b).max(enter);
                leave = (second * a).max(second * b).min(leave);
            }
        }
        bits & L::bits(enter.le(leave))
    }
}

/// A packet through the tree.
#[inline(always)]
pub(crate) fn together<K: Kernel>(
    tree: &Tree,
    segments: &[Ray],
    visible: &mut [f32],
    packet: &mut Packet,
) {
    let (group_count, used) = packet.fill(segments, tree.extent);
    let groups = &packet.groups[..group_count];
    let shaft = Shaft::<K>::new(segments, tree.extent);
    let segment_of = |lane: usize| packet.numbers[lane] as usize;
    // Segments that met a surface with partial coverage: done again, one by one.
    let mut again = 0u32;
    let mut stack = packet.room.stack();
    let mut live = used;
    let (mut current, mut here) = (tree.root, live);
    'walk: loop {
        if here.count_ones() < TOGETHER {
            for lane in ones(here) {
                let passed = K::alone(tree, &segments[segment_of(lane)], current);
                if passed == 0.0 {
                    live &= !(1 << lane);
                } else if passed < 1.0 {
                    again |= 1 << lane;
                }
            }
        } else if current & CHILD_IS_LEAF == 0 {
            let node = tree.node(current);
            for child in ones(shaft.enters(node)) {
                let mut entering = 0;
                for (k, group) in groups.iter().enumerate() {
                    if (here >> (WIDTH * k)) & 0xff != 0 {
                        entering |= group.enters::<K>(node, child) << (WIDTH * k);
                    }
                }
                if entering & here != 0 {
                    stack.push(Waiting {
                        reference: node.child[child],
                        segments: entering & here,
                    });
                }
            }
        } else {
            let (blocked, dimmed) = meet::<K>(tree.leaf(current), groups, here);
            live &= !blocked;
            again |= dimmed;
        }
        loop {
            let Some(next) = stack.pop() else { break 'walk };
            here = next.segments & live;
            if here != 0 {
                current = next.reference;
                break;
            }
        }
    }
    for lane in ones(used) {
        let number = segment_of(lane);
        visible[number] = match (live >> lane & 1, again >> lane & 1) {
            (0, _) => 0.0,
            (_, 0) => 1.0,
            _ => K::alone(tree, &segments[number], tree.root),
        };
    }
}

/// Which of the segments `here` a leaf blocks, and which meet partial coverage there.
///
/// Eight segments against one triangle or eight triangles against one segment, whichever takes
/// fewer tests.
#[inline(always)]
fn meet<L: Lanes>(leaf: &Leaf, groups: &[Group], here: u32) -> (u32, u32) {
    let mut partial = 0u32;
    let mut triangles = 0;
    for k in 0..WIDTH {
        triangles += usize::from(leaf.triangle[k] != u32::MAX);
        partial |= (leaf.triangle[k] >> 31) << k;
    }
    let (mut blocked, mut dimmed) = (0, 0);
    let mut groups_here = 0;
    for k in 0..groups.len() {
        groups_here += usize::from((here >> (WIDTH * k)) & 0xff != 0);
    }
    if here.count_ones() as usize <= triangles * groups_here {
        for lane in ones(here) {
            let crossed = groups[lane / WIDTH].one_crosses::<L>(leaf, lane % WIDTH);
            blocked |= u32::from(crossed & !partial != 0) << lane;
            dimmed |= u32::from(crossed & partial != 0) << lane;
        }
    } else {
        for triangle in 0..triangles {
            let mut crossing = 0;
            for (k, group) in groups.iter().enumerate() {
                crossing |= group.cross_one::<L>(leaf, triangle) << (WIDTH * k);
            }
            if partial >> triangle & 1 == 0 {
                blocked |= crossing & here;
            } else {
                dimmed |= crossing & here;
            }
        }
    }
    (blocked, dimmed)
}

/// The numbers of the bits that are set.
#[inline(always)]
fn ones(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        if bits == 0 {
            return None;
        }
        let k = bits.trailing_zeros() as usize;
        bits &= bits - 1;
        Some(k)
    })
}
