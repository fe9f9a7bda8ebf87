//! Solvers beside each other on the same front: error against time, and against rays or form
//! factors.
//!
//! The error of a solver is measured, not its own estimate: the root mean square difference of
//! element exitance from a converged solution of the same front, by area, in relation to the root
//! mean square of that solution. The reference is Gauss-Seidel to the end on factors from exact
//! shadows; where these are refused, random lines of another seed to a fifth of the asked error.

mod plot;

use crate::error::Error;
use crate::session::Session;
use crate::settings::Settings;
use crate::spare::replaced;
use crate::stage::{Seconds, Stage, cpu_seconds};
use crate::watch::{Control, Status, Watch, enter};
use luxel_core::{Rgb, Solution, Warnings};
use luxel_mesh::Kind as MeshKind;
use luxel_solve::Kind;
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Elements when nobody says: a stored matrix of them takes seconds.
pub const ELEMENTS: usize = 2_000;
/// Time for each solver when nobody says.
pub const TIME: Duration = Duration::from_secs(30);

/// What is written.
const FILES: [&str; 3] = ["compare.json", "compare.csv", "compare.svg"];

/// Measured again when a solver has taken this many times the time of the last measurement.
const STRIDE: f64 = 1.15;
/// Steps that are measured each, to begin with.
const FIRST: usize = 8;
/// Error of a random reference in relation to the one that is asked for.
const FINER: f64 = 0.2;
/// Most time for the reference in relation to that of a solver.
const PATIENCE: u32 = 10;
/// Errors for which the table tells when they were reached.
const MARKS: [f64; 4] = [0.1, 0.03, 0.01, 0.003];

/// What to compare and where to put it.
#[derive(Clone, Debug)]
pub struct CompareJob {
    /// Scene file.
    pub scene: PathBuf,
    /// Folder to write; `None` is `SCENE.compare` beside the scene.
    pub output: Option<PathBuf>,
    /// How it is read and meshed. `error` ends each solver that has reached it, `time` bounds each
    /// ([`TIME`] unless said), `elements` are [`ELEMENTS`] unless said; `solver` is not heeded.
    pub settings: Settings,
    /// Solvers, in the order of the table.
    pub solvers: Vec<Kind>,
}

/// What a solver had after some of its steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Steps so far.
    pub step: u32,
    /// Time of these steps alone; [`Curve::setup`] comes on top.
    pub seconds: Seconds,
    /// Rays cast or form factors used.
    pub work: u64,
    /// Measured relative error of element exitance, rms by area.
    pub error: f64,
    /// What the solver itself says of it.
    pub stated: f64,
    /// Links in force, of a solver that links clusters.
    pub links: Option<usize>,
}

/// How a solver ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// With the error that was asked for.
    Reached,
    /// Nothing more to gain, or nothing for as long as it had gone before.
    Converged,
    /// Out of time.
    Late,
}

impl End {
    /// Word in tables and files.
    pub fn name(self) -> &'static str {
        match self {
            End::Reached => "reached",
            End::Converged => "converged",
            End::Late => "out of time",
        }
    }
}

/// Error against time of one solver.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Which.
    pub solver: Kind,
    /// Form factors, if it needs some.
    pub setup: Seconds,
    /// In order of time.
    pub samples: Vec<Sample>,
    /// How it ended.
    pub end: End,
}

impl Curve {
    /// First sample with at most this error.
    pub fn first_below(&self, error: f64) -> Option<&Sample> {
        self.samples.iter().find(|s| s.error <= error)
    }
}

