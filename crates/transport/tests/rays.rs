//! The ray engine against a brute-force search, and what it promises at edges.

use luxel_core::{
    Alpha, DVec3, Finish, FinishId, Scene, Side, Surface, SurfaceId, Texture, TextureId, Vec2, Vec3,
};
use luxel_transport::{Bvh, Hit, Kernel, Ray, RayCaster};
use std::sync::Arc;

/// Numbers in 0..1 from a seed: a multiplicative congruential sequence [Steele21].
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(0xd1342543de82ef95).wrapping_add(1);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    fn point(&mut self, size: f32) -> Vec3 {
        (Vec3::new(self.next(), self.next(), self.next()) - 0.5) * size
    }
}

fn scene_of(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, finish: Finish) -> Scene {
    let n = triangles.len();
    Scene {
        positions,
        surface_of: vec![SurfaceId(0); n],
        source_triangle: (0..n as u32).collect(),
        surfaces: vec![Surface {
            name: "all".into(),
            finish: FinishId(0),
            triangles: 0..n as u32,
            node: u32::MAX,
            mesh: 0,
            primitive: 0,
        }],
        finishes: vec![finish],
        triangles,
        up: Vec3::Z,
        ..Scene::default()
    }
}

fn soup(count: usize, size: f32, seed: u64) -> Scene {
    let mut random = Random(seed);
    let mut positions = Vec::new();
    for _ in 0..count {
        let centre = random.point(10.0);
        for _ in 0..3 {
            positions.push(centre + random.point(size));
        }
    }
    let triangles = (0..count as u32)
        .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
        .collect();
    scene_of(positions, triangles, Finish::default())
}

fn rays(count: usize, seed: u64, t_max: f32) -> Vec<Ray> {
    let mut random = Random(seed);
    (0..count)
        .map(|_| Ray {
            origin: random.point(12.0),
            t_min: 0.0,
            direction: random.point(2.0),
            t_max,
        })
        .collect()
}

/// What a search over all triangles in f64 finds.
struct Found {
    t: f64,
    triangle: usize,
    weights: [f64; 3],
    side: Side,
}

/// Nearest crossing by the plane of each triangle, in f64. `None` beside `true`, or a crossing
/// beside `true`, where f32 with coordinates up to 12 could decide otherwise.
fn search(scene: &Scene, ray: &Ray) -> (Option<Found>, bool) {
    // Rounding of the engine is below 1e-5 of weights and distances here; ten times that.
    const DOUBT: f64 = 1e-4;
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let range = f64::from(ray.t_min)..=f64::from(ray.t_max);
    let mut best: Option<Found> = None;
    let mut doubtful = false;
    for triangle in 0..scene.triangles.len() {
        let [a, b, c] = scene.corners(triangle).map(|p| p.as_dvec3());
        let normal = (b - a).cross(c - a);
        let along = normal.dot(d);
        let t = normal.dot(a - o) / along;
        let p = o + d * t;
        let weight =
            |q: DVec3, r: DVec3| (r - q).cross(p - q).dot(normal) / normal.length_squared();
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let least = weights[0].min(weights[1]).min(weights[2]);
        let grazing = along.abs() < 0.02 * normal.length() * d.length();
        if least < -DOUBT && !grazing {
            continue;
        }
        doubtful |= least < DOUBT || grazing;
        doubtful |= (t - range.start()).abs() < DOUBT || (t - range.end()).abs() < DOUBT;
        if least >= 0.0 && range.contains(&t) {
            doubtful |= best.as_ref().is_some_and(|b| (b.t - t).abs() < DOUBT);
            if best.as_ref().is_none_or(|b| t < b.t) {
                let side = if along < 0.0 { Side::Front } else { Side::Back };
                best = Some(Found {
                    t,
                    triangle,
                    weights,
                    side,
                });
            }
        }
    }
    (best, doubtful)
}

