//! Triplets as text: `row,column,factor`, rows and columns from 0, rows in order.
//!
//! There is no remark at the head, so that readers of tables need no option for it. The size of
//! the matrix is not in the file: rows at the end without entries leave no trace.

use super::{Precision, write_lines};
use luxel_core::SparseRows;
use std::io::{self, Write};

/// Writes all of the file to `out`.
pub(super) fn write(
    out: &mut impl Write,
    rows: &dyn SparseRows,
    precision: Precision,
) -> io::Result<()> {
    out.write_all(b"row,column,factor\n")?;
    write_lines(out, rows, precision, |text, row, column| {
        write!(text, "{row},{column},")
    })
}

#[cfg(test)]
mod tests {
    use super::super::testing::Rows;
    use super::*;

    #[test]
    fn lines_are_entries_in_order() {
        let mut text = Vec::new();
        write(&mut text, &Rows::example(), Precision::Single).expect("written");
        assert_eq!(
            String::from_utf8(text).expect("text"),
            "row,column,factor\n0,1,0.33333334\n0,2,0.1\n0,3,1e-20\n2,0,1\n2,2,0\n3,3,0.1998249\n"
        );
    }
}
