//! Low-discrepancy points and the maps from them to directions.
//!
//! The first four Sobol' dimensions, each Owen-scrambled by a hash [Burley20] with the constants
//! of sobol_burley. That crate stops at 2^16 points and shuffles the index as well; here the
//! index is not shuffled, so all 2^32 points exist, any aligned run of 2^k points is a net, and
//! a point costs four table look-ups. Scrambling is nested: every point is uniform by itself.
//!
//! Sources: direction numbers [Joe08]; scrambling [Burley20]; disc map [Shirley97];
//! frame around a normal [Duff17].

use luxel_core::Vec3;

/// A four-dimensional low-discrepancy sequence that belongs to one (seed, stream).
///
/// Sequences of different streams are scrambled independently.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sequence {
    scramble: [u32; 4],
}

impl Sequence {
    /// The sequence of a seed and a stream (an element, a receiver, a pair).
    #[inline]
    pub fn new(seed: u32, stream: u32) -> Self {
        let base = hash([seed, stream]);
        Sequence {
            scramble: [
                mix(base ^ 0x912f_69ba),
                mix(base ^ 0x174f_18ab),
                mix(base ^ 0x691e_72ca),
                mix(base ^ 0xb40c_c1b8),
            ],
        }
    }

    /// Point `index` as four 32-bit fractions.
    #[inline]
    pub fn bits4(&self, index: u32) -> [u32; 4] {
        let [b0, b1, b2, b3] = index.to_le_bytes();
        let t = &TABLE;
        let (r0, r1) = (&t[0][b0 as usize], &t[1][b1 as usize]);
        let (r2, r3) = (&t[2][b2 as usize], &t[3][b3 as usize]);
        let mut x = [0; 4];
        for d in 0..4 {
            x[d] = r0[d] ^ r1[d] ^ r2[d] ^ r3[d];
        }
        for d in 0..4 {
            x[d] = scramble(x[d], self.scramble[d]);
        }
        x
    }

    /// Point `index` of the unit hypercube, each coordinate in 0..1 and below 1.
    #[inline]
    pub fn point4(&self, index: u32) -> [f32; 4] {
        self.bits4(index).map(fraction)
    }

    /// The first two coordinates of point `index`.
    #[inline]
    pub fn point2(&self, index: u32) -> [f32; 2] {
        let [a, b, _, _] = self.bits4(index);
        [fraction(a), fraction(b)]
    }

    /// The first coordinate of point `index` to 32 bits, in 0..1 and below 1.
    #[inline]
    pub fn point1(&self, index: u32) -> f64 {
        self.bits4(index)[0] as f64 * (1.0 / 4_294_967_296.0)
    }

    /// A fifth coordinate of point `index` to 32 bits, in 0..1 and below 1, which goes with the
    /// four as if drawn apart: first coordinates in shuffled order [Burley20].
    ///
    /// The coordinates of two sequences at one index do not: scrambled or not, points that share
    /// a run of one share a run of the other.
    #[inline]
    pub fn fifth(&self, index: u32) -> f64 {
        let seed = mix(self.scramble[3] ^ 0x5f35_9e2d);
        self.point1(scramble(index.reverse_bits(), seed))
    }
}

/// A direction around `normal` with density cosine over pi, for `(u, v)` uniform in the square.
///
/// Unit length to a few f32 rounding errors; never below the horizon.
#[inline]
pub fn cosine_hemisphere([u, v]: [f32; 2], normal: Vec3) -> Vec3 {
    let [x, y] = disc([u, v]);
    let z = (1.0 - x * x - y * y).max(0.0).sqrt();
    let [a, b] = frame(normal);
    a * x + b * y + normal * z
}

/// Uniform point of the unit disc by the concentric map [Shirley97], which keeps squares whole.
#[inline]
pub fn disc([u, v]: [f32; 2]) -> [f32; 2] {
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    let flat = a.abs() > b.abs();
    let (radius, other) = if flat { (a, b) } else { (b, a) };
    if radius == 0.0 {
        return [0.0, 0.0];
    }
    // Angle within -pi/4..=pi/4: Taylor to x^9 is exact to f32, branch-free, and the same on
    // every platform, which sin and cos of a maths library are not.
    let x = std::f32::consts::FRAC_PI_4 * (other / radius);
    let s = x * x;
    let sin = x
        * (1.0 - s * (1.0 / 6.0 - s * (1.0 / 120.0 - s * (1.0 / 5040.0 - s * (1.0 / 362_880.0)))));
    let cos = 1.0 - s * (0.5 - s * (1.0 / 24.0 - s * (1.0 / 720.0 - s * (1.0 / 40_320.0))));
    let (p, q) = (radius * cos, radius * sin);
    if flat { [p, q] } else { [q, p] }
}

