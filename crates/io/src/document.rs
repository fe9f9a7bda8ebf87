//! A file read: the scene, what was odd, and what a writer of the same format needs.

use crate::budget::{Budget, readable};
use crate::error::Error;
use crate::options::ReadOptions;
use crate::{gltf_reader, obj_reader, uri};
use luxel_core::{Scene, Warnings};
use std::cell::RefCell;
use std::io::Read;
use std::path::{Path, PathBuf};

/// A scene file, read and made fit for lighting.
#[derive(Clone, Debug)]
pub struct Document {
    /// The scene.
    pub scene: Scene,
    /// Everything that was odd, with its place.
    pub warnings: Warnings,
    /// What the file holds beside the scene.
    pub source: Source,
    /// Triangles in the file, instances counted, before repairs.
    pub triangles_read: usize,
    /// The file and all that was read beside it; empty for a scene out of memory.
    pub files: Vec<PathBuf>,
}

/// What of the file is kept for writing it again.
#[derive(Clone, Debug)]
pub enum Source {
    /// A glTF file.
    Gltf(Box<GltfSource>),
    /// An OBJ file: nothing is kept.
    Obj,
}

/// A glTF file, as it was: for a writer that keeps what it does not know.
#[derive(Clone, Debug)]
pub struct GltfSource {
    /// The whole JSON, in its order.
    pub json: serde_json::Value,
    /// Bytes of each buffer, at least `byteLength` of them; empty where the file has none.
    pub buffers: Vec<Vec<u8>>,
    /// Pictures that lie beside the file, by image index; others are in `json` and `buffers`.
    ///
    /// Also pictures that the scene does not use (normal maps), when they can be read.
    pub images: Vec<Option<ExternalImage>>,
    /// Metres for each unit of length in the file.
    pub scale: f32,
}

/// A picture in a file of its own, undecoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExternalImage {
    /// `image/png` and so on; from the file's first bytes.
    pub mime: &'static str,
    /// The file.
    pub bytes: Vec<u8>,
}

/// Formats of scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// glTF 2.0, text or binary: the first bytes tell.
    Gltf,
    /// Wavefront OBJ.
    Obj,
}

impl Kind {
    /// By the extension of the name.
    pub fn of(path: &Path) -> Option<Kind> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "glb" | "gltf" => Some(Kind::Gltf),
            "obj" => Some(Kind::Obj),
            _ => None,
        }
    }
}

/// Bytes of another file that a scene names: takes the name and the largest size, in bytes, that
/// may be returned; answers why not.
pub type Resolver<'a> = dyn Fn(&str, u64) -> Result<Vec<u8>, String> + 'a;

/// Reads a `.glb`, `.gltf` or `.obj` file and the files that it names beside it.
///
/// Names that leave the file's folder (absolute paths, `..`, web addresses) are refused.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Document, Error> {
    let file = path.display().to_string();
    let kind = Kind::of(path).ok_or_else(|| {
        let found = path
            .extension()
            .map_or("no extension".into(), |e| format!(".{}", e.display()));
        Error::new("a scene file .glb, .gltf or .obj", found).in_file(&file)
    })?;
    let bytes = file_bytes(path, options.memory_limit)
        .map_err(|why| Error::new("a readable file", why).in_file(&file))?;
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let files = RefCell::new(vec![path.to_owned()]);
    let resolver = |name: &str, limit: u64| {
        let beside = folder.join(uri::path_inside(name)?);
        let bytes = file_bytes(&beside, limit)?;
        files.borrow_mut().push(beside);
        Ok(bytes)
    };
    let mut document = read_bytes(kind, &file, bytes, &resolver, options)?;
    document.files = files.into_inner();
    Ok(document)
}

/// Reads a scene out of memory. `name` stands in messages; its stem becomes the scene's name.
pub fn read_bytes(
    kind: Kind,
    name: &str,
    bytes: Vec<u8>,
    resolver: &Resolver<'_>,
    options: &ReadOptions,
) -> Result<Document, Error> {
    let mut budget = Budget::new(options.memory_limit);
    let read = || {
        if !(options.scale.is_finite() && options.scale > 0.0) {
            return Err(Error::new("a scale above 0", options.scale.to_string()));
        }
        budget.take(bytes.len(), 1)?;
        match kind {
            Kind::Gltf => gltf_reader::read(name, bytes, resolver, options, &mut budget),
            Kind::Obj => obj_reader::read(name, &bytes, resolver, options, &mut budget),
        }
    };
    read().map_err(|e| e.in_file(name))
}

/// A whole file of at most `limit` bytes, or why not.
pub(crate) fn file_bytes(path: &Path, limit: u64) -> Result<Vec<u8>, String> {
    let why = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::NotFound => "no such file".to_owned(),
        _ => e.to_string(),
    };
    let about = std::fs::metadata(path).map_err(why)?;
    if !about.is_file() {
        // A device or pipe may never end.
        return Err("a folder or device".into());
    }
    if about.len() > limit {
        let (size, limit) = (readable(about.len()), readable(limit));
        return Err(format!("{size}, more than the {limit} that may be used"));
    }
    let mut bytes = Vec::with_capacity(about.len() as usize);
    // The file may grow while it is read.
    std::fs::File::open(path)
        .map_err(why)?
        .take(limit)
        .read_to_end(&mut bytes)
        .map_err(why)?;
    Ok(bytes)
}
