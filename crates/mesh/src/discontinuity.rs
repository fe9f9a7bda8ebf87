//! Discontinuity mesh: element borders follow the borders of umbra and penumbra.
//!
//! Where light falls on a surface past an occluder, its illuminance (point luminaires) or the
//! derivative of it (area luminaires) jumps along lines. An element across such a line holds one
//! value for two; no refinement makes that good but slowly. So the lines are found first
//! ([`events`]), large surfaces are cut along them in [`prepare`](mod@crate::prepare) as along
//! contact lines, and cells between them are filled with triangles about as large as elements.
//! Refinement is that of the adaptive mesh: cells are quadtrees, split where neighbours differ.
//!
//! Only the limits of umbra and penumbra are drawn: planes that touch luminaire and occluder from
//! one side each (supporting planes) through an edge of one and a vertex of the other. Not drawn:
//! kinks inside a penumbra, lines of three edges, shadows by reflected light.
//!
//! Source: [Heckbert92], [Lischinski92]; extremal planes as in [Nishita85].

mod edges;
pub(crate) mod events;
mod sources;
