//! Walks the tree for one ray.
//!
//! Boxes: the slab test, eight at a time. Every box is taken as if it were larger by a margin
//! of a few units in the last place of the largest coordinate, which covers all rounding of the
//! slab test and of the triangle test; the margin sits in the constants of a ray, so it costs
//! nothing per node.
//!
//! Triangles: the test of Woop, Benthin and Wald. Corners are sheared so that the ray runs along
//! one axis; the three edge functions are then 2x2 determinants. Two triangles with a common
//! edge compute it from the same sheared corners, with the opposite sign and the same bits, and
//! zero counts as inside for both: a ray cannot slip between them. Products are rounded before
//! they are subtracted (no fused multiply-add), which keeps the sign of each determinant right
//! or makes it zero.
//!
//! Of several crossings at the same distance the triangle with the lowest index counts, so
//! answers do not depend on the order in which the tree is walked.
//!
//! Source: [Woop13]; the bound on the rounding of slabs follows [Ize13].

use crate::build::MOST_WAITING;
use crate::bvh::{CHILD_IS_LEAF, Leaf, Node, PARTIAL, Tree};
use crate::contract::{Hit, Ray};
use crate::lanes::{Lanes, WIDTH};
use glam::Vec3A;
use luxel_core::Side;
use std::mem::MaybeUninit;

/// Margin of boxes in units of the largest coordinate: rounding is below six units in the last
/// place, four of the triangle test and two of the slabs.
pub(crate) const MARGIN: f32 = 8.0 * f32::EPSILON;

/// Directions along an axis count as at least this share of the largest, so that slabs are
/// finite. Over the whole scene the ray strays by less than the margin.
pub(crate) const LEAST_SLOPE: f32 = 1e-12;

/// What one ray needs on its way down, as plain numbers.
pub(crate) struct Slabs {
    /// 1 / direction.
    pub(crate) inverse: [f32; 3],
    /// To subtract at the plane that the ray meets first.
    pub(crate) near: [f32; 3],
    /// To subtract at the other plane.
    pub(crate) far: [f32; 3],
    /// 1 where the ray runs towards smaller coordinates.
    pub(crate) negative: [usize; 3],
}

/// The shear that turns a ray into the axis `z`.
#[derive(Clone, Copy)]
pub(crate) struct Shear {
    /// Axes, a cyclic order with the largest direction last.
    pub(crate) axes: [usize; 3],
    /// Direction over direction along z.
    pub(crate) slope: [f32; 2],
    /// 1 / direction along z.
    pub(crate) inverse_z: f32,
}

/// Axis along which the direction is largest; the shear makes it z.
#[inline(always)]
pub(crate) fn dominant_axis(ray: &Ray) -> usize {
    let length = ray.direction.abs();
    let of_two = usize::from(length.y >= length.x);
    if length.z >= length.x.max(length.y) {
        2
    } else {
        of_two
    }
}

/// Whether a ray can meet anything: neither a zero or infinite direction, nor an origin that is
/// not finite.
#[inline(always)]
pub(crate) fn is_usable(ray: &Ray) -> bool {
    let (o, d) = (ray.origin, ray.direction);
    // Sums are not finite if a term is not.
    (o.x + o.y + o.z + d.x + d.y + d.z).is_finite() && (1.0 / d.abs().max_element()).is_finite()
}

/// Slabs and shear of a ray; `None` if it can meet nothing.
#[inline(always)]
pub(crate) fn prepare(ray: &Ray, extent: f32) -> Option<(Slabs, Shear)> {
    if !is_usable(ray) {
        return None;
    }
    let (o, d) = (Vec3A::from(ray.origin), Vec3A::from(ray.direction));
    let least = Vec3A::splat(d.abs().max_element() * LEAST_SLOPE);
    let slope = Vec3A::select(d.abs().cmplt(least), least.copysign(d), d);
    let inverse = Vec3A::ONE / slope;
    let margin = MARGIN * (o.abs().max_element() + extent);
    let (start, widened) = (o * inverse, inverse.abs() * margin);
    let slabs = Slabs {
        inverse: inverse.to_array(),
        near: (start + widened).to_array(),
        far: (start - widened).to_array(),
        negative: inverse.to_array().map(|i| usize::from(i < 0.0)),
    };
    let z = dominant_axis(ray);
    let (x, y) = ((z + 1) % 3, (z + 2) % 3);
    let inverse_z = slabs.inverse[z];
    let slope = [ray.direction[x] * inverse_z, ray.direction[y] * inverse_z];
    Some((
        slabs,
        Shear {
            axes: [x, y, z],
            slope,
            inverse_z,
        },
    ))
}