/// Solvers beside each other.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Name of the scene.
    pub scene: String,
    /// Mesh strategy of the front.
    pub mesh: MeshKind,
    /// Elements of the front.
    pub elements: usize,
    /// Where the truth is from, in words.
    pub reference: &'static str,
    /// Relative error of the reference as it states it; 0 for one to the end.
    pub reference_error: f64,
    /// One for each solver that could serve the front.
    pub curves: Vec<Curve>,
    /// Whether factors are from exact shadows; sampled ones have an error of their own, below which
    /// no solver that uses them gets. None if no solver used any.
    pub exact_factors: Option<bool>,
    /// Solvers that could not, and why.
    pub refused: Vec<(Kind, String)>,
    /// What was odd in the input.
    pub warnings: Warnings,
    /// Files that were written.
    pub files: Vec<PathBuf>,
}

/// Compares solvers on a scene file and writes `compare.json`, `compare.csv` and `compare.svg`.
/// `watch` may stop it: an error, nothing is then written.
pub fn compare(job: &CompareJob, watch: &mut Watch<'_>) -> Result<Comparison, Error> {
    if job.solvers.is_empty() {
        return Err(Error::Setting(
            "--solver: expected at least one solver, found none".into(),
        ));
    }
    let mesh = job.settings.mesh;
    if !matches!(mesh, MeshKind::Uniform | MeshKind::Dense) {
        return Err(Error::Setting(format!(
            "--mesh {}: expected a mesh that does not change while it is solved, such as uniform",
            mesh.name()
        )));
    }
    let output = job
        .output
        .clone()
        .unwrap_or_else(|| job.scene.with_extension("compare"));
    let mut settings = job.settings.clone();
    if settings.element_edge_m.is_none() {
        settings.elements.get_or_insert(ELEMENTS);
    }
    let patience = settings.time.take().unwrap_or(TIME);
    // Lines need nothing beside the front; factors are found when first needed.
    settings.solver = Kind::StochasticJacobi;
    let mut session = Session::open_watched(&job.scene, &settings, watch)?;
    let read = [std::slice::from_ref(&job.scene), session.files()].concat();
    let written = FILES.map(|name| output.join(name));
    if let Some(path) = replaced(&read, &written) {
        return Err(Error::Setting(format!(
            "{}: expected an output that does not replace what is read",
            path.display()
        )));
    }
    let mut comparison = compare_on(&mut session, &job.solvers, patience, watch)?;
    enter(watch, &Status::begin(Stage::Write))?;
    comparison.write(&output)?;
    Ok(comparison)
}

/// The same on a session whose front is there, in memory. The session ends with the last solver.
pub fn compare_on(
    session: &mut Session,
    solvers: &[Kind],
    patience: Duration,
    watch: &mut Watch<'_>,
) -> Result<Comparison, Error> {
    let (asked, seed) = (session.settings().error, session.settings().seed);
    let truth = reference(session, patience * PATIENCE, watch)?;
    let mut comparison = Comparison {
        scene: session.scene().name.clone(),
        mesh: session.settings().mesh,
        elements: session.front().len(),
        reference: truth.name,
        reference_error: truth.error,
        curves: Vec::new(),
        exact_factors: None,
        refused: Vec::new(),
        warnings: session.warnings().clone(),
        files: Vec::new(),
    };
    for (index, &solver) in solvers.iter().enumerate() {
        match session.begin_again(solver, seed, watch) {
            Ok(()) => {}
            Err(Error::Setting(why)) => {
                comparison.refused.push((solver, why));
                continue;
            }
            Err(other) => return Err(other),
        }
        let status = Status {
            share: index as f64 / solvers.len() as f64,
            ..Status::begin(Stage::Solve)
        };
        let (samples, end) = measure(session, &truth, asked, patience, &status, watch)?;
        let setup = if !solver.needs_factors() {
            Seconds::default()
        } else {
            comparison.exact_factors = Some(session.has_exact_factors());
            session.clock_mut().of(Stage::Factors)
        };
        comparison.curves.push(Curve {
            solver,
            setup,
            samples,
            end,
        });
    }
    Ok(comparison)
}

/// What errors are measured against.
struct Truth {
    /// Luminance of the exitance of each element, lm/m².
    exitance: Vec<f64>,
    name: &'static str,
    error: f64,
}

