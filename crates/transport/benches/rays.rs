//! Throughput of the ray engine, side by side with Embree where there is one.
//!
//! Three scenes (19 thousand, 0.2 and 1.4 million triangles) and three kinds of rays: closest
//! hit of cosine-distributed rays in random order, any hit between random facing points, and
//! any hit in bundles of sixteen between small facing patches. One thread, thread CPU time,
//! best of interleaved rounds. Set `LUXEL_EMBREE` to the path of `libembree4` for the
//! comparison: it is opened at run time, as an oracle of answers and of speed.
//!
//! `LUXEL_ROUNDS` sets the number of rounds (3), `LUXEL_SCENES` the number of scenes (3).

use luxel_core::{Finish, FinishId, Scene, Surface, SurfaceId, Vec3};
use luxel_transport::{Bvh, Hit, Ray, RayCaster};
use std::sync::Arc;
use std::time::Instant;

/// Rays of each kind.
const COUNT: usize = 100_000;
/// Segments in a bundle.
const BUNDLE: usize = 16;

fn main() {
    let setting = |name: &str, usual: usize| {
        std::env::var(name)
            .ok()
            .and_then(|v| v.parse().ok())
            .unwrap_or(usual)
    };
    let rounds = setting("LUXEL_ROUNDS", 3);
    let embree = std::env::var_os("LUXEL_EMBREE").map(|path| embree::Library::open(&path));
    if embree.is_none() {
        println!("LUXEL_EMBREE is not set: our figures only");
    }
    let scenes: [(&str, fn() -> Scene, f32); 3] = [
        ("cornell", cornell, 0.05),
        ("room", room, 0.1),
        ("hall", hall, 0.1),
    ];
    for (name, make, patch_m) in scenes.into_iter().take(setting("LUXEL_SCENES", 3)) {
        let scene = Arc::new(make());
        bench(name, &scene, patch_m, rounds, embree.as_ref());
    }
}

