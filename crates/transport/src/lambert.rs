//! Configuration factors: from a point of a surface to a polygon, a disc or a sphere.
//!
//! The factor is a contour integral over the boundary seen from the point (Lambert's formula):
//! each edge adds the angle it spans times the cosine between the receiver's normal and the
//! normal of the plane through edge and point. What is below the horizon is cut away first.
//!
//! Sources: [Lambert1760]; polygon in the form of [Baum89]; disc [Naraghi88] and [Howell10]
//! B-12..B-14; sphere cut by the horizon [Snyder96] as printed in [Lagarde14], appendix.

use luxel_core::{DVec3, Polygon};
use std::f64::consts::PI;

/// Share of a cosine-weighted hemisphere at `point` around the unit `normal` that the front of
/// `polygon` fills, without occlusion; 0..=1.
///
/// Zero from behind the polygon and in its plane. Exact up to rounding, which grows with
/// distance over size: 1e-12 relative at a ratio of 1000.
pub fn point_to_polygon(point: DVec3, normal: DVec3, polygon: &Polygon) -> f64 {
    let v = &polygon.vertices;
    if v.len() < 3 || polygon.area_vector().dot(point - v[0]) <= 0.0 {
        return 0.0;
    }
    above_horizon(point, normal, v)
}

/// The factor without the test of sides: `vertices` counter-clockwise as seen from `point`.
pub(crate) fn above_horizon(point: DVec3, normal: DVec3, vertices: &[DVec3]) -> f64 {
    let mut sum = 0.0;
    let n = vertices.len();
    // Walk the clipped outline without storing it: the edge that the horizon adds lies in the
    // receiver's plane, and its plane through the point is the receiver's own.
    let (mut left, mut entered) = (None, None);
    let mut a = vertices[n - 1] - point;
    let mut za = a.dot(normal);
    for &vertex in vertices {
        let b = vertex - point;
        let zb = b.dot(normal);
        if za >= 0.0 && zb >= 0.0 {
            sum += edge(a, b - a, normal);
        } else if za >= 0.0 || zb >= 0.0 {
            let cut = a + (b - a) * (za / (za - zb));
            if za >= 0.0 {
                sum += edge(a, cut - a, normal);
                left = Some(cut);
            } else {
                sum += edge(cut, b - cut, normal);
                entered = Some(cut);
            }
        }
        (a, za) = (b, zb);
    }
    if let (Some(from), Some(to)) = (left, entered) {
        sum += edge(from, to - from, normal);
    }
    (sum / (2.0 * PI)).clamp(0.0, 1.0)
}

/// Angle of the edge from `a` to `a + along`, seen from the origin, times the cosine between
/// `normal` and the normal of its plane.
#[inline]
fn edge(a: DVec3, along: DVec3, normal: DVec3) -> f64 {
    // b x a = along x a, without the cancellation of two long vectors; it points up for edges
    // that run clockwise around the line of sight, as those of a front that faces us do.
    let cross = along.cross(a);
    let sine = cross.length();
    if sine == 0.0 {
        return 0.0;
    }
    let cosine = a.dot(a + along);
    sine.atan2(cosine) * cross.dot(normal) / sine
}

