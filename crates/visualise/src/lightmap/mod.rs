//! Lightmaps: the light of every surface as texels, with no work for whoever made the scene.
//!
//! [`Charts`] lays surfaces out in an atlas: see `pieces` for what hangs together, `charts` for
//! what shares a lattice, `lattice` for where the light of a texel is asked, `atlas` for packing.
//! [`Sparse`] says which texels to ask, round by round, and ends in a [`Lightmap`].
//!
//! A texel's value belongs to its lattice point, and between four of them light is bilinear, as
//! graphics hardware shows it. Outermost lattice points lie on the borders of a rectangle, so that
//! what is shown never extrapolates, and no texel of another chart, surface or room is mixed in.

mod atlas;
mod charts;
mod covered;
mod lattice;
mod pieces;
mod sparse;
#[cfg(test)]
mod tests;

use crate::lit_mesh::LitMesh;
use atlas::Place;
use charts::Sheet;
use lattice::{Cover, Kind};
use luxel_core::{Buckets, Front, Rgb, Scene, Side, Vec2, Vec3};
use luxel_gather::Receiver;
use luxel_transport::RayCaster;
use pieces::Pieces;
use rayon::prelude::*;
pub use sparse::Sparse;

/// Texels around a chart that repeat its border.
const GUTTER: u32 = 1;
/// A flat sheet has at most this share of all texels.
const MOST_IN_SHEET: f64 = 0.25;
/// Charts of at most so many texels may share answers.
const TINY: usize = 4;
/// How much wider texels get when the pages do not hold them.
const WIDER: f32 = 1.25;
/// Tries to make texels wide enough.
const MOST_TRIES: u32 = 60;

/// How fine a lightmap is, and how large it may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChartSettings {
    /// Metres from texel to texel, above 0. Large sheets and full pages have wider ones.
    pub texel_m: f32,
    /// About the most texels, above 0.
    pub most_texels: f64,
    /// Longest edge of a page, texels; at least 1024.
    pub largest_page: u32,
    /// Most pages.
    pub most_pages: usize,
}

/// A rectangle of texels.
#[derive(Clone, Debug)]
pub(crate) struct Chart {
    sheet: u32,
    /// Lattice point of its first texel.
    first: [u32; 2],
    /// Texels across and down.
    size: [u32; 2],
    /// Index of its first texel.
    start: usize,
    place: Place,
    /// Texels of charts with the same number may share an answer: that of its surface side for charts
    /// that are tiny and whole, as the pages of a book, and one of its own for every other.
    kin: u64,
}

impl Chart {
    fn texel(&self, x: u32, y: u32) -> usize {
        self.start + (y * self.size[0] + x) as usize
    }

    fn count(&self) -> usize {
        (self.size[0] * self.size[1]) as usize
    }
}

/// The atlas of a front: its charts, and where the light of each texel is asked.
pub struct Charts {
    pieces: Pieces,
    sheets: Vec<Sheet>,
    charts: Vec<Chart>,
    /// Chart of each piece.
    chart_of: Vec<u32>,
    /// Of each texel of each chart, chart by chart.
    kind: Vec<Kind>,
    receivers: Vec<Receiver>,
    pages: Vec<[u32; 2]>,
    texel_m: f32,
}

impl Charts {
    /// Lays out all lit sides of a front. The same charts for any thread count.
    ///
    /// With a `caster`, charts are parted where something stands on a surface. Texels are widened
    /// until pages and `most_texels` hold them; see [`Charts::texel_m`].
    pub fn build(
        scene: &Scene,
        front: &Front,
        caster: Option<&dyn RayCaster>,
        settings: &ChartSettings,
    ) -> Charts {
        let area: f64 = front.total_area();
        let fitting = (area / settings.most_texels).sqrt() as f32;
        let mut texel_m = settings.texel_m.max(fitting).max(f32::MIN_POSITIVE);
        for _ in 1..MOST_TRIES {
            if let Some(charts) = Charts::try_build(scene, front, caster, settings, texel_m) {
                return charts;
            }
            texel_m *= WIDER;
        }
        // Charts of one texel each are more than the pages hold: no chart at all.
        Charts {
            pieces: Pieces::default(),
            sheets: Vec::new(),
            charts: Vec::new(),
            chart_of: Vec::new(),
            kind: Vec::new(),
            receivers: Vec::new(),
            pages: Vec::new(),
            texel_m,
        }
    }

