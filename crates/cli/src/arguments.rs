//! The command line: what each command and flag means, and how its units are written.

use clap::{Args, Parser, Subcommand};
use luxel::factors::FactorPoint;
use luxel::factors::zones::{By, ZoneWishes, parse_rows};
use luxel::{Back, CompareJob, FactorsJob, MeshKind, Precision, Settings, SolverKind, Up, units};
use std::ops::Range;
use std::path::PathBuf;
use std::time::Duration;

/// Light a room by radiosity: a scene file in; lit glTF, lux with a stated error and a report out.
#[derive(Parser, Debug)]
#[command(
    name = "luxel",
    version,
    max_term_width = 100,
    after_help = "\
Examples:
  luxel light scenes/two-rooms.glb                     light it, write scenes/two-rooms.lit/
  luxel light hall.obj --lamp 3000lm@2,2.6,1           light a scene that has no lamps
  luxel light room.glb --emit Panel=5000 --error 1%    make a material shine, 5000 cd/m2
  echo '1 0.75 2  0 1 0' | luxel probe room.glb --points -
  luxel inspect room.glb                               what was read, repaired, where the lights are
  luxel factors furnace.stl -o F.npz                   view factors between all facets

Exit code: 0 done; 1 asked accuracy not met or a case failed (files are written); 2 failed."
)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Subcommand, Debug)]
pub enum Command {
    /// Light a scene: writes SCENE.lit/ with scene.glb, lightmaps, preview.png, report.json and the solution
    Light(Light),
    /// Illuminance at points, with its standard error, as tab-separated lines
    Probe(Probe),
    /// What was read, what was repaired, whether it is closed, where the lights are
    Inspect(Inspect),
    /// View factors between the facets of a mesh: a sparse matrix and a report beside it
    #[command(after_help = FACTORS_HELP)]
    Factors(Factors),
    /// Solvers beside each other on one front: error against time, as table and plot
    #[command(after_help = COMPARE_HELP)]
    Compare(Compare),
    /// Check Luxel against closed forms and published cases
    Verify(Verify),
}

/// Flags that every command understands.
#[derive(Args, Debug, Clone)]
pub struct Run {
    /// Threads to use; 0 takes all cores. Results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
    /// Most memory to use, as 4GB
    #[arg(long, value_name = "BYTES", default_value = "4GB", value_parser = units::bytes)]
    pub memory: u64,
    /// Print nothing but errors and what was asked for
    #[arg(long, short)]
    pub quiet: bool,
    /// Print the result as JSON on standard output
    #[arg(long)]
    pub json: bool,
}

/// Flags of commands that draw random numbers.
#[derive(Args, Debug, Clone)]
pub struct Common {
    #[command(flatten)]
    pub run: Run,
    /// Seed of every random number; the same seed gives the same bits
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u32,
}

/// How a scene is read and what light is added to it.
#[derive(Args, Debug, Clone)]
pub struct SceneArguments {
    /// Scene file: .glb, .gltf or .obj
    pub scene: PathBuf,
    /// Factor from the file's lengths to metres
    #[arg(long, value_name = "K", default_value_t = 1.0)]
    pub scale: f32,
    /// Up axis of the file; y unless said
    #[arg(long, value_name = "AXIS", value_parser = ["y", "z"])]
    pub up: Option<String>,
    /// Backs of faces: as the front, or black (default: what the file says)
    #[arg(long, value_name = "KIND", value_parser = ["same", "black"])]
    pub back: Option<String>,
    /// Reflectance above this is clamped, and said
    #[arg(long, value_name = "SHARE", value_parser = units::reflectance)]
    pub max_reflectance: Option<f64>,
    /// Add a lamp: 800lm@x,y,z or 10cd@x,y,z>dx,dy,dz:inner,outer or 1000lx@dx,dy,dz; a colour may follow: *1,0.9,0.8
    #[arg(long, value_name = "LAMP")]
    pub lamp: Vec<String>,
    /// Make a material shine, cd/m2: MATERIAL=5000
    #[arg(long, value_name = "MATERIAL=L")]
    pub emit: Vec<String>,
    /// Luminance of a uniform sky outside, cd/m2
    #[arg(long, value_name = "L")]
    pub sky: Option<String>,
    /// Put luminaire groups together: NAME=a,b,c
    #[arg(long, value_name = "NAME=A,B")]
    pub merge: Vec<String>,
}

