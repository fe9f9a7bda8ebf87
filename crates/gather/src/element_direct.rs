//! Mean direct irradiance of every element: the first emission that a solver is given.
//!
//! Each element asks its strongest lights one by one, by points that are stratified over the
//! element and over the light at once: the mean of the exact unoccluded factor times the
//! weighted share of free shadow rays. All free gives the exact factor, none free exactly
//! zero. Every element takes the same number of points: asking more only where the first few
//! disagree keeps the lucky ones that did not, and was 3 % too bright in penumbrae. The many
//! weak lights are sampled together by importance (see `tree`).

use crate::lights::{DirectLights, Light, LightKind, View};
use crate::lottery::Lots;
use crate::tree::{FINE, Item, sort};
use luxel_core::{ElementId, Front, LuminaireKind, Scene, Vec3};
use luxel_transport::sampling::hash;
use luxel_transport::{Ray, RayCaster, Sequence};
use rayon::prelude::*;
use std::ops::Range;

/// How carefully elements look at the lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ElementDirect {
    /// Points of an element for each strong light (a power of two); more where it is near.
    pub samples: u32,
    /// Strongest lights that each element asks one by one.
    pub strong: usize,
    /// Shadow rays for all the other lights together; more where they are near.
    pub weak_samples: u32,
    /// Seed of every random number.
    pub seed: u32,
}

impl Default for ElementDirect {
    fn default() -> Self {
        ElementDirect {
            samples: 16,
            strong: 12,
            weak_samples: 8,
            seed: 0,
        }
    }
}

/// Elements whose rays travel in one batch.
const BATCH: usize = 32;

/// So few lights are all strong; of more, those that are guessed to give this share of the light.
const FEW: usize = 4;
const WEAK: f32 = 0.02;

/// Elements that reach less far than this share of their distance to a light are far from it.
const FAR: f32 = 0.25;
/// Nearer ones look from up to so many times as many points.
const MOST_TIMES: f32 = 64.0;

/// One strong light at one element.
struct Task {
    element: u32,
    light: u32,
    /// Points of the element that look at it.
    points: u32,
    factor: f64,
    free: f64,
    /// Smallest and largest visibility met.
    seen: [f32; 2],
}

#[derive(Default)]
struct Scratch {
    lots: Lots,
    tasks: Vec<Task>,
    rays: Vec<Ray>,
    /// Task (or first column, for the weak lights) and weight of each ray.
    owner: Vec<(u32, f64)>,
    visible: Vec<f32>,
    weak_rays: Vec<Ray>,
    weak: Vec<(u32, [f64; 3])>,
    sums: Vec<f64>,
}

impl DirectLights {
    /// Mean direct irradiance of every element, lux of each band: `front.len()` x columns.
    ///
    /// Unbiased where a shadow edge crosses an element, exact factors elsewhere. Never negative;
    /// exactly zero where no light is seen. The same bits for any thread count.
    pub fn element_irradiance(
        &self,
        scene: &Scene,
        front: &Front,
        caster: &dyn RayCaster,
        settings: &ElementDirect,
    ) -> Vec<f32> {
        self.element_irradiance_of(0..front.len(), scene, front, caster, settings)
    }

    /// As [`DirectLights::element_irradiance`], of a run of the elements.
    pub fn element_irradiance_of(
        &self,
        elements: Range<usize>,
        scene: &Scene,
        front: &Front,
        caster: &dyn RayCaster,
        settings: &ElementDirect,
    ) -> Vec<f32> {
        let columns = self.columns;
        let mut out = vec![0.0; elements.len() * columns];
        if self.is_empty() {
            return out;
        }
        let job = Job {
            lights: self,
            scene,
            front,
            caster,
            settings,
        };
        out.par_chunks_mut(BATCH * columns)
            .enumerate()
            .for_each_init(Scratch::default, |scratch, (k, out)| {
                job.batch(elements.start + k * BATCH, out, scratch);
            });
        out
    }
}

