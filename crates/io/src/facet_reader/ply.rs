//! PLY, text and binary of either byte order [Turk94]: a row is a face of any number of corners.
//!
//! Elements may come in any order; those and the properties that are not needed are skipped.
//! `vertex` has `x`, `y` and `z` of any type; `face` has a list `vertex_indices` or
//! `vertex_index` of any integer type.
//!
//! An own reader: those at hand name no line, and allocate what the header counts.

use super::numbers::{Numbers, found, number};
use super::{FacetDocument, Input, Rows, Words};
use crate::budget::Budget;
use crate::error::Error;
use crate::obj_reader::text;
use luxel_core::{DVec3, Warnings};
use std::borrow::Cow;

/// Types of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn of(name: &str) -> Option<Type> {
        Some(match name {
            "char" | "int8" => Type::I8,
            "uchar" | "uint8" => Type::U8,
            "short" | "int16" => Type::I16,
            "ushort" | "uint16" => Type::U16,
            "int" | "int32" => Type::I32,
            "uint" | "uint32" => Type::U32,
            "float" | "float32" => Type::F32,
            "double" | "float64" => Type::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Type::I8 | Type::U8 => 1,
            Type::I16 | Type::U16 => 2,
            Type::I32 | Type::U32 | Type::F32 => 4,
            Type::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        !matches!(self, Type::F32 | Type::F64)
    }
}

/// A property: one number, or a list with the type of its length.
#[derive(Clone, Debug)]
struct Property {
    name: String,
    kind: Type,
    length: Option<Type>,
}

#[derive(Clone, Debug)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
    line: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ascii,
    Little,
    Big,
}

fn head_is_no_text(bytes: &[u8]) -> bool {
    text::is_no_text(&String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]))
}

/// Reads the header; returns the format, the elements, and how many bytes and lines it takes.
fn header(
    bytes: &[u8],
    budget: &mut Budget,
) -> Result<(Format, Vec<Element>, usize, usize), Error> {
    let mut at = 0;
    let mut number = 0;
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    // Files of old machines end lines with CR alone. LF then is the first byte of the data.
    let first_end = bytes.iter().position(|b| matches!(b, b'\n' | b'\r'));
    let only_cr = first_end.is_some_and(|k| bytes[k] == b'\r' && bytes.get(k + 1) != Some(&b'\n'));
    loop {
        let rest = &bytes[at..];
        number += 1;
        let Some(end) = rest.iter().position(|b| matches!(b, b'\n' | b'\r')) else {
            let expected = if number == 1 { "'ply'" } else { "'end_header'" };
            let found = match head_is_no_text(rest) {
                true => text::NO_TEXT,
                false => "the end of the file",
            };
            return Err(Error::new(expected, found).at_line(number));
        };
        let crlf = !only_cr && rest[end..].starts_with(b"\r\n");
        at += end + 1 + crlf as usize;
        let line = String::from_utf8_lossy(&rest[..end]);
        let mut words = line.split_whitespace();
        let word = words.next();
        let wrong = |expected: &str, word: Option<&str>| {
            Err(Error::new(expected, found(word)).at_line(number))
        };
        if number == 1 {
            match word {
                Some("ply") => continue,
                _ if head_is_no_text(bytes) => {
                    return Err(Error::new("'ply'", text::NO_TEXT).at_line(number));
                }
                _ => return wrong("'ply'", word),
            }
        }
        match word {
            None | Some("comment" | "obj_info") => {}
            Some("format") => {
                let name = words.next();
                format = Some(match name {
                    Some("ascii") => Format::Ascii,
                    Some("binary_little_endian") => Format::Little,
                    Some("binary_big_endian") => Format::Big,
                    _ => {
                        let known = "'ascii', 'binary_little_endian' or 'binary_big_endian'";
                        return wrong(known, name);
                    }
                });
            }
            Some("element") => {
                let name = words.next();
                let Some(name) = name else {
                    return wrong("the name of an element", name);
                };
                let count = words.next();
                let Some(count) = count.and_then(|w| w.parse().ok()) else {
                    return wrong("a number of elements", count);
                };
                budget.take(1, 80 + name.len())?;
                elements.push(Element {
                    name: name.to_owned(),
                    count,
                    properties: Vec::new(),
                    line: number,
                });
            }
            Some("property") => {
                let Some(element) = elements.last_mut() else {
                    return wrong("an element before its properties", word);
                };
                let type_of = |word: Option<&str>| match word.and_then(Type::of) {
                    Some(kind) => Ok(kind),
                    None => Err(Error::new("a type of number", found(word)).at_line(number)),
                };
                let first = words.next();
                let (length, kind) = if first == Some("list") {
                    let word = words.next();
                    let length = type_of(word)?;
                    if !length.is_integer() {
                        return wrong("an integer type for the length of a list", word);
                    }
                    (Some(length), type_of(words.next())?)
                } else {
                    (None, type_of(first)?)
                };
                let name = words.next();
                let Some(name) = name else {
                    return wrong("the name of a property", name);
                };
                budget.take(1, 64 + name.len())?;
                element.properties.push(Property {
                    name: name.to_owned(),
                    kind,
                    length,
                });
            }
            Some("end_header") => break,
            _ => return wrong("a line of a PLY header", word),
        }
    }
    match format {
        Some(format) => Ok((format, elements, at, number)),
        None => Err(Error::new("a line 'format'", "'end_header'").at_line(number)),
    }
}

