//! A polygon of any shape into convex planar parts, and one convex polygon out of others.
//!
//! A concave polygon is cut into triangles (`outline`), and these are put together again over every
//! diagonal that no hollow corner needs [Hertel83]: at most four times as many parts as there could
//! be. A polygon that is not flat is cut by its ears and stays in triangles. Subtraction cuts a
//! piece along one edge of the cutter after the other and keeps what lies outside: every piece
//! stays convex.

use super::outline::enclosed;
use crate::obj_reader::polygon::{MOST_CORNERS, area_vector, ears};
use luxel_core::{DVec3, Polygon};
use std::collections::HashMap;

/// What lengths mean nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tolerance {
    /// Corners this far off a plane lie in it, metres.
    pub plane_m: f64,
    /// Rounding of a stored number in relation to its size.
    pub grain: f64,
}

/// What a polygon was cut into.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Cut {
    /// Convex and planar, each with area; all face where the polygon does.
    pub parts: Vec<Polygon>,
    /// All corners lie in one plane.
    pub flat: bool,
    /// The outline crosses itself.
    pub crossed: bool,
}

/// A polygon that is not convex has too many corners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TooManyCorners;

/// How far a flat polygon's corners may lie off its plane in relation to its size.
const FLAT: f64 = 1e-6;

/// Largest distance from the first corner.
pub(super) fn size_of(p: &[DVec3]) -> f64 {
    let far = |q: &DVec3| q.distance_squared(p[0]);
    p.iter().map(far).fold(0.0, f64::max).sqrt()
}

/// Whether a polygon with this area vector is no more than a line to the file's numbers.
fn is_line(area: DVec3, p: &[DVec3], grain: f64) -> bool {
    let largest = p.iter().map(|q| q.abs().max_element()).fold(0.0, f64::max);
    // Twice the area over the length is the height. `!(a > b)`: NaN is a line too.
    let height_is_seen = 2.0 * area.length() > grain * largest * size_of(p);
    !height_is_seen
}

/// Whether some corner lies off the line from the first to the one farthest from it.
fn has_breadth(p: &[DVec3], grain: f64) -> bool {
    let far = |q: &&DVec3| q.distance_squared(p[0]);
    let Some(far) = p.iter().max_by(|a, b| far(a).total_cmp(&far(b))) else {
        return false;
    };
    p.iter().any(|q| {
        let area = 0.5 * (*far - p[0]).cross(*q - p[0]);
        !is_line(area, &[p[0], *far, *q], grain)
    })
}

/// The convex parts of a closed ring of corners. A ring without area has none.
pub(super) fn convex_parts(ring: &[DVec3], tolerance: Tolerance) -> Result<Cut, TooManyCorners> {
    let mut cut = Cut {
        parts: Vec::new(),
        flat: true,
        crossed: false,
    };
    let mut p: Vec<DVec3> = Vec::with_capacity(ring.len());
    for &q in ring {
        if p.last() != Some(&q) {
            p.push(q);
        }
    }
    while p.len() > 1 && p.first() == p.last() {
        p.pop();
    }
    if p.len() < 3 {
        return Ok(cut);
    }
    let area = area_vector(&p);
    if is_line(area, &p, tolerance.grain) {
        // Halves that cancel, such as those of a bow tie: which way they would face is not said.
        cut.crossed = has_breadth(&p, tolerance.grain);
        return Ok(cut);
    }
    let normal = area.normalize();
    let size = size_of(&p);
    let middle = p.iter().sum::<DVec3>() / p.len() as f64;
    let off = p.iter().map(|q| (*q - middle).dot(normal).abs());
    cut.flat = p.len() == 3 || off.fold(0.0, f64::max) <= tolerance.plane_m.max(FLAT * size);
    if p.len() == 3 || (cut.flat && is_convex(&p, normal)) {
        cut.parts.push(Polygon::new(p));
        return Ok(cut);
    }
    if p.len() > MOST_CORNERS {
        return Err(TooManyCorners);
    }
    let inside = if cut.flat {
        enclosed(&p, normal, size)
    } else {
        None
    };
    let Some(inside) = inside else {
        for t in ears(&p) {
            push_part(&mut cut.parts, t.iter().map(|&k| p[k]), tolerance.grain);
        }
        if cut.flat {
            cut.crossed = true;
            for part in &mut cut.parts {
                if part.area_vector().dot(normal) < 0.0 {
                    part.vertices.reverse();
                }
            }
        }
        return Ok(cut);
    };
    cut.crossed = inside.crossed;
    for piece in merged(&p, normal, inside.triangles) {
        let corners = piece.into_iter().map(|k| p[k]);
        push_part(&mut cut.parts, corners, tolerance.grain);
    }
    Ok(cut)
}

