//! All solvers against closed forms, against each other, and through changes of front.

use crate::common::{Dense, System, flux, luminance, random, relative_rms, run};
use luxel_core::{DVec3, ElementId, FrontChange};
use luxel_solve::{Kind, SolverSettings};
use luxel_transport::{Constant, GivenNodes};

/// Steps that bring each kind to its best on the small systems here.
fn enough(kind: Kind) -> (usize, f64) {
    if kind.needs_lines() {
        (100, 0.0)
    } else {
        (20_000, 0.0)
    }
}

/// An integrating sphere of unequal patches, all reflecting `rho` and emitting 1.
fn sphere(n: usize, rho: f64) -> System {
    let area: Vec<f64> = (0..n).map(|i| 1.0 + (i % 7) as f64).collect();
    let nothing = Dense {
        rows: vec![vec![0.0; n]; n],
        outside: vec![0.0; n],
    };
    let constant = Constant::new(area.clone());
    let mut system = System::new(1, area, vec![rho; 3 * n], vec![1.0; 3 * n], nothing);
    system.lines = Box::new(constant.clone());
    let nowhere = vec![DVec3::ZERO; n];
    system.nodes = Box::new(GivenNodes::new(&constant, &system.area, nowhere));
    system.factors = Box::new(constant);
    system
}

#[test]
fn furnace_reaches_e_over_one_minus_rho() {
    // Closed, grey, E = 1: B = E / (1 - rho), whatever the shape. The control variate of the
    // lines makes it exact even for stochastic Jacobi; f32 rounding is left.
    for kind in Kind::ALL {
        for rho in [0.0, 0.5, 0.9] {
            let system = sphere(60, rho);
            let problem = system.problem(kind);
            let mut solver = kind.build(SolverSettings::default());
            let (steps, error) = enough(kind);
            let progress = run(&mut *solver, &problem, steps, error);
            let within = match kind {
                // Shots land where they land: five times the error that it claims.
                Kind::MonteCarloShooting => 5.0 * progress.relative_error + 1e-3,
                Kind::StochasticJacobi => 1e-3,
                _ => 1e-6,
            };
            let solution = solver.solution(&problem);
            let exact = vec![1.0 / (1.0 - rho); 180];
            let off = relative_rms(&system, &solution.exitance, &exact);
            assert!(off < within, "{} at rho {rho}: off by {off}", kind.name());
        }
    }
}

#[test]
fn all_agree_with_gauss_seidel_on_a_random_system() {
    for (groups, open) in [(1, 0.0), (3, 0.3)] {
        let mut system = random(60, groups, open, 11);
        if open > 0.0 {
            // The sky shines in the last group.
            let last = 3 * (groups - 1);
            system.outside[last..].copy_from_slice(&[50.0, 60.0, 90.0]);
        }
        let exact = system.exact();
        for kind in Kind::ALL {
            let problem = system.problem(kind);
            let mut solver = kind.build(SolverSettings::default());
            let (steps, error) = enough(kind);
            let progress = run(&mut *solver, &problem, steps, error);
            let solution = solver.solution(&problem);
            assert_eq!(solution.exitance.len(), exact.len());
            let off = relative_rms(&system, &solution.exitance, &exact);
            if kind.needs_lines() {
                // RMS over 60 elements: far in its tail at twice the claimed error.
                let claimed = progress.relative_error;
                assert!(
                    off < 2.0 * claimed + 1e-6,
                    "{}: off {off}, claims {claimed}",
                    kind.name()
                );
                assert!(claimed < 0.02, "{}: claims {claimed}", kind.name());
            } else {
                assert!(
                    off < 1e-6,
                    "{}: f32 rounding, but off by {off}",
                    kind.name()
                );
            }
        }
    }
}

#[test]
fn lines_are_unbiased_in_every_element() {
    // z-test over 40 seeds and all elements: the mean of the seeds may be off by its standard
    // error times 4.5; with 40 elements and two kinds a chance of 1 in 1,000 (t with 39 degrees).
    let mut system = random(40, 1, 0.2, 5);
    system.outside = vec![20.0; 3];
    let exact = system.exact();
    // Few lines a step, or low-discrepancy error would hide below the leftover of the run.
    let settings = SolverSettings {
        lines_per_step: 4000,
        tolerance: 1e-6,
        ..Default::default()
    };
    for kind in [Kind::StochasticJacobi, Kind::MonteCarloShooting] {
        let mut found = Vec::new();
        for seed in 0..40 {
            system.seed = 1000 + seed;
            let problem = system.problem(kind);
            let mut solver = kind.build(settings);
            run(&mut *solver, &problem, 60, 0.0);
            found.push(solver.solution(&problem).exitance);
        }
        for i in 0..40 {
            let values: Vec<f64> = found
                .iter()
                .map(|b| {
                    luminance(
                        &b[3 * i..3 * i + 3]
                            .iter()
                            .map(|v| *v as f64)
                            .collect::<Vec<_>>(),
                    )
                })
                .collect();
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let var = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
            let truth = luminance(&exact[3 * i..3 * i + 3]);
            // 1e-5: light still to come after 60 steps, and f32.
            let allowed = 4.5 * (var / n).sqrt() + 1e-5 * truth;
            assert!(
                (mean - truth).abs() < allowed,
                "{} element {i}: {mean} for {truth}, allowed {allowed}",
                kind.name()
            );
        }
    }
}

