//! A bound for memory: what a reader is about to allocate is asked for here first.

use crate::error::Error;

/// Bytes that may still be allocated.
#[derive(Debug)]
pub(crate) struct Budget {
    left: u64,
    whole: u64,
}

impl Budget {
    pub(crate) fn new(bytes: u64) -> Self {
        Budget {
            left: bytes,
            whole: bytes,
        }
    }

    pub(crate) fn left(&self) -> u64 {
        self.left
    }

    /// Sets `count` things of `size` bytes aside, or says that it would be too much.
    pub(crate) fn take(&mut self, count: usize, size: usize) -> Result<(), Error> {
        let bytes = (count as u64).saturating_mul(size as u64);
        if bytes > self.left {
            let used = self.whole - self.left;
            return Err(Error::new(
                format!("at most {} of memory for the scene", readable(self.whole)),
                format!("need of {}", readable(used.saturating_add(bytes))),
            ));
        }
        self.left -= bytes;
        Ok(())
    }

    /// Gives bytes back that are not held any more.
    pub(crate) fn give_back(&mut self, count: usize, size: usize) {
        let bytes = (count as u64).saturating_mul(size as u64);
        self.left = self.left.saturating_add(bytes).min(self.whole);
    }
}

/// Bytes for people.
pub(crate) fn readable(bytes: u64) -> String {
    match bytes {
        0..1_000_000 => format!("{} kB", bytes.div_ceil(1000)),
        1_000_000..1_000_000_000 => format!("{} MB", bytes.div_ceil(1_000_000)),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
    }
}
