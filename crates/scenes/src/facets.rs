//! Loads for view factors: a room with boxes in the air and a block of a town, divided into
//! about as many facets as one likes, and both as View3D's input for a comparison.
//!
//! Metres, z up, fronts towards the air.

use luxel_core::{DVec3, Facet, FacetPart, Facets, Polygon};
use std::fmt::Write;

/// A room of 4 x 3 x 2.7 m with four boxes that touch nothing, of about so many facets.
pub fn floating_boxes(facets: usize) -> Facets {
    let boxes = [
        ([0.6, 0.5, 0.4], [1.3, 1.1, 1.0]),
        ([2.4, 0.4, 0.7], [3.3, 1.0, 1.5]),
        ([0.8, 1.8, 1.2], [1.6, 2.5, 2.1]),
        ([2.5, 1.7, 0.3], [3.2, 2.6, 0.9]),
    ];
    finest(facets, "room with four boxes", &|edge_m| {
        let mut out = Vec::new();
        for quad in box_faces([0.0; 3], [4.0, 3.0, 2.7]) {
            let [a, b, c, d] = quad;
            out.push(("room", divide([a, d, c, b], edge_m)));
        }
        for (low, high) in boxes {
            for quad in box_faces(low, high) {
                out.push(("boxes", divide(quad, edge_m)));
            }
        }
        out
    })
}

/// Six by five lots of 22 x 20 m with a building each, 9 to 33 m high, and streets, of about so
/// many facets. Open to the sky; nothing lies below the buildings.
pub fn city_block(facets: usize) -> Facets {
    let (pitch, inset) = ([22.0, 20.0], 5.0);
    let mut lots = Vec::new();
    for j in 0..5 {
        for i in 0..6 {
            // Heights without a pattern, the same each time.
            let storeys = 3 + (i * 7 + j * 5 + i * j * 3) % 9;
            let low = [i as f64 * pitch[0], j as f64 * pitch[1], 0.0];
            lots.push((low, 3.0 * storeys as f64));
        }
    }
    finest(facets, "block of a town", &|edge_m| {
        let mut out = Vec::new();
        for &([x, y, _], height) in &lots {
            let xs = [x, x + inset, x + pitch[0] - inset, x + pitch[0]];
            let ys = [y, y + inset, y + pitch[1] - inset, y + pitch[1]];
            for j in 0..3 {
                for i in 0..3 {
                    if (i, j) != (1, 1) {
                        let at = |k: usize, l: usize| DVec3::new(xs[i + k], ys[j + l], 0.0);
                        out.push((
                            "street",
                            divide([at(0, 0), at(1, 0), at(1, 1), at(0, 1)], edge_m),
                        ));
                    }
                }
            }
            let (low, high) = ([xs[1], ys[1], 0.0], [xs[2], ys[2], height]);
            for (k, quad) in box_faces(low, high).into_iter().enumerate() {
                match k {
                    // The floor.
                    0 => {}
                    1 => out.push(("roofs", divide(quad, edge_m))),
                    _ => out.push(("walls", divide(quad, edge_m))),
                }
            }
        }
        out
    })
}

/// Faces of a box, counter-clockwise from outside: below, above, then the sides.
fn box_faces(low: [f64; 3], high: [f64; 3]) -> [[DVec3; 4]; 6] {
    let at = |i: usize, j: usize, k: usize| {
        DVec3::new(
            [low[0], high[0]][i],
            [low[1], high[1]][j],
            [low[2], high[2]][k],
        )
    };
    [
        [at(0, 0, 0), at(0, 1, 0), at(1, 1, 0), at(1, 0, 0)],
        [at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1)],
        [at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1)],
        [at(1, 1, 0), at(0, 1, 0), at(0, 1, 1), at(1, 1, 1)],
        [at(0, 1, 0), at(0, 0, 0), at(0, 0, 1), at(0, 1, 1)],
        [at(1, 0, 0), at(1, 1, 0), at(1, 1, 1), at(1, 0, 1)],
    ]
}

/// A rectangle as cells of edges near `edge_m`.
fn divide([a, b, _, d]: [DVec3; 4], edge_m: f64) -> Vec<[DVec3; 4]> {
    let (u, v) = (b - a, d - a);
    let cells = |side: DVec3| (side.length() / edge_m).round().max(1.0) as usize;
    let (n, m) = (cells(u), cells(v));
    let at = |i: usize, j: usize| a + u * (i as f64 / n as f64) + v * (j as f64 / m as f64);
    (0..n * m)
        .map(|k| {
            let (i, j) = (k % n, k / n);
            [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]
        })
        .collect()
}

