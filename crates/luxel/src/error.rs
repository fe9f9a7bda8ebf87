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
    #[error("{}: could not be written: {source}", path.display())]
    Write {
        /// File or folder.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// Stopped by whoever watches before there was anything to show.
    #[error("stopped before there was anything to show; nothing was written")]
    Stopped,
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
