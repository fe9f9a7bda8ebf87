//! A radiosity texture ("rex"): a quadtree over the unit square of a surface that counts photons.
//!
//! Every photon is counted in each node from the root down to a leaf and in the quarter of the leaf
//! that it hits: a leaf keeps four children on trial, which are not marked. A leaf splits when the
//! power of its quarters differs by more than asked and by more than their counts explain (a count
//! of n is off by the root of n); four leaves that do not differ so are merged. New children on
//! trial share evenly what was counted before they were there. So at any time the power of the
//! leaves is that of all photons. Geometry has no part in it: the tree is read as a texture.
//!
//! Source: [Heckbert90]; fields of a node as in [Yeap99], figure 6.7. Differs: noise is told from
//! contrast by the counts; splits wait for [`RexTree::adapt`].

/// No such node.
pub const NONE: u32 = u32::MAX;

/// A node of the tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Whether it holds what is shown of its area.
    pub leaf: bool,
    /// Whether it is a leaf or above one; children on trial are not marked.
    pub mark: bool,
    /// Depth; 0 is the root.
    pub level: u8,
    /// [`NONE`] for the root.
    pub parent: u32,
    /// Child at low u, high v; [`NONE`] if there are no children.
    pub nw: u32,
    /// Child at high u, high v.
    pub ne: u32,
    /// Child at high u, low v.
    pub se: u32,
    /// Child at low u, low v.
    pub sw: u32,
    /// Least u, 0..1.
    pub u0: f64,
    /// Least v, 0..1.
    pub v0: f64,
    /// Area, m².
    pub area: f64,
    /// Photons counted, those of its children too.
    pub count: u64,
    /// Their power, lm.
    pub power: f64,
}

impl Node {
    /// Width in u and v.
    pub fn width(&self) -> f64 {
        0.5f64.powi(self.level as i32)
    }

    fn children(&self) -> [u32; 4] {
        [self.sw, self.se, self.nw, self.ne]
    }
}

/// When leaves split and merge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Criterion {
    /// Difference of power between quarters, as a share of their mean, from which on they matter.
    pub contrast: f64,
    /// Standard deviations of the counts that a difference must exceed.
    pub deviations: f64,
    /// Deepest level of a leaf, at most 28.
    pub most_level: u8,
}

/// A radiosity texture.
#[derive(Clone, Debug, PartialEq)]
pub struct RexTree {
    nodes: Vec<Node>,
}

impl RexTree {
    /// An empty texture of a surface of this area, one leaf.
    pub fn new(area_m2: f64) -> RexTree {
        let root = Node {
            leaf: true,
            mark: true,
            level: 0,
            parent: NONE,
            nw: NONE,
            ne: NONE,
            se: NONE,
            sw: NONE,
            u0: 0.0,
            v0: 0.0,
            area: area_m2,
            count: 0,
            power: 0.0,
        };
        let mut tree = RexTree { nodes: vec![root] };
        tree.try_children(0);
        tree
    }

    /// All nodes; the first is the root, parents come before children. Merging leaves nodes behind
    /// that no node names; they are neither leaf nor marked.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The leaves.
    pub fn leaves(&self) -> impl Iterator<Item = &Node> {
        self.nodes.iter().filter(|n| n.leaf)
    }

    /// Counts a photon of `power` lm at (u, v), 0..=1.
    pub fn deposit(&mut self, u: f64, v: f64, power: f64) {
        let mut at = 0;
        while at != NONE {
            let node = &mut self.nodes[at as usize];
            node.count += 1;
            node.power += power;
            at = node.children()[quarter(node, u, v)];
        }
    }

    fn try_children(&mut self, parent: u32) {
        let of = self.nodes[parent as usize];
        let half = 0.5 * of.width();
        let first = self.nodes.len() as u32;
        for k in 0..4u64 {
            self.nodes.push(Node {
                leaf: false,
                mark: false,
                level: of.level + 1,
                parent,
                u0: of.u0 + half * (k & 1) as f64,
                v0: of.v0 + half * (k >> 1) as f64,
                area: 0.25 * of.area,
                count: of.count / 4 + u64::from(k < of.count % 4),
                power: 0.25 * of.power,
                nw: NONE,
                ne: NONE,
                se: NONE,
                sw: NONE,
            });
        }
        let node = &mut self.nodes[parent as usize];
        [node.sw, node.se, node.nw, node.ne] = [0, 1, 2, 3].map(|k| first + k);
    }

