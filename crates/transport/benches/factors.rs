//! Throughput of points, factors and the stored matrix.
//!
//! CPU time of the process, so that a busy machine does not blur it; best of three rounds.
//! Figures are printed, nothing is asserted.

use luxel_core::{
    DVec3, ElementId, Finish, FinishId, Front, GroupId, Polygon, Scene, Shape, Side, Surface,
    SurfaceId, Vec3,
};
use luxel_transport::polygon_pair::exchange_area;
use luxel_transport::sampling::cosine_hemisphere;
use luxel_transport::{
    Bvh, FactorRow, FormFactors, FrontLines, Hemicube, LocalLines, Matrix, MatrixSettings, Sequence,
};
use std::hint::black_box;
use std::sync::Arc;

fn main() {
    let points = 10_000_000_u32;
    let sequence = Sequence::new(1, 2);
    report("point4", points as f64, || {
        let mut sum = [0.0_f32; 4];
        for k in 0..points {
            let p = sequence.point4(k);
            for d in 0..4 {
                sum[d] += p[d];
            }
        }
        black_box(sum);
    });
    report("point4 and cosine direction", points as f64, || {
        let mut sum = Vec3::ZERO;
        let normal = black_box(Vec3::new(0.6, 0.0, 0.8));
        for k in 0..points {
            let [_, _, u, v] = sequence.point4(k);
            sum += cosine_hemisphere([u, v], normal);
        }
        black_box(sum);
    });

    let quad = |o: DVec3, u: DVec3, v: DVec3| Polygon::new(vec![o, o + u, o + u + v, o + v]);
    let floor = quad(DVec3::ZERO, DVec3::X, DVec3::Y);
    for (name, to) in [
        (
            "exchange_area, shared edge",
            quad(DVec3::ZERO, DVec3::Y, DVec3::Z),
        ),
        (
            "exchange_area, near, skew",
            quad(
                DVec3::new(0.1, 0.2, 0.9),
                DVec3::new(0.2, 1.0, 0.1),
                DVec3::new(1.0, -0.1, 0.2),
            ),
        ),
        (
            "exchange_area, 10 sizes away",
            quad(DVec3::new(0.1, 0.2, 10.0), DVec3::Y, DVec3::X),
        ),
    ] {
        for accuracy in [1e-10, 1e-4] {
            let count = 20_000;
            report(&format!("{name}, to {accuracy:.0e}"), count as f64, || {
                for _ in 0..count {
                    black_box(exchange_area(black_box(&floor), &to, accuracy));
                }
            });
        }
    }

    for cells in [8, 16] {
        let (scene, front) = room(cells);
        let scene = Arc::new(scene);
        let bvh = Bvh::build(&scene);
        let n = front.len();
        let pairs = (n * n / 2) as f64;
        report(
            &format!("Matrix::assemble, {n} elements, pairs"),
            pairs,
            || {
                black_box(Matrix::assemble(
                    &scene,
                    &front,
                    &bvh,
                    &MatrixSettings::default(),
                ));
            },
        );
        let matrix = Matrix::assemble(&scene, &front, &bvh, &MatrixSettings::default());
        println!("  {} factors, {:?}", matrix.factors(), matrix.defects());
        let lines = FrontLines::new(&scene, &front, &bvh);
        let mut arrivals = Vec::new();
        report("FrontLines::cast, lines", 256.0 * n as f64, || {
            for e in 0..n {
                lines.cast(ElementId::from(e), 0..256, 1, &mut arrivals);
                black_box(&arrivals);
            }
        });
        let hemicube = Hemicube::new(&scene, &front, 100);
        let mut row = FactorRow::default();
        report("Hemicube at 100, rows", n as f64, || {
            for e in 0..n {
                hemicube.row(ElementId::from(e), &mut row);
                black_box(&row);
            }
        });
    }
}

/// Runs three times; prints the best rate.
fn report(name: &str, count: f64, mut run: impl FnMut()) {
    let mut best = f64::INFINITY;
    for _ in 0..3 {
        let start = process_seconds();
        run();
        best = best.min(process_seconds() - start);
    }
    println!(
        "{name}: {:.3e} a CPU second ({:.1} ns each)",
        count / best,
        best / count * 1e9
    );
}

/// CPU time of all threads so far, s.
fn process_seconds() -> f64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the pointer is to a timespec of ours.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// A room of 5 x 4 x 3 m with a box of 1 m standing in it; each side in `cells` x `cells`.
fn room(cells: u32) -> (Scene, Front) {
    let mut sides = Vec::new();
    // Inwards for the room, outwards for the box.
    for (low, size, outwards) in [
        (Vec3::ZERO, Vec3::new(5.0, 4.0, 3.0), false),
        (Vec3::new(2.0, 1.5, 0.01), Vec3::ONE, true),
    ] {
        let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
        for (o, u, v) in [
            (low, x, y),
            (low + z, y, x),
            (low, y, z),
            (low + x, z, y),
            (low, z, x),
            (low + y, x, z),
        ] {
            sides.push(if outwards { [o, v, u] } else { [o, u, v] });
        }
    }
    let mut scene = Scene {
        finishes: vec![Finish::default()],
        ..Scene::default()
    };
    for (k, &[o, u, v]) in sides.iter().enumerate() {
        let base = scene.positions.len() as u32;
        scene.positions.extend([o, o + u, o + u + v, o + v]);
        scene
            .triangles
            .extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        scene.surface_of.extend([SurfaceId::from(k); 2]);
        scene.source_triangle.extend([0, 1]);
        let first = 2 * k as u32;
        scene.surfaces.push(Surface {
            name: format!("side {k}"),
            finish: FinishId(0),
            triangles: first..first + 2,
            node: 0,
            mesh: 0,
            primitive: 0,
        });
    }
    let mut front = Front::new(scene.triangles.len());
    for (k, &[origin, edge_u, edge_v]) in sides.iter().enumerate() {
        let shape = Shape::Parallelogram {
            origin,
            edge_u,
            edge_v,
        };
        let first = 2 * k as u32;
        front.add_patch(
            SurfaceId::from(k),
            Side::Front,
            shape,
            [cells; 2],
            GroupId::NONE,
            &[first, first + 1],
        );
    }
    (scene, front)
}
