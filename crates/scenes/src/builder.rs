//! Builds a [`Scene`] from polygons: surfaces by name, finishes, and solids with chosen faces.
//!
//! Points pass through the current [`Place`] and are rounded to a micrometre, so that edges that
//! meet on paper meet exactly in `f32` and the bytes do not hang on a platform's sine.
//! Polygons may be concave and may have corners on their straight edges: a wall takes the corners
//! of its door opening, and so needs no T-vertex.

use luxel_core::{
    Alpha, Emission, Finish, FinishId, Group, GroupId, Luminaire, LuminaireKind, Rgb, Scene,
    Surface, SurfaceId, Texture, TextureId, Vec2, Vec3, View, quantity::LAMBERTIAN,
};
use std::collections::HashMap;

/// Shorthand for a point in metres.
pub const fn at(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z)
}

/// Where the following geometry goes: turned about the y axis, then moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Where the local origin comes to lie, metres.
    pub origin: Vec3,
    /// Turn about +y, counter-clockwise seen from above, degrees.
    pub turn_deg: f32,
}

impl Place {
    /// World coordinates.
    pub const WORLD: Place = Place {
        origin: Vec3::ZERO,
        turn_deg: 0.0,
    };

    /// A place on the floor or anywhere else.
    pub const fn new(origin: Vec3, turn_deg: f32) -> Self {
        Place { origin, turn_deg }
    }

    /// World position of a local point, metres.
    pub fn world_from_local(&self, p: Vec3) -> Vec3 {
        let (s, c) = (self.turn_deg as f64).to_radians().sin_cos();
        let (x, z) = (p.x as f64, p.z as f64);
        let micrometre = |v: f64| ((v * 1e6).round() / 1e6) as f32;
        // 60.0 m as a product in f32 may be 4 micrometres off: neighbours would not meet.
        let snapped = |v: f32| (v as f64 * 1e5).round() / 1e5;
        Vec3::new(
            micrometre(c * x + s * z + snapped(self.origin.x)),
            micrometre(p.y as f64 + snapped(self.origin.y)),
            micrometre(c * z - s * x + snapped(self.origin.z)),
        )
    }

    /// This place as seen from another: first `self`, then `outer`.
    pub fn within(&self, outer: Place) -> Place {
        Place {
            origin: outer.world_from_local(self.origin),
            turn_deg: self.turn_deg + outer.turn_deg,
        }
    }
}

/// Faces of a block, as bits.
pub mod faces {
    /// Towards -x.
    pub const LEFT: u8 = 1;
    /// Towards +x.
    pub const RIGHT: u8 = 2;
    /// Towards -y.
    pub const BOTTOM: u8 = 4;
    /// Towards +y.
    pub const TOP: u8 = 8;
    /// Towards -z.
    pub const BACK: u8 = 16;
    /// Towards +z.
    pub const FRONT: u8 = 32;
    /// All six.
    pub const ALL: u8 = 63;
    /// Standing on something: no bottom.
    pub const STANDING: u8 = ALL & !BOTTOM;
    /// Hanging from something: no top.
    pub const HANGING: u8 = ALL & !TOP;
    /// A post between two things: the four upright faces.
    pub const POST: u8 = LEFT | RIGHT | BACK | FRONT;
}

struct Piece {
    name: String,
    finish: FinishId,
    triangles: Vec<[u32; 3]>,
    uvs: Vec<[Vec2; 3]>,
}

/// A scene under construction.
pub struct Builder {
    scene: Scene,
    index_of_point: HashMap<[u32; 3], u32>,
    pieces: Vec<Piece>,
    piece_of_name: HashMap<(String, u32), usize>,
    current: usize,
    place: Place,
    tile_m: f32,
}

impl Builder {
    /// An empty scene, y up.
    pub fn new(name: &str) -> Self {
        Builder {
            scene: Scene {
                name: name.into(),
                up: Vec3::Y,
                ..Scene::default()
            },
            index_of_point: HashMap::new(),
            pieces: Vec::new(),
            piece_of_name: HashMap::new(),
            current: 0,
            place: Place::WORLD,
            tile_m: 1.0,
        }
    }

    /// Adds a picture for finishes to use.
    pub fn texture(&mut self, texture: Texture) -> TextureId {
        self.scene.textures.push(texture);
        TextureId::from(self.scene.textures.len() - 1)
    }

    /// Adds any finish.
    pub fn finish(&mut self, finish: Finish) -> FinishId {
        self.scene.finishes.push(finish);
        FinishId::from(self.scene.finishes.len() - 1)
    }

