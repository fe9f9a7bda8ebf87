//! What a user may set, with the defaults that most users keep.

use std::time::Duration;

/// Everything that decides what a [`Session`](crate::Session) computes. The same settings and
/// the same files give the same bits.
#[derive(Clone, Debug)]
pub struct Settings {
    /// How files are read: scale, up axis, backs, limit of reflectance.
    pub read: luxel_io::ReadOptions,
    /// Lamps to add, as `800lm@x,y,z`; each is a group of its own.
    pub lamps: Vec<String>,
    /// Materials made to shine, as `MATERIAL=5000` (cd/m²); each is a group of its own.
    pub emit: Vec<String>,
    /// Luminance of a uniform sky, cd/m².
    pub sky: Option<String>,
    /// Groups put together, as `NAME=a,b,c`.
    pub merge: Vec<String>,
    /// Axis A: how surfaces become elements.
    pub mesh: luxel_mesh::Kind,
    /// Axis B: how the radiosity equation is solved.
    pub solver: luxel_solve::Kind,
    /// Asked relative accuracy of what is shown.
    pub error: f64,
    /// Most time for the solution and the gather together; what is reached by then is written.
    pub time: Option<Duration>,
    /// Elements to aim at; `None` chooses by the scene.
    pub elements: Option<usize>,
    /// Largest edge of an element, metres; `None` follows from the number of elements.
    pub element_edge_m: Option<f64>,
    /// Whether `light` makes lightmaps.
    pub lightmap: bool,
    /// Metres from texel to texel of lightmaps; `None` chooses by the scene.
    pub texel_m: Option<f64>,
    /// Most memory, bytes.
    pub memory: u64,
    /// Seed of every random number.
    pub seed: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            read: luxel_io::ReadOptions::default(),
            lamps: Vec::new(),
            emit: Vec::new(),
            sky: None,
            merge: Vec::new(),
            mesh: luxel_mesh::Kind::Uniform,
            solver: luxel_solve::Kind::StochasticJacobi,
            error: 0.02,
            time: None,
            elements: None,
            element_edge_m: None,
            lightmap: true,
            texel_m: None,
            memory: 4_000_000_000,
            seed: 1,
        }
    }
}

impl Settings {
    /// The settings by name, for the report.
    pub fn to_json(&self) -> serde_json::Map<String, serde_json::Value> {
        use serde_json::json;
        let value = json!({
            "error": self.error,
            "time_s": self.time.map(|t| t.as_secs_f64()),
            "mesh": self.mesh.name(),
            "solver": self.solver.name(),
            "elements": self.elements,
            "element_edge_m": self.element_edge_m,
            "lightmap": self.lightmap,
            "texel_m": self.texel_m,
            "lamps": self.lamps,
            "emit": self.emit,
            "sky": self.sky,
            "merge": self.merge,
            "scale": self.read.scale,
            "max_reflectance": self.read.max_reflectance,
            "memory_bytes": self.memory,
        });
        match value {
            serde_json::Value::Object(map) => map,
            _ => serde_json::Map::new(),
        }
    }
}
