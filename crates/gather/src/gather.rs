//! Irradiance at any receiver: direct light apart, and a final gather over the solved elements.
//!
//! Indirect: cosine-distributed low-discrepancy rays bring the exitance of the element that
//! they hit, in all layers at once, or the sky's. The rays belong to eight independently
//! scrambled sequences, so eight independent estimates give the standard error. What elements
//! send above a cap is asked as from lights, see `bright`. Direct: see `shadow`. Whatever adds most
//! error for its rays is doubled until the wanted error is reached or its rays are spent.
//!
//! The random numbers of a receiver depend on the seed, its place and its normal, so an answer
//! does not depend on which other receivers are asked with it.
//!
//! Where a ray ends close by, what is sent from that point is estimated anew instead of taking the mean
//! of its element (`nearby`), so the elements are not seen in corners and at contact lines. What the
//! noise of the solved elements leaves at a receiver is in its error, too (`element_noise`).
//!
//! Limit: what is left of the elements' size where they are seen from further away than a few of
//! their edges is not part of the stated error.
//!
//! Source: final gather [Reichert92], [Christensen97]; randomised nets as error estimate
//! [Owen97].

use crate::bright::Bright;
use crate::contract::{Accuracy, Irradiance, Receiver};
use crate::element_noise as noise;
use crate::lights::DirectLights;
use crate::lottery::{Field, Lottery};
use crate::nearby::{DEEPEST, Nearby, Place, Second};
use crate::shadow::{self, Rays, SUBSETS, Site, Strong, Subsets};
use crate::tree::COARSE;
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::{ElementId, Front, Scene, Solution};
use luxel_transport::sampling::{cosine_hemisphere, hash};
use luxel_transport::{Hit, Ray, RayCaster, Sequence};
use rayon::prelude::*;

/// Receivers a thread takes at once.
const CHUNK: usize = 4;
/// Gather rays in one batch.
const BATCH: u32 = 512;
/// Most shadow rays for one light that is partly hidden, as a multiple of the gather rays and
/// in all.
const SHADOW_TIMES: u32 = 16;
const MOST_SHADOW: u32 = 262_144;

/// Each strong light is first looked at with one shadow ray for so many of the fewest gather rays.
const FIRST_LOOK: u32 = 16;

/// Places of the lotteries.
const WEAK: usize = 0;
const BRIGHT: usize = 1;

/// Answers what light falls on any receiver.
pub struct Gatherer<'a> {
    scene: &'a Scene,
    front: &'a Front,
    caster: &'a dyn RayCaster,
    solution: &'a Solution,
    lights: &'a DirectLights,
    bright: Bright,
    /// What a ray that leaves the scene brings, all columns.
    outside: Vec<f64>,
    /// No ray can bring anything: nothing is solved and there is no sky.
    dark: bool,
    /// One draw of the noise of each element, lm/m²; empty when there is none.
    noise: Vec<f32>,
    /// Variance at a receiver over the mean square noise of the elements that its rays meet.
    noise_left: f64,
    /// Most turns of a path that stays near by.
    turns: u32,
}

/// What one thread reuses from receiver to receiver.
#[derive(Default)]
struct Scratch<'a> {
    rays: Rays,
    hits: Vec<Hit>,
    second: Second,
    /// Sum over the gather rays of the squares of the noise of the elements that they met.
    noise: f64,
    strong: Vec<Strong<'a>>,
    /// Weak lights, and bright elements.
    lotteries: [Lottery; 2],
    indirect: Subsets,
    variances: Vec<f64>,
    values: Vec<f64>,
    layers: Vec<f64>,
}

impl<'a> Gatherer<'a> {
    /// Over a solution of this front that leaves out the own emission of the direct lights.
    ///
    /// Precondition: `solution`, `front` and `lights` belong to `scene`.
    pub fn new(
        scene: &'a Scene,
        front: &'a Front,
        caster: &'a dyn RayCaster,
        solution: &'a Solution,
        lights: &'a DirectLights,
    ) -> Self {
        let columns = lights.columns;
        debug_assert!(solution.is_empty() || solution.exitance.len() == front.len() * columns);
        let mut outside = vec![0.0; columns];
        if let Some(sky) = &scene.sky {
            let group = if sky.group.index() * 3 < columns {
                sky.group.index()
            } else {
                0
            };
            for (band, l) in sky.luminance.to_array().into_iter().enumerate() {
                outside[3 * group + band] = l as f64 * LAMBERTIAN as f64;
            }
        }
        let dark = outside.iter().all(|&o| o == 0.0) && solution.exitance.iter().all(|&b| b == 0.0);
        Gatherer {
            scene,
            front,
            caster,
            solution,
            lights,
            bright: Bright::new(scene, front, caster, solution),
            outside,
            dark,
            noise: Vec::new(),
            noise_left: 0.0,
            turns: 0,
        }
    }

