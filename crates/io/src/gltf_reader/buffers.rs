//! Bytes of a glTF file: container, buffers, buffer views, accessors.
//!
//! An accessor is checked as a whole against its view before a value is read, with 64-bit
//! arithmetic that cannot overflow. Sparse parts, strides, normalised integers: [GLTF20] 3.6.

use crate::budget::Budget;
use crate::document::{ExternalImage, Resolver};
use crate::error::{Error, Within, clean};
use crate::json::{Json, entry};
use crate::obj_reader::text;
use crate::picture;
use crate::uri;
use serde_json::Value;

/// The two parts of a file.
pub(crate) struct Container<'a> {
    pub json: &'a [u8],
    pub bin: Option<&'a [u8]>,
}

/// Splits a GLB file; any other file is JSON as a whole. [GLTF20] 4.4.
pub(crate) fn container(bytes: &[u8]) -> Result<Container<'_>, Error> {
    if !bytes.starts_with(b"glTF") {
        let json = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let head = String::from_utf8_lossy(&json[..json.len().min(4096)]);
        if text::is_no_text(&head) {
            return Err(Error::new("'glTF' and binary data, or JSON", text::NO_TEXT));
        }
        return Ok(Container { json, bin: None });
    }
    let word = |at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
    };
    let cut = || Error::new("a GLB header of 12 bytes", format!("{} bytes", bytes.len()));
    let (version, length) = (word(4).ok_or_else(cut)?, word(8).ok_or_else(cut)?);
    if version != 2 {
        return Err(Error::new("GLB version 2", version.to_string()).within("header"));
    }
    if (length as usize) > bytes.len() {
        let (expected, found) = (format!("{length} bytes"), format!("{} bytes", bytes.len()));
        return Err(Error::new(expected, found).within("header"));
    }
    let end = length as usize;
    let (mut at, mut json, mut bin) = (12, None, None);
    while at + 8 <= end {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else {
            break;
        };
        let body = at + 8;
        let next = body
            .checked_add(size as usize)
            .filter(|&n| n <= end)
            .ok_or_else(|| {
                let found = format!("{} bytes", end - body);
                Error::new(format!("{size} bytes"), found)
                    .within(format_args!("chunk at byte {at}"))
            })?;
        match (kind, json) {
            (0x4e4f_534a, None) => json = Some(&bytes[body..next]),
            (0x004e_4942, _) if bin.is_none() => bin = Some(&bytes[body..next]),
            _ => {}
        }
        at = next;
    }
    let json = json.ok_or_else(|| Error::new("a JSON chunk", "none"))?;
    Ok(Container { json, bin })
}

/// The buffers of a file.
pub(crate) struct Buffers {
    bytes: Vec<Vec<u8>>,
    /// Bytes of everything together: no array without bytes may be much larger.
    total: u64,
}

/// A buffer view: its bytes and its stride, if it has one.
struct View<'a> {
    bytes: &'a [u8],
    stride: Option<usize>,
}

impl Buffers {
    pub(crate) fn load(
        json: &Value,
        bin: Option<&[u8]>,
        resolver: &Resolver<'_>,
        budget: &mut Budget,
    ) -> Result<Buffers, Error> {
        let mut bytes = Vec::new();
        let mut total = 0u64;
        for index in 0..json.list("buffers")?.len() {
            let mut load = || {
                let buffer = entry(json, "buffers", index)?;
                let length = buffer.whole("byteLength")?;
                let length = length.ok_or_else(|| Error::new("byteLength", "none"))?;
                let data = match buffer.text("uri")? {
                    Some(uri) => bytes_of(uri, resolver, budget)
                        .map_err(|why| Error::new(format!("{length} bytes"), why))?,
                    None if index == 0 && bin.is_some() => {
                        let bin = bin.unwrap_or_default();
                        budget.take(bin.len(), 1)?;
                        bin.to_vec()
                    }
                    // A buffer that compression fills: an error only where it is used.
                    None => return Ok(Vec::new()),
                };
                if data.len() < length {
                    return Err(Error::new(
                        format!("{length} bytes"),
                        format!("{} bytes", data.len()),
                    ));
                }
                Ok(data)
            };
            let data = load().within(|| format!("buffer {index}"))?;
            total += data.len() as u64;
            bytes.push(data);
        }
        Ok(Buffers { bytes, total })
    }

    pub(crate) fn into_bytes(self) -> Vec<Vec<u8>> {
        self.bytes
    }