fn reference(
    session: &mut Session,
    patience: Duration,
    watch: &mut Watch<'_>,
) -> Result<Truth, Error> {
    let (asked, seed) = (session.settings().error, session.settings().seed);
    let status = Status::begin(Stage::Solve);
    let began = Instant::now();
    let exact = session.begin_again(Kind::GaussSeidel, seed, watch);
    match exact {
        Ok(()) if session.has_exact_factors() => {
            session.aim(0.0);
            while session.next().is_some() && began.elapsed() < patience {
                enter(watch, &status)?;
            }
            return Ok(Truth {
                exitance: exitance(session),
                name: "Gauss-Seidel on factors from exact shadows, to the end",
                error: session.progress().relative_error,
            });
        }
        Ok(()) | Err(Error::Setting(_)) => {}
        Err(other) => return Err(other),
    }
    session.begin_again(Kind::StochasticJacobi, seed ^ 0x5eed, watch)?;
    session.aim(FINER * asked);
    while session.next().is_some() && began.elapsed() < patience {
        enter(watch, &status)?;
    }
    Ok(Truth {
        exitance: exitance(session),
        name: "random lines of another seed",
        error: session.progress().relative_error,
    })
}

fn exitance(session: &Session) -> Vec<f64> {
    let solution: Solution = session.solution();
    let total = |e| Rgb::luminance(solution.total(e)) as f64;
    (0..session.front().len()).map(total).collect()
}

/// Steps of the session's solver until it has what is asked, with measurements that are not in the
/// time.
fn measure(
    session: &mut Session,
    truth: &Truth,
    asked: f64,
    patience: Duration,
    status: &Status,
    watch: &mut Watch<'_>,
) -> Result<(Vec<Sample>, End), Error> {
    session.aim(0.0);
    let area: Vec<f64> = session.front().area.iter().map(|&a| a as f64).collect();
    let square = |x: &mut dyn Iterator<Item = f64>| -> f64 {
        x.zip(&area).map(|(x, a)| a * x * x).sum::<f64>()
    };
    let whole = square(&mut truth.exitance.iter().copied());
    let mut samples: Vec<Sample> = Vec::new();
    let mut seconds = Seconds::default();
    loop {
        let (wall, cpu) = (Instant::now(), cpu_seconds());
        let step = session.next();
        seconds.wall += wall.elapsed().as_secs_f64();
        seconds.cpu += cpu_seconds() - cpu;
        let late = seconds.wall > patience.as_secs_f64();
        let last = samples.last().map_or(0.0, |s| s.seconds.wall);
        let ends = step.is_none() || late;
        if ends || samples.len() < FIRST || seconds.wall > STRIDE * last {
            let progress = session.progress();
            let now = exitance(session);
            let mut off = now.iter().zip(&truth.exitance).map(|(a, b)| a - b);
            let error = (square(&mut off) / whole.max(f64::MIN_POSITIVE)).sqrt();
            let sample = Sample {
                step: progress.step,
                seconds,
                work: progress.work,
                error,
                stated: progress.relative_error,
                links: session.links(),
            };
            // The last may have been measured already.
            if samples.last().is_none_or(|s| s.step != sample.step) {
                samples.push(sample);
            }
            if error <= asked {
                return Ok((samples, End::Reached));
            }
        }
        if step.is_none() {
            return Ok((samples, End::Converged));
        }
        if late {
            return Ok((samples, End::Late));
        }
        if watch(status) == Control::Stop {
            return Err(Error::Stopped);
        }
    }
}

