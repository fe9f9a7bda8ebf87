//! The scene as it is lit: triangles, finishes, luminaires, sky and views.
//!
//! Everything is in world space, metres, after instances were placed and dirty geometry was
//! repaired. Counter-clockwise seen from the front.

use crate::element::{FinishId, GroupId, SurfaceId, TextureId};
use crate::layers::Layers;
use crate::quantity::Rgb;
use crate::texture::Texture;
use glam::{Vec2, Vec3};

/// A scene ready for meshing. All indices are in range and all numbers finite: `io` sees to it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Name, usually the file's.
    pub name: String,
    /// Vertex positions, metres.
    pub positions: Vec<Vec3>,
    /// Corners of each triangle, counter-clockwise from the front. None is degenerate.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates of each triangle's corners; empty when no finish has a texture.
    pub uvs: Vec<[Vec2; 3]>,
    /// Surface of each triangle. Triangles of a surface are contiguous.
    pub surface_of: Vec<SurfaceId>,
    /// Index of each triangle within its source primitive, before repairs.
    pub source_triangle: Vec<u32>,
    /// Surfaces: one for each primitive of each instance.
    pub surfaces: Vec<Surface>,
    /// Finishes.
    pub finishes: Vec<Finish>,
    /// Textures.
    pub textures: Vec<Texture>,
    /// Luminaires without size.
    pub luminaires: Vec<Luminaire>,
    /// Luminaire groups, one layer each; never empty after reading (the first is used when nothing shines).
    pub groups: Vec<Group>,
    /// Light from outside.
    pub sky: Option<Sky>,
    /// Named views.
    pub views: Vec<View>,
    /// Up, a unit vector.
    pub up: Vec3,
}

/// One primitive of one instance.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Name for people: node or object name, and the finish when it has several.
    pub name: String,
    /// Finish of the whole surface.
    pub finish: FinishId,
    /// Triangles, a run of [`Scene::triangles`].
    pub triangles: std::ops::Range<u32>,
    /// Node in the source file; `u32::MAX` when the format has none.
    pub node: u32,
    /// Mesh in the source file.
    pub mesh: u32,
    /// Primitive of that mesh.
    pub primitive: u32,
}

/// How coverage is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alpha {
    /// Everything blocks.
    Opaque,
    /// Texels under the cutoff are holes.
    Mask {
        /// Smallest coverage that still blocks, 0..=1.
        cutoff: f32,
    },
    /// A share `1 - coverage` of the light goes straight through.
    Blend,
}

/// Light that a surface gives by itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Emission {
    /// Luminance, cd/m², linear bands.
    pub luminance: Rgb,
    /// Picture that multiplies it.
    pub texture: Option<TextureId>,
    /// Layer it belongs to.
    pub group: GroupId,
}

/// What a surface does with light: diffuse reflection, emission, coverage.
#[derive(Clone, Debug, PartialEq)]
pub struct Finish {
    /// Name in the file.
    pub name: String,
    /// Diffuse reflectance, 0..=1, linear bands.
    pub reflectance: Rgb,
    /// Picture that multiplies the reflectance.
    pub texture: Option<TextureId>,
    /// Emission, if any.
    pub emission: Option<Emission>,
    /// Whether the back reflects as the front does (otherwise it is black and dark).
    pub back_reflects: bool,
    /// Whether the back emits as the front does.
    pub back_emits: bool,
    /// Coverage.
    pub alpha: Alpha,
    /// Coverage factor, multiplied with the texture's alpha, 0..=1.
    pub coverage: f32,
    /// Clear glass: light passes as if it were not there, and it is no element.
    pub transparent: bool,
}

impl Default for Finish {
    fn default() -> Self {
        Finish {
            name: String::new(),
            reflectance: Rgb::splat(0.5),
            texture: None,
            emission: None,
            back_reflects: false,
            back_emits: false,
            alpha: Alpha::Opaque,
            coverage: 1.0,
            transparent: false,
        }
    }
}

/// A luminaire without size.
#[derive(Clone, Debug, PartialEq)]
pub struct Luminaire {
    /// Name for people.
    pub name: String,
    /// Where it hangs, metres. Unused for a directional light.
    pub position: Vec3,
    /// Unit vector along which the light travels on its axis. Unused for a point.
    pub direction: Vec3,
    /// How the light is spread.
    pub kind: LuminaireKind,
    /// Layer it belongs to.
    pub group: GroupId,
}

/// How a luminaire without size spreads its light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LuminaireKind {
    /// The same intensity in all directions.
    Point {
        /// Intensity, cd.
        intensity: Rgb,
        /// Distance at which a window function ends it, metres; infinite if none.
        range_m: f32,
    },
    /// A cone with a soft edge, as KHR_lights_punctual defines it.
    Spot {
        /// Intensity on the axis, cd.
        intensity: Rgb,
        /// As for a point, metres.
        range_m: f32,
        /// Cosine of the angle inside which the intensity is full.
        cos_inner: f32,
        /// Cosine of the angle outside which there is none.
        cos_outer: f32,
    },
    /// Parallel light from infinitely far.
    Directional {
        /// Illuminance on a plane square to it, lux.
        illuminance: Rgb,
    },
    /// Intensity that falls with the cosine from the axis, over one half space.
    Lambertian {
        /// Intensity on the axis, cd.
        intensity: Rgb,
    },
}

