//! Local lines: cosine-distributed rays from uniform points of an element, and the same from
//! known form factors.
//!
//! The share of lines from i that arrive on j tends to F_ij. With four low-discrepancy numbers a
//! line (two for the point, two for the direction) the error falls faster than N^-1/2.
//!
//! Source: [Bekaert99], section 4.3.

use crate::contract::{Arrival, FactorRow, FormFactors, Hit, LocalLines, Ray, RayCaster};
use crate::sampling::{Sequence, cosine_hemisphere};
use luxel_core::{ElementId, Front, Scene};
use rayon::prelude::*;
use std::ops::Range;

/// Rays handed to the caster at once: enough for it to sort and pack, little enough for cache.
const BATCH: u32 = 1024;

/// Lines through a real scene, found by a ray caster.
pub struct FrontLines<'a> {
    scene: &'a Scene,
    front: &'a Front,
    caster: &'a dyn RayCaster,
}

impl<'a> FrontLines<'a> {
    /// Lines between the elements of `front` through the triangles that `caster` holds.
    ///
    /// Precondition: all three belong to the same scene.
    pub fn new(scene: &'a Scene, front: &'a Front, caster: &'a dyn RayCaster) -> Self {
        debug_assert_eq!(front.patch_of.len(), scene.triangles.len());
        FrontLines { scene, front, caster }
    }

    /// Ray `sample` of the sequence of an element.
    #[inline]
    fn ray(&self, element: ElementId, sequence: &Sequence, sample: u32, offset_m: f32) -> Ray {
        let [a, b, c, d] = sequence.point4(sample);
        let (point, normal) = self.front.point_on(self.scene, element, [a, b]);
        Ray {
            origin: point + normal * offset_m,
            t_min: 0.0,
            direction: cosine_hemisphere([c, d], normal),
            t_max: f32::INFINITY,
        }
    }

    /// What a hit of `ray` means.
    #[inline]
    fn arrival(&self, ray: &Ray, hit: &Hit) -> Arrival {
        if !hit.is_hit() {
            return Arrival::OUTSIDE;
        }
        let point = ray.origin + ray.direction * hit.t;
        self.front
            .element_at(hit.triangle as usize, hit.side, point)
            .map_or(Arrival::BLACK, Arrival::on)
    }
}

impl LocalLines for FrontLines<'_> {
    fn len(&self) -> usize {
        self.front.len()
    }

    fn cast(&self, element: ElementId, samples: Range<u32>, seed: u32, arrivals: &mut Vec<Arrival>) {
        arrivals.clear();
        let count = samples.len();
        arrivals.reserve(count);
        let sequence = Sequence::new(seed, element.0);
        let offset_m = self.caster.offset_m();
        let size = count.min(BATCH as usize);
        let mut rays = Vec::with_capacity(size);
        let mut hits = vec![Hit::MISS; size];
        let mut from = samples.start;
        while from < samples.end {
            let to = samples.end.min(from.saturating_add(BATCH));
            rays.clear();
            rays.extend((from..to).map(|k| self.ray(element, &sequence, k, offset_m)));
            let hits = &mut hits[..rays.len()];
            self.caster.closest(&rays, hits);
            arrivals.extend(rays.iter().zip(hits.iter()).map(|(r, h)| self.arrival(r, h)));
            from = to;
        }
    }
}

/// Lines that arrive as known form factors say, so that a Monte Carlo solver and a matrix
/// solver can be compared on the very same system.
///
/// What a row lacks to 1 arrives on black; a row above 1 (an estimate's defect) is scaled to 1.
pub struct FactorLines {
    offsets: Vec<usize>,
    targets: Vec<Arrival>,
    cumulative: Vec<f64>,
}

impl FactorLines {
    /// Reads every row once. Memory: 12 bytes a factor.
    pub fn new(factors: &dyn FormFactors) -> Self {
        let rows: Vec<FactorRow> = (0..factors.len())
            .into_par_iter()
            .map(|i| {
                let mut row = FactorRow::default();
                factors.row(ElementId::from(i), &mut row);
                row
            })
            .collect();
        let mut lines =
            FactorLines { offsets: vec![0], targets: Vec::new(), cumulative: Vec::new() };
        for row in rows {
            let scale = 1.0 / row.closure().max(1.0);
            let entries = row.entries.iter().map(|&(e, f)| (Arrival::on(e), f));
            let mut sum = 0.0;
            for (target, factor) in entries.chain([(Arrival::OUTSIDE, row.outside)]) {
                if factor > 0.0 {
                    sum += factor * scale;
                    lines.targets.push(target);
                    lines.cumulative.push(sum);
                }
            }
            // A row complete but for rounding must not leave a crack to black.
            if 1.0 - sum < 1e-12
                && let Some(last) = lines.cumulative.last_mut()
                && sum > 0.0
            {
                *last = 1.0;
            }
            lines.offsets.push(lines.targets.len());
        }
        lines
    }
}

impl LocalLines for FactorLines {
    fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    fn cast(&self, element: ElementId, samples: Range<u32>, seed: u32, arrivals: &mut Vec<Arrival>) {
        arrivals.clear();
        let run = self.offsets[element.index()]..self.offsets[element.index() + 1];
        let (targets, cumulative) = (&self.targets[run.clone()], &self.cumulative[run]);
        let sequence = Sequence::new(seed, element.0);
        arrivals.extend(samples.map(|k| {
            let u = sequence.point1(k);
            let at = cumulative.partition_point(|&c| c <= u);
            targets.get(at).copied().unwrap_or(Arrival::BLACK)
        }));
    }
}
