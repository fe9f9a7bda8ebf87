//! Fronts: every lit side covered, every point found again, areas kept, limits held; the tree
//! over a front; refinement.

mod common;

use common::{settings, v};
use luxel_core::texture::Wrap;
use luxel_core::{
    ElementId, Emission, Finish, Front, Group, GroupId, Layers, RefinementWish, Rgb, Scene, Shape,
    Side, Solution, SurfaceId, Texture, Vec2,
};
use luxel_mesh::sides::{SIDES, lit_side};
use luxel_mesh::{Adaptive, Kind, MeshSettings, Strategy, hierarchy, neighbour_difference, shade};
use luxel_scenes::builder::Builder;
use proptest::prelude::*;

/// A floor of 4 x 1 m in the xy plane.
fn strip() -> Scene {
    let mut b = Builder::new("strip");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    b.on("floor", grey)
        .polygon(&[v(0., 0., 0.), v(4., 0., 0.), v(4., 1., 0.), v(0., 1., 0.)]);
    b.build()
}

/// Points of the unit square in no particular relation to any grid.
const PLACES: [[f32; 2]; 5] = [
    [0.0, 0.0],
    [0.13, 0.71],
    [0.5, 0.5],
    [0.97, 0.31],
    [1.0, 1.0],
];

/// Patches cover exactly the lit sides, areas agree, and a point of an element is that element's.
fn assert_covers(scene: &Scene, front: &Front) {
    let mut lit_area = 0.0;
    for t in 0..scene.triangles.len() {
        for side in SIDES {
            let lit = lit_side(scene.finish_of(t), side).is_some();
            assert_eq!(
                front.patch_of[t][side as usize].is_some(),
                lit,
                "triangle {t} {side:?}"
            );
            if lit {
                lit_area += scene.area(t) as f64;
            }
        }
    }
    // A joined parallelogram may differ from its triangles by rounding of its corners.
    assert!(
        (front.total_area() - lit_area).abs() < 1e-4 * lit_area,
        "{} m2 of elements, {lit_area} m2 of lit sides",
        front.total_area()
    );
    let mut triangles_of = vec![Vec::new(); front.patches.len()];
    for (t, ids) in front.patch_of.iter().enumerate() {
        for id in ids.iter().filter(|id| id.is_some()) {
            triangles_of[id.index()].push(t);
        }
    }
    for e in 0..front.len() {
        let id = ElementId::from(e);
        let patch = front.patch[e];
        let side = front.patches[patch.index()].side;
        for place in PLACES {
            let (p, n) = front.point_on(scene, id, place);
            assert!((n.length() - 1.0).abs() < 1e-4, "unit normal");
            let on = |&&t: &&usize| {
                let [a, b, c] = scene.corners(t);
                let sign = if side == Side::Front { 1.0 } else { -1.0 };
                let m = (b - a).cross(c - a) * sign;
                m.normalize_or_zero().dot(n) > 0.99
                    && [(a, b), (b, c), (c, a)].iter().all(|&(a, b)| {
                        (b - a).cross(p - a).dot(m) * sign >= -1e-5 * m.length_squared()
                    })
                    && (p - a).dot(m.normalize_or_zero()).abs() < 1e-4
            };
            let t = *triangles_of[patch.index()]
                .iter()
                .find(on)
                .unwrap_or_else(|| {
                    panic!("element {e} at {place:?}: {p} lies on no triangle of its patch")
                });
            assert_eq!(
                front.element_at(t, side, p),
                Some(id),
                "element {e} at {place:?}"
            );
        }
    }
}

#[test]
fn uniform_wall_is_cut_into_squares() {
    // 4 m2 in elements of 0.25 m2: 8 x 2 squares of 0.5 m.
    let scene = strip();
    let front = Kind::Uniform.build(settings(0.25)).initial(&scene);
    assert_eq!((front.patches.len(), front.len()), (1, 16));
    assert_eq!(front.patches[0].grid.iter().product::<u32>(), 16);
    assert!(front.area.iter().all(|&a| (a - 0.25).abs() < 1e-6));
    assert_covers(&scene, &front);
}