#[test]
fn claimed_error_is_the_true_error() {
    // 500 elements: an RMS over them scatters by 1 / sqrt(2 * 500) = 3 %, so a factor of 1.5
    // tests the estimate and not luck.
    for (open, seed) in [(0.0, 1), (0.4, 2)] {
        let system = random(500, 1, open, seed);
        let exact = system.exact();
        for kind in [Kind::StochasticJacobi, Kind::MonteCarloShooting] {
            let problem = system.problem(kind);
            let mut solver = kind.build(SolverSettings::default());
            let mut checked = 0;
            for _ in 0..40 {
                let claimed = solver.step(&problem).relative_error;
                let solution = solver.solution(&problem);
                let is = relative_rms(&system, &solution.exitance, &exact);
                if claimed < 0.1 {
                    checked += 1;
                    let ratio = claimed / is;
                    assert!(
                        (0.667..1.5).contains(&ratio),
                        "{}: claims {claimed}, is {is}",
                        kind.name()
                    );
                }
            }
            assert!(
                checked > 4,
                "{}: reached the range that is checked",
                kind.name()
            );
        }
    }
}

#[test]
fn twice_the_emission_is_twice_the_exitance() {
    // Scaling by two changes no digit, so the answer must be the same to the bit.
    let mut system = random(50, 2, 0.1, 3);
    system.outside = vec![5.0; 6];
    for kind in Kind::ALL {
        let solve = |system: &System| {
            let problem = system.problem(kind);
            let mut solver = kind.build(SolverSettings::default());
            run(&mut *solver, &problem, 12, 0.0);
            solver.solution(&problem).exitance
        };
        let once = solve(&system);
        let mut brighter = random(50, 2, 0.1, 3);
        brighter.emission.iter_mut().for_each(|e| *e *= 2.0);
        brighter.outside = vec![10.0; 6];
        let twice = solve(&brighter);
        for (a, b) in once.iter().zip(&twice) {
            assert_eq!((2.0 * a).to_bits(), b.to_bits(), "{}", kind.name());
        }
    }
}

#[test]
fn bits_do_not_depend_on_threads() {
    let mut system = random(700, 2, 0.1, 9);
    system.outside = vec![5.0; 6];
    for kind in Kind::ALL {
        let solve = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("a pool");
            pool.install(|| {
                let problem = system.problem(kind);
                let mut solver = kind.build(SolverSettings::default());
                let progress = run(&mut *solver, &problem, 8, 0.0);
                (progress, solver.solution(&problem))
            })
        };
        assert_eq!(solve(1), solve(4), "{}", kind.name());
    }
}

/// Splits element 0 of a system in two halves that see the same; the parts do not see each
/// other, which is right for a flat element.
fn split(system: &System, old: &[Vec<f64>]) -> (System, FrontChange) {
    let n = system.area.len();
    let parent = |e: usize| if e == n { 0 } else { e };
    let portion = |e: usize| if parent(e) == 0 { 0.5 } else { 1.0 };
    let rows = (0..=n)
        .map(|i| {
            (0..=n)
                .map(|j| old[parent(i)][parent(j)] * portion(j))
                .collect()
        })
        .collect();
    let columns = system.layers.columns();
    let pick = |values: &[f64], width: usize| -> Vec<f64> {
        (0..=n)
            .flat_map(|e| values[parent(e) * width..(parent(e) + 1) * width].to_vec())
            .collect()
    };
    let new = System::new(
        columns / 3,
        (0..=n)
            .map(|e| system.area[parent(e)] * portion(e))
            .collect(),
        pick(&system.reflectance, 3),
        pick(&system.emission, columns),
        Dense {
            rows,
            outside: vec![0.0; n + 1],
        },
    );
    let change = FrontChange {
        offsets: (0..=n as u32 + 1).collect(),
        sources: (0..=n).map(|e| (ElementId::from(parent(e)), 1.0)).collect(),
    };
    (new, change)
}

