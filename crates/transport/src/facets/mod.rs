//! View factors between facets, exact within a promise: what `luxel factors` computes.
//!
//! - [`blockers`]: what stands in the way, merged into large convex pieces and solids
//! - [`parts`]: what sends and receives, and a tree of clusters over it
//! - [`walk`]: which pairs see each other freely, not at all, or in part
//! - [`free`]: a pair with nothing between
//! - [`shadow`]: a pair with something between
//! - [`compressed`]: all pairs of very many facets in little memory
//! - [`ring`], [`shaft`]: polygons to cut, space between boxes
//!
//! Computed is the exchange area G_ij = A_i F_ij of each pair, once, so A_i F_ij = A_j F_ji
//! holds to the last bit of what is stored. Rows that sum to less than 1 let the rest out of
//! the scene, or onto sides that block and are no rows. Nothing is drawn at random; results do
//! not depend on the number of threads.

mod blockers;
mod compressed;
mod free;
mod parts;
mod ring;
mod shadow;
mod shaft;
#[cfg(test)]
mod tests;
mod walk;

use blockers::Plane;
pub use compressed::{ApplyError, CompressedBatch, CompressedMatrix, Stored};
use luxel_core::{DVec3, Facets, SparseRows};
use parts::Parts;
use rayon::prelude::*;
use shaft::BlockerTree;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use walk::{Ground, Walk};

/// What is asked of the factors.
#[derive(Clone, Debug, PartialEq)]
pub struct FacetSettings {
    /// Promise per factor: |F - exact| at most this, and the sum over a row about this.
    /// 1e-8..=0.1.
    pub error: f64,
    /// Rows that are wanted; all pairs with one of them are computed.
    pub rows: Range<u32>,
}

impl Default for FacetSettings {
    fn default() -> Self {
        FacetSettings {
            error: 1e-4,
            rows: 0..u32::MAX,
        }
    }
}

/// An exchange area above zero; `row <= column`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Triplet {
    /// One row.
    pub row: u32,
    /// The other.
    pub column: u32,
    /// A_row F(row, column), m².
    pub exchange: f32,
}

/// How pairs were settled, counted in pairs of convex parts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Free pairs.
    pub free: u64,
    /// Pairs in clusters that one blocker hides from each other.
    pub hidden: u64,
    /// Pairs with something between them, worked out singly.
    pub shadowed: u64,
    /// Pieces that their senders were cut into.
    pub pieces: u64,
    /// Points from which shadows were cut.
    pub points: u64,
    /// Sum of estimated errors of exchange areas, m².
    pub error: f64,
}

impl Counts {
    /// Adds others.
    pub fn add(&mut self, other: &Counts) {
        self.free += other.free;
        self.hidden += other.hidden;
        self.shadowed += other.shadowed;
        self.pieces += other.pieces;
        self.points += other.points;
        self.error += other.error;
    }
}

/// All pairs of one stretch of the work.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// What was found, in a fixed order.
    pub found: Vec<Triplet>,
    /// How.
    pub counts: Counts,
}

/// Factors in the making. Batches can be computed in any order, also in several runs.
pub struct FacetFactors {
    ground: Ground,
    /// Clusters that make up everything, in order.
    blocks: Vec<u32>,
    areas: Vec<f64>,
}

/// A polygon as it is, or in triangles if its corners do not lie in one plane: what is bent would
/// stand in its own way.
pub(crate) fn unbent(corners: &[DVec3], near_m: f64) -> Vec<Vec<DVec3>> {
    let (low, high) = Plane::of(corners).heights(corners);
    if corners.len() <= 3 || high.max(-low) <= 0.5 * near_m {
        return vec![corners.to_vec()];
    }
    (1..corners.len() - 1)
        .map(|k| vec![corners[0], corners[k], corners[k + 1]])
        .collect()
}

/// Parts of a block at least.
const LEAST_BLOCK: usize = 32;
/// Blocks at most, about.
const BLOCKS: usize = 96;

impl FacetFactors {
    /// Prepares the work: blockers merged, trees built. All parts block.
    pub fn new(facets: &Facets, settings: &FacetSettings) -> FacetFactors {
        let all = facets.parts.iter().map(|p| p.polygon.vertices.clone());
        FacetFactors::past(facets, &all.collect::<Vec<_>>(), settings)
    }

