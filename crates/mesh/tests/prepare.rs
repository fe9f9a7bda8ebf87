//! Contact lines: what was cut, that nothing was lost, and that no element lies on both sides.

mod common;

use common::{settings, v};
use luxel_core::{ElementId, Scene, Side, Vec3, Warnings};
use luxel_mesh::{Kind, MeshSettings, PrepareSettings, prepare};
use luxel_scenes::builder::Builder;
use proptest::prelude::*;
use std::collections::HashMap;

/// The reference case `leak-partition`: 4 x 3 x 2.5 m, partition at x = 2.
fn partitioned() -> Scene {
    let mut b = Builder::new("partition");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    let thin = b.thin("thin", 0.5, 0.5, 0.5);
    let lines: [(&str, [Vec3; 4]); 6] = [
        (
            "floor",
            [v(0., 0., 0.), v(4., 0., 0.), v(4., 3., 0.), v(0., 3., 0.)],
        ),
        (
            "ceiling",
            [
                v(0., 3., 2.5),
                v(4., 3., 2.5),
                v(4., 0., 2.5),
                v(0., 0., 2.5),
            ],
        ),
        (
            "x0",
            [v(0., 0., 0.), v(0., 3., 0.), v(0., 3., 2.5), v(0., 0., 2.5)],
        ),
        (
            "x1",
            [v(4., 0., 2.5), v(4., 3., 2.5), v(4., 3., 0.), v(4., 0., 0.)],
        ),
        (
            "y0",
            [v(0., 0., 2.5), v(4., 0., 2.5), v(4., 0., 0.), v(0., 0., 0.)],
        ),
        (
            "y1",
            [v(0., 3., 0.), v(4., 3., 0.), v(4., 3., 2.5), v(0., 3., 2.5)],
        ),
    ];
    for (name, points) in lines {
        b.on(name, grey).polygon(&points);
    }
    b.on("partition", thin).polygon(&[
        v(2., 0., 0.),
        v(2., 3., 0.),
        v(2., 3., 2.5),
        v(2., 0., 2.5),
    ]);
    b.build()
}

fn prepared(scene: &Scene, max_area_m2: f32) -> (Scene, Warnings) {
    let mut warnings = Warnings::default();
    let settings = PrepareSettings::for_mesh(&settings(max_area_m2));
    (prepare(scene.clone(), &settings, &mut warnings), warnings)
}

fn surface_areas(scene: &Scene) -> Vec<f64> {
    let mut areas = vec![0.0; scene.surfaces.len()];
    for (i, s) in scene.surfaces.iter().enumerate() {
        for t in s.triangles.clone() {
            assert_eq!(
                scene.surface_of[t as usize].index(),
                i,
                "triangles of a surface are one run"
            );
            areas[i] += scene.area(t as usize) as f64;
        }
    }
    areas
}

type Bits = [u32; 3];

/// Edges by position that only one triangle of their surface has.
fn open_edges(scene: &Scene, surface: usize) -> Vec<(Vec3, Vec3)> {
    let bits = |p: Vec3| -> Bits { (p + Vec3::ZERO).to_array().map(f32::to_bits) };
    let mut count: HashMap<(Bits, Bits), (i32, Vec3, Vec3)> = HashMap::new();
    for t in scene.surfaces[surface].triangles.clone() {
        let c = scene.corners(t as usize);
        for k in 0..3 {
            let (a, b) = (c[k], c[(k + 1) % 3]);
            let (key, sign) = if bits(a) < bits(b) {
                ((bits(a), bits(b)), 1)
            } else {
                ((bits(b), bits(a)), -1)
            };
            count.entry(key).or_insert((0, a, b)).0 += sign;
        }
    }
    count
        .into_values()
        .filter(|e| e.0 != 0)
        .map(|e| (e.1, e.2))
        .collect()
}

