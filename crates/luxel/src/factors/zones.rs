//! Zones: facets taken together, by object, by material or by name.

use luxel_core::{Facets, SparseRows};
use std::collections::HashMap;
use std::num::IntErrorKind;

/// How facets are put together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ZoneWishes {
    /// Each object or each material a zone.
    pub by: Option<By>,
    /// `NAME=a,b,10..20`: objects, materials, names of facets and runs of rows.
    pub groups: Vec<String>,
}

/// What makes a zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// OBJ `o` and `g`, STL `solid`, glTF node.
    Object,
    /// OBJ `usemtl`, glTF material.
    Material,
}

/// Which zone each row belongs to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Zones {
    /// Names, in the order in which they were asked for or met.
    pub names: Vec<String>,
    /// Zone of each row.
    pub of: Vec<u32>,
}

/// Name of what no group names.
const REST: &str = "rest";

/// Name of what the file gives no name.
const UNNAMED: &str = "(unnamed)";

impl Zones {
    /// The zones that are wished for; none without a wish. Rows that no group names make one
    /// zone of their own, or stay in the zones of `by`; a group with the name of one of these is
    /// refused. Groups of one name are one.
    pub fn new(facets: &Facets, wishes: &ZoneWishes) -> Result<Option<Zones>, String> {
        if wishes.by.is_none() && wishes.groups.is_empty() {
            return Ok(None);
        }
        const OPEN: u32 = u32::MAX;
        let mut zones = Zones {
            names: Vec::new(),
            of: vec![OPEN; facets.rows.len()],
        };
        for wish in &wishes.groups {
            let (name, members) = wish
                .split_once('=')
                .filter(|(name, members)| !name.trim().is_empty() && !members.trim().is_empty())
                .ok_or_else(|| {
                    format!("--group {wish}: expected NAME=a,b (objects, materials, facets or rows 0..10)")
                })?;
            let zone = zones.named(name.trim());
            for member in members.split(',').map(str::trim) {
                zones
                    .take(facets, member, zone)
                    .map_err(|e| format!("--group {wish}: {e}"))?;
            }
        }
        let groups = zones.names.len();
        let mut by_name: HashMap<u32, u32> = HashMap::new();
        for row in 0..facets.rows.len() {
            if zones.of[row] != OPEN {
                continue;
            }
            let facet = &facets.rows[row];
            let (key, name) = match wishes.by {
                None => (0, REST),
                Some(By::Object) => (facet.object, name_of(&facets.objects, facet.object)),
                Some(By::Material) => (facet.material, name_of(&facets.materials, facet.material)),
            };
            zones.of[row] = match by_name.get(&key) {
                Some(&zone) => zone,
                None => zones.named(if name.is_empty() { UNNAMED } else { name }),
            };
            if (zones.of[row] as usize) < groups {
                let name = &zones.names[zones.of[row] as usize];
                return Err(format!(
                    "--group {name}=...: expected a name that no other zone has, found that of the zone of row {row}, which is in no group"
                ));
            }
            by_name.insert(key, zones.of[row]);
        }
        Ok(Some(zones))
    }

