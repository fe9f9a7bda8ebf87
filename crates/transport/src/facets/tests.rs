//! The whole of `facets` against independent answers.

use super::*;
use crate::obstructed::factor_past;
use crate::polygon_pair::polygon_to_polygon;
use crate::testing;
use luxel_core::{Facet, FacetPart, Polygon};

fn facets(rows: Vec<Vec<DVec3>>, blockers: Vec<Vec<DVec3>>) -> Facets {
    let count = rows.len();
    let all = rows.into_iter().enumerate().map(|(k, v)| (k as u32, v));
    let none = blockers.into_iter().map(|v| (Facets::NO_ROW, v));
    Facets {
        rows: vec![Facet::default(); count],
        parts: all
            .chain(none)
            .map(|(row, v)| FacetPart {
                polygon: Polygon::new(v),
                row,
            })
            .collect(),
        ..Facets::default()
    }
}

fn computed(facets: &Facets, error: f64) -> (ExchangeMatrix, Counts) {
    let settings = FacetSettings {
        error,
        ..FacetSettings::default()
    };
    let work = FacetFactors::new(facets, &settings);
    let batches: Vec<Batch> = (0..work.batches()).map(|b| work.compute(b)).collect();
    let mut counts = Counts::default();
    batches.iter().for_each(|b| counts.add(&b.counts));
    (work.matrix(&batches), counts)
}

fn factor(matrix: &ExchangeMatrix, i: usize, j: usize) -> f64 {
    let run = matrix.offsets[i]..matrix.offsets[i + 1];
    let place = matrix.columns[run.clone()].binary_search(&(j as u32));
    place.map_or(0.0, |k| {
        matrix.exchange[run.start + k] as f64 / matrix.areas[i]
    })
}

/// Uniform numbers, the same each time.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn vector(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next())
    }
}

#[test]
fn random_heaps_agree_with_adaptive_cubature() {
    // Triangles and parallelograms through each other, any size and direction, and boxes among
    // them; all pairs against `factor_past` (independent: shadows from points, no trees, no
    // merging, no critical lines) at 1e-4 of the free factor and its own bound. Promised 3e-5.
    let mut worst = 0.0_f64;
    let mut compared = 0;
    for seed in 0..3 {
        let mut random = Random(seed);
        let mut rows = Vec::new();
        for k in 0..7 {
            let (o, size) = (random.vector(), 0.15 + 0.5 * random.next());
            let (u, v) = (
                (random.vector() - 0.5) * size * 2.0,
                (random.vector() - 0.5) * size * 2.0,
            );
            rows.push(if k % 2 == 0 {
                vec![o, o + u, o + v]
            } else {
                vec![o, o + u, o + u + v, o + v]
            });
        }
        let (low, size) = (random.vector() * 0.6, random.vector() * 0.3 + 0.1);
        rows.extend(box_faces(low, low + size));
        let facets = facets(rows.clone(), Vec::new());
        let (matrix, _) = computed(&facets, 3e-5);
        let polygons: Vec<Polygon> = rows.into_iter().map(Polygon::new).collect();
        for i in 0..polygons.len() {
            for j in i + 1..polygons.len() {
                let free = polygon_to_polygon(&polygons[i], &polygons[j]);
                if free == 0.0 {
                    assert_eq!(factor(&matrix, i, j), 0.0);
                    continue;
                }
                let others: Vec<Polygon> = (0..polygons.len())
                    .filter(|&k| k != i && k != j)
                    .map(|k| polygons[k].clone())
                    .collect();
                let want = factor_past(&polygons[i], &polygons[j], &others, 1e-4);
                let got = factor(&matrix, i, j);
                let off = (got - want.factor).abs();
                assert!(
                    off <= 3e-5 + want.error,
                    "seed {seed}, {i} to {j}: {got} for {want:?}, free {free}"
                );
                assert!(got <= free * (1.0 + 3e-5));
                worst = worst.max(off - want.error);
                compared += 1;
            }
        }
    }
    eprintln!("{compared} pairs, worst {worst:.1e}");
    assert!(compared > 60, "{compared}");
}

