//! Luminaires as what casts shadows: points, directions, and the corners of emissive bodies.
//!
//! Emissive triangles that touch are one body. A flat body is the convex hull of its corners: the
//! planes that touch a concave outline from one side touch its hull. Of a body with very many
//! corners (a bulb) those farthest out in evenly spread directions stand for all.

use crate::contact::{place, root};
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::{DVec3, LuminaireKind, Rgb, Scene};
use std::collections::HashMap;

/// Where light comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Eye {
    /// A point, metres.
    At(DVec3),
    /// Infinitely far, travelling along this unit vector.
    Along(DVec3),
}

/// Where a source shines to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reach {
    /// All around.
    All,
    /// Directions within a cone around a unit axis, by its cosine.
    Cone(DVec3, f64),
}

/// A luminaire that casts shadows.
#[derive(Clone, Debug)]
pub(super) struct Source {
    /// One for a luminaire without size; the corners of an emissive body, in order around a flat
    /// one.
    pub eyes: Vec<Eye>,
    /// Whether consecutive eyes are its edges.
    pub is_flat: bool,
    pub reach: Reach,
    /// Flux, lm; of a directional luminaire what falls on the scene's bounds.
    pub flux: f64,
}

impl Source {
    /// Whether light of it travels along `direction` (any length).
    pub fn shines(&self, direction: DVec3) -> bool {
        match self.reach {
            Reach::All => true,
            Reach::Cone(axis, cosine) => direction.dot(axis) > cosine * direction.length(),
        }
    }
}

/// Corners that stand for a body that has more.
const MOST_CORNERS: usize = 64;
/// A corner of a flat outline counts if it is off the line of its neighbours by this share.
const BEND: f64 = 1e-5;

/// All sources, the strongest first.
pub(super) fn sources(scene: &Scene, tolerance_m: f64) -> Vec<Source> {
    let mut all: Vec<Source> = scene
        .luminaires
        .iter()
        .map(|l| {
            let position = Eye::At(l.position.as_dvec3());
            let axis = l.direction.as_dvec3().normalize_or_zero();
            let candela = |c: Rgb| c.luminance() as f64;
            let (eye, reach, flux) = match l.kind {
                LuminaireKind::Point { intensity, .. } => (
                    position,
                    Reach::All,
                    4.0 * std::f64::consts::PI * candela(intensity),
                ),
                LuminaireKind::Spot {
                    intensity,
                    cos_outer,
                    ..
                } => {
                    let cosine = cos_outer as f64;
                    let solid_angle = 2.0 * std::f64::consts::PI * (1.0 - cosine);
                    (
                        position,
                        Reach::Cone(axis, cosine),
                        solid_angle * candela(intensity),
                    )
                }
                LuminaireKind::Lambertian { intensity } => (
                    position,
                    Reach::Cone(axis, 0.0),
                    std::f64::consts::PI * candela(intensity),
                ),
                LuminaireKind::Directional { illuminance } => {
                    let size = scene.diagonal() as f64;
                    (
                        Eye::Along(axis),
                        Reach::All,
                        candela(illuminance) * size * size,
                    )
                }
            };
            Source {
                eyes: vec![eye],
                is_flat: false,
                reach,
                flux,
            }
        })
        .collect();
    all.extend(bodies(scene, tolerance_m));
    all.retain(|s| s.flux > 0.0);
    // Stable: of equal ones the first in the file.
    all.sort_by(|a, b| b.flux.total_cmp(&a.flux));
    all
}

/// Emissive triangles that touch, body by body in order of their first triangle.
fn bodies(scene: &Scene, tolerance_m: f64) -> Vec<Source> {
    let emissive: Vec<u32> = (0..scene.triangles.len() as u32)
        .filter(|&t| {
            let finish = scene.finish_of(t as usize);
            let shines = |e: &luxel_core::Emission| e.luminance.luminance() > 0.0;
            !finish.transparent && finish.emission.as_ref().is_some_and(shines)
        })
        .collect();
    let mut parent: Vec<usize> = (0..emissive.len()).collect();
    let mut first_at = HashMap::new();
    for (i, &t) in emissive.iter().enumerate() {
        for p in scene.corners(t as usize) {
            let other = *first_at.entry(place(p)).or_insert(i);
            let (a, b) = (root(&mut parent, i), root(&mut parent, other));
            parent[a.max(b)] = a.min(b);
        }
    }
    let mut members: Vec<(usize, u32)> = (0..emissive.len())
        .map(|i| (root(&mut parent, i), emissive[i]))
        .collect();
    members.sort_unstable();
    members
        .chunk_by(|a, b| a.0 == b.0)
        .map(|run| body(scene, run, tolerance_m))
        .collect()
}

