//! STL, text and binary [STL89]: a row is a triangle, an object a `solid`.
//!
//! A file of exactly 84 + 50 n bytes, n as its header counts, is binary whatever it begins with:
//! many binary headers say `solid`. Normals are not used, but one warning tells when they
//! contradict the corners. A text may have more than three corners in a loop: one polygon.
//!
//! An own reader: those at hand know no lines, and believe the count in the header.

use super::numbers::{Numbers, found, number};
use super::{FacetDocument, Input, Rows, Words};
use crate::budget::Budget;
use crate::error::{Error, Within, clean};
use crate::obj_reader::{polygon::area_vector, text};
use luxel_core::{DVec3, Warnings};

const HEADER: usize = 84;
const TRIANGLE: usize = 50;

/// How many facets have normals, and how many of these contradict the corners.
#[derive(Default)]
struct Normals {
    all: usize,
    against: usize,
}

impl Normals {
    fn note(&mut self, normal: DVec3, corners: &[DVec3]) {
        let along = normal.dot(area_vector(corners));
        self.all += (along.abs() > 0.0) as usize;
        self.against += (along < 0.0) as usize;
    }

    fn say(&self, file: &str, warnings: &mut Warnings) {
        if 2 * self.against > self.all {
            let what =
                "facets have normals against the order of their corners; the order was taken";
            warnings.add(file, what, self.against);
        }
    }
}

pub(super) fn read(
    input: Input<'_>,
    bytes: &[u8],
    budget: &mut Budget,
) -> Result<FacetDocument, Error> {
    let counted = bytes
        .get(HEADER - 4..HEADER)
        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as u64);
    let length = |n: u64| HEADER as u64 + TRIANGLE as u64 * n;
    if let Some(n) = counted
        && length(n) == bytes.len() as u64
    {
        return binary(input, &bytes[HEADER..], Warnings::default(), budget);
    }
    let decoded_size = bytes.len();
    budget.take(decoded_size, 2)?;
    let text = text::decoded(bytes);
    let start = text.trim_start();
    let says_solid = start
        .get(..5)
        .is_some_and(|word| word.eq_ignore_ascii_case("solid"));
    // A binary header may say so too; text has no zero bytes.
    if says_solid && !text.contains('\0') {
        return ascii(input, &text, budget);
    }
    drop(text);
    budget.give_back(decoded_size, 2);
    match counted {
        Some(n) if length(n) < bytes.len() as u64 => {
            let mut warnings = Warnings::default();
            let over = bytes.len() as u64 - length(n);
            let what = format!("{over} bytes behind the last triangle were ignored");
            warnings.add(input.file, what, 1);
            let end = length(n) as usize;
            binary(input, &bytes[HEADER..end], warnings, budget)
        }
        Some(n) => Err(Error::new(
            format!("a text that begins with 'solid', or 50 bytes for each of {n} triangles"),
            format!("{} bytes for them", bytes.len() - HEADER),
        )),
        None => Err(Error::new(
            "'solid' or 84 bytes of a binary header",
            format!("{} bytes", bytes.len()),
        )),
    }
}

fn binary(
    input: Input<'_>,
    triangles: &[u8],
    mut warnings: Warnings,
    budget: &mut Budget,
) -> Result<FacetDocument, Error> {
    let mut rows = Rows::new();
    let mut numbers = Numbers::new(input.options.scale, true);
    let mut normals = Normals::default();
    let object = rows.objects.another(String::new(), budget)?;
    let material = rows.materials.id("", budget)?;
    for (k, record) in triangles.chunks_exact(TRIANGLE).enumerate() {
        let float = |at: usize| {
            let b = &record[4 * at..4 * at + 4];
            f32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64
        };
        let vector = |at: usize| DVec3::new(float(at), float(at + 1), float(at + 2));
        let corners = [vector(3), vector(6), vector(9)];
        for value in corners.iter().flat_map(|p| p.to_array()) {
            numbers
                .stored(value)
                .within(|| format!("triangle {}", k + 1))?;
        }
        normals.note(vector(0), &corners);
        rows.push(corners.into_iter(), object, material, None, budget)?;
    }
    normals.say(input.file, &mut warnings);
    rows.into_document(input, &numbers, warnings, budget)
}

fn ascii(input: Input<'_>, text: &str, budget: &mut Budget) -> Result<FacetDocument, Error> {
    let mut reading = Ascii {
        words: Words::new(text),
        rows: Rows::new(),
        numbers: Numbers::new(input.options.scale, false),
        normals: Normals::default(),
        ring: Vec::new(),
        budget,
    };
    let mut warnings = Warnings::default();
    let material = reading.rows.materials.id("", reading.budget)?;
    loop {
        match reading.words.next() {
            None => break,
            Some(word) if word.eq_ignore_ascii_case("solid") => {}
            word => return Err(reading.wrong("'solid' or the end of the file", word)),
        }
        let name = clean(reading.words.rest_of_line());
        let object = reading.rows.objects.another(name, reading.budget)?;
        if !reading.solid(object, material)? {
            warnings.add(input.file, "the last solid has no 'endsolid'", 1);
        }
    }
    reading.normals.say(input.file, &mut warnings);
    let Ascii {
        rows,
        numbers,
        budget,
        ..
    } = reading;
    rows.into_document(input, &numbers, warnings, budget)
}

