//! Form factors by the hemicube: the scene drawn onto five faces of half a cube around an
//! element's centre, each pixel worth its share of the hemisphere.
//!
//! The half cube has edge 2 and height 1; a pixel of the top at (x, y) is worth
//! `dA / (pi (x^2 + y^2 + 1)^2)`, one of a side at (y, z) `z dA / (pi (y^2 + z^2 + 1)^2)`, integrated
//! exactly over the pixel. Triangles are clipped to each face's pyramid, drawn with a depth
//! buffer, and each pixel's ray through its middle names the element. Accurate only as far as
//! pixels resolve the elements, and from one point for a whole element: near large ones it is
//! wrong by design.
//!
//! Source: [Cohen85].

use crate::contract::{FactorRow, FormFactors};
use luxel_core::{ElementId, Front, Scene, Side, Vec3};
use std::cell::RefCell;
use std::f64::consts::PI;

/// Rows of form factors drawn on demand.
///
/// Coverage by texture is not looked at: masks are opaque. Clear glass is not drawn.
pub struct Hemicube<'a> {
    scene: &'a Scene,
    front: &'a Front,
    resolution: usize,
    centres: usize,
    /// Nearer than this is the element's own surface or rounding, metres.
    near: f32,
    /// Worth of the pixels of the top face, row by row.
    top: Vec<f64>,
    /// Worth of the pixels of a side face, from the horizon up.
    side: Vec<f64>,
}

impl<'a> Hemicube<'a> {
    /// Hemicubes with `resolution` pixels along an edge (50 to 200 is usual; at least 2, made
    /// even), one at the centre of each element.
    pub fn new(scene: &'a Scene, front: &'a Front, resolution: usize) -> Self {
        let resolution = resolution.max(2).next_multiple_of(2);
        let [top, side] = delta_factors(resolution);
        Hemicube {
            scene,
            front,
            resolution,
            centres: 1,
            near: 1e-6 * scene.diagonal(),
            top,
            side,
        }
    }

    /// With `n` x `n` hemicubes spread over each element: nearer to the factor of the area.
    pub fn with_centres(mut self, n: usize) -> Self {
        self.centres = n.max(1);
        self
    }

    /// Sum of the worth of all pixels of the five faces; 1 up to rounding.
    pub fn delta_sum(&self) -> f64 {
        self.top.iter().sum::<f64>() + 4.0 * self.side.iter().sum::<f64>()
    }

    /// What each pixel of the top face sees from the element's centre, row by row; for debug
    /// views. `None` where nothing or a black side is seen.
    pub fn top_view(&self, element: ElementId) -> Vec<Option<ElementId>> {
        let (eye, normal) = self.front.point_on(self.scene, element, [0.5, 0.5]);
        let mut buffer = Buffer::default();
        let view = self.faces(normal)[0];
        self.draw(eye, normal, &view, &mut buffer);
        (0..self.resolution * self.resolution)
            .map(|k| match self.seen(eye, &view, &buffer, k) {
                Seen::On(e) => Some(e),
                Seen::Black | Seen::Outside => None,
            })
            .collect()
    }

    /// Top, then the four sides.
    fn faces(&self, normal: Vec3) -> [View; 5] {
        let [a, b] = crate::sampling::frame(normal);
        let side = |forward: Vec3| View {
            forward,
            right: normal.cross(forward),
            up: normal,
            half: true,
        };
        [
            View {
                forward: normal,
                right: a,
                up: b,
                half: false,
            },
            side(a),
            side(b),
            side(-a),
            side(-b),
        ]
    }

    /// Draws all triangles onto one face.
    fn draw(&self, eye: Vec3, normal: Vec3, view: &View, buffer: &mut Buffer) {
        let n = self.resolution;
        buffer.depth.clear();
        buffer.depth.resize(n * n, 0.0);
        buffer.triangle.clear();
        buffer.triangle.resize(n * n, u32::MAX);
        let near = self.near;
        for t in 0..self.scene.triangles.len() {
            if self.scene.finish_of(t).transparent {
                continue;
            }
            let corners = self.scene.corners(t).map(|c| c - eye);
            // Wholly below the horizon, or the element's own plane.
            if corners.iter().all(|c| c.dot(normal) <= near) {
                continue;
            }
            view.draw(corners, t as u32, n, near, buffer);
        }
    }

