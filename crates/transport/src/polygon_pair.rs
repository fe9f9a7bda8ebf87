//! The form factor between two polygons without occlusion, in closed form.
//!
//! Stokes' theorem turns the double area integral into a double contour integral,
//! `A_1 F_12 = 1/(2 pi) sum_ij (u_i . v_j) integral integral ln r ds dt` over pairs of edges. With arc lengths
//! counted from the feet of the common perpendicular (length h), `r^2 = s^2 + t^2 - 2 c s t + h^2`.
//! Because this is homogeneous in (s, t, h), the divergence theorem leaves an elementary
//! boundary integral and `h^2 integral integral ds dt / r^2`, which `t = h / sqrt(1 - c^2) sinh` turns into
//! the imaginary part of dilogarithms. Each polygon is clipped by the plane of the other first.
//!
//! Parallel lines have an elementary form of their own; nearly parallel ones, where the feet run
//! away, get the elementary inner integral and an adaptive outer one. Where a polygon is small
//! for its distance the contour integral cancels; there Gauss points on the smaller polygon
//! with Lambert's formula are exact to 1e-10 and faster.
//!
//! Source: [Schroeder93]. Differs: their inner integrals are not used; see above.

use crate::dilogarithm::{Complex, dilogarithm};
use crate::lambert::above_horizon;
use crate::quadrature::{adaptive, over_polygon};
use luxel_core::{DVec3, Polygon};
use std::f64::consts::PI;

/// Fraction of the flux leaving the front of `from` that reaches the front of `to`, without
/// occlusion; 0..=1.
///
/// Coplanar polygons and polygons that see only each other's backs give exactly 0. Relative
/// accuracy 1e-9 or better, also for shared edges. Convex polygons only.
pub fn polygon_to_polygon(from: &Polygon, to: &Polygon) -> f64 {
    exchange_area(from, to, 1e-10) / from.area().max(f64::MIN_POSITIVE)
}

/// `A_from F(from -> to)`, m², without occlusion, to about `relative` accuracy; symmetric in its
/// arguments up to that. A loose request (1e-3) is several times cheaper for distant pairs.
pub fn exchange_area(from: &Polygon, to: &Polygon, relative: f64) -> f64 {
    match facing_parts(from, to) {
        Some((a, b)) => exchange_of_facing(&a, &b, relative),
        None => 0.0,
    }
}

/// The parts of two polygons that lie in front of each other; `None` if there is nothing.
pub(crate) fn facing_parts(a: &Polygon, b: &Polygon) -> Option<(Polygon, Polygon)> {
    if a.vertices.len() < 3 || b.vertices.len() < 3 {
        return None;
    }
    let b_part = in_front_of(b, a)?;
    let a_part = in_front_of(a, b)?;
    Some((a_part, b_part))
}

/// What of `polygon` lies in front of the plane of `other`.
fn in_front_of(polygon: &Polygon, other: &Polygon) -> Option<Polygon> {
    let normal = other.normal();
    let origin = other.vertices[0];
    let scale = polygon
        .vertices
        .iter()
        .map(|v| (*v - origin).length())
        .fold(0.0, f64::max);
    // What rounding leaves of a shared corner counts as in the plane.
    let snap = 1e-12 * scale;
    let height = |v: DVec3| {
        let h = (v - origin).dot(normal);
        if h.abs() <= snap { 0.0 } else { h }
    };
    let heights: Vec<f64> = polygon.vertices.iter().map(|&v| height(v)).collect();
    if heights.iter().all(|&h| h <= 0.0) {
        return None;
    }
    if heights.iter().all(|&h| h >= 0.0) {
        return Some(polygon.clone());
    }
    let n = heights.len();
    let mut kept = Vec::with_capacity(n + 1);
    for i in 0..n {
        let j = (i + 1) % n;
        let (p, q) = (polygon.vertices[i], polygon.vertices[j]);
        if heights[i] >= 0.0 {
            kept.push(p);
        }
        if heights[i] * heights[j] < 0.0 {
            kept.push(p + (q - p) * (heights[i] / (heights[i] - heights[j])));
        }
    }
    (kept.len() >= 3).then(|| Polygon::new(kept))
}

