//! Exchange area of two parts that nothing stands between.
//!
//! Parts that are small for their distance: a tensor of Gauss rules on both, of the order that
//! the distance asks for. Nearer ones: the closed form of [`crate::polygon_pair`]. Which of the
//! two horizons cut the other part is found from the corners.

use super::parts::{LANES, Nodes, Part};
use crate::polygon_pair::exchange_area;
use std::f64::consts::PI;

/// Radius over distance to the other up to which rules of order 2 and of order 3 keep a relative
/// error; an order of m errs by about the 2m-th power. Measured, see the test.
const LIMITS: [(f64, [f64; 2]); 3] = [
    (3e-5, [0.048, 0.25]),
    (1e-5, [0.033, 0.21]),
    (1e-7, [0.008, 0.085]),
];

/// How two parts stand to each other.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Facing {
    /// Each wholly in front of the other.
    Wholly,
    /// A horizon cuts one of them.
    Partly,
    /// Nothing of one is in front of the other.
    No,
}

/// Heights of less than `near_m` are none.
#[inline]
pub(crate) fn facing(a: &Part, b: &Part, near_m: f64) -> Facing {
    let side = |of: &Part, from: &Part| {
        let height = from.plane.height(of.centre);
        if height > of.radius {
            return Facing::Wholly;
        }
        if height < -of.radius {
            return Facing::No;
        }
        let (low, high) = from.plane.heights(&of.polygon.vertices);
        if high <= near_m {
            Facing::No
        } else if low >= -near_m {
            Facing::Wholly
        } else {
            Facing::Partly
        }
    };
    match side(b, a) {
        Facing::No => Facing::No,
        first => match side(a, b) {
            Facing::Wholly => first,
            other => other,
        },
    }
}

/// Exchange area of parts `i` and `j`, m², which face each other as `facing` says, to about
/// `relative` accuracy.
#[inline]
pub(crate) fn exchange(
    parts: &super::parts::Parts,
    (i, j): (usize, usize),
    facing: Facing,
    relative: f64,
) -> f64 {
    let (a, b) = (&parts.list[i], &parts.list[j]);
    if facing == Facing::Wholly
        && let Some((ma, mb)) = orders(a, b, relative)
    {
        return tensor(&parts.nodes[ma], i, a, &parts.nodes[mb], j, b);
    }
    exchange_area(&a.polygon, &b.polygon, relative)
}

/// Which rule on each; none where the parts are too near for their size.
#[inline]
fn orders(a: &Part, b: &Part, relative: f64) -> Option<(usize, usize)> {
    let (_, limits) = LIMITS.iter().find(|(error, _)| *error <= relative)?;
    let apart = a.centre.distance(b.centre);
    let order = |of: &Part, other: &Part| {
        let ratio = of.radius / (apart - other.radius);
        // Also false where the other reaches beyond the centre.
        limits.iter().position(|&l| ratio >= 0.0 && ratio < l)
    };
    Some((order(a, b)?, order(b, a)?))
}

/// Sum over pairs of nodes of the kernel `cos cos / (pi r^2)`, m².
#[inline]
fn tensor(na: &Nodes, i: usize, a: &Part, nb: &Nodes, j: usize, b: &Part) -> f64 {
    let (ra, rb) = (
        na.starts[i] as usize..na.starts[i + 1] as usize,
        nb.starts[j] as usize..nb.starts[j + 1] as usize,
    );
    let (n, m) = (a.plane.normal, b.plane.normal);
    let mut sum = [0.0; LANES];
    let (xs, ys, zs, ws) = (
        &nb.x[rb.clone()],
        &nb.y[rb.clone()],
        &nb.z[rb.clone()],
        &nb.weight[rb],
    );
    for k in ra {
        let (px, py, pz, w) = (na.x[k], na.y[k], na.z[k], na.weight[k]);
        if w == 0.0 {
            continue;
        }
        for (((x, y), z), v) in xs
            .chunks_exact(LANES)
            .zip(ys.chunks_exact(LANES))
            .zip(zs.chunks_exact(LANES))
            .zip(ws.chunks_exact(LANES))
        {
            for l in 0..LANES {
                let (dx, dy, dz) = (x[l] - px, y[l] - py, z[l] - pz);
                let square = dx * dx + dy * dy + dz * dz;
                let one = dx * n.x + dy * n.y + dz * n.z;
                let two = dx * m.x + dy * m.y + dz * m.z;
                sum[l] -= w * v[l] * (one * two) / (square * square);
            }
        }
    }
    ((sum[0] + sum[1]) + (sum[2] + sum[3])).max(0.0) / PI
}

