//! The `luxel` program: arguments, terminal, exit codes. Everything else is in the library.

mod arguments;
mod commands;
mod terminal;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = arguments::Arguments::parse();
    match commands::run(arguments) {
        Ok(outcome) => outcome.exit_code(),
        Err(error) => {
            terminal::error(&error);
            ExitCode::from(2)
        }
    }
}
