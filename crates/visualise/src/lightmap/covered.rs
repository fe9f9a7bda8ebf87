//! Texels under small things: the leg of a chair on a rug, a cup on a table.
//!
//! Things smaller than an element do not cut the surface that they stand on, so the lattice point of
//! a texel may lie under one, where it is dark, while all that is seen of the texel is beside it. A
//! texel that is much darker than some neighbours and sees none of these along the surface takes
//! their light. Ring by ring, so that larger feet are filled from their borders.

use super::lattice::Kind;
use super::{Chart, Charts, Lightmap};
use luxel_core::Rgb;
use luxel_transport::{Ray, RayCaster};
use rayon::prelude::*;

/// A covered texel has less than this share of a neighbour's light.
const DARKER: f32 = 0.1;
/// Sight between neighbours is tested so high above the surface, texels.
const HEIGHT: f32 = 0.1;
/// Rings that are filled.
const RINGS: usize = 4;

impl Lightmap {
    /// Gives covered texels the light of what is seen beside them. The same for any thread count.
    pub fn uncover(&mut self, charts: &Charts, caster: &dyn RayCaster) {
        let list: Vec<(usize, Rgb, f32)> = charts
            .charts
            .par_iter()
            .filter(|c| charts.sheets[c.sheet as usize].flat && c.count() > 4)
            .flat_map_iter(|chart| self.uncovered(charts, chart, caster))
            .collect();
        for (texel, value, error) in list {
            (self.values[texel], self.errors[texel]) = (value, error);
        }
    }

    /// Covered texels of a chart with the light that they take.
    fn uncovered(
        &self,
        charts: &Charts,
        chart: &Chart,
        caster: &dyn RayCaster,
    ) -> Vec<(usize, Rgb, f32)> {
        let [w, h] = chart.size;
        let run = chart.start..chart.start + chart.count();
        let mut light: Vec<(Rgb, f32)> = (self.values[run.clone()].iter().copied())
            .zip(self.errors[run].iter().copied())
            .collect();
        let step = charts.sheets[chart.sheet as usize].step;
        let lift = HEIGHT * step[0].min(step[1]);
        let lux = |light: &[(Rgb, f32)], t: u32| light[t as usize].0.luminance();
        let used = |t: u32| charts.kind[chart.start + t as usize] != Kind::Unused;
        let around = |t: u32| {
            let (x, y) = (t % w, t / w);
            (y.saturating_sub(1)..=(y + 1).min(h - 1))
                .flat_map(move |j| {
                    (x.saturating_sub(1)..=(x + 1).min(w - 1)).map(move |i| j * w + i)
                })
                .filter(move |&n| n != t && used(n))
        };
        let mut taken = Vec::new();
        let mut todo: Vec<u32> = (0..w * h).filter(|&t| used(t)).collect();
        for _ in 0..RINGS {
            let mut found = Vec::new();
            for &t in &todo {
                let brighter: Vec<u32> = around(t)
                    .filter(|&n| lux(&light, t) < DARKER * lux(&light, n))
                    .collect();
                if brighter.is_empty() {
                    continue;
                }
                let place = |t: u32| {
                    let r = &charts.receivers[chart.start + t as usize];
                    r.position + r.normal * lift.max(caster.offset_m())
                };
                let sights: Vec<Ray> = (brighter.iter())
                    .map(|&n| Ray {
                        origin: place(t),
                        t_min: 0.0,
                        direction: place(n) - place(t),
                        t_max: 1.0,
                    })
                    .collect();
                let mut visible = vec![0.0; sights.len()];
                caster.visibility(&sights, &mut visible);
                if visible.iter().all(|&v| v < 0.5) {
                    let share = 1.0 / brighter.len() as f32;
                    let mean = brighter.iter().fold((Rgb::BLACK, 0.0), |(v, e), &n| {
                        let (value, error) = light[n as usize];
                        (v + value * share, e + error * share)
                    });
                    found.push((t, mean));
                }
            }
            if found.is_empty() {
                break;
            }
            todo = found.iter().flat_map(|&(t, _)| around(t)).collect();
            todo.sort_unstable();
            todo.dedup();
            for (t, mean) in found {
                light[t as usize] = mean;
                taken.push((chart.start + t as usize, mean.0, mean.1));
            }
        }
        taken
    }
}
