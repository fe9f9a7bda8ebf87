//! Cases that give the form factors themselves: exact exitance, published iterates, and the
//! lumen method.

use super::case::{Case, Query};
use super::{Answer, Found};
use luxel_core::Layers;
use luxel_core::layers::BANDS;
use luxel_solve::{
    Direct, GaussSeidel, Jacobi, Problem, Solver, SolverSettings, Southwell, Transport,
};
use luxel_transport::Matrix;
use serde_json::Value;

/// More shots than this and the count of shots is not what it should be.
const MOST_SHOTS: u32 = 100_000;

/// A grey radiosity equation with known factors: all three bands alike.
pub(super) struct System {
    pub area: Vec<f64>,
    reflectance: Vec<f64>,
    emission: Vec<f64>,
    matrix: Matrix,
    layers: Layers,
}

impl System {
    pub fn new(
        factors: &[Vec<f64>],
        area: &[f64],
        reflectance: &[f64],
        emission: &[f64],
    ) -> System {
        let grey = |v: &[f64]| v.iter().flat_map(|x| [*x; BANDS]).collect();
        System {
            area: area.to_vec(),
            reflectance: grey(reflectance),
            emission: grey(emission),
            matrix: Matrix::from_dense(factors, area),
            layers: Layers {
                groups: vec!["all".into()],
            },
        }
    }

    fn problem(&self) -> Problem<'_> {
        Problem {
            layers: &self.layers,
            area: &self.area,
            reflectance: &self.reflectance,
            emission: &self.emission,
            outside: &[0.0; BANDS],
            transport: Transport::Factors(&self.matrix),
            seed: 0,
            importance: None,
        }
    }

    /// Exact exitance of each element.
    pub fn exitance(&self) -> Vec<f64> {
        let mut solver = Direct::new();
        solver.step(&self.problem());
        one_band(solver.exitance())
    }

    /// Exitance by Gauss-Seidel to rounding, for systems too large for LU.
    pub fn relaxed(&self) -> Vec<f64> {
        let mut solver = GaussSeidel::new();
        let problem = self.problem();
        for _ in 0..10_000 {
            let before = solver.exitance().to_vec();
            solver.step(&problem);
            let most = solver.exitance().iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let step = before
                .iter()
                .zip(solver.exitance())
                .fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
            if before.len() == solver.exitance().len() && step <= 1e-14 * most {
                break;
            }
        }
        one_band(solver.exitance())
    }
}

fn one_band(values: &[f64]) -> Vec<f64> {
    values.chunks_exact(BANDS).map(|v| v[0]).collect()
}

pub(super) fn answer(case: &Case) -> Vec<Found> {
    let answers = system(case).map(|system| {
        case.queries
            .iter()
            .map(|query| one(case, &system, query))
            .collect::<Vec<Found>>()
    });
    answers.unwrap_or_else(|missing| case.queries.iter().map(|_| Err(missing.clone())).collect())
}

/// The equation of a case. Reflectance and emission stand by themselves or with the surfaces.
fn system(case: &Case) -> Result<System, String> {
    let scene = &case.scene;
    let factors = scene
        .form_factors
        .as_ref()
        .ok_or("the case gives no form factors")?;
    let areas = scene.areas.as_ref().ok_or("the case gives no areas")?;
    let of_surfaces =
        |get: &dyn Fn(&super::case::Surface) -> f64| scene.surfaces.iter().map(get).collect();
    let reflectance: Vec<f64> = scene
        .reflectance
        .clone()
        .unwrap_or_else(|| of_surfaces(&|s| s.reflectance.rgb()[0]));
    let emission: Vec<f64> = match (&scene.exitance, case.kind.as_str()) {
        (Some(given), _) => given.clone(),
        // Lumen method: the ceiling sends one lumen down; the first surface is the ceiling.
        (None, "utilisation_factor") => areas
            .iter()
            .enumerate()
            .map(|(k, a)| if k == 0 { 1.0 / a } else { 0.0 })
            .collect(),
        (None, _) => of_surfaces(&|s| s.exitance.rgb()[0]),
    };
    let n = areas.len();
    let square = factors.len() == n && factors.iter().all(|row| row.len() == n);
    if n == 0 || !square || reflectance.len() != n || emission.len() != n {
        return Err("form factors, areas, reflectance and exitance differ in length".into());
    }
    Ok(System::new(factors, areas, &reflectance, &emission))
}