    /// Whether the quarters of a node differ by more than `criterion` allows.
    fn differs(&self, node: &Node, criterion: &Criterion) -> bool {
        let quarters = node.children().map(|c| self.nodes[c as usize]);
        let mean = 0.25 * quarters.iter().map(|q| q.power).sum::<f64>();
        if mean <= 0.0 {
            return false;
        }
        let by_power = |a: &&Node, b: &&Node| a.power.total_cmp(&b.power);
        let (Some(low), Some(high)) = (
            quarters.iter().min_by(by_power),
            quarters.iter().max_by(by_power),
        ) else {
            return false;
        };
        // Photons of about one power: each count is off by its root.
        let each = node.power / node.count.max(1) as f64;
        let noise = each * ((low.count + high.count) as f64).sqrt();
        let step = high.power - low.power;
        step > criterion.contrast * mean && step >= criterion.deviations * noise
    }

    /// Splits each leaf whose quarters differ and merges each four leaves that do not; returns how
    /// many of both. To be called between lots of photons.
    pub fn adapt(&mut self, criterion: &Criterion) -> [usize; 2] {
        let (mut splits, mut merges) = (0, 0);
        for at in 0..self.nodes.len() {
            let node = self.nodes[at];
            if node.leaf {
                if node.level < criterion.most_level && self.differs(&node, criterion) {
                    self.nodes[at].leaf = false;
                    for child in node.children() {
                        let child_node = &mut self.nodes[child as usize];
                        (child_node.leaf, child_node.mark) = (true, true);
                        self.try_children(child);
                    }
                    splits += 1;
                }
            } else if node.mark {
                let children = node.children();
                let leaves = children.iter().all(|&c| self.nodes[c as usize].leaf);
                let settled = |&c: &u32| !self.differs(&self.nodes[c as usize], criterion);
                if leaves && children.iter().all(settled) && !self.differs(&node, criterion) {
                    self.nodes[at].leaf = true;
                    for child in children {
                        let child_node = &mut self.nodes[child as usize];
                        (child_node.leaf, child_node.mark) = (false, false);
                        [child_node.sw, child_node.se, child_node.nw, child_node.ne] = [NONE; 4];
                    }
                    merges += 1;
                }
            }
        }
        [splits, merges]
    }

    /// The leaf at (u, v); beyond the border that of the nearest place.
    pub fn leaf_at(&self, u: f64, v: f64) -> &Node {
        let mut node = &self.nodes[0];
        while !node.leaf {
            node = &self.nodes[node.children()[quarter(node, u, v)] as usize];
        }
        node
    }

    /// Illuminance at a corner of a leaf of this width: the mean of the leaves around it. On the
    /// border it goes on as straight as from the corner within to the middle of the leaves there.
    fn corner(&self, u: f64, v: f64, width: f64) -> f64 {
        // Less than half of a leaf of level 28.
        let near = 1e-9;
        let inward = |x: f64| {
            if x <= 0.0 {
                1.0
            } else if x >= 1.0 {
                -1.0
            } else {
                0.0
            }
        };
        let (du, dv) = (inward(u), inward(v));
        let mut mean = 0.0;
        for [i, j] in [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]] {
            let leaf = self.leaf_at(u + near * i, v + near * j);
            mean += 0.25 * leaf.power / leaf.area;
        }
        if (du, dv) == (0.0, 0.0) || width >= 0.5 {
            return mean;
        }
        let within = self.corner(u + du * width, v + dv * width, width);
        (2.0 * mean - within).max(0.0)
    }

    /// The texture: illuminance at the centres of `width` x `height` texels, rows from v = 0 on,
    /// lux. Bilinear within each leaf between its corners.
    pub fn texture(&self, width: usize, height: usize) -> Vec<f32> {
        let mut texels = Vec::with_capacity(width * height);
        for j in 0..height {
            for i in 0..width {
                let (u, v) = (
                    (i as f64 + 0.5) / width as f64,
                    (j as f64 + 0.5) / height as f64,
                );
                let leaf = self.leaf_at(u, v);
                let w = leaf.width();
                let (s, t) = ((u - leaf.u0) / w, (v - leaf.v0) / w);
                let at = |a: f64, b: f64| self.corner(leaf.u0 + a * w, leaf.v0 + b * w, w);
                let low = at(0.0, 0.0) * (1.0 - s) + at(1.0, 0.0) * s;
                let high = at(0.0, 1.0) * (1.0 - s) + at(1.0, 1.0) * s;
                texels.push((low * (1.0 - t) + high * t) as f32);
            }
        }
        texels
    }
}

