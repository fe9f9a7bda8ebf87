//! Triangles that lie absurdly far from all others, and coordinates too coarse for f32.
//!
//! Coordinates are f32 and rays start eight units in the last place of the largest one above a
//! surface. So one forgotten triangle a thousand kilometres away would lift every ray by a metre.
//! What is dark, beyond a gap of a thousand times the size of the rest, and as small in the sky of
//! the rest as the moon, cannot matter to its light: it is left out.

use super::Fate;
use luxel_core::{Scene, Vec3, Warnings};

/// The gap, in relation to the radius of the rest.
const GAP: f32 = 1000.0;
/// Most solid angle that strays may fill together, steradians; the moon fills 6e-5.
const SOLID_ANGLE: f32 = 1e-3;
/// Resolution above which it is said, metres.
const COARSE_M: f32 = 1e-3;

/// Marks strays among the kept triangles.
pub(super) fn drop_strays(scene: &Scene, dropped: &mut [Fate]) {
    let kept: Vec<usize> = (0..dropped.len())
        .filter(|&t| dropped[t] == Fate::Kept)
        .collect();
    let Some(centre) = middle(scene, &kept) else {
        return;
    };
    // Nearest and farthest place of each triangle from there; the nearest of its bounds.
    let mut spans: Vec<(f32, f32, usize)> = kept
        .iter()
        .map(|&t| {
            let [a, b, c] = scene.corners(t).map(|p| p - centre);
            let nearest = Vec3::ZERO.clamp(a.min(b).min(c), a.max(b).max(c)).length();
            let farthest = a.length().max(b.length()).max(c.length());
            (nearest, farthest, t)
        })
        .collect();
    spans.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
    let mut radius = 0.0f32;
    let first = spans.iter().position(|&(nearest, farthest, _)| {
        let beyond = radius > 0.0 && nearest > GAP * radius;
        radius = radius.max(farthest);
        beyond
    });
    let Some(first) = first.filter(|&k| 2 * k > spans.len()) else {
        return;
    };
    let dark = |t: usize| scene.finish_of(t).emission.is_none();
    let strays: Vec<_> = spans[first..].iter().filter(|s| dark(s.2)).collect();
    let filled = strays.iter().map(|s| scene.area(s.2) / (s.0 * s.0));
    if filled.sum::<f32>() < SOLID_ANGLE {
        for &&(_, _, t) in &strays {
            dropped[t] = Fate::Stray;
        }
    }
}

/// Median of the triangles' first corners along each axis.
fn middle(scene: &Scene, kept: &[usize]) -> Option<Vec3> {
    if kept.is_empty() {
        return None;
    }
    let median = |axis: usize| {
        let mut all: Vec<f32> = kept.iter().map(|&t| scene.corners(t)[0][axis]).collect();
        let half = all.len() / 2;
        *all.select_nth_unstable_by(half, f32::total_cmp).1
    };
    Some(Vec3::from_array([0, 1, 2].map(median)))
}

/// Warns when coordinates are so large that f32 cannot tell a millimetre.
pub(super) fn warn_if_coarse(scene: &Scene, file: &str, warnings: &mut Warnings) {
    let largest = scene.largest_coordinate();
    let resolution = 8.0 * f32::EPSILON * largest;
    if resolution > COARSE_M {
        let what = format!(
            "coordinates reach {largest:.3e} m, where single precision resolves {resolution:.1e} m: \
             move the scene to the origin, or leave out what is far away; is --scale right?"
        );
        warnings.add(file, what, 1);
    }
}