    fn view<'a>(&'a self, json: &Value, index: usize) -> Result<View<'a>, Error> {
        let look = || {
            let view = entry(json, "bufferViews", index)?;
            let buffer = view
                .whole("buffer")?
                .ok_or_else(|| Error::new("buffer", "none"))?;
            let offset = view.whole("byteOffset")?.unwrap_or(0);
            let length = view
                .whole("byteLength")?
                .ok_or_else(|| Error::new("byteLength", "none"))?;
            let whole = self.bytes.get(buffer).ok_or_else(|| {
                let expected = format!("one of {} buffers", self.bytes.len());
                Error::new(expected, format!("index {buffer}"))
            })?;
            let bytes = offset
                .checked_add(length)
                .and_then(|end| whole.get(offset..end))
                .ok_or_else(|| {
                    let expected = format!("bytes {offset} to {}", offset.saturating_add(length));
                    let compressed = ["EXT_meshopt_compression", "KHR_meshopt_compression"]
                        .into_iter()
                        .find(|name| matches!(view.extension(name), Ok(Some(_))));
                    let found = match compressed {
                        Some(name) => format!("{name}, which is not read"),
                        None => format!("{} bytes in buffer {buffer}", whole.len()),
                    };
                    Error::new(expected, found)
                })?;
            Ok(View {
                bytes,
                stride: view.whole("byteStride")?,
            })
        };
        look().within(|| format!("bufferView {index}"))
    }

    /// Bytes of a buffer view, for a picture.
    pub(crate) fn view_bytes(&self, json: &Value, index: usize) -> Result<&[u8], Error> {
        Ok(self.view(json, index)?.bytes)
    }
}

/// Bytes of a URI: in it, or in a file beside.
fn bytes_of(uri: &str, resolver: &Resolver<'_>, budget: &mut Budget) -> Result<Vec<u8>, String> {
    let bytes = match uri::data(uri) {
        Some(data) => {
            if uri.len() as u64 > budget.left() {
                return Err("more than the memory that may be used".into());
            }
            data?
        }
        None => {
            let name = uri::percent_decoded(uri);
            resolver(&name, budget.left()).map_err(|why| format!("'{}': {why}", clean(&name)))?
        }
    };
    budget.take(bytes.len(), 1).map_err(|e| e.found)?;
    Ok(bytes)
}

/// Pictures in files beside the glTF file, read when first asked for.
pub(crate) struct ExternalImages<'a> {
    uris: Vec<Option<String>>,
    files: Vec<Option<Result<Vec<u8>, String>>>,
    resolver: &'a Resolver<'a>,
}

impl<'a> ExternalImages<'a> {
    pub(crate) fn new(json: &Value, resolver: &'a Resolver<'a>) -> Result<Self, Error> {
        let mut uris = Vec::new();
        for index in 0..json.list("images")?.len() {
            // A picture that nothing uses may be wrong.
            let uri = entry(json, "images", index).and_then(|i| i.text("uri"));
            uris.push(uri.ok().flatten().map(str::to_owned));
        }
        let files = vec![None; uris.len()];
        Ok(ExternalImages {
            uris,
            files,
            resolver,
        })
    }

    /// Bytes of image `index`, which has a URI, or why not.
    pub(crate) fn get(&mut self, index: usize, budget: &mut Budget) -> Result<&[u8], String> {
        let uri = self
            .uris
            .get(index)
            .and_then(|u| u.as_deref())
            .ok_or("no URI")?;
        let resolver = self.resolver;
        self.files[index]
            .get_or_insert_with(|| bytes_of(uri, resolver, budget))
            .as_ref()
            .map(Vec::as_slice)
            .map_err(Clone::clone)
    }

    /// All pictures that lie in files of their own, for a writer.
    pub(crate) fn into_all(mut self, budget: &mut Budget) -> Vec<Option<ExternalImage>> {
        for index in 0..self.uris.len() {
            let beside = self.uris[index]
                .as_deref()
                .is_some_and(|u| uri::data(u).is_none());
            if beside {
                // Why a picture without use cannot be read is nobody's concern.
                let _ = self.get(index, budget);
            } else {
                self.files[index] = None;
            }
        }
        let known =
            |bytes: Vec<u8>| picture::mime(&bytes).map(|mime| ExternalImage { mime, bytes });
        self.files
            .into_iter()
            .map(|f| f.and_then(Result::ok).and_then(known))
            .collect()
    }
}

