//! A checkpoint of long work: batches of matrix entries, appended as they are done.
//!
//! Little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 8 | magic `LUXELBAT` |
//! | 4 | version, now 2 |
//! | 8 | fingerprint of input and settings |
//! | 4 | CRC-32 of the 20 bytes before it |
//!
//! and then batches:
//!
//! | bytes | what |
//! |---|---|
//! | 4 | id |
//! | 4 | kind: 1 entries, 2 pieces |
//! | 8 | bytes of the content, n |
//! | 48 | six numbers u64 of the caller's: the tally |
//! | 4 | CRC-32 of the 64 bytes before it |
//! | n | content |
//! | 4 | CRC-32 of the n bytes before it |
//!
//! Content of kind 1: row u32, column u32, value f32 of each entry. Of kind 2, for each piece of a
//! compressed matrix: four numbers u64 of blocks, numbers, tiles and entries; each block (first
//! 2 x u32, count 2 x u32, rank u32); each number f32; each tile (row u32, column u32, bits u64);
//! each entry f32.
//!
//! Work that is killed loses the batch that was being written, no more. The head of a batch has a
//! sum of its own, so that a damaged batch can be passed over to those behind it. Batches are
//! handed to the system when they are appended, not forced to the disk: when power fails, the last
//! ones may be lost, and are found to be. Two programs must not write one file.

use crate::error::{Error, WriteError};
use crate::solution_file::Fnv;
use luxel_core::{CompressedPiece, EntryTile, Facets, LowRankBlock};
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const MAGIC: &[u8; 8] = b"LUXELBAT";
const VERSION: u32 = 2;
const HEAD: u64 = 24;
const BATCH_HEAD: u64 = 68;
const ENTRY: u64 = 12;
const PIECE_HEAD: u64 = 32;
const BLOCK: u64 = 20;
const TILE: u64 = 16;
const NUMBER: u64 = 4;

/// Bytes converted at a time, at most: whole entries and whole numbers.
const RUN: usize = 12 << 12;

/// Kinds of content.
const ENTRIES: u32 = 1;
const PIECES: u32 = 2;

/// One entry of a matrix.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BatchEntry {
    /// Row, from 0.
    pub row: u32,
    /// Column, from 0.
    pub column: u32,
    /// Value; its meaning and unit are the caller's. Any bits are kept.
    pub value: f32,
}

/// What the caller counted in a batch; any bits are kept.
pub type Tally = [u64; 6];

/// What was computed at a time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// Which part of the work it is. The file does not ask that ids are unique.
    pub id: u32,
    /// What the caller counted.
    pub tally: Tally,
    /// What was found.
    pub content: Content,
}

/// What a batch holds, in the caller's order.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// Entries of a matrix.
    Entries(Vec<BatchEntry>),
    /// Pieces of a compressed matrix. That their counts agree is the caller's to check
    /// ([`CompressedPiece::fits`]).
    Pieces(Vec<CompressedPiece>),
}

impl Default for Content {
    fn default() -> Self {
        Content::Entries(Vec::new())
    }
}

/// What a file no longer held when it was resumed. That work has to be done again.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lost {
    /// Bytes at the end that were no whole batch; they were cut off.
    pub cut_bytes: u64,
    /// Whether they were more than an unfinished batch: the head of a batch was damaged, and what
    /// came after it could not be found.
    pub cut_at_damage: bool,
    /// Ids of batches whose entries do not fit their checksum, in file order. Their bytes stay in
    /// the file and are passed over.
    pub damaged: Vec<u32>,
}

impl Lost {
    /// Nothing was lost but what a kill half-way leaves: there is no cause for a warning.
    pub fn is_ordinary(&self) -> bool {
        !self.cut_at_damage && self.damaged.is_empty()
    }
}

