//! Pieces: the flat parts that charts are put together from, and where they join.
//!
//! A piece is a whole flat patch, or one triangle of a cluster. Two pieces of one surface side that
//! share an edge are joined when light goes on smoothly from one to the other: flat ones that lie in
//! one plane, and facets that fold by less than a crease. Where something stands on the shared
//! edge, so that points on both sides of it do not see each other, the joint is blocked: light may
//! jump there, and no texel may lie on both sides.

use crate::places::welded;
use crate::sets::Sets;
use luxel_core::{Front, Scene, Shape, Side, SurfaceId, Vec3};
use luxel_transport::{Ray, RayCaster};
use std::collections::HashMap;

/// Facets of a cluster that fold by less than this are one smooth surface: cosine of 30 degrees.
const COS_CREASE: f32 = 0.866;
/// Flat pieces are in one plane when the cosine between their normals is larger.
const COS_FLAT: f32 = 1.0 - 1e-6;
/// More triangles than this at one edge are no wall.
const MOST_AROUND: usize = 8;
/// Sight across an edge is tested at least so often, and once for so many texels of length.
const FEWEST_LOOKS: usize = 3;
const MOST_LOOKS: usize = 64;
const TEXELS_A_LOOK: f32 = 4.0;
/// Sight across an edge: reach on both sides and height above the surface, in texels.
const REACH: f32 = 0.25;
const HEIGHT: f32 = 0.1;

/// No piece.
pub(crate) const NONE: u32 = u32::MAX;

/// Welded ends of an edge of a source triangle, and the piece that it borders.
type Edge = ([u32; 2], u32);

/// A shared edge.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Joint {
    pub pieces: [u32; 2],
    pub ends: [Vec3; 2],
    pub blocked: bool,
}

/// An edge of a piece that is no open joint: light may jump there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HardEdge {
    pub piece: u32,
    pub ends: [Vec3; 2],
}

/// The pieces of a front. Arrays of one entry a piece.
#[derive(Debug, Default)]
pub(crate) struct Pieces {
    pub surface: Vec<SurfaceId>,
    pub side: Vec<Side>,
    /// Whether it is a whole patch (otherwise a facet of a cluster).
    pub flat: Vec<bool>,
    pub normal: Vec<Vec3>,
    pub area: Vec<f32>,
    first_corner: Vec<u32>,
    corners: Vec<Vec3>,
    /// Smooth normal at each corner.
    pub corner_normals: Vec<Vec3>,
    /// Piece of each flat patch.
    of_patch: Vec<u32>,
    /// Piece of the front and back of each triangle of a cluster.
    of_facet: HashMap<(u32, u8), u32>,
    pub joints: Vec<Joint>,
    pub hard: Vec<HardEdge>,
}

impl Pieces {
    pub fn new(
        scene: &Scene,
        front: &Front,
        caster: Option<&dyn RayCaster>,
        texel_m: f32,
    ) -> Pieces {
        let mut p = Pieces {
            of_patch: vec![NONE; front.patches.len()],
            first_corner: vec![0],
            ..Pieces::default()
        };
        for (k, patch) in front.patches.iter().enumerate() {
            match &patch.shape {
                Shape::Parallelogram {
                    origin,
                    edge_u,
                    edge_v,
                } => {
                    let o = *origin;
                    let ring = [o, o + *edge_u, o + *edge_u + *edge_v, o + *edge_v];
                    p.of_patch[k] = p.len() as u32;
                    p.add(patch.surface, patch.side, true, patch.normal, &ring);
                }
                Shape::Triangle {
                    origin,
                    edge_u,
                    edge_v,
                } => {
                    let ring = [*origin, *origin + *edge_u, *origin + *edge_v];
                    p.of_patch[k] = p.len() as u32;
                    p.add(patch.surface, patch.side, true, patch.normal, &ring);
                }
                Shape::Cluster { triangles } => {
                    let run = triangles.start as usize..triangles.end as usize;
                    for c in &front.cluster_triangles[run] {
                        let [a, mut b, mut c_] = scene.corners(c.triangle as usize);
                        if patch.side == Side::Back {
                            std::mem::swap(&mut b, &mut c_);
                        }
                        let n = (b - a).as_dvec3().cross((c_ - a).as_dvec3());
                        let normal = n.normalize_or_zero().as_vec3();
                        let key = (c.triangle, patch.side as u8);
                        p.of_facet.insert(key, p.len() as u32);
                        p.add(patch.surface, patch.side, false, normal, &[a, b, c_]);
                    }
                }
            }
        }
        let edges = p.edges(scene, front);
        p.join(scene, &edges);
        if let Some(caster) = caster {
            p.look_across(caster, texel_m);
        }
        p.find_hard_edges(scene, &edges);
        p.smooth_normals();
        p
    }

