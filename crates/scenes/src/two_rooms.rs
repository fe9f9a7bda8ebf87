//! Two furnished rooms joined by an opening: the first scene that a newcomer lights.
//!
//! A dining room 5.0 x 4.6 m with a neutral ceiling panel of 0.6 x 0.6 m and 4,000 lm, and a
//! living room 5.0 x 4.2 m with a warm globe of 2,000 lm and a standard lamp of 1,100 lm; both
//! 2.6 m high, the wall between them 10 cm thick, its opening 1.7 x 2.2 m. Floor .3, walls .75,
//! ceiling .85, the living room's back wall terracotta. Three luminaire groups. The shell (both
//! floors, ceilings, walls, the opening's lining) is closed.

use crate::builder::{Builder, Place, at, faces, luminance_of};
use crate::furniture::{self as put, Bookshelf};
use crate::pictures;
use faces::{ALL, BACK, BOTTOM, FRONT, LEFT, RIGHT, STANDING, TOP};
use luxel_core::{Finish, Rgb, Scene, Vec3};

const WIDTH: f32 = 5.0;
const HEIGHT: f32 = 2.6;
/// Dining room: z from 0 to here. Living room: z from `-THICK` to `BACK_Z`.
const FRONT_Z: f32 = 4.6;
const BACK_Z: f32 = -4.3;
const THICK: f32 = 0.1;
/// The opening along x, and its height.
const OPENING: [f32; 2] = [2.45, 4.15];
const HEAD: f32 = 2.2;

/// Two furnished rooms joined by an opening; views `dining room`, `living room` and `table`.
pub fn two_rooms() -> Scene {
    let mut b = Builder::new("two rooms");
    shell(&mut b);
    dining(&mut b);
    living(&mut b);
    b.view("dining room", at(2.7, 1.5, 4.5), at(2.62, 1.2, 0.0), 52.0);
    b.view(
        "living room",
        at(0.55, 1.55, -4.0),
        at(3.4, 1.05, 0.2),
        56.0,
    );
    b.view("table", at(0.4, 1.35, 3.6), at(2.0, 0.8, 1.4), 50.0);
    b.build()
}

fn shell(b: &mut Builder) {
    let planks = b.texture(pictures::planks());
    let floor = b.pictured("oak planks", planks, 0.30);
    let white = b.matte("white paint", 0.76, 0.75, 0.72);
    let ceiling = b.matte("ceiling paint", 0.85, 0.85, 0.85);
    let terracotta = b.matte("terracotta paint", 0.60, 0.235, 0.125);
    let [x0, x1] = OPENING;
    let near = at(WIDTH, HEIGHT, FRONT_Z);

    b.tile(2.0).on("dining room: floor", floor).polygon(&[
        at(0.0, 0.0, 0.0),
        at(0.0, 0.0, FRONT_Z),
        at(WIDTH, 0.0, FRONT_Z),
        at(WIDTH, 0.0, 0.0),
        at(x1, 0.0, 0.0),
        at(x0, 0.0, 0.0),
    ]);
    b.on("dining room: ceiling", ceiling)
        .room(Vec3::ZERO, near, TOP);
    b.on("dining room: walls", white)
        .room(Vec3::ZERO, near, LEFT | RIGHT | FRONT);
    b.polygon(&wall_with_opening(0.0));

    let far = [at(0.0, 0.0, BACK_Z), at(WIDTH, HEIGHT, -THICK)];
    b.on("living room: floor", floor).polygon(&[
        at(0.0, 0.0, BACK_Z),
        at(0.0, 0.0, -THICK),
        at(x0, 0.0, -THICK),
        at(x1, 0.0, -THICK),
        at(WIDTH, 0.0, -THICK),
        at(WIDTH, 0.0, BACK_Z),
    ]);
    b.on("living room: ceiling", ceiling)
        .room(far[0], far[1], TOP);
    b.on("living room: walls", white)
        .room(far[0], far[1], LEFT | RIGHT);
    let mut other = wall_with_opening(-THICK);
    other.reverse();
    b.polygon(&other);
    b.on("living room: accent wall", terracotta)
        .room(far[0], far[1], BACK);

    let lining = [at(x0, 0.0, -THICK), at(x1, HEAD, 0.0)];
    b.on("opening: floor", floor)
        .room(lining[0], lining[1], BOTTOM);
    b.on("opening: lining", white)
        .room(lining[0], lining[1], LEFT | RIGHT | TOP);

    let trim = b.matte("trim paint", 0.78, 0.77, 0.74);
    b.on("opening: casing", trim);
    put::casing(b, OPENING, HEAD);
    b.inside(Place::new(at(0.0, 0.0, -THICK), 180.0), |b| {
        put::casing(b, [-x1, -x0], HEAD)
    });
    b.on("dining room: skirting", trim);
    skirt(b, 0.0, FRONT_Z, 0.0);
    b.on("living room: skirting", trim);
    skirt(b, BACK_Z, -THICK, -THICK);
}

