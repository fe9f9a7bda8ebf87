//! Luxel computes how light really fills a room, by radiosity.
//!
//! The facade: [`Session`] takes a scene from file to solution, and [`light()`] does the whole
//! main job with its files. The crates below are the pipeline; see ARCHITECTURE.md.

pub mod compare;
mod energy;
pub mod error;
pub mod factors;
pub mod inspect;
pub mod light;
mod lightmap;
mod matter;
pub mod points;
pub mod probe;
pub mod session;
pub mod settings;
mod sites;
mod spare;
pub mod stage;
pub mod units;
pub mod verify;
pub mod watch;
mod work;

pub use compare::{CompareJob, Comparison, compare};
pub use error::Error;
pub use factors::{FactorsJob, FactorsOutcome, factors};
pub use inspect::{Inspection, inspect};
pub use light::{LightJob, Outcome, light};
pub use luxel_core::{DVec3, Scene, Solution, Vec3, Warnings};
pub use luxel_gather::{Accuracy, Irradiance, Receiver};
pub use luxel_io::{Back, Precision, ReadOptions, Up};
pub use luxel_mesh::Kind as MeshKind;
pub use luxel_solve::{Kind as SolverKind, Progress};
pub use probe::{Answer, probe};
pub use session::{Session, read};
pub use settings::Settings;
pub use stage::Stage;
pub use watch::{Control, Status, Watch};

/// More threads than this only wait for each other.
const MOST_THREADS: usize = 256;

/// Uses this many threads for everything; 0 is one for each core. Results do not depend on it.
///
/// To be called before any work; a second call is an error.
pub fn use_threads(threads: usize) -> Result<(), String> {
    if threads > MOST_THREADS {
        return Err(format!("expected at most {MOST_THREADS}, found {threads}"));
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(|e| e.to_string())
}
