//! What can go wrong in a session, in one clear line each.

use std::path::PathBuf;

/// Why a session could not start or a result could not be written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A scene file could not be read.
    #[error(transparent)]
    Read(#[from] luxel_io::Error),
    /// A setting does not fit the scene.
    #[error("{0}")]
    Setting(String),
    /// A result could not be written.
    #[error("{}: could not be written: {}", path.display(), luxel_io::plainly(source))]
    Write {
        /// File or folder.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The same, where work is kept.
    #[error("{}: could not be written: {}; {percent:.0} % of the work is kept in {}, --resume goes on from there", path.display(), luxel_io::plainly(source), part.display())]
    WriteKept {
        /// File.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
        /// Where the work is.
        part: PathBuf,
        /// How much of it, 0..=100.
        percent: f64,
    },
    /// Stopped by whoever watches before there was anything to show.
    #[error("stopped before there was anything to show; nothing was written")]
    Stopped,
    /// Stopped by whoever watches; no result is written, but the work that is done is kept.
    #[error("stopped at {percent:.0} %: no matrix is written, what is done is kept in {}; --resume goes on from there", part.display())]
    StoppedKept {
        /// Where the work is.
        part: PathBuf,
        /// How much of it, 0..=100.
        percent: f64,
    },
    /// The memory bound is too small for these view factors.
    #[error(
        "{scene}: needs about {needed_mb} MB, more than --memory allows ({bound_mb} MB); {advice}"
    )]
    FactorsMemory {
        /// Scene name.
        scene: String,
        /// Estimate, 10^6 bytes.
        needed_mb: u64,
        /// Bound, 10^6 bytes.
        bound_mb: u64,
        /// What was done, what is kept, what can be asked for instead.
        advice: String,
    },
    /// The memory bound is too small for this scene.
    #[error("{scene}: needs about {needed_mb} MB, more than --memory allows ({bound_mb} MB)")]
    Memory {
        /// Scene name.
        scene: String,
        /// Estimate, 10^6 bytes.
        needed_mb: u64,
        /// Bound, 10^6 bytes.
        bound_mb: u64,
    },
}

impl From<luxel_io::WriteError> for Error {
    fn from(error: luxel_io::WriteError) -> Self {
        match error {
            luxel_io::WriteError::System { path, source } => Error::Write { path, source },
            other => Error::Setting(other.to_string()),
        }
    }
}
