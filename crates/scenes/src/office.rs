//! An open-plan office and a store room lit only through the gap of a door left ajar.
//!
//! Office 12 x 9 x 3 m: 24 desks with screens, drawers and chairs, eight shelves of books along the
//! walls, plants, and twelve ceiling panels of 1.2 x 0.6 m and 5,200 lm in three rows, a material
//! and so a luminaire group each. The window wall is closed: dark panes in white frames. Store room
//! 3 x 4 x 3 m behind a wall of 12 cm; its door stands ajar by 14 degrees, so that about 20 cm are open.
//! Floor .25, walls .7, ceiling .85. The shell (floors, ceilings, walls, lining) is closed.

use crate::builder::{Builder, Place, at, faces, luminance_of};
use crate::furniture::{self as put, Bookshelf};
use faces::{ALL, BACK, BOTTOM, FRONT, HANGING, LEFT, POST, RIGHT, STANDING, TOP};
use luxel_core::{FinishId, Rgb, Scene, Vec3};

const WIDTH: f32 = 12.0;
const DEPTH: f32 = 9.0;
const HEIGHT: f32 = 3.0;
/// Store room beyond x = `WIDTH + THICK`.
const THICK: f32 = 0.12;
const STORE_X: f32 = WIDTH + THICK + 3.0;
const STORE_Z: f32 = 4.0;
/// Door in the wall at x = `WIDTH`, along z, and its height.
const DOOR: [f32; 2] = [1.5, 2.4];
const HEAD: f32 = 2.05;

/// The office; views `office`, `desks` and `store room`, groups `row 1` to `row 3`.
pub fn office() -> Scene {
    let mut b = Builder::new("office");
    shell(&mut b);
    lights(&mut b);
    windows(&mut b);
    let books = books(&mut b);
    let wood = b.matte("maple", 0.52, 0.38, 0.24);
    desks(&mut b, wood);
    shelves(&mut b, wood, &books);
    store(&mut b, wood, &books);
    b.view("office", at(0.5, 1.7, 8.6), at(6.5, 0.9, 3.0), 55.0);
    b.view("desks", at(11.5, 1.45, 8.5), at(6.0, 0.9, 4.0), 50.0);
    b.view("store room", at(14.9, 1.6, 3.8), at(12.2, 1.1, 1.4), 60.0);
    b.build()
}

fn shell(b: &mut Builder) {
    let carpet = b.matte("carpet", 0.24, 0.25, 0.27);
    let white = b.matte("wall paint", 0.70, 0.70, 0.68);
    let ceiling = b.matte("ceiling tiles", 0.85, 0.85, 0.85);
    let near = at(WIDTH, HEIGHT, DEPTH);
    let [z0, z1] = DOOR;
    b.on("office: floor", carpet).polygon(&[
        at(0.0, 0.0, 0.0),
        at(0.0, 0.0, DEPTH),
        at(WIDTH, 0.0, DEPTH),
        at(WIDTH, 0.0, z1),
        at(WIDTH, 0.0, z0),
        at(WIDTH, 0.0, 0.0),
    ]);
    b.on("office: ceiling", ceiling).room(Vec3::ZERO, near, TOP);
    b.on("office: walls", white)
        .room(Vec3::ZERO, near, LEFT | FRONT | BACK);
    b.polygon(&wall_with_door(WIDTH, DEPTH));

    let store = [at(WIDTH + THICK, 0.0, 0.0), at(STORE_X, HEIGHT, STORE_Z)];
    b.on("store room: floor", carpet).polygon(&[
        at(store[0].x, 0.0, 0.0),
        at(store[0].x, 0.0, z0),
        at(store[0].x, 0.0, z1),
        at(store[0].x, 0.0, STORE_Z),
        at(STORE_X, 0.0, STORE_Z),
        at(STORE_X, 0.0, 0.0),
    ]);
    b.on("store room: ceiling", ceiling)
        .room(store[0], store[1], TOP);
    b.on("store room: walls", white)
        .room(store[0], store[1], RIGHT | FRONT | BACK);
    let mut other = wall_with_door(store[0].x, STORE_Z);
    other.reverse();
    b.polygon(&other);
    let lining = [at(WIDTH, 0.0, z0), at(store[0].x, HEAD, z1)];
    b.on("door: floor", carpet)
        .room(lining[0], lining[1], BOTTOM);
    b.on("door: lining", white)
        .room(lining[0], lining[1], FRONT | BACK | TOP);

    // Hinged at its far edge on the store room's side, clear of the lining all round.
    let grey = b.matte("door paint", 0.5, 0.52, 0.55);
    let hinge = Place::new(at(store[0].x - 0.042, 0.0, z0 + 0.012), 14.0);
    b.inside(hinge, |b| {
        b.on("door: leaf", grey);
        b.block(
            at(0.0, 0.006, 0.0),
            at(0.04, HEAD - 0.003, z1 - z0 - 0.016),
            ALL,
        );
        let steel = b.matte("door steel", 0.4, 0.4, 0.4);
        b.on("door: handle", steel);
        b.block(
            at(-0.05, 1.02, 0.78),
            at(0.0, 1.04, 0.80),
            POST & !RIGHT | TOP | BOTTOM,
        );
        b.block(at(-0.066, 1.02, 0.68), at(-0.051, 1.04, 0.81), ALL);
    });
}

