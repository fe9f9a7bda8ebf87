//! How fast a solution gets how good, and how that grows with the scene.
//!
//! `cargo bench -p luxel --bench solution`. First a furnished scene of 10,000 elements to 2 %, held
//! against its own solution with sixteen times less noise; then corridors of 1,000 to 1,000,000
//! triangles to 5 %: solve time, its growth exponent, and how much of that is dearer rays. Times
//! are CPU seconds. An argument bounds the largest corridor.

use luxel::{Session, Settings, Stage};
use luxel_core::{Scene, Solution};
use luxel_transport::{Hit, Ray};

fn main() {
    let largest = std::env::args()
        .filter_map(|a| a.parse::<usize>().ok())
        .next()
        .unwrap_or(1_000_000);
    room();
    let mut before: Option<(f64, f64, f64)> = None;
    for triangles in [1_000, 10_000, 100_000, 1_000_000] {
        if triangles > largest {
            break;
        }
        before = Some(corridor(triangles, before));
    }
}

fn solve(scene: Scene, settings: &Settings) -> (Session, Solution) {
    let mut session = Session::new(scene, settings).expect("the scene is sound");
    for _ in session.by_ref() {}
    let solution = session.solution();
    (session, solution)
}

fn room() {
    let settings = |error| Settings {
        elements: Some(10_000),
        error,
        ..Settings::default()
    };
    let (mut session, rough) = solve(luxel_scenes::two_rooms(), &settings(0.02));
    let clock = session.clock_mut().clone();
    let (direct, solved) = (clock.of(Stage::Direct).cpu, clock.of(Stage::Solve).cpu);
    let (_, fine) = solve(luxel_scenes::two_rooms(), &settings(0.02 / 4.0));
    let (mut square, mut whole) = (0.0f64, 0.0f64);
    for e in 0..fine.len() {
        let area = session.front().area[e] as f64;
        let (a, b) = (
            rough.total(e).luminance() as f64,
            fine.total(e).luminance() as f64,
        );
        square += area * (a - b) * (a - b);
        whole += area * b * b;
    }
    println!(
        "two rooms, {} elements: stated error {:.2} %, RMS against its converged solution {:.2} %, \
         {:.2} CPU s (direct light {direct:.2}, solve {solved:.2})",
        fine.len(),
        100.0 * rough.relative_error,
        100.0 * (square / whole).sqrt(),
        direct + solved,
    );
}

/// Nanoseconds for a ray between two points of the scene, one after the other.
fn ray_ns(session: &Session) -> f64 {
    let front = session.front();
    let n = front.len();
    let rays: Vec<Ray> = (0..200_000usize)
        .map(|k| {
            let e = luxel_core::ElementId::from((k * 7919) % n);
            let u = |step: f32| (k as f32 * step).fract();
            let (p, normal) = front.point_on(session.scene(), e, [u(0.618), u(0.755)]);
            Ray {
                origin: p + normal * session.caster().offset_m(),
                t_min: 0.0,
                direction: luxel_transport::sampling::cosine_hemisphere(
                    [u(0.414), u(0.732)],
                    normal,
                ),
                t_max: f32::INFINITY,
            }
        })
        .collect();
    let mut hits = vec![Hit::MISS; rays.len()];
    let began = std::time::Instant::now();
    session.caster().closest(&rays, &mut hits);
    1e9 * began.elapsed().as_secs_f64() / rays.len() as f64
}

fn corridor(triangles: usize, before: Option<(f64, f64, f64)>) -> (f64, f64, f64) {
    let settings = Settings {
        error: 0.05,
        ..Settings::default()
    };
    let (mut session, solution) = solve(luxel_scenes::corridor(triangles), &settings);
    let solved = session.clock_mut().of(Stage::Solve).cpu;
    let (elements, ray) = (session.front().len() as f64, ray_ns(&session));
    print!(
        "corridor {triangles}: {elements} elements, stated error {:.2} %, solve {solved:.2} CPU s, \
         {} rays, {ray:.0} ns a ray",
        100.0 * solution.relative_error,
        solution.work,
    );
    if let Some((t, s, r)) = before {
        let size = (triangles as f64 / t).ln();
        print!(
            "; exponent {:.2}, of which dearer rays {:.2}",
            (solved / s).ln() / size,
            (ray / r).ln() / size
        );
    }
    println!();
    (triangles as f64, solved, ray)
}
