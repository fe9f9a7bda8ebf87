//! The lights whose direct part is computed apart: luminaires without size and emissive
//! polygons that are luminaire-like.
//!
//! An emissive patch of one emission over all its elements is one polygon; otherwise each
//! element is one (a cluster, one for each triangle). Few polygons are always taken apart, as
//! their light is then exact up to shadows. Many are, unless they cover so much of the scene
//! that gather rays find them anyway (light baked into a texture over everything): then their
//! light is left in the solver's emission and every ray that meets them brings it.

use crate::emitter::{Emitter, EmitterView};
use crate::tree::LightTree;
use luxel_core::layers::BANDS;
use luxel_core::quantity::{LAMBERTIAN, LUMINANCE_WEIGHTS};
use luxel_core::{
    DVec3, ElementId, Front, Luminaire, LuminaireKind, Patch, PatchId, Polygon, Rgb, Scene, Shape,
    Vec3,
};
use luxel_transport::Ray;
use luxel_transport::lambert::point_to_polygon;

/// This many emissive polygons are computed apart whatever their area.
const FEW_POLYGONS: usize = 64;
/// More are computed apart while they cover less than this share of all sides of the scene.
const SMALL_SHARE: f64 = 0.05;

/// The lights of a scene whose direct irradiance is computed apart from the solution.
#[derive(Clone, Debug)]
pub struct DirectLights {
    pub(crate) lights: Vec<Light>,
    pub(crate) tree: LightTree,
    pub(crate) columns: usize,
    direct: Vec<bool>,
}

/// One light: what it sends out (`tint`) times a factor that depends on the receiver.
#[derive(Clone, Debug)]
pub(crate) struct Light {
    /// Intensity (cd), illuminance (lux) or exitance (lm/m²) by kind.
    pub tint: Rgb,
    /// Layer.
    pub group: usize,
    pub kind: LightKind,
}

#[derive(Clone, Debug)]
pub(crate) enum LightKind {
    Luminaire(Luminaire),
    Polygon(Emitter),
}

/// A light as one receiver sees it.
pub(crate) enum View<'a> {
    /// One direction: a single shadow ray is exact.
    Point(Ray),
    Polygon(EmitterView<'a>),
}

impl DirectLights {
    /// Collects the lights of a scene and its front.
    ///
    /// `front.emission` must be set. Lights whose group is out of range join the first.
    pub fn new(scene: &Scene, front: &Front) -> DirectLights {
        let columns = scene.layers().columns();
        let layer = |g: luxel_core::GroupId| {
            if g.index() * 3 < columns {
                g.index()
            } else {
                0
            }
        };
        let mut lights = Vec::new();
        for l in &scene.luminaires {
            let tint = match l.kind {
                LuminaireKind::Point { intensity, .. }
                | LuminaireKind::Spot { intensity, .. }
                | LuminaireKind::Lambertian { intensity } => intensity,
                LuminaireKind::Directional { illuminance } => illuminance,
            };
            if tint.max_band() > 0.0 {
                let kind = LightKind::Luminaire(l.clone());
                lights.push(Light {
                    tint,
                    group: layer(l.group),
                    kind,
                });
            }
        }

        let mut elements: Vec<Vec<ElementId>> = vec![Vec::new(); front.patches.len()];
        let mut emitting = 0.0;
        for e in 0..front.len() {
            if front.emission[e].max_band() > 0.0 {
                elements[front.patch[e].index()].push(ElementId::from(e));
                emitting += front.area[e] as f64;
            }
        }
        let mut direct = vec![false; front.patches.len()];
        let mut polygons = Vec::new();
        for (patch, emissive) in elements.iter().enumerate().filter(|(_, e)| !e.is_empty()) {
            direct[patch] = true;
            polygons_of(
                scene,
                front,
                PatchId::from(patch),
                emissive,
                |polygon, tint| {
                    if let Some(emitter) = Emitter::new(polygon) {
                        let group = layer(front.patches[patch].group);
                        polygons.push(Light {
                            tint,
                            group,
                            kind: LightKind::Polygon(emitter),
                        });
                    }
                },
            );
        }
        let sides: f64 = (0..scene.triangles.len())
            .map(|t| 2.0 * scene.area(t) as f64)
            .sum();
        if polygons.len() <= FEW_POLYGONS || emitting < SMALL_SHARE * sides {
            lights.append(&mut polygons);
        } else {
            direct.fill(false);
        }
        let tree = LightTree::new(&lights);
        DirectLights {
            lights,
            tree,
            columns,
            direct,
        }
    }

