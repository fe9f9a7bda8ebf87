//! Pictures made by formulas: a floor of planks and a few paintings.

use crate::builder::random;
use luxel_core::{Texture, texture::Wrap};

/// A square of 16 x 2 staggered planks, lengthwise down the picture: 2 m of floor.
pub fn planks() -> Texture {
    const SIZE: u32 = 256;
    const ACROSS: u32 = 16;
    let width = SIZE / ACROSS;
    paint("planks", SIZE, SIZE, |x, y| {
        let column = x / width;
        // Joints lie a third of the length further on from plank to plank.
        let shifted = (y + column * 83) % SIZE;
        let half = shifted / (SIZE / 2);
        let plank = (column * 2 + half) as u64;
        let tone = 0.82 + 0.30 * random(11, plank);
        let red = 0.97 + 0.06 * random(12, plank);
        // Grain: noise that changes fast across and slowly along the plank.
        let grain = wave(
            x as f32 * 0.45 + 31.0 * plank as f32,
            shifted as f32 * 0.02,
            13,
        );
        let fine = wave(
            x as f32 * 0.9,
            shifted as f32 * 0.06 + 7.0 * plank as f32,
            14,
        );
        let wood = tone * (0.90 + 0.16 * grain + 0.06 * fine);
        let joint = x.is_multiple_of(width) || shifted.is_multiple_of(SIZE / 2);
        let light = if joint { 0.62 * wood } else { wood };
        [218.0 * light * red, 172.0 * light, 124.0 * light]
    })
}

/// Bands of colour that lie over one another like hills at dusk.
pub fn hills() -> Texture {
    paint("hills", 128, 96, |x, y| {
        let (u, v) = (x as f32 / 128.0, y as f32 / 96.0);
        let sun = ((u - 0.68).powi(2) * 1.78 + (v - 0.33).powi(2)).sqrt() < 0.1;
        let mut colour = [242.0 - 60.0 * v, 196.0 - 30.0 * v, 150.0 + 20.0 * v];
        if sun {
            colour = [250.0, 236.0, 190.0];
        }
        let ranges = [
            (0.46, [196.0, 142.0, 128.0]),
            (0.6, [120.0, 110.0, 124.0]),
            (0.76, [52.0, 74.0, 86.0]),
        ];
        for (k, (height, tone)) in ranges.into_iter().enumerate() {
            let ridge =
                height + 0.09 * (wave(u * (4.0 + 2.0 * k as f32), 3.0 * k as f32, 21) - 0.5);
            if v > ridge {
                colour = tone;
            }
        }
        colour
    })
}

/// Discs and a half disc on a pale ground.
pub fn discs() -> Texture {
    paint("discs", 96, 128, |x, y| {
        let (u, v) = (x as f32 / 96.0, y as f32 / 96.0);
        let inside = |cu: f32, cv: f32, r: f32| (u - cu).powi(2) + (v - cv).powi(2) < r * r;
        if inside(0.34, 0.36, 0.2) {
            [206.0, 88.0, 52.0]
        } else if inside(0.62, 0.62, 0.24) && v > 0.62 {
            [36.0, 92.0, 104.0]
        } else if inside(0.62, 0.60, 0.24) && v < 0.58 {
            [226.0, 178.0, 78.0]
        } else if inside(0.34, 1.0, 0.12) {
            [44.0, 52.0, 66.0]
        } else {
            [236.0, 228.0, 212.0]
        }
    })
}

/// Rectangles of strong colour between dark bars.
pub fn grid() -> Texture {
    paint("grid", 96, 96, |x, y| {
        let bar = [30, 66].iter().any(|&c| x.abs_diff(c) < 3)
            || [22, 70].iter().any(|&c| y.abs_diff(c) < 3);
        match (bar, x < 30, x > 66, y < 22, y > 70) {
            (true, ..) => [28.0, 28.0, 30.0],
            (_, true, _, true, _) => [190.0, 36.0, 32.0],
            (_, _, true, _, true) => [34.0, 66.0, 150.0],
            (_, _, true, true, _) => [232.0, 196.0, 60.0],
            _ => [238.0, 234.0, 226.0],
        }
    })
}

/// Slow colour noise: water from above.
pub fn water() -> Texture {
    paint("water", 128, 96, |x, y| {
        let (u, v) = (x as f32 / 128.0, y as f32 / 96.0);
        let a = wave(u * 5.0 + 2.0 * wave(v * 3.0, u * 2.0, 31), v * 9.0, 32);
        let b = wave(u * 14.0, v * 26.0 + 3.0 * a, 33);
        let crest = if a * 0.7 + b * 0.3 > 0.64 { 60.0 } else { 0.0 };
        [
            36.0 + 40.0 * a + crest,
            96.0 + 60.0 * a + crest,
            128.0 + 50.0 * b + crest,
        ]
    })
}

/// Smooth noise 0..1 with lattice spacing 1.
fn wave(x: f32, y: f32, seed: u64) -> f32 {
    let (x0, y0) = (x.floor(), y.floor());
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (fx, fy) = (ease(x - x0), ease(y - y0));
    let lattice = |i: f32, j: f32| {
        random(
            seed,
            ((i as i64 as u64) << 32) ^ (j as i64 as u64 & 0xffff_ffff),
        )
    };
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    mix(
        mix(lattice(x0, y0), lattice(x0 + 1.0, y0), fx),
        mix(lattice(x0, y0 + 1.0), lattice(x0 + 1.0, y0 + 1.0), fx),
        fy,
    )
}

fn paint(name: &str, width: u32, height: u32, colour: impl Fn(u32, u32) -> [f32; 3]) -> Texture {
    let texels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let rgba = texels
        .map(|(x, y)| {
            // In steps of 2: half the noise to store, and nothing that hangs on a last bit.
            let [r, g, b] = colour(x, y).map(|v| ((v.clamp(0.0, 255.0) / 2.0).round() * 2.0) as u8);
            [r, g, b, 255]
        })
        .collect();
    Texture {
        name: name.into(),
        width,
        height,
        rgba,
        wrap: [Wrap::Repeat; 2],
    }
}
