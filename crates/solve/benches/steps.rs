//! One step of each solver on an integrating sphere of 2,000 patches: no rays, so this is the
//! cost of the solver itself.

use luxel_core::{DVec3, Layers};
use luxel_solve::{Kind, Problem, SolverSettings, Transport};
use luxel_transport::{Constant, GivenNodes};

fn main() {
    divan::main();
}

#[divan::bench(args = Kind::ALL)]
fn step(bencher: divan::Bencher, kind: Kind) {
    let n = 2000;
    let sphere = Constant::new((0..n).map(|i| 1.0 + (i % 7) as f64).collect());
    let layers = Layers {
        groups: vec!["lamp".into()],
    };
    let reflectance = vec![0.5; 3 * n];
    let emission: Vec<f64> = (0..3 * n)
        .map(|k| if k < 300 { 100.0 } else { 0.0 })
        .collect();
    let nodes = GivenNodes::new(&sphere, sphere.areas(), vec![DVec3::ZERO; n]);
    let transport = if kind.needs_nodes() {
        Transport::Nodes(&nodes)
    } else if kind.needs_lines() {
        Transport::Lines(&sphere)
    } else {
        Transport::Factors(&sphere)
    };
    let problem = Problem {
        layers: &layers,
        area: sphere.areas(),
        reflectance: &reflectance,
        emission: &emission,
        outside: &[0.0; 3],
        transport,
        seed: 1,
        importance: None,
    };
    bencher
        .with_inputs(|| kind.build(SolverSettings::default()))
        .bench_local_values(|mut solver| solver.step(&problem));
}
