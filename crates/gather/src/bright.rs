//! Bright elements: those whose exitance stands so far out that gather rays, which find them by
//! chance, would bring it as noise. What they send above a cap is asked as from lights.
//!
//! The exitance of an element is split into what is below the cap, which every gather ray that
//! meets it brings, and the rest, which is taken by the lottery of a light tree with shadow rays.
//! Both together are unbiased for any cap. A ray down a room where a lamp almost touches the
//! ceiling, or a door stands ajar to the sun, then brings a bounded value.
//!
//! The cap is the one for which a receiver in the middle of everything would see least noise:
//! the standard deviation of what a ray brings, plus the noise of the lottery, which is
//! [`LOTTERY`] of the mean of the rest.
//!
//! Source: virtual area lights with bounded contributions, after [Keller97] and [Walter05]; the
//! split is ours.

use crate::emitter::Emitter;
use crate::lights::{Light, LightKind};
use crate::tree::LightTree;
use luxel_core::{Alpha, ElementId, Front, Rgb, Scene, Solution};

/// Standard deviation of one draw of the lottery as a share of its mean.
const LOTTERY: f64 = 2.0;
/// The noise must fall at least to this share of what it is without bright elements: draws cost
/// more than rays, and what is hidden costs draws too.
const WORTH: f64 = 0.25;
/// Caps that are tried.
const CAPS: usize = 96;

/// The bright elements of a solution.
pub(crate) struct Bright {
    /// What a gather ray brings of each element, as a share; empty when no element is bright.
    pub kept: Vec<f32>,
    /// A polygon of a bright element each; the tint is the photometric rest, grey.
    pub lights: Vec<Light>,
    /// Element of each light.
    pub element: Vec<ElementId>,
    pub tree: LightTree,
}

impl Bright {
    /// Finds the bright elements. Near linear in the elements.
    pub fn new(scene: &Scene, front: &Front, solution: &Solution) -> Bright {
        let mut bright = Bright {
            kept: Vec::new(),
            lights: Vec::new(),
            element: Vec::new(),
            tree: LightTree::default(),
        };
        if solution.is_empty() {
            return bright;
        }
        let exitance: Vec<f32> = (0..front.len())
            .map(|e| solution.total(e).luminance().max(0.0))
            .collect();
        let Some(cap) = best_cap(&exitance, &front.area) else {
            return bright;
        };
        bright.kept = vec![1.0; front.len()];
        for (e, &b) in exitance.iter().enumerate().filter(|(_, b)| **b > cap) {
            // A picture with holes sends from a part of its polygon only.
            let surface = &scene.surfaces[front.surface(ElementId::from(e)).index()];
            if scene.finishes[surface.finish.index()].alpha != Alpha::Opaque {
                continue;
            }
            let mut all = true;
            for polygon in front.polygons(scene, ElementId::from(e)) {
                match Emitter::new(polygon) {
                    Some(emitter) => {
                        bright.element.push(ElementId::from(e));
                        bright.lights.push(Light {
                            tint: Rgb::splat(b - cap),
                            group: 0,
                            kind: LightKind::Polygon(emitter),
                        });
                    }
                    None => all = false,
                }
            }
            if all {
                bright.kept[e] = cap / b;
            } else {
                // Slivers without area in f64: the whole element stays with the rays.
                while bright.element.last() == Some(&ElementId::from(e)) {
                    bright.element.pop();
                    bright.lights.pop();
                }
            }
        }
        bright.tree = LightTree::new(&bright.lights);
        bright
    }

    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }

    /// Share of the exitance of a light's element that the lottery brings.
    pub fn rest(&self, light: u32) -> f64 {
        1.0 - self.kept[self.element[light as usize].index()] as f64
    }
}

/// The cap with the least noise, or `None` when it is hardly less than without one.
fn best_cap(exitance: &[f32], area: &[f32]) -> Option<f32> {
    let mut order: Vec<(f32, f32)> = exitance.iter().copied().zip(area.iter().copied()).collect();
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let whole: f64 = order.iter().map(|o| o.1 as f64).sum();
    let highest = order.last()?.0;
    if whole <= 0.0 || highest <= 0.0 {
        return None;
    }
    // Sums of area, flux and square over the elements from the darkest on.
    let mut sums = Vec::with_capacity(order.len() + 1);
    let mut sum = [0.0f64; 3];
    sums.push(sum);
    for &(b, a) in &order {
        let (b, a) = (b as f64, a as f64 / whole);
        sum = [sum[0] + a, sum[1] + a * b, sum[2] + a * b * b];
        sums.push(sum);
    }
    let noise = |cap: f64| {
        let k = order.partition_point(|o| (o.0 as f64) <= cap);
        let [a, flux, square] = sums[k];
        let above = 1.0 - a;
        let mean = flux + above * cap;
        let variance = square + above * cap * cap - mean * mean;
        variance.max(0.0).sqrt() + LOTTERY * (sum[1] - mean).max(0.0)
    };
    let without = noise(highest as f64);
    // Between the mean over 16 and the highest, in equal ratios.
    let lowest = sum[1] / 16.0;
    let ratio = (highest as f64 / lowest).max(1.0).powf(1.0 / CAPS as f64);
    let (mut cap, mut best) = (lowest, (highest as f64, without));
    for _ in 0..CAPS {
        let n = noise(cap);
        if n < best.1 {
            best = (cap, n);
        }
        cap *= ratio;
    }
    (best.1 < WORTH * without).then_some(best.0 as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_hot_spot_is_capped_and_even_light_is_not() {
        // 1 % of the area with a hundred times the exitance: half of all flux.
        let mut exitance: Vec<f32> = (0..1000)
            .map(|k| 0.8 + 0.4 * (k % 7) as f32 / 6.0)
            .collect();
        let area = vec![0.1; 1000];
        assert_eq!(best_cap(&exitance, &area), None);
        exitance[..10].fill(100.0);
        let cap = best_cap(&exitance, &area).expect("a hot spot");
        assert!((0.8..3.0).contains(&cap), "{cap}");
        assert_eq!(best_cap(&[0.0; 4], &[1.0; 4]), None);
        assert_eq!(best_cap(&[], &[]), None);
    }
}