/// The same scene for each kernel that runs here.
fn kernels(scene: &Arc<Scene>) -> Vec<Bvh> {
    let best = Bvh::build(scene);
    if best.kernel() == Kernel::Portable {
        eprintln!("skipped: no AVX2 on this processor, portable kernel only");
        return vec![best];
    }
    vec![best, Bvh::build(scene).into_portable()]
}

fn closest(bvh: &Bvh, rays: &[Ray]) -> Vec<Hit> {
    let mut hits = vec![Hit::MISS; rays.len()];
    bvh.closest(rays, &mut hits);
    hits
}

fn visibility(bvh: &Bvh, rays: &[Ray]) -> Vec<f32> {
    let mut visible = vec![f32::NAN; rays.len()];
    bvh.visibility(rays, &mut visible);
    visible
}

/// Whether two answers have the same bits.
fn same(a: &Hit, b: &Hit) -> bool {
    (
        a.t.to_bits(),
        a.triangle,
        a.u.to_bits(),
        a.v.to_bits(),
        a.side,
    ) == (
        b.t.to_bits(),
        b.triangle,
        b.u.to_bits(),
        b.v.to_bits(),
        b.side,
    )
}

#[test]
fn finds_what_a_search_over_all_triangles_finds() {
    let mut compared = 0;
    for (count, size, t_max) in [
        (1, 8.0, f32::INFINITY),
        (7, 6.0, 5.0),
        (300, 2.0, f32::INFINITY),
        (2000, 0.8, 6.0),
    ] {
        let scene = Arc::new(soup(count, size, count as u64));
        let rays = rays(1500, 99, t_max);
        for bvh in kernels(&scene) {
            let hits = closest(&bvh, &rays);
            let visible = visibility(&bvh, &rays);
            for ((ray, hit), visible) in rays.iter().zip(&hits).zip(&visible) {
                let (found, doubtful) = search(&scene, ray);
                assert_eq!(*visible, if hit.is_hit() { 0.0 } else { 1.0 }, "{ray:?}");
                if doubtful {
                    continue;
                }
                compared += 1;
                match found {
                    None => assert_eq!(*hit, Hit::MISS, "{ray:?}"),
                    Some(found) => {
                        assert_eq!(hit.triangle as usize, found.triangle, "{ray:?}");
                        assert_eq!(hit.side, found.side, "{ray:?}");
                        // f32 with coordinates up to 12 and slopes up to 50.
                        assert!((f64::from(hit.t) - found.t).abs() < 1e-3 * (1.0 + found.t));
                        assert!((f64::from(hit.u) - found.weights[1]).abs() < 1e-3);
                        assert!((f64::from(hit.v) - found.weights[2]).abs() < 1e-3);
                    }
                }
            }
        }
    }
    // Enough rays are beyond doubt, or the test would say little.
    assert!(compared > 4000, "{compared}");
}

#[test]
fn both_kernels_give_the_same_bits() {
    let scene = Arc::new(soup(20_000, 0.4, 5));
    let rays = rays(20_000, 6, f32::INFINITY);
    let [fast, portable] = &kernels(&scene)[..] else {
        return;
    };
    let pairs = closest(fast, &rays)
        .into_iter()
        .zip(closest(portable, &rays));
    assert_eq!(pairs.filter(|(a, b)| !same(a, b)).count(), 0);
    assert_eq!(visibility(fast, &rays), visibility(portable, &rays));
}

#[test]
fn tree_does_not_depend_on_the_number_of_threads() {
    let scene = Arc::new(soup(200_000, 0.1, 8));
    let rays = rays(2000, 9, f32::INFINITY);
    let built = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        let bvh = pool.install(|| Bvh::build(&scene));
        (bvh.bytes(), closest(&bvh, &rays))
    };
    let (one, three) = (built(1), built(3));
    assert_eq!(one.0, three.0);
    assert!(one.1.iter().zip(&three.1).all(|(a, b)| same(a, b)));
}

