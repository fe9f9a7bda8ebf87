//! Exchange areas of very many facets: low-rank blocks where clusters see each other freely from
//! afar, single entries elsewhere.
//!
//! All pairs of n facets are n²/2 numbers, too many from some ten thousand facets on. Between
//! two clusters with nothing in between, each wholly in front of the other and not too near for
//! their size, the kernel is smooth: a block of m x n exchange areas is U Vᵀ to within a
//! tolerance with a few columns each. Adaptive cross approximation finds them from a few rows
//! and columns of the block, the rest is never computed: it takes the row of the block where the
//! last column is most off, and stops when such rows, and some spread over the block, leave less
//! than the tolerance. Nearer clusters are opened. Pairs next to each other, and all pairs with
//! a shadow, whose number grows as n^1.5, stay single: tiles of 8 x 8 parts with a bit for each
//! entry that is there.
//!
//! Each pair is stored once and serves both directions, so the product is symmetric.
//!
//! Sources: [Hackbusch99] for blocks over a tree of clusters, [Bebendorf00] for the cross
//! approximation. Differs: the stopping rule asks for residual rows instead of the last term.

use super::parts::{Cluster, Part, Parts};
use super::walk::{Ground, Walk, box_heights};
use super::{Counts, FacetFactors, Triplet, free};
use luxel_core::compressed::TILE_SIDE as SIDE;
use luxel_core::{CompressedPiece, DVec3, EntryTile, LowRankBlock};
use rayon::prelude::*;
use std::mem::{size_of, size_of_val, take};
use std::ops::Range;

/// Clusters are apart when the distance of their boxes is this many times the smaller one's size.
const APART: f64 = 0.6;
/// Numbers in a block at most, as a share of its pairs.
const WORTH: f64 = 0.75;
/// Rows of a block that must be met before it is believed.
const CHECKS: usize = 3;
/// Stretches of the blocks that are summed apart. A fixed number: the order of sums, and with
/// it the result, does not depend on the threads.
const GROUPS: usize = 32;

/// Exchange areas of all pairs of rows, compressed; symmetric.
///
/// A product is off by about the promise of the settings it was computed with, relative to the
/// root mean square over rows; at 1e-4 the worst row seen, with one facet in a hundred bright in a
/// town, had 2.5e-4. Not promised: less than 1e-7, numbers are stored as f32.
/// [`CompressedMatrix::measured_error`] tells. A facet takes 3 to 16 kB, by what shadows there
/// are; it grows as the root of their number.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CompressedMatrix {
    /// Area of each row, m².
    pub areas: Vec<f64>,
    /// How pairs were settled; all pairs of a low-rank block count as free.
    pub counts: Counts,
    /// Row of each part, in the order of the tree.
    rows: Vec<u32>,
    pieces: Vec<CompressedPiece>,
}

/// All pairs of one stretch of the work, compressed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CompressedBatch {
    /// Of each pair of clusters, in a fixed order.
    pub pieces: Vec<CompressedPiece>,
    /// How pairs were settled.
    pub counts: Counts,
}

/// Where the bytes of a matrix are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stored {
    /// Low-rank blocks.
    pub blocks: u64,
    /// Pairs of parts that they stand for.
    pub block_pairs: u64,
    /// Numbers in them.
    pub block_numbers: u64,
    /// Tiles of single entries.
    pub tiles: u64,
    /// Single entries.
    pub entries: u64,
}

/// Error of a product, on some rows that were computed singly: of the sum over the row divided by
/// its area, relative to the root mean square of those.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ApplyError {
    /// Rows that were asked.
    pub rows: usize,
    /// Of the worst row.
    pub max: f64,
    /// Root mean square over the rows.
    pub rms: f64,
}

