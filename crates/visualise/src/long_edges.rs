//! Long edges halved until light can be drawn along them.
//!
//! Cutting a surface along contact lines leaves long thin triangles. Their area is small, so no
//! strategy divides them, yet a dark corner of one would darken it over its whole length. Here
//! each triangle is halved at its longest edge while that is longer than asked [Rivara84]. What
//! happens to an edge depends on its length alone, so both its triangles agree on the new points
//! and no crack opens.
//!
//! Source: [Rivara84], longest-edge bisection.

use crate::outlines::Drawn;
use luxel_core::Vec3;
use std::collections::HashMap;

/// A point in the middle of an edge: the vertices it lies between.
pub(crate) struct Middle {
    pub between: [u32; 2],
    pub position: Vec3,
}

/// Divides `triangles` until no edge is longer than `longest_m`. `positions` are those of their
/// vertices; the new vertices come after them in order.
///
/// Edges halve at each step, so a triangle with edges `n` times too long becomes about `n²`, and
/// a sliver about `n`. At most `most` new vertices are made: the rest stays as it is.
pub(crate) fn halve(
    triangles: Vec<Drawn<3>>,
    positions: &[Vec3],
    longest_m: f32,
    most: usize,
) -> (Vec<Drawn<3>>, Vec<Middle>) {
    let mut middles: Vec<Middle> = Vec::new();
    let mut of_edge: HashMap<[u32; 2], u32> = HashMap::new();
    let (mut todo, mut done) = (triangles, Vec::new());
    todo.reverse();
    while let Some(drawn) = todo.pop() {
        let t = drawn.corners;
        let at = |v: u32, middles: &[Middle]| match positions.get(v as usize) {
            Some(p) => *p,
            None => middles[v as usize - positions.len()].position,
        };
        // Ends in one order, so that both triangles of an edge measure the same.
        let edge = |k: usize| {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            [a.min(b), a.max(b)]
        };
        let length = |k: usize| {
            let [a, b] = edge(k);
            (at(b, &middles) - at(a, &middles)).length()
        };
        let k = (1..3).fold(0, |best, k| if length(k) > length(best) { k } else { best });
        if length(k) <= longest_m || middles.len() >= most && !of_edge.contains_key(&edge(k)) {
            done.push(drawn);
            continue;
        }
        let middle = *of_edge.entry(edge(k)).or_insert_with(|| {
            let [a, b] = edge(k);
            let position = 0.5 * (at(a, &middles) + at(b, &middles));
            middles.push(Middle {
                between: [a, b],
                position,
            });
            (positions.len() + middles.len() - 1) as u32
        });
        let [a, b, c] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
        for corners in [[middle, b, c], [a, middle, c]] {
            todo.push(Drawn { corners, ..drawn });
        }
    }
    (done, middles)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(triangles: Vec<[u32; 3]>) -> Vec<Drawn<3>> {
        let one = |corners| Drawn { corners, source: 0 };
        triangles.into_iter().map(one).collect()
    }

    fn area(triangles: &[[u32; 3]], p: &[Vec3]) -> f64 {
        triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| p[v as usize].as_dvec3());
                0.5 * (b - a).cross(c - a).length()
            })
            .sum()
    }

    #[test]
    fn slivers_become_short_and_neighbours_agree() {
        // A fan of slivers around one corner, as beside a plate on a table.
        let mut positions = vec![Vec3::ZERO];
        for k in 0..=6 {
            positions.push(Vec3::new(3.0, 0.05 * k as f32 * k as f32, 0.0));
        }
        let triangles: Vec<[u32; 3]> = (1..7).map(|k| [0, k, k + 1]).collect();
        let before = area(&triangles, &positions);
        let (after, middles) = halve(drawn(triangles), &positions, 0.5, usize::MAX);
        let after: Vec<[u32; 3]> = after.iter().map(|t| t.corners).collect();
        positions.extend(middles.iter().map(|m| m.position));
        assert!((area(&after, &positions) - before).abs() < 1e-6);
        let mut edges: HashMap<[u32; 2], i32> = HashMap::new();
        for t in &after {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                assert!((positions[a as usize] - positions[b as usize]).length() <= 0.5);
                *edges.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1 } else { -1 };
            }
        }
        // Open edges are on the border of the fan and nowhere else.
        for ([a, b], n) in edges {
            let (p, q) = (positions[a as usize], positions[b as usize]);
            let on = |f: &dyn Fn(Vec3) -> f32| f(p).abs() < 1e-5 && f(q).abs() < 1e-5;
            let border = on(&|p| p.x - 3.0)
                || on(&|p| p.y - p.x * 0.05 / 3.0)
                || on(&|p| p.y - p.x * 0.05 * 49.0 / 3.0)
                || on(&|p| p.y - p.x * 0.05 * 36.0 / 3.0)
                || on(&|p| p.y);
            assert!(n == 0 || border, "{p} to {q}");
        }
    }

    #[test]
    fn short_edges_stay_and_the_bound_holds() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let one = || drawn(vec![[0, 1, 2]]);
        let (same, none) = halve(one(), &positions, 2.0, usize::MAX);
        assert_eq!((same.len(), same[0].corners, none.len()), (1, [0, 1, 2], 0));
        let (_, bounded) = halve(one(), &positions, 1e-3, 100);
        assert_eq!(bounded.len(), 100);
    }
}
