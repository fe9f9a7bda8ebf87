//! Receivers as text: lines `x y z nx ny nz`, and the table that answers them.
//!
//! The habit of Radiance's `rtrace -I`, with a header line and an error column, so that results
//! of different programs can be compared column by column.

use luxel_core::layers::BANDS;
use luxel_core::{DVec3, Layers, Vec3};
use luxel_gather::{Irradiance, Receiver};
use std::fmt::Write;

/// Longest line that is read as numbers.
const LONGEST_LINE: usize = 4096;

/// Reads receivers, one a line, as [`lines`].
pub fn parse(place: &str, text: &str) -> Result<Vec<Receiver>, String> {
    let receiver = |[x, y, z, nx, ny, nz]: [f64; 6]| Receiver {
        position: Vec3::new(x as f32, y as f32, z as f32),
        normal: Vec3::new(nx as f32, ny as f32, nz as f32),
    };
    Ok(lines(place, text)?.into_iter().map(receiver).collect())
}

/// Reads places in metres and normals, one a line, separated by blanks, tabs or commas. Empty
/// lines and lines that begin with `#` are passed over. Normals are made unit vectors.
///
/// An error names `place`, the line, what was expected and what was found.
pub fn lines(place: &str, text: &str) -> Result<Vec<[f64; 6]>, String> {
    // Some editors begin a text with a mark of its encoding.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut receivers = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let wrong = |found: &str| {
            format!(
                "{place}:{}: expected 6 numbers 'x y z nx ny nz', found {found}",
                index + 1
            )
        };
        if line.len() > LONGEST_LINE {
            return Err(wrong(&format!("a line of {} characters", line.len())));
        }
        let mut numbers = Vec::with_capacity(6);
        for word in line
            .split(|c: char| c.is_whitespace() || c == ',')
            .filter(|w| !w.is_empty())
        {
            match word.parse::<f64>() {
                Ok(v) if v.abs() <= f32::MAX as f64 => numbers.push(v),
                _ => return Err(wrong(&format!("'{word}'"))),
            }
        }
        if numbers.len() != 6 {
            return Err(wrong(&format!("{}", numbers.len())));
        }
        let normal = DVec3::new(numbers[3], numbers[4], numbers[5]);
        match normal.try_normalize() {
            Some(n) => receivers.push([numbers[0], numbers[1], numbers[2], n.x, n.y, n.z]),
            None => return Err(wrong("a normal of length 0")),
        }
    }
    Ok(receivers)
}

/// Header of the table.
pub const HEADER: &str = "# x y z nx ny nz E_r E_g E_b E_lux err_lux";

/// One tab-separated line a receiver, in the order given; lux, and one standard error of E_lux.
pub fn table(receivers: &[Receiver], irradiance: &Irradiance) -> String {
    let mut text = String::with_capacity(96 * (receivers.len() + 1));
    text.push_str(HEADER);
    text.push('\n');
    for (k, r) in receivers.iter().enumerate() {
        let row = &irradiance.values[k * irradiance.columns..(k + 1) * irradiance.columns];
        let total = luxel_core::layers::total(row);
        let (p, n) = (r.position, r.normal);
        writeln!(
            text,
            "{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}",
            p.x,
            p.y,
            p.z,
            n.x,
            n.y,
            n.z,
            total.r,
            total.g,
            total.b,
            total.luminance(),
            irradiance.errors[k]
        )
        .expect("writing to a string");
    }
    text
}

/// The same answers as JSON, layer by layer: `E` by group with its bands, and standard errors.
pub fn json(receivers: &[Receiver], irradiance: &Irradiance, layers: &Layers) -> serde_json::Value {
    let groups = irradiance.columns / BANDS;
    let rows = receivers.iter().enumerate().map(|(k, r)| {
        let row = &irradiance.values[k * irradiance.columns..(k + 1) * irradiance.columns];
        let by_group = layers.groups.iter().enumerate().map(|(g, name)| {
            let bands = &row[g * BANDS..(g + 1) * BANDS];
            serde_json::json!({
                "group": name,
                "E": bands,
                "E_lux": luxel_core::layers::luminance(bands),
                "err_lux": irradiance.layer_errors[k * groups + g],
            })
        });
        serde_json::json!({
            "position": r.position.to_array(),
            "normal": r.normal.to_array(),
            "E_lux": luxel_core::layers::luminance(row),
            "err_lux": irradiance.errors[k],
            "layers": by_group.collect::<Vec<_>>(),
        })
    });
    serde_json::json!({ "receivers": rows.collect::<Vec<_>>(), "rays": irradiance.rays })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_and_wrong_ones_are_named() {
        let good = "# a comment\n\n0 0.75 2\t0 2 0\n1,2,3,0,0,-1\n";
        let receivers = parse("points", good).expect("two receivers");
        assert_eq!(receivers.len(), 2);
        assert_eq!(receivers[0].normal, Vec3::Y);
        let marked = parse("points", "\u{feff}0 0.75 2 0 1 0\r\n").expect("one receiver");
        assert_eq!(marked[0].normal, Vec3::Y);
        for (bad, told) in [
            ("1 2 3 0 1", "points:1: expected 6 numbers"),
            ("1 2 3 0 1 x", "'x'"),
            ("0 0 0 0 1 0\n1 2 3 0 0 0", "points:2"),
            ("1 2 nan 0 1 0", "'nan'"),
            ("1 2 3 4 5 6 7", "found 7"),
        ] {
            let message = parse("points", bad).expect_err("a wrong line");
            assert!(message.contains(told), "{bad}: {message}");
        }
        assert!(parse("points", &"9".repeat(100_000)).is_err());
    }

    #[test]
    fn table_has_a_row_for_each_receiver() {
        let receivers = parse("p", "0 0 0 0 0 1").expect("one");
        let irradiance = Irradiance {
            columns: 6,
            values: vec![1.0, 2.0, 3.0, 10.0, 20.0, 30.0],
            layer_errors: vec![0.1, 0.1],
            errors: vec![0.25],
            rays: 1,
        };
        let text = table(&receivers, &irradiance);
        let row: Vec<&str> = text.lines().nth(1).expect("a row").split('\t').collect();
        assert_eq!(row.len(), 11);
        assert_eq!(
            (row[6], row[7], row[8], row[10]),
            ("11", "22", "33", "0.25")
        );
    }
}
