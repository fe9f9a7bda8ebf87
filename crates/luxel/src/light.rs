//! The main job: light a scene file and write everything that comes of it.
//!
//! `SCENE.lit/` holds `scene.glb`, `lightmap-0.exr`, `preview.png`, `report.json` and `solution.luxel`. Each file
//! is written beside its place and moved there, so at any moment what is there is whole.

use crate::energy::energy;
use crate::error::Error;
use crate::lightmap;
use crate::session::Session;
use crate::settings::Settings;
use crate::sites::Sites;
use crate::spare::replaced;
use crate::stage::{Stage, peak_memory_bytes};
use crate::watch::{Status, Watch, enter};
use crate::work::{self, End, Gathering, Rest};
use luxel_core::{Rgb, Solution, Vec2, Vec3, View};
use luxel_io::{LitPrimitive, LitScale, StoredSolution};
use luxel_visualise::preview::render;
use luxel_visualise::report::{self, Report, State};
use luxel_visualise::tone::linear_scale;
use luxel_visualise::{Exposure, LitMesh, LitPart, PreviewSettings, Texels};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Names of the files in the output folder.
const SOLUTION: &str = "solution.luxel";
const LIT_SCENE: &str = "scene.glb";
const PREVIEW: &str = "preview.png";
const REPORT: &str = "report.json";

/// Pixels of the first picture, which has to be there within a second.
const FIRST_SIZE: [usize; 2] = [960, 540];

/// A scene with more vertices than this shows its first picture only when it is finished.
const FIRST_VERTICES: usize = 1_000_000;

/// The solution is stored at most this often while it is being solved.
const STORE_EVERY: Duration = Duration::from_secs(20);

/// What to light and where to put it.
#[derive(Clone, Debug)]
pub struct LightJob {
    /// Scene file.
    pub scene: PathBuf,
    /// Folder to write; `None` is `SCENE.lit` beside the scene.
    pub output: Option<PathBuf>,
    /// Whether to go on from the solution that is there.
    pub resume: bool,
    /// View of the preview, by name.
    pub view: Option<String>,
    /// Everything else.
    pub settings: Settings,
}

/// What came of it.
pub struct Outcome {
    /// Folder with the files.
    pub folder: PathBuf,
    /// Whether the asked accuracy was reached.
    pub reached: bool,
    /// The report.
    pub report: Report,
    /// The report as JSON, as written.
    pub report_json: String,
    /// A short table for people.
    pub table: String,
}

/// Most gather rays for all vertices together at an accuracy of 5 %; they grow as the inverse.
/// With millions of vertices the eye averages over many, and a pixel shows more than one.
const MOST_RAYS: f64 = 2.1e8;

/// Most gather rays for all that is shown.
pub(crate) fn most_rays(settings: &Settings) -> f64 {
    MOST_RAYS * 0.05 / settings.error
}

/// When not even so many rays are left for a vertex, vertices share them.
const FEW_RAYS: f64 = 256.0;

/// Vertices share within this share of the edge of a mean element.
const SITE: f32 = 0.4;

