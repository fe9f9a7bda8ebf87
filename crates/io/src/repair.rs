//! Dirty geometry into geometry fit for lighting; each repair is a warning with its count.
//!
//! In this order: triangles that are not finite are dropped, and strays absurdly far from the
//! others (in `stray`); vertices are welded; triangles without a height are dropped; coincident
//! triangles are told apart; reflectance is clamped. Then what is left as it is gets counted: edges at which neighbours
//! are turned against each other, and T-vertices (in `seams`).
//!
//! Coincident triangles: of two with the same winding the second goes, unless only it shines.
//! Two back to back are the wall between two rooms: each becomes single-sided, so that a side
//! has one face; if they have the same two-sided finish one of them is enough.

mod seams;
mod stray;

use luxel_core::{
    Alpha, Emission, FinishId, Scene, Surface, SurfaceId, Texture, TextureId, Vec3, Warnings,
};
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// Farthest coordinate that is lit, metres: squares of areas stay finite in f32 up to here.
const FARTHEST: f32 = 1e9;

/// Weld distance in relation to the scene's middle size: four steps of f32.
const WELD: f64 = 4.0 / (1 << 23) as f64;

/// A hash for small integer keys: fast, and the same in every run. No result depends on its order.
#[derive(Default)]
pub(crate) struct IntegerHash(u64);

impl Hasher for IntegerHash {
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 29)
    }
    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }
    fn write_u32(&mut self, v: u32) {
        self.write_u64(v as u64);
    }
    fn write_u64(&mut self, v: u64) {
        // Multiplication by an odd constant after Fibonacci, [Knuth98] 6.4.
        self.0 = (self.0.rotate_left(26) ^ v).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}

pub(crate) type IntegerMap<K, V> = HashMap<K, V, BuildHasherDefault<IntegerHash>>;

/// Repairs a scene in place.
///
/// Returns, for each finish of the repaired scene, the finish of the given scene that it was
/// made from. Surfaces without triangles are removed, vertices without use too.
pub fn repair(
    scene: &mut Scene,
    file: &str,
    max_reflectance: f32,
    warnings: &mut Warnings,
) -> Vec<FinishId> {
    let mut origin: Vec<FinishId> = (0..scene.finishes.len()).map(FinishId::from).collect();
    let mut dropped = vec![Fate::Kept; scene.triangles.len()];
    for (t, fate) in dropped.iter_mut().enumerate() {
        let fit = |p: Vec3| p.is_finite() && p.abs().max_element() <= FARTHEST;
        if !scene.corners(t).into_iter().all(fit) {
            *fate = Fate::NotFinite;
        }
    }
    stray::drop_strays(scene, &mut dropped);
    let tolerance = weld_distance(scene, &dropped);
    let near = weld(scene, tolerance);
    let note = "vertices less than a rounding error apart were welded";
    warnings.add(file, note, near);
    drop_flat(scene, tolerance, &mut dropped);
    part_coincident(scene, &mut dropped);
    report(scene, file, &dropped, warnings);
    rebuild(scene, &dropped, &mut origin);
    clamp_reflectance(scene, file, max_reflectance, &mut origin, warnings);
    seams::count(scene, file, tolerance, warnings);
    stray::warn_if_coarse(scene, file, warnings);
    origin
}

/// What becomes of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Kept,
    /// Kept, with a black and dark back: another face covers it.
    SingleSided,
    NotFinite,
    Stray,
    Flat,
    Double,
}

/// Distance under which vertices are one, metres: rounding error at the middle triangle.
fn weld_distance(scene: &Scene, dropped: &[Fate]) -> f64 {
    let mut sizes: Vec<f32> = Vec::new();
    for (t, corners) in scene.triangles.iter().enumerate() {
        if dropped[t] == Fate::Kept {
            let sizes_of = corners.map(|i| scene.positions[i as usize].abs().max_element());
            sizes.push(sizes_of.into_iter().fold(0.0, f32::max));
        }
    }
    if sizes.is_empty() {
        return 0.0;
    }
    // The median: one vertex far out must not melt the furniture.
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f32::total_cmp);
    *median as f64 * WELD
}

