//! The radiosity equation between elements: axis B of the hybrids table.
//!
//! B_i = E_i + rho_i sum_j F_ij B_j, where F_ij is the fraction of the flux leaving i that
//! reaches j. Every solver is a [`Solver`]: it steps, can be watched and stopped between steps,
//! and restarts from the residual after a change of front.

pub mod ambient;
pub mod balance;
pub mod contract;
pub mod direct;
pub mod gauss_seidel;
pub mod haar_wavelet;
pub mod hierarchical;
pub mod importance;
pub mod jacobi;
pub mod kinds;
mod line_pass;
pub mod linear_wavelet;
pub mod link_solver;
pub mod monte_carlo_shooting;
mod photometry;
pub mod southwell;
pub mod stochastic_jacobi;
mod sweep;

pub use balance::{Account, EnergyBalance};
pub use contract::{Problem, Progress, Solver, Transport};
pub use direct::Direct;
pub use gauss_seidel::GaussSeidel;
pub use jacobi::Jacobi;
pub use kinds::{Kind, SolverSettings};
pub use link_solver::LinkSolver;
pub use monte_carlo_shooting::MonteCarloShooting;
pub use southwell::Southwell;
pub use stochastic_jacobi::StochasticJacobi;