/// Two unit vectors square to a unit `normal` and to each other, right-handed [Duff17].
#[inline]
pub fn frame(normal: Vec3) -> [Vec3; 2] {
    let sign = 1.0_f32.copysign(normal.z);
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    [
        Vec3::new(
            1.0 + sign * normal.x * normal.x * a,
            sign * b,
            -sign * normal.x,
        ),
        Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
    ]
}

/// A well-mixed number from a few words; for streams and seeds, not for cryptography.
#[inline]
pub fn hash<const N: usize>(words: [u32; N]) -> u32 {
    words.iter().fold(0x9e37_79b9, |state, &w| {
        mix(state.rotate_left(5).wrapping_mul(0x2722_0a95) ^ w)
    })
}

/// Bijective mixing of one word (Wellons' lowbias32, the constants of sobol_burley).
#[inline]
fn mix(mut n: u32) -> u32 {
    n ^= 0xe6fe_3beb;
    n ^= n >> 16;
    n = n.wrapping_mul(0x7feb_352d);
    n ^= n >> 15;
    n = n.wrapping_mul(0x846c_a68b);
    n ^ (n >> 16)
}

/// Nested uniform scrambling of bit-reversed `n`, bits restored [Burley20].
#[inline]
fn scramble(mut n: u32, seed: u32) -> u32 {
    n ^= n.wrapping_mul(0x3d20_adea);
    n = n.wrapping_add(seed);
    n = n.wrapping_mul((seed >> 16) | 1);
    n ^= n.wrapping_mul(0x0552_6c56);
    n ^= n.wrapping_mul(0x53a2_2864);
    n.reverse_bits()
}