/// A number that changes with anything that factors between facets depend on: polygons, the rows
/// that they belong to, and `settings` (the text of those that matter, the seed too). Names of
/// facets, objects and materials do not count.
///
/// Not a cryptographic hash: it tells apart what a user may confuse.
pub fn facets_fingerprint(facets: &Facets, settings: &[&str]) -> u64 {
    let mut h = Fnv::default();
    h.count(facets.rows.len());
    h.word(facets.rounding_m.to_bits());
    h.count(facets.parts.len());
    for part in &facets.parts {
        h.word(part.row as u64);
        h.count(part.polygon.vertices.len());
        for corner in &part.polygon.vertices {
            corner.to_array().iter().for_each(|v| h.word(v.to_bits()));
        }
    }
    settings.iter().for_each(|text| h.text(text));
    h.finish()
}

/// A file of batches, open to append to.
#[derive(Debug)]
pub struct BatchFile {
    path: PathBuf,
    file: File,
    /// Bytes of the whole batches and the head.
    length: u64,
}

impl BatchFile {
    /// Begins a new file. An older batch file of that name is emptied, whosever it was; a file of
    /// another kind is an error and stays as it is.
    pub fn create(path: &Path, fingerprint: u64) -> Result<BatchFile, Error> {
        match open_new(path) {
            Ok(file) => BatchFile::begin(path, file, fingerprint),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
                let (mut file, length) = open_old(path)?;
                // Any head of ours will do, an unfinished one too: only what is not ours is kept.
                read_head(&mut file, length).map_err(refuse(path))?;
                BatchFile::begin(path, file, fingerprint)
            }
            Err(e) => Err(refuse(path)(e)),
        }
    }

    /// Opens the file of this fingerprint to go on: all whole batches in file order, and what was
    /// lost. An unfinished batch at the end is cut off.
    ///
    /// A file that is not there, of another fingerprint, of another version or of another kind is
    /// an error and stays as it is. Takes as much memory as the file is long.
    pub fn resume(path: &Path, fingerprint: u64) -> Result<(BatchFile, Vec<Batch>, Lost), Error> {
        let (mut file, length) = open_old(path)?;
        match read_head(&mut file, length).map_err(refuse(path))? {
            Head::Of(found) if found == fingerprint => {}
            Head::Of(_) => {
                return Err(told(
                    path,
                    "the saved work of this input with these settings",
                    "that of another input or other settings; run with the old ones, or delete the file to begin anew",
                ));
            }
            Head::OtherVersion(version) => {
                return Err(told(
                    path,
                    &format!("version {VERSION}"),
                    &format!("version {version}; delete the file to begin anew"),
                ));
            }
            Head::Unfinished => {
                let lost = Lost {
                    cut_bytes: length,
                    ..Lost::default()
                };
                let file = BatchFile::begin(path, file, fingerprint)?;
                return Ok((file, Vec::new(), lost));
            }
        }
        let mut lost = Lost::default();
        let mut batches = Vec::new();
        let end = read_batches(&file, length, &mut batches, &mut lost).map_err(refuse(path))?;
        if end < length {
            lost.cut_bytes = length - end;
            file.set_len(end).map_err(refuse(path))?;
        }
        file.seek(SeekFrom::Start(end)).map_err(refuse(path))?;
        let path = path.to_owned();
        let length = end;
        Ok((BatchFile { path, file, length }, batches, lost))
    }

    /// Appends a batch and hands it to the system, so that it outlives this program. If that
    /// fails, the file is as it was, and the batch may be appended again.
    pub fn append(&mut self, batch: &Batch) -> Result<(), WriteError> {
        match write_batch(&self.file, batch) {
            Ok(()) => {
                self.length += BATCH_HEAD + batch.content.bytes() + 4;
                Ok(())
            }
            Err(e) => {
                // Without this the next batch would follow half a one and be lost with it.
                let _ = self.file.set_len(self.length);
                let _ = self.file.seek(SeekFrom::Start(self.length));
                Err(WriteError::system(&self.path, e))
            }
        }
    }

    /// Size of the file, bytes.
    pub fn bytes(&self) -> u64 {
        self.length
    }

    /// Deletes the file: the work is done.
    pub fn remove(self) -> Result<(), WriteError> {
        let BatchFile { path, file, .. } = self;
        // Some systems do not delete what is open.
        drop(file);
        fs::remove_file(&path).map_err(|e| WriteError::system(&path, e))
    }

    /// Empties the file and writes its head.
    fn begin(path: &Path, mut file: File, fingerprint: u64) -> Result<BatchFile, Error> {
        let mut begin = || {
            file.set_len(0)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&head(fingerprint))
        };
        begin().map_err(refuse(path))?;
        let path = path.to_owned();
        let length = HEAD;
        Ok(BatchFile { path, file, length })
    }
}

