//! Solving over links between the nodes of a tree: what hierarchical and wavelet radiosity share.
//!
//! The tree is that of any front, from one root over all surfaces to single elements; it starts
//! with one link from the root to itself. A step
//!
//! 1. *refines*: a link whose error times the power over it, in the worse of both directions,
//!    is above a threshold is replaced by links between children; each step lowers the threshold.
//!    A pair that provably sees nothing of each other has no link, and a pair of elements has
//!    the exchange that a matrix would hold, without error;
//! 2. *sweeps*: every node gathers over its links; what arrives is pushed down to the elements,
//!    B = E + rho H there, and flux is pulled up again; until sweeps change less than links err.
//!
//! Links hold kernels K(x, y) in 1/m², so H_i = sum over links of K A_q B_q, and serve both
//! directions. What is stated as error is the bound over the links of every element, as if all
//! had the same sign, with its further bounces, plus what sweeps still change.
//!
//! How a link is fitted and judged is a [`Method`]. The bits do not depend on threads: links are
//! kept in the order of refinement, and every node adds its own in that order.
//!
//! Sources: [Hanrahan91], section 4; [Smits94]; [Gortler93], section 6. Differs: every link
//! serves both directions, so it is refined for the worse.

use crate::contract::{Problem, Progress, Solver, Transport};
use crate::photometry::{
    F32_RESOLUTION, absolute, absolute_flux, has_outside, luminance, reflectance, relative_bound,
    rho, share, solution, widened,
};
use crate::sweep::carry;
use luxel_core::hierarchy::Node;
use luxel_core::{Buckets, DVec3, ElementId, FrontChange, Hierarchy, Solution};
use luxel_transport::{KernelSample, NodeFactors};
use rayon::prelude::*;

/// Flux that a link may misplace in the first step, as a share of what is emitted.
const FIRST_THRESHOLD: f64 = 0.02;

/// What a step makes of the threshold.
const TIGHTEN: f64 = 0.25;

/// Sweeps of one step: more wait for the next, so that a step stays short.
const MOST_SWEEPS: u32 = 24;

/// Sweeps end when they change this share of what links err.
const SWEEPS_TO_LINKS: f64 = 0.1;

/// Links are not refined beyond this many: 64 bytes each with their places in two lists.
const MOST_LINKS: usize = 1 << 24;

/// Links of one task. Independent of the thread count.
const CHUNK: usize = 64;

/// How links are fitted and judged.
#[derive(Clone, Copy, Debug)]
pub struct Method {
    /// Name of the solver.
    pub name: &'static str,
    pub(crate) fit: fn(&Ends<'_>, &[KernelSample], f64) -> Fitted,
    /// Samples of a kernel.
    pub(crate) samples: u32,
    /// Whether nodes carry first moments.
    pub(crate) is_linear: bool,
}

/// The two nodes of a link.
pub(crate) struct Ends<'a> {
    /// Centres of area, metres.
    pub centres: [DVec3; 2],
    /// Extents, metres.
    pub sizes: [f64; 2],
    /// Places in the tree's order where the children begin.
    pub children: [&'a [u32]; 2],
}

impl Ends<'_> {
    /// Which child of `end` a sample fell on; 0 for an element.
    pub fn child(&self, end: usize, sample: &KernelSample) -> usize {
        let begins = self.children[end];
        begins
            .partition_point(|first| *first <= sample.at[end])
            .saturating_sub(1)
    }
}

/// Kernel of a link: `mean` + `slopes[0]` . (x - x_0) + `slopes[1]` . (y - y_0), 1/m².
pub(crate) struct Fitted {
    pub mean: f64,
    pub slopes: [[f64; 3]; 2],
    /// By how much the kernel may be off anywhere.
    pub error: f64,
}

#[derive(Clone, Copy, Debug)]
struct Link {
    ends: [u32; 2],
    mean: f64,
    error: f64,
    slopes: [[f32; 3]; 2],
}