    pub fn len(&self) -> usize {
        self.surface.len()
    }

    /// Corners in order, counter-clockwise seen from the lit side.
    pub fn corners(&self, piece: usize) -> &[Vec3] {
        &self.corners[self.run(piece)]
    }

    /// Normals at its corners.
    pub fn normals(&self, piece: usize) -> &[Vec3] {
        &self.corner_normals[self.run(piece)]
    }

    fn run(&self, piece: usize) -> std::ops::Range<usize> {
        self.first_corner[piece] as usize..self.first_corner[piece + 1] as usize
    }

    /// Middle of its corners.
    pub fn centre(&self, piece: usize) -> Vec3 {
        let ring = self.corners(piece);
        ring.iter().copied().sum::<Vec3>() / ring.len() as f32
    }

    /// The piece at one side of a source triangle; `None` where the side is black.
    pub fn at(&self, front: &Front, triangle: u32, side: Side) -> Option<u32> {
        let patch = front.patch_of[triangle as usize][side as usize];
        if !patch.is_some() {
            return None;
        }
        match self.of_patch[patch.index()] {
            NONE => self.of_facet.get(&(triangle, side as u8)).copied(),
            piece => Some(piece),
        }
    }

    fn add(&mut self, surface: SurfaceId, side: Side, flat: bool, normal: Vec3, ring: &[Vec3]) {
        self.surface.push(surface);
        self.side.push(side);
        self.flat.push(flat);
        self.normal.push(normal);
        let twice: f32 = (2..ring.len())
            .map(|k| (ring[k - 1] - ring[0]).cross(ring[k] - ring[0]).length())
            .sum();
        self.area.push(0.5 * twice);
        self.corners.extend_from_slice(ring);
        self.first_corner.push(self.corners.len() as u32);
    }

    /// Edges of all source triangles by place, with the piece and side that they border.
    fn edges(&self, scene: &Scene, front: &Front) -> Vec<Edge> {
        let place = welded(scene);
        let mut edges = Vec::with_capacity(3 * scene.triangles.len());
        for (t, corners) in scene.triangles.iter().enumerate() {
            for side in [Side::Front, Side::Back] {
                let Some(piece) = self.at(front, t as u32, side) else {
                    continue;
                };
                for k in 0..3 {
                    let [a, b] = [corners[k], corners[(k + 1) % 3]].map(|v| place[v as usize]);
                    edges.push(([a.min(b), a.max(b)], piece));
                }
            }
        }
        edges.sort_unstable();
        edges
    }

    fn join(&mut self, scene: &Scene, edges: &[Edge]) {
        let mut joints = Vec::new();
        for around in edges.chunk_by(|a, b| a.0 == b.0) {
            let ends = around[0].0.map(|v| scene.positions[v as usize]);
            for i in 1..around.len() {
                for j in i.saturating_sub(MOST_AROUND)..i {
                    let (a, b) = (around[j].1, around[i].1);
                    if a != b && self.is_smooth(a as usize, b as usize) {
                        joints.push(Joint {
                            pieces: [a, b],
                            ends,
                            blocked: false,
                        });
                    }
                }
            }
        }
        self.joints = joints;
    }

    fn is_smooth(&self, a: usize, b: usize) -> bool {
        let cos = self.normal[a].dot(self.normal[b]);
        self.surface[a] == self.surface[b]
            && self.side[a] == self.side[b]
            && self.flat[a] == self.flat[b]
            && cos > if self.flat[a] { COS_FLAT } else { COS_CREASE }
    }

