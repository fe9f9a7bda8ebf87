//! Rays and form factors: geometry only, no reflectance and no emission.

pub mod contract;

pub use contract::{Arrival, FactorRow, FormFactors, Hit, LocalLines, Ray, RayCaster};
