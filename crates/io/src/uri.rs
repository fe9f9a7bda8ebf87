//! Names of other files in a scene file: percent signs, `data:` and paths that stay inside.

use std::path::{Component, PathBuf};

/// The path of a name beside the scene file, or why it is refused.
///
/// A scene file from elsewhere must not pull in what lies outside its folder: a picture of it
/// would end up in the lit file.
pub(crate) fn path_inside(name: &str) -> Result<PathBuf, String> {
    let refuse = |why: &str| Err(why.to_owned());
    let text = name.replace('\\', "/");
    if text.contains("://") {
        return refuse("an address on the network");
    }
    let drive = text.as_bytes().get(1) == Some(&b':');
    if text.starts_with('/') || drive || text.contains('\0') {
        return refuse("not a path beside the file");
    }
    let mut path = PathBuf::new();
    for part in std::path::Path::new(&text).components() {
        match part {
            Component::Normal(p) => path.push(p),
            Component::CurDir => {}
            Component::ParentDir => {
                if !path.pop() {
                    return refuse("a path that leaves the folder of the file");
                }
            }
            _ => return refuse("not a path beside the file"),
        }
    }
    if path.as_os_str().is_empty() {
        refuse("no name of a file")
    } else {
        Ok(path)
    }
}

/// A URI with its `%20`s turned into bytes [RFC3986]; what is no escape stays.
pub(crate) fn percent_decoded(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        let digit = |at: usize| bytes.get(at).and_then(|&b| (b as char).to_digit(16));
        match (bytes[i], digit(i + 1), digit(i + 2)) {
            (b'%', Some(high), Some(low)) => {
                out.push((high * 16 + low) as u8);
                i += 3;
            }
            (b, ..) => {
                out.push(b);
                i += 1;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// The bytes of a `data:` URI, or why not; `None` when it is another kind of URI.
pub(crate) fn data(uri: &str) -> Option<Result<Vec<u8>, String>> {
    let rest = uri
        .get(..5)
        .filter(|s| s.eq_ignore_ascii_case("data:"))
        .map(|_| &uri[5..])?;
    Some(match rest.split_once(',') {
        None => Err("data URI without a comma".into()),
        Some((head, body)) if head.trim_end().ends_with(";base64") => base64(body),
        Some((_, body)) => Ok(percent_decoded(body).into_bytes()),
    })
}

/// Base64 [RFC4648], both alphabets; blanks and padding are passed over.
fn base64(text: &str) -> Result<Vec<u8>, String> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 3);
    let (mut word, mut bits) = (0u32, 0);
    for (i, c) in text.bytes().enumerate() {
        let six = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'=' => break,
            b' ' | b'\t' | b'\r' | b'\n' => continue,
            _ => return Err(format!("no base64 at character {i}")),
        };
        word = (word << 6) | six as u32;
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            out.push((word >> bits) as u8);
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_test_vectors_of_rfc_4648() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(coded).unwrap(), plain.as_bytes());
        }
        assert!(base64("Zm9v!").is_err());
    }

    #[test]
    fn paths_stay_beside_the_file() {
        assert_eq!(
            path_inside("a/../b c.png").unwrap(),
            PathBuf::from("b c.png")
        );
        assert_eq!(path_inside("./a\\b.png").unwrap(), PathBuf::from("a/b.png"));
        for bad in [
            "../x",
            "/etc/passwd",
            "a/../../x",
            "C:\\x.png",
            "http://x/y",
            "",
            "a\0b",
        ] {
            assert!(path_inside(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn percent_signs_that_are_no_escapes_stay() {
        assert_eq!(percent_decoded("a%20b%zz%4"), "a b%zz%4");
        assert_eq!(data("data:,a%20b").unwrap().unwrap(), b"a b");
        assert!(data("é.png").is_none());
    }
}