/// How it is solved.
#[derive(Args, Debug, Clone)]
pub struct SolveArguments {
    /// Asked accuracy of what is shown, as 2% or 0.02: relative standard error
    #[arg(long, value_name = "SHARE", default_value = "2%", value_parser = units::accuracy)]
    pub error: f64,
    /// Most time for solving and gathering, as 30s or 5min; what is reached by then is written
    #[arg(long, value_name = "TIME", value_parser = units::duration)]
    pub time: Option<Duration>,
    /// Mesh strategy: uniform, dense, adaptive, discontinuity (elements follow shadow lines) or rex (radiosity textures)
    #[arg(long, value_name = "M", default_value = "uniform", value_parser = parse_mesh)]
    pub mesh: MeshKind,
    /// Solver: stochastic-jacobi, monte-carlo-shooting, direct, jacobi, gauss-seidel, southwell,
    /// hierarchical, haar-wavelet or linear-wavelet
    #[arg(long, value_name = "S", default_value = "stochastic-jacobi", value_parser = parse_solver)]
    pub solver: SolverKind,
    /// Elements to aim at (default: by the scene)
    #[arg(long, value_name = "N")]
    pub elements: Option<usize>,
    /// Largest edge of an element, as 20cm (instead of --elements)
    #[arg(long, value_name = "LENGTH", value_parser = units::edge_m, conflicts_with = "elements")]
    pub edge: Option<f64>,
}