/// The dividing wall at `z`, seen from +z; corners of the opening are corners of the polygon.
fn wall_with_opening(z: f32) -> [Vec3; 8] {
    let [x0, x1] = OPENING;
    [
        at(0.0, 0.0, z),
        at(x0, 0.0, z),
        at(x0, HEAD, z),
        at(x1, HEAD, z),
        at(x1, 0.0, z),
        at(WIDTH, 0.0, z),
        at(WIDTH, HEIGHT, z),
        at(0.0, HEIGHT, z),
    ]
}

/// Skirting around a room from `z0` to `z1`, with a gap for the casing on its wall at `open_z`.
fn skirt(b: &mut Builder, z0: f32, z1: f32, open_z: f32) {
    let (gap, corner) = ([OPENING[0] - 0.07, OPENING[1] + 0.07], 0.012);
    for (z, turn) in [(z0, 0.0), (z1, 180.0)] {
        // Turned by 180 degrees, x runs the other way.
        let runs = if z == open_z {
            vec![[0.0, gap[0]], [gap[1], WIDTH]]
        } else {
            vec![[0.0, WIDTH]]
        };
        for [low, high] in runs {
            let run = if turn == 0.0 {
                [low, high]
            } else {
                [-high, -low]
            };
            b.inside(Place::new(at(0.0, 0.0, z), turn), |b| put::skirting(b, run));
        }
    }
    let (z0, z1) = (z0 + corner, z1 - corner);
    b.inside(Place::new(Vec3::ZERO, 90.0), |b| {
        put::skirting(b, [-z1, -z0])
    });
    b.inside(Place::new(at(WIDTH, 0.0, 0.0), -90.0), |b| {
        put::skirting(b, [z0, z1])
    });
}