/// Every surface of `new` has the outline of `old` and no gap inside: an edge that one triangle
/// alone has lies on an edge that one triangle alone had, and their lengths agree.
fn assert_watertight(old: &Scene, new: &Scene) {
    for s in 0..old.surfaces.len() {
        let before = open_edges(old, s);
        let after = open_edges(new, s);
        let length = |e: &[(Vec3, Vec3)]| e.iter().map(|(a, b)| a.distance(*b) as f64).sum::<f64>();
        assert!(
            (length(&before) - length(&after)).abs() < 1e-4 * length(&before).max(1.0),
            "outline of {}: {} m before, {} m after",
            old.surfaces[s].name,
            length(&before),
            length(&after)
        );
        for (a, b) in after {
            let on = |p: Vec3, (c, d): (Vec3, Vec3)| {
                let t = ((p - c).dot(d - c) / (d - c).length_squared()).clamp(0.0, 1.0);
                p.distance(c + (d - c) * t) < 1e-5
            };
            assert!(
                before.iter().any(|&e| on(a, e) && on(b, e)),
                "an edge opened at {a} {b}"
            );
        }
    }
}

#[test]
fn partition_divides_floor_ceiling_and_walls() {
    let scene = partitioned();
    let (new, warnings) = prepared(&scene, 0.25);
    assert!(warnings.is_empty(), "{:?}", warnings);
    assert_watertight(&scene, &new);
    for (a, b) in surface_areas(&scene).iter().zip(surface_areas(&new)) {
        assert!((a - b).abs() < 1e-5 * a, "f32 rounding of a few corners");
    }
    for kind in Kind::ALL {
        let front = kind.build(settings(0.25)).initial(&new);
        for e in 0..front.len() {
            if front.normal(ElementId::from(e)).x.abs() > 0.5 {
                continue; // parallel to the partition
            }
            let xs: Vec<f64> = front
                .polygons(&new, ElementId::from(e))
                .iter()
                .flat_map(|p| p.vertices.iter().map(|v| v.x).collect::<Vec<_>>())
                .collect();
            // One unit in the last place of 2.0, from the sum origin + s * edge.
            let left = xs.iter().all(|&x| x <= 2.0 + 2.4e-7);
            let right = xs.iter().all(|&x| x >= 2.0 - 2.4e-7);
            assert!(
                left || right,
                "{}: element {e} lies on both sides: {xs:?}",
                kind.name()
            );
        }
        // Each of the four cut rectangles is two rectangles again, each side of the partition
        // and both end walls one: 4 * 2 + 2 + 2.
        let patches = front.patches.len();
        assert_eq!(patches, 12, "{}", kind.name());
    }
}

#[test]
fn hardly_a_line_is_left_to_cut_the_second_time() {
    // Groups and triangles of these scenes are in different orders, and many touch many.
    for scene in [luxel_scenes::two_rooms(), luxel_scenes::office()] {
        let mesh = MeshSettings::for_scene(&scene, 20_000);
        let settings = PrepareSettings::for_mesh(&mesh);
        let mut warnings = Warnings::default();
        let once = prepare(scene.clone(), &settings, &mut warnings);
        assert!(once.triangles.len() > scene.triangles.len());
        let twice = prepare(once.clone(), &settings, &mut warnings);
        let added = once.triangles.len() - scene.triangles.len();
        let again = twice.triangles.len() - once.triangles.len();
        // Pieces have corners of their own, so outlines grow together and past the least size.
        assert!(again * 3 < added, "{}: {added}, then {again}", scene.name);
    }
}

#[test]
fn scene_without_contacts_comes_back_as_it_was() {
    let scene = luxel_scenes::furnace::closed_box(2.0, 3.0, 2.5, [0.5; 6]);
    let (new, warnings) = prepared(&scene, 0.1);
    assert_eq!(new, scene);
    assert!(warnings.is_empty());
}

#[test]
fn small_things_do_not_cut_and_large_ones_do() {
    // A 5 cm leg and a 1 m box on a 6 x 6 m floor; elements of 0.25 m2, so contacts from
    // 0.5 m on count.
    for (size, cuts) in [(0.05, false), (1.0, true)] {
        let mut b = Builder::new("on the floor");
        let grey = b.matte("grey", 0.5, 0.5, 0.5);
        b.on("floor", grey).polygon(&[
            v(-3., -3., 0.),
            v(3., -3., 0.),
            v(3., 3., 0.),
            v(-3., 3., 0.),
        ]);
        b.on("box", grey)
            .block(v(0.2, 0.3, 0.0), v(0.2 + size, 0.3 + size, 0.5), u8::MAX);
        let scene = b.build();
        let (new, _) = prepared(&scene, 0.25);
        assert_eq!(
            new.triangles.len() > scene.triangles.len(),
            cuts,
            "{size} m"
        );
        assert_watertight(&scene, &new);
    }
}