fn bench(
    name: &str,
    scene: &Arc<Scene>,
    patch_m: f32,
    rounds: usize,
    embree: Option<&embree::Library>,
) {
    let started = (Instant::now(), process_seconds());
    let ours = Bvh::build(scene);
    let n = scene.triangles.len();
    println!(
        "\n{name}: {n} triangles, {:?}, {:.1} bytes/triangle, built in {:.3} s ({:.3} CPU s)",
        ours.kernel(),
        ours.bytes() as f64 / n as f64,
        started.0.elapsed().as_secs_f64(),
        process_seconds() - started.1,
    );
    let mut random = Random(7);
    let spread = Spread::new(scene);
    let cosine: Vec<Ray> = (0..COUNT).map(|_| spread.cosine(&mut random)).collect();
    let shadow: Vec<Ray> = (0..COUNT)
        .flat_map(|_| spread.facing(&mut random, 0.0, 1))
        .collect();
    let bundles: Vec<Ray> = (0..COUNT / BUNDLE)
        .flat_map(|_| spread.facing(&mut random, patch_m, BUNDLE))
        .collect();

    let mut hits = vec![Hit::MISS; COUNT];
    let mut visible = [vec![0.0f32; COUNT], vec![0.0f32; bundles.len()]];
    let oracles: Vec<(&str, embree::Tree)> = embree
        .map(|library| {
            [("MEDIUM", embree::MEDIUM), ("HIGH", embree::HIGH)].map(|(label, quality)| {
                let started = process_seconds();
                let tree = library.build(scene, quality);
                println!(
                    "  Embree {label}: built in {:.3} CPU s",
                    process_seconds() - started
                );
                (label, tree)
            })
        })
        .into_iter()
        .flatten()
        .collect();

    // The best round counts: other processes only ever slow one down.
    let mut own = [f64::INFINITY; 4];
    let mut theirs = vec![[f64::INFINITY; 4]; oracles.len()];
    let mut their_hits = vec![vec![(f32::INFINITY, u32::MAX); COUNT]; oracles.len()];
    let mut their_visible = vec![[vec![false; COUNT], vec![false; bundles.len()]]; oracles.len()];
    for _ in 0..rounds {
        own[0] = own[0].min(timed(|| ours.closest(&cosine, &mut hits)));
        own[1] = own[1].min(timed(|| ours.visibility(&shadow, &mut visible[0])));
        own[2] = own[2].min(timed(|| {
            // One by one, so that nothing can be shared.
            for (segment, visible) in bundles.iter().zip(&mut visible[1]) {
                ours.visibility(std::slice::from_ref(segment), std::slice::from_mut(visible));
            }
        }));
        own[3] = own[3].min(timed(|| ours.visibility(&bundles, &mut visible[1])));
        for (k, (_, tree)) in oracles.iter().enumerate() {
            let best = &mut theirs[k];
            best[0] = best[0].min(timed(|| tree.closest(&cosine, &mut their_hits[k])));
            let [a, b] = &mut their_visible[k];
            best[1] = best[1].min(timed(|| tree.visible(&shadow, a)));
            best[2] = best[2].min(timed(|| tree.visible(&bundles, b)));
            best[3] = best[3].min(timed(|| tree.visible_16(&bundles, b)));
        }
    }
    let rate = |seconds: f64| COUNT as f64 / seconds * 1e-6;
    println!("  Mrays/s, 1 thread     cosine   shadow   bundle 1x1   bundle by 16");
    let line = |label: &str, s: &[f64; 4]| {
        println!(
            "  {label:<18} {:>9.2} {:>8.2} {:>12.2} {:>14.2}",
            rate(s[0]),
            rate(s[1]),
            rate(s[2]),
            rate(s[3])
        );
    };
    line("Luxel", &own);
    for (k, (label, _)) in oracles.iter().enumerate() {
        line(&format!("Embree {label}"), &theirs[k]);
        let ratio: Vec<f64> = (0..4).map(|i| theirs[k][i] / own[i]).collect();
        println!(
            "  {:<18} {:>9.2} {:>8.2} {:>12.2} {:>14.2}",
            "  Luxel/Embree", ratio[0], ratio[1], ratio[2], ratio[3]
        );
        let closest = hits
            .iter()
            .zip(&their_hits[k])
            .filter(|(a, b)| a.triangle != b.1 && (a.t - b.0).abs() > 1e-3 * b.0.abs())
            .count();
        let differ = |i: usize| {
            let pairs = visible[i].iter().zip(&their_visible[k][i]);
            pairs.filter(|(a, b)| (**a > 0.5) != **b).count()
        };
        println!(
            "    answers that differ: closest {closest}, shadow {}, bundle {}",
            differ(0),
            differ(1)
        );
    }
}

fn timed(work: impl FnOnce()) -> f64 {
    let start = thread_seconds();
    work();
    thread_seconds() - start
}

#[cfg(unix)]
fn clock(id: libc::clockid_t) -> f64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: writes one timespec.
    unsafe { libc::clock_gettime(id, &mut time) };
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

#[cfg(unix)]
fn thread_seconds() -> f64 {
    clock(libc::CLOCK_THREAD_CPUTIME_ID)
}

#[cfg(unix)]
fn process_seconds() -> f64 {
    clock(libc::CLOCK_PROCESS_CPUTIME_ID)
}

#[cfg(not(unix))]
fn thread_seconds() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_secs_f64()
}

#[cfg(not(unix))]
fn process_seconds() -> f64 {
    thread_seconds()
}

/// Numbers in 0..1: a multiplicative congruential sequence [Steele21].
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(0xd134_2543_de82_ef95).wrapping_add(1);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.next()
    }
}

/// Points spread by area over a scene.
struct Spread<'a> {
    scene: &'a Scene,
    sum: Vec<f64>,
}