/// Adds a part unless it is a line.
fn push_part(parts: &mut Vec<Polygon>, corners: impl Iterator<Item = DVec3>, grain: f64) {
    let polygon = Polygon::new(corners.collect());
    if !is_line(polygon.area_vector(), &polygon.vertices, grain) {
        parts.push(polygon);
    }
}

/// Whether a ring goes on to the left, or straight to rounding; back is neither.
fn turns_left(a: DVec3, b: DVec3, c: DVec3, normal: DVec3) -> bool {
    let (u, v) = (b - a, c - b);
    let (turn, straight) = (u.cross(v).dot(normal), 1e-12 * u.length() * v.length());
    turn > straight || (turn >= -straight && u.dot(v) > 0.0)
}

/// Whether a flat ring turns left everywhere, and once in all.
fn is_convex(p: &[DVec3], normal: DVec3) -> bool {
    let n = p.len();
    let mut whole = 0.0;
    for k in 0..n {
        let (a, b, c) = (p[k], p[(k + 1) % n], p[(k + 2) % n]);
        if !turns_left(a, b, c, normal) {
            return false;
        }
        let (u, v) = (b - a, c - b);
        whole += u.cross(v).dot(normal).atan2(u.dot(v));
    }
    // A star of left turns goes round twice.
    (whole - std::f64::consts::TAU).abs() < 1.0
}

/// Triangles of a ring put together over the diagonals that are not needed.
fn merged(p: &[DVec3], normal: DVec3, triangles: Vec<[usize; 3]>) -> Vec<Vec<usize>> {
    let mut piece_of_edge: HashMap<(usize, usize), usize> = HashMap::new();
    for (k, t) in triangles.iter().enumerate() {
        for i in 0..3 {
            piece_of_edge.insert((t[i], t[(i + 1) % 3]), k);
        }
    }
    let mut pieces: Vec<Vec<usize>> = triangles.iter().map(|t| t.to_vec()).collect();
    // Where a piece went that was put to another.
    let mut went: Vec<usize> = (0..pieces.len()).collect();
    let home = |went: &mut Vec<usize>, mut k: usize| {
        while went[k] != k {
            went[k] = went[went[k]];
            k = went[k];
        }
        k
    };
    for (k, t) in triangles.iter().enumerate() {
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            let Some(&other) = piece_of_edge.get(&(b, a)) else {
                continue;
            };
            let (one, other) = (home(&mut went, k), home(&mut went, other));
            if one == other {
                continue;
            }
            // `one` from b round to a, `other` from a round to b.
            let turned = |piece: &[usize], first: usize, last: usize| -> Option<Vec<usize>> {
                let n = piece.len();
                let start = piece.iter().position(|&q| q == first)?;
                (piece[(start + n - 1) % n] == last)
                    .then(|| (0..n).map(|s| piece[(start + s) % n]).collect())
            };
            let (Some(first), Some(second)) =
                (turned(&pieces[one], b, a), turned(&pieces[other], a, b))
            else {
                continue;
            };
            let mut joined = first;
            joined.extend(&second[1..second.len() - 1]);
            let n = joined.len();
            let left = |at: usize| {
                let [x, y, z] = [at + n - 1, at, at + 1].map(|k| p[joined[k % n]]);
                turns_left(x, y, z, normal)
            };
            let at_a = joined.iter().position(|&q| q == a);
            // b stands first.
            if left(0) && at_a.is_some_and(left) {
                pieces[one] = joined;
                pieces[other].clear();
                went[other] = one;
            }
        }
    }
    pieces.retain(|piece| !piece.is_empty());
    pieces
}