#[test]
fn partition_that_ends_in_the_room_still_parts_elements() {
    // Both ends hang free: one line inside the floor that encloses nothing.
    let mut b = Builder::new("screen");
    let grey = b.thin("grey", 0.5, 0.5, 0.5);
    b.on("floor", grey)
        .polygon(&[v(0., 0., 0.), v(4., 0., 0.), v(4., 3., 0.), v(0., 3., 0.)]);
    b.on("screen", grey).polygon(&[
        v(2., 0.7, 0.),
        v(2., 2.1, 0.),
        v(2., 2.1, 1.),
        v(2., 0.7, 1.),
    ]);
    let scene = b.build();
    let (new, _) = prepared(&scene, 0.25);
    assert_watertight(&scene, &new);
    let front = Kind::Uniform.build(settings(0.25)).initial(&new);
    for e in 0..front.len() {
        if front.normal(ElementId::from(e)).z.abs() < 0.5 {
            continue;
        }
        for p in front.polygons(&new, ElementId::from(e)) {
            // Cut the polygon at y = 1.4, where the screen stands, and look at both sides.
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            let n = p.vertices.len();
            for i in 0..n {
                let (a, c) = (p.vertices[i], p.vertices[(i + 1) % n]);
                if (a.y - 1.4) * (c.y - 1.4) <= 0.0 && a.y != c.y {
                    let x = a.x + (c.x - a.x) * (1.4 - a.y) / (c.y - a.y);
                    low = low.min(x);
                    high = high.max(x);
                }
            }
            assert!(
                low > high || high <= 2.0 + 1e-6 || low >= 2.0 - 1e-6,
                "{low}..{high}"
            );
        }
    }
}

#[test]
fn line_along_the_diagonal_of_a_floor_is_not_joined_again() {
    let mut b = Builder::new("diagonal");
    let grey = b.thin("grey", 0.5, 0.5, 0.5);
    b.on("floor", grey)
        .polygon(&[v(0., 0., 0.), v(3., 0., 0.), v(3., 3., 0.), v(0., 3., 0.)]);
    b.on("wall", grey)
        .polygon(&[v(0., 0., 0.), v(3., 3., 0.), v(3., 3., 1.), v(0., 0., 1.)]);
    b.on("cross", grey)
        .polygon(&[v(3., 0., 0.), v(0., 3., 0.), v(0., 3., -1.), v(3., 0., -1.)]);
    let scene = b.build();
    let (new, _) = prepared(&scene, 4.0);
    assert_watertight(&scene, &new);
    let front = Kind::Uniform.build(settings(4.0)).initial(&new);
    // Four triangles, two sides each.
    let floor = front
        .patches
        .iter()
        .filter(|p| p.normal.z.abs() > 0.5)
        .count();
    assert_eq!(floor, 8);
}

#[test]
fn line_that_ends_on_another_closes_the_gap() {
    // Two screens in T, turned so that the foot of the T ends 30 micrometres short of the bar or
    // as much beyond it. The three rooms must stay apart: a hair-thin piece that joined two of
    // them would let a patch span the foot.
    for gap in [3e-5, 0.0, -3e-5] {
        let turn = glam::Mat3::from_rotation_z(0.37);
        let mut b = Builder::new("T");
        let grey = b.thin("grey", 0.5, 0.5, 0.5);
        let at = |x: f32, y: f32, z: f32| turn * v(x, y, z);
        b.on("floor", grey).polygon(&[
            at(-2., 0., 0.),
            at(2., 0., 0.),
            at(2., 3., 0.),
            at(-2., 3., 0.),
        ]);
        b.on("bar", grey).polygon(&[
            at(-2., 2., 0.),
            at(2., 2., 0.),
            at(2., 2., 1.),
            at(-2., 2., 1.),
        ]);
        let end = 2.0 - gap;
        b.on("foot", grey).polygon(&[
            at(0.3, 0., 0.),
            at(0.3, end, 0.),
            at(0.3, end, 1.),
            at(0.3, 0., 1.),
        ]);
        let scene = b.build();
        let (new, _) = prepared(&scene, 0.25);
        // The pieces of a T are large; a gap left open would be filled by one of 4 m x 30 um.
        let floor = new.surfaces[0].triangles.clone();
        assert!(
            floor.clone().all(|t| new.area(t as usize) > 1e-2),
            "gap {gap}"
        );
        assert_watertight(&scene, &new);
        let front = Kind::Uniform.build(settings(0.25)).initial(&new);
        for e in 0..front.len() {
            if front.normal(ElementId::from(e)).z.abs() < 0.5 {
                continue;
            }
            let back = turn.transpose().as_dmat3();
            let points: Vec<glam::DVec3> = front
                .polygons(&new, ElementId::from(e))
                .iter()
                .flat_map(|p| p.vertices.iter().map(|v| back * *v).collect::<Vec<_>>())
                .collect();
            // 0.2 mm: the tolerance of contacts.
            let within = |low: f64, high: f64, of: &dyn Fn(&glam::DVec3) -> f64| {
                points
                    .iter()
                    .all(|p| of(p) > low - 2e-4 && of(p) < high + 2e-4)
            };
            let (x, y) = (|p: &glam::DVec3| p.x, |p: &glam::DVec3| p.y);
            let behind = within(2.0, 3.0, &y);
            let before = within(0.0, 2.0, &y) && (within(-2.0, 0.3, &x) || within(0.3, 2.0, &x));
            assert!(
                behind || before,
                "gap {gap}: element {e} spans two rooms: {points:?}"
            );
        }
    }
}