/// A file that was not there, to read and write.
fn open_new(path: &Path) -> io::Result<File> {
    OpenOptions::new()
        .read(true)
        .write(true)
        .create_new(true)
        .open(path)
}

/// A plain file that is there, to read and write, and its length.
fn open_old(path: &Path) -> Result<(File, u64), Error> {
    // Asked first: a pipe would keep us waiting.
    let about = fs::metadata(path).map_err(refuse(path))?;
    if !about.is_file() {
        return Err(told(path, EXPECTED, "something that is not a plain file"));
    }
    let file = OpenOptions::new().read(true).write(true).open(path);
    Ok((file.map_err(refuse(path))?, about.len()))
}

const EXPECTED: &str = "a file of saved batches";

fn told(path: &Path, expected: &str, found: &str) -> Error {
    Error::new(expected, found).in_file(&path.display().to_string())
}

fn refuse(path: &Path) -> impl Fn(io::Error) -> Error {
    |e| told(path, EXPECTED, &e.to_string())
}

fn head(fingerprint: u64) -> [u8; HEAD as usize] {
    let mut head = [0; HEAD as usize];
    head[..8].copy_from_slice(MAGIC);
    head[8..12].copy_from_slice(&VERSION.to_le_bytes());
    head[12..20].copy_from_slice(&fingerprint.to_le_bytes());
    let sum = crc32fast::hash(&head[..20]);
    head[20..].copy_from_slice(&sum.to_le_bytes());
    head
}

/// What the first bytes say, if the file is one of ours.
enum Head {
    /// A fingerprint follows, and batches.
    Of(u64),
    /// Of a version that is not read.
    OtherVersion(u32),
    /// Killed before the head was whole; there is no batch.
    Unfinished,
}

/// Reads the head; what is not ours is an error.
fn read_head(file: &mut File, length: u64) -> io::Result<Head> {
    let other = |text: &str| Err(io::Error::new(io::ErrorKind::InvalidData, text));
    let mut bytes = Vec::new();
    file.take(HEAD).read_to_end(&mut bytes)?;
    let known = bytes.len().min(12);
    if length < HEAD && bytes[..known] == head(0)[..known] {
        return Ok(Head::Unfinished);
    }
    let Ok(bytes) = <[u8; HEAD as usize]>::try_from(bytes) else {
        return other("something else");
    };
    if &bytes[..8] != MAGIC {
        return other("something else");
    }
    let version = u32_at(&bytes, 8);
    if version != VERSION {
        return Ok(Head::OtherVersion(version));
    }
    if crc32fast::hash(&bytes[..20]) != u32_at(&bytes, 20) {
        return other("one with a damaged head; delete it to begin anew");
    }
    let (low, high) = (u32_at(&bytes, 12), u32_at(&bytes, 16));
    Ok(Head::Of(low as u64 | (high as u64) << 32))
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u32_at(bytes, at) as u64 | (u32_at(bytes, at + 4) as u64) << 32
}

