//! Changes to a scene from the command line: lamps, emission, sky, groups. Each light added is a
//! group of its own.

use crate::assemble::{NO_LIGHT, Names};
use crate::error::clean;
use crate::options::MOST_LIGHT;
use luxel_core::quantity::Lumens;
use luxel_core::{Emission, Group, GroupId, Luminaire, LuminaireKind, Rgb, Scene, Sky, Vec3};

const LAMP_FORMS: &str =
    "800lm@x,y,z or 5cd@x,y,z or 10cd@x,y,z>dx,dy,dz:inner,outer or 1000lx@dx,dy,dz";

/// Adds a lamp without size, as `AMOUNT@PLACE[,options]`:
///
/// - `800lm@2,3.2,0`: a point that sends 800 lm evenly in all directions
/// - `5cd@2,3.2,0`: a point of 5 cd
/// - `10cd@0,3,0>0,-1,0:15,22.5`: a spot with its aim and its inner and outer half angle in
///   degrees (0 and 45 if left out), falling off as KHR_lights_punctual says
/// - `1000lx@0,-1,0`: parallel light that travels along the vector, in lux across the beam
///
/// A linear colour may follow, `800lm@2,3.2,0*1,0.9,0.8`: it multiplies each band. Lengths are
/// metres. The lamp's group has the text as its name.
///
/// ```
/// let mut scene = luxel_core::Scene::default();
/// luxel_io::scene_ops::add_lamp(&mut scene, "800lm@2,3.2,0").unwrap();
/// let luxel_core::LuminaireKind::Point { intensity, .. } = scene.luminaires[0].kind else { panic!() };
/// assert!((intensity.g - 63.66198).abs() < 1e-4); // 800 / 4 pi
/// ```
pub fn add_lamp(scene: &mut Scene, text: &str) -> Result<(), String> {
    let wrong = || {
        format!(
            "lamp '{}': expected {LAMP_FORMS}, of at most {MOST_LIGHT:e}",
            clean(text)
        )
    };
    let mut luminaire = lamp(text).ok_or_else(wrong)?;
    luminaire.group = new_group(scene, text);
    scene.luminaires.push(luminaire);
    Ok(())
}

fn lamp(text: &str) -> Option<Luminaire> {
    let (body, colour) = match text.split_once('*') {
        Some((body, rgb)) => (
            body,
            Rgb::from(three(rgb).filter(|c| c.iter().all(|v| *v >= 0.0))?),
        ),
        None => (text, Rgb::WHITE),
    };
    let (amount, place) = body.split_once('@')?;
    let amount = amount.trim();
    let unit = amount.get(amount.len().checked_sub(2)?..)?;
    let value: f32 = amount[..amount.len() - 2].trim().parse().ok()?;
    let most = MOST_LIGHT / colour.max_band().max(1.0);
    if !(value > 0.0 && value <= most) {
        return None;
    }
    let (place, angles) = match place.split_once(':') {
        Some((place, angles)) => (place, Some(angles)),
        None => (place, None),
    };
    let (place, aim) = match place.split_once('>') {
        Some((place, aim)) => (place, Some(aim)),
        None => (place, None),
    };
    let place = Vec3::from(three(place)?);
    let unit_vector = |v: Vec3| v.as_dvec3().try_normalize().map(|v| v.as_vec3());
    let (mut position, mut direction) = (place, Vec3::NEG_Y);
    let kind = match (unit, aim) {
        ("lx", None) if angles.is_none() => {
            (position, direction) = (Vec3::ZERO, unit_vector(place)?);
            LuminaireKind::Directional {
                illuminance: colour * value,
            }
        }
        ("lm", None) if angles.is_none() => {
            let candela = Lumens::new(value).isotropic_intensity().candela();
            LuminaireKind::Point {
                intensity: colour * candela,
                range_m: f32::INFINITY,
            }
        }
        ("cd", None) if angles.is_none() => LuminaireKind::Point {
            intensity: colour * value,
            range_m: f32::INFINITY,
        },
        ("cd", Some(aim)) => {
            direction = unit_vector(Vec3::from(three(aim)?))?;
            let [inner, outer] = match angles {
                Some(angles) => list::<2>(angles)?,
                None => [0.0, 45.0],
            };
            if !(0.0 <= inner && inner <= outer && outer <= 180.0) {
                return None;
            }
            LuminaireKind::Spot {
                intensity: colour * value,
                range_m: f32::INFINITY,
                cos_inner: (inner as f64).to_radians().cos() as f32,
                cos_outer: (outer as f64).to_radians().cos() as f32,
            }
        }
        _ => return None,
    };
    Some(Luminaire {
        name: clean(text),
        position,
        direction,
        kind,
        group: GroupId::NONE,
    })
}

