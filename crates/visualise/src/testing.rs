//! Small scenes and fronts for the tests of this crate.

use crate::lit_mesh::LitMesh;
use luxel_core::{Finish, Front, Rgb, Scene, Sky, Vec3};
use luxel_mesh::{MeshSettings, Strategy, Uniform};
use luxel_scenes::Builder;
use luxel_transport::bvh::Bvh;
use std::sync::Arc;

/// A uniform front with elements of at most this area.
pub fn front(scene: &Scene, max_area_m2: f32, cluster: bool) -> Front {
    Uniform::new(mesh_settings(max_area_m2, cluster)).initial(scene)
}

/// Settings of such a front.
pub fn mesh_settings(max_area_m2: f32, cluster: bool) -> MeshSettings {
    MeshSettings {
        max_area_m2,
        min_edge_m: 1e-3,
        max_elements: 100_000,
        max_per_region: usize::MAX,
        cluster,
    }
}

/// What `build` makes on so many threads.
pub fn on_threads<T: Send>(threads: usize, build: impl FnOnce() -> T + Send) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.expect("threads").install(build)
}

/// The ray engine of a scene.
pub fn caster(scene: &Scene) -> Bvh {
    Bvh::build(&Arc::new(scene.clone()))
}

/// A room of 5 x 3 x 4 m whose walls are seen from inside.
pub fn room() -> Scene {
    let mut b = Builder::new("room");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    b.on("room", grey)
        .room(Vec3::ZERO, Vec3::new(5.0, 3.0, 4.0), 63);
    b.build()
}

/// A level square of 2 x 2 m around the origin, front up, of this finish.
pub fn square(finish: Finish) -> Scene {
    let mut b = Builder::new("square");
    let f = b.finish(finish);
    let p = |x, z| Vec3::new(x, 0.0, z);
    b.on("square", f)
        .polygon(&[p(-1.0, 1.0), p(1.0, 1.0), p(1.0, -1.0), p(-1.0, -1.0)]);
    b.build()
}

/// The mesh of a scene with the illuminance that `lux` gives at each vertex.
pub fn lit(scene: &Scene, front: &Front, lux: impl Fn(Vec3) -> Rgb) -> LitMesh {
    let mut mesh = LitMesh::build(scene, front, None);
    let values: Vec<Rgb> = mesh.positions.iter().map(|&p| lux(p)).collect();
    let errors = vec![1.0; values.len()];
    mesh.set_light(values, errors);
    mesh
}

/// A sky of this luminance.
pub fn sky(luminance: f32) -> Sky {
    Sky {
        luminance: Rgb::splat(luminance),
        group: luxel_core::GroupId(0),
    }
}
