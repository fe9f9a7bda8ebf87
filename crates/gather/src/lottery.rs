//! A lottery over many lights of which each gives little: an item of a light tree's cut is drawn
//! with a probability in proportion to its guessed irradiance, one light within it by the tree,
//! and one shadow ray goes to a point on it.
//!
//! It learns: from the next round on an item whose draws were hidden is drawn less, and a node of
//! which only some were is drawn as its two halves. Within a round the chances stay the same, so
//! each draw alone is unbiased. The draws belong to [`SUBSETS`]
//! independent sequences, whose spread is the error.
//!
//! Source: [Conty18] for the draws; learning from what arrived is ours.

use crate::lights::{Light, View};
use crate::shadow::{Owner, Rays, SUBSETS, Site, Subsets, missed_square, sample_view};
use crate::tree::{Item, LightTree};
use luxel_transport::{RayCaster, Sequence};

/// Lights to draw from.
pub(crate) struct Field<'a> {
    pub lights: &'a [Light],
    pub tree: &'a LightTree,
    /// Tells the random numbers of one lottery from those of another.
    pub salt: u32,
}

/// The lottery of one receiver over one field, and what its draws brought.
#[derive(Default)]
pub(crate) struct Lottery {
    pub lots: Lots,
    pub subsets: Subsets,
}

impl Lottery {
    /// Nothing to draw, nothing drawn.
    pub fn reset(&mut self, columns: usize) {
        self.lots.items.clear();
        self.lots.close();
        self.subsets.reset(columns);
    }

    /// Variance that steers the rays: of the draws, or of what they may have missed.
    pub fn doubt(&self, columns: usize) -> f64 {
        self.subsets.variance(columns, None).max(self.lots.doubt())
    }

    /// Draws until each subset has `until`; `add` is told of each draw that arrives: the sums of
    /// its subset, the light, and how often its tint arrives.
    pub fn cast(
        &mut self,
        field: &Field<'_>,
        site: &Site,
        until: u32,
        caster: &dyn RayCaster,
        buffer: &mut Rays,
        mut add: impl FnMut(&mut [f64], u32, f64),
    ) {
        buffer.rays.clear();
        buffer.owner.clear();
        for g in 0..SUBSETS {
            let sequence = Sequence::new(site.key ^ field.salt, g as u32);
            for i in self.subsets.taken..until {
                let Some(drawn) = self.lots.draw(sequence.fifth(i)) else {
                    continue;
                };
                let picked = field.tree.pick(
                    drawn.item,
                    field.lights,
                    site.point,
                    site.normal,
                    0.0,
                    drawn.rest,
                );
                let Some((index, p)) = picked else {
                    self.lots.count(drawn.place, 0.0);
                    continue;
                };
                let light = &field.lights[index as usize];
                let Some(view) = light.view(site.point, site.normal, site.start, site.offset)
                else {
                    self.lots.count(drawn.place, 0.0);
                    continue;
                };
                let (ray, weight) = match view {
                    View::Point(ray) => (
                        ray,
                        light.factor(site.point.as_dvec3(), site.normal.as_dvec3()),
                    ),
                    View::Polygon(view) => {
                        let (x, weight) = sample_view(&view, sequence.point2(i));
                        (light.segment_to(site.start, x, site.offset), weight)
                    }
                };
                if weight > 0.0 {
                    buffer.rays.push(ray);
                    buffer.owner.push(Owner {
                        subset: g as u32,
                        light: index,
                        weight: weight / (drawn.probability * p),
                        place: drawn.place,
                    });
                } else {
                    self.lots.count(drawn.place, 0.0);
                }
            }
        }
        self.subsets.taken = until;
        buffer.visible.resize(buffer.rays.len(), 0.0);
        caster.visibility(&buffer.rays, &mut buffer.visible);
        let columns = self.subsets.sums.len() / SUBSETS;
        for (o, &v) in buffer.owner.iter().zip(&buffer.visible) {
            let first = o.subset as usize * columns;
            let row = &mut self.subsets.sums[first..first + columns];
            add(row, o.light, o.weight * v as f64);
            self.lots.count(o.place, v);
        }
        self.lots.open(field, site);
        self.lots.next_round();
    }
}