/// Lights a scene file. `watch` is told of every step and may stop the job, which then ends with
/// valid files and a solution that can be resumed.
pub fn light(job: &LightJob, watch: &mut Watch<'_>) -> Result<Outcome, Error> {
    let folder = job
        .output
        .clone()
        .unwrap_or_else(|| job.scene.with_extension("lit"));
    let mut session = Session::open_watched(&job.scene, &job.settings, watch)?;
    spare_the_scene(session.files(), &folder)?;
    let view = choose_view(&session, job.view.as_deref())?;
    make_folder(&folder)?;
    let stored_at = folder.join(SOLUTION);
    let fingerprint = fingerprint(&session, &job.settings);
    if job.resume {
        let stored = luxel_io::read_solution(&stored_at, fingerprint, session.front().len())?;
        session.resume(&stored.solution);
    }

    let elements = session.front().len();
    enter(watch, &Status::begin(Stage::Mesh))?;
    let mut mesh = LitMesh::build(session.scene(), session.front(), Some(session.caster()));
    session.clock_mut().end(Stage::Mesh);
    let mut shown = false;
    let mut stored = Instant::now();
    let mut failure = None;
    let solved = work::solve(&mut session, watch, |session| {
        if !shown && mesh.positions.len() <= FIRST_VERTICES {
            shown = true;
            let written = first_picture(session, &mut mesh, &view, &folder);
            failure = failure.take().or(written.err());
        }
        if stored.elapsed() > STORE_EVERY {
            stored = Instant::now();
            let written = store(session, &session.solution(), &stored_at, fingerprint);
            failure = failure.take().or(written.err());
        }
    });
    if let Some(error) = failure {
        return Err(error);
    }
    let solution = session.solution();
    store(&session, &solution, &stored_at, fingerprint)?;
    session.clock_mut().end(Stage::Write);

    if elements != session.front().len() {
        // The mesh was refined on the way.
        mesh = LitMesh::build(session.scene(), session.front(), Some(session.caster()));
        session.clock_mut().end(Stage::Mesh);
    }
    let mut texels = None;
    let (rays, gathered) = match solved {
        // Stopped by the user, not by the clock.
        End::Stopped if job.settings.time.is_none() => {
            let (values, errors) = of_elements(&session, &solution, &mesh);
            mesh.set_light(values, errors);
            (0, End::Stopped)
        }
        _ if job.settings.lightmap => {
            let charts = lightmap::charts(&session);
            session.clock_mut().end(Stage::Mesh);
            match charts {
                Some(charts) => {
                    let of_vertex = charts.lay_over(session.front(), &mut mesh);
                    let made = lightmap::light(&session, &solution, &charts, watch);
                    made.lightmap.light(&charts, &of_vertex, &mut mesh);
                    let answer = (made.rays, made.end);
                    texels = Some(Texels {
                        charts,
                        of_vertex,
                        lightmap: made.lightmap,
                    });
                    answer
                }
                None => gather(&session, &solution, &mut mesh, watch),
            }
        }
        _ => gather(&session, &solution, &mut mesh, watch),
    };
    session.clock_mut().end(Stage::Gather);

    watch(&Status::begin(Stage::Write));
    let stopped = solved == End::Stopped || gathered == End::Stopped;
    let settings = PreviewSettings::default();
    let exposure = write_picture(&session, &mesh, texels.as_ref(), &view, &settings, &folder)?;
    let pages = write_pages(texels.as_ref(), &folder)?;
    write_lit_scene(
        &session,
        &mesh,
        texels.as_ref(),
        pages,
        &folder.join(LIT_SCENE),
    )?;
    let report = make_report(
        job,
        &mut session,
        &solution,
        &mesh,
        texels.as_ref(),
        rays,
        &exposure,
        stopped,
    );
    let report_json = report.to_json();
    write(&folder.join(REPORT), report_json.as_bytes())?;
    let table = format!(
        "{}\nwritten to {}\n",
        report::table(&report).trim_end(),
        folder.display()
    );
    let reached = report.state == State::Finished;
    Ok(Outcome {
        folder,
        reached,
        report,
        report_json,
        table,
    })
}

/// Illuminance of the vertices and its error, from the elements alone.
fn of_elements(session: &Session, solution: &Solution, mesh: &LitMesh) -> (Vec<Rgb>, Vec<f32>) {
    let received = session.received(solution);
    let values = mesh.of_elements(&received);
    let error = |value: &Rgb| solution.relative_error * value.luminance();
    let errors = values.iter().map(error).collect();
    (values, errors)
}

/// Asks the light of the vertices, as far as there is time; the rest has that of its elements.
/// Answers with the rays that it took.
fn gather(
    session: &Session,
    solution: &Solution,
    mesh: &mut LitMesh,
    watch: &mut Watch<'_>,
) -> (u64, End) {
    // The picture needs the sum of the groups alone.
    let (merged, lights) = (solution.merged(), session.lights().merged());
    let most_rays = most_rays(session.settings());
    let sites = sites(mesh, most_rays);
    let (asked, end) = work::gather(
        &session.gatherer(&merged, &lights),
        &Gathering {
            receivers: &sites.receivers,
            weights: &sites.weights,
            time: session.time_left(),
            most_rays,
            rest: Rest::LeftOut,
        },
        &session.accuracy(solution),
        watch,
    );
    let left_out = asked.errors.len() < sites.receivers.len();
    let rest = left_out.then(|| of_elements(session, solution, mesh));
    let at = |v: usize| match (sites.of(v), &rest) {
        (site, Some((values, errors))) if site >= asked.errors.len() => (values[v], errors[v]),
        (site, _) => (asked.total(site), asked.errors[site]),
    };
    let (values, errors) = (0..mesh.receivers.len()).map(at).unzip();
    mesh.set_light(values, errors);
    (asked.rays, end)
}

/// Where the light of the vertices is asked: at each, or, when there are too many for the rays,
/// at one of those that are close together.
fn sites(mesh: &LitMesh, most_rays: f64) -> Sites {
    let share = mesh.receivers.len() as f64 * FEW_RAYS > most_rays;
    let edge_m = if share { SITE * mesh.mean_edge_m } else { 0.0 };
    let runs = mesh
        .parts
        .iter()
        .map(|p| p.vertices.start as usize..p.vertices.end as usize);
    Sites::new(&mesh.receivers, &mesh.vertex_areas(), runs, edge_m)
}

