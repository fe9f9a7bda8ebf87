//! The Cornell box from its published measurements, in metres.
//!
//! Corner points in millimetres and reflectances every 4 nm as published; each band is the mean
//! over 40 nm around 620, 540 and 460 nm. The luminaire is published in the plane of the
//! ceiling; here it hangs 0.1 mm below it. Its spectrum is published as relative, so the
//! luminance is chosen: 2,000 cd/m² in all, with the bands in the published proportion. The front is
//! open, and some of the published walls do not meet exactly; both are left as they are.
//!
//! Source: [CornellBox].

use crate::builder::{Builder, at};
use luxel_core::{Rgb, Scene, Vec3};

/// Relative spectrum of the luminaire at 620, 540 and 460 nm, linear between the published
/// 0, 8, 15.6 and 18.4 at 400, 500, 600 and 700 nm.
pub const LIGHT_SPECTRUM: [f32; 3] = [16.16, 11.04, 4.8];

/// The Cornell box with both blocks; view `published camera`.
pub fn cornell() -> Scene {
    let mut b = Builder::new("Cornell box");
    let [white, green, red] = [("white", WHITE), ("green", GREEN), ("red", RED)]
        .map(|(n, [r, g, bl])| b.matte(n, r, g, bl));
    let [r, g, bl] = LIGHT_SPECTRUM;
    let light = b.luminous("light", 0.78, 2000.0, Rgb::new(r, g, bl));
    for (name, finish, corners) in [
        ("floor", white, FLOOR),
        ("ceiling", white, CEILING),
        ("back wall", white, BACK),
        ("right wall", green, RIGHT),
        ("left wall", red, LEFT),
        ("light", light, LIGHT),
    ] {
        b.on(name, finish).polygon(&corners.map(metres));
    }
    for (name, foot, height) in [("short block", SHORT, 165.0), ("tall block", TALL, 330.0)] {
        b.on(name, white);
        let top = foot.map(|[x, _, z]| metres([x, height, z]));
        let foot = foot.map(metres);
        b.polygon(&top);
        for i in 0..4 {
            let j = (i + 1) % 4;
            b.polygon(&[foot[i], foot[j], top[j], top[i]]);
        }
    }
    // Film 25 mm wide behind a lens of 35 mm.
    let angle = 2.0 * (12.5f32 / 35.0).atan().to_degrees();
    b.view(
        "published camera",
        at(0.278, 0.273, -0.8),
        at(0.278, 0.273, 0.0),
        angle,
    );
    b.build()
}

fn metres([x, y, z]: [f32; 3]) -> Vec3 {
    at(x / 1000.0, y / 1000.0, z / 1000.0)
}

type Corners = [[f32; 3]; 4];
const FLOOR: Corners = [
    [552.8, 0.0, 0.0],
    [0.0, 0.0, 0.0],
    [0.0, 0.0, 559.2],
    [549.6, 0.0, 559.2],
];
const CEILING: Corners = [
    [556.0, 548.8, 0.0],
    [556.0, 548.8, 559.2],
    [0.0, 548.8, 559.2],
    [0.0, 548.8, 0.0],
];
const BACK: Corners = [
    [549.6, 0.0, 559.2],
    [0.0, 0.0, 559.2],
    [0.0, 548.8, 559.2],
    [556.0, 548.8, 559.2],
];
const RIGHT: Corners = [
    [0.0, 0.0, 559.2],
    [0.0, 0.0, 0.0],
    [0.0, 548.8, 0.0],
    [0.0, 548.8, 559.2],
];
const LEFT: Corners = [
    [552.8, 0.0, 0.0],
    [549.6, 0.0, 559.2],
    [556.0, 548.8, 559.2],
    [556.0, 548.8, 0.0],
];
const LIGHT: Corners = [
    [343.0, 548.7, 227.0],
    [343.0, 548.7, 332.0],
    [213.0, 548.7, 332.0],
    [213.0, 548.7, 227.0],
];
/// Feet of the blocks, in the order of their published tops.
const SHORT: Corners = [
    [130.0, 0.0, 65.0],
    [82.0, 0.0, 225.0],
    [240.0, 0.0, 272.0],
    [290.0, 0.0, 114.0],
];
const TALL: Corners = [
    [423.0, 0.0, 247.0],
    [265.0, 0.0, 296.0],
    [314.0, 0.0, 456.0],
    [472.0, 0.0, 406.0],
];

/// Reflectance in red, green and blue: means over 600..=640, 520..=560 and 440..=480 nm.
const WHITE: [f32; 3] = [0.7380, 0.7316, 0.7517];
const GREEN: [f32; 3] = [0.1309, 0.4244, 0.1061];
const RED: [f32; 3] = [0.4962, 0.0602, 0.0606];