#[test]
fn dense_has_nine_elements_where_uniform_has_five() {
    // [Yeap99] figures 4.6 and 4.7: 5 and 9 elements over one function. For a smooth function
    // the L2 error of piecewise means falls in proportion to the width: by 5/9.
    let mut b = Builder::new("line");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    b.on("line", grey)
        .polygon(&[v(0., 0., 0.), v(1., 0., 0.), v(1., 0.2, 0.), v(0., 0.2, 0.)]);
    let scene = b.build();
    let f = |x: f64| (-6.0 * (x - 0.4) * (x - 0.4)).exp();
    let error = |kind: Kind, along: usize| {
        let front = kind.build(settings(0.04)).initial(&scene);
        let mut cells: Vec<(f64, f64)> = (0..front.len())
            .map(|e| {
                let p = &front.polygons(&scene, ElementId::from(e))[0];
                let xs = p.vertices.iter().map(|v| v.x);
                (xs.clone().fold(1.0, f64::min), xs.fold(0.0, f64::max))
            })
            .collect();
        cells.sort_by(|a, b| a.0.total_cmp(&b.0));
        cells.dedup_by(|a, b| (a.0 - b.0).abs() < 1e-6);
        assert_eq!(cells.len(), along);
        let mut sum = 0.0;
        for (low, high) in cells {
            let xs: Vec<f64> = (0..200)
                .map(|i| low + (high - low) * (i as f64 + 0.5) / 200.0)
                .collect();
            let mean = xs.iter().map(|&x| f(x)).sum::<f64>() / 200.0;
            sum += xs.iter().map(|&x| (f(x) - mean).powi(2)).sum::<f64>() / 200.0 * (high - low);
        }
        sum.sqrt()
    };
    let ratio = error(Kind::Dense, 9) / error(Kind::Uniform, 5);
    // 2 %: the second order of a function this curved.
    assert!((ratio - 5.0 / 9.0).abs() < 0.02, "{ratio}");
}

#[test]
fn limit_on_elements_is_held_by_larger_elements() {
    let scene = luxel_scenes::cornell();
    for most in [2000, 200, 60] {
        let settings = MeshSettings {
            max_elements: most,
            ..settings(1e-4)
        };
        let front = Kind::Uniform.build(settings).initial(&scene);
        assert!(front.len() <= most, "{} of at most {most}", front.len());
        // Not much fewer than allowed: within the steps of small grids.
        assert!(front.len() * 2 >= most, "{} of {most}", front.len());
        let area = luxel_mesh::uniform::effective_max_area(&scene, &settings);
        assert!(area > settings.max_area_m2);
        assert_covers(&scene, &front);
    }
}

#[test]
fn target_of_the_settings_is_about_met() {
    let scene = luxel_scenes::cornell();
    for target in [500, 5000] {
        let front = Kind::Uniform
            .build(MeshSettings::for_scene(&scene, target))
            .initial(&scene);
        // Grids round up: more than asked, but not twice.
        assert!(
            front.len() >= target * 9 / 10 && front.len() <= target * 2,
            "{}",
            front.len()
        );
    }
}

#[test]
fn tiny_triangles_share_elements() {
    let mut b = Builder::new("ball");
    let grey = b.thin("grey", 0.5, 0.5, 0.5);
    b.on("ball", grey).ball(v(0., 0., 1.), 0.3, 60, 120);
    let scene = b.build();
    let max_area = 0.04;
    let front = Kind::Uniform.build(settings(max_area)).initial(&scene);
    assert_covers(&scene, &front);
    assert!(
        front.len() * 10 < scene.triangles.len(),
        "{} elements",
        front.len()
    );
    for patch in &front.patches {
        let Shape::Cluster { triangles } = &patch.shape else {
            continue;
        };
        let sign = if patch.side == Side::Front { 1.0 } else { -1.0 };
        for c in &front.cluster_triangles[triangles.start as usize..triangles.end as usize] {
            let [p, q, r] = scene.corners(c.triangle as usize);
            let n = (q - p).cross(r - p).normalize() * sign;
            // Cone of 27 degrees, cosine 0.89.
            assert!(n.dot(patch.normal) > 0.889);
        }
    }
    let without = MeshSettings {
        cluster: false,
        ..settings(max_area)
    };
    let front = Kind::Uniform.build(without).initial(&scene);
    assert!(
        front
            .patches
            .iter()
            .all(|p| !matches!(p.shape, Shape::Cluster { .. }))
    );
    assert_covers(&scene, &front);
}

