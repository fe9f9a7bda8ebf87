//! Input of View3D, geometries 3 and 3a [View3D].
//!
//! A row is a surface `S`, in the file's order; surfaces that are combined share the row of the
//! lowest. A subsurface is cut out of its base, and both are rows. A null surface `N` is cut out
//! of its base too, and is no row; it still stands in the way there, as does an obstruction `O`.
//! Numbers of rows are not those of surfaces where some are combined or null: names tell.
//!
//! Masking surfaces, transformations and the geometries 1 and 2 are refused. Written after the
//! manual; an own reader since there is no other.

use super::numbers::{Numbers, found, number};
use super::parts::{Tolerance, size_of, subtract};
use super::{FacetDocument, Input, Oddities, PART_BYTES, ROW_BYTES, Spot};
use crate::budget::Budget;
use crate::error::{Error, clean};
use crate::obj_reader::polygon::area_vector;
use crate::obj_reader::text::{self, Lines};
use luxel_core::{DVec3, Facet, FacetPart, Facets, Polygon, Warnings};

/// Names on control lines.
const CONTROLS: [&str; 12] = [
    "eps", "maxu", "maxo", "mino", "row", "col", "encl", "emit", "out", "list", "prjd", "maxv",
];

/// Subsurfaces of one base above which a file is refused: each is cut out of all that is left.
const MOST_SUBSURFACES: usize = 1000;

/// Pieces that are looked at to cut subsurfaces out, in all: a few seconds.
const MOST_WORK: usize = 100_000_000;

/// How far a subsurface may lie off its base, in relation to the base's size.
const OFF_BASE: f64 = 1e-5;

/// Numbers of combined surfaces that a name tells.
const MOST_TOLD: usize = 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Surface,
    Null,
    Obstruction,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Geometry {
    /// Vertices, then surfaces.
    Vertices,
    /// Surfaces in planes with an azimuth and a tilt.
    Planes,
}

#[derive(Clone, Debug)]
struct Surface {
    kind: Kind,
    line: usize,
    /// Numbers of vertices, from 1; the last may be 0. Geometry 3.
    vertices: [u32; 4],
    /// Corners in the file's unit. Geometry 3a, and 3 once all vertices are read.
    corners: Vec<DVec3>,
    /// Number of its base, or 0.
    base: u32,
    /// Number of the surface that it is combined with, or 0.
    combined: u32,
    emissivity: f64,
    name: String,
}

/// A surface of geometry 3a whose numbers are being read.
struct Pending {
    surface: Surface,
    shape: char,
    /// Origin, azimuth, tilt; then what the shape needs.
    values: Vec<f64>,
}

impl Pending {
    fn needed(&self) -> usize {
        5 + match self.shape {
            'R' => 2,
            'T' => 6,
            _ => 8,
        }
    }
}

pub(super) fn read(
    input: Input<'_>,
    bytes: &[u8],
    budget: &mut Budget,
) -> Result<FacetDocument, Error> {
    budget.take(bytes.len(), 2)?;
    let text = text::decoded(bytes);
    if text::is_no_text(&text) {
        return Err(Error::new(
            "a text with lines T, C, F, V, S, N, O or E",
            text::NO_TEXT,
        ));
    }
    let mut reading = Reading {
        document: FacetDocument::default(),
        numbers: Numbers::new(input.options.scale, false),
        geometry: None,
        vertices: Vec::new(),
        surfaces: Vec::new(),
        pending: None,
        extra: None,
        unknown: None,
        budget,
    };
    let mut lines = Lines::new(&text);
    while let Some(line) = lines.line() {
        let number = lines.number();
        let go_on = reading.line(line, number).map_err(|e| e.at_line(number))?;
        if !go_on {
            break;
        }
    }
    if let Some(pending) = &reading.pending {
        let error = Error::new("the numbers of its plane and shape", "the end of the data");
        return Err(error.at_line(pending.surface.line));
    }
    reading.into_document(input)
}

struct Reading<'b> {
    document: FacetDocument,
    numbers: Numbers,
    geometry: Option<Geometry>,
    vertices: Vec<DVec3>,
    surfaces: Vec<Surface>,
    pending: Option<Pending>,
    /// Words behind the data of a line: how many lines, and the first.
    extra: super::Odd,
    /// Control names that View3D does not have.
    unknown: super::Odd,
    budget: &'b mut Budget,
}

/// Words of a line, without its comment.
type Line<'a> = std::iter::Peekable<Box<dyn Iterator<Item = &'a str> + 'a>>;

fn is_separator(c: char) -> bool {
    c.is_whitespace() || c == ','
}

fn words(line: &str) -> Line<'_> {
    let line = line.split('!').next().unwrap_or_default();
    let separated = line.split(is_separator);
    let all = separated.filter(|w| !w.is_empty());
    let iterator: Box<dyn Iterator<Item = &str>> =
        Box::new(all.take_while(|w| !w.starts_with('/')));
    iterator.peekable()
}

fn whole(words: &mut Line<'_>, expected: &str) -> Result<u32, Error> {
    let word = words.next();
    word.and_then(|w| w.parse().ok())
        .ok_or_else(|| Error::new(expected, found(word)))
}