struct Ascii<'a, 'b> {
    words: Words<'a>,
    rows: Rows,
    numbers: Numbers,
    normals: Normals,
    ring: Vec<DVec3>,
    budget: &'b mut Budget,
}

impl Ascii<'_, '_> {
    fn wrong(&self, expected: &str, word: Option<&str>) -> Error {
        let found = word.map_or("the end of the file".into(), |_| found(word));
        Error::new(expected, found).at_line(self.words.line().max(1))
    }

    /// The facets up to `endsolid`; false if the file ends without it.
    fn solid(&mut self, object: u32, material: u32) -> Result<bool, Error> {
        loop {
            let word = self.words.next();
            match word {
                None => return Ok(false),
                Some(w) if w.eq_ignore_ascii_case("facet") => {}
                Some(w) if w.eq_ignore_ascii_case("endsolid") => {
                    self.words.rest_of_line();
                    return Ok(true);
                }
                _ => return Err(self.wrong("'facet' or 'endsolid'", word)),
            }
            let line = self.words.line();
            self.facet(object, material, line)?;
        }
    }

    fn keyword(&mut self, name: &str) -> Result<(), Error> {
        let word = self.words.next();
        if word.is_some_and(|w| w.eq_ignore_ascii_case(name)) {
            return Ok(());
        }
        Err(self.wrong(&format!("'{name}'"), word))
    }

    fn facet(&mut self, object: u32, material: u32, line: usize) -> Result<(), Error> {
        self.keyword("normal")?;
        let mut normal = [0.0; 3];
        for slot in &mut normal {
            let word = self.words.next();
            // NaN is what many programs write for a sliver.
            *slot = number(word, "3 numbers of a normal")
                .map_err(|_| self.wrong("3 numbers of a normal", word))?;
        }
        self.keyword("outer")?;
        self.keyword("loop")?;
        self.ring.clear();
        loop {
            let word = self.words.next();
            let corners = self.ring.len();
            match word {
                Some(w) if w.eq_ignore_ascii_case("vertex") => {}
                Some(w) if w.eq_ignore_ascii_case("endloop") && corners >= 3 => break,
                _ if corners < 3 => return Err(self.wrong("'vertex'", word)),
                _ => return Err(self.wrong("'vertex' or 'endloop'", word)),
            }
            let mut p = [0.0; 3];
            for slot in &mut p {
                let word = self.words.next();
                let line = self.words.line();
                let value = self.numbers.word(word, "3 coordinates of a vertex");
                *slot = value.map_err(|e| match word {
                    None => self.wrong("3 coordinates of a vertex", None),
                    Some(_) => e.at_line(line),
                })?;
            }
            self.budget.take(1, 24)?;
            self.ring.push(DVec3::from_array(p));
        }
        self.budget.give_back(self.ring.len(), 24);
        self.keyword("endfacet")?;
        self.normals.note(DVec3::from_array(normal), &self.ring);
        let corners = self.ring.iter().copied();
        self.rows
            .push(corners, object, material, Some(line), self.budget)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FacetDocument, FacetKind, FacetOptions, read_facets_bytes};
    use luxel_core::DVec3;

    fn read(bytes: &[u8]) -> Result<FacetDocument, String> {
        let alone = |name: &str, _: u64| Err(format!("no file {name}"));
        let options = FacetOptions::default();
        read_facets_bytes(FacetKind::Stl, "t.stl", bytes.to_vec(), &alone, &options)
            .map_err(|e| e.to_string())
    }

    fn facet(z: f32, normal: &str) -> String {
        format!(
            "facet normal {normal}\n outer loop\n  vertex 0 0 {z}\n  vertex 1 0 {z}\n  \
             vertex 0 1 {z}\n endloop\nendfacet\n"
        )
    }

    fn binary(header: &str, triangles: &[[[f32; 3]; 4]]) -> Vec<u8> {
        let mut out = header.as_bytes().to_vec();
        out.resize(80, b' ');
        out.extend((triangles.len() as u32).to_le_bytes());
        for t in triangles {
            out.extend(t.iter().flatten().flat_map(|v| v.to_le_bytes()));
            out.extend([0x12, 0x80]); // colour bits
        }
        out
    }

    const FLAT: [[f32; 3]; 4] = [[0., 0., 1.], [0., 0., 0.], [1., 0., 0.], [0., 1., 0.]];

