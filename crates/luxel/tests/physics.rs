//! What must hold for any scene, mesh and solver: whole sessions from scene to illuminance.

use luxel::{Accuracy, MeshKind, Receiver, Scene, Session, Settings, SolverKind, Vec3};
use luxel_core::layers::luminance;

/// Accuracy asked of the solvers here; noise of 1 % is far inside the tolerances below.
const ASKED: f64 = 0.01;

fn settings(elements: usize) -> Settings {
    Settings {
        error: ASKED,
        elements: Some(elements),
        ..Settings::default()
    }
}

fn solved(scene: Scene, settings: &Settings) -> Session {
    let mut session = Session::new(scene, settings).expect("a scene that can be solved");
    session.by_ref().for_each(drop);
    session
}

/// Illuminance at a few receivers well inside a box room of 4 x 3 x 2.5 m, lux.
fn probe(session: &Session, receivers: &[Receiver]) -> Vec<f32> {
    let accuracy = Accuracy {
        relative: 2e-3,
        floor_lux: 0.0,
        rays: [1024, 1 << 15],
        seed: 3,
    };
    let answer = session.irradiance_at(&session.solution(), receivers, &accuracy);
    answer
        .values
        .chunks_exact(answer.columns)
        .map(luminance)
        .collect()
}

fn lit_box(exitance: f32) -> (Scene, Vec<Receiver>) {
    let mut scene = luxel_scenes::closed_box(4.0, 3.0, 2.5, [0.5, 0.6, 0.3, 0.8, 0.5, 0.4]);
    for emission in scene
        .finishes
        .iter_mut()
        .filter_map(|f| f.emission.as_mut())
    {
        emission.luminance *= exitance;
    }
    let (low, high) = scene.bounds();
    let at = |x: f32, y: f32, z: f32| low + (high - low) * Vec3::new(x, y, z);
    let receivers = vec![
        Receiver {
            position: at(0.5, 0.3, 0.5),
            normal: Vec3::Y,
        },
        Receiver {
            position: at(0.2, 0.5, 0.8),
            normal: Vec3::X,
        },
        Receiver {
            position: at(0.7, 0.7, 0.3),
            normal: Vec3::NEG_Z,
        },
    ];
    (scene, receivers)
}

fn assert_close(a: &[f32], b: &[f32], factor: f32, relative: f32) {
    for (a, b) in a.iter().zip(b) {
        assert!(
            (a * factor - b).abs() <= relative * b.abs(),
            "{a} x {factor} for {b}"
        );
    }
}

#[test]
fn furnace_is_uniform_for_every_mesh_and_solver() {
    // B = E / (1 - rho) in a closed room of any shape. 300 elements; stored factors carry the
    // closure of sampled visibility, lines their noise: 1.5 % holds both.
    for mesh in MeshKind::ALL {
        for solver in SolverKind::ALL {
            let settings = Settings {
                mesh,
                solver,
                ..settings(300)
            };
            let session = solved(luxel_scenes::furnace(0.5), &settings);
            let (solution, front) = (session.solution(), session.front());
            let mean = (0..front.len())
                .map(|e| front.area[e] as f64 * session.leaving(&solution, e).value() as f64)
                .sum::<f64>()
                / front.total_area();
            assert!(
                (mean - 2.0).abs() < 0.03,
                "{} and {}: {mean}",
                mesh.name(),
                solver.name()
            );
        }
    }
}

#[test]
fn twice_the_emission_is_twice_the_light() {
    // The same seed takes the same rays, so only rounding differs.
    let (scene, receivers) = lit_box(1.0);
    let once = probe(&solved(scene, &settings(800)), &receivers);
    let twice = probe(&solved(lit_box(2.0).0, &settings(800)), &receivers);
    assert_close(&once, &twice, 2.0, 1e-3);
}

