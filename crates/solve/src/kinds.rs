//! The solvers by name: axis B of the hybrids table.

use crate::contract::Solver;
use crate::{
    Direct, GaussSeidel, Jacobi, LinkSolver, MonteCarloShooting, Southwell, StochasticJacobi,
};

/// Which solver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Random lines, all power in every pass; the default.
    #[default]
    StochasticJacobi,
    /// Random lines from the elements that still hold unshot flux.
    MonteCarloShooting,
    /// Dense LU.
    Direct,
    /// Gather from the sweep before.
    Jacobi,
    /// Gather, using new values at once.
    GaussSeidel,
    /// Progressive refinement.
    Southwell,
    /// Links between clusters, refined where power times the bounds of the kernel asks for it.
    Hierarchical,
    /// The same with an oracle that measures the Haar wavelets of the kernel.
    HaarWavelet,
    /// Links that carry light linear in place: two vanishing moments.
    LinearWavelet,
}

/// What a user may set about a solver. The default serves rooms from a few elements to millions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverSettings {
    /// Most lines in one step of a Monte Carlo solver; 0 chooses by the number of elements.
    /// Bounds the memory of a step (16 bytes a line) and how long it lasts.
    pub lines_per_step: u32,
    /// Monte Carlo shooting goes on while any element holds more unshot flux than this share
    /// of the emitted flux.
    pub tolerance: f64,
    /// Shots in one step of Southwell, at least 1.
    pub shots_per_step: u32,
}

impl Default for SolverSettings {
    fn default() -> Self {
        SolverSettings {
            lines_per_step: 0,
            tolerance: 1e-4,
            shots_per_step: 1,
        }
    }
}

impl Kind {
    /// All kinds, the default first.
    pub const ALL: [Kind; 9] = [
        Kind::StochasticJacobi,
        Kind::MonteCarloShooting,
        Kind::Direct,
        Kind::Jacobi,
        Kind::GaussSeidel,
        Kind::Southwell,
        Kind::Hierarchical,
        Kind::HaarWavelet,
        Kind::LinearWavelet,
    ];

    /// Name in settings and reports.
    pub fn name(self) -> &'static str {
        match self {
            Kind::StochasticJacobi => "stochastic-jacobi",
            Kind::MonteCarloShooting => "monte-carlo-shooting",
            Kind::Direct => "direct",
            Kind::Jacobi => "jacobi",
            Kind::GaussSeidel => "gauss-seidel",
            Kind::Southwell => "southwell",
            Kind::Hierarchical => "hierarchical",
            Kind::HaarWavelet => "haar-wavelet",
            Kind::LinearWavelet => "linear-wavelet",
        }
    }

    /// The kind of that name; `None` if there is none.
    pub fn parse(name: &str) -> Option<Kind> {
        Kind::ALL.into_iter().find(|k| k.name() == name)
    }

    /// Whether it wants random lines.
    pub fn needs_lines(self) -> bool {
        matches!(self, Kind::StochasticJacobi | Kind::MonteCarloShooting)
    }

    /// Whether it wants the geometry between clusters.
    pub fn needs_nodes(self) -> bool {
        matches!(
            self,
            Kind::Hierarchical | Kind::HaarWavelet | Kind::LinearWavelet
        )
    }

    /// Whether it wants all form factors between elements.
    pub fn needs_factors(self) -> bool {
        !self.needs_lines() && !self.needs_nodes()
    }

    /// Whether it can serve `elements` elements at all.
    pub fn fits(self, elements: usize) -> bool {
        self != Kind::Direct || Direct::fits(elements)
    }

    /// A solver at its start.
    pub fn build(self, settings: SolverSettings) -> Box<dyn Solver> {
        match self {
            Kind::StochasticJacobi => Box::new(StochasticJacobi::new(settings)),
            Kind::MonteCarloShooting => Box::new(MonteCarloShooting::new(settings)),
            Kind::Direct => Box::new(Direct::new()),
            Kind::Jacobi => Box::new(Jacobi::new()),
            Kind::GaussSeidel => Box::new(GaussSeidel::new()),
            Kind::Southwell => Box::new(Southwell::new(settings)),
            Kind::Hierarchical => Box::new(LinkSolver::new(crate::hierarchical::METHOD)),
            Kind::HaarWavelet => Box::new(LinkSolver::new(crate::haar_wavelet::METHOD)),
            Kind::LinearWavelet => Box::new(LinkSolver::new(crate::linear_wavelet::METHOD)),
        }
    }
}
