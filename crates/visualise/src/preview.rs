//! Pictures of the lit mesh: what the eye would see, and illuminance in false colour.
//!
//! Luminance at a pixel = reflectance (texel) x irradiance / pi + own luminance (texel);
//! irradiance is that of the lightmap, or interpolated between the vertices [Gouraud71]. Four samples a pixel, tone
//! mapped one by one and then averaged, so that an edge before a bright lamp stays smooth.
//!
//! Where there is nothing to show, the picture says so in dark greys that do not depend on the
//! exposure: sides that neither reflect nor emit (the back of a one-sided face) are grey by
//! their slope, 1 to 5 % of white, so that their form can be made out; rays that leave a scene
//! without a sky are 2 % of white, a little blue. With a sky they show its luminance.

use crate::glyphs;
use crate::lightmap::Texels;
use crate::lit_mesh::LitMesh;
use crate::raster::{Camera, NOTHING, SUPER, visible};
use crate::tone::{Encoder, Exposure, LuxScale, ramp};
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::{Alpha, Finish, Rgb, Scene, Side, Texture, TextureId, Vec2, Vec3, View};
use rayon::prelude::*;

/// How large, and how exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PreviewSettings {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Exposure; automatic when absent.
    pub exposure: Option<Exposure>,
}

impl Default for PreviewSettings {
    fn default() -> Self {
        PreviewSettings {
            width: 1280,
            height: 720,
            exposure: None,
        }
    }
}

/// A finished picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// sRGB, three bytes a pixel, row by row from the top left.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// The bytes of a PNG file.
    pub fn png(&self) -> Result<Vec<u8>, image::ImageError> {
        use image::codecs::png::{CompressionType, FilterType, PngEncoder};
        let mut bytes = Vec::new();
        let encoder =
            PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
        let (w, h) = (self.width as u32, self.height as u32);
        image::ImageEncoder::write_image(encoder, &self.rgb, w, h, image::ExtendedColorType::Rgb8)?;
        Ok(bytes)
    }

    fn set(&mut self, x: usize, y: usize, colour: [u8; 3]) {
        if x < self.width && y < self.height {
            let k = 3 * (y * self.width + x);
            self.rgb[k..k + 3].copy_from_slice(&colour);
        }
    }
}

/// What is seen at one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Seen {
    /// A surface: luminance (cd/m²) and illuminance (lux).
    Surface { luminance: Rgb, lux: f32 },
    /// The sky, cd/m².
    Sky(Rgb),
    /// Nothing that is lit: a display value.
    Blank(Rgb),
}

const SAMPLES: usize = SUPER * SUPER;

/// A picture taken but not yet developed: luminance and illuminance of every sample.
pub struct Shot {
    width: usize,
    height: usize,
    pixels: Vec<[Seen; SAMPLES]>,
}

/// Takes the picture from `view`.
///
/// Precondition: the mesh is of this scene and its irradiance is set. A picture of no pixels is
/// allowed.
pub fn shoot(scene: &Scene, mesh: &LitMesh, view: &View, width: usize, height: usize) -> Shot {
    shoot_texels(scene, mesh, None, view, width, height)
}

