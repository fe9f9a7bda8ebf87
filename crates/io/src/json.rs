//! Reading members of JSON values: each mistake names the member, what belongs there and what is there.

use crate::error::{Error, Within, clean};
use serde_json::Value;

/// A value in a few words.
pub(crate) fn found(value: &Value) -> String {
    match value {
        Value::Null => "null".into(),
        Value::Bool(b) => b.to_string(),
        Value::Number(n) => n.to_string(),
        Value::String(s) => format!("'{}'", clean(s)),
        Value::Array(a) => format!("an array of {}", a.len()),
        Value::Object(_) => "an object".into(),
    }
}

/// Members of a JSON object, checked.
pub(crate) trait Json {
    /// The member, if it is there.
    fn member(&self, key: &str) -> Option<&Value>;
    /// An array; an absent one is empty.
    fn list(&self, key: &str) -> Result<&[Value], Error>;
    /// A whole number from 0.
    fn whole(&self, key: &str) -> Result<Option<usize>, Error>;
    /// A finite number that fits an `f32`.
    fn number(&self, key: &str) -> Result<Option<f64>, Error>;
    /// `N` finite numbers.
    fn numbers<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>, Error>;
    /// Text.
    fn text(&self, key: &str) -> Result<Option<&str>, Error>;
    /// True or false; an absent one is false.
    fn flag(&self, key: &str) -> Result<bool, Error>;
    /// An object.
    fn object(&self, key: &str) -> Result<Option<&Value>, Error>;
    /// `extensions.name`, an object.
    fn extension(&self, name: &str) -> Result<Option<&Value>, Error>;
    /// The name of a thing, trimmed, if it has one that says something.
    fn name(&self) -> Option<String>;
}

fn wrong(key: &str, expected: impl Into<String>, value: &Value) -> Error {
    Error::new(expected, found(value)).within(key)
}

fn finite(value: &Value) -> Option<f64> {
    value
        .as_f64()
        .filter(|v| v.is_finite() && v.abs() <= f32::MAX as f64)
}

/// A whole number: 3 and 3.0 are both written.
pub(crate) fn as_whole(value: &Value) -> Option<usize> {
    let n = match value.as_u64() {
        Some(n) => n,
        None => {
            let v = value
                .as_f64()
                .filter(|v| *v >= 0.0 && *v < 9e15 && v.fract() == 0.0)?;
            v as u64
        }
    };
    usize::try_from(n).ok()
}

impl Json for Value {
    fn member(&self, key: &str) -> Option<&Value> {
        self.as_object()?.get(key)
    }

    fn list(&self, key: &str) -> Result<&[Value], Error> {
        match self.member(key) {
            None => Ok(&[]),
            Some(Value::Array(a)) => Ok(a),
            Some(v) => Err(wrong(key, "an array", v)),
        }
    }

    fn whole(&self, key: &str) -> Result<Option<usize>, Error> {
        self.member(key)
            .map(|v| as_whole(v).ok_or_else(|| wrong(key, "a whole number from 0", v)))
            .transpose()
    }

    fn number(&self, key: &str) -> Result<Option<f64>, Error> {
        self.member(key)
            .map(|v| finite(v).ok_or_else(|| wrong(key, "a finite number", v)))
            .transpose()
    }

    fn numbers<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>, Error> {
        let Some(v) = self.member(key) else {
            return Ok(None);
        };
        let expected = || format!("{N} numbers");
        let list = v.as_array().filter(|a| a.len() == N);
        let list = list.ok_or_else(|| wrong(key, expected(), v))?;
        let mut out = [0.0; N];
        for (slot, number) in out.iter_mut().zip(list) {
            *slot = finite(number).ok_or_else(|| wrong(key, expected(), number))?;
        }
        Ok(Some(out))
    }

    fn text(&self, key: &str) -> Result<Option<&str>, Error> {
        self.member(key)
            .map(|v| v.as_str().ok_or_else(|| wrong(key, "text", v)))
            .transpose()
    }

    fn flag(&self, key: &str) -> Result<bool, Error> {
        match self.member(key) {
            None => Ok(false),
            Some(Value::Bool(b)) => Ok(*b),
            Some(v) => Err(wrong(key, "true or false", v)),
        }
    }

    fn object(&self, key: &str) -> Result<Option<&Value>, Error> {
        match self.member(key) {
            None => Ok(None),
            Some(v) if v.is_object() => Ok(Some(v)),
            Some(v) => Err(wrong(key, "an object", v)),
        }
    }

    fn extension(&self, name: &str) -> Result<Option<&Value>, Error> {
        match self.object("extensions")? {
            Some(all) => all.object(name).within(|| "extensions"),
            None => Ok(None),
        }
    }

    fn name(&self) -> Option<String> {
        let name = self.member("name")?.as_str()?.trim();
        if name.is_empty() {
            None
        } else {
            Some(clean(name))
        }
    }
}

/// Entry `index` of the top-level array `key`.
pub(crate) fn entry<'a>(root: &'a Value, key: &str, index: usize) -> Result<&'a Value, Error> {
    let list = root.list(key)?;
    let value = list.get(index).ok_or_else(|| {
        Error::new(
            format!("one of {} {key}", list.len()),
            format!("index {index}"),
        )
    })?;
    if value.is_object() {
        Ok(value)
    } else {
        Err(Error::new("an object", found(value)).within(format_args!("{key} {index}")))
    }
}
