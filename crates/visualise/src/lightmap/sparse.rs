//! Texels asked sparsely where light is smooth and densely where it changes.
//!
//! Each chart is covered by cells of eight texels. The light at the corners and in the middle of a
//! cell is asked; when the middle is what the corners foretell, as far as noise allows, all of the
//! cell is interpolated, and otherwise it is cut in four. Cells with texels that are not regular, at
//! the feet of what stands on the surface and along ragged borders, are always cut down to single
//! texels: that is where shadows are sharp. Every round is whole: stopped after any of them, what
//! is not asked yet is interpolated from what is.
//!
//! Source: pixels are sampled so by [Whitted80], section 5; that a cell may be left when its middle agrees
//! within noise is ours.

use super::Charts;
use super::lattice::Kind;
use luxel_core::Rgb;
use luxel_gather::Receiver;

/// Texels along a cell at first.
const COARSE: u32 = 8;
/// A middle may differ from what the corners foretell by so many of its standard errors.
const DOUBT: f32 = 2.0;

/// A cell of a chart: its first and last texel.
#[derive(Clone, Copy, Debug)]
struct Cell {
    chart: u32,
    low: [u32; 2],
    high: [u32; 2],
    /// Whether its middle is to be compared with its corners.
    tested: bool,
}

impl Cell {
    fn middle(&self) -> [u32; 2] {
        [0, 1].map(|k| (self.low[k] + self.high[k]) / 2)
    }

    fn is_single(&self) -> bool {
        (0..2).all(|k| self.high[k] - self.low[k] <= 1)
    }

    /// Up to four cells, one of them where it is one texel wide.
    fn cut(&self) -> impl Iterator<Item = Cell> + use<> {
        let (cell, m) = (*self, self.middle());
        let halves = [0, 1].map(|k| {
            if cell.high[k] - cell.low[k] <= 1 {
                vec![[cell.low[k], cell.high[k]]]
            } else {
                vec![[cell.low[k], m[k]], [m[k], cell.high[k]]]
            }
        });
        let [across, down] = halves;
        down.into_iter().flat_map(move |y| {
            across.clone().into_iter().map(move |x| Cell {
                low: [x[0], y[0]],
                high: [x[1], y[1]],
                ..cell
            })
        })
    }
}

/// Light of the texels of all charts while it is being asked.
pub struct Sparse<'a> {
    charts: &'a Charts,
    /// Smallest difference between a middle and its corners that matters, as a share of the light.
    tolerance: f32,
    open: Vec<Cell>,
    known: Vec<bool>,
    values: Vec<Rgb>,
    errors: Vec<f32>,
    wanted: Vec<u32>,
    asked: usize,
}