/// As [`shoot`], with the light of a lightmap that lies over the mesh.
pub fn shoot_texels(
    scene: &Scene,
    mesh: &LitMesh,
    texels: Option<&Texels>,
    view: &View,
    width: usize,
    height: usize,
) -> Shot {
    if width == 0 || height == 0 {
        return Shot {
            width,
            height,
            pixels: Vec::new(),
        };
    }
    let stage = Stage::new(scene, mesh, texels);
    let near_m = (scene.diagonal() * 1e-4).clamp(1e-5, 0.02);
    let camera = Camera::new(view, width, height, near_m);
    let seen = visible(
        &camera,
        &|id| stage.corners(id),
        stage.count(),
        &|id| is_solid(stage.finish(id)),
        &|id, x, y| stage.covers(id, &camera, x, y),
    );
    let row = width * SUPER;
    let mut pixels = vec![[Seen::Blank(Rgb::BLACK); SAMPLES]; width * height];
    pixels
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(j, line)| {
            // Neighbours mostly show the same triangle: what it needs is worked out once.
            let mut facet = stage.facet(NOTHING, &camera);
            for (i, pixel) in line.iter_mut().enumerate() {
                let (x, y) = (i * SUPER, j * SUPER);
                let id = |s: usize| seen[(y + s / SUPER) * row + x + s % SUPER];
                let mut shade = |id: u32, x: f32, y: f32| {
                    if facet.id != id {
                        facet = stage.facet(id, &camera);
                    }
                    facet.shade(&camera, x, y)
                };
                let is_one = (1..SAMPLES).all(|s| id(s) == id(0));
                let middle = 0.5 * SUPER as f32;
                // A pixel inside one plain triangle is shaded once, in its middle.
                if is_one && !stage.is_textured(id(0)) {
                    *pixel = [shade(id(0), x as f32 + middle, y as f32 + middle); SAMPLES];
                } else {
                    for (s, sample) in pixel.iter_mut().enumerate() {
                        let (i, j) = ((s % SUPER) as f32 + 0.5, (s / SUPER) as f32 + 0.5);
                        *sample = shade(id(s), x as f32 + i, y as f32 + j);
                    }
                }
            }
        });
    Shot {
        width,
        height,
        pixels,
    }
}

/// Takes and develops the picture that a person sees; answers with the exposure that was used.
pub fn render(
    scene: &Scene,
    mesh: &LitMesh,
    texels: Option<&Texels>,
    view: &View,
    settings: &PreviewSettings,
) -> (Picture, Exposure) {
    let shot = shoot_texels(scene, mesh, texels, view, settings.width, settings.height);
    let exposure = settings.exposure.unwrap_or_else(|| shot.exposure());
    (shot.develop(&exposure), exposure)
}

impl Shot {
    /// Automatic exposure for this picture; the sky counts only when nothing else is seen.
    pub fn exposure(&self) -> Exposure {
        let mean = |pixel: &[Seen; SAMPLES], with_sky: bool| {
            let mut sum = 0.0;
            for s in pixel {
                sum += match s {
                    Seen::Surface { luminance, .. } => luminance.luminance(),
                    Seen::Sky(l) if with_sky => l.luminance(),
                    _ => return None,
                };
            }
            Some(sum / SAMPLES as f32)
        };
        // A hundred thousand pixels know the percentiles to a thousandth; rows are not in step.
        let stride = (self.pixels.len() / 100_000).max(1);
        let some = || self.pixels.iter().step_by(stride);
        let mut values: Vec<f32> = some().filter_map(|p| mean(p, false)).collect();
        if values.is_empty() {
            values = some().filter_map(|p| mean(p, true)).collect();
        }
        Exposure::automatic(&values)
    }

    /// The picture as a person sees it.
    pub fn develop(&self, exposure: &Exposure) -> Picture {
        let encoder = Encoder::default();
        let show = |s: &Seen| match s {
            Seen::Surface { luminance, .. } | Seen::Sky(luminance) => exposure.display(*luminance),
            Seen::Blank(value) => *value,
        };
        self.map(|pixel| {
            let mean = if pixel[1..].iter().all(|s| *s == pixel[0]) {
                show(&pixel[0])
            } else {
                pixel.iter().fold(Rgb::BLACK, |sum, s| sum + show(s)) * (1.0 / SAMPLES as f32)
            };
            encoder.encode(mean)
        })
    }

    /// Illuminance in false colour, with a legend in lux at the right edge. The scale is fitted
    /// to the picture when absent.
    pub fn false_colour(&self, scale: Option<&LuxScale>) -> Picture {
        let fitted;
        let scale = match scale {
            Some(given) => given,
            None => {
                let lux: Vec<f32> = self.pixels.iter().filter_map(first_lux).collect();
                fitted = LuxScale::around(&lux);
                &fitted
            }
        };
        let encoder = Encoder::default();
        let mut picture = self.map(|pixel| {
            let mut sum = [0u32; 3];
            for s in pixel {
                let colour = match s {
                    Seen::Surface { lux, .. } => ramp(scale.place(*lux)),
                    Seen::Sky(_) => [96, 96, 96],
                    Seen::Blank(value) => encoder.encode(*value),
                };
                for band in 0..3 {
                    sum[band] += colour[band] as u32;
                }
            }
            sum.map(|v| (v / SAMPLES as u32) as u8)
        });
        legend(&mut picture, scale);
        picture
    }

