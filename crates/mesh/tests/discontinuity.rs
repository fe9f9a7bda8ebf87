//! Shadow lines: where they lie, that hidden ones are not drawn, that cutting loses nothing, and
//! that any geometry comes through in bounded time.

mod common;

use common::{settings, v};
use luxel_core::{ElementId, LuminaireKind, Rgb, Scene, Vec3, Warnings};
use luxel_mesh::{Kind, MeshSettings, prepare};
use luxel_scenes::builder::Builder;
use proptest::prelude::*;
use std::time::{Duration, Instant};

fn prepared(scene: &Scene, kind: Kind, max_area_m2: f32) -> Scene {
    let mut warnings = Warnings::default();
    prepare(
        scene.clone(),
        &kind.prepare(&settings(max_area_m2)),
        &mut warnings,
    )
}

fn rectangle(x: [f32; 2], y: [f32; 2], z: f32) -> [Vec3; 4] {
    [
        v(x[0], y[0], z),
        v(x[1], y[0], z),
        v(x[1], y[1], z),
        v(x[0], y[1], z),
    ]
}

fn downwards(mut corners: [Vec3; 4]) -> [Vec3; 4] {
    corners.reverse();
    corners
}

/// A floor of 4 x 3 m. A strip light, x 1.8 to 2.2 m, 2.5 m above it, and `plates` that are as
/// wide as they are given and much longer than the floor.
fn strip_light(plates: &[([f32; 2], f32)]) -> Scene {
    let mut b = Builder::new("strip light");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    let thin = b.thin("thin", 0.5, 0.5, 0.5);
    let lamp = b.luminous("lamp", 0.0, 1000.0, Rgb::WHITE);
    b.on("floor", grey)
        .polygon(&rectangle([0., 4.], [0., 3.], 0.));
    for &(x, z) in plates {
        b.on("plate", thin).polygon(&rectangle(x, [-9., 12.], z));
    }
    b.on("lamp", lamp)
        .polygon(&downwards(rectangle([1.8, 2.2], [0.5, 2.5], 2.5)));
    b.build()
}

/// Area of the floor (the first surface) in triangles that reach more than `slack` m to both sides
/// of the line at `x`.
fn area_across(scene: &Scene, x: f32, slack: f32) -> f32 {
    scene.surfaces[0]
        .triangles
        .clone()
        .filter(|&t| {
            let c = scene.corners(t as usize);
            c.iter().any(|p| p.x < x - slack) && c.iter().any(|p| p.x > x + slack)
        })
        .map(|t| scene.area(t as usize))
        .sum()
}

#[test]
fn penumbra_of_a_strip_light_is_where_geometry_says() {
    // The edge at x = 2 m, 1 m high, before light that comes from 1.8 and 2.2 m, 2.5 m high:
    // x = 2 + (2 - x_light) * 1 / 1.5. The floor is 5 m across: 1e-4 of it.
    let scene = strip_light(&[([-30.0, 2.0], 1.0)]);
    let new = prepared(&scene, Kind::Discontinuity, 0.04);
    for x_light in [1.8, 2.2] {
        let x = 2.0 + (2.0 - x_light) / 1.5;
        assert_eq!(area_across(&new, x, 5e-4), 0.0, "limit at {x}");
        // Three times as far as allowed from it the floor is not parted.
        assert!(area_across(&new, x + 1.5e-3, 5e-4) > 0.0);
        // Points of the line itself lie on it to a tenth of that.
        let on = new
            .positions
            .iter()
            .filter(|p| p.z == 0.0 && (p.x - x).abs() < 5e-5);
        assert!(on.count() >= 2);
        let before = prepared(&scene, Kind::Adaptive, 0.04);
        assert!(area_across(&before, x, 5e-4) > 1.0);
    }
}

#[test]
fn shadow_of_a_square_before_a_point_is_one_square() {
    // 1 m wide, halfway up: 2 m wide on the floor, 4 m2 in elements that no border crosses.
    let mut b = Builder::new("square");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    let thin = b.thin("thin", 0.5, 0.5, 0.5);
    b.on("floor", grey)
        .polygon(&rectangle([-3., 3.], [-3., 3.], 0.));
    b.on("plate", thin)
        .polygon(&rectangle([-0.5, 0.5], [-0.5, 0.5], 1.));
    let kind = LuminaireKind::Point {
        intensity: Rgb::WHITE,
        range_m: f32::INFINITY,
    };
    b.luminaire("bulb", v(0., 0., 2.), v(0., 0., 0.), kind);
    let scene = b.build();
    let new = prepared(&scene, Kind::Discontinuity, 0.09);
    let front = Kind::Discontinuity.build(settings(0.09)).initial(&new);
    let (mut dark, mut lit) = (0.0, 0.0);
    for e in (0..front.len()).map(ElementId::from) {
        if front.surface(e).index() != 0 {
            continue;
        }
        let polygons = front.polygons(&new, e);
        let corners = || polygons.iter().flat_map(|p| &p.vertices);
        let far = |p: &luxel_core::DVec3| p.x.abs().max(p.y.abs());
        let inside = corners().all(|p| far(p) < 1.0 + 2e-4);
        // Outside of one and the same side of the square.
        let outside = (0..4).any(|side| {
            let sign = if side < 2 { 1.0 } else { -1.0 };
            corners().all(|p| sign * p.to_array()[side % 2] > 1.0 - 2e-4)
        });
        assert!(inside || outside || polygons.len() > 1, "element {e:?}");
        let area = front.area[e.index()];
        *(if inside { &mut dark } else { &mut lit }) += area;
    }
    // Lines are exact but for f32; elements tile both parts.
    assert!((dark - 4.0).abs() < 1e-3, "{dark} m2 of shadow");
    assert!((dark + lit - 36.0).abs() < 1e-3);
}

