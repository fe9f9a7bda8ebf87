//! A session: one scene from file to solution, step by step, and the answers asked of it.
//!
//! model environment -> surface meshing -> form factors -> solve -> gather. This is the only
//! place where a mesh strategy and a solver are named together; they meet in the four shared
//! records alone.

use crate::error::Error;
use crate::matter::Matter;
use crate::settings::Settings;
use crate::stage::{Clock, Stage};
use crate::watch::{Control, Status, Watch, enter};
use luxel_core::quantity::Exitance;
use luxel_core::{ElementId, Front, Hierarchy, Layers, Rgb, Scene, Solution, Warnings};
use luxel_gather::{Accuracy, DirectLights, ElementDirect, Gatherer, Irradiance, Receiver};
use luxel_io::{Document, Source, scene_ops};
use luxel_mesh::{MeshSettings, Strategy};
use luxel_solve::{Progress, Solver, SolverSettings, Transport};
use luxel_transport::{
    Bvh, Exact, FrontLines, FrontNodes, Matrix, MatrixSettings, NodeFactors, RayCaster,
};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Promise of each stored form factor, absolute.
const FACTOR_ERROR: f64 = 1e-4;

/// Refinements of an adaptive mesh before it is taken as it is.
const MOST_REFINEMENTS: u32 = 4;

/// An error below this share of the scene's typical illuminance is small enough, however dark a
/// receiver is.
const DARK: f32 = 0.1;

/// Fewest gather rays for an accuracy of 2 %; they grow as the inverse square.
const FEWEST_RAYS: f64 = 256.0;

/// A scene being solved.
///
/// An iterator of [`Progress`]: each `next` does one step of the solver, and the iteration ends
/// when the asked accuracy is reached. It may be left and taken up at any step.
///
/// ```no_run
/// use luxel::{Session, Settings};
/// let mut session = Session::open("scenes/two-rooms.glb".as_ref(), &Settings::default())?;
/// for progress in session.by_ref() {
///     println!("{:.1} % unshot", 100.0 * progress.unshot_share);
/// }
/// # Ok::<(), luxel::Error>(())
/// ```
pub struct Session {
    settings: Settings,
    scene: Arc<Scene>,
    source: Option<Source>,
    files: Vec<PathBuf>,
    warnings: Warnings,
    caster: Bvh,
    strategy: Box<dyn Strategy>,
    front: Front,
    lights: DirectLights,
    matter: Matter,
    factors: Option<Matrix>,
    /// Found by exact shadows, not by sampling.
    factors_are_exact: bool,
    /// Clusters of the front, where the solver links them.
    tree: Option<Hierarchy>,
    pairs: MatrixSettings,
    solver: Box<dyn Solver>,
    progress: Progress,
    refinements: u32,
    clock: Clock,
    /// Relative error of element exitance at which the solver may stop.
    target: f64,
}

/// Reads a scene and adds the light that the settings name.
pub fn read(path: &Path, settings: &Settings) -> Result<Document, Error> {
    let mut read = settings.read.clone();
    read.memory_limit = settings.memory;
    let mut document = luxel_io::read(path, &read)?;
    let scene = &mut document.scene;
    for lamp in &settings.lamps {
        scene_ops::add_lamp(scene, lamp)
            .map_err(|e| Error::Setting(format!("--lamp {lamp}: {e}")))?;
    }
    for emit in &settings.emit {
        scene_ops::set_emission(scene, emit)
            .map_err(|e| Error::Setting(format!("--emit {emit}: {e}")))?;
    }
    if let Some(sky) = &settings.sky {
        scene_ops::set_sky(scene, sky).map_err(|e| Error::Setting(format!("--sky {sky}: {e}")))?;
    }
    for merge in &settings.merge {
        scene_ops::merge_groups(scene, merge)
            .map_err(|e| Error::Setting(format!("--merge {merge}: {e}")))?;
    }
    Ok(document)
}

impl Session {
    /// Reads a scene file and makes it ready to solve.
    pub fn open(path: &Path, settings: &Settings) -> Result<Session, Error> {
        Session::open_watched(path, settings, &mut unwatched)
    }

