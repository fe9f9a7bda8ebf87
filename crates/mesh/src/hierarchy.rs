//! A binary tree over any front, by place and normal.
//!
//! Elements are halved at the median of the coordinate that is spread most; a coordinate of the
//! normal counts as half the extent of the node, so that walls that face each other part before
//! neighbours on one wall do. Halves of equal count make the shape of the tree a function of the
//! number of elements alone; n log n time.

use crate::cluster::{Item, halve};
use luxel_core::hierarchy::Node;
use luxel_core::{ElementId, Front, Hierarchy, Scene, Shape, Side, Vec3};
use rayon::prelude::*;

/// A binary tree over `front`: leaves hold one element. Bounds hold every point of the elements,
/// cones every normal (of a cluster's triangles too), but for f32 rounding, which is added.
/// Deterministic.
pub fn hierarchy(scene: &Scene, front: &Front) -> Hierarchy {
    if front.is_empty() {
        return Hierarchy::default();
    }
    let mut items: Vec<Item> = (0..front.len())
        .into_par_iter()
        .map(|e| element_item(scene, front, e))
        .collect();
    sort(&mut items);

    // Level by level: parents before children, children side by side.
    let mut nodes = vec![(0u32, items.len() as u32, 0u32)];
    let mut at = 0;
    while at < nodes.len() {
        let (first, count, _) = nodes[at];
        if count > 1 {
            let half = count / 2;
            nodes[at].2 = nodes.len() as u32;
            nodes.push((first, half, 0));
            nodes.push((first + half, count - half, 0));
        }
        at += 1;
    }
    let nodes = nodes
        .into_par_iter()
        .map(|(first, count, first_child)| {
            let below = &items[first as usize..(first + count) as usize];
            node(scene, front, below, first, first_child)
        })
        .collect();
    Hierarchy {
        nodes,
        order: items.iter().map(|i| ElementId(i.id)).collect(),
    }
}

fn sort(items: &mut [Item]) {
    if items.len() < 2 {
        return;
    }
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    for item in items.iter() {
        let centre = (item.low + item.high) * 0.5;
        low = low.min(centre);
        high = high.max(centre);
    }
    let middle = halve(items, 0.5 * (high - low).max_element());
    let (left, right) = items.split_at_mut(middle);
    if left.len() > 4096 {
        rayon::join(|| sort(left), || sort(right));
    } else {
        sort(left);
        sort(right);
    }
}

fn element_item(scene: &Scene, front: &Front, e: usize) -> Item {
    let patch = &front.patches[front.patch[e].index()];
    let [s0, t0, ds, dt] = front.rect[e];
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    let mut hold = |p: Vec3| {
        low = low.min(p);
        high = high.max(p);
    };
    match &patch.shape {
        Shape::Cluster { triangles } => {
            for c in &front.cluster_triangles[triangles.start as usize..triangles.end as usize] {
                scene
                    .corners(c.triangle as usize)
                    .into_iter()
                    .for_each(&mut hold);
            }
        }
        shape => {
            hold(patch.point(s0, t0));
            hold(patch.point(s0 + ds, t0));
            hold(patch.point(s0, t0 + dt));
            if matches!(shape, Shape::Parallelogram { .. }) {
                hold(patch.point(s0 + ds, t0 + dt));
            }
        }
    }
    Item {
        low,
        high,
        normal: patch.normal,
        area: front.area[e],
        id: e as u32,
    }
}

/// Smallest cosine between `axis` and a normal of element `e`.
fn least_cosine(scene: &Scene, front: &Front, item: &Item, axis: Vec3) -> f32 {
    let patch = &front.patches[front.patch[item.id as usize].index()];
    match &patch.shape {
        Shape::Cluster { triangles } => {
            let sign = if patch.side == Side::Front { 1.0 } else { -1.0 };
            front.cluster_triangles[triangles.start as usize..triangles.end as usize]
                .iter()
                .map(|c| {
                    let [p, q, r] = scene.corners(c.triangle as usize).map(|p| p.as_dvec3());
                    let n = (q - p).cross(r - p).normalize_or_zero().as_vec3();
                    n.dot(axis) * sign
                })
                .fold(1.0, f32::min)
        }
        _ => item.normal.dot(axis),
    }
}

fn node(scene: &Scene, front: &Front, below: &[Item], first: u32, first_child: u32) -> Node {
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    let (mut area, mut sum) = (0.0f64, luxel_core::DVec3::ZERO);
    for item in below {
        low = low.min(item.low);
        high = high.max(item.high);
        area += item.area as f64;
        sum += item.normal.as_dvec3() * item.area as f64;
    }
    // Opposite walls cancel: then there is no cone.
    let axis = if sum.length() > 1e-3 * area {
        sum.normalize_or_zero().as_vec3()
    } else {
        Vec3::ZERO
    };
    let mut cosine = if axis == Vec3::ZERO { -1.0 } else { 1.0f32 };
    for item in below {
        if cosine <= 0.0 {
            // Beyond a half space a cone tells nothing; the scan of the upper levels ends here.
            cosine = -1.0;
            break;
        }
        cosine = cosine.min(least_cosine(scene, front, item, axis));
    }
    let (axis, cos_half_angle) = if cosine <= 0.0 {
        (Vec3::ZERO, -1.0)
    } else {
        (axis, (cosine - 1e-6).max(0.0))
    };
    Node {
        low,
        high,
        area: area as f32,
        axis,
        cos_half_angle,
        first_child,
        children: if below.len() > 1 { 2 } else { 0 },
        first,
        count: below.len() as u32,
    }
}