fn box_faces(l: DVec3, h: DVec3) -> Vec<Vec<DVec3>> {
    let at = |i: usize, j: usize, k: usize| DVec3::new([l.x, h.x][i], [l.y, h.y][j], [l.z, h.z][k]);
    vec![
        vec![at(0, 0, 0), at(0, 1, 0), at(1, 1, 0), at(1, 0, 0)],
        vec![at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1)],
        vec![at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1)],
        vec![at(1, 1, 0), at(0, 1, 0), at(0, 1, 1), at(1, 1, 1)],
        vec![at(0, 1, 0), at(0, 0, 0), at(0, 0, 1), at(0, 1, 1)],
        vec![at(1, 0, 0), at(1, 1, 0), at(1, 1, 1), at(1, 0, 1)],
    ]
}

#[test]
fn reference_cases_through_the_whole_engine() {
    // Every polygon case of the file, blockers among them: 1e-6 relative without blockers, 1e-4
    // with, as it asks of analytic methods, plus its uncertainty.
    let Some(cases) = testing::cases("form_factors.json") else {
        return;
    };
    let (mut free, mut obstructed) = (0, 0);
    for case in &cases {
        let surfaces = case["scene"]["surfaces"].as_array().expect("surfaces");
        if !surfaces.iter().all(testing::is_polygon) {
            continue;
        }
        for query in case["queries"].as_array().expect("queries") {
            let (from, to) = (&query["from"], &query["to"]);
            let rows = [from, to].map(|id| testing::polygon(testing::surface(case, id)).vertices);
            let blockers: Vec<Vec<DVec3>> = surfaces
                .iter()
                .filter(|s| &s["id"] != from && &s["id"] != to)
                .map(|s| testing::polygon(s).vertices)
                .collect();
            let tolerance = if blockers.is_empty() { 1e-6 } else { 1e-4 };
            *(if blockers.is_empty() {
                &mut free
            } else {
                &mut obstructed
            }) += 1;
            let (want, unc) = testing::expected(query);
            let (matrix, _) = computed(&facets(rows.to_vec(), blockers), 1e-6);
            let got = factor(&matrix, 0, 1);
            assert!(
                (got - want).abs() <= tolerance * want + unc + 1e-12,
                "{} {}: {got} for {want}",
                case["id"],
                query["id"]
            );
        }
    }
    eprintln!("{free} free and {obstructed} obstructed factors");
    assert!(free >= 60 && obstructed >= 8, "{free} {obstructed}");
}

#[test]
fn points_see_past_blockers() {
    // A plate over a quarter of what a point sees of a ceiling, by symmetry; and closure from any
    // point of a box among boxes, whatever its direction: 1e-12.
    let ceiling = vec![
        DVec3::new(-1., -1., 1.),
        DVec3::new(-1., 1., 1.),
        DVec3::new(1., 1., 1.),
        DVec3::new(1., -1., 1.),
    ];
    let plate = [(0., 0.), (9., 0.), (9., 9.), (0., 9.)].map(|(x, y)| DVec3::new(x, y, 0.5));
    let open = FacetFactors::new(
        &facets(vec![ceiling.clone()], vec![]),
        &FacetSettings::default(),
    );
    let hidden = FacetFactors::new(
        &facets(vec![ceiling], vec![plate.to_vec()]),
        &FacetSettings::default(),
    );
    let all = open.from_point(DVec3::ZERO, DVec3::Z)[0].1;
    let seen = hidden.from_point(DVec3::ZERO, DVec3::Z)[0].1;
    assert!((seen / all - 0.75).abs() < 1e-12, "{}", seen / all);

    let room = luxel_scenes::floating_boxes(300);
    let work = FacetFactors::new(&room, &FacetSettings::default());
    let mut random = Random(5);
    for _ in 0..40 {
        let x = random.vector() * DVec3::new(3.8, 2.8, 0.2) + 0.1;
        let normal = (random.vector() - 0.5).normalize();
        let sum: f64 = work.from_point(x, normal).iter().map(|f| f.1).sum();
        assert!((sum - 1.0).abs() < 1e-12, "{sum} from {x}");
    }
}