    /// As [`Session::open`]; `watch` is told of the stages and may stop it, which is an error.
    pub fn open_watched(
        path: &Path,
        settings: &Settings,
        watch: &mut Watch<'_>,
    ) -> Result<Session, Error> {
        let mut clock = Clock::start();
        enter(watch, &Status::begin(Stage::Read))?;
        let document = read(path, settings)?;
        clock.end(Stage::Read);
        let mut session = Session::start(
            document.scene,
            Some(document.source),
            document.warnings,
            settings,
            clock,
            watch,
        )?;
        session.files = document.files;
        Ok(session)
    }

    /// Makes a scene that is in memory ready to solve.
    pub fn new(scene: Scene, settings: &Settings) -> Result<Session, Error> {
        Session::start(
            scene,
            None,
            Warnings::default(),
            settings,
            Clock::start(),
            &mut unwatched,
        )
    }

    fn start(
        read: Scene,
        source: Option<Source>,
        mut warnings: Warnings,
        settings: &Settings,
        mut clock: Clock,
        watch: &mut Watch<'_>,
    ) -> Result<Session, Error> {
        let mut mesh = fitting_mesh(&read, settings, &mut warnings)?;
        enter(watch, &Status::begin(Stage::Prepare))?;
        let prepare = settings.mesh.prepare(&mesh);
        let scene = Arc::new(luxel_mesh::prepare(read, &prepare, &mut warnings));
        let caster = Bvh::build(&scene);
        clock.end(Stage::Prepare);

        if settings.elements.is_none()
            && settings.element_edge_m.is_none()
            && settings.solver.needs_factors()
        {
            // A stored matrix grows with the square of the elements.
            mesh = MeshSettings::for_scene(&scene, MATRIX_ELEMENTS);
        }
        enter(watch, &Status::begin(Stage::Mesh))?;
        let mut strategy = settings.mesh.build(mesh);
        let front = strategy.initial(&scene);
        clock.end(Stage::Mesh);

        let lights = DirectLights::new(&scene, &front);
        let shines = |e: &Rgb| e.luminance() > 0.0;
        if lights.is_empty() && scene.sky.is_none() && !front.emission.iter().any(shines) {
            let what = "there is no light: add some with --lamp, --emit or --sky";
            warnings.add(scene.name.as_str(), what, 1);
        }
        let mut session = Session {
            settings: settings.clone(),
            matter: Matter::new(
                &scene,
                &front,
                &lights,
                &vec![0.0; front.len() * scene.layers().columns()],
            ),
            scene,
            source,
            files: Vec::new(),
            warnings,
            caster,
            strategy,
            front,
            lights,
            factors: None,
            factors_are_exact: false,
            tree: None,
            pairs: MatrixSettings {
                seed: settings.seed,
                ..MatrixSettings::default()
            },
            solver: settings.solver.build(SolverSettings::default()),
            progress: Progress::default(),
            refinements: 0,
            clock,
            target: settings.error,
        };
        session.take_front(watch)?;
        Ok(session)
    }

    /// What depends on the front alone: direct light of its elements, and its form factors.
    fn take_front(&mut self, watch: &mut Watch<'_>) -> Result<(), Error> {
        self.lights = DirectLights::new(&self.scene, &self.front);
        let samples = (DIRECT_POINTS / self.front.len().max(1)).clamp(4, 16) as u32;
        let settings = ElementDirect {
            samples: 1 << samples.ilog2(),
            seed: self.settings.seed,
            ..ElementDirect::default()
        };
        let elements = self.front.len();
        let mut direct = Vec::with_capacity(elements * self.matter.layers().columns());
        let mut status = Status::begin(Stage::Direct);
        for first in (0..elements).step_by(RUN) {
            status.share = first as f64 / elements as f64;
            enter(watch, &status)?;
            let run = first..(first + RUN).min(elements);
            direct.extend(self.lights.element_irradiance_of(
                run,
                &self.scene,
                &self.front,
                &self.caster,
                &settings,
            ));
        }
        self.matter = Matter::new(&self.scene, &self.front, &self.lights, &direct);
        self.clock.end(Stage::Direct);
        self.factors = None;
        self.tree = None;
        self.take_factors(watch)
    }