    /// What pixel `k` of a drawn face sees.
    fn seen(&self, eye: Vec3, view: &View, buffer: &Buffer, k: usize) -> Seen {
        let t = buffer.triangle[k];
        if t == u32::MAX {
            return Seen::Outside;
        }
        let n = self.resolution as f32;
        let (x, y) = (k % self.resolution, k / self.resolution);
        let along = view.forward
            + view.right * ((x as f32 + 0.5) / n * 2.0 - 1.0)
            + view.up * ((y as f32 + 0.5) / n * 2.0 - 1.0);
        let [a, b, c] = self.scene.corners(t as usize);
        let side = if (b - a).cross(c - a).dot(along) < 0.0 {
            Side::Front
        } else {
            Side::Back
        };
        let point = eye + along / buffer.depth[k];
        self.front
            .element_at(t as usize, side, point)
            .map_or(Seen::Black, Seen::On)
    }

    /// Adds what is seen from one centre, each pixel's worth times `share`.
    fn add(&self, (eye, normal): (Vec3, Vec3), share: f64, shares: &mut Shares) {
        BUFFER.with_borrow_mut(|buffer| {
            for view in self.faces(normal) {
                self.draw(eye, normal, &view, buffer);
                let first = if view.half {
                    self.resolution * self.resolution / 2
                } else {
                    0
                };
                let worth = if view.half { &self.side } else { &self.top };
                for (k, w) in worth.iter().enumerate() {
                    match self.seen(eye, &view, buffer, first + k) {
                        Seen::On(e) => shares.on[e.index()] += w * share,
                        Seen::Outside => shares.outside += w * share,
                        Seen::Black => {}
                    }
                }
            }
        });
    }
}

thread_local! {
    static BUFFER: RefCell<Buffer> = RefCell::default();
}

struct Shares {
    /// One an element: pixels are far more than elements, as a rule.
    on: Vec<f64>,
    outside: f64,
}

enum Seen {
    On(ElementId),
    Black,
    Outside,
}

/// Depth buffer of one face: one over the distance along `forward`, so 0 is infinitely far.
#[derive(Default)]
struct Buffer {
    depth: Vec<f32>,
    triangle: Vec<u32>,
}

/// One face of the half cube; only the upper half counts for sides.
#[derive(Clone, Copy)]
struct View {
    forward: Vec3,
    right: Vec3,
    up: Vec3,
    half: bool,
}

impl View {
    fn draw(&self, corners: [Vec3; 3], triangle: u32, n: usize, near: f32, buffer: &mut Buffer) {
        // Face coordinates (x, y, depth); the pyramid is |x| <= depth, |y| <= depth.
        let local =
            corners.map(|c| Vec3::new(c.dot(self.right), c.dot(self.up), c.dot(self.forward)));
        let mut polygon = Outline::new(local);
        polygon.clip(|v| v.z - near);
        polygon.clip(|v| v.z - v.x);
        polygon.clip(|v| v.z + v.x);
        polygon.clip(|v| v.z - v.y);
        if self.half {
            polygon.clip(|v| v.y);
        } else {
            polygon.clip(|v| v.z + v.y);
        }
        if polygon.count < 3 {
            return;
        }
        // One over depth is linear on the face: w = plane . (x/z, y/z, 1) / d.
        let [a, b, c] = local;
        let plane = (b - a).as_dvec3().cross((c - a).as_dvec3());
        let d = plane.dot(a.as_dvec3());
        if d == 0.0 {
            return;
        }
        let plane = (plane / d).as_vec3();
        let scale = n as f32;
        let to_pixel = |v: Vec3| {
            [
                (v.x / v.z * 0.5 + 0.5) * scale,
                (v.y / v.z * 0.5 + 0.5) * scale,
            ]
        };
        let mut points = [[0.0_f32; 2]; MAX_CORNERS];
        for k in 0..polygon.count {
            points[k] = to_pixel(polygon.corners[k]);
        }
        let points = &points[..polygon.count];
        let low = points.iter().map(|p| p[1]).fold(f32::INFINITY, f32::min);
        let high = points
            .iter()
            .map(|p| p[1])
            .fold(f32::NEG_INFINITY, f32::max);
        // Pixels whose middle lies inside; a middle on an edge belongs to the right and upper.
        let (first, last) = (
            (low - 0.5).ceil().max(0.0) as usize,
            ((high - 0.5).ceil().max(0.0) as usize).min(n),
        );
        for row in first..last {
            let y = row as f32 + 0.5;
            let (mut left, mut right) = (f32::INFINITY, f32::NEG_INFINITY);
            for k in 0..points.len() {
                let (p, q) = (points[k], points[(k + 1) % points.len()]);
                // Order the ends so that a shared edge gives the same crossing from both sides.
                let (p, q) = if p[1] <= q[1] { (p, q) } else { (q, p) };
                if p[1] <= y && y < q[1] {
                    let x = p[0] + (q[0] - p[0]) * ((y - p[1]) / (q[1] - p[1]));
                    left = left.min(x);
                    right = right.max(x);
                }
            }
            if left > right {
                continue;
            }
            let from = (left - 0.5).ceil().max(0.0) as usize;
            let to = ((right - 0.5).ceil().max(0.0) as usize).min(n);
            let v = y / scale * 2.0 - 1.0;
            for column in from..to {
                let u = (column as f32 + 0.5) / scale * 2.0 - 1.0;
                let w = plane.x * u + plane.y * v + plane.z;
                let k = row * n + column;
                if w > buffer.depth[k] {
                    buffer.depth[k] = w;
                    buffer.triangle[k] = triangle;
                }
            }
        }
    }
}

