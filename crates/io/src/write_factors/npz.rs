//! A CSR matrix as `scipy.sparse.load_npz` opens it: arrays of numpy in a ZIP file.
//!
//! | member | type | what |
//! |---|---|---|
//! | `indices` | i32, i64 where i32 is too small | column of each entry, row by row |
//! | `indptr` | as `indices` | where each row begins, and the end of the last |
//! | `format` | bytes | `csr` |
//! | `shape` | i64 | rows, columns |
//! | `data` | f32 or f64 | value of each entry |
//! | `areas` | f64 | area of each row, m²; `load_npz` passes over it, `numpy.load` shows it |
//!
//! Members are stored, not compressed: factors are noise to a compressor. Those of 4 GiB and more
//! are ZIP64. Rows are read twice, for `indices` and for `data`.
//!
//! Source: numpy's description of the npy format, version 1.0; [PKZIP].

use super::{Precision, each_row};
use luxel_core::SparseRows;
use std::cell::RefCell;
use std::io::{self, Seek, SeekFrom, Write};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipWriter};

/// Bytes gathered before they are handed on: rows can be short.
const RUN: usize = 1 << 16;

/// Writes all of the file to `out`.
pub(super) fn write(
    out: &mut (impl Write + Seek),
    rows: &dyn SparseRows,
    areas_m2: &[f64],
    precision: Precision,
) -> io::Result<()> {
    let failure = RefCell::new(None);
    let zip = ZipWriter::new(Patient {
        out,
        at: 0,
        end: 0,
        failure: &failure,
    });
    let written = write_members(
        Members {
            zip,
            failure: &failure,
        },
        rows,
        areas_m2,
        precision,
    );
    match failure.into_inner() {
        Some(first) => Err(first),
        None => written,
    }
}

fn write_members(
    mut npz: Members<impl Write + Seek>,
    rows: &dyn SparseRows,
    areas_m2: &[f64],
    precision: Precision,
) -> io::Result<()> {
    let [height, width] = rows.shape();
    let count = rows.entries();
    // One type for both index arrays, which must hold every column and the number of entries.
    let most = count.max(height as u64).max(width as u64);
    let index = if most > i32::MAX as u64 {
        Kind::I64
    } else {
        Kind::I32
    };
    let value = match precision {
        Precision::Single => Kind::F32,
        Precision::Double => Kind::F64,
    };

    npz.start("indices", index, &[count])?;
    let mut starts = Vec::with_capacity(height + 1);
    starts.push(0u64);
    each_row(rows, precision, |row, entries| {
        starts.push(starts[row] + entries.len() as u64);
        let columns = entries.iter().map(|e| e.0 as u64);
        npz.integers(index, columns)
    })?;
    npz.start("indptr", index, &[starts.len() as u64])?;
    npz.integers(index, starts.into_iter())?;
    npz.start("format", Kind::Text(3), &[])?;
    npz.bytes(b"csr")?;
    npz.start("shape", Kind::I64, &[2])?;
    npz.integers(Kind::I64, [height as u64, width as u64].into_iter())?;
    npz.start("data", value, &[count])?;
    each_row(rows, precision, |_, entries| {
        npz.floats(value, entries.iter().map(|e| e.1))
    })?;
    npz.start("areas", Kind::F64, &[height as u64])?;
    npz.floats(Kind::F64, areas_m2.iter().copied())?;
    npz.finish()
}

/// Element type of an array.
#[derive(Clone, Copy)]
enum Kind {
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
struct Members<'a, W: Write + Seek> {
    zip: ZipWriter<W>,
    failure: &'a RefCell<Option<io::Error>>,
}