    /// Form factors of the front or a tree over it, if the solver needs some and there are none.
    fn take_factors(&mut self, watch: &mut Watch<'_>) -> Result<(), Error> {
        if self.settings.solver.needs_nodes() && self.tree.is_none() {
            self.tree = Some(luxel_mesh::hierarchy(&self.scene, &self.front));
        }
        if self.settings.solver.needs_factors() {
            // Most pairs of a room see each other: 16 bytes each, and LU holds three bands of f64.
            let pairs = (self.front.len() as u64).pow(2);
            let needed = pairs
                * if self.settings.solver == luxel_solve::Kind::Direct {
                    48
                } else {
                    16
                };
            if needed > self.settings.memory || !self.settings.solver.fits(self.front.len()) {
                return Err(Error::Setting(format!(
                    "--solver {}: {} elements need about {} MB of form factors, too many; \
                     use fewer --elements or the default solver",
                    self.settings.solver.name(),
                    self.front.len(),
                    needed / 1_000_000
                )));
            }
            if self.factors.is_some() {
                return Ok(());
            }
            let settings = MatrixSettings {
                seed: self.settings.seed,
                ..MatrixSettings::default()
            };
            enter(watch, &Status::begin(Stage::Factors))?;
            let (scene, front, caster) = (&*self.scene, &self.front, &self.caster);
            let exact = Matrix::exact(
                scene,
                front,
                caster,
                &settings,
                FACTOR_ERROR,
                &mut |share| {
                    let status = Status {
                        share,
                        ..Status::begin(Stage::Factors)
                    };
                    watch(&status) == Control::Go
                },
            );
            let (matrix, are_exact) = match exact {
                Exact::Done(matrix) => (matrix, true),
                Exact::Stopped => return Err(Error::Stopped),
                Exact::Refused => (Matrix::assemble(scene, front, caster, &settings), false),
            };
            self.factors = Some(matrix);
            self.factors_are_exact = are_exact;
            self.clock.end(Stage::Factors);
        }
        Ok(())
    }

    /// Begins anew with another solver and seed on the same front: nothing but form factors, which
    /// are kept, is left of the work so far.
    pub fn begin_again(
        &mut self,
        solver: luxel_solve::Kind,
        seed: u32,
        watch: &mut Watch<'_>,
    ) -> Result<(), Error> {
        self.settings.solver = solver;
        self.settings.seed = seed;
        self.solver = solver.build(SolverSettings::default());
        self.progress = Progress::default();
        self.take_factors(watch)
    }

    /// Whether there are form factors that exact shadows were used for; `false` also when there
    /// are none.
    pub fn has_exact_factors(&self) -> bool {
        self.factors.is_some() && self.factors_are_exact
    }

    /// Sets the relative error of element exitance at which the solver stops; that of the settings
    /// unless said.
    pub fn aim(&mut self, error: f64) {
        self.target = error;
    }

    /// Relative error of element exitance at which the solver stops.
    pub fn target(&self) -> f64 {
        self.target
    }

    fn reached(&self) -> bool {
        self.progress.finished
            || (self.progress.step > 1
                && self.progress.relative_error <= self.target
                && self.progress.unshot_share <= 0.1 * self.settings.error)
    }

    /// Asks the mesh strategy for a finer front; `false` when it has none.
    fn refine(&mut self) -> bool {
        if self.refinements >= MOST_REFINEMENTS {
            return false;
        }
        let solution = self.solution();
        let wish = luxel_mesh::neighbour_difference(&self.scene, &self.front, &solution);
        let Some((front, change)) =
            self.strategy
                .refine(&self.scene, &self.front, &solution, &wish)
        else {
            self.refinements = MOST_REFINEMENTS;
            return false;
        };
        self.refinements += 1;
        self.front = front;
        self.clock.end(Stage::Mesh);
        if self.take_front(&mut unwatched).is_err() {
            // More factors than memory holds: this front is the last.
            self.refinements = MOST_REFINEMENTS;
        }
        self.with_solver(|solver, problem| solver.restart(&change, problem));
        true
    }