    /// What to say where the file has no names that zones could be made by.
    pub fn doubt(&self, facets: &Facets, by: Option<By>) -> Option<&'static str> {
        let (names, what) = match by? {
            By::Object => (
                &facets.objects,
                "the file names no objects: all facets that no group names are one zone",
            ),
            By::Material => (
                &facets.materials,
                "the file names no materials: all facets that no group names are one zone",
            ),
        };
        let unnamed = names.iter().all(String::is_empty);
        (unnamed && self.names.iter().any(|n| n == UNNAMED)).then_some(what)
    }

    fn named(&mut self, name: &str) -> u32 {
        let known = self.names.iter().position(|n| n == name);
        known.unwrap_or_else(|| {
            self.names.push(name.to_string());
            self.names.len() - 1
        }) as u32
    }

    fn take(&mut self, facets: &Facets, member: &str, zone: u32) -> Result<(), String> {
        let mut found = false;
        let run = parse_rows(member).ok();
        let objects: Vec<bool> = facets.objects.iter().map(|o| o == member).collect();
        let materials: Vec<bool> = facets.materials.iter().map(|m| m == member).collect();
        let holds = |list: &[bool], k: u32| list.get(k as usize).copied().unwrap_or(false);
        let is_name = objects.iter().chain(&materials).any(|&is| is)
            || facets.rows.iter().any(|f| f.name == member);
        let count = facets.rows.len();
        if let Some(run) = run.as_ref().filter(|_| !is_name)
            && (run.start as usize >= count || (run.end as usize > count && run.end != u32::MAX))
        {
            return Err(format!("expected rows below {count}, found '{member}'"));
        }
        for row in 0..facets.rows.len() {
            let facet = &facets.rows[row];
            let named = (!facet.name.is_empty() && facet.name == member)
                || holds(&objects, facet.object)
                || holds(&materials, facet.material);
            if named || run.as_ref().is_some_and(|r| r.contains(&(row as u32))) {
                found = true;
                if self.of[row] != u32::MAX && self.of[row] != zone {
                    return Err(format!(
                        "expected each facet in one group, found row {row} in '{}' as well",
                        self.names[self.of[row] as usize]
                    ));
                }
                self.of[row] = zone;
            }
        }
        if found {
            return Ok(());
        }
        let some: Vec<&str> = facets
            .objects
            .iter()
            .chain(&facets.materials)
            .map(String::as_str)
            .filter(|n| !n.is_empty())
            .take(12)
            .collect();
        Err(format!(
            "expected an object, a material, a facet or rows like 0..10, found '{member}'; there are {}",
            if some.is_empty() {
                "no names".to_string()
            } else {
                some.join(", ")
            }
        ))
    }

    /// Of each zone, whether `keep` has all its rows.
    pub fn complete(&self, keep: &[bool]) -> Vec<bool> {
        let mut complete = vec![true; self.names.len()];
        for (&zone, &kept) in self.of.iter().zip(keep) {
            complete[zone as usize] &= kept;
        }
        complete
    }

    /// Area of each zone, m².
    pub fn areas(&self, row_areas: &[f64]) -> Vec<f64> {
        let mut areas = vec![0.0; self.names.len()];
        for (zone, area) in self.of.iter().zip(row_areas) {
            areas[*zone as usize] += area;
        }
        areas
    }
}

/// Name of an object or a material; empty if it has none.
pub(super) fn name_of(names: &[String], index: u32) -> &str {
    names.get(index as usize).map_or("", String::as_str)
}

/// Rows `a..b`, counted from 0, without b; `a..` to the end; `..b` from the first; `a` alone.
pub fn parse_rows(text: &str) -> Result<std::ops::Range<u32>, String> {
    let wrong = || {
        format!("expected rows as 0..100 (from 0, without the last), 100.. or 7, found '{text}'")
    };
    let number = |t: &str| {
        t.trim().parse::<u32>().map_err(|e| match e.kind() {
            IntErrorKind::PosOverflow => {
                format!("expected rows below {}, found '{text}'", u32::MAX)
            }
            _ => wrong(),
        })
    };
    let run = match text.split_once("..") {
        None => {
            let row = number(text)?;
            row..row.checked_add(1).ok_or_else(wrong)?
        }
        Some((a, b)) => {
            let start = if a.trim().is_empty() { 0 } else { number(a)? };
            let end = if b.trim().is_empty() {
                u32::MAX
            } else {
                number(b)?
            };
            start..end
        }
    };
    if run.start >= run.end {
        return Err(format!(
            "expected the first row before the end, as 0..100, found '{text}', which has no row"
        ));
    }
    Ok(run)
}

/// A stored matrix with few columns a row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    columns: usize,
    rows: Vec<Vec<(u32, f64)>>,
}

impl Table {
    /// Of rows in order, with ascending columns.
    pub fn new(columns: usize, rows: Vec<Vec<(u32, f64)>>) -> Table {
        Table { columns, rows }
    }

