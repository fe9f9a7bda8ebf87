//! Arrays of numpy in a ZIP file: the npz format.
//!
//! Members are stored, not compressed: factors are noise to a compressor. Those of 4 GiB and more
//! are ZIP64. The same arrays give the same bytes. What is in an array is given piece by piece,
//! so that nothing lies in memory twice.
//!
//! Source: numpy's description of the npy format, version 1.0; [PKZIP].

use std::cell::RefCell;
use std::io::{self, Seek, SeekFrom, Write};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipWriter};

/// Bytes gathered before they are handed on: rows can be short.
pub(super) const RUN: usize = 1 << 16;

/// Writes what `fill` puts into arrays to `out`, and ends the file.
pub(super) fn write<W: Write + Seek>(
    out: &mut W,
    fill: impl FnOnce(&mut Arrays<Patient<'_, W>>) -> io::Result<()>,
) -> io::Result<()> {
    let failure = RefCell::new(None);
    let mut arrays = Arrays {
        zip: ZipWriter::new(Patient {
            out,
            at: 0,
            end: 0,
            failure: &failure,
        }),
        failure: &failure,
    };
    let written = fill(&mut arrays).and_then(|()| arrays.finish());
    match failure.into_inner() {
        Some(first) => Err(first),
        None => written,
    }
}

/// Element type of an array.
#[derive(Clone, Copy)]
pub(super) enum Kind {
    U32,
    U64,
    I32,
    I64,
    F32,
    F64,
    /// Bytes of this length.
    Text(u64),
}

impl Kind {
    /// As numpy writes it, and bytes an element.
    fn described(self) -> (String, u64) {
        match self {
            Kind::U32 => ("<u4".into(), 4),
            Kind::U64 => ("<u8".into(), 8),
            Kind::I32 => ("<i4".into(), 4),
            Kind::I64 => ("<i8".into(), 8),
            Kind::F32 => ("<f4".into(), 4),
            Kind::F64 => ("<f8".into(), 8),
            Kind::Text(n) => (format!("|S{n}"), n),
        }
    }
}

/// The head of an npy file: magic, version 1.0, then a dictionary filled up to 64 bytes.
fn npy_head(descr: &str, shape: &[u64]) -> Vec<u8> {
    let shape = match shape {
        [n] => format!("({n},)"),
        _ => format!(
            "({})",
            shape
                .iter()
                .map(u64::to_string)
                .collect::<Vec<_>>()
                .join(", ")
        ),
    };
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    // Data begins at a multiple of 64; 10 bytes come before the text, a line end after it.
    let filled = (10 + text.len() + 1).next_multiple_of(64);
    text.push_str(&" ".repeat(filled - 11 - text.len()));
    text.push('\n');
    let mut head = b"\x93NUMPY\x01\x00".to_vec();
    head.extend((text.len() as u16).to_le_bytes());
    head.extend(text.as_bytes());
    head
}

/// Arrays one after the other in a ZIP file.
pub(super) struct Arrays<'a, W: Write + Seek> {
    zip: ZipWriter<W>,
    failure: &'a RefCell<Option<io::Error>>,
}

