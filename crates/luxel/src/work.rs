//! The long stretches of a job, watched and bounded in time: solve, then gather.

use crate::session::Session;
use crate::stage::Stage;
use crate::watch::{Control, Status, Watch};
use luxel_gather::{Accuracy, Gatherer, Irradiance, Receiver};
use std::time::{Duration, Instant};

/// Share of the time bound that the solver may use; what it leaves is for gathering.
const SOLVE_SHARE: f64 = 0.6;

/// Share of the work from which on the time left is told: the first steps foretell badly.
const FORESEEN: f64 = 0.02;

/// Receivers between two looks at the watch.
const CHUNK: usize = 2048;

/// Gather rays for a receiver when there is no time left.
const HURRIED_RAYS: u32 = 16;

/// Receivers that are tried first when there is a time bound.
const PILOT: usize = 512;

/// Share of the time bound that the trial may take, and how many are tried at once at first.
const PILOT_SHARE: f64 = 0.05;
const FIRST_TRIED: usize = 4;

/// The fewest rays must be so small a share of the bound before it is thought to suffice untried.
const SURELY: f64 = 0.1;

/// No error is loosened more than this many times.
const LOOSEST: f32 = 8.0;

/// Step of the scale that is searched.
const STEP: f32 = 1.02;

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
    let asked = session.target();
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

/// Receivers that are to be gathered at, and what it may cost.
pub struct Gathering<'a> {
    /// Where.
    pub receivers: &'a [Receiver],
    /// What each counts, above 0 (the area that it stands for); empty when all count the same.
    pub weights: &'a [f32],
    /// Most time for it.
    pub time: Option<Duration>,
    /// About the most rays for all together.
    pub most_rays: f64,
    /// What becomes of the rest when the gathering is stopped.
    pub rest: Rest,
}

/// What becomes of receivers for which there is no time left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rest {
    /// They get a few rays each, and have an honest, larger error.
    Hurried,
    /// They are left out: the answer is shorter.
    LeftOut,
}

/// Irradiance at many receivers, in chunks. With bounds that do not suffice for the accuracy, which
/// a few receivers tell, errors are loosened so that the weighted mean square error is least (see
/// [`slacks`]).
pub fn gather(
    gatherer: &Gatherer<'_>,
    gathering: &Gathering<'_>,
    accuracy: &Accuracy,
    watch: &mut Watch<'_>,
) -> (Irradiance, End) {
    let began = Instant::now();
    let receivers = gathering.receivers;
    let bound = gathering.time.map(|t| t.as_secs_f64());
    let mut all = gatherer.irradiance_at(&[], accuracy);
    let mut end = End::Reached;
    let mut status = Status::begin(Stage::Gather);
    let mut accuracy = *accuracy;
    let times = too_dear(gatherer, gathering, &accuracy, bound);
    let slack = if times > 1.0 {
        slacks(gathering, times)
    } else {
        Vec::new()
    };
    for (index, chunk) in receivers.chunks(CHUNK).enumerate() {
        if end == End::Stopped {
            if gathering.rest == Rest::LeftOut {
                break;
            }
            accuracy.rays = [HURRIED_RAYS; 2];
        }
        let slack = slack.get(index * CHUNK..).unwrap_or(&[]);
        let part = gatherer.irradiance_with_slack(chunk, slack, &accuracy);
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

/// How many times the bounds gathering at all receivers would cost, from [`PILOT`] of them spread
/// over all; 1 when they suffice.
fn too_dear(
    gatherer: &Gatherer<'_>,
    gathering: &Gathering<'_>,
    accuracy: &Accuracy,
    bound_s: Option<f64>,
) -> f64 {
    let receivers = gathering.receivers;
    let fewest = accuracy.rays[0] as f64 * receivers.len() as f64;
    if bound_s.is_none() && fewest < SURELY * gathering.most_rays {
        return 1.0;
    }
    let stride = receivers.len().div_ceil(PILOT).max(1);
    let mut few: Vec<Receiver> = receivers.iter().step_by(stride).copied().collect();
    // So that the first few are spread over all, too.
    few.sort_by_cached_key(|r| {
        luxel_transport::sampling::hash(r.position.to_array().map(f32::to_bits))
    });
    let began = Instant::now();
    // In growing steps while the clock runs: the very first may already tell enough.
    let enough_s = bound_s.map_or(f64::INFINITY, |b| PILOT_SHARE * b);
    let (mut tried, mut rays) = (0, 0);
    while tried < few.len() && began.elapsed().as_secs_f64() < enough_s {
        let step = match bound_s {
            Some(_) => tried.max(FIRST_TRIED),
            None => few.len(),
        };
        let to = (tried + step).min(few.len());
        rays += gatherer.irradiance_at(&few[tried..to], accuracy).rays;
        tried = to;
    }
    let scale = receivers.len() as f64 / tried.max(1) as f64;
    let rays = rays as f64 * scale / gathering.most_rays;
    let time = bound_s.map_or(0.0, |b| began.elapsed().as_secs_f64() * scale / b.max(1e-3));
    rays.max(time).max(1.0)
}

/// How much each receiver's error may be loosened so that all cost so many times less.
///
/// Cost falls with the square of the error. The weighted sum of square errors is least for
/// errors in proportion to the fourth root of one over the weight [Neyman34]; none is loosened
/// more than [`LOOSEST`] times, and none is tightened.
fn slacks(gathering: &Gathering<'_>, times: f64) -> Vec<f32> {
    let weight = |k: usize| {
        gathering
            .weights
            .get(k)
            .copied()
            .unwrap_or(1.0)
            .max(f32::MIN_POSITIVE)
    };
    let shape: Vec<f32> = (0..gathering.receivers.len())
        .map(|k| weight(k).powf(-0.25))
        .collect();
    let slack = |s: f32, scale: f32| (s * scale).clamp(1.0, LOOSEST);
    let cost = |scale: f32| -> f64 {
        let each = shape.iter().map(|&s| slack(s, scale).powi(-2) as f64);
        each.sum::<f64>() / shape.len().max(1) as f64
    };
    // From the scale that loosens nothing to the one that loosens all as far as it goes; the cost
    // falls along them.
    let first = shape.iter().copied().fold(f32::INFINITY, f32::min).recip();
    let scales: Vec<f32> = std::iter::successors(Some(first), |s| Some(s * STEP))
        .take_while(|s| *s <= STEP * LOOSEST * first)
        .collect();
    let enough = scales.partition_point(|&s| cost(s) * times > 1.0);
    let scale = scales.get(enough).or(scales.last()).copied().unwrap_or(1.0);
    shape.iter().map(|&s| slack(s, scale)).collect()
}
