//! Visibility of many segments.

use crate::bvh::Tree;
use crate::contract::Ray;
use crate::lanes::Lanes;
use crate::traverse::{Room, visibility};

/// [`visibility`] of each segment.
#[inline(always)]
pub(crate) fn visibility_batch<L: Lanes>(tree: &Tree, segments: &[Ray], visible: &mut [f32]) {
    let mut room = Room::new();
    for (segment, visible) in segments.iter().zip(visible) {
        *visible = visibility::<L>(tree, segment, tree.root, &mut room);
    }
}