#[test]
fn turned_and_moved_scene_has_the_same_light() {
    // Other rays, so the tolerance is their noise: 0.2 % asked of the gather, 1 % of elements.
    let (scene, receivers) = lit_box(1.0);
    let here = probe(&solved(scene.clone(), &settings(800)), &receivers);
    let turn = |v: Vec3| Vec3::new(0.6 * v.x - 0.8 * v.z, v.y, 0.8 * v.x + 0.6 * v.z);
    let away = Vec3::new(7.0, -3.0, 11.0);
    let mut moved = scene;
    moved
        .positions
        .iter_mut()
        .for_each(|p| *p = turn(*p) + away);
    let receivers: Vec<Receiver> = receivers
        .iter()
        .map(|r| Receiver {
            position: turn(r.position) + away,
            normal: turn(r.normal),
        })
        .collect();
    let there = probe(&solved(moved, &settings(800)), &receivers);
    assert_close(&here, &there, 1.0, 0.01);
}

#[test]
fn scaled_scene_has_the_same_light() {
    // Exitance is flux per area: a room ten times the size with the same exitances is as bright.
    let (scene, receivers) = lit_box(1.0);
    let small = probe(&solved(scene.clone(), &settings(800)), &receivers);
    let mut large = scene;
    large.positions.iter_mut().for_each(|p| *p *= 10.0);
    let receivers: Vec<Receiver> = receivers
        .iter()
        .map(|r| Receiver {
            position: r.position * 10.0,
            ..*r
        })
        .collect();
    assert_close(
        &small,
        &probe(&solved(large, &settings(800)), &receivers),
        1.0,
        0.01,
    );
}

#[test]
fn any_thread_count_gives_the_same_bits() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| {
            let (scene, receivers) = lit_box(1.0);
            let session = solved(scene, &settings(500));
            let solution = session.solution();
            let accuracy = session.accuracy(&solution);
            (
                solution.exitance.clone(),
                session.irradiance_at(&solution, &receivers, &accuracy),
            )
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn nothing_leaks_from_a_lit_room_into_a_dark_one() {
    // Two closed boxes, side by side, sharing a wall plane; only the first has light. Exactly 0.
    let lit = luxel_scenes::closed_box(2.0, 2.0, 2.0, [0.8; 6]);
    let mut dark = lit.clone();
    dark.finishes.iter_mut().for_each(|f| f.emission = None);
    let (low, high) = lit.bounds();
    let width = high.x - low.x;
    let mut both = lit;
    let (p, t, s, f) = (
        both.positions.len() as u32,
        both.triangles.len() as u32,
        both.surfaces.len() as u32,
        both.finishes.len() as u32,
    );
    both.positions
        .extend(dark.positions.iter().map(|p| *p + Vec3::X * width));
    both.triangles
        .extend(dark.triangles.iter().map(|c| c.map(|i| i + p)));
    both.uvs.extend(&dark.uvs);
    both.source_triangle.extend(&dark.source_triangle);
    both.surface_of.extend(
        dark.surface_of
            .iter()
            .map(|id| luxel_core::SurfaceId(id.0 + s)),
    );
    both.finishes.extend(dark.finishes);
    both.surfaces
        .extend(dark.surfaces.into_iter().map(|mut surface| {
            surface.finish.0 += f;
            surface.triangles = surface.triangles.start + t..surface.triangles.end + t;
            surface
        }));
    let middle = (low + high) * 0.5 + Vec3::X * width;
    let receivers: Vec<Receiver> = [-0.499, -0.49, -0.4, 0.0, 0.45]
        .map(|x| Receiver {
            position: Vec3::new(middle.x + x * width, low.y, middle.z),
            normal: Vec3::Y,
        })
        .to_vec();
    for mesh in [MeshKind::Uniform, MeshKind::Discontinuity] {
        let settings = Settings {
            mesh,
            ..settings(2000)
        };
        let light = probe(&solved(both.clone(), &settings), &receivers);
        assert_eq!(light, vec![0.0; 5], "{}", mesh.name());
    }
}