fn rows_of(system: &System) -> Vec<Vec<f64>> {
    let mut row = luxel_transport::FactorRow::default();
    (0..system.area.len())
        .map(|i| {
            system.factors.row(ElementId::from(i), &mut row);
            let mut dense = vec![0.0; system.area.len()];
            for (j, f) in &row.entries {
                dense[j.index()] = *f;
            }
            dense
        })
        .collect()
}

#[test]
fn restart_keeps_flux_and_reaches_the_new_answer() {
    let system = random(40, 1, 0.0, 21);
    let (mut split, change) = split(&system, &rows_of(&system));
    // One half is painted black and a lamp far from it is dimmed: light must be taken back.
    split.reflectance[..3].fill(0.0);
    split.emission[8 * 3..9 * 3].fill(0.0);
    let exact = split.exact();
    for kind in Kind::ALL {
        let mut solver = kind.build(SolverSettings::default());
        let problem = system.problem(kind);
        run(&mut *solver, &problem, 10, 0.0);
        let before = solver.solution(&problem);
        let problem = split.problem(kind);
        solver.restart(&change, &problem);
        let carried = solver.solution(&problem);
        // Shares of 0.5 and f32 sums.
        let (a, b) = (
            flux(&system.area, &before.exitance),
            flux(&split.area, &carried.exitance),
        );
        assert!(
            (a / b - 1.0).abs() < 1e-6,
            "{}: flux {a} before, {b} after",
            kind.name()
        );

        let (steps, error) = enough(kind);
        let progress = run(&mut *solver, &problem, steps, error);
        let off = relative_rms(&split, &solver.solution(&problem).exitance, &exact);
        let within = if kind.needs_lines() {
            2.0 * progress.relative_error
        } else {
            1e-6
        };
        assert!(
            off < within,
            "{}: off by {off}, allowed {within}",
            kind.name()
        );
        assert!(off < 0.02, "{}: off by {off}", kind.name());
    }
}

#[test]
fn unshot_is_signed_after_a_restart() {
    let system = random(40, 1, 0.0, 21);
    let (mut split, change) = split(&system, &rows_of(&system));
    split.emission[..3].fill(0.0);
    for kind in [Kind::Southwell, Kind::StochasticJacobi] {
        let mut solver = kind.build(SolverSettings::default());
        run(&mut *solver, &system.problem(kind), 400, 0.0);
        let problem = split.problem(kind);
        solver.restart(&change, &problem);
        solver.step(&problem);
        let solution = solver.solution(&problem);
        assert!(
            solution.unshot.iter().any(|u| *u < 0.0),
            "{}: owes light",
            kind.name()
        );
    }
}

#[test]
fn stored_solution_is_taken_up() {
    let system = random(60, 1, 0.1, 4);
    let exact = system.exact();
    for kind in Kind::ALL {
        let problem = system.problem(kind);
        let mut first = kind.build(SolverSettings::default());
        run(&mut *first, &problem, 25, 0.0);
        let stored = first.solution(&problem);
        let before = relative_rms(&system, &stored.exitance, &exact);
        let mut second = kind.build(SolverSettings::default());
        second.resume(&stored, &problem);
        assert_eq!(
            second.solution(&problem).exitance,
            stored.exitance,
            "{}",
            kind.name()
        );
        let (steps, error) = enough(kind);
        let progress = run(&mut *second, &problem, steps, error);
        let after = relative_rms(&system, &second.solution(&problem).exitance, &exact);
        if kind.needs_lines() {
            // As many new lines as old ones, or more: the error goes on falling.
            assert!(
                after < before,
                "{}: {before} before, {after} after",
                kind.name()
            );
            assert!(after < 2.0 * progress.relative_error);
            assert!(progress.work > stored.work);
        } else {
            assert!(after < 1e-6, "{}: {after}", kind.name());
        }
    }
}

#[test]
fn unequal_areas_are_not_transposed() {
    // FEATURES row 1. Two patches in a closed shell, areas 1 and 3, F_12 = 1, so F_21 = 1/3 and
    // F_22 = 2/3. E = (6, 0), rho = (0, 1/2):
    // B_2 = 1/2 (1/3 * 6 + 2/3 B_2), B_2 = 1 / (2/3) = 1.5. Transposed it would be 4.5.
    let system = System::new(
        1,
        vec![1.0, 3.0],
        vec![0.0, 0.0, 0.0, 0.5, 0.5, 0.5],
        vec![6.0, 6.0, 6.0, 0.0, 0.0, 0.0],
        Dense {
            rows: vec![vec![0.0, 1.0], vec![1.0 / 3.0, 2.0 / 3.0]],
            outside: vec![0.0; 2],
        },
    );
    for kind in Kind::ALL {
        let problem = system.problem(kind);
        let mut solver = kind.build(SolverSettings::default());
        let (steps, error) = enough(kind);
        run(&mut *solver, &problem, steps, error);
        let b = solver.solution(&problem).exitance;
        let within = if kind.needs_lines() { 0.01 } else { 1e-6 };
        assert!(
            (b[0] - 6.0).abs() < 1e-6 && (b[3] - 1.5).abs() < within,
            "{}: {b:?}",
            kind.name()
        );
    }
}

