//! The long stretches of a job, watched and bounded in time: solve, then gather.

use crate::session::Session;
use crate::stage::Stage;
use crate::watch::{Control, Status, Watch};
use luxel_gather::{Accuracy, Gatherer, Irradiance, Receiver};
use std::time::{Duration, Instant};

/// Share of the time bound that the solver may use; the rest is for gathering.
const SOLVE_SHARE: f64 = 0.6;

/// Share of the work from which on the time left is told: the first steps foretell badly.
const FORESEEN: f64 = 0.02;

/// Receivers between two looks at the watch.
const CHUNK: usize = 2048;

/// Gather rays for a receiver when there is no time left.
const HURRIED_RAYS: u32 = 16;

/// Receivers that are tried first when there is a time bound.
const PILOT: usize = 512;

/// Whether a stretch came to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The asked accuracy was reached, or nothing is left to improve.
    Reached,
    /// The watcher or the time bound ended it.
    Stopped,
}

/// Solves until the asked accuracy, the watcher or the time bound ends it. `each` is called
/// after every step.
pub fn solve(
    session: &mut Session,
    watch: &mut Watch<'_>,
    mut each: impl FnMut(&mut Session),
) -> End {
    let began = Instant::now();
    let bound = session
        .settings()
        .time
        .map(|t| t.as_secs_f64() * SOLVE_SHARE);
    let asked = session.settings().error;
    let mut last = Status::begin(Stage::Solve);
    if watch(&last) == Control::Stop {
        return End::Stopped;
    }
    while let Some(progress) = session.next() {
        each(session);
        let elapsed = began.elapsed().as_secs_f64();
        // Noise falls with the root of the work, so work grows with the square of the ratio.
        let known = progress.relative_error.is_finite() && progress.relative_error > 0.0;
        let share = if known {
            (asked / progress.relative_error).powi(2).min(1.0)
        } else {
            0.0
        };
        last.share = share.max(last.share);
        last.unshot = Some(progress.unshot_share);
        last.error = known.then_some(progress.relative_error);
        last.left_s = (last.share > FORESEEN).then(|| elapsed * (1.0 / last.share - 1.0));
        if watch(&last) == Control::Stop || bound.is_some_and(|b| elapsed > b) {
            return End::Stopped;
        }
    }
    End::Reached
}

/// Irradiance at many receivers, in chunks. With a time bound, a few are tried first, and all get
/// the accuracy for which the time suffices. When stopped, what is left gets a few rays each, so
/// that every value is there with its honest, larger error.
pub fn gather(
    gatherer: &Gatherer<'_>,
    time: Option<Duration>,
    receivers: &[Receiver],
    accuracy: &Accuracy,
    watch: &mut Watch<'_>,
    stopped: bool,
) -> (Irradiance, End) {
    let began = Instant::now();
    let bound = time.map(|t| t.as_secs_f64() * (1.0 - SOLVE_SHARE));
    let mut all = gatherer.irradiance_at(&[], accuracy);
    let mut end = if stopped { End::Stopped } else { End::Reached };
    let mut status = Status::begin(Stage::Gather);
    let mut accuracy = *accuracy;
    if let (Some(bound), End::Reached) = (bound, end) {
        accuracy.relative *= slower(gatherer, receivers, &accuracy, bound).sqrt() as f32;
    }
    for (index, chunk) in receivers.chunks(CHUNK).enumerate() {
        if end == End::Stopped {
            accuracy.rays = [HURRIED_RAYS; 2];
        }
        let part = gatherer.irradiance_at(chunk, &accuracy);
        all.values.extend(part.values);
        all.layer_errors.extend(part.layer_errors);
        all.errors.extend(part.errors);
        all.rays += part.rays;
        let done = ((index + 1) * CHUNK).min(receivers.len()) as f64 / receivers.len() as f64;
        let elapsed = began.elapsed().as_secs_f64();
        status.share = done;
        status.left_s = Some(elapsed * (1.0 / done - 1.0));
        let over = bound.is_some_and(|b| elapsed > b);
        if watch(&status) == Control::Stop || over {
            end = End::Stopped;
        }
    }
    (all, end)
}

/// How many times `bound` seconds gathering at all receivers would take, at least 1, from
/// [`PILOT`] of them spread over all.
fn slower(gatherer: &Gatherer<'_>, receivers: &[Receiver], accuracy: &Accuracy, bound: f64) -> f64 {
    let stride = receivers.len().div_ceil(PILOT).max(1);
    let few: Vec<Receiver> = receivers.iter().step_by(stride).copied().collect();
    let began = Instant::now();
    gatherer.irradiance_at(&few, accuracy);
    let all = began.elapsed().as_secs_f64() * receivers.len() as f64 / few.len().max(1) as f64;
    (all / bound.max(1e-3)).max(1.0)
}
