//! Factors between infinitely long strips in two dimensions, by crossed strings.
//!
//! For two strips that see each other freely, the flux between them is the crossed strings less
//! the uncrossed ones, over twice the width of the sender. A strip reaches only what is in
//! front of it, so each is cut at the line of the other first.
//!
//! Source: [Hottel54]; strip and cylinder [Howell10] C-12; equal cylinders C-63.

use glam::DVec2;
use std::f64::consts::PI;

/// An infinite strip by its section. It faces the left of `from -> to`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strip {
    /// One end, metres.
    pub from: DVec2,
    /// The other end.
    pub to: DVec2,
}

impl Strip {
    /// A strip that faces the left of `from -> to`.
    pub fn new(from: DVec2, to: DVec2) -> Self {
        Strip { from, to }
    }

    /// Width, metres.
    pub fn width(&self) -> f64 {
        (self.to - self.from).length()
    }

    /// Height of a point in front, times the width.
    fn height(&self, p: DVec2) -> f64 {
        (self.to - self.from).perp_dot(p - self.from)
    }

    /// What of this strip lies in front of `other`.
    fn in_front_of(&self, other: &Strip) -> Option<Strip> {
        let scale = other.width() * ((self.from - other.from).length() + self.width());
        // What rounding leaves of a shared end counts as on the line.
        let snap = |h: f64| if h.abs() <= 1e-14 * scale { 0.0 } else { h };
        let (a, b) = (snap(other.height(self.from)), snap(other.height(self.to)));
        if a <= 0.0 && b <= 0.0 {
            return None;
        }
        let cut = || self.from + (self.to - self.from) * (a / (a - b));
        Some(match (a < 0.0, b < 0.0) {
            (true, _) => Strip::new(cut(), self.to),
            (_, true) => Strip::new(self.from, cut()),
            _ => *self,
        })
    }
}

/// Fraction of the flux leaving `a` that reaches `b`, nothing between them; 0..=1. Exact.
pub fn strip_to_strip(a: &Strip, b: &Strip) -> f64 {
    let (Some(pa), Some(pb)) = (a.in_front_of(b), b.in_front_of(a)) else {
        return 0.0;
    };
    // Seen along a, the ends of b come in the other order: a.from and b.from cross.
    let shorter = |from: DVec2, far: DVec2, near: DVec2| {
        // |far - from| - |near - from| without cancellation.
        let (x, y) = (far - from, near - from);
        let sum = x.length() + y.length();
        if sum > 0.0 {
            (far - near).dot(x + y) / sum
        } else {
            0.0
        }
    };
    let twice = shorter(pa.from, pb.from, pb.to) + shorter(pa.to, pb.to, pb.from);
    (twice / (2.0 * a.width())).clamp(0.0, 1.0)
}

/// All factors between the strips of a convex section, or of any in which none hides another:
/// `factors[i][j]` = F_ij.
pub fn strip_factors(strips: &[Strip]) -> Vec<Vec<f64>> {
    strips
        .iter()
        .map(|a| strips.iter().map(|b| strip_to_strip(a, b)).collect())
        .collect()
}

/// Fraction of the flux leaving a strip that reaches a parallel cylinder wholly in front of it;
/// 0..=1. Exact.
pub fn strip_to_cylinder(strip: &Strip, centre: DVec2, radius: f64) -> f64 {
    let along = (strip.to - strip.from) / strip.width();
    let height = along.perp_dot(centre - strip.from);
    debug_assert!(height >= radius);
    let foot = (centre - strip.from).dot(along);
    let angle = ((strip.width() - foot) / height).atan() + (foot / height).atan();
    radius / strip.width() * angle
}

