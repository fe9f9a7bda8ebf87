//! Files that other loaders choked on, and our own files cut and with flipped bits: each ends in
//! a scene or in one line that says why not, within bounds of time and memory.

use crate::common::{self, SMALL_OBJ, alone, shared, small_glb, with_mtl};
use luxel_io::{Document, Error, Kind, ReadOptions, Resolver, read, read_bytes};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Most that one file may hold at once, bytes.
const MOST_BYTES: i64 = 500_000_000;

/// Counts what the current thread holds, and the most that it held.
struct Counting;

thread_local! {
    static HELD: Cell<i64> = const { Cell::new(0) };
    static MOST: Cell<i64> = const { Cell::new(0) };
}

fn note(change: i64) {
    let _ = HELD.try_with(|held| {
        held.set(held.get() + change);
        let _ = MOST.try_with(|most| most.set(most.get().max(held.get())));
    });
}

unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note(layout.size() as i64);
        // SAFETY: passed on as it came.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        note(-(layout.size() as i64));
        // SAFETY: passed on as it came.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs a reader of scenes and checks what holds for any bytes.
fn tried(what: &str, run: impl FnOnce() -> Result<Document, Error>) -> Result<Document, String> {
    let document = bounded_run(what, run)?;
    check(what, &document);
    Ok(document)
}

/// Runs a reader within bounds of time and memory; an error is one line.
pub fn bounded_run<T>(what: &str, run: impl FnOnce() -> Result<T, Error>) -> Result<T, String> {
    let before = HELD.get();
    MOST.set(before);
    let start = Instant::now();
    let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(run));
    let took = start.elapsed();
    let most = MOST.get() - before;
    let result = caught.unwrap_or_else(|_| panic!("{what}: panicked"));
    assert!(took < Duration::from_secs(20), "{what}: took {took:?}");
    assert!(most < MOST_BYTES, "{what}: held {most} bytes");
    match result {
        Ok(good) => Ok(good),
        Err(e) => {
            let line = e.to_string();
            assert!(
                !line.contains(['\n', '\r']) && line.contains("expected"),
                "{what}: {line:?}"
            );
            assert!(
                line.contains("found") && line.len() < 1500,
                "{what}: {line:?}"
            );
            Err(line)
        }
    }
}

/// What `Scene` promises: indices in range, finite numbers, no degenerate triangle.
fn check(what: &str, document: &Document) {
    let s = &document.scene;
    let n = s.triangles.len();
    assert!(
        n > 0 && s.surface_of.len() == n && s.source_triangle.len() == n,
        "{what}"
    );
    assert!(s.uvs.is_empty() || s.uvs.len() == n, "{what}");
    assert!(s.positions.iter().all(|p| p.is_finite()), "{what}");
    assert!(s.uvs.iter().flatten().all(|uv| uv.is_finite()), "{what}");
    assert!(
        s.triangles
            .iter()
            .flatten()
            .all(|&i| (i as usize) < s.positions.len()),
        "{what}"
    );
    assert!((0..n).all(|t| s.area(t).is_normal()), "{what}");
    assert!(!s.groups.is_empty(), "{what}");
    let mut at = 0;
    for (k, surface) in s.surfaces.iter().enumerate() {
        assert_eq!(surface.triangles.start, at, "{what}");
        assert!(
            surface.triangles.end > at && surface.finish.index() < s.finishes.len(),
            "{what}"
        );
        let run = surface.triangles.start as usize..surface.triangles.end as usize;
        assert!(s.surface_of[run].iter().all(|id| id.index() == k), "{what}");
        at = surface.triangles.end;
    }
    assert_eq!(at as usize, n, "{what}");
    for finish in &s.finishes {
        assert!(
            finish.reflectance.is_finite() && finish.reflectance.max_band() <= 1.0,
            "{what}"
        );
        let emitted = finish.emission.as_ref();
        assert!(
            emitted.is_none_or(|e| e.luminance.is_finite() && e.group.index() < s.groups.len())
        );
        for id in finish
            .texture
            .iter()
            .chain(emitted.and_then(|e| e.texture.as_ref()))
        {
            let t = &s.textures[id.index()];
            assert_eq!(t.rgba.len(), t.width as usize * t.height as usize, "{what}");
        }
    }
    for l in &s.luminaires {
        assert!(l.position.is_finite() && l.direction.is_finite(), "{what}");
        assert!(l.group.index() < s.groups.len(), "{what}");
    }
}

pub fn files_under(folder: &Path) -> Vec<PathBuf> {
    let mut out = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder)
            .expect("a folder that was just found")
            .flatten()
        {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path)
            } else {
                out.push(path)
            }
        }
    }
    out.sort();
    out
}

