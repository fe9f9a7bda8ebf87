//! Pictures out of their files, with size and memory bounded before anything is decoded.

use crate::budget::Budget;
use image::{ImageFormat, ImageReader, Limits};
use std::io::Cursor;

/// A decoded picture: 8-bit RGBA, row by row from the top left.
pub(crate) struct Picture {
    pub width: u32,
    pub height: u32,
    pub rgba: Vec<[u8; 4]>,
}

/// Largest picture, texels: 256 MB decoded.
const MOST_TEXELS: u64 = 1 << 26;

/// Texels that a byte of a file can stand for at most. Deflate shrinks to 1/1032 at best, with
/// 8 one-bit texels a byte; progressive JPEG can skip 32,767 blocks in a few bytes, but no
/// encoder makes such a picture of a scene.
const MOST_TEXELS_A_BYTE: u64 = 8300;

/// Media type by the first bytes, for formats that glTF files carry.
pub(crate) fn mime(bytes: &[u8]) -> Option<&'static str> {
    const MAGIC: [(&[u8], &str); 5] = [
        (b"\x89PNG\r\n\x1a\n", "image/png"),
        (b"\xff\xd8\xff", "image/jpeg"),
        (b"\xabKTX 20\xbb", "image/ktx2"),
        (b"DDS ", "image/vnd-ms.dds"),
        (b"BM", "image/bmp"),
    ];
    if bytes.len() >= 12 && &bytes[..4] == b"RIFF" && &bytes[8..12] == b"WEBP" {
        return Some("image/webp");
    }
    MAGIC
        .iter()
        .find(|(magic, _)| bytes.starts_with(magic))
        .map(|(_, mime)| *mime)
}

/// Decodes a PNG or JPEG file, or says why not.
pub(crate) fn decode(bytes: &[u8], budget: &mut Budget) -> Result<Picture, String> {
    let format = match mime(bytes) {
        Some("image/png") => ImageFormat::Png,
        Some("image/jpeg") => ImageFormat::Jpeg,
        Some(other) => return Err(format!("{other} is not read, only PNG and JPEG")),
        None => return Err("no PNG or JPEG picture".into()),
    };
    let reader = || ImageReader::with_format(Cursor::new(bytes), format);
    let (width, height) = reader().into_dimensions().map_err(|e| e.to_string())?;
    let texels = width as u64 * height as u64;
    let bound = MOST_TEXELS.min((bytes.len() as u64).saturating_mul(MOST_TEXELS_A_BYTE));
    if texels == 0 || texels > bound {
        return Err(format!(
            "{width} x {height} texels in {} bytes",
            bytes.len()
        ));
    }
    // The decoder holds up to 8 bytes a texel, the result 4 more.
    budget
        .take(texels as usize, 12)
        .map_err(|e| format!("too large: {}", e.found))?;
    let mut limits = Limits::default();
    limits.max_alloc = Some(texels * 16 + (1 << 24));
    let mut decoder = reader();
    decoder.limits(limits);
    let decoded = decoder.decode();
    budget.give_back(texels as usize, 8);
    let raw = decoded.map_err(|e| {
        budget.give_back(texels as usize, 4);
        e.to_string()
    })?;
    let raw = raw.into_rgba8();
    let rgba = raw
        .as_raw()
        .chunks_exact(4)
        .map(|t| [t[0], t[1], t[2], t[3]])
        .collect();
    Ok(Picture {
        width,
        height,
        rgba,
    })
}