    /// Adds a finish of one diffuse reflectance, per band.
    pub fn matte(&mut self, name: &str, r: f32, g: f32, b: f32) -> FinishId {
        let reflectance = Rgb::new(r, g, b);
        self.finish(Finish {
            name: name.into(),
            reflectance,
            ..Finish::default()
        })
    }

    /// Adds a matte finish that reflects on both sides: leaves, paper, lamp shades.
    pub fn thin(&mut self, name: &str, r: f32, g: f32, b: f32) -> FinishId {
        let reflectance = Rgb::new(r, g, b);
        let name = name.into();
        self.finish(Finish {
            name,
            reflectance,
            back_reflects: true,
            ..Finish::default()
        })
    }

    /// Adds a finish with a picture, dimmed or brightened so that its mean reflectance is `mean`.
    pub fn pictured(&mut self, name: &str, texture: TextureId, mean: f32) -> FinishId {
        let own = self.scene.textures[texture.index()].mean().luminance();
        let reflectance = Rgb::splat(mean / own);
        debug_assert!(reflectance.r <= 1.0, "{name}: the picture is too dark");
        let texture = Some(texture);
        self.finish(Finish {
            name: name.into(),
            reflectance,
            texture,
            ..Finish::default()
        })
    }

    /// Adds clear glass.
    pub fn glass(&mut self, name: &str) -> FinishId {
        self.finish(Finish {
            name: name.into(),
            reflectance: Rgb::WHITE,
            transparent: true,
            back_reflects: true,
            alpha: Alpha::Opaque,
            ..Finish::default()
        })
    }

    /// Adds a finish that shines with a luminance in cd/m² and a luminaire group of its own.
    ///
    /// `tint` gives the colour of the light; it is scaled so that `luminance` is photometric.
    pub fn luminous(
        &mut self,
        name: &str,
        reflectance: f32,
        luminance: f32,
        tint: Rgb,
    ) -> FinishId {
        self.scene.groups.push(Group { name: name.into() });
        let group = GroupId::from(self.scene.groups.len() - 1);
        let luminance = tint * (luminance / tint.luminance());
        self.finish(Finish {
            name: name.into(),
            reflectance: Rgb::splat(reflectance),
            emission: Some(Emission {
                luminance,
                texture: None,
                group,
            }),
            ..Finish::default()
        })
    }

    /// Changes a finish that was added before.
    pub fn edit(&mut self, finish: FinishId, change: impl FnOnce(&mut Finish)) {
        change(&mut self.scene.finishes[finish.index()]);
    }

    /// Adds a luminaire without size and a group of its own.
    pub fn luminaire(&mut self, name: &str, position: Vec3, aim: Vec3, kind: LuminaireKind) {
        self.scene.groups.push(Group { name: name.into() });
        let group = GroupId::from(self.scene.groups.len() - 1);
        let direction = (aim - position).normalize();
        self.scene.luminaires.push(Luminaire {
            name: name.into(),
            position,
            direction,
            kind,
            group,
        });
    }

    /// Adds a view from `eye` to `target`.
    pub fn view(&mut self, name: &str, eye: Vec3, target: Vec3, vertical_deg: f32) {
        let forward = (target - eye).normalize();
        let up = forward.cross(Vec3::Y).cross(forward).normalize();
        self.scene.views.push(View {
            name: name.into(),
            eye,
            forward,
            up,
            vertical_angle: vertical_deg.to_radians(),
        });
    }

    /// Following geometry belongs to the surface of this name and finish, new or begun before.
    pub fn on(&mut self, surface: &str, finish: FinishId) -> &mut Self {
        let key = (surface.to_string(), finish.0);
        self.current = *self.piece_of_name.entry(key).or_insert_with(|| {
            self.pieces.push(Piece {
                name: surface.into(),
                finish,
                triangles: Vec::new(),
                uvs: Vec::new(),
            });
            self.pieces.len() - 1
        });
        self
    }

    /// Following geometry is placed here; returns where it was placed before.
    pub fn place(&mut self, place: Place) -> Place {
        std::mem::replace(&mut self.place, place)
    }

    /// The current place.
    pub fn placed(&self) -> Place {
        self.place
    }

    /// Builds something at a place seen from the current one, then goes back.
    pub fn inside(&mut self, place: Place, build: impl FnOnce(&mut Builder)) -> &mut Self {
        let before = self.place(place.within(self.placed()));
        build(self);
        self.place(before);
        self
    }

