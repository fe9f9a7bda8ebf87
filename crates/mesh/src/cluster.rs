//! Tiny triangles of one surface and side that share an element.
//!
//! A chair of ten thousand triangles receives light as a few dozen elements would. Triangles
//! are halved at the median of place or normal, whichever is spread too far, until each group is
//! no larger than an element and its normals lie in a narrow cone.

use luxel_core::{Scene, Vec3};

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
    /// Largest edge of the bounds, metres.
    pub extent_m: f32,
    /// Largest area, m².
    pub area_m2: f32,
    /// Cosine of the largest angle between a normal and the mean normal.
    pub cos_cone: f32,
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

/// Divides `items` (which are reordered) into groups within `limits`; returns their lengths.
///
/// A single item is a group whatever its size.
pub(crate) fn groups(items: &mut [Item], limits: Limits) -> Vec<u32> {
    if items.is_empty() {
        return Vec::new();
    }
    if items.len() == 1 || fits(items, limits) {
        return vec![items.len() as u32];
    }
    // A normal that is off by the whole cone counts as much as a place off by the whole extent.
    let sine = (1.0 - limits.cos_cone * limits.cos_cone).max(1e-4).sqrt();
    let middle = halve(items, limits.extent_m / (2.0 * sine));
    let (left, right) = items.split_at_mut(middle);
    let (mut a, b) = if left.len() > 4096 {
        rayon::join(|| groups(left, limits), || groups(right, limits))
    } else {
        (groups(left, limits), groups(right, limits))
    };
    a.extend(b);
    a
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
    if area > limits.area_m2 as f64 || (high - low).max_element() > limits.extent_m {
        return false;
    }
    let axis = sum.normalize_or_zero();
    items
        .iter()
        .all(|item| item.normal.dot(axis) >= limits.cos_cone)
}
