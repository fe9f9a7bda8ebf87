//! A compressed symmetric matrix over parts: blocks of low rank, and single entries in tiles.
//!
//! Plain records, made by `transport`, written and read by `io`. Numbers are exchange areas
//! A_i F_ij, m². Each pair of parts is stored once and serves both directions.

/// Parts along the side of a tile.
pub const TILE_SIDE: usize = 8;

/// What one pair of the clusters that make up everything holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CompressedPiece {
    /// Blocks of low rank.
    pub blocks: Vec<LowRankBlock>,
    /// Of each block for each of its ranks: a column of U, a column of V.
    pub factors: Vec<f32>,
    /// Where single entries are.
    pub tiles: Vec<EntryTile>,
    /// Entries of the tiles, in the order of bits.
    pub entries: Vec<f32>,
}

/// A block U Vᵀ over two runs of parts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LowRankBlock {
    /// First part of each run.
    pub first: [u32; 2],
    /// Parts in each run: rows of U, rows of V.
    pub count: [u32; 2],
    /// Columns of U and of V.
    pub rank: u32,
}

/// Entries of parts from `TILE_SIDE * row` and `TILE_SIDE * column` on; bit `TILE_SIDE * i + j`
/// is set where there is one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EntryTile {
    /// Eighth part of a row.
    pub row: u32,
    /// Eighth part of a column.
    pub column: u32,
    /// Which entries there are.
    pub bits: u64,
}

impl CompressedPiece {
    /// Memory of its numbers and places.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.blocks[..])
            + size_of_val(&self.factors[..])
            + size_of_val(&self.tiles[..])
            + size_of_val(&self.entries[..])
    }

    /// Whether there are as many numbers as blocks and tiles announce, all over parts below
    /// `parts`. A product with a piece that does not fit panics.
    pub fn fits(&self, parts: usize) -> bool {
        let run_fits = |first: u32, count: u32| first as u64 + count as u64 <= parts as u64;
        let numbers =
            |b: &LowRankBlock| (b.rank as u64).checked_mul(b.count[0] as u64 + b.count[1] as u64);
        let factors = self
            .blocks
            .iter()
            .try_fold(0_u64, |sum, b| sum.checked_add(numbers(b)?));
        let entries: u64 = self.tiles.iter().map(|t| t.bits.count_ones() as u64).sum();
        let tiles = parts.div_ceil(TILE_SIDE) as u64;
        factors == Some(self.factors.len() as u64)
            && entries == self.entries.len() as u64
            && self
                .blocks
                .iter()
                .all(|b| (0..2).all(|k| run_fits(b.first[k], b.count[k])))
            && self
                .tiles
                .iter()
                .all(|t| (t.row as u64) < tiles && (t.column as u64) < tiles)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_fits_when_its_counts_agree() {
        let piece = CompressedPiece {
            blocks: vec![LowRankBlock {
                first: [0, 3],
                count: [3, 2],
                rank: 2,
            }],
            factors: vec![1.0; 10],
            tiles: vec![EntryTile {
                row: 0,
                column: 0,
                bits: 0b101,
            }],
            entries: vec![1.0; 2],
        };
        assert!(piece.fits(5) && !piece.fits(4) && CompressedPiece::default().fits(0));
        let changed = |change: &dyn Fn(&mut CompressedPiece)| {
            let mut other = piece.clone();
            change(&mut other);
            other.fits(5)
        };
        assert!(!changed(&|p| p.factors.push(0.0)));
        assert!(!changed(&|p| p.tiles[0].bits = 1));
        assert!(!changed(&|p| p.tiles[0].column = 1));
        assert!(!changed(&|p| p.blocks[0].rank = u32::MAX));
        assert!(!changed(&|p| p.blocks[0].first[0] = u32::MAX));
    }
}
