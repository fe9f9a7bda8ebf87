//! Factors between discs, spheres and cylinders that have a closed form.
//!
//! Each states its place in the catalogue [Howell10]. Lengths in metres, results 0..=1, exact
//! up to rounding unless said otherwise. Senders and receivers see each other freely, except
//! that concentric cylinders hide parts of themselves, which the forms contain.

use luxel_core::{DVec3, Polygon};
use std::f64::consts::PI;

/// Between two discs on one axis, facing each other. [Howell10] C-41.
pub fn coaxial_discs(from_radius: f64, to_radius: f64, distance: f64) -> f64 {
    let (r1, r2) = (from_radius / distance, to_radius / distance);
    let x = 1.0 + (1.0 + r2 * r2) / (r1 * r1);
    let ratio = (r2 / r1).powi(2);
    // The smaller root of a quadratic, without the difference of near equals.
    2.0 * ratio / (x + (x * x - 4.0 * ratio).max(0.0).sqrt())
}

/// From an end disc of a right circular cylinder to the inside of its side. C-41 and closure.
pub fn cylinder_end_to_side(radius: f64, length: f64) -> f64 {
    1.0 - coaxial_discs(radius, radius, length)
}

/// From the inside of the side of a right circular cylinder to one end disc. C-79.
pub fn cylinder_side_to_end(radius: f64, length: f64) -> f64 {
    cylinder_end_to_side(radius, length) * radius / (2.0 * length)
}

/// From the inside of the side of a right circular cylinder to itself. C-78.
pub fn cylinder_side_to_side(radius: f64, length: f64) -> f64 {
    1.0 - 2.0 * cylinder_side_to_end(radius, length)
}

/// From the outer of two concentric cylinders of the same length to the inner. C-91.
pub fn outer_to_inner_cylinder(inner_radius: f64, outer_radius: f64, length: f64) -> f64 {
    let (r, h) = (outer_radius / inner_radius, length / inner_radius);
    let a = r * r + h * h - 1.0;
    let b = h * h - r * r + 1.0;
    let root = ((a + 2.0).powi(2) - 4.0 * r * r).max(0.0).sqrt();
    let bracket =
        root * (b / (r * a)).clamp(-1.0, 1.0).acos() + b * (1.0 / r).asin() - 0.5 * PI * a;
    (1.0 - ((b / a).clamp(-1.0, 1.0).acos() - bracket / (2.0 * h)) / PI) / r
}

/// From the inner of two concentric cylinders of the same length to the outer. Reciprocity.
pub fn inner_to_outer_cylinder(inner_radius: f64, outer_radius: f64, length: f64) -> f64 {
    outer_to_inner_cylinder(inner_radius, outer_radius, length) * outer_radius / inner_radius
}

/// From the outer of two concentric cylinders of the same length to itself, past the inner.
/// C-92.
pub fn outer_to_outer_cylinder(inner_radius: f64, outer_radius: f64, length: f64) -> f64 {
    let (r, h) = (outer_radius / inner_radius, length / inner_radius);
    let (r2, h2) = (r * r, h * h);
    let long = (4.0 * r2 + h2).sqrt() / h;
    let top = 4.0 * (r2 - 1.0) + h2 / r2 * (r2 - 2.0);
    let first = (top / (h2 + 4.0 * (r2 - 1.0))).clamp(-1.0, 1.0).asin();
    let second = ((r2 - 2.0) / r2).asin();
    1.0 - 1.0 / r + 2.0 / (PI * r) * (2.0 * (r2 - 1.0).sqrt() / h).atan()
        - h / (2.0 * PI * r) * (long * first - second + 0.5 * PI * (long - 1.0))
}

/// From a sphere to a disc on an axis through its centre, facing it. C-127. The share of the
/// sphere of directions that the disc fills: the sphere's radius does not matter while the
/// disc's plane does not cut it.
pub fn sphere_to_disc(disc_radius: f64, distance: f64) -> f64 {
    let r = disc_radius / distance;
    let root = (1.0 + r * r).sqrt();
    // 1 - 1/root without cancellation.
    0.5 * r * r / (root * (root + 1.0))
}

/// From a sphere around `centre` to the front of a polygon whose plane does not cut the sphere:
/// the solid angle over 4 pi. C-130 for a rectangle.
pub fn sphere_to_polygon(centre: DVec3, polygon: &Polygon) -> f64 {
    solid_angle(centre, polygon) / (4.0 * PI)
}

/// From the outside of a sphere to a larger concentric one is 1; this is the way back. C-139.
pub fn outer_to_inner_sphere(inner_radius: f64, outer_radius: f64) -> f64 {
    (inner_radius / outer_radius).powi(2)
}

/// From any part of the inside of a sphere to a zone of it between two parallel planes `height`
/// apart, the zone's share of the sphere. [Jacquez55].
pub fn inside_sphere_to_zone(radius: f64, height: f64) -> f64 {
    height / (2.0 * radius)
}

