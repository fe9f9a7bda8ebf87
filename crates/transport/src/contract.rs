//! The contracts of transport: what a ray engine, a form-factor provider and a source of
//! random lines, and of the geometry between clusters promise to those who solve, gather and mesh.
//! All take batches, so that one dynamic call does much work.

use luxel_core::{DVec3, ElementId, Hierarchy, Side, Vec3};
use std::ops::Range;

/// A ray or segment: points `origin + t direction` for `t_min < t <= t_max`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Ray {
    /// Start, metres.
    pub origin: Vec3,
    /// Smallest parameter that counts.
    pub t_min: f32,
    /// Direction, any length but zero. `t` counts in its length.
    pub direction: Vec3,
    /// Largest parameter that counts.
    pub t_max: f32,
}

/// The nearest crossing of a ray with the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Ray parameter of the crossing; infinite if there is none.
    pub t: f32,
    /// Source triangle; [`Hit::NOTHING`] if there is none.
    pub triangle: u32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2.
    pub v: f32,
    /// Side that was struck.
    pub side: Side,
}

impl Hit {
    /// `triangle` of a ray that left the scene.
    pub const NOTHING: u32 = u32::MAX;

    /// The answer for a ray that left the scene.
    pub const MISS: Hit = Hit {
        t: f32::INFINITY,
        triangle: Hit::NOTHING,
        u: 0.0,
        v: 0.0,
        side: Side::Front,
    };

    /// Whether something was struck.
    #[inline]
    pub fn is_hit(&self) -> bool {
        self.triangle != Hit::NOTHING
    }
}

/// A ray engine over the source triangles of one scene.
///
/// Edge-consistent: a ray cannot slip between two triangles that share an edge. Answers are the
/// same for any batch size and thread count. Triangles of clear glass are not there; masked
/// texels are holes.
pub trait RayCaster: Sync + Send {
    /// Nearest crossing of each ray. `hits[k]` belongs to `rays[k]`.
    ///
    /// A surface with partial coverage stops a ray or lets it through by a hash of the ray, in
    /// proportion to its coverage.
    fn closest(&self, rays: &[Ray], hits: &mut [Hit]);

    /// Share of light that passes along each segment: 0 blocked, 1 free, in between through
    /// partial coverage.
    fn visibility(&self, segments: &[Ray], visible: &mut [f32]);

    /// How far to move the start of a ray off its surface along the normal, metres, so that
    /// rounding cannot put it behind: a few units in the last place of the largest coordinate.
    fn offset_m(&self) -> f32;
}

/// One row of form factors: where the flux that leaves an element goes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FactorRow {
    /// Receivers and their share, F_ij > 0, in ascending order of element, each at most once.
    pub entries: Vec<(ElementId, f64)>,
    /// Share that leaves the scene.
    pub outside: f64,
}

impl FactorRow {
    /// Sum over all receivers and outside. 1 for exact factors in a scene whose hidden sides
    /// are all elements; what is missing fell on black sides or is the estimate's defect.
    pub fn closure(&self) -> f64 {
        self.entries.iter().map(|e| e.1).sum::<f64>() + self.outside
    }
}

/// Form factors between the elements of one front.
///
/// `row(i)` is F_ij, the fraction of the flux leaving i that reaches j. Columns follow by
/// reciprocity, A_i F_ij = A_j F_ji, so gathering and shooting use one estimate.
pub trait FormFactors: Sync + Send {
    /// Number of elements.
    fn len(&self) -> usize;

    /// Whether there is no element.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Replaces `row` by the factors from `element`.
    fn row(&self, element: ElementId, row: &mut FactorRow);
}

/// Where a line from an element ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct Arrival(u32);

impl Arrival {
    /// The line left the scene.
    pub const OUTSIDE: Arrival = Arrival(u32::MAX);
    /// The line ended on a side that reflects nothing and is no element.
    pub const BLACK: Arrival = Arrival(u32::MAX - 1);

    /// The line ended on an element.
    #[inline]
    pub fn on(element: ElementId) -> Arrival {
        debug_assert!(element.0 < Arrival::BLACK.0);
        Arrival(element.0)
    }

    /// The element, if it ended on one.
    #[inline]
    pub fn element(self) -> Option<ElementId> {
        if self.0 < Arrival::BLACK.0 {
            Some(ElementId(self.0))
        } else {
            None
        }
    }
}

/// Elements with the arrivals of their lines, from one [`LocalLines::cast_each`].
pub fn of_each<'a>(
    runs: &'a [(ElementId, Range<u32>)],
    mut arrivals: &'a [Arrival],
) -> impl Iterator<Item = (ElementId, &'a [Arrival])> {
    runs.iter().map(move |(element, samples)| {
        let own;
        (own, arrivals) = arrivals.split_at(samples.len());
        (*element, own)
    })
}

/// Local lines: cosine-distributed lines from uniform points of an element, so that the share
/// of lines from i that arrive on j tends to F_ij [Bekaert99].
pub trait LocalLines: Sync + Send {
    /// Number of elements.
    fn len(&self) -> usize;

    /// Whether there is no element.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Casts lines of several elements: of each run those with the numbers `samples` in the
    /// low-discrepancy sequence that belongs to (element, `seed`). `arrivals` is replaced, one
    /// entry a line, in order. Any run of a power of two samples is well spread.
    ///
    /// Long lists cost less a line than short ones.
    fn cast_each(&self, runs: &[(ElementId, Range<u32>)], seed: u32, arrivals: &mut Vec<Arrival>);

    /// Casts lines of one element, as [`LocalLines::cast_each`].
    fn cast(
        &self,
        element: ElementId,
        samples: Range<u32>,
        seed: u32,
        arrivals: &mut Vec<Arrival>,
    ) {
        self.cast_each(&[(element, samples)], seed, arrivals);
    }
}

/// The kernel between one point of a node and one of another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KernelSample {
    /// Where the points are: elements, as indices into [`Hierarchy::order`].
    pub at: [u32; 2],
    /// The points, metres.
    pub points: [DVec3; 2],
    /// cos cos' / (pi r^2), without occlusion, 1/m².
    pub kernel: f64,
    /// Share of the light that passes between the points, 0..=1.
    pub visible: f64,
    /// Weight in a mean over the two nodes; only ratios matter.
    pub weight: f64,
}

/// Geometry between any two nodes of a tree over the elements, for solvers that link clusters.
///
/// Between two elements the exchange is final, the very one that [`FormFactors`] of this kind
/// store: a solver that refines to elements everywhere solves the same system.
pub trait NodeFactors: Sync + Send {
    /// The tree. Its leaves hold one element each.
    fn hierarchy(&self) -> &Hierarchy;

    /// Local lines of the same elements.
    fn lines(&self) -> &dyn LocalLines;

    /// A_i F_ij, m², of each pair of elements; the same for either order. `out` is replaced.
    fn exchange(&self, pairs: &[(ElementId, ElementId)], out: &mut Vec<f64>);

    /// No kernel between a point of node `p` and one of node `q` is above this, 1/m²: infinite
    /// where they touch; 0 proves that they see nothing of each other.
    fn most(&self, p: usize, q: usize) -> f64;

    /// Replaces `samples` by about `count` samples of the kernel, well spread over both nodes.
    /// Whether these are all that there is, so that nothing is left to chance. The same for the
    /// same pair.
    fn sample(&self, p: usize, q: usize, count: u32, samples: &mut Vec<KernelSample>) -> bool;

    /// Centre of each element, metres.
    fn centres(&self) -> Vec<DVec3>;

    /// Share of each element's flux that leaves the scene.
    fn outside(&self) -> Vec<f64>;
}
