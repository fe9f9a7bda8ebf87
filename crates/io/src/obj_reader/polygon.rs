//! Cutting a polygon into triangles by its ears.
//!
//! An ear is a convex corner whose triangle holds no other corner. [Meisters75] proves that a
//! simple polygon has two. Only the neighbours of a cut ear are looked at again, so a polygon of
//! n corners takes at most of the order of n² steps. A polygon that is not simple has stretches
//! without an ear: there the next corner is cut whatever it looks like.

use luxel_core::DVec3;
use std::cmp::Ordering;

/// Corners above which a polygon is cut as a fan: n² steps would take seconds.
pub(crate) const MOST_CORNERS: usize = 4096;

/// Area vector of a closed ring (Newell).
pub(crate) fn area_vector(p: &[DVec3]) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for k in 1..p.len().saturating_sub(1) {
        sum += (p[k] - p[0]).cross(p[k + 1] - p[0]);
    }
    sum * 0.5
}

/// Whether all corners lie in one plane, to a thousandth of the polygon's size.
pub(crate) fn is_flat(p: &[DVec3]) -> bool {
    if p.len() < 4 {
        return true;
    }
    let normal = area_vector(p).normalize_or_zero();
    let (mut off, mut size) = (0.0f64, 0.0f64);
    for q in p {
        off = off.max((*q - p[0]).dot(normal).abs());
        size = size.max((*q - p[0]).length());
    }
    off <= 1e-3 * size
}

/// The triangles of a polygon of at least three corners, as positions in the ring.
pub(crate) fn ears(p: &[DVec3]) -> Vec<[usize; 3]> {
    let n = p.len();
    if n == 3 {
        return vec![[0, 1, 2]];
    }
    if !(3..=MOST_CORNERS).contains(&n) {
        return (1..n.saturating_sub(1)).map(|k| [0, k, k + 1]).collect();
    }
    let normal = area_vector(p);
    let turn = |a: usize, b: usize, c: usize| (p[b] - p[a]).cross(p[c] - p[b]).dot(normal);
    let mut next: Vec<usize> = (0..n).map(|k| (k + 1) % n).collect();
    let mut before: Vec<usize> = (0..n).map(|k| (k + n - 1) % n).collect();
    let mut left = vec![true; n];
    // A corner that is convex stays so when its neighbours are cut, so only corners that were
    // not can lie in an ear.
    let hollow: Vec<usize> = (0..n)
        .filter(|&k| turn(before[k], k, next[k]).partial_cmp(&0.0) != Some(Ordering::Greater))
        .collect();
    let is_ear = |b: usize, before: &[usize], next: &[usize], left: &[bool]| {
        let (a, c) = (before[b], next[b]);
        turn(a, b, c) > 0.0
            && !hollow.iter().any(|&q| {
                left[q]
                    && ![a, b, c].contains(&q)
                    // A corner at the same place as one of the ear's touches it only.
                    && ![a, b, c].iter().any(|&k| p[k] == p[q])
                    && turn(a, b, q) >= 0.0
                    && turn(b, c, q) >= 0.0
                    && turn(c, a, q) >= 0.0
            })
    };
    let mut ear: Vec<bool> = (0..n).map(|k| is_ear(k, &before, &next, &left)).collect();
    let mut out = Vec::with_capacity(n - 2);
    let (mut head, mut remaining) = (0, n);
    while remaining > 3 {
        let mut b = head;
        while !ear[b] {
            b = next[b];
            if b == head {
                b = next[head];
                break;
            }
        }
        let (a, c) = (before[b], next[b]);
        out.push([a, b, c]);
        left[b] = false;
        next[a] = c;
        before[c] = a;
        if b == head {
            head = c;
        }
        remaining -= 1;
        for k in [a, c] {
            ear[k] = is_ear(k, &before, &next, &left);
        }
    }
    out.push([before[head], head, next[head]]);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(ring: &[DVec3], triangles: &[[usize; 3]]) -> f64 {
        triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|k| ring[k]);
                // Signed: an overlapping or turned triangle would show.
                0.5 * (b - a).cross(c - a).z
            })
            .sum()
    }

    #[test]
    fn a_comb_is_cut_into_triangles_of_its_area() {
        // Ten teeth of 1 x 2 on a back of 19 x 1: area 10 * 2 + 19 = 39.
        let mut ring = vec![DVec3::ZERO, DVec3::new(19.0, 0.0, 0.0)];
        for k in (0..10).rev() {
            let x = 2.0 * k as f64;
            ring.push(DVec3::new(x + 1.0, 3.0, 0.0));
            ring.push(DVec3::new(x, 3.0, 0.0));
            if k > 0 {
                ring.push(DVec3::new(x, 1.0, 0.0));
                ring.push(DVec3::new(x - 1.0, 1.0, 0.0));
            }
        }
        let triangles = ears(&ring);
        assert_eq!(triangles.len(), ring.len() - 2);
        assert!((area(&ring, &triangles) - 39.0).abs() < 1e-9);
        for t in &triangles {
            assert!(area(&ring, &[*t]) >= 0.0, "{t:?} is turned");
        }
    }

    #[test]
    fn polygons_that_are_not_simple_end() {
        let bow = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 0.0)];
        assert_eq!(ears(&bow).len(), 2);
        assert_eq!(ears(&[DVec3::ZERO; 7]).len(), 5);
        assert_eq!(ears(&[DVec3::NAN; 5]).len(), 3);
    }
}