/// What the solver knows of the tree.
#[derive(Clone, Debug, Default)]
struct Tree {
    nodes: Vec<Node>,
    order: Vec<ElementId>,
    area: Vec<f64>,
    centre: Vec<DVec3>,
    /// Diagonal of the bounds, metres.
    size: Vec<f64>,
    /// Photometric reflectance, greatest below.
    reflectance: Vec<f64>,
    /// Importance, greatest below.
    importance: Vec<f64>,
    /// Where the children of each node begin in the order.
    begins: Vec<Vec<u32>>,
}

/// Radiosity over links, by one of several methods.
#[derive(Clone, Debug)]
pub struct LinkSolver {
    method: Method,
    tree: Tree,
    links: Vec<Link>,
    /// Links of each node.
    of: Buckets,
    /// Ends of all links: what a sweep uses.
    used: u64,
    exitance: Vec<f64>,
    change: Vec<f64>,
    /// E and what of the outside is reflected at once.
    first: Vec<f64>,
    /// Share of the emitted flux that a link may misplace.
    threshold: f64,
    /// Error that links must have before the next sweep: that of a carried solution.
    aim: f64,
    /// Whether tree and links are those of the problem.
    is_begun: bool,
    /// Nothing is left to refine.
    is_exhausted: bool,
    progress: Progress,
}

impl LinkSolver {
    /// A solver at its start.
    pub fn new(method: Method) -> Self {
        LinkSolver {
            method,
            tree: Tree::default(),
            links: Vec::new(),
            of: Buckets::default(),
            used: 0,
            exitance: Vec::new(),
            change: Vec::new(),
            first: Vec::new(),
            threshold: FIRST_THRESHOLD,
            aim: f64::INFINITY,
            is_begun: false,
            is_exhausted: false,
            progress: Progress::default(),
        }
    }

    /// Values of a node: flux a column, and its first moments.
    fn stride(&self, problem: &Problem<'_>) -> usize {
        problem.columns() * if self.method.is_linear { 4 } else { 1 }
    }

    fn begin(&mut self, problem: &Problem<'_>, nodes: &dyn NodeFactors) {
        let columns = problem.columns();
        self.tree = Tree::new(problem, nodes);
        self.first = problem.emission.to_vec();
        if has_outside(problem) {
            for (i, seen) in nodes.outside().into_iter().enumerate() {
                for (k, o) in problem.outside.iter().enumerate() {
                    self.first[i * columns + k] += rho(problem, i, k) * seen * o;
                }
            }
        }
        if self.exitance.len() != self.first.len() {
            self.exitance = self.first.clone();
            self.change = self.first.clone();
        }
        self.threshold = FIRST_THRESHOLD;
        self.links.clear();
        if !self.tree.nodes.is_empty() {
            self.links = self.evaluate(nodes, &[[0, 0]]);
        }
        self.is_begun = true;
        self.is_exhausted = false;
    }

    /// Links between pairs of nodes, in order; none where nothing is seen.
    fn evaluate(&mut self, nodes: &dyn NodeFactors, pairs: &[[u32; 2]]) -> Vec<Link> {
        let (tree, method) = (&self.tree, &self.method);
        let parts: Vec<(Vec<Link>, u64)> = pairs
            .par_chunks(CHUNK)
            .map(|pairs| {
                let mut links = Vec::new();
                let (mut samples, mut exact, mut work) = (Vec::new(), Vec::new(), 0);
                for &ends in pairs {
                    let [p, q] = ends.map(|e| e as usize);
                    let product = tree.area[p] * tree.area[q];
                    if product <= 0.0 {
                        continue;
                    }
                    let mut link = Link {
                        ends,
                        mean: 0.0,
                        error: 0.0,
                        slopes: [[0.0; 3]; 2],
                    };
                    if tree.is_element(p) && tree.is_element(q) {
                        nodes.exchange(&[(tree.element(p), tree.element(q))], &mut exact);
                        link.mean = exact.first().copied().unwrap_or(0.0) / product;
                        work += 1;
                        if link.mean > 0.0 {
                            links.push(link);
                        }
                        continue;
                    }
                    let most = nodes.most(p, q);
                    if most <= 0.0 {
                        continue;
                    }
                    let complete = nodes.sample(p, q, method.samples, &mut samples);
                    work += samples.len() as u64;
                    let fitted = (method.fit)(
                        &tree.ends(p, q),
                        &samples,
                        unseen(tree, p, q, most, &samples, complete),
                    );
                    link.mean = fitted.mean;
                    link.error = fitted.error;
                    link.slopes = fitted.slopes.map(|s| s.map(|v| v as f32));
                    links.push(link);
                }
                (links, work)
            })
            .collect();
        let mut all = Vec::with_capacity(pairs.len());
        for (links, work) in parts {
            all.extend(links);
            self.progress.work += work;
        }
        all
    }

