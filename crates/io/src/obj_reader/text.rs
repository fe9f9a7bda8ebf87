//! Text of files: encodings, line ends; continued lines and comments of OBJ and MTL.

use std::borrow::Cow;

/// The text of a file: UTF-8, or UTF-16 with a byte-order mark; what is neither becomes U+FFFD.
pub(crate) fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    let sixteen = |bytes: &[u8], word: fn([u8; 2]) -> u16| {
        let words = bytes.chunks_exact(2).map(|b| word([b[0], b[1]]));
        char::decode_utf16(words)
            .map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect()
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => Cow::Owned(sixteen(rest, u16::from_le_bytes)),
        [0xfe, 0xff, rest @ ..] => Cow::Owned(sixteen(rest, u16::from_be_bytes)),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest),
        _ => String::from_utf8_lossy(bytes),
    }
}

/// What stands in a message for bytes that cannot be shown.
pub(crate) const NO_TEXT: &str = "bytes that are no text";

/// Characters that are looked at to tell text from other bytes.
const LOOKED_AT: usize = 4096;

/// Whether it is something else than text: zero bytes, or more than one control character in
/// fifty. Names in encodings that are not known have neither.
pub(crate) fn is_no_text(text: &str) -> bool {
    let (mut all, mut odd) = (0, 0);
    for c in text.chars().take(LOOKED_AT) {
        if c == '\0' {
            return true;
        }
        all += 1;
        // Escape and end-of-file are left by old editors.
        odd += (c.is_control() && !c.is_whitespace() && !matches!(c, '\x1a' | '\x1b')) as usize;
    }
    50 * odd > all
}

/// Lines with the number of their first line, from 1. A backslash at the end of a line joins the
/// next one to it. Lines end with LF, CR LF or CR.
pub(crate) struct Lines<'a> {
    rest: &'a str,
    number: usize,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(text: &'a str) -> Self {
        Lines {
            rest: text,
            number: 0,
        }
    }

    /// Number of the line that was read last, from 1.
    pub(crate) fn number(&self) -> usize {
        self.number
    }

    /// The next line as it stands: a backslash joins nothing.
    pub(crate) fn line(&mut self) -> Option<&'a str> {
        if self.rest.is_empty() {
            return None;
        }
        self.number += 1;
        let end = self.rest.find(['\n', '\r']).unwrap_or(self.rest.len());
        let (line, mut rest) = self.rest.split_at(end);
        rest = rest.strip_prefix("\r\n").or(rest.get(1..)).unwrap_or("");
        self.rest = rest;
        Some(line)
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = (usize, Cow<'a, str>);

    fn next(&mut self) -> Option<Self::Item> {
        let first = self.line()?;
        let number = self.number;
        let Some(start) = first.strip_suffix('\\') else {
            return Some((number, Cow::Borrowed(first)));
        };
        let mut whole = start.to_owned();
        while let Some(next) = self.line() {
            whole.push(' ');
            match next.strip_suffix('\\') {
                Some(start) => whole.push_str(start),
                None => {
                    whole.push_str(next);
                    break;
                }
            }
        }
        Some((number, Cow::Owned(whole)))
    }
}

/// The line up to a `#` that begins a word: names may hold one.
pub(crate) fn without_comment(line: &str) -> &str {
    let mut before = true;
    for (i, c) in line.char_indices() {
        if c == '#' && before {
            return &line[..i];
        }
        before = c.is_whitespace();
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_keep_their_numbers_through_every_line_end() {
        let found: Vec<_> = Lines::new("a\r\nb \\\n c\rd\n\ne").collect();
        let expected = [(1, "a"), (2, "b   c"), (4, "d"), (5, ""), (6, "e")];
        assert_eq!(found.len(), expected.len());
        for ((n, line), (m, text)) in found.iter().zip(expected) {
            assert_eq!((*n, line.as_ref()), (m, text));
        }
    }

    #[test]
    fn byte_order_marks_choose_the_encoding() {
        assert_eq!(decoded(b"\xef\xbb\xbfv"), "v");
        assert_eq!(decoded(b"\xff\xfev\0 \0"), "v ");
        assert_eq!(decoded(b"\xfe\xff\0v"), "v");
        assert_eq!(decoded(b"\xff\xfev"), "");
    }

    #[test]
    fn text_is_told_from_other_bytes() {
        for text in [
            "",
            "v 1 2 3\r\n\tf 1\x1a",
            "# Gr\u{fffd}\u{fffd}\u{fffd}e\n",
        ] {
            assert!(!is_no_text(text), "{text:?}");
        }
        for bytes in ["v\0 \x001", "\x01\x02abc", "\u{7f}\u{80}\u{81}"] {
            assert!(is_no_text(bytes), "{bytes:?}");
        }
    }

    #[test]
    fn a_comment_begins_a_word() {
        assert_eq!(without_comment("v 1 2 3 # x"), "v 1 2 3 ");
        assert_eq!(without_comment("usemtl wood#2"), "usemtl wood#2");
        assert_eq!(without_comment("# v"), "");
    }
}
