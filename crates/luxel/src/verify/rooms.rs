//! Cases with a scene of their own: solved by a session, asked at receivers, as a user would.

use super::case::{Bands, Case, Query, Surface, triple};
use super::{Answer, Found};
use crate::session::Session;
use crate::settings::Settings;
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::{
    Emission, Finish, FinishId, Group, GroupId, Luminaire, LuminaireKind, Rgb, Scene, Solution,
    SurfaceId, Vec3,
};
use luxel_gather::{Accuracy, Receiver};
use luxel_transport::Sequence;
use serde_json::Value;
use std::f64::consts::TAU;

/// Facets around a sphere or disc.
const AROUND: usize = 128;
/// Facets of the prism that stands for a line source, and its radius, metres.
const PRISM: usize = 24;
const PRISM_RADIUS_M: f64 = 5e-4;
/// Receivers over a surface for its mean.
const MEAN_RECEIVERS: u32 = 2048;
/// Receivers on each surface where "everywhere" is asked; the worst counts.
const EVERYWHERE_RECEIVERS: u32 = 64;
/// Elements aimed at: rooms of one box need no more for 0.1 %; facets are not to be clustered.
const ELEMENTS: usize = 6_000;
const FACET_ELEMENTS: usize = 30_000;

/// A triangle with its corners, f64.
type Triangle = [[f64; 3]; 3];

struct Built {
    session: Session,
    solution: Solution,
    /// Triangles of each surface of the case, for receivers.
    triangles: Vec<Vec<Triangle>>,
    /// Centre of each surface that is part of a sphere: there receivers face as the sphere does,
    /// not as its facets, which are up to 1.4 degrees off.
    centres: Vec<Option<[f64; 3]>>,
    class: &'static str,
}

/// Configuration factor past other surfaces: the illuminance that the surface gives when it
/// alone shines with 1 lm/m² and nothing reflects.
pub(super) fn configuration_factor(case: &Case, query: &Query, to: &str) -> Found {
    check_scene(case)?;
    let mut lone = Case::bare(&case.id);
    lone.scene.surfaces = case.scene.surfaces.clone();
    for surface in &mut lone.scene.surfaces {
        surface.reflectance = Bands::Grey(0.0);
        surface.exitance = Bands::Grey(if surface.id == to { 1.0 } else { 0.0 });
    }
    let built = build(&lone)?;
    let point = query.point("point").ok_or("the query has no point")?;
    let normal = query.point("normal").ok_or("the query has no normal")?;
    let light = built.ask(&[receiver(point, normal)], 2e-4, 1 << 16);
    Ok(Answer::one(light[0].band(None), "montecarlo"))
}

pub(super) fn answer(case: &Case) -> Vec<Found> {
    match build(case) {
        Ok(built) => case.queries.iter().map(|q| one(case, &built, q)).collect(),
        Err(missing) => case.queries.iter().map(|_| Err(missing.clone())).collect(),
    }
}

/// What is said of a scene and not understood may change its meaning.
fn check_scene(case: &Case) -> Result<(), String> {
    let known = ["closed", "units", "channels"];
    match case
        .scene
        .other
        .keys()
        .find(|k| !known.contains(&k.as_str()))
    {
        Some(key) => Err(format!("scenes with '{key}' are not computed yet")),
        None => Ok(()),
    }
}

