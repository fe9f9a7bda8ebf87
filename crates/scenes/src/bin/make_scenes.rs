//! Writes Luxel's own scenes into a folder.
//!
//! `make-scenes DIR` writes the committed four; `make-scenes DIR corridor N` a corridor of about
//! N triangles; `make-scenes DIR boxes N` and `make-scenes DIR city N` a room with four boxes and
//! a block of a town of about N facets, as OBJ and as input of View3D.

use luxel_scenes::facets::{to_obj, to_vs3};
use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let files = match words[..] {
        [_] => luxel_scenes::committed()
            .into_iter()
            .map(|(name, bytes)| (format!("{name}.glb"), bytes))
            .collect(),
        [_, "corridor", n] => match n.parse::<usize>() {
            Ok(n) => {
                let bytes = luxel_scenes::to_glb(&luxel_scenes::corridor(n));
                vec![(format!("corridor-{n}.glb"), bytes)]
            }
            Err(_) => return usage(),
        },
        [_, kind @ ("boxes" | "city"), n] => match n.parse::<usize>() {
            Ok(n) => {
                let facets = match kind {
                    "boxes" => luxel_scenes::floating_boxes(n),
                    _ => luxel_scenes::city_block(n),
                };
                vec![
                    (format!("{kind}-{n}.obj"), to_obj(&facets).into_bytes()),
                    (
                        format!("{kind}-{n}.vs3"),
                        to_vs3(&facets, 1e-4).into_bytes(),
                    ),
                ]
            }
            Err(_) => return usage(),
        },
        _ => return usage(),
    };
    for (name, bytes) in files {
        let path = Path::new(words[0]).join(name);
        if let Err(error) = std::fs::write(&path, &bytes) {
            eprintln!("{}: {error}", path.display());
            return ExitCode::from(2);
        }
        println!("{}: {} bytes", path.display(), bytes.len());
    }
    ExitCode::SUCCESS
}

fn usage() -> ExitCode {
    eprintln!("usage: make-scenes DIR [corridor TRIANGLES | boxes FACETS | city FACETS]");
    ExitCode::from(2)
}
