//! What the solvers promise, on systems with known answers.

mod balance;
mod common;
mod reference;
mod solvers;