    /// Refines all links that misplace more flux than the threshold allows.
    fn refine(&mut self, problem: &Problem<'_>, nodes: &dyn NodeFactors) {
        let columns = problem.columns();
        // What is emitted and what has been found: a room where light stays has more of it.
        let whole = absolute_flux(problem.area, &self.first, columns);
        let allowed = self.threshold * whole;
        let power = self.tree.power(&self.exitance, columns);
        self.is_exhausted = true;
        let mut kept = Vec::with_capacity(self.links.len());
        let mut open = std::mem::take(&mut self.links);
        while !open.is_empty() {
            let mut pairs = Vec::new();
            let room = kept.len() + open.len() < MOST_LINKS;
            for link in open {
                let [p, q] = link.ends.map(|e| e as usize);
                let refinable =
                    link.error > 0.0 && !(self.tree.is_element(p) && self.tree.is_element(q));
                self.is_exhausted &= !refinable;
                if refinable && room && self.tree.misplaced(&link, &power) > allowed {
                    self.tree.children_of(p, q, &mut pairs);
                } else {
                    kept.push(link);
                }
            }
            open = self.evaluate(nodes, &pairs);
        }
        self.is_exhausted |= kept.len() >= MOST_LINKS;
        self.links = kept;
    }

    /// Lists the links of every node.
    fn index(&mut self) {
        let ends = self.links.iter().zip(0..).flat_map(|(link, k)| {
            let [p, q] = link.ends.map(|e| e as usize);
            let both = [Some((p, k)), (p != q).then_some((q, k))];
            both.into_iter().flatten()
        });
        self.used = ends.clone().count() as u64;
        self.of = Buckets::new(self.tree.nodes.len(), ends);
    }

    /// The other end of a link of `node`, and the slopes at this end and at the other.
    fn across(link: &Link, node: usize) -> (usize, &[f32; 3], &[f32; 3]) {
        let near = usize::from(link.ends[0] as usize != node);
        let far = 1 - near;
        (
            link.ends[far] as usize,
            &link.slopes[near],
            &link.slopes[far],
        )
    }

    /// One sweep: gather over links, push, reflect, pull.
    fn sweep(&mut self, problem: &Problem<'_>) {
        let columns = problem.columns();
        let stride = self.stride(problem);
        let sent = self.tree.pulled(&self.exitance, columns, stride);
        let mut arrived = vec![0.0; self.tree.nodes.len() * stride];
        arrived
            .par_chunks_mut(stride)
            .enumerate()
            .for_each(|(node, sum)| {
                for &k in self.of.of(node) {
                    let link = &self.links[k as usize];
                    let (other, near, far) = Self::across(link, node);
                    let sent = &sent[other * stride..(other + 1) * stride];
                    for c in 0..columns {
                        sum[c] += link.mean * sent[c];
                    }
                    if stride > columns {
                        for c in 0..columns {
                            for d in 0..3 {
                                sum[c] += far[d] as f64 * sent[(d + 1) * columns + c];
                                sum[(d + 1) * columns + c] += near[d] as f64 * sent[c];
                            }
                        }
                    }
                }
            });
        self.tree.push(&mut arrived, columns, stride);
        for leaf in self.tree.leaves() {
            let i = self.tree.element(leaf).index();
            for c in 0..columns {
                let b = i * columns + c;
                let new = self.first[b] + rho(problem, i, c) * arrived[leaf * stride + c];
                self.change[b] = new - self.exitance[b];
                self.exitance[b] = new;
            }
        }
        self.progress.work += self.used;
    }

