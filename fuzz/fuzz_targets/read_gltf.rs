//! Any bytes as a glTF file: a scene or an error, never a panic.
//!
//! `cargo +nightly fuzz run read_gltf`; good first inputs are the files in `scenes/`.
#![no_main]

use libfuzzer_sys::fuzz_target;
use luxel_io::{Kind, ReadOptions, read_bytes};

fuzz_target!(|bytes: &[u8]| {
    let options = ReadOptions { memory_limit: 200_000_000, ..ReadOptions::default() };
    let alone = |name: &str, _: u64| Err(format!("no file {name}"));
    let _ = read_bytes(Kind::Gltf, "fuzz.glb", bytes.to_vec(), &alone, &options);
});
