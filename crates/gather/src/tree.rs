//! A light tree: many lights, of which each receiver asks only the important ones.
//!
//! A binary tree over all lights that have a place. A receiver takes a cut: nodes that look
//! small from it, single lights where they do not. The strongest single lights are then
//! computed one by one and the rest by a lottery (see `lottery`), which takes a node; one light
//! within it is taken by descending with the guesses of the two children. Guesses are zero only
//! where no light can arrive, so the estimate is unbiased.
//!
//! Source: [Conty18]; the cut is that of [Walter05]. Differs: the strongest lights leave the
//! lottery.

use crate::lights::{Light, LightKind};
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::{LuminaireKind, Vec3};

/// Nodes whose radius over distance is below this are not opened: where the strongest lights are
/// looked for, and where all go into the lottery.
pub(crate) const FINE: f32 = 0.35;
pub(crate) const COARSE: f32 = 0.5;
/// So few lights are each looked at.
const FEW: usize = 64;

#[derive(Clone, Debug)]
struct Node {
    centre: Vec3,
    radius: f32,
    /// Greatest intensity of all lights below, cd.
    total: f32,
    /// What of it does not depend on direction.
    round: f32,
    /// Sum of axis times intensity of the flat lights.
    vector: Vec3,
    /// The light, or the first of two children.
    link: Link,
}

#[derive(Clone, Copy, Debug)]
enum Link {
    Light(u32),
    Children(u32),
}

/// What a receiver's cut consists of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Item {
    /// A single light.
    Light(u32),
    /// A node with several.
    Node(u32),
}

/// So many of the strongest are put in order.
const SORTED: usize = 48;

/// The strongest first; those after the first [`SORTED`] in any order, the same on every run.
pub(crate) fn sort(items: &mut [(f32, Item)]) {
    let by_guess = |a: &(f32, Item), b: &(f32, Item)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
    if items.len() > SORTED {
        items.select_nth_unstable_by(SORTED, by_guess);
        items[..SORTED].sort_unstable_by(by_guess);
    } else {
        items.sort_unstable_by(by_guess);
    }
}

/// The tree, and the lights that are infinitely far.
#[derive(Clone, Debug, Default)]
pub(crate) struct LightTree {
    nodes: Vec<Node>,
    distant: Vec<u32>,
}

impl LightTree {
    pub fn new(lights: &[Light]) -> LightTree {
        let mut tree = LightTree::default();
        let mut order = Vec::new();
        for (i, l) in lights.iter().enumerate() {
            match place(l) {
                Some(p) => order.push((i as u32, p)),
                None => tree.distant.push(i as u32),
            }
        }
        if !order.is_empty() {
            tree.nodes.push(Node {
                centre: Vec3::ZERO,
                radius: 0.0,
                total: 0.0,
                round: 0.0,
                vector: Vec3::ZERO,
                link: Link::Light(0),
            });
            tree.build(lights, &mut order, 0);
        }
        tree
    }

    fn build(&mut self, lights: &[Light], order: &mut [(u32, Vec3)], at: usize) {
        if let [(light, centre)] = *order {
            self.nodes[at] = leaf(&lights[light as usize], light, centre);
            return;
        }
        let low = order.iter().fold(Vec3::INFINITY, |m, o| m.min(o.1));
        let high = order.iter().fold(Vec3::NEG_INFINITY, |m, o| m.max(o.1));
        let size = high - low;
        let axis = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let half = order.len() / 2;
        // The index breaks ties, so that the tree is the same on every run.
        order.select_nth_unstable_by(half, |a, b| {
            a.1[axis].total_cmp(&b.1[axis]).then(a.0.cmp(&b.0))
        });
        let first = self.nodes.len();
        let empty = self.nodes[at].clone();
        self.nodes.extend([empty.clone(), empty]);
        let (left, right) = order.split_at_mut(half);
        self.build(lights, left, first);
        self.build(lights, right, first + 1);
        let (a, b) = (&self.nodes[first], &self.nodes[first + 1]);
        let centre = (low + high) * 0.5;
        let radius =
            ((a.centre - centre).length() + a.radius).max((b.centre - centre).length() + b.radius);
        self.nodes[at] = Node {
            centre,
            radius,
            total: a.total + b.total,
            round: a.round + b.round,
            vector: a.vector + b.vector,
            link: Link::Children(first as u32),
        };
    }

    /// Replaces `items` by the lights and nodes that a receiver must consider, each with its
    /// guessed irradiance. Items without a guess are left out.
    pub fn cut(
        &self,
        lights: &[Light],
        point: Vec3,
        normal: Vec3,
        reach: f32,
        small: f32,
        items: &mut Vec<(f32, Item)>,
    ) {
        items.clear();
        for &l in &self.distant {
            items.push((
                lights[l as usize].guess(point, normal, reach),
                Item::Light(l),
            ));
        }
        if !self.nodes.is_empty() {
            self.open(0, lights, point, normal, reach, small, items);
        }
        items.retain(|i| i.0 > 0.0);
    }