// Lanes do not go through `array::map`: what is not inlined everywhere is compiled without the
// instructions of the kernel, and costs a factor of three.
#[inline(always)]
pub(crate) fn splat<L: Lanes>(values: [f32; 3]) -> [L; 3] {
    [
        L::splat(values[0]),
        L::splat(values[1]),
        L::splat(values[2]),
    ]
}

/// A prepared ray in registers.
pub(crate) struct Beam<L> {
    inverse: [L; 3],
    near: [L; 3],
    far: [L; 3],
    /// Which of a node's planes the ray meets first on each axis.
    near_plane: [usize; 3],
    origin: [L; 3],
    axes: [usize; 3],
    slope: [L; 2],
    inverse_z: L,
    t_min: L,
}

impl<L: Lanes> Beam<L> {
    #[inline(always)]
    pub(crate) fn new(ray: &Ray, extent: f32) -> Option<Beam<L>> {
        let (slabs, shear) = prepare(ray, extent)?;
        let origin = ray.origin.to_array();
        let [x, y, z] = shear.axes;
        let [back_x, back_y, back_z] = slabs.negative;
        Some(Beam {
            inverse: splat(slabs.inverse),
            near: splat(slabs.near),
            far: splat(slabs.far),
            near_plane: [back_x, 2 + back_y, 4 + back_z],
            origin: splat([origin[x], origin[y], origin[z]]),
            axes: shear.axes,
            slope: [L::splat(shear.slope[0]), L::splat(shear.slope[1])],
            inverse_z: L::splat(shear.inverse_z),
            t_min: L::splat(ray.t_min),
        })
    }

    /// Which boxes the ray enters before `t_max`, as bits, and where.
    #[inline(always)]
    pub(crate) fn boxes(&self, node: &Node, t_max: L) -> (u32, L) {
        let [nx, ny, nz] = self.near_plane;
        let plane = |k: usize| L::load(&node.planes[k]);
        let x0 = plane(nx).mul_sub(self.inverse[0], self.near[0]);
        let y0 = plane(ny).mul_sub(self.inverse[1], self.near[1]);
        let z0 = plane(nz).mul_sub(self.inverse[2], self.near[2]);
        let x1 = plane(nx ^ 1).mul_sub(self.inverse[0], self.far[0]);
        let y1 = plane(ny ^ 1).mul_sub(self.inverse[1], self.far[1]);
        let z1 = plane(nz ^ 1).mul_sub(self.inverse[2], self.far[2]);
        let enter = x0.max(y0).max(z0.max(self.t_min));
        let leave = x1.min(y1).min(z1.min(t_max));
        (L::bits(enter.le(leave)), enter)
    }

    /// Which triangles the ray crosses at `t_min < t <= t_max`.
    #[inline(always)]
    pub(crate) fn triangles(&self, leaf: &Leaf, t_max: L) -> Option<Crossing<L>> {
        let [x, y, z] = self.axes;
        let [a, b, c] = &leaf.corners;
        crossing(
            [
                [L::load(&a[x]), L::load(&a[y]), L::load(&a[z])],
                [L::load(&b[x]), L::load(&b[y]), L::load(&b[z])],
                [L::load(&c[x]), L::load(&c[y]), L::load(&c[z])],
            ],
            self.origin,
            self.slope,
            self.inverse_z,
            self.t_min,
            t_max,
        )
    }
}