/// A triangle has at most 3 + 5 corners after five clips.
const MAX_CORNERS: usize = 8;

struct Outline {
    corners: [Vec3; MAX_CORNERS],
    count: usize,
}

impl Outline {
    fn new([a, b, c]: [Vec3; 3]) -> Self {
        let mut corners = [Vec3::ZERO; MAX_CORNERS];
        corners[..3].copy_from_slice(&[a, b, c]);
        Outline { corners, count: 3 }
    }

    /// Keeps where `height`, a linear function, is not negative.
    fn clip(&mut self, height: impl Fn(Vec3) -> f32) {
        let (old, n) = (self.corners, self.count);
        self.count = 0;
        for k in 0..n {
            let (p, q) = (old[k], old[(k + 1) % n]);
            let (hp, hq) = (height(p), height(q));
            if hp >= 0.0 {
                self.push(p);
            }
            if (hp >= 0.0) != (hq >= 0.0) {
                // From the lower end, so that a shared edge is cut at the same point.
                let (a, b, ha, hb) = if hp < hq {
                    (p, q, hp, hq)
                } else {
                    (q, p, hq, hp)
                };
                self.push(a + (b - a) * (ha / (ha - hb)));
            }
        }
    }

    fn push(&mut self, v: Vec3) {
        if self.count < MAX_CORNERS {
            self.corners[self.count] = v;
            self.count += 1;
        }
    }
}

/// Worth of the pixels of the top and of the upper half of a side, row by row: exact integrals,
/// as differences of the configuration factor of a rectangle with a corner at the axis.
fn delta_factors(n: usize) -> [Vec<f64>; 2] {
    let at = |k: usize| 2.0 * k as f64 / n as f64 - 1.0;
    // Rectangle 0..x, 0..y square to the axis at distance 1 [Howell10] B-3.
    let top = |x: f64, y: f64| {
        let (a, b) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
        (x / a * (y / a).atan() + y / b * (x / b).atan()) / (2.0 * PI)
    };
    // Rectangle 0..y wide, 0..z high, standing at distance 1 [Howell10] B-4.
    let side = |y: f64, z: f64| {
        let r = (1.0 + z * z).sqrt();
        (y.atan() - (y / r).atan() / r) / (2.0 * PI)
    };
    let table = |rows: std::ops::Range<usize>, f: &dyn Fn(f64, f64) -> f64| {
        rows.flat_map(|j| {
            (0..n).map(move |i| {
                let (x0, x1, y0, y1) = (at(i), at(i + 1), at(j), at(j + 1));
                f(x1, y1) - f(x0, y1) - f(x1, y0) + f(x0, y0)
            })
        })
        .collect()
    };
    [table(0..n, &top), table(n / 2..n, &side)]
}