impl Reading<'_> {
    /// Reads a line; false at the end of the data.
    fn line(&mut self, line: &str, number: usize) -> Result<bool, Error> {
        let mut words = words(line);
        if self.pending.is_some() {
            return self.plane(&mut words, number).map(|()| true);
        }
        let Some(word) = words.next() else {
            return Ok(true);
        };
        // Behind the separators the line begins with the word.
        let line = line.trim_start_matches(is_separator);
        let letter = word.chars().next().unwrap_or(' ').to_ascii_uppercase();
        // `End of data` is what most files say.
        match letter {
            'E' | '*' => return Ok(false),
            'T' => {
                let rest = line[word.len()..].trim_matches(is_separator);
                self.document.title = clean(rest);
                return Ok(true);
            }
            _ => {}
        }
        if word.len() > 1 {
            let expected = "T, C, F, V, S, N, O or E";
            return Err(Error::new(expected, found(Some(word))));
        }
        match letter {
            'C' => {
                self.controls(&line[word.len()..], number)?;
                return Ok(true);
            }
            'F' => self.format(words.next())?,
            'V' => self.vertex(&mut words)?,
            'S' => self.surface(Kind::Surface, &mut words, number)?,
            'N' => self.surface(Kind::Null, &mut words, number)?,
            'O' => self.surface(Kind::Obstruction, &mut words, number)?,
            _ => {
                let found = match letter {
                    'M' => "a masking surface M, which is not supported".into(),
                    'X' => "a transformation X, which is not supported".into(),
                    _ => found(Some(word)),
                };
                return Err(Error::new("T, C, F, V, S, N, O or E", found));
            }
        }
        self.note_extra(&mut words, number);
        Ok(true)
    }

    fn note_extra(&mut self, words: &mut Line<'_>, number: usize) {
        if words.peek().is_some() {
            super::count(&mut self.extra, Spot::Line(number));
        }
    }

    fn format(&mut self, word: Option<&str>) -> Result<(), Error> {
        if self.geometry.is_some() {
            return Err(Error::new("one line F", "a second one"));
        }
        self.geometry = Some(match word {
            Some("3") => Geometry::Vertices,
            Some("3a" | "3A") => Geometry::Planes,
            Some(other) => {
                let what = format!("geometry {}, which is not supported", clean(other));
                return Err(Error::new("geometry 3 or 3a", what));
            }
            None => return Err(Error::new("geometry 3 or 3a", found(None))),
        });
        Ok(())
    }

    fn controls(&mut self, line: &str, number: usize) -> Result<(), Error> {
        let line = line.replace('=', " ");
        let mut words = words(&line);
        while let Some(word) = words.next() {
            let name = word.to_ascii_lowercase();
            let value = words.next();
            let expected = format!("a number for '{}'", clean(word));
            let finite = super::numbers::number(value, &expected)?;
            if !finite.is_finite() {
                return Err(Error::new(expected, found(value)));
            }
            if !CONTROLS.contains(&name.as_str()) {
                super::count(&mut self.unknown, Spot::Line(number));
                continue;
            }
            if name == "encl" {
                self.document.enclosed = finite != 0.0;
            }
            let value = clean(value.unwrap_or_default());
            let controls = &mut self.document.controls;
            match controls.iter_mut().find(|c| c.0 == name) {
                Some(known) => known.1 = value,
                None => controls.push((name, value)),
            }
        }
        Ok(())
    }

    fn geometry(&self) -> Result<Geometry, Error> {
        let missing = || Error::new("a line F 3 or F 3a before this one", "none");
        self.geometry.ok_or_else(missing)
    }

    fn vertex(&mut self, words: &mut Line<'_>) -> Result<(), Error> {
        if self.geometry()? == Geometry::Planes {
            let found = "a vertex, which geometry 3a does not have";
            return Err(Error::new("a surface", found));
        }
        let next = self.vertices.len() + 1;
        let expected = format!("vertex {next}");
        let own = whole(words, &expected)?;
        if own as usize != next {
            return Err(Error::new(expected, format!("vertex {own}")));
        }
        let mut p = [0.0; 3];
        for slot in &mut p {
            *slot = self.numbers.word(words.next(), "3 coordinates")?;
        }
        self.budget.take(1, 24)?;
        self.vertices.push(DVec3::from_array(p));
        Ok(())
    }

    fn surface(&mut self, kind: Kind, words: &mut Line<'_>, line: usize) -> Result<(), Error> {
        let geometry = self.geometry()?;
        let next = self.surfaces.len() + 1;
        let expected = format!("surface {next}");
        let own = whole(words, &expected)?;
        if own as usize != next {
            return Err(Error::new(expected, format!("surface {own}")));
        }
        let mut surface = Surface {
            kind,
            line,
            vertices: [0; 4],
            corners: Vec::new(),
            base: 0,
            combined: 0,
            emissivity: 0.0,
            name: String::new(),
        };
        let mut shape = ' ';
        match geometry {
            Geometry::Vertices => {
                for slot in &mut surface.vertices {
                    *slot = whole(words, "the numbers of 4 vertices")?;
                }
            }
            Geometry::Planes => {
                let word = words.next();
                shape = match word {
                    Some("R" | "r") => 'R',
                    Some("Q" | "q") => 'Q',
                    Some("T" | "t") => 'T',
                    _ => return Err(Error::new("shape R, Q or T", found(word))),
                };
            }
        }
        // An obstruction needs no more.
        if kind != Kind::Obstruction || words.peek().is_some() {
            surface.base = whole(words, "the number of a base, or 0")?;
            surface.combined = whole(words, "the number of a surface to combine with, or 0")?;
        }
        if kind != Kind::Obstruction || words.peek().is_some() {
            let word = words.next();
            let expected = "an emissivity, 0 to 1";
            surface.emissivity = number(word, expected)?;
            if !(0.0..=1.0).contains(&surface.emissivity) {
                return Err(Error::new(expected, found(word)));
            }
        }
        surface.name = words.next().map_or_else(|| own.to_string(), clean);
        self.check_references(&surface)?;
        // Record, corners, parts, and what a row takes.
        let held = 2 * size_of_val(&surface) + ROW_BYTES + PART_BYTES + 4 * 24 * 3;
        self.budget.take(1, held + surface.name.len())?;
        match geometry {
            Geometry::Vertices => self.surfaces.push(surface),
            Geometry::Planes => {
                self.pending = Some(Pending {
                    surface,
                    shape,
                    values: Vec::with_capacity(13),
                });
            }
        }
        Ok(())
    }

    /// What can be said of base and combination before the rest is read.
    fn check_references(&self, surface: &Surface) -> Result<(), Error> {
        let own = self.surfaces.len() as u32 + 1;
        let Surface { base, combined, .. } = *surface;
        match (surface.kind, base) {
            (Kind::Obstruction, 1..) => {
                let what = format!("base {base} of an obstruction");
                return Err(Error::new("no base", what));
            }
            (Kind::Null, 0) => {
                return Err(Error::new("the base of a null surface", "none"));
            }
            _ => {}
        }
        if combined == 0 {
            return Ok(());
        }
        if surface.kind != Kind::Surface {
            let what = format!("{combined} for what is no row");
            return Err(Error::new("no surface to combine with", what));
        }
        if combined >= own {
            let expected = format!("a surface before {own} to combine with");
            return Err(Error::new(expected, format!("surface {combined}")));
        }
        let other = &self.surfaces[combined as usize - 1];
        let what = if other.kind != Kind::Surface {
            "which is no row"
        } else if other.combined != 0 {
            "which is combined itself"
        } else {
            return Ok(());
        };
        let found = format!("surface {combined}, {what}");
        Err(Error::new("a surface S with a row of its own", found))
    }

    /// Numbers of the surface of geometry 3a that is being read.
    fn plane(&mut self, words: &mut Line<'_>, line: usize) -> Result<(), Error> {
        let Some(mut pending) = self.pending.take() else {
            return Ok(());
        };
        while pending.values.len() < pending.needed() {
            let Some(word) = words.next() else {
                self.pending = Some(pending);
                return Ok(());
            };
            let expected = format!(
                "{} numbers of the plane and the shape of surface {}",
                pending.needed(),
                self.surfaces.len() + 1
            );
            let value = match pending.values.len() {
                3 | 4 => {
                    let angle = number(Some(word), &expected)?;
                    if !angle.is_finite() {
                        return Err(Error::new("a finite angle", found(Some(word))));
                    }
                    angle
                }
                _ => self.numbers.word(Some(word), &expected)?,
            };
            let size = pending.shape == 'R' && pending.values.len() >= 5;
            if size && value < 0.0 {
                let expected = "a width and a height from 0";
                return Err(Error::new(expected, found(Some(word))));
            }
            pending.values.push(value);
        }
        self.note_extra(words, line);
        let Pending {
            mut surface,
            shape,
            values,
        } = pending;
        surface.corners = corners_in_plane(shape, &values);
        for value in surface.corners.iter().flat_map(|p| p.to_array()) {
            self.numbers.stored(value)?;
        }
        self.surfaces.push(surface);
        Ok(())
    }

    /// Corners of geometry 3 from the vertices.
    fn resolve_vertices(&mut self) -> Result<(), Error> {
        let count = self.vertices.len();
        for surface in &mut self.surfaces {
            let used = match surface.vertices {
                [_, _, _, 0] => 3,
                _ => 4,
            };
            let of = |&k: &u32| {
                let place = (k as usize).checked_sub(1);
                let found = place.and_then(|k| self.vertices.get(k));
                found.copied().ok_or_else(|| {
                    let expected = match count {
                        0 => "vertices".to_owned(),
                        _ => format!("the number of a vertex, 1 to {count}"),
                    };
                    Error::new(expected, k.to_string()).at_line(surface.line)
                })
            };
            let corners = surface.vertices[..used].iter().map(of);
            surface.corners = corners.collect::<Result<_, _>>()?;
        }
        Ok(())
    }

    fn into_document(mut self, input: Input<'_>) -> Result<FacetDocument, Error> {
        if self.geometry == Some(Geometry::Vertices) {
            self.resolve_vertices()?;
        }
        let rounding_m = self.numbers.rounding_m();
        let tolerance = Tolerance {
            plane_m: 2.0 * rounding_m,
            grain: self.numbers.grain(),
        };
        let mut odd = Oddities::default();
        let mut whole: Vec<Vec<Polygon>> = Vec::with_capacity(self.surfaces.len());
        for surface in &mut self.surfaces {
            for p in &mut surface.corners {
                *p *= input.options.scale;
            }
            let spot = || Spot::Line(surface.line);
            let parts = odd.cut(&surface.corners, tolerance, spot)?;
            whole.push(parts);
        }
        let mut pieces = whole.clone();
        let mut work = 0;
        for (base, children) in self.children()? {
            let holder = &self.surfaces[base];
            let slack = (OFF_BASE * size_of(&holder.corners)).max(tolerance.plane_m);
            // What is left beside a subsurface is kept however thin the file can say it.
            let thin = (tolerance.grain * size_of(&holder.corners)).max(tolerance.plane_m);
            let normal = area_vector(&holder.corners).normalize_or_zero();
            let off = off_plane(&holder.corners, holder, normal);
            if off > slack {
                let expected = format!("a flat surface {} below others", base + 1);
                let found = format!("a corner {off:.6} m off its plane");
                return Err(Error::new(expected, found).at_line(holder.line));
            }
            for child in children {
                let surface = &self.surfaces[child];
                let held: usize = pieces[base].iter().map(|p| p.vertices.len()).sum();
                check_lies_on(surface, holder, base + 1, normal, slack)
                    .map_err(|e| e.at_line(surface.line))?;
                let (mut area, mut taken) = (0.0, 0.0);
                for cutter in &whole[child] {
                    work += pieces[base].len();
                    area += cutter.area();
                    taken += subtract(&mut pieces[base], cutter, normal, thin);
                }
                if work > MOST_WORK {
                    let expected = "subsurfaces that leave less pieces of their bases";
                    let found = format!("{} of base {}", pieces[base].len(), base + 1);
                    return Err(Error::new(expected, found).at_line(surface.line));
                }
                let around = 4.0 * size_of(&surface.corners);
                if taken < area - slack * around {
                    let expected =
                        format!("a subsurface within base {} and clear of others", base + 1);
                    let found = format!("{taken:.6} m² of its {area:.6} m² there");
                    return Err(Error::new(expected, found).at_line(surface.line));
                }
                let now: usize = pieces[base].iter().map(|p| p.vertices.len()).sum();
                let more = now.saturating_sub(held);
                self.budget.take(more, 24 + PART_BYTES)?;
            }
        }
        self.put_together(input, pieces, odd, rounding_m)
    }

    /// Bases, from the lowest, and the surfaces on each.
    fn children(&self) -> Result<Vec<(usize, Vec<usize>)>, Error> {
        let mut of: Vec<Vec<usize>> = vec![Vec::new(); self.surfaces.len()];
        for (k, surface) in self.surfaces.iter().enumerate() {
            let base = surface.base as usize;
            if base == 0 {
                continue;
            }
            let wrong = |expected: &str, found: String| {
                Err(Error::new(expected, found).at_line(surface.line))
            };
            let Some(holder) = self.surfaces.get(base - 1) else {
                let expected = format!("a base from 1 to {}", self.surfaces.len());
                return wrong(&expected, base.to_string());
            };
            match holder.kind {
                Kind::Null => {
                    let expected = "a base that is a surface or an obstruction";
                    return wrong(expected, format!("null surface {base}"));
                }
                // Obstructions come last: only what lies on surfaces has its base before it.
                Kind::Surface if base > k => {
                    let expected = format!("a base before surface {}", k + 1);
                    return wrong(&expected, base.to_string());
                }
                _ => {}
            }
            if of[base - 1].len() >= MOST_SUBSURFACES {
                let expected = format!("at most {MOST_SUBSURFACES} surfaces on base {base}");
                return wrong(&expected, "more".into());
            }
            of[base - 1].push(k);
        }
        let all = of.into_iter().enumerate();
        Ok(all.filter(|(_, list)| !list.is_empty()).collect())
    }

    /// Rows, parts and warnings.
    fn put_together(
        mut self,
        input: Input<'_>,
        pieces: Vec<Vec<Polygon>>,
        odd: Oddities,
        rounding_m: f64,
    ) -> Result<FacetDocument, Error> {
        let mut facets = Facets {
            objects: vec![String::new()],
            materials: vec![String::new()],
            rounding_m,
            ..Facets::default()
        };
        let mut emissivity: Vec<f64> = Vec::new();
        // Sums over what a row is combined of: area, area times emissivity.
        let mut sums: Vec<[f64; 2]> = Vec::new();
        let mut numbers: Vec<Vec<usize>> = Vec::new();
        let mut row_of = vec![Facets::NO_ROW; self.surfaces.len()];
        let mut mixed = None;
        let mut covered = None;
        for (k, (surface, parts)) in self.surfaces.iter_mut().zip(pieces).enumerate() {
            let spot = Spot::Line(surface.line);
            if surface.kind == Kind::Surface {
                let combined = (surface.combined as usize).checked_sub(1);
                let row = match combined {
                    Some(other) => row_of[other],
                    None => facets.rows.len() as u32,
                };
                row_of[k] = row;
                if combined.is_none() {
                    facets.rows.push(Facet {
                        name: std::mem::take(&mut surface.name),
                        object: 0,
                        material: 0,
                    });
                    emissivity.push(surface.emissivity);
                    sums.push([0.0; 2]);
                    numbers.push(Vec::new());
                } else if emissivity[row as usize] != surface.emissivity {
                    super::count(&mut mixed, spot);
                }
                let area: f64 = parts.iter().map(Polygon::area).sum();
                let sum = &mut sums[row as usize];
                sum[0] += area;
                sum[1] += area * surface.emissivity;
                numbers[row as usize].push(k + 1);
                if parts.is_empty() && size_of_area(&surface.corners) {
                    super::count(&mut covered, spot);
                }
            }
            let row = row_of[k];
            let parts = parts.into_iter();
            facets
                .parts
                .extend(parts.map(|polygon| FacetPart { polygon, row }));
        }
        for (row, numbers) in numbers.iter().enumerate() {
            let [area, weighted] = sums[row];
            if numbers.len() < 2 {
                continue;
            }
            if area > 0.0 {
                // Rounding must not carry it beyond 1.
                emissivity[row] = (weighted / area).clamp(0.0, 1.0);
            }
            let told = numbers.iter().take(MOST_TOLD).map(usize::to_string);
            let mut list = told.collect::<Vec<_>>().join("+");
            if numbers.len() > MOST_TOLD {
                list.push_str("+…");
            }
            let name = &mut facets.rows[row].name;
            *name = format!("{name} ({list})");
        }
        let mut warnings = Warnings::default();
        odd.say(input.file, &mut warnings);
        let others = [
            (
                covered,
                "surfaces are covered by their subsurfaces and have no area left; the first is here",
            ),
            (
                mixed,
                "combined surfaces differ in emissivity: the mean by area is taken; the first is here",
            ),
            (
                self.extra,
                "words behind the data were ignored; the first are here",
            ),
            (
                self.unknown,
                "controls that View3D does not have were ignored; the first is here",
            ),
        ];
        for (odd, what) in others {
            if let Some((number, spot)) = odd {
                warnings.add(spot.of(input.file), what, number);
            }
        }
        self.document.facets = facets;
        self.document.emissivity = emissivity;
        self.document.warnings = warnings;
        Ok(self.document)
    }
}

