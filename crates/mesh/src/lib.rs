//! Surfaces into elements: axis A of the hybrids table.

pub mod contract;

pub use contract::{MeshSettings, Strategy};
