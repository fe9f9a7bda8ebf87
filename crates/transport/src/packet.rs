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

use crate::bvh::{CHILD_IS_LEAF, Leaf, Node, PARTIAL, Tree};
use crate::contract::Ray;
use crate::lanes::{Lanes, WIDTH};
use crate::traverse::{
    LEAST_SLOPE, MARGIN, Room, Waiting, crossing, dominant_axis, is_usable, splat, visibility,
};
use luxel_core::Vec3;

/// Most segments in a packet.
const MOST: usize = 16;
/// Least segments worth a packet.
const LEAST: usize = 5;
/// Segments in a subtree from which on they go together.
const TOGETHER: u32 = 4;
/// Most groups: sixteen segments along three axes fill at most four.
const GROUPS: usize = 4;
/// Largest sum of the sizes of both ends, as a share of the length.
const SPREAD: f32 = 0.35;

/// Share of light that passes along each segment.
#[inline(always)]
pub(crate) fn visibility_batch<L: Lanes>(tree: &Tree, segments: &[Ray], visible: &mut [f32]) {
    let mut room = Room::new();
    let mut room_of_packet = Room::new();
    let mut from = 0;
    while from < segments.len().min(visible.len()) {
        let count = coherent(&segments[from..]);
        let run = from..from + count;
        if count < LEAST {
            for k in run {
                visible[k] = visibility::<L>(tree, &segments[k], tree.root, &mut room);
            }
        } else {
            let (segments, visible) = (&segments[run.clone()], &mut visible[run]);
            together::<L>(tree, segments, visible, &mut room_of_packet, &mut room);
        }
        from += count;
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

/// Up to eight segments with the same dominant axis, field by field.
struct Group<L> {
    inverse: [L; 3],
    near: [L; 3],
    far: [L; 3],
    /// In the order of `axes`.
    origin: [L; 3],
    slope: [L; 2],
    inverse_z: L,
    axes: [usize; 3],
    t_min: L,
    t_max: L,
}

impl<L: Lanes> Group<L> {
    /// Lanes beyond `segments` have an empty range.
    #[inline(always)]
    fn new(segments: &[Ray], numbers: &[u8], z: usize, extent: f32) -> Group<L> {
        let mut origin = [[0.0f32; WIDTH]; 3];
        let mut direction = [[1.0f32; WIDTH]; 3];
        let mut range = [[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]];
        for (lane, &number) in numbers.iter().enumerate() {
            let ray = &segments[number as usize];
            for axis in 0..3 {
                origin[axis][lane] = ray.origin[axis];
                direction[axis][lane] = ray.direction[axis];
            }
            range[0][lane] = ray.t_min;
            range[1][lane] = ray.t_max;
        }
        let mut slabs = [[[0.0f32; WIDTH]; 3]; 3];
        let mut slopes = [[0.0f32; WIDTH]; 3];
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        for lane in 0..WIDTH {
            let (o, d) = (origin, direction);
            let reach = o[0][lane].abs().max(o[1][lane].abs()).max(o[2][lane].abs()) + extent;
            let least = d[z][lane].abs() * LEAST_SLOPE;
            for axis in 0..3 {
                let d = d[axis][lane];
                let inverse = 1.0
                    / if d.abs() < least {
                        least.copysign(d)
                    } else {
                        d
                    };
                let widened = MARGIN * reach * inverse.abs();
                slabs[0][axis][lane] = inverse;
                slabs[1][axis][lane] = o[axis][lane] * inverse + widened;
                slabs[2][axis][lane] = o[axis][lane] * inverse - widened;
            }
            slopes[2][lane] = 1.0 / d[z][lane];
            slopes[0][lane] = d[x][lane] * slopes[2][lane];
            slopes[1][lane] = d[y][lane] * slopes[2][lane];
        }
        Group {
            inverse: load(&slabs[0]),
            near: load(&slabs[1]),
            far: load(&slabs[2]),
            origin: [
                L::load(&origin[x]),
                L::load(&origin[y]),
                L::load(&origin[z]),
            ],
            slope: [L::load(&slopes[0]), L::load(&slopes[1])],
            inverse_z: L::load(&slopes[2]),
            axes: [x, y, z],
            t_min: L::load(&range[0]),
            t_max: L::load(&range[1]),
        }
    }

    /// Which segments enter one child's box, as bits.
    #[inline(always)]
    fn enters(&self, node: &Node, child: usize) -> u32 {
        let mut enter = self.t_min;
        let mut leave = self.t_max;
        for axis in 0..3 {
            let a = L::splat(node.planes[2 * axis][child]) * self.inverse[axis];
            let b = L::splat(node.planes[2 * axis + 1][child]) * self.inverse[axis];
            enter = (a.min(b) - self.near[axis]).max(enter);
            leave = (a.max(b) - self.far[axis]).min(leave);
        }
        L::bits(enter.le(leave))
    }

    /// Which segments cross one triangle, as bits.
    #[inline(always)]
    fn crosses(&self, leaf: &Leaf, triangle: usize) -> u32 {
        let [x, y, z] = self.axes;
        let [a, b, c] = &leaf.corners;
        let corners = [
            splat([a[x][triangle], a[y][triangle], a[z][triangle]]),
            splat([b[x][triangle], b[y][triangle], b[z][triangle]]),
            splat([c[x][triangle], c[y][triangle], c[z][triangle]]),
        ];
        match crossing(
            corners,
            self.origin,
            self.slope,
            self.inverse_z,
            self.t_min,
            self.t_max,
        ) {
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
fn together<L: Lanes>(
    tree: &Tree,
    segments: &[Ray],
    visible: &mut [f32],
    room: &mut Room<u32>,
    room_of_one: &mut Room<()>,
) {
    // Lanes in the order of dominant axes: a group shares one.
    let mut numbers = [0u8; GROUPS * WIDTH];
    let mut groups: [Option<Group<L>>; GROUPS] = [const { None }; GROUPS];
    let mut group_count = 0;
    let mut used = 0u32;
    for z in 0..3 {
        let first = group_count * WIDTH;
        let mut end = first;
        for (number, ray) in segments.iter().enumerate() {
            if dominant_axis(ray) == z {
                numbers[end] = number as u8;
                used |= 1 << end;
                end += 1;
            }
        }
        for lanes in numbers[first..end].chunks(WIDTH) {
            groups[group_count] = Some(Group::new(segments, lanes, z, tree.extent));
            group_count += 1;
        }
    }
    let groups = &groups[..group_count];
    let shaft = Shaft::<L>::new(segments, tree.extent);
    // Segments that met a surface with partial coverage: done again, one by one.
    let mut again = 0u32;
    let mut stack = room.stack();
    let mut live = used;
    let (mut current, mut here) = (tree.root, live);
    'walk: loop {
        if here.count_ones() < TOGETHER {
            while here != 0 {
                let lane = here.trailing_zeros() as usize;
                here &= here - 1;
                let number = numbers[lane] as usize;
                let passed = visibility::<L>(tree, &segments[number], current, room_of_one);
                if passed == 0.0 {
                    live &= !(1 << lane);
                } else if passed < 1.0 {
                    again |= 1 << lane;
                }
            }
        } else if current & CHILD_IS_LEAF == 0 {
            let node = tree.node(current);
            let mut bits = shaft.enters(node);
            while bits != 0 {
                let child = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let mut entering = 0;
                for (k, group) in groups.iter().enumerate() {
                    let Some(group) = group else { continue };
                    if (here >> (WIDTH * k)) & 0xff != 0 {
                        entering |= group.enters(node, child) << (WIDTH * k);
                    }
                }
                if entering & here != 0 {
                    stack.push(Waiting {
                        reference: node.child[child],
                        with: entering & here,
                    });
                }
            }
        } else {
            let leaf = tree.leaf(current);
            for triangle in 0..WIDTH {
                if leaf.triangle[triangle] == u32::MAX {
                    break;
                }
                let mut struck = 0;
                for (k, group) in groups.iter().enumerate() {
                    let Some(group) = group else { continue };
                    if (here >> (WIDTH * k)) & 0xff != 0 {
                        struck |= group.crosses(leaf, triangle) << (WIDTH * k);
                    }
                }
                if leaf.triangle[triangle] & PARTIAL != 0 {
                    again |= struck & here;
                } else {
                    here &= !struck;
                    live &= !struck;
                }
            }
        }
        loop {
            let Some(next) = stack.pop() else { break 'walk };
            here = next.with & live;
            if here != 0 {
                current = next.reference;
                break;
            }
        }
    }
    while used != 0 {
        let lane = used.trailing_zeros() as usize;
        used &= used - 1;
        let number = numbers[lane] as usize;
        visible[number] = match (live >> lane & 1, again >> lane & 1) {
            (0, _) => 0.0,
            (_, 0) => 1.0,
            _ => visibility::<L>(tree, &segments[number], tree.root, room_of_one),
        };
    }
}
