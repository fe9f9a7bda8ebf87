//! Where to stand when a file names no view.
//!
//! Candidates are eyes at 1.6 m above a floor with their back to a wall, and eyes outside that
//! hold everything in the picture. Each is judged by a coarse picture of rays: how much of it
//! shows sides that light can reach, from how near. Black backs, emptiness and what is right
//! before the eye count against it. So a closed room is seen from one of its corners, a box with
//! an open side through that side, and an object in the open from around it.
//!
//! Rays only and no solution, so the view does not change while the light is being solved.

use luxel_core::{LuminaireKind, Scene, Side, Vec3, View};
use luxel_transport::{Hit, Ray, RayCaster};

/// Height of the eye above the floor, metres.
const EYE_M: f32 = 1.6;
/// What is lower than this is a model or an object rather than a room to stand in, metres.
const SMALL_M: f32 = 2.2;
/// Places tried inside the bounds.
const PLACES: usize = 64;
/// Directions tried at each place.
const DIRECTIONS: usize = 16;
/// Directions tried around the outside.
const AROUND: usize = 16;
/// Vertical opening angle inside, radians: as wide as walls look straight (70 degrees).
const INSIDE_ANGLE: f32 = 70.0 * std::f32::consts::PI / 180.0;
/// Vertical opening angle outside, radians (40 degrees).
const OUTSIDE_ANGLE: f32 = 40.0 * std::f32::consts::PI / 180.0;
/// Width of a picture for its height.
const ASPECT: f32 = 16.0 / 9.0;
/// Rays of a coarse picture, across and down.
const GRID: [usize; 2] = [12, 7];
/// Luminaires and emitters to which sight is tested, the strongest first.
const LAMPS: usize = 4;
/// And those around which places are tried: in a large building the lit rooms are a small part.
const LIT_PLACES: usize = 16;

/// The first view of the scene, or [`auto_view`].
pub fn first_view(scene: &Scene, caster: &dyn RayCaster) -> View {
    scene
        .views
        .first()
        .cloned()
        .unwrap_or_else(|| auto_view(scene, caster))
}

/// A sensible view of a scene; the same for any thread count.
pub fn auto_view(scene: &Scene, caster: &dyn RayCaster) -> View {
    let (low, high) = scene.bounds();
    let up = scene.up.normalize_or(Vec3::Z);
    let size = (high - low).length();
    if size.is_nan() || size <= 0.0 {
        let forward = up.any_orthonormal_vector();
        return named(Vec3::ZERO, forward, up, INSIDE_ANGLE);
    }
    let lamps = lamps(scene);
    let mut candidates = inside(caster, low, high, up, &lamps);
    let within = candidates.len();
    candidates.extend(outside(low, high, up));
    let lamps = &lamps[..lamps.len().min(LAMPS)];
    let mut scores = judge(scene, caster, &candidates, lamps, size);
    if (high - low).dot(up).abs() < SMALL_M {
        // Nobody stands in a model; but a closed one shows nothing from outside.
        scores[..within].iter_mut().for_each(|s| *s *= 0.5);
    }
    let mut best = 0;
    for k in 1..candidates.len() {
        if scores[k] > scores[best] {
            best = k;
        }
    }
    candidates.swap_remove(best)
}

fn named(eye: Vec3, forward: Vec3, up: Vec3, vertical_angle: f32) -> View {
    View {
        name: "automatic".into(),
        eye,
        forward,
        up,
        vertical_angle,
    }
}

/// Nearest hits of many rays.
fn cast(caster: &dyn RayCaster, rays: &[Ray]) -> Vec<Hit> {
    let mut hits = vec![Hit::MISS; rays.len()];
    caster.closest(rays, &mut hits);
    hits
}

fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray {
        origin,
        t_min: 0.0,
        direction,
        t_max: f32::INFINITY,
    }
}