    /// Following polygons repeat their picture every so many metres.
    pub fn tile(&mut self, metres: f32) -> &mut Self {
        self.tile_m = metres;
        self
    }

    /// Adds a flat polygon, counter-clockwise from the front; it may be concave.
    ///
    /// The picture lies flat on it, along the two axes nearest to its plane.
    pub fn polygon(&mut self, points: &[Vec3]) -> &mut Self {
        let tile = self.tile_m;
        let n = newell(points).abs();
        let uv = |p: &Vec3| {
            let flat = if n.y >= n.x && n.y >= n.z {
                Vec2::new(p.x, p.z)
            } else if n.x >= n.z {
                Vec2::new(p.z, -p.y)
            } else {
                Vec2::new(p.x, -p.y)
            };
            flat / tile
        };
        let uvs: Vec<Vec2> = points.iter().map(uv).collect();
        self.polygon_with_uvs(points, &uvs)
    }

    /// Adds a rectangle that shows the whole picture: corners bottom left, bottom right, top
    /// right, top left as seen from the front.
    pub fn picture(&mut self, corners: [Vec3; 4]) -> &mut Self {
        let uvs = [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)].map(|(u, v)| Vec2::new(u, v));
        self.polygon_with_uvs(&corners, &uvs)
    }

    fn polygon_with_uvs(&mut self, points: &[Vec3], uvs: &[Vec2]) -> &mut Self {
        for ear in ears(points) {
            let triangle = ear.map(|k| {
                let p = self.place.world_from_local(points[k]);
                self.vertex(p)
            });
            let piece = &mut self.pieces[self.current];
            piece.triangles.push(triangle);
            piece.uvs.push(ear.map(|k| uvs[k]));
        }
        self
    }

    fn vertex(&mut self, p: Vec3) -> u32 {
        // Adding zero turns -0 into +0: one point, one key.
        let key = (p + Vec3::ZERO).to_array().map(f32::to_bits);
        *self.index_of_point.entry(key).or_insert_with(|| {
            self.scene.positions.push(p + Vec3::ZERO);
            self.scene.positions.len() as u32 - 1
        })
    }

    /// Adds chosen faces of a block, fronts outward (see [`faces`]).
    pub fn block(&mut self, low: Vec3, high: Vec3, which: u8) -> &mut Self {
        for (bit, polygon) in block_faces(low, high) {
            if which & bit != 0 {
                self.polygon(&polygon);
            }
        }
        self
    }

    /// Adds chosen faces of a block, fronts inward: a room.
    pub fn room(&mut self, low: Vec3, high: Vec3, which: u8) -> &mut Self {
        for (bit, mut polygon) in block_faces(low, high) {
            if which & bit != 0 {
                polygon.reverse();
                self.polygon(&polygon);
            }
        }
        self
    }

    /// Adds the side of an upright frustum of `sides` flat faces, fronts outward: `radius` at the
    /// bottom and at the top, the top `height` above `base`.
    pub fn frustum(
        &mut self,
        base: Vec3,
        radius: [f32; 2],
        height: f32,
        sides: usize,
    ) -> &mut Self {
        let low = ring(base, radius[0], sides);
        let high = ring(base + Vec3::Y * height, radius[1], sides);
        for i in 0..sides {
            let j = (i + 1) % sides;
            self.polygon(&[low[i], low[j], high[j], high[i]]);
        }
        self
    }

    /// Adds a level disc of `sides` corners that faces up or down.
    pub fn disc(&mut self, centre: Vec3, radius: f32, sides: usize, up: bool) -> &mut Self {
        let mut rim = ring(centre, radius, sides);
        if !up {
            rim.reverse();
        }
        // A fan from the middle: ears of a rim alone are slivers.
        for i in 0..sides {
            self.polygon(&[centre, rim[i], rim[(i + 1) % sides]]);
        }
        self
    }

    /// Adds a ball of `rings` x `sides` faces, fronts outward, poles on the y axis.
    pub fn ball(&mut self, centre: Vec3, radius: f32, rings: usize, sides: usize) -> &mut Self {
        let level = |k: usize| {
            let angle = std::f32::consts::PI * k as f32 / rings as f32;
            ring(
                centre - Vec3::Y * radius * angle.cos(),
                radius * angle.sin(),
                sides,
            )
        };
        let (south, north) = (centre - Vec3::Y * radius, centre + Vec3::Y * radius);
        for k in 0..rings {
            let (low, high) = (level(k), level(k + 1));
            for i in 0..sides {
                let j = (i + 1) % sides;
                match k {
                    0 => self.polygon(&[south, high[j], high[i]]),
                    _ if k + 1 == rings => self.polygon(&[low[i], low[j], north]),
                    _ => {
                        // Rounding bends the quad by a micrometre: two triangles stay exact.
                        self.polygon(&[low[i], low[j], high[j]]);
                        self.polygon(&[low[i], high[j], high[i]])
                    }
                };
            }
        }
        self
    }

    /// The finished scene: triangles of a surface in one run, a group even when nothing shines.
    pub fn build(mut self) -> Scene {
        let pictured = self.scene.finishes.iter().any(|f| f.texture.is_some());
        for piece in self.pieces.into_iter().filter(|p| !p.triangles.is_empty()) {
            let surface = self.scene.surfaces.len();
            let first = self.scene.triangles.len() as u32;
            let count = piece.triangles.len() as u32;
            if pictured {
                if self.scene.finishes[piece.finish.index()].texture.is_some() {
                    self.scene.uvs.extend(piece.uvs);
                } else {
                    self.scene
                        .uvs
                        .extend(piece.uvs.iter().map(|_| [Vec2::ZERO; 3]));
                }
            }
            self.scene.triangles.extend(piece.triangles);
            self.scene
                .surface_of
                .extend((0..count).map(|_| SurfaceId::from(surface)));
            self.scene.source_triangle.extend(0..count);
            self.scene.surfaces.push(Surface {
                name: piece.name,
                finish: piece.finish,
                triangles: first..first + count,
                node: surface as u32,
                mesh: surface as u32,
                primitive: 0,
            });
        }
        if self.scene.groups.is_empty() {
            self.scene.groups.push(Group {
                name: "dark".into(),
            });
        }
        self.scene
    }
}

