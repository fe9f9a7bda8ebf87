//! The solution file that `--resume` continues: a stored [`Solution`] and whose it is.
//!
//! Little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 8 | magic `LUXELSOL` |
//! | 4 | version, now 1 |
//! | 8 | length of the body |
//! | body | fingerprint u64; step u32; work u64; relative error f32; unshot share f32; number of groups u32, then each name (length u32, UTF-8); elements u64; exitance, then unshot, f32 each |
//! | 4 | CRC-32 of everything before it |
//!
//! A cut, flipped or foreign file is an error that says what is wrong. Nothing is allocated by a
//! count in the file before it was held against the bytes that are there.

use crate::atomic;
use crate::error::{Error, clean};
use luxel_core::{Front, Layers, LuminaireKind, Scene, Shape, Solution};
use std::io::{Read, Write};
use std::path::Path;

const MAGIC: &[u8; 8] = b"LUXELSOL";
const VERSION: u32 = 1;
const HEAD: usize = 20;

/// A solution with what is needed to go on from it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StoredSolution {
    /// [`fingerprint`] of the problem that it solves.
    pub fingerprint: u64,
    /// Steps that the solver had done.
    pub step: u32,
    /// Exitance, unshot, layers and counters.
    pub solution: Solution,
}

/// A number that changes with anything that the solution depends on: geometry, finishes,
/// luminaires, sky, elements, `settings` (the text of those that matter) and seed.
///
/// Not a cryptographic hash: it tells apart what a user may confuse.
pub fn fingerprint(scene: &Scene, front: &Front, settings: &[&str], seed: u32) -> u64 {
    let mut h = Fnv::default();
    h.count(scene.positions.len());
    scene.positions.iter().for_each(|p| h.floats(&p.to_array()));
    h.count(scene.triangles.len());
    for (t, s) in scene.triangles.iter().zip(&scene.surface_of) {
        t.iter().for_each(|&i| h.word(i as u64));
        h.word(s.0 as u64);
    }
    for uv in &scene.uvs {
        uv.iter().for_each(|c| h.floats(&c.to_array()));
    }
    for s in &scene.surfaces {
        h.word(s.finish.0 as u64);
    }
    for f in &scene.finishes {
        h.floats(&f.reflectance.to_array());
        h.word(f.texture.map_or(u64::MAX, |t| t.0 as u64));
        if let Some(e) = &f.emission {
            h.floats(&e.luminance.to_array());
            h.word(e.texture.map_or(u64::MAX, |t| t.0 as u64));
            h.word(e.group.0 as u64);
        }
        let flags = [
            f.back_reflects,
            f.back_emits,
            f.transparent,
            f.emission.is_some(),
        ];
        flags.iter().for_each(|&b| h.word(b as u64));
        h.floats(&[f.coverage]);
        match f.alpha {
            luxel_core::Alpha::Opaque => h.word(0),
            luxel_core::Alpha::Mask { cutoff } => h.floats(&[1.0, cutoff]),
            luxel_core::Alpha::Blend => h.word(2),
        }
    }
    for t in &scene.textures {
        h.word(t.width as u64);
        h.word(t.height as u64);
        t.rgba
            .iter()
            .for_each(|p| h.word(u32::from_le_bytes(*p) as u64));
    }
    for l in &scene.luminaires {
        h.floats(&l.position.to_array());
        h.floats(&l.direction.to_array());
        h.word(l.group.0 as u64);
        match l.kind {
            LuminaireKind::Point { intensity, range_m } => {
                h.word(0);
                h.floats(&intensity.to_array());
                h.floats(&[range_m]);
            }
            LuminaireKind::Spot {
                intensity,
                range_m,
                cos_inner,
                cos_outer,
            } => {
                h.word(1);
                h.floats(&intensity.to_array());
                h.floats(&[range_m, cos_inner, cos_outer]);
            }
            LuminaireKind::Directional { illuminance } => {
                h.word(2);
                h.floats(&illuminance.to_array());
            }
            LuminaireKind::Lambertian { intensity } => {
                h.word(3);
                h.floats(&intensity.to_array());
            }
        }
    }
    for g in &scene.groups {
        h.text(&g.name);
    }
    if let Some(sky) = &scene.sky {
        h.floats(&sky.luminance.to_array());
        h.word(sky.group.0 as u64);
    }
    h.count(front.len());
    for e in 0..front.len() {
        h.word(front.patch[e].0 as u64);
        h.floats(&front.rect[e]);
        h.floats(&[front.area[e]]);
    }
    for p in &front.patches {
        h.word(p.surface.0 as u64);
        h.word(p.side as u64);
        match &p.shape {
            Shape::Parallelogram {
                origin,
                edge_u,
                edge_v,
            }
            | Shape::Triangle {
                origin,
                edge_u,
                edge_v,
            } => {
                [origin, edge_u, edge_v]
                    .iter()
                    .for_each(|v| h.floats(&v.to_array()));
            }
            Shape::Cluster { triangles } => {
                h.word(triangles.start as u64);
                h.word(triangles.end as u64);
            }
        }
    }
    settings.iter().for_each(|text| h.text(text));
    h.word(seed as u64);
    h.finish()
}