    fn map(&self, colour: impl Fn(&[Seen; SAMPLES]) -> [u8; 3] + Sync) -> Picture {
        let mut rgb = vec![0u8; 3 * self.width * self.height];
        rgb.par_chunks_mut(3)
            .zip(self.pixels.par_iter())
            .with_min_len(1024)
            .for_each(|(out, pixel)| out.copy_from_slice(&colour(pixel)));
        Picture {
            width: self.width,
            height: self.height,
            rgb,
        }
    }
}

fn first_lux(pixel: &[Seen; SAMPLES]) -> Option<f32> {
    pixel.iter().find_map(|s| match s {
        Seen::Surface { lux, .. } => Some(*lux),
        _ => None,
    })
}

/// A bar with round values, on a dark ground at the right edge.
fn legend(picture: &mut Picture, scale: &LuxScale) {
    let zoom = (picture.height / 360).max(1);
    let margin = 6 * zoom;
    let label = |lux: f32| format!("{lux}");
    let longest = scale
        .ticks
        .iter()
        .map(|&t| label(t).len())
        .max()
        .unwrap_or(0)
        .max(3);
    let (bar, text) = (10 * zoom, longest * glyphs::ADVANCE * zoom);
    let panel = margin * 3 + bar + text;
    let (w, h) = (picture.width, picture.height);
    let line = 2 * glyphs::HEIGHT * zoom;
    if panel > w || 4 * line > h {
        return;
    }
    let left = w - panel;
    for y in 0..h {
        for x in left..w {
            picture.set(x, y, [20, 20, 24]);
        }
    }
    let (top, bottom) = (margin + line, h - margin - line);
    for y in top..bottom {
        let colour = ramp((bottom - 1 - y) as f32 / (bottom - 1 - top).max(1) as f32);
        for x in left + margin..left + margin + bar {
            picture.set(x, y, colour);
        }
    }
    let ink = [230, 230, 230];
    let beside = left + 2 * margin + bar;
    glyphs::draw("lux", [beside, margin], zoom, |x, y| picture.set(x, y, ink));
    let mut last = usize::MAX;
    for &tick in scale.ticks.iter() {
        let y = bottom - 1 - (scale.place(tick) * (bottom - 1 - top) as f32) as usize;
        for x in left + margin..left + margin + bar + margin / 2 {
            picture.set(x, y, ink);
        }
        // Labels that would touch are left out, from the dark end up.
        if last != usize::MAX && last < y + line * 3 / 4 {
            continue;
        }
        last = y;
        let place = [beside, y.saturating_sub(glyphs::HEIGHT * zoom / 2)];
        glyphs::draw(&label(tick), place, zoom, |x, y| picture.set(x, y, ink));
    }
}

fn is_solid(finish: &Finish) -> bool {
    matches!(finish.alpha, Alpha::Opaque) && !finish.transparent
}

/// Everything that can be drawn: lit triangles, then the black sides of source triangles.
struct Stage<'a> {
    scene: &'a Scene,
    mesh: &'a LitMesh,
    texels: Option<&'a Texels>,
    /// Part of each lit triangle.
    part: Vec<u32>,
    /// Source triangles of black sides.
    black: Vec<(u32, Side)>,
}

