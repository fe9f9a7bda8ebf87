//! The work in batches: computed one after the other, watched, kept on the disk, gone on with.
//!
//! What is done is kept in `OUTPUT.part` beside the output as soon as it takes longer than a few
//! seconds, so a stop or a kill loses little. What was counted is kept as well: a run that is
//! gone on with reports what one in one go would.

use super::Asked;
use crate::error::Error;
use crate::stage::{Stage, peak_memory_bytes};
use crate::watch::{Control, Status, Watch};
use luxel_core::{CompressedPiece, Facets, Warnings};
use luxel_io::{
    Batch as StoredBatch, BatchEntry, BatchFile, Content, Tally, WriteError, facets_fingerprint,
};
use luxel_transport::facets::{Batch, CompressedBatch, Counts, FacetFactors, Triplet};
use std::mem::take;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Work is kept at most this often.
const KEEP_EVERY: Duration = Duration::from_secs(5);

/// Bytes of a pair while it is found, and twice when it is stored.
const PAIR_BYTES: u64 = 12 + 16;

/// What one batch of the work makes.
pub(super) trait Made: Default + Send {
    /// Tells files of one kind of work from those of another; nothing for the first kind.
    const KIND: Option<&'static str>;

    /// Computes it.
    fn make(work: &FacetFactors, batch: usize) -> Self;

    fn counts(&self) -> &Counts;

    /// Memory that it takes to the end of the work, bytes.
    fn memory(&self) -> u64;

    /// Pairs in it that are stored singly.
    fn pairs(&self) -> u64;

    fn into_content(self) -> Content;

    /// None if the content is not of this kind, or not of this work.
    fn of(content: Content, counts: Counts, work: &FacetFactors) -> Option<Self>;
}

impl Made for Batch {
    const KIND: Option<&'static str> = None;

    fn make(work: &FacetFactors, batch: usize) -> Self {
        work.compute(batch)
    }

    fn counts(&self) -> &Counts {
        &self.counts
    }

    fn memory(&self) -> u64 {
        self.pairs() * PAIR_BYTES
    }

    fn pairs(&self) -> u64 {
        self.found.len() as u64
    }

    fn into_content(self) -> Content {
        let entry = |t: Triplet| BatchEntry {
            row: t.row,
            column: t.column,
            value: t.exchange,
        };
        Content::Entries(self.found.into_iter().map(entry).collect())
    }

    fn of(content: Content, counts: Counts, work: &FacetFactors) -> Option<Self> {
        let Content::Entries(entries) = content else {
            return None;
        };
        let rows = work.rows() as u32;
        if entries.iter().any(|e| e.row >= rows || e.column >= rows) {
            return None;
        }
        let triplet = |e: BatchEntry| Triplet {
            row: e.row,
            column: e.column,
            exchange: e.value,
        };
        let found = entries.into_iter().map(triplet).collect();
        Some(Batch { found, counts })
    }
}

impl Made for CompressedBatch {
    const KIND: Option<&'static str> = Some("compressed");

    fn make(work: &FacetFactors, batch: usize) -> Self {
        work.compress(batch)
    }

    fn counts(&self) -> &Counts {
        &self.counts
    }

    fn memory(&self) -> u64 {
        let bytes = |p: &CompressedPiece| (size_of_val(p) + p.bytes()) as u64;
        self.pieces.iter().map(bytes).sum()
    }

    fn pairs(&self) -> u64 {
        self.pieces.iter().map(|p| p.entries.len() as u64).sum()
    }

    fn into_content(self) -> Content {
        Content::Pieces(self.pieces)
    }

    fn of(content: Content, counts: Counts, work: &FacetFactors) -> Option<Self> {
        let Content::Pieces(pieces) = content else {
            return None;
        };
        let fit = pieces.iter().all(|p| p.fits(work.parts()));
        fit.then_some(CompressedBatch { pieces, counts })
    }
}