impl FacetFactors {
    /// What [`FacetFactors::compute`] gives, compressed; uses all threads.
    ///
    /// All rows must be wanted in the settings.
    pub fn compress(&self, batch: usize) -> CompressedBatch {
        debug_assert!(self.ground.wanted.iter().all(|&w| w), "all rows");
        let own = self.blocks[batch];
        let results: Vec<(CompressedPiece, Counts)> = self.blocks[batch..]
            .par_iter()
            .map_init(Walk::packing, |walk, &other| {
                walk.pair(&self.ground, own, other);
                let packer = walk.packer.as_mut().expect("made for packing");
                let piece = packer.finish(&mut walk.found);
                (piece, take(&mut walk.counts))
            })
            .collect();
        let mut batch = CompressedBatch::default();
        for (piece, counts) in results {
            batch.pieces.push(piece);
            batch.counts.add(&counts);
        }
        batch
    }

    /// Rows of the matrix.
    pub fn rows(&self) -> usize {
        self.areas.len()
    }

    /// Convex parts that send and receive: what blocks and tiles count.
    pub fn parts(&self) -> usize {
        self.ground.parts.list.len()
    }

    /// The matrix of all batches, in their order.
    pub fn compressed(&self, batches: Vec<CompressedBatch>) -> CompressedMatrix {
        let mut matrix = CompressedMatrix {
            areas: self.areas.clone(),
            rows: self.ground.parts.list.iter().map(|p| p.row).collect(),
            ..CompressedMatrix::default()
        };
        for mut batch in batches {
            matrix.pieces.append(&mut batch.pieces);
            matrix.counts.add(&batch.counts);
        }
        matrix
    }

    /// A_i F_ij of one row with all others, each computed singly, m².
    pub fn exact_row(&self, row: u32) -> Vec<f64> {
        let parts = &self.ground.parts.list;
        let mut out = vec![0.0; self.areas.len()];
        for part in (0..parts.len()).filter(|&p| parts[p].row == row) {
            let has = |&b: &u32| self.ground.parts.clusters[b as usize].run().contains(&part);
            let own = self
                .blocks
                .iter()
                .position(has)
                .expect("blocks make up everything");
            let found: Vec<Vec<Triplet>> = (0..self.blocks.len())
                .into_par_iter()
                .map_init(Walk::default, |walk, other| {
                    walk.only = Some(part);
                    // As `compute` does.
                    let [a, b] = [own.min(other), own.max(other)].map(|k| self.blocks[k]);
                    walk.pair(&self.ground, a, b);
                    take(&mut walk.found)
                })
                .collect();
            for t in found.iter().flatten() {
                let other = if t.row == row { t.column } else { t.row };
                // Both ways in one, and found from either part.
                let share = if other == row { 0.5 } else { 1.0 };
                out[other as usize] += share * t.exchange as f64;
            }
        }
        out
    }
}

impl CompressedMatrix {
    /// All batches of `work`; uses all threads.
    pub fn assemble(work: &FacetFactors) -> CompressedMatrix {
        work.compressed((0..work.batches()).map(|b| work.compress(b)).collect())
    }

    /// y_i = sum_j A_i F_ij x_j. Of x per m² leaving it is what arrives, A_i times x per m².
    ///
    /// The same bits for any number of threads.
    pub fn apply(&self, x: &[f64], y: &mut [f64]) {
        assert!(x.len() == self.areas.len() && y.len() == self.areas.len());
        let room = self.rows.len().next_multiple_of(SIDE);
        let mut from: Vec<f64> = self.rows.iter().map(|&row| x[row as usize]).collect();
        from.resize(room, 0.0);
        let sums: Vec<Vec<f64>> = self
            .groups()
            .into_par_iter()
            .map(|group| {
                let mut to = vec![0.0; room];
                let mut products = Vec::new();
                for piece in &self.pieces[group] {
                    multiply(piece, &from, &mut to, &mut products);
                }
                to
            })
            .collect();
        y.fill(0.0);
        for (part, &row) in self.rows.iter().enumerate() {
            y[row as usize] += sums.iter().map(|s| s[part]).sum::<f64>();
        }
    }