/// Crossings of rays with triangles, lane by lane.
pub(crate) struct Crossing<L> {
    /// Lanes that cross within the range; not zero.
    pub(crate) bits: u32,
    /// Ray parameter.
    pub(crate) t: L,
    /// Edge functions opposite corners 1 and 2, and the sum of all three.
    v: L,
    w: L,
    sum: L,
}

/// The triangle test [Woop13]: `corners[k]` in the order of the shear's axes. Lanes are
/// triangles for one ray and rays for one triangle; the arithmetic, so the answer, is the same.
#[inline(always)]
pub(crate) fn crossing<L: Lanes>(
    corners: [[L; 3]; 3],
    origin: [L; 3],
    slope: [L; 2],
    inverse_z: L,
    t_min: L,
    t_max: L,
) -> Option<Crossing<L>> {
    let [ax, ay, az] = sheared(corners[0], origin, slope);
    let [bx, by, bz] = sheared(corners[1], origin, slope);
    let [cx, cy, cz] = sheared(corners[2], origin, slope);
    let u = cx * by - cy * bx;
    let v = ax * cy - ay * cx;
    let w = bx * ay - by * ax;
    let zero = L::splat(0.0);
    let inside = zero.le(u.min(v.min(w))) | u.max(v.max(w)).le(zero);
    if L::bits(inside) == 0 {
        return None;
    }
    let sum = u + v + w;
    let t = (u * az + v * bz + w * cz) / sum * inverse_z;
    let bits = L::bits(inside & t_min.lt(t) & t.le(t_max));
    (bits != 0).then_some(Crossing { bits, t, v, w, sum })
}

/// A corner seen from the ray: across it, and along it.
#[inline(always)]
fn sheared<L: Lanes>(corner: [L; 3], origin: [L; 3], slope: [L; 2]) -> [L; 3] {
    let z = corner[2] - origin[2];
    [
        corner[0] - origin[0] - slope[0] * z,
        corner[1] - origin[1] - slope[1] * z,
        z,
    ]
}

impl<L: Lanes> Crossing<L> {
    /// Barycentric weights of corners 1 and 2, and the sum whose sign tells the side.
    #[inline(always)]
    fn weights(&self) -> ([f32; WIDTH], [f32; WIDTH], [f32; WIDTH]) {
        (
            (self.v / self.sum).store(),
            (self.w / self.sum).store(),
            self.sum.store(),
        )
    }
}

/// Room for what waits in the deepest tree that the builder makes.
///
/// Not initialised: clearing four kilobytes would cost as much as a short ray.
pub(crate) struct Room<T>(MaybeUninit<[T; MOST_WAITING]>);

impl<T: Copy> Room<T> {
    #[inline(always)]
    pub(crate) fn new() -> Room<T> {
        Room(MaybeUninit::uninit())
    }

    #[inline(always)]
    pub(crate) fn stack(&mut self) -> Stack<'_, T> {
        Stack {
            items: &mut self.0,
            count: 0,
        }
    }
}

/// What waits, last in first out.
pub(crate) struct Stack<'a, T> {
    items: &'a mut MaybeUninit<[T; MOST_WAITING]>,
    count: usize,
}

impl<T: Copy> Stack<'_, T> {
    #[inline(always)]
    pub(crate) fn push(&mut self, item: T) {
        self.put(self.count, item);
        self.count += 1;
    }

    #[inline(always)]
    pub(crate) fn pop(&mut self) -> Option<T> {
        if self.count == 0 {
            return None;
        }
        self.count -= 1;
        Some(self.get(self.count))
    }

    #[inline(always)]
    fn put(&mut self, at: usize, item: T) {
        debug_assert!(at < MOST_WAITING);
        // SAFETY: `at <= count`, and count stays below MOST_WAITING: a walk leaves at most
        // eight waiting on the last level and seven on each above, and the builder bounds the
        // levels.
        unsafe { self.items.as_mut_ptr().cast::<T>().add(at).write(item) };
    }

    #[inline(always)]
    fn get(&self, at: usize) -> T {
        // SAFETY: all below `count` were put, and callers ask for those only.
        unsafe { self.items.as_ptr().cast::<T>().add(at).read() }
    }
}

