//! What a scene holds: sizes, finishes, lights, warnings, and whether it is closed.

use crate::error::Error;
use crate::session::read;
use crate::settings::Settings;
use luxel_core::quantity::{LAMBERTIAN, SPHERE_SR};
use luxel_core::{LuminaireKind, Scene, Vec3, Warning, Warnings};
use luxel_transport::sampling::Sequence;
use luxel_transport::{Bvh, Hit, Ray, RayCaster};
use serde::Serialize;
use std::path::Path;
use std::sync::Arc;

/// What was read.
#[derive(Clone, Debug, Serialize)]
pub struct Inspection {
    /// Scene name.
    pub scene: String,
    /// Triangles after repairs.
    pub triangles: usize,
    /// Surfaces: primitives of instances.
    pub surfaces: usize,
    /// Finishes.
    pub finishes: usize,
    /// Textures that were decoded.
    pub textures: usize,
    /// Size of the bounds along x, y and z, metres.
    pub size_m: [f32; 3],
    /// Area of all triangles, one side, m².
    pub area_m2: f64,
    /// Area-weighted mean reflectance (photometric).
    pub mean_reflectance: f64,
    /// Share of rays from points inside that meet a surface, 0..=1; `None` when no point inside was found.
    pub closed: Option<f64>,
    /// Lights: one for each luminaire, emitting finish and sky.
    pub lights: Vec<Light>,
    /// Named views.
    pub views: Vec<String>,
    /// What was odd, and what was done about it.
    pub warnings: Vec<String>,
}

/// A source of light.
#[derive(Clone, Debug, Serialize)]
pub struct Light {
    /// Name.
    pub name: String,
    /// What it is.
    pub kind: String,
    /// Its group.
    pub group: String,
    /// Flux, lm; `None` where it has none of its own (sky, directional).
    pub flux_lm: Option<f64>,
    /// Where, in words.
    pub place: String,
}

/// Reads a scene and looks it over.
pub fn inspect(path: &Path, settings: &Settings) -> Result<Inspection, Error> {
    let document = read(path, settings)?;
    Ok(look(document.scene, &document.warnings))
}

fn look(scene: Scene, warnings: &Warnings) -> Inspection {
    let scene = Arc::new(scene);
    let (low, high) = scene.bounds();
    let (mut area, mut reflected) = (0.0f64, 0.0f64);
    for t in 0..scene.triangles.len() {
        let a = scene.area(t) as f64;
        area += a;
        reflected += a * scene.reflectance_at(t, 1.0 / 3.0, 1.0 / 3.0).luminance() as f64;
    }
    Inspection {
        scene: scene.name.clone(),
        triangles: scene.triangles.len(),
        surfaces: scene.surfaces.len(),
        finishes: scene.finishes.len(),
        textures: scene.textures.len(),
        size_m: (high - low).to_array(),
        area_m2: area,
        mean_reflectance: if area > 0.0 { reflected / area } else { 0.0 },
        closed: closedness(&scene),
        lights: lights(&scene),
        views: scene.views.iter().map(|v| v.name.clone()).collect(),
        warnings: warnings.iter().map(Warning::to_string).collect(),
    }
}

impl std::fmt::Display for Inspection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.size_m;
        writeln!(f, "{}", self.scene)?;
        writeln!(
            f,
            "  triangles    {} in {} surfaces",
            self.triangles, self.surfaces
        )?;
        writeln!(
            f,
            "  size         {x:.2} x {y:.2} x {z:.2} m, {:.1} m2 of surface",
            self.area_m2
        )?;
        writeln!(
            f,
            "  finishes     {}, {} textures, mean reflectance {:.2}",
            self.finishes, self.textures, self.mean_reflectance
        )?;
        match self.closed {
            Some(share) => writeln!(
                f,
                "  closed       {:.1} % of the rays from inside meet a surface",
                100.0 * share
            )?,
            None => writeln!(f, "  closed       no: no point was found that is inside")?,
        }
        if !self.views.is_empty() {
            writeln!(f, "  views        {}", self.views.join(", "))?;
        }
        writeln!(
            f,
            "  lights       {}",
            if self.lights.is_empty() {
                "none: add one with --lamp, --emit or --sky"
            } else {
                ""
            }
        )?;
        for l in &self.lights {
            let flux = l
                .flux_lm
                .map_or(String::new(), |lm| format!(", {lm:.0} lm"));
            writeln!(
                f,
                "    {}: {}{flux}, {} (group {})",
                l.name, l.kind, l.place, l.group
            )?;
        }
        if !self.warnings.is_empty() {
            writeln!(f, "  warnings")?;
            for w in &self.warnings {
                writeln!(f, "    {w}")?;
            }
        }
        Ok(())
    }
}

