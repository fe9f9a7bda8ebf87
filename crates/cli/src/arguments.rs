//! The command line: what each command and flag means, and how its units are written.

use clap::{Args, Parser, Subcommand};
use luxel::{Back, MeshKind, Settings, SolverKind, Up, units};
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
    /// Light a scene: writes SCENE.lit/ with scene.glb, preview.png, report.json and the solution
    Light(Light),
    /// Illuminance at points, with its standard error, as tab-separated lines
    Probe(Probe),
    /// What was read, what was repaired, whether it is closed, where the lights are
    Inspect(Inspect),
    /// Check Luxel against closed forms and published cases
    Verify(Verify),
}

/// Flags that every command understands.
#[derive(Args, Debug, Clone)]
pub struct Common {
    /// Threads to use; 0 takes all cores. Results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
    /// Seed of every random number; the same seed gives the same bits
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u32,
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
    /// Mesh strategy: uniform, dense or adaptive
    #[arg(long, value_name = "M", default_value = "uniform", value_parser = parse_mesh)]
    pub mesh: MeshKind,
    /// Solver: stochastic-jacobi, monte-carlo-shooting, direct, jacobi, gauss-seidel or southwell
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
        settings.memory = self.memory;
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

fn parse_mesh(name: &str) -> Result<MeshKind, String> {
    MeshKind::parse(name).ok_or_else(|| expected(name, MeshKind::ALL.iter().map(|k| k.name())))
}

fn parse_solver(name: &str) -> Result<SolverKind, String> {
    SolverKind::parse(name).ok_or_else(|| expected(name, SolverKind::ALL.iter().map(|k| k.name())))
}

fn expected<'a>(found: &str, names: impl Iterator<Item = &'a str>) -> String {
    format!(
        "expected one of {}, found '{found}'",
        names.collect::<Vec<_>>().join(", ")
    )
}
