//! Hierarchical radiosity: links between clusters, as coarse as the light allows.
//!
//! A link stands for the kernel between all points of two nodes and holds its mean. It is
//! refined, into links to the children of the larger node, while its error times the power that
//! goes over it is above a threshold: the BF oracle. The error is the greatest distance of the
//! kernel, visibility included, from that mean. What no sample has found counts too: as one
//! sample more that goes against all the others. How links are refined, solved and tightened:
//! `link_solver.rs`.
//!
//! Sources: [Hanrahan91] (links, power times form factor, visibility by rays, push and pull),
//! [Smits94] and [Sillion95] (clusters of surfaces under one root).

use crate::link_solver::{Ends, Fitted, Method};
use luxel_transport::KernelSample;

/// Constant links, judged by the bounds of their kernel.
pub const METHOD: Method = Method {
    name: "hierarchical",
    fit,
    samples: 16,
    is_linear: false,
};

fn fit(_ends: &Ends<'_>, samples: &[KernelSample], unseen: f64) -> Fitted {
    let mean = mean(samples);
    let off = samples
        .iter()
        .map(|s| (s.kernel * s.visible - mean).abs())
        .fold(0.0, f64::max);
    Fitted {
        mean,
        slopes: [[0.0; 3]; 2],
        error: off.max(unseen),
    }
}

/// Weighted mean of the kernel with visibility, 1/m².
pub(crate) fn mean(samples: &[KernelSample]) -> f64 {
    let (mut sum, mut weight) = (0.0, 0.0);
    for s in samples {
        sum += s.weight * s.kernel * s.visible;
        weight += s.weight;
    }
    if weight > 0.0 { sum / weight } else { 0.0 }
}
