//! The energy balance of a whole session: luminaires, first landing, exchange, loss.
//!
//! emitted = absorbed + escaped + unshot + imbalance, for each group. Two independent estimates
//! meet in the imbalance: the analytic direct light on the elements against rays from the
//! luminaires, and the solver's own balance.

use crate::session::Session;
use luxel_core::Solution;
use luxel_core::layers::{BANDS, luminance};
use luxel_visualise::report::{Energy, Flux, GroupFlux};

/// Photometric sum of one group's columns.
fn of(columns: &[f64], group: usize) -> f64 {
    let bands: [f32; BANDS] = std::array::from_fn(|b| columns[BANDS * group + b] as f32);
    luminance(&bands) as f64
}

/// Where the light of every group went, lumens.
pub fn energy(session: &Session, solution: &Solution) -> Energy {
    let balance = session.balance(solution);
    let matter = session.matter();
    let fate = session.lights().fate(
        session.front(),
        session.caster(),
        session.scene().bounds(),
        session.settings().seed,
    );
    let groups = session.layers().groups.iter().enumerate().map(|(g, name)| {
        let exchange = &balance.groups[g];
        // The equation's emission holds the first reflection of direct light, which came from a
        // luminaire and is counted there; the rest of the direct light was absorbed on landing.
        let reflected = of(matter.direct_reflected(), g);
        let absorbed_first = of(matter.direct_landed(), g) - reflected;
        GroupFlux {
            name: name.clone(),
            flux: Flux::balance(
                of(&fate.emitted, g) + exchange.emitted_lm - reflected,
                exchange.absorbed_lm + absorbed_first + of(&fate.black, g),
                exchange.escaped_lm + of(&fate.outside, g),
                exchange.unshot_lm,
            ),
        }
    });
    Energy::from_groups(groups.collect())
}