    /// The same where only `blockers` block: convex polygons, corners in metres. The parts lie on
    /// them or apart from them.
    pub fn past(
        facets: &Facets,
        blockers: &[Vec<DVec3>],
        settings: &FacetSettings,
    ) -> FacetFactors {
        let largest = facets
            .parts
            .iter()
            .flat_map(|p| &p.polygon.vertices)
            .map(|v| v.abs().max_element())
            .fold(0.0, f64::max);
        // Corners of a part and those of the plane that it lies on are both rounded.
        let near_m = (3.0 * facets.rounding_m).max(4e-12 * largest);
        let flat: Vec<Vec<DVec3>> = blockers.iter().flat_map(|b| unbent(b, near_m)).collect();
        let blockers = blockers::merge(&flat, facets.rounding_m);
        let tree = BlockerTree::new(&blockers.list);
        let parts = Parts::new(facets, &blockers, &tree, near_m);
        let rows = facets.rows.len();
        let wanted_rows = settings.rows.start..settings.rows.end.min(rows as u32);
        let wanted = parts
            .clusters
            .iter()
            .map(|c| {
                parts.list[c.run()]
                    .iter()
                    .any(|p| wanted_rows.contains(&p.row))
            })
            .collect();
        let most = (parts.list.len() / BLOCKS).max(LEAST_BLOCK);
        let mut blocks = Vec::new();
        let mut todo: Vec<u32> = if parts.clusters.is_empty() {
            Vec::new()
        } else {
            vec![0]
        };
        while let Some(cluster) = todo.pop() {
            let c = &parts.clusters[cluster as usize];
            match c.children {
                Some(first) if c.count as usize > most => todo.extend([first + 1, first]),
                _ => blocks.push(cluster),
            }
        }
        FacetFactors {
            ground: Ground {
                parts,
                blockers,
                tree,
                near_m,
                error: settings.error,
                rows: rows.max(1),
                wanted,
                wanted_rows,
                stop: AtomicBool::new(false),
            },
            blocks,
            areas: facets.areas(),
        }
    }

    /// Ends what is being computed, from any thread; what [`FacetFactors::compute`] then returns
    /// is not whole.
    pub fn stop(&self) {
        self.ground.stop.store(true, Ordering::Relaxed);
    }

    /// Number of batches.
    pub fn batches(&self) -> usize {
        self.blocks.len()
    }

    /// Share of all pairs that a batch goes through, 0..=1.
    pub fn share(&self, batch: usize) -> f64 {
        let count = |b: u32| self.ground.parts.clusters[b as usize].count as f64;
        let own = count(self.blocks[batch]);
        let later: f64 = self.blocks[batch..].iter().map(|&b| count(b)).sum();
        let all = self.ground.parts.list.len() as f64;
        own * (later - 0.5 * own) / (0.5 * all * all)
    }

    /// Blockers after merging, solids counted once: what every ray has to pass.
    pub fn blockers(&self) -> usize {
        self.ground.blockers.list.len()
    }

    /// Rows that have no part in a batch after the first `done`: their factors are complete.
    pub fn finished(&self, done: usize) -> Vec<bool> {
        let mut finished = vec![true; self.areas.len()];
        for &block in &self.blocks[done.min(self.blocks.len())..] {
            let run = self.ground.parts.clusters[block as usize].run();
            for part in &self.ground.parts.list[run] {
                finished[part.row as usize] = false;
            }
        }
        finished
    }

    /// All pairs of the block of this number with itself and later ones; uses all threads.
    pub fn compute(&self, batch: usize) -> Batch {
        let own = self.blocks[batch];
        let results: Vec<Batch> = self.blocks[batch..]
            .par_iter()
            .map_init(Walk::default, |walk, &other| {
                walk.pair(&self.ground, own, other);
                Batch {
                    found: std::mem::take(&mut walk.found),
                    counts: std::mem::take(&mut walk.counts),
                }
            })
            .collect();
        let mut batch = Batch {
            found: Vec::with_capacity(results.iter().map(|r| r.found.len()).sum()),
            counts: Counts::default(),
        };
        for mut result in results {
            batch.found.append(&mut result.found);
            batch.counts.add(&result.counts);
        }
        batch
    }

