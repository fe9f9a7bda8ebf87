//! Writes Luxel's own scenes into a folder.
//!
//! `make-scenes DIR` writes the committed four; `make-scenes DIR corridor N` a corridor of about
//! N triangles.

use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let files = match words[..] {
        [_] => luxel_scenes::committed()
            .into_iter()
            .map(|(name, bytes)| (name.to_string(), bytes))
            .collect(),
        [_, "corridor", n] => match n.parse::<usize>() {
            Ok(n) => {
                let bytes = luxel_scenes::to_glb(&luxel_scenes::corridor(n));
                vec![(format!("corridor-{n}"), bytes)]
            }
            Err(_) => return usage(),
        },
        _ => return usage(),
    };
    for (name, bytes) in files {
        let path = Path::new(words[0]).join(name + ".glb");
        if let Err(error) = std::fs::write(&path, &bytes) {
            eprintln!("{}: {error}", path.display());
            return ExitCode::from(2);
        }
        println!("{}: {} bytes", path.display(), bytes.len());
    }
    ExitCode::SUCCESS
}

fn usage() -> ExitCode {
    eprintln!("usage: make-scenes DIR [corridor TRIANGLES]");
    ExitCode::from(2)
}
