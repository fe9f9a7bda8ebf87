//! Direct light of the strong lights at one receiver, one by one, each with its own error from
//! independent subsets. The weak ones are left to the `lottery`.
//!
//! A strong light gives its exact unoccluded factor times the share of free shadow rays,
//! weighted by the kernel (ratio estimator). A luminaire without size needs one ray and has no
//! error. A polygon is sampled by [`SUBSETS`] independently scrambled sequences. While all its
//! rays agree, the answer is all or nothing and its stated error is zero; but rays go on until
//! what they could have missed is small beside the wanted error, so that a slit or a thin
//! occluder which matters is found.

use crate::emitter::EmitterView;
use crate::lights::{DirectLights, Light, LightKind, View, photometric};
use crate::lottery::Lots;
use crate::tree::{FINE, Item, sort};
use luxel_core::Vec3;
use luxel_transport::sampling::hash;
use luxel_transport::{Ray, RayCaster, Sequence};

/// Independent estimates of everything that is random.
pub(crate) const SUBSETS: usize = 8;
/// With 8 subsets the true error over the estimated one follows Student's t with 7 degrees of
/// freedom, of which 95 % lie within 2.365 and not within 1.960: so much larger is the error that we
/// state, and the value +- 1.96 times it is a 95 % interval.
pub(crate) const STUDENT: f64 = (2.364_624 / 1.959_964) * (2.364_624 / 1.959_964);
/// Strongest lights that are computed one by one.
const STRONG: usize = 24;
/// So many are, however weak.
const ALWAYS: usize = 3;

/// Mean square of the share of a light that `rays` missed while all of them agreed, if it was
/// thought to be free, hidden, or hidden in part by any share, each as likely.
pub(crate) fn missed_square(rays: f64) -> f64 {
    2.0 / ((rays + 1.0) * (rays + 2.0) * (rays + 3.0))
}

/// A receiver, ready to send rays.
#[derive(Clone, Copy)]
pub(crate) struct Site {
    pub point: Vec3,
    pub normal: Vec3,
    /// The point moved off its surface.
    pub start: Vec3,
    /// By how much, metres.
    pub offset: f32,
    /// Names its random numbers: from the seed, the place and the normal.
    pub key: u32,
}

/// Buffers for batches of rays.
#[derive(Default)]
pub(crate) struct Rays {
    pub rays: Vec<Ray>,
    pub visible: Vec<f32>,
    pub(crate) owner: Vec<Owner>,
}

/// To whom a shadow ray belongs.
pub(crate) struct Owner {
    pub subset: u32,
    pub light: u32,
    pub weight: f64,
    /// Place in the lottery.
    pub place: u32,
}

/// Sums of independent subsets, all columns.
#[derive(Default)]
pub(crate) struct Subsets {
    /// Samples in each subset.
    pub taken: u32,
    /// `[subset * columns + column]`.
    pub sums: Vec<f64>,
}

impl Subsets {
    pub fn reset(&mut self, columns: usize) {
        self.taken = 0;
        self.sums.clear();
        self.sums.resize(SUBSETS * columns, 0.0);
    }

    /// Rays used.
    pub fn rays(&self) -> u32 {
        self.taken * SUBSETS as u32
    }

    /// Adds the mean of every column.
    pub fn add_mean(&self, values: &mut [f64]) {
        if self.taken > 0 {
            for subset in self.sums.chunks_exact(values.len()) {
                for (v, s) in values.iter_mut().zip(subset) {
                    *v += s / self.rays() as f64;
                }
            }
        }
    }

    /// Variance of the photometric mean; adds that of each layer to `layers` when asked.
    pub fn variance(&self, columns: usize, layers: Option<&mut [f64]>) -> f64 {
        if self.taken == 0 {
            return 0.0;
        }
        let n = self.taken as f64;
        let value = |subset: &[f64]| photometric([subset[0], subset[1], subset[2]]) / n;
        let spread = |values: [f64; SUBSETS]| {
            let mean = values.iter().sum::<f64>() / SUBSETS as f64;
            let square: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
            // Equal numbers summed in different order are still equal.
            let square = if square < 1e-24 * mean * mean {
                0.0
            } else {
                square
            };
            STUDENT * square / (SUBSETS * (SUBSETS - 1)) as f64
        };
        let row = |g: usize| &self.sums[g * columns..(g + 1) * columns];
        if let Some(layers) = layers {
            for (group, layer) in layers.iter_mut().enumerate() {
                *layer += spread(std::array::from_fn(|g| value(&row(g)[3 * group..])));
            }
        }
        spread(std::array::from_fn(|g| {
            row(g).chunks_exact(3).map(value).sum()
        }))
    }
}

/// One strong light at one receiver.
pub(crate) struct Strong<'a> {
    pub light: &'a Light,
    index: u32,
    /// Unoccluded photometric irradiance, lux.
    pub lux: f64,
    factor: f64,
    view: View<'a>,
    /// Samples in each subset; a luminaire without size has one ray in all.
    taken: u32,
    weight: [f64; SUBSETS],
    free: [f64; SUBSETS],
    seen: [f32; 2],
}