/// Takes a convex polygon out of convex pieces in its plane; returns the area that was taken, m².
///
/// `normal`: of the plane, unit. Corners nearer to an edge than `slack` metres lie on it, and
/// what is left of a piece but thinner than that is dropped.
pub(super) fn subtract(
    pieces: &mut Vec<Polygon>,
    cutter: &Polygon,
    normal: DVec3,
    slack: f64,
) -> f64 {
    // Where an edge of the cutter is, and its inward side, counter-clockwise about `normal`.
    let mut ring = cutter.vertices.clone();
    if cutter.area_vector().dot(normal) < 0.0 {
        ring.reverse();
    }
    let edges: Vec<(DVec3, DVec3)> = (0..ring.len())
        .map(|k| (ring[k], ring[(k + 1) % ring.len()] - ring[k]))
        .filter(|(_, along)| along.length() > 0.0)
        .map(|(a, along)| (a, normal.cross(along).normalize_or_zero()))
        .collect();
    let (low, high) = bounds(&ring);
    let mut taken = 0.0;
    let mut kept = Vec::with_capacity(pieces.len());
    for piece in pieces.drain(..) {
        let (own_low, own_high) = bounds(&piece.vertices);
        let apart = (own_low - high)
            .max(low - own_high)
            .cmpgt(DVec3::splat(slack));
        let outside = |&(a, inward): &(DVec3, DVec3)| {
            let within = |q: &DVec3| (*q - a).dot(inward) > slack;
            !piece.vertices.iter().any(within)
        };
        if apart.any() || edges.iter().any(outside) {
            kept.push(piece);
            continue;
        }
        let mut rest = piece;
        for &(a, inward) in &edges {
            let (outer, inner) = split(&rest, a, inward, slack);
            if outer.vertices.len() >= 3 && !is_sliver(&outer, slack) {
                kept.push(outer);
            }
            rest = inner;
            if rest.vertices.len() < 3 {
                break;
            }
        }
        taken += rest.area();
    }
    *pieces = kept;
    taken
}

fn bounds(p: &[DVec3]) -> (DVec3, DVec3) {
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    p.iter()
        .fold(start, |(low, high), q| (low.min(*q), high.max(*q)))
}

fn is_sliver(polygon: &Polygon, slack: f64) -> bool {
    2.0 * polygon.area() <= slack * size_of(&polygon.vertices)
}

