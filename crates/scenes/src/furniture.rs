//! Things that stand in the rooms. Each is built around a local origin on the floor (or where
//! its text says), with its front towards +z, and leaves out the faces that nothing can see.

use crate::builder::{Builder, Place, at, faces, random};
use faces::{ALL, BACK, BOTTOM, FRONT, HANGING, LEFT, POST, RIGHT, STANDING, TOP};
use luxel_core::{FinishId, Vec3};

/// A table `w` x `d` metres and 0.75 m high on four legs.
pub fn table(b: &mut Builder, name: &str, place: Place, w: f32, d: f32, wood: FinishId) {
    b.inside(place, |b| {
        b.on(name, wood);
        b.block(
            at(-w / 2.0, 0.715, -d / 2.0),
            at(w / 2.0, 0.75, d / 2.0),
            ALL,
        );
        let (x, z) = (w / 2.0 - 0.08, d / 2.0 - 0.08);
        for (x, z) in [(-x, -z), (x, -z), (-x, z), (x, z)] {
            b.block(
                at(x - 0.03, 0.0, z - 0.03),
                at(x + 0.03, 0.715, z + 0.03),
                POST,
            );
        }
    });
}

/// A wooden chair that looks towards +z, its seat 0.46 m high.
pub fn chair(b: &mut Builder, name: &str, place: Place, wood: FinishId, seat: FinishId) {
    b.inside(place, |b| {
        b.on(name, wood);
        for x in [-0.19, 0.19] {
            b.block(at(x - 0.018, 0.0, 0.17), at(x + 0.018, 0.43, 0.206), POST);
            b.block(at(x - 0.018, 0.0, -0.216), at(x + 0.018, 0.43, -0.18), POST);
            b.block(
                at(x - 0.018, 0.46, -0.216),
                at(x + 0.018, 0.86, -0.18),
                STANDING,
            );
        }
        for y in [0.58, 0.74] {
            b.block(
                at(-0.172, y, -0.208),
                at(0.172, y + 0.08, -0.19),
                FRONT | BACK | TOP | BOTTOM,
            );
        }
        b.on(&format!("{name}: seat"), seat);
        b.block(at(-0.22, 0.43, -0.23), at(0.22, 0.46, 0.22), ALL);
    });
}

/// An office chair on a column with a five-armed foot.
pub fn office_chair(b: &mut Builder, name: &str, place: Place, metal: FinishId, cloth: FinishId) {
    b.inside(place, |b| {
        b.on(name, metal);
        b.frustum(at(0.0, 0.09, 0.0), [0.03, 0.03], 0.34, 8);
        for arm in 0..5 {
            b.inside(Place::new(Vec3::ZERO, 72.0 * arm as f32), |b| {
                b.block(at(0.035, 0.05, -0.02), at(0.29, 0.09, 0.02), ALL);
                b.block(at(0.26, 0.0, -0.015), at(0.28, 0.05, 0.015), POST);
            });
        }
        b.block(
            at(-0.03, 0.40, -0.29),
            at(0.03, 0.43, -0.04),
            ALL & !TOP & !BACK,
        );
        b.block(at(-0.03, 0.40, -0.31), at(0.03, 0.60, -0.29), ALL);
        b.on(&format!("{name}: seat"), cloth);
        b.block(at(-0.24, 0.43, -0.23), at(0.24, 0.50, 0.24), ALL);
        b.block(at(-0.22, 0.58, -0.285), at(0.22, 1.02, -0.23), ALL);
    });
}

/// What a bookshelf is made of and filled with.
pub struct Bookshelf<'a> {
    /// Width, height and depth, metres.
    pub size: [f32; 3],
    /// Compartments, one above the other.
    pub levels: usize,
    /// Boards.
    pub wood: FinishId,
    /// Books, picked by chance.
    pub books: &'a [FinishId],
    /// How much of each board is filled, 0..=1.
    pub full: f32,
    /// Seed of thickness, height and colour.
    pub seed: u64,
}

