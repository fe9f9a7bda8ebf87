//! Reference cases as they stand in their files.

use crate::error::Error;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// One file of cases.
#[derive(Debug)]
pub(crate) struct CaseFile {
    /// Name without extension.
    pub file: String,
    pub cases: Vec<Case>,
}

/// One case: a scene and what is asked of it.
#[derive(Debug, Deserialize)]
pub(crate) struct Case {
    pub id: String,
    pub kind: String,
    #[serde(default)]
    pub scene: Scene,
    #[serde(default)]
    pub queries: Vec<Query>,
    #[serde(default)]
    tolerance: BTreeMap<String, Tolerance>,
}

/// Pass limit of one class of methods.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
pub(crate) struct Tolerance {
    #[serde(default)]
    pub rel: f64,
    #[serde(default)]
    pub abs: f64,
}

#[derive(Debug, Default, Deserialize)]
pub(crate) struct Scene {
    #[serde(default)]
    pub surfaces: Vec<Surface>,
    #[serde(default)]
    pub lights: Vec<Value>,
    pub form_factors: Option<Vec<Vec<f64>>>,
    pub areas: Option<Vec<f64>>,
    pub reflectance: Option<Vec<f64>>,
    pub exitance: Option<Vec<f64>>,
    /// Everything else that the scene has: what we do not read may change its meaning.
    #[serde(flatten)]
    pub other: BTreeMap<String, Value>,
}

#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Surface {
    pub id: String,
    pub shape: String,
    #[serde(default)]
    pub reflectance: Bands,
    #[serde(default)]
    pub exitance: Bands,
    #[serde(default)]
    pub two_sided: bool,
    /// Geometry, by shape.
    #[serde(flatten)]
    pub geometry: BTreeMap<String, Value>,
}

/// One number for all bands, or three.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(crate) enum Bands {
    Grey(f64),
    Rgb([f64; 3]),
}

impl Default for Bands {
    fn default() -> Self {
        Bands::Grey(0.0)
    }
}

impl Bands {
    pub fn rgb(&self) -> [f64; 3] {
        match self {
            Bands::Grey(v) => [*v; 3],
            Bands::Rgb(v) => *v,
        }
    }
}

/// What is asked.
#[derive(Debug, Deserialize)]
pub(crate) struct Query {
    pub id: String,
    pub quantity: String,
    pub expected: Value,
    #[serde(default)]
    pub unc: Value,
    /// Arguments of the quantity.
    #[serde(flatten)]
    pub arguments: BTreeMap<String, Value>,
}

impl Query {
    /// All numbers of the expected value, in reading order; of shooting iterates those that the
    /// method defines, in the order radiosity, unshot, ambient, display.
    pub fn expected_numbers(&self) -> Vec<f64> {
        fn collect(value: &Value, out: &mut Vec<f64>) {
            match value {
                Value::Number(n) => out.extend(n.as_f64()),
                Value::Array(list) => list.iter().for_each(|v| collect(v, out)),
                Value::Object(step) => {
                    for key in ["shot", "radiosity", "unshot", "ambient", "display"] {
                        if let Some(v) = step.get(key) {
                            collect(v, out);
                        }
                    }
                }
                _ => {}
            }
        }
        let mut out = Vec::new();
        collect(&self.expected, &mut out);
        out
    }

    pub fn uncertainty(&self) -> f64 {
        self.unc.as_f64().unwrap_or(0.0)
    }

    pub fn text(&self, key: &str) -> Option<&str> {
        self.arguments.get(key)?.as_str()
    }

    pub fn number(&self, key: &str) -> Option<f64> {
        self.arguments.get(key)?.as_f64()
    }

    pub fn point(&self, key: &str) -> Option<[f64; 3]> {
        triple(self.arguments.get(key)?)
    }
}

/// Three numbers.
pub(crate) fn triple(value: &Value) -> Option<[f64; 3]> {
    let list = value.as_array()?;
    let [x, y, z] = list.as_slice() else {
        return None;
    };
    Some([x.as_f64()?, y.as_f64()?, z.as_f64()?])
}

impl Surface {
    pub fn number(&self, key: &str) -> Result<f64, String> {
        let value = self.geometry.get(key).and_then(Value::as_f64);
        value.ok_or_else(|| format!("{} '{}' has no number '{key}'", self.shape, self.id))
    }