/// `luxel light`
#[derive(Args, Debug)]
pub struct Light {
    #[command(flatten)]
    pub scene: SceneArguments,
    #[command(flatten)]
    pub solve: SolveArguments,
    #[command(flatten)]
    pub common: Common,
    /// Folder to write (default: SCENE.lit beside the scene)
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Metres from texel to texel of the lightmaps, as 5cm (default: 5 cm, less in small
    /// scenes and more in large ones)
    #[arg(long, value_name = "LENGTH", value_parser = units::edge_m)]
    pub texel: Option<f64>,
    /// No lightmaps: the light is in the vertices alone
    #[arg(long, conflicts_with = "texel")]
    pub no_lightmap: bool,
    /// Go on from the solution in the output folder
    #[arg(long)]
    pub resume: bool,
    /// View for preview.png, by name (default: the scene's first camera, or one that is chosen)
    #[arg(long, value_name = "NAME")]
    pub view: Option<String>,
}

/// `luxel probe`
#[derive(Args, Debug)]
pub struct Probe {
    #[command(flatten)]
    pub scene: SceneArguments,
    #[command(flatten)]
    pub solve: SolveArguments,
    #[command(flatten)]
    pub common: Common,
    /// Lines 'x y z nx ny nz' (metres, and the normal of the plane): a file, or - for standard input
    #[arg(long, value_name = "FILE")]
    pub points: String,
}

/// `luxel inspect`
#[derive(Args, Debug)]
pub struct Inspect {
    #[command(flatten)]
    pub scene: SceneArguments,
    #[command(flatten)]
    pub common: Common,
}

const FACTORS_HELP: &str = "\
Rows are facets in the order of the file; a quad or polygon is one row. F[i, j] is the share of
what leaves the front of facet i (corners counter-clockwise) that reaches the front of facet j.
Backs block, and neither send nor receive.

Examples:
  luxel factors room.obj                               writes room.factors.npz and room.factors.json
  luxel factors furnace.stl -o F.mtx --enclosed        closed furnace: rows made to sum to 1
  luxel factors town.obj --by object                   between objects instead of facets
  luxel factors city.obj --compressed -o F.npz         too large for memory otherwise
  luxel factors town.obj --group roofs=3..90 --to-zones -o roofs.csv
  echo '0 0 1.2  0 0 1' | luxel factors town.obj --points - --by material -o person.csv

In Python: F = scipy.sparse.load_npz('room.factors.npz'); areas = numpy.load(...)['areas']

Exit code: 0 done; 1 accuracy not met (all is written), or stopped (finished rows are written, no
matrix with --compressed; --resume goes on); 2 failed.";

/// `luxel factors`
#[derive(Args, Debug)]
pub struct Factors {
    /// Mesh: .stl, .ply, .obj, .glb, .gltf or View3D's .vs3
    pub scene: PathBuf,
    /// Matrix to write: .npz (scipy.sparse), .csv (row,column,factor from 0) or .mtx (Matrix
    /// Market); a report .json comes beside it [default: SCENE.factors.npz]
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Promise per factor: |F - exact| at most this [default: 1e-4, or eps of a .vs3]
    #[arg(long, value_name = "E", value_parser = parse_promise)]
    pub error: Option<f64>,
    /// Only these rows, from 0, without the last: 0..100, 100.. or 7
    #[arg(long, value_name = "A..B", value_parser = parse_rows)]
    pub rows: Option<Range<u32>>,
    /// Factors between zones: each object, or each material
    #[arg(long, value_name = "KIND", value_parser = ["object", "material"])]
    pub by: Option<String>,
    /// Put objects, materials, facets or rows into a zone: NAME=a,b,10..20
    #[arg(long, value_name = "NAME=A,B")]
    pub group: Vec<String>,
    /// Keep facets as rows where columns are zones
    #[arg(long)]
    pub to_zones: bool,
    /// Factors from points instead: lines 'x y z nx ny nz' (metres), a file or - for standard input
    #[arg(long, value_name = "FILE", conflicts_with_all = ["rows", "to_zones", "enclosed", "resume"])]
    pub points: Option<String>,
    /// The scene is closed: make rows sum to 1 by the least change that keeps reciprocity; the
    /// size of the change is reported
    #[arg(long, conflicts_with = "rows")]
    pub enclosed: bool,
    /// Leave out factors below this in both directions; what rows lose is reported
    #[arg(long, value_name = "F", default_value_t = 0.0, value_parser = parse_threshold)]
    pub threshold: f64,
    /// Numbers as 64 or 32 bits [default: 64]
    #[arg(long, value_name = "BITS", value_parser = ["32", "64"])]
    pub precision: Option<String>,
    /// For scenes whose factors do not fit into --memory, from some 20,000 facets on: all rows as
    /// low-rank blocks and single entries, for products F x. An .npz of arrays that
    /// docs/view-factors-compressed.py reads; 100,000 facets of a room take 1.6 GB instead of 60
    #[arg(long)]
    pub compressed: bool,
    /// Factor from the file's lengths to metres
    #[arg(long, value_name = "K", default_value = "1", value_parser = parse_scale)]
    pub scale: f64,
    /// Turn every facet over
    #[arg(long)]
    pub flip: bool,
    /// Go on with work that was stopped or killed
    #[arg(long)]
    pub resume: bool,
    #[command(flatten)]
    pub run: Run,
}

impl Factors {
    /// The job for the library; `points` are those of `--points`, read.
    pub fn job(&self, points: Option<Vec<FactorPoint>>) -> FactorsJob {
        FactorsJob {
            scene: self.scene.clone(),
            output: self.output.clone(),
            scale: self.scale,
            flip: self.flip,
            error: self.error,
            rows: self.rows.clone(),
            threshold: self.threshold,
            zones: ZoneWishes {
                by: self.by.as_deref().map(|by| match by {
                    "material" => By::Material,
                    _ => By::Object,
                }),
                groups: self.group.clone(),
            },
            to_zones: self.to_zones,
            points,
            spared: self.points.iter().map(PathBuf::from).collect(),
            enclosed: self.enclosed,
            resume: self.resume,
            compressed: self.compressed,
            precision: self.precision.as_deref().map(|bits| match bits {
                "32" => Precision::Single,
                _ => Precision::Double,
            }),
            memory: self.run.memory,
        }
    }
}

const COMPARE_HELP: &str = "\
All solvers get the same elements. Their error is measured against a converged solution of these
elements, so it holds no error of the mesh.

Examples:
  luxel compare scenes/two-rooms.glb                   writes scenes/two-rooms.compare/
  luxel compare room.glb --solver southwell,gauss-seidel --elements 5000 --error 0.1%

Exit code: 0 done; 1 stopped (nothing is written); 2 failed.";

/// `luxel compare`
#[derive(Args, Debug)]
pub struct Compare {
    #[command(flatten)]
    pub scene: SceneArguments,
    /// Solvers, with commas between them, or all
    #[arg(long, value_name = "S,S", default_value = "all", value_parser = parse_solvers)]
    pub solver: Solvers,
    /// A solver ends when its measured error is this small
    #[arg(long, value_name = "SHARE", default_value = "0.3%", value_parser = units::accuracy)]
    pub error: f64,
    /// Most time for each solver
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = units::duration)]
    pub time: Duration,
    /// Mesh strategy: uniform or dense
    #[arg(long, value_name = "M", default_value = "uniform", value_parser = parse_mesh)]
    pub mesh: MeshKind,
    /// Elements to aim at (default: 2000)
    #[arg(long, value_name = "N")]
    pub elements: Option<usize>,
    /// Folder for compare.json, compare.csv and compare.svg (default: SCENE.compare beside the scene)
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub common: Common,
}