/// A ball around the origin whose vertices are shared, so that it is closed; `n` rings.
fn ball(n: u32, radius: f32, centre: Vec3) -> Scene {
    let around = 2 * n;
    let mut positions = vec![centre + Vec3::Z * radius, centre - Vec3::Z * radius];
    for j in 1..n {
        for i in 0..around {
            let (polar, angle) = (
                std::f32::consts::PI * j as f32 / n as f32,
                std::f32::consts::TAU * i as f32 / around as f32,
            );
            let ring = polar.sin();
            let unit = Vec3::new(ring * angle.cos(), ring * angle.sin(), polar.cos());
            positions.push(centre + radius * unit);
        }
    }
    let at = |i: u32, j: u32| match j {
        0 => 0,
        j if j == n => 1,
        j => 2 + (j - 1) * around + i % around,
    };
    let mut triangles = Vec::new();
    for j in 0..n {
        for i in 0..around {
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1));
            if a != b {
                triangles.push([a, b, d]);
            }
            if c != d {
                triangles.push([a, d, c]);
            }
        }
    }
    scene_of(positions, triangles, Finish::default())
}

/// A closed box of `n` by `n` squares a side, vertices shared.
fn closed_box(n: u32, low: Vec3, size: Vec3) -> Scene {
    let mut positions: Vec<Vec3> = Vec::new();
    let mut numbers = std::collections::HashMap::new();
    let mut triangles = Vec::new();
    let mut vertex = |k: [u32; 3]| {
        *numbers.entry(k).or_insert_with(|| {
            let share = Vec3::new(k[0] as f32, k[1] as f32, k[2] as f32) / n as f32;
            positions.push(low + size * share);
            positions.len() as u32 - 1
        })
    };
    for axis in 0..3 {
        for end in [0, n] {
            for i in 0..n {
                for j in 0..n {
                    let mut at = |i: u32, j: u32| {
                        let mut k = [end; 3];
                        k[(axis + 1) % 3] = i;
                        k[(axis + 2) % 3] = j;
                        vertex(k)
                    };
                    let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1));
                    triangles.extend([[a, b, d], [a, d, c]]);
                }
            }
        }
    }
    scene_of(positions, triangles, Finish::default())
}

#[test]
fn no_ray_slips_between_triangles_that_share_an_edge() {
    // From inside a closed surface every ray must strike something. Rays are aimed where it is
    // hardest: at vertices and at points of edges, as exactly as f32 can.
    let closed = [
        ball(24, 1.0, Vec3::ZERO),
        ball(24, 0.3, Vec3::new(100.0, -50.0, 20.0)),
        closed_box(9, Vec3::new(-1.0, 2.0, 5.0), Vec3::new(3.0, 2.0, 7.0)),
        closed_box(4, Vec3::splat(-0.1), Vec3::splat(1.0)),
    ];
    for scene in closed {
        let scene = Arc::new(scene);
        let (low, high) = scene.bounds();
        let centre = (low + high) * 0.5;
        let mut random = Random(3);
        for bvh in kernels(&scene) {
            // The portable kernel has the same bits (another test), so it gets fewer.
            let rounds = if bvh.kernel() == Kernel::Portable {
                1
            } else {
                40
            };
            for _ in 0..rounds {
                let origin = centre + random.point(0.7) * (high - low) * 0.5;
                let mut rays = Vec::new();
                for corners in &scene.triangles {
                    for k in 0..3 {
                        let a = scene.positions[corners[k] as usize];
                        let b = scene.positions[corners[(k + 1) % 3] as usize];
                        for target in [a, (a + b) * 0.5, a + (b - a) * random.next()] {
                            rays.push(Ray {
                                origin,
                                t_min: 0.0,
                                direction: target - origin,
                                t_max: f32::INFINITY,
                            });
                        }
                    }
                }
                let hits = closest(&bvh, &rays);
                let escaped = hits.iter().filter(|hit| !hit.is_hit()).count();
                assert_eq!(escaped, 0, "of {} rays", rays.len());
                // Struck where it was aimed at: t = 1 but for rounding of coordinates to 100 m
                // and slopes of the surface.
                assert!(hits.iter().all(|hit| (hit.t - 1.0).abs() < 2e-3));
                assert!(visibility(&bvh, &rays).iter().all(|&v| v == 0.0));
            }
        }
    }
}

