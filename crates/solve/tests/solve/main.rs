//! What the solvers promise, on systems with known answers.

mod balance;
mod common;
mod importance;
mod reference;
mod solvers;
