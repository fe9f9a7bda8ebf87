//! The mesh strategies by name, and settings that suit a scene.

use crate::adaptive::Adaptive;
use crate::contract::{MeshSettings, Strategy};
use crate::dense::Dense;
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
}

impl Kind {
    /// All strategies.
    pub const ALL: [Kind; 3] = [Kind::Uniform, Kind::Dense, Kind::Adaptive];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Uniform => "uniform",
            Kind::Dense => "dense",
            Kind::Adaptive => "adaptive",
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
        }
    }
}

impl MeshSettings {
    /// Settings that give about `target_elements` elements at first.
    ///
    /// Elements share the lit sides' area evenly; refinement may go to an eighth of their edge
    /// but not below 1 cm, and to four times their number.
    pub fn for_scene(scene: &Scene, target_elements: usize) -> MeshSettings {
        let target = target_elements.max(1);
        let area = lit_area(scene);
        let max_area_m2 = if area > 0.0 {
            (area / target as f64) as f32
        } else {
            1.0
        };
        MeshSettings {
            max_area_m2,
            min_edge_m: (max_area_m2.sqrt() / 8.0).max(0.01),
            max_elements: target.saturating_mul(4),
            cluster: true,
        }
    }
}

/// Area of all sides that reflect or emit, m².
pub fn lit_area(scene: &Scene) -> f64 {
    scene
        .surfaces
        .iter()
        .map(|s| {
            let finish = &scene.finishes[s.finish.index()];
            let sides = SIDES
                .iter()
                .filter(|&&side| lit_side(finish, side).is_some())
                .count();
            let area: f64 = s
                .triangles
                .clone()
                .map(|t| scene.area(t as usize) as f64)
                .sum();
            area * sides as f64
        })
        .sum()
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
