//! The report of a run: `report.json` for programs, a short table for people.
//!
//! The fields are documented in `docs/report-schema.md`; the field names are the names in the
//! file. Numbers that are not known are `null`, never a made-up zero. Units stand in the names:
//! `_lm`, `_lux`, `_m2`, `_s`, `_bytes`; shares are 0..=1.

use crate::lit_mesh::LitMesh;
use luxel_core::quantity::LUMINANCE_WEIGHTS;
use luxel_core::{Scene, Side, Warnings};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// Version of the layout of `report.json`; rises when a field changes its meaning or goes.
pub const FORMAT: u32 = 1;

/// Names of the sides of a surface.
const FRONT: &str = "front";
const BACK: &str = "back";

/// Most surfaces in the table for people.
const TABLE_ROWS: usize = 15;

/// Everything that a run has to say about itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`FORMAT`].
    pub format: u32,
    /// Program and version, `luxel 0.1.0`.
    pub generator: String,
    /// Scene file as the user named it.
    pub scene: String,
    /// Whether the run came to its end.
    pub state: State,
    /// What was asked and what was reached.
    pub accuracy: Accuracy,
    /// Where the light went.
    pub energy: Energy,
    /// How big the task was.
    pub counts: Counts,
    /// Time of each stage, in order.
    pub stages: Vec<Stage>,
    /// Most memory that the process held, bytes; `null` where the system does not tell.
    pub memory_peak_bytes: Option<u64>,
    /// How the picture was exposed.
    pub exposure: Option<Exposure>,
    /// Light on each side of each surface.
    pub surfaces: Vec<SurfaceLight>,
    /// What was odd in the input and what was done about it.
    pub warnings: Vec<Oddity>,
    /// Settings of the run by name, as the program understood them.
    pub settings: serde_json::Map<String, serde_json::Value>,
    /// Seed of every random number.
    pub seed: u32,
}

/// Whether a run came to its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The asked accuracy was met.
    Finished,
    /// All work was done, but the asked accuracy was not met.
    NotMet,
    /// The user or a time limit ended it; the files are valid and can be resumed.
    #[default]
    Stopped,
}

/// Accuracy, as relative errors (0.02 is 2 %).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Asked relative error.
    pub asked: f64,
    /// Reached: the larger of the two below.
    pub reached: Option<f64>,
    /// Relative RMS error of element exitance, area-weighted, as the solver estimates it.
    pub elements: Option<f64>,
    /// Relative RMS standard error of the illuminance at the vertices shown.
    pub vertices: Option<f64>,
    /// Share of the vertices whose error is within what was asked, expected from their stated
    /// errors: see [`Within`].
    pub within: Option<f64>,
    /// Share of the emitted flux still unshot.
    pub unshot_share: Option<f64>,
}

/// Where the light went, photometric.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Energy {
    /// All groups together.
    pub total: Flux,
    /// Each luminaire group.
    pub groups: Vec<GroupFlux>,
}

/// Flux of one group.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GroupFlux {
    /// Name of the group.
    pub name: String,
    /// Its flux.
    #[serde(flatten)]
    pub flux: Flux,
}

/// The energy balance: emitted = absorbed + escaped + unshot + imbalance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Flux {
    /// Emitted into the scene by luminaires, surfaces and sky, lm.
    pub emitted_lm: f64,
    /// Absorbed by surfaces, lm.
    pub absorbed_lm: f64,
    /// Left through openings, lm.
    pub escaped_lm: f64,
    /// Still to be shot, signed, lm.
    pub unshot_lm: f64,
    /// What is missing from the balance, signed, lm: the error of the estimate.
    pub imbalance_lm: f64,
}

impl Flux {
    /// A balance from its four terms, with the imbalance worked out.
    pub fn balance(emitted_lm: f64, absorbed_lm: f64, escaped_lm: f64, unshot_lm: f64) -> Flux {
        let imbalance_lm = emitted_lm - absorbed_lm - escaped_lm - unshot_lm;
        Flux {
            emitted_lm,
            absorbed_lm,
            escaped_lm,
            unshot_lm,
            imbalance_lm,
        }
    }
}

