//! Tiny triangles of one surface and side that share an element.
//!
//! A chair of ten thousand triangles receives light as a few dozen elements would. Triangles are
//! sorted into cubes of space as wide as an element and into bundles of directions (cells of a
//! cube map around each axis, so that a box's six faces are six bundles); what shares both shares
//! an element. A group that is still too large or too round is halved. Linear time but for the
//! sort.

use luxel_core::{Scene, Vec3};
use rayon::prelude::*;

/// One tiny triangle, or anything else that has a place and a normal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Item {
    pub low: Vec3,
    pub high: Vec3,
    pub normal: Vec3,
    pub area: f32,
    pub id: u32,
}

impl Item {
    pub fn of_triangle(scene: &Scene, triangle: u32) -> Item {
        let [a, b, c] = scene.corners(triangle as usize);
        let n = (b - a).as_dvec3().cross((c - a).as_dvec3());
        Item {
            low: a.min(b).min(c),
            high: a.max(b).max(c),
            normal: n.normalize_or_zero().as_vec3(),
            area: (0.5 * n.length()) as f32,
            id: triangle,
        }
    }

    fn place(&self, axis: usize) -> f32 {
        self.low[axis] + self.high[axis]
    }
}

/// What a group may be.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Width of the cubes, metres; no group is wider than twice this.
    pub cube_m: f32,
    /// Largest area, m².
    pub area_m2: f32,
    /// Cells along an edge of a face of the cube map, odd, so that axes lie in the middle of one.
    pub directions: u32,
    /// Cosine of the largest angle between a normal and the mean normal.
    pub cos_cone: f32,
}

/// Groups of triangles that share an element.
#[derive(Default)]
pub(crate) struct Clusters {
    /// Triangles, group by group.
    pub triangles: Vec<u32>,
    /// Length of each group.
    pub lengths: Vec<u32>,
}

/// A triangle to be grouped.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tiny {
    /// No group joins two families.
    pub family: u32,
    pub triangle: u32,
    /// Centre of the flat shape that the triangle is part of: its parts stay together.
    pub centre: Vec3,
}

/// Groups `tiny` triangles within `limits`. A single triangle is a group whatever its size.
pub(crate) fn clusters(scene: &Scene, tiny: &[Tiny], limits: Limits) -> Clusters {
    let (low, _) = scene.bounds();
    let mut keyed: Vec<(u128, u32)> = tiny
        .par_iter()
        .map(
            |&Tiny {
                 family,
                 triangle: t,
                 centre,
             }| {
                let [a, b, c] = scene.corners(t as usize);
                let place = (centre - low) / limits.cube_m;
                let cell = place
                    .to_array()
                    .map(|x| (x.max(0.0) as u128).min((1 << 21) - 1));
                let bundle = bundle((b - a).cross(c - a), limits.directions) as u128;
                let cube = (cell[0] << 42) | (cell[1] << 21) | cell[2];
                (((family as u128) << 96) | (bundle << 63) | cube, t)
            },
        )
        .collect();
    keyed.par_sort_unstable();
    let runs: Vec<&[(u128, u32)]> = keyed.chunk_by(|a, b| a.0 == b.0).collect();
    let parts: Vec<Clusters> = runs
        .par_chunks(1024)
        .map(|runs| {
            let mut part = Clusters::default();
            let mut items = Vec::new();
            for run in runs {
                items.clear();
                items.extend(run.iter().map(|&(_, t)| Item::of_triangle(scene, t)));
                divide(&mut items, limits, &mut part.lengths);
                part.triangles.extend(items.iter().map(|i| i.id));
            }
            part
        })
        .collect();
    let mut all = Clusters::default();
    for part in parts {
        all.triangles.extend(part.triangles);
        all.lengths.extend(part.lengths);
    }
    all
}

/// Cell of a cube map with `n` x `n` cells a face that a direction points to.
fn bundle(direction: Vec3, n: u32) -> u32 {
    let size = direction.abs();
    let axis = size.max_position();
    if size[axis] == 0.0 {
        return 0;
    }
    let across = |k: usize| {
        let x = 0.5 + 0.5 * direction[(axis + k) % 3] / size[axis];
        ((x * n as f32) as u32).min(n - 1)
    };
    let face = 2 * axis as u32 + u32::from(direction[axis] < 0.0);
    (face * n + across(1)) * n + across(2)
}

/// Halves `items` at the median along the axis of place or of normal that is spread most, a unit
/// of normal counting as `normal_m` metres; returns the length of the first half.
///
/// Precondition: two items or more. Deterministic: ties are broken by id.
pub(crate) fn halve(items: &mut [Item], normal_m: f32) -> usize {
    let (mut low, mut high) = ([f32::INFINITY; 6], [f32::NEG_INFINITY; 6]);
    let key = |item: &Item, axis: usize| {
        if axis < 3 {
            0.5 * item.place(axis)
        } else {
            item.normal[axis - 3] * normal_m
        }
    };
    for item in items.iter() {
        for axis in 0..6 {
            let v = key(item, axis);
            low[axis] = low[axis].min(v);
            high[axis] = high[axis].max(v);
        }
    }
    let spread = |axis: usize| high[axis] - low[axis];
    let axis = (1..6).fold(0, |best, a| if spread(a) > spread(best) { a } else { best });
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| {
        key(a, axis).total_cmp(&key(b, axis)).then(a.id.cmp(&b.id))
    });
    middle
}

/// Divides `items` (which are reordered) into groups within `limits`; appends their lengths.
fn divide(items: &mut [Item], limits: Limits, lengths: &mut Vec<u32>) {
    if items.len() == 1 || fits(items, limits) {
        lengths.push(items.len() as u32);
        return;
    }
    // A normal that is off by the whole cone counts as much as a place off by the whole cube.
    let sine = (1.0 - limits.cos_cone * limits.cos_cone).max(1e-4).sqrt();
    let middle = halve(items, limits.cube_m / (2.0 * sine));
    let (left, right) = items.split_at_mut(middle);
    divide(left, limits, lengths);
    divide(right, limits, lengths);
}

fn fits(items: &[Item], limits: Limits) -> bool {
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    let (mut area, mut sum) = (0.0f64, Vec3::ZERO);
    for item in items {
        low = low.min(item.low);
        high = high.max(item.high);
        area += item.area as f64;
        sum += item.normal * item.area;
    }
    if area > limits.area_m2 as f64 || (high - low).max_element() > 2.0 * limits.cube_m {
        return false;
    }
    let axis = sum.normalize_or_zero();
    items
        .iter()
        .all(|item| item.normal.dot(axis) >= limits.cos_cone)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_in_the_middle_of_their_bundle() {
        // Directions 10 degrees off an axis stay with it; the six axes are apart.
        for n in [1, 3] {
            let mut seen = Vec::new();
            for axis in [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z] {
                let own = bundle(axis, n);
                assert!(!seen.contains(&own) && own < 6 * n * n);
                seen.push(own);
                for off in [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z] {
                    assert_eq!(bundle(axis + off * 0.17, n), own);
                }
            }
        }
    }
}
