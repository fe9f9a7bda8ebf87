//! Files into [`Facets`]: the rows of a view-factor matrix, numbered as their user numbers them.
//!
//! Unlike [`read`](crate::read) nothing is repaired, welded, dropped or put in another order: a
//! row is a facet of the file, in the file's order, in double precision. A polygon stays one
//! row whatever parts it is cut into; a facet without area keeps its row.
//!
//! - `stl`: ASCII and binary; `ply`; `obj`; `gltf`; `vs3`: input of View3D
//! - `parts`: polygons of any shape into convex planar ones; `outline`: what a ring encloses
//! - `numbers`: coordinates, and how well the file knows them

mod gltf;
mod numbers;
mod obj;
mod outline;
mod parts;
mod ply;
mod stl;
mod vs3;

use crate::budget::Budget;
use crate::document::{Resolver, file_bytes};
use crate::error::Error;
use crate::obj_reader::text::Lines;
use crate::solution_file::fingerprint_of_bytes;
use crate::uri;
use luxel_core::{DVec3, Facet, FacetPart, Facets, Polygon, Warnings};
use numbers::Numbers;
use parts::{Tolerance, convex_parts};
use std::cell::Cell;
use std::collections::HashMap;
use std::path::Path;

/// Formats of files with facets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FacetKind {
    /// Stereolithography, text or binary: the size tells.
    Stl,
    /// Polygon file format of Stanford, text or binary.
    Ply,
    /// Wavefront OBJ; its materials are not read.
    Obj,
    /// glTF 2.0, text or binary.
    Gltf,
    /// Input of View3D, geometries 3 and 3a.
    Vs3,
}

impl FacetKind {
    /// By the extension of the name.
    pub fn of(path: &Path) -> Option<FacetKind> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "stl" => Some(FacetKind::Stl),
            "ply" => Some(FacetKind::Ply),
            "obj" => Some(FacetKind::Obj),
            "glb" | "gltf" => Some(FacetKind::Gltf),
            "vs3" => Some(FacetKind::Vs3),
            _ => None,
        }
    }
}

/// How facets are read where the file leaves it open.
#[derive(Clone, Debug, PartialEq)]
pub struct FacetOptions {
    /// Metres for each unit of length in the file; above 0.
    pub scale: f64,
    /// Turns every facet over: corners that run clockwise become counter-clockwise.
    pub flip: bool,
    /// Bound for what reading may hold at once, bytes.
    pub memory: u64,
}

impl Default for FacetOptions {
    fn default() -> Self {
        FacetOptions {
            scale: 1.0,
            flip: false,
            memory: 4 << 30,
        }
    }
}

/// A file of facets, read.
#[derive(Clone, Debug, Default)]
pub struct FacetDocument {
    /// Rows and their parts; at least one row.
    pub facets: Facets,
    /// Everything that was odd, with its place.
    pub warnings: Warnings,
    /// Whether the file says that its facets enclose a room (VS3 `encl=1`).
    pub enclosed: bool,
    /// Emissivity of each row, 0..=1 (VS3); empty where the format has none.
    pub emissivity: Vec<f64>,
    /// Title in the file (VS3 `T`), or empty.
    pub title: String,
    /// What the file asks of a program (VS3 `C`): name in small letters and value, each name
    /// once, in the file's order.
    pub controls: Vec<(String, String)>,
    /// A number that changes with the bytes of the file and of those read beside it.
    pub fingerprint: u64,
}

impl FacetDocument {
    /// Value of a control, by its name in small letters.
    pub fn control(&self, name: &str) -> Option<&str> {
        let found = self.controls.iter().find(|c| c.0 == name)?;
        Some(&found.1)
    }
}

/// Reads the facets of a `.stl`, `.ply`, `.obj`, `.glb`, `.gltf` or `.vs3` file.
///
/// Buffers that a glTF names must lie in its folder or below.
pub fn read_facets(path: &Path, options: &FacetOptions) -> Result<FacetDocument, Error> {
    let file = path.display().to_string();
    let kind = FacetKind::of(path).ok_or_else(|| {
        let found = path
            .extension()
            .map_or("no extension".into(), |e| format!(".{}", e.display()));
        let expected = "a file of facets .stl, .ply, .obj, .glb, .gltf or .vs3";
        Error::new(expected, found).in_file(&file)
    })?;
    let bytes = file_bytes(path, options.memory)
        .map_err(|why| Error::new("a readable file", why).in_file(&file))?;
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let resolver =
        |name: &str, limit: u64| file_bytes(&folder.join(uri::path_inside(name)?), limit);
    read_facets_bytes(kind, &file, bytes, &resolver, options)
}