impl FormFactors for Hemicube<'_> {
    fn len(&self) -> usize {
        self.front.len()
    }

    fn row(&self, element: ElementId, row: &mut FactorRow) {
        let mut shares = Shares {
            on: vec![0.0; self.front.len()],
            outside: 0.0,
        };
        let n = self.centres;
        let place = |k: usize| (k as f32 + 0.5) / n as f32;
        for j in 0..n {
            for i in 0..n {
                let centre = self
                    .front
                    .point_on(self.scene, element, [place(i), place(j)]);
                self.add(centre, 1.0 / (n * n) as f64, &mut shares);
            }
        }
        row.entries.clear();
        let seen = shares.on.iter().enumerate().filter(|(_, f)| **f > 0.0);
        row.entries
            .extend(seen.map(|(e, f)| (ElementId::from(e), *f)));
        row.outside = shares.outside;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{cube, parallelograms};

    #[test]
    fn pixels_are_worth_one_together() {
        // Asked: 1 +- 1e-3 at 50 to 200. Exact integrals sum to 1 but for rounding.
        let (scene, front) = cube(1);
        for n in [50, 100, 200] {
            let sum = Hemicube::new(&scene, &front, n).delta_sum();
            assert!((sum - 1.0).abs() < 1e-12, "{sum} at {n}");
        }
        // And each is close to the kernel at its middle [Cohen85].
        let [top, side] = delta_factors(100);
        let area = 0.02 * 0.02;
        assert!((top[50 * 100 + 50] / (area / PI) - 1.0).abs() < 1e-3);
        let (y, z): (f64, f64) = (0.51, 0.71);
        let want = z * area / (PI * (y * y + z * z + 1.0).powi(2));
        assert!((side[35 * 100 + 75] / want - 1.0).abs() < 1e-3);
    }

    #[test]
    fn the_cube_closes_and_is_right_at_its_centre() {
        // From the centre of the floor: ceiling [Howell10] B-3, four times the factor of a
        // quarter (x = y = 1/2 at distance 1); pixels of 1/100 on an edge of the ceiling's
        // image: error below the worth of one row of pixels, 0.5 %.
        let (scene, front) = cube(1);
        let cube = Hemicube::new(&scene, &front, 100);
        let mut row = FactorRow::default();
        cube.row(ElementId(0), &mut row);
        assert!((row.closure() - 1.0).abs() < 1e-9, "{}", row.closure());
        assert_eq!(row.outside, 0.0);
        let r: f64 = 1.25_f64.sqrt();
        let want = 4.0 / PI * (0.5 / r) * (0.5 / r).atan();
        assert!(
            (row.entries[0].1 - want).abs() < 5e-3,
            "{} for {want}",
            row.entries[0].1
        );
    }

    #[test]
    fn error_falls_with_resolution() {
        // Small elements under a patch that no pixel grid divides evenly; exact factor of each
        // element from the centre by Lambert's formula. Mean error over the elements.
        let (x, y) = (Vec3::new(0.9, 0.13, 0.0), Vec3::new(-0.21, 1.1, 0.0));
        let sides = [
            [Vec3::new(-0.05, -0.05, 0.0), Vec3::X * 0.1, Vec3::Y * 0.1],
            [Vec3::new(0.31, -0.47, 0.83), y, x],
        ];
        let (scene, mut front) = parallelograms(&sides, 1);
        front.split(ElementId(1));
        front.split(ElementId(3));
        let (eye, normal) = front.point_on(&scene, ElementId(0), [0.5, 0.5]);
        let mut row = FactorRow::default();
        let errors = [50, 100, 200, 400].map(|n| {
            Hemicube::new(&scene, &front, n).row(ElementId(0), &mut row);
            let error = |e: usize| {
                let polygon = &front.polygons(&scene, ElementId::from(e))[0];
                let want =
                    crate::lambert::point_to_polygon(eye.as_dvec3(), normal.as_dvec3(), polygon);
                let got = row
                    .entries
                    .iter()
                    .find(|x| x.0.index() == e)
                    .map_or(0.0, |x| x.1);
                (got - want).abs() / want
            };
            (1..front.len()).map(error).sum::<f64>() / (front.len() - 1) as f64
        });
        eprintln!("mean relative error at 50, 100, 200, 400: {errors:?}");
        assert!(errors[1] < errors[0] && errors[2] < errors[1] && errors[3] < errors[2]);
        assert!(errors[2] < 5e-3 && errors[0] < 0.05);
        // The rest leaves the scene: told apart from black.
        assert!((row.closure() - 1.0).abs() < 1e-9 && row.outside > 0.5);
    }

    #[test]
    fn backs_are_black_and_not_outside() {
        // A ceiling that faces up hides the sky without receiving.
        let up = [[Vec3::ZERO, Vec3::X, Vec3::Y], [Vec3::Z, Vec3::X, Vec3::Y]];
        let (scene, front) = parallelograms(&up, 1);
        let mut row = FactorRow::default();
        Hemicube::new(&scene, &front, 100).row(ElementId(0), &mut row);
        assert!(row.entries.is_empty());
        // 1 - 0.2394, the unit square seen from 1 under its centre.
        assert!((row.outside - 0.7606).abs() < 0.01, "{}", row.outside);
    }

    #[test]
    fn many_centres_approach_the_factor_of_the_area() {
        // Faces of a cube, 0.19982 opposite and 0.20004 beside [Howell10] C-11, C-14. One centre
        // gives 0.2394 and 0.1902; the midpoint rule over 8 x 8 comes within 1 %.
        let (scene, front) = cube(1);
        let mut row = FactorRow::default();
        Hemicube::new(&scene, &front, 100)
            .with_centres(8)
            .row(ElementId(0), &mut row);
        for (_, f) in &row.entries {
            assert!((f - 0.2).abs() < 2e-3, "{f}");
        }
    }

    #[test]
    fn top_view_shows_the_ceiling() {
        let (scene, front) = cube(1);
        let view = Hemicube::new(&scene, &front, 50).top_view(ElementId(0));
        assert_eq!(view.len(), 2500);
        assert_eq!(view[25 * 50 + 25], Some(ElementId(1)));
        assert!(view[0].is_some_and(|e| e.0 > 1), "a corner sees a wall");
    }
}
