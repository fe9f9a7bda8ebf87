//! A CSR matrix as `scipy.sparse.load_npz` opens it: [arrays](super::arrays) of these names.
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
//! Rows are read twice, for `indices` and for `data`.

use super::arrays::{self, Arrays, Kind};
use super::{Precision, each_row};
use luxel_core::SparseRows;
use std::io::{self, Seek, Write};

/// Writes all of the file to `out`.
pub(super) fn write(
    out: &mut (impl Write + Seek),
    rows: &dyn SparseRows,
    areas_m2: &[f64],
    precision: Precision,
) -> io::Result<()> {
    arrays::write(out, |npz| write_members(npz, rows, areas_m2, precision))
}

fn write_members(
    npz: &mut Arrays<impl Write + Seek>,
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
    npz.floats(Kind::F64, areas_m2.iter().copied())
}

#[cfg(test)]
mod tests {
    use super::super::arrays::RUN;
    use super::super::arrays::testing::array;
    use super::super::testing::Rows;
    use super::*;
    use std::io::{Cursor, SeekFrom};
    use zip::ZipArchive;

    fn written(rows: &Rows, areas: &[f64], precision: Precision) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        write(&mut out, rows, areas, precision).expect("written");
        out.into_inner()
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