#[test]
fn hidden_events_draw_nothing() {
    // A second plate just below the first, wider by 1.5 m: the first one's lines fall on it.
    let both = strip_light(&[([-30.0, 2.0], 1.0), ([-30.0, 3.5], 0.9)]);
    let lower = strip_light(&[([-30.0, 3.5], 0.9)]);
    let floor = |scene: &Scene| {
        let new = prepared(scene, Kind::Discontinuity, 0.04);
        let floor = new.surfaces[0].triangles.clone();
        floor.map(|t| new.corners(t as usize)).collect::<Vec<_>>()
    };
    assert_eq!(floor(&both), floor(&lower));
}

#[test]
fn elements_between_lines_have_the_size_that_was_asked() {
    // 0.04 m2 on 12 m2 of floor: 300 elements uniformly. Lines cost some more, not many times more.
    let scene = strip_light(&[([-30.0, 2.0], 1.0)]);
    let new = prepared(&scene, Kind::Discontinuity, 0.04);
    let front = Kind::Discontinuity.build(settings(0.04)).initial(&new);
    let floor: Vec<usize> = (0..front.len())
        .filter(|&e| front.surface(ElementId::from(e)).index() == 0)
        .collect();
    let area: f32 = floor.iter().map(|&e| front.area[e]).sum();
    assert!((area - 12.0).abs() < 1e-3, "{area}");
    assert!((300..900).contains(&floor.len()), "{}", floor.len());
    assert!(floor.iter().all(|&e| front.area[e] < 0.0401));
}

#[test]
fn lines_do_not_depend_on_the_number_of_threads() {
    let scene = luxel_scenes::office();
    let mesh = MeshSettings::for_scene(&scene, 5000);
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool");
        pool.install(|| {
            let mut warnings = Warnings::default();
            let new = prepare(
                scene.clone(),
                &Kind::Discontinuity.prepare(&mesh),
                &mut warnings,
            );
            let front = Kind::Discontinuity.build(mesh).initial(&new);
            (new, front)
        })
    };
    let (one, three) = (build(1), build(3));
    assert!(one == three);
    let area = |s: &Scene| {
        (0..s.triangles.len())
            .map(|t| s.area(t) as f64)
            .sum::<f64>()
    };
    assert!((area(&one.0) - area(&scene)).abs() < 1e-4 * area(&scene));
    assert!(one.0.triangles.len() > scene.triangles.len() + 100);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    /// A soup of triangles that cross each other, some of them luminous, and a lamp anywhere.
    #[test]
    fn any_soup_is_cut_in_bounded_time_and_nothing_is_lost(
        shapes in prop::collection::vec(
            (prop::array::uniform3(-3i32..3), prop::array::uniform3(-3i32..3), prop::array::uniform3(-3i32..3), 0u8..4),
            1..24),
        lamp in prop::array::uniform3(-3i32..3),
        jitter in prop_oneof![Just(0.0f32), Just(1e-6), Just(1e-4), Just(0.13)],
        max_area in 0.02f32..1.0,
    ) {
        let mut b = Builder::new("soup");
        let thin = b.thin("thin", 0.5, 0.5, 0.5);
        let glow = b.luminous("glow", 0.3, 100.0, Rgb::WHITE);
        for (i, (p, q, r, kind)) in shapes.iter().enumerate() {
            // Whole coordinates make coplanar faces, shared edges and exact hits on purpose.
            let at = |a: &[i32; 3], k: usize| {
                let shift = jitter * ((i * 3 + k) % 7) as f32;
                v(a[0] as f32 + shift, a[1] as f32 - shift, a[2] as f32 + 0.5 * shift)
            };
            let (p, q, r) = (at(p, 0), at(q, 1), at(r, 2));
            prop_assume!((q - p).cross(r - p).length() > 1e-2);
            b.on(&format!("s{i}"), if *kind == 0 { glow } else { thin }).polygon(&[p, q, r]);
        }
        let [x, y, z] = lamp.map(|c| c as f32);
        let kind = LuminaireKind::Point { intensity: Rgb::WHITE, range_m: f32::INFINITY };
        b.luminaire("bulb", v(x, y, z), v(x, y, z - 1.0), kind);
        let scene = b.build();
        let start = Instant::now();
        let new = prepared(&scene, Kind::Discontinuity, max_area);
        let front = Kind::Discontinuity.build(settings(max_area)).initial(&new);
        // Milliseconds in fact; a loop without end or a square of the lines would show.
        prop_assert!(start.elapsed() < Duration::from_secs(20));
        for s in 0..scene.surfaces.len() {
            let area = |scene: &Scene| {
                scene.surfaces[s].triangles.clone().map(|t| scene.area(t as usize) as f64).sum::<f64>()
            };
            let (old, new) = (area(&scene), area(&new));
            // Corners rounded to f32 and slivers without area.
            prop_assert!((old - new).abs() < 1e-4 * old.max(0.1), "{old} m2, now {new}");
        }
        let normal = |scene: &Scene, t: u32| {
            let [a, b, c] = scene.corners(t as usize).map(|p| p.as_dvec3());
            (b - a).cross(c - a)
        };
        for (before, after) in scene.surfaces.iter().zip(&new.surfaces) {
            let whole = normal(&scene, before.triangles.start);
            let turned = after.triangles.clone().filter(|&t| normal(&new, t).dot(whole) <= 0.0);
            prop_assert_eq!(turned.count(), 0, "pieces face as the whole does");
        }
        for t in 0..new.triangles.len() {
            prop_assert!(front.patch_of[t].iter().any(|p| p.is_some()));
        }
    }
}
