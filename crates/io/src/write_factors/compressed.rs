//! A compressed symmetric matrix as plain [arrays](super::arrays) of numpy.
//!
//! The matrix is G = P (B + Bᵀ + T + Tᵀ) Pᵀ, in m²: G[i, j] = A_i F[i, j]. P adds the parts of
//! each row up, B is the sum of the blocks, T of the single entries.
//!
//! | member | type, shape | what |
//! |---|---|---|
//! | `format` | bytes | `luxel-compressed-1`: name and version of this layout |
//! | `areas` | f64 (rows) | area of each row, m² |
//! | `part_row` | u32 (parts) | row of each part; blocks and tiles count parts |
//! | `block_first` | u32 (blocks, 2) | first part of the two runs that a block lies over |
//! | `block_count` | u32 (blocks, 2) | parts in them, m and n |
//! | `block_rank` | u32 (blocks) | r: the block is U Vᵀ, U of m x r, V of n x r |
//! | `u` | f32 | U of each block, column by column: m r numbers |
//! | `v` | f32 | V of each block, column by column: n r numbers |
//! | `tile_row` | u32 (tiles) | a tile begins at part 8 x this |
//! | `tile_column` | u32 (tiles) | and, across, at part 8 x this |
//! | `tile_bits` | u64 (tiles) | bit 8 i + j is set where row i, column j of the tile has an entry |
//! | `entries` | f32 | single entries: tile by tile, in the order of the bits from the lowest |
//!
//! Tiles take about 5 bytes for an entry, where a row and a column beside each would make it 12.

use super::arrays::{self, Arrays, Kind};
use crate::atomic;
use crate::error::WriteError;
use luxel_core::{CompressedPiece, EntryTile, LowRankBlock};
use std::io::{self, Seek, Write};
use std::path::Path;

const FORMAT: &[u8] = b"luxel-compressed-1";

/// Writes a compressed matrix; returns the size of the file in bytes.
///
/// `part_rows` holds the row of each part. Pieces that do not fit
/// ([`CompressedPiece::fits`]), and numbers that are not finite, are an error, not a file.
pub fn write_compressed(
    path: &Path,
    areas_m2: &[f64],
    part_rows: &[u32],
    pieces: &[CompressedPiece],
) -> Result<u64, WriteError> {
    atomic::write_seeking(path, |out| write(out, areas_m2, part_rows, pieces))
        .map_err(|e| WriteError::system(path, e))
}

fn write(
    out: &mut (impl Write + Seek),
    areas_m2: &[f64],
    part_rows: &[u32],
    pieces: &[CompressedPiece],
) -> io::Result<()> {
    check(areas_m2, part_rows, pieces)?;
    arrays::write(out, |npz| write_members(npz, areas_m2, part_rows, pieces))
}

fn check(areas_m2: &[f64], part_rows: &[u32], pieces: &[CompressedPiece]) -> io::Result<()> {
    let broken = |text: &str| Err(io::Error::new(io::ErrorKind::InvalidData, text));
    if part_rows.iter().any(|&row| row as usize >= areas_m2.len()) {
        return broken("a part belongs to no row");
    }
    if !pieces.iter().all(|p| p.fits(part_rows.len())) {
        return broken("blocks or tiles do not fit their numbers");
    }
    let finite = |p: &CompressedPiece| p.factors.iter().chain(&p.entries).all(|v| v.is_finite());
    if !pieces.iter().all(finite) || !areas_m2.iter().all(|a| a.is_finite()) {
        return broken("a number is not finite");
    }
    Ok(())
}

fn write_members(
    npz: &mut Arrays<impl Write + Seek>,
    areas_m2: &[f64],
    part_rows: &[u32],
    pieces: &[CompressedPiece],
) -> io::Result<()> {
    npz.start("format", Kind::Text(FORMAT.len() as u64), &[])?;
    npz.bytes(FORMAT)?;
    npz.start("areas", Kind::F64, &[areas_m2.len() as u64])?;
    npz.floats(Kind::F64, areas_m2.iter().copied())?;
    npz.start("part_row", Kind::U32, &[part_rows.len() as u64])?;
    npz.integers(Kind::U32, part_rows.iter().map(|&row| row as u64))?;

    let blocks = || pieces.iter().flat_map(|p| &p.blocks);
    let count = blocks().count() as u64;
    npz.start("block_first", Kind::U32, &[count, 2])?;
    npz.integers(Kind::U32, blocks().flat_map(|b| b.first).map(u64::from))?;
    npz.start("block_count", Kind::U32, &[count, 2])?;
    npz.integers(Kind::U32, blocks().flat_map(|b| b.count).map(u64::from))?;
    npz.start("block_rank", Kind::U32, &[count])?;
    npz.integers(Kind::U32, blocks().map(|b| b.rank as u64))?;
    for (side, name) in ["u", "v"].into_iter().enumerate() {
        let numbers = |b: &LowRankBlock| b.rank as u64 * b.count[side] as u64;
        npz.start(name, Kind::F32, &[blocks().map(numbers).sum()])?;
        for piece in pieces {
            let mut rest = &piece.factors[..];
            for block in &piece.blocks {
                let [m, n] = block.count.map(|c| c as usize);
                for _ in 0..block.rank {
                    let (column, others) = rest.split_at(m + n);
                    rest = others;
                    let own = if side == 0 {
                        &column[..m]
                    } else {
                        &column[m..]
                    };
                    npz.floats(Kind::F32, own.iter().map(|&v| v as f64))?;
                }
            }
        }
    }

    let tiles = || pieces.iter().flat_map(|p| &p.tiles);
    let count = tiles().count() as u64;
    let mut of_tiles = |name: &str, kind: Kind, value: fn(&EntryTile) -> u64| {
        npz.start(name, kind, &[count])?;
        npz.integers(kind, tiles().map(value))
    };
    of_tiles("tile_row", Kind::U32, |t| t.row as u64)?;
    of_tiles("tile_column", Kind::U32, |t| t.column as u64)?;
    of_tiles("tile_bits", Kind::U64, |t| t.bits)?;
    let entries = pieces.iter().map(|p| p.entries.len() as u64).sum();
    npz.start("entries", Kind::F32, &[entries])?;
    let numbers = pieces.iter().flat_map(|p| &p.entries);
    npz.floats(Kind::F32, numbers.map(|&v| v as f64))
}