fn dining(b: &mut Builder) {
    let oak = b.matte("oak", 0.46, 0.29, 0.155);
    let seat = b.matte("seat cloth", 0.10, 0.21, 0.25);
    let walnut = b.matte("walnut", 0.20, 0.115, 0.065);
    let books = [
        ("book red", [0.42, 0.08, 0.06]),
        ("book blue", [0.07, 0.14, 0.32]),
        ("book ochre", [0.55, 0.36, 0.10]),
        ("book green", [0.10, 0.24, 0.13]),
        ("book white", [0.70, 0.68, 0.60]),
        ("book grey", [0.22, 0.22, 0.24]),
    ]
    .map(|(name, [r, g, bl])| b.matte(name, r, g, bl));

    let rug = b.matte("rug wool", 0.42, 0.37, 0.30);
    b.on("rug", rug)
        .block(at(0.55, 0.0, 0.95), at(3.05, 0.012, 2.85), STANDING);
    let height = 0.012;
    put::table(
        b,
        "table",
        Place::new(at(1.8, height, 1.9), 0.0),
        1.7,
        0.9,
        oak,
    );
    let places = [
        (1.4, 1.28, 4.0),
        (2.2, 1.32, -6.0),
        (1.35, 2.52, 176.0),
        (2.25, 2.64, 156.0),
    ];
    for (i, (x, z, turn)) in places.into_iter().enumerate() {
        let name = format!("chair {}", i + 1);
        put::chair(b, &name, Place::new(at(x, height, z), turn), oak, seat);
    }
    let china = b.thin("china", 0.74, 0.73, 0.70);
    let top = 0.75 + height;
    b.on("bowl", china)
        .frustum(at(1.8, top, 1.85), [0.07, 0.16], 0.075, 24);
    b.disc(at(1.8, top + 0.004, 1.85), 0.072, 24, true);
    let apple = b.matte("apple", 0.50, 0.09, 0.05);
    let lemon = b.matte("lemon", 0.78, 0.56, 0.08);
    for (finish, x, y, z) in [
        (apple, 1.765, 0.062, 1.82),
        (lemon, 1.85, 0.060, 1.835),
        (apple, 1.81, 0.062, 1.91),
    ] {
        let name = if finish == apple { "apples" } else { "lemon" };
        b.on(name, finish).ball(at(x, top + y, z), 0.04, 8, 12);
    }
    for (x, z) in [(1.32, 1.70), (2.25, 1.68), (1.32, 2.12), (2.28, 2.12)] {
        b.on("plates", china)
            .frustum(at(x, top, z), [0.07, 0.125], 0.016, 20);
        b.disc(at(x, top + 0.002, z), 0.08, 20, true);
    }

    let frame = b.matte("white metal", 0.72, 0.72, 0.72);
    // 4,000 lm from 0.36 m²: about 3,500 cd/m², as an edge-lit office panel.
    let light = b.luminous(
        "panel",
        0.7,
        luminance_of(4000.0, 0.36),
        Rgb::new(1.03, 1.0, 0.90),
    );
    let hook = Place::new(at(1.8, HEIGHT, 1.75), 0.0);
    put::ceiling_panel(b, "panel", hook, [0.6, 0.6], [frame, light]);

    let shelf = Bookshelf {
        size: [1.5, 2.0, 0.3],
        levels: 5,
        wood: oak,
        books: &books,
        full: 0.8,
        seed: 3,
    };
    put::bookshelf(b, "bookshelf", Place::new(at(1.3, 0.0, 0.025), 0.0), &shelf);

    // A sideboard on the right wall, its front towards -x.
    b.inside(Place::new(at(WIDTH - 0.02, 0.0, 2.1), -90.0), |b| {
        b.on("sideboard", walnut);
        b.block(at(-0.8, 0.14, 0.0), at(0.8, 0.78, 0.42), ALL & !FRONT);
        for (low, high) in [(-0.8, -0.27), (-0.265, 0.265), (0.27, 0.8)] {
            b.block(at(low, 0.14, 0.42), at(high, 0.775, 0.438), ALL & !BACK);
        }
        for (x, z) in [(-0.75, 0.05), (0.75, 0.05), (-0.75, 0.37), (0.75, 0.37)] {
            b.block(
                at(x - 0.02, 0.0, z - 0.02),
                at(x + 0.02, 0.14, z + 0.02),
                faces::POST,
            );
        }
        let glaze = b.matte("blue glaze", 0.06, 0.17, 0.34);
        b.on("vase", glaze)
            .frustum(at(-0.45, 0.78, 0.2), [0.05, 0.095], 0.13, 20);
        b.frustum(at(-0.45, 0.91, 0.2), [0.095, 0.04], 0.14, 20);
        b.disc(at(-0.45, 1.05, 0.2), 0.04, 20, true);
        b.on("ball", china).ball(at(0.38, 0.86, 0.22), 0.08, 10, 16);
    });
    let hills = b.texture(pictures::hills());
    let hills = b.pictured("hills", hills, 0.34);
    let wall = Place::new(at(WIDTH, 1.55, 2.1), -90.0);
    put::framed(b, "landscape", wall, [1.0, 0.75], [walnut, hills]);

    let pot = b.matte("clay", 0.42, 0.20, 0.12);
    let soil = b.matte("soil", 0.06, 0.045, 0.03);
    let leaf = b.thin("leaf", 0.09, 0.26, 0.07);
    put::plant(
        b,
        "plant",
        Place::new(at(4.58, 0.0, 0.52), 0.0),
        [pot, soil, leaf],
        [1.25, 54.0],
        5,
    );
}