/// A convex polygon on both sides of the line through `a`: outside, and on the side of `inward`.
fn split(polygon: &Polygon, a: DVec3, inward: DVec3, slack: f64) -> (Polygon, Polygon) {
    let p = &polygon.vertices;
    let n = p.len();
    let height: Vec<f64> = p
        .iter()
        .map(|q| (*q - a).dot(inward))
        .map(|h| if h.abs() <= slack { 0.0 } else { h })
        .collect();
    let (mut outer, mut inner) = (Vec::new(), Vec::new());
    for k in 0..n {
        let next = (k + 1) % n;
        let (h, g) = (height[k], height[next]);
        if h <= 0.0 {
            outer.push(p[k]);
        }
        if h >= 0.0 {
            inner.push(p[k]);
        }
        if h * g < 0.0 {
            let q = p[k].lerp(p[next], h / (h - g));
            outer.push(q);
            inner.push(q);
        }
    }
    // Only its edge lies there.
    if !height.iter().any(|h| *h < 0.0) {
        outer.clear();
    }
    if !height.iter().any(|h| *h > 0.0) {
        inner.clear();
    }
    (Polygon::new(outer), Polygon::new(inner))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FINE: Tolerance = Tolerance {
        plane_m: 1e-12,
        grain: 1e-12,
    };

    fn ring(xy: &[(f64, f64)]) -> Vec<DVec3> {
        xy.iter().map(|&(x, y)| DVec3::new(x, y, 1.0)).collect()
    }

    fn area(parts: &[Polygon]) -> f64 {
        parts.iter().map(|p| p.area_vector().z).sum()
    }

    fn assert_convex(parts: &[Polygon]) {
        for part in parts {
            assert!(is_convex(&part.vertices, DVec3::Z), "{part:?}");
        }
    }

    #[test]
    fn convex_polygons_stay_whole() {
        let hexagon: Vec<DVec3> = (0..6)
            .map(|k| {
                let a = std::f64::consts::FRAC_PI_3 * k as f64;
                DVec3::new(3.0 + a.cos(), a.sin(), 2.0)
            })
            .collect();
        assert_eq!(convex_parts(&hexagon, FINE).unwrap().parts.len(), 1);
        let quad = ring(&[(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)]);
        let cut = convex_parts(&quad, FINE).unwrap();
        assert_eq!((cut.parts, cut.flat), (vec![Polygon::new(quad)], true));
    }

    #[test]
    fn an_l_becomes_two_parts_and_a_comb_no_more_than_twice_its_teeth() {
        let l = ring(&[(0., 0.), (2., 0.), (2., 1.), (1., 1.), (1., 2.), (0., 2.)]);
        let cut = convex_parts(&l, FINE).unwrap();
        assert_eq!(cut.parts.len(), 2);
        assert_convex(&cut.parts);
        assert!((area(&cut.parts) - 3.0).abs() < 1e-12);
        // Ten teeth of 1 x 2 on a back of 19 x 1: area 10 * 2 + 19 = 39.
        let mut comb = vec![(0.0, 0.0), (19.0, 0.0)];
        for k in (0..10).rev() {
            let x = 2.0 * k as f64;
            comb.extend([(x + 1.0, 3.0), (x, 3.0)]);
            if k > 0 {
                comb.extend([(x, 1.0), (x - 1.0, 1.0)]);
            }
        }
        let cut = convex_parts(&ring(&comb), FINE).unwrap();
        assert_convex(&cut.parts);
        assert!((area(&cut.parts) - 39.0).abs() < 1e-12);
        // 18 hollow corners need at least 9 cuts; [Hertel83]: at most four times the optimum.
        assert!((10..=20).contains(&cut.parts.len()), "{}", cut.parts.len());
    }

    #[test]
    fn what_is_bent_is_cut_into_triangles() {
        let mut quad = ring(&[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]);
        quad[2].z += 1e-3;
        let cut = convex_parts(&quad, FINE).unwrap();
        assert_eq!((cut.parts.len(), cut.flat), (2, false));
        // Less than a millionth of its size is flat.
        quad[2].z = 1.0 + 1e-6;
        assert!(convex_parts(&quad, FINE).unwrap().flat);
        // As is what the file could not say better.
        quad[2].z = 1.0 + 1e-3;
        let coarse = Tolerance {
            plane_m: 1e-3,
            ..FINE
        };
        assert!(convex_parts(&quad, coarse).unwrap().flat);
    }

    #[test]
    fn what_has_no_area_has_no_part() {
        for p in [
            ring(&[(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)]),
            ring(&[(0.0, 0.0), (1.0, 1.0), (0.0, 0.0), (1.0, 1.0)]),
            ring(&[(3.0, 3.0); 5]),
            ring(&[(0.1, 0.1), (0.3, 0.3), (0.7, 0.7)]),
            Vec::new(),
            vec![DVec3::NAN; 4],
        ] {
            assert!(convex_parts(&p, FINE).unwrap().parts.is_empty(), "{p:?}");
        }
    }

    #[test]
    fn an_outline_that_crosses_itself_is_said_and_faces_one_way() {
        // A bow with a large and a small wing.
        let bow = ring(&[(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (1.0, -1.0)]);
        let cut = convex_parts(&bow, FINE).unwrap();
        assert!(cut.crossed);
        assert!(cut.parts.iter().all(|p| p.area_vector().z > 0.0));
    }

    #[test]
    fn an_outline_that_touches_or_retraces_itself_has_the_area_it_encloses() {
        for (what, outline, area_m2, parts) in [
            (
                "a spike from a corner",
                ring(&[(0., 0.), (2., 0.), (2., 2.), (5., 5.), (2., 2.), (0., 2.)]),
                4.0,
                1,
            ),
            (
                "a spike from an edge",
                ring(&[
                    (0., 0.),
                    (1., 0.),
                    (1., -3.),
                    (1., 0.),
                    (2., 0.),
                    (2., 2.),
                    (0., 2.),
                ]),
                4.0,
                1,
            ),
            (
                "an edge retraced within itself",
                ring(&[(0., 0.), (2., 0.), (1., 0.), (2., 0.), (2., 2.), (0., 2.)]),
                4.0,
                1,
            ),
            (
                "two squares at a corner",
                ring(&[
                    (1., 1.),
                    (0., 1.),
                    (0., 0.),
                    (1., 0.),
                    (1., 1.),
                    (2., 1.),
                    (2., 2.),
                    (1., 2.),
                ]),
                2.0,
                2,
            ),
            (
                "a corner on an edge",
                ring(&[(0., 0.), (4., 0.), (4., 1.), (2., 0.), (0., 1.)]),
                2.0,
                2,
            ),
            (
                "a hole on a bridge",
                ring(&[
                    (0., 0.),
                    (4., 0.),
                    (4., 4.),
                    (0., 4.),
                    (0., 0.),
                    (1., 1.),
                    (1., 2.),
                    (2., 2.),
                    (2., 1.),
                    (1., 1.),
                ]),
                15.0,
                0,
            ),
            (
                "gone round twice",
                ring(&[
                    (0., 0.),
                    (1., 0.),
                    (1., 1.),
                    (0., 1.),
                    (0., 0.),
                    (1., 0.),
                    (1., 1.),
                    (0., 1.),
                ]),
                1.0,
                1,
            ),
        ] {
            for turn in 0..outline.len() {
                let mut turned = outline.clone();
                turned.rotate_left(turn);
                let cut = convex_parts(&turned, FINE).unwrap();
                assert_convex(&cut.parts);
                assert!(
                    (area(&cut.parts) - area_m2).abs() < 1e-12,
                    "{what}: {cut:?}"
                );
                assert!(parts == 0 || cut.parts.len() == parts, "{what}: {cut:?}");
                assert_eq!(cut.crossed, what == "gone round twice", "{what}");
            }
        }
    }

    #[test]
    fn halves_that_cancel_are_said_to_cross() {
        let bow = ring(&[(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]);
        let cut = convex_parts(&bow, FINE).unwrap();
        assert!(cut.parts.is_empty() && cut.crossed);
    }

    #[test]
    fn random_outlines_are_cut_into_convex_parts_of_one_facing() {
        use proptest::prelude::*;
        let corners = prop::collection::vec((0u8..7, 0u8..7), 3..24);
        proptest!(|(corners in corners, tilt in 0.0f64..3.0)| {
            let turn = luxel_core::glam::DMat3::from_rotation_x(tilt);
            let outline: Vec<DVec3> = corners
                .iter()
                .map(|&(x, y)| turn * DVec3::new(f64::from(x) / 3.0, f64::from(y) / 3.0, 1.0))
                .collect();
            let cut = convex_parts(&outline, FINE).unwrap();
            let newell = area_vector(&outline);
            let one_facing: f64 = cut.parts.iter().map(|p| p.area_vector().dot(newell)).sum();
            let areas: f64 = cut.parts.iter().map(Polygon::area).sum();
            // What is gone round w times counts |w| times in no sum but Newell's, w being signed.
            prop_assert!((one_facing - areas * newell.length()).abs() < 1e-9);
            prop_assert!(cut.crossed || (areas - newell.length()).abs() < 1e-9, "{:?}", cut);
        });
    }

    #[test]
    fn a_star_that_turns_left_twice_is_not_convex() {
        let star: Vec<DVec3> = (0..5)
            .map(|k| DVec3::from_angle_z(2.0 * k as f64))
            .collect();
        assert!(!is_convex(&star, DVec3::Z));
    }

    trait FromAngle {
        /// On the unit circle, by fifths of a turn.
        fn from_angle_z(fifths: f64) -> DVec3;
    }
    impl FromAngle for DVec3 {
        fn from_angle_z(fifths: f64) -> DVec3 {
            let (s, c) = (fifths * std::f64::consts::TAU / 5.0).sin_cos();
            DVec3::new(c, s, 0.0)
        }
    }

    #[test]
    fn a_window_leaves_four_pieces_and_a_corner_two() {
        let wall = Polygon::new(ring(&[(0., 0.), (4., 0.), (4., 3.), (0., 3.)]));
        let window = Polygon::new(ring(&[(1., 1.), (2., 1.), (2., 2.), (1., 2.)]));
        let mut pieces = vec![wall.clone()];
        assert!((subtract(&mut pieces, &window.flipped(), DVec3::Z, 1e-9) - 1.0).abs() < 1e-12);
        assert_eq!(pieces.len(), 4);
        assert_convex(&pieces);
        assert!((area(&pieces) - 11.0).abs() < 1e-12);
        // A second time nothing is there.
        assert_eq!(subtract(&mut pieces, &window, DVec3::Z, 1e-9), 0.0);
        let door = Polygon::new(ring(&[(0., 0.), (1., 0.), (1., 2.), (0., 2.)]));
        let mut pieces = vec![wall.clone()];
        subtract(&mut pieces, &door, DVec3::Z, 1e-9);
        assert_eq!(pieces.len(), 2);
        let mut pieces = vec![wall.clone()];
        subtract(&mut pieces, &wall, DVec3::Z, 1e-9);
        assert!(pieces.is_empty());
    }
}
