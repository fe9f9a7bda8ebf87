//! Closed forms that Luxel knows itself: what `luxel verify` proves without any file.

use super::Count;
use super::solvers::System;
use crate::session::Session;
use crate::settings::Settings;
use luxel_core::quantity::{LAMBERTIAN, Lumens};
use luxel_core::{DVec3, Polygon, Vec3};
use luxel_gather::{Accuracy, Receiver};
use luxel_mesh::Kind as Mesh;
use luxel_scenes as scenes;
use luxel_solve::Kind as Solver;
use luxel_transport::lambert::point_to_polygon;
use luxel_transport::polygon_pair::polygon_to_polygon;

/// Elements of the furnaces: enough for every strategy, few enough for the dense solver.
const FURNACE_ELEMENTS: usize = 400;

pub(super) fn run(print: &mut dyn FnMut(&str)) -> Count {
    let mut count = Count::default();
    let mut check = |name: &str, expected: f64, got: f64, tolerance: f64| {
        let passed = (got - expected).abs() <= tolerance;
        let verdict = if passed { "pass" } else { "FAIL" };
        print(&format!(
            "{name} expected {expected:.7} got {got:.7} (within {tolerance:.1e}) {verdict}"
        ));
        count.passed += passed as usize;
        count.failed += !passed as usize;
    };
    kernels(&mut check);
    shelf(&mut check);
    furnaces(&mut check);
    lamps(&mut check);
    count
}

type Check<'a> = dyn FnMut(&str, f64, f64, f64) + 'a;

fn square(z: f64, up: bool) -> Polygon {
    let mut v = vec![
        DVec3::new(0.0, 0.0, z),
        DVec3::new(1.0, 0.0, z),
        DVec3::new(1.0, 1.0, z),
        DVec3::new(0.0, 1.0, z),
    ];
    if !up {
        v.reverse();
    }
    Polygon::new(v)
}

/// Factors known in closed form [Howell10]; rounding only.
fn kernels(check: &mut Check<'_>) {
    // C-11 at x = y = 1: opposite faces of a cube; what is left goes to four equal sides.
    let opposite = {
        let r = 2f64.sqrt();
        (2.0 / std::f64::consts::PI)
            * ((4.0f64 / 3.0).sqrt().ln() + 2.0 * r * (1.0 / r).atan() - 2.0 * 1f64.atan())
    };
    check(
        "factor: opposite faces of a cube",
        opposite,
        polygon_to_polygon(&square(0.0, true), &square(1.0, false)),
        1e-9,
    );
    let wall = Polygon::new(vec![
        DVec3::ZERO,
        DVec3::new(0.0, 1.0, 0.0),
        DVec3::new(0.0, 1.0, 1.0),
        DVec3::new(0.0, 0.0, 1.0),
    ]);
    check(
        "factor: faces of a cube that share an edge",
        0.25 * (1.0 - opposite),
        polygon_to_polygon(&square(0.0, true), &wall),
        1e-9,
    );
    // C-1 corner formula at a = b = c.
    let corner =
        2.0 * (1.0 / 2f64.sqrt()) * (1.0 / 2f64.sqrt()).atan() / (2.0 * std::f64::consts::PI);
    check(
        "factor: point under the corner of a square",
        corner,
        point_to_polygon(DVec3::ZERO, DVec3::Z, &square(1.0, false)),
        1e-12,
    );
}

/// The three-surface shelf at g = sqrt 3, one patch a surface: DESIGN and REFERENCES say where
/// the printed values err.
fn shelf(check: &mut Check<'_>) {
    let g = 3f64.sqrt();
    let ab = 0.5 * (1.0 + g - (1.0 + g * g).sqrt());
    let ac = (1.0 + g * g).sqrt() - g;
    let ba = 0.5 * (1.0 + 1.0 / g - (1.0 + 1.0 / (g * g)).sqrt());
    let factors = [vec![0.0, ab, ac], vec![ba, 0.0, ba], vec![ac, ab, 0.0]];
    let cases = [
        (
            [0.0, 0.5, 1.0 / 3.0],
            [1.0, 0.0, 0.0],
            [1.0, 0.1166030, 0.1035430],
        ),
        (
            [0.1, 0.5, 1.0 / 3.0],
            [1.0, 0.0, 0.0],
            [1.0070923, 0.1174300, 0.1042773],
        ),
        (
            [0.5, 0.0, 0.5],
            [0.0, 1.0, 0.0],
            [0.2113249, 1.0, 0.2113249],
        ),
        (
            [0.1, 0.1, 0.5],
            [1.0, 1.0, 0.0],
            [1.0464691, 1.0290572, 0.3285308],
        ),
    ];
    for (k, (rho, emission, expected)) in cases.into_iter().enumerate() {
        let b = System::new(&factors, &[1.0, g, 1.0], &rho, &emission).exitance();
        for (name, (e, got)) in ["A", "B", "C"].iter().zip(expected.iter().zip(b)) {
            // Seven printed digits.
            check(
                &format!("shelf {}: exitance of {name}", k + 1),
                *e,
                got,
                6e-8,
            );
        }
    }
}