    /// Factors from a point with a unit normal to rows: configuration factors, in ascending
    /// order of row, above zero. Exact to rounding.
    pub fn from_point(&self, point: DVec3, normal: DVec3) -> Vec<(u32, f64)> {
        let mut found = Vec::new();
        Walk::default().all_from_point(&self.ground, point, normal, &mut found);
        // Parts of a row add up; stable, so that sums are the same each time.
        found.sort_by_key(|f| f.0);
        found.dedup_by(|later, first| {
            let same = later.0 == first.0;
            if same {
                first.1 += later.1;
            }
            same
        });
        found
    }

    /// The matrix of what was found.
    pub fn matrix(&self, batches: &[Batch]) -> ExchangeMatrix {
        ExchangeMatrix::new(
            &self.areas,
            batches.iter().flat_map(|b| b.found.iter().copied()),
        )
    }
}

/// Exchange areas of all pairs above zero, as sparse rows; symmetric.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExchangeMatrix {
    /// Area of each row, m².
    pub areas: Vec<f64>,
    /// Row i is `offsets[i]..offsets[i + 1]` of the next two.
    pub offsets: Vec<usize>,
    /// Columns, ascending in each row.
    pub columns: Vec<u32>,
    /// A_i F_ij, m².
    pub exchange: Vec<f32>,
}

impl ExchangeMatrix {
    /// From triplets of which each pair may have several.
    pub fn new(areas: &[f64], triplets: impl Iterator<Item = Triplet> + Clone) -> ExchangeMatrix {
        let n = areas.len();
        let mut offsets = vec![0_usize; n + 1];
        for t in triplets.clone() {
            offsets[t.row as usize + 1] += 1;
            if t.row != t.column {
                offsets[t.column as usize + 1] += 1;
            }
        }
        for i in 0..n {
            offsets[i + 1] += offsets[i];
        }
        let mut next = offsets.clone();
        let mut columns = vec![0_u32; offsets[n]];
        let mut exchange = vec![0.0_f32; offsets[n]];
        let mut put = |row: u32, column: u32, value: f32| {
            let at = &mut next[row as usize];
            columns[*at] = column;
            exchange[*at] = value;
            *at += 1;
        };
        for t in triplets {
            put(t.row, t.column, t.exchange);
            if t.row != t.column {
                put(t.column, t.row, t.exchange);
            }
        }
        // Each row by column; what several parts of a row found is one entry.
        let (mut order, mut to) = (Vec::new(), 0);
        let mut start = 0;
        for i in 0..n {
            let run = start..offsets[i + 1];
            start = offsets[i + 1];
            order.clear();
            order.extend(run.map(|k| (columns[k], exchange[k])));
            // Stable: equal columns stay in the order of the batches, so sums are the same.
            order.sort_by_key(|e| e.0);
            offsets[i] = to;
            let mut k = 0;
            while k < order.len() {
                let column = order[k].0;
                let mut sum = 0.0_f64;
                while k < order.len() && order[k].0 == column {
                    sum += order[k].1 as f64;
                    k += 1;
                }
                columns[to] = column;
                exchange[to] = sum as f32;
                to += 1;
            }
        }
        offsets[n] = to;
        columns.truncate(to);
        exchange.truncate(to);
        ExchangeMatrix {
            areas: areas.to_vec(),
            offsets,
            columns,
            exchange,
        }
    }

    /// Sum of the factors of each row.
    pub fn row_sums(&self) -> Vec<f64> {
        (0..self.areas.len())
            .map(|i| {
                let run = self.offsets[i]..self.offsets[i + 1];
                let sum: f64 = self.exchange[run].iter().map(|&g| g as f64).sum();
                if self.areas[i] > 0.0 {
                    sum / self.areas[i]
                } else {
                    0.0
                }
            })
            .collect()
    }
}

impl SparseRows for ExchangeMatrix {
    fn shape(&self) -> [usize; 2] {
        [self.areas.len(); 2]
    }

    fn entries(&self) -> u64 {
        self.columns.len() as u64
    }

    fn row(&self, row: usize, entries: &mut Vec<(u32, f64)>) {
        entries.clear();
        let run = self.offsets[row]..self.offsets[row + 1];
        let area = self.areas[row];
        entries.extend(
            self.columns[run.clone()]
                .iter()
                .zip(&self.exchange[run])
                .map(|(&j, &g)| (j, g as f64 / area)),
        );
    }
}
