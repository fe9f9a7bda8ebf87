//! Quantities as people write them on a command line: `2%`, `5cm`, `60s`, `4GB`.
//!
//! ```
//! use luxel::units::{length_m, share};
//! assert_eq!(share("2%"), Ok(0.02));
//! assert_eq!(length_m("5cm"), Ok(0.05));
//! assert!(length_m("5").unwrap_err().contains("unit"));
//! ```

use std::time::Duration;

/// Splits `12.5cm` into 12.5 and `cm`.
fn split(text: &str) -> Result<(f64, &str), String> {
    let text = text.trim();
    // An `e` belongs to the number only when an exponent follows (`1e-3`, but not `1em`).
    let bytes = text.as_bytes();
    let mut end = 0;
    while end < bytes.len() {
        let exponent = matches!(bytes[end], b'e' | b'E')
            && bytes
                .get(end + 1)
                .is_some_and(|c| c.is_ascii_digit() || matches!(c, b'+' | b'-'));
        if bytes[end].is_ascii_digit() || matches!(bytes[end], b'.' | b'+' | b'-') || exponent {
            end += 1;
        } else {
            break;
        }
    }
    let value: f64 = text[..end]
        .parse()
        .map_err(|_| format!("expected a number with a unit, found '{text}'"))?;
    if !value.is_finite() || value < 0.0 {
        return Err(format!(
            "expected a finite number of at least 0, found '{text}'"
        ));
    }
    Ok((value, text[end..].trim()))
}

fn by_unit(text: &str, units: &[(&str, f64)], example: &str) -> Result<f64, String> {
    let (value, unit) = split(text)?;
    match units.iter().find(|u| u.0.eq_ignore_ascii_case(unit)) {
        Some((_, factor)) => Ok(value * factor),
        None => {
            let known: Vec<&str> = units
                .iter()
                .map(|u| u.0)
                .filter(|u| !u.is_empty())
                .collect();
            let found = if unit.is_empty() {
                "none".to_string()
            } else {
                format!("'{unit}'")
            };
            Err(format!(
                "expected a unit ({}) as in {example}, found {found}",
                known.join(", ")
            ))
        }
    }
}

/// A share: `2%` or `0.02`.
pub fn share(text: &str) -> Result<f64, String> {
    by_unit(text, &[("%", 0.01), ("", 1.0)], "2%")
}

/// An accuracy: a [`share`] from a millionth to 1. So a bare `5`, which may mean 5 %, is refused.
pub fn accuracy(text: &str) -> Result<f64, String> {
    match share(text)? {
        error if (1e-6..=1.0).contains(&error) => Ok(error),
        _ => Err(format!(
            "expected from 0.0001% to 100%, like 5% or 0.05, found '{text}'"
        )),
    }
}

/// A reflectance: a [`share`] below 1, for in a closed room of 1 light would never end.
pub fn reflectance(text: &str) -> Result<f64, String> {
    match share(text)? {
        share if share <= 0.999 => Ok(share),
        _ => Err(format!("expected at most 99.9%, found '{text}'")),
    }
}

/// A [`length_m`] above 0.
pub fn edge_m(text: &str) -> Result<f64, String> {
    match length_m(text)? {
        edge if (1e-6..1e9).contains(&edge) => Ok(edge),
        _ => Err(format!(
            "expected a length from 0.001mm on, like 20cm, found '{text}'"
        )),
    }
}

/// A length in metres: `5cm`, `2.5m`, `3mm`, `1ft`, `4in`.
pub fn length_m(text: &str) -> Result<f64, String> {
    let units = [
        ("mm", 1e-3),
        ("cm", 1e-2),
        ("m", 1.0),
        ("ft", 0.3048),
        ("in", 0.0254),
    ];
    by_unit(text, &units, "5cm")
}

/// A duration: `60s`, `2min`, `500ms`, `1h`.
pub fn duration(text: &str) -> Result<Duration, String> {
    let units = [("ms", 1e-3), ("s", 1.0), ("min", 60.0), ("h", 3600.0)];
    let seconds = by_unit(text, &units, "60s")?;
    Duration::try_from_secs_f64(seconds).map_err(|_| format!("'{text}' is too long a time"))
}

/// An amount of memory in bytes: `4GB`, `500MB`, `1.5GiB`.
pub fn bytes(text: &str) -> Result<u64, String> {
    let units = [
        ("kB", 1e3),
        ("MB", 1e6),
        ("GB", 1e9),
        ("TB", 1e12),
        ("KiB", 1024.0),
        ("MiB", 1048576.0),
        ("GiB", 1073741824.0),
    ];
    by_unit(text, &units, "4GB").map(|b| b as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_and_wrong_ones_are_named() {
        assert_eq!(share("0.5"), Ok(0.5));
        assert_eq!(share("1e-2"), Ok(0.01));
        assert_eq!(bytes("1.5GiB"), Ok(1610612736));
        assert_eq!(duration("2min"), Ok(Duration::from_secs(120)));
        for (wrong, told) in [
            ("60", "unit"),
            ("x", "number"),
            ("-3s", "at least 0"),
            ("3lm", "'lm'"),
        ] {
            let message = duration(wrong).expect_err("not a duration");
            assert!(message.contains(told), "{wrong}: {message}");
        }
        assert!(duration("1e300h").is_err());
        assert_eq!(accuracy("5%"), Ok(0.05));
        assert_eq!(reflectance("0.9"), Ok(0.9));
        assert!(reflectance("1").is_err() && reflectance("90").is_err());
        for wrong in ["5", "101%", "0", "1e-9"] {
            assert!(accuracy(wrong).is_err(), "{wrong}");
        }
    }
}