    fn try_build(
        scene: &Scene,
        front: &Front,
        caster: Option<&dyn RayCaster>,
        settings: &ChartSettings,
        texel_m: f32,
    ) -> Option<Charts> {
        let pieces = Pieces::new(scene, front, caster, texel_m);
        let (sheets, groups) =
            charts::group(&pieces, texel_m, MOST_IN_SHEET * settings.most_texels);
        let mut chart_of = vec![pieces::NONE; pieces.len()];
        for (k, group) in groups.iter().enumerate() {
            group
                .pieces
                .iter()
                .for_each(|&p| chart_of[p as usize] = k as u32);
        }
        let mut in_sheet = vec![0u32; sheets.len()];
        groups.iter().for_each(|g| in_sheet[g.sheet as usize] += 1);
        let covers: Vec<Option<Cover>> = (sheets.par_iter().zip(&in_sheet))
            .map(|(sheet, &n)| {
                (n > 1).then(|| Cover::new(&pieces, sheet, &sheet.pieces, [0, 0], sheet.size))
            })
            .collect();
        let hard = Buckets::new(
            pieces.len(),
            pieces
                .hard
                .iter()
                .enumerate()
                .map(|(k, e)| (e.piece as usize, k as u32)),
        );
        let laid: Vec<lattice::Texels> = (groups.par_iter())
            .map(|group| {
                let of_pieces = |p: &u32| hard.of(*p as usize).iter();
                let edges: Vec<pieces::HardEdge> = (group.pieces.iter().flat_map(of_pieces))
                    .map(|&k| pieces.hard[k as usize])
                    .collect();
                let (sheet, cover) = (&sheets[group.sheet as usize], &covers[group.sheet as usize]);
                lattice::texels(&pieces, sheet, group, cover.as_ref(), &edges)
            })
            .collect();
        let sizes: Vec<[u32; 2]> = laid
            .iter()
            .map(|t| t.size.map(|n| n + 2 * GUTTER))
            .collect();
        let (places, pages) = atlas::pack(&sizes, settings.largest_page, settings.most_pages)?;
        let (mut kind, mut receivers) = (Vec::new(), Vec::new());
        let mut charts = Vec::with_capacity(groups.len());
        for ((group, texels), place) in groups.iter().zip(laid).zip(places) {
            let piece = group.pieces[0] as usize;
            let is_tiny = texels.kind.len() <= TINY && in_sheet[group.sheet as usize] == 1;
            let kin = match is_tiny {
                true => 2 * pieces.surface[piece].0 as u64 + pieces.side[piece] as u64,
                false => (1 << 40) + charts.len() as u64,
            };
            charts.push(Chart {
                sheet: group.sheet,
                first: texels.first,
                size: texels.size,
                start: kind.len(),
                place,
                kin,
            });
            kind.extend(texels.kind);
            receivers.extend(texels.receivers);
        }
        Some(Charts {
            pieces,
            sheets,
            charts,
            chart_of,
            kind,
            receivers,
            pages,
            texel_m,
        })
    }

    /// Texels of all charts, used or not.
    pub fn texels(&self) -> usize {
        self.kind.len()
    }

    /// Texels that light is shown with.
    pub fn used(&self) -> usize {
        self.kind.iter().filter(|&&k| k != Kind::Unused).count()
    }

    /// Number of charts.
    pub fn len(&self) -> usize {
        self.charts.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.charts.is_empty()
    }

    /// Width and height of each page.
    pub fn pages(&self) -> &[[u32; 2]] {
        &self.pages
    }

    /// Metres from texel to texel, but for large sheets.
    pub fn texel_m(&self) -> f32 {
        self.texel_m
    }

