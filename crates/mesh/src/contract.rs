//! What a mesh strategy is given and what it promises.

use luxel_core::{Front, FrontChange, RefinementWish, Scene, Solution};

/// How fine a mesh may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshSettings {
    /// Largest area of an element, m².
    pub max_area_m2: f32,
    /// Smallest edge of an element, metres: refinement stops there.
    pub min_edge_m: f32,
    /// Most elements.
    pub max_elements: usize,
    /// Most elements of one flat region at first: a lawn of hectares around a room has larger
    /// elements than the room.
    pub max_per_region: usize,
    /// Whether triangles much smaller than an element share one (clusters).
    pub cluster: bool,
}

/// A mesh strategy: makes the first front and, if it adapts, the next ones.
///
/// Every triangle side that reflects or emits belongs to exactly one patch; sides that do
/// neither have none. Same front for any thread count.
pub trait Strategy: Send {
    /// The first front.
    fn initial(&mut self, scene: &Scene) -> Front;

    /// The next front, or `None` when the strategy has nothing to refine.
    fn refine(
        &mut self,
        scene: &Scene,
        front: &Front,
        solution: &Solution,
        wish: &RefinementWish,
    ) -> Option<(Front, FrontChange)>;
}
