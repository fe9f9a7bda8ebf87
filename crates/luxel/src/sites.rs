//! Receivers that are so close together that one answers for all, for meshes that have more
//! vertices than rays can be spent on: the faces of a book, the leaves of a plant.
//!
//! Receivers share a site when they lie in one cell of a grid, in one plane of a stack, face
//! about the same way and belong to one run (a surface side). The one nearest to the middle of
//! them is asked.

use luxel_core::Vec3;
use luxel_gather::Receiver;
use std::collections::HashMap;
use std::ops::Range;

/// Planes of the stack in an edge of the grid: what stands before a wall is not the wall.
const PLANES: f32 = 4.0;

/// Steps of a normal's components: about 20 degrees.
const FACINGS: f32 = 3.0;

/// Sites, and which of them answers for each receiver.
pub struct Sites {
    /// One a site.
    pub receivers: Vec<Receiver>,
    /// Sum of the weights of those that share it.
    pub weights: Vec<f32>,
    /// Of each of the given receivers; empty when each has its own.
    site: Vec<u32>,
}

/// Grid cell, plane of the stack, facing.
type Key = ([i32; 3], i32, [i8; 3]);

impl Sites {
    /// Sites of receivers within `edge_m`, or one for each receiver when that is 0; `runs` cover
    /// all receivers.
    ///
    /// Near linear. The same for every run of the program.
    pub fn new(
        receivers: &[Receiver],
        weights: &[f32],
        runs: impl Iterator<Item = Range<usize>>,
        edge_m: f32,
    ) -> Sites {
        if edge_m <= 0.0 || !edge_m.is_finite() {
            return Sites {
                receivers: receivers.to_vec(),
                weights: weights.to_vec(),
                site: Vec::new(),
            };
        }
        let mut site = vec![0; receivers.len()];
        // Weight and weighted place of each site.
        let mut sums: Vec<(f64, [f64; 3])> = Vec::new();
        let mut known: HashMap<Key, u32> = HashMap::new();
        for run in runs {
            known.clear();
            for k in run {
                let at = *known.entry(key(&receivers[k], edge_m)).or_insert_with(|| {
                    sums.push((0.0, [0.0; 3]));
                    sums.len() as u32 - 1
                });
                site[k] = at;
                let (sum, place) = &mut sums[at as usize];
                let weight = weights[k] as f64;
                *sum += weight;
                let p = receivers[k].position.to_array();
                place
                    .iter_mut()
                    .zip(p)
                    .for_each(|(s, p)| *s += weight * p as f64);
            }
        }
        // The nearest to the middle; the first of equals.
        let mut nearest = vec![(f32::INFINITY, 0u32); sums.len()];
        for (k, receiver) in receivers.iter().enumerate() {
            let (sum, place) = sums[site[k] as usize];
            let middle = Vec3::from(place.map(|p| (p / sum) as f32));
            let distance = (receiver.position - middle).length_squared();
            let best = &mut nearest[site[k] as usize];
            // Without weight there is no middle: any will do.
            if distance < best.0 || best.0.is_infinite() {
                *best = (distance, k as u32);
            }
        }
        Sites {
            receivers: nearest.iter().map(|n| receivers[n.1 as usize]).collect(),
            weights: sums.iter().map(|s| s.0 as f32).collect(),
            site,
        }
    }

    /// The site that answers for a receiver.
    pub fn of(&self, receiver: usize) -> usize {
        self.site.get(receiver).map_or(receiver, |&s| s as usize)
    }
}

fn key(receiver: &Receiver, edge_m: f32) -> Key {
    let (p, n) = (receiver.position, receiver.normal);
    (
        (p / edge_m).floor().to_array().map(|c| c as i32),
        (p.dot(n) * PLANES / edge_m).floor() as i32,
        (n * FACINGS).round().to_array().map(|c| c as i8),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn receiver(position: [f32; 3], normal: [f32; 3]) -> Receiver {
        Receiver {
            position: position.into(),
            normal: normal.into(),
        }
    }

    #[test]
    fn only_close_receivers_of_one_plane_facing_and_run_share() {
        let up = [0.0, 1.0, 0.0];
        let all = [
            receiver([0.01, 0.0, 0.01], up),
            receiver([0.02, 0.0, 0.02], up),
            receiver([0.03, 0.0, 0.03], up),
            receiver([0.03, 0.05, 0.03], up),
            receiver([0.02, 0.0, 0.02], [1.0, 0.0, 0.0]),
            receiver([0.52, 0.0, 0.02], up),
            receiver([0.02, 0.0, 0.02], up),
        ];
        let weights = [1.0; 7];
        let sites = Sites::new(&all, &weights, [0..6, 6..7].into_iter(), 0.1);
        let of: Vec<usize> = (0..7).map(|k| sites.of(k)).collect();
        assert_eq!(of, [0, 0, 0, 1, 2, 3, 4]);
        assert_eq!(sites.receivers[0], all[1]);
        assert_eq!(sites.weights, [3.0, 1.0, 1.0, 1.0, 1.0]);
        let alone = Sites::new(&all, &weights, std::iter::empty(), 0.0);
        assert_eq!((alone.receivers.len(), alone.of(5)), (7, 5));
    }
}
