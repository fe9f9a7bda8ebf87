//! Systems with known answers, without geometry.

use luxel_core::{DVec3, ElementId, Layers};
use luxel_solve::{Kind, Problem, Progress, Solver, Transport};
use luxel_transport::{FactorLines, FactorRow, FormFactors, GivenNodes, LocalLines, NodeFactors};

/// Form factors from a dense table; what a row lacks to 1 goes to `outside` and to black.
pub struct Dense {
    pub rows: Vec<Vec<f64>>,
    pub outside: Vec<f64>,
}

impl FormFactors for Dense {
    fn len(&self) -> usize {
        self.rows.len()
    }

    fn row(&self, element: ElementId, row: &mut FactorRow) {
        let i = element.index();
        row.entries.clear();
        let seen = self.rows[i].iter().enumerate().filter(|(_, f)| **f > 0.0);
        row.entries
            .extend(seen.map(|(j, f)| (ElementId::from(j), *f)));
        row.outside = self.outside[i];
    }
}

/// Everything that a [`Problem`] borrows.
pub struct System {
    pub layers: Layers,
    pub area: Vec<f64>,
    pub reflectance: Vec<f64>,
    pub emission: Vec<f64>,
    pub outside: Vec<f64>,
    pub factors: Box<dyn FormFactors>,
    pub lines: Box<dyn LocalLines>,
    pub nodes: Box<dyn NodeFactors>,
    pub seed: u32,
    pub importance: Option<Vec<f64>>,
}

impl System {
    pub fn new(
        groups: usize,
        area: Vec<f64>,
        reflectance: Vec<f64>,
        emission: Vec<f64>,
        dense: Dense,
    ) -> Self {
        let lines = Box::new(FactorLines::new(&dense));
        let nowhere = vec![DVec3::ZERO; area.len()];
        let nodes = Box::new(GivenNodes::new(&dense, &area, nowhere));
        System {
            layers: Layers {
                groups: (0..groups).map(|g| format!("group {g}")).collect(),
            },
            outside: vec![0.0; 3 * groups],
            area,
            reflectance,
            emission,
            factors: Box::new(dense),
            lines,
            nodes,
            seed: 7,
            importance: None,
        }
    }

    pub fn problem(&self, kind: Kind) -> Problem<'_> {
        Problem {
            layers: &self.layers,
            area: &self.area,
            reflectance: &self.reflectance,
            emission: &self.emission,
            outside: &self.outside,
            transport: if kind.needs_lines() {
                Transport::Lines(&*self.lines)
            } else if kind.needs_nodes() {
                Transport::Nodes(&*self.nodes)
            } else {
                Transport::Factors(&*self.factors)
            },
            seed: self.seed,
            importance: self.importance.as_deref(),
        }
    }

    /// B of the linear system by Gauss-Seidel to rounding.
    pub fn exact(&self) -> Vec<f64> {
        let problem = self.problem(Kind::GaussSeidel);
        let mut solver = luxel_solve::GaussSeidel::new();
        while solver.step(&problem).relative_error > 1e-13 {}
        solver.exitance().to_vec()
    }
}

/// Pseudo-random numbers in 0..1 [Steele14].
pub struct Dice(pub u64);

impl Dice {
    pub fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A random reciprocal system: areas of a ratio up to 30, reflectances 0.1 to 0.9 a band,
/// one element in eight emits, most of all the first. `open` is the share of each row that
/// leaves; half of it to the outside, half to black.
pub fn random(n: usize, groups: usize, open: f64, seed: u64) -> System {
    let mut dice = Dice(seed);
    let area: Vec<f64> = (0..n).map(|_| 0.1 * 30f64.powf(dice.roll())).collect();
    let mut kernel = vec![vec![0.0; n]; n];
    for i in 0..n {
        for j in 0..i {
            let w = dice.roll().powi(3) * area[i] * area[j];
            (kernel[i][j], kernel[j][i]) = (w, w);
        }
    }
    // Symmetric scaling until A_i F_ij sums to A_i (1 - open) [Sinkhorn67].
    let mut scale = vec![1.0; n];
    for _ in 0..300 {
        for i in 0..n {
            let sum: f64 = (0..n).map(|j| kernel[i][j] * scale[j]).sum();
            scale[i] = (scale[i] * area[i] * (1.0 - open) / sum).sqrt();
        }
    }
    let rows = (0..n)
        .map(|i| {
            (0..n)
                .map(|j| scale[i] * kernel[i][j] * scale[j] / area[i])
                .collect()
        })
        .collect();
    let reflectance = (0..3 * n).map(|_| 0.1 + 0.8 * dice.roll()).collect();
    let emission = (0..n * 3 * groups)
        .map(|at| {
            let i = at / (3 * groups);
            match i % 8 {
                0 if i == 0 => 3000.0 * dice.roll(),
                0 => 300.0 * dice.roll(),
                _ => 0.0,
            }
        })
        .collect();
    System::new(
        groups,
        area,
        reflectance,
        emission,
        Dense {
            rows,
            outside: vec![0.5 * open; n],
        },
    )
}

pub fn run(solver: &mut dyn Solver, problem: &Problem<'_>, steps: usize, error: f64) -> Progress {
    let mut progress = Progress::default();
    for _ in 0..steps {
        progress = solver.step(problem);
        if progress.finished || progress.relative_error <= error {
            break;
        }
    }
    progress
}

pub fn luminance(row: &[f64]) -> f64 {
    row.chunks(3)
        .map(|b| 0.2126 * b[0] + 0.7152 * b[1] + 0.0722 * b[2])
        .sum()
}

/// Area-weighted relative RMS of photometric exitance.
pub fn relative_rms(system: &System, found: &[f32], exact: &[f64]) -> f64 {
    let columns = system.layers.columns();
    let found: Vec<f64> = found.iter().map(|v| *v as f64).collect();
    let (mut error, mut whole) = (0.0, 0.0);
    for (i, a) in system.area.iter().enumerate() {
        let at = i * columns..(i + 1) * columns;
        let (x, y) = (luminance(&found[at.clone()]), luminance(&exact[at]));
        error += a * (x - y).powi(2);
        whole += a * y * y;
    }
    (error / whole).sqrt()
}

/// Photometric flux, lm.
pub fn flux(area: &[f64], values: &[f32]) -> f64 {
    let columns = values.len() / area.len();
    area.iter()
        .zip(values.chunks(columns))
        .map(|(a, r)| a * luminance(&r.iter().map(|v| *v as f64).collect::<Vec<_>>()))
        .sum()
}