/// Fraction of the flux leaving one infinite cylinder that reaches a parallel one; 0..=1.
///
/// Crossed strings around two circles of any radii that do not overlap. For equal ones it is
/// [Howell10] C-63.
pub fn cylinder_to_cylinder(from_radius: f64, to_radius: f64, between_axes: f64) -> f64 {
    let (a, b, d) = (from_radius, to_radius, between_axes);
    debug_assert!(d >= a + b);
    // A crossed string: its straight part and its arcs to where the uncrossed string touches.
    let (sum, difference) = (a + b, a - b);
    let inner = (d * d - sum * sum).max(0.0).sqrt();
    let outer = (d * d - difference * difference).sqrt();
    let (cross, open) = ((sum / d).asin(), (difference / d).asin());
    // The crossed tangent leaves each circle at angle acos(sum/d) from the line of centres, the
    // uncrossed one at acos(+-difference/d).
    let arcs = a * (cross - open) + b * (cross + open);
    ((inner + arcs - outer) / (2.0 * PI * a)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn at(v: &serde_json::Value) -> DVec2 {
        DVec2::new(v[0].as_f64().expect("x"), v[1].as_f64().expect("y"))
    }

    #[test]
    fn reference_cases() {
        // 1e-6 relative as the file asks of analytic methods, plus its uncertainty.
        let Some(cases) = testing::cases("form_factors.json") else {
            return;
        };
        let (mut count, mut worst) = (0, 0.0_f64);
        for case in cases.iter().filter(|c| c["tags"][0] == "2d") {
            for query in case["queries"].as_array().expect("queries") {
                let (from, to) = (
                    testing::surface(case, &query["from"]),
                    testing::surface(case, &query["to"]),
                );
                let strip = |s: &serde_json::Value| Strip::new(at(&s["p0"]), at(&s["p1"]));
                let radius = |s: &serde_json::Value| s["radius"].as_f64().expect("radius");
                let got = match (from["shape"].as_str(), to["shape"].as_str()) {
                    (Some("infinite_strip"), Some("infinite_strip")) => {
                        strip_to_strip(&strip(from), &strip(to))
                    }
                    (Some("infinite_strip"), _) => {
                        strip_to_cylinder(&strip(from), at(&to["center"]), radius(to))
                    }
                    _ => {
                        let d = (at(&from["center"]) - at(&to["center"])).length();
                        cylinder_to_cylinder(radius(from), radius(to), d)
                    }
                };
                let (want, unc) = testing::expected(query);
                assert!(
                    (got - want).abs() <= 1e-6 * want + unc,
                    "{} {}: {got} for {want}",
                    case["id"],
                    query["id"]
                );
                worst = worst.max((got / want - 1.0).abs());
                count += 1;
            }
        }
        eprintln!("{count} factors in two dimensions, worst relative error {worst:.1e}");
        assert!(count >= 14);
    }

    #[test]
    fn the_shelf_of_three_surfaces() {
        // Floor A and wall B at a right angle, and C the plane from edge to edge; ratio
        // g = floor / wall = sqrt 3: the wall gives (1 + g - sqrt(1 + g^2)) / 2 to the floor, and
        // rows close. Rounding only.
        let g = 3.0_f64.sqrt();
        let (o, floor, wall) = (DVec2::ZERO, DVec2::new(g, 0.0), DVec2::new(0.0, 1.0));
        let strips = [
            Strip::new(o, floor),
            Strip::new(wall, o),
            Strip::new(floor, wall),
        ];
        let f = strip_factors(&strips);
        assert!((f[0][1] * g - 0.5 * (1.0 + g - 2.0)).abs() < 1e-15);
        for i in 0..3 {
            assert!(
                (f[i].iter().sum::<f64>() - 1.0).abs() < 1e-14,
                "closed triangle"
            );
            assert_eq!(f[i][i], 0.0);
            for j in 0..3 {
                let (wi, wj) = (strips[i].width(), strips[j].width());
                assert!((wi * f[i][j] - wj * f[j][i]).abs() < 1e-15, "reciprocity");
            }
        }
    }

    #[test]
    fn strips_behind_and_in_one_line_give_zero() {
        let a = Strip::new(DVec2::ZERO, DVec2::X);
        assert_eq!(
            strip_to_strip(&a, &Strip::new(DVec2::X, DVec2::new(2.0, 0.0))),
            0.0
        );
        assert_eq!(
            strip_to_strip(&a, &Strip::new(DVec2::Y, DVec2::ONE)),
            0.0,
            "faces up"
        );
        // Half of a tall wall is below the floor: as its upper half.
        let tall = Strip::new(DVec2::new(0.0, 1.0), DVec2::new(0.0, -1.0));
        let upper = Strip::new(DVec2::new(0.0, 1.0), DVec2::ZERO);
        assert!((strip_to_strip(&a, &tall) - strip_to_strip(&a, &upper)).abs() < 1e-15);
        assert!((strip_to_strip(&tall, &a) - 0.5 * strip_to_strip(&upper, &a)).abs() < 1e-15);
    }

    #[test]
    fn unequal_cylinders_are_reciprocal_and_tend_to_the_view_of_a_line() {
        let (f, back) = (
            cylinder_to_cylinder(2.0, 0.5, 4.0),
            cylinder_to_cylinder(0.5, 2.0, 4.0),
        );
        assert!((2.0 * f - 0.5 * back).abs() < 1e-15);
        // A vanishing sender sees the other under the half angle asin(b/d): share asin/pi.
        let tiny = cylinder_to_cylinder(1e-6, 2.0, 4.0);
        assert!((tiny - 0.5_f64.asin() / PI).abs() < 1e-6);
    }
}
