//! The nouns of Luxel: what a scene is, how it is cut into elements, what a solution holds.
//!
//! No files, threads, clocks or random source; builds for wasm. Every other crate imports this
//! one and speaks its words. Lengths are metres, angles radians, light is photometric
//! (lumens), colours are linear RGB. Numbers are stored as `f32` and summed as `f64`.

pub mod buckets;
pub mod compressed;
pub mod element;
pub mod facets;
pub mod front;
pub mod hierarchy;
pub mod layers;
pub mod patch_sources;
pub mod polygon;
pub mod quantity;
pub mod scene;
pub mod solution;
pub mod texture;
pub mod warning;

pub use buckets::Buckets;
pub use compressed::{CompressedPiece, EntryTile, LowRankBlock};
pub use element::{ElementId, FinishId, GroupId, PatchId, SurfaceId, TextureId};
pub use facets::{Facet, FacetPart, Facets, SparseRows};
pub use front::{Front, FrontChange, Patch, RefinementWish, Shape, Side};
pub use glam;
pub use glam::{DVec3, Vec2, Vec3};
pub use hierarchy::Hierarchy;
pub use layers::Layers;
pub use patch_sources::{PatchSources, triangles_of_patches};
pub use polygon::Polygon;
pub use quantity::Rgb;
pub use scene::{
    Alpha, Emission, Finish, Group, Luminaire, LuminaireKind, Scene, Sky, Surface, View,
};
pub use solution::Solution;
pub use texture::Texture;
pub use warning::{Warning, Warnings};