/// Reads the batches behind the head, and returns where the last whole one ends.
fn read_batches(
    file: &File,
    length: u64,
    batches: &mut Vec<Batch>,
    lost: &mut Lost,
) -> io::Result<u64> {
    let mut source = BufReader::with_capacity(1 << 18, file);
    let mut end = HEAD;
    while length - end >= BATCH_HEAD {
        let mut head = [0; BATCH_HEAD as usize];
        source.read_exact(&mut head)?;
        if crc32fast::hash(&head[..64]) != u32_at(&head, 64) {
            lost.cut_at_damage = true;
            return Ok(end);
        }
        let (id, kind, bytes) = (u32_at(&head, 0), u32_at(&head, 4), u64_at(&head, 8));
        // Held against the file before anything is allocated.
        if bytes.saturating_add(4) > length - end - BATCH_HEAD {
            return Ok(end);
        }
        let mut content = Summed {
            source: &mut source,
            left: bytes,
            sum: crc32fast::Hasher::new(),
        };
        let read = match kind {
            ENTRIES => read_entries(&mut content)?.map(Content::Entries),
            PIECES => read_pieces(&mut content)?.map(Content::Pieces),
            _ => None,
        };
        content.pass()?;
        let sum = content.sum.finalize();
        let mut tail = [0; 4];
        source.read_exact(&mut tail)?;
        match read {
            Some(content) if sum.to_le_bytes() == tail => batches.push(Batch {
                id,
                tally: std::array::from_fn(|k| u64_at(&head, 16 + 8 * k)),
                content,
            }),
            _ => lost.damaged.push(id),
        }
        end += BATCH_HEAD + bytes + 4;
    }
    Ok(end)
}

/// The content of a batch while it is read, and its sum.
struct Summed<'a, R> {
    source: &'a mut R,
    left: u64,
    sum: crc32fast::Hasher,
}

impl<R: Read> Summed<'_, R> {
    /// Fills `bytes`; false if there are not so many.
    fn fill(&mut self, bytes: &mut [u8]) -> io::Result<bool> {
        if bytes.len() as u64 > self.left {
            return Ok(false);
        }
        self.source.read_exact(bytes)?;
        self.sum.update(bytes);
        self.left -= bytes.len() as u64;
        Ok(true)
    }

    /// `count` things of `size` bytes each; none if there are not so many.
    fn list<T>(
        &mut self,
        count: u64,
        size: u64,
        of: impl Fn(&[u8]) -> T,
    ) -> io::Result<Option<Vec<T>>> {
        if count.checked_mul(size).is_none_or(|all| all > self.left) {
            return Ok(None);
        }
        let mut list = Vec::with_capacity(count as usize);
        let mut run = [0; RUN];
        let most = RUN / size as usize;
        while list.len() < count as usize {
            let part = &mut run[..(count as usize - list.len()).min(most) * size as usize];
            if !self.fill(part)? {
                return Ok(None);
            }
            list.extend(part.chunks_exact(size as usize).map(&of));
        }
        Ok(Some(list))
    }

    /// Goes to the end of the content.
    fn pass(&mut self) -> io::Result<()> {
        let mut run = [0; RUN];
        while self.left > 0 {
            let part = self.left.min(RUN as u64) as usize;
            self.fill(&mut run[..part])?;
        }
        Ok(())
    }
}

fn read_entries(content: &mut Summed<'_, impl Read>) -> io::Result<Option<Vec<BatchEntry>>> {
    if !content.left.is_multiple_of(ENTRY) {
        return Ok(None);
    }
    content.list(content.left / ENTRY, ENTRY, |b| BatchEntry {
        row: u32_at(b, 0),
        column: u32_at(b, 4),
        value: f32::from_bits(u32_at(b, 8)),
    })
}

fn read_pieces(content: &mut Summed<'_, impl Read>) -> io::Result<Option<Vec<CompressedPiece>>> {
    let mut pieces = Vec::new();
    while content.left > 0 {
        let Some(piece) = read_piece(content)? else {
            return Ok(None);
        };
        pieces.push(piece);
    }
    Ok(Some(pieces))
}