impl Comparison {
    /// A table for people.
    pub fn table(&self) -> String {
        let mut out = format!(
            "{}: {} elements ({} mesh); error of element exitance against {}\n\n",
            self.scene,
            self.elements,
            self.mesh.name(),
            self.reference
        );
        let _ = write!(out, "{:>22} {:>10}", "solver", "factors s");
        for mark in MARKS {
            let _ = write!(out, " {:>9}", format!("{} % s", 100.0 * mark));
        }
        let _ = writeln!(
            out,
            " {:>9} {:>9} {:>11} {:>10} {:>9}",
            "end s", "error", "stated", "work", "links"
        );
        for curve in &self.curves {
            let Some(last) = curve.samples.last() else {
                continue;
            };
            let setup = match curve.setup.wall {
                s if s > 0.0 => format!("{s:.2}"),
                _ => "-".into(),
            };
            let _ = write!(out, "{:>22} {setup:>10}", curve.solver.name());
            for mark in MARKS {
                let when = curve.first_below(mark);
                let when = when.map_or("-".into(), |s| format!("{:.3}", s.seconds.wall));
                let _ = write!(out, " {when:>9}");
            }
            let _ = writeln!(
                out,
                " {:>9.3} {:>9} {:>11} {:>10.2e} {:>9}  {}",
                last.seconds.wall,
                format!("{:.3} %", 100.0 * last.error),
                format!("{:.3} %", 100.0 * last.stated),
                last.work as f64,
                last.links.map_or("-".into(), |n| n.to_string()),
                curve.end.name(),
            );
        }
        for (solver, why) in &self.refused {
            let _ = writeln!(out, "{:>22} left out: {why}", solver.name());
        }
        if self.exact_factors == Some(false) {
            out += "\nForm factors are sampled: their own error is where the solvers that use them end.\n";
        }
        out += "\nTimes are seconds by the clock; those of a solver come on top of its form factors. \
                Work: rays cast, or factors and links used.\n";
        out
    }

    /// All of it for programs.
    pub fn to_json(&self) -> serde_json::Value {
        let seconds = |s: &Seconds| json!({ "wall": s.wall, "cpu": s.cpu });
        json!({
            "program": concat!("luxel ", env!("CARGO_PKG_VERSION")),
            "scene": self.scene,
            "mesh": self.mesh.name(),
            "elements": self.elements,
            "reference": self.reference,
            "reference_error": self.reference_error,
            "exact_factors": self.exact_factors,
            "solvers": self.curves.iter().map(|c| json!({
                "solver": c.solver.name(),
                "end": c.end.name(),
                "setup_seconds": seconds(&c.setup),
                "samples": c.samples.iter().map(|s| json!({
                    "step": s.step,
                    "seconds": seconds(&s.seconds),
                    "work": s.work,
                    "error": s.error,
                    "stated": s.stated,
                    "links": s.links,
                })).collect::<Vec<_>>(),
            })).collect::<Vec<_>>(),
            "left_out": self.refused.iter().map(|(solver, why)| json!({
                "solver": solver.name(),
                "why": why,
            })).collect::<Vec<_>>(),
        })
    }

    fn to_csv(&self) -> String {
        let mut out = String::from("solver,step,setup_s,wall_s,cpu_s,work,error,stated,links\n");
        for c in &self.curves {
            for s in &c.samples {
                let _ = writeln!(
                    out,
                    "{},{},{},{},{},{},{:e},{:e},{}",
                    c.solver.name(),
                    s.step,
                    c.setup.wall,
                    s.seconds.wall,
                    s.seconds.cpu,
                    s.work,
                    s.error,
                    s.stated,
                    s.links.map_or(String::new(), |n| n.to_string())
                );
            }
        }
        out
    }

    fn write(&mut self, folder: &Path) -> Result<(), Error> {
        let failed = |path: &Path| {
            let path = path.to_path_buf();
            move |source| Error::Write { path, source }
        };
        std::fs::create_dir_all(folder).map_err(failed(folder))?;
        let texts = [
            format!("{:#}\n", self.to_json()),
            self.to_csv(),
            plot::svg(self),
        ];
        for (name, text) in FILES.into_iter().zip(texts) {
            let path = folder.join(name);
            std::fs::write(&path, text).map_err(failed(&path))?;
            self.files.push(path);
        }
        Ok(())
    }
}
