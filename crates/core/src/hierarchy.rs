//! A tree over the elements of any front: clusters of clusters down to single elements.
//!
//! Flat arrays, no pointers. The children of a node are `first_child .. first_child + children`;
//! a leaf names a run of `order`. Nodes are stored parents first, so a backward sweep pulls and
//! a forward sweep pushes.

use crate::element::ElementId;
use glam::Vec3;

/// One cluster.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Smallest corner of the bounds, metres.
    pub low: Vec3,
    /// Largest corner of the bounds, metres.
    pub high: Vec3,
    /// Area of all elements below, m².
    pub area: f32,
    /// Axis of the cone that holds all normals below (unit; zero if they fill the sphere).
    pub axis: Vec3,
    /// Cosine of the half angle of that cone; -1 when it is the whole sphere.
    pub cos_half_angle: f32,
    /// First child node; meaningless for a leaf.
    pub first_child: u32,
    /// Number of children; 0 for a leaf.
    pub children: u32,
    /// First element below, as an index into [`Hierarchy::order`].
    pub first: u32,
    /// Number of elements below.
    pub count: u32,
}

/// A tree over a front.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hierarchy {
    /// Clusters, root first, parents before children. Empty for an empty front.
    pub nodes: Vec<Node>,
    /// Every element exactly once; each node owns a run of it.
    pub order: Vec<ElementId>,
}

impl Hierarchy {
    /// Elements below `node`.
    pub fn elements(&self, node: usize) -> &[ElementId] {
        let n = &self.nodes[node];
        &self.order[n.first as usize..(n.first + n.count) as usize]
    }
}
