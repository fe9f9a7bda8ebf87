//! What a solver is given and what it promises.

use luxel_core::{FrontChange, Layers, Solution};
use luxel_transport::{FormFactors, LocalLines, NodeFactors};

/// How light gets from element to element.
#[derive(Clone, Copy)]
pub enum Transport<'a> {
    /// Rows of form factors, for the deterministic solvers.
    Factors(&'a dyn FormFactors),
    /// Random lines, for the Monte Carlo solvers.
    Lines(&'a dyn LocalLines),
    /// Geometry between clusters, for the solvers that link them.
    Nodes(&'a dyn NodeFactors),
}

/// The radiosity equation for one front: everything but the state of the solver.
///
/// Element-major arrays; column = 3 * group + band. `f64`, since published iterates are
/// compared to 1e-9.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    /// Names of the columns.
    pub layers: &'a Layers,
    /// Area of each element, m².
    pub area: &'a [f64],
    /// Diffuse reflectance, three bands an element, 0..1.
    pub reflectance: &'a [f64],
    /// What each element gives before any exchange, lm/m², `columns` an element.
    pub emission: &'a [f64],
    /// Exitance of the outside as seen from within (pi times the sky's luminance), one a column.
    pub outside: &'a [f64],
    /// Geometry.
    pub transport: Transport<'a>,
    /// Seed of every random number.
    pub seed: u32,
    /// How much each element matters, above 0, mean 1 by area: what flux that leaves it adds to
    /// what is looked at (see [`crate::importance`]). `None` where all matter alike. It says where
    /// work goes first, never what the answer is.
    pub importance: Option<&'a [f64]>,
}

impl Problem<'_> {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.area.len()
    }

    /// Whether there is no element.
    pub fn is_empty(&self) -> bool {
        self.area.is_empty()
    }

    /// Columns a row.
    pub fn columns(&self) -> usize {
        self.layers.columns()
    }

    /// Importance of element `i`; 1 where none is given.
    pub fn importance_of(&self, i: usize) -> f64 {
        self.importance.map_or(1.0, |w| w[i])
    }
}

/// How far a solver is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Steps done.
    pub step: u32,
    /// Absolute unshot flux as a share of the emitted flux (photometric, all groups); for an
    /// iterative solver the residual's flux. Where all is sent at once: what the sums show to be
    /// missing, as a share of what is there.
    pub unshot_share: f64,
    /// Estimated relative RMS error of element exitance, area-weighted: from independent
    /// estimates for a Monte Carlo solver, a bound from the residual for the others.
    pub relative_error: f64,
    /// Rays cast or form factors used so far.
    pub work: u64,
    /// Whether more steps would not improve the result in f32.
    pub finished: bool,
}

/// A solver of the radiosity equation, resumable step by step.
///
/// The same bits for any thread count. A step is a natural unit of the method: one sweep, one
/// shot or a small batch of shots, one pass of lines.
pub trait Solver: Send {
    /// Does one step on the problem. The problem must be the same from step to step, but for
    /// `restart`.
    fn step(&mut self, problem: &Problem<'_>) -> Progress;

    /// Exitance and signed unshot of the present state; never includes the ambient term.
    fn solution(&self, problem: &Problem<'_>) -> Solution;

    /// One draw of what the photometric exitance of each element is wrong by, lm/m², with the
    /// variance of the solution's noise; empty where there is no noise or nothing is known of it.
    fn noise(&self, _problem: &Problem<'_>) -> Vec<f32> {
        Vec::new()
    }

    /// Carries the state over to a new front and restarts from the residual
    /// E + rho F B - B of the carried solution. `problem` is the new one.
    fn restart(&mut self, change: &FrontChange, problem: &Problem<'_>);

    /// Takes up a stored solution of this very problem, as `--resume` does.
    fn resume(&mut self, stored: &Solution, problem: &Problem<'_>);

    /// Links in force, for a solver that links clusters.
    fn links(&self) -> Option<usize> {
        None
    }
}
