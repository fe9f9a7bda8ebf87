//! Solvers beside each other: the comparison is right, and what it writes can be read.

use luxel::compare::{CompareJob, End, compare, compare_on};
use luxel::{Control, Session, Settings, SolverKind, Status};
use std::time::Duration;

fn go(_: &Status) -> Control {
    Control::Go
}

#[test]
fn all_solvers_meet_on_a_front_with_exact_factors() {
    let settings = Settings {
        elements: Some(300),
        error: 0.01,
        solver: SolverKind::StochasticJacobi,
        ..Settings::default()
    };
    let mut session = Session::new(luxel_scenes::cornell(), &settings).expect("a session");
    let minute = Duration::from_secs(60);
    let all = compare_on(&mut session, &SolverKind::ALL, minute, &mut go).expect("a comparison");
    assert_eq!(all.exact_factors, Some(true));
    assert!(all.reference.starts_with("Gauss-Seidel") && all.refused.is_empty());
    assert_eq!(all.curves.len(), SolverKind::ALL.len());
    for curve in &all.curves {
        let name = curve.solver.name();
        assert_eq!(curve.end, End::Reached, "{name}");
        let last = curve.samples.last().expect("samples");
        assert!(last.error <= 0.01 && last.work > 0, "{name}: {last:?}");
        let times = curve.samples.windows(2);
        for w in times {
            assert!(w[0].seconds.wall <= w[1].seconds.wall && w[0].work <= w[1].work);
        }
        // Deterministic iterations only get better; random ones are where they say, within three
        // times.
        if curve.solver.needs_lines() {
            assert!(last.error <= 3.0 * last.stated, "{name}: {last:?}");
        } else if curve.solver.needs_nodes() {
            // A bound, whatever the signs.
            assert!(
                last.error <= last.stated && last.links > Some(0),
                "{name}: {last:?}"
            );
        } else {
            assert!(curve.setup.wall > 0.0, "{name}");
            for w in curve.samples.windows(2) {
                assert!(w[1].error <= w[0].error * (1.0 + 1e-6), "{name}: {w:?}");
            }
        }
        assert_eq!(curve.first_below(0.01), Some(last));
    }
    let table = all.table();
    assert!(SolverKind::ALL.iter().all(|k| table.contains(k.name())));
}

#[test]
fn a_front_too_large_for_factors_leaves_their_solvers_out() {
    let settings = Settings {
        elements: Some(4000),
        error: 0.05,
        // Enough for the elements, not for 16 bytes a pair of them.
        memory: 140_000_000,
        ..Settings::default()
    };
    let mut session = Session::new(luxel_scenes::cornell(), &settings).expect("a session");
    assert!(session.front().len() > 3000);
    let solvers = [SolverKind::GaussSeidel, SolverKind::StochasticJacobi];
    let patience = Duration::from_secs(20);
    let all = compare_on(&mut session, &solvers, patience, &mut go).expect("a comparison");
    assert_eq!((all.curves.len(), all.refused.len()), (1, 1));
    assert!(all.reference.starts_with("random lines") && all.exact_factors.is_none());
    assert!(all.refused[0].1.contains("elements need about"));
    assert_eq!(all.curves[0].end, End::Reached);
}

#[test]
fn files_are_written_and_a_stop_writes_none() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("box.glb");
    std::fs::write(&scene, luxel_scenes::to_glb(&luxel_scenes::cornell())).expect("written");
    let mut job = CompareJob {
        scene,
        output: None,
        settings: Settings {
            elements: Some(200),
            error: 0.02,
            time: Some(Duration::from_secs(20)),
            ..Settings::default()
        },
        solvers: vec![SolverKind::GaussSeidel, SolverKind::StochasticJacobi],
    };
    let stopped = compare(&job, &mut |_| Control::Stop);
    assert!(stopped.is_err() && !folder.path().join("box.compare").exists());
    let all = compare(&job, &mut go).expect("a comparison");
    let read = |name: &str| {
        std::fs::read_to_string(folder.path().join("box.compare").join(name)).expect(name)
    };
    let json: serde_json::Value = serde_json::from_str(&read("compare.json")).expect("JSON");
    assert_eq!(json["solvers"].as_array().map(Vec::len), Some(2));
    let samples: usize = all.curves.iter().map(|c| c.samples.len()).sum();
    assert_eq!(read("compare.csv").lines().count(), samples + 1);
    let svg = read("compare.svg");
    assert!(svg.starts_with("<svg") && svg.contains("gauss-seidel") && !svg.contains("NaN"));
    job.settings.mesh = luxel::MeshKind::Adaptive;
    assert!(compare(&job, &mut go).is_err());
    job.solvers.clear();
    assert!(compare(&job, &mut go).is_err());
}
