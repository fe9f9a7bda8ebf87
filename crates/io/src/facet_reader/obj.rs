//! Wavefront OBJ [OBJ95]: a row is an `f`, whole; an object is what shares `o` and `g`.
//!
//! Only vertices, faces and names are read. Indices below zero count back from the newest vertex
//! at that line. A face of less than three corners keeps its row, without area.

use super::numbers::Numbers;
use super::{FacetDocument, Input, Rows};
use crate::budget::Budget;
use crate::error::{Error, clean};
use crate::obj_reader::text::{self, Lines};
use crate::obj_reader::{index, place_name};
use luxel_core::{DVec3, Warnings};

pub(super) fn read(
    input: Input<'_>,
    bytes: &[u8],
    budget: &mut Budget,
) -> Result<FacetDocument, Error> {
    budget.take(bytes.len(), 2)?;
    let text = text::decoded(bytes);
    if text::is_no_text(&text) {
        return Err(Error::new("a text with lines 'v' and 'f'", text::NO_TEXT));
    }
    let mut reading = Reading {
        rows: Rows::new(),
        numbers: Numbers::new(input.options.scale, false),
        positions: Vec::new(),
        object: String::new(),
        group: String::new(),
        material: String::new(),
        place: None,
        left_out: 0,
        corners: Vec::new(),
        budget,
    };
    for (number, line) in Lines::new(&text) {
        let line = text::without_comment(&line);
        reading
            .statement(line, number)
            .map_err(|e| e.at_line(number))?;
    }
    let Reading {
        rows,
        numbers,
        left_out,
        budget,
        ..
    } = reading;
    let mut warnings = Warnings::default();
    let what = "free-form curves and surfaces are left out";
    warnings.add(input.file, what, left_out);
    rows.into_document(input, &numbers, warnings, budget)
}

struct Reading<'b> {
    rows: Rows,
    numbers: Numbers,
    positions: Vec<DVec3>,
    object: String,
    group: String,
    material: String,
    /// Object and material of new faces; found when the next one comes.
    place: Option<(u32, u32)>,
    left_out: usize,
    corners: Vec<u32>,
    budget: &'b mut Budget,
}

