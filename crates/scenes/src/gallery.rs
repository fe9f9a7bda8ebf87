//! A gallery: pictures under spots, a mirror, a glass case with a small sculpture.
//!
//! 10 x 7 m and 3.6 m high, with a free-standing wall. Nine luminaires without size
//! (KHR_lights_punctual spots, 2,600 cd on the axis, half angles 14 and 27 degrees) hang under two
//! tracks, each a group; a luminous cove of 120 cd/m² gives a little light from above. The mirror is the
//! finish [`MIRROR`] (written as smooth metal), the case clear glass. Pictures are textures. The
//! shell (floor, ceiling, walls) is closed; the glass panes are blocks 6 mm thick.

use crate::builder::{Builder, Place, at, faces};
use crate::{furniture as put, pictures};
use faces::{ALL, BACK, BOTTOM, FRONT, HANGING, LEFT, POST, RIGHT, STANDING, TOP};
use luxel_core::{FinishId, LuminaireKind, Rgb, Scene, Vec3};

/// Name of the finish that is a mirror.
pub const MIRROR: &str = "mirror";

const WIDTH: f32 = 10.0;
const DEPTH: f32 = 7.0;
const HEIGHT: f32 = 3.6;
/// The tracks hang here, metres above the floor.
const TRACK: f32 = 3.3;

/// The gallery; views `entrance`, `case` and `mirror`.
pub fn gallery() -> Scene {
    let mut b = Builder::new("gallery");
    let floor = b.matte("screed", 0.32, 0.31, 0.30);
    let white = b.matte("gallery white", 0.80, 0.80, 0.79);
    let ceiling = b.matte("ceiling paint", 0.82, 0.82, 0.82);
    let (low, high) = (Vec3::ZERO, at(WIDTH, HEIGHT, DEPTH));
    b.on("floor", floor).room(low, high, BOTTOM);
    b.on("ceiling", ceiling).room(low, high, TOP);
    b.on("walls", white).room(low, high, POST);
    let plaster = b.matte("blue-grey paint", 0.16, 0.20, 0.24);
    b.on("standing wall", plaster)
        .block(at(6.2, 0.0, 2.2), at(6.4, 2.8, 5.6), STANDING);

    let frame = b.matte("black frame", 0.04, 0.04, 0.04);
    let oak = b.matte("oak", 0.46, 0.29, 0.155);
    hang(&mut b, frame);
    mirror(&mut b, oak);
    case(&mut b, white);
    bench(&mut b, oak, frame);
    cove(&mut b, white);
    b.view("entrance", at(0.6, 1.65, 6.4), at(5.2, 1.35, 1.6), 52.0);
    b.view("case", at(4.9, 1.5, 5.4), at(3.0, 1.2, 2.6), 45.0);
    b.view("mirror", at(7.2, 1.6, 5.9), at(9.9, 1.4, 3.2), 58.0);
    b.build()
}

fn hang(b: &mut Builder, frame: FinishId) {
    let [hills, discs, grid, water] = [
        pictures::hills(),
        pictures::discs(),
        pictures::grid(),
        pictures::water(),
    ]
    .map(|t| {
        let name = t.name.clone();
        // Its own brightness, a little dimmed: paper is not perfectly white.
        let mean = t.mean().luminance();
        let texture = b.texture(t);
        b.pictured(&name, texture, 0.9 * mean)
    });
    // Name, picture, middle on the wall, turn of the wall, size.
    let works = [
        ("Hills", hills, at(1.9, 1.6, 0.0), 0.0, [1.6, 1.2]),
        ("Discs", discs, at(4.4, 1.6, 0.0), 0.0, [0.9, 1.2]),
        ("Water", water, at(6.9, 1.6, 0.0), 0.0, [1.6, 1.2]),
        ("Grid", grid, at(0.0, 1.6, 2.0), 90.0, [1.2, 1.2]),
        ("Discs, again", discs, at(0.0, 1.6, 4.6), 90.0, [0.9, 1.2]),
        ("Water, again", water, at(6.2, 1.6, 3.9), -90.0, [1.6, 1.2]),
        ("Grid, again", grid, at(6.4, 1.6, 3.9), 90.0, [1.2, 1.2]),
    ];
    let metal = b.matte("track", 0.08, 0.08, 0.08);
    for (i, (name, picture, middle, turn, size)) in works.into_iter().enumerate() {
        let place = Place::new(middle, turn);
        put::framed(b, name, place, size, [frame, picture]);
        // 1.9 m from the wall: 42 degrees from the plumb line, as museums hang them.
        let lamp = place.world_from_local(at(0.0, TRACK - middle.y, 1.9));
        spot(b, &format!("spot {}", i + 1), lamp, middle, metal);
    }
    spot(b, "spot 8", at(3.9, TRACK, 3.6), at(3.0, 1.25, 2.6), metal);
    spot(b, "spot 9", at(2.2, TRACK, 3.3), at(3.0, 1.25, 2.6), metal);
}