    /// Factors from each kept row, or each zone, to each zone.
    ///
    /// `keep` says which rows are complete; zones with others are left empty.
    pub fn of_zones(
        factors: &dyn SparseRows,
        areas: &[f64],
        zones: &Zones,
        from_zones: bool,
        keep: &[bool],
    ) -> Table {
        let n = zones.names.len();
        let mut entries = Vec::new();
        let to_zones = |sums: &[f64]| -> Vec<(u32, f64)> {
            let above = |(zone, &f): (usize, &f64)| (f > 0.0).then_some((zone as u32, f));
            sums.iter().enumerate().filter_map(above).collect()
        };
        let rows = areas.len();
        if !from_zones {
            let mut sums = vec![0.0; n];
            let rows = (0..rows)
                .map(|row| {
                    sums.fill(0.0);
                    if keep[row] {
                        factors.row(row, &mut entries);
                        for &(j, f) in &entries {
                            sums[zones.of[j as usize] as usize] += f;
                        }
                    }
                    to_zones(&sums)
                })
                .collect();
            return Table::new(n, rows);
        }
        let zone_areas = zones.areas(areas);
        let mut sums = vec![vec![0.0; n]; n];
        let complete = zones.complete(keep);
        for row in 0..rows {
            let zone = zones.of[row] as usize;
            if !complete[zone] {
                continue;
            }
            factors.row(row, &mut entries);
            for &(j, f) in &entries {
                sums[zone][zones.of[j as usize] as usize] += f * areas[row];
            }
        }
        let rows = sums
            .iter_mut()
            .enumerate()
            .map(|(zone, sums)| {
                if !complete[zone] {
                    return Vec::new();
                }
                sums.iter_mut().for_each(|s| *s /= zone_areas[zone]);
                to_zones(sums)
            })
            .collect();
        Table::new(n, rows)
    }
}

impl SparseRows for Table {
    fn shape(&self) -> [usize; 2] {
        [self.rows.len(), self.columns]
    }

    fn entries(&self) -> u64 {
        self.rows.iter().map(|r| r.len() as u64).sum()
    }

