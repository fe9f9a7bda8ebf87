//! `luxel verify`: Luxel against closed forms and published cases, in public.
//!
//! Without a folder the built-in closed forms are checked. With one, every `*.json` in it is
//! read as a set of reference cases (`format` "refcase-1"). One line a query: id, quantity,
//! expected, got, verdict. A case that Luxel cannot answer yet is skipped by name, with what is
//! missing.

mod built_in;
mod case;
mod factors;
mod rooms;
mod solvers;
mod strips;

use crate::error::Error;
use case::{Case, CaseFile, Query};
use std::path::Path;

/// An answer to one query, and by which class of method it was found.
#[derive(Clone, Debug)]
pub(crate) struct Answer {
    /// Numbers, in the order of the expected ones.
    pub values: Vec<f64>,
    /// Class of method, which chooses the tolerance: `analytic`, `montecarlo`, `tessellated` ...
    pub class: &'static str,
}

impl Answer {
    /// One number.
    pub fn one(value: f64, class: &'static str) -> Answer {
        Answer {
            values: vec![value],
            class,
        }
    }
}

/// An answer, or what is missing for one.
pub(crate) type Found = Result<Answer, String>;

/// Numbers of passed, failed and skipped checks.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    passed: usize,
    failed: usize,
    skipped: usize,
}

impl Count {
    fn add(&mut self, other: Count) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.skipped += other.skipped;
    }

    fn words(&self) -> String {
        format!(
            "{} passed, {} failed, {} skipped",
            self.passed, self.failed, self.skipped
        )
    }
}

/// Runs the checks and prints each line through `print`. `true` when nothing failed.
///
/// An error is a folder or file that cannot be read; a failed check is none.
pub fn run(cases: Option<&Path>, print: &mut dyn FnMut(&str)) -> Result<bool, Error> {
    let mut total = Count::default();
    match cases {
        None => total.add(built_in::run(print)),
        Some(folder) => {
            for file in files(folder)? {
                let set = case::read(&file)?;
                let count = run_file(&set, print);
                print(&format!("{}: {}", set.file, count.words()));
                total.add(count);
            }
        }
    }
    print(&total.words());
    Ok(total.failed == 0)
}

/// The case files of a folder, by name.
fn files(folder: &Path) -> Result<Vec<std::path::PathBuf>, Error> {
    let unreadable = |e: std::io::Error| Error::Setting(format!("{}: {e}", folder.display()));
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.extension().is_some_and(|e| e == "json") {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        let folder = folder.display();
        return Err(Error::Setting(format!(
            "{folder}: expected reference cases (*.json), found none"
        )));
    }
    Ok(files)
}

fn run_file(set: &CaseFile, print: &mut dyn FnMut(&str)) -> Count {
    let mut count = Count::default();
    if set.cases.is_empty() {
        print(&format!(
            "{}: skipped: no cases of format refcase-1",
            set.file
        ));
    }
    for case in &set.cases {
        let answers = answer(case);
        for (query, found) in case.queries.iter().zip(answers) {
            count.add(judge(case, query, found, print));
        }
    }
    count
}

/// Answers to all queries of a case, in order.
fn answer(case: &Case) -> Vec<Found> {
    match case.kind.as_str() {
        "form_factor" | "configuration_factor" => factors::answer(case),
        "solver" | "utilisation_factor" => solvers::answer(case),
        "radiosity" if case.scene.form_factors.is_some() => solvers::answer(case),
        "radiosity" if case.scene.is_plane() => strips::answer(case),
        "radiosity" | "illuminance" => rooms::answer(case),
        other => {
            let missing = format!("kind '{other}' is not computed yet");
            case.queries.iter().map(|_| Err(missing.clone())).collect()
        }
    }
}

/// Compares an answer with what is expected: |got - expected| <= rel |expected| + abs + 3 unc.
fn judge(case: &Case, query: &Query, found: Found, print: &mut dyn FnMut(&str)) -> Count {
    let name = format!("{}/{} {}", case.id, query.id, query.quantity);
    let answer = match found {
        Ok(answer) => answer,
        Err(missing) => {
            print(&format!("{name} skipped: {missing}"));
            return Count {
                skipped: 1,
                ..Count::default()
            };
        }
    };
    let expected = query.expected_numbers();
    let class = case.tolerance_class(answer.class);
    let Some((class, tolerance)) = class else {
        print(&format!(
            "{name} skipped: no tolerance for {} methods",
            answer.class
        ));
        return Count {
            skipped: 1,
            ..Count::default()
        };
    };
    let unc = query.uncertainty();
    let within = |rel: f64, abs: f64| {
        expected.len() == answer.values.len()
            && expected
                .iter()
                .zip(&answer.values)
                .all(|(e, g)| (g - e).abs() <= rel * e.abs() + abs + 3.0 * unc)
    };
    let passed = within(tolerance.rel, tolerance.abs);
    // The place where they are furthest apart stands for the whole.
    let worst = expected
        .iter()
        .zip(&answer.values)
        .max_by(|a, b| (a.0 - a.1).abs().total_cmp(&(b.0 - b.1).abs()))
        .map_or((f64::NAN, f64::NAN), |(e, g)| (*e, *g));
    let off = if worst.0 != 0.0 {
        format!("{:+.2e} relative", (worst.1 - worst.0) / worst.0.abs())
    } else {
        format!("{:+.2e}", worst.1 - worst.0)
    };
    let verdict = if passed { "pass" } else { "FAIL" };
    print(&format!(
        "{name} expected {:.9} got {:.9} ({off}, {class}) {verdict}",
        worst.0, worst.1
    ));
    Count {
        passed: passed as usize,
        failed: !passed as usize,
        skipped: 0,
    }
}