/// Which child holds (u, v), in the order sw, se, nw, ne.
fn quarter(node: &Node, u: f64, v: f64) -> usize {
    let half = 0.5 * node.width();
    usize::from(u >= node.u0 + half) + 2 * usize::from(v >= node.v0 + half)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CRITERION: Criterion = Criterion {
        contrast: 0.02,
        deviations: 3.0,
        most_level: 5,
    };

    /// Places of the R2 sequence [Roberts18].
    fn places(count: usize) -> impl Iterator<Item = (f64, f64)> {
        const G: f64 = 1.324_717_957_244_746;
        (1..=count).map(|i| ((i as f64 / G).fract(), (i as f64 / (G * G)).fract()))
    }

    #[test]
    fn power_of_leaves_is_that_of_all_photons_through_splits_and_merges() {
        let mut tree = RexTree::new(6.0);
        let (mut power, mut count, mut done) = (0.0, 0, [0, 0]);
        for round in 0..8 {
            for (u, v) in places(20_000) {
                // Half of it is four times as bright at first; later the other half catches up.
                let bright = (u < 0.3) == (round < 4);
                let p = if bright { 4e-3 } else { 1e-3 };
                tree.deposit(u, v, p);
                power += p;
                count += 1;
            }
            let now = tree.adapt(&CRITERION);
            done = [done[0] + now[0], done[1] + now[1]];
            let sum: f64 = tree.leaves().map(|n| n.power).sum();
            // f64 rounding of 160,000 terms.
            assert!(
                (sum - power).abs() < 1e-9 * power,
                "round {round}: {sum} of {power}"
            );
            assert_eq!(tree.leaves().map(|n| n.count).sum::<u64>(), count);
            let area: f64 = tree.leaves().map(|n| n.area).sum();
            assert!((area - 6.0).abs() < 1e-12);
        }
        assert!(done[0] > 10 && done[1] > 0, "splits and merges: {done:?}");
    }

    #[test]
    fn leaves_are_small_at_the_step_only() {
        let mut tree = RexTree::new(1.0);
        // A level a lot of photons, and more lots until counts tell the last from noise.
        for _ in 0..16 {
            for (u, v) in places(50_000) {
                tree.deposit(u, v, if u < 0.3 { 2e-5 } else { 1e-5 });
            }
            tree.adapt(&CRITERION);
        }
        let at = |u: f64| tree.leaf_at(u, 0.6).level;
        assert_eq!(at(0.299), CRITERION.most_level);
        assert!(at(0.9) <= 2, "{}", at(0.9));
    }

    #[test]
    fn texture_and_mesh_show_the_same_smooth_light() {
        // A bulb 1.2 m above a square of 1 m: I cos / d². A mesh of 32 x 32 cells, linear between
        // exact vertices, and a texture of 32 x 32 leaves over which photons are spread evenly,
        // each with the power of its place: the noise left is that of the sequence.
        let lux = |u: f64, v: f64| {
            let (x, y) = (u - 0.3, v - 0.6);
            let square = x * x + y * y + 1.44;
            1000.0 * 1.2 / (square * square.sqrt())
        };
        let mut tree = RexTree::new(1.0);
        let always = Criterion {
            contrast: -1.0,
            deviations: 0.0,
            most_level: 5,
        };
        // Split first, so that no leaf holds evenly shared power.
        for (u, v) in [(0.2, 0.2), (0.8, 0.2), (0.2, 0.8), (0.8, 0.8)] {
            tree.deposit(u, v, 1e-30);
        }
        (0..5).for_each(|_| {
            tree.adapt(&always);
        });
        assert_eq!(tree.leaves().count(), 32 * 32);
        const PHOTONS: usize = 1 << 22;
        for (u, v) in places(PHOTONS) {
            tree.deposit(u, v, lux(u, v) / PHOTONS as f64);
        }
        const N: usize = 128;
        let texture = tree.texture(N, N);
        let (mut most, cell) = (0.0f64, 1.0 / 32.0);
        for j in 0..N {
            for i in 0..N {
                let (u, v) = ((i as f64 + 0.5) / N as f64, (j as f64 + 0.5) / N as f64);
                let (a, b) = ((u / cell).floor() * cell, (v / cell).floor() * cell);
                let (s, t) = ((u - a) / cell, (v - b) / cell);
                let mesh = (lux(a, b) * (1.0 - s) + lux(a + cell, b) * s) * (1.0 - t)
                    + (lux(a, b + cell) * (1.0 - s) + lux(a + cell, b + cell) * s) * t;
                // Exposure multiplies both: what counts is the share of the local value.
                most = most.max((texture[j * N + i] as f64 / mesh - 1.0).abs());
            }
        }
        assert!(most < 1.0 / 255.0, "{most}");
    }
}