/// The dividing wall at `x` from z = 0 to `depth`, seen from -x.
fn wall_with_door(x: f32, depth: f32) -> [Vec3; 8] {
    let [z0, z1] = DOOR;
    [
        (0.0, 0.0),
        (z0, 0.0),
        (z0, HEAD),
        (z1, HEAD),
        (z1, 0.0),
        (depth, 0.0),
        (depth, HEIGHT),
        (0.0, HEIGHT),
    ]
    .map(|(z, y)| at(x, y, z))
}

fn lights(b: &mut Builder) {
    let frame = b.matte("white metal", 0.72, 0.72, 0.72);
    for row in 0..3 {
        let name = format!("row {}", row + 1);
        let tint = Rgb::new(1.02, 1.0, 0.94);
        let light = b.luminous(&name, 0.7, luminance_of(5200.0, 0.72), tint);
        for i in 0..4 {
            let hook = at(1.5 + 3.0 * i as f32, HEIGHT, 1.5 + 3.0 * row as f32);
            let panel = format!("panels {name}");
            put::ceiling_panel(b, &panel, Place::new(hook, 0.0), [1.2, 0.6], [frame, light]);
        }
    }
}

/// Four closed windows on the wall at x = 0: frames that stand out, dark panes, sills.
fn windows(b: &mut Builder) {
    let frame = b.matte("window frame", 0.72, 0.72, 0.72);
    let pane = b.matte("night pane", 0.06, 0.065, 0.08);
    let heater = b.matte("heater", 0.74, 0.74, 0.72);
    for i in 0..4 {
        b.inside(Place::new(at(0.0, 0.0, 1.2 + 2.2 * i as f32), 90.0), |b| {
            // Local x runs along the wall, z into the room.
            b.on("windows: frames", frame);
            b.block(at(-0.95, 0.95, 0.0), at(0.95, 0.99, 0.22), ALL & !BACK);
            b.block(at(-0.95, 2.45, 0.0), at(0.95, 2.52, 0.06), ALL & !BACK);
            for x in [-0.95, -0.035, 0.88] {
                b.block(
                    at(x, 0.99, 0.0),
                    at(x + 0.07, 2.45, 0.06),
                    LEFT | RIGHT | FRONT,
                );
            }
            b.on("windows: panes", pane);
            for (low, high) in [(-0.88, -0.035), (0.035, 0.88)] {
                b.block(at(low, 0.99, 0.0), at(high, 2.45, 0.02), FRONT);
            }
            b.on("heaters", heater);
            for k in 0..10 {
                let x = -0.75 + 0.15 * k as f32;
                b.block(at(x, 0.15, 0.04), at(x + 0.13, 0.75, 0.12), ALL);
            }
        });
    }
}

fn books(b: &mut Builder) -> [FinishId; 5] {
    [
        ("binder blue", [0.07, 0.14, 0.32]),
        ("binder red", [0.42, 0.08, 0.06]),
        ("binder grey", [0.30, 0.30, 0.32]),
        ("binder black", [0.05, 0.05, 0.05]),
        ("binder white", [0.70, 0.70, 0.67]),
    ]
    .map(|(name, [r, g, bl])| b.matte(name, r, g, bl))
}

