//! Mean reflectance and own exitance of every element.
//!
//! Without a texture these are the finish's. With one, they are averaged over the element: the
//! picture is reduced to half its size again and again (mean of four linear texels), and the
//! element is sampled at the centres of a regular grid on the level where it covers about as
//! many texels as there are samples. So no texel is missed, however fine the picture.
//! A masked or blended picture cannot be reduced before its holes are cut; it is sampled as it
//! is, and its reflectance is the mean of what is not a hole: what arrives in a hole goes on.

use crate::sides::lit_side;
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::texture::{Wrap, linear_from_srgb};
use luxel_core::{Alpha, Front, PatchSources, Rgb, Scene, Shape, Texture, TextureId, Vec2, Vec3};
use rayon::prelude::*;

/// Fewest samples along an edge of an element.
const FEWEST: u32 = 4;

/// Most samples of an element in all.
const MOST: f32 = 1024.0;

/// Where in an element the texels are counted, along its edges; inside a triangle too.
const LOOKS: [[f32; 2]; 4] = [[0.33, 0.33], [0.1, 0.1], [0.7, 0.2], [0.2, 0.7]];

/// Sets `reflectance` and `emission` of every element of `front`. Parallel; same bits for any
/// thread count.
///
/// Mean of a texture over an element: 0.5 % typical, see the head of the file.
pub fn shade(scene: &Scene, front: &mut Front) {
    let pictures: Vec<Option<Pyramid>> = {
        let mut used = vec![false; scene.textures.len()];
        for f in &scene.finishes {
            for id in [f.texture, f.emission.as_ref().and_then(|e| e.texture)]
                .into_iter()
                .flatten()
            {
                if let Some(u) = used.get_mut(id.index()) {
                    *u = true;
                }
            }
        }
        scene
            .textures
            .par_iter()
            .zip(used)
            .map(|(t, used)| used.then(|| Pyramid::new(t)))
            .collect()
    };
    let sources = PatchSources::new(scene, front);
    let values: Vec<(Rgb, Rgb)> = (0..front.len())
        .into_par_iter()
        .map(|e| element(scene, front, &pictures, &sources, e))
        .collect();
    for (e, (reflectance, emission)) in values.into_iter().enumerate() {
        front.reflectance[e] = reflectance;
        front.emission[e] = emission;
    }
}

fn element(
    scene: &Scene,
    front: &Front,
    pictures: &[Option<Pyramid>],
    sources: &PatchSources,
    e: usize,
) -> (Rgb, Rgb) {
    let id = front.patch[e];
    let patch = &front.patches[id.index()];
    let finish = &scene.finishes[scene.surfaces[patch.surface.index()].finish.index()];
    let Some(lit) = lit_side(finish, patch.side) else {
        return (Rgb::BLACK, Rgb::BLACK);
    };
    let emission = finish.emission.as_ref().filter(|_| lit.emits);
    let luminance = emission.map_or(Rgb::BLACK, |m| m.luminance);
    let reflectance = if lit.reflects {
        finish.reflectance
    } else {
        Rgb::BLACK
    };
    let emission_picture = emission.and_then(|m| m.texture);
    let triangles = sources.of(id.index());
    if finish.texture.is_none() && emission_picture.is_none() {
        let coverage = triangles
            .first()
            .map_or(1.0, |&t| scene.coverage_at(t as usize, 0.0, 0.0));
        return (reflectance, luminance * (LAMBERTIAN * coverage));
    }
    let mut mean = Mean::default();
    let [s0, t0, ds, dt] = front.rect[e];
    match &patch.shape {
        Shape::Cluster { triangles } => {
            for c in &front.cluster_triangles[triangles.start as usize..triangles.end as usize] {
                let t = c.triangle as usize;
                let weight = scene.area(t) as f64;
                sample(
                    scene,
                    pictures,
                    &|_, _| std::slice::from_ref(&c.triangle),
                    scene.corners(t),
                    true,
                    2,
                    weight,
                    &mut mean,
                );
            }
        }
        shape => {
            let corners = [
                patch.point(s0, t0),
                patch.point(s0 + ds, t0),
                patch.point(s0, t0 + dt),
            ];
            let triangle = matches!(shape, Shape::Triangle { .. });
            let near = |x: f32, y: f32| sources.near(id.index(), [s0 + x * ds, t0 + y * dt]);
            sample(
                scene, pictures, &near, corners, triangle, FEWEST, 1.0, &mut mean,
            );
        }
    }
    let (mean_reflectance, mean_luminance) = mean.finish();
    let only_if = |yes: bool, c: Rgb| if yes { c } else { Rgb::BLACK };
    (
        only_if(lit.reflects, mean_reflectance),
        only_if(lit.emits, mean_luminance) * LAMBERTIAN,
    )
}

