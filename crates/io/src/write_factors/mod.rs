//! Sparse matrices of factors as other programs read them, in one of three formats.
//!
//! | ending | what | numbering |
//! |---|---|---|
//! | `.npz` | CSR arrays of `scipy.sparse.load_npz`, and the areas of the rows | from 0 |
//! | `.csv` | a line `row,column,factor` an entry, under such a line | from 0 |
//! | `.mtx` | Matrix Market, coordinate real general | from 1, as that format asks |
//!
//! [`write_compressed`] writes a matrix of another kind: low-rank blocks and single entries.
//!
//! Rows are read from the matrix as they are written, more than once if need be, so a matrix
//! that just fits into memory can be written. The same matrix gives the same bytes. A file is
//! whole or what was there before stays (see [`atomic`]).

mod arrays;
mod compressed;
mod csv;
mod mtx;
mod npz;

use crate::atomic;
use crate::error::WriteError;
use luxel_core::SparseRows;
use std::io::{self, Write};
use std::path::Path;

pub use compressed::write_compressed;

/// A format that a matrix of factors can be written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FactorFormat {
    /// Arrays of a CSR matrix for `scipy.sparse.load_npz`. The only one that also carries the
    /// areas: array `areas`, f64, m², one a row.
    Npz,
    /// Triplets as text with a heading, rows and columns from 0.
    Csv,
    /// Matrix Market, rows and columns from 1.
    Mtx,
}

impl FactorFormat {
    /// The endings that [`of`](FactorFormat::of) knows, as a user would list them.
    pub const ENDINGS: &'static str = ".npz, .csv or .mtx";

    /// The format that the ending of a name asks for, in capitals or not.
    pub fn of(path: &Path) -> Result<FactorFormat, WriteError> {
        let ending = path.extension().map(|e| e.to_ascii_lowercase());
        match ending.as_deref().and_then(|e| e.to_str()) {
            Some("npz") => Ok(FactorFormat::Npz),
            Some("csv") => Ok(FactorFormat::Csv),
            Some("mtx") => Ok(FactorFormat::Mtx),
            _ => Err(WriteError::Format {
                path: path.to_owned(),
                expected: FactorFormat::ENDINGS,
            }),
        }
    }
}

/// How many digits of a factor are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// f32: 7 digits, half the size.
    #[default]
    Single,
    /// f64: all digits.
    Double,
}

impl Precision {
    /// The value that is written for `value`.
    fn kept(self, value: f64) -> f64 {
        match self {
            Precision::Single => value as f32 as f64,
            Precision::Double => value,
        }
    }
}

/// Writes a matrix of factors in the format that the name's ending asks for; returns the size of
/// the file in bytes.
///
/// `areas_m2` holds one area a row. Every entry of the matrix becomes an entry of the file, zeros
/// too. Rows that break what [`SparseRows`] promises, or hold what is not finite in `precision`,
/// are an error, not a file. Panics if there are not as many areas as rows.
pub fn write_factors(
    path: &Path,
    rows: &dyn SparseRows,
    areas_m2: &[f64],
    precision: Precision,
) -> Result<u64, WriteError> {
    assert_eq!(areas_m2.len(), rows.shape()[0], "one area a row");
    let format = FactorFormat::of(path)?;
    atomic::write_seeking(path, |out| match format {
        FactorFormat::Npz => npz::write(out, rows, areas_m2, precision),
        FactorFormat::Csv => csv::write(out, rows, precision),
        FactorFormat::Mtx => mtx::write(out, rows, precision),
    })
    .map_err(|e| WriteError::system(path, e))
}

/// Hands on each row, with its values as they are written, once it was held against what
/// [`SparseRows`] promises: a reader of the file would not notice.
fn each_row(
    rows: &dyn SparseRows,
    precision: Precision,
    mut take: impl FnMut(usize, &[(u32, f64)]) -> io::Result<()>,
) -> io::Result<()> {
    let broken = |text: String| Err(io::Error::new(io::ErrorKind::InvalidData, text));
    let [height, width] = rows.shape();
    let mut entries = Vec::new();
    let mut seen = 0u64;
    for row in 0..height {
        rows.row(row, &mut entries);
        let mut least = 0;
        for (column, value) in &mut entries {
            if (*column as usize) < least || *column as usize >= width {
                return broken(format!("row {row} has column {column} out of place"));
            }
            least = *column as usize + 1;
            let kept = precision.kept(*value);
            if !kept.is_finite() {
                return broken(format!("row {row}, column {column} holds {value}"));
            }
            *value = kept;
        }
        seen += entries.len() as u64;
        take(row, &entries)?;
    }
    match seen == rows.entries() {
        true => Ok(()),
        false => broken(format!(
            "{} entries were announced, there are {seen}",
            rows.entries()
        )),
    }
}