    #[test]
    fn solids_are_objects_and_lines_end_as_they_like() {
        let two = format!(
            "solid left wall\r\n{}endsolid left wall\r\nSOLID b\n{}{}endsolid\n",
            facet(0.0, "0 0 1").replace('\n', "\r\n"),
            facet(1.0, "nan nan nan"),
            facet(2.0, "0 0 0").to_uppercase(),
        );
        let d = read(two.as_bytes()).unwrap();
        assert_eq!(d.facets.objects, ["left wall", "b"]);
        let objects: Vec<u32> = d.facets.rows.iter().map(|r| r.object).collect();
        assert_eq!(objects, [0, 1, 1]);
        assert_eq!(
            d.facets.parts[2].polygon.vertices[1],
            DVec3::new(1., 0., 2.)
        );
        assert!(d.warnings.is_empty(), "{:?}", d.warnings);
        let utf16: Vec<u8> = [0xff, 0xfe]
            .into_iter()
            .chain(two.encode_utf16().flat_map(u16::to_le_bytes))
            .collect();
        assert_eq!(read(&utf16).unwrap().facets, d.facets);
    }

    #[test]
    fn a_binary_file_is_known_by_its_size() {
        let d = read(&binary("solid by a careless program", &[FLAT, FLAT])).unwrap();
        assert_eq!(d.facets.rows.len(), 2);
        assert_eq!(d.facets.rounding_m, f32::EPSILON as f64);
        assert!(d.warnings.is_empty());
        let mut longer = binary("x", &[FLAT]);
        longer.extend([0; 7]);
        let d = read(&longer).unwrap();
        assert_eq!((d.facets.rows.len(), d.warnings.len()), (1, 1));
    }

    #[test]
    fn errors_name_the_place() {
        let good = facet(0.0, "0 0 1");
        let solid = |inner: &str| format!("solid\n{inner}endsolid\n").into_bytes();
        let mut bad = FLAT;
        bad[2][1] = f32::INFINITY;
        let mut cut = binary("x", &[FLAT, FLAT]);
        cut.truncate(100);
        for (bytes, message) in [
            (
                solid(&good.replace("1 0 0", "1 x 0")),
                "t.stl:5: expected 3 coordinates of a vertex, found 'x'",
            ),
            (
                solid(&good.replace("1 0 0", "1 inf 0")),
                "t.stl:5: expected a finite coordinate, found 'inf'",
            ),
            (
                solid(&good.replace("  vertex 0 1 0\n", "")),
                "t.stl:6: expected 'vertex', found 'endloop'",
            ),
            (
                solid(&good.replace("endfacet\n", "")),
                "t.stl:8: expected 'endfacet', found 'endsolid'",
            ),
            (
                solid(&good)[..37].to_vec(),
                "t.stl:3: expected 'vertex', found the end of the file",
            ),
            (
                b"solid\nendsolid".to_vec(),
                "t.stl: expected facets, found none",
            ),
            (
                binary("x", &[FLAT, bad]),
                "t.stl: triangle 2: expected a finite coordinate, found inf",
            ),
            (
                cut,
                "t.stl: expected a text that begins with 'solid', or 50 bytes for each of 2 triangles, found 16 bytes for them",
            ),
            (
                Vec::new(),
                "t.stl: expected 'solid' or 84 bytes of a binary header, found 0 bytes",
            ),
        ] {
            assert_eq!(read(&bytes).unwrap_err(), message);
        }
    }

    #[test]
    fn normals_that_contradict_are_said_once() {
        let mut turned = FLAT;
        turned[0][2] = -1.0;
        let d = read(&binary("x", &[turned, turned, FLAT])).unwrap();
        let said: Vec<String> = d.warnings.iter().map(|w| w.to_string()).collect();
        assert_eq!(
            said,
            [
                "t.stl: facets have normals against the order of their corners; the order was \
                 taken (2 of them)"
            ]
        );
        // The order of the corners counts all the same.
        assert_eq!(d.facets.parts[0].polygon.normal(), DVec3::Z);
        assert!(
            read(&binary("x", &[turned, FLAT]))
                .unwrap()
                .warnings
                .is_empty()
        );
    }

    #[test]
    fn a_facet_without_area_keeps_its_row() {
        let mut line = FLAT;
        line[3] = [2.0, 0.0, 0.0];
        let d = read(&binary("x", &[FLAT, line, FLAT])).unwrap();
        assert_eq!(d.facets.rows.len(), 3);
        let rows: Vec<u32> = d.facets.parts.iter().map(|p| p.row).collect();
        assert_eq!(rows, [0, 2]);
        let said: Vec<String> = d.warnings.iter().map(|w| w.to_string()).collect();
        assert!(
            said[0].starts_with("t.stl: facet 2: facets without area"),
            "{said:?}"
        );
    }
}