impl Spread<'_> {
    fn new(scene: &Scene) -> Spread<'_> {
        let mut sum = vec![0.0];
        for triangle in 0..scene.triangles.len() {
            sum.push(sum[triangle] + f64::from(scene.area(triangle)));
        }
        Spread { scene, sum }
    }

    /// A point and the unit normal there.
    fn point(&self, random: &mut Random) -> (Vec3, Vec3) {
        let at = f64::from(random.next()) * self.sum[self.sum.len() - 1];
        let triangle = self
            .sum
            .partition_point(|&s| s <= at)
            .clamp(1, self.sum.len() - 1)
            - 1;
        let [a, b, c] = self.scene.corners(triangle);
        let (u, v) = (random.next().sqrt(), random.next());
        (
            a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v),
            (b - a).cross(c - a).normalize(),
        )
    }

    fn cosine(&self, random: &mut Random) -> Ray {
        let (point, normal) = self.point(random);
        let (x, y) = normal.any_orthonormal_pair();
        let (radius, angle) = (random.next().sqrt(), random.next() * std::f32::consts::TAU);
        let along = x * (radius * angle.cos()) + y * (radius * angle.sin());
        Ray {
            origin: point + normal * 1e-4,
            t_min: 0.0,
            direction: along + normal * (1.0 - radius * radius).max(0.0).sqrt(),
            t_max: f32::INFINITY,
        }
    }

    /// `count` segments between squares of side `size_m` around two points that face each other.
    fn facing(&self, random: &mut Random, size_m: f32, count: usize) -> Vec<Ray> {
        loop {
            let ((p, n), (q, m)) = (self.point(random), self.point(random));
            let way = q - p;
            if way.dot(n) < 1e-3 || way.dot(m) > -1e-3 {
                continue;
            }
            let mut square = |centre: Vec3, normal: Vec3| {
                let (x, y) = normal.any_orthonormal_pair();
                let mut at = || (random.next() - 0.5) * size_m;
                centre + normal * 1e-4 + x * at() + y * at()
            };
            return (0..count)
                .map(|_| {
                    let (from, to) = (square(p, n), square(q, m));
                    Ray {
                        origin: from,
                        t_min: 0.0,
                        direction: to - from,
                        t_max: 0.9999,
                    }
                })
                .collect();
        }
    }
}

/// Triangles under construction.
#[derive(Default)]
struct Maker {
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl Maker {
    /// `n` by `n` squares, the front where `x` cross `y` points.
    fn grid(&mut self, corner: Vec3, x: Vec3, y: Vec3, n: u32) {
        let first = self.positions.len() as u32;
        for j in 0..=n {
            for i in 0..=n {
                let (s, t) = (i as f32 / n as f32, j as f32 / n as f32);
                self.positions.push(corner + x * s + y * t);
            }
        }
        for j in 0..n {
            for i in 0..n {
                let a = first + j * (n + 1) + i;
                let (b, c, d) = (a + 1, a + n + 1, a + n + 2);
                self.triangles.extend([[a, b, d], [a, d, c]]);
            }
        }
    }

    /// A turned box, seen from outside or, as a room, from inside.
    fn block(&mut self, low: Vec3, size: Vec3, angle: f32, n: u32, inside: bool) {
        let (sin, cos) = angle.sin_cos();
        let (x, y) = (
            Vec3::new(cos, sin, 0.0) * size.x,
            Vec3::new(-sin, cos, 0.0) * size.y,
        );
        let z = Vec3::Z * size.z;
        for (corner, a, b) in [
            (low, y, x),
            (low + z, x, y),
            (low, x, z),
            (low + y, z, x),
            (low, z, y),
            (low + x, y, z),
        ] {
            if inside {
                self.grid(corner, b, a, n)
            } else {
                self.grid(corner, a, b, n)
            }
        }
    }

    /// A ball of `2 n (2 n - 2)` triangles.
    fn ball(&mut self, centre: Vec3, radius: f32, n: u32) {
        let first = self.positions.len() as u32;
        let around = 2 * n;
        for j in 0..=n {
            let polar = std::f32::consts::PI * j as f32 / n as f32;
            for i in 0..around {
                let angle = std::f32::consts::TAU * i as f32 / around as f32;
                let (ring, z) = (polar.sin(), polar.cos());
                self.positions
                    .push(centre + radius * Vec3::new(ring * angle.cos(), ring * angle.sin(), z));
            }
        }
        for j in 0..n {
            for i in 0..around {
                let at = |i: u32, j: u32| first + j * around + i % around;
                let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1));
                if j > 0 {
                    self.triangles.push([a, c, b]);
                }
                if j + 1 < n {
                    self.triangles.push([b, c, d]);
                }
            }
        }
    }

    fn scene(self) -> Scene {
        let n = self.triangles.len();
        Scene {
            positions: self.positions,
            triangles: self.triangles,
            surface_of: vec![SurfaceId(0); n],
            source_triangle: (0..n as u32).collect(),
            surfaces: vec![Surface {
                name: "all".into(),
                finish: FinishId(0),
                triangles: 0..n as u32,
                node: u32::MAX,
                mesh: 0,
                primitive: 0,
            }],
            finishes: vec![Finish::default()],
            up: Vec3::Z,
            ..Scene::default()
        }
    }
}

