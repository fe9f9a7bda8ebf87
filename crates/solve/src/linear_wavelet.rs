//! Wavelet radiosity with linear functions: links that carry light linear in place.
//!
//! The functions of a node are constant and linear in place, so wavelets of two vanishing
//! moments are what a link leaves out: nothing where the kernel is linear between its ends.
//! K(x, y) = k + s (x - x_0) + t (y - y_0) is fitted to the samples by least squares about the
//! centres of both nodes, and the oracle takes the greatest residual. A receiver gets
//! (k + s (x - x_0)) M + t M_1 with the flux M of the sender and its first moment M_1 about the
//! centre; a linear function stays linear when it is pushed to a child. Elements stay
//! constant, so the limit is that of the other solvers. Products x y are left out: they are as
//! small as the squares, which are missing too.
//!
//! Source: [Gortler93], sections 4 to 6. Differs: moments about centres of clusters instead of
//! multiwavelets on squares, so that any tree will do; elements are constant.

use crate::link_solver::{Ends, Fitted, Method};
use luxel_transport::KernelSample;

/// Linear links, judged by their residual.
pub const METHOD: Method = Method {
    name: "linear-wavelet",
    fit,
    samples: 32,
    is_linear: true,
};

/// Unknowns: the constant, and three slopes at either end.
const TERMS: usize = 7;

/// Added to the diagonal in relation to it: flat nodes have no extent along their normal.
const RIDGE: f64 = 1e-9;

fn fit(ends: &Ends<'_>, samples: &[KernelSample], unseen: f64) -> Fitted {
    let sizes = ends.sizes.map(|s| if s > 0.0 { 1.0 / s } else { 0.0 });
    let place = |s: &KernelSample| -> [f64; TERMS] {
        let [x, y] = [0, 1].map(|end| (s.points[end] - ends.centres[end]) * sizes[end]);
        [1.0, x.x, x.y, x.z, y.x, y.y, y.z]
    };
    let mut normal = [[0.0; TERMS]; TERMS];
    let mut right = [0.0; TERMS];
    for s in samples {
        let at = place(s);
        let value = s.kernel * s.visible;
        for a in 0..TERMS {
            right[a] += s.weight * at[a] * value;
            for b in 0..TERMS {
                normal[a][b] += s.weight * at[a] * at[b];
            }
        }
    }
    let whole = normal[0][0];
    for (a, row) in normal.iter_mut().enumerate().skip(1) {
        row[a] += RIDGE * whole;
    }
    let found = solve(normal, right);
    let error = samples
        .iter()
        .map(|s| {
            let linear: f64 = place(s).iter().zip(&found).map(|(a, b)| a * b).sum();
            (s.kernel * s.visible - linear).abs()
        })
        .fold(0.0, f64::max);
    Fitted {
        mean: found[0],
        slopes: [
            [1, 2, 3].map(|k| found[k] * sizes[0]),
            [4, 5, 6].map(|k| found[k] * sizes[1]),
        ],
        error: error.max(unseen),
    }
}

/// Gauss elimination of a positive matrix; an unknown that nothing determines is 0.
fn solve(mut m: [[f64; TERMS]; TERMS], mut right: [f64; TERMS]) -> [f64; TERMS] {
    for k in 0..TERMS {
        if m[k][k] <= 0.0 {
            continue;
        }
        let (pivot, value) = (m[k], right[k]);
        for a in k + 1..TERMS {
            let f = m[a][k] / pivot[k];
            for b in k..TERMS {
                m[a][b] -= f * pivot[b];
            }
            right[a] -= f * value;
        }
    }
    let mut found = [0.0; TERMS];
    for k in (0..TERMS).rev() {
        if m[k][k] > 0.0 {
            let known: f64 = (k + 1..TERMS).map(|b| m[k][b] * found[b]).sum();
            found[k] = (right[k] - known) / m[k][k];
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_core::DVec3;

    #[test]
    fn a_linear_kernel_is_found_without_residual() {
        // K = 2 + 3 x_1 - y_2 between two flat nodes: rounding and the ridge of 1e-9.
        let samples: Vec<KernelSample> = (0..32)
            .map(|k| {
                let v = |a: u32| ((k * a) % 32) as f64 / 31.0;
                let (x, y) = (DVec3::new(v(5), v(7), 0.0), DVec3::new(v(11), v(13), 4.0));
                KernelSample {
                    at: [0, 1],
                    points: [x, y],
                    kernel: 2.0 + 3.0 * x.x - y.y,
                    visible: 1.0,
                    weight: 1.0,
                }
            })
            .collect();
        let ends = Ends {
            centres: [DVec3::new(0.5, 0.5, 0.0), DVec3::new(0.5, 0.5, 4.0)],
            sizes: [1.0, 1.0],
            children: [&[], &[]],
        };
        let fitted = fit(&ends, &samples, 0.0);
        assert!((fitted.mean - 3.0).abs() < 1e-6, "{}", fitted.mean);
        assert!((fitted.slopes[0][0] - 3.0).abs() < 1e-6);
        assert!((fitted.slopes[1][1] + 1.0).abs() < 1e-6);
        assert!(fitted.error < 1e-6, "{}", fitted.error);
    }
}
