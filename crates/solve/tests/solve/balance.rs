//! Emitted = absorbed + escaped + unshot.

use crate::common::{Dense, System, random, run};
use luxel_solve::{Kind, SolverSettings, balance};

#[test]
fn balance_closes_for_all_kinds_at_any_moment() {
    for open in [0.0, 0.4] {
        let mut system = random(60, 2, open, 8);
        system.outside = vec![30.0; 6];
        for kind in Kind::ALL {
            let problem = system.problem(kind);
            let mut solver = kind.build(SolverSettings::default());
            for steps in [1, 40] {
                run(&mut *solver, &problem, steps, 0.0);
                let solution = solver.solution(&problem);
                let balance = balance::measure(&problem, &solution, 1 << 20);
                let within = match kind {
                    // B = E + rho F (B - U) holds after every step: f32 rounding.
                    Kind::Direct | Kind::Jacobi | Kind::Southwell => 1e-6,
                    // A sweep uses old and new values; closed at the end.
                    Kind::GaussSeidel if steps == 1 => 0.3,
                    Kind::GaussSeidel => 1e-6,
                    // Noise of few lines, then of many.
                    _ if steps == 1 => 0.1,
                    _ => 0.005,
                };
                let total = balance.total;
                assert!(
                    total.imbalance.abs() < within,
                    "{} after {steps}: {total:?}",
                    kind.name()
                );
                assert_eq!(total.escaped_lm > 0.0, open > 0.0);
                let sum: f64 = balance.groups.iter().map(|g| g.absorbed_lm).sum();
                assert!(
                    (sum / total.absorbed_lm - 1.0).abs() < 1e-12,
                    "groups add up"
                );
            }
        }
    }
}

#[test]
fn flux_onto_black_sides_is_absorbed() {
    // One patch of 2 m² that emits 5 lm/m² and sees 30 % outside and 70 % black: 3 lm escape.
    let dense = Dense {
        rows: vec![vec![0.0]],
        outside: vec![0.3],
    };
    let system = System::new(1, vec![2.0], vec![0.5; 3], vec![5.0; 3], dense);
    for kind in [Kind::GaussSeidel, Kind::StochasticJacobi] {
        let problem = system.problem(kind);
        let mut solver = kind.build(SolverSettings::default());
        run(&mut *solver, &problem, 5, 0.0);
        let total = balance::measure(&problem, &solver.solution(&problem), 1 << 14).total;
        // 2^13 lines or more are nearly one whole net: counts within a few lines.
        assert!((total.emitted_lm - 10.0).abs() < 1e-5);
        assert!((total.escaped_lm - 3.0).abs() < 0.01, "{total:?}");
        assert!((total.absorbed_lm - 7.0).abs() < 0.01, "{total:?}");
    }
}

#[test]
fn a_wrong_solution_is_found_out() {
    let system = random(60, 1, 0.2, 8);
    let problem = system.problem(Kind::GaussSeidel);
    let mut solver = Kind::GaussSeidel.build(SolverSettings::default());
    run(&mut *solver, &problem, 100, 0.0);
    let mut solution = solver.solution(&problem);
    solution.exitance.iter_mut().for_each(|b| *b *= 1.1);
    assert!(balance::measure(&problem, &solution, 0).total.imbalance < -0.01);
}