/// A box of finely cut walls with two finely cut blocks.
fn cornell() -> Scene {
    let mut maker = Maker::default();
    maker.block(Vec3::ZERO, Vec3::splat(0.56), 0.0, 28, true);
    maker.block(
        Vec3::new(0.13, 0.07, 0.0),
        Vec3::new(0.165, 0.165, 0.165),
        0.29,
        20,
        false,
    );
    maker.block(
        Vec3::new(0.30, 0.25, 0.0),
        Vec3::new(0.165, 0.165, 0.33),
        -0.3,
        20,
        false,
    );
    maker.scene()
}

/// An office: huge wall triangles beside tiny ones.
fn room() -> Scene {
    let mut maker = Maker::default();
    let mut random = Random(1);
    maker.block(Vec3::ZERO, Vec3::new(12.0, 9.0, 3.0), 0.0, 1, true);
    for k in 0..24 {
        let at = Vec3::new(1.0 + (k % 6) as f32 * 1.8, 1.0 + (k / 6) as f32 * 2.0, 0.0);
        let angle = random.between(-0.1, 0.1);
        maker.block(
            at + Vec3::Z * 0.72,
            Vec3::new(1.4, 0.7, 0.03),
            angle,
            1,
            false,
        );
        for (x, y) in [(0.05, 0.05), (1.3, 0.05), (0.05, 0.6), (1.3, 0.6)] {
            maker.block(
                at + Vec3::new(x, y, 0.0),
                Vec3::new(0.05, 0.05, 0.72),
                angle,
                1,
                false,
            );
        }
        maker.block(
            at + Vec3::new(0.5, 0.9, 0.4),
            Vec3::new(0.45, 0.45, 0.05),
            angle,
            2,
            false,
        );
        maker.block(
            at + Vec3::new(0.5, 1.3, 0.45),
            Vec3::new(0.45, 0.05, 0.5),
            angle,
            2,
            false,
        );
        maker.ball(at + Vec3::new(0.3, 0.3, 0.9), 0.12, 42);
    }
    for k in 0..900 {
        let (shelf, place) = (k / 150, k % 150);
        let at = Vec3::new(0.5 + place as f32 * 0.07, 8.6, 0.3 + shelf as f32 * 0.4);
        let size = Vec3::new(0.03, random.between(0.1, 0.25), random.between(0.15, 0.3));
        maker.block(at, size, random.between(-0.1, 0.1), 1, false);
    }
    for k in 0..8 {
        maker.ball(Vec3::new(1.0 + k as f32 * 1.4, 4.5, 2.6), 0.25, 36);
    }
    maker.scene()
}

