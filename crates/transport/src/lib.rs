//! Rays and form factors: geometry only, no reflectance and no emission.

mod arena;
mod build;
pub mod bvh;
pub mod closed_forms;
pub mod closure_repair;
pub mod constant;
pub mod contract;
pub(crate) mod dilogarithm;
pub mod facets;
pub mod given_nodes;
pub mod hemicube;
#[cfg(target_arch = "x86_64")]
mod kernel_avx2;
mod kernel_portable;
pub mod lambert;
mod lanes;
pub mod lines;
pub mod matrix;
pub mod monte_carlo;
pub mod nodes;
pub mod obstructed;
mod packet;
pub mod polygon_pair;
pub(crate) mod quadrature;
pub mod sampling;
pub mod strings;
#[cfg(test)]
pub(crate) mod testing;
mod traverse;

pub use bvh::{Bvh, Kernel};
pub use closure_repair::{
    Closure, ExchangeAreas, NegativePairs, Repair, RepairOutcome, RepairSettings, repair_closure,
};
pub use constant::Constant;
pub use contract::{
    Arrival, FactorRow, FormFactors, Hit, KernelSample, LocalLines, NodeFactors, Ray, RayCaster,
    of_each,
};
pub use given_nodes::GivenNodes;
pub use hemicube::Hemicube;
pub use lines::{FactorLines, FrontLines};
pub use matrix::{Defects, Exact, Matrix, MatrixSettings};
pub use monte_carlo::{MonteCarloFactors, RowError};
pub use nodes::FrontNodes;
pub use sampling::Sequence;