    pub fn point(&self, key: &str) -> Result<[f64; 3], String> {
        let value = self.geometry.get(key).and_then(triple);
        value.ok_or_else(|| format!("{} '{}' has no point '{key}'", self.shape, self.id))
    }

    /// A point of a cross-section.
    pub fn pair(&self, key: &str) -> Result<[f64; 2], String> {
        let list = self.geometry.get(key).and_then(Value::as_array);
        match list.map(Vec::as_slice) {
            Some([x, y]) if x.is_number() && y.is_number() => {
                Ok([x.as_f64().unwrap_or(0.0), y.as_f64().unwrap_or(0.0)])
            }
            _ => Err(format!("{} '{}' has no pair '{key}'", self.shape, self.id)),
        }
    }

    pub fn vertices(&self) -> Result<Vec<[f64; 3]>, String> {
        let list = self.geometry.get("vertices").and_then(Value::as_array);
        let points: Option<Vec<[f64; 3]>> = list.and_then(|l| l.iter().map(triple).collect());
        points.ok_or_else(|| format!("{} '{}' has no vertices", self.shape, self.id))
    }
}

impl Scene {
    pub fn surface(&self, id: &str) -> Result<&Surface, String> {
        let found = self.surfaces.iter().find(|s| s.id == id);
        found.ok_or_else(|| format!("the case has no surface '{id}'"))
    }

    /// Whether everything is infinitely long: a problem in the plane.
    pub fn is_plane(&self) -> bool {
        !self.surfaces.is_empty() && self.surfaces.iter().all(|s| s.shape == "infinite_strip")
    }
}

impl Case {
    /// A case whose scene is written in a way that is not read: skipped by name, query by query.
    fn unread(index: usize, value: &Value, why: &str) -> Case {
        let text = |key: &str| value.get(key).and_then(Value::as_str).map(str::to_owned);
        let queries = value
            .get("queries")
            .and_then(Value::as_array)
            .map_or(&[][..], Vec::as_slice);
        Case {
            kind: format!("{} ({why})", text("kind").unwrap_or_default()),
            queries: queries
                .iter()
                .filter_map(|q| Query::deserialize(q).ok())
                .collect(),
            ..Case::bare(&text("id").unwrap_or_else(|| format!("case {index}")))
        }
    }

    /// A case with nothing in it.
    pub fn bare(id: &str) -> Case {
        Case {
            id: id.into(),
            kind: String::new(),
            scene: Scene::default(),
            queries: Vec::new(),
            tolerance: BTreeMap::new(),
        }
    }

    /// Tolerance for a class of method: its own name, else the nearest name that the case uses.
    /// An exact answer may stand where only sampled ones were foreseen.
    pub fn tolerance_class(&self, class: &'static str) -> Option<(&str, Tolerance)> {
        let others: &[&str] = match class {
            "analytic" => &["patchwise", "mesh", "meshed", "montecarlo"],
            "montecarlo" => &[
                "mesh",
                "meshed",
                "quadrature",
                "hemicube",
                "tessellated",
                "analytic",
            ],
            "tessellated" => &["montecarlo", "mesh", "meshed", "analytic"],
            "mesh" => &["meshed", "montecarlo", "analytic"],
            _ => &[],
        };
        std::iter::once(&class).chain(others).find_map(|name| {
            self.tolerance
                .get_key_value(*name)
                .map(|(known, t)| (known.as_str(), *t))
        })
    }
}

/// Reads a file. A file of another format has no cases.
pub(crate) fn read(path: &Path) -> Result<CaseFile, Error> {
    let place = path.display();
    let text =
        std::fs::read_to_string(path).map_err(|e| Error::Setting(format!("{place}: {e}")))?;
    let value: Value =
        serde_json::from_str(&text).map_err(|e| Error::Setting(format!("{place}: {e}")))?;
    let file = path
        .file_stem()
        .map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    if value.get("format").and_then(Value::as_str) != Some("refcase-1") {
        return Ok(CaseFile {
            file,
            cases: Vec::new(),
        });
    }
    let list = value
        .get("cases")
        .and_then(Value::as_array)
        .map_or(&[][..], Vec::as_slice);
    let cases = list.iter().enumerate().map(|(index, case)| {
        Case::deserialize(case).unwrap_or_else(|e| Case::unread(index, case, &e.to_string()))
    });
    Ok(CaseFile {
        file,
        cases: cases.collect(),
    })
}