#[test]
fn emission_and_back_sides_follow_the_finish() {
    let mut b = Builder::new("lamp");
    let luminance = Rgb::new(1.0, 2.0, 3.0);
    let lamp = b.luminous("lamp", 0.0, luminance.luminance(), luminance);
    b.on("lamp", lamp)
        .polygon(&[v(0., 0., 0.), v(1., 0., 0.), v(1., 1., 0.), v(0., 1., 0.)]);
    let scene = b.build();
    let front = Kind::Uniform.build(settings(0.25)).initial(&scene);
    assert_eq!(front.len(), 4, "the back is black: no patch");
    // M = pi L.
    let pi = std::f32::consts::PI;
    for e in 0..4 {
        assert_eq!(front.reflectance[e], Rgb::BLACK);
        let m = front.emission[e].to_array();
        for band in 0..3 {
            assert!((m[band] - pi * (band as f32 + 1.0)).abs() < 1e-5);
        }
        assert!(front.group(ElementId::from(e)).is_some());
    }
}

/// A unit square with a picture across it, cut as `shapes` says.
fn pictured(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Scene {
    let mut b = Builder::new("picture");
    let rgba = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| texel(x, y))
        .collect();
    let texture = Texture {
        name: "t".into(),
        width,
        height,
        rgba,
        wrap: [Wrap::Clamp; 2],
    };
    let id = b.texture(texture);
    let finish = b.finish(Finish {
        reflectance: Rgb::WHITE,
        texture: Some(id),
        emission: Some(Emission {
            luminance: Rgb::WHITE,
            texture: Some(id),
            group: GroupId(0),
        }),
        ..Finish::default()
    });
    b.on("picture", finish)
        .picture([v(0., 0., 0.), v(1., 0., 0.), v(1., 1., 0.), v(0., 1., 0.)]);
    let mut scene = b.build();
    scene.groups = vec![Group { name: "g".into() }];
    scene
}

#[test]
fn a_narrow_chart_does_not_take_from_what_lies_beside_it() {
    // As baked atlases are: faces in a stripe two texels high, two more around it, black beyond.
    let stripe = |x: u32, y: u32| {
        let inside = (4..124).contains(&x) && (60..66).contains(&y);
        let g = if inside { 255 } else { 0 };
        [g, g, g, 255]
    };
    let mut scene = pictured(128, 128, stripe);
    let uv = |x: f32, y: f32| luxel_core::Vec2::new(x / 128.0, y / 128.0);
    scene.uvs = vec![
        [uv(6.0, 62.0), uv(122.0, 62.0), uv(122.0, 64.0)],
        [uv(122.0, 64.0), uv(6.0, 64.0), uv(6.0, 62.0)],
    ];
    for edge in [1.0, 0.3, 0.1] {
        let front = Kind::Uniform.build(settings(edge)).initial(&scene);
        for e in 0..front.len() {
            let m = front.emission[e].g as f64 / std::f64::consts::PI;
            assert!((m - 1.0).abs() < 1e-3, "element {e} of edge {edge}: {m}");
        }
    }
}

#[test]
fn textures_are_averaged_over_each_element() {
    // Noise of 512 x 512 texels, the hardest case: the mean of each quarter, from the texels.
    let noise = |x: u32, y: u32| {
        let h =
            (x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77)).wrapping_mul(0xC2B2_AE3D);
        let g = (h >> 24) as u8;
        [g, g, g, 255]
    };
    let scene = pictured(512, 512, noise);
    let front = Kind::Uniform.build(settings(0.25)).initial(&scene);
    assert_eq!(front.len(), 4);
    for e in 0..4 {
        let centre = front.polygons(&scene, ElementId::from(e))[0].centre();
        let (x0, y0) = (
            if centre.x < 0.5 { 0 } else { 256 },
            if centre.y < 0.5 { 256 } else { 0 },
        );
        let mut sum = 0.0;
        for y in y0..y0 + 256 {
            for x in x0..x0 + 256 {
                sum += luxel_core::texture::linear_from_srgb(noise(x, y)[0]) as f64;
            }
        }
        let mean = sum / 65536.0;
        let got = front.reflectance[e].g as f64;
        assert!(
            (got - mean).abs() < 0.005 * mean,
            "{got}, texels say {mean}"
        );
        let m = front.emission[e].g as f64 / std::f64::consts::PI;
        assert!((m - mean).abs() < 0.005 * mean);
    }
    // The same over triangles, whose mean is that of the whole square when weighted by area.
    let mut triangles = Front::new(2);
    for t in 0..2u32 {
        let [origin, b, c] = scene.corners(t as usize);
        let shape = Shape::Triangle {
            origin,
            edge_u: b - origin,
            edge_v: c - origin,
        };
        triangles.add_patch(SurfaceId(0), Side::Front, shape, [2, 2], GroupId(0), &[t]);
    }
    shade(&scene, &mut triangles);
    let flux = |f: &Front| {
        (0..f.len())
            .map(|e| f.reflectance[e].g as f64 * f.area[e] as f64)
            .sum::<f64>()
    };
    assert!((flux(&triangles) - flux(&front)).abs() < 0.005 * flux(&front));
}