#[test]
fn rays_along_axes_and_in_planes_of_boxes_are_struck() {
    // Zero components, both signs of zero, origins in the plane of box faces and edges.
    let scene = Arc::new(closed_box(8, Vec3::ZERO, Vec3::splat(8.0)));
    for bvh in kernels(&scene) {
        let mut rays = Vec::new();
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                for zero in [0.0, -0.0] {
                    for (i, j) in (1..8).flat_map(|i| (1..8).map(move |j| (i, j))) {
                        let mut origin = [4.0; 3];
                        origin[(axis + 1) % 3] = i as f32;
                        origin[(axis + 2) % 3] = j as f32;
                        let mut direction = [zero; 3];
                        direction[axis] = sign;
                        rays.push(Ray {
                            origin: origin.into(),
                            t_min: 0.0,
                            direction: direction.into(),
                            t_max: f32::INFINITY,
                        });
                    }
                }
            }
        }
        // Whole numbers: every product is exact, so the distance is exactly 4.
        assert!(closest(&bvh, &rays).iter().all(|hit| hit.t == 4.0));
    }
}

#[test]
fn range_is_open_at_the_start_and_closed_at_the_end() {
    let positions = vec![
        Vec3::new(-1.0, -1.0, 2.0),
        Vec3::new(3.0, -1.0, 2.0),
        Vec3::new(-1.0, 3.0, 2.0),
    ];
    let scene = Arc::new(scene_of(positions, vec![[0, 1, 2]], Finish::default()));
    for bvh in kernels(&scene) {
        let hit = |t_min: f32, t_max: f32| {
            let ray = Ray {
                origin: Vec3::ZERO,
                t_min,
                direction: Vec3::Z,
                t_max,
            };
            let hit = closest(&bvh, &[ray])[0];
            assert_eq!(
                visibility(&bvh, &[ray])[0],
                if hit.is_hit() { 0.0 } else { 1.0 }
            );
            hit.is_hit()
        };
        assert!(hit(0.0, 2.0) && hit(1.99, 5.0) && hit(f32::NEG_INFINITY, f32::INFINITY));
        assert!(!hit(2.0, 5.0) && !hit(0.0, 1.99) && !hit(3.0, 1.0));
        // Seen from above the corners turn counter-clockwise; the ray comes from below.
        let up = Ray {
            origin: Vec3::ZERO,
            t_min: 0.0,
            direction: Vec3::Z,
            t_max: 9.0,
        };
        let down = Ray {
            origin: Vec3::Z * 4.0,
            t_min: 0.0,
            direction: -Vec3::Z,
            t_max: 9.0,
        };
        let hits = closest(&bvh, &[up, down]);
        assert_eq!((hits[0].side, hits[1].side), (Side::Back, Side::Front));
        // The origin is 1/4 of the way along both edges from corner 0.
        assert_eq!((hits[0].u, hits[0].v), (0.25, 0.25));
    }
}

#[test]
fn offset_puts_rays_in_front_of_their_own_surface() {
    for (size, shift) in [(1.0, 0.0), (0.05, 0.0), (3.0, 1000.0)] {
        let mut scene = soup(3000, size, 21);
        scene.positions.iter_mut().for_each(|p| *p += shift);
        let scene = Arc::new(scene);
        let bvh = Bvh::build(&scene);
        let mut random = Random(22);
        let mut rays = Vec::new();
        for triangle in 0..scene.triangles.len() {
            let [a, b, c] = scene.corners(triangle);
            let (normal, u) = ((b - a).cross(c - a).normalize_or_zero(), random.next());
            let v = random.next() * (1.0 - u);
            let out = random.point(2.0);
            let origin = a * (1.0 - u - v) + b * u + c * v + normal * bvh.offset_m();
            let direction = if out.dot(normal) < 0.0 { -out } else { out };
            // Needles have no normal in f32; what grazes is not asked for.
            let fat = (b - a).cross(c - a).length() > 0.05 * (b - a).length() * (c - a).length();
            if fat && direction.dot(normal) > 1e-2 {
                rays.push((
                    triangle,
                    Ray {
                        origin,
                        t_min: 0.0,
                        direction,
                        t_max: f32::INFINITY,
                    },
                ));
            }
        }
        let hits = closest(&bvh, &rays.iter().map(|r| r.1).collect::<Vec<_>>());
        let own = hits
            .iter()
            .zip(&rays)
            .filter(|(hit, ray)| hit.triangle as usize == ray.0);
        assert_eq!(own.count(), 0, "of {} rays", rays.len());
    }
}