    /// What the links may be off by, relative, area-weighted RMS with further bounces.
    fn link_error(&self, problem: &Problem<'_>) -> f64 {
        let columns = problem.columns();
        let power = self.tree.power(&self.exitance, columns);
        let mut error: Vec<f64> = (0..self.tree.nodes.len())
            .into_par_iter()
            .map(|node| {
                let off = |k: &u32| {
                    let link = &self.links[*k as usize];
                    link.error * power[Self::across(link, node).0]
                };
                self.of.of(node).iter().map(off).sum()
            })
            .collect();
        self.tree.push(&mut error, 1, 1);
        let (mut square, mut whole, mut reflected, mut area) = (0.0, 0.0, 0.0, 0.0);
        for leaf in self.tree.leaves() {
            let i = self.tree.element(leaf).index();
            let (a, r) = (problem.area[i], reflectance(problem, i));
            let b = luminance(&self.exitance[i * columns..(i + 1) * columns]);
            square += a * (r * error[leaf]).powi(2);
            whole += a * b * b;
            reflected += a * r;
            area += a;
        }
        let bounces = 1.0 / (1.0 - share(reflected, area)).max(1e-3);
        if whole > 0.0 {
            bounces * (square / whole).sqrt()
        } else {
            0.0
        }
    }
}

/// By how much the kernel may be off where no sample fell, 1/m²: as one sample more would say
/// that goes against all the others, by the rule of succession [Laplace1774].
fn unseen(
    tree: &Tree,
    p: usize,
    q: usize,
    most: f64,
    samples: &[KernelSample],
    complete: bool,
) -> f64 {
    if complete {
        return 0.0;
    }
    let found = samples.iter().map(|s| s.kernel).fold(0.0, f64::max);
    let largest = if found > 0.0 {
        found
    } else {
        // No mean kernel is more than the inverse of the larger area: factors are at most 1.
        most.min(1.0 / tree.area[p].max(tree.area[q]))
    };
    largest / (samples.len() + 1) as f64
}

impl Tree {
    fn new(problem: &Problem<'_>, from: &dyn NodeFactors) -> Self {
        let Hierarchy { nodes, order } = from.hierarchy().clone();
        let places = from.centres();
        let n = nodes.len();
        let mut tree = Tree {
            area: vec![0.0; n],
            centre: vec![DVec3::ZERO; n],
            size: nodes
                .iter()
                .map(|n| (n.high - n.low).length() as f64)
                .collect(),
            reflectance: vec![0.0; n],
            importance: vec![0.0; n],
            begins: vec![Vec::new(); n],
            nodes,
            order,
        };
        for at in (0..n).rev() {
            let node = tree.nodes[at];
            let (mut area, mut moment) = (0.0, DVec3::ZERO);
            let (mut reflects, mut matters) = (0.0f64, 0.0f64);
            if node.children == 0 {
                debug_assert_eq!(node.count, 1, "a leaf is one element");
                let i = tree.element(at).index();
                area = problem.area[i];
                moment = problem.area[i] * places[i];
                reflects = reflectance(problem, i);
                matters = problem.importance_of(i);
            }
            for child in node.first_child..node.first_child + node.children {
                let child = child as usize;
                area += tree.area[child];
                moment += tree.area[child] * tree.centre[child];
                reflects = reflects.max(tree.reflectance[child]);
                matters = matters.max(tree.importance[child]);
                tree.begins[at].push(tree.nodes[child].first);
            }
            tree.area[at] = area;
            tree.centre[at] = if area > 0.0 {
                moment / area
            } else {
                DVec3::ZERO
            };
            tree.reflectance[at] = reflects;
            tree.importance[at] = matters;
        }
        tree
    }

