//! The stated error is true: over our own scenes the interval of the value plus and minus 1.96 times
//! its stated standard error holds the truth as often as it says.
//!
//! Truth is a run of its own: another seed, five times as many elements, and at least ten times the
//! rays, whose own stated error is added in quadrature. Receivers are vertices of the mesh that is
//! shown, so half of them lie at edges, in corners and under things.

use luxel::{Accuracy, Receiver, Scene, Session, Settings};
use luxel_visualise::LitMesh;

/// Receivers of each scene.
const RECEIVERS: usize = 60;
const RAYS: u32 = 256;

/// Receivers spread over the vertices of the mesh that is shown.
fn vertices(session: &Session) -> Vec<Receiver> {
    let mesh = LitMesh::build(session.scene(), session.front(), Some(session.caster()));
    let count = mesh.receivers.len() as f64;
    (0..RECEIVERS)
        .map(|k| (k as f64 * 0.618_033_988_75).fract() * count)
        .map(|at| mesh.receivers[at as usize])
        .collect()
}

fn solved(scene: &Scene, elements: usize, seed: u32, error: f64) -> Session {
    let settings = Settings {
        elements: Some(elements),
        error,
        seed,
        ..Settings::default()
    };
    let mut session = Session::new(scene.clone(), &settings).expect("our own scene");
    session.by_ref().for_each(drop);
    session
}

/// Value and stated error at each receiver, lux.
fn asked(session: &Session, receivers: &[Receiver], rays: u32) -> Vec<[f64; 2]> {
    let accuracy = Accuracy {
        relative: 0.0,
        floor_lux: 0.0,
        rays: [rays; 2],
        seed: session.settings().seed,
    };
    let solution = session.solution();
    // As `probe` asks.
    let gatherer = session.gatherer(&solution, session.lights()).with_turns(8);
    let answer = gatherer.irradiance_at(receivers, &accuracy);
    (0..receivers.len())
        .map(|k| [answer.lux(k) as f64, answer.errors[k] as f64])
        .collect()
}

#[test]
fn truth_lies_in_the_stated_interval_as_often_as_it_says() {
    let scenes = [
        luxel_scenes::cornell(),
        luxel_scenes::two_rooms(),
        luxel_scenes::office(),
        luxel_scenes::gallery(),
    ];
    let (mut inside, mut all) = (0, 0);
    let mut told = String::new();
    for scene in &scenes {
        let session = solved(scene, 6_000, 1, 0.06);
        let receivers = vertices(&session);
        let got = asked(&session, &receivers, RAYS);
        let truth = asked(&solved(scene, 30_000, 77, 0.03), &receivers, 12 * RAYS);
        let mut here = 0;
        for ([value, error], [exact, rest]) in got.iter().zip(&truth) {
            // Exactly dark places differ by rounding alone.
            let half = 1.96 * error.hypot(*rest) + 1e-5 * exact;
            here += ((value - exact).abs() <= half) as usize;
        }
        told += &format!(" {}: {here} of {RECEIVERS};", scene.name);
        inside += here;
        all += RECEIVERS;
    }
    let coverage = inside as f64 / all as f64;
    println!("{:.1} % inside;{told}", 100.0 * coverage);
    assert!(
        (0.93..=0.97).contains(&coverage),
        "{:.1} % inside;{told}",
        100.0 * coverage
    );
}
