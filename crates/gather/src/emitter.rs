//! An emissive polygon as a receiver sees it: the exact unoccluded factor, and points on it
//! for shadow rays.
//!
//! From afar points are uniform by area. Near by, area sampling would spend nearly all rays
//! where the kernel is small. There a rectangle is sampled uniformly in the angles along its two
//! edges: lines along either edge stay straight in the unit square, so the strata of the points
//! resolve slits and edges of shadow that run with the room. Any other shape is a fan of
//! spherical triangles, uniform by solid angle [Arvo95], clipped at the receiver's horizon. Each
//! point carries the weight kernel / density, whose mean is the factor.

use luxel_core::{DVec3, Polygon, Vec3};
use std::f64::consts::PI;

/// A uniformly emitting convex polygon: a parallelogram or a triangle.
#[derive(Clone, Debug)]
pub(crate) struct Emitter {
    /// Corners, counter-clockwise seen from where the light goes.
    pub polygon: Polygon,
    /// Unit normal towards the light.
    pub normal: DVec3,
    /// Area, m².
    pub area: f64,
    /// Mean of the corners.
    pub centre: DVec3,
    /// Largest distance of a corner from the centre, metres.
    pub radius: f64,
    /// Whether the four corners form a rectangle.
    rectangle: bool,
}

/// Emitters larger than this, as seen (radius over distance), are sampled by solid angle.
const NEAR: f64 = 0.15;

impl Emitter {
    /// From a triangle or a parallelogram; `None` when it has no area.
    pub fn new(polygon: Polygon) -> Option<Emitter> {
        let v = &polygon.vertices;
        let area = polygon.area();
        if !(v.len() == 3 || v.len() == 4) || !area.is_finite() || area <= 0.0 {
            return None;
        }
        let centre = polygon.centre();
        let radius = v.iter().map(|&p| (p - centre).length()).fold(0.0, f64::max);
        let rectangle = v.len() == 4 && {
            let (u, w) = (v[1] - v[0], v[3] - v[0]);
            u.dot(w).abs() < 1e-6 * u.length() * w.length()
        };
        Some(Emitter {
            normal: polygon.normal(),
            area,
            centre,
            radius,
            rectangle,
            polygon,
        })
    }

    /// The emitter as seen from a receiver; `None` when it is wholly behind it or turned away.
    pub fn seen_from(&self, point: DVec3, normal: DVec3) -> Option<EmitterView<'_>> {
        let to = self.centre - point;
        if to.dot(self.normal) >= 0.0 {
            return None;
        }
        let (mut above, mut below) = (false, false);
        for &v in &self.polygon.vertices {
            let h = (v - point).dot(normal);
            above |= h > 0.0;
            below |= h < 0.0;
        }
        if !above {
            return None;
        }
        let shape = if below {
            fan(
                point,
                &clip_to_horizon(&self.polygon.vertices, point, normal),
            )?
        } else if self.radius * self.radius < NEAR * NEAR * to.length_squared() {
            Sampler::Area
        } else if let Some(s) = self
            .rectangle
            .then(|| RectangleByAngle::new(self, point))
            .flatten()
        {
            Sampler::Rectangle(s)
        } else {
            fan(point, &self.polygon.vertices).unwrap_or(Sampler::Area)
        };
        Some(EmitterView {
            emitter: self,
            point,
            normal,
            shape,
        })
    }
}

/// An emitter as seen from one receiver.
pub(crate) struct EmitterView<'a> {
    emitter: &'a Emitter,
    point: DVec3,
    normal: DVec3,
    shape: Sampler,
}

enum Sampler {
    /// Uniform by area.
    Area,
    /// Uniform by the angles along the edges of a rectangle.
    Rectangle(RectangleByAngle),
    /// Uniform by solid angle over triangles; with the running share of each.
    Fan(Vec<(f64, SphericalTriangle)>, f64),
}

impl EmitterView<'_> {
    /// A point of the emitter for `(u, v)` uniform in the square, and its weight: the mean of
    /// the weights is the unoccluded factor. A weight of zero needs no shadow ray.
    pub fn sample(&self, [u, v]: [f64; 2]) -> (Vec3, f64) {
        let e = self.emitter;
        match &self.shape {
            Sampler::Area => {
                let c = &e.polygon.vertices;
                let x = if c.len() == 4 {
                    c[0] + (c[1] - c[0]) * u + (c[3] - c[0]) * v
                } else {
                    // Low-distortion map of the square to the triangle [Heitz19].
                    let (a, b) = if v > u {
                        (0.5 * u, v - 0.5 * u)
                    } else {
                        (u - 0.5 * v, 0.5 * v)
                    };
                    c[0] + (c[1] - c[0]) * a + (c[2] - c[0]) * b
                };
                (x.as_vec3(), self.kernel(x - self.point) * e.area)
            }
            Sampler::Rectangle(s) => {
                let (to, area) = s.sample(u, v);
                ((self.point + to).as_vec3(), self.kernel(to) * area)
            }
            Sampler::Fan(triangles, whole) => {
                let k = triangles
                    .partition_point(|t| t.0 <= u)
                    .min(triangles.len() - 1);
                let before = if k == 0 { 0.0 } else { triangles[k - 1].0 };
                let share = ((u - before) / (triangles[k].0 - before)).clamp(0.0, 1.0);
                let w = triangles[k].1.sample(share, v);
                let fall = w.dot(e.normal);
                if fall >= 0.0 {
                    return (self.point.as_vec3(), 0.0);
                }
                let t = (e.polygon.vertices[0] - self.point).dot(e.normal) / fall;
                (
                    (self.point + w * t).as_vec3(),
                    w.dot(self.normal).max(0.0) * whole / PI,
                )
            }
        }
    }
}

