//! Rays and form factors: geometry only, no reflectance and no emission.

mod arena;
mod build;
pub mod bvh;
pub mod constant;
pub mod contract;
#[cfg(target_arch = "x86_64")]
mod kernel_avx2;
mod kernel_portable;
mod lanes;
pub mod lines;
mod packet;
pub mod sampling;
mod traverse;

pub use bvh::{Bvh, Kernel};
pub use constant::Constant;
pub use contract::{Arrival, FactorRow, FormFactors, Hit, LocalLines, Ray, RayCaster};
pub use lines::{FactorLines, FrontLines};
pub use sampling::Sequence;