/// Writes a line for each entry: what `place` puts for row and column, then the value.
fn write_lines(
    out: &mut impl Write,
    rows: &dyn SparseRows,
    precision: Precision,
    place: impl Fn(&mut Vec<u8>, usize, u32) -> io::Result<()>,
) -> io::Result<()> {
    let mut text = Vec::new();
    each_row(rows, precision, |row, entries| {
        text.clear();
        for &(column, value) in entries {
            place(&mut text, row, column)?;
            push_number(&mut text, value, precision);
            text.push(b'\n');
        }
        out.write_all(&text)
    })
}

/// Appends a number in the fewest digits that are read back as the same number.
fn push_number(text: &mut Vec<u8>, value: f64, precision: Precision) {
    use std::io::Write;
    // Plain digits where they are short, an exponent where they would be mostly zeros.
    let plain = value == 0.0 || (1e-4..1e15).contains(&value.abs());
    match (precision, plain) {
        (Precision::Single, true) => write!(text, "{}", value as f32),
        (Precision::Single, false) => write!(text, "{:e}", value as f32),
        (Precision::Double, true) => write!(text, "{value}"),
        (Precision::Double, false) => write!(text, "{value:e}"),
    }
    .expect("memory takes all that is written");
}

#[cfg(test)]
pub(crate) mod testing {
    use luxel_core::SparseRows;

    /// A matrix in memory that may lie about itself.
    pub(crate) struct Rows {
        pub shape: [usize; 2],
        pub rows: Vec<Vec<(u32, f64)>>,
        pub entries: u64,
    }

    impl Rows {
        pub(crate) fn new(columns: usize, rows: Vec<Vec<(u32, f64)>>) -> Rows {
            Rows {
                shape: [rows.len(), columns],
                entries: rows.iter().map(|r| r.len() as u64).sum(),
                rows,
            }
        }

        /// Four rows, the second empty; values that need all digits, are tiny or zero.
        pub(crate) fn example() -> Rows {
            Rows::new(
                4,
                vec![
                    vec![(1, 1.0 / 3.0), (2, 0.1), (3, 1e-20)],
                    vec![],
                    vec![(0, 1.0), (2, 0.0)],
                    vec![(3, 0.199_824_895_698_387_4)],
                ],
            )
        }
    }

    impl SparseRows for Rows {
        fn shape(&self) -> [usize; 2] {
            self.shape
        }
        fn entries(&self) -> u64 {
            self.entries
        }
        fn row(&self, row: usize, entries: &mut Vec<(u32, f64)>) {
            entries.clone_from(&self.rows[row]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::testing::Rows;
    use super::*;
    use std::process::Command;

    const AREAS: [f64; 4] = [1.0, 2.5, 0.1, 4.0];

    #[test]
    fn the_ending_chooses_the_format() {
        for (name, format) in [
            ("a.npz", FactorFormat::Npz),
            ("a.b.CSV", FactorFormat::Csv),
            ("folder.npz/a.Mtx", FactorFormat::Mtx),
        ] {
            assert_eq!(FactorFormat::of(Path::new(name)).expect("known"), format);
        }
        for name in ["a", "a.txt", ".npz", "npz", "a.npz/"] {
            let known = FactorFormat::of(Path::new(name)).is_ok();
            assert_eq!(known, name == "a.npz/", "{name}");
        }
        let told = FactorFormat::of(Path::new("out.xlsx")).expect_err("unknown");
        assert_eq!(
            told.to_string(),
            "out.xlsx: expected a name that ends in .npz, .csv or .mtx"
        );
    }

    #[test]
    fn numbers_are_short_and_read_back_as_themselves() {
        // Decimal to binary is exact by the contract of `str::parse`.
        let text = |v: f64, p: Precision| {
            let mut text = Vec::new();
            push_number(&mut text, v, p);
            String::from_utf8(text).expect("digits")
        };
        for v in [0.0, 1.0, 0.1, 1.0 / 3.0, 1e-20, 5e-324, 9.999e-5, 1e15, 3e7] {
            let double: f64 = text(v, Precision::Double).parse().expect("a number");
            assert_eq!(double, v);
            let single: f32 = text(v, Precision::Single).parse().expect("a number");
            assert_eq!(single, v as f32);
        }
        assert_eq!(text(1.0 / 3.0, Precision::Single), "0.33333334");
        assert_eq!(text(1e-20, Precision::Double), "1e-20");
    }

    #[test]
    fn the_size_returned_is_that_of_the_file_and_bytes_repeat() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for name in ["a.npz", "a.csv", "a.mtx"] {
            for precision in [Precision::Single, Precision::Double] {
                let path = folder.path().join(name);
                let size = write_factors(&path, &Rows::example(), &AREAS, precision);
                let bytes = std::fs::read(&path).expect("there");
                assert_eq!(size.expect("written"), bytes.len() as u64);
                write_factors(&path, &Rows::example(), &AREAS, precision).expect("written");
                assert_eq!(std::fs::read(&path).expect("there"), bytes);
            }
        }
    }

    #[test]
    fn rows_that_break_their_promise_leave_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let one = |entries: Vec<(u32, f64)>| Rows::new(2, vec![entries]);
        let short = Rows {
            entries: 3,
            ..one(vec![(0, 0.5)])
        };
        let long = Rows {
            entries: 0,
            ..one(vec![(0, 0.5)])
        };
        let cases = [
            (short, "3 entries were announced, there are 1"),
            (long, "0 entries were announced, there are 1"),
            (one(vec![(2, 0.5)]), "row 0 has column 2 out of place"),
            (
                one(vec![(1, 0.5), (0, 0.5)]),
                "row 0 has column 0 out of place",
            ),
            (
                one(vec![(1, 0.5), (1, 0.5)]),
                "row 0 has column 1 out of place",
            ),
            (one(vec![(1, f64::NAN)]), "row 0, column 1 holds NaN"),
            // Finite, but not in f32.
            (one(vec![(1, 1e200)]), "row 0, column 1 holds 1"),
        ];
        for name in ["a.npz", "a.csv", "a.mtx"] {
            let path = folder.path().join(name);
            std::fs::write(&path, "old").expect("written");
            for (rows, why) in &cases {
                let told = write_factors(&path, rows, &[1.0], Precision::Single)
                    .expect_err("broken rows")
                    .to_string();
                assert!(told.contains(&format!("{name}: could not be written: {why}")));
                assert_eq!(std::fs::read(&path).expect("there"), b"old");
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).expect("read").count(), 3);
    }