impl EmitterView<'_> {
    /// Factor per area: cos cos / (pi r²).
    fn kernel(&self, to: DVec3) -> f64 {
        let d2 = to.length_squared();
        let cosines = to.dot(self.normal).max(0.0) * (-to.dot(self.emitter.normal)).max(0.0);
        if d2 > 0.0 {
            cosines / (PI * d2 * d2)
        } else {
            0.0
        }
    }
}

/// The part of a polygon that is above the receiver's horizon.
fn clip_to_horizon(vertices: &[DVec3], point: DVec3, normal: DVec3) -> Vec<DVec3> {
    let mut out = Vec::with_capacity(vertices.len() + 1);
    for (i, &a) in vertices.iter().enumerate() {
        let b = vertices[(i + 1) % vertices.len()];
        let (ha, hb) = ((a - point).dot(normal), (b - point).dot(normal));
        if ha >= 0.0 {
            out.push(a);
        }
        if (ha > 0.0 && hb < 0.0) || (ha < 0.0 && hb > 0.0) {
            out.push(a + (b - a) * (ha / (ha - hb)));
        }
    }
    out
}

/// Fan of spherical triangles; `None` when nothing of it can be seen.
fn fan(point: DVec3, vertices: &[DVec3]) -> Option<Sampler> {
    let mut triangles = Vec::with_capacity(4);
    let mut whole = 0.0;
    for i in 1..vertices.len().saturating_sub(1) {
        let corners = [vertices[0], vertices[i], vertices[i + 1]];
        if let Some(t) = SphericalTriangle::new(corners.map(|c| c - point)) {
            whole += t.solid_angle;
            triangles.push((whole, t));
        }
    }
    if triangles.is_empty() {
        return None;
    }
    for t in &mut triangles {
        t.0 /= whole;
    }
    Some(Sampler::Fan(triangles, whole))
}

/// Sampling of a rectangle by the angle along each edge: the foot of the receiver is the origin,
/// `h` its height, x = h tan a, y = h tan b with uniform angles.
///
/// Kernel over density is (1 + x²)(1 + y²) / (1 + x² + y²)² for h = 1: smooth and at most 1.
struct RectangleByAngle {
    x: DVec3,
    y: DVec3,
    /// Vector from the receiver to its foot on the plane.
    down: DVec3,
    h: f64,
    /// First angle and range of angles along x and y.
    ax: [f64; 2],
    ay: [f64; 2],
}

impl RectangleByAngle {
    fn new(e: &Emitter, point: DVec3) -> Option<Self> {
        let v = &e.polygon.vertices;
        let (u, w) = (v[1] - v[0], v[3] - v[0]);
        let (lu, lw) = (u.length(), w.length());
        let (x, y) = (u / lu, w / lw);
        let d = v[0] - point;
        let down = e.normal * d.dot(e.normal);
        let h = down.length();
        if h <= 1e-9 * e.radius {
            return None;
        }
        let range = |from: f64, length: f64| {
            let first = (from / h).atan();
            [first, ((from + length) / h).atan() - first]
        };
        let (ax, ay) = (range(d.dot(x), lu), range(d.dot(y), lw));
        Some(RectangleByAngle {
            x,
            y,
            down,
            h,
            ax,
            ay,
        })
    }

    /// Vector from the receiver to the point, and the area that one unit of `u` and `v` covers.
    fn sample(&self, u: f64, v: f64) -> (DVec3, f64) {
        let (p, q) = (
            (self.ax[0] + u * self.ax[1]).tan(),
            (self.ay[0] + v * self.ay[1]).tan(),
        );
        let to = self.down + self.x * (p * self.h) + self.y * (q * self.h);
        let area = self.h * self.h * (1.0 + p * p) * (1.0 + q * q) * self.ax[1] * self.ay[1];
        (to, area)
    }
}

/// Uniform sampling of a spherical triangle [Arvo95].
struct SphericalTriangle {
    a: DVec3,
    b: DVec3,
    c: DVec3,
    sin_alpha: f64,
    cos_alpha: f64,
    angles: f64,
    solid_angle: f64,
}