impl Energy {
    /// The balance of all groups, summed from those of each.
    pub fn from_groups(groups: Vec<GroupFlux>) -> Energy {
        let mut total = Flux::default();
        for g in &groups {
            total.emitted_lm += g.flux.emitted_lm;
            total.absorbed_lm += g.flux.absorbed_lm;
            total.escaped_lm += g.flux.escaped_lm;
            total.unshot_lm += g.flux.unshot_lm;
            total.imbalance_lm += g.flux.imbalance_lm;
        }
        Energy { total, groups }
    }
}

/// How big the task was.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counts {
    /// Triangles lit, after repairs.
    pub triangles: u64,
    /// Surfaces.
    pub surfaces: u64,
    /// Elements of the last front.
    pub elements: u64,
    /// Vertices of the lit scene.
    pub vertices: u64,
    /// Texels of the lightmap, and those of them whose illuminance was asked; the others are
    /// interpolated.
    pub texels: u64,
    /// See `texels`.
    pub texels_asked: u64,
    /// Rays or form factors that the solver used.
    pub solver_work: u64,
    /// Rays that the gather used.
    pub gather_rays: u64,
    /// Steps of the solver.
    pub steps: u64,
    /// Luminaire groups.
    pub groups: u64,
    /// Threads.
    pub threads: u64,
}

/// Time of one stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// `read`, `mesh`, `solve`, ...
    pub name: String,
    /// Time on the clock, seconds.
    pub wall_s: f64,
    /// Time of all threads, seconds; `null` where the system does not tell.
    pub cpu_s: Option<f64>,
}

/// How the picture was exposed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Exposure value at ISO 100.
    pub ev100: f64,
    /// Display value (1 is white before the tone curve) for each cd/m².
    pub scale_per_cd_m2: f64,
}

/// Light on one side of one surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfaceLight {
    /// Index in the scene.
    pub surface: u32,
    /// Name of the surface.
    pub name: String,
    /// `front` or `back`.
    pub side: String,
    /// Area, m².
    pub area_m2: f64,
    /// Area-weighted mean illuminance.
    pub mean_lux: f64,
    /// Smallest illuminance at a vertex.
    pub min_lux: f64,
    /// Largest illuminance at a vertex.
    pub max_lux: f64,
    /// Area-weighted RMS standard error of the illuminance at a point (not of the mean).
    pub error_lux: f64,
    /// Share of the area whose error is within what was asked, expected from the stated errors.
    pub within: f64,
    /// Error that 95 % of the area is expected to be within, relative to the illuminance (or to a
    /// tenth of the mean of all, where that is more).
    pub error_p95: f64,
}

/// One warning.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Oddity {
    /// Where: file and part of it.
    pub place: String,
    /// What was found and what was done.
    pub what: String,
    /// How many.
    pub count: u64,
}

/// Warnings in the form of the report.
pub fn oddities(warnings: &Warnings) -> Vec<Oddity> {
    let one = |w: &luxel_core::Warning| Oddity {
        place: w.place.clone(),
        what: w.what.clone(),
        count: w.count as u64,
    };
    warnings.iter().map(one).collect()
}

/// Illuminance of each side of each surface that has elements, in the order of
/// [`LitMesh::parts`].
///
/// The mean is that of the linear interpolation that is shown (exact for it); its error falls
/// with the square of the elements' size. Minimum and maximum are those of the vertices.
///
/// Precondition: the irradiance is set.
pub fn surface_statistics(scene: &Scene, mesh: &LitMesh, asked: f64) -> Vec<SurfaceLight> {
    let asked = Within::new(mesh, asked);
    let lux = |v: u32| {
        let e = mesh.irradiance[v as usize];
        LUMINANCE_WEIGHTS
            .iter()
            .zip(e.to_array())
            .map(|(w, b)| *w as f64 * b as f64)
            .sum::<f64>()
    };
    let mut list = Vec::with_capacity(mesh.parts.len());
    for part in &mesh.parts {
        let (mut area, mut flux, mut variance, mut within) = (0.0, 0.0, 0.0, 0.0);
        let mut errors = Vec::new();
        for t in part.triangles.clone() {
            let corners = mesh.triangles[t as usize];
            let third = mesh.area(t as usize) / 3.0;
            area += 3.0 * third;
            for v in corners {
                flux += third * lux(v);
                variance += third * (mesh.errors[v as usize] as f64).powi(2);
                within += third * asked.probability(mesh, v);
                errors.push((third, asked.relative(mesh, v)));
            }
        }
        let (mut min, mut max) = (f64::INFINITY, 0.0f64);
        for v in part.vertices.clone() {
            min = min.min(lux(v));
            max = max.max(lux(v));
        }
        let per_area = 1.0 / area.max(f64::MIN_POSITIVE);
        list.push(SurfaceLight {
            surface: part.surface.0,
            name: scene.surfaces[part.surface.index()].name.clone(),
            side: if part.side == Side::Front {
                FRONT
            } else {
                BACK
            }
            .into(),
            area_m2: area,
            mean_lux: flux * per_area,
            min_lux: if min.is_finite() { min } else { 0.0 },
            max_lux: max,
            error_lux: (variance * per_area).sqrt(),
            within: within * per_area,
            error_p95: p95(&errors),
        });
    }
    list
}