    /// Chart of one side of a source triangle; `None` where it is black.
    pub fn chart_at(&self, front: &Front, triangle: u32, side: Side) -> Option<u32> {
        if self.is_empty() {
            return None;
        }
        let piece = self.pieces.at(front, triangle, side)?;
        Some(self.chart_of[piece as usize])
    }

    /// Page of a chart; the first for what has none.
    pub fn page_of(&self, chart: u32) -> u32 {
        self.charts.get(chart as usize).map_or(0, |c| c.place.page)
    }

    /// Texture coordinates on the page of a point on a chart, 0..1 from the upper left.
    pub fn uv_of(&self, chart: u32, point: Vec3) -> Vec2 {
        let Some(c) = self.charts.get(chart as usize) else {
            return Vec2::ZERO;
        };
        let at = self.in_chart(c, point);
        let [w, h] = self.pages[c.place.page as usize];
        let corner = Vec2::new(c.place.corner[0] as f32, c.place.corner[1] as f32);
        (corner + at + GUTTER as f32 + 0.5) / Vec2::new(w as f32, h as f32)
    }

    /// Texels from the first of a chart.
    fn in_chart(&self, chart: &Chart, point: Vec3) -> Vec2 {
        let sheet = &self.sheets[chart.sheet as usize];
        let at = sheet.lattice(sheet.project(point));
        let first = Vec2::new(chart.first[0] as f32, chart.first[1] as f32);
        let last = Vec2::new((chart.size[0] - 1) as f32, (chart.size[1] - 1) as f32);
        (at - first).clamp(Vec2::ZERO, last)
    }

    fn kin_of_texel(&self, texel: usize) -> u64 {
        self.charts[self.chart_of_texel(texel)].kin
    }

    fn texel_area(&self, texel: usize) -> f32 {
        let sheet = &self.sheets[self.charts[self.chart_of_texel(texel)].sheet as usize];
        (sheet.step[0] * sheet.step[1]).max(f32::MIN_POSITIVE)
    }

    fn chart_of_texel(&self, texel: usize) -> usize {
        self.charts.partition_point(|c| c.start <= texel) - 1
    }

    /// Lays the charts over a mesh: its vertices are divided where charts end. Answers with the
    /// chart of each vertex.
    pub fn lay_over(&self, front: &Front, mesh: &mut LitMesh) -> Vec<u32> {
        mesh.divide(
            |source, side| self.chart_at(front, source, side).unwrap_or(pieces::NONE),
            |chart| self.page_of(chart),
        )
    }
}

/// A lightmap that lies over a mesh.
pub struct Texels {
    /// Its layout.
    pub charts: Charts,
    /// Its light.
    pub lightmap: Lightmap,
    /// Chart of each vertex of the mesh, as [`Charts::lay_over`] answered.
    pub of_vertex: Vec<u32>,
}

impl Texels {
    /// Whether the triangles around a vertex have texels.
    pub fn has(&self, vertex: usize) -> bool {
        self.of_vertex
            .get(vertex)
            .is_some_and(|&c| c != pieces::NONE)
    }

    /// Illuminance at a point of the chart of a vertex, lux.
    pub fn at(&self, vertex: usize, point: Vec3) -> Rgb {
        self.lightmap
            .at(&self.charts, self.of_vertex[vertex], point)
            .0
    }
}

/// The light of the texels of some [`Charts`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lightmap {
    /// Illuminance in linear bands, all groups together, lux.
    values: Vec<Rgb>,
    /// Standard error of the photometric value, lux.
    errors: Vec<f32>,
    /// Texels that were asked; the others are interpolated.
    asked: usize,
}

impl Lightmap {
    /// Texels whose light was asked; that of the others is interpolated.
    pub fn asked(&self) -> usize {
        self.asked
    }

