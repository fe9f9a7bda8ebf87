//! How much of the noise of the solved elements is left at a receiver.
//!
//! A receiver sees many elements, each with its own noise, so most of it averages out; how much
//! depends on how many it sees, and on how far the noise of neighbours goes together. Given one draw
//! d of the noise of every element, the mean D of d over the rays of a receiver is one draw of
//! the noise there. Its square is not worth much at one receiver, but the ratio of D² to the
//! mean of d² over the same rays is alike everywhere: it is measured over points all over the
//! scene, and each receiver takes that share of the mean of d² over its own rays. So a dark room
//! with few and noisy lines has its own error.
//!
//! Source: ours; independent replications as the measure of an error are those of [Owen97].

use luxel_core::{ElementId, Front, Scene};
use luxel_transport::{FrontLines, LocalLines, RayCaster};
use rayon::prelude::*;

/// Points of the measure, and rays from each.
const POINTS: usize = 512;
const RAYS: u32 = 128;

/// Variance of the noise at a receiver over the mean square noise of the elements it sees; 0 when
/// there is none. 65,536 rays.
pub(crate) fn left(scene: &Scene, front: &Front, caster: &dyn RayCaster, noise: &[f32]) -> f64 {
    if noise.iter().all(|d| *d == 0.0) {
        return 0.0;
    }
    let stride = front.len().div_ceil(POINTS).max(1);
    let lines = FrontLines::new(scene, front, caster);
    let points: Vec<usize> = (0..front.len()).step_by(stride).collect();
    let each: Vec<[f64; 2]> = points
        .par_iter()
        .map(|&e| {
            let mut arrivals = Vec::new();
            lines.cast(ElementId::from(e), 0..RAYS, 0x3c6e_f372, &mut arrivals);
            let met = arrivals.iter().filter_map(|a| a.element());
            met.map(|e| noise[e.index()] as f64)
                .fold([0.0; 2], |s, d| [s[0] + d, s[1] + d * d])
        })
        .collect();
    let n = RAYS as f64;
    let (mut of_means, mut of_rays) = (0.0, 0.0);
    for [sum, squares] in each {
        of_means += (sum / n).powi(2);
        of_rays += squares / n;
    }
    if of_rays > 0.0 {
        // So few rays have a spread of their own: that of d over their number.
        ((of_means / of_rays - 1.0 / n) / (1.0 - 1.0 / n)).max(0.0)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_core::{GroupId, Shape, SurfaceId, Vec3};
    use luxel_transport::Bvh;

    /// Two facing squares a tenth of their edge apart, of n x n elements each.
    fn facing(n: u32) -> (Scene, Front) {
        let mut scene = Scene::default();
        scene.finishes.push(luxel_core::Finish::default());
        let sides = [(0.0, Vec3::X, Vec3::Y), (0.1, Vec3::Y, Vec3::X)];
        for (k, (z, u, v)) in sides.into_iter().enumerate() {
            let (o, first) = (Vec3::Z * z, 4 * k as u32);
            scene.positions.extend([o, o + u, o + u + v, o + v]);
            let corners = [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i: u32| i + first));
            scene.triangles.extend(corners);
            scene.surface_of.extend([SurfaceId(k as u32); 2]);
            scene.source_triangle.extend([0, 1]);
            scene.surfaces.push(luxel_core::Surface {
                name: String::new(),
                finish: luxel_core::FinishId(0),
                triangles: 2 * k as u32..2 * k as u32 + 2,
                node: 0,
                mesh: 0,
                primitive: 0,
            });
        }
        let mut front = Front::new(4);
        for (k, (z, edge_u, edge_v)) in sides.into_iter().enumerate() {
            let origin = Vec3::Z * z;
            let shape = Shape::Parallelogram {
                origin,
                edge_u,
                edge_v,
            };
            let sources = [2 * k as u32, 2 * k as u32 + 1];
            let side = luxel_core::Side::Front;
            front.add_patch(
                SurfaceId(k as u32),
                side,
                shape,
                [n, n],
                GroupId::NONE,
                &sources,
            );
        }
        (scene, front)
    }

    #[test]
    fn noise_that_all_elements_share_stays_and_independent_noise_averages_out() {
        let (scene, front) = facing(32);
        let caster = Bvh::build(&std::sync::Arc::new(scene.clone()));
        let of = |noise: &[f32]| left(&scene, &front, &caster, noise);
        assert_eq!(of(&vec![0.0; front.len()]), 0.0);
        // One and the same at all: the square of the mean is the mean of the squares, but for the
        // rays that leave between the squares (their share of the first is squared).
        let shared = of(&vec![0.3; front.len()]);
        assert!((0.7..=1.0).contains(&shared), "{shared}");
        // Of alternating sign, a point sees some fifty elements of 1/32 from 0.1 away.
        let signs = |e: usize| {
            if luxel_transport::sampling::hash([e as u32]) & 1 == 0 {
                0.3
            } else {
                -0.3
            }
        };
        let noise: Vec<f32> = (0..front.len()).map(signs).collect();
        let independent = of(&noise);
        assert!((0.003..0.06).contains(&independent), "{independent}");
    }
}