#[test]
fn nothing_one_and_many_of_the_same() {
    let up = Ray {
        origin: Vec3::new(0.1, 0.1, -1.0),
        t_min: 0.0,
        direction: Vec3::Z,
        t_max: 9.0,
    };
    let corners = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
    for count in [0, 1, 2, 9, 5000] {
        let scene = scene_of(corners.clone(), vec![[0, 1, 2]; count], Finish::default());
        for bvh in kernels(&Arc::new(scene)) {
            let hit = closest(&bvh, &[up])[0];
            // Of many at one distance the first counts.
            assert_eq!(hit.triangle, if count == 0 { Hit::NOTHING } else { 0 });
            assert_eq!(
                visibility(&bvh, &[up])[0],
                if count == 0 { 1.0 } else { 0.0 }
            );
            assert!(bvh.offset_m() > 0.0);
        }
    }
}

#[test]
fn sizes_from_tiny_to_huge_build_and_answer() {
    // Each triangle ten times as far and as large as the one before: the heuristic would peel
    // one off at a time. A ray from far must find the last. Up to 1e10 m all products stay
    // finite; beyond, areas and determinants overflow, and only an end is promised.
    for largest in [10, 38] {
        let mut positions = Vec::new();
        for k in -30..largest {
            let s = 10f32.powi(k);
            positions.extend([
                Vec3::new(-s, -s, s),
                Vec3::new(s, -s, s),
                Vec3::new(0.0, s, s),
            ]);
        }
        let triangles: Vec<[u32; 3]> = (0..positions.len() as u32 / 3)
            .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
            .collect();
        let last = triangles.len() as u32 - 1;
        let scene = Arc::new(scene_of(positions, triangles, Finish::default()));
        for bvh in kernels(&scene) {
            let down = Ray {
                origin: Vec3::new(0.0, 0.0, 3.0 * 10f32.powi(largest - 1)),
                t_min: 0.0,
                direction: -Vec3::Z,
                t_max: f32::INFINITY,
            };
            let hit = closest(&bvh, &[down])[0];
            assert!(largest == 38 || hit.triangle == last, "{hit:?}");
        }
    }
    // Many triangles in one place, in one plane and on one line of centroids.
    for stretch in [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0)] {
        let mut positions = Vec::new();
        for k in 0..3000 {
            let at = stretch * (k as f32 * 1e-3);
            positions.extend([at, at + Vec3::X, at + Vec3::Y]);
        }
        let triangles = (0..3000).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let bvh = Bvh::build(&Arc::new(scene_of(positions, triangles, Finish::default())));
        let up = Ray {
            origin: Vec3::new(0.2, 0.2, -1.0),
            t_min: 0.0,
            direction: Vec3::Z,
            t_max: 2.0,
        };
        assert_eq!(closest(&bvh, &[up])[0].t, 1.0);
    }
}