fn build(case: &Case) -> Result<Built, String> {
    check_scene(case)?;
    let mut scene = Scene {
        name: case.id.clone(),
        groups: vec![Group { name: "all".into() }],
        up: Vec3::Z,
        ..Scene::default()
    };
    let mut triangles = Vec::new();
    let mut class = "montecarlo";
    for surface in &case.scene.surfaces {
        if surface.shape != "polygon" {
            class = "tessellated";
        }
        let list = tessellate(surface)?;
        add_surface(&mut scene, surface, &list);
        triangles.push(list);
    }
    for light in &case.scene.lights {
        add_light(&mut scene, light)?;
    }
    let elements = Some(if class == "tessellated" {
        FACET_ELEMENTS
    } else {
        ELEMENTS
    });
    let settings = Settings {
        // Means and receivers see hundreds of elements: a tenth of this is left.
        error: 0.01,
        elements,
        ..Settings::default()
    };
    let mut session = Session::new(scene, &settings).map_err(|e| e.to_string())?;
    session.by_ref().for_each(drop);
    let solution = session.solution();
    let centre = |s: &Surface| (s.shape == "sphere_zone").then(|| s.point("center").ok());
    let centres = case.scene.surfaces.iter().map(|s| centre(s).flatten());
    Ok(Built {
        session,
        solution,
        triangles,
        centres: centres.collect(),
        class,
    })
}

fn add_surface(scene: &mut Scene, surface: &Surface, triangles: &[Triangle]) {
    let reflectance = surface.reflectance.rgb().map(|v| v as f32);
    let exitance = surface.exitance.rgb().map(|v| v as f32);
    let shines = exitance.iter().any(|&m| m > 0.0);
    let luminance = Rgb::from(exitance) * (1.0 / LAMBERTIAN);
    let finish = FinishId::from(scene.finishes.len());
    scene.finishes.push(Finish {
        name: surface.id.clone(),
        reflectance: reflectance.into(),
        emission: shines.then_some(Emission {
            luminance,
            texture: None,
            group: GroupId(0),
        }),
        back_reflects: surface.two_sided,
        back_emits: surface.two_sided,
        ..Finish::default()
    });
    let id = SurfaceId::from(scene.surfaces.len());
    let first = scene.triangles.len() as u32;
    // One position for one place, so that neighbours share their edges.
    let mut known: std::collections::BTreeMap<[u32; 3], u32> = std::collections::BTreeMap::new();
    for (k, t) in triangles.iter().enumerate() {
        let corners = t.map(|p| {
            let p = p.map(|x| x as f32 + 0.0);
            *known.entry(p.map(f32::to_bits)).or_insert_with(|| {
                scene.positions.push(Vec3::from(p));
                scene.positions.len() as u32 - 1
            })
        });
        scene.triangles.push(corners);
        scene.surface_of.push(id);
        scene.source_triangle.push(k as u32);
    }
    scene.surfaces.push(luxel_core::Surface {
        name: surface.id.clone(),
        finish,
        triangles: first..scene.triangles.len() as u32,
        node: u32::MAX,
        mesh: 0,
        primitive: 0,
    });
}

fn add_light(scene: &mut Scene, light: &Value) -> Result<(), String> {
    let point = |key: &str| {
        light
            .get(key)
            .and_then(triple)
            .ok_or_else(|| format!("the light has no '{key}'"))
    };
    let number = |key: &str| {
        light
            .get(key)
            .and_then(Value::as_f64)
            .ok_or_else(|| format!("the light has no '{key}'"))
    };
    let place = |p: [f64; 3]| Vec3::from(p.map(|x| x as f32));
    let kind = light.get("type").and_then(Value::as_str).unwrap_or("none");
    match kind {
        "point_isotropic" | "point_lambertian" => {
            let intensity = Rgb::splat(number("intensity_cd")? as f32);
            let (kind, direction) = if kind == "point_isotropic" {
                (
                    LuminaireKind::Point {
                        intensity,
                        range_m: f32::INFINITY,
                    },
                    Vec3::NEG_Z,
                )
            } else {
                let axis = place(point("axis")?).normalize_or(Vec3::NEG_Z);
                (LuminaireKind::Lambertian { intensity }, axis)
            };
            let position = place(point("position")?);
            let name = "lamp".into();
            scene.luminaires.push(Luminaire {
                name,
                position,
                direction,
                kind,
                group: GroupId(0),
            });
            Ok(())
        }
        "line_lambertian" => {
            // A thin cylinder of exitance M has, per metre, the intensity M / pi times its
            // diameter square to its axis, and the cosine law along it.
            let per_metre = number("intensity_cd_per_m")?;
            let exitance = per_metre * LAMBERTIAN as f64 / (2.0 * PRISM_RADIUS_M);
            let surface = Surface {
                id: "line".into(),
                shape: "prism".into(),
                reflectance: Bands::Grey(0.0),
                exitance: Bands::Grey(exitance),
                two_sided: false,
                geometry: Default::default(),
            };
            add_surface(scene, &surface, &prism(point("p0")?, point("p1")?));
            Ok(())
        }
        "point_table" => Err("photometric tables are not read yet".into()),
        other => Err(format!("lights of type '{other}' are not computed yet")),
    }
}