fn bounded() -> ReadOptions {
    ReadOptions {
        memory_limit: 300_000_000,
        ..ReadOptions::default()
    }
}

#[test]
fn every_hostile_file_ends_in_a_scene_or_in_one_line() {
    let Some(folder) = shared("data/hostile") else {
        return;
    };
    let mut counts: BTreeMap<(&str, bool), usize> = BTreeMap::new();
    for path in files_under(&folder) {
        let what = path.display().to_string();
        let kind = Kind::of(&path);
        let result = tried(&what, || read(&path, &bounded()));
        let name = match kind {
            Some(Kind::Gltf) => "glTF",
            Some(Kind::Obj) => "OBJ",
            None => "other",
        };
        assert!(kind.is_some() || result.is_err(), "{what}");
        *counts.entry((name, result.is_ok())).or_default() += 1;
        // And as what it is not: both readers must stand any bytes.
        let bytes = std::fs::read(&path).expect("a file that was just read");
        for kind in [Kind::Gltf, Kind::Obj] {
            let _ = tried(&what, || {
                read_bytes(kind, "x", bytes.clone(), &alone, &bounded())
            });
        }
    }
    for ((kind, good), count) in &counts {
        eprintln!("{kind}: {count} {}", if *good { "read" } else { "refused" });
    }
    let all: usize = counts.values().sum();
    assert!(all > 400, "{all} files");
}

/// Whole, cut at each of 100 lengths and with flipped bits.
fn mutate(name: &str, kind: Kind, bytes: &[u8], resolver: &Resolver<'_>) {
    let whole = tried(name, || {
        read_bytes(kind, name, bytes.to_vec(), resolver, &bounded())
    });
    whole.unwrap_or_else(|line| panic!("{name} is sound: {line}"));
    for percent in 0..100 {
        let part = bytes[..bytes.len() * percent / 100].to_vec();
        let _ = tried(&format!("{name} to {percent} %"), || {
            read_bytes(kind, name, part, resolver, &bounded())
        });
    }
    // [Marsaglia03], 32 bits: places of the bits, the same in every run.
    let mut state = 2_463_534_242u32;
    let mut random = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state as usize
    };
    let (mut read_well, rounds) = (0, 2000);
    for round in 0..rounds {
        let mut own = bytes.to_vec();
        for _ in 0..1 + round % 8 {
            let bit = random() % (own.len() * 8);
            own[bit / 8] ^= 1 << (bit % 8);
        }
        let what = format!("{name}, round {round}");
        let result = tried(&what, || read_bytes(kind, name, own, resolver, &bounded()));
        read_well += result.is_ok() as usize;
    }
    eprintln!("{name}: {read_well} of {rounds} with flipped bits were read");
    // Neither everything nor nothing: the flips reach the numbers and the structure.
    assert!(read_well > 0 && read_well < rounds);
}

#[test]
fn a_cut_or_flipped_glb_never_panics() {
    mutate("small.glb", Kind::Gltf, &small_glb(), &alone);
}

#[test]
fn a_cut_or_flipped_obj_never_panics() {
    mutate("small.obj", Kind::Obj, SMALL_OBJ.as_bytes(), &with_mtl);
}

#[test]
fn a_cut_or_flipped_picture_never_panics() {
    let mut jpeg = std::io::Cursor::new(Vec::new());
    let picture =
        image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([x as u8 * 6, y as u8 * 8, 99]));
    picture
        .write_to(&mut jpeg, image::ImageFormat::Jpeg)
        .expect("writing into memory");
    let jpeg = jpeg.into_inner();
    let text = "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n";
    let png = common::png(40, 30, |x, y| [x as u8, y as u8, 99, 255]);
    for file in [jpeg, png] {
        for round in 0..600usize {
            let mut own = file.clone();
            if round < 100 {
                own.truncate(file.len() * round / 100);
            } else {
                let at = (round * 7919) % own.len();
                own[at] ^= 1 << (round % 8);
            }
            let resolver = move |name: &str, _: u64| match name {
                "a.mtl" => Ok(b"newmtl m\nmap_Kd x.png\n".to_vec()),
                _ => Ok(own.clone()),
            };
            let bytes = text.as_bytes().to_vec();
            let result = tried("picture", || {
                read_bytes(Kind::Obj, "t.obj", bytes, &resolver, &bounded())
            });
            assert!(
                result.is_ok(),
                "a broken picture is a warning: {:?}",
                result.err()
            );
        }
    }
}