#[test]
fn rays_that_are_no_rays_meet_nothing() {
    let scene = Arc::new(soup(2000, 1.0, 4));
    let odd = [
        0.0,
        -0.0,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e-45,
        f32::MAX,
        1.0,
    ];
    for bvh in kernels(&scene) {
        let mut rays = Vec::new();
        for (i, &a) in odd.iter().enumerate() {
            for (j, &b) in odd.iter().enumerate() {
                let k = (i + j) % odd.len();
                rays.push(Ray {
                    origin: Vec3::ZERO,
                    t_min: 0.0,
                    direction: Vec3::new(a, b, odd[k]),
                    t_max: f32::INFINITY,
                });
                rays.push(Ray {
                    origin: Vec3::new(a, b, odd[k]),
                    t_min: 0.0,
                    direction: Vec3::X,
                    t_max: f32::INFINITY,
                });
                rays.push(Ray {
                    origin: Vec3::ZERO,
                    t_min: a,
                    direction: Vec3::X,
                    t_max: b,
                });
            }
        }
        let hits = closest(&bvh, &rays);
        let visible = visibility(&bvh, &rays);
        for ((ray, hit), visible) in rays.iter().zip(&hits).zip(&visible) {
            // Finite answers only, and the two questions agree.
            assert_eq!(*visible, if hit.is_hit() { 0.0 } else { 1.0 }, "{ray:?}");
            assert!(
                !hit.is_hit() || (hit.t.is_finite() && hit.u.is_finite() && hit.v.is_finite()),
                "{ray:?}"
            );
            let nonsense = !ray.origin.is_finite()
                || !ray.direction.is_finite()
                || ray.direction == Vec3::ZERO;
            assert!(!nonsense || *hit == Hit::MISS, "{ray:?}");
        }
    }
}

/// A stack of unit squares across z, one finish each, with a picture whose left half is clear.
fn panes(finishes: Vec<Finish>) -> Arc<Scene> {
    let mut scene = Scene {
        finishes,
        up: Vec3::Z,
        ..Scene::default()
    };
    for k in 0..scene.finishes.len() as u32 {
        let z = k as f32 + 1.0;
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            scene.positions.push(Vec3::new(x, y, z));
        }
        scene
            .triangles
            .extend([[4 * k, 4 * k + 1, 4 * k + 2], [4 * k, 4 * k + 2, 4 * k + 3]]);
        let corner = |x: f32, y: f32| Vec2::new(x, y);
        scene.uvs.extend([
            [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0)],
            [corner(0.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)],
        ]);
        scene.surface_of.extend([SurfaceId(k); 2]);
        scene.source_triangle.extend([0, 1]);
        scene.surfaces.push(Surface {
            name: format!("pane {k}"),
            finish: FinishId(k),
            triangles: 2 * k..2 * k + 2,
            node: u32::MAX,
            mesh: k,
            primitive: 0,
        });
    }
    let texel = |k: usize| {
        if k % 4 < 2 {
            [255, 255, 255, 0]
        } else {
            [255; 4]
        }
    };
    scene.textures.push(Texture {
        name: "half".into(),
        width: 4,
        height: 4,
        rgba: (0..16).map(texel).collect(),
        wrap: Default::default(),
    });
    Arc::new(scene)
}

fn up_through(x: f32, y: f32) -> Ray {
    Ray {
        origin: Vec3::new(x, y, 0.0),
        t_min: 0.0,
        direction: Vec3::Z,
        t_max: 100.0,
    }
}

#[test]
fn masked_texels_are_holes_and_clear_glass_is_not_there() {
    let mask = Finish {
        texture: Some(TextureId(0)),
        alpha: Alpha::Mask { cutoff: 0.5 },
        ..Finish::default()
    };
    let glass = Finish {
        transparent: true,
        ..Finish::default()
    };
    let scene = panes(vec![glass, mask, Finish::default()]);
    for bvh in kernels(&scene) {
        // Centres of the clear and of the opaque half, in both triangles of the squares.
        for (x, y, z) in [
            (0.3, 0.2, 3.0),
            (0.3, 0.8, 3.0),
            (0.7, 0.2, 2.0),
            (0.7, 0.8, 2.0),
        ] {
            assert_eq!(closest(&bvh, &[up_through(x, y)])[0].t, z, "{x} {y}");
            let short = Ray {
                t_max: 2.5,
                ..up_through(x, y)
            };
            assert_eq!(
                visibility(&bvh, &[short])[0],
                if z == 2.0 { 0.0 } else { 1.0 }
            );
        }
    }
}