/// Luminance of a Lambertian luminaire of this flux in lm and luminous area in m², cd/m².
pub fn luminance_of(flux_lm: f32, area_m2: f32) -> f32 {
    flux_lm / (LAMBERTIAN * area_m2)
}

/// Random number 0..1 from a seed and an index; the same everywhere [Steele14, SplitMix64].
pub fn random(seed: u64, index: u64) -> f32 {
    let mut z =
        seed.wrapping_mul(0xd134_2543_de82_ef95) ^ index.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
}

/// Points of a level circle, counter-clockwise seen from above.
fn ring(centre: Vec3, radius: f32, sides: usize) -> Vec<Vec3> {
    (0..sides)
        .map(|i| {
            let angle = std::f32::consts::TAU * i as f32 / sides as f32;
            centre + at(radius * angle.cos(), 0.0, -radius * angle.sin())
        })
        .collect()
}

fn block_faces(a: Vec3, b: Vec3) -> [(u8, [Vec3; 4]); 6] {
    let p = |x: bool, y: bool, z: bool| {
        at(
            if x { b.x } else { a.x },
            if y { b.y } else { a.y },
            if z { b.z } else { a.z },
        )
    };
    let (o, l) = (false, true);
    [
        (
            faces::LEFT,
            [p(o, o, o), p(o, o, l), p(o, l, l), p(o, l, o)],
        ),
        (
            faces::RIGHT,
            [p(l, o, l), p(l, o, o), p(l, l, o), p(l, l, l)],
        ),
        (
            faces::BOTTOM,
            [p(o, o, o), p(l, o, o), p(l, o, l), p(o, o, l)],
        ),
        (faces::TOP, [p(o, l, l), p(l, l, l), p(l, l, o), p(o, l, o)]),
        (
            faces::BACK,
            [p(l, o, o), p(o, o, o), p(o, l, o), p(l, l, o)],
        ),
        (
            faces::FRONT,
            [p(o, o, l), p(l, o, l), p(l, l, l), p(o, l, l)],
        ),
    ]
}

/// Twice the area times the normal [Newell, in Sutherland74].
fn newell(points: &[Vec3]) -> Vec3 {
    let mut n = Vec3::ZERO;
    for (i, &p) in points.iter().enumerate() {
        n += (p - points[0]).cross(points[(i + 1) % points.len()] - points[0]);
    }
    n
}

