//! Receivers a second, and how long the direct light of the elements takes.
//!
//! `cargo bench -p luxel-gather`. Scene: a furnished box room (six walls, tables and cupboards),
//! two lamps, one bounce as the field; one thread. Figures are time on the processor where the
//! system tells it (Linux), so that other load does not count.

use luxel_core::quantity::LAMBERTIAN;
use luxel_core::*;
use luxel_gather::{Accuracy, DirectLights, ElementDirect, Gatherer, Receiver};
use luxel_transport::Bvh;
use std::sync::Arc;
use std::time::Instant;

/// Seconds that this thread has run.
fn on_processor(since: Instant) -> f64 {
    std::fs::read_to_string("/proc/thread-self/schedstat")
        .ok()
        .and_then(|s| s.split(' ').next()?.parse::<f64>().ok())
        .map_or_else(|| since.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

fn main() {
    let (scene, front) = room(32);
    let caster = Bvh::build(&scene);
    let lights = DirectLights::new(&scene, &front);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("one thread");
    let (elements, count) = (front.len(), scene.triangles.len());

    let (direct, seconds) = timed(&pool, || {
        lights.element_irradiance(&scene, &front, &caster, &ElementDirect::default())
    });
    println!(
        "{elements} elements, {count} triangles, {} lamps",
        lights.len()
    );
    println!("direct light of all elements: {seconds:.3} s");

    // One bounce as the field to gather: smooth, with the shadows that a solution has.
    let layers = scene.layers();
    let exitance = direct.iter().map(|e| 0.5 * e + 20.0).collect();
    let solution = Solution {
        layers,
        exitance,
        ..Solution::default()
    };
    let gatherer = Gatherer::new(&scene, &front, &caster, &solution, &lights);
    let receivers: Vec<Receiver> = (0..5000)
        .map(|k| {
            let f = |a: f32| (k as f32 * a + 0.37).fract();
            let (x, y) = (0.1 + 7.8 * f(0.754_877_7), 0.1 + 5.8 * f(0.569_840_3));
            Receiver {
                position: Vec3::new(x, y, 0.85),
                normal: Vec3::Z,
            }
        })
        .collect();
    for rays in [256, 1024, 4096] {
        let accuracy = Accuracy {
            relative: 0.0,
            floor_lux: f32::INFINITY,
            rays: [rays; 2],
            seed: 1,
        };
        report(
            &pool,
            &gatherer,
            &receivers,
            &accuracy,
            &format!("{rays} gather rays"),
        );
    }
    for relative in [0.03, 0.01, 0.003] {
        let accuracy = Accuracy {
            relative,
            floor_lux: 0.1,
            rays: [64, 65_536],
            seed: 1,
        };
        report(
            &pool,
            &gatherer,
            &receivers,
            &accuracy,
            &format!("asked {} %", 100.0 * relative),
        );
    }
    many_lamps(&pool);
}

fn many_lamps(pool: &rayon::ThreadPool) {
    let (scene, front) = corridor();
    let caster = Bvh::build(&scene);
    let lights = DirectLights::new(&scene, &front);
    let (_, seconds) = timed(pool, || {
        lights.element_irradiance(&scene, &front, &caster, &ElementDirect::default())
    });
    println!(
        "{} elements, {} lamps: direct light {seconds:.2} s",
        front.len(),
        lights.len()
    );
}

fn timed<T: Send>(pool: &rayon::ThreadPool, job: impl FnOnce() -> T + Send) -> (T, f64) {
    pool.install(|| {
        let wall = Instant::now();
        let before = on_processor(wall);
        let answer = job();
        (answer, on_processor(wall) - before)
    })
}

fn report(
    pool: &rayon::ThreadPool,
    gatherer: &Gatherer,
    receivers: &[Receiver],
    a: &Accuracy,
    what: &str,
) {
    let (e, seconds) = timed(pool, || gatherer.irradiance_at(receivers, a));
    let n = receivers.len() as f64;
    let stated: f64 = (0..receivers.len())
        .map(|k| (e.errors[k] / e.lux(k).max(1e-6)).powi(2) as f64)
        .sum::<f64>()
        / n;
    println!(
        "{what}: {seconds:.2} s, {:.0} receivers/s, {:.2} Mrays/s, {:.0} rays each, stated RMS {:.2} %",
        n / seconds,
        e.rays as f64 / seconds * 1e-6,
        e.rays as f64 / n,
        100.0 * stated.sqrt(),
    );
}

/// An 8 x 6 x 3 m room with 12 tables, 8 cupboards and two lamps.
fn room(cells: u32) -> (Arc<Scene>, Front) {
    let mut sides = Vec::new();
    cuboid(&mut sides, [0.0; 3], [8.0, 6.0, 3.0], true, cells);
    for k in 0..12 {
        let (x, y) = (0.6 + 1.8 * (k % 4) as f32, 0.8 + 1.7 * (k / 4) as f32);
        cuboid(
            &mut sides,
            [x, y, 0.70],
            [x + 1.4, y + 0.7, 0.74],
            false,
            cells / 6,
        );
        for leg in [[0.02, 0.02], [1.33, 0.02], [0.02, 0.63], [1.33, 0.63]] {
            let (lx, ly) = (x + leg[0], y + leg[1]);
            cuboid(
                &mut sides,
                [lx, ly, 0.0],
                [lx + 0.05, ly + 0.05, 0.69],
                false,
                2,
            );
        }
    }
    for k in 0..8 {
        let x = 0.01 + 0.99 * k as f32;
        cuboid(
            &mut sides,
            [x, 5.5, 0.01],
            [x + 0.9, 5.95, 2.0],
            false,
            cells / 6,
        );
    }
    let lamps = [2.0, 5.4].map(|x| ([x, 2.7, 2.95].into(), Vec3::Y * 0.6, Vec3::X * 0.6, 2));
    assemble(sides, &lamps)
}

/// 100 cells of 4 x 4 x 3 m in a row, open to each other beside a partition, a lamp in each.
fn corridor() -> (Arc<Scene>, Front) {
    let (mut sides, mut lamps) = (Vec::new(), Vec::new());
    for k in 0..100 {
        let o = Vec3::X * (4.0 * k as f32);
        let (x, y, z) = (Vec3::X * 4.0, Vec3::Y * 4.0, Vec3::Z * 3.0);
        sides.extend([
            (o, x, y, 25),
            (o + z, y, x, 25),
            (o, z, x, 25),
            (o + y, x, z, 25),
        ]);
        sides.push((o, Vec3::Y * 2.5, z, 1));
        lamps.push((
            o + Vec3::new(1.7, 1.7, 2.95),
            Vec3::Y * 0.6,
            Vec3::X * 0.6,
            2,
        ));
    }
    assemble(sides, &lamps)
}

fn assemble(mut sides: Vec<Sheet>, lamps: &[Sheet]) -> (Arc<Scene>, Front) {
    let mut scene = Scene {
        up: Vec3::Z,
        ..Scene::default()
    };
    scene.groups = vec![Group {
        name: "lamps".into(),
    }];
    scene.finishes.push(Finish::default());
    let emission = Emission {
        luminance: Rgb::splat(5000.0),
        texture: None,
        group: GroupId(0),
    };
    scene.finishes.push(Finish {
        emission: Some(emission),
        ..Finish::default()
    });
    let lamps_from = sides.len();
    sides.extend_from_slice(lamps);
    for (k, &(corner, u, v, _)) in sides.iter().enumerate() {
        let first = scene.positions.len() as u32;
        scene
            .positions
            .extend([corner, corner + u, corner + u + v, corner + v]);
        scene
            .triangles
            .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        scene.surface_of.extend([SurfaceId(k as u32); 2]);
        scene.source_triangle.extend([0, 1]);
        scene.surfaces.push(Surface {
            name: String::new(),
            finish: FinishId((k >= lamps_from) as u32),
            triangles: 2 * k as u32..2 * k as u32 + 2,
            node: 0,
            mesh: 0,
            primitive: 0,
        });
    }
    let mut front = Front::new(scene.triangles.len());
    for (k, &(origin, edge_u, edge_v, n)) in sides.iter().enumerate() {
        let lamp = k >= lamps_from;
        let group = if lamp { GroupId(0) } else { GroupId::NONE };
        let shape = Shape::Parallelogram {
            origin,
            edge_u,
            edge_v,
        };
        let sources = [2 * k as u32, 2 * k as u32 + 1];
        let before = front.len();
        front.add_patch(
            SurfaceId(k as u32),
            Side::Front,
            shape,
            [n, n],
            group,
            &sources,
        );
        for e in before..front.len() {
            front.reflectance[e] = Rgb::splat(0.5);
            front.emission[e] = Rgb::splat(if lamp { 5000.0 * LAMBERTIAN } else { 0.0 });
        }
    }
    (Arc::new(scene), front)
}

/// Corner, two edges and cells along each; edges cross towards the light.
type Sheet = (Vec3, Vec3, Vec3, u32);

fn cuboid(out: &mut Vec<Sheet>, low: [f32; 3], high: [f32; 3], inside: bool, cells: u32) {
    let (l, d) = (Vec3::from(low), Vec3::from(high) - Vec3::from(low));
    let (x, y, z) = (Vec3::X * d.x, Vec3::Y * d.y, Vec3::Z * d.z);
    for (corner, u, v) in [
        (l, x, y),
        (l + z, y, x),
        (l, z, x),
        (l + y, x, z),
        (l, y, z),
        (l + x, z, y),
    ] {
        let (u, v) = if inside { (u, v) } else { (v, u) };
        out.push((corner, u, v, cells.max(1)));
    }
}