/// A shelf with a back, full of books; its origin is the middle of its back's foot.
pub fn bookshelf(b: &mut Builder, name: &str, place: Place, shelf: &Bookshelf) {
    let ([w, h, d], t) = (shelf.size, 0.022);
    let (left, right) = (-w / 2.0 + t, w / 2.0 - t);
    let clear = (h - 0.08 - t) / shelf.levels as f32;
    b.inside(place, |b| {
        b.on(name, shelf.wood);
        b.block(at(left - t, 0.0, 0.0), at(left, h - t, d), POST);
        b.block(at(right, 0.0, 0.0), at(right + t, h - t, d), POST);
        b.block(at(left - t, h - t, 0.0), at(right + t, h, d), ALL);
        b.block(at(left, 0.0, 0.0), at(right, h - t, 0.01), FRONT | BACK);
        b.block(
            at(left, 0.0, d - 0.04),
            at(right, 0.08 - t, d - 0.02),
            FRONT | BACK,
        );
        for level in 0..shelf.levels {
            let y = 0.08 + level as f32 * clear;
            b.block(
                at(left, y - t, 0.01),
                at(right, y, d - 0.005),
                FRONT | TOP | BOTTOM,
            );
        }
    });
    for level in 0..shelf.levels {
        let y = 0.08 + level as f32 * clear;
        let seed = shelf.seed * 64 + level as u64;
        let reach = left + (right - left) * (shelf.full * (0.85 + 0.3 * random(seed, 0))).min(0.98);
        let (mut x, mut n) = (left + 0.006, 0);
        loop {
            let [thick, tall, deep, pick] = [1, 2, 3, 4].map(|k| random(seed, 8 * n + k));
            let thickness = 0.016 + 0.032 * thick;
            if x + thickness > reach {
                break;
            }
            let height = (clear - t) * (0.58 + 0.34 * tall);
            let depth = (d - 0.05) * (0.66 + 0.26 * deep);
            let finish = shelf.books[(pick * shelf.books.len() as f32) as usize];
            b.on(&format!("{name}: books"), finish).inside(place, |b| {
                let front = d - 0.03;
                b.block(
                    at(x, y, front - depth),
                    at(x + thickness, y + height, front),
                    STANDING,
                );
            });
            x += thickness + 0.0015;
            n += 1;
        }
    }
}

/// A sofa `w` metres wide with two cushions.
pub fn sofa(b: &mut Builder, name: &str, place: Place, w: f32, cloth: FinishId, feet: FinishId) {
    let x = w / 2.0 - 0.16;
    b.inside(place, |b| {
        b.on(name, cloth);
        b.block(
            at(-x, 0.10, -0.44),
            at(x, 0.28, 0.40),
            FRONT | BACK | TOP | BOTTOM,
        );
        b.block(
            at(-x + 0.005, 0.28, -0.42),
            at(x - 0.005, 0.80, -0.22),
            STANDING,
        );
        b.block(at(-x - 0.16, 0.10, -0.45), at(-x, 0.58, 0.42), ALL);
        b.block(at(x, 0.10, -0.45), at(x + 0.16, 0.58, 0.42), ALL);
        for (low, high) in [(-x + 0.01, -0.005), (0.005, x - 0.01)] {
            b.block(at(low, 0.281, -0.205), at(high, 0.43, 0.43), ALL);
        }
        b.on(&format!("{name}: feet"), feet);
        for (x, z) in [(-x, -0.38), (x, -0.38), (-x, 0.34), (x, 0.34)] {
            b.frustum(at(x, 0.0, z), [0.018, 0.025], 0.10, 8);
        }
    });
}

/// A potted plant; each leaf is two triangles that shine on both sides.
pub fn plant(
    b: &mut Builder,
    name: &str,
    place: Place,
    [pot, soil, leaf]: [FinishId; 3],
    [height, leaves]: [f32; 2],
    seed: u64,
) {
    let (rim, sides) = (0.17 * height.min(1.0), 14);
    let pot_height = 0.3 * height.min(1.0);
    b.inside(place, |b| {
        b.on(&format!("{name}: pot"), pot);
        b.frustum(Vec3::ZERO, [rim * 0.72, rim], pot_height, sides);
        let level = Vec3::Y * pot_height;
        b.on(&format!("{name}: soil"), soil)
            .disc(level, rim, sides, true);
        b.on(&format!("{name}: leaves"), leaf);
        for k in 0..leaves as u64 {
            let [turn, rise, size, root] = [1, 2, 3, 4].map(|j| random(seed, 8 * k + j));
            // Golden angle: no leaf stands right above another.
            let angle = (137.508 * k as f32 + 30.0 * turn).to_radians();
            let out = at(angle.cos(), 0.0, angle.sin());
            let side = at(-out.z, 0.0, out.x);
            let share = k as f32 / leaves;
            let length = (0.26 + 0.14 * size) * height.min(1.4);
            let lift = 0.25 + 0.65 * share + 0.2 * rise;
            let along = (out + Vec3::Y * lift * 1.5).normalize();
            let from = level
                + Vec3::Y * (0.02 + (height - pot_height) * 0.62 * share)
                + out * rim * 0.3 * root;
            let middle = from + along * length * 0.55;
            let tip = middle + (along - Vec3::Y * 0.9 * (1.0 - share)).normalize() * length * 0.55;
            let half = side * length * 0.17;
            b.polygon(&[from, middle + half, middle - half]);
            b.polygon(&[middle - half, middle + half, tip]);
        }
    });
}

/// A flat luminaire of `w` x `d` metres in a narrow frame, 4 cm deep; its origin is the middle
/// of its top, on the ceiling.
pub fn ceiling_panel(
    b: &mut Builder,
    name: &str,
    place: Place,
    [w, d]: [f32; 2],
    [frame, light]: [FinishId; 2],
) {
    let (x, z, rim, y) = (w / 2.0, d / 2.0, 0.015, -0.04);
    b.inside(place, |b| {
        b.on(&format!("{name}: frame"), frame);
        b.block(
            at(-x - rim, y, -z - rim),
            at(x + rim, 0.0, z + rim),
            HANGING & !BOTTOM,
        );
        let outer = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(i, k): (f32, f32)| at(i * (x + rim), y, k * (z + rim)));
        let inner = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(i, k): (f32, f32)| at(i * x, y, k * z));
        for i in 0..4 {
            let j = (i + 1) % 4;
            b.polygon(&[outer[i], outer[j], inner[j], inner[i]]);
        }
        b.on(name, light).polygon(&inner);
    });
}

