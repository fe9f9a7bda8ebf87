//! Luminaires without size (KHR_lights_punctual) and cameras as views.

use crate::assemble::Assembly;
use crate::error::{Error, Within};
use crate::json::{Json, entry};
use crate::options::MOST_LIGHT;
use luxel_core::glam::{DMat4, DVec3};
use luxel_core::{GroupId, Luminaire, LuminaireKind, Rgb, Vec3, View};
use serde_json::Value;

/// An axis of a node as a unit vector: lights and cameras have no scale.
fn axis(world: DMat4, column: usize) -> Option<Vec3> {
    let v: DVec3 = world.col(column).truncate();
    v.try_normalize()
        .map(|v| v.as_vec3())
        .filter(|v| v.is_finite())
}

/// Where a node is, if that is anywhere.
fn place_of(world: DMat4) -> Option<Vec3> {
    Some(world.w_axis.truncate().as_vec3()).filter(|p| p.is_finite())
}

/// Adds the light of a node, if it has one.
pub(crate) fn luminaire(
    json: &Value,
    node: &Value,
    index: usize,
    world: DMat4,
    scale: f64,
    assembly: &mut Assembly<'_>,
) -> Result<(), Error> {
    const NAME: &str = "KHR_lights_punctual";
    let Some(reference) = node.extension(NAME)? else {
        return Ok(());
    };
    let Some(light) = reference.whole("light").within(|| NAME)? else {
        return Err(Error::new("light", "none").within(NAME));
    };
    let lights = json.extension(NAME)?;
    let lights = lights.ok_or_else(|| Error::new(format!("extensions.{NAME}"), "none"))?;
    let value = entry(lights, "lights", light).within(|| NAME)?;
    let within = || format!("light {light}");
    let colour = value
        .numbers::<3>("color")
        .within(within)?
        .unwrap_or([1.0; 3]);
    let strength = value.number("intensity").within(within)?.unwrap_or(1.0);
    let amount = colour.map(|c| (c * strength).clamp(0.0, MOST_LIGHT as f64) as f32);
    if amount != colour.map(|c| (c * strength) as f32) {
        let what = format!("intensity outside 0 to {MOST_LIGHT:e} was clamped");
        assembly.warn(&within(), what, 1);
    }
    let intensity = Rgb::from(amount);
    let range = value
        .number("range")
        .within(within)?
        .unwrap_or(f64::INFINITY);
    let range_m = (range * scale) as f32;
    if range_m <= 0.0 {
        return Err(Error::new("a range above 0", range.to_string())
            .within("range")
            .within(within()));
    }
    let kind = match value.text("type").within(within)? {
        Some("point") => LuminaireKind::Point { intensity, range_m },
        Some("directional") => LuminaireKind::Directional {
            illuminance: intensity,
        },
        Some("spot") => {
            let spot = value.object("spot").within(within)?.unwrap_or(&Value::Null);
            let inner = spot.number("innerConeAngle").within(within)?.unwrap_or(0.0);
            let outer = spot
                .number("outerConeAngle")
                .within(within)?
                .unwrap_or(std::f64::consts::FRAC_PI_4);
            if !(0.0 <= inner && inner <= outer && outer <= std::f64::consts::PI) {
                let found = format!("{inner} and {outer}");
                let expected = "cone angles 0 <= inner <= outer <= pi";
                return Err(Error::new(expected, found).within("spot").within(within()));
            }
            LuminaireKind::Spot {
                intensity,
                range_m,
                cos_inner: inner.cos() as f32,
                cos_outer: outer.cos() as f32,
            }
        }
        Some(other) => {
            let e = Error::new("point, spot or directional", format!("'{other}'"));
            return Err(e.within("type").within(within()));
        }
        None => return Err(Error::new("type", "none").within(within())),
    };
    let name = node
        .name()
        .or(value.name())
        .unwrap_or_else(|| format!("light {light}"));
    if intensity.max_band() <= 0.0 {
        assembly.warn(
            &format!("node {index}"),
            format!("light '{name}' is off and left out"),
            1,
        );
        return Ok(());
    }
    let (Some(position), Some(back)) = (place_of(world), axis(world, 2)) else {
        let what = format!("light '{name}' has no finite place or no direction and is left out");
        assembly.warn(&format!("node {index}"), what, 1);
        return Ok(());
    };
    assembly.add_luminaire(Luminaire {
        name,
        position,
        direction: -back,
        kind,
        group: GroupId::NONE,
    });
    Ok(())
}

/// Adds a camera of a node as a view.
pub(crate) fn camera(
    json: &Value,
    camera: usize,
    node: &Value,
    index: usize,
    world: DMat4,
    assembly: &mut Assembly<'_>,
) -> Result<(), Error> {
    let value = entry(json, "cameras", camera)?;
    let within = || format!("camera {camera}");
    if value.text("type").within(within)? != Some("perspective") {
        assembly.warn(&within(), "not a perspective camera: left out", 1);
        return Ok(());
    }
    let lens = value.object("perspective").within(within)?;
    let lens = lens.ok_or_else(|| Error::new("perspective", "none").within(within()))?;
    let angle = lens.number("yfov").within(within)?;
    let angle = angle.ok_or_else(|| Error::new("yfov", "none").within(within()))?;
    let sensible = angle > 0.0 && angle < std::f64::consts::PI;
    let name = node
        .name()
        .or(value.name())
        .unwrap_or_else(|| format!("camera {camera}"));
    let (Some(eye), Some(back), Some(up), true) =
        (place_of(world), axis(world, 2), axis(world, 1), sensible)
    else {
        let what = format!("camera '{name}' has no sensible place or angle and is left out");
        assembly.warn(&format!("node {index}"), what, 1);
        return Ok(());
    };
    assembly.add_view(View {
        name,
        eye,
        forward: -back,
        up,
        vertical_angle: angle as f32,
    });
    Ok(())
}