/// Numbers of the body, one after the other.
enum Body<'a> {
    Text { words: Words<'a>, before: usize },
    Binary { bytes: &'a [u8], big: bool },
}

impl Body<'_> {
    /// Adds to an error where the body is.
    fn placed(&self, error: Error, element: &Element, index: u64) -> Error {
        match self {
            Body::Text { words, before } => error.at_line(before + words.line()),
            Body::Binary { .. } => error.within(format!("{} {index}", element.name)),
        }
    }

    fn bytes(&mut self, count: usize) -> Result<&[u8], Error> {
        match self {
            Body::Binary { bytes, .. } if bytes.len() >= count => {
                let (taken, rest) = bytes.split_at(count);
                *bytes = rest;
                Ok(taken)
            }
            _ => Err(ended()),
        }
    }

    /// The next number, and how it was written.
    fn next(&mut self, kind: Type, expected: &str) -> Result<(f64, Option<&str>), Error> {
        match self {
            Body::Text { words, .. } => {
                let word = words.next().ok_or_else(ended)?;
                Ok((number(Some(word), expected)?, Some(word)))
            }
            Body::Binary { big, .. } => {
                let big = *big;
                let mut b = [0u8; 8];
                let size = kind.size();
                b[..size].copy_from_slice(self.bytes(size)?);
                if big {
                    b[..size].reverse();
                }
                let value = match kind {
                    Type::I8 => b[0] as i8 as f64,
                    Type::U8 => b[0] as f64,
                    Type::I16 => i16::from_le_bytes([b[0], b[1]]) as f64,
                    Type::U16 => u16::from_le_bytes([b[0], b[1]]) as f64,
                    Type::I32 => i32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64,
                    Type::U32 => u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64,
                    Type::F32 => f32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64,
                    Type::F64 => f64::from_le_bytes(b),
                };
                Ok((value, None))
            }
        }
    }

    /// The next whole number below 2^32.
    fn whole(&mut self, kind: Type, expected: &str) -> Result<u32, Error> {
        let (value, word) = self.next(kind, expected)?;
        if (0.0..=u32::MAX as f64).contains(&value) && value.fract() == 0.0 {
            return Ok(value as u32);
        }
        let found = word.map_or_else(|| value.to_string(), |w| found(Some(w)));
        Err(Error::new(expected, found))
    }

    /// Leaves numbers out.
    fn skip(&mut self, count: usize, kind: Type) -> Result<(), Error> {
        match self {
            Body::Text { words, .. } => {
                for _ in 0..count {
                    words.next().ok_or_else(ended)?;
                }
                Ok(())
            }
            Body::Binary { .. } => self.bytes(count.saturating_mul(kind.size())).map(|_| ()),
        }
    }

    fn skip_property(&mut self, property: &Property) -> Result<(), Error> {
        let count = match property.length {
            None => 1,
            Some(length) => self.whole(length, "the length of a list")? as usize,
        };
        self.skip(count, property.kind)
    }
}

fn ended() -> Error {
    Error::new("a number", "the end of the file")
}

