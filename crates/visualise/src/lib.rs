//! Pictures, vertex values and reports from a solution, which is borrowed and never changed.
//!
//! - [`lit_mesh`]: the elements as triangles with illuminance at their vertices
//! - [`report`]: `report.json` and the table for people

pub mod lit_mesh;
mod places;
pub mod report;

pub use lit_mesh::{LitMesh, LitPart};
pub use report::Report;
