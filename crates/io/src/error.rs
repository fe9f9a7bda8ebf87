//! Why a file could not be read (file, place, expected, found) or written, in one line.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// A place in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// The file as a whole.
    Whole,
    /// A line of a text file, from 1.
    Line(usize),
    /// A part of it (`mesh 3, primitive 0, POSITION`).
    Part(String),
}

/// What kept a file from being read.
///
/// Printed as one line, without control characters:
/// `room.glb: mesh 3, primitive 0, POSITION: expected VEC3, found 'VEC2'`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct Error {
    /// File name as the user gave it.
    pub file: String,
    /// Where in the file.
    pub place: Place,
    /// What belongs there.
    pub expected: String,
    /// What is there.
    pub found: String,
}

impl Error {
    /// An error whose file and place the callers fill in.
    pub(crate) fn new(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Error {
            file: String::new(),
            place: Place::Whole,
            expected: expected.into(),
            found: found.into(),
        }
    }

    /// The same error at a line.
    pub(crate) fn at_line(mut self, line: usize) -> Self {
        self.place = Place::Line(line);
        self
    }

    /// The same error inside a part: `part` is put before the place that it has.
    pub(crate) fn within(mut self, part: impl fmt::Display) -> Self {
        self.place = Place::Part(match self.place {
            Place::Whole => part.to_string(),
            Place::Line(line) => format!("{part}, line {line}"),
            Place::Part(inner) => format!("{part}, {inner}"),
        });
        self
    }

    /// The same error with its file, unless it names one.
    pub(crate) fn in_file(mut self, file: &str) -> Self {
        if self.file.is_empty() {
            self.file = file.to_owned();
        }
        self
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&clean(&self.file))?;
        match &self.place {
            Place::Whole => f.write_str(": ")?,
            Place::Line(line) => write!(f, ":{line}: ")?,
            Place::Part(part) => write!(f, ": {}: ", clean(part))?,
        }
        write!(
            f,
            "expected {}, found {}",
            clean(&self.expected),
            clean(&self.found)
        )
    }
}

/// What kept a file from being written.
///
/// Printed as one line, without control characters:
/// `room.npz: could not be written: the disk is full`.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The name does not tell which format is wanted.
    #[error("{}: expected a name that ends in {expected}", clean(&path.display().to_string()))]
    Format {
        /// File as the user named it.
        path: PathBuf,
        /// Endings that are known.
        expected: &'static str,
    },
    /// The system, or what was to be written, stood in the way.
    #[error("{}: could not be written: {}", clean(&path.display().to_string()), plainly(source))]
    System {
        /// File as the user named it.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
}

impl WriteError {
    /// The system's answer with its file.
    pub(crate) fn system(path: &Path, source: io::Error) -> Self {
        WriteError::System {
            path: path.to_owned(),
            source,
        }
    }
}

/// The system's answer, in plain words where it is a matter of space.
pub fn plainly(e: &io::Error) -> String {
    match e.kind() {
        io::ErrorKind::StorageFull => "the disk is full".into(),
        io::ErrorKind::QuotaExceeded => "the user's share of the disk is full".into(),
        io::ErrorKind::FileTooLarge => "it is too large for this file system".into(),
        _ => clean(&e.to_string()),
    }
}

/// A piece of text from a file, fit for one line: no control characters, at most 200 characters.
pub(crate) fn clean(text: &str) -> String {
    let mut out: String = text
        .chars()
        .take(200)
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    if text.chars().nth(200).is_some() {
        out.push('…');
    }
    out
}

/// Adds places to the error of a result.
pub(crate) trait Within<T> {
    /// Puts `part` before the place of the error.
    fn within<P: fmt::Display>(self, part: impl FnOnce() -> P) -> Result<T, Error>;
}

impl<T> Within<T> for Result<T, Error> {
    fn within<P: fmt::Display>(self, part: impl FnOnce() -> P) -> Result<T, Error> {
        self.map_err(|e| e.within(part()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_one_line_with_file_place_expected_and_found() {
        let e = Error::new("VEC3", "'VEC2'")
            .within("POSITION")
            .within("primitive 0")
            .within("mesh 3")
            .in_file("room.glb");
        assert_eq!(
            e.to_string(),
            "room.glb: mesh 3, primitive 0, POSITION: expected VEC3, found 'VEC2'"
        );
        let e = Error::new("a number", "'a\nb'")
            .at_line(17)
            .in_file("room.obj");
        assert_eq!(e.to_string(), "room.obj:17: expected a number, found 'a b'");
    }
}