fn living(b: &mut Builder) {
    let cloth = b.matte("sofa cloth", 0.16, 0.24, 0.27);
    let feet = b.matte("dark wood", 0.10, 0.06, 0.035);
    let mustard = b.matte("mustard cushion", 0.62, 0.38, 0.06);
    let wool = b.matte("cream rug", 0.55, 0.50, 0.42);
    let brass = b.matte("brass", 0.42, 0.30, 0.13);

    put::sofa(
        b,
        "sofa",
        Place::new(at(3.35, 0.0, -3.8), 0.0),
        2.0,
        cloth,
        feet,
    );
    b.on("cushions", mustard);
    for (x, turn) in [(2.78, 14.0), (3.9, -11.0)] {
        b.inside(Place::new(at(x, 0.43, -3.86), turn), |b| {
            b.block(at(-0.2, 0.0, -0.06), at(0.2, 0.36, 0.06), STANDING);
        });
    }
    b.on("living room: rug", wool)
        .block(at(2.3, 0.0, -3.3), at(4.5, 0.012, -1.3), STANDING);
    b.inside(Place::new(at(3.4, 0.012, -2.4), 0.0), |b| {
        b.on("low table", feet);
        b.frustum(at(0.0, 0.36, 0.0), [0.42, 0.42], 0.03, 28);
        b.disc(at(0.0, 0.39, 0.0), 0.42, 28, true)
            .disc(at(0.0, 0.36, 0.0), 0.42, 28, false);
        for i in 0..3 {
            let angle = (120.0 * i as f32 + 30.0).to_radians();
            b.frustum(
                at(0.3 * angle.cos(), 0.0, 0.3 * angle.sin()),
                [0.015, 0.02],
                0.36,
                8,
            );
        }
    });
    let paper = b.matte("magazine", 0.66, 0.66, 0.64);
    b.inside(Place::new(at(3.3, 0.402, -2.36), 25.0), |b| {
        b.on("magazine", paper)
            .block(at(-0.11, 0.0, -0.15), at(0.11, 0.01, 0.15), STANDING);
    });

    // Opal glass: 2,000 lm from a ball of 0.4 m.
    let area = 4.0 * std::f32::consts::PI * 0.2 * 0.2;
    let warm = Rgb::new(1.32, 0.96, 0.52);
    let light = b.luminous("globe", 0.6, luminance_of(2000.0, area), warm);
    let middle = Place::new(at(3.15, 2.0, -2.3), 0.0);
    put::globe(b, "globe", middle, [0.2, HEIGHT - 2.0], [brass, light]);

    // 1,100 lm from both sides of the shade.
    let slant = (0.30f32 * 0.30 + 0.06 * 0.06).sqrt();
    let area = 2.0 * std::f32::consts::PI * (0.23 + 0.17) * slant;
    let shade = b.luminous("shade", 0.55, luminance_of(1100.0, area), warm);
    b.edit(shade, |finish: &mut Finish| {
        finish.back_reflects = true;
        finish.back_emits = true;
    });
    put::floor_lamp(
        b,
        "standard lamp",
        Place::new(at(4.66, 0.0, -3.86), 0.0),
        brass,
        shade,
    );

    let discs = b.texture(pictures::discs());
    let discs = b.pictured("discs", discs, 0.45);
    let wall = Place::new(at(3.35, 1.52, BACK_Z), 0.0);
    put::framed(b, "print", wall, [0.6, 0.8], [feet, discs]);
    let hills = Place::new(at(0.0, 1.5, -2.2), 90.0);
    put::framed(b, "print 2", hills, [0.6, 0.8], [feet, discs]);

    // A bench by the left wall, seen from the living room's view.
    b.inside(Place::new(at(0.3, 0.0, -1.4), 90.0), |b| {
        b.on("bench", feet);
        b.block(at(-0.6, 0.40, -0.2), at(0.6, 0.44, 0.2), ALL);
        for x in [-0.5, 0.5] {
            b.block(
                at(x - 0.02, 0.0, -0.18),
                at(x + 0.02, 0.40, 0.18),
                faces::POST,
            );
        }
    });
}