pub(super) fn read(
    input: Input<'_>,
    bytes: &[u8],
    budget: &mut Budget,
) -> Result<FacetDocument, Error> {
    // Only a text has a byte-order mark.
    let bytes = match bytes {
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [0xef, 0xbb, 0xbf, ..] => {
            budget.take(bytes.len(), 2)?;
            Cow::Owned(text::decoded(bytes).into_owned().into_bytes())
        }
        _ => Cow::Borrowed(bytes),
    };
    let (format, elements, start, lines) = header(&bytes, budget)?;
    let text;
    let mut body = match format {
        Format::Ascii => {
            budget.take(bytes.len() - start, 2)?;
            text = String::from_utf8_lossy(&bytes[start..]);
            Body::Text {
                words: Words::new(&text),
                before: lines,
            }
        }
        _ => Body::Binary {
            bytes: &bytes[start..],
            big: format == Format::Big,
        },
    };
    let mut reading = Reading {
        numbers: Numbers::new(input.options.scale, false),
        positions: Vec::new(),
        corners: Vec::new(),
        ends: Vec::new(),
        lines: Vec::new(),
        budget,
    };
    let (mut vertices_met, mut faces_met) = (false, false);
    for element in &elements {
        let again = |met: &mut bool| {
            let what = format!("one element '{}'", element.name);
            match std::mem::replace(met, true) {
                true => Err(Error::new(what, "a second one").at_line(element.line)),
                false => Ok(()),
            }
        };
        match element.name.as_str() {
            "vertex" => {
                again(&mut vertices_met)?;
                reading.vertices(element, &mut body)?;
            }
            "face" => {
                again(&mut faces_met)?;
                reading.faces(element, &mut body)?;
            }
            "tristrips" => {
                let error = Error::new("faces", "triangle strips, which are not supported");
                return Err(error.at_line(element.line));
            }
            _ if element.properties.is_empty() => {}
            _ => {
                for k in 0..element.count {
                    for property in &element.properties {
                        body.skip_property(property)
                            .map_err(|e| body.placed(e, element, k))?;
                    }
                }
            }
        }
    }
    let mut warnings = Warnings::default();
    let left = match &mut body {
        Body::Text { words, .. } => words.next().is_some(),
        Body::Binary { bytes, .. } => !bytes.is_empty(),
    };
    if left {
        let what = "more stands in the file than its header says; it was ignored";
        warnings.add(input.file, what, 1);
    }
    reading.into_document(input, warnings)
}

struct Reading<'b> {
    numbers: Numbers,
    positions: Vec<DVec3>,
    /// Corners of all faces, as indices of vertices.
    corners: Vec<u32>,
    ends: Vec<usize>,
    /// Line of each face in a text.
    lines: Vec<usize>,
    budget: &'b mut Budget,
}