impl<'a> Sparse<'a> {
    /// Ready for the first round. `tolerance` is the share of its light by which a texel may be off.
    pub fn new(charts: &'a Charts, tolerance: f32) -> Sparse<'a> {
        let n = charts.texels();
        let mut s = Sparse {
            charts,
            tolerance,
            open: Vec::new(),
            known: vec![false; n],
            values: vec![Rgb::BLACK; n],
            errors: vec![0.0; n],
            wanted: Vec::new(),
            asked: 0,
        };
        let mut cells = Vec::new();
        for (k, chart) in charts.charts.iter().enumerate() {
            let last = chart.size.map(|n| n - 1);
            let steps = last.map(|l| l.div_ceil(COARSE).max(1));
            for y in 0..steps[1] {
                for x in 0..steps[0] {
                    cells.push(Cell {
                        chart: k as u32,
                        low: [x * COARSE, y * COARSE],
                        high: [
                            ((x + 1) * COARSE).min(last[0]),
                            ((y + 1) * COARSE).min(last[1]),
                        ],
                        tested: false,
                    });
                }
            }
        }
        s.open = s.divided(cells);
        s.want();
        s
    }

    /// Receivers of the texels whose light is asked next; none when all is done.
    pub fn wanted(&self) -> Vec<Receiver> {
        let at = |&t: &u32| self.charts.receivers[t as usize];
        self.wanted.iter().map(at).collect()
    }

    /// Which of the wanted texels may share an answer when they are close: those of one number.
    pub fn wanted_kin(&self) -> Vec<u64> {
        let kin = |&t: &u32| self.charts.kin_of_texel(t as usize);
        self.wanted.iter().map(kin).collect()
    }

    /// Area that each wanted texel stands for, m².
    pub fn wanted_areas(&self) -> Vec<f32> {
        let area = |&t: &u32| self.charts.texel_area(t as usize);
        self.wanted.iter().map(area).collect()
    }

    /// How many texels have been asked.
    pub fn asked(&self) -> usize {
        self.asked
    }

    /// Takes the light of the first of the wanted texels, lux, and its standard errors, and makes the
    /// next round. What is left over of a round stays interpolated from the ones before; the first has
    /// none before it and is to be taken whole.
    pub fn take(&mut self, light: impl Iterator<Item = (Rgb, f32)>) {
        let wanted = std::mem::take(&mut self.wanted);
        let mut taken = 0;
        for (&t, (value, error)) in wanted.iter().zip(light) {
            (self.values[t as usize], self.errors[t as usize]) = (value, error);
            self.known[t as usize] = true;
            taken += 1;
        }
        self.asked += taken;
        if taken < wanted.len() {
            return;
        }
        let mut next = Vec::new();
        for cell in std::mem::take(&mut self.open) {
            if cell.is_single() {
                continue;
            }
            // Interpolated in any case, in case that this is the last round.
            let agrees = self.interpolate(&cell);
            if !agrees {
                next.extend(cell.cut());
            }
        }
        self.open = self.divided(next);
        self.want();
    }

    /// Light of all texels; those that no chart uses are black.
    pub fn finish(self) -> super::Lightmap {
        super::Lightmap {
            values: self.values,
            errors: self.errors,
            asked: self.asked,
        }
    }

    /// Cuts cells until they are single or regular throughout.
    fn divided(&self, cells: Vec<Cell>) -> Vec<Cell> {
        let mut todo = cells;
        todo.reverse();
        let mut done = Vec::new();
        while let Some(mut cell) = todo.pop() {
            if cell.is_single() {
                done.push(cell);
            } else if self.is_regular(&cell) {
                cell.tested = true;
                done.push(cell);
            } else {
                let first = todo.len();
                todo.extend(cell.cut());
                todo[first..].reverse();
            }
        }
        done
    }

    fn is_regular(&self, cell: &Cell) -> bool {
        let chart = &self.charts.charts[cell.chart as usize];
        (cell.low[1]..=cell.high[1]).all(|y| {
            (cell.low[0]..=cell.high[0])
                .all(|x| self.charts.kind[chart.texel(x, y)] == Kind::Regular)
        })
    }

    fn want(&mut self) {
        let mut wanted = Vec::new();
        for cell in &self.open {
            let chart = &self.charts.charts[cell.chart as usize];
            let ([x0, y0], [x1, y1]) = (cell.low, cell.high);
            let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]];
            let middle = cell.tested.then(|| cell.middle());
            for [x, y] in corners.into_iter().chain(middle) {
                let t = chart.texel(x, y);
                if self.charts.kind[t] != Kind::Unused && !self.known[t] {
                    self.known[t] = true;
                    wanted.push(t as u32);
                }
            }
        }
        // Known once they are taken.
        wanted.iter().for_each(|&t| self.known[t as usize] = false);
        self.wanted = wanted;
    }

    /// Fills a tested cell from its corners and its middle; answers whether they agree.
    fn interpolate(&mut self, cell: &Cell) -> bool {
        let chart = &self.charts.charts[cell.chart as usize];
        let ([x0, y0], [x1, y1]) = (cell.low, cell.high);
        let at = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]].map(|[x, y]| chart.texel(x, y));
        let [mx, my] = cell.middle();
        let middle = chart.texel(mx, my);
        let place = |x: u32, y: u32| {
            let along = |v: u32, low: u32, high: u32| match high - low {
                0 => 0.0,
                n => (v - low) as f32 / n as f32,
            };
            [along(x, x0, x1), along(y, y0, y1)]
        };
        let weights =
            |[s, t]: [f32; 2]| [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
        let corners = at.map(|t| self.values[t]);
        let mix = |w: [f32; 4]| (0..4).fold(Rgb::BLACK, |sum, k| sum + corners[k] * w[k]);
        let w = weights(place(mx, my));
        let foretold = mix(w);
        let found = self.values[middle];
        let difference = (found.luminance() - foretold.luminance()).abs();
        let noise: f32 = (0..4).map(|k| (w[k] * self.errors[at[k]]).powi(2)).sum();
        let noise = (noise + self.errors[middle].powi(2)).sqrt();
        let small = self.tolerance * found.luminance().max(foretold.luminance());
        let agrees = difference <= small.max(DOUBT * noise);
        // A tent over the cell that brings the middle to what was found.
        let correction = found + foretold * -1.0;
        let tent = |v: f32, m: f32| {
            if m <= 0.0 || m >= 1.0 {
                1.0
            } else {
                (v / m).min((1.0 - v) / (1.0 - m))
            }
        };
        let [ms, mt] = place(mx, my);
        let bent = 0.25 * difference;
        for y in y0..=y1 {
            for x in x0..=x1 {
                let t = chart.texel(x, y);
                if self.known[t] {
                    continue;
                }
                let p = place(x, y);
                let w = weights(p);
                let lift = tent(p[0], ms) * tent(p[1], mt);
                let value = mix(w) + correction * lift;
                self.values[t] = value.map(|v| v.max(0.0));
                // Neighbours share the noise of the corners; what bends between them is unknown.
                let error: f32 = (0..4).map(|k| w[k] * self.errors[at[k]]).sum();
                self.errors[t] = error.hypot(bent);
            }
        }
        agrees
    }
}