/// Type of a component.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(code: usize) -> Option<Component> {
        use Component::*;
        Some(match code {
            5120 => I8,
            5121 => U8,
            5122 => I16,
            5123 => U16,
            5125 => U32,
            5126 => F32,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Component::I8 | Component::U8 => 1,
            Component::I16 | Component::U16 => 2,
            Component::U32 | Component::F32 => 4,
        }
    }

    /// The value at the start of `b`, which holds at least `size` bytes. Normalised as
    /// [GLTF20] 3.6.2.2 says.
    fn value(self, b: &[u8], normalized: bool) -> f32 {
        let (v, largest) = match self {
            Component::I8 => (b[0] as i8 as f64, 127.0),
            Component::U8 => (b[0] as f64, 255.0),
            Component::I16 => (i16::from_le_bytes([b[0], b[1]]) as f64, 32767.0),
            Component::U16 => (u16::from_le_bytes([b[0], b[1]]) as f64, 65535.0),
            Component::U32 => (
                u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f64,
                4294967295.0,
            ),
            Component::F32 => return f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        };
        if normalized {
            (v / largest).max(-1.0) as f32
        } else {
            v as f32
        }
    }

    /// The whole number at the start of `b`, for unsigned types.
    fn whole(self, b: &[u8]) -> u32 {
        match self {
            Component::U16 => u16::from_le_bytes([b[0], b[1]]) as u32,
            Component::U32 => u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            _ => b[0] as u32,
        }
    }
}

/// Bytes of `count` things of `size` bytes, `stride` apart, all of them there.
struct Strip<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
}

impl<'a> Strip<'a> {
    fn new(view: View<'a>, offset: usize, count: usize, size: usize) -> Result<Self, Error> {
        let stride = view.stride.unwrap_or(size);
        if stride < size {
            let found = format!("byteStride {stride}");
            return Err(Error::new(
                format!("a stride of at least {size} bytes"),
                found,
            ));
        }
        // offset + (count - 1) * stride + size
        let need = (count as u64)
            .saturating_sub(1)
            .saturating_mul(stride as u64)
            .saturating_add(if count > 0 { size as u64 } else { 0 })
            .saturating_add(offset as u64);
        if need > view.bytes.len() as u64 {
            let found = format!("{} bytes in its buffer view", view.bytes.len());
            return Err(Error::new(
                format!("{need} bytes for {count} values"),
                found,
            ));
        }
        Ok(Strip {
            bytes: &view.bytes[offset..],
            stride,
            size,
        })
    }

    fn at(&self, index: usize) -> &'a [u8] {
        &self.bytes[index * self.stride..index * self.stride + self.size]
    }
}

/// An accessor whose bytes were all found to be there.
pub(crate) struct Accessor<'a> {
    pub count: usize,
    pub width: usize,
    component: Component,
    normalized: bool,
    base: Option<Strip<'a>>,
    sparse: Option<(usize, Component, Strip<'a>, Strip<'a>)>,
}

/// Number of components of each type that attributes have.
fn width_of(name: &str) -> Option<usize> {
    Some(match name {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" | "MAT2" => 4,
        "MAT3" => 9,
        "MAT4" => 16,
        _ => return None,
    })
}

