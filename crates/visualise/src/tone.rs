//! From luminance to the screen: exposure, tone curve, encoding, false colour.
//!
//! Exposure follows the log-average luminance, which is brought near middle grey; white follows a
//! high percentile, so that about 99 % of a picture stays below it [Reinhard02]. The curve works
//! on luminance and keeps hue; what is still too bright for one band fades to white.
//!
//! Source: [Reinhard02], equations 1, 2 and 4. Differs: darkest and brightest percent are left
//! out of the average; the key counts after the curve.

use crate::lit_mesh::LitMesh;
use luxel_core::Rgb;
use luxel_core::quantity::LAMBERTIAN;

/// Display value that the log-average luminance gets: a little more than middle grey (18 %
/// linear), since rooms are lighter than what photographers call average.
const KEY: f32 = 0.22;

/// Luminance that saturates a camera at exposure value 0 and ISO 100, cd/m² [Lagarde14].
const SATURATION_EV0: f32 = 1.2;

/// How luminance becomes a display value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Display value before the curve for each cd/m².
    pub scale: f32,
    /// Display value before the curve that becomes white; more than 1.
    pub white: f32,
}

impl Exposure {
    /// For a picture whose pixels have these luminances (cd/m², any order; zeros and numbers
    /// that are not finite do not count).
    ///
    /// The log-average becomes about middle grey, or less where a fifth of the picture is far brighter;
    /// at least 99 % of the given values stay below white,
    /// unless the brightest percent is over a thousand times the average.
    pub fn automatic(luminances: &[f32]) -> Exposure {
        let mut lit: Vec<f32> = luminances
            .iter()
            .copied()
            .filter(|l| l.is_finite() && *l > 0.0)
            .collect();
        if lit.is_empty() {
            return Exposure {
                scale: 1.0,
                white: 4.0,
            };
        }
        lit.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| lit[(share * (lit.len() - 1) as f64).round() as usize];
        let bounds = [at(0.01), at(0.99)];
        let sum: f64 = lit
            .iter()
            .map(|l| l.clamp(bounds[0], bounds[1]).ln() as f64)
            .sum();
        let average = (sum / lit.len() as f64).exp() as f32;
        // x / (1 + x) = key before the curve's end at white, which lies far above the key.
        // Where a dark half pulls the average down, the bright fifth still keeps its drawing:
        // three quarters of white.
        let scale = (KEY / (1.0 - KEY) / average).min(3.0 / at(0.8));
        let white = (at(0.995) * scale * 1.05).clamp(1.5, 250.0);
        Exposure { scale, white }
    }

    /// As a camera at this exposure value (ISO 100) would see it.
    pub fn from_ev100(ev100: f32) -> Exposure {
        Exposure {
            scale: 1.0 / (SATURATION_EV0 * ev100.exp2()),
            white: 4.0,
        }
    }

    /// The exposure value (ISO 100) at which a camera would saturate at display value 1.
    pub fn ev100(&self) -> f32 {
        (1.0 / (self.scale * SATURATION_EV0)).log2()
    }

    /// Display value before encoding, each band 0..=1, of a luminance in linear bands.
    pub fn display(&self, luminance: Rgb) -> Rgb {
        let x = luminance.luminance() * self.scale;
        if x.is_nan() || x <= 0.0 {
            return Rgb::BLACK;
        }
        if x.is_infinite() {
            return Rgb::WHITE;
        }
        // Beyond white all is white; f32 would otherwise overflow in the square.
        let x = x.min(self.white);
        let y = (x * (1.0 + x / (self.white * self.white)) / (1.0 + x)).min(1.0);
        let colour = luminance.map(|v| v.max(0.0)) * (y / luminance.luminance());
        let most = colour.max_band();
        if most <= 1.0 {
            return colour;
        }
        // Towards grey of the same luminance until the largest band fits.
        let keep = (1.0 - y) / (most - y);
        colour.map(|v| (y + (v - y) * keep).clamp(0.0, 1.0))
    }
}

