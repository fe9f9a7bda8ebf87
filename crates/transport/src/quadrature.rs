//! Numerical integration in one dimension and over polygons: Gauss-Legendre of any order and an
//! adaptive Gauss-Kronrod rule.
//!
//! Sources: Gauss nodes by Newton's method on the Legendre polynomial [Press07], section 4.6;
//! Kronrod nodes [Piessens83].

use luxel_core::{DVec3, Polygon};
use std::sync::OnceLock;

/// Highest order of [`gauss`].
pub(crate) const MAX_ORDER: usize = 32;

/// Nodes in -1..1 and weights of the Gauss-Legendre rule with `n` points, 1..=32.
pub(crate) fn gauss(n: usize) -> &'static [(f64, f64)] {
    static RULES: OnceLock<Vec<Vec<(f64, f64)>>> = OnceLock::new();
    &RULES.get_or_init(|| (0..=MAX_ORDER).map(legendre).collect())[n]
}

fn legendre(n: usize) -> Vec<(f64, f64)> {
    let order = n as f64;
    (0..n)
        .map(|i| {
            let mut x = -(std::f64::consts::PI * (i as f64 + 0.75) / (order + 0.5)).cos();
            let mut slope = 1.0;
            // Newton doubles the digits: six steps from this start are plenty.
            for _ in 0..6 {
                let (mut before, mut value) = (1.0, x);
                for k in 2..=n {
                    let k = k as f64;
                    (before, value) = (
                        value,
                        ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k,
                    );
                }
                slope = order * (x * value - before) / (x * x - 1.0);
                x -= value / slope;
            }
            (x, 2.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

/// Kronrod nodes above zero with their weight, and the weight of the 7-point Gauss rule where
/// it shares the node.
const KRONROD: [(f64, f64, f64); 8] = [
    (0.0, 0.209_482_141_084_727_82, 0.417_959_183_673_469_4),
    (0.207_784_955_007_898_47, 0.204_432_940_075_298_9, 0.0),
    (
        0.405_845_151_377_397_2,
        0.190_350_578_064_785_4,
        0.381_830_050_505_118_9,
    ),
    (0.586_087_235_467_691_1, 0.169_004_726_639_267_9, 0.0),
    (
        0.741_531_185_599_394_4,
        0.140_653_259_715_525_92,
        0.279_705_391_489_276_64,
    ),
    (0.864_864_423_359_769_1, 0.104_790_010_322_250_18, 0.0),
    (
        0.949_107_912_342_758_5,
        0.063_092_092_629_978_55,
        0.129_484_966_168_869_7,
    ),
    (0.991_455_371_120_812_6, 0.022_935_322_010_529_224, 0.0),
];

/// Integral to `tolerance` (absolute) by bisection with the 7-15 Gauss-Kronrod rule; stops
/// at 40 bisections deep, so integrable singularities at an end cost time, not correctness.
pub(crate) fn adaptive(low: f64, high: f64, tolerance: f64, f: &mut impl FnMut(f64) -> f64) -> f64 {
    let mut todo = vec![(low, high, 0_u32)];
    let mut sum = 0.0;
    while let Some((a, b, depth)) = todo.pop() {
        let (middle, half) = (0.5 * (a + b), 0.5 * (b - a));
        let (mut fine, mut coarse) = (0.0, 0.0);
        for (k, &(x, wk, wg)) in KRONROD.iter().enumerate() {
            let y = if k == 0 {
                f(middle)
            } else {
                f(middle - half * x) + f(middle + half * x)
            };
            fine += wk * y;
            coarse += wg * y;
        }
        let error = ((fine - coarse) * half).abs();
        // The difference is the error of the 7-point rule; the 15-point one is far better.
        if depth >= 40 || error <= tolerance * ((b - a) / (high - low)).abs().max(1e-3) {
            sum += fine * half;
        } else {
            todo.push((middle, b, depth + 1));
            todo.push((a, middle, depth + 1));
        }
    }
    sum
}

/// Points and weights (m²) for integration over a convex polygon: a tensor rule of `n` x `n`
/// points on a parallelogram, collapsed ones on the triangles of a fan otherwise.
pub(crate) fn over_polygon(polygon: &Polygon, n: usize, mut each: impl FnMut(DVec3, f64)) {
    let v = &polygon.vertices;
    let rule = gauss(n);
    if let &[a, b, c, d] = v.as_slice()
        && (a - b + c - d).length_squared() <= 1e-24 * (c - a).length_squared()
    {
        let quarter = 0.25 * (b - a).cross(d - a).length();
        for &(x, wx) in rule {
            for &(y, wy) in rule {
                let p = a + (b - a) * (0.5 + 0.5 * x) + (d - a) * (0.5 + 0.5 * y);
                each(p, wx * wy * quarter);
            }
        }
        return;
    }
    for k in 1..v.len().saturating_sub(1) {
        let (a, b, c) = (v[0], v[k], v[k + 1]);
        let double = (b - a).cross(c - a).length();
        for &(x, wx) in rule {
            let s = 0.5 + 0.5 * x;
            for &(y, wy) in rule {
                let t = 0.5 + 0.5 * y;
                each(
                    a + (b - a) * (s * (1.0 - t)) + (c - a) * (s * t),
                    0.25 * wx * wy * s * double,
                );
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauss_is_exact_for_polynomials() {
        // n points integrate x^(2n-1) and below exactly; even powers give 2/(k+1).
        for n in 1..=MAX_ORDER {
            for k in (0..2 * n).step_by(2) {
                let sum: f64 = gauss(n).iter().map(|&(x, w)| w * x.powi(k as i32)).sum();
                assert!(
                    (sum - 2.0 / (k as f64 + 1.0)).abs() < 1e-13,
                    "order {n}, power {k}"
                );
            }
        }
    }

    #[test]
    fn adaptive_rule_meets_its_tolerance() {
        // Integral of ln x over 0..1 is -1; of 1/(1e-4 + x^2) over -1..1 is 200 atan(100).
        let log = adaptive(0.0, 1.0, 1e-10, &mut |x| x.ln());
        assert!((log + 1.0).abs() < 1e-9);
        let peak = adaptive(-1.0, 1.0, 1e-8, &mut |x| 1.0 / (1e-4 + x * x));
        assert!((peak - 200.0 * 100.0_f64.atan()).abs() < 1e-8);
    }

    #[test]
    fn polygon_rule_integrates_moments() {
        // Unit square: area 1, mean of x^2 1/3. Triangle (0,0) (1,0) (0,1): integral of xy 1/24.
        let square = Polygon::new(
            [(0., 0.), (1., 0.), (1., 1.), (0., 1.)]
                .map(|(x, y)| DVec3::new(x, y, 0.0))
                .to_vec(),
        );
        let triangle = Polygon::new(
            [(0., 0.), (1., 0.), (0., 1.)]
                .map(|(x, y)| DVec3::new(x, y, 0.0))
                .to_vec(),
        );
        let (mut area, mut second, mut cross) = (0.0, 0.0, 0.0);
        over_polygon(&square, 3, |p, w| {
            area += w;
            second += w * p.x * p.x;
        });
        over_polygon(&triangle, 3, |p, w| cross += w * p.x * p.y);
        assert!((area - 1.0).abs() < 1e-14 && (second - 1.0 / 3.0).abs() < 1e-14);
        assert!((cross - 1.0 / 24.0).abs() < 1e-15);
    }
}
