use super::*;
use crate::testing;
use luxel_scenes::Builder;

fn settings(texel_m: f32) -> ChartSettings {
    ChartSettings {
        texel_m,
        most_texels: 1e6,
        largest_page: 2048,
        most_pages: 4,
    }
}

/// Charts of a scene with their light, asked of a function.
fn lit(
    scene: &Scene,
    front: &Front,
    texel_m: f32,
    lux: impl Fn(&Receiver) -> f32,
) -> (Charts, Lightmap) {
    let caster = testing::caster(scene);
    let charts = Charts::build(scene, front, Some(&caster), &settings(texel_m));
    let mut sparse = Sparse::new(&charts, 0.01);
    loop {
        let wanted = sparse.wanted();
        if wanted.is_empty() {
            break;
        }
        sparse.take(wanted.iter().map(|r| (Rgb::splat(lux(r)), 0.0)));
    }
    let lightmap = sparse.finish();
    (charts, lightmap)
}

/// Points spread over every triangle that has a chart: chart and point.
fn points(scene: &Scene, front: &Front, charts: &Charts) -> Vec<(u32, Vec3)> {
    let mut out = Vec::new();
    for t in 0..scene.triangles.len() {
        let [a, b, c] = scene.corners(t);
        let Some(chart) = charts.chart_at(front, t as u32, Side::Front) else {
            continue;
        };
        for (u, v) in [
            (0.02, 0.03),
            (0.3, 0.3),
            (0.9, 0.05),
            (0.05, 0.9),
            (0.5, 0.49),
            (0.11, 0.6),
        ] {
            out.push((chart, a + (b - a) * u + (c - a) * v));
        }
    }
    out
}

#[test]
fn linear_light_is_reproduced_everywhere_from_few_texels() {
    let scene = testing::room();
    let front = testing::front(&scene, 1.0, false);
    // Bilinear interpolation and its test are exact for a linear function, up to f32; places at the
    // edges are moved inwards by 5 mm, a difference of at most 0.05 lux.
    let light = |p: Vec3| 100.0 + 7.0 * p.x + 3.0 * p.y - 5.0 * p.z;
    let (charts, map) = lit(&scene, &front, 0.05, |r| light(r.position));
    assert_eq!(charts.len(), 6);
    for (chart, p) in points(&scene, &front, &charts) {
        let found = map.at(&charts, chart, p).0.luminance();
        assert!(
            (found - light(p)).abs() < 0.06,
            "{found} for {} at {p}",
            light(p)
        );
    }
    // 94 m² have 37,600 squares of 5 cm.
    assert!(
        (37_600..42_000).contains(&charts.used()),
        "{}",
        charts.used()
    );
    assert!(map.asked() < charts.used() / 20, "asked {}", map.asked());
}

/// A floor of 4 x 4 m, front up, parted by a wall of no thickness along x = 0, with a door between
/// z = 0.8 and z = 1.6 or without; cut along the wall's foot, as a session does.
fn parted_floor(door: bool) -> Scene {
    let mut b = Builder::new("parted");
    let grey = b.thin("grey", 0.5, 0.5, 0.5);
    let p = Vec3::new;
    b.on("floor", grey).polygon(&[
        p(-2.0, 0.0, 2.0),
        p(2.0, 0.0, 2.0),
        p(2.0, 0.0, -2.0),
        p(-2.0, 0.0, -2.0),
    ]);
    let ends = if door {
        vec![[-2.0, 0.8], [1.6, 2.0]]
    } else {
        vec![[-2.0, 2.0]]
    };
    b.on("wall", grey);
    for [z0, z1] in ends {
        b.polygon(&[
            p(0.0, 0.0, z0),
            p(0.0, 0.0, z1),
            p(0.0, 2.0, z1),
            p(0.0, 2.0, z0),
        ]);
    }
    let settings = luxel_mesh::PrepareSettings::for_mesh(&testing::mesh_settings(0.01, false));
    luxel_mesh::prepare(b.build(), &settings, &mut luxel_core::Warnings::default())
}

#[test]
fn no_light_passes_under_a_wall_not_even_a_texel() {
    for door in [false, true] {
        let scene = parted_floor(door);
        let front = testing::front(&scene, 0.1, false);
        let light = |r: &Receiver| if r.position.x > 0.0 { 1000.0 } else { 0.0 };
        // 7 cm: the wall's foot lies on no line of the lattice.
        let (charts, map) = lit(&scene, &front, 0.07, light);
        let mut seen = [0, 0];
        for (chart, p) in points(&scene, &front, &charts) {
            // At the door light goes over smoothly.
            if p.y != 0.0 || (door && (0.7..1.7).contains(&p.z)) {
                continue;
            }
            let found = map.at(&charts, chart, p).0.luminance();
            let right = p.x > 0.0;
            seen[right as usize] += 1;
            // Dark is exactly dark; weights that sum to 1 do so up to rounding.
            let expected = if right { 1000.0 } else { 0.0 };
            assert!(
                (found - expected).abs() <= 1e-6 * expected,
                "{found} at {p}, door {door}"
            );
        }
        assert!(seen[0] > 5 && seen[1] > 5);
    }
}