    #[test]
    fn a_full_disk_is_named_with_the_file() {
        let e = WriteError::system(
            Path::new("room.npz"),
            io::Error::new(io::ErrorKind::StorageFull, "No space left on device"),
        );
        assert_eq!(
            e.to_string(),
            "room.npz: could not be written: the disk is full"
        );
        let told = write_factors(
            Path::new("no-such-folder/a.csv"),
            &Rows::example(),
            &AREAS,
            Precision::Single,
        )
        .expect_err("no folder");
        let told = told.to_string();
        assert!(told.starts_with("no-such-folder/a.csv: could not be written: "));
    }

    /// Reads all three files as a user would; exit code 77 where numpy or scipy is not there.
    const READ_ALL: &str = r#"
import csv, sys
try:
    import numpy, scipy.io, scipy.sparse
except ImportError as e:
    print(e); sys.exit(77)
npz, text, mtx, single = *sys.argv[1:4], sys.argv[4] == "single"
kind = numpy.float32 if single else numpy.float64
expected = numpy.zeros((4, 4), kind)
for i, j, v in [(0,1,1/3), (0,2,0.1), (0,3,1e-20), (2,0,1.0), (2,2,0.0), (3,3,0.1998248956983874)]:
    expected[i, j] = v
m = scipy.sparse.load_npz(npz)
assert m.format == "csr" and m.shape == (4, 4) and m.nnz == 6, m
assert m.data.dtype == kind and m.has_sorted_indices
m.check_format(full_check=True)
assert (m.toarray() == expected).all(), m
with numpy.load(npz) as arrays:
    assert arrays["areas"].tolist() == [1.0, 2.5, 0.1, 4.0]
    assert arrays["shape"].dtype == numpy.int64 and arrays["indices"].dtype == numpy.int32
t = scipy.io.mmread(mtx)
assert t.shape == (4, 4) and t.nnz == 6
assert (t.toarray().astype(kind) == expected).all(), t
found = numpy.zeros((4, 4), kind)
with open(text, newline="") as file:
    for line in csv.DictReader(file):
        found[int(line["row"]), int(line["column"])] = float(line["factor"])
assert (found == expected).all(), found
"#;

    #[test]
    fn scipy_reads_all_three() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (precision, word) in [(Precision::Single, "single"), (Precision::Double, "double")] {
            let paths = ["a.npz", "a.csv", "a.mtx"].map(|name| folder.path().join(name));
            for path in &paths {
                write_factors(path, &Rows::example(), &AREAS, precision).expect("written");
            }
            let run = Command::new("python3")
                .args(["-c", READ_ALL])
                .args(&paths)
                .arg(word)
                .output();
            match run {
                Err(e) => return eprintln!("skipped: python3: {e}"),
                Ok(out) if out.status.code() == Some(77) => {
                    return eprintln!("skipped: {}", String::from_utf8_lossy(&out.stdout).trim());
                }
                Ok(out) => {
                    let told = String::from_utf8_lossy(&out.stderr);
                    assert!(out.status.success(), "{word}: {told}");
                }
            }
        }
    }
}
