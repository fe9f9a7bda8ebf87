//! Any bytes as a file of facets, the first byte telling the format: facets or an error, never a
//! panic.
//!
//! `cargo +nightly fuzz run read_facets`
#![no_main]

use libfuzzer_sys::fuzz_target;
use luxel_io::{FacetKind, FacetOptions, read_facets_bytes};

fuzz_target!(|bytes: &[u8]| {
    let Some((first, rest)) = bytes.split_first() else {
        return;
    };
    let kinds = [FacetKind::Stl, FacetKind::Ply, FacetKind::Obj, FacetKind::Gltf, FacetKind::Vs3];
    let kind = kinds[*first as usize % kinds.len()];
    let options = FacetOptions { memory: 200_000_000, ..FacetOptions::default() };
    let alone = |name: &str, _: u64| Err(format!("no file {name}"));
    let _ = read_facets_bytes(kind, "fuzz", rest.to_vec(), &alone, &options);
});
