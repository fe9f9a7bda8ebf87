//! How a scene file is to be read where the file leaves it open.

use luxel_core::Vec3;

/// Largest luminance (cd/m²), intensity (cd), flux (lm) or illuminance (lx) that is taken as meant:
/// six hundred suns. Sums over any scene stay finite below it.
pub const MOST_LIGHT: f32 = 1e12;

/// Which way is up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Up {
    /// Along y, as glTF says and OBJ usually means.
    Y,
    /// Along z.
    Z,
}

impl Up {
    /// The unit vector.
    pub fn vector(self) -> Vec3 {
        match self {
            Up::Y => Vec3::Y,
            Up::Z => Vec3::Z,
        }
    }
}

/// What the backs of all faces do, whatever the file says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Back {
    /// Backs reflect as fronts do.
    Same,
    /// Backs are black.
    Black,
}

/// How a scene file is read.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadOptions {
    /// Metres for each unit of length in the file. Touches no intensity.
    pub scale: f32,
    /// Overrules the file's up axis. Coordinates are not turned: only [`Scene::up`] changes.
    ///
    /// [`Scene::up`]: luxel_core::Scene::up
    pub up: Option<Up>,
    /// Overrules what backs reflect.
    pub back: Option<Back>,
    /// Largest diffuse reflectance of any band, 0..=1; more is clamped and said.
    ///
    /// 0.98 unless given: the best white coatings reach it, and at 1 light would never end.
    pub max_reflectance: f32,
    /// Bound for what reading may hold at once, bytes.
    pub memory_limit: u64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        ReadOptions {
            scale: 1.0,
            up: None,
            back: None,
            max_reflectance: 0.98,
            memory_limit: 4 << 30,
        }
    }
}
