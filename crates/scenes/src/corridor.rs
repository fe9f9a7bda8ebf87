//! A corridor as long as one likes: the load of the growth benches.
//!
//! Bays of 2.4 x 2.4 m and 2.7 m height, each with its ceiling panel, a door, a shelf of books, a bin, a
//! plant, a bench and a notice board: about a thousand triangles a bay, most of them small. All panels
//! are one luminaire group. After 25 bays the corridor turns back beside itself through an
//! opening, so that a million triangles fit into a hundred metres, where `f32` still knows
//! a micrometre; from any bay only its own row is in sight. Both ends are closed, and the shell
//! (floor, ceiling, walls, linings) is closed.

use crate::builder::{Builder, Place, at, faces, luminance_of};
use crate::furniture::{self as put, Bookshelf};
use faces::{ALL, BACK, BOTTOM, FRONT, LEFT, RIGHT, TOP};
use luxel_core::{FinishId, Rgb, Scene, Vec3};

const LENGTH: f32 = 2.4;
const WIDTH: f32 = 2.4;
const HEIGHT: f32 = 2.7;
const THICK: f32 = 0.1;
const ROW: usize = 25;
/// The opening between two rows: along the bay, and its height.
const OPENING: [f32; 2] = [0.4, 2.0];
const HEAD: f32 = 2.2;
/// Triangles of a bay without opening, on average.
const PER_BAY: usize = 1000;

/// A corridor of about so many triangles (within 5 % from 10,000 on, and never less than a bay);
/// view `corridor`.
pub fn corridor(triangles: usize) -> Scene {
    let bays = ((triangles + PER_BAY / 2) / PER_BAY).max(1);
    let mut b = Builder::new("corridor");
    let kit = Kit::new(&mut b);
    for bay in 0..bays {
        let (row, place) = (bay / ROW, bay % ROW);
        let forth = row % 2 == 0;
        // Every second row runs back, so the bay after a turn lies beside the bay before it.
        let column = if forth { place } else { ROW - 1 - place };
        let turns = place + 1 == ROW && bay + 1 < bays;
        let ends = |low: bool| {
            let first = place == 0;
            let last = place + 1 == ROW || bay + 1 == bays;
            if low == forth { first } else { last }
        };
        let origin = at(row as f32 * (WIDTH + THICK), 0.0, column as f32 * LENGTH);
        b.inside(Place::new(origin, 0.0), |b| {
            let sides = Sides {
                left_open: place == 0 && row > 0,
                right_open: turns,
                low_end: ends(true),
                high_end: ends(false),
            };
            shell(b, &kit, row, sides);
            furnish(b, &kit, row, bay as u64, sides);
        });
    }
    let eye = at(1.3, 1.6, 0.25);
    b.view("corridor", eye, eye + at(-0.02, -0.12, 1.0), 60.0);
    b.build()
}

#[derive(Clone, Copy)]
struct Sides {
    left_open: bool,
    right_open: bool,
    low_end: bool,
    high_end: bool,
}

struct Kit {
    floor: FinishId,
    wall: FinishId,
    ceiling: FinishId,
    frame: FinishId,
    panel: FinishId,
    wood: FinishId,
    metal: FinishId,
    books: [FinishId; 4],
    bin: FinishId,
    paper: FinishId,
    plant: [FinishId; 3],
}

impl Kit {
    fn new(b: &mut Builder) -> Kit {
        let grey = |b: &mut Builder, name: &str, v: f32| b.matte(name, v, v, v);
        Kit {
            floor: b.matte("linoleum", 0.30, 0.28, 0.24),
            wall: grey(b, "wall paint", 0.75),
            ceiling: grey(b, "ceiling paint", 0.85),
            frame: grey(b, "white metal", 0.7),
            // 2,400 lm from 0.9 x 0.3 m.
            panel: b.luminous("panels", 0.7, luminance_of(2400.0, 0.27), Rgb::WHITE),
            wood: b.matte("beech", 0.48, 0.33, 0.19),
            metal: grey(b, "steel", 0.4),
            books: [
                b.matte("book red", 0.42, 0.08, 0.06),
                b.matte("book blue", 0.07, 0.14, 0.32),
                b.matte("book ochre", 0.55, 0.36, 0.10),
                b.matte("book white", 0.70, 0.68, 0.60),
            ],
            bin: b.thin("bin", 0.12, 0.13, 0.15),
            paper: b.matte("paper", 0.78, 0.77, 0.72),
            plant: [
                b.matte("clay", 0.42, 0.20, 0.12),
                b.matte("soil", 0.06, 0.045, 0.03),
                b.thin("leaf", 0.09, 0.26, 0.07),
            ],
        }
    }
}