/// A subtree that waits: where the ray enters it above, which it is below, so that comparing
/// the numbers compares the distances. (Not so for distances below zero, where the order of a
/// walk is worse and its answer the same.)
#[inline(always)]
fn waiting(enter: f32, reference: u32) -> u64 {
    u64::from(enter.to_bits()) << 32 | u64::from(reference)
}

impl Stack<'_, u64> {
    /// Adds an item above `base` so that those from `base` on are sorted, farthest first.
    #[inline(always)]
    fn insert(&mut self, base: usize, item: u64) {
        let mut at = self.count;
        while at > base && self.get(at - 1) < item {
            self.put(at, self.get(at - 1));
            at -= 1;
        }
        self.put(at, item);
        self.count += 1;
    }
}

/// [`closest`] of each ray.
#[inline(always)]
pub(crate) fn closest_batch<L: Lanes>(tree: &Tree, rays: &[Ray], hits: &mut [Hit]) {
    let mut room = Room::new();
    for (ray, hit) in rays.iter().zip(hits) {
        *hit = closest::<L>(tree, ray, &mut room);
    }
}

/// Nearest crossing.
#[inline(always)]
fn closest<L: Lanes>(tree: &Tree, ray: &Ray, room: &mut Room<u64>) -> Hit {
    let Some(beam) = Beam::<L>::new(ray, tree.extent) else {
        return Hit::MISS;
    };
    let mut stack = room.stack();
    let mut best = Hit {
        t: ray.t_max,
        ..Hit::MISS
    };
    let mut t_max = L::splat(ray.t_max);
    let mut current = tree.root;
    'walk: loop {
        while current & CHILD_IS_LEAF == 0 {
            let node = tree.node(current);
            let (bits, enter) = beam.boxes(node, t_max);
            if bits == 0 {
                break;
            }
            // Nearest first: the others wait, sorted, the farthest deepest. One or two is usual
            // and takes no branch, for none would be predicted.
            let enter = enter.store();
            let child = |bits: u32| {
                let k = bits.trailing_zeros() as usize % WIDTH;
                waiting(enter[k], node.child[k])
            };
            let mut rest = bits & (bits - 1);
            let first = child(bits);
            let second = child(if rest == 0 { bits } else { rest });
            let mut nearest = first.min(second);
            let base = stack.count;
            let farther = first.max(second);
            tree.prefetch(farther as u32);
            stack.put(base, farther);
            stack.count += usize::from(rest != 0);
            rest &= rest.wrapping_sub(1);
            while rest != 0 {
                let next = child(rest);
                tree.prefetch(next as u32);
                rest &= rest - 1;
                stack.insert(base, next.max(nearest));
                nearest = nearest.min(next);
            }
            current = nearest as u32;
        }
        if current & CHILD_IS_LEAF != 0 {
            let leaf = tree.leaf(current);
            if let Some(crossing) = beam.triangles(leaf, t_max) {
                nearer(tree, ray, leaf, &crossing, &mut best);
                t_max = L::splat(best.t);
            }
        }
        loop {
            let Some(next) = stack.pop() else { break 'walk };
            if f32::from_bits((next >> 32) as u32) <= best.t {
                current = next as u32;
                break;
            }
        }
    }
    if best.is_hit() { best } else { Hit::MISS }
}

/// Takes over the nearest of a leaf's crossings.
#[inline(always)]
fn nearer<L: Lanes>(tree: &Tree, ray: &Ray, leaf: &Leaf, crossing: &Crossing<L>, best: &mut Hit) {
    let t = crossing.t.store();
    let (u, v, sum) = crossing.weights();
    let mut bits = crossing.bits;
    while bits != 0 {
        let k = bits.trailing_zeros() as usize;
        bits &= bits - 1;
        let triangle = leaf.triangle[k] & !PARTIAL;
        let is_nearer = t[k] < best.t || (t[k] == best.t && triangle < best.triangle);
        if !is_nearer
            || (leaf.triangle[k] & PARTIAL != 0 && !stops(tree, ray, triangle, u[k], v[k]))
        {
            continue;
        }
        // Corners turn counter-clockwise around the ray's axis where the sum is negative.
        let z = dominant_axis(ray);
        let front = (sum[k] > 0.0) == (ray.direction[z] > 0.0);
        let side = if front { Side::Front } else { Side::Back };
        *best = Hit {
            t: t[k],
            triangle,
            u: u[k],
            v: v[k],
            side,
        };
    }
}

