//! Any bytes as an OBJ file and, from the first zero byte on, as its material library.
//!
//! `cargo +nightly fuzz run read_obj`
#![no_main]

use libfuzzer_sys::fuzz_target;
use luxel_io::{Kind, ReadOptions, read_bytes};

fuzz_target!(|bytes: &[u8]| {
    let options = ReadOptions { memory_limit: 200_000_000, ..ReadOptions::default() };
    let mut parts = bytes.splitn(2, |b| *b == 0);
    let scene = parts.next().unwrap_or_default().to_vec();
    let library = parts.next().unwrap_or_default();
    // Every name is the library: texture statements then read it as a picture.
    let beside = |_: &str, _: u64| Ok(library.to_vec());
    let _ = read_bytes(Kind::Obj, "fuzz.obj", scene, &beside, &options);
});
