//! The search of a window: edges of its rows, hits among them, chords through each hit, and what
//! passes is measured.
//!
//! Each step costs more than the one before and leaves fewer: of the 2.8 million pixels of a cluttered
//! photograph some ten thousand hits, of these some hundred candidates. `benches/search.rs` times it.
//!
//! A ring is crossed by the more rows the larger it is, and each of its hits costs the more. Every second
//! pair of rows therefore leaves out what is crossed by enough others, however flat it lies.

pub(crate) mod chord;
pub(crate) mod claim;
pub(crate) mod cross;
pub(crate) mod hits;
pub(crate) mod row_edges;
pub(crate) mod threshold;

use crate::{
    camera::PixelPoint,
    frame::Frame,
    marker::{
        Ring,
        classify::elliptical::check_disc,
        detector::{Detector, Scratch},
        kind::{Kind, Pattern, Polarity},
        reject::{Reject, Rejected},
        ring::checks::{Probe, Rules},
        search::{
            chord::{Evenness, RATIO_SLACK},
            claim::{Claim, ClaimedPixels},
            cross::{Candidate, CrossRules, cross},
            hits::{Hit, HitRules, HitScratch, find_hits},
            row_edges::{ROW_STEP, RowEdges},
            threshold::BinarySearch,
        },
        validate::{disc_center::check_middle, letter::check_stroke, outline::check_rims},
    },
    segment::Window,
};

/// Depth of the binary search that a promising candidate is given.
const SEARCH_DEPTH: u32 = 2;
/// An edge's least step between the pixels before and after it, as a share of the least contrast.
const STEP_SHARE: f64 = 0.6;
/// Shortest chord of a ring that a row through its disc's middle half crosses, in shorter semiaxes.
const LEAST_CHORD: f64 = 1.6;
/// Every second pair of rows leaves out chords so long that at least so many others cross the disc of
/// the flattest ring that has them: there are many, and each costs as much as it is long …
const LEAST_PAIRS: f64 = 2.0;
/// … but not those in which perspective makes the two sides differ by more than this share: of rings so
/// large, only some rows show an even chord.
const MOST_SIDE_SHARE: f64 = 0.25;
/// A ring may reach this share, and so many pixels, beyond where its chords have it.
const BEYOND: (f64, f64) = (1.25, 3.0);
/// A coded roundel's white core, as a share of the disc between the teeth.
const CORE_SHARE: f64 = 240.0 / 420.0;
/// A coded roundel's ring is black at this share of its radius, whatever the code.
const CODED_BLACK: f64 = 0.8;

/// What the search looks for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SearchRules {
    hit: HitRules,
    cross: CrossRules,
    step: u8,
}

/// Memory of the search.
#[derive(Debug, Default)]
pub(crate) struct SearchScratch {
    row: RowEdges,
    hits: HitScratch,
    claimed: ClaimedPixels,
}

impl SearchScratch {
    /// Room for rows of frames of this width. The rest has it from the first search of a whole frame on.
    pub fn make_room(&mut self, width: usize) {
        self.hits.make_room(width);
    }
}

impl SearchRules {
    pub fn new(kinds: &[Kind], rules: &Rules, contrast: u8) -> Self {
        let coded = kinds.iter().any(|kind| matches!(kind.pattern, Pattern::Coded(_)));
        let mut evenness = Evenness::of_plain(rules.ratios);
        let step = (STEP_SHARE * f64::from(contrast)) as u8;
        let mut black_at = None;
        if coded {
            evenness = evenness.with_teeth(CORE_SHARE);
            black_at = Some(CODED_BLACK);
        }
        for (least, most) in kinds.iter().map(Kind::ratios).filter(|(least, most)| least < most) {
            // A chord along the disc's longer axis, another along the shorter one; the ring's black is
            // beyond both.
            evenness.ratio_slack = evenness.ratio_slack.max(RATIO_SLACK + most - least);
            black_at = Some(black_at.unwrap_or(0.0).max(0.5 * (1.0 + most)));
        }
        Self {
            hit: HitRules {
                evenness,
                least_px: LEAST_CHORD * rules.min_semi_minor_px,
                left_out_px: (f64::MAX, f64::MAX),
                contrast,
                step,
            },
            cross: CrossRules {
                evenness,
                min_axis_ratio: rules.min_axis_ratio,
                min_semi_minor_px: rules.min_semi_minor_px,
                black_at,
            },
            step,
        }
    }

    /// The same for a frame of this width.
    fn seen_in(mut self, width: usize) -> Self {
        self.hit.evenness = self.hit.evenness.seen_in(width);
        self.cross.evenness = self.cross.evenness.seen_in(width);
        self
    }