/// A hall full of balls and blocks.
fn hall() -> Scene {
    let mut maker = Maker::default();
    let mut random = Random(2);
    maker.block(Vec3::ZERO, Vec3::new(60.0, 40.0, 12.0), 0.0, 4, true);
    let mut place = |margin: f32| {
        Vec3::new(
            random.between(margin, 60.0 - margin),
            random.between(margin, 40.0 - margin),
            random.between(margin, 12.0 - margin),
        )
    };
    for _ in 0..700 {
        let centre = place(0.7);
        maker.ball(centre, 0.2 + 0.4 * (centre.x * 7.31).fract(), 22);
    }
    for _ in 0..2500 {
        let low = place(1.0);
        let size = Vec3::new(low.x * 3.7, low.y * 5.3, low.z * 9.1).fract() * 0.8 + 0.1;
        maker.block(low, size, low.x, 1, false);
    }
    maker.scene()
}

/// The few functions of Embree 4 that the comparison needs, from a library opened at run time.
mod embree {
    use super::{BUNDLE, Ray, Scene};
    use libloading::Library as Shared;
    use std::ffi::{OsStr, c_char, c_void};

    pub const MEDIUM: u32 = 1;
    pub const HIGH: u32 = 2;

    type Handle = *mut c_void;

    #[repr(C, align(16))]
    struct RayHit {
        origin: [f32; 3],
        near: f32,
        direction: [f32; 3],
        time: f32,
        far: f32,
        mask: u32,
        id: u32,
        flags: u32,
        normal: [f32; 3],
        u: f32,
        v: f32,
        triangle: u32,
        geometry: u32,
        // Instance numbers, one or two by version, and room.
        rest: [u32; 13],
    }

    impl RayHit {
        fn new(ray: &Ray) -> RayHit {
            RayHit {
                origin: ray.origin.to_array(),
                near: ray.t_min,
                direction: ray.direction.to_array(),
                time: 0.0,
                far: ray.t_max,
                mask: u32::MAX,
                id: 0,
                flags: 0,
                normal: [0.0; 3],
                u: 0.0,
                v: 0.0,
                triangle: u32::MAX,
                geometry: u32::MAX,
                rest: [u32::MAX; 13],
            }
        }
    }

    /// Sixteen rays field by field: origin, near, direction, time, far, mask, id, flags.
    #[repr(C, align(64))]
    struct Ray16([[u32; BUNDLE]; 12]);

    /// RTCOccludedArguments with the coherent flag.
    #[repr(C)]
    struct Arguments {
        flags: u32,
        features: u32,
        rest: [usize; 8],
    }

    pub struct Library {
        shared: Shared,
        device: Handle,
    }

    pub struct Tree {
        scene: Handle,
        intersect: unsafe extern "C" fn(Handle, *mut RayHit, *const c_void),
        occluded: unsafe extern "C" fn(Handle, *mut RayHit, *const c_void),
        occluded_16: unsafe extern "C" fn(*const i32, Handle, *mut Ray16, *const Arguments),
    }

    impl Library {
        // SAFETY of this whole module: signatures are those of Embree 4's rtcore headers; if
        // the file is no Embree 4 a symbol is missing, and the bench ends.
        pub fn open(path: &OsStr) -> Library {
            unsafe {
                let shared = Shared::new(path).expect("LUXEL_EMBREE opens");
                let new: libloading::Symbol<unsafe extern "C" fn(*const c_char) -> Handle> =
                    shared.get(b"rtcNewDevice").expect("an Embree 4 library");
                let device = new(std::ptr::null());
                Library { shared, device }
            }
        }

        fn symbol<T: Copy>(&self, name: &str) -> T {
            unsafe {
                *self
                    .shared
                    .get::<T>(name.as_bytes())
                    .expect("an Embree 4 library")
            }
        }