    /// Follows paths that stay near by through so many turns, 8 at most, in place of taking the mean of
    /// an element that is close; none unless said. Without, the stated error leaves out what the mesh
    /// adds in corners and gaps. With 8, it takes up to ten times the time, and between large emitters
    /// it is noisy: one light is drawn at each turn.
    pub fn with_turns(mut self, turns: u32) -> Self {
        self.turns = turns.min(DEEPEST);
        self
    }

    /// Takes the noise of the elements into the stated errors: `noise` is one draw of what the
    /// photometric exitance of each element is wrong by, lm/m², such as half the difference of two
    /// independent solutions of which the mean is gathered.
    pub fn with_element_noise(mut self, noise: Vec<f32>) -> Self {
        debug_assert!(noise.is_empty() || noise.len() == self.front.len());
        self.noise_left = noise::left(self.scene, self.front, self.caster, &noise);
        self.noise = noise;
        self
    }

    /// Irradiance at each receiver, per layer, with its standard error.
    ///
    /// Lux of each band. The error is that of the random numbers, of rays and of the solved elements
    /// (see [`Gatherer::with_element_noise`]). It is stated so that the value plus and minus 1.96
    /// times it is a 95 % interval. Exactly zero where nothing is seen. The same bits for any
    /// thread count, order and grouping of receivers. A receiver may lie exactly on a surface.
    pub fn irradiance_at(&self, receivers: &[Receiver], accuracy: &Accuracy) -> Irradiance {
        self.irradiance_with_slack(receivers, &[], accuracy)
    }

    /// As [`Gatherer::irradiance_at`], but each receiver's error may be so many times what
    /// `accuracy` says (at least 1; receivers without an entry have 1).
    pub fn irradiance_with_slack(
        &self,
        receivers: &[Receiver],
        slack: &[f32],
        accuracy: &Accuracy,
    ) -> Irradiance {
        let columns = self.lights.columns;
        let groups = columns / 3;
        let n = receivers.len();
        let mut values = vec![0.0; n * columns];
        let mut layer_errors = vec![0.0; n * groups];
        let mut errors = vec![0.0; n];
        let rays = receivers
            .par_chunks(CHUNK)
            .enumerate()
            .zip(values.par_chunks_mut(CHUNK * columns))
            .zip(layer_errors.par_chunks_mut(CHUNK * groups))
            .zip(errors.par_chunks_mut(CHUNK))
            .map_init(
                Scratch::default,
                |scratch, ((((chunk, receivers), values), layers), errors)| {
                    let mut rays = 0;
                    for (k, receiver) in receivers.iter().enumerate() {
                        let slack = slack.get(CHUNK * chunk + k).copied().unwrap_or(1.0);
                        let accuracy = accuracy.loosened(slack);
                        let values = &mut values[k * columns..(k + 1) * columns];
                        let layers = &mut layers[k * groups..(k + 1) * groups];
                        rays +=
                            self.one(receiver, &accuracy, scratch, values, layers, &mut errors[k]);
                    }
                    rays
                },
            )
            .sum();
        Irradiance {
            columns,
            values,
            layer_errors,
            errors,
            rays,
        }
    }

