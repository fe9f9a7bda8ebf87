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
const BATCH: usize = 1024;

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
        FrontLines {
            scene,
            front,
            caster,
        }
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

    fn cast_each(&self, runs: &[(ElementId, Range<u32>)], seed: u32, arrivals: &mut Vec<Arrival>) {
        arrivals.clear();
        let count = runs.iter().map(|(_, samples)| samples.len()).sum();
        arrivals.reserve(count);
        let offset_m = self.caster.offset_m();
        let mut lines = runs.iter().flat_map(|(element, samples)| {
            let sequence = Sequence::new(seed, element.0);
            samples
                .clone()
                .map(move |k| self.ray(*element, &sequence, k, offset_m))
        });
        let size = count.min(BATCH);
        let mut rays = Vec::with_capacity(size);
        let mut hits = vec![Hit::MISS; size];
        while arrivals.len() < count {
            rays.clear();
            rays.extend(lines.by_ref().take(BATCH));
            let hits = &mut hits[..rays.len()];
            self.caster.closest(&rays, hits);
            let pairs = rays.iter().zip(hits.iter());
            arrivals.extend(pairs.map(|(ray, hit)| self.arrival(ray, hit)));
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
        let mut lines = FactorLines {
            offsets: vec![0],
            targets: Vec::new(),
            cumulative: Vec::new(),
        };
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

    fn cast_each(&self, runs: &[(ElementId, Range<u32>)], seed: u32, arrivals: &mut Vec<Arrival>) {
        arrivals.clear();
        for (element, samples) in runs {
            let run = self.offsets[element.index()]..self.offsets[element.index() + 1];
            let (targets, cumulative) = (&self.targets[run.clone()], &self.cumulative[run]);
            let sequence = Sequence::new(seed, element.0);
            arrivals.extend(samples.clone().map(|k| {
                let u = sequence.point1(k);
                let at = cumulative.partition_point(|&c| c <= u);
                targets.get(at).copied().unwrap_or(Arrival::BLACK)
            }));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Constant;
    use crate::testing::{BruteForce, cube, parallelograms};
    use luxel_core::Vec3;

    #[test]
    fn lines_of_a_cube_arrive_on_other_walls_in_the_right_shares() {
        // Opposite 0.19982, beside 0.20004 [Howell10] C-11, C-14; 4096 stratified lines with an
        // rms error of 3e-3 over seeds, four times that.
        let (scene, front) = cube(2);
        let caster = BruteForce::new(&scene);
        let lines = FrontLines::new(&scene, &front, &caster);
        let mut arrivals = Vec::new();
        let mut walls = [0.0; 6];
        for e in 0..4 {
            lines.cast(ElementId(e), 0..1024, 9, &mut arrivals);
            assert_eq!(arrivals.len(), 1024);
            for a in &arrivals {
                walls[a.element().expect("the cube is closed").index() / 4] += 1.0 / 4096.0;
            }
        }
        assert_eq!(walls[0], 0.0, "the floor does not see itself");
        assert!(
            walls[1..].iter().all(|w: &f64| (w - 0.2).abs() < 0.012),
            "{walls:?}"
        );
    }

    #[test]
    fn runs_of_samples_join_to_the_whole() {
        // The same lines in one call, in two, and past the size of a batch.
        let (scene, front) = cube(1);
        let caster = BruteForce::new(&scene);
        let lines = FrontLines::new(&scene, &front, &caster);
        let (mut whole, mut part, mut joined) = (Vec::new(), Vec::new(), Vec::new());
        lines.cast(ElementId(3), 100..2900, 1, &mut whole);
        for run in [100..700, 700..2900] {
            lines.cast(ElementId(3), run, 1, &mut part);
            joined.append(&mut part);
        }
        assert_eq!(whole, joined);
        let runs = [100..101, 101..101, 101..2400, 2400..2900].map(|run| (ElementId(3), run));
        lines.cast_each(&runs, 1, &mut part);
        assert_eq!(whole, part);
    }

    #[test]
    fn outside_and_black_are_told_apart() {
        // A roof that faces up over half of the sky: black; the rest leaves.
        let roof = [
            [Vec3::ZERO, Vec3::X, Vec3::Y],
            [
                Vec3::new(-50.0, -50.0, 1.0),
                Vec3::X * 50.5,
                Vec3::Y * 101.0,
            ],
        ];
        let (scene, front) = parallelograms(&roof, 1);
        let caster = BruteForce::new(&scene);
        let mut arrivals = Vec::new();
        FrontLines::new(&scene, &front, &caster).cast(ElementId(0), 0..1024, 1, &mut arrivals);
        let count = |what| arrivals.iter().filter(|a| **a == what).count();
        let (outside, black) = (count(Arrival::OUTSIDE), count(Arrival::BLACK));
        assert_eq!(outside + black, 1024);
        // Half by symmetry about x = 1/2; stratified: a few lines of 1024.
        assert!((black as i32 - 512).abs() < 30, "{black}");
    }

    #[test]
    fn lines_of_factors_keep_what_rows_lack() {
        // Rows of 0.5 and 0.25 outside: a quarter is black. 1024 stratified numbers: one off.
        struct Rows;
        impl FormFactors for Rows {
            fn len(&self) -> usize {
                2
            }
            fn row(&self, _element: ElementId, row: &mut FactorRow) {
                *row = FactorRow {
                    entries: vec![(ElementId(1), 0.5)],
                    outside: 0.25,
                };
            }
        }
        let lines = FactorLines::new(&Rows);
        let mut arrivals = Vec::new();
        lines.cast(ElementId(0), 0..1024, 4, &mut arrivals);
        for (what, want) in [
            (Arrival::on(ElementId(1)), 512),
            (Arrival::OUTSIDE, 256),
            (Arrival::BLACK, 256),
        ] {
            let count = arrivals.iter().filter(|a| **a == what).count() as i32;
            assert!((count - want).abs() <= 1, "{what:?}: {count}");
        }
        // Complete rows never fall through the crack of rounding.
        let sphere = Constant::new(vec![0.1; 7]);
        let lines = FactorLines::new(&sphere);
        lines.cast(ElementId(0), 0..4096, 4, &mut arrivals);
        assert!(arrivals.iter().all(|a| a.element().is_some()));
    }
}