    fn with_solver<T>(
        &mut self,
        act: impl FnOnce(&mut dyn Solver, &luxel_solve::Problem<'_>) -> T,
    ) -> T {
        let lines = FrontLines::new(&self.scene, &self.front, &self.caster);
        let nodes = nodes(
            &self.scene,
            &self.front,
            &self.caster,
            &self.tree,
            &self.pairs,
        );
        let transport = transport(&self.settings, &self.factors, &lines, &nodes);
        let problem = self.matter.problem(transport, self.settings.seed);
        act(self.solver.as_mut(), &problem)
    }

    /// The solution as it stands. Never holds the ambient term.
    pub fn solution(&self) -> Solution {
        self.with_problem(|problem| self.solver.solution(problem))
    }

    /// The problem without the geometry between clusters: what is known is told without it.
    fn with_problem<T>(&self, act: impl FnOnce(&luxel_solve::Problem<'_>) -> T) -> T {
        let lines = FrontLines::new(&self.scene, &self.front, &self.caster);
        let transport = transport(&self.settings, &self.factors, &lines, &None);
        act(&self.matter.problem(transport, self.settings.seed))
    }

    /// Exitance with the ambient term added: for a picture of an unfinished solution, never stored.
    pub fn displayed(&self) -> Solution {
        let mut solution = self.solution();
        let lines = FrontLines::new(&self.scene, &self.front, &self.caster);
        let problem = self
            .matter
            .problem(Transport::Lines(&lines), self.settings.seed);
        solution.exitance = luxel_solve::ambient::displayed(&problem, &solution);
        solution
    }

    /// All that leaves an element, own emission and reflected light of every group, lm/m².
    pub fn leaving(&self, solution: &Solution, element: usize) -> Exitance {
        let apart = self.lights.is_direct(self.front.patch[element]);
        let own = if apart {
            self.front.emission[element]
        } else {
            Rgb::BLACK
        };
        Exitance::new(solution.total(element) + own)
    }

    /// Illuminance of every element, all groups together, lux of each band; 0 where a band is not
    /// reflected.
    pub fn received(&self, solution: &Solution) -> Vec<Rgb> {
        let (front, lights) = (&self.front, &self.lights);
        let of_element = |e: usize| {
            let is_source = front.group(ElementId::from(e)).is_some();
            let own = if is_source && !lights.is_direct(front.patch[e]) {
                front.emission[e]
            } else {
                Rgb::BLACK
            };
            let (leaving, own) = (solution.total(e).to_array(), own.to_array());
            let rho = front.reflectance[e].to_array();
            Rgb::from([0, 1, 2].map(|band| {
                let reflected = (leaving[band] - own[band]).max(0.0);
                if rho[band] > 0.0 {
                    reflected / rho[band]
                } else {
                    0.0
                }
            }))
        };
        (0..front.len()).into_par_iter().map(of_element).collect()
    }

    /// Takes up a stored solution of this very scene and settings.
    pub fn resume(&mut self, stored: &Solution) {
        self.with_solver(|solver, problem| solver.resume(stored, problem));
        self.progress.relative_error = stored.relative_error as f64;
        self.progress.unshot_share = stored.unshot_share as f64;
        self.progress.work = stored.work;
        self.progress.step = self.progress.step.max(2);
    }

    /// Irradiance at any receivers from the solution as it stands: the one function behind
    /// every number shown.
    ///
    /// `values[receiver * columns + column]` in lux of each band, with one standard error a layer
    /// and one for the total, which holds the noise of gather and shadow rays and that of the
    /// elements; 1.96 times it is half of a 95 % interval.
    pub fn irradiance_at(
        &self,
        solution: &Solution,
        receivers: &[Receiver],
        accuracy: &Accuracy,
    ) -> Irradiance {
        self.gatherer(solution, &self.lights)
            .irradiance_at(receivers, accuracy)
    }

    /// What answers for many lots of receivers: cheaper than [`Session::irradiance_at`] for each,
    /// with the same bits. `lights` are [`Session::lights`], or merged as `solution` is.
    pub fn gatherer<'a>(
        &'a self,
        solution: &'a Solution,
        lights: &'a DirectLights,
    ) -> Gatherer<'a> {
        Gatherer::new(&self.scene, &self.front, &self.caster, solution, lights)
            .with_element_noise(self.noise())
    }

    /// One draw of the noise of each element's exitance, lm/m².
    fn noise(&self) -> Vec<f32> {
        self.with_problem(|problem| self.solver.noise(problem))
    }