    fn is_element(&self, node: usize) -> bool {
        self.nodes[node].children == 0
    }

    fn leaves(&self) -> impl Iterator<Item = usize> {
        (0..self.nodes.len()).filter(|&node| self.is_element(node))
    }

    fn element(&self, leaf: usize) -> ElementId {
        self.order[self.nodes[leaf].first as usize]
    }

    fn ends(&self, p: usize, q: usize) -> Ends<'_> {
        Ends {
            centres: [p, q].map(|e| self.centre[e]),
            sizes: [p, q].map(|e| self.size[e]),
            children: [p, q].map(|e| &self.begins[e][..]),
        }
    }

    /// Pairs that take the place of a link: both ends of a self-link, else the larger end.
    fn children_of(&self, p: usize, q: usize, pairs: &mut Vec<[u32; 2]>) {
        let below = |n: usize| {
            self.nodes[n].first_child..self.nodes[n].first_child + self.nodes[n].children
        };
        if p == q {
            for a in below(p) {
                pairs.extend((a..below(p).end).map(|b| [a, b]));
            }
            return;
        }
        let extent = |n: usize| (self.size[n], self.area[n]);
        let split_p = self.is_element(q) || (!self.is_element(p) && extent(p) >= extent(q));
        if split_p {
            pairs.extend(below(p).map(|a| [a, q as u32]));
        } else {
            pairs.extend(below(q).map(|b| [p as u32, b]));
        }
    }

    /// Flux that a link may put in the wrong place, lm, in the worse direction, as it matters.
    fn misplaced(&self, link: &Link, power: &[f64]) -> f64 {
        let [p, q] = link.ends.map(|e| e as usize);
        let to = |to: usize, from: usize| {
            self.importance[to] * self.reflectance[to] * self.area[to] * power[from]
        };
        link.error * to(p, q).max(to(q, p))
    }

    /// Photometric absolute flux of every node, lm.
    fn power(&self, exitance: &[f64], columns: usize) -> Vec<f64> {
        let mut power = vec![0.0; self.nodes.len()];
        for at in (0..self.nodes.len()).rev() {
            let node = &self.nodes[at];
            if node.children == 0 {
                let i = self.element(at).index();
                power[at] = self.area[at] * absolute(&exitance[i * columns..(i + 1) * columns]);
            }
            for child in node.first_child..node.first_child + node.children {
                power[at] += power[child as usize];
            }
        }
        power
    }

    /// Flux of every node and, if `stride` has room, its first moments about the centre.
    fn pulled(&self, exitance: &[f64], columns: usize, stride: usize) -> Vec<f64> {
        let mut sums = vec![0.0; self.nodes.len() * stride];
        for at in (0..self.nodes.len()).rev() {
            let node = &self.nodes[at];
            if node.children == 0 {
                let i = self.element(at).index();
                for c in 0..columns {
                    sums[at * stride + c] = self.area[at] * exitance[i * columns + c];
                }
            }
            for child in node.first_child..node.first_child + node.children {
                let (above, below) = sums.split_at_mut((at + 1) * stride);
                let sum = &mut above[at * stride..];
                let part = &below[(child as usize - at - 1) * stride..][..stride];
                for (s, v) in sum.iter_mut().zip(part) {
                    *s += v;
                }
                if stride > columns {
                    let moved = (self.centre[child as usize] - self.centre[at]).to_array();
                    for (d, m) in moved.into_iter().enumerate() {
                        for c in 0..columns {
                            sum[(d + 1) * columns + c] += m * part[c];
                        }
                    }
                }
            }
        }
        sums
    }

    /// Adds what arrived at every node to its children, taken at their centres.
    fn push(&self, values: &mut [f64], columns: usize, stride: usize) {
        for (at, node) in self.nodes.iter().enumerate() {
            for child in node.first_child..node.first_child + node.children {
                let (above, below) = values.split_at_mut((at + 1) * stride);
                let whole = &above[at * stride..];
                let part = &mut below[(child as usize - at - 1) * stride..][..stride];
                for (p, v) in part.iter_mut().zip(whole) {
                    *p += v;
                }
                if stride > columns {
                    let moved = (self.centre[child as usize] - self.centre[at]).to_array();
                    for (d, m) in moved.into_iter().enumerate() {
                        for c in 0..columns {
                            part[c] += m * whole[(d + 1) * columns + c];
                        }
                    }
                }
            }
        }
    }
}

