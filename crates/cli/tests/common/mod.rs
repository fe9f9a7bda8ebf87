//! What the tests of the program share.

use std::process::{Command, Output};

/// Runs the program.
pub fn luxel(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_luxel"))
        .args(arguments)
        .output()
        .expect("luxel runs")
}

/// What it said.
pub fn words(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}