/// A number that changes with any of the bytes and with what came `before` them.
pub(crate) fn fingerprint_of_bytes(before: u64, bytes: &[u8]) -> u64 {
    let mut h = Fnv(0xcbf2_9ce4_8422_2325 ^ before);
    h.count(bytes.len());
    for chunk in bytes.chunks(8) {
        let mut word = [0; 8];
        word[..chunk.len()].copy_from_slice(chunk);
        h.word(u64::from_le_bytes(word));
    }
    h.0
}

/// FNV-1a over words of 64 bits, each mixed once more so that high bits come down [Fowler91].
pub(crate) struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Fnv(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    pub(crate) fn word(&mut self, v: u64) {
        self.0 = (self.0 ^ v).wrapping_mul(0x0000_0100_0000_01b3);
        self.0 ^= self.0 >> 29;
    }
    pub(crate) fn count(&mut self, n: usize) {
        self.word(n as u64);
    }
    fn floats(&mut self, values: &[f32]) {
        values.iter().for_each(|v| self.word(v.to_bits() as u64));
    }
    pub(crate) fn text(&mut self, text: &str) {
        self.count(text.len());
        text.bytes().for_each(|b| self.word(b as u64));
    }
    pub(crate) fn finish(self) -> u64 {
        self.0
    }
}

/// Writes a solution file whole, or leaves the old one.
pub fn write_solution(path: &Path, stored: &StoredSolution) -> std::io::Result<()> {
    let body = body_length(stored) as u64;
    atomic::write_with(path, |out| {
        let mut out = Summed {
            out,
            crc: crc32fast::Hasher::new(),
        };
        out.write_all(MAGIC)?;
        out.write_all(&VERSION.to_le_bytes())?;
        out.write_all(&body.to_le_bytes())?;
        let s = &stored.solution;
        out.write_all(&stored.fingerprint.to_le_bytes())?;
        out.write_all(&stored.step.to_le_bytes())?;
        out.write_all(&s.work.to_le_bytes())?;
        out.write_all(&s.relative_error.to_le_bytes())?;
        out.write_all(&s.unshot_share.to_le_bytes())?;
        out.write_all(&(s.layers.groups.len() as u32).to_le_bytes())?;
        for name in &s.layers.groups {
            out.write_all(&(name.len() as u32).to_le_bytes())?;
            out.write_all(name.as_bytes())?;
        }
        out.write_all(&(s.len() as u64).to_le_bytes())?;
        for values in [&s.exitance, &s.unshot] {
            for run in values.chunks(1 << 14) {
                let bytes: Vec<u8> = run.iter().flat_map(|v| v.to_le_bytes()).collect();
                out.write_all(&bytes)?;
            }
        }
        let crc = out.crc.finalize();
        out.out.write_all(&crc.to_le_bytes())
    })
}

fn body_length(stored: &StoredSolution) -> usize {
    let s = &stored.solution;
    let names: usize = s.layers.groups.iter().map(|n| 4 + n.len()).sum();
    8 + 4 + 8 + 4 + 4 + 4 + names + 8 + 4 * (s.exitance.len() + s.unshot.len())
}

/// Passes bytes on and sums them up.
struct Summed<'a> {
    out: &'a mut dyn Write,
    crc: crc32fast::Hasher,
}

impl Write for Summed<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let n = self.out.write(bytes)?;
        self.crc.update(&bytes[..n]);
        Ok(n)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }
}

