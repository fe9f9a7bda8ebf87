//! Importance says where work goes, and nothing else.

use crate::common::{Dense, System, luminance, random, relative_rms, run};
use luxel_core::ElementId;
use luxel_solve::{Kind, Solver, SolverSettings, Southwell, importance};
use luxel_transport::FactorRow;

/// Share of a room's flux that goes through the opening to the other at most.
const OPENING: f64 = 0.01;

/// Two equal rooms of `n` elements that see little of each other, both lit; 20 elements of the first
/// are looked at.
fn two_rooms(n: usize) -> (System, Vec<f64>) {
    let rooms = [31, 31].map(|seed| random(n, 1, 0.0, seed));
    let whole = rooms.each_ref().map(|r| r.area.iter().sum::<f64>());
    let through = OPENING / whole[0].max(whole[1]);
    let area: Vec<f64> = rooms.iter().flat_map(|r| r.area.clone()).collect();
    let mut row = FactorRow::default();
    let rows = (0..2 * n)
        .map(|i| {
            let mut dense: Vec<f64> = area.iter().map(|a| through * a).collect();
            let own = i / n;
            dense[own * n..(own + 1) * n].fill(0.0);
            rooms[own].factors.row(ElementId::from(i % n), &mut row);
            for (j, f) in &row.entries {
                dense[own * n + j.index()] = (1.0 - OPENING) * f;
            }
            dense
        })
        .collect();
    let system = System::new(
        1,
        area,
        rooms.iter().flat_map(|r| r.reflectance.clone()).collect(),
        rooms.iter().flat_map(|r| r.emission.clone()).collect(),
        Dense {
            rows,
            outside: vec![0.0; 2 * n],
        },
    );
    let seen = (0..2 * n).map(|i| if i < 20 { 1.0 } else { 0.0 }).collect();
    (system, seen)
}

/// Relative RMS error of what is looked at.
fn seen_error(system: &System, seen: &[f64], found: &[f32], exact: &[f64]) -> f64 {
    let (mut error, mut whole) = (0.0, 0.0);
    for (i, v) in seen.iter().enumerate() {
        let wide: Vec<f64> = found[3 * i..3 * i + 3].iter().map(|v| *v as f64).collect();
        let truth = luminance(&exact[3 * i..3 * i + 3]);
        error += v * system.area[i] * (luminance(&wide) - truth).powi(2);
        whole += v * system.area[i] * truth * truth;
    }
    (error / whole).sqrt()
}

#[test]
fn what_is_seen_of_the_light_is_what_lamps_matter() {
    // sum v A B = sum y A E: both are v (1 - rho F)^-1 E, read from either side; grey, so that it
    // holds for luminance. Solutions are f32; lines have noise.
    let mut system = random(50, 1, 0.2, 17);
    for values in [&mut system.reflectance, &mut system.emission] {
        for grey in values.chunks_exact_mut(3) {
            grey.fill(grey[0]);
        }
    }
    let seen: Vec<f64> = (0..50).map(|i| (i % 5) as f64).collect();
    let exact = system.exact();
    let flux = |weight: &[f64], values: &[f64]| -> f64 {
        (0..50)
            .map(|i| weight[i] * system.area[i] * values[3 * i])
            .sum()
    };
    for (kind, within) in [
        (Kind::GaussSeidel, 1e-5),
        (Kind::LinearWavelet, 0.02),
        (Kind::StochasticJacobi, 0.02),
    ] {
        let y = importance::adjoint(&system.problem(kind), &seen, 1e-3);
        let (by_light, by_lamps) = (flux(&seen, &exact), flux(&y, &system.emission));
        let ratio = by_lamps / by_light;
        let within = if kind == Kind::GaussSeidel {
            2e-3
        } else {
            within
        };
        assert!((ratio - 1.0).abs() < within, "{}: {ratio}", kind.name());
    }
}