/// Reads facets out of memory. `name` stands in messages; its stem becomes the facets' name.
pub fn read_facets_bytes(
    kind: FacetKind,
    name: &str,
    bytes: Vec<u8>,
    resolver: &Resolver<'_>,
    options: &FacetOptions,
) -> Result<FacetDocument, Error> {
    let mut budget = Budget::new(options.memory);
    let fingerprint = Cell::new(fingerprint_of_bytes(0, &bytes));
    let noting = |name: &str, limit: u64| {
        let bytes = resolver(name, limit)?;
        fingerprint.set(fingerprint_of_bytes(fingerprint.get(), &bytes));
        Ok(bytes)
    };
    let mut read = || {
        if !(options.scale.is_finite() && options.scale > 0.0) {
            return Err(Error::new("a scale above 0", options.scale.to_string()));
        }
        budget.take(bytes.len(), 1)?;
        let input = Input {
            file: name,
            options,
        };
        match kind {
            FacetKind::Stl => stl::read(input, &bytes, &mut budget),
            FacetKind::Ply => ply::read(input, &bytes, &mut budget),
            FacetKind::Obj => obj::read(input, &bytes, &mut budget),
            FacetKind::Gltf => gltf::read(input, &bytes, &noting, &mut budget),
            FacetKind::Vs3 => vs3::read(input, &bytes, &mut budget),
        }
    };
    let mut document = read().map_err(|e| e.in_file(name))?;
    if document.facets.rows.is_empty() {
        return Err(Error::new("facets", "none").in_file(name));
    }
    let stem = Path::new(name).file_stem();
    document.facets.name = stem.map_or(String::new(), |s| s.to_string_lossy().into_owned());
    if options.flip {
        for part in &mut document.facets.parts {
            part.polygon.vertices.reverse();
        }
    }
    document.fingerprint = fingerprint.get();
    Ok(document)
}

/// What every format is told.
#[derive(Clone, Copy)]
struct Input<'a> {
    /// The file as the user named it.
    file: &'a str,
    options: &'a FacetOptions,
}

/// Bytes that a row takes beside its name: record, place, end of its ring.
const ROW_BYTES: usize = 32 + 8 + 8;
/// Bytes that a part takes beside its corners.
const PART_BYTES: usize = 32 + 16;

/// Rows that are being collected. Parts are made at the end, when the rounding is known.
struct Rows {
    rows: Vec<Facet>,
    objects: NameList,
    materials: NameList,
    /// Corners of all rows, in units of the file.
    corners: Vec<DVec3>,
    /// End of each row's corners.
    ends: Vec<usize>,
    /// Line of each row; empty where the format has no lines.
    lines: Vec<usize>,
}

impl Rows {
    fn new() -> Self {
        Rows {
            rows: Vec::new(),
            objects: NameList::default(),
            materials: NameList::default(),
            corners: Vec::new(),
            ends: Vec::new(),
            lines: Vec::new(),
        }
    }

    /// Adds a row. `line` for text, always or never.
    fn push(
        &mut self,
        corners: impl ExactSizeIterator<Item = DVec3>,
        object: u32,
        material: u32,
        line: Option<usize>,
        budget: &mut Budget,
    ) -> Result<(), Error> {
        // In the ring, and in the one part that most rows have.
        budget.take(corners.len(), 2 * 24)?;
        budget.take(1, ROW_BYTES + PART_BYTES)?;
        if self.rows.len() + 1 >= Facets::NO_ROW as usize {
            return Err(Error::new("less than 2^32 facets", "more"));
        }
        self.rows.push(Facet {
            name: String::new(),
            object,
            material,
        });
        self.corners.extend(corners);
        self.ends.push(self.corners.len());
        self.lines.extend(line);
        Ok(())
    }

    /// Makes the parts.
    fn into_document(
        self,
        input: Input<'_>,
        numbers: &Numbers,
        mut warnings: Warnings,
        budget: &mut Budget,
    ) -> Result<FacetDocument, Error> {
        let Rows {
            rows,
            objects,
            materials,
            corners,
            ends,
            lines,
        } = self;
        let mut facets = Facets {
            rows,
            objects: objects.list,
            materials: materials.list,
            rounding_m: numbers.rounding_m(),
            ..Facets::default()
        };
        facets.parts.reserve_exact(facets.rows.len());
        let tolerance = Tolerance {
            plane_m: 2.0 * facets.rounding_m,
            grain: numbers.grain(),
        };
        let mut odd = Oddities::default();
        let mut start = 0;
        let mut ring: Vec<DVec3> = Vec::new();
        for (row, &end) in ends.iter().enumerate() {
            ring.clear();
            let scaled = corners[start..end].iter();
            ring.extend(scaled.map(|p| *p * input.options.scale));
            start = end;
            let place = || match lines.get(row) {
                Some(line) => Spot::Line(*line),
                None => Spot::Facet(row + 1),
            };
            let parts = odd.cut(&ring, tolerance, place)?;
            if parts.len() > 1 {
                let held: usize = parts.iter().map(|p| p.vertices.len()).sum();
                budget.take(held, 24)?;
                budget.take(parts.len(), PART_BYTES)?;
            }
            facets
                .parts
                .extend(parts.into_iter().map(|polygon| FacetPart {
                    polygon,
                    row: row as u32,
                }));
        }
        odd.say(input.file, &mut warnings);
        Ok(FacetDocument {
            facets,
            warnings,
            ..FacetDocument::default()
        })
    }
}

