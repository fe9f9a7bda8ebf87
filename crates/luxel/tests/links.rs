//! Solvers that link clusters, on a real scene: how many links an error takes.

use luxel::{Session, Settings, SolverKind};

fn session(solver: SolverKind, elements: usize) -> Session {
    let settings = Settings {
        solver,
        elements: Some(elements),
        error: 1e-9,
        ..Settings::default()
    };
    Session::new(luxel_scenes::cornell(), &settings).expect("a session")
}

/// Luminance of every element's exitance.
fn exitance(session: &Session) -> Vec<f64> {
    let solution = session.solution();
    let of = |e| solution.total(e).luminance() as f64;
    (0..session.front().len()).map(of).collect()
}

/// Links and error, relative RMS by area, after each step.
fn steps(solver: SolverKind, elements: usize, truth: &[f64], count: usize) -> Vec<(usize, f64)> {
    let mut session = session(solver, elements);
    let area = session.front().area.clone();
    let whole: f64 = (truth.iter().zip(&area))
        .map(|(b, a)| b * b * *a as f64)
        .sum();
    (0..count)
        .map_while(|_| {
            session.next()?;
            let found = exitance(&session);
            let off = found.iter().zip(truth).zip(&area);
            let square: f64 = off.map(|((x, y), a)| (x - y).powi(2) * *a as f64).sum();
            Some((session.links().expect("links"), (square / whole).sqrt()))
        })
        .collect()
}

fn truth(elements: usize) -> Vec<f64> {
    let mut session = session(SolverKind::GaussSeidel, elements);
    while session.next().is_some() {}
    exitance(&session)
}

#[test]
fn linear_links_are_fewer_at_equal_error_and_all_come_to_gauss_seidel() {
    // Lambertian exchange in a box is smooth but for two shadows. Measured at 3 % with 2,246
    // elements: 85,332 to 205,865 links of Haar, 16,933 to 43,038 linear ones.
    let truth = truth(600);
    let links_at = |solver: SolverKind, error: f64| {
        let steps = steps(solver, 600, &truth, 14);
        let (_, last) = *steps.last().expect("steps");
        // Sampled visibility of the elements against exact shadows.
        assert!(last < 0.01, "{}: ends at {last}", solver.name());
        let first = steps.iter().find(|s| s.1 <= error);
        first.expect("reached").0
    };
    let haar = links_at(SolverKind::HaarWavelet, 0.04);
    let hierarchical = links_at(SolverKind::Hierarchical, 0.04);
    let linear = links_at(SolverKind::LinearWavelet, 0.04);
    eprintln!("links at 4 %: hierarchical {hierarchical}, Haar {haar}, linear {linear}");
    assert!(linear < haar && linear < hierarchical);
}

#[test]
fn links_grow_no_faster_than_elements() {
    // The threshold is a share of the emitted flux, so at a step the same light is let go wrong
    // whatever the elements: links may grow with their number, not with its square (pairs: 50
    // and 250 times as many here).
    for solver in [SolverKind::Hierarchical, SolverKind::LinearWavelet] {
        let counts: Vec<(usize, usize)> = [300, 1200, 4800]
            .into_iter()
            .map(|elements| {
                let mut session = session(solver, elements);
                for _ in 0..5 {
                    session.next();
                }
                (session.front().len(), session.links().expect("links"))
            })
            .collect();
        eprintln!("{}: elements and links {counts:?}", solver.name());
        for w in counts.windows(2) {
            let elements = w[1].0 as f64 / w[0].0 as f64;
            let links = w[1].1 as f64 / w[0].1 as f64;
            assert!(links < 1.2 * elements, "{counts:?}");
        }
    }
}