/// What a receiver must consider, and the chances of each item.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lots {
    /// Guessed irradiance and item.
    pub items: Vec<(f32, Item)>,
    /// Draws of each item, and how many of them arrived.
    tally: Vec<[f32; 2]>,
    /// Running sum of the weights.
    sums: Vec<f64>,
    /// Sum of the guesses, lux.
    pub whole: f64,
}

/// One draw of a lottery.
pub(crate) struct Drawn {
    /// Place in [`Lots::items`].
    pub place: u32,
    pub item: Item,
    pub probability: f64,
    /// What is left of the random number, uniform in 0..1.
    pub rest: f64,
}

/// An item is never drawn less than this share of what its guess says.
const LEAST: f32 = 0.02;
/// After so many draws a node of which less than this share arrived is opened.
const TOLD: f32 = 8.0;
const MIXED: f32 = 0.75;
/// So many draws must arrive before their spread is believed.
const ENOUGH: f32 = 8.0;
/// After so many draws with hardly an arrival the lights are behind a wall.
const HIDDEN: f32 = 512.0;

impl Lots {
    /// Makes the lottery ready; the items stay as they are from here on.
    pub fn close(&mut self) {
        self.whole = self.items.iter().map(|i| i.0 as f64).sum();
        self.tally.clear();
        self.tally.resize(self.items.len(), [0.0; 2]);
        self.next_round();
    }

    /// Opens the nodes of which some draws arrived and some did not: below, what is seen parts
    /// from what is hidden.
    fn open(&mut self, field: &Field<'_>, site: &Site) {
        for place in 0..self.items.len() {
            let [drawn, seen] = self.tally[place];
            let mixed = drawn >= TOLD && seen > 0.0 && seen < MIXED * drawn;
            if let (Item::Node(node), true) = (self.items[place].1, mixed) {
                let halves = field
                    .tree
                    .halves(node, field.lights, site.point, site.normal);
                self.items[place] = halves[0];
                self.items.push(halves[1]);
                self.tally[place] = [0.0; 2];
                self.tally.push([0.0; 2]);
            }
        }
    }

    /// Takes what was tallied into account. Within a round the chances stay the same, so that
    /// each draw alone is unbiased.
    pub fn next_round(&mut self) {
        let mut sum = 0.0;
        self.sums.clear();
        let items = self.items.iter().zip(&self.tally);
        self.sums.extend(items.map(|(i, [drawn, arrived])| {
            let share = ((arrived + 1.0) / (drawn + 1.0)).max(LEAST);
            sum += i.0 as f64 * share as f64;
            sum
        }));
    }

    /// What `u`, uniform in 0..1, draws; `None` when there is nothing.
    pub fn draw(&self, u: f64) -> Option<Drawn> {
        let whole = *self.sums.last()?;
        let pick = u * whole;
        let last = self.items.len() - 1;
        let place = self.sums.partition_point(|s| *s <= pick).min(last);
        let before = if place > 0 { self.sums[place - 1] } else { 0.0 };
        let weight = self.sums[place] - before;
        Some(Drawn {
            place: place as u32,
            item: self.items[place].1,
            probability: weight / whole,
            rest: ((pick - before) / weight).clamp(0.0, 1.0),
        })
    }

    /// Counts a draw and what share of it arrived.
    pub fn count(&mut self, place: u32, arrived: f32) {
        let [drawn, seen] = &mut self.tally[place as usize];
        *drawn += 1.0;
        *seen += arrived;
    }

    /// Variance that may hide behind too few arrivals, lux².
    pub fn doubt(&self) -> f64 {
        let (drawn, seen) = self
            .tally
            .iter()
            .fold((0.0f32, 0.0f32), |s, t| (s.0 + t[0], s.1 + t[1]));
        if seen >= ENOUGH || drawn >= HIDDEN {
            return 0.0;
        }
        self.whole * self.whole * missed_square(drawn as f64)
    }
}
