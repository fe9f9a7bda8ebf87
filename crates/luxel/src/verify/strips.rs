//! Cases in the plane: infinitely long strips, continuous along their width.
//!
//! Each strip is cut into elements, finer towards its ends where two strips may touch, with
//! crossed-strings factors between all pairs [Hottel54]; the exitance at a point is one more
//! gather with the point's exact factors.

use super::case::{Case, Query};
use super::factors::strip;
use super::solvers::System;
use super::{Answer, Found};
use glam::DVec2;
use luxel_transport::strings::{Strip, strip_factors};

/// Elements a strip: constant elements err by the square of their size, so two solutions, one
/// twice as fine, extrapolate to a far better one [Richardson11].
const ELEMENTS: [usize; 2] = [150, 300];

/// Share of the light leaving a point of a strip (with its unit normal) that reaches `b`: half
/// the difference of the sines from the normal.
fn point_factor(p: DVec2, along: DVec2, b: &Strip) -> f64 {
    let sine = |q: DVec2| (q - p).normalize_or_zero().dot(along);
    (0.5 * (sine(b.to) - sine(b.from)).abs()).min(1.0)
}

/// The point at share `t` of a strip's width.
fn at(strip: &Strip, t: f64) -> DVec2 {
    strip.from + (strip.to - strip.from) * t
}

/// Whether a point lies in front of a strip.
fn faces(strip: &Strip, p: DVec2) -> bool {
    (strip.to - strip.from).perp_dot(p - strip.from) > 1e-12 * strip.width()
}

/// A solved case.
struct Solved {
    strips: Vec<Strip>,
    elements: Vec<Strip>,
    /// Index of each element's strip.
    owner: Vec<usize>,
    exitance: Vec<f64>,
}

pub(super) fn answer(case: &Case) -> Vec<Found> {
    let solved = ELEMENTS.map(|elements| solve(case, elements));
    case.queries
        .iter()
        .map(|query| extrapolated(case, &solved, query))
        .collect()
}

fn extrapolated(case: &Case, solved: &[Result<Solved, String>; 2], query: &Query) -> Found {
    let at = |k: usize| one(case, solved[k].as_ref().map_err(String::clone)?, query);
    let (coarse, fine): (f64, f64) = (at(0)?, at(1)?);
    Ok(Answer::one((4.0 * fine - coarse) / 3.0, "analytic"))
}

fn solve(case: &Case, count: usize) -> Result<Solved, String> {
    let mut strips = Vec::new();
    let (mut elements, mut owner) = (Vec::new(), Vec::new());
    let (mut rho, mut emission) = (Vec::new(), Vec::new());
    for (index, surface) in case.scene.surfaces.iter().enumerate() {
        let strip = strip(surface)?;
        // Fine at both ends: t = (1 - cos) / 2 crowds the cuts there as light does in a corner.
        let cut = |k: usize| 0.5 - 0.5 * (std::f64::consts::PI * k as f64 / count as f64).cos();
        for k in 0..count {
            elements.push(Strip::new(at(&strip, cut(k)), at(&strip, cut(k + 1))));
            owner.push(index);
            rho.push(surface.reflectance.rgb()[0]);
            emission.push(surface.exitance.rgb()[0]);
        }
        strips.push(strip);
    }
    let lengths: Vec<f64> = elements.iter().map(Strip::width).collect();
    let factors = strip_factors(&elements);
    let exitance = System::new(&factors, &lengths, &rho, &emission).relaxed();
    Ok(Solved {
        strips,
        elements,
        owner,
        exitance,
    })
}

fn one(case: &Case, solved: &Solved, query: &Query) -> Result<f64, String> {
    let name = query.text("surface").ok_or("the query names no surface")?;
    let index = case.scene.surfaces.iter().position(|s| s.id == name);
    let index = index.ok_or_else(|| format!("the case has no surface '{name}'"))?;
    let strip = &solved.strips[index];
    match query.quantity.as_str() {
        "mean_radiosity" => {
            let own = (0..solved.elements.len()).filter(|&e| solved.owner[e] == index);
            let flux: f64 = own
                .map(|e| solved.elements[e].width() * solved.exitance[e])
                .sum();
            Ok(flux / strip.width())
        }
        "radiosity_at" => {
            let t = match (query.number("x"), query.number("distance_from_apex")) {
                (Some(x), _) => (x - strip.from.x) / (strip.to.x - strip.from.x),
                // The apex is the end that other strips share.
                (None, Some(d)) => {
                    let shared = solved.strips.iter().enumerate().any(|(k, s)| {
                        k != index
                            && (s.from.distance(strip.from) < 1e-9
                                || s.to.distance(strip.from) < 1e-9)
                    });
                    let t = d / strip.width();
                    if shared { t } else { 1.0 - t }
                }
                (None, None) => return Err("the query gives no place on the strip".into()),
            };
            let surface = &case.scene.surfaces[index];
            let along = (strip.to - strip.from) / strip.width();
            let p = at(strip, t);
            let irradiance: f64 = (0..solved.elements.len())
                .filter(|&e| {
                    let element = &solved.elements[e];
                    solved.owner[e] != index && faces(strip, at(element, 0.5)) && faces(element, p)
                })
                .map(|e| point_factor(p, along, &solved.elements[e]) * solved.exitance[e])
                .sum();
            let value = surface.exitance.rgb()[0] + surface.reflectance.rgb()[0] * irradiance;
            Ok(value)
        }
        other => Err(format!(
            "quantity '{other}' is not computed in the plane yet"
        )),
    }
}