#[test]
fn holes_do_not_darken_what_reflects() {
    // Left half white and opaque, right half a black hole.
    let mut scene = pictured(64, 64, |x, _| if x < 32 { [255; 4] } else { [0; 4] });
    scene.finishes[0].alpha = luxel_core::Alpha::Mask { cutoff: 0.5 };
    let front = Kind::Uniform.build(settings(1.0)).initial(&scene);
    assert_eq!(front.len(), 1);
    // 2 %: bilinear reading at the rim of the hole.
    assert!(front.reflectance[0].g > 0.98, "{:?}", front.reflectance[0]);
    let m = front.emission[0].g / std::f32::consts::PI;
    assert!((m - 0.5).abs() < 0.02, "half the area emits: {m}");
}

fn step_at(scene: &Scene, front: &Front, edge: f64) -> Solution {
    let exitance = (0..front.len())
        .flat_map(|e| {
            let p = &front.polygons(scene, ElementId::from(e))[0];
            let xs = p.vertices.iter().map(|v| v.x);
            let (low, high) = (
                xs.clone().fold(f64::MAX, f64::min),
                xs.fold(f64::MIN, f64::max),
            );
            let share = ((edge - low) / (high - low)).clamp(0.0, 1.0);
            [1.0 + share as f32; 3]
        })
        .collect();
    Solution {
        layers: Layers {
            groups: vec!["g".into()],
        },
        exitance,
        ..Solution::default()
    }
}

#[test]
fn adaptive_refines_at_the_edge_of_a_shadow_only() {
    // [Yeap99] figures 6.4, 6.5: a step of light at x = 1.7. Elements there reach the smallest
    // edge, the rest stays; a uniform mesh of that width would need 100 times more.
    let scene = strip();
    let settings = MeshSettings {
        min_edge_m: 0.05,
        ..settings(0.25)
    };
    let mut adaptive = Adaptive::new(settings);
    let mut front = adaptive.initial(&scene);
    for _ in 0..8 {
        let solution = step_at(&scene, &front, 1.7);
        let wish = neighbour_difference(&scene, &front, &solution);
        assert_eq!(wish.0.len(), front.len());
        let Some((next, change)) = adaptive.refine(&scene, &front, &solution, &wish) else {
            break;
        };
        assert_change_keeps_flux(&front, &next, &change, &solution);
        front = next;
        assert_balanced(&front);
    }
    assert_covers(&scene, &front);
    let finest = front.area.iter().fold(f32::MAX, |a, &b| a.min(b));
    assert!(
        (finest - 0.0625 * 0.0625).abs() < 1e-6,
        "edge 1/16 m: the next would be below 5 cm"
    );
    let uniform = (4.0 / finest) as usize;
    assert!(
        front.len() * 4 < uniform,
        "{} elements instead of {uniform}",
        front.len()
    );
    let far = (0..front.len())
        .filter(|&e| front.polygons(&scene, ElementId::from(e))[0].centre().x > 2.6)
        .all(|e| front.area[e] > 0.2);
    assert!(far, "no refinement away from the step");
    let solution = step_at(&scene, &front, 10.0);
    let wish = neighbour_difference(&scene, &front, &solution);
    assert!(
        wish.0.iter().all(|&w| w < 1e-6),
        "even light: nothing to refine"
    );
    assert!(adaptive.refine(&scene, &front, &solution, &wish).is_none());
}

