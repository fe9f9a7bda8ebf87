//! Enclosures whose light is known in closed form, for property tests.
//!
//! In a closed room where every surface emits 1 lm/m² and reflects rho, each sends out
//! 1 / (1 - rho) everywhere, whatever its shape: B = E + rho H with H = B.

use crate::builder::{Builder, at, faces};
use luxel_core::{FinishId, Rgb, Scene, Vec3, quantity::LAMBERTIAN};

/// Closed room 4 x 2.5 x 3 m with a turned block on its floor, all surfaces emitting 1 lm/m².
///
/// The room is convex, the block too, so that occlusion counts. Exitance 1 / (1 - rho)
/// everywhere. The floor under the block is cut out: no face is covered.
pub fn furnace(rho: f32) -> Scene {
    let mut b = Builder::new("furnace");
    let all = glowing(&mut b, rho);
    let (low, high) = (at(-2.0, 0.0, -1.5), at(2.0, 2.5, 1.5));
    b.on("walls and ceiling", all)
        .room(low, high, faces::ALL & !faces::BOTTOM);

    // The block's foot, turned by a 3-4-5 triangle so that its corners are exact.
    let foot = [
        at(0.5, 0.0, 0.1),
        at(0.1, 0.0, 0.4),
        at(-0.5, 0.0, -0.4),
        at(-0.1, 0.0, -0.7),
    ];
    let corners = [
        at(low.x, 0.0, low.z),
        at(low.x, 0.0, high.z),
        at(high.x, 0.0, high.z),
        at(high.x, 0.0, low.z),
    ];
    // Foot corners face, in turn, the room's right front, left front, left back, right back.
    let facing = [2, 1, 0, 3];
    b.on("floor", all);
    for i in 0..4 {
        let j = (i + 1) % 4;
        b.polygon(&[foot[i], foot[j], corners[facing[j]], corners[facing[i]]]);
    }
    b.on("block", all);
    let top = foot.map(|p| p + Vec3::Y * 1.25);
    for i in 0..4 {
        let j = (i + 1) % 4;
        b.polygon(&[foot[j], foot[i], top[i], top[j]]);
    }
    b.polygon(&[top[3], top[2], top[1], top[0]]);
    b.build()
}

/// Closed room `w` x `h` x `d` metres (x, y, z), its floor's corner at the origin, with a
/// luminous ceiling of 1000 cd/m² that reflects as given.
///
/// Reflectances in the order x low, x high, floor, ceiling, z low, z high.
pub fn closed_box(w: f32, d: f32, h: f32, reflectances: [f32; 6]) -> Scene {
    let mut b = Builder::new("closed box");
    let names = [
        "left wall",
        "right wall",
        "floor",
        "ceiling",
        "back wall",
        "front wall",
    ];
    let bits = [
        faces::LEFT,
        faces::RIGHT,
        faces::BOTTOM,
        faces::TOP,
        faces::BACK,
        faces::FRONT,
    ];
    for ((name, bit), rho) in names.into_iter().zip(bits).zip(reflectances) {
        let finish = if bit == faces::TOP {
            b.luminous(name, rho, 1000.0, Rgb::WHITE)
        } else {
            b.matte(name, rho, rho, rho)
        };
        b.on(name, finish).room(Vec3::ZERO, at(w, h, d), bit);
    }
    b.build()
}

/// Closed L-shaped room 3 m high, all surfaces emitting 1 lm/m²: a 4 x 4 m square without a
/// 2 x 2 m corner, so that parts of the walls do not see each other.
///
/// Exitance 1 / (1 - rho) everywhere.
pub fn l_shaped_furnace(rho: f32) -> Scene {
    let mut b = Builder::new("L-shaped furnace");
    let all = glowing(&mut b, rho);
    // Counter-clockwise seen from above, where +z points towards the viewer's feet.
    let plan = [
        at(0.0, 0.0, 0.0),
        at(0.0, 0.0, 4.0),
        at(2.0, 0.0, 4.0),
        at(2.0, 0.0, 2.0),
        at(4.0, 0.0, 2.0),
        at(4.0, 0.0, 0.0),
    ];
    extrude(&mut b, &plan, 3.0, [all; 3]);
    b.build()
}

/// A closed room over a floor plan (counter-clockwise from above): floor, walls, ceiling.
fn extrude(b: &mut Builder, plan: &[Vec3], height: f32, [floor, walls, ceiling]: [FinishId; 3]) {
    let mut top: Vec<Vec3> = plan.iter().map(|&p| p + Vec3::Y * height).collect();
    b.on("floor", floor).polygon(plan);
    b.on("walls", walls);
    for i in 0..plan.len() {
        let j = (i + 1) % plan.len();
        b.polygon(&[plan[j], plan[i], top[i], top[j]]);
    }
    top.reverse();
    b.on("ceiling", ceiling).polygon(&top);
}

fn glowing(b: &mut Builder, rho: f32) -> FinishId {
    b.luminous("glow", rho, 1.0 / LAMBERTIAN, Rgb::WHITE)
}
