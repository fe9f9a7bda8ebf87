//! The mesh strategies by name, and settings that suit a scene.

use crate::adaptive::Adaptive;
use crate::contract::{MeshSettings, Strategy};
use crate::dense::Dense;
use crate::prepare::PrepareSettings;
use crate::rex::Rex;
use crate::sides::{SIDES, lit_side};
use crate::uniform::Uniform;
use luxel_core::Scene;

/// A mesh strategy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Elements of about one size.
    Uniform,
    /// Uniform with nine elements where `Uniform` has five.
    Dense,
    /// Uniform at first, then split where neighbours differ.
    Adaptive,
    /// Adaptive between the limits of umbra and penumbra, along which elements end.
    Discontinuity,
    /// Radiosity textures: coarse at first, split and merged by the light in each leaf.
    Rex,
}

impl Kind {
    /// All strategies.
    pub const ALL: [Kind; 5] = [
        Kind::Uniform,
        Kind::Dense,
        Kind::Adaptive,
        Kind::Discontinuity,
        Kind::Rex,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Uniform => "uniform",
            Kind::Dense => "dense",
            Kind::Adaptive => "adaptive",
            Kind::Discontinuity => "discontinuity",
            Kind::Rex => "rex",
        }
    }

    /// The strategy of that name.
    pub fn parse(name: &str) -> Option<Kind> {
        Kind::ALL.into_iter().find(|k| k.name() == name)
    }

    /// A strategy ready to start.
    pub fn build(self, settings: MeshSettings) -> Box<dyn Strategy> {
        match self {
            Kind::Uniform => Box::new(Uniform::new(settings)),
            Kind::Dense => Box::new(Dense::new(settings)),
            Kind::Adaptive => Box::new(Adaptive::new(settings)),
            // Its lines are in the scene that `prepare` made.
            Kind::Discontinuity => Box::new(Adaptive::new(settings)),
            Kind::Rex => Box::new(Rex::new(settings)),
        }
    }

    /// How a scene is to be [prepared](crate::prepare()) for this strategy.
    pub fn prepare(self, settings: &MeshSettings) -> PrepareSettings {
        PrepareSettings {
            shadows: (self == Kind::Discontinuity).then_some(*settings),
            ..PrepareSettings::for_mesh(settings)
        }
    }
}

impl MeshSettings {
    /// Settings that give about `target_elements` elements at first.
    ///
    /// Elements share the lit sides' area evenly, but no flat region has more than
    /// [`MOST_IN_REGION`] of them; refinement may go to an eighth of their edge but not below
    /// 1 cm, and to four times their number.
    pub fn for_scene(scene: &Scene, target_elements: usize) -> MeshSettings {
        let target = target_elements.max(1);
        let areas = lit_areas(scene);
        // A triangle stands for half a region: most large ones are rectangles.
        let most = 0.5 * MOST_IN_REGION * target as f64;
        let count = |max: f64| areas.iter().map(|a| (a / max).min(most)).sum::<f64>();
        let whole: f64 = areas.iter().sum();
        let mut max_area_m2 = if whole > 0.0 {
            whole / target as f64
        } else {
            1.0
        };
        // Where a few triangles are nearly everything, nothing can make up for their limit.
        if areas.len() > FEW_TRIANGLES {
            let (mut low, mut high) = (1e-3 * max_area_m2, max_area_m2);
            for _ in 0..40 {
                let middle = (low * high).sqrt();
                if count(middle) > target as f64 {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            max_area_m2 = high;
        }
        let max_area_m2 = max_area_m2 as f32;
        MeshSettings {
            max_area_m2,
            min_edge_m: (max_area_m2.sqrt() / 8.0).max(0.01),
            max_elements: target.saturating_mul(4),
            max_per_region: if areas.len() > FEW_TRIANGLES {
                (MOST_IN_REGION * target as f64).ceil() as usize
            } else {
                usize::MAX
            },
            cluster: true,
        }
    }
}

/// Largest share of the wanted elements in one flat region.
const MOST_IN_REGION: f64 = 0.5;
/// Of so few triangles, all are looked at.
const FEW_TRIANGLES: usize = 64;

/// Area of all sides that reflect or emit, m².
pub fn lit_area(scene: &Scene) -> f64 {
    lit_areas(scene).iter().sum()
}

/// The same for each triangle that has one.
fn lit_areas(scene: &Scene) -> Vec<f64> {
    scene
        .surfaces
        .iter()
        .flat_map(|s| {
            let finish = &scene.finishes[s.finish.index()];
            let sides = SIDES
                .iter()
                .filter(|&&side| lit_side(finish, side).is_some())
                .count();
            let triangles = if sides > 0 { s.triangles.clone() } else { 0..0 };
            triangles.map(move |t| sides as f64 * scene.area(t as usize) as f64)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_parsed_back() {
        for kind in Kind::ALL {
            assert_eq!(Kind::parse(kind.name()), Some(kind));
        }
        assert_eq!(Kind::parse("marching"), None);
    }
}
