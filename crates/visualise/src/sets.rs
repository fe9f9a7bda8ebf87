//! Disjoint sets: which things hang together, by union and find with halved paths.
//!
//! Source: [Tarjan84].

/// Sets of the numbers below some count, at first each alone. The smallest number of a set leads it.
pub(crate) struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    pub fn new(count: usize) -> Sets {
        Sets {
            parent: (0..count as u32).collect(),
        }
    }

    /// The leader of the set of `k`.
    pub fn lead(&mut self, mut k: u32) -> u32 {
        while self.parent[k as usize] != k {
            self.parent[k as usize] = self.parent[self.parent[k as usize] as usize];
            k = self.parent[k as usize];
        }
        k
    }

    /// Puts two sets together.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.lead(a), self.lead(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}
