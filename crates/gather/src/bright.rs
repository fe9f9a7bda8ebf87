//! Bright elements: those whose exitance stands so far out that gather rays, which find them by
//! chance, would bring it as noise. What they send above a cap is asked as from lights.
//!
//! The exitance of an element is split into what is below the cap, which every gather ray that
//! meets it brings, and the rest, which is taken by the lottery of a light tree with shadow rays.
//! Both together are unbiased for any cap. A ray down a room where a lamp almost touches the
//! ceiling, or a door stands ajar to the sun, then brings a bounded value.
//!
//! The cap is the one with the least noise for gather rays from elements all over the scene: the
//! standard deviation of what a ray brings, plus the noise of the lottery, which is [`LOTTERY`]
//! of the mean of the rest.
//!
//! Source: virtual area lights with bounded contributions, after [Keller97] and [Walter05]; the
//! split is ours.

use crate::emitter::Emitter;
use crate::lights::{Light, LightKind};
use crate::tree::LightTree;
use luxel_core::{Alpha, ElementId, Front, Rgb, Scene, Solution};
use luxel_transport::{FrontLines, LocalLines, RayCaster};
use rayon::prelude::*;

/// Standard deviation of one draw of the lottery as a share of its mean.
const LOTTERY: f64 = 2.0;
/// The noise must fall at least to this share of what it is without bright elements: draws cost
/// more than rays, and what is hidden costs draws too.
const WORTH: f64 = 0.25;
/// Caps that are tried.
const CAPS: usize = 96;
/// Elements from which trial rays go, and rays from each.
const ELEMENTS: usize = 4096;
const RAYS: u32 = 16;

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
    /// Finds the bright elements. Near linear in the elements; 65,536 rays at most.
    pub fn new(
        scene: &Scene,
        front: &Front,
        caster: &dyn RayCaster,
        solution: &Solution,
    ) -> Bright {
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
        let Some(cap) = best_cap(brought(scene, front, caster, &exitance)) else {
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

/// What trial rays bring: exitance of the elements that they meet, 0 where they meet none.
fn brought(scene: &Scene, front: &Front, caster: &dyn RayCaster, exitance: &[f32]) -> Vec<f32> {
    let stride = front.len().div_ceil(ELEMENTS).max(1);
    let lines = FrontLines::new(scene, front, caster);
    let chosen: Vec<usize> = (0..front.len()).step_by(stride).collect();
    chosen
        .par_iter()
        .flat_map_iter(|&e| {
            let mut arrivals = Vec::new();
            lines.cast(ElementId::from(e), 0..RAYS, 0x2545_f491, &mut arrivals);
            arrivals
                .into_iter()
                .map(|a| a.element().map_or(0.0, |e| exitance[e.index()]))
        })
        .collect()
}

/// The cap with the least noise for these values, or `None` when that is hardly less than without.
fn best_cap(mut values: Vec<f32>) -> Option<f32> {
    values.sort_unstable_by(f32::total_cmp);
    let highest = *values.last()?;
    if highest <= 0.0 {
        return None;
    }
    // Sums of count, value and square from the darkest on.
    let mut sums = Vec::with_capacity(values.len() + 1);
    let mut sum = [0.0f64; 3];
    sums.push(sum);
    let each = 1.0 / values.len() as f64;
    for b in values.iter().map(|&b| b as f64) {
        sum = [sum[0] + each, sum[1] + each * b, sum[2] + each * b * b];
        sums.push(sum);
    }
    let noise = |cap: f64| {
        let k = values.partition_point(|&b| b as f64 <= cap);
        let [below, flux, square] = sums[k];
        let above = 1.0 - below;
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
        // One ray in a hundred brings a hundred times as much: half of all light.
        let mut values: Vec<f32> = (0..1000)
            .map(|k| 0.8 + 0.4 * (k % 7) as f32 / 6.0)
            .collect();
        assert_eq!(best_cap(values.clone()), None);
        values[..10].fill(100.0);
        let cap = best_cap(values).expect("a hot spot");
        assert!((0.8..3.0).contains(&cap), "{cap}");
        assert_eq!(best_cap(vec![0.0; 4]), None);
        assert_eq!(best_cap(Vec::new()), None);
    }
}