/// Radical inverse: points of the Halton sequence [Halton60].
fn halton(mut k: usize, base: usize) -> f32 {
    let (mut f, mut sum) = (1.0, 0.0);
    while k > 0 {
        f /= base as f32;
        sum += f * (k % base) as f32;
        k /= base;
    }
    sum
}

/// Eyes that stand on a floor with a wall behind.
fn inside(
    caster: &dyn RayCaster,
    low: Vec3,
    high: Vec3,
    up: Vec3,
    lamps: &[(Vec3, bool)],
) -> Vec<View> {
    let size = (high - low).length();
    let across = up.any_orthonormal_vector();
    let along = up.cross(across);
    let mut points: Vec<Vec3> = (1..=PLACES)
        .map(|k| low + (high - low) * Vec3::new(halton(k, 2), halton(k, 3), halton(k, 5)))
        .collect();
    // A step below each lamp, and two to one side.
    let step = (0.02 * size).min(1.0);
    for &(lamp, _) in lamps.iter().filter(|l| !l.1) {
        points.extend([lamp - up * step, lamp - up * step + across * (2.0 * step)]);
    }
    let vertical: Vec<Ray> = points
        .iter()
        .flat_map(|&p| [ray(p, -up), ray(p, up)])
        .collect();
    let hits = cast(caster, &vertical);
    let mut eyes = Vec::new();
    for (&p, found) in points.iter().zip(hits.chunks_exact(2)) {
        if !found[0].is_hit() {
            continue;
        }
        // In a small model a little above the middle; in a hall, or a file in another unit, not
        // with the chin on the floor.
        let clear = found[0].t
            + if found[1].is_hit() {
                found[1].t
            } else {
                f32::INFINITY
            };
        let tall = clear.min((high - low).dot(up).abs());
        eyes.push(p - up * (found[0].t - EYE_M.max(0.15 * tall).min(0.55 * tall)));
    }
    let turn = |k: usize| {
        // Not along the axes: two walls in view show more than one.
        let angle = (k as f32 + 0.37) * std::f32::consts::TAU / DIRECTIONS as f32;
        across * angle.cos() + along * angle.sin()
    };
    let backs: Vec<Ray> = eyes
        .iter()
        .flat_map(|&e| (0..DIRECTIONS).map(move |k| ray(e, -turn(k))))
        .collect();
    let walls = cast(caster, &backs);
    let mut views = Vec::new();
    for (i, &eye) in eyes.iter().enumerate() {
        for k in 0..DIRECTIONS {
            let wall = walls[i * DIRECTIONS + k].t;
            if !wall.is_finite() {
                continue;
            }
            // Half a metre before the wall, or a seventh of the way in a small model.
            let back = wall - (wall / 7.0).min(0.5f32.max(0.02 * size));
            let forward = (turn(k) - up * 0.12).normalize();
            views.push(named(eye - turn(k) * back, forward, up, INSIDE_ANGLE));
        }
    }
    views
}

/// Eyes around the whole, a little above.
fn outside(low: Vec3, high: Vec3, up: Vec3) -> Vec<View> {
    let across = up.any_orthonormal_vector();
    let along = up.cross(across);
    let (centre, radius) = (0.5 * (low + high), 0.5 * (high - low).length());
    // The corners of the bounds are rarely where the object is.
    let distance = 0.9 * radius / (0.5 * OUTSIDE_ANGLE).sin();
    let mut views = Vec::new();
    for k in 0..AROUND {
        let angle = k as f32 * std::f32::consts::TAU / AROUND as f32;
        for rise in [0.05, 0.45] {
            let away = (across * angle.cos() + along * angle.sin() + up * rise).normalize();
            views.push(named(centre + away * distance, -away, up, OUTSIDE_ANGLE));
        }
    }
    views
}