/// Solid angle of the front of a convex polygon seen from `point`, sr; zero from behind.
///
/// Source: [Oosterom83], triangle by triangle.
pub fn solid_angle(point: DVec3, polygon: &Polygon) -> f64 {
    let v = &polygon.vertices;
    if v.len() < 3 || polygon.area_vector().dot(point - v[0]) <= 0.0 {
        return 0.0;
    }
    let a = v[0] - point;
    let la = a.length();
    let mut sum = 0.0;
    for k in 1..v.len() - 1 {
        let (b, c) = (v[k] - point, v[k + 1] - point);
        let (lb, lc) = (b.length(), c.length());
        // Edges from the first corner keep the volume accurate for small, far triangles.
        let volume = a.dot((b - a).cross(c - a));
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        sum += 2.0 * volume.abs().atan2(below);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use serde_json::Value;

    /// The closed form for a query, if this file has one.
    fn closed_form(case: &Value, from: &Value, to: &Value) -> Option<f64> {
        let number = |v: &Value| v.as_f64().expect("a number");
        let radius = |s: &Value| number(&s["radius"]);
        let height = |s: &Value| testing::vector(&s["axis"]).length();
        let between = |a: &Value, b: &Value| {
            (testing::vector(&a["center"]) - testing::vector(&b["center"])).length()
        };
        Some(match (from["shape"].as_str()?, to["shape"].as_str()?) {
            ("disc", "disc") => coaxial_discs(radius(from), radius(to), between(from, to)),
            ("disc", "cylinder") => cylinder_end_to_side(radius(to), height(to)),
            ("cylinder", "disc") => cylinder_side_to_end(radius(from), height(from)),
            ("cylinder", "cylinder") => {
                let inner = case["scene"]["surfaces"]
                    .as_array()?
                    .iter()
                    .find(|s| s["side"] == "out");
                match inner {
                    None => cylinder_side_to_side(radius(from), height(from)),
                    Some(inner) => {
                        let outer = if from["side"] == "in" { from } else { to };
                        let (a, b, l) = (radius(inner), radius(outer), height(outer));
                        if from["side"] == "out" {
                            inner_to_outer_cylinder(a, b, l)
                        } else if to["side"] == "out" {
                            outer_to_inner_cylinder(a, b, l)
                        } else {
                            outer_to_outer_cylinder(a, b, l)
                        }
                    }
                }
            }
            ("sphere", "disc") => sphere_to_disc(radius(to), between(from, to)),
            ("sphere", "polygon") => {
                sphere_to_polygon(testing::vector(&from["center"]), &testing::polygon(to))
            }
            _ => return None,
        })
    }

    #[test]
    fn reference_cases() {
        // 1e-6 relative as the file asks of analytic methods, plus its uncertainty.
        let Some(cases) = testing::cases("form_factors.json") else {
            return;
        };
        let (mut count, mut worst) = (0, (0.0_f64, String::new()));
        for case in &cases {
            for query in case["queries"].as_array().expect("queries") {
                let (from, to) = (
                    testing::surface(case, &query["from"]),
                    testing::surface(case, &query["to"]),
                );
                let Some(got) = closed_form(case, from, to) else {
                    continue;
                };
                let (want, unc) = testing::expected(query);
                assert!(
                    (got - want).abs() <= 1e-6 * want + unc,
                    "{} {}: {got} for {want}",
                    case["id"],
                    query["id"]
                );
                if (got / want - 1.0).abs() > worst.0 {
                    worst = ((got / want - 1.0).abs(), case["id"].to_string());
                }
                count += 1;
            }
        }
        eprintln!(
            "{count} closed forms, worst relative error {:.1e} in {}",
            worst.0, worst.1
        );
        assert!(count >= 38, "{count}");
    }

    #[test]
    fn discs_keep_their_digits_near_and_far() {
        // Far: area over pi d^2, error of order (r/d)^2. Touching: all arrives.
        assert!((coaxial_discs(1.0, 1.0, 1e5) * 1e10 - 1.0).abs() < 1e-9);
        assert!((coaxial_discs(1.0, 2.0, 1e-9) - 1.0).abs() < 1e-12);
        assert!((sphere_to_disc(1e-4, 1.0) / 0.25e-8 - 1.0).abs() < 1e-7);
    }

    #[test]
    fn solid_angle_of_a_cube_face_is_a_sixth() {
        // From the centre, and from a far point the area over the square of the distance.
        let square = |z: f64| {
            Polygon::new(
                [(-1., -1.), (-1., 1.), (1., 1.), (1., -1.)]
                    .map(|(x, y)| DVec3::new(x, y, z))
                    .to_vec(),
            )
        };
        assert!((solid_angle(DVec3::ZERO, &square(1.0)) - 4.0 * PI / 6.0).abs() < 1e-14);
        assert!((solid_angle(DVec3::ZERO, &square(1e5)) * 1e10 / 4.0 - 1.0).abs() < 1e-9);
        assert_eq!(
            solid_angle(DVec3::Z * 2.0, &square(1.0)),
            0.0,
            "from behind"
        );
        assert!(
            (inside_sphere_to_zone(1.0, 1.0) - 0.5).abs() < 1e-15,
            "half a sphere"
        );
    }

    #[test]
    fn concentric_cylinders_become_long_ones() {
        // Infinitely long: the inner gives all to the outer, the outer r1/r2 to the inner, and
        // the rest to itself; at length 1e4 radii what the ends lose is below 1e-3.
        assert!((inner_to_outer_cylinder(1.0, 2.0, 1e4) - 1.0).abs() < 1e-3);
        assert!((outer_to_outer_cylinder(1.0, 2.0, 1e4) - 0.5).abs() < 1e-3);
        assert!((outer_to_inner_sphere(1.0, 2.0) - 0.25).abs() < 1e-15);
    }
}
