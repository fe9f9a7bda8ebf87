//! The radiosity equation's known side for one front: what `gather` and `core` know, laid out
//! as the solvers read it.

use luxel_core::layers::BANDS;
use luxel_core::quantity::LAMBERTIAN;
use luxel_core::{ElementId, Front, Layers, Scene};
use luxel_gather::DirectLights;
use luxel_solve::{Problem, Transport};

/// Area, reflectance and first emission of every element.
///
/// Emission is the own exitance of surfaces that are gathered by rays, plus the first
/// reflection of the direct light of luminaires and luminaire-like surfaces, which `gather`
/// computes analytically. The own exitance of the latter is not in it.
pub struct Matter {
    layers: Layers,
    area: Vec<f64>,
    reflectance: Vec<f64>,
    emission: Vec<f64>,
    outside: Vec<f64>,
    direct_landed: Vec<f64>,
    direct_reflected: Vec<f64>,
}

impl Matter {
    /// `direct`: mean direct irradiance of each element, `columns` an element, lux.
    pub fn new(scene: &Scene, front: &Front, lights: &DirectLights, direct: &[f32]) -> Matter {
        let layers = scene.layers();
        let columns = layers.columns();
        let mut emission = vec![0.0; front.len() * columns];
        let mut reflectance = Vec::with_capacity(front.len() * BANDS);
        let (mut direct_landed, mut direct_reflected) = (vec![0.0; columns], vec![0.0; columns]);
        for e in 0..front.len() {
            let area = front.area[e] as f64;
            let rho = front.reflectance[e].to_array();
            reflectance.extend(rho.map(f64::from));
            let row = &mut emission[e * columns..(e + 1) * columns];
            for (column, value) in row.iter_mut().enumerate() {
                let irradiance = direct[e * columns + column] as f64;
                *value = rho[column % BANDS] as f64 * irradiance;
                direct_landed[column] += area * irradiance;
                direct_reflected[column] += area * *value;
            }
            let id = ElementId::from(e);
            let group = front.group(id);
            if group.is_some() && !lights.is_direct(front.patch[e]) {
                for (band, own) in front.emission[e].to_array().into_iter().enumerate() {
                    row[BANDS * group.index() + band] += own as f64;
                }
            }
        }
        let mut outside = vec![0.0; columns];
        if let Some(sky) = &scene.sky {
            for (band, luminance) in sky.luminance.to_array().into_iter().enumerate() {
                outside[BANDS * sky.group.index() + band] = (luminance * LAMBERTIAN) as f64;
            }
        }
        let area = front.area.iter().map(|&a| a as f64).collect();
        Matter {
            layers,
            area,
            reflectance,
            emission,
            outside,
            direct_landed,
            direct_reflected,
        }
    }

    /// Direct light of the direct lights on all elements, lm, one entry a column.
    pub fn direct_landed(&self) -> &[f64] {
        &self.direct_landed
    }

    /// What of it is reflected at once, lm, one entry a column.
    pub fn direct_reflected(&self) -> &[f64] {
        &self.direct_reflected
    }

    /// The equation with its geometry.
    pub fn problem<'a>(&'a self, transport: Transport<'a>, seed: u32) -> Problem<'a> {
        Problem {
            layers: &self.layers,
            area: &self.area,
            reflectance: &self.reflectance,
            emission: &self.emission,
            outside: &self.outside,
            transport,
            seed,
            importance: None,
        }
    }

    /// Names of the columns.
    pub fn layers(&self) -> &Layers {
        &self.layers
    }
}