/// No file that is written may be one that was read: the scene, its buffers and pictures.
fn spare_the_scene(read: &[PathBuf], folder: &Path) -> Result<(), Error> {
    let mut written = [LIT_SCENE, PREVIEW, REPORT, SOLUTION]
        .map(|name| folder.join(name))
        .to_vec();
    written.extend((0..lightmap::MOST_PAGES).map(|k| folder.join(page_name(k))));
    match replaced(read, &written) {
        None => Ok(()),
        Some(path) => Err(Error::Setting(format!(
            "{}: expected an output folder that does not hold the scene, found that {} would \
             replace it",
            folder.display(),
            path.file_name().unwrap_or_default().display()
        ))),
    }
}

fn make_folder(folder: &Path) -> Result<(), Error> {
    if folder.exists() && !folder.is_dir() {
        return Err(Error::Setting(format!(
            "{}: expected a folder to write to, found a file",
            folder.display()
        )));
    }
    std::fs::create_dir_all(folder).map_err(|source| Error::Write {
        path: folder.to_owned(),
        source,
    })
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    luxel_io::write_atomic(path, bytes).map_err(|source| Error::Write {
        path: path.to_owned(),
        source,
    })
}

fn choose_view(session: &Session, name: Option<&str>) -> Result<View, Error> {
    let scene = session.scene();
    match name {
        None => Ok(luxel_visualise::first_view(scene, session.caster())),
        Some(name) => scene.views.iter().find(|v| v.name == name).cloned().ok_or_else(|| {
            let known: Vec<&str> = scene.views.iter().map(|v| v.name.as_str()).collect();
            Error::Setting(format!(
                "--view {name}: expected one of the scene's views ({}), found none of that name",
                if known.is_empty() { "it has none".into() } else { known.join(", ") }
            ))
        }),
    }
}

/// A picture within the first second: what the first steps found, with the ambient term.
fn first_picture(
    session: &mut Session,
    mesh: &mut LitMesh,
    view: &View,
    folder: &Path,
) -> Result<(), Error> {
    let displayed = session.displayed();
    let (values, errors) = of_elements(session, &displayed, mesh);
    mesh.set_light(values, errors);
    let [width, height] = FIRST_SIZE;
    let first = PreviewSettings {
        width,
        height,
        ..PreviewSettings::default()
    };
    let written = write_picture(session, mesh, None, view, &first, folder);
    session.clock_mut().end(Stage::Write);
    written.map(|_| ())
}

/// Writes the picture and answers how it was exposed.
fn write_picture(
    session: &Session,
    mesh: &LitMesh,
    texels: Option<&Texels>,
    view: &View,
    settings: &PreviewSettings,
    folder: &Path,
) -> Result<Exposure, Error> {
    let (picture, exposure) = render(session.scene(), mesh, texels, view, settings);
    let path = folder.join(PREVIEW);
    let png = picture.png().map_err(|e| Error::Write {
        path: path.clone(),
        source: std::io::Error::other(e),
    })?;
    write(&path, &png)?;
    Ok(exposure)
}

fn store(
    session: &Session,
    solution: &Solution,
    path: &Path,
    fingerprint: u64,
) -> Result<(), Error> {
    let stored = StoredSolution {
        fingerprint,
        step: session.progress().step,
        solution: solution.clone(),
    };
    luxel_io::write_solution(path, &stored).map_err(|source| Error::Write {
        path: path.to_owned(),
        source,
    })
}

/// Tells one scene with one set of settings from another, so that a solution is never resumed
/// on elements that it does not belong to.
fn fingerprint(session: &Session, settings: &Settings) -> u64 {
    luxel_io::fingerprint(
        session.scene(),
        session.front(),
        &[settings.mesh.name(), settings.solver.name()],
        settings.seed,
    )
}

/// Writes the pages of the lightmap; those of an earlier run that are not written anew are removed,
/// as they do not belong to the scene. Answers with their names and sizes.
fn write_pages(texels: Option<&Texels>, folder: &Path) -> Result<Vec<(String, [u32; 2])>, Error> {
    let mut written = Vec::new();
    if let Some(Texels {
        charts, lightmap, ..
    }) = texels
    {
        for (k, &size) in charts.pages().iter().enumerate() {
            let name = page_name(k);
            let path = folder.join(&name);
            luxel_io::write_exr(&path, size, &lightmap.page(charts, k as u32))
                .map_err(|source| Error::Write { path, source })?;
            written.push((name, size));
        }
    }
    for k in written.len()..lightmap::MOST_PAGES {
        // None to remove is the usual case.
        let _ = std::fs::remove_file(folder.join(page_name(k)));
    }
    Ok(written)
}

fn page_name(page: usize) -> String {
    format!("lightmap-{page}.exr")
}

