//! How far a job is, told to whoever watches, who may stop it.

use crate::error::Error;
use crate::stage::Stage;

/// How far a job is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Status {
    /// What is being done.
    pub stage: Stage,
    /// Share of this stage that is done, estimated, 0..=1.
    pub share: f64,
    /// Share of the emitted flux still unshot.
    pub unshot: Option<f64>,
    /// Relative error now.
    pub error: Option<f64>,
    /// Seconds left in this stage, estimated.
    pub left_s: Option<f64>,
}

impl Status {
    /// The start of a stage.
    pub fn begin(stage: Stage) -> Status {
        Status {
            stage,
            share: 0.0,
            unshot: None,
            error: None,
            left_s: None,
        }
    }
}

/// What a watcher wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// Go on.
    Go,
    /// End soon, with valid files.
    Stop,
}

/// Told of every step; answers whether to go on.
pub type Watch<'a> = dyn FnMut(&Status) -> Control + 'a;

/// Says that a stage begins; an error when the watcher wants no more, for stages before there is
/// anything to keep.
pub(crate) fn enter(watch: &mut Watch<'_>, status: &Status) -> Result<(), Error> {
    match watch(status) {
        Control::Go => Ok(()),
        Control::Stop => Err(Error::Stopped),
    }
}