/// Reads the solution file of the problem with this fingerprint on `elements` elements; that of
/// any other problem is an error for the user.
pub fn read_solution(
    path: &Path,
    fingerprint: u64,
    elements: usize,
) -> Result<StoredSolution, Error> {
    let file = path.display().to_string();
    let refuse = |found: String| Error::new("a solution file", found).in_file(&file);
    let about = std::fs::metadata(path).map_err(|e| refuse(e.to_string()))?;
    if !about.is_file() {
        return Err(refuse("something that is not a plain file".into()));
    }
    // The head first: a huge foreign file is never read.
    let mut head = [0; 28];
    let mut source = std::fs::File::open(path).map_err(|e| refuse(e.to_string()))?;
    let known = source.read_exact(&mut head).is_ok() && &head[..8] == MAGIC;
    let mut bytes = Vec::new();
    if known {
        bytes.extend(head);
        source
            .take(about.len())
            .read_to_end(&mut bytes)
            .map_err(|e| refuse(e.to_string()))?;
    }
    let stored = solution_from_bytes(&bytes).map_err(|e| e.in_file(&file))?;
    if stored.fingerprint != fingerprint || stored.solution.len() != elements {
        return Err(Error::new(
            "the solution of this scene with these settings",
            "that of another scene, other lights or other settings; run without --resume",
        )
        .in_file(&file));
    }
    Ok(stored)
}

/// Reads a solution out of memory.
pub fn solution_from_bytes(bytes: &[u8]) -> Result<StoredSolution, Error> {
    if bytes.len() < HEAD + 4 || &bytes[..8] != MAGIC {
        return Err(Error::new("a solution file of luxel", "something else"));
    }
    let (kept, sum) = bytes.split_at(bytes.len() - 4);
    let mut all = Cursor { bytes: &kept[8..] };
    let version = all.u32("version")?;
    if version != VERSION {
        return Err(Error::new(
            format!("version {VERSION}"),
            format!("version {version}"),
        ));
    }
    let length = all.u64("length")?;
    if length != all.bytes.len() as u64 {
        let found = format!("{}; the file is cut or longer than it was", all.bytes.len());
        return Err(Error::new(format!("{length} bytes"), found));
    }
    let mut crc = crc32fast::Hasher::new();
    crc.update(kept);
    if crc.finalize().to_le_bytes() != sum {
        return Err(Error::new(
            "bytes that fit their checksum",
            "a damaged file",
        ));
    }
    let mut stored = StoredSolution {
        fingerprint: all.u64("fingerprint")?,
        step: all.u32("step")?,
        solution: Solution::default(),
    };
    let s = &mut stored.solution;
    s.work = all.u64("work")?;
    s.relative_error = f32::from_bits(all.u32("relative error")?);
    s.unshot_share = f32::from_bits(all.u32("unshot share")?);
    let groups = all.u32("groups")?;
    let mut names = Vec::new();
    for _ in 0..groups {
        // Each name takes bytes that are there, so the list cannot outgrow the file.
        let n = all.u32("length of a name")? as usize;
        let text = std::str::from_utf8(all.take(n, "name")?)
            .map_err(|_| Error::new("a name in UTF-8", "other bytes"))?;
        names.push(text.to_owned());
    }
    s.layers = Layers { groups: names };
    let elements = all.u64("elements")?;
    let values = (elements as u128) * s.columns() as u128;
    if values * 8 != all.bytes.len() as u128 {
        let expected = format!("exitance and unshot of {elements} elements");
        return Err(Error::new(expected, format!("{} bytes", all.bytes.len())));
    }
    let (exitance, unshot) = all.bytes.split_at(all.bytes.len() / 2);
    let floats = |bytes: &[u8]| -> Result<Vec<f32>, Error> {
        let list: Vec<f32> = bytes
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        match list.iter().find(|v| !v.is_finite()) {
            Some(v) => Err(Error::new("finite numbers", clean(&v.to_string()))),
            None => Ok(list),
        }
    };
    s.exitance = floats(exitance)?;
    s.unshot = floats(unshot)?;
    Ok(stored)
}

struct Cursor<'a> {
    bytes: &'a [u8],
}

