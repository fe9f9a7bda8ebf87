//! The commands: from arguments to the library and back to the terminal.

use crate::arguments::{
    Arguments, Command, Compare, Factors, Inspect, Light, Probe, Verify, settings,
};
use crate::terminal;
use luxel::factors::FactorPoint;
use luxel::{Control, DVec3, LightJob, Session, Status, points};
use std::io::{Read, Write};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// How a command ended when nothing failed.
pub enum Outcome {
    /// What was asked for was reached.
    Done,
    /// Files are written, but the asked accuracy was not met, or a case failed.
    Short,
}

impl Outcome {
    /// 0 or 1, as `--help` says.
    pub fn exit_code(&self) -> ExitCode {
        match self {
            Outcome::Done => ExitCode::SUCCESS,
            Outcome::Short => ExitCode::from(1),
        }
    }

    fn of(reached: bool) -> Outcome {
        if reached {
            Outcome::Done
        } else {
            Outcome::Short
        }
    }
}

/// Runs a command.
pub fn run(arguments: Arguments) -> Result<Outcome, String> {
    match arguments.command {
        Command::Light(light) => self::light(&light),
        Command::Probe(probe) => self::probe(&probe),
        Command::Inspect(inspect) => self::inspect(&inspect),
        Command::Factors(factors) => self::factors(&factors),
        Command::Compare(compare) => self::compare(&compare),
        Command::Verify(verify) => self::verify(&verify),
    }
}

fn threads(threads: usize) -> Result<(), String> {
    luxel::use_threads(threads).map_err(|e| format!("--threads {threads}: {e}"))
}

/// Set by Ctrl-C. A second Ctrl-C ends the program at once.
fn stop_on_interrupt() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let seen = stop.clone();
    // Ctrl-C, SIGTERM and SIGHUP. Without a handler they end the program as usual: nothing is lost
    // but the last stretch.
    let _ = ctrlc::set_handler(move || {
        if seen.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
    });
    stop
}

/// Shows progress; answers with what Ctrl-C wants.
fn watch(progress: &mut terminal::Progress, stop: &AtomicBool, status: &Status) -> Control {
    progress.show(status);
    if stop.load(Ordering::SeqCst) {
        Control::Stop
    } else {
        Control::Go
    }
}

/// How a job ends that has nothing to show: stopped by the user, or failed.
fn ended(error: luxel::Error) -> Result<Outcome, String> {
    match error {
        luxel::Error::Stopped | luxel::Error::StoppedKept { .. } => {
            terminal::error(&error.to_string());
            Ok(Outcome::Short)
        }
        other => Err(other.to_string()),
    }
}

fn print(text: &str) -> Result<(), String> {
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        // The reader of a pipe has what it wanted.
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other.map_err(|e| format!("standard output: {e}")),
    }
}

fn light(arguments: &Light) -> Result<Outcome, String> {
    threads(arguments.common.run.threads)?;
    let stop = stop_on_interrupt();
    let mut progress = terminal::Progress::new(arguments.common.run.quiet);
    let job = LightJob {
        scene: arguments.scene.scene.clone(),
        output: arguments.output.clone(),
        resume: arguments.resume,
        view: arguments.view.clone(),
        settings: luxel::Settings {
            lightmap: !arguments.no_lightmap,
            texel_m: arguments.texel,
            ..settings(&arguments.scene, Some(&arguments.solve), &arguments.common)
        },
    };
    let outcome = luxel::light(&job, &mut |status| watch(&mut progress, &stop, status));
    progress.end();
    let outcome = match outcome {
        Ok(outcome) => outcome,
        Err(error) => return ended(error),
    };
    if arguments.common.run.json {
        print(&(outcome.report_json + "\n"))?;
    } else if !arguments.common.run.quiet {
        print(&outcome.table)?;
    }
    Ok(Outcome::of(outcome.reached))
}

fn compare(arguments: &Compare) -> Result<Outcome, String> {
    threads(arguments.common.run.threads)?;
    let stop = stop_on_interrupt();
    let mut progress = terminal::Progress::new(arguments.common.run.quiet);
    let compared = luxel::compare(&arguments.job(), &mut |status| {
        watch(&mut progress, &stop, status)
    });
    progress.end();
    let comparison = match compared {
        Ok(comparison) => comparison,
        Err(error) => return ended(error),
    };
    if !arguments.common.run.quiet {
        for warning in comparison.warnings.iter() {
            terminal::say(&format!("warning: {warning}"));
        }
    }
    if arguments.common.run.json {
        print(&format!("{:#}\n", comparison.to_json()))?;
    } else if !arguments.common.run.quiet {
        let files = comparison.files.iter().map(|f| f.display().to_string());
        let written = files.collect::<Vec<_>>().join(", ");
        print(&format!("{}\nwritten: {written}\n", comparison.table()))?;
    }
    Ok(Outcome::Done)
}

