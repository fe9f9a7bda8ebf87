//! Facets: the rows of a view-factor matrix, as their users number them.
//!
//! A row is one facet of the file: a triangle, a quad, a polygon, or several of them that the
//! file puts together. What the kernels need is convex and planar, so a row is made of
//! *parts*. Parts of no row only stand in the way. Each part sends and receives on its front
//! (corners counter-clockwise) and blocks from both sides.

use crate::polygon::Polygon;

/// A convex planar piece of a row, or something that only blocks.
#[derive(Clone, Debug, PartialEq)]
pub struct FacetPart {
    /// Corners in metres, counter-clockwise from the front. Has area.
    pub polygon: Polygon,
    /// Its row; [`Facets::NO_ROW`] for what only blocks.
    pub row: u32,
}

/// One row of the matrix.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facet {
    /// Name in the file, or empty.
    pub name: String,
    /// Index into [`Facets::objects`].
    pub object: u32,
    /// Index into [`Facets::materials`].
    pub material: u32,
}

/// All facets of a file, in its order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facets {
    /// Name, usually the file's.
    pub name: String,
    /// Rows, in file order. A facet without area keeps its row and has no part.
    pub rows: Vec<Facet>,
    /// Pieces of the rows and blockers.
    pub parts: Vec<FacetPart>,
    /// Names of objects (OBJ `o` and `g`, STL `solid`, glTF node, otherwise one).
    pub objects: Vec<String>,
    /// Names of materials; one that is empty where the format has none.
    pub materials: Vec<String>,
    /// Coordinates are known to this many metres: half a unit in the last place of the largest
    /// one, as the file stored it. Planes that differ by less are the same.
    pub rounding_m: f64,
}

impl Facets {
    /// `row` of a part that only blocks.
    pub const NO_ROW: u32 = u32::MAX;

    /// Area of each row, m²: the sum over its parts.
    pub fn areas(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.rows.len()];
        for part in self.parts.iter().filter(|p| p.row != Facets::NO_ROW) {
            areas[part.row as usize] += part.polygon.area();
        }
        areas
    }
}

/// A sparse matrix that is read row by row, any number of times: what is written to files.
pub trait SparseRows {
    /// Rows and columns.
    fn shape(&self) -> [usize; 2];

    /// Number of entries in all rows.
    fn entries(&self) -> u64;

    /// Replaces `entries` by row `row`: columns in ascending order, each at most once, and values.
    fn row(&self, row: usize, entries: &mut Vec<(u32, f64)>);
}