struct Job<'a> {
    lights: &'a DirectLights,
    scene: &'a Scene,
    front: &'a Front,
    caster: &'a dyn RayCaster,
    settings: &'a ElementDirect,
}

impl Job<'_> {
    fn batch(&self, first: usize, out: &mut [f32], s: &mut Scratch) {
        let columns = self.lights.columns;
        s.tasks.clear();
        s.weak_rays.clear();
        s.weak.clear();
        s.sums.clear();
        s.sums.resize(out.len(), 0.0);
        for k in 0..out.len() / columns {
            self.list(first, k, s);
        }
        s.rays.clear();
        s.owner.clear();
        for t in 0..s.tasks.len() {
            self.points(first, t, s);
        }
        s.visible.resize(s.rays.len(), 0.0);
        self.caster.visibility(&s.rays, &mut s.visible);
        for (&(task, weight), &v) in s.owner.iter().zip(&s.visible) {
            let task = &mut s.tasks[task as usize];
            task.free += weight * v as f64;
            task.seen = [task.seen[0].min(v), task.seen[1].max(v)];
        }
        for task in &s.tasks {
            let light = &self.lights.lights[task.light as usize];
            let e = task.sum() / task.points as f64;
            let place = task.element as usize * columns + 3 * light.group;
            for (band, tint) in light.tint.to_array().into_iter().enumerate() {
                s.sums[place + band] += e * tint as f64;
            }
        }
        if !s.weak_rays.is_empty() {
            s.visible.resize(s.weak_rays.len(), 0.0);
            self.caster.visibility(&s.weak_rays, &mut s.visible);
            for (&(place, value), &v) in s.weak.iter().zip(&s.visible) {
                for band in 0..3 {
                    s.sums[place as usize + band] += value[band] * v as f64;
                }
            }
        }
        for (out, &sum) in out.iter_mut().zip(&s.sums) {
            *out = sum as f32;
        }
    }

    /// Sorts the lights of element `first + k` into strong ones (tasks) and the lottery.
    fn list(&self, first: usize, k: usize, s: &mut Scratch) {
        let element = ElementId::from(first + k);
        let (centre, normal) = self.front.point_on(self.scene, element, [0.5, 0.5]);
        let (corner, _) = self.front.point_on(self.scene, element, [0.0, 0.0]);
        let (other, _) = self.front.point_on(self.scene, element, [1.0, 1.0]);
        let reach = (corner - centre).length().max((other - centre).length());
        let lights = self.lights;
        lights.tree.cut(
            &lights.lights,
            centre,
            normal,
            reach,
            FINE,
            &mut s.lots.items,
        );
        sort(&mut s.lots.items);
        let (mut strong, mut kept) = (0, 0);
        let whole: f32 = s.lots.items.iter().map(|i| i.0).sum();
        let few = s.lots.items.len() <= FEW;
        for i in 0..s.lots.items.len() {
            let asked = strong < self.settings.strong && (few || s.lots.items[i].0 >= WEAK * whole);
            match s.lots.items[i].1 {
                Item::Light(light) if asked => {
                    strong += 1;
                    s.tasks.push(Task {
                        element: k as u32,
                        light,
                        points: self.settings.samples.max(1)
                            * nearness(&lights.lights[light as usize], centre, reach),
                        factor: 0.0,
                        free: 0.0,
                        seen: [1.0, 0.0],
                    });
                }
                _ => {
                    s.lots.items[kept] = s.lots.items[i];
                    kept += 1;
                }
            }
        }
        s.lots.items.truncate(kept);
        if kept > 0 {
            s.lots.close();
            self.lottery(element, k, (centre, normal, reach), s);
        }
    }

    fn lottery(&self, element: ElementId, k: usize, site: (Vec3, Vec3, f32), s: &mut Scratch) {
        let lights = self.lights;
        let offset = self.caster.offset_m();
        let near = |&(guess, item): &(f32, Item)| match item {
            Item::Light(l) => {
                (guess * nearness(&lights.lights[l as usize], site.0, site.2) as f32) as f64
            }
            Item::Node(_) => guess as f64,
        };
        let times = s.lots.items.iter().map(near).sum::<f64>() / s.lots.whole;
        let draws = self.settings.weak_samples.max(1) * (times as u32).next_power_of_two();
        let sequence = Sequence::new(hash([self.settings.seed, 0x77ea]), element.0);
        for i in 0..draws {
            let [u, v, a, b] = sequence.point4(i);
            let Some(drawn) = s.lots.draw(sequence.fifth(i)) else {
                continue;
            };
            let Some((light, p)) = lights.tree.pick(
                drawn.item,
                &lights.lights,
                site.0,
                site.1,
                site.2,
                drawn.rest,
            ) else {
                continue;
            };
            let light = &lights.lights[light as usize];
            let (point, normal) = self.front.point_on(self.scene, element, [u, v]);
            let start = point + normal * offset;
            let Some(view) = light.view(point, normal, start, offset) else {
                continue;
            };
            let (ray, weight) = match view {
                View::Point(ray) => (ray, light.factor(point.as_dvec3(), normal.as_dvec3())),
                View::Polygon(view) => {
                    let (x, weight) = view.sample([a as f64, b as f64]);
                    (light.segment_to(start, x, offset), weight)
                }
            };
            if weight > 0.0 {
                let share = weight / (draws as f64 * drawn.probability * p);
                s.weak_rays.push(ray);
                let place = k * lights.columns + 3 * light.group;
                s.weak.push((
                    place as u32,
                    light.tint.to_array().map(|t| t as f64 * share),
                ));
            }
        }
    }

    /// Takes the points of a task: adds their factors and queues their rays.
    fn points(&self, first: usize, t: usize, s: &mut Scratch) {
        let task = &mut s.tasks[t];
        let element = ElementId::from(first + task.element as usize);
        let light = &self.lights.lights[task.light as usize];
        let sequence = Sequence::new(hash([self.settings.seed, task.light]), element.0);
        let offset = self.caster.offset_m();
        for i in 0..task.points {
            let [u, v, a, b] = sequence.point4(i);
            let (point, normal) = self.front.point_on(self.scene, element, [u, v]);
            let factor = light.factor(point.as_dvec3(), normal.as_dvec3());
            task.factor += factor;
            let start = point + normal * offset;
            let (ray, weight) = match light.view(point, normal, start, offset) {
                None => continue,
                Some(View::Point(ray)) => (ray, factor),
                Some(View::Polygon(view)) => {
                    let (x, weight) = view.sample([a as f64, b as f64]);
                    (light.segment_to(start, x, offset), weight)
                }
            };
            if weight > 0.0 {
                s.rays.push(ray);
                s.owner.push((t as u32, weight));
            }
        }
    }
}

/// How many times as many points an element within `reach` of `centre` needs because of its
/// nearness to a light: light falls with the square of a distance that changes over the element.
/// A power of two.
fn nearness(light: &Light, centre: Vec3, reach: f32) -> u32 {
    let (place, least) = match &light.kind {
        LightKind::Polygon(e) => (e.centre.as_vec3(), e.radius as f32),
        LightKind::Luminaire(l) => match l.kind {
            LuminaireKind::Directional { .. } => return 1,
            _ => (l.position, f32::MIN_POSITIVE),
        },
    };
    let width = reach / (place - centre).length().max(least);
    let times = (width / FAR).powi(2).clamp(1.0, MOST_TIMES);
    (times as u32).next_power_of_two()
}

impl Task {
    /// Sum of factor times visibility. Where all rays agree the exact factors count; where a
    /// shadow edge crosses, the rays' own weights do, since visible share and factor go together.
    fn sum(&self) -> f64 {
        let mixed = self.seen[0] < self.seen[1];
        if mixed {
            self.free
        } else {
            self.factor * self.seen[1] as f64
        }
    }
}