    fn one(
        &self,
        receiver: &Receiver,
        accuracy: &Accuracy,
        s: &mut Scratch<'a>,
        values: &mut [f32],
        layer_errors: &mut [f32],
        error: &mut f32,
    ) -> u64 {
        let columns = self.lights.columns;
        let normal = receiver.normal.normalize_or_zero();
        if normal.length_squared() == 0.0 || !receiver.position.is_finite() {
            return 0;
        }
        let offset = self.caster.offset_m().max(f32::MIN_POSITIVE);
        let p = receiver.position;
        let site = Site {
            point: p,
            normal,
            start: p + normal * offset,
            offset,
            key: hash([
                accuracy.seed,
                p.x.to_bits(),
                p.y.to_bits(),
                p.z.to_bits(),
                normal.x.to_bits(),
                normal.y.to_bits(),
                normal.z.to_bits(),
            ]),
        };
        let subset = |rays: u32| (rays.max(1).next_power_of_two() / SUBSETS as u32).max(2);
        let fewest = subset(accuracy.rays[0]);
        let most = subset(accuracy.rays[1]).max(fewest);
        let most_shadow = most
            .saturating_mul(SHADOW_TIMES)
            .min(MOST_SHADOW / SUBSETS as u32);

        s.indirect.reset(columns);
        s.noise = 0.0;
        s.lotteries.iter_mut().for_each(|l| l.reset(columns));
        let least = 0.5 * accuracy.relative;
        let lots = &mut s.lotteries[WEAK].lots;
        shadow::strong_lights(self.lights, &site, least, lots, &mut s.strong);
        let first = (fewest / FIRST_LOOK).max(1);
        for light in &mut s.strong {
            light.cast(&site, first, self.caster, &mut s.rays);
        }
        if !self.bright.is_empty() {
            let (bright, lots) = (&self.bright, &mut s.lotteries[BRIGHT].lots);
            let (lights, items) = (&bright.lights, &mut lots.items);
            bright.tree.cut(lights, p, normal, 0.0, COARSE, items);
            lots.close();
        }
        for which in [WEAK, BRIGHT] {
            if !s.lotteries[which].lots.items.is_empty() {
                self.draw(which, &site, fewest.min(8), s);
            }
        }
        if !self.dark {
            self.gather(&site, fewest, s);
        }

        // Parts: strong lights, then the lotteries, then the gather rays.
        let count = s.strong.len() + s.lotteries.len() + 1;
        s.variances.clear();
        s.variances.extend(s.strong.iter().map(|l| l.doubt()));
        let drawn = s.lotteries.iter().map(|l| l.doubt(columns));
        s.variances.extend(drawn);
        s.variances.push(s.indirect.variance(columns, None));
        s.values.resize(columns, 0.0);
        loop {
            self.add_up(s);
            let total: f64 = s
                .values
                .chunks_exact(3)
                .map(|v| crate::lights::photometric([v[0], v[1], v[2]]))
                .sum();
            let wanted = (accuracy.relative as f64 * total).max(accuracy.floor_lux as f64);
            let variance: f64 = s.variances.iter().sum();
            // More rays do not take the noise of the elements away, so it must not call for ever
            // more of them: they bring half of what is asked at least.
            let wanted = wanted * wanted;
            let goal = (wanted - self.noise_variance(s)).max(0.25 * wanted);
            if variance <= goal {
                break;
            }
            // Doubling a part costs as many rays as it has and takes away at least half its
            // variance: the largest variance a ray pays best.
            let mut best: Option<(f64, usize)> = None;
            for part in 0..count {
                let (taken, limit) = match part.checked_sub(s.strong.len()) {
                    None if s.strong[part].agrees() => (s.strong[part].taken(), most),
                    None => (s.strong[part].taken(), most_shadow),
                    Some(which @ (WEAK | BRIGHT)) => {
                        (s.lotteries[which].subsets.taken, most.saturating_mul(4))
                    }
                    Some(_) => (s.indirect.taken, most),
                };
                let pays = s.variances[part] / taken.max(1) as f64;
                if pays > 0.0 && taken < limit && best.is_none_or(|b| pays > b.0) {
                    best = Some((pays, part));
                }
            }
            let Some((_, part)) = best else { break };
            s.variances[part] = match part.checked_sub(s.strong.len()) {
                None => {
                    let light = &mut s.strong[part];
                    light.cast(&site, 2 * light.taken(), self.caster, &mut s.rays);
                    light.doubt()
                }
                Some(which @ (WEAK | BRIGHT)) => {
                    let until = 2 * s.lotteries[which].subsets.taken;
                    self.draw(which, &site, until, s);
                    s.lotteries[which].doubt(columns)
                }
                Some(_) => {
                    let until = 2 * s.indirect.taken;
                    self.gather(&site, until, s);
                    s.indirect.variance(columns, None)
                }
            };
        }

        s.layers.clear();
        s.layers.resize(columns / 3, 0.0);
        for light in &s.strong {
            s.layers[light.light.group] += light.variance();
        }
        let [weak, bright] = &s.lotteries;
        let random = [&weak.subsets, &bright.subsets, &s.indirect]
            .map(|part| part.variance(columns, Some(&mut s.layers)));
        for (out, &v) in values.iter_mut().zip(&s.values) {
            *out = v as f32;
        }
        for (out, &v) in layer_errors.iter_mut().zip(&s.layers) {
            *out = v.sqrt() as f32;
        }
        let strong: f64 = s.strong.iter().map(|l| l.variance()).sum();
        let elements = self.noise_variance(s);
        *error = (strong + random.iter().sum::<f64>() + elements).sqrt() as f32;
        let shadow: u64 = s.strong.iter().map(|l| l.rays() as u64).sum();
        let drawn: u64 = s.lotteries.iter().map(|l| l.subsets.rays() as u64).sum();
        shadow + drawn + s.indirect.rays() as u64 + std::mem::take(&mut s.second.rays)
    }

    /// The sum of all parts, all columns.
    fn add_up(&self, s: &mut Scratch<'_>) {
        s.values.fill(0.0);
        s.indirect.add_mean(&mut s.values);
        for lottery in &s.lotteries {
            lottery.subsets.add_mean(&mut s.values);
        }
        for light in &s.strong {
            let place = 3 * light.light.group;
            for (band, v) in light.value().into_iter().enumerate() {
                s.values[place + band] += v;
            }
        }
    }