/// Factor from lux to the linear vertex colours of a file whose viewers have no tone curve.
///
/// Colour = illuminance * factor; the display shows reflectance times it. Area-weighted: the
/// log-average gets 0.3 where that leaves nine tenths of the area below 1, and always at least
/// so much that the brightest hundredth reaches 1.
pub fn linear_scale(mesh: &LitMesh) -> f32 {
    let mut samples: Vec<(f32, f64)> = Vec::with_capacity(mesh.triangles.len());
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let sum: f32 = corners
            .iter()
            .map(|&v| mesh.irradiance[v as usize].luminance())
            .sum();
        if sum.is_finite() && sum > 0.0 {
            samples.push((sum / 3.0, mesh.area(t)));
        }
    }
    let whole: f64 = samples.iter().map(|s| s.1).sum();
    if whole <= 0.0 {
        return 1.0 / LAMBERTIAN;
    }
    samples.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let at = |share: f64| {
        let mut sum = 0.0;
        samples
            .iter()
            .find(|s| {
                sum += s.1;
                sum >= share * whole
            })
            .map_or(samples[samples.len() - 1].0, |s| s.0)
    };
    let bounds = (at(0.01), at(0.99));
    let log: f64 = samples
        .iter()
        .map(|s| s.0.clamp(bounds.0, bounds.1).ln() as f64 * s.1)
        .sum();
    let average = (log / whole).exp() as f32;
    (0.3 / average).min(1.0 / at(0.9)).max(1.0 / at(0.99))
}

/// Encodes linear display values as sRGB bytes, quickly: a table of 4096 steps, within one
/// byte of the formula [IEC61966-2-1].
pub struct Encoder {
    table: Vec<u8>,
}

impl Default for Encoder {
    fn default() -> Self {
        let table = (0..=4096)
            .map(|i| srgb_from_linear(i as f32 / 4096.0))
            .collect();
        Encoder { table }
    }
}

impl Encoder {
    /// Bytes of a display value; bands outside 0..=1 are clipped.
    pub fn encode(&self, value: Rgb) -> [u8; 3] {
        value
            .to_array()
            .map(|v| self.table[(v.clamp(0.0, 1.0) * 4096.0 + 0.5) as usize])
    }
}

/// One sRGB byte from linear light 0..=1 [IEC61966-2-1].
pub fn srgb_from_linear(v: f32) -> u8 {
    let v = v.clamp(0.0, 1.0);
    let e = if v <= 0.003_130_8 {
        12.92 * v
    } else {
        1.055 * v.powf(1.0 / 2.4) - 0.055
    };
    (e * 255.0 + 0.5) as u8
}

/// The ramp of false colour: sRGB at equal steps, dark to light, so that it survives a grey
/// print; blue, teal, green, amber, cream.
const RAMP: [[u8; 3]; 9] = [
    [18, 14, 62],
    [32, 44, 122],
    [24, 88, 148],
    [20, 128, 140],
    [52, 160, 104],
    [132, 184, 60],
    [214, 190, 56],
    [248, 204, 120],
    [255, 242, 214],
];

/// Colour of a place 0..=1 on the false-colour ramp, sRGB.
pub fn ramp(place: f32) -> [u8; 3] {
    let last = RAMP.len() - 1;
    let x = if place.is_nan() {
        0.0
    } else {
        place.clamp(0.0, 1.0) * last as f32
    };
    let k = (x as usize).min(last - 1);
    let f = x - k as f32;
    std::array::from_fn(|band| {
        let (a, b) = (RAMP[k][band] as f32, RAMP[k + 1][band] as f32);
        (a + (b - a) * f + 0.5) as u8
    })
}

/// A logarithmic scale of illuminance between round numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct LuxScale {
    /// Lux at the dark end.
    pub low: f32,
    /// Lux at the light end.
    pub high: f32,
    /// Round values on it, ascending, with both ends: steps of 1, 2, 5.
    pub ticks: Vec<f32>,
}

impl LuxScale {
    /// A scale that holds the middle 96 % of the values (lux), over at most four decades.
    pub fn around(values: &[f32]) -> LuxScale {
        let mut lit: Vec<f32> = values
            .iter()
            .copied()
            .filter(|l| l.is_finite() && *l > 1e-6)
            .collect();
        lit.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| {
            lit.get((share * lit.len().saturating_sub(1) as f64).round() as usize)
                .copied()
        };
        let high = at(0.98).unwrap_or(1000.0).min(1e30);
        let low = at(0.02).unwrap_or(1.0).clamp(high * 1e-4, high * 0.5);
        // Exponent of ten times three plus 0, 1 or 2 for 1, 2 and 5.
        let round =
            |i: i32| 10f64.powi(i.div_euclid(3)) * [1.0, 2.0, 5.0][i.rem_euclid(3) as usize];
        let near = |v: f32| 3 * (v as f64).log10().floor() as i32;
        let mut first = near(low);
        while round(first + 1) <= low as f64 * 1.0001 {
            first += 1;
        }
        let mut last = near(high);
        while round(last) < high as f64 * 0.9999 {
            last += 1;
        }
        let ticks: Vec<f32> = (first..=last).map(|i| round(i) as f32).collect();
        LuxScale {
            low: ticks[0],
            high: ticks[ticks.len() - 1],
            ticks,
        }
    }

