//! Files that are whole or not there: written beside their place, then moved over it.
//!
//! A reader, a crash, a full disk or Ctrl-C never leaves half a file under its name: the bytes
//! go to a temporary file in the same folder, are forced to the disk, and the file is renamed,
//! which replaces the old one in one step.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// Tells the temporary files of one process apart.
static COUNTER: AtomicU32 = AtomicU32::new(0);

/// Writes a file whole, or leaves what was there before.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write_with(path, |out| out.write_all(bytes))
}

/// Writes a file whole by `fill`; if that fails, what was there before stays, and nothing else.
pub fn write_with(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    write_seeking(path, |out| fill(out)).map(|_| ())
}

/// Whether a file can be put there, as far as can be told without its bytes: the folder takes new
/// files, and no folder has the name.
pub fn try_place(path: &Path) -> io::Result<()> {
    if path.is_dir() {
        return Err(io::ErrorKind::IsADirectory.into());
    }
    let (folder, name) = placed(path)?;
    Unfinished::create(folder, name).map(|_| ())
}

/// As [`write_with`], for formats that go back to fill in a sum; returns the bytes of the file.
pub fn write_seeking(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<u64> {
    let (folder, name) = placed(path)?;
    let (guard, file) = Unfinished::create(folder, name)?;
    let mut out = BufWriter::with_capacity(1 << 18, file);
    fill(&mut out)?;
    let file = out.into_inner().map_err(|e| e.into_error())?;
    file.sync_all()?;
    let bytes = file.metadata()?.len();
    drop(file);
    fs::rename(&guard.path, path)?;
    std::mem::forget(guard);
    // The name is safe once the folder is on the disk, where the system can do that; the file is
    // whole either way.
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
    Ok(bytes)
}

/// Folder and name of a file.
fn placed(path: &Path) -> io::Result<(&Path, &std::ffi::OsStr)> {
    let name = path.file_name().ok_or_else(|| {
        io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("{} is no file name", path.display()),
        )
    })?;
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    Ok((folder, name))
}

/// A temporary file, removed unless it was moved to its place.
struct Unfinished {
    path: PathBuf,
}

impl Unfinished {
    fn create(folder: &Path, name: &std::ffi::OsStr) -> io::Result<(Unfinished, File)> {
        loop {
            let mut own = std::ffi::OsString::from(".");
            own.push(name);
            let number = COUNTER.fetch_add(1, Ordering::Relaxed);
            own.push(format!(".{}-{number}.part", std::process::id()));
            let path = folder.join(own);
            // Never over a file that is there: a link under that name would lead elsewhere.
            match OpenOptions::new().write(true).create_new(true).open(&path) {
                Ok(file) => return Ok((Unfinished { path }, file)),
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => continue,
                Err(e) => return Err(e),
            }
        }
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("out.bin");
        write(&path, b"old").expect("written");
        let failed = write_with(&path, |out| {
            out.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).expect("there"), b"old");
        assert_eq!(fs::read_dir(folder.path()).expect("readable").count(), 1);
        write(&path, b"new").expect("written");
        assert_eq!(fs::read(&path).expect("there"), b"new");
        assert_eq!(fs::read_dir(folder.path()).expect("readable").count(), 1);
    }

    #[test]
    fn a_place_is_tried_and_left_as_it_was() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("out.bin");
        write(&path, b"old").expect("written");
        try_place(&path).expect("writable");
        try_place(&folder.path().join("new")).expect("writable");
        assert_eq!(fs::read(&path).expect("there"), b"old");
        assert_eq!(fs::read_dir(folder.path()).expect("readable").count(), 1);
        for bad in [
            folder.path(),
            &path.join("x"),
            Path::new("no-such-folder/x"),
        ] {
            assert!(try_place(bad).is_err(), "{}", bad.display());
        }
    }

    #[test]
    fn a_path_without_a_name_or_folder_is_an_error() {
        assert!(write(Path::new(".."), b"x").is_err());
        assert!(write(Path::new("no-such-folder/x"), b"x").is_err());
    }
}