        pub fn build(&self, scene: &Scene, quality: u32) -> Tree {
            type Make = unsafe extern "C" fn(Handle) -> Handle;
            type MakeKind = unsafe extern "C" fn(Handle, u32) -> Handle;
            type Set = unsafe extern "C" fn(Handle, u32);
            type Act = unsafe extern "C" fn(Handle);
            type Attach = unsafe extern "C" fn(Handle, Handle) -> u32;
            type Buffer = unsafe extern "C" fn(Handle, u32, u32, u32, usize, usize) -> *mut c_void;
            const FLOAT3: u32 = 0x9003;
            const UINT3: u32 = 0x5003;
            let buffer: Buffer = self.symbol("rtcSetNewGeometryBuffer");
            unsafe {
                let tree = self.symbol::<Make>("rtcNewScene")(self.device);
                let geometry = self.symbol::<MakeKind>("rtcNewGeometry")(self.device, 0);
                let (vertices, faces) = (scene.positions.len(), scene.triangles.len());
                let to = buffer(geometry, 1, 0, FLOAT3, 12, vertices).cast::<[f32; 3]>();
                for (k, position) in scene.positions.iter().enumerate() {
                    to.add(k).write(position.to_array());
                }
                let to = buffer(geometry, 0, 0, UINT3, 12, faces).cast::<[u32; 3]>();
                to.copy_from_nonoverlapping(scene.triangles.as_ptr(), faces);
                self.symbol::<Act>("rtcCommitGeometry")(geometry);
                self.symbol::<Attach>("rtcAttachGeometry")(tree, geometry);
                self.symbol::<Act>("rtcReleaseGeometry")(geometry);
                self.symbol::<Set>("rtcSetSceneBuildQuality")(tree, quality);
                self.symbol::<Act>("rtcCommitScene")(tree);
                Tree {
                    scene: tree,
                    intersect: self.symbol("rtcIntersect1"),
                    occluded: self.symbol("rtcOccluded1"),
                    occluded_16: self.symbol("rtcOccluded16"),
                }
            }
        }
    }

    impl Tree {
        pub fn closest(&self, rays: &[Ray], hits: &mut [(f32, u32)]) {
            for (ray, hit) in rays.iter().zip(hits) {
                let mut query = RayHit::new(ray);
                unsafe { (self.intersect)(self.scene, &mut query, std::ptr::null()) };
                *hit = (query.far, query.triangle);
            }
        }

        pub fn visible(&self, segments: &[Ray], visible: &mut [bool]) {
            for (segment, visible) in segments.iter().zip(visible) {
                let mut query = RayHit::new(segment);
                unsafe { (self.occluded)(self.scene, &mut query, std::ptr::null()) };
                *visible = query.far >= 0.0;
            }
        }

        pub fn visible_16(&self, segments: &[Ray], visible: &mut [bool]) {
            let arguments = Arguments {
                flags: 1 << 16,
                features: u32::MAX,
                rest: [0; 8],
            };
            let bundles = segments
                .chunks_exact(BUNDLE)
                .zip(visible.chunks_exact_mut(BUNDLE));
            for (bundle, visible) in bundles {
                let mut query = Ray16([[0; BUNDLE]; 12]);
                for (k, ray) in bundle.iter().enumerate() {
                    for axis in 0..3 {
                        query.0[axis][k] = ray.origin[axis].to_bits();
                        query.0[4 + axis][k] = ray.direction[axis].to_bits();
                    }
                    query.0[3][k] = ray.t_min.to_bits();
                    query.0[8][k] = ray.t_max.to_bits();
                    query.0[9][k] = u32::MAX;
                }
                let valid = [-1i32; BUNDLE];
                unsafe {
                    (self.occluded_16)(valid.as_ptr(), self.scene, &mut query, &arguments);
                }
                for (k, visible) in visible.iter_mut().enumerate() {
                    *visible = f32::from_bits(query.0[8][k]) >= 0.0;
                }
            }
        }
    }
}