impl Reading<'_> {
    fn vertices(&mut self, element: &Element, body: &mut Body<'_>) -> Result<(), Error> {
        let mut slots = [None; 3];
        for (slot, name) in slots.iter_mut().zip(["x", "y", "z"]) {
            let mut all = element.properties.iter().enumerate();
            let place = all.find(|(_, p)| p.name == name && p.length.is_none());
            let Some((k, property)) = place else {
                let expected = format!("a vertex with a number {name}");
                return Err(Error::new(expected, "none").at_line(element.line));
            };
            if property.kind == Type::F32 {
                self.numbers.set_single();
            }
            *slot = Some(k);
        }
        for k in 0..element.count {
            let mut p = DVec3::ZERO;
            for (at, property) in element.properties.iter().enumerate() {
                let result = match slots.iter().position(|slot| *slot == Some(at)) {
                    None => body.skip_property(property),
                    Some(axis) => body.next(property.kind, "a coordinate").and_then(|read| {
                        p[axis] = match read {
                            (_, Some(word)) => self.numbers.word(Some(word), "a coordinate")?,
                            (value, None) => self.numbers.stored(value)?,
                        };
                        Ok(())
                    }),
                };
                result.map_err(|e| body.placed(e, element, k))?;
            }
            self.budget.take(1, 24)?;
            self.positions.push(p);
        }
        Ok(())
    }

    fn faces(&mut self, element: &Element, body: &mut Body<'_>) -> Result<(), Error> {
        let is_ring = |p: &Property| matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
        let ring = element.properties.iter().position(is_ring);
        let lists = ring.and_then(|k| Some((k, element.properties[k].length?)));
        let Some((ring, length)) = lists else {
            let expected = "a face with a list vertex_indices";
            return Err(Error::new(expected, "none").at_line(element.line));
        };
        let kind = element.properties[ring].kind;
        if !kind.is_integer() {
            let expected = "an integer type for vertex_indices";
            return Err(Error::new(expected, "a float type").at_line(element.line));
        }
        for k in 0..element.count {
            for (at, property) in element.properties.iter().enumerate() {
                if at != ring {
                    body.skip_property(property)
                        .map_err(|e| body.placed(e, element, k))?;
                    continue;
                }
                self.ring(body, length, kind)
                    .map_err(|e| body.placed(e, element, k))?;
            }
            self.budget.take(1, 16)?;
            self.ends.push(self.corners.len());
        }
        Ok(())
    }

    fn ring(&mut self, body: &mut Body<'_>, length: Type, kind: Type) -> Result<(), Error> {
        let count = body.whole(length, "the number of corners")?;
        if let Body::Text { words, before } = body {
            self.lines.push(*before + words.line());
        }
        // Nothing is allocated by the count: the numbers must be there first.
        for _ in 0..count {
            let index = body.whole(kind, "the index of a vertex")?;
            self.budget.take(1, 4)?;
            self.corners.push(index);
        }
        Ok(())
    }

    fn into_document(self, input: Input<'_>, warnings: Warnings) -> Result<FacetDocument, Error> {
        let mut rows = Rows::new();
        let object = rows.objects.another(String::new(), self.budget)?;
        let material = rows.materials.id("", self.budget)?;
        let mut start = 0;
        let count = self.positions.len();
        for (k, &end) in self.ends.iter().enumerate() {
            let corners = &self.corners[start..end];
            start = end;
            let line = self.lines.get(k).copied();
            if let Some(wrong) = corners.iter().find(|&&c| c as usize >= count) {
                let expected = match count {
                    0 => "vertices".into(),
                    _ => format!("the index of a vertex, 0 to {}", count - 1),
                };
                let error = Error::new(expected, wrong.to_string());
                return Err(match line {
                    Some(line) => error.at_line(line),
                    None => error.within(format!("face {k}")),
                });
            }
            let ring = corners.iter().map(|&c| self.positions[c as usize]);
            rows.push(ring, object, material, line, self.budget)?;
        }
        rows.into_document(input, &self.numbers, warnings, self.budget)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FacetDocument, FacetKind, FacetOptions, read_facets_bytes};
    use luxel_core::DVec3;

    fn read(bytes: &[u8]) -> Result<FacetDocument, String> {
        let alone = |name: &str, _: u64| Err(format!("no file {name}"));
        let options = FacetOptions::default();
        read_facets_bytes(FacetKind::Ply, "t.ply", bytes.to_vec(), &alone, &options)
            .map_err(|e| e.to_string())
    }

    const TEXT: &str = "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 4\n\
        property float x\nproperty uchar red\nproperty double y\nproperty float z\n\
        element face 2\nproperty list uchar float weights\n\
        property list uchar int vertex_indices\nend_header\n\
        0 255 0 0\n1 255 0 0\n1 255 1 0\n0 255 1 0\n\
        0 4 0 1 2 3\n2 0.5 0.5 3 0 2\n1\n";

    /// The same in binary, faces first, an element that nobody knows between.
    fn binary(big: bool) -> Vec<u8> {
        let order = if big { "big" } else { "little" };
        let mut out = format!(
            "ply\r\nformat binary_{order}_endian 1.0\r\nelement face 2\r\n\
             property list ushort uint vertex_index\r\nproperty uchar flag\r\n\
             element odd 2\r\nproperty list char short numbers\r\n\
             element empty 18446744073709551615\r\n\
             element vertex 4\r\nproperty double x\r\nproperty short y\r\nproperty float z\r\n\
             end_header\r\n"
        )
        .into_bytes();
        let mut put = |bytes: &[u8]| {
            if big {
                out.extend(bytes.iter().rev());
            } else {
                out.extend(bytes);
            }
        };
        for face in [&[0u32, 1, 2, 3][..], &[0, 2, 1]] {
            put(&(face.len() as u16).to_le_bytes());
            face.iter().for_each(|i| put(&i.to_le_bytes()));
            put(&[7]);
        }
        for list in [&[-5i16, 6][..], &[]] {
            put(&[list.len() as u8]);
            list.iter().for_each(|i| put(&i.to_le_bytes()));
        }
        for (x, y) in [(0.0f64, 0i16), (1.0, 0), (1.0, 1), (0.0, 1)] {
            put(&x.to_le_bytes());
            put(&y.to_le_bytes());
            put(&0f32.to_le_bytes());
        }
        out
    }

    #[test]
    fn text_and_both_binaries_hold_the_same() {
        let d = read(TEXT.as_bytes()).unwrap();
        assert_eq!(d.facets.areas(), [1.0, 0.5]);
        assert_eq!(d.facets.parts[0].polygon.vertices.len(), 4);
        assert_eq!(d.facets.parts[1].polygon.normal(), DVec3::NEG_Z);
        assert!(d.warnings.is_empty(), "{:?}", d.warnings);
        for big in [false, true] {
            let other = read(&binary(big)).unwrap();
            assert_eq!(other.facets.parts, d.facets.parts);
            assert_eq!(other.facets.rounding_m, f32::EPSILON as f64);
        }
        let crlf = TEXT.replace('\n', "\r\n");
        assert_eq!(read(crlf.as_bytes()).unwrap().facets, d.facets);
        let cr = TEXT.replace('\n', "\r");
        assert_eq!(read(cr.as_bytes()).unwrap().facets, d.facets);
        let utf16: Vec<u8> = [0xff, 0xfe]
            .into_iter()
            .chain(TEXT.encode_utf16().flat_map(u16::to_le_bytes))
            .collect();
        assert_eq!(read(&utf16).unwrap().facets, d.facets);
    }

    #[test]
    fn errors_name_the_place() {
        let with = |from: &str, to: &str| TEXT.replace(from, to).into_bytes();
        let mut cut = binary(false);
        cut.truncate(cut.len() - 20);
        for (bytes, message) in [
            (
                with("1 255 1 0\n0", "1 255 x 0\n0"),
                "t.ply:15: expected a coordinate, found 'x'",
            ),
            (
                with("1 255 1 0\n0", "1 255 nan 0\n0"),
                "t.ply:15: expected a finite coordinate, found 'nan'",
            ),
            (
                with("0 4 0 1 2 3", "0 4 0 1 2 4"),
                "t.ply:17: expected the index of a vertex, 0 to 3, found 4",
            ),
            (
                with("0 4 0 1 2 3", "0 4 0 1 2 -1"),
                "t.ply:17: expected the index of a vertex, found '-1'",
            ),
            (
                with("face 2", "face 3"),
                "t.ply:19: expected a number, found the end of the file",
            ),
            (
                with("float x", "float u"),
                "t.ply:4: expected a vertex with a number x, found none",
            ),
            (
                with("float z", "half z"),
                "t.ply:8: expected a type of number, found 'half'",
            ),
            (
                with("element face", "element tristrips"),
                "t.ply:9: expected faces, found triangle strips, which are not supported",
            ),
            (
                with("uchar int v", "uchar float v"),
                "t.ply:9: expected an integer type for vertex_indices, found a float type",
            ),
            (
                with("uchar int v", "float int v"),
                "t.ply:11: expected an integer type for the length of a list, found 'float'",
            ),
            (
                with("end_header", "end"),
                "t.ply:12: expected a line of a PLY header, found 'end'",
            ),
            (
                with("vertex 4", "vertex 99999999999999999999"),
                "t.ply:4: expected a number of elements, found '99999999999999999999'",
            ),
            (
                cut,
                "t.ply: vertex 2: expected a number, found the end of the file",
            ),
            (
                b"solid".to_vec(),
                "t.ply:1: expected 'ply', found the end of the file",
            ),
        ] {
            assert_eq!(read(&bytes).unwrap_err(), message);
        }
    }

    #[test]
    fn a_count_without_bytes_allocates_nothing() {
        let header = "ply\nformat binary_little_endian 1.0\nelement face 18446744073709551615\n\
            property list uint uint vertex_indices\nend_header\n";
        let mut bytes = header.as_bytes().to_vec();
        bytes.extend([0xff; 40]);
        assert_eq!(
            read(&bytes).unwrap_err(),
            "t.ply: face 0: expected a number, found the end of the file"
        );
    }

    #[test]
    fn doubles_are_known_better() {
        let text = TEXT
            .replace("float ", "double ")
            .replace("uchar double w", "uchar float w");
        let text = text.replace("0 255 0 0", "0.00000000000001 255 0 0");
        assert_eq!(read(text.as_bytes()).unwrap().facets.rounding_m, 1e-12);
    }
}