#[test]
fn charts_of_one_sheet_agree_where_they_meet() {
    let scene = parted_floor(true);
    let front = testing::front(&scene, 0.1, false);
    // In the door no wall is near: any continuous function must be continuous as shown.
    let light = |p: Vec3| 300.0 + 200.0 * (9.0 * p.x).sin() * (7.0 * p.z).cos();
    let (charts, map) = lit(&scene, &front, 0.07, |r| light(r.position));
    assert!(charts.len() >= 2);
    let mut steps = Vec::new();
    for joint in charts.pieces.joints.iter().filter(|j| !j.blocked) {
        let of = joint.pieces.map(|p| charts.chart_of[p as usize]);
        if of[0] == of[1] {
            continue;
        }
        let [p, q] = joint.ends;
        for k in 0..40 {
            // The reach of a texel from the ends, where the wall begins.
            let at = p + (q - p) * (0.1 + 0.8 * k as f32 / 39.0);
            let [a, b] = of.map(|c| map.at(&charts, c, at).0.luminance());
            steps.push((a - b).abs() / a.max(b));
        }
    }
    assert!(!steps.is_empty(), "the door parts the floor's charts");
    let worst = steps.iter().copied().fold(0.0, f32::max);
    assert!(worst < 1.0 / 255.0, "a step of {worst}");
}

#[test]
fn a_ball_is_smooth() {
    let mut b = Builder::new("ball");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    b.on("ball", grey).ball(Vec3::ZERO, 1.0, 24, 48);
    let scene = b.build();
    let all: Vec<u32> = (0..scene.triangles.len() as u32).collect();
    let mut front = Front::new(all.len());
    front.add_cluster(
        &scene,
        luxel_core::SurfaceId(0),
        Side::Front,
        luxel_core::GroupId::NONE,
        &all,
    );
    let light = |n: Vec3| 500.0 + 300.0 * n.y;
    let (charts, map) = lit(&scene, &front, 0.03, |r| light(r.normal));
    assert!(charts.len() < 24, "{} charts", charts.len());
    for (chart, p) in points(&scene, &front, &charts) {
        let found = map.at(&charts, chart, p).0.luminance();
        // Facets of 7.5 degrees: normals are interpolated within a percent.
        assert!(
            (found / light(p.normalize()) - 1.0).abs() < 0.03,
            "{found} at {p}"
        );
    }
}

#[test]
fn coordinates_lie_on_the_page_and_read_what_the_map_holds() {
    let scene = testing::room();
    let front = testing::front(&scene, 1.0, false);
    let light = |p: Vec3| 100.0 + 7.0 * p.x + 3.0 * p.y - 5.0 * p.z;
    let (charts, map) = lit(&scene, &front, 0.1, |r| light(r.position));
    let [w, h] = charts.pages()[0];
    let page = map.page(&charts, 0);
    assert_eq!(page.len(), (w * h) as usize);
    for (chart, p) in points(&scene, &front, &charts) {
        let uv = charts.uv_of(chart, p);
        // As graphics hardware reads it: centres at halves.
        let at = uv * Vec2::new(w as f32, h as f32) - 0.5;
        let (x, y) = (at.x.floor(), at.y.floor());
        let (s, t) = (at.x - x, at.y - y);
        let texel = |i: f32, j: f32| page[(j as u32 * w + i as u32) as usize].luminance();
        let read = (texel(x, y) * (1.0 - s) + texel(x + 1.0, y) * s) * (1.0 - t)
            + (texel(x, y + 1.0) * (1.0 - s) + texel(x + 1.0, y + 1.0) * s) * t;
        let held = map.at(&charts, chart, p).0.luminance();
        assert!((read - held).abs() < 0.02, "{read} for {held}");
    }
}

#[test]
fn a_step_of_light_is_asked_texel_by_texel_and_flat_light_is_not() {
    let scene = testing::room();
    let front = testing::front(&scene, 1.0, false);
    let step = |r: &Receiver| if r.position.x > 1.234 { 10.0 } else { 500.0 };
    let (charts, map) = lit(&scene, &front, 0.05, step);
    for (chart, p) in points(&scene, &front, &charts) {
        let found = map.at(&charts, chart, p).0.luminance();
        if (p.x - 1.234).abs() > 0.05 {
            let expected = if p.x > 1.234 { 10.0 } else { 500.0 };
            assert!((found - expected).abs() < 1e-3, "{found} at {p}");
        }
    }
    assert!(
        map.asked() < charts.used() / 4,
        "asked {} of {}",
        map.asked(),
        charts.used()
    );
}

#[test]
fn the_same_charts_for_any_thread_count() {
    let scene = parted_floor(true);
    let front = testing::front(&scene, 0.05, true);
    let build = |n| {
        testing::on_threads(n, || {
            let caster = testing::caster(&scene);
            let c = Charts::build(&scene, &front, Some(&caster), &settings(0.05));
            (c.receivers.clone(), c.pages.clone(), c.chart_of.clone())
        })
    };
    assert!(build(1) == build(4));
}

#[test]
fn wide_scenes_get_wide_texels_and_impossible_ones_none() {
    let scene = testing::room();
    let front = testing::front(&scene, 1.0, false);
    let few = ChartSettings {
        most_texels: 2_000.0,
        ..settings(0.01)
    };
    let charts = Charts::build(&scene, &front, None, &few);
    assert!(charts.texel_m() > 0.2, "94 m² in 2,000 texels");
    assert!(charts.used() < 4_000, "{}", charts.used());
    let none = ChartSettings {
        most_pages: 0,
        ..settings(0.01)
    };
    assert!(Charts::build(&scene, &front, None, &none).is_empty());
}