/// Adds samples of the parallelogram or triangle `corners`. `near` gives the source triangles among
/// which the one lies that holds the place (x, y) along its edges.
fn sample<'a>(
    scene: &Scene,
    pictures: &[Option<Pyramid>],
    near: &dyn Fn(f32, f32) -> &'a [u32],
    [a, b, c]: [Vec3; 3],
    triangle: bool,
    least: u32,
    weight: f64,
    mean: &mut Mean,
) {
    let Some(&first) = near(1.0 / 3.0, 1.0 / 3.0).first() else {
        return;
    };
    let finish = scene.finish_of(first as usize);
    let emission_picture = finish.emission.as_ref().and_then(|e| e.texture);
    let luminance = finish.emission.as_ref().map_or(Rgb::BLACK, |e| e.luminance);
    let picture = |id: Option<TextureId>| {
        id.and_then(|id| pictures.get(id.index()))
            .and_then(Option::as_ref)
    };
    let (reflects, emits) = (picture(finish.texture), picture(emission_picture));
    // Texels along both edges and of the whole decide on how many samples and which level. Each
    // source triangle has its own place in the picture, and a sliver beside the element says
    // nothing about it: the least of a few looks.
    let along = |p: &Pyramid| {
        LOOKS.iter().fold([f32::INFINITY; 3], |least, &[x, y]| {
            let (t, ..) = locate(scene, near(x, y), a + (b - a) * x + (c - a) * y);
            let [u0, u1, u2] = [a, b, c].map(|p| uv_in(scene, t, p));
            let (b, c) = (p.texels(u1 - u0), p.texels(u2 - u0));
            let now = [b.length(), c.length(), b.perp_dot(c).abs()];
            [0, 1, 2].map(|k| least[k].min(now[k]))
        })
    };
    let (reflected, emitted) = (reflects.map(along), emits.map(along));
    let texels = [reflected, emitted]
        .into_iter()
        .flatten()
        .fold([0.0f32; 2], |most, t| {
            [most[0].max(t[0]), most[1].max(t[1])]
        });
    let n = grid(texels, least);
    let level = |texels: [f32; 3]| {
        let each = (texels[2] / (n[0] * n[1]) as f32).sqrt();
        // A sample stands for about one texel of its level; no coarser, for beside the element
        // the picture may show something else.
        if each > 1.0 && each.is_finite() {
            each.log2() as usize
        } else {
            0
        }
    };
    let levels = [reflected.map_or(0, level), emitted.map_or(0, level)];
    let each = weight / (n[0] as f64 * n[1] as f64);
    for j in 0..n[1] {
        for i in 0..n[0] {
            let (x, y) = (
                (i as f32 + 0.5) / n[0] as f32,
                (j as f32 + 0.5) / n[1] as f32,
            );
            // The other half of the square is folded onto the triangle.
            let (x, y) = if triangle && x + y > 1.0 {
                (1.0 - x, 1.0 - y)
            } else {
                (x, y)
            };
            let p = a + (b - a) * x + (c - a) * y;
            let (t, u, v) = locate(scene, near(x, y), p);
            let coverage = scene.coverage_at(t as usize, u, v);
            let uv = scene.uv_at(t as usize, u, v);
            let (r, l) = if finish.alpha == Alpha::Opaque {
                let at = |p: Option<&Pyramid>, level| {
                    p.map_or(Rgb::WHITE, |p: &Pyramid| p.sample(level, uv))
                };
                (
                    finish.reflectance * at(reflects, levels[0]),
                    luminance * at(emits, levels[1]),
                )
            } else {
                (
                    scene.reflectance_at(t as usize, u, v),
                    scene.luminance_at(t as usize, u, v),
                )
            };
            mean.add(r, l, coverage, each);
        }
    }
}

/// Samples along the two edges of an element that covers so many texels: about one a texel, while
/// there are not too many.
fn grid(texels: [f32; 2], least: u32) -> [u32; 2] {
    let texels = texels.map(|t| {
        if t.is_finite() {
            t.max(least as f32)
        } else {
            MOST.sqrt()
        }
    });
    let scale = (MOST / (texels[0] * texels[1])).sqrt().min(1.0);
    // What the short edge cannot give up, the long one must.
    let bound = MOST / least as f32;
    texels.map(|t| ((t * scale).ceil().min(bound) as u32).max(least))
}

#[derive(Default)]
struct Mean {
    reflectance: [f64; 3],
    luminance: [f64; 3],
    covered: f64,
    weight: f64,
}

impl Mean {
    fn add(&mut self, reflectance: Rgb, luminance: Rgb, coverage: f32, weight: f64) {
        let covered = weight * coverage as f64;
        for (sum, v) in self.reflectance.iter_mut().zip(reflectance.to_array()) {
            *sum += v as f64 * covered;
        }
        for (sum, v) in self.luminance.iter_mut().zip(luminance.to_array()) {
            *sum += v as f64 * covered;
        }
        self.covered += covered;
        self.weight += weight;
    }