/// Where an error is good enough however dark it is, as a share of the asked error of the mean
/// illuminance of all that is shown: 0.2 % of the mean for 2 %.
const DARK: f64 = 0.1;

/// What was asked of the vertices: an error of at most `asked` times the illuminance there, or times
/// a tenth of the mean of all where that is more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Within {
    asked: f64,
    least_lux: f64,
}

impl Within {
    /// For what `mesh` shows; the mean is over its area.
    ///
    /// Precondition: the irradiance is set.
    pub fn new(mesh: &LitMesh, asked: f64) -> Within {
        let (mut flux, mut whole) = (0.0, 0.0);
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let third = mesh.area(t) / 3.0;
            for &v in corners {
                flux += third * mesh.irradiance[v as usize].luminance() as f64;
                whole += third;
            }
        }
        let least_lux = DARK * flux / whole.max(f64::MIN_POSITIVE);
        Within { asked, least_lux }
    }

    /// The error of a vertex relative to what counts there, in stated standard errors.
    fn relative(&self, mesh: &LitMesh, v: u32) -> f64 {
        let lux = mesh.irradiance[v as usize].luminance() as f64;
        let counts = lux.max(self.least_lux).max(f64::MIN_POSITIVE);
        mesh.errors[v as usize] as f64 / counts
    }

    /// Probability that the error of a vertex is within what was asked.
    fn probability(&self, mesh: &LitMesh, v: u32) -> f64 {
        within_normal(self.asked, self.relative(mesh, v))
    }

    /// Share of the vertices within what was asked; `None` where there is none.
    pub fn share(&self, mesh: &LitMesh) -> Option<f64> {
        let n = mesh.positions.len();
        let sum: f64 = (0..n as u32).map(|v| self.probability(mesh, v)).sum();
        (n > 0).then(|| sum / n as f64)
    }
}