/// Cuts a simple polygon into triangles, best-shaped ear first [Meisters75].
fn ears(points: &[Vec3]) -> Vec<[usize; 3]> {
    let normal = newell(points).normalize();
    let mut left: Vec<usize> = (0..points.len()).collect();
    let mut triangles = Vec::with_capacity(points.len().saturating_sub(2));
    let area = |a: Vec3, b: Vec3, c: Vec3| (b - a).cross(c - a).dot(normal);
    while left.len() > 3 {
        let n = left.len();
        let mut best: Option<(f32, usize)> = None;
        for i in 0..n {
            let [a, b, c] = [left[(i + n - 1) % n], left[i], left[(i + 1) % n]].map(|k| points[k]);
            let long = (b - a)
                .length_squared()
                .max((c - b).length_squared())
                .max((a - c).length_squared());
            let quality = area(a, b, c) / long;
            // A corner on the ear's rim blocks it too: cutting there would leave a T-vertex.
            let blocked = || {
                left.iter()
                    .map(|&k| points[k])
                    .filter(|&p| p != a && p != b && p != c)
                    .any(|p| {
                        let tiny = -1e-7 * long;
                        area(a, b, p) >= tiny && area(b, c, p) >= tiny && area(c, a, p) >= tiny
                    })
            };
            if quality > 1e-6 && best.is_none_or(|(q, _)| quality > q) && !blocked() {
                best = Some((quality, i));
            }
        }
        let (_, i) = best.expect("a simple polygon has two ears");
        triangles.push([left[(i + n - 1) % n], left[i], left[(i + 1) % n]]);
        left.remove(i);
    }
    triangles.push([left[0], left[1], left[2]]);
    triangles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn block_faces_outward_and_room_inward() {
        // Signed volume by the divergence theorem: + for fronts outward, - for inward.
        for (inward, sign) in [(false, 1.0), (true, -1.0)] {
            let mut b = Builder::new("b");
            let grey = b.matte("grey", 0.5, 0.5, 0.5);
            let (low, high) = (at(1.0, 2.0, 3.0), at(2.0, 4.0, 6.0));
            b.on("x", grey);
            if inward {
                b.room(low, high, faces::ALL)
            } else {
                b.block(low, high, faces::ALL)
            };
            let volume = signed_volume(&b.build());
            assert!(
                (volume - sign * 6.0).abs() < 1e-5,
                "1 x 2 x 3 m, f32 rounding: {volume}"
            );
        }
    }

    #[test]
    fn ball_and_frustum_face_outward() {
        // A ball of 16 x 32 flat faces is smaller than 4/3 pi r^3 by under 4 %.
        let mut b = Builder::new("b");
        let grey = b.matte("grey", 0.5, 0.5, 0.5);
        b.on("ball", grey).ball(at(5.0, 1.0, 2.0), 1.0, 16, 32);
        let volume = signed_volume(&b.build());
        assert!(volume < 4.18879 && volume > 4.02, "{volume}");

        // A prism of n sides holds n/2 sin(2 pi / n) r^2 h.
        let mut b = Builder::new("b");
        let grey = b.matte("grey", 0.5, 0.5, 0.5);
        let base = at(3.0, 0.0, 1.0);
        b.on("can", grey).frustum(base, [0.5, 0.5], 2.0, 12);
        b.disc(base, 0.5, 12, false)
            .disc(base + Vec3::Y * 2.0, 0.5, 12, true);
        let volume = signed_volume(&b.build());
        assert!(
            (volume - 1.5).abs() < 1e-4,
            "12 sides, r 0.5, h 2: exactly 1.5; {volume}"
        );
    }

    #[test]
    fn wall_with_an_opening_is_cut_without_loss() {
        // 4 x 3 m less a door of 1 x 2 m is 10 m²; eight corners make six triangles.
        let mut b = Builder::new("b");
        let grey = b.matte("grey", 0.5, 0.5, 0.5);
        b.on("wall", grey).polygon(&[
            at(0.0, 0.0, 0.0),
            at(1.0, 0.0, 0.0),
            at(1.0, 2.0, 0.0),
            at(2.0, 2.0, 0.0),
            at(2.0, 0.0, 0.0),
            at(4.0, 0.0, 0.0),
            at(4.0, 3.0, 0.0),
            at(0.0, 3.0, 0.0),
        ]);
        let scene = b.build();
        let area: f32 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
        assert_eq!(scene.triangles.len(), 6);
        assert!((area - 10.0).abs() < 1e-5, "{area}");
    }

    fn signed_volume(scene: &Scene) -> f32 {
        (0..scene.triangles.len())
            .map(|t| {
                let [a, b, c] = scene.corners(t);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }
}