fn probe(arguments: &Probe) -> Result<Outcome, String> {
    threads(arguments.common.run.threads)?;
    let (place, text) = text_of(&arguments.points, arguments.common.run.memory)?;
    let receivers = points::parse(place, &text)?;
    let stop = stop_on_interrupt();
    let settings = settings(&arguments.scene, Some(&arguments.solve), &arguments.common);
    let mut progress = terminal::Progress::new(arguments.common.run.quiet);
    let mut watch = |status: &Status| watch(&mut progress, &stop, status);
    let mut session = match Session::open_watched(&arguments.scene.scene, &settings, &mut watch) {
        Ok(session) => session,
        Err(error) => {
            progress.end();
            return ended(error);
        }
    };
    let answer = luxel::probe(&mut session, &receivers, &mut watch);
    progress.end();
    if !arguments.common.run.quiet {
        for warning in session.warnings().iter() {
            terminal::say(&format!("warning: {warning}"));
        }
        let dark = answer.irradiance.dark();
        if dark > 0 {
            terminal::say(&format!(
                "warning: no light at {dark} of {} points: inside a solid, behind a face or outside?",
                receivers.len()
            ));
        }
    }
    if arguments.common.run.json {
        print(
            &(points::json(&receivers, &answer.irradiance, session.layers()).to_string() + "\n"),
        )?;
    } else {
        print(&points::table(&receivers, &answer.irradiance))?;
    }
    Ok(Outcome::of(answer.reached))
}

/// The text of a file, or of standard input for `-`, and what to call it.
fn text_of(from: &str, memory: u64) -> Result<(&str, String), String> {
    let (place, text) = if from == "-" {
        (
            "standard input",
            read_bounded(std::io::stdin().lock(), memory),
        )
    } else {
        let file = std::fs::File::open(from).map_err(unreadable);
        (from, file.and_then(|file| read_bounded(file, memory)))
    };
    let text = text.map_err(|e| format!("{place}: {e}"))?;
    Ok((place, text))
}

/// Why points cannot be read.
fn unreadable(e: std::io::Error) -> String {
    use std::io::ErrorKind::{InvalidData, IsADirectory, NotFound, PermissionDenied};
    match e.kind() {
        NotFound => "expected a file of points, found no such file".into(),
        IsADirectory => "expected a file of points, found a folder".into(),
        PermissionDenied => {
            "expected a readable file of points, found one that may not be read".into()
        }
        InvalidData => "expected points as text, found something that is no UTF-8".into(),
        _ => format!("expected a readable file of points, found: {e}"),
    }
}

/// Points with normals in full precision.
fn factor_points(from: &str, memory: u64) -> Result<Vec<FactorPoint>, String> {
    let (place, text) = text_of(from, memory)?;
    let point = |[x, y, z, nx, ny, nz]: [f64; 6]| FactorPoint {
        position: DVec3::new(x, y, z),
        normal: DVec3::new(nx, ny, nz),
    };
    Ok(points::lines(place, &text)?
        .into_iter()
        .map(point)
        .collect())
}

fn factors(arguments: &Factors) -> Result<Outcome, String> {
    let run = &arguments.run;
    threads(run.threads)?;
    let points = match &arguments.points {
        Some(from) => Some(factor_points(from, run.memory)?),
        None => None,
    };
    let stop = stop_on_interrupt();
    let mut progress = terminal::Progress::new(run.quiet);
    let job = arguments.job(points);
    let outcome = luxel::factors(&job, &mut |status| watch(&mut progress, &stop, status));
    progress.end();
    let outcome = match outcome {
        Ok(outcome) => outcome,
        Err(error) => return ended(error),
    };
    if !run.quiet {
        for warning in outcome.warnings.iter() {
            terminal::say(&format!("warning: {warning}"));
        }
    }
    if run.json {
        let json = serde_json::to_string_pretty(&outcome.report).map_err(|e| e.to_string())?;
        print(&(json + "\n"))?;
    } else if !run.quiet {
        let files = format!(
            "{:>22}  {}, {}\n",
            "written",
            outcome.output.display(),
            outcome.report_path.display()
        );
        print(&(outcome.report.table() + &files))?;
    }
    if !outcome.complete {
        let further = match outcome.kept_in {
            Some(_) => "; --resume goes on from there",
            None => "",
        };
        terminal::say(&format!(
            "stopped: {} rows are finished{further}",
            outcome.report.finished_rows
        ));
    }
    Ok(Outcome::of(outcome.complete && outcome.report.accuracy_met))
}

/// All of `source`, which may be as long as an eighth of the memory bound.
fn read_bounded(source: impl Read, memory: u64) -> Result<String, String> {
    let most = memory / 8;
    let mut text = String::new();
    source
        .take(most + 1)
        .read_to_string(&mut text)
        .map_err(unreadable)?;
    if text.len() as u64 > most {
        return Err(format!(
            "expected at most {} MB of points (an eighth of --memory), found more; give them in parts",
            most / 1_000_000
        ));
    }
    Ok(text)
}

fn inspect(arguments: &Inspect) -> Result<Outcome, String> {
    threads(arguments.common.run.threads)?;
    let settings = settings(&arguments.scene, None, &arguments.common);
    let found = luxel::inspect(&arguments.scene.scene, &settings).map_err(|e| e.to_string())?;
    if arguments.common.run.json {
        let json = serde_json::to_string_pretty(&found).map_err(|e| e.to_string())?;
        print(&(json + "\n"))?;
    } else {
        print(&found.to_string())?;
    }
    Ok(Outcome::Done)
}

fn verify(arguments: &Verify) -> Result<Outcome, String> {
    threads(arguments.common.run.threads)?;
    let mut failed = None;
    let passed = luxel::verify::run(arguments.cases.as_deref(), &mut |line| {
        if let Err(e) = print(&format!("{line}\n")) {
            failed.get_or_insert(e);
        }
    })
    .map_err(|e| e.to_string())?;
    match failed {
        Some(e) => Err(e),
        None => Ok(Outcome::of(passed)),
    }
}
