//! Photometric quantities with types, and the one place where pi stands between them.
//!
//! A single value at a border has a type (`Lumens`, `Exitance`, ...). Bulk arrays are plain
//! `f32` whose name says the quantity.
//!
//! ```
//! use luxel_core::quantity::{Exitance, Lumens, Luminance, Rgb};
//! let lamp = Lumens::new(800.0).isotropic_intensity();
//! assert!((lamp.candela() - 63.66198).abs() < 1e-4);
//! let screen = Luminance::new(Rgb::splat(100.0)).lambertian_exitance();
//! assert!((screen.rgb().g - 314.15927).abs() < 1e-4);
//! ```

use std::f64::consts::PI;
use std::ops::{Add, AddAssign, Mul, MulAssign, Sub};

/// The ratio between exitance and luminance of a Lambertian surface: M = pi L [Lambert1760].
pub const LAMBERTIAN: f32 = PI as f32;

/// The solid angle of the whole sphere, steradian.
pub const SPHERE_SR: f32 = (4.0 * PI) as f32;

/// Luminance weights of linear RGB with Rec. 709 primaries.
pub const LUMINANCE_WEIGHTS: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Three linear bands (red, green, blue) of any quantity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Rgb {
    /// Red band.
    pub r: f32,
    /// Green band.
    pub g: f32,
    /// Blue band.
    pub b: f32,
}

impl Rgb {
    /// All bands zero.
    pub const BLACK: Rgb = Rgb::splat(0.0);
    /// All bands one.
    pub const WHITE: Rgb = Rgb::splat(1.0);

    /// Three bands.
    #[inline]
    pub const fn new(r: f32, g: f32, b: f32) -> Self {
        Rgb { r, g, b }
    }

    /// The same value in each band.
    #[inline]
    pub const fn splat(v: f32) -> Self {
        Rgb::new(v, v, v)
    }

    /// The photometric value: bands weighted by [`LUMINANCE_WEIGHTS`].
    #[inline]
    pub fn luminance(self) -> f32 {
        self.r * LUMINANCE_WEIGHTS[0]
            + self.g * LUMINANCE_WEIGHTS[1]
            + self.b * LUMINANCE_WEIGHTS[2]
    }

    /// The largest band.
    #[inline]
    pub fn max_band(self) -> f32 {
        self.r.max(self.g).max(self.b)
    }

    /// Each band through `f`.
    #[inline]
    pub fn map(self, f: impl Fn(f32) -> f32) -> Self {
        Rgb::new(f(self.r), f(self.g), f(self.b))
    }

    /// As an array.
    #[inline]
    pub fn to_array(self) -> [f32; 3] {
        [self.r, self.g, self.b]
    }

    /// Whether every band is finite.
    pub fn is_finite(self) -> bool {
        self.r.is_finite() && self.g.is_finite() && self.b.is_finite()
    }
}

impl From<[f32; 3]> for Rgb {
    #[inline]
    fn from(a: [f32; 3]) -> Self {
        Rgb::new(a[0], a[1], a[2])
    }
}
impl Add for Rgb {
    type Output = Rgb;
    #[inline]
    fn add(self, o: Rgb) -> Rgb {
        Rgb::new(self.r + o.r, self.g + o.g, self.b + o.b)
    }
}
impl Sub for Rgb {
    type Output = Rgb;
    #[inline]
    fn sub(self, o: Rgb) -> Rgb {
        Rgb::new(self.r - o.r, self.g - o.g, self.b - o.b)
    }
}
impl AddAssign for Rgb {
    #[inline]
    fn add_assign(&mut self, o: Rgb) {
        *self = *self + o;
    }
}
impl Mul for Rgb {
    type Output = Rgb;
    #[inline]
    fn mul(self, o: Rgb) -> Rgb {
        Rgb::new(self.r * o.r, self.g * o.g, self.b * o.b)
    }
}
impl Mul<f32> for Rgb {
    type Output = Rgb;
    #[inline]
    fn mul(self, k: f32) -> Rgb {
        Rgb::new(self.r * k, self.g * k, self.b * k)
    }
}
impl MulAssign<f32> for Rgb {
    #[inline]
    fn mul_assign(&mut self, k: f32) {
        *self = *self * k;
    }
}

macro_rules! banded {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct $name(Rgb);

        impl $name {
            /// From linear bands in the unit of this quantity.
            pub const fn new(rgb: Rgb) -> Self {
                $name(rgb)
            }
            /// The linear bands.
            pub const fn rgb(self) -> Rgb {
                self.0
            }
            /// The photometric value.
            pub fn value(self) -> f32 {
                self.0.luminance()
            }
        }
        impl Add for $name {
            type Output = $name;
            fn add(self, o: $name) -> $name {
                $name(self.0 + o.0)
            }
        }
    };
}

banded!(
    /// Luminous flux leaving a surface per area, lm/m².
    Exitance
);
banded!(
    /// Luminous flux arriving on a surface per area, lux.
    Illuminance
);
banded!(
    /// Luminance, cd/m².
    Luminance
);
banded!(
    /// Diffuse reflectance, 0..=1 per band, no unit.
    Reflectance
);

impl Exitance {
    /// Luminance of a Lambertian surface of this exitance: L = M / pi.
    pub fn lambertian_luminance(self) -> Luminance {
        Luminance(self.0 * (1.0 / LAMBERTIAN))
    }
}

impl Luminance {
    /// Exitance of a Lambertian surface of this luminance: M = pi L.
    pub fn lambertian_exitance(self) -> Exitance {
        Exitance(self.0 * LAMBERTIAN)
    }
}

impl Mul<Illuminance> for Reflectance {
    type Output = Exitance;
    fn mul(self, irradiance: Illuminance) -> Exitance {
        Exitance(self.0 * irradiance.0)
    }
}

/// Luminous flux, lm.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Lumens(f32);

impl Lumens {
    /// From a number of lumens.
    pub const fn new(lumens: f32) -> Self {
        Lumens(lumens)
    }
    /// The number of lumens.
    pub const fn lumens(self) -> f32 {
        self.0
    }
    /// Intensity of a point that sends this flux evenly into all directions: I = flux / 4 pi.
    pub fn isotropic_intensity(self) -> Candela {
        Candela(self.0 / SPHERE_SR)
    }
}

/// Luminous intensity, cd.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Candela(f32);

impl Candela {
    /// From a number of candela.
    pub const fn new(candela: f32) -> Self {
        Candela(candela)
    }
    /// The number of candela.
    pub const fn candela(self) -> f32 {
        self.0
    }
    /// Flux of a point of this intensity in all directions.
    pub fn isotropic_flux(self) -> Lumens {
        Lumens(self.0 * SPHERE_SR)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exitance_is_pi_times_luminance() {
        let exitance = Luminance::new(Rgb::splat(1.0)).lambertian_exitance();
        assert_eq!(exitance.rgb(), Rgb::splat(LAMBERTIAN));
        let back = exitance.lambertian_luminance().value();
        assert!((back - 1.0).abs() < 1e-6, "f32 rounding only");
    }

    #[test]
    fn leaving_is_emitted_plus_reflected() {
        let leaving = Exitance::new(Rgb::splat(1.0))
            + Reflectance::new(Rgb::splat(0.5)) * Illuminance::new(Rgb::splat(4.0));
        assert_eq!(leaving.rgb(), Rgb::splat(3.0));
    }

    #[test]
    fn luminance_weights_sum_to_one() {
        assert!((Rgb::WHITE.luminance() - 1.0).abs() < 1e-6);
    }
}