#[test]
fn rug_in_the_floor_is_reported() {
    let mut b = Builder::new("rug");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    b.on("floor", grey)
        .polygon(&[v(0., 0., 0.), v(4., 0., 0.), v(4., 3., 0.), v(0., 3., 0.)]);
    b.on("rug", grey)
        .polygon(&[v(1., 1., 0.), v(2., 1., 0.), v(2., 2., 0.), v(1., 2., 0.)]);
    let (_, warnings) = prepared(&b.build(), 0.25);
    assert_eq!(warnings.len(), 1);
}

#[test]
fn texture_coordinates_are_interpolated() {
    let mut scene = partitioned();
    // u = x / 4, v = y / 3 on every triangle.
    scene.uvs = (0..scene.triangles.len())
        .map(|t| {
            scene
                .corners(t)
                .map(|p| luxel_core::Vec2::new(p.x / 4.0, p.y / 3.0))
        })
        .collect();
    let (new, _) = prepared(&scene, 0.25);
    assert_eq!(new.uvs.len(), new.triangles.len());
    for t in 0..new.triangles.len() {
        for (p, uv) in new.corners(t).iter().zip(new.uvs[t]) {
            assert!((uv.x - p.x / 4.0).abs() < 1e-6 && (uv.y - p.y / 3.0).abs() < 1e-6);
        }
    }
}

#[test]
fn too_many_lines_are_reported() {
    let scene = partitioned();
    let mut warnings = Warnings::default();
    let settings = PrepareSettings {
        max_lines: 0,
        ..PrepareSettings::for_mesh(&settings(0.25))
    };
    prepare(scene, &settings, &mut warnings);
    assert!(
        warnings.iter().any(|w| w.what.contains("too many")),
        "{warnings:?}"
    );
}