/// Probability that a normal error of standard deviation `sigma` is at most `most` in absolute value:
/// 1 where there is no error.
///
/// Source: [Abramowitz64] 7.1.26, to 1.5e-7.
fn within_normal(most: f64, sigma: f64) -> f64 {
    if sigma <= 0.0 {
        return 1.0;
    }
    let x = most / (sigma * std::f64::consts::SQRT_2);
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series = t
        * (0.254_829_592
            + t * (-0.284_496_736
                + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    1.0 - series * (-x * x).exp()
}

/// The error that a share of 95 % of all weight is within, from weights and standard errors, by
/// halving.
fn p95(errors: &[(f64, f64)]) -> f64 {
    let whole: f64 = errors.iter().map(|e| e.0).sum();
    let worst = errors.iter().map(|e| e.1).fold(0.0, f64::max);
    let (mut low, mut high) = (0.0, 2.0 * worst);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        let within: f64 = errors
            .iter()
            .map(|&(w, s)| w * within_normal(middle, s))
            .sum();
        if within < 0.95 * whole {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

/// Relative RMS standard error over everything shown: the root of the mean square error over
/// the root of the mean square illuminance, area-weighted. `None` where nothing is lit.
pub fn relative_error(mesh: &LitMesh) -> Option<f64> {
    let (mut errors, mut values) = (0.0, 0.0);
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let area = mesh.area(t);
        for &v in corners {
            errors += area * (mesh.errors[v as usize] as f64).powi(2);
            values += area * (mesh.irradiance[v as usize].luminance() as f64).powi(2);
        }
    }
    (values > 0.0).then(|| (errors / values).sqrt())
}

impl Report {
    /// The text of `report.json`. Numbers that are not finite become `null`.
    pub fn to_json(&self) -> String {
        // Only a map with keys that are no text can fail, and there is none.
        let mut text = serde_json::to_string_pretty(self).expect("all keys are text");
        text.push('\n');
        text
    }
}

/// The short table that ends `luxel light`: surfaces by area, energy balance, accuracy, time.
///
/// Surfaces of one name are one row for their fronts and one for their backs; backs that no light
/// reaches, as of walls seen from outside, are left out.
pub fn table(report: &Report) -> String {
    let mut rows: Vec<SurfaceLight> = Vec::new();
    let mut by_name: Vec<&SurfaceLight> = report.surfaces.iter().collect();
    by_name.sort_by(|a, b| row_of(a).cmp(&row_of(b)));
    for group in by_name.chunk_by(|a, b| row_of(a) == row_of(b)) {
        let area: f64 = group.iter().map(|s| s.area_m2).sum();
        let max_lux = group.iter().map(|s| s.max_lux).fold(0.0, f64::max);
        let (name, is_back) = row_of(group[0]);
        if is_back && max_lux == 0.0 {
            continue;
        }
        rows.push(SurfaceLight {
            name: if is_back {
                format!("{name} (back)")
            } else {
                name.to_owned()
            },
            area_m2: area,
            mean_lux: group.iter().map(|s| s.mean_lux * s.area_m2).sum::<f64>()
                / area.max(f64::MIN_POSITIVE),
            min_lux: group
                .iter()
                .map(|s| s.min_lux)
                .fold(f64::INFINITY, f64::min),
            max_lux,
            ..SurfaceLight::default()
        });
    }
    rows.sort_by(|a, b| {
        b.area_m2
            .total_cmp(&a.area_m2)
            .then_with(|| a.name.cmp(&b.name))
    });
    let mut out = String::new();
    // Writing to a string cannot fail.
    let mut line = |text: String| {
        let _ = writeln!(out, "{}", text.trim_end());
    };
    if !rows.is_empty() {
        let shown = &rows[..rows.len().min(TABLE_ROWS)];
        let width = shown
            .iter()
            .map(|r| r.name.chars().count())
            .max()
            .unwrap_or(0)
            .clamp(7, 32);
        line(format!(
            "{:<width$}  {:>9}  {:>9}  {:>9}  {:>9}",
            "surface", "area m²", "mean lux", "min lux", "max lux"
        ));
        for r in shown {
            line(format!(
                "{:<width$}  {:>9}  {:>9}  {:>9}  {:>9}",
                shortened(&r.name, width),
                figure(r.area_m2),
                figure(r.mean_lux),
                figure(r.min_lux),
                figure(r.max_lux)
            ));
        }
        if rows.len() > shown.len() {
            line(format!("and {} more", rows.len() - shown.len()));
        }
        line(String::new());
    }
    let f = &report.energy.total;
    let share = if f.emitted_lm > 0.0 {
        format!(" ({:+.2} %)", 100.0 * f.imbalance_lm / f.emitted_lm)
    } else {
        String::new()
    };
    line(format!(
        "energy    {} lm emitted = {} absorbed + {} escaped + {} unshot; imbalance {} lm{share}",
        figure(f.emitted_lm),
        figure(f.absorbed_lm),
        figure(f.escaped_lm),
        figure(f.unshot_lm),
        figure(f.imbalance_lm)
    ));
    let a = &report.accuracy;
    let reached = a.reached.map_or("not known".into(), percent);
    let state = match report.state {
        State::Finished => "",
        State::NotMet => " (not met)",
        State::Stopped => " (stopped before the end)",
    };
    let within = a.within.map_or(String::new(), |w| {
        format!(", {} of the vertices within it", percent(w))
    });
    line(format!(
        "accuracy  {reached} reached, {} asked{within}{state}",
        percent(a.asked)
    ));
    if f.emitted_lm == 0.0 {
        line("light     none: the scene needs some (--lamp, --emit or --sky)".into());
    }
    if !report.warnings.is_empty() {
        let count = report.warnings.len();
        line(format!(
            "warnings  {count}, told by luxel inspect and report.json"
        ));
    }
    let wall: f64 = report.stages.iter().map(|s| s.wall_s).sum();
    let stages: Vec<String> = report
        .stages
        .iter()
        .map(|s| format!("{} {} s", s.name, figure(s.wall_s)))
        .collect();
    line(format!(
        "time      {} s ({})",
        figure(wall),
        stages.join(", ")
    ));
    out
}

/// What tells rows of the table apart: name, and whether it is the back.
fn row_of(surface: &SurfaceLight) -> (&str, bool) {
    (&surface.name, surface.side == BACK)
}

fn percent(share: f64) -> String {
    format!("{} %", figure(100.0 * share))
}

/// Three figures, without an exponent in the usual range.
fn figure(v: f64) -> String {
    let size = v.abs();
    if !v.is_finite() {
        "-".into()
    } else if size == 0.0 || size >= 99.95 {
        format!("{v:.0}")
    } else if size >= 9.995 {
        format!("{v:.1}")
    } else if size >= 0.9995 {
        format!("{v:.2}")
    } else if size >= 0.001 {
        format!("{v:.3}")
    } else {
        format!("{v:.1e}")
    }
}

/// A name that fits its column and holds no control characters (names come from files).
fn shortened(name: &str, width: usize) -> String {
    let clean = || name.chars().map(|c| if c.is_control() { ' ' } else { c });
    if name.chars().count() <= width {
        clean().collect()
    } else {
        clean().take(width - 1).chain(['…']).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use luxel_core::{Finish, Rgb};

    #[test]
    fn shares_within_are_those_of_the_normal_distribution() {
        // Tables of the normal distribution: 68.269 % within one, 95 % within 1.95996 sigma.
        assert!((within_normal(1.0, 1.0) - 0.682_689).abs() < 1e-6);
        assert!((within_normal(1.959_964, 1.0) - 0.95).abs() < 1e-6);
        assert_eq!(within_normal(0.01, 0.0), 1.0);
        // Half of the weight has no error: 95 % of all is 90 % of the rest, 1.64485 sigma.
        let error = p95(&[(1.0, 0.0), (0.5, 2.0), (0.5, 2.0)]);
        assert!((error - 2.0 * 1.644_854).abs() < 1e-5, "{error}");
    }

    #[test]
    fn statistics_are_those_of_the_linear_light() {
        // E = 100 + 50 x over -1..1: mean 100, from 50 to 150, at any fineness of the mesh.
        for area in [10.0, 0.3] {
            let scene = testing::square(Finish::default());
            let front = testing::front(&scene, area, false);
            let mesh = testing::lit(&scene, &front, |p| Rgb::splat(100.0 + 50.0 * p.x));
            let all = surface_statistics(&scene, &mesh, 0.02);
            assert_eq!(all.len(), 1);
            let s = &all[0];
            assert_eq!((s.name.as_str(), s.side.as_str()), ("square", "front"));
            assert!((s.area_m2 - 4.0).abs() < 1e-5, "f32 positions");
            assert!(
                (s.mean_lux - 100.0).abs() < 1e-3,
                "weights of luminance sum to 1 in f32"
            );
            assert!((s.min_lux - 50.0).abs() < 1e-3 && (s.max_lux - 150.0).abs() < 1e-3);
            // An error of 1 lux at every vertex.
            assert!((s.error_lux - 1.0).abs() < 1e-6);
            // Root of the mean of E² = 10,000 + 2500 / 3 (a little less between the vertices'
            // squares: they are averaged, so a little more on the coarse mesh).
            let relative = relative_error(&mesh).expect("lit");
            assert!((1.0 / relative - 104.1).abs() < 8.0, "{relative}");
        }
    }

    fn report(surfaces: usize) -> Report {
        let surface = |k: usize| SurfaceLight {
            surface: k as u32,
            name: format!("wall {k}"),
            side: FRONT.into(),
            area_m2: (k + 1) as f64,
            mean_lux: 123.4,
            min_lux: 0.5,
            max_lux: 1234.5,
            error_lux: 1.0,
            within: 0.97,
            error_p95: 0.018,
        };
        let flux = Flux::balance(1000.0, 900.0, 90.0, 5.0);
        Report {
            format: FORMAT,
            accuracy: Accuracy {
                asked: 0.02,
                reached: Some(0.013),
                ..Accuracy::default()
            },
            energy: Energy::from_groups(vec![GroupFlux {
                name: "lamp".into(),
                flux,
            }]),
            stages: vec![Stage {
                name: "solve".into(),
                wall_s: 1.25,
                cpu_s: Some(2.4),
            }],
            surfaces: (0..surfaces).map(surface).collect(),
            state: State::Finished,
            ..Report::default()
        }
    }

    #[test]
    fn the_table_is_short_and_says_what_matters() {
        let text = table(&report(40));
        assert!(text.lines().count() <= 22, "{text}");
        assert!(
            text.contains("wall 39") && !text.contains("wall 3 "),
            "the largest first"
        );
        assert!(text.contains("and 25 more"), "{text}");
        assert!(text.contains("imbalance 5.00 lm (+0.50 %)"), "{text}");
        assert!(text.contains("1.30 % reached, 2.00 % asked"), "{text}");
        assert!(text.contains("1.25 s"), "{text}");
    }

    #[test]
    fn each_side_of_a_name_is_one_row() {
        let mut r = report(4);
        for surface in &mut r.surfaces {
            surface.name = "wall".into();
        }
        r.surfaces[0].mean_lux = 100.0;
        r.surfaces[1].mean_lux = 400.0;
        r.surfaces[2].side = BACK.into();
        r.surfaces[2].mean_lux = 7.77;
        r.surfaces[3].side = BACK.into();
        r.surfaces[3].mean_lux = 7.77;
        let text = table(&r);
        let [_heads, back, front, ..] = text.lines().collect::<Vec<_>>()[..] else {
            panic!("a line of heads and two rows: {text}");
        };
        assert!(
            back.contains("wall (back)") && back.contains("7.77"),
            "{text}"
        );
        // (1 * 100 + 2 * 400) / 3 m².
        assert!(front.contains("300"), "{text}");
        for surface in &mut r.surfaces[2..] {
            surface.max_lux = 0.0;
        }
        assert!(!table(&r).contains("back"), "dark backs are left out");
        r.surfaces[0].name = "evil\u{1b}[2J name".into();
        assert!(!table(&r).contains('\u{1b}'));
    }

    #[test]
    fn the_table_says_what_is_missing_or_odd() {
        let mut r = report(1);
        assert!(!table(&r).contains("warnings") && !table(&r).contains("--lamp"));
        r.warnings = vec![Oddity::default(); 2];
        r.energy = Energy::from_groups(Vec::new());
        let text = table(&r);
        assert!(
            text.contains("warnings  2, ") && text.contains("--lamp"),
            "{text}"
        );
    }

    #[test]
    fn json_goes_there_and_back_and_holds_no_made_up_numbers() {
        let mut r = report(3);
        let back: Report = serde_json::from_str(&r.to_json()).expect("our own text");
        assert_eq!(back, r);
        r.accuracy.asked = f64::NAN;
        let value: serde_json::Value = serde_json::from_str(&r.to_json()).expect("JSON");
        assert!(value["accuracy"]["asked"].is_null());
        assert!(value["memory_peak_bytes"].is_null());
        assert_eq!(value["state"], "finished");
        assert_eq!(value["energy"]["groups"][0]["emitted_lm"], 1000.0);
    }

    /// Names of all members of a JSON value, with their way down.
    fn members(value: &serde_json::Value, out: &mut Vec<String>) {
        match value {
            serde_json::Value::Object(map) => {
                for (name, inner) in map {
                    out.push(name.clone());
                    members(inner, out);
                }
            }
            serde_json::Value::Array(list) => list.iter().for_each(|v| members(v, out)),
            _ => {}
        }
    }

    #[test]
    fn every_member_is_in_the_schema_document() {
        let mut r = report(1);
        r.exposure = Some(Exposure::default());
        r.warnings = vec![Oddity::default()];
        let schema = include_str!("../../../docs/report-schema.md");
        let mut names = Vec::new();
        let value = serde_json::from_str(&r.to_json()).expect("JSON");
        members(&value, &mut names);
        for name in names {
            assert!(
                schema.contains(&format!("`{name}`")),
                "{name} is not documented"
            );
        }
    }
}
