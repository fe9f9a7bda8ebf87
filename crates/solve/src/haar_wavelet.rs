//! Wavelet radiosity with Haar wavelets: constant links, judged by what refining would change.
//!
//! In the non-standard form a link between two nodes holds the kernel's coefficient for their
//! constant functions, and its refinement adds the Haar wavelets: the differences between the
//! means over the pairs of children and the mean over all. So the same links as in
//! `hierarchical.rs`, and the same limit, but an oracle that measures those coefficients
//! instead of bounding the kernel. What varies within children and cancels in their means is
//! not refined for: fewer links at a threshold.
//!
//! Source: [Gortler93], sections 4 and 6.

use crate::hierarchical::mean;
use crate::link_solver::{Ends, Fitted, Method};
use luxel_transport::KernelSample;

/// Constant links, judged by their Haar wavelets.
pub const METHOD: Method = Method {
    name: "haar-wavelet",
    fit,
    samples: 16,
    is_linear: false,
};

fn fit(ends: &Ends<'_>, samples: &[KernelSample], unseen: f64) -> Fitted {
    let mean = mean(samples);
    let children = ends.children.map(|c| c.len().max(1));
    let mut sums = vec![(0.0, 0.0); children[0] * children[1]];
    for s in samples {
        let sum = &mut sums[ends.child(0, s) * children[1] + ends.child(1, s)];
        sum.0 += s.weight * s.kernel * s.visible;
        sum.1 += s.weight;
    }
    let detail = sums
        .iter()
        .filter(|(_, weight)| *weight > 0.0)
        .map(|(sum, weight)| (sum / weight - mean).abs())
        .fold(0.0, f64::max);
    Fitted {
        mean,
        slopes: [[0.0; 3]; 2],
        error: detail.max(unseen),
    }
}
