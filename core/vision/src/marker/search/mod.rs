//! Search of a window for candidates: edges of its rows, hits among them, chords through each hit.
//!
//! | step | module |
//! | --- | --- |
//! | falls and rises of the light along a row | `row_edges` |
//! | black, white, black of matching widths | `hits` |
//! | four chords through the centre | `cross`, `chord` |
//! | thresholds to try | `threshold` |
//! | pixels of roundels already found | `claim` |
//!
//! Each step costs more than the one before and passes fewer: of the 2.8 million pixels of a cluttered
//! photograph some ten thousand hits, of these some hundred candidates, which [`crate::marker::Detector`] measures.
//! `benches/search.rs` times it.
//!
//! The larger a ring, the more rows cross it and the more each of its hits costs. Every second pair of rows therefore
//! skips rings that enough other rows cross, at any tilt.

pub(crate) mod chord;
pub(crate) mod claim;
pub(crate) mod cross;
pub(crate) mod hits;
pub(crate) mod row_edges;
pub(crate) mod threshold;

use crate::marker::{
    code::CodeLayout,
    kind::{Kind, Pattern},
    ring::probe::Rules,
    search::{
        chord::{Evenness, RATIO_SLACK},
        claim::ClaimedPixels,
        cross::CrossRules,
        hits::{HitRules, HitScratch},
        row_edges::{ROW_STEP, RowEdges},
    },
};

/// Smallest step of an edge between the pixels before and after it, as a share of the smallest
/// contrast.
const STEP_SHARE: f64 = 0.6;
/// Shortest chord of a ring in a row through the middle half of its disc, in shorter semiaxes.
const MIN_CHORD: f64 = 1.6;
/// Every second pair of rows skips chords so long that at least this many other pairs cross the
/// disc of the flattest ring with such a chord …
const MIN_PAIRS: f64 = 2.0;
/// … except those so long that perspective lets the two sides differ by more than this share: only
/// some rows of such large rings have an even chord.
const MAX_SIDE_SHARE: f64 = 0.25;
/// A coded roundel's ring is black at this share of its radius, for any code.
const CODED_BLACK: f64 = 0.8;

/// Limits of the search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SearchRules {
    pub hit: HitRules,
    pub cross: CrossRules,
    pub step: u8,
}

/// Memory of the search.
#[derive(Debug, Default)]
pub(crate) struct SearchScratch {
    pub row: RowEdges,
    pub hits: HitScratch,
    pub claimed: ClaimedPixels,
}

impl SearchScratch {
    /// Reserves memory for rows of this width. The rest grows with the first search of a whole
    /// frame.
    pub fn reserve(&mut self, width: usize) {
        self.hits.reserve(width);
    }
}

impl SearchRules {
    pub fn new(kinds: &[Kind], rules: &Rules, contrast: u8) -> Self {
        let coded = kinds.iter().any(|kind| matches!(kind.pattern, Pattern::Coded(_)));
        let mut evenness = Evenness::plain(rules.ratios);
        let step = (STEP_SHARE * f64::from(contrast)) as u8;
        let mut black_at = None;
        if coded {
            evenness = evenness.with_teeth(CodeLayout::CORE_SHARE);
            black_at = Some(CODED_BLACK);
        }
        for (min, max) in kinds.iter().map(Kind::ratios).filter(|(min, max)| min < max) {
            // One chord along the disc's longer axis, another along the shorter one; the ring's
            // black is beyond both.
            evenness.ratio_slack = evenness.ratio_slack.max(RATIO_SLACK + max - min);
            black_at = Some(black_at.unwrap_or(0.0).max(0.5 * (1.0 + max)));
        }
        Self {
            hit: HitRules {
                evenness,
                min_px: MIN_CHORD * rules.min_semi_minor_px,
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
    pub fn for_width(mut self, width: usize) -> Self {
        self.hit.evenness = self.hit.evenness.for_width(width);
        self.cross.evenness = self.cross.evenness.for_width(width);
        self
    }

    /// Limits for hits of row `v`. The disc of a ring with a chord of c pixels is at least k·q·c
    /// high, with k the smallest ratio of diameters and q that of axes.
    pub fn hit_in(&self, v: usize) -> HitRules {
        if (v / ROW_STEP).is_multiple_of(2) {
            return self.hit;
        }
        let Evenness { white, share_per_px, .. } = self.hit.evenness;
        let height_share = 2.0 * white.0 * self.cross.min_axis_ratio;
        let min_px = 2.0 * MIN_PAIRS * ROW_STEP as f64 / height_share;
        HitRules { left_out_px: (min_px, MAX_SIDE_SHARE / share_per_px), ..self.hit }
    }
}