/// A closed room of grey walls, all shining alike: B = E / (1 - rho) for any shape, any mesh,
/// any solver.
fn furnaces(check: &mut Check<'_>) {
    for mesh in Mesh::ALL {
        for solver in Solver::ALL {
            let settings = Settings {
                mesh,
                solver,
                error: 0.005,
                elements: Some(FURNACE_ELEMENTS),
                ..Settings::default()
            };
            let name = format!("furnace: {} mesh, {} solver", mesh.name(), solver.name());
            let Ok(mut session) = Session::new(scenes::furnace(0.5), &settings) else {
                check(&name, 2.0, f64::NAN, 0.0);
                continue;
            };
            session.by_ref().for_each(drop);
            let solution = session.solution();
            let front = session.front();
            let mean = (0..front.len())
                .map(|e| front.area[e] as f64 * session.leaving(&solution, e).value() as f64)
                .sum::<f64>()
                / front.total_area();
            // Stored factors carry the closure of sampled visibility; lines their noise.
            check(&name, 2.0, mean, 0.01);
        }
    }
}

/// An isotropic lamp in the middle of a cube: mean illuminance flux / (A (1 - rho)).
fn lamps(check: &mut Check<'_>) {
    let mut scene = scenes::closed_box(4.0, 4.0, 4.0, [0.5; 6]);
    scene.finishes.iter_mut().for_each(|f| f.emission = None);
    let (low, high) = scene.bounds();
    let centre = (low + high) * 0.5;
    let lamp = format!("10000lm@{},{},{}", centre.x, centre.y, centre.z);
    let expected = 10_000.0 / (6.0 * 16.0 * 0.5);
    if let Err(e) = luxel_io::scene_ops::add_lamp(&mut scene, &lamp) {
        return check(&format!("lamp in a cube: {e}"), expected, f64::NAN, 0.0);
    }
    let settings = Settings {
        error: 0.005,
        elements: Some(3000),
        ..Settings::default()
    };
    let Ok(mut session) = Session::new(scene, &settings) else {
        return check("lamp in a cube: mean illuminance", expected, f64::NAN, 0.0);
    };
    session.by_ref().for_each(drop);
    let solution = session.solution();
    let front = session.front();
    let flux: f64 = (0..front.len())
        .map(|e| front.area[e] as f64 * solution.total(e).luminance() as f64 / 0.5)
        .sum();
    check(
        "lamp in a cube: mean illuminance",
        expected,
        flux / front.total_area(),
        0.005 * expected,
    );

    let below = Receiver {
        position: centre + Vec3::NEG_Y * 1.0,
        normal: Vec3::Y,
    };
    let mut dark = solution.clone();
    dark.exitance.fill(0.0);
    let accuracy = Accuracy {
        relative: 1e-3,
        floor_lux: 0.0,
        rays: [64, 64],
        seed: 1,
    };
    let direct = session.irradiance_at(&dark, &[below], &accuracy);
    let candela = Lumens::new(10_000.0).isotropic_intensity().candela() as f64;
    let got = luxel_core::layers::luminance(&direct.values) as f64;
    // One metre under the lamp lux and candela are the same number; f32.
    check(
        "lamp in a cube: direct light one metre below",
        candela,
        got,
        1e-5 * candela,
    );
    let exitance =
        luxel_core::quantity::Luminance::new(luxel_core::Rgb::WHITE).lambertian_exitance();
    check(
        "exitance of 1 cd/m2",
        LAMBERTIAN as f64,
        exitance.value() as f64,
        1e-6,
    );
}