fn assert_change_keeps_flux(
    old: &Front,
    new: &Front,
    change: &luxel_core::FrontChange,
    solution: &Solution,
) {
    let carried = change.carry(&solution.exitance, 3);
    assert_eq!(carried.len(), 3 * new.len());
    let flux = |f: &Front, b: &[f32]| {
        (0..f.len())
            .map(|e| b[3 * e] as f64 * f.area[e] as f64)
            .sum::<f64>()
    };
    let (before, after) = (flux(old, &solution.exitance), flux(new, &carried));
    // Quarters of an area are exact in f32.
    assert!((before - after).abs() < 1e-12 * before, "{before} {after}");
}

/// Neighbours within a parallelogram patch differ by one level at most: found by brute force.
fn assert_balanced(front: &Front) {
    for a in 0..front.len() {
        for b in 0..front.len() {
            let ([x, y, w, h], [p, q, r, s]) = (front.rect[a], front.rect[b]);
            let apart = 1e-6;
            let touch_x = ((x + w - p).abs() < apart || (p + r - x).abs() < apart)
                && y < q + s - apart
                && q < y + h - apart;
            if front.patch[a] == front.patch[b] && touch_x {
                assert!(
                    w / r < 2.5 && r / w < 2.5,
                    "elements {a} and {b}: {w} and {r}"
                );
            }
        }
    }
}

#[test]
fn texture_is_not_taken_for_a_shadow() {
    // Even irradiance on a picture that is dark on the left: exitance steps, light does not.
    let scene = pictured(
        64,
        64,
        |x, _| if x < 32 { [90, 90, 90, 255] } else { [255; 4] },
    );
    let front = Kind::Uniform.build(settings(1.0 / 16.0)).initial(&scene);
    let exitance = front
        .reflectance
        .iter()
        .flat_map(|r| [r.g * 100.0; 3])
        .collect();
    let solution = Solution {
        layers: Layers {
            groups: vec!["g".into()],
        },
        exitance,
        ..Solution::default()
    };
    let wish = neighbour_difference(&scene, &front, &solution);
    assert!(wish.0.iter().all(|&w| w < 1e-4), "{:?}", wish.0);
}

#[test]
fn refinement_stops_at_the_limit_on_elements() {
    let scene = strip();
    let settings = MeshSettings {
        max_elements: 50,
        ..settings(0.25)
    };
    let mut adaptive = Adaptive::new(settings);
    let front = adaptive.initial(&scene);
    let wish = RefinementWish(vec![1.0; front.len()]);
    let (next, _) = adaptive
        .refine(&scene, &front, &Solution::default(), &wish)
        .expect("splits");
    assert!(next.len() <= 50 && next.len() > 47, "{}", next.len());
}

#[test]
fn rex_splits_at_a_step_and_merges_where_the_light_has_moved_on() {
    // Leaves of 0.8 m2 at first. A step of light at x = 1.73 that moves to x = 3.13: leaves are
    // split there, and merged behind it.
    let scene = strip();
    let settings = MeshSettings {
        min_edge_m: 0.05,
        ..settings(0.05)
    };
    let mut rex = Kind::Rex.build(settings);
    let mut front = rex.initial(&scene);
    let uniform = Kind::Uniform.build(settings).initial(&scene).len();
    assert!(
        front.len() * 4 < uniform,
        "coarse at first: {}",
        front.len()
    );
    let least_at = |front: &Front, x: f64| {
        (0..front.len())
            .filter(|&e| {
                let p = &front.polygons(&scene, ElementId::from(e))[0].vertices;
                p.iter().any(|q| q.x <= x) && p.iter().any(|q| q.x >= x)
            })
            .map(|e| front.area[e])
            .fold(f32::MAX, f32::min)
    };
    let mut lengths = Vec::new();
    for edge in [1.73, 3.13] {
        for _ in 0..8 {
            let solution = step_at(&scene, &front, edge);
            let wish = neighbour_difference(&scene, &front, &solution);
            let Some((next, change)) = rex.refine(&scene, &front, &solution, &wish) else {
                break;
            };
            assert_change_keeps_flux(&front, &next, &change, &solution);
            front = next;
            assert_covers(&scene, &front);
        }
        lengths.push(front.len());
        assert!(
            least_at(&front, edge) < 0.03,
            "small at {edge}: {}, {lengths:?}",
            least_at(&front, edge)
        );
    }
    assert!(
        least_at(&front, 1.73) > 0.09,
        "merged: {}",
        least_at(&front, 1.73)
    );
    assert!(lengths.iter().all(|&n| n < 400), "{lengths:?}");
}