/// Whether a surface with partial coverage stops this ray.
#[cold]
#[inline(never)]
fn stops(tree: &Tree, ray: &Ray, triangle: u32, u: f32, v: f32) -> bool {
    let coverage = tree.scene.coverage_at(triangle as usize, u, v);
    if coverage >= 1.0 {
        return true;
    }
    // A number in 0..1 from the ray and the triangle, never 1: nothing stops at a hole.
    let words = ray
        .origin
        .to_array()
        .into_iter()
        .chain(ray.direction.to_array());
    let hash = words
        .map(f32::to_bits)
        .fold(mix(triangle), |hash, word| mix(hash ^ word));
    ((hash >> 8) as f32) * (1.0 / (1 << 24) as f32) < coverage
}

/// A bijection of 32 bits in which each bit depends on all [Wellons18].
fn mix(word: u32) -> u32 {
    let mut x = word.wrapping_add(0x9e37_79b9);
    x = (x ^ (x >> 16)).wrapping_mul(0x21f0_aaad);
    x = (x ^ (x >> 15)).wrapping_mul(0x735a_2d97);
    x ^ (x >> 15)
}

/// Share of light that passes one segment through the subtree at `root`.
#[inline(always)]
pub(crate) fn visibility<L: Lanes>(tree: &Tree, ray: &Ray, root: u32) -> f32 {
    let Some(beam) = Beam::<L>::new(ray, tree.extent) else {
        return 1.0;
    };
    let mut room = Room::new();
    let mut stack = room.stack();
    let t_max = L::splat(ray.t_max);
    let mut passed = 1.0;
    let mut current = root;
    loop {
        if current & CHILD_IS_LEAF == 0 {
            let node = tree.node(current);
            let (bits, _) = beam.boxes(node, t_max);
            if bits != 0 {
                // As in `closest`, one or two without a branch.
                let child = |bits: u32| node.child[bits.trailing_zeros() as usize % WIDTH];
                current = child(bits);
                let mut rest = bits & (bits - 1);
                let second = child(if rest == 0 { bits } else { rest });
                tree.prefetch(second);
                stack.put(stack.count, second);
                stack.count += usize::from(rest != 0);
                rest &= rest.wrapping_sub(1);
                while rest != 0 {
                    stack.push(child(rest));
                    tree.prefetch(child(rest));
                    rest &= rest - 1;
                }
                continue;
            }
        } else {
            let leaf = tree.leaf(current);
            if let Some(crossing) = beam.triangles(leaf, t_max) {
                if !tree.has_partial {
                    return 0.0;
                }
                passed *= free_share(tree, leaf, &crossing);
                if passed == 0.0 {
                    return 0.0;
                }
            }
        }
        let Some(next) = stack.pop() else {
            return passed;
        };
        current = next;
    }
}

/// Product of `1 - coverage` over a leaf's crossings.
#[cold]
#[inline(never)]
fn free_share<L: Lanes>(tree: &Tree, leaf: &Leaf, crossing: &Crossing<L>) -> f32 {
    let (u, v, _) = crossing.weights();
    let mut passed = 1.0;
    for k in (0..WIDTH).filter(|k| crossing.bits >> k & 1 != 0) {
        if leaf.triangle[k] & PARTIAL == 0 {
            return 0.0;
        }
        let triangle = (leaf.triangle[k] & !PARTIAL) as usize;
        passed *= 1.0 - tree.scene.coverage_at(triangle, u[k], v[k]).clamp(0.0, 1.0);
    }
    passed
}