/// Centre and the radius of a ball around it that holds the polygon.
pub(crate) fn ball(p: &Polygon) -> (DVec3, f64) {
    let centre = p.centre();
    (
        centre,
        p.vertices
            .iter()
            .map(|v| (*v - centre).length_squared())
            .fold(0.0, f64::max)
            .sqrt(),
    )
}

/// Both polygons lie wholly in front of each other.
fn exchange_of_facing(a: &Polygon, b: &Polygon, relative: f64) -> f64 {
    let ((ca, ra), (cb, rb)) = (ball(a), ball(b));
    let (small, large, radius) = if ra <= rb { (a, b, ra) } else { (b, a, rb) };
    let apart = distance_to(large, if ra <= rb { ca } else { cb });
    // Nodes so that the Gauss error (radius / 2 apart)^2n stays below the request.
    let ratio = radius / (2.0 * apart);
    if ratio < 0.2 {
        let order = (relative.ln() / (2.0 * ratio.max(1e-9).ln()))
            .ceil()
            .max(1.0) as usize;
        let order = order + usize::from(small.vertices.len() == 3);
        if order <= 12 {
            let normal = small.normal();
            let mut sum = 0.0;
            over_polygon(small, order, |p, w| {
                sum += w * above_horizon(p, normal, &large.vertices)
            });
            return sum;
        }
    }
    contour(a, b).max(0.0)
}