type Pieces = Vec<(&'static str, Vec<[DVec3; 4]>)>;

/// The division whose number of facets is nearest to what is asked.
fn finest(facets: usize, name: &str, divided: &dyn Fn(f64) -> Pieces) -> Facets {
    let count = |edge: f64| divided(edge).iter().map(|p| p.1.len()).sum::<usize>();
    // From coarse to fine, so that nothing much finer than what is asked is ever made.
    let mut fine = 1e3_f64;
    while count(fine) <= facets {
        fine *= 0.7;
    }
    let mut coarse = fine / 0.7;
    for _ in 0..60 {
        let middle = (fine * coarse).sqrt();
        if count(middle) > facets {
            fine = middle;
        } else {
            coarse = middle;
        }
        if count(coarse) == facets {
            break;
        }
    }
    let near = |edge: f64| count(edge).abs_diff(facets);
    let edge = if near(fine) < near(coarse) {
        fine
    } else {
        coarse
    };
    let mut out = Facets {
        name: name.to_string(),
        materials: vec![String::new()],
        ..Facets::default()
    };
    for (object, cells) in divided(edge) {
        let object = out
            .objects
            .iter()
            .position(|o| o == object)
            .unwrap_or_else(|| {
                out.objects.push(object.to_string());
                out.objects.len() - 1
            });
        for cell in cells {
            out.parts.push(FacetPart {
                polygon: Polygon::new(cell.to_vec()),
                row: out.rows.len() as u32,
            });
            out.rows.push(Facet {
                name: String::new(),
                object: object as u32,
                material: 0,
            });
        }
    }
    out
}

/// Quads and triangles of one part a row as input of View3D.
pub fn to_vs3(facets: &Facets, eps: f64) -> String {
    let mut text = format!("T {}\nC eps={eps:e} out=0 list=0\nF 3\n", facets.name);
    let mut vertex = 0;
    for part in &facets.parts {
        for v in &part.polygon.vertices {
            vertex += 1;
            let _ = writeln!(text, "V {vertex} {} {} {}", v.x, v.y, v.z);
        }
    }
    vertex = 0;
    for (k, part) in facets.parts.iter().enumerate() {
        let n = part.polygon.vertices.len();
        let _ = write!(text, "S {}", k + 1);
        for c in 0..4 {
            let _ = write!(text, " {}", if c < n { vertex + c + 1 } else { 0 });
        }
        vertex += n;
        let _ = writeln!(text, " 0 0 0.9 f{}", k + 1);
    }
    text + "E\n"
}

/// Facets as OBJ, an object each.
pub fn to_obj(facets: &Facets) -> String {
    let mut text = String::new();
    let mut object = u32::MAX;
    let mut vertex = 0;
    for part in &facets.parts {
        let row = &facets.rows[part.row as usize];
        if row.object != object {
            object = row.object;
            let _ = writeln!(text, "o {}", facets.objects[object as usize]);
        }
        let mut face = String::from("f");
        for v in &part.polygon.vertices {
            vertex += 1;
            let _ = writeln!(text, "v {} {} {}", v.x, v.y, v.z);
            let _ = write!(face, " {vertex}");
        }
        text += &face;
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_come_near_what_is_asked_and_boxes_are_closed() {
        for asked in [1000, 2000, 5000] {
            let room = floating_boxes(asked);
            let off = room.rows.len() as f64 / asked as f64 - 1.0;
            assert!(off.abs() < 0.06, "{}", room.rows.len());
            // Area vectors of a closed surface sum to zero.
            let sum: DVec3 = room.parts.iter().map(|p| p.polygon.area_vector()).sum();
            assert!(sum.length() < 1e-9);
            let area: f64 = room.areas().iter().sum();
            let boxes = 2.0
                * ((0.42 + 0.42 + 0.36)
                    + (0.54 + 0.72 + 0.48)
                    + (0.56 + 0.72 + 0.63)
                    + (0.63 + 0.42 + 0.54));
            assert!((area - 61.8 - boxes).abs() < 1e-9, "{area}");
        }
        let city = city_block(22_000);
        let off = city.rows.len() as f64 / 22_000.0 - 1.0;
        assert!(off.abs() < 0.03, "{}", city.rows.len());
    }
}
