//! glTF 2.0 and GLB into a scene [GLTF20].
//!
//! The JSON is walked as it is, member by member, and every count is held against the bytes
//! that are there: so a mistake is reported with its place, what a writer must keep is kept, and
//! parts that light does not need (animations, physics) may be as odd as they like.
//!
//! Read as light: base colour (factor x texture x COLOR_0) is the diffuse reflectance whatever
//! the metallic factor; emissive factor x texture x `KHR_materials_emissive_strength` is a
//! luminance in cd/m². A face blocks light from both sides. A single-sided back is black and
//! dark; a double-sided face reflects and emits on both sides. A mirrored node turns the
//! winding. Shading is flat.
//!
//! - `buffers`: the container, buffers, buffer views, accessors
//! - `geometry`: primitives into triangles
//! - `materials`: finishes and textures
//! - `lights`: punctual lights and cameras

mod buffers;
mod geometry;
mod lights;
mod materials;

use crate::assemble::{Assembly, SurfaceOrigin};
use crate::budget::Budget;
use crate::document::{Document, GltfSource, Resolver, Source};
use crate::error::{Error, Within};
use crate::json::{Json, as_whole, entry, found};
use crate::options::ReadOptions;
use buffers::Buffers;
use geometry::{Meshes, Primitive};
use luxel_core::glam::{DMat3, DMat4, DQuat, DVec3};
use luxel_core::{Scene, Vec3, Warnings};
use materials::Materials;
use serde_json::{Map, Value};

/// Extensions that are read, or that change nothing that diffuse light would see.
const KNOWN: [&str; 17] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_transmission",
    "KHR_materials_ior",
    "KHR_materials_volume",
    "KHR_materials_specular",
    "KHR_materials_clearcoat",
    "KHR_materials_sheen",
    "KHR_materials_iridescence",
    "KHR_materials_anisotropy",
    "KHR_materials_dispersion",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_texture_transform",
    "KHR_mesh_quantization",
    "KHR_xmp_json_ld",
    "KHR_animation_pointer",
];

/// Extensions that a file may require although we cannot decode them: the picture is left out.
const PICTURES: [&str; 4] = [
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
];

/// Reads a glTF file, text or binary.
pub(crate) fn read(
    file: &str,
    bytes: Vec<u8>,
    resolver: &Resolver<'_>,
    options: &ReadOptions,
    budget: &mut Budget,
) -> Result<Document, Error> {
    let container = buffers::container(&bytes)?;
    let json = json_of(container.json, budget)?;
    let mut assembly = Assembly::new(file, options);
    check_head(&json, &mut assembly)?;
    let buffers = Buffers::load(&json, container.bin, resolver, budget)?;
    drop(bytes);
    let mut images = buffers::ExternalImages::new(&json, resolver)?;
    read_scene(&json, &buffers, &mut images, &mut assembly, budget)?;
    let source = GltfSource {
        images: images.into_all(budget),
        buffers: buffers.into_bytes(),
        scale: options.scale,
        json,
    };
    assembly.finish(Source::Gltf(Box::new(source)))
}

/// Reads the triangles of a glTF file as they are: every one, in the order of nodes, primitives
/// and indices, with the names of their surfaces and finishes. No repairs, no light, no pictures.
pub(crate) fn read_triangles(
    file: &str,
    bytes: &[u8],
    resolver: &Resolver<'_>,
    options: &ReadOptions,
    budget: &mut Budget,
) -> Result<(Scene, Warnings), Error> {
    let container = buffers::container(bytes)?;
    let mut json = json_of(container.json, budget)?;
    keep_geometry(&mut json);
    let mut assembly = Assembly::new(file, options);
    check_head(&json, &mut assembly)?;
    let buffers = Buffers::load(&json, container.bin, resolver, budget)?;
    let mut images = buffers::ExternalImages::new(&json, resolver)?;
    read_scene(&json, &buffers, &mut images, &mut assembly, budget)?;
    Ok((assembly.scene, assembly.warnings))
}

/// Takes out what has no place: what is not there cannot be wrong.
fn keep_geometry(json: &mut Value) {
    let Some(whole) = json.as_object_mut() else {
        return;
    };
    for key in ["images", "textures", "cameras", "extensionsUsed"] {
        whole.remove(key);
    }
    let mut each = |key: &str, change: &dyn Fn(&mut Map<String, Value>)| {
        let list = whole.get_mut(key).and_then(Value::as_array_mut);
        for value in list.into_iter().flatten() {
            value.as_object_mut().map(change);
        }
    };
    each("materials", &|material| {
        material.retain(|key, _| key == "name")
    });
    each("nodes", &|node| {
        node.remove("camera");
        node.remove("extensions");
    });
    each("meshes", &|mesh| {
        let list = mesh.get_mut("primitives").and_then(Value::as_array_mut);
        for primitive in list.into_iter().flatten() {
            let attributes = primitive.get_mut("attributes");
            if let Some(attributes) = attributes.and_then(Value::as_object_mut) {
                attributes.retain(|key, _| key == "POSITION");
            }
        }
    });
}

