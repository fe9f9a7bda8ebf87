//! `irradiance_at` and `element_irradiance` against closed forms.

mod common;

use common::{Quad, cuboid, scene, solution};
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::*;
use luxel_gather::*;
use luxel_transport::lambert::point_to_polygon;
use luxel_transport::{Bvh, RayCaster};
use std::sync::Arc;

const FINE: Accuracy = Accuracy {
    relative: 0.002,
    floor_lux: 0.0,
    rays: [256, 8192],
    seed: 1,
};

fn at(position: [f32; 3], normal: [f32; 3]) -> Receiver {
    Receiver {
        position: position.into(),
        normal: Vec3::from(normal).normalize(),
    }
}

/// Direct light only: nothing is solved.
fn direct(
    scene: &Arc<Scene>,
    front: &Front,
    receivers: &[Receiver],
    accuracy: &Accuracy,
) -> Irradiance {
    let caster = Bvh::build(scene);
    let lights = DirectLights::new(scene, front);
    let solution = solution(scene, front, |_, _| 0.0);
    Gatherer::new(scene, front, &caster, &solution, &lights).irradiance_at(receivers, accuracy)
}

fn luminaire(kind: LuminaireKind) -> Luminaire {
    Luminaire {
        name: "lamp".into(),
        position: Vec3::new(0.0, 0.0, 3.0),
        direction: -Vec3::Z,
        kind,
        group: GroupId(0),
    }
}

/// A floor and one luminaire over it.
fn lamp_over_floor(kind: LuminaireKind) -> (Arc<Scene>, Front) {
    let floor = Quad::new([-9.0, -9.0, 0.0], [18.0, 0.0, 0.0], [0.0, 18.0, 0.0]);
    let (s, front) = scene(&[floor.reflecting(4)], 1);
    let mut s = Scene::clone(&s);
    s.luminaires.push(luminaire(kind));
    (Arc::new(s), front)
}