#[inline]
fn fraction(n: u32) -> f32 {
    (n >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// For each byte of the index and its value: the XOR of the direction numbers of four
/// dimensions, bits reversed.
static TABLE: [[[u32; 4]; 256]; 4] = table();

const fn table() -> [[[u32; 4]; 256]; 4] {
    // Degree, inner coefficients and first numbers of dimensions 2..4 [Joe08].
    const DEGREE: [usize; 3] = [1, 2, 3];
    const INNER: [u32; 3] = [0, 1, 1];
    const FIRST: [[u32; 3]; 3] = [[1, 0, 0], [1, 3, 0], [1, 3, 1]];
    let mut vectors = [[0_u32; 4]; 32];
    let mut k = 0;
    while k < 32 {
        vectors[k][0] = 1 << (31 - k);
        k += 1;
    }
    let mut d = 0;
    while d < 3 {
        let s = DEGREE[d];
        let mut k = 0;
        while k < 32 {
            vectors[k][d + 1] = if k < s {
                FIRST[d][k] << (31 - k)
            } else {
                let old = vectors[k - s][d + 1];
                let mut v = old ^ (old >> s);
                let mut i = 1;
                while i < s {
                    if (INNER[d] >> (s - 1 - i)) & 1 == 1 {
                        v ^= vectors[k - i][d + 1];
                    }
                    i += 1;
                }
                v
            };
            k += 1;
        }
        d += 1;
    }
    let mut out = [[[0_u32; 4]; 256]; 4];
    let mut byte = 0;
    while byte < 4 {
        let mut value = 0;
        while value < 256 {
            let mut bit = 0;
            while bit < 8 {
                if (value >> bit) & 1 == 1 {
                    let mut d = 0;
                    while d < 4 {
                        out[byte][value][d] ^= vectors[8 * byte + bit][d].reverse_bits();
                        d += 1;
                    }
                }
                bit += 1;
            }
            value += 1;
        }
        byte += 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_numbers_are_those_of_sobol_burley() {
        // Unscrambled points of both, first 2^16 (all that the crate has).
        for index in (0..65_536_u32).step_by(37) {
            let b = index.to_le_bytes();
            for d in 0..4 {
                let ours = TABLE[0][b[0] as usize][d] ^ TABLE[1][b[1] as usize][d];
                let theirs = sobol_burley::parts::sobol_rev(index.reverse_bits(), d as u32);
                // The crate stores 16 bits of each direction number.
                assert_eq!(
                    ours & 0xffff,
                    theirs & 0xffff,
                    "point {index} dimension {d}"
                );
            }
        }
    }

    #[test]
    fn any_aligned_run_fills_every_elementary_interval() {
        // Dimensions 0 and 1 are a (0, 2)-sequence: of 2^m aligned points each box of area 2^-m
        // holds exactly one; scrambling keeps that.
        let s = Sequence::new(7, 42);
        let m = 8;
        for start in [0_u32, 256, 1 << 20, 3_000_000 << 8] {
            for k in 0..=m {
                let mut seen = vec![0; 1 << m];
                for i in start..start + (1 << m) {
                    let [a, b, _, _] = s.bits4(i);
                    let x = (a as u64 >> (32 - k)) as usize;
                    let y = (b as u64 >> (32 - (m - k))) as usize;
                    seen[(y << k) | x] += 1;
                }
                assert!(seen.iter().all(|&n| n == 1), "run at {start}, boxes 2^{k}");
            }
        }
        // And each single dimension of the four.
        for d in 0..4 {
            let mut seen = [0; 256];
            for i in 512..768 {
                seen[(s.bits4(i)[d] >> 24) as usize] += 1;
            }
            assert!(seen.iter().all(|&n| n == 1));
        }
    }

    #[test]
    fn the_fifth_coordinate_is_stratified_and_independent() {
        for stream in 0..16 {
            let s = Sequence::new(3, stream);
            for k in 0..=8 {
                let n = 1 << k;
                let mut seen = vec![0; n];
                (n..2 * n).for_each(|i| seen[(s.fifth(i as u32) * n as f64) as usize] += 1);
                assert!(seen.iter().all(|&c| c == 1), "2^{k} points");
            }
            // Where the fifth lies in one sixteenth, the others still fill their range.
            for d in 0..4 {
                let mut cells = [0; 8];
                for i in (0..4096).filter(|&i| s.fifth(i) < 1.0 / 16.0) {
                    cells[(s.point4(i)[d] * 8.0) as usize] += 1;
                }
                let (low, high) = (cells.iter().min().unwrap(), cells.iter().max().unwrap());
                assert!(*low > 10 && *high < 60, "coordinate {d}: {cells:?}");
            }
        }
    }

    #[test]
    fn streams_are_independent() {
        // One point each of 40,000 streams: mean 1/2 and covariance 0 within 5 standard errors
        // (sqrt(1/12 n) and 1/12 sqrt n).
        let n = 40_000;
        let mut mean = [0.0_f64; 4];
        let mut cross = 0.0;
        for stream in 0..n {
            let p = Sequence::new(1, stream).point4(3);
            let q = Sequence::new(1, stream + 1).point4(3);
            for d in 0..4 {
                mean[d] += p[d] as f64;
            }
            cross += (p[0] as f64 - 0.5) * (q[0] as f64 - 0.5);
        }
        let n = n as f64;
        for d in 0..4 {
            assert!((mean[d] / n - 0.5).abs() < 5.0 * (1.0 / (12.0 * n)).sqrt());
        }
        assert!((cross / n).abs() < 5.0 / (12.0 * n.sqrt()));
    }

    #[test]
    fn cosine_directions_have_the_moments_of_the_cosine() {
        // Mean of cos theta is 2/3, of cos^2 theta 1/2, of the square of a tangent component
        // 1/4; 4096 stratified points reach 1e-3 easily.
        for normal in [
            Vec3::Z,
            -Vec3::Z,
            Vec3::new(0.6, -0.48, 0.64),
            Vec3::new(-0.8, 0.0, -0.6),
        ] {
            let s = Sequence::new(3, 9);
            let [a, b] = frame(normal);
            assert!(a.dot(b).abs() < 1e-6 && (a.cross(b) - normal).length() < 1e-6);
            let mut sums = [0.0_f64; 4];
            let n = 4096;
            for i in 0..n {
                let w = cosine_hemisphere(s.point2(i), normal);
                assert!((w.length() - 1.0).abs() < 1e-6 && w.dot(normal) >= 0.0);
                let c = w.dot(normal) as f64;
                let (x, y) = (w.dot(a) as f64, w.dot(b) as f64);
                for (sum, value) in sums.iter_mut().zip([c, c * c, x * x, x * y]) {
                    *sum += value / n as f64;
                }
            }
            for (got, want) in sums.iter().zip([2.0 / 3.0, 0.5, 0.25, 0.0]) {
                assert!((got - want).abs() < 1e-3, "{got} should be {want}");
            }
        }
    }

    #[test]
    fn disc_map_agrees_with_the_maths_library() {
        // The polynomial against f64 sine and cosine; 2 ulp of f32.
        for i in 0..=64 {
            for j in 0..=64 {
                let (u, v) = (i as f32 / 64.0, j as f32 / 64.0);
                let [x, y] = disc([u, v]);
                let (a, b) = (2.0 * u as f64 - 1.0, 2.0 * v as f64 - 1.0);
                let (r, phi) = if a == 0.0 && b == 0.0 {
                    (0.0, 0.0)
                } else if a.abs() > b.abs() {
                    (a, std::f64::consts::FRAC_PI_4 * b / a)
                } else {
                    (
                        b,
                        std::f64::consts::FRAC_PI_2 - std::f64::consts::FRAC_PI_4 * a / b,
                    )
                };
                assert!((x as f64 - r * phi.cos()).abs() < 3e-7);
                assert!((y as f64 - r * phi.sin()).abs() < 3e-7);
            }
        }
    }
}