impl<W: Write + Seek> Arrays<'_, W> {
    /// Begins the next array. Its elements follow, as many as `shape` says.
    pub(super) fn start(&mut self, name: &str, kind: Kind, shape: &[u64]) -> io::Result<()> {
        let (descr, size) = kind.described();
        let head = npy_head(&descr, shape);
        let bytes = head.len() as u64 + size * shape.iter().product::<u64>();
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            // No clock and no system in the file: the same matrix, the same bytes.
            .last_modified_time(DateTime::default())
            .system(System::Unix)
            .unix_permissions(0o644)
            .large_file(bytes >= u32::MAX as u64);
        self.zip
            .start_file(format!("{name}.npy"), options)
            .map_err(io_error)?;
        self.bytes(&head)
    }

    pub(super) fn integers(
        &mut self,
        kind: Kind,
        values: impl Iterator<Item = u64>,
    ) -> io::Result<()> {
        self.each(values, |run, v| match kind {
            Kind::U32 | Kind::I32 => run.extend((v as u32).to_le_bytes()),
            _ => run.extend(v.to_le_bytes()),
        })
    }

    pub(super) fn floats(
        &mut self,
        kind: Kind,
        values: impl Iterator<Item = f64>,
    ) -> io::Result<()> {
        self.each(values, |run, v| match kind {
            Kind::F32 => run.extend((v as f32).to_le_bytes()),
            _ => run.extend(v.to_le_bytes()),
        })
    }

    fn each<T>(
        &mut self,
        values: impl Iterator<Item = T>,
        put: impl Fn(&mut Vec<u8>, T),
    ) -> io::Result<()> {
        let mut run = Vec::with_capacity(RUN.min(8 * values.size_hint().0));
        for v in values {
            if run.len() + 8 > RUN {
                self.bytes(&run)?;
                run.clear();
            }
            put(&mut run, v);
        }
        self.bytes(&run)
    }

    pub(super) fn bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.zip.write_all(bytes)?;
        self.go_on()
    }

    fn finish(self) -> io::Result<()> {
        self.zip.finish().map(|_| ()).map_err(io_error)
    }

    /// Stops the writing after a failure; the failure itself is told by [`write`].
    fn go_on(&self) -> io::Result<()> {
        match *self.failure.borrow() {
            Some(_) => Err(io::Error::other("writing failed")),
            None => Ok(()),
        }
    }
}

fn io_error(e: ZipError) -> io::Error {
    match e {
        ZipError::Io(e) => e,
        other => io::Error::other(other),
    }
}

/// A file that keeps its first failure to itself and from then on takes all and writes nothing.
///
/// Without it, a full disk shows twice: `ZipWriter` tries again to end the archive when it is
/// dropped, and prints what comes of it.
pub(super) struct Patient<'a, W> {
    out: &'a mut W,
    at: u64,
    end: u64,
    failure: &'a RefCell<Option<io::Error>>,
}

impl<W: Write + Seek> Patient<'_, W> {
    /// Does `act` unless something failed before; none if it fails.
    fn attempt<T>(&mut self, act: impl FnOnce(&mut W) -> io::Result<T>) -> Option<T> {
        let mut failure = self.failure.borrow_mut();
        if failure.is_some() {
            return None;
        }
        act(self.out).map_err(|e| *failure = Some(e)).ok()
    }
}

impl<W: Write + Seek> Write for Patient<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.attempt(|out| out.write_all(bytes));
        self.at += bytes.len() as u64;
        self.end = self.end.max(self.at);
        Ok(bytes.len())
    }
    fn flush(&mut self) -> io::Result<()> {
        self.attempt(W::flush);
        Ok(())
    }
}

impl<W: Write + Seek> Seek for Patient<'_, W> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let target = match to {
            SeekFrom::Start(n) => Some(n),
            SeekFrom::Current(d) => self.at.checked_add_signed(d),
            SeekFrom::End(d) => self.end.checked_add_signed(d),
        };
        let target = target.ok_or(io::ErrorKind::InvalidInput)?;
        if target != self.at {
            self.attempt(|out| out.seek(SeekFrom::Start(target)));
            self.at = target;
        }
        Ok(target)
    }
}

#[cfg(test)]
pub(super) mod testing {
    use std::io::{Cursor, Read};
    use zip::ZipArchive;

    /// Dictionary and data of an array.
    pub(crate) fn array(bytes: &[u8], name: &str) -> (String, Vec<u8>) {
        let mut archive = ZipArchive::new(Cursor::new(bytes)).expect("a ZIP file");
        let mut member = archive.by_name(&format!("{name}.npy")).expect("there");
        let mut npy = Vec::new();
        // Reading to the end checks the CRC-32.
        member.read_to_end(&mut npy).expect("whole");
        assert_eq!(&npy[..8], b"\x93NUMPY\x01\x00");
        let data = 10 + u16::from_le_bytes([npy[8], npy[9]]) as usize;
        assert_eq!(data % 64, 0, "data begins at a multiple of 64");
        assert_eq!(npy[data - 1], b'\n');
        let text = std::str::from_utf8(&npy[10..data - 1]).expect("text");
        (text.trim_end().to_owned(), npy[data..].to_vec())
    }
}