    /// The accuracy that the settings ask for, with darkness measured against `solution`.
    pub fn accuracy(&self, solution: &Solution) -> Accuracy {
        // A light seen through a gap must be found before the spread of the rays is believed.
        let fewest = (FEWEST_RAYS * (0.02 / self.settings.error).powi(2)).clamp(32.0, 512.0) as u32;
        let relative = self.settings.error as f32;
        Accuracy {
            relative,
            floor_lux: DARK * relative * self.typical_illuminance(solution),
            rays: [fewest, 16384],
            seed: self.settings.seed,
        }
    }

    /// Mean illuminance of the elements that reflect and are lit, by area, but at most twice its
    /// median, lux: what the scene looks like, even when a lamp hangs close to a wall, most of the
    /// light stays in another room, or most of the area is a dark field outside.
    fn typical_illuminance(&self, solution: &Solution) -> f32 {
        let (mut flux, mut area) = (0.0f64, 0.0f64);
        let mut lit: Vec<f32> = (0..self.front.len())
            .filter_map(|e| {
                let rho = self.front.reflectance[e].luminance();
                let lux = solution.total(e).luminance() / rho;
                let counts = rho > 0.01 && lux > 0.0;
                if counts {
                    flux += lux as f64 * self.front.area[e] as f64;
                    area += self.front.area[e] as f64;
                }
                counts.then_some(lux)
            })
            .collect();
        let middle = lit.len() / 2;
        if lit.is_empty() {
            return 0.0;
        }
        let median = *lit.select_nth_unstable_by(middle, f32::total_cmp).1;
        ((flux / area) as f32).min(2.0 * median)
    }

    /// Energy balance of the solution, lumens.
    pub fn balance(&self, solution: &Solution) -> luxel_solve::balance::EnergyBalance {
        self.with_problem(|problem| luxel_solve::balance::measure(problem, solution, BALANCE_LINES))
    }

    /// The scene as it is solved.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// What the scene's file holds beside the scene; `None` for a scene from memory.
    pub fn source(&self) -> Option<&Source> {
        self.source.as_ref()
    }

    /// Files that were read for the scene; none for a scene from memory.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// The elements in force.
    pub fn front(&self) -> &Front {
        &self.front
    }

    /// The ray engine.
    pub fn caster(&self) -> &dyn RayCaster {
        &self.caster
    }

    /// Lights whose direct light is computed apart.
    pub fn lights(&self) -> &DirectLights {
        &self.lights
    }

    /// The known side of the equation.
    pub(crate) fn matter(&self) -> &Matter {
        &self.matter
    }

    /// Names of the columns.
    pub fn layers(&self) -> &Layers {
        self.matter.layers()
    }

    /// What was odd in the input.
    pub fn warnings(&self) -> &Warnings {
        &self.warnings
    }

    /// Settings of this session.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Links in force, where the solver links clusters.
    pub fn links(&self) -> Option<usize> {
        self.solver.links()
    }

    /// How far the solver is.
    pub fn progress(&self) -> Progress {
        self.progress
    }

    /// What solving has left of the time for solving and gathering, if it is bounded.
    pub(crate) fn time_left(&self) -> Option<Duration> {
        let solving = self.clock.of(Stage::Solve).wall;
        let time = self.settings.time?;
        Some(time.saturating_sub(Duration::from_secs_f64(solving)))
    }

    /// Times of the stages so far.
    pub fn clock_mut(&mut self) -> &mut Clock {
        &mut self.clock
    }
}

impl Iterator for Session {
    type Item = Progress;

    fn next(&mut self) -> Option<Progress> {
        if self.reached() && !self.refine() {
            return None;
        }
        self.progress = self.with_solver(|solver, problem| solver.step(problem));
        self.clock.end(Stage::Solve);
        Some(self.progress)
    }
}

/// Stored factors or clusters where the solver needs them, else lines.
fn transport<'a>(
    settings: &Settings,
    factors: &'a Option<Matrix>,
    lines: &'a FrontLines<'a>,
    nodes: &'a Option<FrontNodes<'a>>,
) -> Transport<'a> {
    match (factors, nodes) {
        (_, Some(nodes)) if settings.solver.needs_nodes() => {
            Transport::Nodes(nodes as &dyn NodeFactors)
        }
        (Some(matrix), _) if settings.solver.needs_factors() => Transport::Factors(matrix),
        _ => Transport::Lines(lines),
    }
}