    /// Row `row` of A_i F_ij, m², as the product gives it.
    pub fn row(&self, row: u32) -> Vec<f64> {
        let mut unit = vec![0.0; self.areas.len()];
        unit[row as usize] = 1.0;
        let mut out = vec![0.0; unit.len()];
        self.apply(&unit, &mut out);
        out
    }

    /// Error of the product with `x`, on about `rows` rows spread evenly over all, against
    /// [`FacetFactors::exact_row`]. `work` is what the matrix was computed from.
    pub fn measured_error(&self, work: &FacetFactors, x: &[f64], rows: usize) -> ApplyError {
        self.measured_errors(work, &[x], rows)[0]
    }

    /// The same for several `x`, each row computed once for all.
    pub fn measured_errors(
        &self,
        work: &FacetFactors,
        sources: &[&[f64]],
        rows: usize,
    ) -> Vec<ApplyError> {
        let n = self.areas.len();
        let products: Vec<Vec<f64>> = sources
            .iter()
            .map(|x| {
                let mut y = vec![0.0; n];
                self.apply(x, &mut y);
                y
            })
            .collect();
        let step = n.div_ceil(rows.max(1)).max(1);
        // Of each source: largest error, sum of squared errors, of squared values.
        let mut sums = vec![(0.0_f64, 0.0, 0.0); sources.len()];
        let mut count = 0;
        for i in (step / 2..n).step_by(step).filter(|&i| self.areas[i] > 0.0) {
            let row = work.exact_row(i as u32);
            for ((x, y), (max, errors, values)) in sources.iter().zip(&products).zip(&mut sums) {
                let exact: f64 = row.iter().zip(*x).map(|(g, x)| g * x).sum();
                let error = (y[i] - exact) / self.areas[i];
                *max = max.max(error.abs());
                *errors += error * error;
                *values += (exact / self.areas[i]).powi(2);
            }
            count += 1;
        }
        sums.into_iter()
            .map(|(max, errors, values)| {
                let scale = f64::max(values, f64::MIN_POSITIVE).sqrt();
                ApplyError {
                    rows: count,
                    max: max / (scale / (count.max(1) as f64).sqrt()),
                    rms: errors.sqrt() / scale,
                }
            })
            .collect()
    }

    /// Row of each part, in the order that blocks and tiles count in.
    pub fn part_rows(&self) -> &[u32] {
        &self.rows
    }

    /// All that is stored, in the order of the batches.
    pub fn pieces(&self) -> &[CompressedPiece] {
        &self.pieces
    }

    /// Memory that the matrix takes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.areas[..])
            + size_of_val(&self.rows[..])
            + self
                .pieces
                .iter()
                .map(|p| size_of::<CompressedPiece>() + p.bytes())
                .sum::<usize>()
    }

    /// What is stored how.
    pub fn stored(&self) -> Stored {
        let mut stored = Stored::default();
        for piece in &self.pieces {
            stored.blocks += piece.blocks.len() as u64;
            stored.block_numbers += piece.factors.len() as u64;
            stored.tiles += piece.tiles.len() as u64;
            stored.entries += piece.entries.len() as u64;
            for block in &piece.blocks {
                stored.block_pairs += block.count[0] as u64 * block.count[1] as u64;
            }
        }
        stored
    }

    /// Runs of pieces with about as much in each.
    fn groups(&self) -> Vec<Range<usize>> {
        let all: usize = self.pieces.iter().map(CompressedPiece::bytes).sum();
        let mut groups = Vec::with_capacity(GROUPS);
        let (mut start, mut before) = (0, 0);
        for (k, piece) in self.pieces.iter().enumerate() {
            before += piece.bytes();
            if before * GROUPS >= all * (groups.len() + 1) {
                groups.push(start..k + 1);
                start = k + 1;
            }
        }
        groups
    }
}