/// Makes one vertex of each set that coincides; returns how many differed in their bits.
fn weld(scene: &mut Scene, tolerance: f64) -> usize {
    let count = scene.positions.len();
    let mut same: IntegerMap<[u32; 3], u32> =
        IntegerMap::with_capacity_and_hasher(count, Default::default());
    // Vertices by cells four tolerances wide; those of a cell are chained.
    let mut cells: IntegerMap<[u64; 3], u32> = IntegerMap::default();
    let mut next: Vec<u32> = Vec::new();
    let mut kept: Vec<Vec3> = Vec::new();
    let mut new_index = Vec::with_capacity(count);
    let mut near = 0;
    let width = 4.0 * tolerance;
    for &p in &scene.positions {
        let p = p + Vec3::ZERO; // one zero of two
        let bits = p.to_array().map(f32::to_bits);
        let fresh = kept.len() as u32;
        let index = *same.entry(bits).or_insert(fresh);
        if index != fresh || !p.is_finite() || tolerance == 0.0 {
            if index == fresh {
                kept.push(p);
                next.push(u32::MAX);
            }
            new_index.push(index);
            continue;
        }
        let cell_of = |offset: f64| {
            p.to_array()
                .map(|v| ((v as f64 + offset) / width).floor() as i64 as u64)
        };
        let (low, high) = (cell_of(-tolerance), cell_of(tolerance));
        let found = (|| {
            'cells: for corner in 0..8u32 {
                let mut cell = low;
                for axis in 0..3 {
                    if corner >> axis & 1 == 1 {
                        if high[axis] == low[axis] {
                            continue 'cells; // seen already with the low side
                        }
                        cell[axis] = high[axis];
                    }
                }
                let mut at = cells.get(&cell).copied().unwrap_or(u32::MAX);
                while at != u32::MAX {
                    let apart = (kept[at as usize] - p).abs().max_element() as f64;
                    if apart <= tolerance {
                        return Some(at);
                    }
                    at = next[at as usize];
                }
            }
            None
        })();
        match found {
            Some(at) => {
                near += 1;
                same.insert(bits, at);
                new_index.push(at);
            }
            None => {
                let home = cells.entry(cell_of(0.0)).or_insert(u32::MAX);
                next.push(*home);
                *home = fresh;
                kept.push(p);
                new_index.push(fresh);
            }
        }
    }
    for corners in &mut scene.triangles {
        *corners = corners.map(|i| new_index[i as usize]);
    }
    scene.positions = kept;
    near
}

/// Marks triangles without a height that f32 can tell from zero.
fn drop_flat(scene: &Scene, tolerance: f64, dropped: &mut [Fate]) {
    for (t, fate) in dropped.iter_mut().enumerate() {
        if *fate != Fate::Kept {
            continue;
        }
        let [a, b, c] = scene.corners(t).map(|p| p.as_dvec3());
        let twice = (b - a).cross(c - a).length();
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        // Meshing and rays compute with f32: the area must be a normal number there.
        let stored = scene.area(t);
        if twice <= tolerance * longest || !stored.is_normal() {
            *fate = Fate::Flat;
        }
    }
}

/// Finds triangles on the same three vertices.
fn part_coincident(scene: &Scene, dropped: &mut [Fate]) {
    let shines = |t: usize| scene.finish_of(t).emission.is_some();
    let solid = |t: usize| {
        let f = scene.finish_of(t);
        f.alpha == Alpha::Opaque && !f.transparent
    };
    let two_sided = |t: usize| scene.finish_of(t).back_reflects || scene.finish_of(t).back_emits;
    // The triangle that stays on each set of vertices, for either winding.
    let mut first: IntegerMap<[u32; 3], [u32; 2]> =
        IntegerMap::with_capacity_and_hasher(scene.triangles.len(), Default::default());
    for t in 0..scene.triangles.len() {
        if dropped[t] != Fate::Kept {
            continue;
        }
        let corners = scene.triangles[t];
        let mut key = corners;
        key.sort_unstable();
        let winding = even(corners, key) as usize;
        let stays = first.entry(key).or_insert([u32::MAX; 2]);
        let same = stays[winding] as usize;
        if stays[winding] != u32::MAX {
            // The brighter or the solid one is what the maker wanted to be seen.
            if (shines(t), solid(t)) <= (shines(same), solid(same)) {
                dropped[t] = Fate::Double;
                continue;
            }
            dropped[same] = Fate::Double;
        }
        stays[winding] = t as u32;
        let other = stays[1 - winding] as usize;
        let wall = stays[1 - winding] != u32::MAX
            && solid(t)
            && solid(other)
            && (two_sided(t) || two_sided(other));
        if !wall {
            continue;
        }
        if dropped[other] == Fate::Kept
            && scene.finish_of(t) == scene.finish_of(other)
            && !shines(t)
        {
            dropped[t] = Fate::Double;
            stays[winding] = u32::MAX;
        } else {
            dropped[t] = Fate::SingleSided;
            dropped[other] = Fate::SingleSided;
        }
    }
}