fn size_of_area(corners: &[DVec3]) -> bool {
    area_vector(corners).length() > 0.0
}

/// Sine and cosine of an angle in degrees, exact at right angles.
fn sine_cosine(angle_deg: f64) -> (f64, f64) {
    match angle_deg.rem_euclid(360.0) {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        a => a.to_radians().sin_cos(),
    }
}

/// Corners of a surface of geometry 3a.
///
/// The azimuth of the normal runs clockwise from north, which is y; a tilt of 0 faces up, 90 is
/// upright. In the plane, x runs to the right as seen from the front and y upwards.
fn corners_in_plane(shape: char, values: &[f64]) -> Vec<DVec3> {
    let origin = DVec3::new(values[0], values[1], values[2]);
    let (east, north) = sine_cosine(values[3]);
    let (level, up) = sine_cosine(values[4]);
    let normal = DVec3::new(level * east, level * north, up);
    let x_axis = DVec3::new(-north, east, 0.0);
    let y_axis = normal.cross(x_axis);
    let at = |x: f64, y: f64| origin + x_axis * x + y_axis * y;
    let rest = &values[5..];
    match shape {
        'R' => {
            let (w, h) = (rest[0], rest[1]);
            vec![at(0.0, 0.0), at(w, 0.0), at(w, h), at(0.0, h)]
        }
        _ => rest.chunks_exact(2).map(|p| at(p[0], p[1])).collect(),
    }
}

