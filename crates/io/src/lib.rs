//! Files in and out: scene files into a [`Scene`](luxel_core::Scene), lit scenes and solutions
//! out of it.
//!
//! Only this crate knows file formats. Scene files are dirty, and may be hostile: what can be
//! repaired is repaired and becomes a [`Warning`](luxel_core::Warning) with its place; what
//! cannot is an [`Error`] of one line. No bytes make a reader panic, and nothing is allocated
//! by a count in a file before that count was held against the bytes that are there.
//!
//! - glTF 2.0 and GLB: [`mod@gltf_reader`]
//! - OBJ with MTL: [`mod@obj_reader`]
//! - facets for view factors, out of STL, PLY, OBJ, glTF and VS3: [`mod@facet_reader`]
//! - geometry made fit for lighting: [`mod@repair`]
//! - light added from the command line: [`mod@scene_ops`]
//! - the lit scene as glTF: [`mod@write_gltf`]; the solution to resume: [`mod@solution_file`]
//! - view factors as sparse matrices: [`mod@write_factors`]; parts of them while they are computed:
//!   [`mod@batch_file`]

mod assemble;
pub mod atomic;
pub mod batch_file;
mod budget;
mod document;
mod error;
pub mod facet_reader;
pub mod gltf_reader;
mod json;
pub mod obj_reader;
mod options;
mod picture;
pub mod repair;
pub mod scene_ops;
pub mod solution_file;
mod uri;
pub mod write_exr;
mod write_factors;
pub mod write_gltf;

pub use atomic::write as write_atomic;
pub use batch_file::{Batch, BatchEntry, BatchFile, Content, Lost, Tally, facets_fingerprint};
pub use document::{Document, ExternalImage, GltfSource, Kind, Resolver, Source, read, read_bytes};
pub use error::{Error, Place, WriteError, plainly};
pub use facet_reader::{FacetDocument, FacetKind, FacetOptions, read_facets, read_facets_bytes};
pub use options::{Back, ReadOptions, Up};
pub use solution_file::{StoredSolution, fingerprint, read_solution, write_solution};
pub use write_exr::write_exr;
pub use write_factors::{FactorFormat, Precision, write_compressed, write_factors};
pub use write_gltf::{LitPrimitive, LitScale, lit_glb, write_lit_glb};