/// Whether `corners` is an even permutation of `sorted`.
fn even(corners: [u32; 3], sorted: [u32; 3]) -> bool {
    let [a, b, c] = sorted;
    corners == [a, b, c] || corners == [b, c, a] || corners == [c, a, b]
}

/// Surfaces named for one kind of repair; with more, the file is.
const MOST_PLACES: usize = 8;

fn report(scene: &Scene, file: &str, dropped: &[Fate], warnings: &mut Warnings) {
    let kinds = [
        (
            Fate::NotFinite,
            "dropped triangles that are not finite or too far away",
        ),
        (
            Fate::Stray,
            "dropped triangles a thousand times farther away than all others",
        ),
        (Fate::Flat, "dropped triangles without area"),
        (Fate::Double, "dropped triangles that coincide with another"),
        (
            Fate::SingleSided,
            "faces back to back were made single-sided",
        ),
    ];
    for (kind, what) in kinds {
        let mut places: Vec<(usize, usize)> = Vec::new();
        for (s, surface) in scene.surfaces.iter().enumerate() {
            let run = &dropped[surface.triangles.start as usize..surface.triangles.end as usize];
            let count = run.iter().filter(|f| **f == kind).count();
            if count > 0 {
                places.push((s, count));
            }
        }
        if places.len() > MOST_PLACES {
            let all = places.iter().map(|p| p.1).sum();
            warnings.add(format!("{file}: {} surfaces", places.len()), what, all);
        } else {
            for (s, count) in places {
                warnings.add(format!("{file}: '{}'", scene.surfaces[s].name), what, count);
            }
        }
    }
}

/// Keeps what is kept: triangles in order, single-sided ones as surfaces of their own.
fn rebuild(scene: &mut Scene, dropped: &[Fate], origin: &mut Vec<FinishId>) {
    let old = std::mem::take(scene);
    let textured = !old.uvs.is_empty();
    let mut vertex = vec![u32::MAX; old.positions.len()];
    let mut single: HashMap<FinishId, FinishId> = HashMap::new();
    scene.finishes = old.finishes;
    for surface in old.surfaces {
        for fate in [Fate::Kept, Fate::SingleSided] {
            let start = scene.triangles.len();
            let id = SurfaceId::from(scene.surfaces.len());
            for t in surface.triangles.start as usize..surface.triangles.end as usize {
                if dropped[t] != fate {
                    continue;
                }
                let corners = old.triangles[t].map(|i| {
                    let slot = &mut vertex[i as usize];
                    if *slot == u32::MAX {
                        *slot = scene.positions.len() as u32;
                        scene.positions.push(old.positions[i as usize]);
                    }
                    *slot
                });
                scene.triangles.push(corners);
                scene.source_triangle.push(old.source_triangle[t]);
                scene.surface_of.push(id);
                if textured {
                    scene.uvs.push(old.uvs[t]);
                }
            }
            if scene.triangles.len() == start {
                continue;
            }
            let mut finish = surface.finish;
            if fate == Fate::SingleSided {
                finish = *single.entry(surface.finish).or_insert_with(|| {
                    let mut own = scene.finishes[surface.finish.index()].clone();
                    own.back_reflects = false;
                    own.back_emits = false;
                    scene.finishes.push(own);
                    origin.push(origin[surface.finish.index()]);
                    FinishId::from(scene.finishes.len() - 1)
                });
            }
            let triangles = start as u32..scene.triangles.len() as u32;
            scene.surfaces.push(Surface {
                finish,
                triangles,
                ..surface.clone()
            });
        }
    }
    scene.name = old.name;
    scene.textures = old.textures;
    scene.luminaires = old.luminaires;
    scene.groups = old.groups;
    scene.sky = old.sky;
    scene.views = old.views;
    scene.up = old.up;
}