    /// Place on the ramp, 0..=1.
    pub fn place(&self, lux: f32) -> f32 {
        if lux.is_nan() || lux <= self.low {
            return 0.0;
        }
        ((lux / self.low).ln() / (self.high / self.low).ln()).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_average_becomes_the_key() {
        // A picture of one luminance: log-average = that value, so display = key, but for the
        // curve's second term x² / white² (1 + x): white is 1.5 here, x = 0.282.
        let e = Exposure::automatic(&[73.0; 100]);
        let grey = e.display(Rgb::splat(73.0)).g;
        let x = KEY / (1.0 - KEY);
        let expected = x * (1.0 + x / 2.25) / (1.0 + x);
        assert!((grey - expected).abs() < 1e-5, "{grey} {expected}");
    }

    #[test]
    fn ninety_nine_of_a_hundred_stay_below_white_and_hue_is_kept() {
        // Luminances over four decades, as a room with lamps has.
        let picture: Vec<f32> = (0..10_000).map(|i| 10f32.powf(i as f32 / 2500.0)).collect();
        let e = Exposure::automatic(&picture);
        let white = picture
            .iter()
            .filter(|l| e.display(Rgb::splat(**l)).g >= 0.999)
            .count();
        assert!(white <= 100, "{white} of 10000 are burnt");
        let c = e.display(Rgb::new(60.0, 30.0, 15.0));
        assert!((c.r / c.g - 2.0).abs() < 1e-4 && (c.g / c.b - 2.0).abs() < 1e-4);
    }

    #[test]
    fn display_rises_with_luminance_and_stays_in_range() {
        let e = Exposure {
            scale: 0.01,
            white: 6.0,
        };
        let mut last = -1.0;
        for k in -40..60 {
            let c = e.display(Rgb::new(1.0, 0.2, 0.05) * 2f32.powi(k));
            assert!(
                c.luminance() >= last - 1e-6 && c.max_band() <= 1.0,
                "at 2^{k}"
            );
            last = c.luminance();
        }
        for odd in [f32::NAN, -1.0, f32::INFINITY] {
            assert!(e.display(Rgb::splat(odd)).max_band() <= 1.0);
        }
    }

    #[test]
    fn exposure_value_goes_there_and_back() {
        // EV 15, bright sun: saturates at 1.2 * 2^15 = 39,322 cd/m².
        let e = Exposure::from_ev100(15.0);
        assert!((1.0 / e.scale - 39_321.6).abs() < 1.0);
        assert!((e.ev100() - 15.0).abs() < 1e-4);
    }

    #[test]
    fn encoder_is_the_inverse_of_the_core_decoder() {
        let encoder = Encoder::default();
        for byte in 0..=255u8 {
            let linear = luxel_core::texture::linear_from_srgb(byte);
            assert_eq!(srgb_from_linear(linear), byte);
            let quick = encoder.encode(Rgb::splat(linear))[0];
            assert!(
                quick.abs_diff(byte) <= 1,
                "{byte} {quick}: steps of 1/4096 near black"
            );
        }
    }

    #[test]
    fn ramp_gets_lighter_all_the_way() {
        let lightness =
            |c: [u8; 3]| Rgb::from(c.map(luxel_core::texture::linear_from_srgb)).luminance();
        for k in 0..100 {
            let (a, b) = (ramp(k as f32 / 100.0), ramp((k + 1) as f32 / 100.0));
            // One byte of rounding in a band at most.
            assert!(lightness(b) >= lightness(a) - 0.003, "{k}: {a:?} {b:?}");
        }
    }

    #[test]
    fn lux_scale_has_round_ends() {
        let s = LuxScale::around(&[3.3, 40.0, 100.0, 420.0]);
        assert_eq!((s.low, s.high), (2.0, 500.0));
        assert_eq!(s.ticks, [2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0]);
        // Half way between 2 and 500 on a logarithmic scale is their geometric mean.
        assert!((s.place(1000f32.sqrt()) - 0.5).abs() < 1e-5);
        for odd in [vec![], vec![f32::NAN], vec![0.0], vec![1e-30, 1e38]] {
            assert!(LuxScale::around(&odd).ticks.len() >= 2);
        }
    }
}