    fn open(
        &self,
        at: u32,
        lights: &[Light],
        point: Vec3,
        normal: Vec3,
        reach: f32,
        small: f32,
        items: &mut Vec<(f32, Item)>,
    ) {
        let node = &self.nodes[at as usize];
        match node.link {
            Link::Light(l) => {
                items.push((
                    lights[l as usize].guess(point, normal, reach),
                    Item::Light(l),
                ));
            }
            Link::Children(first) => {
                let guess = self.guess(at, lights, point, normal, reach);
                if guess <= 0.0 {
                    return;
                }
                let d = (node.centre - point).length() - reach;
                if d > 0.0 && node.radius < small * d && lights.len() > FEW {
                    items.push((guess, Item::Node(at)));
                } else {
                    self.open(first, lights, point, normal, reach, small, items);
                    self.open(first + 1, lights, point, normal, reach, small, items);
                }
            }
        }
    }

    /// The two items right below a node, each with its guessed irradiance, which may be 0.
    pub fn halves(
        &self,
        node: u32,
        lights: &[Light],
        point: Vec3,
        normal: Vec3,
    ) -> [(f32, Item); 2] {
        let Link::Children(first) = self.nodes[node as usize].link else {
            unreachable!("an item that is a node has children")
        };
        [first, first + 1].map(|at| {
            let item = match self.nodes[at as usize].link {
                Link::Light(light) => Item::Light(light),
                Link::Children(_) => Item::Node(at),
            };
            (self.guess(at, lights, point, normal, 0.0), item)
        })
    }

    /// Guessed irradiance from all lights of a node.
    fn guess(&self, at: u32, lights: &[Light], point: Vec3, normal: Vec3, reach: f32) -> f32 {
        let node = &self.nodes[at as usize];
        if let Link::Light(l) = node.link {
            return lights[l as usize].guess(point, normal, reach);
        }
        let to = node.centre - point;
        let slack = node.radius + reach;
        let d2 = to
            .length_squared()
            .max(slack * slack)
            .max(f32::MIN_POSITIVE);
        let d = d2.sqrt();
        let here = ((to.dot(normal) + slack) / d).clamp(0.0, 1.0);
        // Facets that face all ways show a quarter of their sum to any side; what is left of
        // their vector sum shows its cosine. The last term keeps every light in the lottery.
        let flat = (node.total - node.round - node.vector.length()).max(0.0);
        let sent =
            node.round + 0.25 * flat + (-node.vector.dot(to) / d).max(0.0) + 0.02 * node.total;
        sent * here / d2
    }

    /// One light of all and the probability of having taken it; `u` uniform in 0..1. Cheaper than a
    /// cut where one light is all that is asked.
    pub fn pick_any(
        &self,
        lights: &[Light],
        point: Vec3,
        normal: Vec3,
        u: f64,
    ) -> Option<(u32, f64)> {
        let far = |&l: &u32| lights[l as usize].guess(point, normal, 0.0) as f64;
        let near = if self.nodes.is_empty() {
            0.0
        } else {
            self.guess(0, lights, point, normal, 0.0) as f64
        };
        let whole = near + self.distant.iter().map(far).sum::<f64>();
        if whole <= 0.0 {
            return None;
        }
        let mut pick = u * whole;
        for l in &self.distant {
            let share = far(l);
            if pick < share {
                return Some((*l, share / whole));
            }
            pick -= share;
        }
        if near <= 0.0 {
            return None;
        }
        let rest = (pick / near).clamp(0.0, 1.0);
        let (light, p) = self.pick(Item::Node(0), lights, point, normal, 0.0, rest)?;
        Some((light, p * near / whole))
    }

    /// One light of an item and the probability of having taken it; `u` uniform in 0..1.
    /// `None` when no light of the item reaches the receiver.
    pub fn pick(
        &self,
        item: Item,
        lights: &[Light],
        point: Vec3,
        normal: Vec3,
        reach: f32,
        mut u: f64,
    ) -> Option<(u32, f64)> {
        let mut at = match item {
            Item::Light(l) => return Some((l, 1.0)),
            Item::Node(n) => n,
        };
        let mut probability = 1.0;
        loop {
            match self.nodes[at as usize].link {
                Link::Light(l) => return Some((l, probability)),
                Link::Children(first) => {
                    let a = self.guess(first, lights, point, normal, reach) as f64;
                    let b = self.guess(first + 1, lights, point, normal, reach) as f64;
                    if a + b <= 0.0 {
                        return None;
                    }
                    let share = a / (a + b);
                    if u < share {
                        u /= share;
                        probability *= share;
                        at = first;
                    } else {
                        u = (u - share) / (1.0 - share);
                        probability *= 1.0 - share;
                        at = first + 1;
                    }
                }
            }
        }
    }
}

/// Where a light is; `None` when it is infinitely far.
fn place(light: &Light) -> Option<Vec3> {
    match &light.kind {
        LightKind::Polygon(e) => Some(e.centre.as_vec3()),
        LightKind::Luminaire(l) => match l.kind {
            LuminaireKind::Directional { .. } => None,
            _ => Some(l.position),
        },
    }
}

fn leaf(light: &Light, index: u32, centre: Vec3) -> Node {
    let strength = light.tint.luminance();
    let (total, vector, radius) = match &light.kind {
        LightKind::Polygon(e) => {
            let intensity = strength * e.area as f32 / LAMBERTIAN;
            (intensity, e.normal.as_vec3() * intensity, e.radius as f32)
        }
        LightKind::Luminaire(_) => (strength, Vec3::ZERO, 0.0),
    };
    let round = if vector == Vec3::ZERO { total } else { 0.0 };
    Node {
        centre,
        radius,
        total,
        round,
        vector,
        link: Link::Light(index),
    }
}