/// `N` finite numbers between commas.
fn list<const N: usize>(text: &str) -> Option<[f32; N]> {
    let mut out = [0.0; N];
    let mut words = text.split(',');
    for slot in &mut out {
        *slot = words
            .next()?
            .trim()
            .parse()
            .ok()
            .filter(|v: &f32| v.is_finite())?;
    }
    words.next().is_none().then_some(out)
}

fn three(text: &str) -> Option<[f32; 3]> {
    list::<3>(text)
}

/// One number for all bands, or three.
fn bands(text: &str) -> Option<Rgb> {
    let one = || list::<1>(text).map(|[v]| Rgb::splat(v));
    one()
        .or_else(|| three(text).map(Rgb::from))
        .filter(|c| c.to_array().iter().all(|v| (0.0..=MOST_LIGHT).contains(v)))
}

/// Sets the luminance of a material, `MATERIAL=5000` or `MATERIAL=5000,4000,3000`, cd/m².
///
/// All materials of that name get it, without a picture, as one group with the material's name.
/// A luminance of 0 puts them out.
pub fn set_emission(scene: &mut Scene, text: &str) -> Result<(), String> {
    let (name, luminance) = text
        .rsplit_once('=')
        .and_then(|(name, value)| Some((name, bands(value)?)))
        .ok_or_else(|| {
            format!(
                "emission '{}': expected MATERIAL=5000 (cd/m², at most {MOST_LIGHT:e})",
                clean(text)
            )
        })?;
    let hit: Vec<usize> = (0..scene.finishes.len())
        .filter(|&k| scene.finishes[k].name == name)
        .collect();
    if hit.is_empty() {
        let known = scene.finishes.iter().map(|f| f.name.as_str());
        return Err(format!(
            "no material '{}'; there are: {}",
            clean(name),
            listed(known)
        ));
    }
    for &k in &hit {
        scene.finishes[k].emission = None;
    }
    drop_unused_groups(scene);
    if luminance.max_band() > 0.0 {
        let group = new_group(scene, name);
        for &k in &hit {
            scene.finishes[k].emission = Some(Emission {
                luminance,
                texture: None,
                group,
            });
        }
    }
    Ok(())
}

/// Sets the sky: the same luminance from everywhere outside, `3000` or `3000,3200,4000`, cd/m².
pub fn set_sky(scene: &mut Scene, text: &str) -> Result<(), String> {
    let luminance = bands(text).ok_or_else(|| {
        format!(
            "sky '{}': expected a luminance in cd/m², such as 3000, of at most {MOST_LIGHT:e}",
            clean(text)
        )
    })?;
    scene.sky = None;
    drop_unused_groups(scene);
    if luminance.max_band() > 0.0 {
        let group = new_group(scene, "sky");
        scene.sky = Some(Sky { luminance, group });
    }
    Ok(())
}