impl<'a> Stage<'a> {
    fn new(scene: &'a Scene, mesh: &'a LitMesh, texels: Option<&'a Texels>) -> Stage<'a> {
        let mut part = vec![0; mesh.triangles.len()];
        let mut lit = vec![[false; 2]; scene.surfaces.len()];
        for (k, p) in mesh.parts.iter().enumerate() {
            lit[p.surface.index()][p.side as usize] = true;
            part[p.triangles.start as usize..p.triangles.end as usize].fill(k as u32);
        }
        let mut black = Vec::new();
        for (surface, sides) in scene.surfaces.iter().zip(&lit) {
            // Glass without colour is not seen.
            if scene.finishes[surface.finish.index()].transparent {
                continue;
            }
            for side in [Side::Front, Side::Back] {
                if !sides[side as usize] {
                    black.extend(surface.triangles.clone().map(|t| (t, side)));
                }
            }
        }
        Stage {
            scene,
            mesh,
            texels,
            part,
            black,
        }
    }

    fn count(&self) -> u32 {
        (self.mesh.triangles.len() + self.black.len()) as u32
    }

    /// Corners, counter-clockwise from the side that is seen.
    fn corners(&self, id: u32) -> [Vec3; 3] {
        match self.mesh.triangles.get(id as usize) {
            Some(t) => t.map(|v| self.mesh.positions[v as usize]),
            None => {
                let (triangle, side) = self.black[id as usize - self.mesh.triangles.len()];
                let [a, b, c] = self.scene.corners(triangle as usize);
                if side == Side::Front {
                    [a, b, c]
                } else {
                    [a, c, b]
                }
            }
        }
    }

    fn finish(&self, id: u32) -> &'a Finish {
        let surface = match self.part.get(id as usize) {
            Some(&p) => self.mesh.parts[p as usize].surface,
            None => {
                let (triangle, _) = self.black[id as usize - self.mesh.triangles.len()];
                self.scene.surface_of[triangle as usize]
            }
        };
        &self.scene.finishes[self.scene.surfaces[surface.index()].finish.index()]
    }

    fn is_textured(&self, id: u32) -> bool {
        if id as usize >= self.mesh.triangles.len() {
            return false;
        }
        let finish = self.finish(id);
        finish.texture.is_some()
            || finish
                .emission
                .as_ref()
                .is_some_and(|e| e.texture.is_some())
    }

    fn uv(&self, id: u32, w: [f32; 3]) -> Vec2 {
        if self.scene.uvs.is_empty() {
            return Vec2::ZERO;
        }
        match self.mesh.triangles.get(id as usize) {
            Some(t) => (0..3).map(|k| self.mesh.uvs[t[k] as usize] * w[k]).sum(),
            None => {
                let (triangle, side) = self.black[id as usize - self.mesh.triangles.len()];
                let (u, v) = if side == Side::Front {
                    (w[1], w[2])
                } else {
                    (w[2], w[1])
                };
                self.scene.uv_at(triangle as usize, u, v)
            }
        }
    }

    /// Whether a triangle with holes is there at a sample.
    fn covers(&self, id: u32, camera: &Camera, x: usize, y: usize) -> bool {
        let finish = self.finish(id);
        let w =
            Crossing::new(self.corners(id), camera).weights(camera, x as f32 + 0.5, y as f32 + 0.5);
        let texel = finish.texture.map_or(1.0, |t| {
            self.scene.textures[t.index()].sample(self.uv(id, w)).1
        });
        let coverage = finish.coverage * texel;
        match finish.alpha {
            Alpha::Opaque => true,
            Alpha::Mask { cutoff } => coverage >= cutoff,
            // Ordered over 4 x 4 samples, so four steps in each pixel and sixteen in four.
            Alpha::Blend => {
                const ORDER: [u8; 16] = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];
                coverage > (ORDER[y % 4 * 4 + x % 4] as f32 + 0.5) / 16.0
            }
        }
    }

    /// What a triangle shows; [`NOTHING`] shows the outside.
    fn facet(&self, id: u32, camera: &Camera) -> Facet<'a> {
        if id == NOTHING {
            let seen = match &self.scene.sky {
                Some(sky) => Seen::Sky(sky.luminance),
                None => Seen::Blank(Rgb::new(0.018, 0.020, 0.024)),
            };
            return Facet {
                id,
                shows: Shows::One(seen),
            };
        }
        let corners = self.corners(id);
        let crossing = Crossing::new(corners, camera);
        let Some(&part) = self.part.get(id as usize) else {
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            return Facet {
                id,
                shows: Shows::Black(normal.normalize_or_zero()),
            };
        };
        let vertices = self.mesh.triangles[id as usize].map(|v| v as usize);
        let finish = self.finish(id);
        let is_front = self.mesh.parts[part as usize].side == Side::Front;
        let textures = &self.scene.textures;
        let picture = |t: Option<TextureId>| t.map(|t| &textures[t.index()]);
        let emission = finish
            .emission
            .as_ref()
            .filter(|_| is_front || finish.back_emits);
        let reflects = is_front || finish.back_reflects;
        Facet {
            id,
            shows: Shows::Lit {
                crossing,
                light: match self.texels {
                    Some(texels) if texels.has(vertices[0]) => {
                        Light::Texels(texels, vertices[0], corners)
                    }
                    _ => Light::Vertices(vertices.map(|v| self.mesh.irradiance[v])),
                },
                uvs: vertices.map(|v| self.mesh.uvs.get(v).copied().unwrap_or_default()),
                reflectance: finish.reflectance * if reflects { 1.0 / LAMBERTIAN } else { 0.0 },
                picture: picture(finish.texture).filter(|_| reflects),
                luminance: emission.map_or(Rgb::BLACK, |e| e.luminance),
                glow: picture(emission.and_then(|e| e.texture)),
            },
        }
    }
}