/// Adds the product, both directions, from and to parts.
fn multiply(piece: &CompressedPiece, x: &[f64], y: &mut [f64], products: &mut Vec<[f64; 2]>) {
    let mut rest = &piece.factors[..];
    for block in &piece.blocks {
        let [a, b] = runs(block);
        let (m, n, rank) = (a.len(), b.len(), block.rank as usize);
        let (factors, others) = rest.split_at(rank * (m + n));
        rest = others;
        products.clear();
        products.extend(factors.chunks_exact(m + n).map(|uv| {
            let (u, v) = uv.split_at(m);
            [dot(u, &x[a.clone()]), dot(v, &x[b.clone()])]
        }));
        for (uv, &[of_u, of_v]) in factors.chunks_exact(m + n).zip(&*products) {
            let (u, v) = uv.split_at(m);
            add(&mut y[a.clone()], of_v, u);
            add(&mut y[b.clone()], of_u, v);
        }
    }
    let mut next = 0;
    for tile in &piece.tiles {
        let (i, j) = (SIDE * tile.row as usize, SIDE * tile.column as usize);
        let xs: &[f64; SIDE] = x[j..j + SIDE].try_into().expect("a side");
        for k in 0..SIDE {
            let mut bits = (tile.bits >> (SIDE * k)) as u8;
            let count = bits.count_ones() as usize;
            let entries = &piece.entries[next..next + count];
            next += count;
            let (here, mut sum) = (x[i + k], 0.0);
            if count == SIDE {
                let ys = &mut y[j..j + SIDE];
                for l in 0..SIDE {
                    sum += entries[l] as f64 * xs[l];
                    ys[l] += entries[l] as f64 * here;
                }
            } else {
                for &entry in entries {
                    let l = bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    sum += entry as f64 * xs[l];
                    y[j + l] += entry as f64 * here;
                }
            }
            y[i + k] += sum;
        }
    }
}

fn runs(block: &LowRankBlock) -> [Range<usize>; 2] {
    [0, 1].map(|k| block.first[k] as usize..(block.first[k] + block.count[k]) as usize)
}

fn dot(u: &[f32], x: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (whole, rest) = (u.chunks_exact(8), u.len() / 8 * 8);
    for (u, x) in whole.zip(x.chunks_exact(8)) {
        for l in 0..8 {
            sums[l] += u[l] as f64 * x[l];
        }
    }
    let rest: f64 = u[rest..]
        .iter()
        .zip(&x[rest..])
        .map(|(&u, x)| u as f64 * x)
        .sum();
    rest + sums.iter().sum::<f64>()
}

fn add(y: &mut [f64], factor: f64, u: &[f32]) {
    for (y, &u) in y.iter_mut().zip(u) {
        *y += factor * u as f64;
    }
}

/// Puts away what one walk finds: free pairs of clusters as blocks, the rest as tiles.
#[derive(Default)]
pub(crate) struct Packer {
    piece: CompressedPiece,
    cross: Cross,
}