fn write_lit_scene(
    session: &Session,
    mesh: &LitMesh,
    texels: Option<&Texels>,
    pages: Vec<(String, [u32; 2])>,
    path: &Path,
) -> Result<(), Error> {
    let uvs: Vec<Vec2> = texels.map_or(Vec::new(), |t| {
        let uv = |(&p, &chart): (&Vec3, &u32)| t.charts.uv_of(chart, p);
        mesh.positions.iter().zip(&t.of_vertex).map(uv).collect()
    });
    let page_of = |c: &[u32; 3]| texels.map_or(0, |t| t.charts.page_of(t.of_vertex[c[0] as usize]));
    let primitives: Vec<LitPrimitive<'_>> = mesh
        .parts
        .iter()
        .flat_map(|part| {
            let run = part.triangles.start as usize..part.triangles.end as usize;
            let by_page = mesh.triangles[run].chunk_by(|a, b| page_of(a) == page_of(b));
            by_page.map(move |triangles| (part, triangles))
        })
        .map(|(part, triangles)| lit_primitive(mesh, part, triangles, &uvs, page_of(&triangles[0])))
        .collect();
    let scale = LitScale {
        colour_per_lux: linear_scale(mesh),
        pages,
    };
    luxel_io::write_lit_glb(session.scene(), session.source(), &primitives, &scale, path).map_err(
        |source| Error::Write {
            path: path.to_owned(),
            source,
        },
    )
}

fn lit_primitive<'a>(
    mesh: &'a LitMesh,
    part: &LitPart,
    triangles: &'a [[u32; 3]],
    texels: &'a [Vec2],
    page: u32,
) -> LitPrimitive<'a> {
    let vertices = part.vertices.start as usize..part.vertices.end as usize;
    LitPrimitive {
        surface: part.surface,
        side: part.side,
        positions: &mesh.positions[vertices.clone()],
        normals: &mesh.normals[vertices.clone()],
        uvs: mesh.uvs.get(vertices.clone()).unwrap_or(&[]),
        texels: texels.get(vertices.clone()).unwrap_or(&[]),
        page,
        irradiance: &mesh.irradiance[vertices],
        triangles,
        first_vertex: part.vertices.start,
    }
}

fn make_report(
    job: &LightJob,
    session: &mut Session,
    solution: &Solution,
    mesh: &LitMesh,
    texels: Option<&Texels>,
    gather_rays: u64,
    exposure: &Exposure,
    stopped: bool,
) -> Report {
    let asked = job.settings.error;
    let elements = solution.relative_error as f64;
    let vertices = report::relative_error(mesh);
    let reached = vertices.unwrap_or(0.0).max(elements);
    let within = report::Within::new(mesh, asked).share(mesh);
    let progress = session.progress();
    let energy = energy(session, solution);
    session.clock_mut().end(Stage::Write);
    let clock = session.clock_mut().clone();
    let stages = Stage::ALL
        .into_iter()
        .filter(|&s| clock.of(s).wall > 0.0)
        .map(|stage| {
            let seconds = clock.of(stage);
            report::Stage {
                name: stage.name().into(),
                wall_s: seconds.wall,
                cpu_s: (seconds.cpu > 0.0).then_some(seconds.cpu),
            }
        });
    let state = match (stopped, reached <= asked) {
        (true, _) => State::Stopped,
        (false, true) => State::Finished,
        (false, false) => State::NotMet,
    };
    Report {
        format: report::FORMAT,
        generator: concat!("luxel ", env!("CARGO_PKG_VERSION")).into(),
        scene: job.scene.display().to_string(),
        state,
        accuracy: report::Accuracy {
            asked,
            reached: Some(reached),
            elements: Some(elements),
            vertices,
            within,
            unshot_share: Some(solution.unshot_share as f64),
        },
        energy,
        counts: report::Counts {
            triangles: session.scene().triangles.len() as u64,
            surfaces: session.scene().surfaces.len() as u64,
            elements: session.front().len() as u64,
            vertices: mesh.positions.len() as u64,
            texels: texels.map_or(0, |t| t.charts.used() as u64),
            texels_asked: texels.map_or(0, |t| t.lightmap.asked() as u64),
            solver_work: solution.work,
            gather_rays,
            steps: progress.step as u64,
            groups: session.layers().groups.len() as u64,
            threads: rayon::current_num_threads() as u64,
        },
        stages: stages.collect(),
        memory_peak_bytes: Some(peak_memory_bytes()).filter(|&b| b > 0),
        exposure: Some(report::Exposure {
            ev100: exposure.ev100() as f64,
            scale_per_cd_m2: exposure.scale as f64,
        }),
        surfaces: report::surface_statistics(session.scene(), mesh, asked),
        warnings: report::oddities(session.warnings()),
        settings: job.settings.to_json(),
        seed: job.settings.seed,
    }
}