/// Where a facet stands.
#[derive(Clone, Copy)]
enum Spot {
    Line(usize),
    /// From 1.
    Facet(usize),
}

impl Spot {
    fn of(self, file: &str) -> String {
        match self {
            Spot::Line(line) => format!("{file}:{line}"),
            Spot::Facet(number) => format!("{file}: facet {number}"),
        }
    }
}

/// One kind of odd facets: how many, and the first.
type Odd = Option<(usize, Spot)>;

fn count(odd: &mut Odd, spot: Spot) {
    odd.get_or_insert((0, spot)).0 += 1;
}

/// Facets that are odd in shape.
#[derive(Default)]
struct Oddities {
    without_area: Odd,
    bent: Odd,
    crossed: Odd,
    cancelled: Odd,
}

impl Oddities {
    /// The parts of a facet; counts what is odd about it.
    fn cut(
        &mut self,
        ring: &[DVec3],
        tolerance: Tolerance,
        spot: impl Fn() -> Spot,
    ) -> Result<Vec<Polygon>, Error> {
        let cut = convex_parts(ring, tolerance).map_err(|_| {
            let most = crate::obj_reader::polygon::MOST_CORNERS;
            let expected = format!("at most {most} corners of a polygon that is not convex");
            let error = Error::new(expected, ring.len().to_string());
            match spot() {
                Spot::Line(line) => error.at_line(line),
                Spot::Facet(number) => error.within(format!("facet {number}")),
            }
        })?;
        match (cut.parts.is_empty(), cut.crossed) {
            (true, true) => count(&mut self.cancelled, spot()),
            (true, false) => count(&mut self.without_area, spot()),
            (false, true) => count(&mut self.crossed, spot()),
            (false, false) => (),
        }
        if !cut.flat {
            count(&mut self.bent, spot());
        }
        Ok(cut.parts)
    }

    fn say(self, file: &str, warnings: &mut Warnings) {
        let kinds = [
            (
                self.without_area,
                "facets without area keep their rows, which see nothing; the first is here",
            ),
            (
                self.bent,
                "facets that are not flat were split into triangles; the first is here",
            ),
            (
                self.crossed,
                "facets whose outlines cross themselves were cut as they are; the first is here",
            ),
            (
                self.cancelled,
                "facets whose outlines cross themselves face neither way, and keep rows that see nothing; the first is here",
            ),
        ];
        for (odd, what) in kinds {
            if let Some((number, spot)) = odd {
                warnings.add(spot.of(file), what, number);
            }
        }
    }
}

/// Names, each once, in the order in which they came.
#[derive(Default)]
struct NameList {
    list: Vec<String>,
    index: HashMap<String, u32>,
}

impl NameList {
    /// The index of a name.
    fn id(&mut self, name: &str, budget: &mut Budget) -> Result<u32, Error> {
        if let Some(&known) = self.index.get(name) {
            return Ok(known);
        }
        budget.take(2, name.len() + 64)?;
        let fresh = self.list.len() as u32;
        self.list.push(name.to_owned());
        self.index.insert(name.to_owned(), fresh);
        Ok(fresh)
    }

    /// The index of a new thing, whose name others may have.
    fn another(&mut self, name: String, budget: &mut Budget) -> Result<u32, Error> {
        budget.take(1, name.len() + 32)?;
        self.list.push(name);
        Ok(self.list.len() as u32 - 1)
    }
}

/// Words of a text and the lines that they stand in.
struct Words<'a> {
    lines: Lines<'a>,
    rest: &'a str,
}

impl<'a> Words<'a> {
    fn new(text: &'a str) -> Self {
        Words {
            lines: Lines::new(text),
            rest: "",
        }
    }

    /// Line of the word that was read last, from 1.
    fn line(&self) -> usize {
        self.lines.number()
    }

    fn next(&mut self) -> Option<&'a str> {
        loop {
            let rest = self.rest.trim_start();
            if !rest.is_empty() {
                let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
                let (word, rest) = rest.split_at(end);
                self.rest = rest;
                return Some(word);
            }
            self.rest = self.lines.line()?;
        }
    }

    /// What stands in the line behind the word that was read last.
    fn rest_of_line(&mut self) -> &'a str {
        std::mem::take(&mut self.rest).trim()
    }
}