#[test]
fn rows_of_closed_scenes_sum_to_one() {
    // A room with boxes; the same cut into triangles; and a ball inside a box, 320 triangles,
    // whose facets hide each other. |1 - sum| stays below a few times the promise.
    let room = luxel_scenes::floating_boxes(250);
    let mut triangles = room.clone();
    triangles.parts.clear();
    triangles.rows.clear();
    for part in &room.parts {
        let v = &part.polygon.vertices;
        for corners in [[v[0], v[1], v[2]], [v[0], v[2], v[3]]] {
            triangles.parts.push(FacetPart {
                polygon: Polygon::new(corners.to_vec()),
                row: triangles.rows.len() as u32,
            });
            triangles.rows.push(Facet::default());
        }
    }
    let mut ball = ball(2);
    ball.extend(
        box_faces(DVec3::splat(-2.0), DVec3::splat(2.0))
            .into_iter()
            .map(|mut f| {
                f.reverse();
                f
            }),
    );
    for (name, scene) in [
        ("quads", room),
        ("triangles", triangles),
        ("ball", facets(ball, vec![])),
    ] {
        let (matrix, counts) = computed(&scene, 1e-4);
        let sums = matrix.row_sums();
        let mean = sums.iter().map(|s| (1.0 - s).abs()).sum::<f64>() / sums.len() as f64;
        let worst = sums.iter().map(|s| (1.0 - s).abs()).fold(0.0, f64::max);
        eprintln!("{name}: closure mean {mean:.1e}, worst {worst:.1e}, {counts:?}");
        assert!(mean < 1e-4 && worst < 1e-3, "{name}: {mean} {worst}");
    }
}