impl Packer {
    /// Two clusters with nothing in between. What is not put into a block goes to `found`, by
    /// parts.
    pub(crate) fn free(
        &mut self,
        ground: &Ground,
        a: &Cluster,
        b: &Cluster,
        found: &mut Vec<Triplet>,
        counts: &mut Counts,
    ) {
        let (m, n) = (a.count as usize, b.count as usize);
        let most = (WORTH * (m * n) as f64 / (m + n) as f64) as usize;
        if most > 0 && smooth(ground, a, b) {
            let asked = Asked {
                parts: &ground.parts,
                runs: [a.run(), b.run()],
                relative: ground.relative(),
                tolerance: ground.error,
            };
            if let Some(rank) = self.cross.find(&asked, most) {
                self.cross.put(&asked, rank, &mut self.piece);
                counts.free += (m * n) as u64;
                return;
            }
        }
        let opened = match (a.children, b.children) {
            _ if most == 0 => None,
            (None, None) => None,
            (Some(first), None) => Some((first, b)),
            (None, Some(first)) => Some((first, a)),
            (Some(one), Some(two)) => Some(if a.size() >= b.size() {
                (one, b)
            } else {
                (two, a)
            }),
        };
        if let Some((first, other)) = opened {
            for child in [first, first + 1] {
                let child = &ground.parts.clusters[child as usize];
                self.free(ground, child, other, found, counts);
            }
            return;
        }
        for i in a.run() {
            for j in b.run() {
                let (p, q) = (&ground.parts.list[i], &ground.parts.list[j]);
                let facing = free::facing(p, q, ground.near_m);
                if facing != free::Facing::No {
                    let value = free::exchange(&ground.parts, (i, j), facing, ground.relative());
                    counts.free += 1;
                    if value > 0.0 {
                        found.push(by_parts(i, j, value));
                    }
                }
            }
        }
    }

    /// What was put away; `found` is emptied.
    fn finish(&mut self, found: &mut Vec<Triplet>) -> CompressedPiece {
        let side = SIDE as u64;
        let place = |t: &Triplet| {
            let (i, j) = (t.row as u64, t.column as u64);
            // Tile first, then the bit in it.
            ((i / side) << 35) | ((j / side) << 6) | (i % side * side + j % side)
        };
        found.sort_unstable_by_key(place);
        let same = |a: &Triplet, b: &Triplet| place(a) >> 6 == place(b) >> 6;
        let mut piece = take(&mut self.piece);
        piece.blocks.shrink_to_fit();
        piece.factors.shrink_to_fit();
        piece.tiles.reserve_exact(found.chunk_by(same).count());
        piece
            .tiles
            .extend(found.chunk_by(same).map(|run| EntryTile {
                row: run[0].row / SIDE as u32,
                column: run[0].column / SIDE as u32,
                bits: run.iter().map(|t| 1_u64 << (place(t) & 63)).sum(),
            }));
        piece.entries = found.iter().map(|t| t.exchange).collect();
        found.clear();
        piece
    }
}

/// An entry between two parts rather than rows.
pub(crate) fn by_parts(i: usize, j: usize, value: f64) -> Triplet {
    Triplet {
        row: i.min(j) as u32,
        column: i.max(j) as u32,
        exchange: value as f32,
    }
}

/// Whether the kernel between two clusters is smooth: they are apart for their size, and all
/// parts of each wholly in front of all of the other.
fn smooth(ground: &Ground, a: &Cluster, b: &Cluster) -> bool {
    let gap = (a.low - b.high).max(b.low - a.high).max(DVec3::ZERO);
    let faces = |a: &Cluster, b: &Cluster| {
        let above = |plane| box_heights(plane, b.low, b.high).0 >= -ground.near_m;
        match &a.flat {
            Some(plane) => above(plane),
            None => ground.parts.list[a.run()].iter().all(|p| above(&p.plane)),
        }
    };
    gap.length() >= APART * a.size().min(b.size()) && faces(a, b) && faces(b, a)
}

/// A block that is wanted.
struct Asked<'a> {
    parts: &'a Parts,
    runs: [Range<usize>; 2],
    /// Accuracy of each entry.
    relative: f64,
    /// Error of the block relative to its norm.
    tolerance: f64,
}

impl Asked<'_> {
    fn part(&self, side: usize, k: usize) -> &Part {
        &self.parts.list[self.runs[side].start + k]
    }

    /// Exchange area over the root of both areas: large and small parts weigh alike.
    fn entry(&self, i: usize, j: usize) -> f64 {
        let pair = (self.runs[0].start + i, self.runs[1].start + j);
        let value = free::exchange(self.parts, pair, free::Facing::Wholly, self.relative);
        value / (self.part(0, i).area * self.part(1, j).area).sqrt()
    }
}

