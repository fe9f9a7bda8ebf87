//! The radiosity equation between elements: axis B of the hybrids table.
//!
//! B_i = E_i + rho_i sum_j F_ij B_j, where F_ij is the fraction of the flux leaving i that
//! reaches j. Every solver is a [`Solver`]: it steps, can be watched and stopped between steps,
//! and restarts from the residual after a change of front.

pub mod contract;

pub use contract::{Problem, Progress, Solver, Transport};