/// An icosahedron whose faces are cut in four `times` times, on the unit sphere.
fn ball(times: u32) -> Vec<Vec<DVec3>> {
    let g = 0.5 * (1.0 + 5.0_f64.sqrt());
    let mut v = Vec::new();
    for (a, b) in [(1., g), (-1., g), (1., -g), (-1., -g)] {
        v.extend([
            DVec3::new(a, b, 0.),
            DVec3::new(0., a, b),
            DVec3::new(b, 0., a),
        ]);
    }
    let mut faces = Vec::new();
    for i in 0..12 {
        for j in 0..12 {
            for k in 0..12 {
                let near = |a: usize, b: usize| (v[a].distance(v[b]) - 2.0).abs() < 1e-9;
                let turn = (v[j] - v[i]).cross(v[k] - v[i]).dot(v[i]);
                if i < j && i < k && near(i, j) && near(j, k) && near(k, i) && turn > 0.0 {
                    faces.push([v[i], v[j], v[k]].map(|p: DVec3| p.normalize()));
                }
            }
        }
    }
    assert_eq!(faces.len(), 20);
    for _ in 0..times {
        faces = faces
            .into_iter()
            .flat_map(|[a, b, c]| {
                let [ab, bc, ca] = [a + b, b + c, c + a].map(|p| p.normalize());
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    faces.into_iter().map(|f| f.to_vec()).collect()
}

#[test]
fn the_same_bits_on_any_number_of_threads_and_in_parts() {
    let room = luxel_scenes::floating_boxes(250);
    let pool = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads")
    };
    let one = pool(1).install(|| computed(&room, 1e-4).0);
    let three = pool(3).install(|| computed(&room, 1e-4).0);
    assert!(one == three);
    // Rows by themselves have the very same numbers.
    let settings = FacetSettings {
        rows: 17..23,
        ..FacetSettings::default()
    };
    let work = FacetFactors::new(&room, &settings);
    let batches: Vec<Batch> = (0..work.batches()).map(|b| work.compute(b)).collect();
    let part = work.matrix(&batches);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for row in 17..23 {
        one.row(row, &mut a);
        part.row(row, &mut b);
        assert!(a == b && !a.is_empty());
    }
    assert!(part.columns.len() < one.columns.len() / 10);
}

#[test]
fn rows_of_several_parts_exchange_with_themselves() {
    // A cube as two rows: floor, and all the rest as one row of five parts. F of the rest to
    // itself is 1 - A_floor / A_rest.
    let faces = box_faces(DVec3::ZERO, DVec3::ONE);
    let mut scene = facets(
        faces
            .into_iter()
            .map(|mut f| {
                f.reverse();
                f
            })
            .collect(),
        vec![],
    );
    scene.rows.truncate(2);
    for part in &mut scene.parts {
        part.row = part.row.min(1);
    }
    let (matrix, _) = computed(&scene, 1e-6);
    assert!((factor(&matrix, 0, 1) - 1.0).abs() < 1e-6);
    assert!((factor(&matrix, 1, 1) - 0.8).abs() < 1e-6);
    assert!((factor(&matrix, 1, 0) - 0.2).abs() < 1e-6);
}

#[test]
fn tiny_gaps_and_common_edges() {
    // Plates of 1 m a micrometre apart see nothing but each other; a plate of the same size in
    // the gap hides all; a wall on an edge of the floor gets the closed form to 1e-6.
    let at = |z: f64| [(0., 0.), (1., 0.), (1., 1.), (0., 1.)].map(|(x, y)| DVec3::new(x, y, z));
    let floor = at(0.0).to_vec();
    let mut lid = at(1e-6).to_vec();
    lid.reverse();
    let (matrix, _) = computed(&facets(vec![floor.clone(), lid.clone()], vec![]), 1e-6);
    let want = 1.0 - 2e-6;
    assert!((factor(&matrix, 0, 1) - want).abs() < 1e-6);
    let between = at(5e-7).to_vec();
    let (matrix, _) = computed(&facets(vec![floor.clone(), lid], vec![between]), 1e-6);
    assert_eq!(matrix.columns.len(), 0);
    let wall = vec![DVec3::ZERO, DVec3::Y, DVec3::new(0., 1., 1.), DVec3::Z];
    let want = polygon_to_polygon(&Polygon::new(floor.clone()), &Polygon::new(wall.clone()));
    let (matrix, _) = computed(&facets(vec![floor, wall], vec![]), 1e-4);
    assert!(
        (factor(&matrix, 0, 1) / want - 1.0).abs() < 1e-6 && (want - 0.200_043_78).abs() < 1e-7
    );
}

#[test]
fn nothing_and_one_facet() {
    let (matrix, _) = computed(&Facets::default(), 1e-4);
    assert_eq!(matrix.shape(), [0, 0]);
    let (matrix, _) = computed(
        &facets(vec![vec![DVec3::ZERO, DVec3::X, DVec3::Y]], vec![]),
        1e-4,
    );
    assert_eq!((matrix.shape(), matrix.entries()), ([1, 1], 0));
}

#[test]
fn rounded_triangles_do_not_stand_in_their_own_way() {
    // Turned, in triangles of centimetres, rounded to f32: each knows its plane to a millionth,
    // and the box that it lies on reaches far beyond it. Rows of a closed scene sum to 1.
    let room = luxel_scenes::floating_boxes(1000);
    let turn = luxel_core::glam::DQuat::from_euler(luxel_core::glam::EulerRot::XYZ, 0.3, 0.5, 0.7);
    let mut triangles = Vec::new();
    let mut first_on_a_box = 0;
    for part in &room.parts {
        let v: Vec<DVec3> = part
            .polygon
            .vertices
            .iter()
            .map(|&v| (turn * v).as_vec3().as_dvec3())
            .collect();
        if room.rows[part.row as usize].object == 0 {
            first_on_a_box = triangles.len() as u32 + 2;
        }
        triangles.extend([vec![v[0], v[1], v[2]], vec![v[0], v[2], v[3]]]);
    }
    let mut scene = facets(triangles, vec![]);
    scene.rounding_m = 5.0 * f32::EPSILON as f64;
    let settings = FacetSettings {
        rows: first_on_a_box..u32::MAX,
        ..FacetSettings::default()
    };
    let work = FacetFactors::new(&scene, &settings);
    assert!(work.blockers() == 10);
    let batches: Vec<Batch> = (0..work.batches()).map(|b| work.compute(b)).collect();
    let sums = work.matrix(&batches).row_sums();
    let worst = sums[first_on_a_box as usize..]
        .iter()
        .map(|s| (s - 1.0).abs())
        .fold(0.0, f64::max);
    eprintln!(
        "{} rows, worst {worst:.1e}",
        sums.len() - first_on_a_box as usize
    );
    assert!(worst < 4e-4, "{worst:e}");
}

#[test]
fn a_round_table_hides_what_its_outline_says() {
    // One facet of many corners in a room: from a point by the closed form, whole factors by
    // closure and by symmetry. Its shadow has more corners than a ring holds.
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let radius = 0.5;
    for n in [24, 48, 100, 1000] {
        let table: Vec<DVec3> = (0..n)
            .map(|k| std::f64::consts::TAU * k as f64 / n as f64)
            .map(|t| corner(2.0 + radius * t.cos(), 2.0 + radius * t.sin(), 1.3))
            .collect();
        let (w, h) = (4.0, 3.0);
        let room = [
            [[0., 0., 0.], [w, 0., 0.], [w, w, 0.], [0., w, 0.]],
            [[0., 0., h], [0., w, h], [w, w, h], [w, 0., h]],
            [[0., 0., 0.], [0., 0., h], [w, 0., h], [w, 0., 0.]],
            [[w, 0., 0.], [w, 0., h], [w, w, h], [w, w, 0.]],
            [[w, w, 0.], [w, w, h], [0., w, h], [0., w, 0.]],
            [[0., w, 0.], [0., w, h], [0., 0., h], [0., 0., 0.]],
        ]
        .map(|side| side.map(DVec3::from_array).to_vec());
        let [floor, ceiling] = [0, 1].map(|k| room[k].clone());
        let rows: Vec<Vec<DVec3>> = room.into_iter().chain([table.clone()]).collect();
        let all = facets(rows, Vec::new());
        let work = FacetFactors::new(&all, &FacetSettings::default());
        let x = corner(1.9, 2.05, 0.0);
        let free = |polygon: &[DVec3]| crate::lambert::above_horizon(x, DVec3::Z, polygon);
        let underside: Vec<DVec3> = table.iter().rev().copied().collect();
        let exact = free(&ceiling) - free(&underside);
        assert_eq!(free(&floor), 0.0);
        let found = work.from_point(x, DVec3::Z);
        let seen = found.iter().find(|f| f.0 == 1).map_or(0.0, |f| f.1);
        assert!((seen - exact).abs() < 1e-12, "{n}: {seen} for {exact}");
        if n > 100 {
            continue;
        }
        let (matrix, _) = computed(&all, 1e-4);
        let sums = matrix.row_sums();
        // The ceiling and the table see only fronts; the walls are alike.
        assert!((sums[1] - 1.0).abs() < 2e-4, "{n}: {sums:?}");
        assert!((sums[6] - 1.0).abs() < 2e-4, "{n}: {sums:?}");
        for wall in 3..6 {
            assert!((sums[wall] - sums[2]).abs() < 2e-4, "{n}: {sums:?}");
        }
    }
}