fn one(case: &Case, system: &System, query: &Query) -> Found {
    let exact = |values| {
        Ok(Answer {
            values,
            class: "analytic",
        })
    };
    match (query.quantity.as_str(), query.id.as_str()) {
        ("radiosity_vector", _) => exact(system.exitance()),
        ("radiosity", _) => {
            let name = query.text("surface").ok_or("the query names no surface")?;
            let index = case.scene.surfaces.iter().position(|s| s.id == name);
            let index = index.or_else(|| name.parse().ok());
            let index = index.filter(|&i| i < system.area.len());
            let index = index.ok_or_else(|| format!("the case has no surface '{name}'"))?;
            exact(vec![system.exitance()[index]])
        }
        // Flux that reaches the floor, the last surface, of one lumen sent down.
        ("utilisation_factor", _) => {
            let floor = system.area.len() - 1;
            let b = system.exitance();
            let rho = system.reflectance[BANDS * floor];
            if rho <= 0.0 {
                return Err("a black floor shows no flux by its exitance".into());
            }
            exact(vec![b[floor] / rho * system.area[floor]])
        }
        ("direct_ratio", _) => {
            let last = luxel_core::ElementId::from(system.area.len() - 1);
            exact(vec![system.matrix.factor(luxel_core::ElementId(0), last)])
        }
        ("iterates", "jacobi") => {
            let mut solver = Jacobi::new();
            exact(sweeps(query, || {
                solver.step(&system.problem());
                one_band(solver.exitance())
            }))
        }
        ("iterates", "gauss_seidel") => {
            let mut solver = GaussSeidel::new();
            exact(sweeps(query, || {
                solver.step(&system.problem());
                one_band(solver.exitance())
            }))
        }
        ("iterates", "shooting") => exact(shots(system, query)),
        ("count", "shots_to_0.1pct") => Ok(Answer::one(shots_to(system, 1e-3)? as f64, "analytic")),
        (quantity, id) => Err(format!("quantity '{quantity}' ({id}) is not computed yet")),
    }
}

fn rows(query: &Query) -> usize {
    query.expected.as_array().map_or(0, Vec::len)
}

fn sweeps(query: &Query, mut sweep: impl FnMut() -> Vec<f64>) -> Vec<f64> {
    (0..rows(query)).flat_map(|_| sweep()).collect()
}

/// Shooting step by step, in the order of [`Query::expected_numbers`].
fn shots(system: &System, query: &Query) -> Vec<f64> {
    let problem = system.problem();
    let mut solver = Southwell::new(SolverSettings::default());
    let mut out = Vec::new();
    for row in 0..rows(query) {
        solver.step(&problem);
        let b = one_band(solver.exitance());
        let ambient = solver.ambient(&problem)[0];
        if query.expected[row]
            .get("shot")
            .is_some_and(Value::is_number)
        {
            out.push(solver.last_shot().index() as f64);
        }
        out.extend(&b);
        out.extend(one_band(solver.unshot()));
        out.push(ambient);
        out.extend(
            b.iter()
                .zip(system.reflectance.chunks_exact(BANDS))
                .map(|(b, rho)| b + rho[0] * ambient),
        );
    }
    out
}

/// Shots until the unshot flux is at most this share of the emitted flux.
fn shots_to(system: &System, share: f64) -> Result<u32, String> {
    let flux = |v: &[f64]| {
        v.chunks_exact(BANDS)
            .zip(&system.area)
            .map(|(u, a)| u[0] * a)
            .sum::<f64>()
    };
    let emitted = flux(&system.emission);
    let problem = system.problem();
    let mut solver = Southwell::new(SolverSettings::default());
    for shot in 1..=MOST_SHOTS {
        solver.step(&problem);
        if flux(solver.unshot()) <= share * emitted {
            return Ok(shot);
        }
    }
    Err("shooting does not converge".into())
}