/// A luminous globe on a cable; its origin is the globe's middle, the ceiling `drop` above it.
pub fn globe(
    b: &mut Builder,
    name: &str,
    place: Place,
    [radius, drop]: [f32; 2],
    [cable, light]: [FinishId; 2],
) {
    b.inside(place, |b| {
        b.on(&format!("{name}: cable"), cable);
        b.frustum(
            at(0.0, radius + 0.04, 0.0),
            [0.004, 0.004],
            drop - radius - 0.04,
            6,
        );
        let cap = at(0.0, radius - 0.01, 0.0);
        b.frustum(cap, [0.05, 0.03], 0.05, 12)
            .disc(cap + Vec3::Y * 0.05, 0.03, 12, true);
        b.on(name, light).ball(Vec3::ZERO, radius, 12, 20);
    });
}

/// A standard lamp 1.6 m high whose shade, open above and below, shines on both sides.
pub fn floor_lamp(b: &mut Builder, name: &str, place: Place, metal: FinishId, shade: FinishId) {
    b.inside(place, |b| {
        b.on(&format!("{name}: stand"), metal);
        b.frustum(Vec3::ZERO, [0.15, 0.14], 0.025, 20)
            .disc(at(0.0, 0.025, 0.0), 0.14, 20, true);
        b.frustum(at(0.0, 0.025, 0.0), [0.011, 0.011], 1.4, 8).disc(
            at(0.0, 1.425, 0.0),
            0.011,
            8,
            true,
        );
        b.on(name, shade)
            .frustum(at(0.0, 1.28, 0.0), [0.23, 0.17], 0.30, 24);
    });
}

/// A framed picture `w` x `h` metres; its origin is the middle of its back, on the wall.
pub fn framed(
    b: &mut Builder,
    name: &str,
    place: Place,
    [w, h]: [f32; 2],
    [frame, picture]: [FinishId; 2],
) {
    let (x, y, rim, front, back) = (w / 2.0, h / 2.0, 0.03, 0.025, 0.015);
    b.inside(place, |b| {
        b.on(&format!("{name}: frame"), frame);
        let signs = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let outer = signs.map(|(i, j): (f32, f32)| at(i * (x + rim), j * (y + rim), front));
        let inner = signs.map(|(i, j): (f32, f32)| at(i * x, j * y, front));
        let sunk = inner.map(|p| at(p.x, p.y, back));
        b.block(
            at(-x - rim, -y - rim, 0.0),
            at(x + rim, y + rim, front),
            ALL & !FRONT & !BACK,
        );
        for i in 0..4 {
            let j = (i + 1) % 4;
            b.polygon(&[outer[i], outer[j], inner[j], inner[i]]);
            b.polygon(&[inner[i], inner[j], sunk[j], sunk[i]]);
        }
        b.on(name, picture).picture(sunk);
    });
}

/// A closed door leaf with its casing, 0.9 x 2.05 m; its origin is on the floor, on the wall.
pub fn closed_door(b: &mut Builder, name: &str, place: Place, leaf: FinishId, metal: FinishId) {
    b.inside(place, |b| {
        b.on(name, leaf);
        b.block(at(-0.45, 0.005, 0.004), at(0.45, 2.05, 0.03), ALL);
        casing(b, [-0.455, 0.455], 2.055);
        b.on(&format!("{name}: handle"), metal);
        b.block(
            at(0.34, 1.02, 0.03),
            at(0.36, 1.04, 0.08),
            POST & !BACK | TOP | BOTTOM,
        );
        b.block(at(0.24, 1.02, 0.081), at(0.37, 1.04, 0.096), ALL);
    });
}

/// The frame on the wall around an opening from `low` to `high` along x and up to `head`, on the
/// current surface.
pub fn casing(b: &mut Builder, [low, high]: [f32; 2], head: f32) {
    let (rim, front) = (0.07, 0.018);
    b.block(
        at(low - rim, 0.0, 0.0),
        at(low, head, front),
        LEFT | RIGHT | FRONT,
    );
    b.block(
        at(high, 0.0, 0.0),
        at(high + rim, head, front),
        LEFT | RIGHT | FRONT,
    );
    b.block(
        at(low - rim, head, 0.0),
        at(high + rim, head + rim, front),
        ALL & !BACK,
    );
}

/// A row of skirting from `low` to `high` along x on a wall that looks towards +z; something must
/// stand at both ends, for it has no end faces.
pub fn skirting(b: &mut Builder, [low, high]: [f32; 2]) {
    b.block(at(low, 0.0, 0.0), at(high, 0.08, 0.012), FRONT | TOP);
}
