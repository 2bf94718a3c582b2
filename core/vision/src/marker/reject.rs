//! Why a candidate is rejected: one reason per stage, counted, and kept with its position on request.

use std::fmt;

use crate::camera::PixelPoint;

macro_rules! rejects {
    ($($(#[doc = $doc:literal])+ $name:ident = $text:literal,)+) => {
        /// The stage that rejected a candidate, in the order of the pipeline.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Reject {
            $($(#[doc = $doc])+ $name,)+
        }

        impl Reject {
            /// All stages, in order.
            pub const ALL: &'static [Reject] = &[$(Reject::$name,)+];

            /// Short description.
            pub fn reason(self) -> &'static str {
                match self { $(Reject::$name => $text,)+ }
            }
        }
    };
}

rejects! {
    /// Search: black is not equally wide on both sides of the white.
    Chord = "black and white do not alternate evenly along row and column",
    /// Cut by the frame's edge, or too close to it to measure the rim.
    FrameEdge = "cut by the frame's edge",
    /// No black where the ring of a disc should be.
    NoBlack = "no black where the ring should be",
    /// The black segment exceeds the expected size.
    BlackTooLarge = "black segment larger than the roundel looked for",
    /// The black segment has too few pixels.
    TooSmall = "too small",
    /// Eq. (2) for the black segment.
    BlackBox = "black segment's area does not fit its box (eq. 2)",
    /// No white at the black segment's centre.
    NoWhite = "no white at the ring's centre",
    /// The white segment is not enclosed by the black one.
    WhiteTooLarge = "white disc not enclosed by the black ring",
    /// Eq. (2) for the white segment.
    WhiteBox = "white segment's area does not fit its box (eq. 2)",
    /// Ratio of the segments' areas.
    AreaRatio = "ratio of black to white area",
    /// Distance of the segments' centres.
    Concentricity = "ring and disc are not concentric",
    /// Eq. (5) for the disc or for ring and disc together.
    Roundness = "not an ellipse (eq. 5)",
    /// Flatter than the largest tilt searched for.
    Tilt = "too flat",
    /// The two rims have different shapes.
    Similarity = "ring and disc have different shapes",
    /// Too little difference of black and white.
    Contrast = "contrast too low",
    /// The grey levels along the rims contradict the segments.
    Profile = "grey levels at the rims are not those of a roundel",
    /// No configured kind has this ratio.
    Kind = "ratio of diameters fits no kind",
    /// The outer rim is partly covered.
    Covered = "the outer rim is partly covered",
    /// Search: the levels along a rim show corners, teeth or gaps.
    Outline = "a rim is no ellipse but has corners, teeth or gaps",
    /// The centre lies in a masked region.
    Masked = "in a masked region",
    /// Another roundel has been found there.
    Claimed = "already taken for another roundel",
    /// Tracking: too far from the track's prediction, or of another size.
    Gate = "too far from the track's prediction",
}

impl fmt::Display for Reject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.reason())
    }
}

/// Number of candidates of one frame rejected at each stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RejectCounts([u32; Reject::ALL.len()]);

impl RejectCounts {
    /// Candidates rejected at this stage.
    pub fn count(&self, reject: Reject) -> u32 {
        self.0[reject as usize]
    }

    /// Candidates rejected at any stage.
    pub fn total(&self) -> u32 {
        self.0.iter().fold(0, |sum, &n| sum.saturating_add(n))
    }

    /// Every stage with its count, in order.
    pub fn iter(&self) -> impl Iterator<Item = (Reject, u32)> + '_ {
        Reject::ALL.iter().map(|&reject| (reject, self.count(reject)))
    }

    pub(crate) fn add(&mut self, reject: Reject) {
        let count = &mut self.0[reject as usize];
        *count = count.saturating_add(1);
    }
}

/// A rejected candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rejected {
    /// Where it was measured.
    pub center: PixelPoint,
    /// Half the sides of its estimated bounding box, along u and v, pixels.
    pub half_box_px: (f64, f64),
    /// Reason.
    pub reject: Reject,
}

/// Largest number of rejected candidates kept per frame; all are counted. Beyond it, candidates of
/// the earliest stage are thinned out evenly over the frame, since those that came furthest are the
/// most informative.
pub const MAX_REJECTED: usize = 4096;

