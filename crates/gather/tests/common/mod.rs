//! Small scenes of quadrilaterals, each one surface, one finish and one patch.

use luxel_core::*;
use std::sync::Arc;

/// One parallelogram: corner, two edges (their cross product is the front), finish.
#[derive(Clone)]
pub struct Quad {
    pub corner: Vec3,
    pub u: Vec3,
    pub v: Vec3,
    pub exitance: f32,
    pub group: u32,
    /// Whether the front reflects, and so has elements.
    pub reflects: bool,
    pub grid: [u32; 2],
}

impl Quad {
    pub fn new(corner: [f32; 3], u: [f32; 3], v: [f32; 3]) -> Quad {
        Quad {
            corner: corner.into(),
            u: u.into(),
            v: v.into(),
            exitance: 0.0,
            group: 0,
            reflects: false,
            grid: [1, 1],
        }
    }
    pub fn emits(self, exitance: f32) -> Quad {
        Quad { exitance, ..self }
    }
    pub fn in_group(self, group: u32) -> Quad {
        Quad { group, ..self }
    }
    pub fn reflecting(self, n: u32) -> Quad {
        Quad {
            reflects: true,
            grid: [n, n],
            ..self
        }
    }
    pub fn flipped(self) -> Quad {
        Quad {
            u: self.v,
            v: self.u,
            ..self
        }
    }
    pub fn polygon(&self) -> Polygon {
        let (o, u, v) = (self.corner.as_dvec3(), self.u.as_dvec3(), self.v.as_dvec3());
        Polygon::new(vec![o, o + u, o + u + v, o + v])
    }
}

/// The six sides of a box, fronts inward when `inside`.
pub fn cuboid(low: [f32; 3], high: [f32; 3], inside: bool) -> Vec<Quad> {
    let (l, d) = (Vec3::from(low), Vec3::from(high) - Vec3::from(low));
    let (x, y, z) = (Vec3::X * d.x, Vec3::Y * d.y, Vec3::Z * d.z);
    let q = |c: Vec3, u: Vec3, v: Vec3| Quad::new(c.into(), u.into(), v.into());
    let all = [
        q(l, x, y),
        q(l + z, y, x),
        q(l, z, x),
        q(l + y, x, z),
        q(l, y, z),
        q(l + x, z, y),
    ];
    all.map(|q| if inside { q } else { q.flipped() }).to_vec()
}

pub fn scene(quads: &[Quad], groups: u32) -> (Arc<Scene>, Front) {
    let mut s = Scene {
        up: Vec3::Z,
        ..Scene::default()
    };
    s.groups = (0..groups)
        .map(|g| Group {
            name: format!("group {g}"),
        })
        .collect();
    for (k, q) in quads.iter().enumerate() {
        let first = s.positions.len() as u32;
        let at = s.triangles.len() as u32;
        s.positions.extend([
            q.corner,
            q.corner + q.u,
            q.corner + q.u + q.v,
            q.corner + q.v,
        ]);
        s.triangles
            .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        s.surface_of.extend([SurfaceId(k as u32); 2]);
        s.source_triangle.extend([0, 1]);
        s.surfaces.push(Surface {
            name: format!("quad {k}"),
            finish: FinishId(k as u32),
            triangles: at..at + 2,
            node: 0,
            mesh: 0,
            primitive: k as u32,
        });
        let luminance = Rgb::splat(q.exitance / quantity::LAMBERTIAN);
        s.finishes.push(Finish {
            reflectance: if q.reflects {
                Rgb::splat(0.5)
            } else {
                Rgb::BLACK
            },
            emission: (q.exitance > 0.0).then_some(Emission {
                luminance,
                texture: None,
                group: GroupId(q.group),
            }),
            ..Finish::default()
        });
    }
    let mut front = Front::new(s.triangles.len());
    for (k, q) in quads.iter().enumerate() {
        if !q.reflects && q.exitance == 0.0 {
            continue;
        }
        let group = if q.exitance > 0.0 {
            GroupId(q.group)
        } else {
            GroupId::NONE
        };
        let shape = Shape::Parallelogram {
            origin: q.corner,
            edge_u: q.u,
            edge_v: q.v,
        };
        let sources = [2 * k as u32, 2 * k as u32 + 1];
        let before = front.len();
        front.add_patch(
            SurfaceId(k as u32),
            Side::Front,
            shape,
            q.grid,
            group,
            &sources,
        );
        for e in before..front.len() {
            front.emission[e] = Rgb::splat(q.exitance);
            front.reflectance[e] = s.finishes[k].reflectance;
        }
    }
    (Arc::new(s), front)
}

pub fn solution(scene: &Scene, front: &Front, exitance: impl Fn(usize, usize) -> f32) -> Solution {
    let layers = scene.layers();
    let columns = layers.columns();
    let exitance = (0..front.len() * columns)
        .map(|i| exitance(i / columns, i % columns))
        .collect();
    Solution {
        layers,
        exitance,
        ..Solution::default()
    }
}