#[cfg(test)]
mod tests {
    use super::super::arrays::testing::array;
    use super::*;
    use std::io::Cursor;

    /// Two pieces: one with a block of rank 2 over three and two parts, one with two tiles.
    fn pieces() -> Vec<CompressedPiece> {
        vec![
            CompressedPiece {
                blocks: vec![LowRankBlock {
                    first: [1, 7],
                    count: [3, 2],
                    rank: 2,
                }],
                factors: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0],
                ..CompressedPiece::default()
            },
            CompressedPiece {
                tiles: vec![
                    EntryTile {
                        row: 0,
                        column: 1,
                        bits: 0b10_0000_0001,
                    },
                    EntryTile {
                        row: 1,
                        column: 1,
                        bits: 1 << 63,
                    },
                ],
                entries: vec![0.25, 0.5, 0.75],
                ..CompressedPiece::default()
            },
        ]
    }

    const PARTS: [u32; 9] = [0, 0, 1, 1, 1, 2, 2, 2, 0];

    #[test]
    fn members_are_what_the_head_of_this_file_says() {
        let mut out = Cursor::new(Vec::new());
        write(&mut out, &[1.0, 2.0, 0.5], &PARTS, &pieces()).expect("written");
        let bytes = out.into_inner();
        let u4 = |v: &[u32]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let f4 = |v: &[f32]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let u8s = |v: &[u64]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let f8 = |v: &[f64]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        for (name, kind, shape, data) in [
            ("format", "|S18", "()", FORMAT.to_vec()),
            ("areas", "<f8", "(3,)", f8(&[1.0, 2.0, 0.5])),
            ("part_row", "<u4", "(9,)", u4(&PARTS)),
            ("block_first", "<u4", "(1, 2)", u4(&[1, 7])),
            ("block_count", "<u4", "(1, 2)", u4(&[3, 2])),
            ("block_rank", "<u4", "(1,)", u4(&[2])),
            ("u", "<f4", "(6,)", f4(&[1.0, 2.0, 3.0, 6.0, 7.0, 8.0])),
            ("v", "<f4", "(4,)", f4(&[4.0, 5.0, 9.0, 10.0])),
            ("tile_row", "<u4", "(2,)", u4(&[0, 1])),
            ("tile_column", "<u4", "(2,)", u4(&[1, 1])),
            ("tile_bits", "<u8", "(2,)", u8s(&[0b10_0000_0001, 1 << 63])),
            ("entries", "<f4", "(3,)", f4(&[0.25, 0.5, 0.75])),
        ] {
            let head = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
            assert_eq!(array(&bytes, name), (head, data), "{name}");
        }
    }

    #[test]
    fn what_does_not_fit_or_is_not_finite_leaves_no_file() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.npz");
        let mut short = pieces();
        short[0].factors.pop();
        let mut infinite = pieces();
        infinite[1].entries[2] = f32::INFINITY;
        for (areas, pieces, why) in [
            (&[1.0, 2.0][..], pieces(), "a part belongs to no row"),
            (&[1.0; 3][..], short, "blocks or tiles do not fit"),
            (&[1.0; 3][..], infinite, "a number is not finite"),
            (&[f64::NAN; 3][..], pieces(), "a number is not finite"),
        ] {
            let told = write_compressed(&path, areas, &PARTS, &pieces).expect_err("broken");
            let told = told.to_string();
            assert!(told.contains(why), "{told}");
            assert_eq!(std::fs::read_dir(folder.path()).expect("read").count(), 0);
        }
        let size = write_compressed(&path, &[1.0; 3], &PARTS, &pieces()).expect("written");
        assert_eq!(size, std::fs::metadata(&path).expect("there").len());
    }
}