/// How far corners lie off the plane of a base, metres.
fn off_plane(corners: &[DVec3], base: &Surface, normal: DVec3) -> f64 {
    let off = |p: &DVec3| (*p - base.corners[0]).dot(normal).abs();
    corners.iter().map(off).fold(0.0, f64::max)
}

/// A subsurface lies in the plane of its base; what radiates faces where the base does.
fn check_lies_on(
    surface: &Surface,
    holder: &Surface,
    base: usize,
    normal: DVec3,
    slack: f64,
) -> Result<(), Error> {
    let off = off_plane(&surface.corners, holder, normal);
    if off > slack {
        let expected = format!("a subsurface in the plane of base {base}");
        return Err(Error::new(expected, format!("one {off:.6} m off it")));
    }
    let turned = area_vector(&surface.corners).dot(normal) < 0.0;
    if turned && surface.kind == Kind::Surface {
        let expected = format!("a subsurface that faces where base {base} does");
        return Err(Error::new(expected, "one that faces the other way"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::{FacetDocument, FacetKind, FacetOptions, read_facets_bytes};
    use luxel_core::{DVec3, Facets};

    fn read(text: &str) -> Result<FacetDocument, String> {
        let alone = |name: &str, _: u64| Err(format!("no file {name}"));
        let options = FacetOptions::default();
        let bytes = text.as_bytes().to_vec();
        read_facets_bytes(FacetKind::Vs3, "t.vs3", bytes, &alone, &options)
            .map_err(|e| e.to_string())
    }

    fn said(d: &FacetDocument) -> Vec<String> {
        d.warnings.iter().map(|w| w.to_string()).collect()
    }

    /// An L-shaped room as vertices and surfaces. Two surfaces are combined with each of 7 and 8.
    const ROOM: &str = "T  An L-shaped room \\\nC  encl=1 list = 2 eps=1.e-4 maxU=8 emit=1\n! \\\nF  3\n\
        !  #   x    y    z\n\
        V  1   0.   3.   3.\nV  2   1.   3.   3.\nV  3   0.   3.   0.\nV  4   1.   3.   0.\n\
        V  5   0.   1.   0.\nV  6   1.   1.   0.\nV  7   3.   1.   0.\nV  8   0.   0.   0.\n\
        V  9   1.   0.   0.\nV 10   3.   0.   0.\nV 11   0.   0.   3.\nV 12   1.   0.   3.\n\
        V 13   3.   0.   3.\nV 14   0.   1.   3.\nV 15   1.   1.   3.\nV 16   3.   1.   3.\n\
        S  1   11  13  10   8   0   0   0.90  srf-1\nS  2   10  13  16   7   0   0   0.90  srf-2\n\
        S  3    6   7  16  15   0   0   0.90  srf-3\nS  4    4   6  15   2   0   0   0.90  srf-4\n\
        S  5    3   4   2   1   0   0   0.90  srf-5\nS  6    8   3   1  11   0   0   0.90  srf-6\n\
        S  7   11  14  15  12   0   0   0.90  srf-7\nS  8    8   9   6   5   0   0   0.90  srf-8\n\
        S  9    1   2  15  14   0   7   0.90  srf-7b    ! combined\n\
        S 10   15  16  13  12   0   7   0.90  srf-7c\nS 11    5   6   4   3   0   8   0.90  srf-8b\n\
        S 12    9  10   7   6   0   8   0.50  srf-8c\nEnd of data\nS 13 nonsense\n";

    /// The same room as planes.
    const PLANES: &str = "T The same\nC encl=1\nF 3a\n\
        S  1  R   0   0  0.90  srf-1\n  3. 0. 0.    0  90    3. 3.\n\
        S  2  R   0   0  0.90  srf-2\n  3. 1. 0.  270  90    1. 3.\n\
        S  3  r   0   0  0.90  srf-3\n  1. 1. 0.  180  90    2. 3.\n\
        S  4  R   0   0  0.90  srf-4\n  1. 3. 0.  270  90    2. 3.\n\
        S  5  R   0   0  0.90  srf-5\n  0. 3. 0.  180  90    1. 3.\n\
        S  6  R   0   0  0.90  srf-6\n  0. 0. 0.   90  90    3. 3.\n\
        S  7  Q   0   0  0.90  srf-7\n  3. 0. 3.    0  180 \n  2. 0.   3. 0.   3. 1.   2. 1.\n\
        S  8  Q   0   0  0.90  srf-8\n  0. 0. 0.  180   0 \n  0. 0.   1. 0.   1. 1.   0. 1.\n\
        S  9  Q   0   7  0.90  srf-7b\n  3. 0. 3.    0  180 \n! between\n\n  2. 1.   3. 1.   3. 3.   2. 3.\n\
        S 10  Q   0   7  0.90  srf-7c\n  3. 0. 3.    0  180 \n  0. 0.   2. 0.   2. 1.   0. 1.\n\
        S 11  Q   0   8  0.90  srf-8b\n  0. 0. 0.  180.  0.\n  0. 1.   1. 1.   1. 3.   0. 3.\n\
        S 12  q   0   8  0.50  srf-8c\n  0. 0. 0.  180.  0.\n  1. 0.   3. 0.   3. 1.   1. 1.\n";

    /// Corners from the lowest on, in the same turn.
    fn canonical(corners: &[DVec3]) -> Vec<[f64; 3]> {
        let mut ring: Vec<[f64; 3]> = corners
            .iter()
            .map(|p| (*p + DVec3::ZERO).to_array())
            .collect();
        let lowest = (0..ring.len())
            .min_by(|&a, &b| ring[a].partial_cmp(&ring[b]).expect("finite"))
            .expect("corners");
        ring.rotate_left(lowest);
        ring
    }

    #[test]
    fn both_geometries_describe_the_same_room() {
        let (a, b) = (read(ROOM).unwrap(), read(PLANES).unwrap());
        assert_eq!(a.facets.parts.len(), 12);
        assert_eq!(b.facets.parts.len(), 12);
        for (p, q) in a.facets.parts.iter().zip(&b.facets.parts) {
            assert_eq!(p.row, q.row);
            assert_eq!(
                canonical(&p.polygon.vertices),
                canonical(&q.polygon.vertices)
            );
        }
        // A closed surface: the area vectors add up to nothing.
        let sum: DVec3 = a.facets.parts.iter().map(|p| p.polygon.area_vector()).sum();
        assert!(sum.length() < 1e-12);
        let names: Vec<&str> = a.facets.rows.iter().map(|r| r.name.as_str()).collect();
        assert_eq!(names[6..], ["srf-7 (7+9+10)", "srf-8 (8+11+12)"]);
        assert_eq!(a.facets.areas()[6..], [5.0, 5.0]);
        // 1 m² and 2 m² of 0.9, 2 m² of 0.5.
        assert!((a.emissivity[7] - 0.74).abs() < 1e-12);
        assert!(a.enclosed && b.enclosed);
        assert_eq!(a.title, "An L-shaped room \\");
        assert_eq!(a.control("maxu"), Some("8"));
        assert_eq!(a.control("eps"), Some("1.e-4"));
        assert_eq!(a.control("row"), None);
        assert_eq!(said(&a).len(), 1);
        assert!(
            said(&a)[0].starts_with("t.vs3:33: combined surfaces differ"),
            "{:?}",
            said(&a)
        );
    }

    #[test]
    fn tilts_and_triangles() {
        // A roof facing south-east at 45 degrees: the normal is (1, -1, sqrt 2) / 2.
        let d = read("F 3a\nS 1 T 0 0 .9 roof\n1 2 3 135 45 0 0 2 0 0 1\n").unwrap();
        let p = &d.facets.parts[0].polygon;
        let expected = DVec3::new(0.5, -0.5, 0.5f64.sqrt());
        assert!((p.normal() - expected).length() < 1e-12);
        assert!((p.area() - 1.0).abs() < 1e-12);
        // To the right, seen from the south-east, is north-east.
        let right = (p.vertices[1] - p.vertices[0]).normalize();
        assert!((right - DVec3::new(1.0, 1.0, 0.0).normalize()).length() < 1e-12);
        assert!(p.vertices[2].z > 3.5);
    }

    /// A wall of 4 x 3 with what is given, from vertex 5 on and from surface 2 on.
    fn wall(vertices: &str, surfaces: &str) -> String {
        format!(
            "F 3\nV 1 0 0 0\nV 2 4 0 0\nV 3 4 3 0\nV 4 0 3 0\n{vertices}S 1 1 2 3 4 0 0 .9 wall\n{surfaces}"
        )
    }

    const SQUARE: &str = "V 5 1 1 0\nV 6 2 1 0\nV 7 2 2 0\nV 8 1 2 0\n";

    #[test]
    fn a_window_is_cut_out_of_its_wall_and_a_pane_out_of_the_window() {
        let pane = "V 9 1 1 0\nV 10 1.5 1 0\nV 11 1.5 1.5 0\nV 12 1 1.5 0\n";
        let text = wall(
            &format!("{SQUARE}{pane}"),
            "S 2 5 6 7 8 1 0 .8 window\nS 3 9 10 11 12 2 0 .7 pane\n",
        );
        let d = read(&text).unwrap();
        assert_eq!(d.facets.areas(), [11.0, 0.75, 0.25]);
        assert_eq!(d.emissivity, [0.9, 0.8, 0.7]);
        assert!(
            d.facets
                .parts
                .iter()
                .all(|p| p.polygon.normal() == DVec3::Z)
        );
        assert!(d.warnings.is_empty(), "{:?}", d.warnings);
    }

    #[test]
    fn a_null_surface_is_no_row_but_stands_there() {
        for corners in ["5 6 7 8", "8 7 6 5"] {
            let text = wall(SQUARE, &format!("N 2 {corners} 1 0 .8 hole\n"));
            let d = read(&text).unwrap();
            assert_eq!(d.facets.areas(), [11.0]);
            let blocking = d.facets.parts.iter().filter(|p| p.row == Facets::NO_ROW);
            assert_eq!(blocking.map(|p| p.polygon.area()).sum::<f64>(), 1.0);
        }
    }

    #[test]
    fn an_obstruction_blocks_and_carries_surfaces() {
        let text = wall(SQUARE, "S 2 5 6 7 8 3 0 .8 window\nO 3 1 2 3 4\n");
        let d = read(&text.replace("S 1 1 2 3 4", "S 1 4 3 2 1")).unwrap();
        assert_eq!(d.facets.areas(), [12.0, 1.0]);
        let blocking = d.facets.parts.iter().filter(|p| p.row == Facets::NO_ROW);
        assert_eq!(blocking.map(|p| p.polygon.area()).sum::<f64>(), 11.0);
    }

    #[test]
    fn a_wall_that_is_all_window_keeps_its_row() {
        let d = read(&wall("", "S 2 1 2 3 4 1 0 .8 glass\n")).unwrap();
        assert_eq!(d.facets.areas(), [0.0, 12.0]);
        assert!(
            said(&d)[0].starts_with("t.vs3:6: surfaces are covered"),
            "{:?}",
            said(&d)
        );
    }

    #[test]
    fn words_behind_the_data_and_unknown_controls_are_said() {
        let d = read(&format!(
            "C foo=1 eps=1e-3\n{}",
            wall("", "S 2 1 2 3 0 0 0 .9 a b c\n")
        ));
        let said = said(&d.unwrap());
        assert_eq!(said.len(), 2, "{said:?}");
        assert!(said[0].starts_with("t.vs3:8: words behind"), "{said:?}");
        assert!(said[1].starts_with("t.vs3:1: controls"), "{said:?}");
    }

    #[test]
    fn errors_name_the_line_and_what_is_refused() {
        let outside = "V 5 1 1 0\nV 6 9 1 0\nV 7 9 2 0\nV 8 1 2 0\n";
        let off = "V 5 1 1 1\nV 6 2 1 1\nV 7 2 2 1\nV 8 1 2 1\n";
        let planes = "F 3a\nS 1 R 0 0 .9 a\n";
        for (text, message) in [
            (
                wall("V 6 0 0 0\n", ""),
                "t.vs3:6: expected vertex 5, found vertex 6",
            ),
            (
                wall("V 4 0 0 0\n", ""),
                "t.vs3:6: expected vertex 5, found vertex 4",
            ),
            (
                wall("V 5 0 0\n", ""),
                "t.vs3:6: expected 3 coordinates, found the end of the line",
            ),
            (
                wall("V 5 0 0 1e999\n", ""),
                "t.vs3:6: expected a finite coordinate, found '1e999'",
            ),
            (
                wall("", "S 3 1 2 3 4 0 0 .9 b\n"),
                "t.vs3:7: expected surface 2, found surface 3",
            ),
            (
                wall("", "S 2 1 2 3 9 0 0 .9 b\n"),
                "t.vs3:7: expected the number of a vertex, 1 to 4, found 9",
            ),
            (
                wall("", "S 2 1 0 3 4 0 0 .9 b\n"),
                "t.vs3:7: expected the number of a vertex, 1 to 4, found 0",
            ),
            (
                wall("", "S 2 1 2 3 4 0 0 1.5 b\n"),
                "t.vs3:7: expected an emissivity, 0 to 1, found '1.5'",
            ),
            (
                wall("", "M 2 4 3 2 1 1 0 .9 b\n"),
                "t.vs3:7: expected T, C, F, V, S, N, O or E, found a masking surface M, which is \
                 not supported",
            ),
            (
                wall("", "X 1\n"),
                "t.vs3:7: expected T, C, F, V, S, N, O or E, found a transformation X, which is \
                 not supported",
            ),
            (
                "T x\nF 2\n".into(),
                "t.vs3:2: expected geometry 3 or 3a, found geometry 2, which is not supported",
            ),
            (
                "V 1 0 0 0\n".into(),
                "t.vs3:1: expected a line F 3 or F 3a before this one, found none",
            ),
            (
                "F 3a\nV 1 0 0 0\n".into(),
                "t.vs3:2: expected a surface, found a vertex, which geometry 3a does not have",
            ),
            (
                "C eps=x\n".into(),
                "t.vs3:1: expected a number for 'eps', found 'x'",
            ),
            (
                wall("", "S 2 1 2 3 4 0 3 .9 b\n"),
                "t.vs3:7: expected a surface before 2 to combine with, found surface 3",
            ),
            (
                wall("", "S 2 1 2 3 4 0 1 .9 b\nS 3 1 2 3 4 0 2 .9 c\n"),
                "t.vs3:8: expected a surface S with a row of its own, found surface 2, which is \
                 combined itself",
            ),
            (
                wall(SQUARE, "N 2 5 6 7 8 0 0 .9 b\n"),
                "t.vs3:7: expected the base of a null surface, found none"
                    .replace(":7", ":11")
                    .leak(),
            ),
            (
                wall(SQUARE, "S 2 5 6 7 8 9 0 .9 b\n"),
                "t.vs3:11: expected a base from 1 to 2, found 9",
            ),
            (
                wall(SQUARE, "S 2 5 6 7 8 3 0 .9 b\nS 3 1 2 3 4 0 0 .9 c\n"),
                "t.vs3:11: expected a base before surface 2, found 3",
            ),
            (
                wall(SQUARE, "S 2 8 7 6 5 1 0 .9 b\n"),
                "t.vs3:11: expected a subsurface that faces where base 1 does, found one that \
                 faces the other way",
            ),
            (
                wall(off, "S 2 5 6 7 8 1 0 .9 b\n"),
                "t.vs3:11: expected a subsurface in the plane of base 1, found one 1.000000 m off it",
            ),
            (
                wall(SQUARE, "S 2 5 6 7 8 1 0 .9 b\n").replace("V 3 4 3 0", "V 3 4 3 1"),
                "t.vs3:10: expected a flat surface 1 below others, found a corner 0.489490 m off \
                 its plane",
            ),
            (
                wall(outside, "S 2 5 6 7 8 1 0 .9 b\n"),
                "t.vs3:11: expected a subsurface within base 1 and clear of others, found \
                 3.000000 m² of its 8.000000 m² there",
            ),
            (
                wall(SQUARE, "S 2 5 6 7 8 1 0 .9 b\nS 3 5 6 7 0 1 0 .9 c\n"),
                "t.vs3:12: expected a subsurface within base 1 and clear of others, found \
                 0.000000 m² of its 0.500000 m² there",
            ),
            (
                format!("{planes}0 0 0 90 90 1\nS 2 R 0 0 .9 b\n"),
                "t.vs3:4: expected 7 numbers of the plane and the shape of surface 1, found 'S'",
            ),
            (
                format!("{planes}0 0 0 90 90 1 -1\n"),
                "t.vs3:3: expected a width and a height from 0, found '-1'",
            ),
            (
                planes.into(),
                "t.vs3:2: expected the numbers of its plane and shape, found the end of the data",
            ),
            (
                planes.replace('R', "P"),
                "t.vs3:2: expected shape R, Q or T, found 'P'",
            ),
            (
                "Surfaces follow\n".into(),
                "t.vs3:1: expected T, C, F, V, S, N, O or E, found 'Surfaces'",
            ),
            ("F 3\nE\n".into(), "t.vs3: expected facets, found none"),
        ] {
            assert_eq!(read(&text).unwrap_err(), message, "{text}");
        }
    }
}