impl<'a> Cursor<'a> {
    fn take(&mut self, n: usize, what: &str) -> Result<&'a [u8], Error> {
        if n > self.bytes.len() {
            return Err(Error::new(
                format!("{n} bytes of {what}"),
                format!("{}", self.bytes.len()),
            ));
        }
        let (head, rest) = self.bytes.split_at(n);
        self.bytes = rest;
        Ok(head)
    }
    fn u32(&mut self, what: &str) -> Result<u32, Error> {
        let b = self.take(4, what)?;
        Ok(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }
    fn u64(&mut self, what: &str) -> Result<u64, Error> {
        let (low, high) = (self.u32(what)?, self.u32(what)?);
        Ok(low as u64 | (high as u64) << 32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_core::Vec3;
    use proptest::prelude::*;

    fn stored() -> StoredSolution {
        let layers = Layers {
            groups: vec!["lamp".into(), "sky é".into()],
        };
        StoredSolution {
            fingerprint: 0x0123_4567_89ab_cdef,
            step: 7,
            solution: Solution {
                layers,
                exitance: (0..30).map(|i| i as f32 * 0.37).collect(),
                unshot: (0..30).map(|i| -(i as f32)).collect(),
                relative_error: 0.02,
                unshot_share: 0.001,
                work: 1 << 40,
            },
        }
    }

    fn bytes() -> Vec<u8> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("solution");
        write_solution(&path, &stored()).expect("written");
        let own = stored().fingerprint;
        assert_eq!(read_solution(&path, own, 5).expect("read"), stored());
        let told = read_solution(&path, own + 1, 5)
            .expect_err("another scene")
            .to_string();
        assert!(
            told.contains("expected the solution of this scene"),
            "{told}"
        );
        assert!(read_solution(&path, own, 6).is_err(), "another mesh");
        assert!(read_solution(folder.path(), own, 5).is_err(), "a folder");
        std::fs::read(&path).expect("there")
    }

    #[test]
    fn what_was_written_is_read_bit_for_bit() {
        assert_eq!(solution_from_bytes(&bytes()).expect("whole"), stored());
    }

    #[test]
    fn every_cut_and_every_flipped_bit_is_an_error() {
        // CRC-32 finds every single flipped bit; a cut breaks the length.
        let whole = bytes();
        for n in 0..whole.len() {
            assert!(solution_from_bytes(&whole[..n]).is_err(), "cut at {n}");
        }
        for k in 0..whole.len() * 8 {
            let mut bad = whole.clone();
            bad[k / 8] ^= 1 << (k % 8);
            assert!(solution_from_bytes(&bad).is_err(), "bit {k}");
        }
    }

    proptest! {
        #[test]
        fn a_forged_body_with_a_right_checksum_never_panics(
            at in 0usize..80, value in any::<[u8; 4]>(), cut in 0usize..200,
        ) {
            let whole = bytes();
            let mut bad = whole[..whole.len() - 4].to_vec();
            let at = 20 + at.min(bad.len() - 24);
            bad[at..at + 4].copy_from_slice(&value);
            bad.truncate(bad.len().saturating_sub(cut).max(20));
            let length = (bad.len() - 20) as u64;
            bad[12..20].copy_from_slice(&length.to_le_bytes());
            let crc = crc32fast::hash(&bad);
            bad.extend(crc.to_le_bytes());
            if let Ok(s) = solution_from_bytes(&bad) {
                prop_assert_eq!(s.solution.exitance.len(), s.solution.unshot.len());
            }
        }
    }

    #[test]
    fn another_scene_is_refused() {
        let mut scene = Scene {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            triangles: vec![[0, 1, 2]],
            surface_of: vec![luxel_core::SurfaceId(0)],
            finishes: vec![luxel_core::Finish::default()],
            ..Scene::default()
        };
        let front = Front::new(1);
        let a = fingerprint(&scene, &front, &["uniform"], 1);
        assert_eq!(a, fingerprint(&scene.clone(), &front, &["uniform"], 1));
        assert_ne!(a, fingerprint(&scene, &front, &["dense"], 1));
        assert_ne!(a, fingerprint(&scene, &front, &["uniform"], 2));
        scene.positions[1].x += 1e-6;
        let b = fingerprint(&scene, &front, &["uniform"], 1);
        assert_ne!(a, b);
        scene.finishes[0].reflectance.g = 0.51;
        assert_ne!(b, fingerprint(&scene, &front, &["uniform"], 1));
    }
}