/// Places from which light comes, the strongest first; with a direction that it has everywhere.
fn lamps(scene: &Scene) -> Vec<(Vec3, bool)> {
    let mut found: Vec<(f32, Vec3, bool)> = Vec::new();
    for l in &scene.luminaires {
        match l.kind {
            LuminaireKind::Point { intensity, .. }
            | LuminaireKind::Spot { intensity, .. }
            | LuminaireKind::Lambertian { intensity } => {
                found.push((intensity.luminance(), l.position, false));
            }
            LuminaireKind::Directional { illuminance } => {
                let size = scene.diagonal();
                found.push((illuminance.luminance() * size * size, -l.direction, true));
            }
        }
    }
    // The largest triangle of an emitting surface stands for it.
    for s in &scene.surfaces {
        let Some(e) = &scene.finishes[s.finish.index()].emission else {
            continue;
        };
        let mut largest = (0.0, 0);
        let mut area = 0.0;
        for t in s.triangles.clone() {
            let a = scene.area(t as usize);
            area += a;
            if a > largest.0 {
                largest = (a, t);
            }
        }
        if largest.0 > 0.0 {
            let [a, b, c] = scene.corners(largest.1 as usize);
            // A hair in front of the emitter, so that it does not block the sight to itself.
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let centre = (a + b + c) / 3.0 + normal * 1e-3 * largest.0.sqrt();
            found.push((e.luminance.luminance() * area, centre, false));
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.iter().take(LIT_PLACES).map(|f| (f.1, f.2)).collect()
}

/// How good each view is.
fn judge(
    scene: &Scene,
    caster: &dyn RayCaster,
    views: &[View],
    lamps: &[(Vec3, bool)],
    size: f32,
) -> Vec<f32> {
    let rays: Vec<Ray> = views
        .iter()
        .flat_map(|v| {
            let right = v.forward.cross(v.up).normalize_or_zero();
            let up = right.cross(v.forward);
            let tall = (0.5 * v.vertical_angle).tan();
            (0..GRID[0] * GRID[1]).map(move |k| {
                let x = 2.0 * ((k % GRID[0]) as f32 + 0.5) / GRID[0] as f32 - 1.0;
                let y = 2.0 * ((k / GRID[0]) as f32 + 0.5) / GRID[1] as f32 - 1.0;
                ray(
                    v.eye,
                    (v.forward + right * (x * tall * ASPECT) + up * (y * tall)).normalize(),
                )
            })
        })
        .collect();
    let hits = cast(caster, &rays);
    // Sight from each hit to each lamp.
    let shadow: Vec<Ray> = rays
        .iter()
        .zip(&hits)
        .flat_map(|(r, h)| {
            let t = if h.is_hit() { h.t } else { 0.0 };
            let p = r.origin + r.direction * t - r.direction * (1e-4 * size);
            lamps.iter().map(move |&(lamp, is_direction)| Ray {
                origin: p,
                t_min: 0.0,
                direction: if is_direction { lamp * size } else { lamp - p },
                t_max: if is_direction { 4.0 } else { 1.0 },
            })
        })
        .collect();
    let mut free = vec![1.0; shadow.len()];
    caster.visibility(&shadow, &mut free);
    let mut scores = Vec::with_capacity(views.len());
    let n = GRID[0] * GRID[1];
    // From here on a thing can be looked at well.
    let comfortable = 0.8f32.max(0.03 * size).min(0.1 * size);
    for (v, view) in views.iter().enumerate() {
        let (mut sum, mut seen) = (0.0, Vec::with_capacity(n));
        for k in v * n..(v + 1) * n {
            let hit = &hits[k];
            if !hit.is_hit() {
                // Empty: neither lit nor ugly. Around an object there is much of it.
                sum += if view.vertical_angle == OUTSIDE_ANGLE {
                    0.15
                } else {
                    0.1
                };
                continue;
            }
            let triangle = hit.triangle as usize;
            let finish = scene.finish_of(triangle);
            if hit.side == Side::Back && !(finish.back_reflects || finish.back_emits) {
                sum -= 0.5;
                continue;
            }
            let lit = free[k * lamps.len()..(k + 1) * lamps.len()]
                .iter()
                .any(|&f| f > 0.5);
            let worth = if lit || finish.emission.is_some() {
                1.0
            } else {
                0.3
            };
            // Depth is better than a wall in the face.
            let near = (hit.t / comfortable).min(1.0);
            let deep = (hit.t / (0.5 * size)).min(1.0);
            sum += worth * near * (0.5 + 0.5 * deep);
            seen.push(scene.surface_of[triangle]);
        }
        // Many things are better than a bare wall: up to three quarters more for twelve surfaces.
        seen.sort_unstable();
        seen.dedup();
        let variety = (seen.len() as f32).min(12.0) / 16.0;
        scores.push(sum / n as f32 * (1.0 + variety));
    }
    scores
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use luxel_core::{Finish, Rgb};
    use luxel_scenes::Builder;

    #[test]
    fn a_room_is_seen_from_inside_at_eye_height() {
        let mut scene = testing::room();
        scene.luminaires.push(luxel_core::Luminaire {
            name: "lamp".into(),
            position: Vec3::new(2.5, 2.8, 2.0),
            direction: -Vec3::Y,
            kind: LuminaireKind::Point {
                intensity: Rgb::splat(100.0),
                range_m: f32::INFINITY,
            },
            group: luxel_core::GroupId(0),
        });
        let view = first_view(&scene, &testing::caster(&scene));
        let (low, high) = scene.bounds();
        assert!(
            view.eye.cmpgt(low).all() && view.eye.cmplt(high).all(),
            "{}",
            view.eye
        );
        assert!((view.eye.y - 1.6).abs() < 1e-3);
        // From near one wall to the far side: the longest way is 6.4 m.
        let mut hit = [Hit::MISS];
        testing::caster(&scene).closest(&[ray(view.eye, view.forward)], &mut hit);
        assert!(hit[0].t > 3.0, "{}", hit[0].t);
    }

    #[test]
    fn a_small_box_is_seen_through_its_open_side() {
        let mut b = Builder::new("box");
        let grey = b.matte("grey", 0.5, 0.5, 0.5);
        // All but the side at low z (the fifth of the six, see `Builder::room`).
        b.on("box", grey).room(Vec3::ZERO, Vec3::splat(0.5), 63);
        let mut scene = b.build();
        let keep: Vec<usize> = (0..scene.triangles.len())
            .filter(|&t| !scene.corners(t).iter().all(|p| p.z == 0.0))
            .collect();
        scene.triangles = keep.iter().map(|&t| scene.triangles[t]).collect();
        scene.surface_of.truncate(keep.len());
        scene.source_triangle.truncate(keep.len());
        scene.uvs.clear();
        scene.surfaces[0].triangles = 0..keep.len() as u32;
        assert_eq!(keep.len(), 10);
        let view = auto_view(&scene, &testing::caster(&scene));
        assert!(view.eye.z < 0.0 && view.forward.z > 0.8, "{view:?}");
    }

    #[test]
    fn an_object_in_the_open_is_seen_from_around_it() {
        let mut b = Builder::new("ball");
        let grey = b.matte("grey", 0.5, 0.5, 0.5);
        b.on("ball", grey)
            .ball(Vec3::new(7.0, 3.0, -2.0), 1.0, 8, 16);
        let scene = b.build();
        let view = auto_view(&scene, &testing::caster(&scene));
        let towards = Vec3::new(7.0, 3.0, -2.0) - view.eye;
        assert!(towards.length() > 2.0);
        assert!(view.forward.dot(towards.normalize()) > 0.99);
    }

    #[test]
    fn views_of_the_file_come_first_and_an_empty_scene_has_one() {
        let empty = Scene {
            up: Vec3::Z,
            ..Scene::default()
        };
        let caster = testing::caster(&testing::square(Finish::default()));
        assert!((auto_view(&empty, &caster).forward.length() - 1.0).abs() < 1e-5);
        let mut scene = testing::room();
        scene.views.push(named(Vec3::ONE, Vec3::X, Vec3::Y, 1.0));
        assert_eq!(first_view(&scene, &caster).eye, Vec3::ONE);
    }
}