#[test]
fn the_fixed_point_is_the_same() {
    let (mut system, seen) = two_rooms(40);
    let exact = system.exact();
    system.importance = Some(importance::weights(
        &system.problem(Kind::GaussSeidel),
        &seen,
        0.01,
    ));
    for kind in Kind::ALL {
        let problem = system.problem(kind);
        let mut solver = kind.build(SolverSettings::default());
        let steps = if kind.needs_factors() || kind.needs_nodes() {
            20_000
        } else {
            60
        };
        let progress = run(&mut *solver, &problem, steps, 0.0);
        let off = relative_rms(&system, &solver.solution(&problem).exitance, &exact);
        // f32, or what lines claim.
        let within = 1e-6
            + if kind.needs_factors() {
                0.0
            } else {
                2.0 * progress.relative_error
            };
        assert!(off < within && off < 0.02, "{}: off {off}", kind.name());
    }
}

#[test]
fn what_is_looked_at_is_right_sooner() {
    let (mut system, seen) = two_rooms(150);
    let exact = system.exact();
    let weights = importance::weights(&system.problem(Kind::GaussSeidel), &seen, 0.05);

    // Shots of Southwell until what is looked at is right to 1 %.
    let mut shots = |importance: Option<Vec<f64>>| {
        system.importance = importance;
        let problem = system.problem(Kind::Southwell);
        let mut solver = Southwell::new(SolverSettings::default());
        (1..2000).find(|_| {
            solver.step(&problem);
            let found = solver.solution(&problem).exitance;
            seen_error(&system, &seen, &found, &exact) < 0.01
        })
    };
    let plain = shots(None).expect("reached");
    let weighted = shots(Some(weights.clone())).expect("reached");
    eprintln!("Southwell, shots to 1 %: {plain} without importance, {weighted} with");
    // Half of the shots serve the other room.
    assert!(10 * weighted < 8 * plain, "{plain} {weighted}");

    // Error at equal lines over 12 seeds.
    let kind = Kind::StochasticJacobi;
    let mut lines = |importance: Option<Vec<f64>>| {
        system.importance = importance;
        let (mut square, mut work) = (0.0, 0.0);
        for seed in 0..12 {
            system.seed = seed;
            let problem = system.problem(kind);
            let mut solver = kind.build(SolverSettings {
                lines_per_step: 40_000,
                ..SolverSettings::default()
            });
            let progress = run(&mut *solver, &problem, 40, 0.0);
            let found = solver.solution(&problem).exitance;
            square += seen_error(&system, &seen, &found, &exact).powi(2);
            work += progress.work as f64;
        }
        // Error falls with the root of the work: make up for lines that were not the same.
        ((square / 12.0).sqrt() * (work / 12.0).sqrt(), work / 12.0)
    };
    let (plain, weighted) = (lines(None), lines(Some(weights.clone())));
    eprintln!(
        "{}: error times root of lines {} without importance, {} with ({} and {} lines)",
        kind.name(),
        plain.0,
        weighted.0,
        plain.1,
        weighted.1
    );
    assert!(weighted.0 < 0.8 * plain.0, "{}", kind.name());

    // Links: error of what is seen against links, without and with importance.
    let mut links = |importance: Option<Vec<f64>>| {
        system.importance = importance;
        let problem = system.problem(Kind::Hierarchical);
        let mut solver = Kind::Hierarchical.build(SolverSettings::default());
        for _ in 0..40 {
            solver.step(&problem);
            let found = solver.solution(&problem).exitance;
            if seen_error(&system, &seen, &found, &exact) < 0.02 {
                break;
            }
        }
        solver.links().expect("links")
    };
    let (plain, weighted) = (links(None), links(Some(weights)));
    eprintln!(
        "hierarchical, links at 2 % of what is seen: {plain} without importance, {weighted} with"
    );
    assert!(weighted < plain, "{plain} {weighted}");
}