/// The batches that are done, from the first on.
pub(super) struct Found<T> {
    pub(super) batches: Vec<T>,
    pub(super) counts: Counts,
    /// Share of all pairs that they went through, 0..=1.
    pub(super) share: f64,
    path: PathBuf,
    fingerprint: u64,
    file: Option<BatchFile>,
    /// Batches that are in the file.
    kept: usize,
    /// Why the file does not keep all that it should.
    unkept: Option<String>,
}

impl<T: Made> Found<T> {
    fn new(path: &Path, fingerprint: u64) -> Found<T> {
        Found {
            batches: Vec::new(),
            counts: Counts::default(),
            share: 0.0,
            path: path.to_owned(),
            fingerprint,
            file: None,
            kept: 0,
            unkept: None,
        }
    }

    fn add(&mut self, batch: T, work: &FacetFactors) {
        self.share += work.share(self.batches.len());
        self.counts.add(batch.counts());
        self.batches.push(batch);
    }

    /// Takes in what an earlier run kept.
    fn resume(&mut self, work: &FacetFactors, warnings: &mut Warnings) -> Result<(), Error> {
        let (file, stored, lost) = BatchFile::resume(&self.path, self.fingerprint)?;
        let mut damaged = !lost.is_ordinary();
        for batch in stored {
            // In order from the first; what follows a gap is done again.
            if batch.id as usize != self.batches.len() {
                continue;
            }
            match T::of(batch.content, counts_of(&batch.tally), work) {
                Some(made) => self.add(made, work),
                None => damaged = true,
            }
        }
        if damaged {
            let what = "a part of the saved work is damaged; it is done again";
            warnings.add(self.path.display().to_string(), what, 1);
        }
        self.kept = self.batches.len();
        self.file = Some(file);
        Ok(())
    }

    /// Adds what is not there yet to the file. If that fails the work goes on without, and the
    /// next time tries again.
    fn keep(&mut self, work: &FacetFactors) {
        self.unkept = self.try_keep(work).err();
    }

    fn try_keep(&mut self, work: &FacetFactors) -> Result<(), String> {
        if self.kept == self.batches.len() {
            return Ok(());
        }
        let file = match &mut self.file {
            Some(file) => file,
            None => {
                let fresh = BatchFile::create(&self.path, self.fingerprint);
                self.file.insert(fresh.map_err(|e| e.to_string())?)
            }
        };
        while self.kept < self.batches.len() {
            // Moved there and back, so that nothing lies in memory twice.
            let made = take(&mut self.batches[self.kept]);
            let counts = *made.counts();
            let stored = StoredBatch {
                id: self.kept as u32,
                tally: tally_of(&counts),
                content: made.into_content(),
            };
            let written = file.append(&stored);
            self.batches[self.kept] =
                T::of(stored.content, counts, work).expect("it was made of this work");
            written.map_err(|e| e.to_string())?;
            self.kept += 1;
        }
        Ok(())
    }

    /// The file that keeps everything that was found, if there is one.
    pub(super) fn kept_in(&self) -> Option<&Path> {
        let whole = self.file.is_some() && self.kept == self.batches.len();
        whole.then_some(&*self.path)
    }

    /// Keeps the rest as well where work is kept already: before what may fail.
    pub(super) fn keep_rest(&mut self, work: &FacetFactors) {
        if self.file.is_some() {
            self.keep(work);
        }
    }

    /// Writes the result by `write`. If the disk is full and `spare` says that all work is in the
    /// result, the file that keeps it makes room, and comes back if that does not help.
    pub(super) fn write(
        &mut self,
        work: &FacetFactors,
        spare: bool,
        mut write: impl FnMut() -> Result<u64, WriteError>,
    ) -> Result<u64, Error> {
        let mut written = write();
        if written.as_ref().is_err_and(is_full) && spare && self.file.is_some() {
            self.remove()?;
            written = write();
            if written.is_err() {
                self.keep(work);
            }
        }
        written.map_err(|e| self.unwritten(work, e))
    }