impl<'a> Accessor<'a> {
    /// Accessor `index`, which must be of one of the `types` (`SCALAR`, `VEC3`, ...).
    pub(crate) fn new(
        json: &Value,
        buffers: &'a Buffers,
        index: usize,
        types: &[&str],
    ) -> Result<Accessor<'a>, Error> {
        let look = || {
            let a = entry(json, "accessors", index)?;
            let code = a.whole("componentType")?;
            let code = code.ok_or_else(|| Error::new("componentType", "none"))?;
            let component = Component::of(code)
                .ok_or_else(|| Error::new("componentType 5120 to 5126", code.to_string()))?;
            let kind = a
                .text("type")?
                .ok_or_else(|| Error::new("a type", "none"))?;
            let width = width_of(kind)
                .filter(|_| types.contains(&kind))
                .ok_or_else(|| Error::new(types.join(" or "), format!("'{kind}'")))?;
            let count = a
                .whole("count")?
                .ok_or_else(|| Error::new("count", "none"))?;
            let offset = a.whole("byteOffset")?.unwrap_or(0);
            let size = component.size() * width;
            let base = a
                .whole("bufferView")?
                .map(|v| Strip::new(buffers.view(json, v)?, offset, count, size))
                .transpose()?;
            // Zeros without bytes: as many as a file of this size could have a use for.
            if base.is_none() && count as u64 > 65536 + 16 * buffers.total {
                return Err(Error::new(
                    "a bufferView",
                    format!("{count} values without one"),
                ));
            }
            let sparse = match a.object("sparse")? {
                None => None,
                Some(s) => Some(Self::sparse(json, buffers, s, count, size).within(|| "sparse")?),
            };
            let normalized = a.flag("normalized")? && component != Component::F32;
            Ok(Accessor {
                count,
                width,
                component,
                normalized,
                base,
                sparse,
            })
        };
        look().within(|| format!("accessor {index}"))
    }

    fn sparse(
        json: &Value,
        buffers: &'a Buffers,
        sparse: &Value,
        all: usize,
        size: usize,
    ) -> Result<(usize, Component, Strip<'a>, Strip<'a>), Error> {
        let count = sparse
            .whole("count")?
            .ok_or_else(|| Error::new("count", "none"))?;
        if count > all {
            return Err(Error::new(
                format!("at most {all} values"),
                count.to_string(),
            ));
        }
        let strip = |key: &str, size: usize| {
            let part = sparse.object(key)?.ok_or_else(|| Error::new(key, "none"))?;
            let view = part
                .whole("bufferView")?
                .ok_or_else(|| Error::new("bufferView", "none"))?;
            let offset = part.whole("byteOffset")?.unwrap_or(0);
            Strip::new(buffers.view(json, view)?, offset, count, size).within(|| key.to_owned())
        };
        let code = sparse
            .object("indices")?
            .map(|i| i.whole("componentType"))
            .transpose()?;
        let kind = code
            .flatten()
            .and_then(Component::of)
            .filter(|k| matches!(k, Component::U8 | Component::U16 | Component::U32))
            .ok_or_else(|| {
                Error::new(
                    "indices of an unsigned type",
                    format!("{:?}", code.flatten()),
                )
            })?;
        let places = strip("indices", kind.size())?;
        for k in 0..count {
            let place = kind.whole(places.at(k)) as usize;
            if place >= all {
                return Err(Error::new(
                    format!("indices below {all}"),
                    place.to_string(),
                ));
            }
        }
        Ok((count, kind, places, strip("values", size)?))
    }

    /// All values, `count * width`, floats and normalised or plain integers alike.
    pub(crate) fn floats(&self, budget: &mut Budget) -> Result<Vec<f32>, Error> {
        let w = self.width;
        budget.take(self.count, w * 4)?;
        let mut out = vec![0.0; self.count * w];
        let size = self.component.size();
        let read = |to: &mut [f32], from: &[u8]| {
            for (slot, bytes) in to.iter_mut().zip(from.chunks_exact(size)) {
                *slot = self.component.value(bytes, self.normalized);
            }
        };
        if let Some(base) = &self.base {
            for (k, to) in out.chunks_exact_mut(w).enumerate() {
                read(to, base.at(k));
            }
        }
        if let Some((count, kind, places, values)) = &self.sparse {
            for k in 0..*count {
                let place = kind.whole(places.at(k)) as usize;
                read(&mut out[place * w..(place + 1) * w], values.at(k));
            }
        }
        Ok(out)
    }

    /// All values as indices below `bound`.
    pub(crate) fn indices(&self, bound: usize, budget: &mut Budget) -> Result<Vec<u32>, Error> {
        let unsigned = matches!(
            self.component,
            Component::U8 | Component::U16 | Component::U32
        );
        if !unsigned {
            return Err(Error::new(
                "indices of an unsigned type",
                format!("{:?}", self.component),
            ));
        }
        budget.take(self.count, 4)?;
        let mut out = vec![0; self.count];
        if let Some(base) = &self.base {
            for (k, slot) in out.iter_mut().enumerate() {
                *slot = self.component.whole(base.at(k));
            }
        }
        if let Some((count, kind, places, values)) = &self.sparse {
            for k in 0..*count {
                out[kind.whole(places.at(k)) as usize] = self.component.whole(values.at(k));
            }
        }
        match out.iter().find(|&&i| i as usize >= bound) {
            Some(i) => Err(Error::new(format!("indices below {bound}"), i.to_string())),
            None => Ok(out),
        }
    }

    /// Whether there are bytes behind it.
    pub(crate) fn has_bytes(&self) -> bool {
        self.base.is_some() || self.sparse.is_some()
    }
}