/// A thousand large triangles in one box, each across hundreds of others: pieces stay in
/// proportion to the area in elements, and areas stay.
#[test]
fn a_thicket_of_large_triangles_is_cut_within_bounds() {
    let mut at = 1u32;
    let mut random = || {
        at = at.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (at >> 8) as f32 / (1 << 24) as f32
    };
    let mut b = Builder::new("thicket");
    let thin = b.thin("thin", 0.5, 0.5, 0.5);
    for _ in 0..1000 {
        let corner = |_| v(random(), random(), random());
        let points: [Vec3; 3] = [0, 1, 2].map(corner);
        b.on("triangle", thin).polygon(&points);
    }
    let scene = b.build();
    let (new, warnings) = prepared(&scene, 0.1);
    let elements = surface_areas(&scene).iter().sum::<f64>() / 0.1;
    let (before, after) = (scene.triangles.len(), new.triangles.len());
    assert!(
        after > 2 * before && (after as f64) < 100.0 * elements,
        "{before} -> {after}, {elements} elements"
    );
    let told = |what: &str| warnings.iter().any(|w| w.what.contains(what));
    assert!(told("too many on one triangle"), "{warnings:?}");
    for (a, b) in surface_areas(&scene).iter().zip(surface_areas(&new)) {
        assert!((a - b).abs() < 1e-4 * a.max(1e-3), "{a} {b}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Boxes and screens anywhere in a tilted room: the outline and the area of every surface
    /// stay, nothing opens, and no cut line runs through the inside of a piece.
    #[test]
    fn random_furniture_leaves_no_gap(
        boxes in prop::collection::vec((0.0f32..3.0, 0.0f32..3.0, 0.1f32..1.5, 0.1f32..1.5, -0.2f32..0.2, 0.0f32..6.3), 1..7),
        angle in 0.0f32..1.5,
        snap in prop::bool::ANY,
    ) {
        let tilt = glam::Mat3::from_euler(glam::EulerRot::XYZ, angle, 0.3 * angle, 0.7 * angle);
        // On a grid of 0.25 m many corners and lines coincide.
        let q = |x: f32| if snap { (x * 4.0).round() / 4.0 } else { x };
        let mut b = Builder::new("random");
        let grey = b.thin("grey", 0.5, 0.5, 0.5);
        let put = |points: [Vec3; 4]| points.map(|p| tilt * p);
        b.on("floor", grey).polygon(&put([v(0., 0., 0.), v(3., 0., 0.), v(3., 3., 0.), v(0., 3., 0.)]));
        b.on("wall", grey).polygon(&put([v(0., 0., 0.), v(0., 3., 0.), v(0., 3., 2.), v(0., 0., 2.)]));
        for (i, &(x, y, w, d, z, turn)) in boxes.iter().enumerate() {
            let (x, y, w, d) = (q(x), q(y), q(w).max(0.25), q(d).max(0.25));
            let z = if snap { 0.0 } else { z };
            let turn = glam::Mat3::from_rotation_z(if snap { 0.0 } else { turn });
            let at = |a: f32, c: f32, h: f32| tilt * (v(x, y, z) + turn * v(a, c, h));
            let name = format!("box {i}");
            b.on(&name, grey)
                .polygon(&[at(0., 0., 0.), at(w, 0., 0.), at(w, 0., 1.), at(0., 0., 1.)])
                .polygon(&[at(w, 0., 0.), at(w, d, 0.), at(w, d, 1.), at(w, 0., 1.)])
                .polygon(&[at(w, d, 0.), at(0., d, 0.), at(0., d, 1.), at(w, d, 1.)])
                .polygon(&[at(0., d, 0.), at(0., 0., 0.), at(0., 0., 1.), at(0., d, 1.)]);
        }
        let scene = b.build();
        let (new, warnings) = prepared(&scene, 0.05);
        prop_assert!(!warnings.iter().any(|w| w.what.contains("could not")), "{:?}", warnings);
        assert_watertight(&scene, &new);
        for (a, b) in surface_areas(&scene).iter().zip(surface_areas(&new)) {
            // Corners rounded to f32, 1e-7 of 4 m along every cut.
            prop_assert!((a - b).abs() < 1e-4 * a, "{} {}", a, b);
        }
        // Points just left and right of a contact line of the first box lie on different elements.
        let front = Kind::Uniform.build(settings(0.05)).initial(&new);
        let floor = new.surfaces[0].triangles.clone();
        let inside = |t: u32, p: Vec3| {
            let [a, b, c] = new.corners(t as usize);
            let n = (b - a).cross(c - a);
            [(a, b), (b, c), (c, a)].iter().all(|&(a, b)| (b - a).cross(p - a).dot(n) > 0.0)
        };
        let find = |p: Vec3| {
            floor.clone().find(|&t| inside(t, p)).and_then(|t| front.element_at(t as usize, Side::Front, p))
        };
        let (x, y, w, d, z, turn) = boxes[0];
        let (x, y, w, d) = (q(x), q(y), q(w).max(0.25), q(d).max(0.25));
        if (snap || z <= 0.0) && w.max(d) > 0.3 {
            let turn = glam::Mat3::from_rotation_z(if snap { 0.0 } else { turn });
            for share in [0.21, 0.5, 0.83] {
                // 2 mm on both sides: ten times the tolerance.
                let at = |a: f32, c: f32| tilt * (v(x, y, 0.0) + turn * v(a, c, 0.0));
                let pairs = [
                    (at(w * share, -0.002), at(w * share, 0.002)),
                    (at(w - 0.002, d * share), at(w + 0.002, d * share)),
                ];
                for (p, r) in pairs {
                    if let (Some(e), Some(f)) = (find(p), find(r)) {
                        prop_assert!(e != f, "one element on both sides at {}", p);
                    }
                }
            }
        }
    }
}