/// Some solvers.
#[derive(Clone, Debug)]
pub struct Solvers(pub Vec<SolverKind>);

impl Compare {
    /// The job for the library.
    pub fn job(&self) -> CompareJob {
        let mut settings = settings(&self.scene, None, &self.common);
        settings.error = self.error;
        settings.time = Some(self.time);
        settings.mesh = self.mesh;
        settings.elements = self.elements;
        CompareJob {
            scene: self.scene.scene.clone(),
            output: self.output.clone(),
            settings,
            solvers: self.solver.0.clone(),
        }
    }
}

/// `luxel verify`
#[derive(Args, Debug)]
pub struct Verify {
    /// Folder of reference cases (*.json); without it only the built-in closed forms are checked
    #[arg(long, value_name = "DIR")]
    pub cases: Option<PathBuf>,
    #[command(flatten)]
    pub common: Common,
}

impl SceneArguments {
    fn apply(&self, settings: &mut Settings) {
        settings.read.scale = self.scale;
        settings.read.up = self
            .up
            .as_deref()
            .map(|u| if u == "z" { Up::Z } else { Up::Y });
        settings.read.back = self
            .back
            .as_deref()
            .map(|b| if b == "same" { Back::Same } else { Back::Black });
        if let Some(limit) = self.max_reflectance {
            settings.read.max_reflectance = limit as f32;
        }
        settings.lamps = self.lamp.clone();
        settings.emit = self.emit.clone();
        settings.sky = self.sky.clone();
        settings.merge = self.merge.clone();
    }
}

impl Common {
    fn apply(&self, settings: &mut Settings) {
        settings.seed = self.seed;
        settings.memory = self.run.memory;
    }
}

impl SolveArguments {
    fn apply(&self, settings: &mut Settings) {
        settings.error = self.error;
        settings.time = self.time;
        settings.mesh = self.mesh;
        settings.solver = self.solver;
        settings.elements = self.elements;
        settings.element_edge_m = self.edge;
    }
}

/// The library's settings for a scene that is solved, or only read.
pub fn settings(
    scene: &SceneArguments,
    solve: Option<&SolveArguments>,
    common: &Common,
) -> Settings {
    let mut settings = Settings::default();
    scene.apply(&mut settings);
    if let Some(solve) = solve {
        solve.apply(&mut settings);
    }
    common.apply(&mut settings);
    settings
}

/// A number within bounds, in words for the error.
fn number(text: &str, low: f64, high: f64) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(v) if (low..=high).contains(&v) => Ok(v),
        _ => Err(format!(
            "expected a number from {low:e} to {high:e}, found '{text}'"
        )),
    }
}

fn parse_promise(text: &str) -> Result<f64, String> {
    number(text, 1e-8, 0.1)
}

fn parse_threshold(text: &str) -> Result<f64, String> {
    number(text, 0.0, 0.1)
}

fn parse_scale(text: &str) -> Result<f64, String> {
    number(text, 1e-9, 1e9)
}

fn parse_mesh(name: &str) -> Result<MeshKind, String> {
    MeshKind::parse(name).ok_or_else(|| expected(name, MeshKind::ALL.iter().map(|k| k.name())))
}

fn parse_solver(name: &str) -> Result<SolverKind, String> {
    SolverKind::parse(name).ok_or_else(|| expected(name, SolverKind::ALL.iter().map(|k| k.name())))
}

fn parse_solvers(names: &str) -> Result<Solvers, String> {
    if names == "all" {
        return Ok(Solvers(SolverKind::ALL.to_vec()));
    }
    let mut solvers = Vec::new();
    for name in names.split(',') {
        let solver = parse_solver(name)?;
        if !solvers.contains(&solver) {
            solvers.push(solver);
        }
    }
    Ok(Solvers(solvers))
}

fn expected<'a>(found: &str, names: impl Iterator<Item = &'a str>) -> String {
    format!(
        "expected one of {}, found '{found}'",
        names.collect::<Vec<_>>().join(", ")
    )
}