#[test]
fn blended_surfaces_pass_their_share() {
    let blend = |coverage| Finish {
        alpha: Alpha::Blend,
        coverage,
        ..Finish::default()
    };
    let scene = panes(vec![blend(0.25), blend(0.5), blend(1.0)]);
    let mut random = Random(31);
    let rays: Vec<Ray> = (0..20_000)
        .map(|_| up_through(random.next(), random.next()))
        .collect();
    for bvh in kernels(&scene) {
        let two = Ray {
            t_max: 2.5,
            ..up_through(0.4, 0.3)
        };
        // (1 - 1/4) (1 - 1/2), and nothing through all three.
        assert_eq!(visibility(&bvh, &[two, up_through(0.4, 0.3)]), [0.375, 0.0]);
        // Stops in proportion: 1/4 at the first, 3/8 at the second, the rest at the third.
        let hits = closest(&bvh, &rays);
        for (z, share) in [(1.0, 0.25), (2.0, 0.375), (3.0, 0.375)] {
            let got = hits.iter().filter(|hit| (hit.t - z).abs() < 1e-5).count() as f64
                / rays.len() as f64;
            // Four standard deviations of a binomial share of 20,000.
            assert!(
                (got - share).abs() < 4.0 * (0.25f64 / 2e4).sqrt(),
                "{z}: {got}"
            );
        }
        // The same ray, the same answer, alone or in company.
        assert!(
            rays.iter()
                .zip(&hits)
                .take(500)
                .all(|(ray, hit)| same(&closest(&bvh, &[*ray])[0], hit))
        );
    }
}

/// Bundles of `count` segments between two small squares, of many sizes and directions.
fn bundles(random: &mut Random, bundles: usize, size: f32) -> Vec<Ray> {
    let mut segments = Vec::new();
    for bundle in 0..bundles {
        let mut from = random.point(size);
        let mut to = random.point(size);
        match bundle % 4 {
            // Along a diagonal, where the dominant axis changes within the bundle; along an
            // axis; from one point; anything.
            0 => to = from + Vec3::new(1.0, -1.0, 1.0) * (random.next() - 0.5) * size,
            1 => to.x = from.x,
            2 => from = from.round(),
            _ => {}
        }
        let width = 0.1 * size * random.next() * random.next();
        for _ in 0..1 + bundle % 21 {
            let origin = if bundle % 4 == 2 {
                from
            } else {
                from + random.point(width)
            };
            let end = to + random.point(width);
            let t_max = 0.5 + random.next();
            let direction = (end - origin) / t_max;
            segments.push(Ray {
                origin,
                t_min: 0.0,
                direction,
                t_max,
            });
        }
    }
    segments
}

#[test]
fn segments_in_company_get_the_answer_they_get_alone() {
    // Packets must not change a bit, whatever the mixture in a batch.
    let mut random = Random(41);
    let mut faded = soup(3000, 0.5, 43);
    faded.finishes[0] = Finish {
        alpha: Alpha::Blend,
        coverage: 0.5,
        ..Finish::default()
    };
    let scenes = [
        soup(30, 3.0, 42),
        soup(5000, 0.5, 43),
        faded,
        closed_box(20, Vec3::splat(-2.0), Vec3::splat(4.0)),
    ];
    for scene in scenes {
        let scene = Arc::new(scene);
        let segments = bundles(&mut random, 400, 10.0);
        let mut answers = Vec::new();
        for bvh in kernels(&scene) {
            let together = visibility(&bvh, &segments);
            let alone: Vec<f32> = segments
                .iter()
                .map(|segment| visibility(&bvh, &[*segment])[0])
                .collect();
            assert_eq!(together, alone);
            let free = alone.iter().filter(|&&v| v == 1.0).count();
            assert!(free > 0 && free < alone.len(), "both answers occur: {free}");
            answers.push(alone);
        }
        assert!(answers.iter().all(|a| *a == answers[0]));
    }
}