/// Share of rays from points inside that meet a surface.
///
/// A point counts as inside when it has something above and below it and in at least three of
/// the four directions around. Points are tried on a low-discrepancy sequence over the bounds.
fn closedness(scene: &Arc<Scene>) -> Option<f64> {
    const TRIED: u32 = 512;
    const INSIDE: usize = 32;
    const RAYS: u32 = 128;
    let caster = Bvh::build(scene);
    let (low, high) = scene.bounds();
    let up = scene.up;
    let side = up.any_orthonormal_vector();
    let ring = [side, -side, up.cross(side), -up.cross(side)];
    let points = Sequence::new(0, 0);
    let cast = |rays: &[Ray]| -> usize {
        let mut hits = vec![Hit::MISS; rays.len()];
        caster.closest(rays, &mut hits);
        hits.iter().filter(|h| h.is_hit()).count()
    };
    let ray = |origin: Vec3, direction: Vec3| Ray {
        origin,
        t_min: 0.0,
        direction,
        t_max: f32::INFINITY,
    };
    let mut inside = Vec::new();
    for k in 0..TRIED {
        let u = points.point4(k);
        let p = low + (high - low) * Vec3::new(u[0], u[1], u[2]);
        let vertical = cast(&[ray(p, up), ray(p, -up)]);
        let around = cast(&ring.map(|d| ray(p, d)));
        if vertical == 2 && around >= 3 {
            inside.push(p);
            if inside.len() == INSIDE {
                break;
            }
        }
    }
    let mut hits = 0;
    for (k, &p) in inside.iter().enumerate() {
        let directions = Sequence::new(1, k as u32);
        let rays: Vec<Ray> = (0..RAYS)
            .map(|i| {
                let [u, v] = directions.point2(i);
                let z = 1.0 - 2.0 * u;
                let r = (1.0 - z * z).max(0.0).sqrt();
                let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
                ray(p, Vec3::new(r * cos, r * sin, z))
            })
            .collect();
        hits += cast(&rays);
    }
    (!inside.is_empty()).then(|| hits as f64 / (inside.len() as f64 * RAYS as f64))
}

fn lights(scene: &Scene) -> Vec<Light> {
    let place = |p: Vec3| format!("at {:.2}, {:.2}, {:.2}", p.x, p.y, p.z);
    let mut list = Vec::new();
    for l in &scene.luminaires {
        let (kind, flux, place) = match l.kind {
            LuminaireKind::Point { intensity, .. } => (
                "point",
                Some((intensity.luminance() * SPHERE_SR) as f64),
                place(l.position),
            ),
            LuminaireKind::Spot {
                intensity,
                cos_inner,
                cos_outer,
                ..
            } => (
                "spot",
                Some(spot_flux(
                    intensity.luminance() as f64,
                    cos_inner as f64,
                    cos_outer as f64,
                )),
                place(l.position),
            ),
            LuminaireKind::Lambertian { intensity } => (
                "Lambertian point",
                Some((intensity.luminance() * LAMBERTIAN) as f64),
                place(l.position),
            ),
            LuminaireKind::Directional { illuminance } => (
                "directional",
                None,
                format!(
                    "{:.0} lx along {:.2}, {:.2}, {:.2}",
                    illuminance.luminance(),
                    l.direction.x,
                    l.direction.y,
                    l.direction.z
                ),
            ),
        };
        list.push(Light {
            name: l.name.clone(),
            kind: kind.into(),
            group: scene.groups[l.group.index()].name.clone(),
            flux_lm: flux,
            place,
        });
    }
    for (id, finish) in scene.finishes.iter().enumerate() {
        let Some(emission) = &finish.emission else {
            continue;
        };
        let (mut flux, mut area, mut count) = (0.0f64, 0.0f64, 0usize);
        let mut centre = Vec3::ZERO;
        for surface in scene.surfaces.iter().filter(|s| s.finish.index() == id) {
            count += 1;
            for t in surface.triangles.clone() {
                let t = t as usize;
                let a = scene.area(t);
                let luminance = scene.luminance_at(t, 1.0 / 3.0, 1.0 / 3.0).luminance();
                flux += (a * luminance * LAMBERTIAN) as f64;
                area += a as f64;
                let [p, q, r] = scene.corners(t);
                centre += (p + q + r) * (a / 3.0);
            }
        }
        if finish.back_emits {
            flux *= 2.0;
        }
        list.push(Light {
            name: finish.name.clone(),
            kind: format!(
                "{:.3} m2 in {count} surface{}",
                area,
                if count == 1 { "" } else { "s" }
            ),
            group: scene.groups[emission.group.index()].name.clone(),
            flux_lm: Some(flux),
            place: if area > 0.0 {
                format!("around{}", &place(centre / area as f32)[2..])
            } else {
                "nowhere".into()
            },
        });
    }
    if let Some(sky) = &scene.sky {
        list.push(Light {
            name: "sky".into(),
            kind: "uniform sky".into(),
            group: scene.groups[sky.group.index()].name.clone(),
            flux_lm: None,
            place: format!(
                "{:.0} cd/m2 from everywhere outside",
                sky.luminance.luminance()
            ),
        });
    }
    list
}

/// Flux of a glTF spot, lm: its intensity times ((cos - cos_outer) / (cos_inner - cos_outer))²
/// integrated over the cone. The ramp is linear in the cosine, so the soft edge counts a third.
fn spot_flux(intensity: f64, cos_inner: f64, cos_outer: f64) -> f64 {
    let half_sphere = SPHERE_SR as f64 / 2.0;
    half_sphere * intensity * ((1.0 - cos_inner) + (cos_inner - cos_outer) / 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spot_flux_of_a_hard_hemisphere_is_two_pi_candela() {
        assert!(
            (spot_flux(1.0, 0.0, 0.0) - 2.0 * std::f64::consts::PI).abs() < 1e-6,
            "f32 constant"
        );
    }
}
