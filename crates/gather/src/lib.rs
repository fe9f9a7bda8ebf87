//! From the solved elements to anything shown: direct light, final gather, error.

pub mod contract;

pub use contract::{Accuracy, Irradiance, Receiver};
