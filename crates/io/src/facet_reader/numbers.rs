//! Coordinates, and how well the file knows them.
//!
//! A stored f32 is off by half a unit in its last place. Text is off by half of its last digit:
//! the last of the finest number where digits behind the point are fixed (`%.6f`), the last of
//! the largest number where significant digits are (`%e`). Short numbers are round rather than
//! coarse: with fewer than six such digits throughout, a text means what it says. None is taken
//! for coarser than a millionth of its largest coordinate.

use crate::error::{Error, clean};
use crate::obj_reader::text::NO_TEXT;

/// Farthest coordinate, metres: what lies beyond cannot be lit either.
const FARTHEST_M: f64 = 1e9;

/// What doubles and the arithmetic on them lose, in relation to the largest coordinate.
const DOUBLE_GRAIN: f64 = 1e-12;

/// Coarsest that text is taken for, in relation to the largest coordinate.
const COARSEST_TEXT: f64 = 1e-6;

/// Digits from which on they look like the end of a longer number.
const CUT_OFF: i32 = 6;

/// What was seen of the coordinates of a file.
#[derive(Clone, Debug)]
pub(super) struct Numbers {
    scale: f64,
    largest: f64,
    /// Stored, or written by a program that held them, as f32.
    single: bool,
    /// Digits behind the point of the finest number.
    decimals: Option<i32>,
    /// Most significant digits of a number.
    digits: i32,
    /// Some numbers have an exponent.
    exponents: bool,
}

impl Numbers {
    /// `scale`: metres for each unit of the file. `single`: they were f32 once.
    pub(super) fn new(scale: f64, single: bool) -> Self {
        Numbers {
            scale,
            largest: 0.0,
            single,
            decimals: None,
            digits: 0,
            exponents: false,
        }
    }

    /// From here on they were f32 once.
    pub(super) fn set_single(&mut self) {
        self.single = true;
    }

    /// A coordinate out of a binary file, in the file's unit.
    pub(super) fn stored(&mut self, value: f64) -> Result<f64, Error> {
        self.checked(value, || value.to_string())
    }

    /// A coordinate out of a text, in the file's unit. `expected`: what belongs there.
    pub(super) fn word(&mut self, word: Option<&str>, expected: &str) -> Result<f64, Error> {
        let value = number(word, expected)?;
        let word = word.unwrap_or_default();
        self.note_digits(word);
        self.checked(value, || found(Some(word)))
    }

    fn checked(&mut self, value: f64, found: impl Fn() -> String) -> Result<f64, Error> {
        let size = value.abs();
        // `!(a <= b)`: NaN too.
        let near = size * self.scale <= FARTHEST_M;
        if !near {
            let expected = match value.is_finite() {
                true => "a coordinate within 10^9 m",
                false => "a finite coordinate",
            };
            return Err(Error::new(expected, found()));
        }
        self.largest = self.largest.max(size);
        Ok(value)
    }

    fn note_digits(&mut self, word: &str) {
        let (mantissa, exponent) = match word.find(['e', 'E']) {
            Some(at) => (&word[..at], true),
            None => (word, false),
        };
        self.exponents |= exponent;
        let digits = mantissa.bytes().filter(u8::is_ascii_digit);
        let count = digits.skip_while(|b| *b == b'0').take(99).count();
        self.digits = self.digits.max(count as i32);
        if !exponent {
            let behind = mantissa.find('.').map_or(0, |at| mantissa.len() - at - 1);
            self.decimals = self.decimals.max(Some(behind.min(99) as i32));
        }
    }

    /// Rounding of a number in relation to its size.
    pub(super) fn grain(&self) -> f64 {
        match self.single {
            true => f32::EPSILON as f64,
            false => DOUBLE_GRAIN,
        }
    }

    /// Coordinates are known to this many metres.
    pub(super) fn rounding_m(&self) -> f64 {
        let text = match (self.exponents, self.decimals) {
            (true, _) if self.largest > 0.0 && self.digits >= CUT_OFF => {
                let before = self.largest.log10().floor() as i32 + 1;
                0.5 * 10f64.powi(before - self.digits)
            }
            (false, Some(decimals)) if decimals >= CUT_OFF => 0.5 * 10f64.powi(-decimals),
            _ => 0.0,
        };
        let text = text.min(COARSEST_TEXT * self.largest);
        (self.grain() * self.largest).max(text) * self.scale
    }
}

/// A number in a text; may be infinite or NaN.
pub(super) fn number(word: Option<&str>, expected: &str) -> Result<f64, Error> {
    word.and_then(|w| w.parse().ok())
        .ok_or_else(|| Error::new(expected, found(word)))
}

/// Characters of a word that are shown.
const SHOWN: usize = 40;

/// A word in a message: its beginning, if it can be shown.
pub(super) fn found(word: Option<&str>) -> String {
    let Some(word) = word else {
        return "the end of the line".into();
    };
    let odd = |c: &char| c.is_control() || *c == char::REPLACEMENT_CHARACTER;
    if 4 * word.chars().filter(odd).count() > word.chars().count() || word.contains('\0') {
        return NO_TEXT.into();
    }
    let plain = |c| match c {
        char::REPLACEMENT_CHARACTER => '?',
        c => c,
    };
    let mut shown: String = word.chars().take(SHOWN).map(plain).collect();
    if word.chars().nth(SHOWN).is_some() {
        shown.push('…');
    }
    format!("'{}'", clean(&shown))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rounding(words: &[&str], scale: f64) -> f64 {
        let mut numbers = Numbers::new(scale, false);
        for word in words {
            numbers.word(Some(word), "a number").unwrap();
        }
        numbers.rounding_m()
    }

    fn assert_near(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-9 * b, "{a} and {b}");
    }

    #[test]
    fn the_finest_number_tells_the_places_of_a_text() {
        assert_near(rounding(&["0", "1.5", "12.345678"], 1.0), 0.5e-6);
        assert_near(rounding(&["0", "1.5", "12.345678"], 0.001), 0.5e-9);
        // %e with six digits behind the point: seven in all, of which 123.4567 shows four there.
        assert_near(
            rounding(&["1.234567e+02", "3.000000e-05", "0"], 1.0),
            0.5e-4,
        );
        // Round numbers are not coarse.
        assert_near(rounding(&["0", "1"], 1.0), 1e-12);
        assert_near(rounding(&["0", "2", "0.50001"], 1.0), 2e-12);
        assert_near(rounding(&["0.12345678901234567", "1.0"], 1.0), 1e-12);
    }

    #[test]
    fn singles_are_known_to_their_last_place() {
        let mut numbers = Numbers::new(1.0, true);
        numbers.stored(3.0).unwrap();
        numbers.stored(-100.0).unwrap();
        assert_near(numbers.rounding_m(), 100.0 * f32::EPSILON as f64);
    }

    #[test]
    fn a_word_in_a_message_is_short_and_can_be_shown() {
        assert_eq!(found(Some("1.5m")), "'1.5m'");
        assert_eq!(found(Some("\u{fffd}\u{3}x")), NO_TEXT);
        let long = found(Some(&"long".repeat(100)));
        assert_eq!(long, format!("'{}…'", "long".repeat(10)));
    }

    #[test]
    fn what_is_not_finite_or_too_far_is_refused() {
        let mut numbers = Numbers::new(1e-3, false);
        for word in ["nan", "-inf", "1e400", "1e13", "", "x"] {
            assert!(numbers.word(Some(word), "a number").is_err(), "{word}");
        }
        assert!(numbers.word(Some("1e12"), "a number").is_ok());
    }
}
