//! The published iterates of `../shared/reference/solver.json`, skipped when it is not there.

use crate::common::{Dense, System};
use luxel_core::Solution;
use luxel_solve::{Direct, GaussSeidel, Jacobi, Kind, Solver, SolverSettings, Southwell, ambient};
use serde_json::Value;

fn numbers(v: &Value) -> Vec<f64> {
    v.as_array()
        .expect("an array")
        .iter()
        .map(|x| x.as_f64().expect("a number"))
        .collect()
}

fn cases() -> Vec<Value> {
    let here = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = here
        .ancestors()
        .map(|dir| dir.join("shared/reference/solver.json"))
        .find(|file| file.exists());
    let Some(file) = file else {
        eprintln!("skipped: no shared/reference/solver.json beside the project");
        return Vec::new();
    };
    let text = std::fs::read_to_string(file).expect("readable");
    let whole: Value = serde_json::from_str(&text).expect("valid JSON");
    whole["cases"].as_array().expect("cases").clone()
}

/// All three bands alike, so that the photometric order is the order of the one band.
fn system(case: &Value) -> System {
    let scene = &case["scene"];
    let rows: Vec<Vec<f64>> = scene["form_factors"]
        .as_array()
        .expect("rows")
        .iter()
        .map(numbers)
        .collect();
    let triple = |v: Vec<f64>| v.into_iter().flat_map(|x| [x; 3]).collect::<Vec<f64>>();
    System::new(
        1,
        numbers(&scene["areas"]),
        triple(numbers(&scene["reflectance"])),
        triple(numbers(&scene["exitance"])),
        Dense {
            outside: vec![0.0; rows.len()],
            rows,
        },
    )
}

fn query<'a>(case: &'a Value, id: &str) -> &'a Value {
    let all = case["queries"].as_array().expect("queries");
    &all.iter().find(|q| q["id"] == id).expect("the query")["expected"]
}

/// Relative 1e-9, the tolerance of the file, plus its own uncertainty of 1e-12, which the
/// twelve printed digits make 1e-11 of the value.
fn assert_close(case: &Value, what: &str, found: &[f64], expected: &[f64]) {
    for (i, e) in expected.iter().enumerate() {
        for band in 0..3 {
            let f = found[3 * i + band];
            let within = 1e-9 * e.abs() + 1e-11;
            assert!(
                (f - e).abs() <= within,
                "{}: {what} of {i}: {f} for {e}",
                case["id"]
            );
        }
    }
}

#[test]
fn direct_gives_the_exact_exitance() {
    for case in cases() {
        let system = system(&case);
        let mut solver = Direct::new();
        solver.step(&system.problem(Kind::Direct));
        assert_close(&case, "B", solver.exitance(), &numbers(query(&case, "B")));
        // FEATURES row 4: residual of a dense solve.
        assert!(solver.residual().iter().all(|r| r.abs() < 1e-10));
    }
}

#[test]
fn jacobi_and_gauss_seidel_give_the_iterates() {
    for case in cases() {
        let system = system(&case);
        let problem = system.problem(Kind::Jacobi);
        let (mut jacobi, mut gauss_seidel) = (Jacobi::new(), GaussSeidel::new());
        let iterates = |id: &str| query(&case, id).as_array().expect("iterates").clone();
        for expected in iterates("jacobi") {
            jacobi.step(&problem);
            assert_close(&case, "jacobi", jacobi.exitance(), &numbers(&expected));
        }
        for expected in iterates("gauss_seidel") {
            gauss_seidel.step(&problem);
            assert_close(
                &case,
                "gauss_seidel",
                gauss_seidel.exitance(),
                &numbers(&expected),
            );
        }
    }
}

#[test]
fn southwell_gives_the_shots_with_ambient_and_display() {
    for case in cases() {
        let system = system(&case);
        let problem = system.problem(Kind::Southwell);
        let mut solver = Southwell::new(SolverSettings::default());
        for shot in query(&case, "shooting").as_array().expect("shots") {
            solver.step(&problem);
            assert_eq!(
                solver.last_shot().0 as u64,
                shot["shot"].as_u64().expect("an index")
            );
            assert_close(&case, "B", solver.exitance(), &numbers(&shot["radiosity"]));
            assert_close(&case, "unshot", solver.unshot(), &numbers(&shot["unshot"]));
            let ambient = solver.ambient(&problem);
            let expected = shot["ambient"].as_f64().expect("a number");
            assert_close(&case, "ambient", &ambient, &[expected]);
            let display: Vec<f64> = solver
                .exitance()
                .iter()
                .enumerate()
                .map(|(at, b)| b + problem.reflectance[at] * ambient[at % 3])
                .collect();
            assert_close(&case, "display", &display, &numbers(&shot["display"]));

            // Row 50: showing with the ambient term leaves the stored solution bit-identical.
            let stored: Solution = solver.solution(&problem);
            let before = stored.clone();
            let shown = ambient::displayed(&problem, &stored);
            assert_eq!(stored, before);
            for (s, d) in shown.iter().zip(&display) {
                assert!(
                    (*s as f64 - d).abs() <= 1e-6 * d.abs() + 1e-12,
                    "f32 rounding"
                );
            }
        }
    }
}

#[test]
fn southwell_needs_the_published_number_of_shots() {
    // Counted until the unshot flux is 0.1 % of the emitted; the residual's flux never grows,
    // and the ambient term falls with it (row 50).
    for case in cases() {
        let system = system(&case);
        let problem = system.problem(Kind::Southwell);
        let mut solver = Southwell::new(SolverSettings::default());
        let (mut shots, mut last) = (0, 1.0);
        loop {
            shots += 1;
            let share = solver.step(&problem).unshot_share;
            assert!(share <= last * (1.0 + 1e-12), "row 48: residual monotone");
            last = share;
            if share < 1e-3 {
                break;
            }
        }
        assert_eq!(Some(shots), query(&case, "shots_to_0.1pct").as_u64());
        while !solver.step(&problem).finished {}
        let largest = solver.exitance().iter().fold(0.0f64, |m, b| m.max(*b));
        assert!(solver.ambient(&problem)[0] < 1e-5 * largest);
    }
}