#[test]
fn shelf_has_the_values_of_the_design() {
    // DESIGN section 4 at g = sqrt 3, one patch a surface; open to the front.
    let g = 3f64.sqrt();
    let ab = (1.0 + g - (1.0 + g * g).sqrt()) / 2.0;
    let ac = (1.0 + g * g).sqrt() - g;
    let bc = (1.0 + 1.0 / g - (1.0 + 1.0 / (g * g)).sqrt()) / 2.0;
    // Walls A and C of height 1, floor B of width g; F_BA = F_AB / g = F_BC.
    assert!((ab / g - bc).abs() < 1e-12);
    let rows = vec![vec![0.0, ab, ac], vec![bc, 0.0, bc], vec![ac, ab, 0.0]];
    let outside: Vec<f64> = rows.iter().map(|r| 1.0 - r.iter().sum::<f64>()).collect();
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
    for (rho, emission, expected) in cases {
        let triple = |v: [f64; 3]| v.into_iter().flat_map(|x| [x; 3]).collect::<Vec<f64>>();
        let dense = Dense {
            rows: rows.clone(),
            outside: outside.clone(),
        };
        let system = System::new(1, vec![1.0, g, 1.0], triple(rho), triple(emission), dense);
        for kind in Kind::ALL {
            let problem = system.problem(kind);
            let mut solver = kind.build(SolverSettings::default());
            let (steps, error) = enough(kind);
            run(&mut *solver, &problem, steps, error);
            let b = solver.solution(&problem).exitance;
            for i in 0..3 {
                // Seven printed digits; lines stay within 1 % of the brightest.
                let within = if kind.needs_lines() { 0.01 } else { 3e-7 };
                assert!(
                    (b[3 * i] as f64 - expected[i]).abs() < within,
                    "{}: {b:?}",
                    kind.name()
                );
            }
        }
    }
}

#[test]
fn a_room_that_no_light_reaches_stays_exactly_dark() {
    // Two closed spheres of 30 patches that do not see each other; one is lit. Nothing but an
    // estimate from the wrong place could put light into the other.
    let n = 30;
    let same = |i: usize, j: usize| (i < n) == (j < n);
    let rows = (0..2 * n)
        .map(|i| {
            (0..2 * n)
                .map(|j| if same(i, j) { 1.0 / n as f64 } else { 0.0 })
                .collect()
        })
        .collect();
    let emission = (0..6 * n)
        .map(|at| if at < 9 { 100.0 } else { 0.0 })
        .collect();
    let dense = Dense {
        rows,
        outside: vec![0.0; 2 * n],
    };
    let system = System::new(1, vec![1.0; 2 * n], vec![0.7; 6 * n], emission, dense);
    for kind in Kind::ALL {
        let problem = system.problem(kind);
        let mut solver = kind.build(SolverSettings::default());
        for step in 0..20 {
            solver.step(&problem);
            let solution = solver.solution(&problem);
            // A link from the root to itself holds both rooms until it is refined.
            if kind.needs_nodes() && step < 10 {
                continue;
            }
            assert!(
                solution.exitance[3 * n..].iter().all(|b| *b == 0.0),
                "{}",
                kind.name()
            );
        }
    }
}

#[test]
fn empty_and_dark_problems_are_harmless() {
    let empty = System::new(
        1,
        vec![],
        vec![],
        vec![],
        Dense {
            rows: vec![],
            outside: vec![],
        },
    );
    let dark = System::new(
        1,
        vec![1.0, 0.0],
        vec![0.5; 6],
        vec![0.0; 6],
        Dense {
            rows: vec![vec![0.0, 1.0], vec![1.0, 0.0]],
            outside: vec![0.0; 2],
        },
    );
    for kind in Kind::ALL {
        for system in [&empty, &dark] {
            let problem = system.problem(kind);
            let mut solver = kind.build(SolverSettings::default());
            run(&mut *solver, &problem, 3, 0.0);
            let solution = solver.solution(&problem);
            assert!(
                solution.exitance.iter().all(|b| *b == 0.0),
                "{}",
                kind.name()
            );
        }
    }
}

#[test]
fn kinds_are_found_by_name() {
    for kind in Kind::ALL {
        assert_eq!(Kind::parse(kind.name()), Some(kind));
    }
    assert_eq!(Kind::parse("radiosity"), None);
    assert!(Kind::Southwell.fits(1_000_000) && !Kind::Direct.fits(1_000_000));
}
