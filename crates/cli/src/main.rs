//! The `luxel` program: arguments, terminal, exit codes. Everything else is in the library.

mod arguments;
mod commands;
mod mistakes;
mod terminal;

use clap::Parser;
use clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = match arguments::Arguments::try_parse() {
        Ok(arguments) => arguments,
        // `luxel` alone, --help and --version are no mistakes.
        Err(e) if !e.use_stderr() || e.kind() == DisplayHelpOnMissingArgumentOrSubcommand => {
            e.exit()
        }
        Err(e) => {
            terminal::error(&mistakes::line(&e));
            return ExitCode::from(2);
        }
    };
    match commands::run(arguments) {
        Ok(outcome) => outcome.exit_code(),
        Err(error) => {
            terminal::error(&error);
            ExitCode::from(2)
        }
    }
}