/// Configuration factor from `point` with unit `normal` to the front of a disc, without
/// occlusion; 0..=1. Zero from behind.
///
/// Closed form where the whole disc is above the horizon (1e-14); otherwise the arc is
/// integrated numerically (1e-12 absolute).
///
/// Source: [Naraghi88].
pub fn point_to_disc(
    point: DVec3,
    normal: DVec3,
    centre: DVec3,
    disc_normal: DVec3,
    radius: f64,
) -> f64 {
    let away = point - centre;
    let height = away.dot(disc_normal);
    if height <= 0.0 || radius <= 0.0 {
        return 0.0;
    }
    let lateral = away - disc_normal * height;
    let offset = lateral.length();
    // Heights of disc points above the horizon: middle plus a cosine wave.
    let middle = (centre - point).dot(normal);
    let in_plane = normal - disc_normal * normal.dot(disc_normal);
    let swing = radius * in_plane.length();
    if middle + swing <= 0.0 {
        return 0.0;
    }
    if middle - swing >= 0.0 {
        let (h, a, r) = (height, offset, radius);
        let z = (h * h + a * a + r * r).powi(2) - 4.0 * a * a * r * r;
        let root = z.max(0.0).sqrt();
        // Factors of a receiver that faces the disc's plane, and of one that faces its axis.
        let along = 0.5 * (1.0 - (a * a + h * h - r * r) / root);
        let across = if a > 0.0 {
            h / (2.0 * a) * ((h * h + a * a + r * r) / root - 1.0)
        } else {
            0.0
        };
        let towards = if a > 0.0 { -lateral / a } else { DVec3::ZERO };
        return (-disc_normal.dot(normal) * along + towards.dot(normal) * across).clamp(0.0, 1.0);
    }
    // Cut by the horizon: the arc above it, then the chord in the horizon.
    let u = in_plane / in_plane.length();
    let v = disc_normal.cross(u);
    let half = (-middle / swing).clamp(-1.0, 1.0).acos();
    let at = |phi: f64| centre - point + (u * phi.cos() + v * phi.sin()) * radius;
    let mut arc = |phi: f64| {
        let p = at(phi);
        let tangent = (v * phi.cos() - u * phi.sin()) * radius;
        tangent.cross(p).dot(normal) / p.length_squared()
    };
    let mut sum = crate::quadrature::adaptive(-half, half, 1e-12, &mut arc);
    let (start, end) = (at(half), at(-half));
    sum += edge(start, end - start, normal);
    (sum / (2.0 * PI)).clamp(0.0, 1.0)
}