/// Bounds every reflectance, textures included: a texel stays below `limit` after its factor.
fn clamp_reflectance(
    scene: &mut Scene,
    file: &str,
    limit: f32,
    origin: &mut [FinishId],
    warnings: &mut Warnings,
) {
    debug_assert_eq!(origin.len(), scene.finishes.len());
    let limit = limit.clamp(0.0, 1.0);
    let what = format!("reflectance above {limit} was clamped (--max-reflectance)");
    let mut made: HashMap<(TextureId, [u8; 3]), TextureId> = HashMap::new();
    let mut used = vec![false; scene.finishes.len()];
    for surface in &scene.surfaces {
        used[surface.finish.index()] = true;
    }
    let mut names: Vec<String> = Vec::new();
    for k in 0..scene.finishes.len() {
        let finish = &scene.finishes[k];
        if finish.transparent || !used[k] {
            continue;
        }
        let Some(id) = finish.texture else {
            let bounded = finish.reflectance.map(|v| v.min(limit));
            if bounded != finish.reflectance {
                scene.finishes[k].reflectance = bounded;
                names.push(scene.finishes[k].name.clone());
            }
            continue;
        };
        // Brightest byte that each band may have under its factor.
        let most = finish
            .reflectance
            .to_array()
            .map(|factor| brightest(factor, limit));
        let texture = &scene.textures[id.index()];
        let over = |t: &[u8; 4]| (0..3).any(|b| t[b] > most[b]);
        if !texture.rgba.iter().any(over) {
            continue;
        }
        names.push(finish.name.clone());
        let textures = &mut scene.textures;
        let new = *made.entry((id, most)).or_insert_with(|| {
            let mut own: Texture = textures[id.index()].clone();
            for t in &mut own.rgba {
                for b in 0..3 {
                    t[b] = t[b].min(most[b]);
                }
            }
            textures.push(own);
            TextureId::from(textures.len() - 1)
        });
        scene.finishes[k].texture = Some(new);
    }
    drop_unused_textures(scene);
    if names.len() > MOST_PLACES {
        warnings.add(
            format!("{file}: {} materials", names.len()),
            &what,
            names.len(),
        );
    } else {
        for name in names {
            warnings.add(format!("{file}: material '{name}'"), &what, 1);
        }
    }
}

/// Largest sRGB byte whose linear value times `factor` is at most `limit`.
fn brightest(factor: f32, limit: f32) -> u8 {
    (0..=255u8)
        .rev()
        .find(|&b| luxel_core::texture::linear_from_srgb(b) * factor <= limit)
        .unwrap_or(0)
}