/// A luminaire group: dimmed as one, so a layer of every solution.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Name for people.
    pub name: String,
}

/// Light from outside the scene: the same luminance from everywhere.
#[derive(Clone, Debug, PartialEq)]
pub struct Sky {
    /// Luminance, cd/m².
    pub luminance: Rgb,
    /// Layer it belongs to.
    pub group: GroupId,
}

/// A named place to look from.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Name.
    pub name: String,
    /// Eye, metres.
    pub eye: Vec3,
    /// Unit vector of sight.
    pub forward: Vec3,
    /// Unit vector up in the picture.
    pub up: Vec3,
    /// Vertical opening angle, radians.
    pub vertical_angle: f32,
}

impl Scene {
    /// The three corners of a triangle, metres.
    #[inline]
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|i| self.positions[i as usize])
    }

    /// Finish of a triangle.
    #[inline]
    pub fn finish_of(&self, triangle: usize) -> &Finish {
        &self.finishes[self.surfaces[self.surface_of[triangle].index()]
            .finish
            .index()]
    }

    /// Area of a triangle, m².
    pub fn area(&self, triangle: usize) -> f32 {
        let [a, b, c] = self.corners(triangle);
        0.5 * (b - a).cross(c - a).length()
    }

    /// Weights of corners 1 and 2 at the foot of `p` on a triangle's plane; zero for a triangle
    /// without area. Outside of 0..1 where the foot lies outside.
    pub fn barycentric(&self, triangle: usize, p: Vec3) -> [f32; 2] {
        let [a, b, c] = self.corners(triangle).map(|q| q.as_dvec3());
        let (e, f, r) = (b - a, c - a, p.as_dvec3() - a);
        let n = e.cross(f);
        let square = n.length_squared();
        if square == 0.0 {
            return [0.0, 0.0];
        }
        [
            (r.cross(f).dot(n) / square) as f32,
            (e.cross(r).dot(n) / square) as f32,
        ]
    }

    /// Smallest and largest corner of everything; zero for an empty scene.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let mut low = Vec3::splat(f32::INFINITY);
        let mut high = Vec3::splat(f32::NEG_INFINITY);
        for corners in &self.triangles {
            for &i in corners {
                low = low.min(self.positions[i as usize]);
                high = high.max(self.positions[i as usize]);
            }
        }
        if self.triangles.is_empty() {
            (Vec3::ZERO, Vec3::ZERO)
        } else {
            (low, high)
        }
    }

    /// Largest absolute coordinate, metres: what decides on how exact f32 is here.
    pub fn largest_coordinate(&self) -> f32 {
        let (low, high) = self.bounds();
        low.abs().max(high.abs()).max_element()
    }

    /// Length of the bounds' diagonal, metres.
    pub fn diagonal(&self) -> f32 {
        let (low, high) = self.bounds();
        (high - low).length()
    }

    /// The columns that a solution of this scene has.
    pub fn layers(&self) -> Layers {
        Layers {
            groups: self.groups.iter().map(|g| g.name.clone()).collect(),
        }
    }

    /// Texture coordinates at barycentric weights `(u, v)` of corners 1 and 2.
    pub fn uv_at(&self, triangle: usize, u: f32, v: f32) -> Vec2 {
        match self.uvs.get(triangle) {
            Some([a, b, c]) => *a * (1.0 - u - v) + *b * u + *c * v,
            None => Vec2::ZERO,
        }
    }

    /// Diffuse reflectance at barycentric weights `(u, v)` of corners 1 and 2.
    pub fn reflectance_at(&self, triangle: usize, u: f32, v: f32) -> Rgb {
        let finish = self.finish_of(triangle);
        match finish.texture {
            Some(id) => {
                finish.reflectance
                    * self.textures[id.index()]
                        .sample(self.uv_at(triangle, u, v))
                        .0
            }
            None => finish.reflectance,
        }
    }

    /// Own luminance at barycentric weights `(u, v)`, cd/m²; black when the finish does not emit.
    pub fn luminance_at(&self, triangle: usize, u: f32, v: f32) -> Rgb {
        match &self.finish_of(triangle).emission {
            Some(e) => match e.texture {
                Some(id) => {
                    e.luminance
                        * self.textures[id.index()]
                            .sample(self.uv_at(triangle, u, v))
                            .0
                }
                None => e.luminance,
            },
            None => Rgb::BLACK,
        }
    }

    /// Share of light that is blocked at barycentric weights `(u, v)`: 0 a hole, 1 opaque.
    pub fn coverage_at(&self, triangle: usize, u: f32, v: f32) -> f32 {
        let finish = self.finish_of(triangle);
        let covered = || {
            let texel = finish.texture.map_or(1.0, |id| {
                self.textures[id.index()]
                    .sample(self.uv_at(triangle, u, v))
                    .1
            });
            finish.coverage * texel
        };
        match finish.alpha {
            _ if finish.transparent => 0.0,
            Alpha::Opaque => 1.0,
            Alpha::Mask { cutoff } => {
                if covered() >= cutoff {
                    1.0
                } else {
                    0.0
                }
            }
            Alpha::Blend => covered(),
        }
    }
}
