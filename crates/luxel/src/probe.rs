//! Illuminance at points: solve, then gather at the receivers.

use crate::session::Session;
use crate::stage::Stage;
use crate::watch::Watch;
use crate::work::{self, End, Gathering, Rest};
use luxel_gather::{Irradiance, Receiver};

/// What was found at the receivers.
pub struct Answer {
    /// Irradiance, one entry a receiver, in the order given.
    pub irradiance: Irradiance,
    /// Whether every receiver has the asked accuracy.
    pub reached: bool,
}

/// Noise that elements may have for that of a receiver, which sees hundreds of them.
const ROUGHER: f64 = 3.0;

/// Turns of paths that stay near by: numbers must not hold the mesh. Pictures take none, as eight
/// need ten times the work in furnished rooms, most of it behind books.
const TURNS: u32 = 8;

/// Solves the session as far as asked and gathers at `receivers`.
pub fn probe(session: &mut Session, receivers: &[Receiver], watch: &mut Watch<'_>) -> Answer {
    session.aim(ROUGHER * session.settings().error);
    let solved = work::solve(session, watch, |_| ());
    let solution = session.solution();
    let accuracy = session.accuracy(&solution);
    let (irradiance, gathered) = work::gather(
        &session
            .gatherer(&solution, session.lights())
            .with_turns(TURNS),
        &Gathering {
            receivers,
            weights: &[],
            time: session.time_left(),
            most_rays: f64::INFINITY,
            rest: Rest::Hurried,
        },
        &accuracy,
        watch,
    );
    session.clock_mut().end(Stage::Gather);
    let mut met = true;
    for receiver in 0..irradiance.errors.len() {
        let value = irradiance.lux(receiver);
        met &= irradiance.errors[receiver] <= (accuracy.relative * value).max(accuracy.floor_lux);
    }
    Answer {
        irradiance,
        reached: met && solved == End::Reached && gathered == End::Reached,
    }
}