    fn row(&self, row: usize, entries: &mut Vec<(u32, f64)>) {
        entries.clear();
        entries.extend_from_slice(&self.rows[row]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_core::Facet;

    fn facets() -> Facets {
        let row = |name: &str, object, material| Facet {
            name: name.into(),
            object,
            material,
        };
        Facets {
            rows: vec![
                row("a", 0, 0),
                row("b", 0, 1),
                row("c", 1, 1),
                row("", 1, 0),
            ],
            objects: vec!["shell".into(), "box".into()],
            materials: vec!["white".into(), "black".into()],
            ..Facets::default()
        }
    }

    #[test]
    fn wishes_become_zones() {
        let wish = |by, groups: &[&str]| ZoneWishes {
            by,
            groups: groups.iter().map(|g| g.to_string()).collect(),
        };
        let zones = |w| Zones::new(&facets(), &w);
        assert_eq!(zones(wish(None, &[])), Ok(None));
        let by = zones(wish(Some(By::Material), &[])).unwrap().unwrap();
        assert_eq!(
            (by.names, by.of),
            (vec!["white".into(), "black".into()], vec![0, 1, 1, 0])
        );
        let mixed = zones(wish(Some(By::Object), &["lid=c"])).unwrap().unwrap();
        assert_eq!(mixed.of, [1, 1, 0, 2]);
        let rest = zones(wish(None, &["x=shell, 3"])).unwrap().unwrap();
        assert_eq!(
            (rest.names, rest.of),
            (vec!["x".into(), "rest".into()], vec![0, 0, 1, 0])
        );
        for bad in [
            "x", "=a", "x=", "x=nobody", "x=9..4", "x=1..5", "x=4", "x=4..",
        ] {
            assert!(zones(wish(None, &[bad])).is_err(), "{bad}");
        }
        let beyond = zones(wish(None, &["x=1..900"])).unwrap_err();
        assert!(
            beyond.ends_with("expected rows below 4, found '1..900'"),
            "{beyond}"
        );
        let open = zones(wish(None, &["x=2.."])).unwrap().unwrap();
        assert_eq!(open.of, [1, 1, 0, 0]);
        let twice = zones(wish(None, &["x=a", "y=shell"])).unwrap_err();
        assert!(twice.contains("row 0 in 'x'"), "{twice}");
        // Groups may take names of zones that nothing is left of, and go on in a second one.
        for (by, groups) in [
            (Some(By::Object), &["box=box,a"][..]),
            (None, &["rest=shell,box"]),
            (None, &["x=a", "x=b"]),
        ] {
            assert!(zones(wish(by, groups)).is_ok(), "{groups:?}");
        }
        for (by, group) in [
            (None, "rest=a"),
            (Some(By::Object), "box=a"),
            (Some(By::Material), "black=b"),
        ] {
            let told = zones(wish(by, &[group])).unwrap_err();
            let name = group.split_once('=').unwrap().0;
            let said = format!("--group {name}=...: expected a name that no other zone has");
            assert!(told.starts_with(&said), "{told}");
        }
    }

    #[test]
    fn files_without_names_are_told() {
        let mut facets = facets();
        let said = |facets: &Facets, by, groups: Vec<String>| {
            let zones = Zones::new(facets, &ZoneWishes { by, groups });
            zones.unwrap().unwrap().doubt(facets, by)
        };
        let by = Some(By::Material);
        assert_eq!(said(&facets, by, vec![]), None);
        facets.materials = vec![String::new(); 2];
        let told = said(&facets, by, vec![]).unwrap();
        assert!(told.starts_with("the file names no materials"), "{told}");
        assert_eq!(said(&facets, by, vec!["all=0..".into()]), None);
        assert_eq!(said(&facets, Some(By::Object), vec![]), None);
        facets.materials[1] = "black".into();
        assert_eq!(said(&facets, by, vec![]), None, "two zones");
    }

    #[test]
    fn rows_are_runs() {
        assert_eq!(parse_rows("3..7"), Ok(3..7));
        assert_eq!(parse_rows("3.."), Ok(3..u32::MAX));
        assert_eq!(parse_rows("..7"), Ok(0..7));
        assert_eq!(parse_rows("4"), Ok(4..5));
        for bad in ["", "a", "7..3", "3..3", "-1..2", "1..2..3"] {
            assert!(parse_rows(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn zones_add_what_their_rows_have() {
        // Areas 1, 3 and 2; F by hand, G symmetric.
        let rows = vec![
            vec![(1, 0.6), (2, 0.4)],
            vec![(0, 0.2), (2, 0.1)],
            vec![(0, 0.2), (1, 0.15)],
        ];
        let (factors, areas) = (Table::new(3, rows), [1.0, 3.0, 2.0]);
        let zones = Zones {
            names: vec!["x".into(), "y".into()],
            of: vec![0, 0, 1],
        };
        let both = Table::of_zones(&factors, &areas, &zones, true, &[true; 3]);
        let mut row = Vec::new();
        both.row(0, &mut row);
        // (0.6 + 3 x 0.2) / 4 and (0.4 + 3 x 0.1) / 4.
        assert!((row[0].1 - 0.3).abs() < 1e-15 && (row[1].1 - 0.175).abs() < 1e-15);
        assert_eq!(zones.complete(&[true, false, true]), [false, true]);
        let some = Table::of_zones(&factors, &areas, &zones, true, &[true, false, true]);
        some.row(0, &mut row);
        assert!(row.is_empty());
        some.row(1, &mut row);
        assert!(row.len() == 1 && (row[0].1 - 0.35).abs() < 1e-15);
        let single = Table::of_zones(&factors, &areas, &zones, false, &[true, false, true]);
        single.row(1, &mut row);
        assert!(row.is_empty());
        single.row(2, &mut row);
        assert!(row.len() == 1 && (row[0].1 - 0.35).abs() < 1e-15);
    }
}