/// Cross approximation: buffers.
#[derive(Default)]
struct Cross {
    /// Columns of U and of V.
    u: Vec<f64>,
    v: Vec<f64>,
    row: Vec<f64>,
    column: Vec<f64>,
    used: Vec<bool>,
}

impl Cross {
    /// Rank that meets the tolerance, in `u` and `v`; none above `most`.
    fn find(&mut self, asked: &Asked<'_>, most: usize) -> Option<usize> {
        let [m, n] = [asked.runs[0].len(), asked.runs[1].len()];
        self.u.clear();
        self.v.clear();
        self.used.clear();
        self.used.resize(m, false);
        let (mut rank, mut checked) = (0, 0);
        // Norm of U V^T, squared.
        let mut norm = 0.0;
        let mut i = m / 2;
        loop {
            self.used[i] = true;
            self.row.clear();
            self.row.extend((0..n).map(|j| asked.entry(i, j)));
            for (u, v) in self.u.chunks_exact(m).zip(self.v.chunks_exact(n)) {
                subtract(&mut self.row, u[i], v);
            }
            let left = square(&self.row);
            if left * m as f64 <= asked.tolerance * asked.tolerance * norm {
                checked += 1;
                let unused = |k: usize| (i + m * 3 / 8 + k) % m;
                match (0..m).map(unused).find(|&k| !self.used[k]) {
                    Some(next) if checked < CHECKS => i = next,
                    _ => return Some(rank),
                }
                continue;
            }
            if rank == most {
                return None;
            }
            let j = largest(&self.row, |_| true)?;
            let pivot = self.row[j];
            self.column.clear();
            self.column.extend((0..m).map(|i| asked.entry(i, j)));
            for (u, v) in self.u.chunks_exact(m).zip(self.v.chunks_exact(n)) {
                subtract(&mut self.column, v[j], u);
            }
            self.column.iter_mut().for_each(|c| *c /= pivot);
            for (u, v) in self.u.chunks_exact(m).zip(self.v.chunks_exact(n)) {
                norm += 2.0 * product(u, &self.column) * product(v, &self.row);
            }
            norm += square(&self.column) * left;
            self.u.extend_from_slice(&self.column);
            self.v.extend_from_slice(&self.row);
            rank += 1;
            match largest(&self.column, |k| !self.used[k]) {
                Some(next) => i = next,
                None => return Some(rank),
            }
        }
    }

    /// Stores the block that was found.
    fn put(&self, asked: &Asked<'_>, rank: usize, piece: &mut CompressedPiece) {
        if rank == 0 {
            return;
        }
        let [m, n] = [asked.runs[0].len(), asked.runs[1].len()];
        let [a, b] = [0, 1].map(|side| {
            let count = asked.runs[side].len();
            (0..count).map(move |k| asked.part(side, k).area.sqrt())
        });
        for (u, v) in self.u.chunks_exact(m).zip(self.v.chunks_exact(n)) {
            piece
                .factors
                .extend(u.iter().zip(a.clone()).map(|(u, a)| (u * a) as f32));
            piece
                .factors
                .extend(v.iter().zip(b.clone()).map(|(v, b)| (v * b) as f32));
        }
        piece.blocks.push(LowRankBlock {
            first: [0, 1].map(|k| asked.runs[k].start as u32),
            count: [m as u32, n as u32],
            rank: rank as u32,
        });
    }
}

fn square(x: &[f64]) -> f64 {
    product(x, x)
}

