//! A small convex planar polygon in double precision: what form-factor kernels work on.

use glam::DVec3;

/// Normal times area of a polygon with these corners (Newell), m².
pub fn area_vector(v: &[DVec3]) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for i in 1..v.len().saturating_sub(1) {
        sum += (v[i] - v[0]).cross(v[i + 1] - v[0]);
    }
    sum * 0.5
}

/// A convex planar polygon, counter-clockwise seen from its front.
#[derive(Clone, Debug, PartialEq)]
pub struct Polygon {
    /// Corners, at least three, metres.
    pub vertices: Vec<DVec3>,
}

impl Polygon {
    /// From corners in order.
    pub fn new(vertices: Vec<DVec3>) -> Self {
        Polygon { vertices }
    }

    /// Area vector: normal times area (Newell), m².
    pub fn area_vector(&self) -> DVec3 {
        area_vector(&self.vertices)
    }

    /// Area, m².
    pub fn area(&self) -> f64 {
        self.area_vector().length()
    }

    /// Unit normal of the front; zero for a degenerate polygon.
    pub fn normal(&self) -> DVec3 {
        self.area_vector().normalize_or_zero()
    }

    /// Mean of the corners.
    pub fn centre(&self) -> DVec3 {
        self.vertices.iter().copied().sum::<DVec3>() / self.vertices.len().max(1) as f64
    }

    /// The same polygon seen from the other side.
    pub fn flipped(&self) -> Polygon {
        Polygon {
            vertices: self.vertices.iter().rev().copied().collect(),
        }
    }
}
