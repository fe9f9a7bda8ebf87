//! Cases that ask for a form factor or a configuration factor: the kernel or closed form of
//! `transport` that fits the pair of shapes.

use super::case::{Case, Query, Surface};
use super::{Answer, Found};
use luxel_core::{DVec3, Polygon};
use luxel_transport::closed_forms as closed;
use luxel_transport::lambert::{point_to_disc, point_to_polygon, point_to_sphere};
use luxel_transport::obstructed::factor_past;
use luxel_transport::polygon_pair::polygon_to_polygon;
use luxel_transport::strings::{self, Strip};

/// Asked relative error of an obstructed factor.
const OBSTRUCTED_ERROR: f64 = 2e-5;

pub(super) fn answer(case: &Case) -> Vec<Found> {
    case.queries.iter().map(|query| one(case, query)).collect()
}

fn one(case: &Case, query: &Query) -> Found {
    let to = case
        .scene
        .surface(query.text("to").ok_or("the query names no surface 'to'")?)?;
    let value = match query.quantity.as_str() {
        "configuration_factor" if case.scene.surfaces.len() > 1 => {
            return super::rooms::configuration_factor(case, query, &to.id);
        }
        "configuration_factor" => {
            let point = query.point("point").ok_or("the query has no point")?.into();
            let normal = query
                .point("normal")
                .ok_or("the query has no normal")?
                .into();
            configuration_factor(point, normal, to)?
        }
        "form_factor" => {
            let from = query
                .text("from")
                .ok_or("the query names no surface 'from'")?;
            form_factor(case, case.scene.surface(from)?, to)?
        }
        other => return Err(format!("quantity '{other}' is not computed yet")),
    };
    Ok(Answer::one(value, "analytic"))
}

pub(super) fn polygon(surface: &Surface) -> Result<Polygon, String> {
    Ok(Polygon::new(
        surface.vertices()?.into_iter().map(DVec3::from).collect(),
    ))
}

fn configuration_factor(point: DVec3, normal: DVec3, to: &Surface) -> Result<f64, String> {
    match to.shape.as_str() {
        "polygon" => Ok(point_to_polygon(point, normal, &polygon(to)?)),
        "disc" => {
            let (centre, facing) = (to.point("center")?.into(), to.point("normal")?.into());
            Ok(point_to_disc(
                point,
                normal,
                centre,
                facing,
                to.number("radius")?,
            ))
        }
        "sphere" => Ok(point_to_sphere(
            point,
            normal,
            to.point("center")?.into(),
            to.number("radius")?,
        )),
        other => Err(format!(
            "the factor from a point to a '{other}' is not computed yet"
        )),
    }
}

fn form_factor(case: &Case, from: &Surface, to: &Surface) -> Result<f64, String> {
    match (from.shape.as_str(), to.shape.as_str()) {
        ("polygon", "polygon") => {
            let (a, b) = (polygon(from)?, polygon(to)?);
            let between: Vec<&Surface> = case
                .scene
                .surfaces
                .iter()
                .filter(|s| s.id != from.id && s.id != to.id)
                .collect();
            if between.iter().any(|s| s.shape != "polygon") {
                return Err("curved surfaces between polygons are not computed yet".into());
            }
            let occluders: Vec<Polygon> = between
                .into_iter()
                .map(polygon)
                .collect::<Result<_, String>>()?;
            if occluders.is_empty() || from.id == to.id {
                Ok(polygon_to_polygon(&a, &b))
            } else {
                Ok(factor_past(&a, &b, &occluders, OBSTRUCTED_ERROR).factor)
            }
        }
        ("disc", "disc") => {
            let (p, n) = (
                DVec3::from(from.point("center")?),
                DVec3::from(from.point("normal")?).normalize(),
            );
            let (q, m) = (
                DVec3::from(to.point("center")?),
                DVec3::from(to.point("normal")?).normalize(),
            );
            let between = q - p;
            let coaxial =
                between.cross(n).length() < 1e-9 * between.length() && n.dot(m) < -1.0 + 1e-9;
            if !coaxial || between.dot(n) <= 0.0 {
                return Err("discs that are not coaxial and facing are not computed yet".into());
            }
            Ok(closed::coaxial_discs(
                from.number("radius")?,
                to.number("radius")?,
                between.length(),
            ))
        }
        ("disc", "cylinder") | ("cylinder", "disc") => {
            let (cylinder, disc) = if from.shape == "cylinder" {
                (from, to)
            } else {
                (to, from)
            };
            let radius = cylinder.number("radius")?;
            let length = DVec3::from(cylinder.point("axis")?).length();
            if disc.number("radius")? != radius || !is_inside(cylinder) {
                return Err("a disc that does not close the cylinder is not computed yet".into());
            }
            Ok(if from.shape == "disc" {
                closed::cylinder_end_to_side(radius, length)
            } else {
                closed::cylinder_side_to_end(radius, length)
            })
        }
        ("cylinder", "cylinder") => {
            let length = DVec3::from(from.point("axis")?).length();
            let (a, b) = (from.number("radius")?, to.number("radius")?);
            let inner = case
                .scene
                .surfaces
                .iter()
                .find(|s| s.shape == "cylinder" && !is_inside(s));
            match (is_inside(from), is_inside(to), inner) {
                (true, true, None) => Ok(closed::cylinder_side_to_side(a, length)),
                (true, true, Some(i)) => Ok(closed::outer_to_outer_cylinder(
                    i.number("radius")?,
                    a,
                    length,
                )),
                (true, false, _) => Ok(closed::outer_to_inner_cylinder(b, a, length)),
                (false, true, _) => Ok(closed::inner_to_outer_cylinder(a, b, length)),
                (false, false, _) => Err("cylinders side by side are not computed yet".into()),
            }
        }
        ("sphere", "disc") => {
            let (p, q) = (
                DVec3::from(from.point("center")?),
                DVec3::from(to.point("center")?),
            );
            let n = DVec3::from(to.point("normal")?).normalize();
            if (q - p).cross(n).length() > 1e-9 * (q - p).length() {
                return Err("a disc off the sphere's axis is not computed yet".into());
            }
            Ok(closed::sphere_to_disc(
                to.number("radius")?,
                (q - p).length(),
            ))
        }
        ("sphere", "polygon") => Ok(closed::sphere_to_polygon(
            from.point("center")?.into(),
            &polygon(to)?,
        )),
        ("infinite_strip", "infinite_strip") => {
            Ok(strings::strip_to_strip(&strip(from)?, &strip(to)?))
        }
        ("infinite_strip", "infinite_cylinder") => {
            let centre = to.pair("center")?.into();
            Ok(strings::strip_to_cylinder(
                &strip(from)?,
                centre,
                to.number("radius")?,
            ))
        }
        ("infinite_cylinder", "infinite_cylinder") => {
            let [a, b] = [from.pair("center")?, to.pair("center")?];
            let apart = (a[0] - b[0]).hypot(a[1] - b[1]);
            Ok(strings::cylinder_to_cylinder(
                from.number("radius")?,
                to.number("radius")?,
                apart,
            ))
        }
        (a, b) => Err(format!(
            "the factor from a '{a}' to a '{b}' is not computed yet"
        )),
    }
}

pub(super) fn strip(surface: &Surface) -> Result<Strip, String> {
    Ok(Strip::new(
        surface.pair("p0")?.into(),
        surface.pair("p1")?.into(),
    ))
}

fn is_inside(surface: &Surface) -> bool {
    surface
        .geometry
        .get("side")
        .and_then(serde_json::Value::as_str)
        == Some("in")
}