impl Reading<'_> {
    fn statement(&mut self, line: &str, number: usize) -> Result<(), Error> {
        let line = line.trim_start();
        let end = line.find(char::is_whitespace).unwrap_or(line.len());
        let (word, rest) = line.split_at(end);
        let rest = rest.trim();
        match word {
            "v" => {
                let mut words = rest.split_whitespace();
                let mut p = [0.0; 3];
                for slot in &mut p {
                    *slot = self.numbers.word(words.next(), "3 numbers")?;
                }
                self.budget.take(1, 24)?;
                self.positions.push(DVec3::from_array(p));
            }
            "f" | "fo" => self.face(rest, number)?,
            "o" => {
                self.object = clean(rest);
                self.group.clear();
                self.place = None;
            }
            "g" => {
                self.group = clean(rest);
                self.place = None;
            }
            "usemtl" => {
                self.material = clean(rest);
                self.place = None;
            }
            "curv" | "curv2" | "surf" => self.left_out += 1,
            _ => {}
        }
        Ok(())
    }

    fn face(&mut self, rest: &str, number: usize) -> Result<(), Error> {
        self.corners.clear();
        for word in rest.split_whitespace() {
            let first = word.split('/').next().unwrap_or("");
            let corner = index(first, self.positions.len(), word, "vertices")?;
            self.corners.push(corner);
        }
        let (object, material) = match self.place {
            Some(place) => place,
            None => {
                let name = place_name(&self.object, &self.group);
                let object = self.rows.objects.id(&name, self.budget)?;
                let material = self.rows.materials.id(&self.material, self.budget)?;
                *self.place.insert((object, material))
            }
        };
        let positions = &self.positions;
        let corners = self.corners.iter().map(|&k| positions[k as usize]);
        self.rows
            .push(corners, object, material, Some(number), self.budget)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FacetDocument, FacetKind, FacetOptions, read_facets_bytes};
    use luxel_core::DVec3;

    fn read_with(text: &str, options: &FacetOptions) -> Result<FacetDocument, String> {
        let alone = |name: &str, _: u64| Err(format!("no file {name}"));
        let bytes = text.as_bytes().to_vec();
        read_facets_bytes(FacetKind::Obj, "t.obj", bytes, &alone, options)
            .map_err(|e| e.to_string())
    }

    fn read(text: &str) -> Result<FacetDocument, String> {
        read_with(text, &FacetOptions::default())
    }

    #[test]
    fn a_polygon_is_one_row_and_names_are_kept() {
        let d = read(
            "o hall\nv 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\nusemtl oak wood\n\
             f 1/1/1 2 3//2 4 5 6\ng door\nusemtl steel\nf -6 -5 \\\n -4\no hall\nusemtl steel\nf 1 2\n",
        )
        .unwrap();
        let f = &d.facets;
        assert_eq!(f.objects, ["hall", "hall, door"]);
        assert_eq!(f.materials, ["oak wood", "steel"]);
        let at: Vec<_> = f.rows.iter().map(|r| (r.object, r.material)).collect();
        assert_eq!(at, [(0, 0), (1, 1), (0, 1)]);
        let rows: Vec<u32> = f.parts.iter().map(|p| p.row).collect();
        assert_eq!(rows, [0, 0, 1]);
        // 2 x 1 and 1 x 1; half of 2 x 1.
        assert_eq!(f.areas(), [3.0, 1.0, 0.0]);
        let said: Vec<String> = d.warnings.iter().map(|w| w.to_string()).collect();
        assert_eq!(said.len(), 1);
        assert!(
            said[0].starts_with("t.obj:16: facets without area"),
            "{said:?}"
        );
        assert_eq!(f.name, "t");
    }

    #[test]
    fn scale_and_flip() {
        let text = "v 0 0 0\nv 1000 0 0\nv 0 1000 0\nf 1 2 3\n";
        let options = FacetOptions {
            scale: 1e-3,
            flip: true,
            ..FacetOptions::default()
        };
        let d = read_with(text, &options).unwrap();
        assert_eq!(d.facets.parts[0].polygon.normal(), DVec3::NEG_Z);
        assert_eq!(d.facets.areas(), [0.5]);
        let error = read_with(
            text,
            &FacetOptions {
                scale: f64::NAN,
                ..options
            },
        );
        assert_eq!(
            error.unwrap_err(),
            "t.obj: expected a scale above 0, found NaN"
        );
    }

    #[test]
    fn a_bent_quad_is_two_triangles_of_one_row() {
        let d = read("v 0 0 0\nv 1 0 0\nv 1 1 .1\nv 0 1 0\nf 1 2 3 4\nf 4 3 2 1\n").unwrap();
        let rows: Vec<u32> = d.facets.parts.iter().map(|p| p.row).collect();
        assert_eq!(rows, [0, 0, 1, 1]);
        let said: Vec<String> = d.warnings.iter().map(|w| w.to_string()).collect();
        assert_eq!(
            said,
            [
                "t.obj:5: facets that are not flat were split into triangles; the first is here \
                 (2 of them)"
            ]
        );
    }

    #[test]
    fn errors_name_the_line() {
        for (text, message) in [
            (
                "v 0 0\n",
                "t.obj:1: expected 3 numbers, found the end of the line",
            ),
            (
                "\nv 0 0 nan\n",
                "t.obj:2: expected a finite coordinate, found 'nan'",
            ),
            (
                "v 0 0 2e9\n",
                "t.obj:1: expected a coordinate within 10^9 m, found '2e9'",
            ),
            (
                "v 0 0 0\nf 1 2 3\n",
                "t.obj:2: expected an index of vertices so far, 1 to 1 or -1 to -1, found '2'",
            ),
            ("# nothing\n", "t.obj: expected facets, found none"),
        ] {
            assert_eq!(read(text).unwrap_err(), message);
        }
        let mut comb = String::new();
        for k in 0..3000 {
            comb += &format!("v {k} {} 0\nv {k}.5 9 0\n", k % 2);
        }
        comb += "f";
        for k in 1..=6000 {
            comb += &format!(" {k}");
        }
        assert_eq!(
            read(&comb).unwrap_err(),
            "t.obj:6001: expected at most 4096 corners of a polygon that is not convex, found 6000"
        );
    }

    #[test]
    fn memory_is_bounded() {
        let text = "v 0 0 0\n".repeat(10_000);
        let options = FacetOptions {
            memory: 300_000,
            ..FacetOptions::default()
        };
        let error = read_with(&text, &options).unwrap_err();
        assert!(error.contains("at most 300 kB of memory"), "{error}");
    }
}