fn shell(b: &mut Builder, kit: &Kit, row: usize, s: Sides) {
    let (low, high) = (Vec3::ZERO, at(WIDTH, HEIGHT, LENGTH));
    let [z0, z1] = OPENING;
    // Counter-clockwise from above: down the left side, up the right.
    let mut floor = vec![at(0.0, 0.0, 0.0)];
    if s.left_open {
        floor.extend([at(0.0, 0.0, z0), at(0.0, 0.0, z1)]);
    }
    floor.extend([at(0.0, 0.0, LENGTH), at(WIDTH, 0.0, LENGTH)]);
    if s.right_open {
        floor.extend([at(WIDTH, 0.0, z1), at(WIDTH, 0.0, z0)]);
    }
    floor.push(at(WIDTH, 0.0, 0.0));
    b.on(&format!("row {}: floor", row + 1), kit.floor)
        .polygon(&floor);
    b.on(&format!("row {}: ceiling", row + 1), kit.ceiling)
        .room(low, high, TOP);
    b.on(&format!("row {}: walls", row + 1), kit.wall);
    for (end, bit) in [(s.low_end, BACK), (s.high_end, FRONT)] {
        if end {
            b.room(low, high, bit);
        }
    }
    for (open, bit, x) in [(s.left_open, LEFT, 0.0), (s.right_open, RIGHT, WIDTH)] {
        if !open {
            b.room(low, high, bit);
            continue;
        }
        let mut wall = [
            (0.0, 0.0),
            (z0, 0.0),
            (z0, HEAD),
            (z1, HEAD),
            (z1, 0.0),
            (LENGTH, 0.0),
        ]
        .map(|(z, y)| at(x, y, z))
        .to_vec();
        wall.extend([at(x, HEIGHT, LENGTH), at(x, HEIGHT, 0.0)]);
        if bit == LEFT {
            wall.reverse();
        }
        b.polygon(&wall);
    }
    if s.right_open {
        let lining = [at(WIDTH, 0.0, z0), at(WIDTH + THICK, HEAD, z1)];
        b.room(lining[0], lining[1], TOP | BACK | FRONT);
        b.on(&format!("row {}: floor", row + 1), kit.floor)
            .room(lining[0], lining[1], BOTTOM);
    }
}

fn furnish(b: &mut Builder, kit: &Kit, row: usize, bay: u64, s: Sides) {
    let name = |what: &str| format!("row {}: {what}", row + 1);
    let hook = Place::new(at(WIDTH / 2.0, HEIGHT, LENGTH / 2.0), 0.0);
    put::ceiling_panel(b, &name("panels"), hook, [0.3, 0.9], [kit.frame, kit.panel]);
    if !s.left_open {
        let shelf = Bookshelf {
            size: [1.7, 2.0, 0.28],
            levels: 5,
            wood: kit.wood,
            books: &kit.books,
            full: 0.265,
            seed: 100 + bay,
        };
        put::bookshelf(
            b,
            &name("shelves"),
            Place::new(at(0.02, 0.0, 1.1), 90.0),
            &shelf,
        );
    }
    if !s.right_open {
        let wall = Place::new(at(WIDTH, 0.0, 0.62), -90.0);
        put::closed_door(b, &name("doors"), wall, kit.wood, kit.metal);
        notices(
            b,
            kit,
            &name("notices"),
            Place::new(at(WIDTH, 1.5, 1.8), -90.0),
        );
    }
    let spot = Place::new(at(WIDTH - 0.24, 0.0, 2.16), 0.0);
    put::plant(b, &name("plants"), spot, kit.plant, [0.8, 36.0], 900 + bay);
    // An open bin: both sides of its wall are seen, and its bottom lies above the floor.
    b.on(&name("bins"), kit.bin);
    let foot = at(WIDTH - 0.22, 0.0, 1.32);
    b.frustum(foot, [0.1, 0.13], 0.3, 12)
        .disc(foot + Vec3::Y * 0.01, 0.101, 12, true);
    b.on(&name("benches"), kit.wood)
        .inside(Place::new(at(WIDTH - 0.2, 0.0, 1.68), 90.0), |b| {
            b.block(at(-0.2, 0.4, -0.16), at(0.2, 0.43, 0.16), ALL);
            for x in [-0.17, 0.17] {
                b.block(
                    at(x - 0.015, 0.0, -0.14),
                    at(x + 0.015, 0.4, 0.14),
                    faces::POST,
                );
            }
        });
}

/// A board with papers, a millimetre thick each.
fn notices(b: &mut Builder, kit: &Kit, name: &str, place: Place) {
    b.inside(place, |b| {
        b.on(name, kit.wood)
            .block(at(-0.4, -0.3, 0.0), at(0.4, 0.3, 0.015), ALL & !BACK);
        b.on(name, kit.paper);
        for i in 0..4 {
            for j in 0..2 {
                let corner = at(-0.36 + 0.185 * i as f32, -0.25 + 0.27 * j as f32, 0.015);
                b.inside(Place::new(corner, 0.0), |b| {
                    b.block(Vec3::ZERO, at(0.15, 0.21, 0.001), ALL & !BACK);
                });
            }
        }
    });
}