    /// Why a file could not be written, and where the work is kept, if it is.
    fn unwritten(&self, work: &FacetFactors, error: WriteError) -> Error {
        match error {
            WriteError::System { path, source } if self.file.is_some() => {
                let kept: f64 = (0..self.kept).map(|b| work.share(b)).sum();
                let total: f64 = (0..work.batches()).map(|b| work.share(b)).sum();
                Error::WriteKept {
                    path,
                    source,
                    part: self.path.clone(),
                    percent: (100.0 * kept / total.max(f64::MIN_POSITIVE)).floor(),
                }
            }
            other => other.into(),
        }
    }

    /// Says why the work is not kept, if it is not.
    pub(super) fn say(&self, warnings: &mut Warnings) {
        if let Some(why) = &self.unkept {
            let what = format!("work is not kept for --resume: {why}");
            warnings.add(self.path.display().to_string(), what, 1);
        }
    }

    /// Deletes the file: the work is done.
    pub(super) fn remove(&mut self) -> Result<(), Error> {
        self.kept = 0;
        let removed = self.file.take().map_or(Ok(()), BatchFile::remove);
        removed.map_err(Error::from)
    }
}

/// Whether space is what a file lacked.
fn is_full(error: &WriteError) -> bool {
    use std::io::ErrorKind::{QuotaExceeded, StorageFull};
    match error {
        WriteError::System { source, .. } => {
            matches!(source.kind(), StorageFull | QuotaExceeded)
        }
        WriteError::Format { .. } => false,
    }
}

/// Computes all batches that an earlier run has not, as long as the watcher wants.
pub(super) fn compute<T: Made>(
    facets: &Facets,
    work: &FacetFactors,
    asked: &Asked<'_>,
    part: &Path,
    warnings: &mut Warnings,
    watch: &mut Watch<'_>,
) -> Result<Found<T>, Error> {
    let settings = [format!("{:e}", asked.error), format!("{:?}", asked.rows)];
    let mut words: Vec<&str> = settings.iter().map(String::as_str).collect();
    words.extend(T::KIND);
    let mut found = Found::<T>::new(part, facets_fingerprint(facets, &words));
    if asked.job.resume && part.exists() {
        found.resume(work, warnings)?;
    } else if part.exists() {
        let what = "finished work of an earlier run is there; --resume would go on with it";
        warnings.add(part.display().to_string(), what, 1);
    }
    let total: f64 = (0..work.batches()).map(|b| work.share(b)).sum();
    let total = total.max(f64::MIN_POSITIVE);
    let before = peak_memory_bytes();
    let mut held: u64 = found.batches.iter().map(T::memory).sum();
    let (began, start_share, mut kept_at) = (Instant::now(), found.share, Instant::now());
    loop {
        if before + held > asked.job.memory {
            found.keep_rest(work);
            let needed = before as f64 + held as f64 * total / found.share.max(1e-9 * total);
            return Err(too_much(facets, asked, &found, needed));
        }
        if found.batches.len() == work.batches() {
            return Ok(found);
        }
        let advanced = found.share - start_share;
        let status = Status {
            share: found.share / total,
            left_s: (advanced > 0.02 * total)
                .then(|| began.elapsed().as_secs_f64() * (total - found.share) / advanced),
            ..Status::begin(Stage::Factors)
        };
        let stop = watch(&status) == Control::Stop;
        if stop || kept_at.elapsed() > KEEP_EVERY {
            found.keep(work);
            kept_at = Instant::now();
        }
        if stop {
            return Ok(found);
        }
        let Some(batch) = watched::<T>(work, found.batches.len(), &status, watch) else {
            found.keep(work);
            return Ok(found);
        };
        held += batch.memory();
        found.add(batch, work);
    }
}

