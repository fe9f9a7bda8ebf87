//! A picture on a surface: linear RGB and coverage, sampled by texture coordinates.

use crate::quantity::Rgb;
use glam::Vec2;

/// What happens to texture coordinates outside 0..1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Wrap {
    /// The picture repeats.
    #[default]
    Repeat,
    /// Every second repetition is mirrored.
    Mirror,
    /// The border texel goes on.
    Clamp,
}

/// A decoded image: 8-bit texels as stored, decoded to linear light when read.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// Name in the file, for messages.
    pub name: String,
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// RGBA, row by row from the top left. Colours are sRGB-encoded, alpha is linear.
    pub rgba: Vec<[u8; 4]>,
    /// Behaviour across and down outside 0..1.
    pub wrap: [Wrap; 2],
}

/// Decodes one sRGB byte to linear light [IEC61966-2-1].
pub fn linear_from_srgb(byte: u8) -> f32 {
    let v = byte as f32 / 255.0;
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

impl Texture {
    fn texel(&self, x: i64, y: i64) -> [u8; 4] {
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
        let (column, row) = (
            place(x, self.width, self.wrap[0]),
            place(y, self.height, self.wrap[1]),
        );
        self.rgba[row * self.width as usize + column]
    }

    /// Bilinear lookup at `uv` (glTF: origin at the top left). Linear RGB and coverage 0..=1.
    ///
    /// A coordinate that is not finite reads the first texel.
    pub fn sample(&self, uv: Vec2) -> (Rgb, f32) {
        if self.rgba.is_empty() {
            return (Rgb::WHITE, 1.0);
        }
        // Beyond 2^20 repetitions f32 holds no fraction worth reading.
        let bounded = |v: f32| {
            if v.is_finite() && v.abs() < 1.0e6 {
                v
            } else {
                0.0
            }
        };
        let x = bounded(uv.x) * self.width as f32 - 0.5;
        let y = bounded(uv.y) * self.height as f32 - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let mut colour = Rgb::BLACK;
        let mut alpha = 0.0;
        // The table is fetched once: finding it costs as much as a texel.
        LINEAR.with(|l| {
            for (dx, dy, w) in [
                (0, 0, (1.0 - fx) * (1.0 - fy)),
                (1, 0, fx * (1.0 - fy)),
                (0, 1, (1.0 - fx) * fy),
                (1, 1, fx * fy),
            ] {
                let t = self.texel(x0 as i64 + dx, y0 as i64 + dy);
                colour += Rgb::new(l[t[0] as usize], l[t[1] as usize], l[t[2] as usize]) * w;
                alpha += t[3] as f32 / 255.0 * w;
            }
        });
        (colour, alpha)
    }

    /// Mean colour of the whole picture.
    pub fn mean(&self) -> Rgb {
        let mut sum = [0.0f64; 3];
        for t in &self.rgba {
            for band in 0..3 {
                sum[band] += LINEAR.with(|l| l[t[band] as usize]) as f64;
            }
        }
        let n = self.rgba.len().max(1) as f64;
        Rgb::new(
            (sum[0] / n) as f32,
            (sum[1] / n) as f32,
            (sum[2] / n) as f32,
        )
    }
}

thread_local! {
    static LINEAR: [f32; 256] = std::array::from_fn(|i| linear_from_srgb(i as u8));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checker() -> Texture {
        Texture {
            name: "checker".into(),
            width: 2,
            height: 1,
            rgba: vec![[255, 255, 255, 255], [0, 0, 0, 0]],
            wrap: [Wrap::Repeat; 2],
        }
    }

    #[test]
    fn texel_centres_are_exact_and_middle_is_the_mean() {
        let t = checker();
        assert_eq!(t.sample(Vec2::new(0.25, 0.5)), (Rgb::WHITE, 1.0));
        let (colour, alpha) = t.sample(Vec2::new(0.5, 0.5));
        assert!((colour.g - 0.5).abs() < 1e-6 && (alpha - 0.5).abs() < 1e-6);
    }

    #[test]
    fn wild_coordinates_do_not_panic() {
        for v in [f32::NAN, f32::INFINITY, -1e30, 1e30, -7.3] {
            checker().sample(Vec2::new(v, v));
        }
    }
}
