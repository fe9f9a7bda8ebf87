//! Higher-density uniform mesh: nine elements along an edge where the uniform mesh has five.
//!
//! Source: [Yeap99], 4.3.2, figure 4.7: the same function over 9 elements instead of 5. The
//! error of a smooth function falls in proportion to the width of an element.

use crate::contract::{MeshSettings, Strategy};
use crate::uniform::mesh;
use luxel_core::{Front, FrontChange, RefinementWish, Scene, Solution};

/// The higher-density uniform strategy: one front, never refined.
#[derive(Clone, Debug)]
pub struct Dense {
    settings: MeshSettings,
}

impl Dense {
    /// With the settings of the uniform mesh that it is denser than.
    pub fn new(settings: MeshSettings) -> Self {
        Dense { settings }
    }
}

/// Elements along an edge that has `n` in a uniform mesh: 5 become 9, 1 becomes 2.
pub fn denser(n: u32) -> u32 {
    (9 * n + 2) / 5
}

impl Strategy for Dense {
    fn initial(&mut self, scene: &Scene) -> Front {
        mesh(scene, &self.settings, denser).0
    }

    fn refine(
        &mut self,
        _: &Scene,
        _: &Front,
        _: &Solution,
        _: &RefinementWish,
    ) -> Option<(Front, FrontChange)> {
        None
    }
}