/// Why the work ends here, and what can be done.
fn too_much<T: Made>(facets: &Facets, asked: &Asked<'_>, found: &Found<T>, needed: f64) -> Error {
    let pairs: u64 = found.batches.iter().map(T::pairs).sum();
    let mut advice = format!("{pairs} pairs were found so far");
    if let Some(part) = found.kept_in() {
        advice += &format!(
            ", kept in {} (--resume with a larger --memory goes on; otherwise delete it)",
            part.display()
        );
    }
    if T::KIND.is_none() {
        advice += match asked.not_compressed() {
            None => "; --compressed takes all rows in a fraction of it, --rows 0..1000 takes some",
            Some(_) => "; take rows in parts (--rows 0..1000)",
        };
    }
    Error::FactorsMemory {
        scene: facets.name.clone(),
        needed_mb: needed as u64 / 1_000_000 + 1,
        bound_mb: asked.job.memory / 1_000_000,
        advice,
    }
}

/// Computes a batch and asks the watcher now and then; nothing if it wants no more.
fn watched<T: Made>(
    work: &FacetFactors,
    batch: usize,
    status: &Status,
    watch: &mut Watch<'_>,
) -> Option<T> {
    const EVERY: Duration = Duration::from_millis(50);
    std::thread::scope(|scope| {
        let (send, receive) = std::sync::mpsc::channel();
        scope.spawn(move || send.send(T::make(work, batch)));
        loop {
            match receive.recv_timeout(EVERY) {
                Ok(batch) => return Some(batch),
                Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {
                    if watch(status) == Control::Stop {
                        work.stop();
                        return None;
                    }
                }
                // The computing thread panicked; the scope passes that on.
                Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => return None,
            }
        }
    })
}

fn tally_of(counts: &Counts) -> Tally {
    [
        counts.free,
        counts.hidden,
        counts.shadowed,
        counts.pieces,
        counts.points,
        counts.error.to_bits(),
    ]
}

fn counts_of(tally: &Tally) -> Counts {
    let [free, hidden, shadowed, pieces, points, error] = *tally;
    Counts {
        free,
        hidden,
        shadowed,
        pieces,
        points,
        error: f64::from_bits(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_transport::facets::FacetSettings;
    use std::io::{self, ErrorKind};

    #[test]
    fn on_a_full_disk_kept_work_makes_room_and_is_never_lost() {
        let facets = luxel_scenes::floating_boxes(100);
        let work = FacetFactors::new(&facets, &FacetSettings::default());
        let folder = tempfile::tempdir().expect("a folder");
        let part = folder.path().join("f.npz.part");
        let all = || {
            let mut found = Found::<Batch>::new(&part, 7);
            for batch in 0..work.batches() {
                found.add(work.compute(batch), &work);
            }
            found.keep(&work);
            assert_eq!(found.kept_in(), Some(&*part));
            found
        };
        all();
        let kept = std::fs::read(&part).expect("there");
        // Fails as long as `wanted` says, and notes whether the file was there.
        let mut there = Vec::new();
        let mut run = |spare: bool, kind: ErrorKind, fails: usize| {
            there.clear();
            let written = all().write(&work, spare, || {
                there.push(part.exists());
                match there.len() > fails {
                    true => Ok(5),
                    false => Err(WriteError::System {
                        path: "f.npz".into(),
                        source: io::Error::from(kind),
                    }),
                }
            });
            (written.map_err(|e| e.to_string()), there.clone())
        };
        let full = ErrorKind::StorageFull;
        assert_eq!(run(true, full, 0), (Ok(5), vec![true]));
        assert_eq!(run(true, full, 1), (Ok(5), vec![true, false]));
        assert!(!part.exists());
        for (spare, kind, tried) in [
            (true, full, vec![true, false]),
            (false, full, vec![true]),
            (true, ErrorKind::PermissionDenied, vec![true]),
        ] {
            let (written, there) = run(spare, kind, 2);
            assert_eq!(there, tried);
            let told = written.expect_err("it fails");
            assert!(told.starts_with("f.npz: could not be written: "), "{told}");
            assert!(told.contains("; 100 % of the work is kept in "), "{told}");
            assert!(std::fs::read(&part).expect("there") == kept);
        }
    }
}