    /// The same lights with all groups in one.
    pub fn merged(&self) -> DirectLights {
        let mut merged = self.clone();
        merged.columns = BANDS;
        merged.lights.iter_mut().for_each(|l| l.group = 0);
        merged
    }

    /// Whether the own emission of a patch is computed here, and so must not be in the emission
    /// that the solver spreads.
    pub fn is_direct(&self, patch: PatchId) -> bool {
        self.direct.get(patch.index()).copied().unwrap_or(false)
    }

    /// Number of lights: luminaires and polygons.
    pub fn len(&self) -> usize {
        self.lights.len()
    }

    /// Whether there is no light.
    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }
}

/// Calls `add` with each uniform polygon of an emissive patch and its exitance.
fn polygons_of(
    scene: &Scene,
    front: &Front,
    patch: PatchId,
    emissive: &[ElementId],
    mut add: impl FnMut(Polygon, Rgb),
) {
    let first = front.emission[emissive[0].index()];
    let covered: f64 = emissive.iter().map(|e| front.area[e.index()] as f64).sum();
    let same = |e: &ElementId| {
        let m = front.emission[e.index()].to_array();
        first
            .to_array()
            .iter()
            .zip(m)
            .all(|(a, b)| (a - b).abs() <= 1e-5 * a.abs())
    };
    let whole = whole_polygon(&front.patches[patch.index()]);
    if let Some(polygon) =
        whole.filter(|p| emissive.iter().all(same) && (covered - p.area()).abs() < 1e-4 * p.area())
    {
        return add(polygon, first);
    }
    for &e in emissive {
        for polygon in front.polygons(scene, e) {
            add(polygon, front.emission[e.index()]);
        }
    }
}

/// The outline of a flat patch; `None` for a cluster.
fn whole_polygon(patch: &Patch) -> Option<Polygon> {
    let at = |s, t| patch.point(s, t).as_dvec3();
    match patch.shape {
        Shape::Parallelogram { .. } => Some(Polygon::new(vec![
            at(0.0, 0.0),
            at(1.0, 0.0),
            at(1.0, 1.0),
            at(0.0, 1.0),
        ])),
        Shape::Triangle { .. } => {
            Some(Polygon::new(vec![at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)]))
        }
        Shape::Cluster { .. } => None,
    }
}

impl Light {
    /// Unoccluded factor at a receiver; times `tint` it is the irradiance.
    ///
    /// Exact: inverse square and cosine for a point, [Lambert1760] for a polygon.
    pub fn factor(&self, point: DVec3, normal: DVec3) -> f64 {
        match &self.kind {
            LightKind::Polygon(e) => point_to_polygon(point, normal, &e.polygon),
            LightKind::Luminaire(l) => luminaire_factor(l, point, normal),
        }
    }

    /// A cheap guess of the photometric irradiance anywhere within `reach` metres of a point.
    /// Zero only where no light can arrive.
    pub fn guess(&self, point: Vec3, normal: Vec3, reach: f32) -> f32 {
        let strength = self.tint.luminance();
        match &self.kind {
            LightKind::Polygon(e) => {
                let to = e.centre.as_vec3() - point;
                let slack = e.radius as f32 + reach;
                let d2 = to
                    .length_squared()
                    .max(slack * slack)
                    .max(f32::MIN_POSITIVE);
                let d = d2.sqrt();
                let here = ((to.dot(normal) + slack) / d).clamp(0.0, 1.0);
                let there = ((slack - to.dot(e.normal.as_vec3())) / d).clamp(0.0, 1.0);
                strength * e.area as f32 * here * there / (LAMBERTIAN * d2)
            }
            LightKind::Luminaire(l) => match l.kind {
                LuminaireKind::Directional { .. } => {
                    if reach > 0.0 {
                        strength
                    } else {
                        strength * (-l.direction.dot(normal)).max(0.0)
                    }
                }
                _ => {
                    let to = l.position - point;
                    let d2 = to
                        .length_squared()
                        .max(reach * reach)
                        .max(f32::MIN_POSITIVE);
                    strength * ((to.dot(normal) + reach) / d2.sqrt()).clamp(0.0, 1.0) / d2
                }
            },
        }
    }