fn product(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

fn subtract(from: &mut [f64], factor: f64, x: &[f64]) {
    for (to, x) in from.iter_mut().zip(x) {
        *to -= factor * x;
    }
}

/// Index of the entry with the largest absolute value among those allowed.
fn largest(x: &[f64], allowed: impl Fn(usize) -> bool) -> Option<usize> {
    (0..x.len())
        .filter(|&k| allowed(k))
        .max_by(|&k, &l| x[k].abs().total_cmp(&x[l].abs()))
}

#[cfg(test)]
mod tests {
    use super::super::{Batch, ExchangeMatrix, FacetSettings};
    use super::*;
    use luxel_core::{Facet, FacetPart, Facets, Polygon};

    fn work(facets: &Facets) -> FacetFactors {
        FacetFactors::new(facets, &FacetSettings::default())
    }

    fn dense(work: &FacetFactors) -> ExchangeMatrix {
        let batches: Vec<Batch> = (0..work.batches()).map(|b| work.compute(b)).collect();
        work.matrix(&batches)
    }

    fn product_of(matrix: &ExchangeMatrix, x: &[f64]) -> Vec<f64> {
        (0..x.len())
            .map(|i| {
                let run = matrix.offsets[i]..matrix.offsets[i + 1];
                run.map(|k| matrix.exchange[k] as f64 * x[matrix.columns[k] as usize])
                    .sum()
            })
            .collect()
    }

    /// Numbers without a pattern in 0..1, the same each time.
    fn numbers(n: usize, seed: usize) -> Vec<f64> {
        (0..n)
            .map(|i| (0.618_033_988_75 * (i * (i + seed)) as f64).fract())
            .collect()
    }

    /// Quads as two triangles each; every third row takes in the one after it, so that it has
    /// four parts; one box blocks without rows.
    fn triangles(facets: &Facets) -> Facets {
        let mut out = Facets::default();
        for (k, part) in facets.parts.iter().enumerate() {
            let v = &part.polygon.vertices;
            let blocks = v.iter().all(|v| {
                v.x > 2.4 && v.x < 3.3 && v.y > 0.3 && v.y < 1.1 && v.z > 0.6 && v.z < 1.6
            });
            if !blocks && k % 3 != 1 {
                out.rows.push(Facet {
                    name: String::new(),
                    object: 0,
                    material: 0,
                });
            }
            for corners in [vec![v[0], v[1], v[2]], vec![v[0], v[2], v[3]]] {
                out.parts.push(FacetPart {
                    polygon: Polygon::new(corners),
                    row: if blocks {
                        Facets::NO_ROW
                    } else {
                        out.rows.len() as u32 - 1
                    },
                });
            }
        }
        out
    }

    /// With boxes, of triangles, and empty: there blocks are of low rank. In a room of a thousand
    /// facets with boxes hardly a pair of clusters is both large and free.
    fn rooms() -> [Facets; 3] {
        let mut empty = luxel_scenes::floating_boxes(3000);
        let boxes = empty
            .rows
            .iter()
            .position(|r| r.object == 1)
            .expect("boxes come last");
        empty.rows.truncate(boxes);
        empty.parts.truncate(boxes);
        let some = luxel_scenes::floating_boxes(700);
        [luxel_scenes::floating_boxes(1000), triangles(&some), empty]
    }

    #[test]
    fn products_and_rows_are_those_of_single_entries() {
        let mut blocks = 0;
        for facets in rooms() {
            let n = facets.rows.len();
            let work = work(&facets);
            let (dense, matrix) = (dense(&work), CompressedMatrix::assemble(&work));
            let stored = matrix.stored();
            if stored.block_pairs > 3 * stored.entries {
                blocks += 1;
                assert!(
                    stored.block_numbers * 5 < stored.block_pairs * 3,
                    "{stored:?}"
                );
            }
            let (x, z) = (numbers(n, 7), numbers(n, 11));
            let (mut y, mut w) = (vec![0.0; n], vec![0.0; n]);
            matrix.apply(&x, &mut y);
            matrix.apply(&z, &mut w);
            for (i, want) in product_of(&dense, &x).into_iter().enumerate() {
                // The promise of the settings, 1e-4 of what arrives from x <= 1.
                let error = (y[i] - want).abs() / dense.areas[i];
                assert!(error <= 1e-4, "row {i}: {error:e}");
            }
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            // Rounding of sums of some thousand f64.
            let (one, two) = (dot(&z, &y), dot(&x, &w));
            assert!((one - two).abs() <= 1e-12 * one, "{one} {two}");
            for i in (0..n).step_by(97) {
                let mut unit = vec![0.0; n];
                unit[i] = 1.0;
                let (want, exact) = (product_of(&dense, &unit), work.exact_row(i as u32));
                let got = matrix.row(i as u32);
                let mut sum = 0.0;
                for j in 0..n {
                    // f32 of sums.
                    assert!((want[j] - exact[j]).abs() <= 2e-7 * want[j]);
                    sum += (got[j] - want[j]).abs() / dense.areas[i];
                }
                // Promised: 1e-4 for the sum over a row.
                assert!(sum <= 1e-4, "row {i}: {sum:e}");
            }
            let error = matrix.measured_error(&work, &numbers(n, 3), 20);
            assert!(
                error.rows >= 20 && error.max <= 1e-4 && error.rms <= error.max,
                "{error:?}"
            );
        }
        assert_eq!(blocks, 1);
    }

    #[test]
    fn exitance_is_that_of_single_entries() {
        // B = E + rho F B by repeated substitution; an error d of F in the sum over rows becomes
        // at most d rho / (1 - rho) of the largest B.
        let facets = luxel_scenes::floating_boxes(2000);
        let work = work(&facets);
        let (dense, matrix) = (dense(&work), CompressedMatrix::assemble(&work));
        let n = facets.rows.len();
        let e: Vec<f64> = (0..n)
            .map(|i| if i % 50 == 0 { 100.0 } else { 0.0 })
            .collect();
        let rho: Vec<f64> = numbers(n, 5).iter().map(|r| 0.2 + 0.5 * r).collect();
        let solve = |product: &dyn Fn(&[f64]) -> Vec<f64>| {
            let mut b = e.clone();
            for _ in 0..60 {
                let g = product(&b);
                for i in 0..n {
                    b[i] = e[i] + rho[i] * g[i] / dense.areas[i];
                }
            }
            b
        };
        let want = solve(&|b| product_of(&dense, b));
        let got = solve(&|b| {
            let mut g = vec![0.0; n];
            matrix.apply(b, &mut g);
            g
        });
        let mean = want.iter().sum::<f64>() / n as f64;
        let worst = want
            .iter()
            .zip(&got)
            .map(|(w, g)| (w - g).abs())
            .fold(0.0, f64::max);
        assert!(worst <= 1e-4 * mean, "{worst:e} of {mean}");
    }

    #[test]
    fn threads_do_not_change_a_bit() {
        let facets = luxel_scenes::floating_boxes(1000);
        let work = work(&facets);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("threads").install(|| {
                let matrix = CompressedMatrix::assemble(&work);
                let mut y = vec![0.0; matrix.areas.len()];
                matrix.apply(&numbers(y.len(), 1), &mut y);
                (matrix, y)
            })
        };
        assert_eq!(run(1), run(2));
    }

    #[test]
    fn nothing_and_one_facet_exchange_nothing() {
        let none = CompressedMatrix::assemble(&work(&Facets::default()));
        none.apply(&[], &mut []);
        let mut facets = luxel_scenes::floating_boxes(100);
        facets.parts.truncate(1);
        facets.rows.truncate(1);
        let work = work(&facets);
        let one = CompressedMatrix::assemble(&work);
        let mut y = [7.0];
        one.apply(&[1.0], &mut y);
        assert_eq!(
            (y, one.row(0), work.exact_row(0)),
            ([0.0], vec![0.0], vec![0.0])
        );
        assert_eq!(one.measured_error(&work, &[1.0], 5).max, 0.0);
    }
}
