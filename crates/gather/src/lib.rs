//! From the solved elements to anything shown: direct light, final gather, error.
//!
//! [`DirectLights`] knows the lights, [`DirectLights::element_irradiance`] gives a solver its
//! first emission, and [`Gatherer::irradiance_at`] answers at any receiver: one function for
//! every number shown.

mod bright;
pub mod contract;
pub mod element_direct;
mod element_noise;
mod emitter;
pub mod fate;
pub mod gather;
pub mod lights;
mod lottery;
mod nearby;
mod shadow;
mod tree;

pub use contract::{Accuracy, Irradiance, Receiver};
pub use element_direct::ElementDirect;
pub use fate::Fate;
pub use gather::Gatherer;
pub use lights::DirectLights;