fn drop_unused_textures(scene: &mut Scene) {
    let mut new = vec![TextureId::NONE; scene.textures.len()];
    let mut used = vec![false; scene.textures.len()];
    for finish in &scene.finishes {
        for id in finish
            .texture
            .iter()
            .chain(finish.emission.iter().flat_map(|e| &e.texture))
        {
            used[id.index()] = true;
        }
    }
    let mut kept = Vec::new();
    for (k, texture) in std::mem::take(&mut scene.textures).into_iter().enumerate() {
        if used[k] {
            new[k] = TextureId::from(kept.len());
            kept.push(texture);
        }
    }
    scene.textures = kept;
    for finish in &mut scene.finishes {
        finish.texture = finish.texture.map(|id| new[id.index()]);
        if let Some(Emission {
            texture: Some(id), ..
        }) = &mut finish.emission
        {
            *id = new[id.index()];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_core::{Finish, Group, Rgb};

    /// A scene of separate triangles, one surface for each entry of `parts`.
    fn scene(finishes: Vec<Finish>, parts: &[(usize, &[[Vec3; 3]])]) -> Scene {
        let mut s = Scene {
            finishes,
            up: Vec3::Y,
            ..Scene::default()
        };
        s.groups.push(Group { name: "g".into() });
        for (finish, triangles) in parts {
            let start = s.triangles.len() as u32;
            for (k, t) in triangles.iter().enumerate() {
                let first = s.positions.len() as u32;
                s.positions.extend(t);
                s.triangles.push([first, first + 1, first + 2]);
                s.source_triangle.push(k as u32);
                s.surface_of.push(SurfaceId::from(s.surfaces.len()));
            }
            s.surfaces.push(Surface {
                name: format!("part {}", s.surfaces.len()),
                finish: FinishId::from(*finish),
                triangles: start..s.triangles.len() as u32,
                node: u32::MAX,
                mesh: u32::MAX,
                primitive: 0,
            });
        }
        s
    }

    fn repaired(mut s: Scene) -> (Scene, Vec<String>) {
        let mut warnings = Warnings::default();
        repair(&mut s, "t", 0.9, &mut warnings);
        (s, warnings.iter().map(|w| w.to_string()).collect())
    }

    const T: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];
    const TURNED: [Vec3; 3] = [Vec3::ZERO, Vec3::Y, Vec3::X];

    fn two_sided(grey: f32) -> Finish {
        Finish {
            reflectance: Rgb::splat(grey),
            back_reflects: true,
            ..Finish::default()
        }
    }

    #[test]
    fn vertices_a_rounding_error_apart_become_one() {
        let close = Vec3::new(1.0 + f32::EPSILON, 0.0, 0.0);
        let far = Vec3::new(1.0 + 1e-5, 0.0, 0.0);
        let z = Vec3::Z;
        let s = scene(
            vec![Finish::default()],
            &[(0, &[T, [close, z, Vec3::Y], [far, z, -z]])],
        );
        let (s, said) = repaired(s);
        // 0, x, y, z, far, -z: `close` is x, 10 micrometres are not.
        assert_eq!(s.positions.len(), 6);
        assert!(said[0].contains("welded"), "{said:?}");
    }

    #[test]
    fn triangles_without_area_or_place_go_and_empty_surfaces_with_them() {
        let nan = [Vec3::NAN, Vec3::X, Vec3::Y];
        let far = [Vec3::splat(1e12), Vec3::X, Vec3::Y];
        let line = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0];
        let s = scene(
            vec![Finish::default()],
            &[(0, &[nan, far]), (0, &[line, T])],
        );
        let (s, said) = repaired(s);
        assert_eq!(
            (s.triangles.len(), s.surfaces.len(), s.positions.len()),
            (1, 1, 3)
        );
        assert_eq!(s.surfaces[0].name, "part 1");
        assert_eq!(s.source_triangle, [1]);
        assert!(
            said.iter()
                .any(|w| w.contains("'part 0'") && w.contains("(2 of them)")),
            "{said:?}"
        );
        assert!(said.iter().any(|w| w.contains("without area")), "{said:?}");
    }

    fn shining() -> Finish {
        Finish {
            emission: Some(Emission {
                luminance: Rgb::WHITE,
                texture: None,
                group: luxel_core::GroupId(0),
            }),
            ..Finish::default()
        }
    }

    #[test]
    fn a_stray_goes_but_not_a_sun_or_a_sky() {
        let at = |far: f32, size: f32| T.map(|p| p * size + Vec3::X * far);
        let near = [T, TURNED, at(1.0, 1.0)];
        let (s, said) = repaired(scene(
            vec![two_sided(0.5)],
            &[(0, &near), (0, &[at(1e6, 1.0)])],
        ));
        assert_eq!(
            s.triangles.len(),
            2,
            "two are back to back and one, one is lost"
        );
        assert!(said.iter().any(|w| w.contains("farther away")), "{said:?}");
        assert!(!said.iter().any(|w| w.contains("resolves")), "{said:?}");
        let finishes = vec![two_sided(0.5), shining()];
        let kept = [
            // It shines; it fills much of the sky; it is not so far; it reaches to the rest.
            (1, at(1e6, 1.0)),
            (0, at(1e6, 1e6)),
            (0, at(1e3, 1.0)),
            (0, [Vec3::splat(-1e6), Vec3::X * 2e6, Vec3::splat(0.5)]),
        ];
        for (finish, other) in kept {
            let (s, said) = repaired(scene(finishes.clone(), &[(0, &near), (finish, &[other])]));
            assert_eq!(s.triangles.len(), 3, "{said:?}");
            let far = other[1].x > 1e4;
            assert_eq!(said.iter().any(|w| w.contains("resolves")), far, "{said:?}");
        }
    }

    #[test]
    fn of_two_faces_at_one_place_the_brighter_stays() {
        let lamp = shining();
        let s = scene(vec![Finish::default(), lamp], &[(0, &[T]), (1, &[T])]);
        let (s, said) = repaired(s);
        assert_eq!(s.triangles.len(), 1);
        assert!(s.finish_of(0).emission.is_some());
        assert!(said.iter().any(|w| w.contains("coincide")), "{said:?}");
    }

    #[test]
    fn a_wall_between_two_rooms_has_one_face_on_each_side() {
        // Single-sided back to back: as it should be.
        let plain = vec![
            Finish::default(),
            Finish {
                coverage: 0.5,
                ..Finish::default()
            },
        ];
        let (s, said) = repaired(scene(plain, &[(0, &[T]), (1, &[TURNED])]));
        assert_eq!((s.triangles.len(), said.len()), (2, 0));
        // Two-sided and different: each keeps its front.
        let (s, said) = repaired(scene(
            vec![two_sided(0.2), two_sided(0.7)],
            &[(0, &[T]), (1, &[TURNED])],
        ));
        assert_eq!(s.triangles.len(), 2);
        assert!((0..2).all(|t| !s.finish_of(t).back_reflects), "{said:?}");
        assert!(said.iter().any(|w| w.contains("single-sided")), "{said:?}");
        // Two-sided and alike: one is enough.
        let (s, _) = repaired(scene(vec![two_sided(0.2)], &[(0, &[T]), (0, &[TURNED])]));
        assert_eq!(s.triangles.len(), 1);
        assert!(s.finish_of(0).back_reflects);
    }

    #[test]
    fn reflectance_is_bounded_in_factors_and_texels() {
        let mut finish = Finish {
            reflectance: Rgb::new(1.0, 0.5, 0.95),
            ..Finish::default()
        };
        let (s, said) = repaired(scene(vec![finish.clone()], &[(0, &[T])]));
        assert_eq!(s.finishes[0].reflectance, Rgb::new(0.9, 0.5, 0.9));
        assert!(said[0].contains("above 0.9"), "{said:?}");
        finish.texture = Some(TextureId(0));
        let mut s = scene(vec![finish], &[(0, &[T])]);
        s.uvs = vec![[luxel_core::Vec2::ZERO; 3]];
        let texel = vec![[255, 255, 100, 255]];
        s.textures.push(Texture {
            name: "t".into(),
            width: 1,
            height: 1,
            rgba: texel,
            wrap: Default::default(),
        });
        let (s, _) = repaired(s);
        // sRGB 242 is 0.8879 and 243 is 0.8963, 244 is 0.9047 [IEC61966-2-1].
        assert_eq!(s.textures[0].rgba[0], [243, 255, 100, 255]);
        assert_eq!(s.textures.len(), 1);
    }

    #[test]
    fn turned_neighbours_and_t_vertices_are_counted() {
        let up = [Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
        let turned = [up[0], up[2], up[1]];
        let (_, said) = repaired(scene(vec![Finish::default()], &[(0, &[T, up])]));
        assert!(said.is_empty(), "{said:?}");
        let (_, said) = repaired(scene(vec![Finish::default()], &[(0, &[T, turned])]));
        assert!(
            said.iter().any(|w| w.contains("opposite winding")),
            "{said:?}"
        );
        // Below the edge from 0 to x, two triangles that meet in its middle.
        let (m, low) = (Vec3::X * 0.5, Vec3::new(0.5, -1.0, 0.0));
        let below = [[Vec3::ZERO, low, m], [m, low, Vec3::X]];
        let (_, said) = repaired(scene(
            vec![Finish::default()],
            &[(0, &[T, below[0], below[1]])],
        ));
        assert_eq!(
            said,
            ["t: T-vertices, inside the edge of another face, were left"]
        );
    }
}
