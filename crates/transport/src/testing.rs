//! What several tests share: a ray caster that tries every triangle, small scenes, and the
//! reference cases beside the project.

use crate::contract::{Hit, Ray, RayCaster};
use luxel_core::{
    DVec3, Finish, FinishId, Front, GroupId, Polygon, Scene, Shape, Side, Surface, SurfaceId, Vec3,
};
use serde_json::Value;

/// Tries every triangle of a scene, in double precision.
pub(crate) struct BruteForce {
    triangles: Vec<[DVec3; 3]>,
}

impl BruteForce {
    pub fn new(scene: &Scene) -> Self {
        let triangles = (0..scene.triangles.len()).map(|t| scene.corners(t).map(|c| c.as_dvec3()));
        BruteForce {
            triangles: triangles.collect(),
        }
    }

    fn nearest(&self, ray: &Ray) -> Hit {
        let mut best = Hit {
            t: ray.t_max,
            ..Hit::MISS
        };
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        for (k, &[a, b, c]) in self.triangles.iter().enumerate() {
            let (e1, e2) = (b - a, c - a);
            let p = d.cross(e2);
            let det = e1.dot(p);
            if det == 0.0 {
                continue;
            }
            let s = o - a;
            let u = s.dot(p) / det;
            let q = s.cross(e1);
            let v = d.dot(q) / det;
            let t = e2.dot(q) / det;
            // A hair of overlap closes the seam between two triangles.
            let inside = u >= -1e-9 && v >= -1e-9 && u + v <= 1.0 + 1e-9;
            if inside && t > ray.t_min as f64 && t < best.t as f64 {
                let side = if det > 0.0 { Side::Front } else { Side::Back };
                best = Hit {
                    t: t as f32,
                    triangle: k as u32,
                    u: u as f32,
                    v: v as f32,
                    side,
                };
            }
        }
        if best.is_hit() { best } else { Hit::MISS }
    }
}

impl RayCaster for BruteForce {
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]) {
        for (ray, hit) in rays.iter().zip(hits) {
            *hit = self.nearest(ray);
        }
    }

    fn visibility(&self, segments: &[Ray], visible: &mut [f32]) {
        for (ray, v) in segments.iter().zip(visible) {
            *v = if self.nearest(ray).is_hit() { 0.0 } else { 1.0 };
        }
    }

    fn offset_m(&self) -> f32 {
        1e-5
    }
}

/// A scene of parallelograms `(origin, edge_u, edge_v)`, fronts towards `edge_u x edge_v`, each
/// cut into `cells` x `cells` elements; backs are black.
pub(crate) fn parallelograms(sides: &[[Vec3; 3]], cells: u32) -> (Scene, Front) {
    let mut scene = Scene {
        finishes: vec![Finish::default()],
        ..Scene::default()
    };
    for (k, &[o, u, v]) in sides.iter().enumerate() {
        let base = scene.positions.len() as u32;
        scene.positions.extend([o, o + u, o + u + v, o + v]);
        scene
            .triangles
            .extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        scene.surface_of.extend([SurfaceId::from(k); 2]);
        scene.source_triangle.extend([0, 1]);
        let first = 2 * k as u32;
        scene.surfaces.push(Surface {
            name: format!("side {k}"),
            finish: FinishId(0),
            triangles: first..first + 2,
            node: 0,
            mesh: 0,
            primitive: 0,
        });
    }
    let mut front = Front::new(scene.triangles.len());
    for (k, &[origin, edge_u, edge_v]) in sides.iter().enumerate() {
        let shape = Shape::Parallelogram {
            origin,
            edge_u,
            edge_v,
        };
        let first = 2 * k as u32;
        front.add_patch(
            SurfaceId::from(k),
            Side::Front,
            shape,
            [cells; 2],
            GroupId::NONE,
            &[first, first + 1],
        );
    }
    (scene, front)
}

/// The inside of the unit cube: floor, ceiling, then the walls x = 0, x = 1, y = 0, y = 1.
pub(crate) fn cube(cells: u32) -> (Scene, Front) {
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    parallelograms(
        &[
            [Vec3::ZERO, x, y],
            [z, y, x],
            [Vec3::ZERO, y, z],
            [x, z, y],
            [Vec3::ZERO, z, x],
            [y, x, z],
        ],
        cells,
    )
}

/// The cases of one reference file, or `None` (and a word on stderr) where it is absent.
pub(crate) fn cases(file: &str) -> Option<Vec<Value>> {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let path = root
        .ancestors()
        .map(|p| p.join("shared/reference").join(file))
        .find(|p| p.exists());
    let Some(path) = path else {
        eprintln!("skipped: no shared/reference/{file} beside the project");
        return None;
    };
    let text = std::fs::read_to_string(path).expect("it was just found");
    let json: Value = serde_json::from_str(&text).expect("a reference file is JSON");
    json["cases"].as_array().cloned()
}

/// A JSON list of three numbers.
pub(crate) fn vector(v: &Value) -> DVec3 {
    let at = |k: usize| v[k].as_f64().expect("a number");
    DVec3::new(at(0), at(1), at(2))
}

/// A JSON surface of shape `polygon`.
pub(crate) fn polygon(surface: &Value) -> Polygon {
    Polygon::new(
        surface["vertices"]
            .as_array()
            .expect("vertices")
            .iter()
            .map(vector)
            .collect(),
    )
}

/// Surface of a case by its id.
pub(crate) fn surface<'a>(case: &'a Value, id: &Value) -> &'a Value {
    let surfaces = case["scene"]["surfaces"].as_array().expect("surfaces");
    surfaces
        .iter()
        .find(|s| s["id"] == *id)
        .expect("the case names its surfaces")
}

/// Whether a surface is a polygon.
pub(crate) fn is_polygon(surface: &Value) -> bool {
    surface["shape"] == "polygon"
}

/// Largest relative error that a query allows, and its expected value.
pub(crate) fn expected(query: &Value) -> (f64, f64) {
    (
        query["expected"].as_f64().expect("a number"),
        3.0 * query["unc"].as_f64().unwrap_or(0.0),
    )
}