impl<W: Write + Seek> Members<'_, W> {
    /// Begins the next array. Its elements follow, as many as `shape` says.
    fn start(&mut self, name: &str, kind: Kind, shape: &[u64]) -> io::Result<()> {
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

    fn integers(&mut self, kind: Kind, values: impl Iterator<Item = u64>) -> io::Result<()> {
        self.each(values, |run, v| match kind {
            Kind::I32 => run.extend((v as i32).to_le_bytes()),
            _ => run.extend(v.to_le_bytes()),
        })
    }

    fn floats(&mut self, kind: Kind, values: impl Iterator<Item = f64>) -> io::Result<()> {
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

    fn bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
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
struct Patient<'a, W> {
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
mod tests {
    use super::super::testing::Rows;
    use super::*;
    use std::io::{Cursor, Read};
    use zip::ZipArchive;

    fn written(rows: &Rows, areas: &[f64], precision: Precision) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        write(&mut out, rows, areas, precision).expect("written");
        out.into_inner()
    }

    /// Dictionary and data of an array.
    fn array(bytes: &[u8], name: &str) -> (String, Vec<u8>) {
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

    fn head(descr: &str, shape: &str) -> String {
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}")
    }

    #[test]
    fn members_are_the_arrays_of_a_csr_matrix() {
        let bytes = written(&Rows::example(), &[1.0, 2.5, 0.1, 4.0], Precision::Double);
        let i32s = |v: &[i32]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let f64s = |v: &[f64]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let expected = [
            ("indices", head("<i4", "(6,)"), i32s(&[1, 2, 3, 0, 2, 3])),
            ("indptr", head("<i4", "(5,)"), i32s(&[0, 3, 3, 5, 6])),
            ("format", head("|S3", "()"), b"csr".to_vec()),
            ("shape", head("<i8", "(2,)"), i32s(&[4, 0, 4, 0])),
            (
                "data",
                head("<f8", "(6,)"),
                f64s(&[1.0 / 3.0, 0.1, 1e-20, 1.0, 0.0, 0.199_824_895_698_387_4]),
            ),
            ("areas", head("<f8", "(4,)"), f64s(&[1.0, 2.5, 0.1, 4.0])),
        ];
        for (name, head, data) in expected {
            assert_eq!(array(&bytes, name), (head, data), "{name}");
        }
        let archive = ZipArchive::new(Cursor::new(&bytes[..])).expect("a ZIP file");
        assert_eq!(archive.len(), 6);

        let bytes = written(&Rows::example(), &[1.0; 4], Precision::Single);
        let (head_found, data) = array(&bytes, "data");
        assert_eq!(head_found, head("<f4", "(6,)"));
        assert_eq!(data[..4], (1.0f32 / 3.0).to_le_bytes());
    }

    #[test]
    fn a_matrix_without_rows_and_one_with_many_columns() {
        let bytes = written(&Rows::new(0, vec![]), &[], Precision::Single);
        assert_eq!(array(&bytes, "indptr"), (head("<i4", "(1,)"), vec![0; 4]));
        assert_eq!(array(&bytes, "data"), (head("<f4", "(0,)"), vec![]));
        // A column beyond i32 makes both index arrays i64, as scipy wants them alike.
        let far = Rows::new(1 << 32, vec![vec![(u32::MAX, 0.5)]]);
        let bytes = written(&far, &[1.0], Precision::Single);
        let column = (u32::MAX as u64).to_le_bytes().to_vec();
        assert_eq!(array(&bytes, "indices"), (head("<i8", "(1,)"), column));
        assert_eq!(array(&bytes, "indptr").0, head("<i8", "(2,)"));
    }

    #[test]
    fn rows_longer_than_a_run_stay_in_order() {
        let n = 3 * RUN as u32 / 4 + 5;
        let long = Rows::new(n as usize, vec![(0..n).map(|j| (j, j as f64)).collect()]);
        let bytes = written(&long, &[1.0], Precision::Double);
        let data = array(&bytes, "data").1;
        assert_eq!(data.len(), 8 * n as usize);
        for (j, v) in data.chunks_exact(8).enumerate() {
            assert_eq!(v, (j as f64).to_le_bytes());
        }
    }

    /// Takes so many bytes, then is full.
    struct Small {
        inner: Cursor<Vec<u8>>,
        room: usize,
    }
    impl Write for Small {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if bytes.len() > self.room {
                return Err(io::ErrorKind::StorageFull.into());
            }
            self.room -= bytes.len();
            self.inner.write(bytes)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    impl Seek for Small {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.inner.seek(to)
        }
    }

    #[test]
    fn a_disk_that_fills_up_anywhere_is_told_as_that() {
        let whole = written(&Rows::example(), &[1.0; 4], Precision::Single).len();
        // Sums are filled in afterwards, so somewhat more is written than stays.
        let mut done = 0;
        for room in 0..whole + 400 {
            let mut out = Small {
                inner: Cursor::new(Vec::new()),
                room,
            };
            match write(&mut out, &Rows::example(), &[1.0; 4], Precision::Single) {
                Ok(()) => done += 1,
                Err(e) => assert_eq!(e.kind(), io::ErrorKind::StorageFull, "{room}"),
            }
        }
        assert!(done > 0 && done <= 400, "{done}");
    }
}