    /// Draws from one of the lotteries until each subset has `until`.
    fn draw(&self, which: usize, site: &Site, until: u32, s: &mut Scratch<'a>) {
        let (weak, bright, columns) = (self.lights, &self.bright, self.lights.columns);
        let (lights, tree, salt) = match which {
            WEAK => (&weak.lights, &weak.tree, 0x1b87_3593),
            _ => (&bright.lights, &bright.tree, 0x85eb_ca6b),
        };
        let bring = |row: &mut [f64], index: u32, share: f64| {
            if which == WEAK {
                let light = &weak.lights[index as usize];
                let tint = light.tint.to_array();
                add(&mut row[3 * light.group..], &tint, |&t| t as f64 * share);
            } else {
                let first = bright.element[index as usize].index() * columns;
                let share = share * bright.rest(index);
                let exitance = &self.solution.exitance[first..first + columns];
                add(row, exitance, |&b| b as f64 * share);
            }
        };
        let field = Field { lights, tree, salt };
        let (lottery, rays) = (&mut s.lotteries[which], &mut s.rays);
        lottery.cast(&field, site, until, self.caster, rays, bring);
    }

    /// Variance of the photometric value by the noise of the elements: the mean square noise of
    /// those that the rays met, less what the mean over many of them takes away.
    fn noise_variance(&self, s: &Scratch<'_>) -> f64 {
        self.noise_left * s.noise / s.indirect.rays().max(1) as f64
    }

    /// Takes gather rays until each subset has `until`.
    fn gather(&self, site: &Site, until: u32, s: &mut Scratch<'a>) {
        let columns = self.lights.columns;
        let (scene, front, caster) = (self.scene, self.front, self.caster);
        let nearby = Nearby {
            scene,
            front,
            caster,
            solution: self.solution,
            lights: self.lights,
            bright: &self.bright,
            outside: &self.outside,
            turns: self.turns,
        };
        let (sums, buffer) = (&mut s.indirect, &mut s.rays);
        for g in 0..SUBSETS {
            let sequence = Sequence::new(site.key, g as u32);
            let mut from = sums.taken;
            while from < until {
                let to = until.min(from + BATCH);
                buffer.rays.clear();
                buffer.rays.extend((from..to).map(|i| Ray {
                    origin: site.start,
                    t_min: 0.0,
                    direction: cosine_hemisphere(sequence.point2(i), site.normal),
                    t_max: f32::INFINITY,
                }));
                s.hits.resize(buffer.rays.len(), Hit::MISS);
                caster.closest(&buffer.rays, &mut s.hits);
                let row = &mut sums.sums[g * columns..(g + 1) * columns];
                for (index, (ray, hit)) in (from..).zip(buffer.rays.iter().zip(&s.hits)) {
                    if !hit.is_hit() {
                        add(row, &self.outside, |&o| o);
                        continue;
                    }
                    let at = ray.origin + ray.direction * hit.t;
                    let Some(element) = front.element_at(hit.triangle as usize, hit.side, at)
                    else {
                        continue;
                    };
                    // What the lottery brings of a bright element must not come twice.
                    let kept = self.bright.kept.get(element.index());
                    let whole = kept.is_none_or(|&kept| kept == 1.0);
                    let near = nearby.normal_if_near(hit, element).filter(|_| whole);
                    if let Some(normal) = near {
                        let subset = g as u32;
                        s.second.places.push(Place {
                            subset,
                            index,
                            element,
                            at,
                            normal,
                            share: [1.0; 3],
                        });
                    } else {
                        self.add_mean(element, row);
                        let wrong = self.noise.get(element.index()).copied().unwrap_or(0.0);
                        s.noise += (wrong * wrong) as f64;
                    }
                }
                s.noise += nearby.gather(site, &self.noise, &mut s.second, sums, buffer);
                from = to;
            }
        }
        s.indirect.taken = until;
    }

    /// Adds the mean exitance of an element, but for what is asked as from a light.
    #[inline]
    fn add_mean(&self, element: ElementId, row: &mut [f64]) {
        let first = element.index() * row.len();
        let Some(b) = self.solution.exitance.get(first..first + row.len()) else {
            return;
        };
        match self.bright.kept.get(element.index()) {
            Some(&kept) if kept < 1.0 => add(row, b, |&b| (b * kept) as f64),
            _ => add(row, b, |&b| b as f64),
        }
    }
}

#[inline]
fn add<T>(row: &mut [f64], values: &[T], as_f64: impl Fn(&T) -> f64) {
    for (sum, v) in row.iter_mut().zip(values) {
        *sum += as_f64(v);
    }
}