/// Makes one group out of several, `name=a,b,c`. `name=*` takes them all.
///
/// Group names with a comma in them are found as long as they stand as a whole.
pub fn merge_groups(scene: &mut Scene, text: &str) -> Result<(), String> {
    let (name, members) = text
        .split_once('=')
        .filter(|(name, members)| !name.trim().is_empty() && !members.trim().is_empty())
        .ok_or_else(|| format!("groups '{}': expected name=a,b,c", clean(text)))?;
    let mut member = vec![members.trim() == "*"; scene.groups.len()];
    let mut rest = if members.trim() == "*" {
        ""
    } else {
        members.trim()
    };
    while !rest.is_empty() {
        // The longest name that fits: a lamp's name holds commas itself.
        let fits = |g: &Group| {
            rest.strip_prefix(g.name.as_str())
                .is_some_and(|r| r.is_empty() || r.trim_start().starts_with(','))
        };
        let best = (0..scene.groups.len())
            .filter(|&k| fits(&scene.groups[k]))
            .max_by_key(|&k| scene.groups[k].name.len());
        let Some(k) = best else {
            let known = scene.groups.iter().map(|g| g.name.as_str());
            return Err(format!(
                "no light group '{}'; there are: {}",
                clean(rest),
                listed(known)
            ));
        };
        member[k] = true;
        rest = rest[scene.groups[k].name.len()..].trim_start();
        rest = rest.strip_prefix(',').unwrap_or(rest).trim_start();
    }
    let Some(target) = member.iter().position(|m| *m) else {
        return Err(format!("groups '{}': expected name=a,b,c", clean(text)));
    };
    let onto = GroupId::from(target);
    for group in all_group_ids(scene) {
        if group.is_some() && member[group.index()] {
            *group = onto;
        }
    }
    let others = scene.groups.iter().zip(&member).filter(|(_, m)| !**m);
    let mut taken = Names::of(others.map(|(g, _)| &g.name));
    scene.groups[target].name = taken.unique(name.trim());
    drop_unused_groups(scene);
    Ok(())
}

/// Every place in a scene that names a group.
fn all_group_ids(scene: &mut Scene) -> impl Iterator<Item = &mut GroupId> {
    let finishes = scene
        .finishes
        .iter_mut()
        .filter_map(|f| f.emission.as_mut());
    finishes
        .map(|e| &mut e.group)
        .chain(scene.luminaires.iter_mut().map(|l| &mut l.group))
        .chain(scene.sky.iter_mut().map(|s| &mut s.group))
}

/// Removes groups that nothing belongs to and renumbers the others.
fn drop_unused_groups(scene: &mut Scene) {
    let mut used = vec![false; scene.groups.len()];
    for group in all_group_ids(scene) {
        if group.is_some() {
            used[group.index()] = true;
        }
    }
    let mut new = Vec::with_capacity(used.len());
    let mut kept = Vec::new();
    for (group, used) in std::mem::take(&mut scene.groups).into_iter().zip(used) {
        new.push(GroupId::from(kept.len()));
        if used {
            kept.push(group);
        }
    }
    for group in all_group_ids(scene) {
        if group.is_some() {
            *group = new[group.index()];
        }
    }
    if kept.is_empty() {
        kept.push(Group {
            name: NO_LIGHT.into(),
        });
    }
    scene.groups = kept;
}

/// Adds a group under a name of its own; the one of a scene without light makes way.
fn new_group(scene: &mut Scene, name: &str) -> GroupId {
    if all_group_ids(scene).all(|g| !g.is_some()) {
        scene.groups.clear();
    }
    let name = Names::of(scene.groups.iter().map(|g| &g.name)).unique(&clean(name));
    scene.groups.push(Group { name });
    GroupId::from(scene.groups.len() - 1)
}

/// Different names for a message, in alphabetical order, at most thirty.
fn listed<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let mut names: Vec<&str> = names.collect();
    names.sort_unstable();
    names.dedup();
    let more = names.len().saturating_sub(30);
    names.truncate(30);
    let mut out = names.join(", ");
    if more > 0 {
        out.push_str(&format!(" and {more} more"));
    }
    out
}