impl SphericalTriangle {
    fn new(corners: [DVec3; 3]) -> Option<Self> {
        let [a, b, c] = corners.map(|p| p.normalize_or_zero());
        let normal = |p: DVec3, q: DVec3| p.cross(q).try_normalize();
        let (ab, bc, ca) = (normal(a, b)?, normal(b, c)?, normal(c, a)?);
        let angle = |p: DVec3, q: DVec3| (-p.dot(q)).clamp(-1.0, 1.0).acos();
        let (alpha, beta, gamma) = (angle(ab, ca), angle(bc, ab), angle(ca, bc));
        let angles = alpha + beta + gamma;
        let solid_angle = angles - PI;
        // Below this the excess is mostly rounding, and the light of it is nothing.
        (solid_angle > 1e-9).then_some(SphericalTriangle {
            a,
            b,
            c,
            sin_alpha: alpha.sin(),
            cos_alpha: alpha.cos(),
            angles,
            solid_angle,
        })
    }

    fn sample(&self, u: f64, v: f64) -> DVec3 {
        let part = PI + u * (self.angles - PI);
        let (s, c) = (part.sin(), part.cos());
        let sin_phi = s * self.cos_alpha - c * self.sin_alpha;
        let cos_phi = c * self.cos_alpha + s * self.sin_alpha;
        let k1 = cos_phi + self.cos_alpha;
        let k2 = sin_phi - self.sin_alpha * self.a.dot(self.b);
        let below = (k2 * sin_phi + k1 * cos_phi) * self.sin_alpha;
        let cos_b = (k2 + (k2 * cos_phi - k1 * sin_phi) * self.cos_alpha) / below;
        let cos_b = if cos_b.is_finite() {
            cos_b.clamp(-1.0, 1.0)
        } else {
            1.0
        };
        let sin_b = (1.0 - cos_b * cos_b).sqrt();
        let across = |p: DVec3, q: DVec3| (p - q * p.dot(q)).normalize_or_zero();
        let on_side = self.a * cos_b + across(self.c, self.a) * sin_b;
        let cos_t = 1.0 - v * (1.0 - on_side.dot(self.b));
        let sin_t = (1.0 - cos_t * cos_t).max(0.0).sqrt();
        self.b * cos_t + across(on_side, self.b) * sin_t
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_transport::Sequence;
    use luxel_transport::lambert::point_to_polygon;

    /// Sheared, straight and three-cornered emitters above the origin, facing down.
    fn emitters() -> Vec<Emitter> {
        let z = 1.3;
        let rectangle = [[-1.0, -0.5], [-1.0, 0.8], [1.5, 0.8], [1.5, -0.5]];
        let sheared = [[-1.0, -0.5], [-0.7, 0.8], [1.8, 0.8], [1.5, -0.5]];
        let triangle = [[-1.0, -0.5], [-0.2, 1.8], [1.5, -0.5]];
        [&rectangle[..], &sheared[..], &triangle[..]]
            .iter()
            .map(|c| c.iter().map(|p| DVec3::new(p[0], p[1], z)).collect())
            .map(|v| Emitter::new(Polygon::new(v)).expect("has area"))
            .collect()
    }

    #[test]
    fn mean_weight_is_the_factor_near_far_and_across_the_horizon() {
        // Mean over 4096 Sobol' points against the closed form of [Lambert1760]. A smooth
        // integrand on a scrambled net errs about n^-1.5 = 4e-6; clipped edges cost more.
        for (k, e) in emitters().iter().enumerate() {
            assert!(e.normal.z < 0.0);
            for (point, normal) in [
                (DVec3::ZERO, DVec3::Z),
                (DVec3::new(0.3, 0.1, 1.2), DVec3::Z),
                (DVec3::new(0.3, 0.1, 0.9), DVec3::new(0.8, 0.0, 0.6)),
                (DVec3::new(0.2, 0.0, 0.5), DVec3::X),
                (DVec3::new(20.0, 3.0, -9.0), DVec3::Z),
            ] {
                let view = e.seen_from(point, normal).expect("in sight");
                let s = Sequence::new(5, k as u32);
                let n = 4096;
                let mean = (0..n)
                    .map(|i| {
                        let (x, w) = view.sample(s.point2(i).map(f64::from));
                        if w > 0.0 {
                            let h = (x.as_dvec3() - e.polygon.vertices[0]).dot(e.normal);
                            assert!(h.abs() < 1e-5, "on the plane of the emitter");
                        }
                        w
                    })
                    .sum::<f64>()
                    / n as f64;
                let exact = point_to_polygon(point, normal, &e.polygon);
                assert!(
                    (mean / exact - 1.0).abs() < 1e-3,
                    "{k} {point} {normal}: {mean} {exact}"
                );
            }
        }
    }

    #[test]
    fn what_is_behind_is_not_seen() {
        for e in emitters() {
            assert!(e.seen_from(DVec3::ZERO, -DVec3::Z).is_none());
            assert!(
                e.seen_from(DVec3::new(0.0, 0.0, 2.0), -DVec3::Z).is_none(),
                "back is dark"
            );
        }
    }
}