/// Configuration factor from `point` with unit `normal` to the outside of a sphere, without
/// occlusion; 0..=1. Exact, also where the horizon cuts the sphere. 1 from inside or on it.
///
/// Source: [Snyder96].
pub fn point_to_sphere(point: DVec3, normal: DVec3, centre: DVec3, radius: f64) -> f64 {
    let towards = centre - point;
    let distance = towards.length();
    if distance <= radius {
        return 1.0;
    }
    let cosine = (towards.dot(normal) / distance).clamp(-1.0, 1.0);
    let share = (radius / distance).powi(2);
    // Height of the lowest and highest tangent ray in terms of the sphere's half angle.
    let sin_half = radius / distance;
    if cosine >= sin_half {
        return share * cosine;
    }
    if cosine <= -sin_half {
        return 0.0;
    }
    let sine = (1.0 - cosine * cosine).sqrt();
    let x = (1.0 / share - 1.0).sqrt();
    let y = (-x * cosine / sine).clamp(-1.0, 1.0);
    let root = (1.0 - y * y).sqrt();
    (share / PI * (cosine * y.acos() - x * sine * root) + (sine * root / x).atan() / PI)
        .clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Sequence;
    use crate::testing;

    fn square(low: f64, high: f64, z: f64) -> Polygon {
        // Facing down.
        let at = |x, y| DVec3::new(x, y, z);
        Polygon::new(vec![
            at(low, low),
            at(low, high),
            at(high, high),
            at(high, low),
        ])
    }

    #[test]
    fn reference_cases() {
        // Tolerance: 1e-6 relative as the file asks of analytic methods, plus its uncertainty.
        let Some(cases) = testing::cases("point_factors.json") else {
            return;
        };
        let (mut worst, mut count, mut other) = (0.0_f64, 0, Vec::new());
        for case in &cases {
            for query in case["queries"].as_array().expect("queries") {
                let to = testing::surface(case, &query["to"]);
                let (p, n) = (
                    testing::vector(&query["point"]),
                    testing::vector(&query["normal"]),
                );
                let got = match to["shape"].as_str() {
                    Some("polygon") => point_to_polygon(p, n, &testing::polygon(to)),
                    Some("disc") => {
                        let radius = to["radius"].as_f64().expect("radius");
                        point_to_disc(
                            p,
                            n,
                            testing::vector(&to["center"]),
                            testing::vector(&to["normal"]),
                            radius,
                        )
                    }
                    Some("sphere") => point_to_sphere(
                        p,
                        n,
                        testing::vector(&to["center"]),
                        to["radius"].as_f64().expect("radius"),
                    ),
                    shape => {
                        other.push(format!("{shape:?}"));
                        continue;
                    }
                };
                let (want, unc) = testing::expected(query);
                assert!(
                    (got - want).abs() <= 1e-6 * want.abs() + unc,
                    "{} {}: {got} for {want}",
                    case["id"],
                    query["id"]
                );
                worst = worst.max((got - want).abs() / want.abs().max(1e-300));
                count += 1;
            }
        }
        eprintln!(
            "{count} point factors, worst relative error {worst:.1e}; other shapes: {other:?}"
        );
        assert!(count > 0);
    }

    #[test]
    fn contact_edge_down_to_a_tenth_of_a_millimetre() {
        // Wall of width w, height h on the floor, point at distance d on the axis of its edge
        // [Howell10] B-5: F = (1/pi) (atan(1/Y) - Y / sqrt(X^2 + Y^2) atan(1 / sqrt(X^2 + Y^2)))
        // for one half, X = h / (w/2), Y = d / (w/2). Rounding only.
        let (half, h) = (1.0, 2.5);
        let wall = Polygon::new(
            [(-half, h), (half, h), (half, 0.0), (-half, 0.0)]
                .map(|(x, z)| DVec3::new(x, 0.0, z))
                .to_vec(),
        );
        for d in [1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9] {
            let root = ((h * h + d * d) / (half * half)).sqrt();
            let y = d / half;
            let want = ((1.0 / y).atan() - y / root * (1.0 / root).atan()) / PI;
            let got = point_to_polygon(DVec3::new(0.0, d, 0.0), DVec3::Z, &wall);
            assert!((got - want).abs() < 1e-12, "at {d} m: {got} for {want}");
        }
    }

    #[test]
    fn behind_and_in_the_plane_is_exactly_zero() {
        let s = square(-1.0, 1.0, 1.0);
        assert_eq!(
            point_to_polygon(DVec3::new(0.0, 0.0, 2.0), -DVec3::Z, &s),
            0.0
        );
        assert_eq!(
            point_to_polygon(DVec3::new(3.0, 0.0, 1.0), -DVec3::X, &s),
            0.0
        );
        assert_eq!(
            point_to_polygon(DVec3::ZERO, -DVec3::Z, &s),
            0.0,
            "below the horizon"
        );
    }

    #[test]
    fn horizon_cuts_disc_and_sphere_as_a_many_sided_polygon_says() {
        // 2000-gon of the same area as the disc: relative error of order (pi / 2000)^2 = 2e-6.
        let n = 2000;
        let around = |normal: DVec3, centre: DVec3, radius: f64| {
            let u = normal.any_orthonormal_vector();
            let v = normal.cross(u);
            let step = 2.0 * PI / n as f64;
            let r = radius * (step / step.sin()).sqrt();
            let at =
                |k: usize| centre + (u * (k as f64 * step).cos() + v * (k as f64 * step).sin()) * r;
            Polygon::new((0..n).map(at).collect())
        };
        let s = Sequence::new(1, 1);
        for k in 0..40 {
            let [a, b, c, d] = s.point4(k).map(|x| 2.0 * x as f64 - 1.0);
            let disc_normal = DVec3::new(a, b, -1.2).normalize();
            let normal = DVec3::new(1.5 * c, 1.5 * d, 0.3).normalize();
            let centre = DVec3::new(d, a, 1.5);
            let want = point_to_polygon(DVec3::ZERO, normal, &around(disc_normal, centre, 1.0));
            let got = point_to_disc(DVec3::ZERO, normal, centre, disc_normal, 1.0);
            assert!((got - want).abs() < 3e-6, "{k}: {got} for {want}");
            // A sphere looks like the disc of its contour circle.
            let distance = centre.length();
            let (axis, radius) = (centre / distance, 0.8);
            let towards = centre - axis * (radius * radius / distance);
            let rim = radius * (1.0 - (radius / distance).powi(2)).sqrt();
            let want = point_to_disc(DVec3::ZERO, normal, towards, -axis, rim);
            let got = point_to_sphere(DVec3::ZERO, normal, centre, radius);
            assert!((got - want).abs() < 1e-11, "{k}: sphere {got} for {want}");
        }
    }
}