fn desks(b: &mut Builder, wood: FinishId) {
    let steel = b.matte("steel", 0.38, 0.38, 0.40);
    let cloth = b.matte("chair cloth", 0.05, 0.10, 0.19);
    let plastic = b.matte("black plastic", 0.04, 0.04, 0.045);
    let screen = b.matte("screen", 0.03, 0.03, 0.035);
    let drawers = b.matte("drawers", 0.6, 0.6, 0.6);
    let paper = b.matte("paper", 0.78, 0.78, 0.74);
    let china = b.thin("china", 0.6, 0.25, 0.12);
    // Three blocks of eight, face to face in pairs.
    for desk in 0..24u64 {
        let (block, seat) = (desk / 8, desk % 8);
        let (pair, side) = (seat / 2, seat % 2);
        let x = 2.7 + 1.75 * pair as f32;
        let z = 1.8 + 2.65 * block as f32;
        let (dz, turn) = if side == 0 {
            (0.41, 0.0)
        } else {
            (-0.41, 180.0)
        };
        let row = format!("desks {}", block + 1);
        b.inside(Place::new(at(x, 0.0, z + dz), turn), |b| {
            put::table(b, &row, Place::new(Vec3::ZERO, 0.0), 1.6, 0.8, wood);
            b.on(&format!("{row}: drawers"), drawers);
            b.block(at(0.25, 0.08, -0.3), at(0.65, 0.60, 0.28), ALL);
            for k in 0..3 {
                let y = 0.1 + 0.165 * k as f32;
                b.block(at(0.26, y, 0.28), at(0.64, y + 0.155, 0.295), ALL & !BACK);
            }
            b.on(&format!("{row}: screens"), plastic);
            b.block(at(-0.11, 0.75, -0.30), at(0.11, 0.762, -0.12), STANDING);
            b.block(at(-0.025, 0.762, -0.25), at(0.025, 0.92, -0.23), POST);
            b.block(at(-0.28, 0.86, -0.228), at(0.28, 1.20, -0.20), ALL & !FRONT);
            let rim = [(-0.28, 0.86), (0.28, 0.86), (0.28, 1.20), (-0.28, 1.20)];
            let outer = rim.map(|(x, y): (f32, f32)| at(x, y, -0.20));
            let inner = outer.map(|p| at(p.x * 0.965, 1.03 + (p.y - 1.03) * 0.94, -0.20));
            for i in 0..4 {
                let j = (i + 1) % 4;
                b.polygon(&[outer[i], outer[j], inner[j], inner[i]]);
            }
            b.on(&format!("{row}: screens"), screen).polygon(&inner);
            b.on(&format!("{row}: keyboards"), plastic);
            b.block(at(-0.22, 0.75, 0.05), at(0.22, 0.762, 0.20), STANDING);
            for line in 0..3 {
                for key in 0..7 {
                    let low = at(-0.21 + 0.06 * key as f32, 0.762, 0.06 + 0.045 * line as f32);
                    b.block(low, low + at(0.05, 0.004, 0.035), STANDING);
                }
            }
            b.on(&format!("{row}: papers"), paper);
            b.inside(
                Place::new(at(-0.5, 0.75, 0.1), 9.0 * (desk % 5) as f32 - 18.0),
                |b| {
                    b.block(at(-0.105, 0.0, -0.148), at(0.105, 0.012, 0.148), STANDING);
                },
            );
            let cup = at(0.45, 0.75, -0.05);
            b.on(&format!("{row}: cups"), china)
                .frustum(cup, [0.035, 0.042], 0.09, 12);
            b.disc(cup + Vec3::Y * 0.005, 0.0352, 12, true);
            let seat = Place::new(at(-0.1, 0.0, 0.52), 170.0 + 7.0 * (desk % 4) as f32);
            put::office_chair(b, &format!("chairs {}", block + 1), seat, steel, cloth);
        });
    }
}

fn shelves(b: &mut Builder, wood: FinishId, books: &[FinishId]) {
    for i in 0..8u64 {
        // Four along the back wall, four along the front wall.
        let (x, z, turn) = match i {
            0..4 => (2.2 + 2.4 * i as f32, 0.03, 0.0),
            _ => (3.0 + 2.0 * (i - 4) as f32, DEPTH - 0.03, 180.0),
        };
        let shelf = Bookshelf {
            size: [1.2, 1.9, 0.34],
            levels: 5,
            wood,
            books,
            full: 0.62,
            seed: 40 + i,
        };
        put::bookshelf(b, "shelves", Place::new(at(x, 0.0, z), turn), &shelf);
    }
    let pot = b.matte("clay", 0.42, 0.20, 0.12);
    let soil = b.matte("soil", 0.06, 0.045, 0.03);
    let leaf = b.thin("leaf", 0.09, 0.26, 0.07);
    for (i, (x, z)) in [(0.6, 0.45), (11.5, 8.5), (11.5, 0.5)]
        .into_iter()
        .enumerate()
    {
        let place = Place::new(at(x, 0.0, z), 70.0 * i as f32);
        put::plant(
            b,
            "plants",
            place,
            [pot, soil, leaf],
            [1.5, 60.0],
            70 + i as u64,
        );
    }
}

fn store(b: &mut Builder, wood: FinishId, books: &[FinishId]) {
    let boxes = b.matte("cardboard", 0.42, 0.29, 0.17);
    for (i, z) in [0.9f32, 2.2, 3.3].into_iter().enumerate() {
        let shelf = Bookshelf {
            size: [0.95, 2.2, 0.36],
            levels: 6,
            wood,
            books,
            full: 0.45,
            seed: 60 + i as u64,
        };
        put::bookshelf(
            b,
            "store room: shelves",
            Place::new(at(STORE_X - 0.03, 0.0, z), -90.0),
            &shelf,
        );
    }
    b.on("store room: boxes", boxes);
    for (x, y, z, turn) in [
        (12.6, 0.0, 3.5, 8.0),
        (12.58, 0.32, 3.5, -5.0),
        (13.3, 0.0, 3.6, 14.0),
        (13.6, 0.0, 0.4, 3.0),
    ] {
        b.inside(Place::new(at(x, y, z), turn), |b| {
            b.block(at(-0.24, 0.0, -0.18), at(0.24, 0.32, 0.18), STANDING);
        });
    }
    let shade = b.matte("dead lamp", 0.7, 0.7, 0.7);
    b.on("store room: lamp, off", shade);
    b.block(
        at(13.3, HEIGHT - 0.08, 1.9),
        at(14.5, HEIGHT, 2.05),
        HANGING,
    );
}