impl Solver for LinkSolver {
    fn step(&mut self, problem: &Problem<'_>) -> Progress {
        let Transport::Nodes(nodes) = problem.transport else {
            debug_assert!(false, "{} needs nodes", self.method.name);
            return Progress {
                finished: true,
                relative_error: 1.0,
                ..Progress::default()
            };
        };
        if !self.is_begun || self.exitance.len() != problem.emission.len() {
            self.begin(problem, nodes);
        } else if self.progress.step > 0 {
            self.threshold *= TIGHTEN;
        }
        let mut links;
        loop {
            if !self.is_exhausted {
                self.refine(problem, nodes);
                self.index();
            }
            links = self.link_error(problem);
            // A carried solution must not be taken over coarser links than it was found with.
            if links <= self.aim || self.is_exhausted {
                break;
            }
            self.threshold *= TIGHTEN;
        }
        self.aim = f64::INFINITY;
        let mut left = 0.0;
        for _ in 0..MOST_SWEEPS {
            self.sweep(problem);
            left = relative_bound(problem, &self.exitance, &self.change);
            if left <= (SWEEPS_TO_LINKS * links).max(F32_RESOLUTION) {
                break;
            }
        }
        links = self.link_error(problem);
        let columns = problem.columns();
        let emitted = absolute_flux(problem.area, &self.first, columns);
        let changed = absolute_flux(problem.area, &self.change, columns);
        self.progress.step += 1;
        self.progress.unshot_share = share(changed, emitted);
        self.progress.relative_error = links + left;
        self.progress.finished = self.is_exhausted && left <= F32_RESOLUTION;
        self.progress
    }

    fn solution(&self, problem: &Problem<'_>) -> Solution {
        if self.exitance.is_empty() {
            return solution(problem, problem.emission, problem.emission, 1.0, 0);
        }
        let p = &self.progress;
        let mut found = solution(
            problem,
            &self.exitance,
            &self.change,
            p.unshot_share,
            p.work,
        );
        found.relative_error = p.relative_error as f32;
        found
    }

    /// The tree is another, so links are found anew, as fine as those that the solution had.
    fn restart(&mut self, change: &FrontChange, problem: &Problem<'_>) {
        if self.exitance.is_empty() {
            return;
        }
        self.exitance = carry(change, &self.exitance, problem.columns());
        self.change = carry(change, &self.change, problem.columns());
        self.aim = self.progress.relative_error;
        self.is_begun = false;
    }

    fn resume(&mut self, stored: &Solution, problem: &Problem<'_>) {
        let Some(exitance) = widened(&stored.exitance, problem) else {
            return;
        };
        *self = LinkSolver::new(self.method);
        self.change = widened(&stored.unshot, problem).unwrap_or(vec![0.0; exitance.len()]);
        self.exitance = exitance;
        self.aim = stored.relative_error as f64;
        self.progress = Progress {
            unshot_share: stored.unshot_share as f64,
            relative_error: stored.relative_error as f64,
            work: stored.work,
            ..Progress::default()
        };
    }

    fn links(&self) -> Option<usize> {
        Some(self.links.len())
    }
}