    /// What a hit of row `v` must look like. The disc of a ring with a chord of c pixels is at least
    /// k·q·c high, with k the least ratio of diameters and q that of axes.
    fn hit_in(&self, v: usize) -> HitRules {
        if (v / ROW_STEP).is_multiple_of(2) {
            return self.hit;
        }
        let Evenness { white, share_per_px, .. } = self.hit.evenness;
        let height_share = 2.0 * white.0 * self.cross.min_axis_ratio;
        let least_px = 2.0 * LEAST_PAIRS * ROW_STEP as f64 / height_share;
        HitRules { left_out_px: (least_px, MOST_SIDE_SHARE / share_per_px), ..self.hit }
    }
}

impl Detector {
    /// Appends to `found` the rings whose disc crosses `window` and that no claim covers, and claims
    /// them, until there are `most` of them.
    pub(crate) fn search(&self, frame: &Frame, window: Window, most: usize, scratch: &mut Scratch) {
        scratch.make_room(frame, self.params().max_roundels);
        let mut memory = std::mem::take(&mut scratch.search);
        let SearchScratch { row, hits, claimed } = &mut memory;
        claimed.clear(window);
        scratch.claims.iter().for_each(|claim| claimed.add(claim));
        let rules = &self.search_rules.seen_in(frame.width());
        for v in (window.top..window.bottom).step_by(ROW_STEP) {
            if scratch.found.len() >= most {
                break;
            }
            row.read(self.level, frame, v, &window, rules.step);
            for &polarity in &self.polarities {
                find_hits(row, &rules.hit_in(v), polarity, hits);
                for hit in &mut hits.hits {
                    hit.u += window.left;
                    if scratch.found.len() >= most || claimed.contains(hit.u, v) {
                        continue;
                    }
                    if let Some(ring) = self.try_hit(frame, (hit, v), polarity, rules, scratch) {
                        let claim = Claim::new(&ring);
                        claimed.add(&claim);
                        scratch.claims.push(claim);
                        scratch.found.push(ring);
                    }
                }
            }
        }
        scratch.search = memory;
    }

    /// The ring whose disc a hit is, at the first threshold of the binary search that shows it.
    fn try_hit(
        &self,
        frame: &Frame,
        (hit, v): (&Hit, usize),
        polarity: Polarity,
        rules: &SearchRules,
        scratch: &mut Scratch,
    ) -> Option<Ring> {
        let center = PixelPoint { u: hit.u as f64, v: v as f64 };
        let mut rejected =
            Rejected { center, half_box_px: (hit.half_px, hit.half_px), reject: Reject::Masked };
        if self.mask.covers(center) {
            scratch.rejects.add(rejected);
            return None;
        }
        let mut first = None;
        for threshold in BinarySearch::new(hit.black, hit.white, SEARCH_DEPTH) {
            let tried = cross(frame, (hit, v), threshold, &rules.cross, polarity);
            let tried = tried.and_then(|candidate| {
                let (u, v) = candidate.center;
                rejected.center = PixelPoint { u: u as f64, v: v as f64 };
                rejected.half_box_px = candidate.half_box_px;
                self.measure_candidate(frame, &candidate, polarity, scratch)
            });
            match tried {
                Ok(ring) => return Some(ring),
                Err(reject) => {
                    first = first.or(Some(reject));
                    // A further threshold helps only where rims were bridged.
                    if reject != Reject::BlackTooLarge && reject != Reject::WhiteTooLarge {
                        break;
                    }
                }
            }
        }
        scratch.rejects.add(Rejected { reject: first.unwrap_or(Reject::Contrast), ..rejected });
        None
    }

    fn measure_candidate(
        &self,
        frame: &Frame,
        candidate: &Candidate,
        polarity: Polarity,
        scratch: &mut Scratch,
    ) -> Result<Ring, Reject> {
        let (half_u, half_v) = candidate.half_box_px;
        let reach = |half: f64| half * BEYOND.0 + BEYOND.1;
        let center = candidate.ring_center;
        let probe = Probe {
            center: candidate.center,
            threshold: candidate.threshold,
            bounds: Window::around(frame, center, (reach(half_u), reach(half_v))),
            polarity,
            expected: None,
        };
        let ring = self.measure(frame, &probe, &mut scratch.measure)?;
        let pattern = self.kind_of(&ring).map_or(Pattern::Plain, |kind| kind.pattern);
        let smooth = !matches!(pattern, Pattern::Coded(_));
        check_rims(frame, &ring, smooth)?;
        if smooth {
            check_middle(frame, &ring)?;
        }
        match (pattern, self.kind_of(&ring)) {
            (Pattern::Elliptical { .. }, Some(kind)) => check_disc(&ring, kind)?,
            (Pattern::Plain, _) => check_stroke(&ring)?,
            _ => (),
        }
        let covered = scratch.claims.iter().any(|claim| claim.covers(&ring));
        if covered { Err(Reject::Claimed) } else { Ok(ring) }
    }

    fn kind_of(&self, ring: &Ring) -> Option<&Kind> {
        ring.kind.and_then(|kind| self.kinds().get(usize::from(kind.0)))
    }
}
