//! No file that is written may be one that was read.

use std::path::{Path, PathBuf};

/// The first of `written` that is one of `read`, by whatever name.
pub(crate) fn replaced<'w>(read: &[PathBuf], written: &'w [PathBuf]) -> Option<&'w Path> {
    let read: Vec<PathBuf> = read.iter().filter_map(|p| p.canonicalize().ok()).collect();
    let is_read = |p: &&PathBuf| p.canonicalize().is_ok_and(|p| read.contains(&p));
    written.iter().find(is_read).map(PathBuf::as_path)
}