fn json_of(text: &[u8], budget: &mut Budget) -> Result<Value, Error> {
    // A JSON value takes up to about twelve times its text.
    budget.take(text.len(), 12)?;
    serde_json::from_slice(text).map_err(|e| {
        let message = e.to_string();
        let what = message.split(" at line ").next().unwrap_or(&message);
        Error::new("JSON", format!("what is none ({what})")).at_line(e.line())
    })
}

/// Version and required extensions.
fn check_head(json: &Value, assembly: &mut Assembly<'_>) -> Result<(), Error> {
    if !json.is_object() {
        return Err(Error::new("a glTF object", found(json)));
    }
    let asset = json
        .object("asset")?
        .ok_or_else(|| Error::new("asset", "none"))?;
    let version = asset.text("version").within(|| "asset")?;
    let version = version.ok_or_else(|| Error::new("a version", "none").within("asset"))?;
    if version.split('.').next() != Some("2") {
        return Err(Error::new("glTF 2", format!("version '{version}'")).within("asset"));
    }
    let names = |key: &str| -> Result<Vec<String>, Error> {
        json.list(key)?
            .iter()
            .map(|v| match v.as_str() {
                Some(name) => Ok(name.to_owned()),
                None => Err(Error::new("the name of an extension", found(v)).within(key)),
            })
            .collect()
    };
    for name in names("extensionsRequired")? {
        let known = KNOWN.contains(&name.as_str()) || PICTURES.contains(&name.as_str());
        if !known {
            let expected = "only extensions that are read here";
            return Err(
                Error::new(expected, format!("required {name}")).within("extensionsRequired")
            );
        }
    }
    for name in names("extensionsUsed")? {
        if !KNOWN.contains(&name.as_str()) {
            assembly.warn("", format!("extension {name} is ignored"), 1);
        }
    }
    for name in ["skins", "animations"] {
        let count = json.list(name)?.len();
        assembly.warn(
            "",
            format!("{name} are ignored: everything stands as its nodes do"),
            count,
        );
    }
    Ok(())
}

/// A node with something in it, placed.
struct Placed<'a> {
    index: usize,
    node: &'a Value,
    world: DMat4,
}

fn read_scene(
    json: &Value,
    buffers: &Buffers,
    images: &mut buffers::ExternalImages<'_>,
    assembly: &mut Assembly<'_>,
    budget: &mut Budget,
) -> Result<(), Error> {
    let placed = placed_nodes(json, assembly)?;
    let mut materials = Materials::new(json);
    let mut meshes = Meshes::new(json);
    let scale = assembly.options().scale as f64;
    for Placed { index, node, world } in placed {
        let world = DMat4::from_scale(DVec3::splat(scale)) * world;
        let place = format!("node {index}");
        if let Some(mesh) = node.whole("mesh").within(|| &place)? {
            entry(json, "meshes", mesh).within(|| &place)?;
            let primitives =
                meshes.primitives(mesh, &mut materials, buffers, images, assembly, budget)?;
            let shared = meshes.name(mesh);
            let name = node.name().or(shared).unwrap_or_else(|| place.clone());
            for primitive in primitives.iter() {
                place_primitive(
                    index,
                    mesh,
                    &name,
                    primitives.len(),
                    primitive,
                    world,
                    assembly,
                    budget,
                )
                .within(|| &place)?;
            }
        }
        if let Some(camera) = node.whole("camera").within(|| &place)? {
            lights::camera(json, camera, node, index, world, assembly).within(|| &place)?;
        }
        lights::luminaire(json, node, index, world, scale, assembly).within(|| &place)?;
    }
    Ok(())
}

