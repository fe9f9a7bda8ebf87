//! Values by the bucket that they belong to, all in one list: a counting sort.

/// Values of each bucket, in the order in which they were given.
#[derive(Clone, Debug, Default)]
pub struct Buckets {
    /// Values of bucket `b` are `list[start[b]..start[b + 1]]`.
    start: Vec<u32>,
    list: Vec<u32>,
}

impl Buckets {
    /// Sorts pairs of a bucket, below `count`, and a value. Linear; goes over `pairs` twice.
    pub fn new(count: usize, pairs: impl Iterator<Item = (usize, u32)> + Clone) -> Buckets {
        let mut start = vec![0u32; count + 1];
        pairs.clone().for_each(|(b, _)| start[b + 1] += 1);
        for b in 0..count {
            start[b + 1] += start[b];
        }
        let (mut at, mut list) = (start.clone(), vec![0; start[count] as usize]);
        for (b, value) in pairs {
            list[at[b] as usize] = value;
            at[b] += 1;
        }
        Buckets { start, list }
    }

    /// Values of a bucket.
    #[inline]
    pub fn of(&self, bucket: usize) -> &[u32] {
        &self.list[self.start[bucket] as usize..self.start[bucket + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_keep_their_order_within_a_bucket() {
        let pairs = [(2, 7), (0, 5), (2, 3), (2, 9), (3, 1)];
        let buckets = Buckets::new(5, pairs.into_iter());
        let all: Vec<&[u32]> = (0..5).map(|b| buckets.of(b)).collect();
        assert_eq!(all, [&[5][..], &[], &[7, 3, 9], &[1], &[]]);
        assert!(Buckets::new(1, std::iter::empty()).of(0).is_empty());
    }
}
