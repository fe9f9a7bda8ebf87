//! Cameras and punctual lights of a scene that came from no glTF file.
//!
//! Source: [GLTF20], KHR_lights_punctual.

use super::base::{Base, matrix};
use luxel_core::{LuminaireKind, Rgb, Scene, Vec3};
use serde_json::json;

/// Adds them to the root of the file.
pub(super) fn add_views_and_luminaires(base: &mut Base, scene: &Scene) {
    for view in &scene.views {
        let angle = view.vertical_angle.clamp(0.01, 3.1);
        let perspective = json!({ "yfov": angle, "znear": 0.01 });
        let camera =
            json!({ "name": view.name, "type": "perspective", "perspective": perspective });
        let camera = base.push("cameras", camera);
        let placed = matrix(view.eye, view.forward, view.up);
        let node = json!({ "name": view.name, "camera": camera, "matrix": placed });
        let node = base.push("nodes", node);
        base.add_root(node);
    }
    for l in &scene.luminaires {
        let (kind, strength) = match l.kind {
            LuminaireKind::Point { intensity, .. } => ("point", intensity),
            LuminaireKind::Spot { intensity, .. } => ("spot", intensity),
            LuminaireKind::Directional { illuminance } => ("directional", illuminance),
            // The format has no cosine; a half space is the nearest it can say.
            LuminaireKind::Lambertian { intensity } => ("spot", intensity),
        };
        let most = strength.max_band();
        let colour = if most > 0.0 {
            strength * (1.0 / most)
        } else {
            Rgb::WHITE
        };
        let mut light = json!({
            "name": l.name, "type": kind, "intensity": most.max(0.0), "color": colour.to_array(),
        });
        match l.kind {
            LuminaireKind::Point { range_m, .. } | LuminaireKind::Spot { range_m, .. }
                if range_m.is_finite() && range_m > 0.0 =>
            {
                light["range"] = json!(range_m);
            }
            _ => {}
        }
        let quarter = std::f32::consts::FRAC_PI_2;
        match l.kind {
            LuminaireKind::Spot {
                cos_inner,
                cos_outer,
                ..
            } => {
                let outer = cos_outer.clamp(0.0, 1.0).acos().clamp(1e-3, quarter);
                let inner = cos_inner.clamp(0.0, 1.0).acos().min(outer * 0.999);
                light["spot"] = json!({ "innerConeAngle": inner, "outerConeAngle": outer });
            }
            LuminaireKind::Lambertian { .. } => {
                light["spot"] = json!({ "innerConeAngle": 0.0, "outerConeAngle": quarter });
            }
            _ => {}
        }
        let index = base.push_light(light);
        let aim = l.direction.normalize_or(-Vec3::Y);
        let node = base.push(
            "nodes",
            json!({
                "name": l.name,
                "matrix": matrix(l.position, aim, scene.up),
                "extensions": { "KHR_lights_punctual": { "light": index } },
            }),
        );
        base.add_root(node);
    }
}
