//! The dilogarithm of a complex number, Li2(z) = sum of z^k / k^2, on its principal branch.
//!
//! Reflection and inversion bring z to |z| <= 1, Re z <= 1/2; there a series in -ln(1 - z) with
//! Bernoulli numbers gains more than a digit a term.
//!
//! Source: [Maximon03], sections 3 and 4; series [tHooft79], appendix A.

use std::f64::consts::PI;

/// A complex number, for this file and the polygon factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Complex {
    pub re: f64,
    pub im: f64,
}

impl Complex {
    pub fn new(re: f64, im: f64) -> Self {
        Complex { re, im }
    }

    pub fn plus(self, o: Complex) -> Complex {
        Complex::new(self.re + o.re, self.im + o.im)
    }

    pub fn minus(self, o: Complex) -> Complex {
        Complex::new(self.re - o.re, self.im - o.im)
    }

    pub fn times(self, o: Complex) -> Complex {
        Complex::new(
            self.re * o.re - self.im * o.im,
            self.re * o.im + self.im * o.re,
        )
    }

    pub fn scaled(self, s: f64) -> Complex {
        Complex::new(self.re * s, self.im * s)
    }

    pub fn inverse(self) -> Complex {
        let d = 1.0 / (self.re * self.re + self.im * self.im);
        Complex::new(self.re * d, -self.im * d)
    }

    pub fn norm_squared(self) -> f64 {
        self.re * self.re + self.im * self.im
    }

    /// Principal logarithm.
    pub fn ln(self) -> Complex {
        Complex::new(0.5 * self.norm_squared().ln(), self.im.atan2(self.re))
    }
}

/// B_2n / (2n + 1)! for n = 1..: coefficients of the series in u^(2n + 1).
const BERNOULLI: [f64; 10] = [
    1.0 / 36.0,
    -1.0 / 3600.0,
    1.0 / 211_680.0,
    -1.0 / 10_886_400.0,
    1.0 / 526_901_760.0,
    -4.064_761_645_144_226e-11,
    8.921_691_020_456_452e-13,
    -1.993_929_586_072_107_6e-14,
    4.518_980_029_619_918e-16,
    -1.035_651_761_218_124_7e-17,
];

/// Li2(z), cut along the real axis above 1. Relative accuracy about 1e-15.
pub(crate) fn dilogarithm(z: Complex) -> Complex {
    let one = Complex::new(1.0, 0.0);
    if z.norm_squared() < 1e-300 {
        return z;
    }
    if z.norm_squared() > 1.0 {
        let l = z.scaled(-1.0).ln();
        let inner = dilogarithm(z.inverse());
        let square = l.times(l).scaled(0.5);
        return Complex::new(-PI * PI / 6.0, 0.0).minus(inner).minus(square);
    }
    if z.re > 0.5 {
        let rest = one.minus(z);
        if rest.norm_squared() < 1e-300 {
            return Complex::new(PI * PI / 6.0, 0.0);
        }
        let product = z.ln().times(rest.ln());
        return Complex::new(PI * PI / 6.0, 0.0)
            .minus(product)
            .minus(series(rest));
    }
    series(z)
}

/// |z| <= 1 and Re z <= 1/2.
fn series(z: Complex) -> Complex {
    let u = Complex::new(1.0 - z.re, -z.im).ln().scaled(-1.0);
    let square = u.times(u);
    let mut power = u;
    let mut sum = u.minus(square.scaled(0.25));
    for b in BERNOULLI {
        power = power.times(square);
        sum = sum.plus(power.scaled(b));
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        // [Maximon03], section 5: Li2(1), Li2(-1), Li2(1/2), and Li2(i) = -pi^2/48 + i Catalan.
        let ln2 = 2.0_f64.ln();
        for (z, want) in [
            ((1.0, 0.0), (PI * PI / 6.0, 0.0)),
            ((-1.0, 0.0), (-PI * PI / 12.0, 0.0)),
            ((0.5, 0.0), (PI * PI / 12.0 - 0.5 * ln2 * ln2, 0.0)),
            ((0.0, 1.0), (-PI * PI / 48.0, 0.915_965_594_177_219)),
        ] {
            let got = dilogarithm(Complex::new(z.0, z.1));
            assert!(
                (got.re - want.0).abs() < 1e-15 && (got.im - want.1).abs() < 1e-15,
                "{z:?} {got:?}"
            );
        }
    }

    #[test]
    fn agrees_with_the_defining_integral() {
        // Li2(z) = -integral over 0..1 of ln(1 - z t) / t: 1e-11 by the adaptive rule.
        for (re, im) in [
            (0.3, 0.8),
            (-2.0, 0.5),
            (4.0, -3.0),
            (0.9, 0.05),
            (0.6, -0.7),
            (-0.2, 30.0),
        ] {
            let z = Complex::new(re, im);
            let part = |imaginary: bool| {
                crate::quadrature::adaptive(0.0, 1.0, 1e-12, &mut |t| {
                    let l = Complex::new(1.0 - re * t, -im * t).ln();
                    if imaginary { -l.im / t } else { -l.re / t }
                })
            };
            let got = dilogarithm(z);
            assert!((got.re - part(false)).abs() < 1e-10 && (got.im - part(true)).abs() < 1e-10);
        }
    }
}
