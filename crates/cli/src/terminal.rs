//! What the terminal shows: a progress bar, plain lines when it is no terminal, one error line.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use luxel::{Stage, Status};
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// Plain lines come at most this often.
const LINE_EVERY: Duration = Duration::from_secs(2);

/// Prints one line. A standard error that takes none is no reason to lose the work.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Prints an error as one line.
pub fn error(message: &str) {
    let clean = |c: char| if c.is_control() { ' ' } else { c };
    say(&format!(
        "luxel: {}",
        message.chars().map(clean).collect::<String>()
    ));
}

/// Shows how far a job is.
pub enum Progress {
    /// `--quiet`.
    Silent,
    /// A bar on a terminal.
    Bar(ProgressBar),
    /// One line now and then.
    Lines(Lines),
}

/// The last line: stage, percent, and when it was printed.
#[derive(Default)]
pub struct Lines(Option<(Stage, u64, Instant)>);

impl Lines {
    /// Whether there is something new to print: another stage, or another percent after a while.
    fn due(&mut self, status: &Status, now: Instant) -> bool {
        let percent = (100.0 * status.share).round() as u64;
        let due = self.0.is_none_or(|(stage, last, when)| {
            stage != status.stage || (percent != last && now - when > LINE_EVERY)
        });
        if due {
            self.0 = Some((status.stage, percent, now));
        }
        due
    }
}

impl Progress {
    /// Chooses by where standard error goes.
    pub fn new(quiet: bool) -> Progress {
        if quiet {
            return Progress::Silent;
        }
        if !std::io::stderr().is_terminal() {
            return Progress::Lines(Lines::default());
        }
        let bar = ProgressBar::with_draw_target(Some(1000), ProgressDrawTarget::stderr());
        let style = ProgressStyle::with_template("{prefix:>12} [{bar:32}] {msg}")
            .expect("the template is fixed")
            .progress_chars("=> ");
        bar.set_style(style);
        Progress::Bar(bar)
    }

    /// Takes in a new status.
    pub fn show(&mut self, status: &Status) {
        match self {
            Progress::Silent => {}
            Progress::Bar(bar) => {
                bar.set_prefix(status.stage.name());
                bar.set_position((status.share.clamp(0.0, 1.0) * 1000.0) as u64);
                bar.set_message(words(status));
            }
            Progress::Lines(lines) => {
                if lines.due(status, Instant::now()) {
                    say(&format!("{:>12}: {}", status.stage.name(), words(status)));
                }
            }
        }
    }

    /// Takes the bar away.
    pub fn end(self) {
        if let Progress::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

fn words(status: &Status) -> String {
    let mut words = format!("{:3.0} %", 100.0 * status.share);
    if let Some(unshot) = status.unshot {
        words += &format!(", {:.2} % unshot", 100.0 * unshot);
    }
    if let Some(error) = status.error.filter(|e| e.is_finite()) {
        words += &format!(", error {:.2} %", 100.0 * error);
    }
    if let Some(left) = status.left_s.filter(|s| s.is_finite()) {
        words += &format!(", {left:.0} s left");
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_when_the_stage_or_after_a_while_the_percent_is_another() {
        let (mut lines, start) = (Lines::default(), Instant::now());
        let mut due = |stage, share, seconds| {
            let status = Status {
                share,
                ..Status::begin(stage)
            };
            lines.due(&status, start + Duration::from_secs(seconds))
        };
        assert!(due(Stage::Read, 0.0, 0));
        assert!(due(Stage::Factors, 0.0, 0));
        assert!(!due(Stage::Factors, 0.45, 1), "too early");
        assert!(due(Stage::Factors, 0.45, 5));
        assert!(!due(Stage::Factors, 0.4549, 500), "the same percent");
        assert!(due(Stage::Factors, 0.456, 501));
    }
}