    /// Finds the joints on which something stands.
    fn look_across(&mut self, caster: &dyn RayCaster, texel_m: f32) {
        let (mut segments, mut of) = (Vec::new(), Vec::new());
        for (k, joint) in self.joints.iter().enumerate() {
            let [a, b] = joint.pieces.map(|p| p as usize);
            // Facets are too small for anything to stand on one edge of them alone.
            if !self.flat[a] {
                continue;
            }
            let [p, q] = joint.ends;
            let normal = self.normal[a];
            let across = normal.cross(q - p).normalize_or_zero();
            // Not beyond the pieces.
            let depth = |piece: usize| {
                let far = self
                    .corners(piece)
                    .iter()
                    .map(|c| (*c - p).dot(across).abs());
                far.fold(0.0f32, f32::max)
            };
            let reach = (REACH * texel_m).min(0.5 * depth(a).min(depth(b)));
            let lift = normal
                * (HEIGHT * texel_m)
                    .min(HEIGHT / REACH * reach)
                    .max(caster.offset_m());
            let looks = ((q - p).length() / (TEXELS_A_LOOK * texel_m)) as usize;
            let looks = looks.clamp(FEWEST_LOOKS, MOST_LOOKS);
            for i in 0..looks {
                let at = p + (q - p) * ((i as f32 + 0.5) / looks as f32) + lift;
                segments.push(Ray {
                    origin: at - across * reach,
                    t_min: 0.0,
                    direction: across * (2.0 * reach),
                    t_max: 1.0,
                });
                of.push(k);
            }
        }
        let mut visible = vec![1.0; segments.len()];
        caster.visibility(&segments, &mut visible);
        for (&k, &v) in of.iter().zip(&visible) {
            self.joints[k].blocked |= v < 0.5;
        }
    }

    fn find_hard_edges(&mut self, scene: &Scene, edges: &[Edge]) {
        let open: std::collections::HashSet<(u32, [u32; 6])> = (self.joints.iter())
            .filter(|j| !j.blocked)
            .flat_map(|j| j.pieces.map(|p| (p, bits(j.ends))))
            .collect();
        let mut hard = Vec::new();
        for run in edges.chunk_by(|a, b| a == b) {
            let (edge, piece) = run[0];
            let ends = edge.map(|v| scene.positions[v as usize]);
            // Twice in one piece: an edge inside of a patch of several triangles.
            if run.len() == 1 && self.flat[piece as usize] && !open.contains(&(piece, bits(ends))) {
                hard.push(HardEdge { piece, ends });
            }
        }
        self.hard = hard;
    }

    /// Normals of facets, averaged where they join.
    fn smooth_normals(&mut self) {
        self.corner_normals = (0..self.len())
            .flat_map(|k| std::iter::repeat_n(self.normal[k], self.corners(k).len()))
            .collect();
        // Corners that joined pieces have at one place are one vertex.
        let mut sets = Sets::new(self.corners.len());
        for joint in self
            .joints
            .iter()
            .filter(|j| !self.flat[j.pieces[0] as usize])
        {
            for end in joint.ends {
                let [a, b] = joint.pieces.map(|p| {
                    let run = self.run(p as usize);
                    run.clone().find(|&c| self.corners[c] == end)
                });
                if let (Some(a), Some(b)) = (a, b) {
                    sets.join(a as u32, b as u32);
                }
            }
        }
        let mut sums = vec![Vec3::ZERO; self.corners.len()];
        for piece in (0..self.len()).filter(|&p| !self.flat[p]) {
            for c in self.run(piece) {
                let lead = sets.lead(c as u32) as usize;
                sums[lead] += self.normal[piece] * self.area[piece];
            }
        }
        for piece in (0..self.len()).filter(|&p| !self.flat[p]) {
            for c in self.run(piece) {
                let lead = sets.lead(c as u32) as usize;
                self.corner_normals[c] = sums[lead].normalize_or(self.normal[piece]);
            }
        }
    }
}

/// Two ends as one key.
fn bits(ends: [Vec3; 2]) -> [u32; 6] {
    let [a, b] = ends.map(|p| (p + Vec3::ZERO).to_array().map(f32::to_bits));
    let [a, b] = if a <= b { [a, b] } else { [b, a] };
    [a[0], a[1], a[2], b[0], b[1], b[2]]
}