/// Where the light on a triangle comes from.
enum Light<'a> {
    /// Its corners, lux.
    Vertices([Rgb; 3]),
    /// A lightmap; a vertex and the corners.
    Texels(&'a Texels, usize, [Vec3; 3]),
}

/// A triangle ready to be shaded.
struct Facet<'a> {
    id: u32,
    shows: Shows<'a>,
}

enum Shows<'a> {
    /// The same everywhere.
    One(Seen),
    /// A side that is black, with its normal.
    Black(Vec3),
    /// A lit side.
    Lit {
        crossing: Crossing,
        light: Light<'a>,
        uvs: [Vec2; 3],
        /// Reflectance over pi.
        reflectance: Rgb,
        picture: Option<&'a Texture>,
        luminance: Rgb,
        glow: Option<&'a Texture>,
    },
}

impl Facet<'_> {
    fn shade(&self, camera: &Camera, x: f32, y: f32) -> Seen {
        match &self.shows {
            Shows::One(seen) => *seen,
            Shows::Black(normal) => {
                let slope = normal.dot(camera.direction(x, y).normalize_or_zero()).abs();
                Seen::Blank(Rgb::splat(0.01 + 0.04 * slope))
            }
            Shows::Lit {
                crossing,
                light,
                uvs,
                reflectance,
                picture,
                luminance,
                glow,
            } => {
                let w = crossing.weights(camera, x, y);
                let e = match light {
                    Light::Vertices(e) => e[0] * w[0] + e[1] * w[1] + e[2] * w[2],
                    Light::Texels(texels, vertex, [a, b, c]) => {
                        texels.at(*vertex, *a * w[0] + *b * w[1] + *c * w[2])
                    }
                };
                let mut seen = *reflectance * e;
                let mut own = *luminance;
                if picture.is_some() || glow.is_some() {
                    let uv = uvs[0] * w[0] + uvs[1] * w[1] + uvs[2] * w[2];
                    if let Some(picture) = picture {
                        seen = seen * picture.sample(uv).0;
                    }
                    if let Some(glow) = glow {
                        own = own * glow.sample(uv).0;
                    }
                }
                Seen::Surface {
                    luminance: seen + own,
                    lux: e.luminance(),
                }
            }
        }
    }
}

/// Where sights cross a triangle's plane: weights are quotients of two linear functions of the
/// direction (Cramer's rule on `t d = a - eye + u e + v f`).
struct Crossing {
    normal: Vec3,
    /// Numerators of the weights of corners 1 and 2.
    across: [Vec3; 2],
}

impl Crossing {
    fn new([a, b, c]: [Vec3; 3], camera: &Camera) -> Crossing {
        let (e, f) = ((b - a).as_dvec3(), (c - a).as_dvec3());
        let r = (a - camera.eye).as_dvec3();
        // Scaled, so that tiny triangles stay within f32.
        let n = e.cross(f);
        let scale = 1.0 / n.length().max(f64::MIN_POSITIVE);
        Crossing {
            normal: (n * scale).as_vec3(),
            across: [
                (f.cross(r) * scale).as_vec3(),
                (r.cross(e) * scale).as_vec3(),
            ],
        }
    }

