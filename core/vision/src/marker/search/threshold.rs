//! Thresholds by binary search (paper, section 3.2).
//!
//! The paper sets the threshold to 1/2, 1/4, 3/4, 1/8, 3/8, 5/8 … of the whole grey range, one
//! step per failed search of the frame. Here the search knows the local black and white of a candidate, so the sequence
//! runs over that range: its first value is the middle, eq. (3), and the further ones find a roundel whose disc or margin
//! is bridged at the middle.

/// The sequence 1/2, 1/4, 3/4, 1/8 … of `low..high`, each threshold once, until the steps are
/// 2⁻ᵈᵉᵖᵗʰ of the range or below one grey level.
#[derive(Clone, Debug)]
pub struct BinarySearch {
    low: u32,
    range: u32,
    depth: u32,
    level: u32,
    odd: u32,
}

impl BinarySearch {
    /// Thresholds strictly above `low` and at most `high`: black `low` stays black, white `high`
    /// white.
    pub fn new(low: u8, high: u8, depth: u32) -> Self {
        let range = u32::from(high.saturating_sub(low));
        Self { low: u32::from(low), range, depth: depth.min(8), level: 1, odd: 1 }
    }
}

impl Iterator for BinarySearch {
    type Item = u8;

    fn next(&mut self) -> Option<u8> {
        let parts = 1u32 << self.level;
        if self.level > self.depth || self.range < parts {
            return None;
        }
        let threshold = self.low + (self.range * self.odd).div_ceil(parts);
        self.odd += 2;
        if self.odd > parts {
            (self.level, self.odd) = (self.level + 1, 1);
        }
        u8::try_from(threshold).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_follow_the_sequence_of_the_paper() {
        let found: Vec<u8> = BinarySearch::new(0, 240, 3).collect();
        assert_eq!(found, [120, 60, 180, 30, 90, 150, 210]);
    }

    #[test]
    fn thresholds_are_distinct_and_inside_the_range() {
        for (low, high) in [(0, 255), (30, 70), (10, 13), (7, 7), (9, 3), (254, 255)] {
            let mut found: Vec<u8> = BinarySearch::new(low, high, 8).collect();
            assert!(found.iter().all(|&t| t > low && t <= high), "{low} {high} {found:?}");
            let n = found.len();
            found.sort_unstable();
            found.dedup();
            assert_eq!(found.len(), n);
        }
        assert_eq!(BinarySearch::new(7, 7, 8).count(), 0);
        assert_eq!(BinarySearch::new(10, 12, 8).collect::<Vec<_>>(), [11]);
    }
}
