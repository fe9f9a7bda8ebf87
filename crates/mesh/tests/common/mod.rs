//! What the tests of this crate share.

use luxel_core::Vec3;
use luxel_mesh::MeshSettings;

pub fn v(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z)
}

pub fn settings(max_area_m2: f32) -> MeshSettings {
    MeshSettings {
        max_area_m2,
        min_edge_m: 0.01,
        max_elements: 100_000,
        max_per_region: usize::MAX,
        cluster: true,
    }
}