#[cfg(test)]
mod tests {
    use super::super::blockers::Blockers;
    use super::super::parts::Parts;
    use super::super::shaft::BlockerTree;
    use super::*;
    use luxel_core::{DVec3, FacetPart, Facets, Polygon};

    fn parts(polygons: Vec<Vec<DVec3>>) -> Parts {
        let parts = polygons
            .into_iter()
            .enumerate()
            .map(|(k, v)| FacetPart {
                polygon: Polygon::new(v),
                row: k as u32,
            })
            .collect();
        let facets = Facets {
            parts,
            ..Facets::default()
        };
        let none = Blockers::default();
        Parts::new(&facets, &none, &BlockerTree::new(&none.list), 1e-12)
    }

    #[test]
    fn rules_keep_the_accuracy_that_is_asked() {
        // Against the closed form, for squares, slender rectangles, skew quads and triangles in
        // all directions at 1.5 to 400 radii.
        let shapes: [&[(f64, f64)]; 4] = [
            &[(0., 0.), (1., 0.), (1., 1.), (0., 1.)],
            &[(0., 0.), (1., 0.), (1., 0.2), (0., 0.2)],
            &[(0., 0.), (1., 0.1), (0.7, 0.9), (0.1, 0.6)],
            &[(0., 0.), (1., 0.), (0.2, 0.8)],
        ];
        for asked in [3e-5, 1e-5, 1e-7] {
            let (mut worst, mut count) = (0.0_f64, 0);
            for (k, one) in shapes.iter().enumerate() {
                for two in &shapes {
                    for step in 0..60 {
                        let distance = 1.5 * 1.1_f64.powi(step);
                        let turn = 0.37 * step as f64 + k as f64;
                        let towards =
                            DVec3::new(turn.sin() * 0.7, turn.cos() * 0.7, 0.5).normalize();
                        let a: Vec<DVec3> =
                            one.iter().map(|&(x, y)| DVec3::new(x, y, 0.)).collect();
                        let (u, v) = (
                            DVec3::new(turn.cos(), 0.3, turn.sin()).normalize(),
                            DVec3::new(-turn.sin(), 0.5, turn.cos()).normalize(),
                        );
                        let mut b: Vec<DVec3> = two
                            .iter()
                            .map(|&(x, y)| towards * distance + u * x + v * y)
                            .collect();
                        if Polygon::new(b.clone()).normal().dot(towards) > 0.0 {
                            b.reverse();
                        }
                        let parts = parts(vec![a, b]);
                        let (p, q) = (&parts.list[0], &parts.list[1]);
                        if facing(p, q, 1e-12) != Facing::Wholly || orders(p, q, asked).is_none() {
                            continue;
                        }
                        let got = exchange(&parts, (0, 1), Facing::Wholly, asked);
                        let want = exchange_area(&p.polygon, &q.polygon, 1e-11);
                        // Where a horizon is near, what is left of the cosine is small and the
                        // error counts against what the distance alone would give.
                        let scale = want.max(0.05 * p.area * q.area / (PI * distance * distance));
                        worst = worst.max((got - want).abs() / scale);
                        count += 1;
                    }
                }
            }
            eprintln!("asked {asked:.0e}: {count} pairs, worst {worst:.1e}");
            assert!(count > 150 && worst < asked, "{asked}: {worst} of {count}");
        }
    }
}