    fn finish(&self) -> (Rgb, Rgb) {
        let over = |sum: [f64; 3], w: f64| {
            if w > 0.0 {
                Rgb::from(sum.map(|s| (s / w) as f32))
            } else {
                Rgb::BLACK
            }
        };
        (
            over(self.reflectance, self.covered),
            over(self.luminance, self.weight),
        )
    }
}

fn uv_in(scene: &Scene, triangle: u32, p: Vec3) -> Vec2 {
    let [u, v] = scene.barycentric(triangle as usize, p);
    scene.uv_at(triangle as usize, u, v)
}

/// The triangle that holds `p`, or the one that misses it least, and the weights there.
fn locate(scene: &Scene, triangles: &[u32], p: Vec3) -> (u32, f32, f32) {
    let mut best = (f32::NEG_INFINITY, (triangles[0], 0.0, 0.0));
    for &t in triangles {
        let [u, v] = scene.barycentric(t as usize, p);
        let inside = u.min(v).min(1.0 - u - v);
        if inside > best.0 {
            best = (inside, (t, u, v));
        }
        if inside >= 0.0 {
            break;
        }
    }
    best.1
}

/// A picture in linear light and its reductions to half the size.
struct Pyramid {
    levels: Vec<(u32, u32, Vec<[f32; 3]>)>,
    wrap: [Wrap; 2],
}

impl Pyramid {
    fn new(texture: &Texture) -> Pyramid {
        let linear: Vec<f32> = (0..=255).map(linear_from_srgb).collect();
        let (w, h) = (texture.width.max(1), texture.height.max(1));
        let mut texels: Vec<[f32; 3]> = texture
            .rgba
            .iter()
            .map(|t| {
                [
                    linear[t[0] as usize],
                    linear[t[1] as usize],
                    linear[t[2] as usize],
                ]
            })
            .collect();
        // What an empty picture means to Texture::sample.
        texels.resize(w as usize * h as usize, [1.0; 3]);
        let mut levels = vec![(w, h, texels)];
        while let Some((w, h, fine)) = levels.last().filter(|l| l.0 > 1 || l.1 > 1) {
            let (nw, nh) = (w.div_ceil(2), h.div_ceil(2));
            let mut coarse = Vec::with_capacity(nw as usize * nh as usize);
            for y in 0..nh {
                for x in 0..nw {
                    // Area of the coarse texel in the fine grid; exact for odd sizes too.
                    let (x0, x1) = (
                        x as f64 * *w as f64 / nw as f64,
                        (x + 1) as f64 * *w as f64 / nw as f64,
                    );
                    let (y0, y1) = (
                        y as f64 * *h as f64 / nh as f64,
                        (y + 1) as f64 * *h as f64 / nh as f64,
                    );
                    let (mut sum, mut total) = ([0.0f64; 3], 0.0);
                    for yy in y0 as u32..(y1.ceil() as u32).min(*h) {
                        for xx in x0 as u32..(x1.ceil() as u32).min(*w) {
                            let wx = x1.min(xx as f64 + 1.0) - x0.max(xx as f64);
                            let wy = y1.min(yy as f64 + 1.0) - y0.max(yy as f64);
                            let texel = fine[(yy * w + xx) as usize];
                            for k in 0..3 {
                                sum[k] += texel[k] as f64 * wx * wy;
                            }
                            total += wx * wy;
                        }
                    }
                    coarse.push(sum.map(|s| (s / total) as f32));
                }
            }
            levels.push((nw, nh, coarse));
        }
        Pyramid {
            levels,
            wrap: texture.wrap,
        }
    }

    /// A step in texture coordinates in texels of the finest level.
    fn texels(&self, step: Vec2) -> Vec2 {
        let (w, h, _) = &self.levels[0];
        Vec2::new(step.x * *w as f32, step.y * *h as f32)
    }

    fn sample(&self, level: usize, uv: Vec2) -> Rgb {
        let (w, h, texels) = &self.levels[level.min(self.levels.len() - 1)];
        let bounded = |v: f32| {
            if v.is_finite() && v.abs() < 1.0e6 {
                v
            } else {
                0.0
            }
        };
        let (x, y) = (
            bounded(uv.x) * *w as f32 - 0.5,
            bounded(uv.y) * *h as f32 - 0.5,
        );
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let place = |i: i64, n: u32, wrap: Wrap| -> usize {
            let n = n as i64;
            (match wrap {
                Wrap::Repeat => i.rem_euclid(n),
                Wrap::Mirror => {
                    let j = i.rem_euclid(2 * n);
                    if j < n { j } else { 2 * n - 1 - j }
                }
                Wrap::Clamp => i.clamp(0, n - 1),
            }) as usize
        };
        let mut sum = Rgb::BLACK;
        for (dx, dy, weight) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            let column = place(x0 as i64 + dx, *w, self.wrap[0]);
            let row = place(y0 as i64 + dy, *h, self.wrap[1]);
            sum += Rgb::from(texels[row * *w as usize + column]) * weight;
        }
        sum
    }
}