fn read_piece(content: &mut Summed<'_, impl Read>) -> io::Result<Option<CompressedPiece>> {
    let mut head = [0; PIECE_HEAD as usize];
    if !content.fill(&mut head)? {
        return Ok(None);
    }
    let count = |k: usize| u64_at(&head, 8 * k);
    let number = |b: &[u8]| f32::from_bits(u32_at(b, 0));
    let block = |b: &[u8]| LowRankBlock {
        first: [u32_at(b, 0), u32_at(b, 4)],
        count: [u32_at(b, 8), u32_at(b, 12)],
        rank: u32_at(b, 16),
    };
    let tile = |b: &[u8]| EntryTile {
        row: u32_at(b, 0),
        column: u32_at(b, 4),
        bits: u64_at(b, 8),
    };
    let Some(blocks) = content.list(count(0), BLOCK, block)? else {
        return Ok(None);
    };
    let Some(factors) = content.list(count(1), NUMBER, number)? else {
        return Ok(None);
    };
    let Some(tiles) = content.list(count(2), TILE, tile)? else {
        return Ok(None);
    };
    let Some(entries) = content.list(count(3), NUMBER, number)? else {
        return Ok(None);
    };
    Ok(Some(CompressedPiece {
        blocks,
        factors,
        tiles,
        entries,
    }))
}

impl Content {
    /// Bytes in the file.
    fn bytes(&self) -> u64 {
        match self {
            Content::Entries(entries) => ENTRY * entries.len() as u64,
            Content::Pieces(pieces) => pieces
                .iter()
                .map(|p| {
                    PIECE_HEAD
                        + BLOCK * p.blocks.len() as u64
                        + NUMBER * (p.factors.len() + p.entries.len()) as u64
                        + TILE * p.tiles.len() as u64
                })
                .sum(),
        }
    }

    fn write(&self, out: &mut Summing<'_>) -> io::Result<()> {
        match self {
            Content::Entries(entries) => out.list(entries, |e| {
                [e.row, e.column, e.value.to_bits()].map(u32::to_le_bytes)
            }),
            Content::Pieces(pieces) => pieces.iter().try_for_each(|p| {
                let counts = [
                    p.blocks.len(),
                    p.factors.len(),
                    p.tiles.len(),
                    p.entries.len(),
                ];
                out.list(&counts, |&n| [(n as u64).to_le_bytes()])?;
                out.list(&p.blocks, |b| {
                    [b.first[0], b.first[1], b.count[0], b.count[1], b.rank].map(u32::to_le_bytes)
                })?;
                out.list(&p.factors, |v| [v.to_le_bytes()])?;
                out.list(&p.tiles, |t| {
                    let (low, high) = (t.bits as u32, (t.bits >> 32) as u32);
                    [t.row, t.column, low, high].map(u32::to_le_bytes)
                })?;
                out.list(&p.entries, |v| [v.to_le_bytes()])
            }),
        }
    }
}

/// Where the content of a batch goes, and its sum.
struct Summing<'a> {
    out: BufWriter<&'a File>,
    sum: crc32fast::Hasher,
    run: Vec<u8>,
}

impl Summing<'_> {
    fn list<T, const N: usize, const M: usize>(
        &mut self,
        list: &[T],
        bytes: impl Fn(&T) -> [[u8; M]; N],
    ) -> io::Result<()> {
        for part in list.chunks(RUN / (N * M)) {
            self.run.clear();
            for thing in part {
                self.run.extend(bytes(thing).as_flattened());
            }
            self.sum.update(&self.run);
            self.out.write_all(&self.run)?;
        }
        Ok(())
    }
}

