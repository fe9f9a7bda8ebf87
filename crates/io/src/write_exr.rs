//! Pages of a lightmap as OpenEXR: illuminance in lux, linear RGB with Rec. 709 primaries.
//!
//! Half floats (three digits and a half, under a 255th of anything shown) while the light is below
//! their largest number, else full floats; ZIP compression in blocks of 16 lines, which every reader
//! knows.
//!
//! Source: [OpenEXR3].

use crate::atomic;
use exr::prelude::{
    Compression, Encoding, Image, Layer, LayerAttributes, LineOrder, SpecificChannels, Text, Vec2,
    WritableImage, f16,
};
use luxel_core::Rgb;
use std::io::{self, Cursor};
use std::path::Path;

/// Half floats end at 65,504.
const MOST_HALF: f32 = 65_000.0;

/// Writes rows of texels from the top, whole or not at all. `texels.len() == width * height`.
pub fn write_exr(path: &Path, size: [u32; 2], texels: &[Rgb]) -> io::Result<()> {
    let [w, h] = size.map(|s| s as usize);
    debug_assert_eq!(texels.len(), w * h);
    let at = |p: Vec2<usize>| {
        let texel = texels[p.y() * w + p.x()].to_array();
        texel.map(|v| if v.is_finite() { v } else { 0.0 })
    };
    let is_small = texels.iter().all(|t| t.max_band() < MOST_HALF);
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: exr::prelude::Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let named = LayerAttributes::named(Text::from("illuminance in lux"));
    let mut bytes = Cursor::new(Vec::new());
    let written = if is_small {
        let half = |p| {
            let [r, g, b] = at(p).map(f16::from_f32);
            (r, g, b)
        };
        let layer = Layer::new((w, h), named, encoding, SpecificChannels::rgb(half));
        Image::from_layer(layer).write().to_buffered(&mut bytes)
    } else {
        let full = |p| {
            let [r, g, b] = at(p);
            (r, g, b)
        };
        let layer = Layer::new((w, h), named, encoding, SpecificChannels::rgb(full));
        Image::from_layer(layer).write().to_buffered(&mut bytes)
    };
    written.map_err(io::Error::other)?;
    atomic::write(path, bytes.get_ref())
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::read_first_rgba_layer_from_file;

    fn read(path: &Path, w: usize) -> Vec<[f32; 3]> {
        let image = read_first_rgba_layer_from_file(
            path,
            |size, _| vec![[0.0f32; 3]; size.area()],
            move |pixels, p, (r, g, b, _): (f32, f32, f32, f32)| {
                pixels[p.y() * w + p.x()] = [r, g, b];
            },
        );
        image.expect("readable").layer_data.channel_data.pixels
    }

    #[test]
    fn texels_are_read_back_within_half_floats_and_bright_ones_exactly() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("page.exr");
        let texels: Vec<Rgb> = (0..15)
            .map(|k| Rgb::new(k as f32 * 123.4, 0.37, 500.0 - k as f32))
            .collect();
        write_exr(&path, [5, 3], &texels).expect("written");
        for (a, b) in texels.iter().zip(read(&path, 5)) {
            for (a, b) in a.to_array().iter().zip(b) {
                assert!((a - b).abs() <= a * 5e-4, "{a} became {b}");
            }
        }
        let bright = vec![Rgb::new(98_765.43, 1.0e-3, f32::NAN); 4];
        write_exr(&path, [2, 2], &bright).expect("written");
        assert_eq!(read(&path, 2)[3], [98_765.43, 1.0e-3, 0.0]);
    }
}