fn body(scene: &Scene, members: &[(usize, u32)], tolerance_m: f64) -> Source {
    let (mut flux, mut normal) = (0.0, DVec3::ZERO);
    let mut corners: Vec<DVec3> = Vec::new();
    let mut backs = false;
    for &(_, t) in members {
        let finish = scene.finish_of(t as usize);
        let luminance = finish.emission.as_ref().map_or(Rgb::BLACK, |e| e.luminance);
        let [a, b, c] = scene.corners(t as usize).map(|p| p.as_dvec3());
        flux += luminance.luminance() as f64 * LAMBERTIAN as f64 * scene.area(t as usize) as f64;
        normal += (b - a).cross(c - a);
        backs |= finish.back_emits;
        corners.extend([a, b, c]);
    }
    corners.sort_by(|a, b| {
        a.to_array()
            .partial_cmp(&b.to_array())
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    corners.dedup();
    let normal = normal.normalize_or_zero();
    let is_flat = normal != DVec3::ZERO
        && corners
            .iter()
            .all(|&p| (p - corners[0]).dot(normal).abs() <= tolerance_m);
    if is_flat {
        corners = hull(&corners, normal);
    } else if corners.len() > MOST_CORNERS {
        corners = outermost(&corners);
    }
    Source {
        eyes: corners.into_iter().map(Eye::At).collect(),
        is_flat,
        reach: if is_flat && !backs {
            Reach::Cone(normal, 0.0)
        } else {
            Reach::All
        },
        flux,
    }
}

/// Convex hull in the plane across `normal`, counter-clockwise seen against it.
///
/// Andrew's monotone chain [Andrew79].
fn hull(points: &[DVec3], normal: DVec3) -> Vec<DVec3> {
    let x = normal.any_orthonormal_vector();
    let y = normal.cross(x);
    let mut flat: Vec<(f64, f64, DVec3)> =
        points.iter().map(|&p| (p.dot(x), p.dot(y), p)).collect();
    flat.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let half = |order: &mut dyn Iterator<Item = &(f64, f64, DVec3)>| {
        let mut line: Vec<(f64, f64, DVec3)> = Vec::new();
        for &p in order {
            while let [.., a, b] = line[..] {
                let (u, v) = ((b.0 - a.0, b.1 - a.1), (p.0 - b.0, p.1 - b.1));
                let size = u.0.hypot(u.1) * v.0.hypot(v.1);
                if u.0 * v.1 - u.1 * v.0 > BEND * size {
                    break;
                }
                line.pop();
            }
            line.push(p);
        }
        line.pop();
        line
    };
    let mut all = half(&mut flat.iter());
    all.extend(half(&mut flat.iter().rev()));
    all.into_iter().map(|p| p.2).collect()
}

/// Those farthest out in directions spread evenly over the sphere (a Fibonacci lattice).
fn outermost(points: &[DVec3]) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
    let mut kept: Vec<usize> = (0..MOST_CORNERS)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f64 / MOST_CORNERS as f64;
            let (s, c) = (golden * i as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let d = DVec3::new(r * c, r * s, z);
            (1..points.len()).fold(0, |best, p| {
                if points[p].dot(d) > points[best].dot(d) {
                    p
                } else {
                    best
                }
            })
        })
        .collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|i| points[i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hull_of_an_l_has_five_corners() {
        // The inner corner of an L and points on its edges are no corners of its hull.
        let at = |x: f64, y: f64| DVec3::new(x, y, 3.0);
        let points = [
            at(0., 0.),
            at(2., 0.),
            at(2., 1.),
            at(1., 1.),
            at(1., 2.),
            at(0., 2.),
            at(1., 0.),
        ];
        let found = hull(&points, DVec3::Z);
        assert_eq!(found.len(), 5);
        let twice: f64 = (0..5).map(|i| found[i].cross(found[(i + 1) % 5]).z).sum();
        // 4 m2 less half a square metre; positive: counter-clockwise.
        assert!((0.5 * twice - 3.5).abs() < 1e-12, "{}", 0.5 * twice);
    }
}
