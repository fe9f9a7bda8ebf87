//! Matrix Market, coordinate format: rows and columns from 1, as the format asks.
//!
//! `general` although exchange areas are symmetric: factors are not, A_i F_ij = A_j F_ji.
//!
//! Source: [Boisvert96].

use super::{Precision, write_lines};
use luxel_core::SparseRows;
use std::io::{self, Write};

/// Writes all of the file to `out`.
pub(super) fn write(
    out: &mut impl Write,
    rows: &dyn SparseRows,
    precision: Precision,
) -> io::Result<()> {
    let [height, width] = rows.shape();
    out.write_all(b"%%MatrixMarket matrix coordinate real general\n")?;
    out.write_all(b"% View factors: the share of what leaves facet i that arrives at facet j,\n")?;
    out.write_all(b"% i = row, j = column, facets counted from 1 in the order of their file.\n")?;
    writeln!(out, "{height} {width} {}", rows.entries())?;
    write_lines(out, rows, precision, |text, row, column| {
        write!(text, "{} {} ", row + 1, column as u64 + 1)
    })
}

#[cfg(test)]
mod tests {
    use super::super::testing::Rows;
    use super::*;

    #[test]
    fn the_size_line_and_entries_from_one() {
        let mut text = Vec::new();
        write(&mut text, &Rows::example(), Precision::Double).expect("written");
        let text = String::from_utf8(text).expect("text");
        assert!(text.starts_with("%%MatrixMarket matrix coordinate real general\n% "));
        let kept: Vec<&str> = text.lines().filter(|l| !l.starts_with('%')).collect();
        assert_eq!(
            kept,
            [
                "4 4 6",
                "1 2 0.3333333333333333",
                "1 3 0.1",
                "1 4 1e-20",
                "3 1 1",
                "3 3 0",
                "4 4 0.1998248956983874"
            ]
        );
    }
}