/// Distance from a point to a polygon, from below: to its ball's surface or its plane and edges.
fn distance_to(polygon: &Polygon, point: DVec3) -> f64 {
    let v = &polygon.vertices;
    let normal = polygon.normal();
    let height = (point - v[0]).dot(normal);
    let n = v.len();
    let mut outside = false;
    let mut nearest = f64::INFINITY;
    for i in 0..n {
        let (p, q) = (v[i], v[(i + 1) % n]);
        let along = q - p;
        let rel = point - p;
        outside |= along.cross(rel).dot(normal) < 0.0;
        let t = (rel.dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        nearest = nearest.min((rel - along * t).length());
    }
    if outside { nearest } else { height.abs() }
}

/// The double contour integral, `1/(2 pi) sum sum u.v integral integral ln r`, m².
fn contour(a: &Polygon, b: &Polygon) -> f64 {
    // Lengths in units of the distance of the centres keep ln r small, so that what cancels
    // around the closed contours is small to begin with.
    let origin = a.centre();
    let unit = (b.centre() - origin).length().max(f64::MIN_POSITIVE);
    let local =
        |p: &Polygon| -> Vec<DVec3> { p.vertices.iter().map(|v| (*v - origin) / unit).collect() };
    let (va, vb) = (local(a), local(b));
    let mut sum = 0.0;
    for i in 0..va.len() {
        let (p, p1) = (va[i], va[(i + 1) % va.len()]);
        let length_a = (p1 - p).length();
        if length_a == 0.0 {
            continue;
        }
        for j in 0..vb.len() {
            let (q, q1) = (vb[j], vb[(j + 1) % vb.len()]);
            let length_b = (q1 - q).length();
            if length_b == 0.0 {
                continue;
            }
            let (u, v) = ((p1 - p) / length_a, (q1 - q) / length_b);
            let cosine = u.dot(v);
            // Rounding of a right angle; its term is as small.
            if cosine.abs() > 1e-15 {
                sum += cosine * log_integral(p, u, length_a, q, v, length_b);
            }
        }
    }
    sum * unit * unit / (2.0 * PI)
}

/// Integral of ln |p + s u - q - t v| over s in 0..a, t in 0..b (u, v unit).
fn log_integral(p: DVec3, u: DVec3, a: f64, q: DVec3, v: DVec3, b: f64) -> f64 {
    let c = u.dot(v);
    let cross = u.cross(v);
    let sine = cross.length();
    let d = p - q;
    if sine < 1e-11 {
        return parallel(d, u, a, b, c.signum());
    }
    if sine < 0.05 {
        return nearly_parallel(p, u, a, q, v, b);
    }
    // Feet of the common perpendicular: arc lengths s, t from there.
    let s0 = (c * d.dot(v) - d.dot(u)) / (sine * sine);
    let t0 = (d.dot(v) - c * d.dot(u)) / (sine * sine);
    // p + s0 u and q + t0 v are the feet; count s and t from them.
    let (s, t) = ([-s0, a - s0], [-t0, b - t0]);
    let h = d.dot(cross).abs() / sine;
    let side = |s: f64, t: f64| {
        // Integral in s up to s, at fixed t, of ln r.
        let w = (sine * sine * t * t + h * h).sqrt();
        log_along(s - c * t, w)
    };
    let other = |s: f64, t: f64| {
        let w = (sine * sine * s * s + h * h).sqrt();
        log_along(t - c * s, w)
    };
    let boundary = t[1] * (side(s[1], t[1]) - side(s[0], t[1]))
        - t[0] * (side(s[1], t[0]) - side(s[0], t[0]))
        + s[1] * (other(s[1], t[1]) - other(s[1], t[0]))
        - s[0] * (other(s[0], t[1]) - other(s[0], t[0]));
    0.5 * (boundary - a * b + skew(s, t, h, c, sine))
}

/// Antiderivative of ln sqrt(x^2 + w^2).
fn log_along(x: f64, w: f64) -> f64 {
    let square = x * x + w * w;
    if square == 0.0 {
        return 0.0;
    }
    0.5 * x * square.ln() - x + if w > 0.0 { w * (x / w).atan() } else { 0.0 }
}

/// `h^2` times the integral of 1/r^2 over the rectangle.
fn skew(s: [f64; 2], t: [f64; 2], h: f64, c: f64, sine: f64) -> f64 {
    // Below this h^2 ln^2 h is lost in rounding.
    if h < 1e-10 {
        return 0.0;
    }
    // Roots of z^2 h (1 - i c/sine) + 2 i s z + h (1 + i c/sine).
    let lead = Complex::new(h, -h * c / sine);
    let last = Complex::new(h, h * c / sine);
    let z = t.map(|t| (sine * t / h).asinh().exp());
    let mut sum = 0.0;
    for (k, s) in s.into_iter().enumerate() {
        // z = (-i s +- sqrt(-s^2 - lead last)) / lead, and lead last is real: h^2 / sine^2.
        let root = (s * s + h * h / (sine * sine)).sqrt();
        // Larger root without cancellation, the other by the product last / lead.
        let big = Complex::new(0.0, if s >= 0.0 { -(s + root) } else { root - s });
        let z1 = big.times(lead.inverse());
        let z2 = last.times(big.inverse());
        let sign = if k == 1 { 1.0 } else { -1.0 };
        for zk in [z1, z2] {
            let inverse = zk.inverse();
            let upper = dilogarithm(inverse.scaled(z[1])).im;
            let lower = dilogarithm(inverse.scaled(z[0])).im;
            sum -= sign * (upper - lower);
        }
    }
    h * h / sine * sum
}

/// Lines in the same direction (`sign` 1) or the opposite one.
fn parallel(d: DVec3, u: DVec3, a: f64, b: f64, sign: f64) -> f64 {
    // s along u from p; the other edge covers d.u offsets t from -d.u, in direction sign.
    let offset = -d.dot(u);
    let h = (d - u * d.dot(u)).length();
    let (t0, t1) = if sign > 0.0 {
        (offset, offset + b)
    } else {
        (offset - b, offset)
    };
    // Second antiderivative of ln sqrt(x^2 + h^2).
    let twice = |x: f64| {
        let square = x * x + h * h;
        if square == 0.0 {
            return 0.0;
        }
        let angle = if h > 0.0 { h * x * (x / h).atan() } else { 0.0 };
        0.25 * (x * x - h * h) * square.ln() - 0.75 * x * x + angle
    };
    twice(a - t0) - twice(a - t1) - twice(-t0) + twice(-t1)
}

/// Elementary along u, adaptive along v.
fn nearly_parallel(p: DVec3, u: DVec3, a: f64, q: DVec3, v: DVec3, b: f64) -> f64 {
    let inner = |t: f64| {
        let rel = q + v * t - p;
        let x = rel.dot(u);
        let w = (rel - u * x).length();
        log_along(a - x, w) - log_along(-x, w)
    };
    // The inner integral has kinks where the edges come near; bisect there.
    let mut cuts = vec![0.0, b];
    for end in [p, p + u * a] {
        let t = (end - q).dot(v);
        if t > 0.0 && t < b {
            cuts.push(t);
        }
    }
    cuts.sort_by(f64::total_cmp);
    cuts.windows(2)
        .filter(|w| w[1] > w[0])
        .map(|w| adaptive(w[0], w[1], 1e-13 * b, &mut { inner }))
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn quad(points: [(f64, f64, f64); 4]) -> Polygon {
        Polygon::new(points.map(|(x, y, z)| DVec3::new(x, y, z)).to_vec())
    }

    #[test]
    fn reference_cases() {
        // 1e-6 relative as the file asks of analytic methods, plus its uncertainty.
        let Some(cases) = testing::cases("form_factors.json") else {
            return;
        };
        let (mut worst, mut count) = ((0.0_f64, String::new()), 0);
        for case in &cases {
            if case["scene"]["surfaces"]
                .as_array()
                .is_some_and(|s| s.len() != 2)
            {
                continue;
            }
            for query in case["queries"].as_array().expect("queries") {
                let (from, to) = (
                    testing::surface(case, &query["from"]),
                    testing::surface(case, &query["to"]),
                );
                if !testing::is_polygon(from) || !testing::is_polygon(to) {
                    continue;
                }
                let (from, to) = (testing::polygon(from), testing::polygon(to));
                let got = polygon_to_polygon(&from, &to);
                let (want, unc) = testing::expected(query);
                let relative = (got - want).abs() / want.abs();
                assert!(
                    (got - want).abs() <= 1e-6 * want.abs() + unc,
                    "{} {}: {got} for {want}",
                    case["id"],
                    query["id"]
                );
                if relative > worst.0 {
                    worst = (relative, case["id"].to_string());
                }
                count += 1;
            }
        }
        eprintln!(
            "{count} polygon factors, worst relative error {:.1e} in {}",
            worst.0, worst.1
        );
        assert!(count >= 60, "{count}");
    }

    #[test]
    fn closed_form_equals_quadrature_of_the_point_form() {
        // Skew triangles; 32 x 32 Gauss points of Lambert's formula are exact to rounding here.
        let a = Polygon::new(vec![
            DVec3::new(0.1, 0.0, 0.0),
            DVec3::new(1.0, 0.2, 0.1),
            DVec3::new(0.3, 0.9, -0.1),
        ]);
        let b = Polygon::new(vec![
            DVec3::new(0.0, 0.1, 1.5),
            DVec3::new(0.2, 1.3, 1.2),
            DVec3::new(1.1, 0.4, 1.4),
        ]);
        let (fa, fb) = facing_parts(&a, &b).expect("they face each other");
        let normal = fa.normal();
        let mut want = 0.0;
        over_polygon(&fa, 32, |p, w| {
            want += w * above_horizon(p, normal, &fb.vertices)
        });
        let got = contour(&fa, &fb);
        assert!((got - want).abs() < 1e-12 * want, "{got} for {want}");
        assert!((contour(&fb, &fa) - got).abs() < 1e-13 * got, "symmetric");
    }

    #[test]
    fn skew_edges_agree_with_the_adaptive_integral() {
        // The dilogarithm form against numerical integration of the elementary inner one.
        let p = DVec3::new(0.2, -0.4, 0.1);
        for (q, v) in [
            (DVec3::new(0.5, 0.3, 0.8), DVec3::new(0.3, 0.8, 0.2)),
            (DVec3::new(-0.5, 0.3, 0.02), DVec3::new(-0.9, 0.4, -0.1)),
            (DVec3::new(0.2, -0.4, 0.1), DVec3::new(0.5, 0.1, 0.9)),
            (DVec3::new(0.5, -0.9, 1e-7), DVec3::new(0.0, 1.0, 0.0)),
        ] {
            let u = DVec3::new(1.0, 0.1, 0.0).normalize();
            let v = v.normalize();
            let got = log_integral(p, u, 1.2, q, v, 0.9);
            let want = nearly_parallel(p, u, 1.2, q, v, 0.9);
            assert!((got - want).abs() < 1e-12, "{got} for {want}");
        }
    }

    #[test]
    fn back_faces_and_one_plane_give_exactly_zero() {
        let floor = quad([(0., 0., 0.), (1., 0., 0.), (1., 1., 0.), (0., 1., 0.)]);
        let beside = quad([(1., 0., 0.), (2., 0., 0.), (2., 1., 0.), (1., 1., 0.)]);
        let above = quad([(0., 0., 1.), (1., 0., 1.), (1., 1., 1.), (0., 1., 1.)]);
        assert_eq!(polygon_to_polygon(&floor, &beside), 0.0);
        assert_eq!(polygon_to_polygon(&floor, &above), 0.0, "it faces up");
        assert!(polygon_to_polygon(&floor, &above.flipped()) > 0.19);
    }

    #[test]
    fn a_cut_polygon_counts_only_what_is_in_front() {
        // A wall that reaches as far below the floor as above gives half of what its upper half
        // gives by itself, from the wall; from the floor it gives the same.
        let floor = quad([(0., 0., 0.), (1., 0., 0.), (1., 1., 0.), (0., 1., 0.)]);
        let tall = quad([(0., 0., -1.), (0., 1., -1.), (0., 1., 1.), (0., 0., 1.)]);
        let upper = quad([(0., 0., 0.), (0., 1., 0.), (0., 1., 1.), (0., 0., 1.)]);
        let want = polygon_to_polygon(&floor, &upper);
        assert!((polygon_to_polygon(&floor, &tall) - want).abs() < 1e-12);
        assert!((polygon_to_polygon(&tall, &floor) - 0.5 * want).abs() < 1e-12);
    }

    #[test]
    fn rows_of_closed_boxes_sum_to_one() {
        // Closure of the cube and of flat and long boxes: 1e-10.
        for (x, y, z) in [
            (1.0, 1.0, 1.0),
            (10.0, 10.0, 0.01),
            (100.0, 0.5, 0.5),
            (1e-3, 2e-3, 1e-3),
        ] {
            let v = |i: f64, j: f64, k: f64| (i * x, j * y, k * z);
            let faces = [
                quad([v(0., 0., 0.), v(1., 0., 0.), v(1., 1., 0.), v(0., 1., 0.)]),
                quad([v(0., 0., 1.), v(0., 1., 1.), v(1., 1., 1.), v(1., 0., 1.)]),
                quad([v(0., 0., 0.), v(0., 1., 0.), v(0., 1., 1.), v(0., 0., 1.)]),
                quad([v(1., 0., 0.), v(1., 0., 1.), v(1., 1., 1.), v(1., 1., 0.)]),
                quad([v(0., 0., 0.), v(0., 0., 1.), v(1., 0., 1.), v(1., 0., 0.)]),
                quad([v(0., 1., 0.), v(1., 1., 0.), v(1., 1., 1.), v(0., 1., 1.)]),
            ];
            for from in &faces {
                let sum: f64 = faces.iter().map(|to| polygon_to_polygon(from, to)).sum();
                assert!((sum - 1.0).abs() < 1e-10, "{sum} in {x} x {y} x {z}");
            }
        }
    }

    #[test]
    fn distant_and_tiny_tend_to_the_kernel() {
        // F -> A_2 cos cos / (pi r^2) as size over distance shrinks: error of order its square.
        for distance in [1e2, 1e4, 1e6] {
            let a = quad([(0., 0., 0.), (1., 0., 0.), (1., 1., 0.), (0., 1., 0.)]);
            let d = distance;
            let b = quad([(0., 0., d), (0., 1., d), (1., 1., d), (1., 0., d)]);
            let kernel = 1.0 / (PI * d * d);
            assert!((polygon_to_polygon(&a, &b) / kernel - 1.0).abs() < 3.0 / (d * d) + 1e-10);
        }
    }
}