fn write_batch(file: &File, batch: &Batch) -> io::Result<()> {
    let kind = match batch.content {
        Content::Entries(_) => ENTRIES,
        Content::Pieces(_) => PIECES,
    };
    let mut head = Vec::with_capacity(BATCH_HEAD as usize);
    head.extend(batch.id.to_le_bytes());
    head.extend(kind.to_le_bytes());
    head.extend(batch.content.bytes().to_le_bytes());
    head.extend(batch.tally.iter().flat_map(|n| n.to_le_bytes()));
    head.extend(crc32fast::hash(&head).to_le_bytes());
    let mut out = Summing {
        out: BufWriter::with_capacity(1 << 18, file),
        sum: crc32fast::Hasher::new(),
        run: Vec::new(),
    };
    let written = out.out.write_all(&head).and_then(|()| {
        batch.content.write(&mut out)?;
        let sum = out.sum.clone().finalize();
        out.out.write_all(&sum.to_le_bytes())?;
        out.out.flush()
    });
    // What could not be written must not be tried again when the buffer goes away: the caller
    // cuts the file back.
    let _ = out.out.into_parts();
    written
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn batch(id: u32, entries: u32) -> Batch {
        let entry = |k: u32| BatchEntry {
            row: id,
            column: k,
            value: 0.1 + k as f32,
        };
        Batch {
            id,
            tally: [id as u64, u64::MAX, 0, 1, 2, 0.1_f64.to_bits()],
            content: Content::Entries((0..entries).map(entry).collect()),
        }
    }

    /// Two pieces, one of them empty; more numbers than a run in the other.
    fn pieces(id: u32) -> Batch {
        let piece = CompressedPiece {
            blocks: vec![
                LowRankBlock {
                    first: [3, u32::MAX],
                    count: [id, 2],
                    rank: 1,
                };
                3
            ],
            factors: (0..RUN / 4 + 3).map(|k| k as f32).collect(),
            tiles: vec![
                EntryTile {
                    row: 1,
                    column: 2,
                    bits: 0x8000_0000_0000_0001,
                };
                2
            ],
            entries: vec![0.5; 4],
        };
        Batch {
            content: Content::Pieces(vec![piece, CompressedPiece::default()]),
            ..batch(id, 0)
        }
    }

    /// Three batches, the second empty, and where each ends.
    fn three() -> (tempfile::TempDir, PathBuf, Vec<Batch>, Vec<u64>) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("work.batches");
        let batches = vec![batch(7, 3), batch(9, 0), batch(1, 2)];
        let mut file = BatchFile::create(&path, 42).expect("created");
        let mut ends = vec![file.bytes()];
        for b in &batches {
            file.append(b).expect("appended");
            ends.push(file.bytes());
            assert_eq!(fs::metadata(&path).expect("there").len(), file.bytes());
        }
        (folder, path, batches, ends)
    }

    #[test]
    fn batches_are_read_in_order_and_more_can_follow() {
        let (_folder, path, mut batches, _) = three();
        let (mut file, read, lost) = BatchFile::resume(&path, 42).expect("resumed");
        assert_eq!((read, &lost), (batches.clone(), &Lost::default()));
        // Longer than a run, so that parts are joined.
        batches.push(batch(3, RUN as u32 / 4 + 17));
        file.append(&batches[3]).expect("appended");
        drop(file);
        let (mut file, read, _) = BatchFile::resume(&path, 42).expect("resumed");
        assert_eq!(read, batches);
        batches.push(pieces(8));
        batches.push(batch(9, 1));
        file.append(&batches[4]).expect("appended");
        file.append(&batches[5]).expect("appended");
        assert_eq!(fs::metadata(&path).expect("there").len(), file.bytes());
        drop(file);
        let (file, read, _) = BatchFile::resume(&path, 42).expect("resumed");
        assert_eq!(read, batches);
        file.remove().expect("removed");
        assert!(!path.exists());
    }

    #[test]
    fn a_tail_torn_anywhere_costs_the_batch_it_was_in() {
        let (folder, path, mut batches, ends) = three();
        let whole = fs::read(&path).expect("there");
        let torn = folder.path().join("torn");
        batches.push(batch(5, 4));
        for n in 0..=whole.len() {
            fs::write(&torn, &whole[..n]).expect("written");
            let (mut file, read, lost) = BatchFile::resume(&torn, 42).expect("resumed");
            let kept = ends.iter().filter(|&&end| end <= n as u64).count();
            let end = kept.checked_sub(1).map_or(0, |k| ends[k]);
            assert_eq!(read, batches[..kept.saturating_sub(1)], "cut at {n}");
            assert_eq!(lost.cut_bytes, n as u64 - end, "cut at {n}");
            assert!(lost.is_ordinary(), "cut at {n}");
            // What is appended now is found behind the whole ones.
            file.append(&batches[3]).expect("appended");
            drop(file);
            let (_, read, lost) = BatchFile::resume(&torn, 42).expect("resumed");
            assert_eq!(read.last(), batches.last(), "cut at {n}");
            assert_eq!((read.len(), lost), (kept.max(1), Lost::default()));
        }
    }

    #[test]
    fn pieces_whose_counts_lie_are_damaged_and_passed_over() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("work.batches");
        let mut file = BatchFile::create(&path, 42).expect("created");
        file.append(&pieces(1)).expect("appended");
        file.append(&batch(2, 2)).expect("appended");
        drop(file);
        let whole = fs::read(&path).expect("there");
        let content = (HEAD + BATCH_HEAD) as usize;
        let Content::Pieces(list) = &pieces(1).content else {
            unreachable!("made of pieces")
        };
        let end = content + Content::Pieces(list.clone()).bytes() as usize;
        // Each of the four counts, with a sum that fits.
        for k in 0..4 {
            for count in [u64::MAX, 1 << 40, 1 << 61] {
                let mut bytes = whole.clone();
                bytes[content + 8 * k..content + 8 * (k + 1)].copy_from_slice(&count.to_le_bytes());
                let sum = crc32fast::hash(&bytes[content..end]);
                bytes[end..end + 4].copy_from_slice(&sum.to_le_bytes());
                fs::write(&path, &bytes).expect("written");
                let (_, read, lost) = BatchFile::resume(&path, 42).expect("resumed");
                assert_eq!((read, lost.damaged), (vec![batch(2, 2)], vec![1]));
            }
        }
    }

    #[test]
    fn every_flipped_bit_is_noticed_and_costs_no_batch_before_it() {
        // CRC-32 finds every single flipped bit.
        let (folder, path, batches, ends) = three();
        let whole = fs::read(&path).expect("there");
        let bad = folder.path().join("bad");
        for bit in 0..whole.len() * 8 {
            let at = bit as u64 / 8;
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            fs::write(&bad, &bytes).expect("written");
            let resumed = BatchFile::resume(&bad, 42);
            if at < HEAD {
                assert!(resumed.is_err(), "bit {bit}");
                assert_eq!(fs::read(&bad).expect("there"), bytes, "bit {bit}");
                continue;
            }
            let (_, read, lost) = resumed.expect("resumed");
            let hit = ends.iter().filter(|&&end| end <= at).count() - 1;
            assert!(!lost.is_ordinary(), "bit {bit}");
            let mut left = batches.clone();
            if at - ends[hit] < BATCH_HEAD {
                left.truncate(hit);
                assert!(lost.cut_at_damage && lost.cut_bytes == ends[3] - ends[hit]);
            } else {
                left.remove(hit);
                assert_eq!((lost.damaged, lost.cut_bytes), (vec![batches[hit].id], 0));
            }
            assert_eq!(read, left, "bit {bit}");
        }
    }

    #[test]
    fn other_work_and_other_files_are_refused_and_left_alone() {
        let (folder, path, ..) = three();
        let whole = fs::read(&path).expect("there");
        let told = BatchFile::resume(&path, 43).expect_err("other work");
        let told = told.to_string();
        assert!(told.contains("work.batches: expected the saved work of this input"));
        assert!(told.contains("delete the file to begin anew"), "{told}");
        assert_eq!(fs::read(&path).expect("there"), whole);

        let mut newer = whole.clone();
        newer[8] = 1;
        fs::write(&path, &newer).expect("written");
        let told = BatchFile::resume(&path, 42).expect_err("version 1");
        assert!(
            told.to_string()
                .contains("expected version 2, found version 1"),
            "{told}"
        );

        let foreign = folder.path().join("thesis.txt");
        for text in [
            "years of work, more than 24 bytes",
            "short",
            "LUXELSOL",
            "L!",
        ] {
            fs::write(&foreign, text).expect("written");
            for told in [
                BatchFile::create(&foreign, 42).expect_err("foreign"),
                BatchFile::resume(&foreign, 42)
                    .map(|_| ())
                    .expect_err("foreign"),
            ] {
                let told = told.to_string();
                assert!(
                    told.ends_with(
                        "thesis.txt: expected a file of saved batches, found something else"
                    ),
                    "{told}"
                );
            }
            assert_eq!(fs::read(&foreign).expect("there"), text.as_bytes());
        }
        assert!(BatchFile::create(folder.path(), 42).is_err(), "a folder");
        assert!(BatchFile::resume(folder.path(), 42).is_err(), "a folder");
        let none = folder.path().join("none");
        assert!(BatchFile::resume(&none, 42).is_err());
        assert!(!none.exists());
    }

    #[test]
    fn creating_over_an_older_batch_file_empties_it() {
        let (_folder, path, ..) = three();
        BatchFile::create(&path, 43).expect("created");
        let (_, read, lost) = BatchFile::resume(&path, 43).expect("resumed");
        assert_eq!((read, lost), (vec![], Lost::default()));
    }

    #[test]
    fn other_geometry_and_other_settings_have_another_fingerprint() {
        use luxel_core::{DVec3, Facet, FacetPart, Polygon};
        let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let mut facets = Facets {
            rows: vec![Facet::default()],
            parts: vec![FacetPart {
                polygon: Polygon::new(corners),
                row: 0,
            }],
            ..Facets::default()
        };
        let a = facets_fingerprint(&facets, &["rays 100"]);
        facets.rows[0].name = "wall".into();
        assert_eq!(a, facets_fingerprint(&facets, &["rays 100"]));
        assert_ne!(a, facets_fingerprint(&facets, &["rays 200"]));
        facets.parts[0].row = Facets::NO_ROW;
        let b = facets_fingerprint(&facets, &["rays 100"]);
        assert_ne!(a, b);
        facets.parts[0].polygon.vertices[2].y += 1e-15;
        assert_ne!(b, facets_fingerprint(&facets, &["rays 100"]));
    }

    proptest! {
        #[test]
        fn a_forged_tail_never_panics(
            id in any::<u32>(), kind in 0_u32..4, count in any::<u64>(),
            rest in prop::collection::vec(any::<u8>(), 0..90),
        ) {
            // A head that fits its sum and promises any length: that of the file decides.
            let folder = tempfile::tempdir().expect("a temporary folder");
            let path = folder.path().join("forged");
            let mut bytes = head(42).to_vec();
            let count = if count & 1 == 0 { count % 80 } else { count };
            let start = bytes.len();
            bytes.extend(id.to_le_bytes());
            bytes.extend(kind.to_le_bytes());
            bytes.extend(count.to_le_bytes());
            bytes.extend([7; 48]);
            let sum = crc32fast::hash(&bytes[start..]);
            bytes.extend(sum.to_le_bytes());
            bytes.extend(rest);
            fs::write(&path, &bytes).expect("written");
            let (file, read, lost) = BatchFile::resume(&path, 42).expect("resumed");
            prop_assert_eq!(file.bytes() + lost.cut_bytes, bytes.len() as u64);
            prop_assert!(read.len() + lost.damaged.len() <= 4);
        }
    }
}
