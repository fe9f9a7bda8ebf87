//! Surfaces into elements: axis A of the hybrids table.
//!
//! [`prepare`](prepare::prepare) conforms the geometry for light, a [`Strategy`] of some
//! [`Kind`] makes fronts of it, [`hierarchy`](hierarchy::hierarchy) puts a tree over any front.

pub mod adaptive;
mod cluster;
mod contact;
pub mod contract;
mod cut;
pub mod dense;
pub mod discontinuity;
mod flat;
pub mod hierarchy;
pub mod kinds;
mod neighbours;
pub mod prepare;
pub mod rex;
pub mod shade;
pub mod sides;
pub mod uniform;

pub use adaptive::{Adaptive, neighbour_difference};
pub use contract::{MeshSettings, Strategy};
pub use dense::Dense;
pub use hierarchy::hierarchy;
pub use kinds::Kind;
pub use prepare::{PrepareSettings, prepare};
pub use rex::Rex;
pub use shade::shade;
pub use uniform::Uniform;
