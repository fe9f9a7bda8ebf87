//! Pictures, vertex values and reports from a solution, which is borrowed and never changed.
//!
//! - [`lit_mesh`]: the elements as triangles with illuminance at their vertices
//! - [`lightmap`]: the light of surfaces as texels of an atlas
//! - [`preview`]: a picture of them, and [`auto_view`] for where to stand
//! - [`tone`]: exposure, tone curve, false colour
//! - [`report`]: `report.json` and the table for people

pub mod auto_view;
mod glyphs;
pub mod lightmap;
pub mod lit_mesh;
mod long_edges;
mod outlines;
mod places;
pub mod preview;
mod raster;
pub mod report;
mod sets;
#[cfg(test)]
mod testing;
pub mod tone;

pub use auto_view::{auto_view, first_view};
pub use lightmap::{ChartSettings, Charts, Lightmap, Sparse, Texels};
pub use lit_mesh::{LitMesh, LitPart};
pub use preview::{Picture, PreviewSettings};
pub use report::Report;
pub use tone::Exposure;