#[test]
fn neighbours_are_found_across_patches_of_one_surface() {
    // An L-shaped floor: no parallelogram, so several patches. A step between two of them shows.
    let mut b = Builder::new("L");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    b.on("floor", grey).polygon(&[
        v(0., 0., 0.),
        v(2., 0., 0.),
        v(2., 1., 0.),
        v(1., 1., 0.),
        v(1., 2., 0.),
        v(0., 2., 0.),
    ]);
    let scene = b.build();
    let front = Kind::Uniform
        .build(MeshSettings {
            cluster: false,
            ..settings(4.0)
        })
        .initial(&scene);
    assert!(front.patches.len() > 1);
    let exitance = (0..front.len())
        .flat_map(|e| [1.0 + front.patch[e].0 as f32; 3])
        .collect();
    let solution = Solution {
        layers: Layers {
            groups: vec!["g".into()],
        },
        exitance,
        ..Solution::default()
    };
    let wish = neighbour_difference(&scene, &front, &solution);
    assert!(wish.0.iter().all(|&w| w > 0.1), "{:?}", wish.0);
}

fn assert_tree(scene: &Scene, front: &Front) {
    let tree = hierarchy(scene, front);
    assert_eq!(tree, hierarchy(scene, front), "same bits again");
    let mut seen = vec![false; front.len()];
    for e in &tree.order {
        assert!(
            !std::mem::replace(&mut seen[e.index()], true),
            "every element once"
        );
    }
    assert!(seen.iter().all(|&s| s));
    assert_eq!(tree.nodes[0].count as usize, front.len());
    for (i, node) in tree.nodes.iter().enumerate() {
        if node.children > 0 {
            assert!(node.first_child as usize > i, "parents first");
            let children =
                &tree.nodes[node.first_child as usize..(node.first_child + node.children) as usize];
            assert_eq!(children.iter().map(|c| c.count).sum::<u32>(), node.count);
            assert_eq!(children[0].first, node.first);
            let area: f64 = children.iter().map(|c| c.area as f64).sum();
            assert!(
                (area - node.area as f64).abs() < 1e-5 * area,
                "f32 rounding"
            );
        } else {
            assert_eq!(node.count, 1, "down to single elements");
        }
        for &e in tree.elements(i) {
            for p in front.polygons(scene, e) {
                for q in &p.vertices {
                    let slack = 1e-5;
                    let (low, high) = (node.low.as_dvec3() - slack, node.high.as_dvec3() + slack);
                    assert!(q.cmpge(low).all() && q.cmple(high).all(), "bounds hold");
                }
                let cosine = p.normal().as_vec3().dot(node.axis);
                // Polygons of a grid are recomputed in f32: 1e-4 of their normal.
                assert!(cosine >= node.cos_half_angle - 1e-4, "cone holds: {cosine}");
            }
        }
    }
}

#[test]
fn tree_holds_all_elements_of_any_front() {
    let scene = luxel_scenes::cornell();
    for kind in Kind::ALL {
        assert_tree(
            &scene,
            &kind
                .build(MeshSettings::for_scene(&scene, 300))
                .initial(&scene),
        );
    }
    assert!(hierarchy(&scene, &Front::new(0)).nodes.is_empty());
}

#[test]
fn fronts_do_not_depend_on_the_number_of_threads() {
    let scene = luxel_scenes::corridor(20_000);
    let settings = MeshSettings::for_scene(&scene, 3000);
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("pool");
        pool.install(|| {
            let mut warnings = luxel_core::Warnings::default();
            let prepare = luxel_mesh::PrepareSettings::for_mesh(&settings);
            let new = luxel_mesh::prepare(scene.clone(), &prepare, &mut warnings);
            let front = Kind::Uniform.build(settings).initial(&new);
            let tree = hierarchy(&new, &front);
            (new, front, tree)
        })
    };
    let (one, three) = (build(1), build(3));
    assert!(one == three);
    assert!(one.1.len() <= settings.max_elements);
    let empty = Kind::Uniform.build(settings).initial(&Scene::default());
    assert!(empty.is_empty());
}