#[test]
fn furnace_gives_the_exitance_of_its_walls_exactly() {
    // In a closed room whose walls all send out B, every plane receives B: all rays bring the
    // same number, so there is no error but f32's. Walls that reflect all hold any B.
    let (s, mut front) = scene(
        &cuboid([0.0; 3], [4.0, 3.0, 2.5], true).map_all(|q| q.reflecting(5)),
        1,
    );
    front.reflectance.fill(Rgb::WHITE);
    let caster = Bvh::build(&s);
    let lights = DirectLights::new(&s, &front);
    let solution = solution(&s, &front, |_, _| 37.0);
    let gatherer = Gatherer::new(&s, &front, &caster, &solution, &lights);
    let receivers = [
        at([1.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
        at([2.0, 1.5, 1.2], [0.3, -0.5, 0.1]),
        at([4.0, 1.0, 2.0], [-1.0, 0.0, 0.0]),
        at([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]),
        at([1.0, 3.0, 1e-3], [0.0, -1.0, 0.0]),
    ];
    let e = gatherer.irradiance_at(&receivers, &FINE);
    for k in 0..receivers.len() {
        assert!(
            (e.lux(k) / 37.0 - 1.0).abs() < 1e-6,
            "receiver {k}: {}",
            e.lux(k)
        );
        assert_eq!(e.errors[k], 0.0);
    }
}

#[test]
fn luminous_furnace_is_exact_from_closed_forms() {
    // The same with walls that emit: the six factors of a box sum to 1.
    let room = cuboid([0.0; 3], [4.0, 3.0, 2.5], true).map_all(|q| q.emits(100.0));
    let (s, front) = scene(&room, 1);
    let receivers = [
        at([1.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
        at([2.0, 1.5, 1.2], [0.3, -0.5, 0.1]),
    ];
    let e = direct(&s, &front, &receivers, &FINE);
    for k in 0..2 {
        assert!(
            (e.lux(k) - 100.0).abs() < 1e-4,
            "receiver {k}: {}",
            e.lux(k)
        );
        assert_eq!(e.errors[k], 0.0, "all shadow rays are free");
    }
}

#[test]
fn point_follows_inverse_square_and_cosine() {
    // E = I cos / d^2, with 1000 cd 3 m over a floor.
    let (s, front) = lamp_over_floor(LuminaireKind::Point {
        intensity: Rgb::splat(1000.0),
        range_m: f32::INFINITY,
    });
    let places: [[f32; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [-2.0, 3.0, 0.0], [0.5, 0.5, 1.0]];
    let receivers = places.map(|p| at(p, [0.0, 0.0, 1.0]));
    let e = direct(&s, &front, &receivers, &FINE);
    for (k, p) in places.iter().enumerate() {
        let h = 3.0 - p[2] as f64;
        let d2 = (p[0] * p[0] + p[1] * p[1]) as f64 + h * h;
        let exact = 1000.0 * h / d2.powf(1.5);
        assert!((e.lux(k) as f64 / exact - 1.0).abs() < 1e-6, "at {p:?}");
        assert_eq!(e.errors[k], 0.0);
    }
    let beneath = direct(&s, &front, &[at([0.0, 0.0, -0.5], [0.0, 0.0, 1.0])], &FINE);
    assert_eq!(beneath.lux(0), 0.0, "the floor blocks from below");
}

#[test]
fn spot_has_the_edge_and_range_of_gltf() {
    // KHR_lights_punctual: clamp((cos - cos_outer) / (cos_inner - cos_outer), 0, 1) squared, and
    // window clamp(1 - (d / range)^4).
    let (inner, outer) = (0.9_f32, 0.8_f32);
    let kind = LuminaireKind::Spot {
        intensity: Rgb::splat(500.0),
        range_m: 6.0,
        cos_inner: inner,
        cos_outer: outer,
    };
    let (s, front) = lamp_over_floor(kind);
    let xs = [0.0, 1.0, 1.6, 1.9, 2.2, 2.3, 4.0];
    let receivers = xs.map(|x| at([x, 0.0, 0.0], [0.0, 0.0, 1.0]));
    let e = direct(&s, &front, &receivers, &FINE);
    for (k, x) in xs.iter().enumerate() {
        let d = (9.0 + (x * x) as f64).sqrt();
        let cos = 3.0 / d;
        let edge = ((cos - outer as f64) / (inner as f64 - outer as f64)).clamp(0.0, 1.0);
        let window = (1.0 - (d / 6.0).powi(4)).clamp(0.0, 1.0);
        let exact = 500.0 * cos / (d * d) * edge * edge * window;
        assert!(
            (e.lux(k) as f64 - exact).abs() < 1e-5 * exact.max(1e-3),
            "x {x}: {} {exact}",
            e.lux(k)
        );
    }
}

#[test]
fn sun_and_lambertian_lamp_follow_the_cosine() {
    // Lambertian: E = I cos^2 / d^2 straight between parallel planes; sun: E cos.
    let receivers = [
        at([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
        at([1.0, 0.0, 0.0], [1.0, 0.0, 1.0]),
    ];
    let (s, front) = lamp_over_floor(LuminaireKind::Lambertian {
        intensity: Rgb::splat(100.0),
    });
    let e = direct(&s, &front, &receivers, &FINE);
    assert!((e.lux(0) as f64 / (100.0 * 0.9 / 10.0) - 1.0).abs() < 1e-6);
    let (s, front) = lamp_over_floor(LuminaireKind::Directional {
        illuminance: Rgb::splat(50_000.0),
    });
    let e = direct(&s, &front, &receivers, &FINE);
    assert!((e.lux(0) / 50_000.0 - 1.0).abs() < 1e-6);
    assert!((e.lux(1) / (50_000.0 * 0.5_f32.sqrt()) - 1.0).abs() < 1e-6);
}

#[test]
fn free_panel_is_the_closed_form() {
    // No occluder: all shadow rays are free and the factor of [Lambert1760] stands, near, far,
    // from the panel's own edge and for a 5 mm source.
    let panel = Quad::new([-1.0, -0.5, 3.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]).emits(4000.0);
    let tiny = Quad::new([4.0, 4.0, 3.0], [0.0, 0.005, 0.0], [0.005, 0.0, 0.0]).emits(1e6);
    let (s, front) = scene(&[panel.clone(), tiny.clone()], 1);
    let receivers = [
        at([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
        at([0.2, 0.1, 2.95], [0.0, 0.0, 1.0]),
        at([0.2, 0.1, 2.95], [0.7, 0.0, 0.7]),
        at([3.0, 0.4, 2.5], [-1.0, 0.0, 0.2]),
        at([60.0, 0.0, 0.0], [-1.0, 0.0, 0.0]),
    ];
    let e = direct(&s, &front, &receivers, &FINE);
    for (k, r) in receivers.iter().enumerate() {
        let (p, n) = (r.position.as_dvec3(), r.normal.as_dvec3());
        let exact = 4000.0 * point_to_polygon(p, n, &panel.polygon())
            + 1e6 * point_to_polygon(p, n, &tiny.polygon());
        assert!(
            (e.lux(k) as f64 / exact - 1.0).abs() < 1e-5,
            "{k}: {} {exact}",
            e.lux(k)
        );
    }
}

#[test]
fn penumbra_of_a_plate_is_what_a_clipped_source_gives() {
    // A plate at half height over a panel, from x = -0.25 to 0.55: from x it hides the panel
    // between 2 * edge - x. Exact by clipping the panel there. Tolerance: 4 stated errors
    // (12 receivers) and 0.1 % of the unoccluded value where all first rays agree.
    let panel = |x0: f32, x1: f32| {
        Quad::new([x0, -0.3, 3.0], [0.0, 0.6, 0.0], [x1 - x0, 0.0, 0.0]).emits(4712.389)
    };
    let plate = Quad::new([-0.25, -2.0, 1.5], [0.8, 0.0, 0.0], [0.0, 4.0, 0.0]);
    let (s, front) = scene(&[panel(-0.5, 0.5), plate], 1);
    let xs = [
        -3.0, -1.2, -0.9, -0.6, -0.3, 0.0, 0.2, 0.8, 1.1, 1.4, 1.8, 3.0,
    ];
    let receivers = xs.map(|x| at([x, 0.1, 0.0], [0.0, 0.0, 1.0]));
    let e = direct(
        &s,
        &front,
        &receivers,
        &Accuracy {
            relative: 0.003,
            ..FINE
        },
    );
    for (k, r) in receivers.iter().enumerate() {
        let (p, n) = (r.position.as_dvec3(), DVec3::Z);
        let factor = |a: f32, b: f32| {
            if b > a {
                4712.389 * point_to_polygon(p, n, &panel(a, b).polygon())
            } else {
                0.0
            }
        };
        let (left, right) = (-0.5 - r.position.x, 1.1 - r.position.x);
        let exact = factor(-0.5, left.clamp(-0.5, 0.5)) + factor(right.clamp(-0.5, 0.5), 0.5);
        let slack = 4.0 * e.errors[k] as f64 + 1e-3 * factor(-0.5, 0.5);
        let (got, x) = (e.lux(k) as f64, xs[k]);
        assert!(
            (got - exact).abs() < slack,
            "x {x}: {got} should be {exact} +- {}",
            e.errors[k]
        );
        assert!(
            (got - exact).abs() <= 0.01 * exact,
            "x {x}: {got} should be {exact}"
        );
        if x == 0.0 || x == 0.2 {
            assert_eq!(got, 0.0, "umbra");
        }
    }
}

#[test]
fn slit_of_one_centimetre_lets_its_light_through() {
    // A 40 m emitter over two plates with a 1 cm gap, seen from 0.2 m beside the gap. Exact by
    // clipping the emitter to what the gap shows.
    let emitter = |x0: f32, x1: f32| {
        Quad::new([x0, -20.0, 3.0], [0.0, 40.0, 0.0], [x1 - x0, 0.0, 0.0]).emits(1000.0)
    };
    let left = Quad::new([-30.0, -30.0, 1.0], [29.995, 0.0, 0.0], [0.0, 60.0, 0.0]);
    let right = Quad::new([0.005, -30.0, 1.0], [29.995, 0.0, 0.0], [0.0, 60.0, 0.0]);
    let (s, front) = scene(&[emitter(-20.0, 20.0), left, right], 1);
    let e = direct(
        &s,
        &front,
        &[at([0.2, 0.0, 0.0], [0.0, 0.0, 1.0])],
        &Accuracy {
            relative: 0.003,
            rays: [256, 16_384],
            ..FINE
        },
    );
    let shown = emitter(0.2 - 3.0 * 0.205, 0.2 - 3.0 * 0.195).polygon();
    let exact = 1000.0 * point_to_polygon(DVec3::new(0.2, 0.0, 0.0), DVec3::Z, &shown);
    let got = e.lux(0) as f64;
    assert!(
        (got / exact - 1.0).abs() < 0.01,
        "{got} should be {exact}; stated {}",
        e.errors[0]
    );
}

#[test]
fn sky_gives_pi_times_its_luminance() {
    // Half space of sky over a floor that sends out nothing.
    let floor = Quad::new([-9.0, -9.0, 0.0], [18.0, 0.0, 0.0], [0.0, 18.0, 0.0]);
    let (s, front) = scene(&[floor.reflecting(2)], 2);
    let mut s = Scene::clone(&s);
    s.sky = Some(Sky {
        luminance: Rgb::splat(3000.0),
        group: GroupId(1),
    });
    let s = Arc::new(s);
    let e = direct(&s, &front, &[at([0.5, 0.5, 0.0], [0.0, 0.0, 1.0])], &FINE);
    assert!((e.lux(0) / (3000.0 * LAMBERTIAN) - 1.0).abs() < 1e-6);
    assert_eq!(e.values[..3], [0.0; 3], "in the layer of the sky only");
    assert_eq!(e.errors[0], 0.0);
}

#[test]
fn dark_side_of_a_wall_is_exactly_dark() {
    let mut quads = cuboid([0.0; 3], [3.0; 3], true).map_all(|q| q.reflecting(2));
    quads.extend(cuboid([3.0, 0.0, 0.0], [6.0, 3.0, 3.0], true).map_all(|q| q.reflecting(2)));
    quads.push(Quad::new([1.0, 1.0, 3.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]).emits(1e4));
    let (s, front) = scene(&quads, 1);
    let caster = Bvh::build(&s);
    let lights = DirectLights::new(&s, &front);
    // The lit room is solved, the other is dark.
    let solved = solution(&s, &front, |e, _| if e < 24 { 50.0 } else { 0.0 });
    let gatherer = Gatherer::new(&s, &front, &caster, &solved, &lights);
    let receivers: Vec<Receiver> = (0..60)
        .map(|k| {
            let t = k as f32 * 0.05;
            match k % 3 {
                0 => at([3.0, t, 0.0], [1.0, 0.0, 0.0]),
                1 => at([3.0, t, 3.0], [1.0, 0.2, -1.0]),
                _ => at([3.0 + t, 0.0, 3.0], [0.0, 0.0, -1.0]),
            }
        })
        .collect();
    let e = gatherer.irradiance_at(&receivers, &FINE);
    assert!(e.values.iter().all(|&v| v == 0.0));
    assert!(e.errors.iter().all(|&v| v == 0.0));
    let elements = lights.element_irradiance(&s, &front, &caster, &ElementDirect::default());
    assert!(elements[24 * 3..48 * 3].iter().all(|&v| v == 0.0));
    assert!(elements[..12].iter().all(|&v| v > 100.0), "the lit floor");
}

#[test]
fn a_hot_spot_on_the_ceiling_is_found_by_every_receiver() {
    // In an empty room a receiver sees M of the walls, and more by the exact factor of a spot
    // that covers 1/600 of the surface and sends out half of the light. All of it is the walls' own,
    // and they reflect nothing; emission that changes a hair over them all is met by rays.
    let mut quads =
        cuboid([0.0; 3], [4.0, 3.0, 2.5], true).map_all(|q| q.reflecting(5).emits(10.0));
    let spot = Quad::new([1.9, 1.4, 2.499], [0.0, 0.3, 0.0], [0.3, 0.0, 0.0]);
    let polygon = spot.polygon();
    quads.push(spot.reflecting(2).emits(6001.0));
    let (s, mut front) = scene(&quads, 1);
    front.reflectance.fill(Rgb::BLACK);
    for (e, emission) in front.emission.iter_mut().enumerate() {
        *emission *= 1.0 + 1e-4 * (e % 3) as f32;
    }
    let caster = Bvh::build(&s);
    let lights = DirectLights::new(&s, &front);
    assert!(lights.is_empty());
    let solved = solution(&s, &front, |e, c| front.emission[e].to_array()[c % 3]);
    let gatherer = Gatherer::new(&s, &front, &caster, &solved, &lights);
    let receivers: Vec<Receiver> = (0..200)
        .map(|k| {
            let f = |step: f32| 0.01 + 0.98 * (0.5 + k as f32 * step).fract();
            let (a, b) = (f(0.618), f(0.755));
            match k % 3 {
                0 => at([4.0 * a, 3.0 * b, 0.0], [0.0, 0.0, 1.0]),
                1 => at([0.0, 3.0 * a, 2.4 * b], [1.0, 0.0, 0.0]),
                _ => at([4.0 * a, 3.0 * b, 1.2], [0.3, 0.1, 0.7]),
            }
        })
        .collect();
    let asked = Accuracy {
        relative: 0.01,
        rays: [64, 16384],
        ..FINE
    };
    let got = gatherer.irradiance_at(&receivers, &asked);
    let mut chi = 0.0;
    for (k, r) in receivers.iter().enumerate() {
        let factor = point_to_polygon(r.position.as_dvec3(), r.normal.as_dvec3(), &polygon);
        let truth = 10.0 + 5991.0 * factor as f32;
        let error = got.lux(k) - truth;
        assert!(
            got.errors[k] <= 0.0101 * truth,
            "{k}: {}",
            got.errors[k] / truth
        );
        chi += (error / got.errors[k].max(1e-4 * truth)).powi(2) / receivers.len() as f32;
    }
    assert!(
        chi < 2.0,
        "errors are {} times as large as stated",
        chi.sqrt()
    );
    // By rays alone it would be about (1 - F) / F / 0.01^2, more than 100,000 each.
    assert!(got.rays < 2000 * 200, "{} rays a receiver", got.rays / 200);
}

/// A furnished room: box, table, cupboard, two lamps of two layers, a made-up solution.
fn furnished() -> (Arc<Scene>, Front, Solution) {
    let mut quads = cuboid([0.0; 3], [5.0, 4.0, 3.0], true).map_all(|q| q.reflecting(8));
    quads.extend(cuboid([1.0, 1.0, 0.7], [2.5, 2.0, 0.75], false).map_all(|q| q.reflecting(3)));
    quads.extend(cuboid([3.5, 2.5, 0.0], [4.5, 3.5, 1.8], false).map_all(|q| q.reflecting(3)));
    let lamp =
        |x: f32, y: f32| Quad::new([x, y, 2.9], [0.0, 0.6, 0.0], [0.6, 0.0, 0.0]).emits(5000.0);
    quads.push(lamp(1.0, 1.5));
    quads.push(lamp(3.2, 1.5).in_group(1));
    let (s, front) = scene(&quads, 2);
    // Any field will do: it varies from element to element and differs between the layers.
    let solved = solution(&s, &front, |e, c| {
        let n = (e as u32).wrapping_mul(2_654_435_761) >> 24;
        if c < 3 {
            20.0 + n as f32
        } else {
            60.0 + 0.3 * ((n * 7) % 256) as f32
        }
    });
    (s, front, solved)
}

fn scattered(n: usize) -> Vec<Receiver> {
    (0..n)
        .map(|k| {
            let f = |a: f32| (k as f32 * a + 0.37).fract();
            let (x, y) = (0.1 + 4.8 * f(0.754_877_7), 0.1 + 3.8 * f(0.569_840_3));
            match k % 3 {
                // Not under the cupboard, where nothing shines.
                0 => at([x.min(3.4), y, 0.0], [0.0, 0.0, 1.0]),
                1 => at([0.0, y, 3.0 * f(0.618_034)], [1.0, 0.0, 0.0]),
                _ => at([x, y, 2.1], [f(0.31) - 0.5, f(0.77) - 0.5, 0.5]),
            }
        })
        .collect()
}

#[test]
fn layers_are_separate_and_their_sum_is_the_total() {
    // The same room with one lamp's layer switched off gives the other layer unchanged, within
    // the errors of two runs that stop at different rays.
    let (s, front, solved) = furnished();
    let caster = Bvh::build(&s);
    let lights = DirectLights::new(&s, &front);
    let receivers = scattered(30);
    let both =
        Gatherer::new(&s, &front, &caster, &solved, &lights).irradiance_at(&receivers, &FINE);
    for layer in 0..2 {
        let mut only = front.clone();
        for e in 0..only.len() {
            if only.group(ElementId::from(e)) != GroupId(layer) {
                only.emission[e] = Rgb::BLACK;
            }
        }
        let lights = DirectLights::new(&s, &only);
        assert_eq!(lights.len(), 1);
        let mut part = solved.clone();
        for (i, b) in part.exitance.iter_mut().enumerate() {
            if (i % 6) / 3 != layer as usize {
                *b = 0.0;
            }
        }
        let one =
            Gatherer::new(&s, &only, &caster, &part, &lights).irradiance_at(&receivers, &FINE);
        for k in 0..receivers.len() {
            let l = layer as usize;
            let (a, b) = (
                both.values[6 * k + 3 * l + 1],
                one.values[6 * k + 3 * l + 1],
            );
            let error = both.layer_errors[2 * k + l].hypot(one.layer_errors[2 * k + l]);
            assert!(
                (a - b).abs() <= 5.0 * error + 1e-4 * a,
                "{k}: {a} {b} +- {error}"
            );
            assert_eq!(one.values[6 * k + 3 * (1 - l) + 1], 0.0);
        }
    }
}

#[test]
fn stated_errors_are_true() {
    // 200 receivers at moderate rays against 32 times as many. The mean square of error over
    // stated error is 1 by construction; with 200 heavy-tailed values its root lies in 0.7..1.3.
    let (s, front, solved) = furnished();
    let caster = Bvh::build(&s);
    let lights = DirectLights::new(&s, &front);
    let gatherer = Gatherer::new(&s, &front, &caster, &solved, &lights);
    let receivers = scattered(200);
    let rough = Accuracy {
        relative: 1e-6,
        floor_lux: 0.0,
        rays: [256, 256],
        seed: 3,
    };
    let got = gatherer.irradiance_at(&receivers, &rough);
    let truth = gatherer.irradiance_at(
        &receivers,
        &Accuracy {
            rays: [8192, 8192],
            seed: 4,
            ..rough
        },
    );
    let mut squares = [0.0_f64; 3];
    for k in 0..receivers.len() {
        let z = (got.lux(k) - truth.lux(k)) as f64
            / (got.errors[k] as f64).hypot(truth.errors[k] as f64);
        squares[0] += z * z / 200.0;
        for layer in 0..2 {
            let i = 2 * k + layer;
            let value = |e: &Irradiance| e.values[6 * k + 3 * layer + 1] as f64;
            let z = (value(&got) - value(&truth))
                / (got.layer_errors[i] as f64).hypot(truth.layer_errors[i] as f64);
            squares[1 + layer] += z * z / 200.0;
        }
    }
    for square in squares {
        assert!((0.7..1.3).contains(&square.sqrt()), "{squares:?}");
    }
}

#[test]
fn asked_accuracy_is_reached() {
    // 1 % asked, plenty of rays allowed: the root mean square against a reference is below.
    let (s, front, solved) = furnished();
    let caster = Bvh::build(&s);
    let lights = DirectLights::new(&s, &front);
    let gatherer = Gatherer::new(&s, &front, &caster, &solved, &lights);
    let receivers = scattered(40);
    let asked = Accuracy {
        relative: 0.01,
        floor_lux: 0.0,
        rays: [64, 65_536],
        seed: 5,
    };
    let got = gatherer.irradiance_at(&receivers, &asked);
    let truth = gatherer.irradiance_at(
        &receivers,
        &Accuracy {
            relative: 0.002,
            seed: 6,
            ..asked
        },
    );
    let mut square = 0.0;
    for k in 0..receivers.len() {
        assert!(got.errors[k] <= 0.01 * got.lux(k));
        square += ((got.lux(k) / truth.lux(k) - 1.0) as f64).powi(2) / receivers.len() as f64;
    }
    assert!(square.sqrt() < 0.012, "{}", square.sqrt());
}

#[test]
fn same_bits_for_any_threads_and_any_company() {
    let (s, front, solved) = furnished();
    let caster = Bvh::build(&s);
    let lights = DirectLights::new(&s, &front);
    let gatherer = Gatherer::new(&s, &front, &caster, &solved, &lights);
    let receivers = scattered(23);
    let accuracy = Accuracy {
        relative: 0.02,
        floor_lux: 0.0,
        rays: [64, 1024],
        seed: 9,
    };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| {
            let settings = ElementDirect {
                seed: 9,
                ..ElementDirect::default()
            };
            let elements = lights.element_irradiance(&s, &front, &caster, &settings);
            (gatherer.irradiance_at(&receivers, &accuracy), elements)
        })
    };
    let (one, elements) = run(1);
    let (three, again) = run(3);
    assert_eq!(one, three);
    assert_eq!(elements, again);
    let alone = gatherer.irradiance_at(&receivers[7..8], &accuracy);
    assert_eq!(alone.values[..], one.values[7 * 6..8 * 6]);
}

#[test]
fn elements_get_the_mean_of_the_closed_form() {
    // Direct irradiance of an element = exitance x factor, here through the mean over a fine
    // grid of points; 4 stratified points of a smooth function.
    let floor = Quad::new([0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]).reflecting(8);
    let panel = Quad::new([1.0, 1.0, 2.5], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]).emits(1000.0);
    let (s, front) = scene(&[floor, panel.clone()], 1);
    let caster = Bvh::build(&s);
    let lights = DirectLights::new(&s, &front);
    let e = lights.element_irradiance(&s, &front, &caster, &ElementDirect::default());
    let mut total = [0.0; 2];
    for element in 0..64 {
        let mut exact = 0.0;
        for i in 0..16 {
            for j in 0..16 {
                let uv = [(i as f32 + 0.5) / 16.0, (j as f32 + 0.5) / 16.0];
                let (p, n) = front.point_on(&s, ElementId(element), uv);
                exact +=
                    1000.0 * point_to_polygon(p.as_dvec3(), n.as_dvec3(), &panel.polygon()) / 256.0;
            }
        }
        let got = e[3 * element as usize + 1] as f64;
        // The factor varies by up to 25 % over half a metre here: an error of 1/4 of 1/4 of it.
        assert!((got / exact - 1.0).abs() < 0.04, "{element}: {got} {exact}");
        total[0] += got;
        total[1] += exact;
    }
    assert!((total[0] / total[1] - 1.0).abs() < 0.003, "{total:?}");
    assert_eq!(e[64 * 3..], [0.0; 3], "the panel does not light itself");
}

#[test]
fn many_lights_by_lottery_are_unbiased() {
    // 900 little panels over a table that shades: the lottery against every light one by one
    // (as 15 runs of 60 lights each, which are all taken singly by elements that ask 60).
    let mut quads = vec![
        Quad::new([9.0, 9.0, 0.0], [12.0, 0.0, 0.0], [0.0, 12.0, 0.0]).reflecting(12),
        Quad::new([10.0, 10.0, 1.0], [8.0, 0.0, 0.0], [0.0, 6.0, 0.0]),
    ];
    for k in 0..900 {
        let (x, y) = ((k % 30) as f32 + 0.3, (k / 30) as f32 + 0.3);
        let strength = 1000.0 * (1 + k % 5) as f32;
        quads.push(Quad::new([x, y, 3.0], [0.0, 0.1, 0.0], [0.1, 0.0, 0.0]).emits(strength));
    }
    let (s, front) = scene(&quads, 1);
    let caster = Bvh::build(&s);
    let lights = DirectLights::new(&s, &front);
    assert_eq!(lights.len(), 900);
    let settings = ElementDirect {
        weak_samples: 64,
        ..ElementDirect::default()
    };
    let by_lottery = lights.element_irradiance(&s, &front, &caster, &settings);
    let mut one_by_one = vec![0.0_f64; 144];
    for part in 0..15 {
        let mut few = front.clone();
        for e in 144..few.len() {
            if (e - 144) / 60 != part {
                few.emission[e] = Rgb::BLACK;
            }
        }
        let lights = DirectLights::new(&s, &few);
        let settings = ElementDirect {
            strong: 60,
            ..ElementDirect::default()
        };
        let e = lights.element_irradiance(&s, &front, &caster, &settings);
        for k in 0..144 {
            one_by_one[k] += e[3 * k + 1] as f64;
        }
    }
    let (mut a, mut b, mut square) = (0.0, 0.0, 0.0);
    for k in 0..144 {
        let (x, y) = (by_lottery[3 * k + 1] as f64, one_by_one[k]);
        a += x;
        b += y;
        square += (x - y) * (x - y) / 144.0;
    }
    // 64 draws from weak lights that vary by their half: less than 10 % an element, and the
    // mean over 144 elements 12 times better.
    assert!(
        square.sqrt() < 0.1 * b / 144.0,
        "{} of {}",
        square.sqrt(),
        b / 144.0
    );
    assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");

    // And at receivers, against their stated errors.
    let solved = solution(&s, &front, |_, _| 0.0);
    let gatherer = Gatherer::new(&s, &front, &caster, &solved, &lights);
    let receivers: Vec<Receiver> = (0..20)
        .map(|k| at([1.0 + 1.4 * k as f32, 13.0, 0.0], [0.0, 0.0, 1.0]))
        .collect();
    let rough = Accuracy {
        relative: 0.02,
        floor_lux: 0.0,
        rays: [256, 4096],
        seed: 2,
    };
    let got = gatherer.irradiance_at(&receivers, &rough);
    let mut square = 0.0;
    for (k, r) in receivers.iter().enumerate() {
        let mut exact = 0.0;
        for q in quads.iter().filter(|q| q.exitance > 0.0) {
            // Visible share on a 12 x 12 grid: an edge is uncertain by less than 1 / 24 of one
            // panel, and few panels are cut.
            let f = point_to_polygon(r.position.as_dvec3(), DVec3::Z, &q.polygon());
            let mut rays = Vec::new();
            for i in 0..144 {
                let x = q.corner
                    + q.u * (((i % 12) as f32 + 0.5) / 12.0)
                    + q.v * (((i / 12) as f32 + 0.5) / 12.0);
                let origin = r.position + Vec3::Z * 1e-4;
                let direction = x - origin;
                rays.push(luxel_transport::Ray {
                    origin,
                    t_min: 0.0,
                    direction,
                    t_max: 0.9999,
                });
            }
            let mut free = vec![0.0; rays.len()];
            caster.visibility(&rays, &mut free);
            exact += q.exitance as f64 * f * free.iter().sum::<f32>() as f64 / 144.0;
        }
        let z = (got.lux(k) as f64 - exact) / (got.errors[k] as f64 + 1e-3 * exact);
        square += z * z / 20.0;
    }
    assert!(square.sqrt() < 1.5, "{}", square.sqrt());
}

#[test]
fn light_baked_over_everything_is_left_to_the_solver() {
    // 150 emissive patches that are a third of all sides: not luminaire-like.
    let tiles: Vec<Quad> = (0..150)
        .map(|k| {
            let (x, y) = ((k % 15) as f32, (k / 15) as f32);
            Quad::new([x, y, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
                .emits(10.0)
                .reflecting(1)
        })
        .collect();
    let (s, front) = scene(&tiles, 1);
    let lights = DirectLights::new(&s, &front);
    assert!(lights.is_empty());
    assert!(!lights.is_direct(PatchId(0)));
    let few = scene(&tiles[..20], 1);
    let lights = DirectLights::new(&few.0, &few.1);
    assert_eq!(lights.len(), 20);
    assert!(lights.is_direct(PatchId(0)));
}

trait MapAll {
    fn map_all(self, f: impl Fn(Quad) -> Quad) -> Vec<Quad>;
}

impl MapAll for Vec<Quad> {
    fn map_all(self, f: impl Fn(Quad) -> Quad) -> Vec<Quad> {
        self.into_iter().map(f).collect()
    }
}