    /// Weights of the three corners; kept inside the triangle, as the sight may pass a hair
    /// beside it.
    fn weights(&self, camera: &Camera, x: f32, y: f32) -> [f32; 3] {
        let ray = camera.direction(x, y);
        let share = 1.0 / ray.dot(self.normal);
        let (u, v) = (
            ray.dot(self.across[0]) * share,
            ray.dot(self.across[1]) * share,
        );
        if !(u.is_finite() && v.is_finite()) {
            return [1.0, 0.0, 0.0];
        }
        let w = [1.0 - u - v, u, v].map(|w| w.max(0.0));
        let sum = w[0] + w[1] + w[2];
        w.map(|w| w / sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use luxel_core::{Emission, GroupId};

    fn look(eye: Vec3, target: Vec3, vertical_angle: f32) -> View {
        let forward = (target - eye).normalize();
        let up = if forward.y.abs() > 0.99 {
            -Vec3::Z
        } else {
            Vec3::Y
        };
        View {
            name: "test".into(),
            eye,
            forward,
            up,
            vertical_angle,
        }
    }

    fn down() -> View {
        look(Vec3::Y * 2.0, Vec3::ZERO, 0.5)
    }

    fn centre(shot: &Shot) -> Seen {
        shot.pixels[shot.height / 2 * shot.width + shot.width / 2][0]
    }

    fn luminance_of(seen: Seen) -> f32 {
        match seen {
            Seen::Surface { luminance, .. } => luminance.g,
            other => panic!("no surface: {other:?}"),
        }
    }

    #[test]
    fn luminance_is_reflected_and_own() {
        // rho E / pi + L = 0.5 * 314.159 / pi + 7 = 57.
        let finish = Finish {
            emission: Some(Emission {
                luminance: Rgb::splat(7.0),
                texture: None,
                group: GroupId(0),
            }),
            ..Finish::default()
        };
        let scene = testing::square(finish);
        let front = testing::front(&scene, 0.3, false);
        let mesh = testing::lit(&scene, &front, |_| Rgb::splat(100.0 * LAMBERTIAN));
        let shot = shoot(&scene, &mesh, &down(), 33, 33);
        let seen = luminance_of(centre(&shot));
        assert!((seen - 57.0).abs() < 1e-3, "{seen}: f32 only");
        let Seen::Surface { lux, .. } = centre(&shot) else {
            panic!("no surface")
        };
        assert!((lux - 314.159).abs() < 1e-2);
    }

    #[test]
    fn light_is_linear_between_vertices() {
        let scene = testing::square(Finish::default());
        let front = testing::front(&scene, 10.0, false);
        let mesh = testing::lit(&scene, &front, |p| Rgb::splat(100.0 + 50.0 * p.x));
        let view = look(Vec3::Y * 2.0, Vec3::ZERO, 2.0 * 0.5f32.atan());
        let shot = shoot(&scene, &mesh, &view, 64, 64);
        for i in 4..60 {
            // The picture is 2 m wide; the middle of pixel i lies at x = (i + 1/2) / 32 - 1.
            let x = (i as f32 + 0.5) / 32.0 - 1.0;
            let of = |s: &Seen| match s {
                Seen::Surface { lux, .. } => *lux,
                _ => panic!("nothing at {i}"),
            };
            let lux = shot.pixels[32 * 64 + i].iter().map(of).sum::<f32>() / SAMPLES as f32;
            assert!((lux - (100.0 + 50.0 * x)).abs() < 0.01, "{i}: {lux}");
        }
    }

    #[test]
    fn a_closed_room_shows_no_pinhole() {
        let scene = testing::room();
        let front = testing::front(&scene, 0.02, false);
        let mesh = testing::lit(&scene, &front, |_| Rgb::splat(50.0));
        for (eye, target) in [
            (Vec3::new(1.0, 1.6, 1.0), Vec3::new(5.0, 1.0, 4.0)),
            // A hand's breadth beside a wall: it reaches far out of the picture and behind the eye.
            (Vec3::new(0.05, 1.6, 0.05), Vec3::new(0.06, 1.5, 4.0)),
            (Vec3::new(2.5, 1.5, 2.0), Vec3::new(2.5, 0.0, 2.0)),
        ] {
            let shot = shoot(&scene, &mesh, &look(eye, target, 1.3), 320, 180);
            let open = shot
                .pixels
                .iter()
                .flatten()
                .filter(|s| !matches!(s, Seen::Surface { .. }));
            assert_eq!(open.count(), 0, "from {eye}");
            for s in shot.pixels.iter().flatten() {
                // rho E / pi everywhere.
                assert!((luminance_of(*s) - 25.0 / LAMBERTIAN).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn the_nearest_surface_is_seen_and_backs_are_dark_grey() {
        let mut scene = testing::square(Finish::default());
        let front = testing::front(&scene, 10.0, false);
        let mesh = testing::lit(&scene, &front, |_| Rgb::splat(50.0));
        let below = look(-Vec3::Y * 2.0, Vec3::ZERO, 0.5);
        let Seen::Blank(value) = centre(&shoot(&scene, &mesh, &below, 33, 33)) else {
            panic!("the back is black")
        };
        assert!(value.g > 0.01 && value.g <= 0.05);
        // Beside it: nothing, then a sky.
        let away = look(Vec3::Y * 2.0, Vec3::new(0.0, 2.0, -9.0), 0.5);
        assert!(matches!(
            centre(&shoot(&scene, &mesh, &away, 33, 33)),
            Seen::Blank(_)
        ));
        scene.sky = Some(testing::sky(3000.0));
        let seen = centre(&shoot(&scene, &mesh, &away, 33, 33));
        assert_eq!(seen, Seen::Sky(Rgb::splat(3000.0)));
    }

    #[test]
    fn holes_and_half_transparent_surfaces_let_the_sky_through() {
        let through = |alpha: Alpha, coverage: f32| {
            let finish = Finish {
                alpha,
                coverage,
                ..Finish::default()
            };
            let mut scene = testing::square(finish);
            scene.sky = Some(testing::sky(1.0));
            let front = testing::front(&scene, 10.0, false);
            let mesh = testing::lit(&scene, &front, |_| Rgb::splat(50.0));
            let shot = shoot(&scene, &mesh, &down(), 32, 32);
            let all = shot.pixels.iter().flatten();
            let sky = all.filter(|s| matches!(s, Seen::Sky(_))).count();
            sky as f32 / (32.0 * 32.0 * SAMPLES as f32)
        };
        assert_eq!(through(Alpha::Mask { cutoff: 0.5 }, 0.4), 1.0);
        assert_eq!(through(Alpha::Mask { cutoff: 0.5 }, 0.6), 0.0);
        // Sixteen thresholds in each 4 x 4 samples: 0.25 covers exactly four of them.
        assert_eq!(through(Alpha::Blend, 0.25), 0.75);
    }

    #[test]
    fn pictures_of_any_size_develop_and_encode() {
        let scene = testing::room();
        let front = testing::front(&scene, 1.0, false);
        let mesh = testing::lit(&scene, &front, |p| Rgb::splat(10.0 * (1.0 + p.x)));
        let view = look(Vec3::new(1.0, 1.6, 1.0), Vec3::new(5.0, 1.0, 4.0), 1.2);
        for (width, height) in [(1, 1), (2, 50), (50, 2), (640, 360)] {
            let shot = shoot(&scene, &mesh, &view, width, height);
            let picture = shot.develop(&shot.exposure());
            let png = picture.png().expect("memory can be written");
            let back = image::load_from_memory(&png).expect("a picture").to_rgb8();
            assert_eq!(back.as_raw(), &picture.rgb);
            assert_eq!(shot.false_colour(None).rgb.len(), 3 * width * height);
        }
        assert_eq!(
            shoot(&scene, &mesh, &view, 0, 0)
                .false_colour(None)
                .rgb
                .len(),
            0
        );
    }

    #[test]
    fn the_picture_is_neither_black_nor_burnt_at_any_strength_of_light() {
        let scene = testing::room();
        let front = testing::front(&scene, 0.2, false);
        let view = look(Vec3::new(1.0, 1.6, 1.0), Vec3::new(5.0, 1.0, 4.0), 1.2);
        for strength in [1e-4, 1.0, 1e6] {
            let mesh = testing::lit(&scene, &front, |p| Rgb::splat(strength * (0.1 + p.x * p.y)));
            let (picture, _) = render(&scene, &mesh, None, &view, &PreviewSettings::default());
            let n = picture.rgb.len() as f64;
            let mean = picture.rgb.iter().map(|&b| b as f64).sum::<f64>() / n;
            let burnt = picture.rgb.iter().filter(|&&b| b == 255).count() as f64 / n;
            assert!((70.0..190.0).contains(&mean), "mean {mean} at {strength}");
            assert!(burnt <= 0.01, "{burnt} burnt at {strength}");
        }
    }
}