    /// Light at a point of a chart, lux, and its standard error, as a viewer interpolates it.
    pub fn at(&self, charts: &Charts, chart: u32, point: Vec3) -> (Rgb, f32) {
        let c = &charts.charts[chart as usize];
        let p = charts.in_chart(c, point);
        let (x, y) = (p.x.floor() as u32, p.y.floor() as u32);
        let (x1, y1) = ((x + 1).min(c.size[0] - 1), (y + 1).min(c.size[1] - 1));
        let (s, t) = (p.x - x as f32, p.y - y as f32);
        let corners = [
            (x, y, (1.0 - s) * (1.0 - t)),
            (x1, y, s * (1.0 - t)),
            (x, y1, (1.0 - s) * t),
            (x1, y1, s * t),
        ];
        let (mut value, mut error, mut whole) = (Rgb::BLACK, 0.0, 0.0);
        for (x, y, w) in corners {
            let texel = c.texel(x, y);
            if charts.kind[texel] != Kind::Unused {
                value += self.values[texel] * w;
                error += self.errors[texel] * w;
                whole += w;
            }
        }
        if whole <= 0.0 {
            return (Rgb::BLACK, 0.0);
        }
        (value * (1.0 / whole), error / whole)
    }

    /// Sets the light of the vertices of a mesh that the charts lie over.
    pub fn light(&self, charts: &Charts, chart_of_vertex: &[u32], mesh: &mut LitMesh) {
        let at = |(&p, &chart): (&Vec3, &u32)| match chart {
            pieces::NONE => (Rgb::BLACK, 0.0),
            chart => self.at(charts, chart, p),
        };
        let (values, errors) = mesh
            .positions
            .par_iter()
            .zip(chart_of_vertex)
            .map(at)
            .unzip();
        mesh.set_light(values, errors);
    }

    /// The texels of a page, row by row from the upper left, lux. What no chart uses has the light of
    /// its surroundings, so that filters find nothing strange there; far from any chart it is black.
    pub fn page(&self, charts: &Charts, page: u32) -> Vec<Rgb> {
        let [w, h] = charts.pages[page as usize];
        let mut out = vec![Rgb::BLACK; (w * h) as usize];
        for chart in charts.charts.iter().filter(|c| c.place.page == page) {
            let filled = self.filled(charts, chart);
            let [cw, ch] = chart.size;
            for y in 0..ch + 2 * GUTTER {
                for x in 0..cw + 2 * GUTTER {
                    let (i, j) = (
                        x.saturating_sub(GUTTER).min(cw - 1),
                        y.saturating_sub(GUTTER).min(ch - 1),
                    );
                    let to = (chart.place.corner[1] + y) * w + chart.place.corner[0] + x;
                    out[to as usize] = filled[(j * cw + i) as usize];
                }
            }
        }
        out
    }

    /// Texels of a chart; unused ones take the mean of their neighbours, ring by ring.
    fn filled(&self, charts: &Charts, chart: &Chart) -> Vec<Rgb> {
        let [w, h] = chart.size;
        let run = chart.start..chart.start + chart.count();
        let mut values = self.values[run.clone()].to_vec();
        let mut used: Vec<bool> = charts.kind[run]
            .iter()
            .map(|&k| k != Kind::Unused)
            .collect();
        let mut left: Vec<u32> = (0..w * h).filter(|&t| !used[t as usize]).collect();
        while !left.is_empty() {
            let mut found = Vec::new();
            for &t in &left {
                let (x, y) = (t % w, t / w);
                let (mut sum, mut n) = (Rgb::BLACK, 0);
                for j in y.saturating_sub(1)..=(y + 1).min(h - 1) {
                    for i in x.saturating_sub(1)..=(x + 1).min(w - 1) {
                        let k = (j * w + i) as usize;
                        if used[k] {
                            sum += values[k];
                            n += 1;
                        }
                    }
                }
                if n > 0 {
                    found.push((t, sum * (1.0 / n as f32)));
                }
            }
            if found.is_empty() {
                break;
            }
            for &(t, value) in &found {
                (values[t as usize], used[t as usize]) = (value, true);
            }
            left.retain(|&t| !used[t as usize]);
        }
        values
    }
}
