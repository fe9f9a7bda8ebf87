//! Rays and form factors: geometry only, no reflectance and no emission.

pub mod constant;
pub mod contract;
pub mod lines;
pub mod sampling;

pub use constant::Constant;
pub use contract::{Arrival, FactorRow, FormFactors, Hit, LocalLines, Ray, RayCaster};
pub use lines::{FactorLines, FrontLines};
pub use sampling::Sequence;