#[test]
fn clusters_do_not_cross_a_contact_line() {
    // A wall at x = 2 with a box close to it on either side: small pieces of floor on both
    // sides within one cube of 1 m (cubes start at x = -0.5).
    let mut b = Builder::new("two cells");
    let grey = b.matte("grey", 0.5, 0.5, 0.5);
    let rect = |x0: f32, y0: f32, x1: f32, y1: f32| {
        [v(x0, y0, 0.), v(x1, y0, 0.), v(x1, y1, 0.), v(x0, y1, 0.)]
    };
    b.on("floor", grey).polygon(&rect(-0.5, 0., 4., 3.));
    b.on("wall", grey)
        .polygon(&[v(2., 0., 0.), v(2., 3., 0.), v(2., 3., 2.), v(2., 0., 2.)]);
    for (name, x) in [("left", 1.55), ("right", 2.05)] {
        b.on(name, grey)
            .block(v(x, 1.1, 0.0), v(x + 0.4, 1.5, 0.5), u8::MAX);
    }
    let scene = b.build();
    let mut warnings = luxel_core::Warnings::default();
    let fine = luxel_mesh::PrepareSettings::for_mesh(&settings(0.05));
    let new = luxel_mesh::prepare(scene, &fine, &mut warnings);
    let front = Kind::Uniform.build(settings(1.0)).initial(&new);
    assert_covers(&new, &front);
    let mut near = [0, 0];
    for e in 0..front.len() {
        if front.surface(ElementId::from(e)) != SurfaceId(0) {
            continue;
        }
        // The floor under the boxes is cut off whole: two regions below the size of an element,
        // which may share one.
        let under = |c: glam::DVec3| {
            (1.1..1.5).contains(&c.y)
                && ((1.55..1.95).contains(&c.x) || (2.05..2.45).contains(&c.x))
        };
        let mut polygons = front.polygons(&new, ElementId::from(e));
        polygons.retain(|p| !under(p.centre()));
        if polygons.is_empty() {
            continue;
        }
        let right: Vec<bool> = polygons.iter().map(|p| p.centre().x > 2.0).collect();
        assert!(
            right.iter().all(|&r| r == right[0]),
            "element {e} joins both sides"
        );
        if polygons.len() > 1 {
            near[right[0] as usize] += 1;
        }
    }
    assert!(
        near[0] > 0 && near[1] > 0,
        "there are clusters on both sides: {near:?}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    /// Any triangles and parallelograms, any size of element, any splits.
    #[test]
    fn random_shapes_are_covered(
        shapes in prop::collection::vec(
            (prop::array::uniform3(-5.0f32..5.0), prop::array::uniform3(-3.0f32..3.0), prop::array::uniform3(-3.0f32..3.0), prop::bool::ANY, prop::bool::ANY),
            1..6),
        max_area in 0.05f32..5.0,
        splits in prop::collection::vec(0usize..1000, 0..20),
        kind in 0usize..Kind::ALL.len(),
    ) {
        let mut b = Builder::new("random");
        let single = b.matte("single", 0.5, 0.5, 0.5);
        let double = b.thin("double", 0.5, 0.5, 0.5);
        for (i, (o, u, w, quad, thin)) in shapes.iter().enumerate() {
            // Whole millimetres, summed in f64: each corner is rounded to f32 once, as in a file.
            let mm = |a: &[f32; 3]| glam::DVec3::from(a.map(|x| (x as f64 * 1e3).round() / 1e3));
            let (o, u, w) = (mm(o), mm(u), mm(w));
            // Slivers thinner than 1 % of their length: f32 cannot tell their cells apart.
            prop_assume!(u.cross(w).length() > 0.03 * u.length().max(w.length()).powi(2));
            let [o, ou, ouw, ow] = [o, o + u, o + u + w, o + w].map(|p| p.as_vec3());
            b.on(&format!("s{i}"), if *thin { double } else { single });
            if *quad {
                b.polygon(&[o, ou, ouw, ow]);
            } else {
                b.polygon(&[o, ou, ow]);
            }
        }
        let scene = b.build();
        let mut strategy = Kind::ALL[kind].build(settings(max_area));
        let mut front = strategy.initial(&scene);
        assert_covers(&scene, &front);
        let quads = shapes.iter().filter(|s| s.3).count();
        let found = front
            .patches
            .iter()
            .filter(|p| p.side == Side::Front && matches!(p.shape, Shape::Parallelogram { .. }))
            .count();
        prop_assert_eq!(found, quads, "every parallelogram is one patch");
        for s in splits {
            let e = ElementId::from(s % front.len());
            if front.area[e.index()] > 1e-3 {
                front.split(e);
            }
        }
        assert_covers(&scene, &front);
        assert_tree(&scene, &front);
    }

    /// Any wishes, on quadrilaterals and triangles: a rex keeps flux and limits, finds every point.
    #[test]
    fn random_wishes_of_a_rex_keep_flux(
        wishes in prop::collection::vec(prop::collection::vec(0.0f32..0.2, 64), 1..5),
        seed in 0u32..1000,
    ) {
        let mut b = Builder::new("both");
        let thin = b.thin("thin", 0.5, 0.5, 0.5);
        b.on("wall", thin)
            .polygon(&[v(0., 0., 0.), v(4., 0., 0.), v(4., 1., 0.), v(0., 1., 0.)]);
        b.on("gable", thin).polygon(&[v(0., 2., 0.), v(3., 2., 0.), v(1., 4., 0.)]);
        let scene = b.build();
        let limit = MeshSettings { min_edge_m: 0.05, max_elements: 600, ..settings(0.1) };
        let mut rex = Kind::Rex.build(limit);
        let mut front = rex.initial(&scene);
        for wish in wishes {
            let n = front.len();
            let exitance: Vec<f32> =
                (0..3 * n).map(|i| ((i as u32 * 7919 + seed) % 101) as f32).collect();
            let solution = Solution { layers: Layers { groups: vec!["g".into()] }, exitance, ..Solution::default() };
            // Most wishes are nothing, so that leaves merge too.
            let wish = RefinementWish((0..n).map(|e| (wish[e * 7 % wish.len()] - 0.1).max(0.0)).collect());
            if let Some((next, change)) = rex.refine(&scene, &front, &solution, &wish) {
                assert_change_keeps_flux(&front, &next, &change, &solution);
                prop_assert!(next.len() <= 600);
                front = next;
            }
        }
        assert_covers(&scene, &front);
    }

    /// Any wishes: flux is kept, neighbours stay within one level, limits are held.
    #[test]
    fn random_wishes_keep_flux_and_balance(
        wishes in prop::collection::vec(prop::collection::vec(0.0f32..1.0, 64), 1..4),
        seed in 0u32..1000,
    ) {
        let scene = strip();
        let limit = MeshSettings { min_edge_m: 0.03, max_elements: 400, ..settings(0.25) };
        let mut adaptive = Adaptive::with_threshold(limit, 0.8);
        let mut front = adaptive.initial(&scene);
        for wish in wishes {
            let n = front.len();
            let exitance: Vec<f32> =
                (0..3 * n).map(|i| ((i as u32 * 7919 + seed) % 101) as f32).collect();
            let solution = Solution { layers: Layers { groups: vec!["g".into()] }, exitance, ..Solution::default() };
            let wish = RefinementWish((0..n).map(|e| wish[e % wish.len()]).collect());
            if let Some((next, change)) = adaptive.refine(&scene, &front, &solution, &wish) {
                assert_change_keeps_flux(&front, &next, &change, &solution);
                prop_assert!(next.len() <= 400);
                assert_balanced(&next);
                front = next;
            }
        }
        assert_covers(&scene, &front);
        let edge = (0..front.len())
            .map(|e| {
                let p = &front.polygons(&scene, ElementId::from(e))[0].vertices;
                p[0].distance(p[1]).min(p[1].distance(p[2]))
            })
            .fold(f64::MAX, f64::min);
        prop_assert!(edge >= 0.0299, "no edge below the smallest: {edge}");
    }
}

#[test]
fn uv_of_unused_is_not_read() {
    // A finish with a texture on a scene without coordinates reads one texel and goes on.
    let mut scene = pictured(4, 4, |_, _| [188, 188, 188, 255]);
    scene.uvs = Vec::<[Vec2; 3]>::new();
    let front = Kind::Uniform.build(settings(0.25)).initial(&scene);
    // sRGB 188 is 0.5029 linear [IEC61966-2-1].
    assert!(
        front
            .reflectance
            .iter()
            .all(|r| (r.g - 0.5029).abs() < 1e-3)
    );
}
