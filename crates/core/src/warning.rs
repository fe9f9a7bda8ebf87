//! Warnings: what was odd in the input, where, and what was done about it.

use std::fmt;

/// One kind of oddity at one place, repaired or left aside.
#[derive(Clone, Debug, PartialEq)]
pub struct Warning {
    /// Where: file, then the part of it (`room.glb: mesh 3 'Wall', primitive 0`).
    pub place: String,
    /// What was found and what was done (`dropped degenerate triangles`).
    pub what: String,
    /// How many of them.
    pub count: usize,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.count > 1 {
            write!(f, "{}: {} ({} of them)", self.place, self.what, self.count)
        } else {
            write!(f, "{}: {}", self.place, self.what)
        }
    }
}

/// A list of warnings that counts repetitions instead of growing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Warnings {
    list: Vec<Warning>,
}

impl Warnings {
    /// Adds `count` findings; the same place and words are counted together.
    pub fn add(&mut self, place: impl Into<String>, what: impl Into<String>, count: usize) {
        if count == 0 {
            return;
        }
        let (place, what) = (place.into(), what.into());
        match self
            .list
            .iter_mut()
            .find(|w| w.place == place && w.what == what)
        {
            Some(known) => known.count += count,
            None => self.list.push(Warning { place, what, count }),
        }
    }

    /// All warnings, in the order in which they were first met.
    pub fn iter(&self) -> impl Iterator<Item = &Warning> {
        self.list.iter()
    }

    /// Number of different warnings.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether nothing was odd.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Takes over the warnings of `other`.
    pub fn append(&mut self, other: Warnings) {
        for w in other.list {
            self.add(w.place, w.what, w.count);
        }
    }
}
