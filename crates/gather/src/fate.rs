//! Where the light of the luminaires goes first: onto elements, onto black sides, out of the scene.
//!
//! Rays from the lights themselves, in the density of their intensity: an estimate that shares
//! nothing with the analytic direct light of the elements, so the two are held against each
//! other in the energy balance.

use crate::lights::{DirectLights, Light, LightKind};
use luxel_core::layers::BANDS;
use luxel_core::quantity::{LAMBERTIAN, SPHERE_SR};
use luxel_core::{Front, LuminaireKind, Vec3};
use luxel_transport::sampling::cosine_hemisphere;
use luxel_transport::{Hit, Ray, RayCaster, Sequence};
use std::f32::consts::TAU;

/// Rays for all lights together, and fewest for one.
const RAYS: u32 = 1 << 17;
const FEWEST: u32 = 256;

/// Flux of the direct lights and where it arrives first, lm, one entry a column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fate {
    /// Sent out. Of parallel light, what meets the scene.
    pub emitted: Vec<f64>,
    /// Arrived on elements.
    pub landed: Vec<f64>,
    /// Arrived on sides that reflect nothing and are no elements.
    pub black: Vec<f64>,
    /// Left the scene.
    pub outside: Vec<f64>,
}

impl DirectLights {
    /// Follows rays from every direct light to where they end. The same bits for any thread count.
    ///
    /// Exact for `emitted` (but for parallel light); the shares have the error of 256 to
    /// 131,072 low-discrepancy rays a light, typically below 1 %.
    pub fn fate(
        &self,
        front: &Front,
        caster: &dyn RayCaster,
        bounds: (Vec3, Vec3),
        seed: u32,
    ) -> Fate {
        let zero = || vec![0.0; self.columns];
        let mut fate = Fate {
            emitted: zero(),
            landed: zero(),
            black: zero(),
            outside: zero(),
        };
        let count = (RAYS / self.lights.len().max(1) as u32).max(FEWEST);
        let (mut rays, mut weights) = (Vec::new(), Vec::new());
        let mut hits = Vec::new();
        for (index, light) in self.lights.iter().enumerate() {
            rays.clear();
            weights.clear();
            let sequence = Sequence::new(seed, index as u32);
            for k in 0..count {
                let (ray, weight) = light.emit(sequence.point4(k), caster.offset_m(), bounds);
                if weight > 0.0 {
                    rays.push(ray);
                    weights.push(weight / count as f64);
                }
            }
            hits.clear();
            hits.resize(rays.len(), Hit::MISS);
            caster.closest(&rays, &mut hits);
            let (mut landed, mut black, mut outside) = (0.0, 0.0, 0.0);
            for ((ray, hit), weight) in rays.iter().zip(&hits).zip(&weights) {
                if !hit.is_hit() {
                    outside += weight;
                    continue;
                }
                let point = ray.origin + ray.direction * hit.t;
                match front.element_at(hit.triangle as usize, hit.side, point) {
                    Some(_) => landed += weight,
                    None => black += weight,
                }
            }
            if light.is_parallel() {
                // What passes beside the scene was never in it.
                outside = 0.0;
            }
            for (band, tint) in light.tint.to_array().into_iter().enumerate() {
                let column = BANDS * light.group + band;
                let tint = tint as f64;
                fate.landed[column] += tint * landed;
                fate.black[column] += tint * black;
                fate.outside[column] += tint * outside;
                fate.emitted[column] += tint * (landed + black + outside);
            }
        }
        fate
    }
}

impl Light {
    fn is_parallel(&self) -> bool {
        matches!(&self.kind, LightKind::Luminaire(l) if matches!(l.kind, LuminaireKind::Directional { .. }))
    }