/// One primitive of one node into the scene.
fn place_primitive(
    node: usize,
    mesh: usize,
    name: &str,
    siblings: usize,
    primitive: &Primitive,
    world: DMat4,
    assembly: &mut Assembly<'_>,
    budget: &mut Budget,
) -> Result<(), Error> {
    let first = assembly.add_positions(
        primitive.positions.iter().map(|p| {
            let p = world.transform_point3(Vec3::from(*p).as_dvec3());
            // 0.0 + makes one zero of two, so that equal places have equal bits.
            (p + DVec3::ZERO).as_vec3()
        }),
        budget,
    )?;
    let name = match siblings {
        1 => name.to_owned(),
        _ => format!(
            "{name}, {}",
            assembly.scene.finishes[primitive.finish.index()].name
        ),
    };
    let origin = SurfaceOrigin {
        name,
        node: node as u32,
        mesh: mesh as u32,
        primitive: primitive.index,
    };
    // [GLTF20] 3.7.4: a negative determinant turns the winding.
    let mirrored = DMat3::from_mat4(world).determinant() < 0.0;
    let turn = |[a, b, c]: [u32; 3]| if mirrored { [a, c, b] } else { [a, b, c] };
    let triangles = primitive
        .triangles
        .iter()
        .enumerate()
        .map(|(k, t)| (turn(*t).map(|i| i + first), k as u32));
    if mirrored {
        let turned: Vec<_> = primitive.uvs.iter().map(|&[a, b, c]| [a, c, b]).collect();
        assembly.add_surface(origin, primitive.finish, triangles, &turned, budget)
    } else {
        assembly.add_surface(origin, primitive.finish, triangles, &primitive.uvs, budget)
    }
}

/// The nodes of the default scene, parents before children, in file order.
///
/// Without a scene: all nodes, from those that are nobody's child.
fn placed_nodes<'a>(
    json: &'a Value,
    assembly: &mut Assembly<'_>,
) -> Result<Vec<Placed<'a>>, Error> {
    let nodes = json.list("nodes")?;
    let scenes = json.list("scenes")?;
    let children = |index: usize| -> Result<Vec<usize>, Error> {
        let node = entry(json, "nodes", index)?;
        node.list("children")?
            .iter()
            .map(|v| as_whole(v).ok_or_else(|| Error::new("the index of a node", found(v))))
            .collect::<Result<_, _>>()
            .within(|| format!("node {index}, children"))
    };
    let roots: Vec<usize> = if scenes.is_empty() {
        let mut is_child = vec![false; nodes.len()];
        for index in 0..nodes.len() {
            for child in children(index)? {
                if let Some(slot) = is_child.get_mut(child) {
                    *slot = true;
                }
            }
        }
        (0..nodes.len()).filter(|&i| !is_child[i]).collect()
    } else {
        let chosen = json.whole("scene")?.unwrap_or(0);
        if scenes.len() > 1 {
            let what = format!("only scene {chosen} of {} is read", scenes.len());
            assembly.warn("", what, 1);
        }
        entry(json, "scenes", chosen)?
            .list("nodes")?
            .iter()
            .map(|v| as_whole(v).ok_or_else(|| Error::new("the index of a node", found(v))))
            .collect::<Result<_, _>>()
            .within(|| format!("scene {chosen}, nodes"))?
    };
    let mut seen = vec![false; nodes.len()];
    let mut out = Vec::new();
    let mut stack: Vec<(usize, DMat4)> =
        roots.iter().rev().map(|&n| (n, DMat4::IDENTITY)).collect();
    while let Some((index, parent)) = stack.pop() {
        let node = entry(json, "nodes", index)?;
        if std::mem::replace(&mut seen[index], true) {
            // A loop, or a tree of shared children that would unfold without end.
            let found = "a second parent or a loop";
            return Err(Error::new("a tree of nodes", found).within(format_args!("node {index}")));
        }
        let world = parent * local(node, index, assembly).within(|| format!("node {index}"))?;
        for child in children(index)?.into_iter().rev() {
            stack.push((child, world));
        }
        out.push(Placed { index, node, world });
    }
    Ok(out)
}

/// Parent from node.
fn local(node: &Value, index: usize, assembly: &mut Assembly<'_>) -> Result<DMat4, Error> {
    if let Some(m) = node.numbers::<16>("matrix")? {
        return Ok(DMat4::from_cols_array(&m));
    }
    let translation = node.numbers("translation")?.unwrap_or([0.0; 3]);
    let scale = node.numbers("scale")?.unwrap_or([1.0; 3]);
    let rotation = DQuat::from_array(node.numbers("rotation")?.unwrap_or([0.0, 0.0, 0.0, 1.0]));
    let length = rotation.length();
    if (length - 1.0).abs() > 1e-3 {
        let what = format!("rotation of length {length:.3} was made a unit quaternion");
        assembly.warn(&format!("node {index}"), what, 1);
    }
    let rotation = if length > 1e-12 {
        rotation / length
    } else {
        DQuat::IDENTITY
    };
    Ok(DMat4::from_scale_rotation_translation(
        DVec3::from_array(scale),
        rotation,
        DVec3::from_array(translation),
    ))
}
