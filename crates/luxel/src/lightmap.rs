//! Lightmaps of a session: laid out by its front, asked round by round as far as time allows.

use crate::light::most_rays;
use crate::session::Session;
use crate::sites::Sites;
use crate::watch::Watch;
use crate::work::{self, End, Gathering, Rest};
use luxel_core::Solution;
use luxel_visualise::{ChartSettings, Charts, Lightmap, Sparse};
use std::time::Instant;

/// Metres from texel to texel unless said, or less in small scenes; and about how many texels a scene
/// has at least and at most.
const TEXEL_M: f64 = 0.05;
const FEWEST_TEXELS: f64 = 60_000.0;
const MOST_TEXELS: f64 = 250_000.0;
/// Longest edge of a page: what every graphics card can show.
const LARGEST_PAGE: u32 = 4096;
/// Most pages.
pub(crate) const MOST_PAGES: usize = 8;
/// Texels that are nearer than this share of their distance, as on the pages of a book, share one
/// answer. Points of one lattice never do.
const SHARED: f32 = 0.5;
/// Share of the time left that a round may take: later ones are finer, and may be left out.
const ROUND_SHARE: f64 = 0.6;

/// What came of lighting the texels.
pub(crate) struct Made {
    pub lightmap: Lightmap,
    pub rays: u64,
    pub end: End,
}

/// Lays out the lit sides of a session; `None` when there is nothing lit, or more than pages hold.
pub(crate) fn charts(session: &Session) -> Option<Charts> {
    let texel = session.settings().texel_m;
    let fine = (session.front().total_area() / FEWEST_TEXELS).sqrt();
    let settings = ChartSettings {
        texel_m: texel.unwrap_or(TEXEL_M.min(fine)) as f32,
        most_texels: match texel {
            Some(_) => (LARGEST_PAGE as f64).powi(2) * MOST_PAGES as f64,
            None => MOST_TEXELS,
        },
        largest_page: LARGEST_PAGE,
        most_pages: MOST_PAGES,
    };
    let charts = Charts::build(
        session.scene(),
        session.front(),
        Some(session.caster()),
        &settings,
    );
    (!charts.is_empty()).then_some(charts)
}

/// Asks the light of the texels, all groups together.
pub(crate) fn light(
    session: &Session,
    solution: &Solution,
    charts: &Charts,
    watch: &mut Watch<'_>,
) -> Made {
    let (merged, lights) = (solution.merged(), session.lights().merged());
    let gatherer = session.gatherer(&merged, &lights);
    let accuracy = session.accuracy(solution);
    let most_rays = most_rays(session.settings());
    let mut sparse = Sparse::new(charts, 0.5 * session.settings().error as f32);
    let (began, bound) = (Instant::now(), session.time_left());
    let (mut rays, mut end) = (0u64, End::Reached);
    loop {
        let wanted = sparse.wanted();
        if wanted.is_empty() || end == End::Stopped {
            break;
        }
        let kin = sparse.wanted_kin();
        let mut runs = Vec::new();
        let mut first = 0;
        for run in kin.chunk_by(|a, b| a == b) {
            runs.push(first..first + run.len());
            first += run.len();
        }
        let edge_m = SHARED * charts.texel_m();
        let sites = Sites::new(&wanted, &sparse.wanted_areas(), runs.into_iter(), edge_m);
        let left = bound.map(|b| b.saturating_sub(began.elapsed()));
        let is_first = sparse.asked() == 0;
        let (asked, ended) = work::gather(
            &gatherer,
            &Gathering {
                receivers: &sites.receivers,
                weights: &sites.weights,
                time: left.map(|l| l.mul_f64(ROUND_SHARE)),
                most_rays: (most_rays - rays as f64).max(1.0),
                rest: if is_first {
                    Rest::Hurried
                } else {
                    Rest::LeftOut
                },
            },
            &accuracy,
            watch,
        );
        rays += asked.rays;
        end = ended;
        let answers = (0..wanted.len())
            .map(|k| sites.of(k))
            .take_while(|&site| site < asked.errors.len())
            .map(|site| (asked.total(site), asked.errors[site]));
        sparse.take(answers);
    }
    let mut lightmap = sparse.finish();
    lightmap.uncover(charts, session.caster());
    Made {
        lightmap,
        rays,
        end,
    }
}
