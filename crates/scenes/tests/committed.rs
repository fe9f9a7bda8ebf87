//! The scenes in `scenes/` are those that the code makes, and sound glTF binaries.

use std::path::Path;

#[test]
fn committed_scenes_are_what_the_code_makes() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    for (name, made) in luxel_scenes::committed() {
        let path = folder.join(name).with_extension("glb");
        let stored = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert!(
            stored == made,
            "{name}.glb differs: run `cargo run -p luxel-scenes --bin make-scenes -- scenes`"
        );
        assert!(made.len() < 1_500_000, "{name}.glb is {} bytes", made.len());
    }
}

#[test]
fn container_lengths_and_accessors_add_up() {
    for (name, bytes) in luxel_scenes::committed() {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(&bytes[..4], b"glTF");
        assert_eq!((word(4), word(8)), (2, bytes.len()), "{name}");
        let json_length = word(12);
        assert_eq!(&bytes[16..20], b"JSON");
        let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + json_length]).unwrap();
        let binary = 20 + json_length;
        assert_eq!(word(binary) + binary + 8, bytes.len());
        let end = json["buffers"][0]["byteLength"].as_u64().unwrap();
        for view in json["bufferViews"].as_array().unwrap() {
            let offset = view["byteOffset"].as_u64().unwrap();
            assert!(offset % 4 == 0 && offset + view["byteLength"].as_u64().unwrap() <= end);
        }
        let corners: u64 = json["meshes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|m| m["primitives"][0]["indices"].as_u64().unwrap() as usize)
            .map(|i| json["accessors"][i]["count"].as_u64().unwrap())
            .sum();
        let scene = match name {
            "two-rooms" => luxel_scenes::two_rooms(),
            "cornell" => luxel_scenes::cornell(),
            "office" => luxel_scenes::office(),
            _ => luxel_scenes::gallery(),
        };
        assert_eq!(corners as usize, 3 * scene.triangles.len(), "{name}");
    }
}