impl Strong<'_> {
    /// Visible fraction, 0..=1.
    fn fraction(&self) -> f64 {
        let (weight, free): (f64, f64) = (self.weight.iter().sum(), self.free.iter().sum());
        if weight > 0.0 { free / weight } else { 0.0 }
    }

    /// Irradiance of each band, lux.
    pub fn value(&self) -> [f64; 3] {
        let e = self.factor * self.fraction();
        self.light.tint.to_array().map(|t| t as f64 * e)
    }

    /// Whether all rays met the same visibility (or there is only one ray).
    pub fn agrees(&self) -> bool {
        self.seen[0] >= self.seen[1]
    }

    /// Variance that steers the rays: while all agree, of what they may have missed.
    pub fn doubt(&self) -> f64 {
        match self.view {
            View::Polygon(_) if self.agrees() => {
                self.lux * self.lux * missed_square(self.rays() as f64)
            }
            _ => self.variance(),
        }
    }

    /// Variance of the photometric irradiance.
    pub fn variance(&self) -> f64 {
        if self.agrees() {
            return 0.0;
        }
        let whole: f64 = self.weight.iter().sum();
        let fraction = self.fraction();
        // Variance of a ratio of means [Cochran77]: residuals free - fraction * weight.
        let square: f64 = self
            .weight
            .iter()
            .zip(&self.free)
            .map(|(w, f)| (f - fraction * w) * (f - fraction * w))
            .sum();
        let n = SUBSETS as f64;
        let estimate = STUDENT * square / (whole * whole) * n / (n - 1.0);
        // Where a shadow edge runs along a stratum, all subsets often count the same number of
        // free rays, and their spread is zero by chance. An edge that lies anywhere in its
        // stratum leaves a mean variance of 1/6 of a ray squared.
        let taken = self.taken as f64;
        let least = 1.0 / (6.0 * n * taken * taken);
        estimate.max(least) * self.lux * self.lux
    }

    pub fn rays(&self) -> u32 {
        match self.view {
            View::Point(_) => self.taken.min(1),
            View::Polygon(_) => self.taken * SUBSETS as u32,
        }
    }

    /// Goes on to `until` samples in each subset.
    pub fn cast(&mut self, site: &Site, until: u32, caster: &dyn RayCaster, buffer: &mut Rays) {
        buffer.rays.clear();
        buffer.owner.clear();
        match &self.view {
            View::Point(ray) => {
                buffer.rays.push(*ray);
                buffer.owner.push(Owner {
                    subset: 0,
                    light: self.index,
                    weight: 1.0,
                    place: 0,
                });
            }
            View::Polygon(view) => {
                for g in 0..SUBSETS {
                    let stream = hash([self.index, g as u32]);
                    let sequence = Sequence::new(site.key ^ 0x5bd1_e995, stream);
                    for i in self.taken..until {
                        let (x, weight) = sample_view(view, sequence.point2(i));
                        if weight > 0.0 {
                            buffer
                                .rays
                                .push(self.light.segment_to(site.start, x, site.offset));
                            buffer.owner.push(Owner {
                                subset: g as u32,
                                light: self.index,
                                weight,
                                place: 0,
                            });
                        }
                    }
                }
            }
        }
        self.taken = until;
        buffer.visible.resize(buffer.rays.len(), 0.0);
        caster.visibility(&buffer.rays, &mut buffer.visible);
        for (o, &v) in buffer.owner.iter().zip(&buffer.visible) {
            self.weight[o.subset as usize] += o.weight;
            self.free[o.subset as usize] += o.weight * v as f64;
            self.seen = [self.seen[0].min(v), self.seen[1].max(v)];
        }
    }

    pub fn taken(&self) -> u32 {
        self.taken
    }
}

/// 24-bit fractions in the middle of their cells: a point never lies on the edge of a light.
pub(crate) fn sample_view(view: &EmitterView<'_>, [u, v]: [f32; 2]) -> (Vec3, f64) {
    const HALF: f64 = 0.5 / 16_777_216.0;
    view.sample([u as f64 + HALF, v as f64 + HALF])
}

/// Finds the strong lights of a receiver; leaves the weak ones in `lots`, closed. A light with size
/// and less than `least` of all guesses is weak, but for the first [`ALWAYS`].
pub(crate) fn strong_lights<'a>(
    lights: &'a DirectLights,
    site: &Site,
    least: f32,
    lots: &mut Lots,
    strong: &mut Vec<Strong<'a>>,
) {
    strong.clear();
    let items = &mut lots.items;
    lights
        .tree
        .cut(&lights.lights, site.point, site.normal, 0.0, FINE, items);
    sort(items);
    let least = least * items.iter().map(|i| i.0).sum::<f32>();
    let is_strong = |guess: f32, index: u32, count: usize| {
        let sized = matches!(lights.lights[index as usize].kind, LightKind::Polygon(_));
        count < STRONG && (count < ALWAYS || guess >= least || !sized)
    };
    let mut kept = 0;
    for i in 0..items.len() {
        match items[i].1 {
            Item::Light(index) if is_strong(items[i].0, index, strong.len()) => {
                let light = &lights.lights[index as usize];
                let factor = light.factor(site.point.as_dvec3(), site.normal.as_dvec3());
                let view = light.view(site.point, site.normal, site.start, site.offset);
                if let (true, Some(view)) = (factor > 0.0, view) {
                    let lux = factor * light.tint.luminance() as f64;
                    let zero = [0.0; SUBSETS];
                    let seen = [f32::INFINITY, f32::NEG_INFINITY];
                    strong.push(Strong {
                        light,
                        index,
                        lux,
                        factor,
                        view,
                        taken: 0,
                        weight: zero,
                        free: zero,
                        seen,
                    });
                }
            }
            _ => {
                items[kept] = items[i];
                kept += 1;
            }
        }
    }
    items.truncate(kept);
    lots.close();
}