/// A prism whose mean projected width is that of the cylinder that it stands for.
fn prism(p0: [f64; 3], p1: [f64; 3]) -> Vec<Triangle> {
    let axis = sub(p1, p0);
    let n = unit(axis);
    let side = unit(cross(
        n,
        if n[0].abs() < 0.9 {
            [1.0, 0.0, 0.0]
        } else {
            [0.0, 1.0, 0.0]
        },
    ));
    let other = cross(n, side);
    // Mean width of a convex outline is its perimeter / pi; the cylinder's is its diameter.
    let half = std::f64::consts::PI / PRISM as f64;
    let radius = PRISM_RADIUS_M * half / half.sin();
    let ring = |base: [f64; 3], k: usize| -> [f64; 3] {
        let (s, c) = (TAU * (k % PRISM) as f64 / PRISM as f64).sin_cos();
        std::array::from_fn(|i| base[i] + radius * (c * side[i] + s * other[i]))
    };
    (0..PRISM)
        .flat_map(|k| {
            let [a, b, c, d] = [ring(p0, k), ring(p0, k + 1), ring(p1, k + 1), ring(p1, k)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

fn tessellate(surface: &Surface) -> Result<Vec<Triangle>, String> {
    match surface.shape.as_str() {
        "polygon" => {
            let v = surface.vertices()?;
            Ok((1..v.len().saturating_sub(1))
                .map(|i| [v[0], v[i], v[i + 1]])
                .collect())
        }
        "disc" => {
            let (centre, n) = (surface.point("center")?, unit(surface.point("normal")?));
            let radius = surface.number("radius")?;
            // A regular polygon of the disc's own area, with the frame that zones use, so that
            // a bowl and its lid meet.
            let (x, y) = if n[2].abs() > 0.999 {
                ([1.0, 0.0, 0.0], [0.0, n[2].signum(), 0.0])
            } else {
                let x = unit(cross(n, [0.0, 0.0, 1.0]));
                (x, cross(n, x))
            };
            let at = |k: usize| -> [f64; 3] {
                let (s, c) = (TAU * (k % AROUND) as f64 / AROUND as f64).sin_cos();
                std::array::from_fn(|i| centre[i] + radius * (c * x[i] + s * y[i]))
            };
            Ok((0..AROUND).map(|k| [centre, at(k), at(k + 1)]).collect())
        }
        "sphere_zone" => {
            let centre = surface.point("center")?;
            let radius = surface.number("radius")?;
            let (low, high) = (surface.number("z_min")?, surface.number("z_max")?);
            let inward = surface.geometry.get("side").and_then(Value::as_str) == Some("in");
            let angle = |z: f64| ((z - centre[2]) / radius).clamp(-1.0, 1.0).acos();
            let (top, bottom) = (angle(high), angle(low));
            let rings = (((bottom - top) / TAU * AROUND as f64).ceil() as usize).max(2);
            let at = |j: usize, k: usize| -> [f64; 3] {
                let theta = top + (bottom - top) * j as f64 / rings as f64;
                let (s, c) = (TAU * (k % AROUND) as f64 / AROUND as f64).sin_cos();
                let r = radius * theta.sin();
                [
                    centre[0] + r * c,
                    centre[1] + r * s,
                    centre[2] + radius * theta.cos(),
                ]
            };
            let mut list = Vec::new();
            for j in 0..rings {
                for k in 0..AROUND {
                    // Counter-clockwise from outside: down, then around.
                    let [a, b, c, d] = [at(j, k), at(j + 1, k), at(j + 1, k + 1), at(j, k + 1)];
                    for t in [[a, b, c], [a, c, d]] {
                        if area(&t) > 1e-12 * radius * radius {
                            list.push(if inward { [t[0], t[2], t[1]] } else { t });
                        }
                    }
                }
            }
            Ok(list)
        }
        other => Err(format!(
            "surfaces of shape '{other}' are not tessellated yet"
        )),
    }
}

fn one(case: &Case, built: &Built, query: &Query) -> Found {
    let channel = query
        .number("channel")
        .map(|c| c as usize)
        .filter(|c| *c < 3);
    let found = |value: f64| Ok(Answer::one(value, built.class));
    let surface = || -> Result<usize, String> {
        let name = query.text("surface").ok_or("the query names no surface")?;
        let index = case.scene.surfaces.iter().position(|s| s.id == name);
        index.ok_or_else(|| format!("the case has no surface '{name}'"))
    };
    let exitance = |index: usize, irradiance: f64| {
        let s = &case.scene.surfaces[index];
        let band = channel.unwrap_or(1);
        s.exitance.rgb()[band] + s.reflectance.rgb()[band] * irradiance
    };
    match query.quantity.as_str() {
        "illuminance" | "irradiance" => {
            let point = query.point("point").ok_or("the query has no point")?;
            let normal = query.point("normal").ok_or("the query has no normal")?;
            let receiver = receiver(point, normal);
            // One receiver may cost what a whole surface does.
            found(built.ask(&[receiver], 5e-4, 1 << 18)[0].band(channel))
        }
        "mean_irradiance" => found(built.mean(surface()?, channel)),
        "radiosity" | "mean_radiosity" => {
            let index = surface()?;
            found(exitance(index, built.mean(index, channel)))
        }
        quantity @ ("radiosity_everywhere" | "irradiance_everywhere") => {
            let expected = query
                .expected
                .as_f64()
                .ok_or("the query expects no number")?;
            let mut worst = expected;
            for index in 0..case.scene.surfaces.len() {
                let receivers = built.spread(index, EVERYWHERE_RECEIVERS);
                for e in built.ask(&receivers, 1e-3, 1 << 14) {
                    let e = e.band(channel);
                    let value = if quantity == "radiosity_everywhere" {
                        exitance(index, e)
                    } else {
                        e
                    };
                    if (value - expected).abs() > (worst - expected).abs() {
                        worst = value;
                    }
                }
            }
            found(worst)
        }
        "shadow_boundary_x" => shadow_boundary(case, built, query),
        other => Err(format!("quantity '{other}' is not computed yet")),
    }
}

/// Irradiance at one receiver, all bands.
struct Light(Rgb);

impl Light {
    fn band(&self, channel: Option<usize>) -> f64 {
        match channel {
            Some(c) => self.0.to_array()[c] as f64,
            None => self.0.luminance() as f64,
        }
    }
}

impl Built {
    fn ask(&self, receivers: &[Receiver], relative: f32, rays: u32) -> Vec<Light> {
        let accuracy = Accuracy {
            relative,
            floor_lux: 0.0,
            rays: [64, rays],
            seed: 1,
        };
        let answer = self
            .session
            .irradiance_at(&self.solution, receivers, &accuracy);
        answer
            .values
            .chunks_exact(answer.columns)
            .map(|row| Light(luxel_core::layers::total(row)))
            .collect()
    }

    fn mean(&self, surface: usize, channel: Option<usize>) -> f64 {
        // 2,048 receivers of 2 % each make a mean of well below 0.1 %.
        let light = self.ask(&self.spread(surface, MEAN_RECEIVERS), 0.02, 1 << 12);
        light.iter().map(|e| e.band(channel)).sum::<f64>() / light.len().max(1) as f64
    }

    /// Receivers spread evenly over a surface of the case.
    fn spread(&self, surface: usize, count: u32) -> Vec<Receiver> {
        let triangles = &self.triangles[surface];
        let mut running = Vec::with_capacity(triangles.len());
        let mut sum = 0.0;
        for t in triangles {
            sum += area(t);
            running.push(sum);
        }
        let sequence = Sequence::new(7, surface as u32);
        (0..count)
            .map(|k| {
                let [u, v, w, _] = sequence.point4(k).map(f64::from);
                let t = &triangles[running
                    .partition_point(|r| *r <= w * sum)
                    .min(triangles.len() - 1)];
                let (a, b) = if v > u {
                    (0.5 * u, v - 0.5 * u)
                } else {
                    (u - 0.5 * v, 0.5 * v)
                };
                let p = std::array::from_fn(|i| {
                    t[0][i] + a * (t[1][i] - t[0][i]) + b * (t[2][i] - t[0][i])
                });
                let facet = cross(sub(t[1], t[0]), sub(t[2], t[0]));
                let normal = self.centres[surface].map_or(facet, |centre| {
                    let out = sub(p, centre);
                    let turned = (0..3).map(|i| out[i] * facet[i]).sum::<f64>() < 0.0;
                    out.map(|x| if turned { -x } else { x })
                });
                receiver(p, normal)
            })
            .collect()
    }
}

/// Where along x, on the plane and row of the case's other points, the light begins to be cut
/// off (`penumbra...`) or is gone (`umbra...`): bisection on what a receiver sees.
fn shadow_boundary(case: &Case, built: &Built, query: &Query) -> Found {
    let expected = query
        .expected
        .as_f64()
        .ok_or("the query expects no number")?;
    let row = case
        .queries
        .iter()
        .find_map(|q| q.point("point"))
        .ok_or("the case has no point")?;
    let mut free = Case::bare(&case.id);
    free.scene.surfaces = case
        .scene
        .surfaces
        .iter()
        .filter(|s| s.exitance.rgb()[0] > 0.0)
        .cloned()
        .collect();
    let free = build(&free)?;
    let share = |x: f64| -> f64 {
        let at = [receiver([x, row[1], row[2]], [0.0, 0.0, 1.0])];
        let seen = |b: &Built| b.ask(&at, 1e-4, 1 << 14)[0].band(None);
        seen(built) / seen(&free).max(f64::MIN_POSITIVE)
    };
    let umbra = query.id.starts_with("umbra");
    let cut = |x: f64| {
        if umbra {
            share(x) <= 1e-6
        } else {
            share(x) < 1.0 - 1e-4
        }
    };
    // A boundary is where the answer changes within half a metre of where it should be.
    let (mut a, mut b) = (expected - 0.45, expected + 0.45);
    let (at_a, at_b) = (cut(a), cut(b));
    if at_a == at_b {
        return Ok(Answer::one(f64::NAN, built.class));
    }
    for _ in 0..16 {
        let middle = 0.5 * (a + b);
        if cut(middle) == at_a {
            a = middle
        } else {
            b = middle
        }
    }
    Ok(Answer::one(0.5 * (a + b), built.class))
}

fn receiver(point: [f64; 3], normal: [f64; 3]) -> Receiver {
    Receiver {
        position: Vec3::from(point.map(|x| x as f32)),
        normal: Vec3::from(unit(normal).map(|x| x as f32)),
    }
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 0.0 {
        v.map(|x| x / length)
    } else {
        v
    }
}

fn area(t: &Triangle) -> f64 {
    let n = cross(sub(t[1], t[0]), sub(t[2], t[0]));
    0.5 * n.iter().map(|x| x * x).sum::<f64>().sqrt()
}