    /// A ray of light for uniform numbers, and its weight: the mean of the weights times `tint`
    /// is the flux, lm.
    fn emit(&self, [a, b, u, v]: [f32; 4], offset: f32, (low, high): (Vec3, Vec3)) -> (Ray, f64) {
        let ray = |origin, direction| Ray {
            origin,
            t_min: 0.0,
            direction,
            t_max: f32::INFINITY,
        };
        match &self.kind {
            LightKind::Polygon(e) => {
                let c = &e.polygon.vertices;
                let (s, t) = if c.len() == 4 {
                    (a, b)
                } else if b > a {
                    (0.5 * a, b - 0.5 * a)
                } else {
                    (a - 0.5 * b, 0.5 * b)
                };
                let last = c[c.len() - 1];
                let point = c[0] + (c[1] - c[0]) * s as f64 + (last - c[0]) * t as f64;
                let normal = e.normal.as_vec3();
                let origin = point.as_vec3() + normal * offset;
                (ray(origin, cosine_hemisphere([u, v], normal)), e.area)
            }
            LightKind::Luminaire(l) => match l.kind {
                LuminaireKind::Point { .. } => (
                    ray(l.position, cap(-1.0, [u, v], Vec3::Z)),
                    SPHERE_SR as f64,
                ),
                LuminaireKind::Spot {
                    cos_inner,
                    cos_outer,
                    ..
                } => {
                    let direction = cap(cos_outer, [u, v], l.direction);
                    let ramp = (direction.dot(l.direction) - cos_outer)
                        / (cos_inner - cos_outer).max(1e-3);
                    let weight = SPHERE_SR * 0.5 * (1.0 - cos_outer) * ramp.clamp(0.0, 1.0).powi(2);
                    (ray(l.position, direction), weight as f64)
                }
                LuminaireKind::Lambertian { .. } => (
                    ray(l.position, cosine_hemisphere([u, v], l.direction)),
                    LAMBERTIAN as f64,
                ),
                LuminaireKind::Directional { .. } => {
                    let (centre, radius) = ((low + high) * 0.5, (high - low).length() * 0.5);
                    let side = l.direction.any_orthonormal_vector();
                    let other = l.direction.cross(side);
                    let (r, angle) = (radius * u.sqrt(), TAU * v);
                    let origin = centre - l.direction * (2.0 * radius)
                        + (side * angle.cos() + other * angle.sin()) * r;
                    (
                        ray(origin, l.direction),
                        (LAMBERTIAN * radius * radius) as f64,
                    )
                }
            },
        }
    }
}

/// A direction uniform by solid angle within the cap `cos >= cos_edge` around `axis`.
fn cap(cos_edge: f32, [u, v]: [f32; 2], axis: Vec3) -> Vec3 {
    let z = 1.0 - u * (1.0 - cos_edge);
    let r = (1.0 - z * z).max(0.0).sqrt();
    let side = axis.any_orthonormal_vector();
    let angle = TAU * v;
    (side * angle.cos() + axis.cross(side) * angle.sin()) * r + axis * z
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_core::{GroupId, Luminaire, Rgb, Scene};

    /// A ray engine over nothing.
    struct Void;
    impl RayCaster for Void {
        fn closest(&self, _: &[Ray], hits: &mut [Hit]) {
            hits.fill(Hit::MISS);
        }
        fn visibility(&self, _: &[Ray], visible: &mut [f32]) {
            visible.fill(1.0);
        }
        fn offset_m(&self) -> f32 {
            1e-6
        }
    }

    #[test]
    fn a_lamp_in_the_void_loses_its_lumens() {
        let kinds = [
            // 4 pi, pi, and 2 pi (1 - cos) / 3 lm for one candela: a soft hemisphere's edge counts a third.
            (
                LuminaireKind::Point {
                    intensity: Rgb::WHITE,
                    range_m: f32::INFINITY,
                },
                12.566371,
            ),
            (
                LuminaireKind::Lambertian {
                    intensity: Rgb::WHITE,
                },
                LAMBERTIAN as f64,
            ),
            (
                LuminaireKind::Spot {
                    intensity: Rgb::WHITE,
                    range_m: f32::INFINITY,
                    cos_inner: 1.0,
                    cos_outer: 0.0,
                },
                2.0943951,
            ),
        ];
        for (kind, lumens) in kinds {
            let scene = Scene {
                luminaires: vec![Luminaire {
                    name: "lamp".into(),
                    position: Vec3::ZERO,
                    direction: Vec3::X,
                    kind,
                    group: GroupId(0),
                }],
                groups: vec![luxel_core::Group {
                    name: "lamp".into(),
                }],
                ..Scene::default()
            };
            let front = Front::new(0);
            let fate = DirectLights::new(&scene, &front).fate(&front, &Void, scene.bounds(), 1);
            // 2^17 low-discrepancy rays integrate a smooth ramp to well below 1e-4.
            assert!(
                (fate.emitted[1] - lumens).abs() < 1e-4 * lumens,
                "{kind:?}: {}",
                fate.emitted[1]
            );
            assert_eq!(fate.outside[1], fate.emitted[1]);
        }
    }
}