    /// How a receiver sees the light; `None` when it is behind or turned away.
    /// `start` is the receiver moved off its surface, `offset` by how much.
    pub fn view(&self, point: Vec3, normal: Vec3, start: Vec3, offset: f32) -> Option<View<'_>> {
        match &self.kind {
            LightKind::Polygon(e) => e
                .seen_from(point.as_dvec3(), normal.as_dvec3())
                .map(View::Polygon),
            LightKind::Luminaire(l) => {
                if luminaire_factor(l, point.as_dvec3(), normal.as_dvec3()) <= 0.0 {
                    return None;
                }
                Some(View::Point(match l.kind {
                    LuminaireKind::Directional { .. } => Ray {
                        origin: start,
                        t_min: 0.0,
                        direction: -l.direction,
                        t_max: f32::INFINITY,
                    },
                    // A lamp may hang exactly on a ceiling: the segment ends just before it.
                    _ => segment(start, l.position, offset),
                }))
            }
        }
    }

    /// Shadow segment to a point on a polygon light, ending just in front of its surface.
    pub fn segment_to(&self, start: Vec3, target: Vec3, offset: f32) -> Ray {
        match &self.kind {
            LightKind::Polygon(e) => {
                let target = target + e.normal.as_vec3() * offset;
                Ray {
                    origin: start,
                    t_min: 0.0,
                    direction: target - start,
                    t_max: 1.0,
                }
            }
            LightKind::Luminaire(_) => segment(start, target, offset),
        }
    }
}

fn segment(start: Vec3, end: Vec3, offset: f32) -> Ray {
    let direction = end - start;
    let t_max = 1.0 - (offset / direction.length().max(f32::MIN_POSITIVE)).min(1.0);
    Ray {
        origin: start,
        t_min: 0.0,
        direction,
        t_max,
    }
}

/// Irradiance of a luminaire of unit strength.
///
/// Cone and range as KHR_lights_punctual defines them.
fn luminaire_factor(l: &Luminaire, point: DVec3, normal: DVec3) -> f64 {
    if let LuminaireKind::Directional { .. } = l.kind {
        return (-l.direction.as_dvec3().dot(normal)).max(0.0);
    }
    let to = l.position.as_dvec3() - point;
    let d2 = to.length_squared();
    if d2 <= 0.0 {
        return 0.0;
    }
    let w = to / d2.sqrt();
    let here = w.dot(normal).max(0.0) / d2;
    let along = -w.dot(l.direction.as_dvec3());
    let window = |range_m: f32| {
        if range_m.is_finite() && range_m > 0.0 {
            (1.0 - (d2 / (range_m as f64 * range_m as f64)).powi(2)).clamp(0.0, 1.0)
        } else {
            1.0
        }
    };
    match l.kind {
        LuminaireKind::Point { range_m, .. } => here * window(range_m),
        LuminaireKind::Spot {
            range_m,
            cos_inner,
            cos_outer,
            ..
        } => {
            let scale = 1.0 / (cos_inner as f64 - cos_outer as f64).max(0.001);
            let edge = ((along - cos_outer as f64) * scale).clamp(0.0, 1.0);
            here * window(range_m) * edge * edge
        }
        LuminaireKind::Lambertian { .. } => here * along.max(0.0),
        LuminaireKind::Directional { .. } => 0.0,
    }
}

/// Photometric value of three bands, in double precision.
pub(crate) fn photometric(rgb: [f64; 3]) -> f64 {
    (0..3).map(|b| rgb[b] * LUMINANCE_WEIGHTS[b] as f64).sum()
}