/// A housing under the ceiling and, just below its mouth, the luminaire.
fn spot(b: &mut Builder, name: &str, position: Vec3, aim: Vec3, metal: FinishId) {
    let intensity = Rgb::new(1.06, 1.0, 0.82) * (2600.0 / Rgb::new(1.06, 1.0, 0.82).luminance());
    b.luminaire(
        name,
        position,
        aim,
        LuminaireKind::Spot {
            intensity,
            range_m: f32::INFINITY,
            cos_inner: 14f32.to_radians().cos(),
            cos_outer: 27f32.to_radians().cos(),
        },
    );
    b.on("spot housings", metal);
    let mouth = position + Vec3::Y * 0.02;
    b.frustum(mouth, [0.05, 0.04], 0.14, 12)
        .disc(mouth, 0.05, 12, false);
    b.frustum(mouth + Vec3::Y * 0.14, [0.04, 0.008], 0.02, 12);
    let stem = mouth + Vec3::Y * 0.16;
    b.frustum(stem, [0.008, 0.008], HEIGHT - stem.y, 6);
}

fn mirror(b: &mut Builder, oak: FinishId) {
    let silver = b.matte(MIRROR, 0.90, 0.90, 0.90);
    put::framed(
        b,
        "mirror",
        Place::new(at(WIDTH, 1.35, 3.4), -90.0),
        [1.4, 2.0],
        [oak, silver],
    );
}

/// A plinth with a glass case of five panes; in it a stack of turned blocks and a ball.
fn case(b: &mut Builder, white: FinishId) {
    let glass = b.glass("case glass");
    let bronze = b.matte("bronze", 0.30, 0.17, 0.08);
    b.inside(Place::new(at(3.0, 0.0, 2.6), 20.0), |b| {
        b.on("plinth", white)
            .block(at(-0.35, 0.0, -0.35), at(0.35, 1.0, 0.35), STANDING);
        let (r, t, top) = (0.33, 0.006, 1.6);
        b.on("case", glass);
        b.block(at(-r, 1.0, -r), at(-r + t, top, r), STANDING);
        b.block(at(r - t, 1.0, -r), at(r, top, r), STANDING);
        // Between the side panes and under the lid with a hair's gap, as glued glass has.
        let inner = r - t - 0.0005;
        b.block(at(-inner, 1.0, -r), at(inner, top, -r + t), STANDING);
        b.block(at(-inner, 1.0, r - t), at(inner, top, r), STANDING);
        b.block(at(-r, top + 0.0005, -r), at(r, top + 0.0005 + t, r), ALL);
        b.on("sculpture", bronze);
        for (k, (half, low, high)) in [
            (0.14f32, 0.0f32, 0.06f32),
            (0.09, 0.06, 0.2),
            (0.06, 0.2, 0.34),
        ]
        .into_iter()
        .enumerate()
        {
            b.inside(Place::new(at(0.0, 1.0, 0.0), 25.0 * k as f32), |b| {
                b.block(at(-half, low, -half), at(half, high, half), STANDING);
            });
        }
        b.ball(at(0.0, 1.415, 0.0), 0.075, 12, 20);
    });
}

fn bench(b: &mut Builder, oak: FinishId, metal: FinishId) {
    b.inside(Place::new(at(3.4, 0.0, 4.9), 0.0), |b| {
        b.on("bench", oak)
            .block(at(-0.9, 0.40, -0.22), at(0.9, 0.46, 0.22), ALL);
        b.on("bench: feet", metal);
        for x in [-0.7, 0.7] {
            b.block(at(x - 0.02, 0.0, -0.2), at(x + 0.02, 0.40, 0.2), POST);
        }
    });
}

/// A board below the ceiling along the entrance wall whose upper side shines.
fn cove(b: &mut Builder, white: FinishId) {
    let light = b.luminous("cove", 0.7, 120.0, Rgb::new(1.0, 1.0, 0.98));
    let (low, high) = (
        at(0.5, 3.2, DEPTH - 0.4),
        at(WIDTH - 0.5, 3.26, DEPTH - 0.05),
    );
    b.on("cove: board", white)
        .block(low, high, HANGING & (LEFT | RIGHT | FRONT | BACK | BOTTOM));
    b.on("cove", light).block(low, high, TOP);
}