/// Geometry between clusters of the front, if there is a tree.
fn nodes<'a>(
    scene: &'a Scene,
    front: &'a Front,
    caster: &'a Bvh,
    tree: &'a Option<Hierarchy>,
    settings: &'a MatrixSettings,
) -> Option<FrontNodes<'a>> {
    let tree = tree.as_ref()?;
    Some(FrontNodes::new(scene, front, caster, tree, settings))
}

/// Nobody watches.
fn unwatched(_: &Status) -> Control {
    Control::Go
}

/// Elements between two looks at the watch; a multiple of what is computed at once.
const RUN: usize = 1 << 14;

/// Points from which all elements together look at a light: of many elements each has fewer, 4 at
/// least and 16 at most, for neighbours even it out.
const DIRECT_POINTS: usize = 400_000;

/// Lines for the energy balance: 0.1 % for the whole scene.
const BALANCE_LINES: u64 = 1 << 20;

/// Elements at which a stored matrix is comfortable.
const MATRIX_ELEMENTS: usize = 3_000;

/// Fewest elements that memory may force on a mesh that was left to us.
const FEWEST_ELEMENTS: usize = 1_000;

/// Elements for a scene when the user does not say: enough that light on a room's walls is
/// well drawn, few enough that a solution takes seconds.
fn default_elements(scene: &Scene) -> usize {
    (20_000 + scene.triangles.len() / 4).min(400_000)
}

/// The mesh that was asked for or, if it was left to us, the finest that memory holds.
fn fitting_mesh(
    scene: &Scene,
    settings: &Settings,
    warnings: &mut Warnings,
) -> Result<MeshSettings, Error> {
    let wanted = settings.elements.unwrap_or_else(|| default_elements(scene));
    let mut mesh = MeshSettings::for_scene(scene, wanted);
    if let Some(edge) = settings.element_edge_m {
        mesh.max_area_m2 = (edge * edge) as f32;
        mesh.max_elements = usize::MAX;
        mesh.max_per_region = usize::MAX;
    }
    let estimate = memory_estimate(scene);
    let free = settings.elements.is_none() && settings.element_edge_m.is_none();
    let mut elements = wanted;
    let mut needed = estimate(&mesh);
    while free && needed > settings.memory && elements > FEWEST_ELEMENTS {
        elements = elements * 3 / 4;
        mesh = MeshSettings::for_scene(scene, elements);
        needed = estimate(&mesh);
    }
    if needed > settings.memory {
        return Err(Error::Memory {
            scene: scene.name.clone(),
            needed_mb: needed.div_ceil(1_000_000),
            bound_mb: settings.memory / 1_000_000,
        });
    }
    if elements < wanted {
        let what = format!(
            "elements are larger than usual, to keep within --memory: {elements}, not {wanted}"
        );
        warnings.add(scene.name.as_str(), what, 1);
    }
    Ok(mesh)
}

/// Peak memory, bytes, of a job with a mesh: the program with a picture, triangles with their tree,
/// elements with their columns and vertices. Measured from 60 to a million triangles.
fn memory_estimate(scene: &Scene) -> impl Fn(&MeshSettings) -> u64 {
    const PROGRAM: u64 = 110_000_000;
    const PER_TRIANGLE: u64 = 950;
    const PER_ELEMENT: u64 = 500;
    const PER_COLUMN: u64 = 90;
    let triangles = scene.triangles.len();
    let area: f64 = (0..triangles).map(|t| scene.area(t) as f64).sum();
    let texels: usize = scene.textures.iter().map(|t| t.rgba.len()).sum();
    let fixed = PROGRAM + 8 * texels as u64 + triangles as u64 * PER_TRIANGLE;
    let each = PER_ELEMENT + scene.layers().columns() as u64 * PER_COLUMN;
    move |mesh| {
        // As many as are allowed, or as the area has room for, with a few for each triangle: both
        // sides, and cells that are halved in both directions to get under the bound.
        let by_area = 4.0 * area / mesh.max_area_m2.max(f32::MIN_POSITIVE) as f64;
        let by_area = (by_area as usize).saturating_add(4 * triangles);
        fixed + (mesh.max_elements.min(by_area) as u64).min(1 << 32) * each
    }
}