/// Rejected candidates of one frame.
#[derive(Debug, Default)]
pub(crate) struct Rejects {
    pub counts: RejectCounts,
    /// The newest frame's rejected candidates, if they are kept.
    pub list: Option<Vec<Rejected>>,
    /// Per stage, one candidate in 2ⁿ is kept.
    thinned: [u32; Reject::ALL.len()],
}

impl Rejects {
    /// Removes all.
    pub fn clear(&mut self) {
        self.counts = RejectCounts::default();
        self.thinned = Default::default();
        self.list.iter_mut().for_each(Vec::clear);
    }

    /// Enables or disables keeping candidates.
    pub fn keep(&mut self, keep: bool) {
        self.list = keep.then(|| self.list.take().unwrap_or_default());
    }

    /// Counts a candidate, and keeps it if enabled.
    pub fn add(&mut self, rejected: Rejected) {
        let number = self.counts.count(rejected.reject);
        self.counts.add(rejected.reject);
        let Some(list) = &mut self.list else { return };
        if number.trailing_zeros() < self.thinned[rejected.reject as usize] {
            return;
        }
        list.push(rejected);
        while list.len() > MAX_REJECTED && thin(list, &mut self.thinned) {}
    }
}

/// Drops every other candidate of the earliest stage that has more than one; false if there is
/// none.
fn thin(list: &mut Vec<Rejected>, thinned: &mut [u32; Reject::ALL.len()]) -> bool {
    let mut kept = [0usize; Reject::ALL.len()];
    list.iter().for_each(|rejected| kept[rejected.reject as usize] += 1);
    let Some(stage) = kept.iter().position(|&count| count > 1) else { return false };
    thinned[stage] += 1;
    let mut odd = false;
    list.retain(|rejected| {
        let is_of_stage = rejected.reject as usize == stage;
        odd ^= is_of_stage;
        !is_of_stage || odd
    });
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_kept_by_stage() {
        let mut counts = RejectCounts::default();
        counts.add(Reject::Gate);
        counts.add(Reject::Chord);
        counts.add(Reject::Gate);
        assert_eq!(counts.count(Reject::Gate), 2);
        assert_eq!(counts.total(), 3);
        assert_eq!(counts.iter().filter(|(_, n)| *n > 0).count(), 2);
        assert_eq!(counts.iter().next(), Some((Reject::Chord, 1)));
    }

    #[test]
    fn candidates_are_kept_on_request_up_to_the_limit() {
        let center = PixelPoint { u: 1.0, v: 2.0 };
        let rejected = Rejected { center, half_box_px: (3.0, 4.0), reject: Reject::Tilt };
        let mut rejects = Rejects::default();
        rejects.add(rejected);
        assert_eq!(rejects.list, None);
        rejects.keep(true);
        (0..MAX_REJECTED).for_each(|_| rejects.add(rejected));
        assert_eq!(rejects.list.as_ref().unwrap().len(), MAX_REJECTED);
        assert_eq!(rejects.counts.count(Reject::Tilt) as usize, MAX_REJECTED + 1);
        rejects.clear();
        assert_eq!(rejects.list, Some(Vec::new()));
        assert_eq!(rejects.counts.total(), 0);
    }

    #[test]
    fn too_many_candidates_are_thinned_evenly_from_the_earliest_stage() {
        let rejected = |row: usize, reject| {
            let center = PixelPoint { u: 0.0, v: row as f64 };
            Rejected { center, half_box_px: (3.0, 4.0), reject }
        };
        let mut rejects = Rejects::default();
        rejects.keep(true);
        let rows = 10 * MAX_REJECTED;
        for row in 0..rows {
            rejects.add(rejected(row, Reject::Chord));
            if row % 100 == 0 {
                rejects.add(rejected(row, Reject::Profile));
            }
        }
        let list = rejects.list.as_ref().unwrap();
        assert!((MAX_REJECTED / 2..=MAX_REJECTED).contains(&list.len()), "{}", list.len());
        let of = |stage| list.iter().filter(move |it| it.reject == stage);
        assert_eq!(of(Reject::Profile).count(), rows.div_ceil(100));
        let below = |share: usize| {
            of(Reject::Chord).filter(|it| it.center.v < (rows * share / 4) as f64).count() as f64
        };
        let even = of(Reject::Chord).count() as f64 / 4.0;
        assert!((1..4).all(|share| (below(share) - even * share as f64).abs() <= 2.0));
    }
}
