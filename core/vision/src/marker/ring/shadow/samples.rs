//! Pixels of disc, ring and margin away from their rims, thinned out evenly.

use fearless_simd::{Simd, dispatch};
use fearless_simd_macros::simd;

use crate::{
    frame::Frame,
    marker::{
        kind::Polarity,
        ring::{
            measure::MeasureScratch,
            pixels::{
                edge_band::{EdgeBands, pixels_in},
                patch::{Patch, WORD_PX},
                segment_fill::FilledSegment,
                segments::Segments,
            },
            probe::Probe,
        },
    },
};

/// Largest number of samples.
pub(crate) const MAX_SAMPLES: usize = 512;

/// A pixel away from the rims.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightSample {
    /// Position relative to the probe's centre, pixels.
    pub u: f32,
    pub v: f32,
    /// The frame's own level, also for white rings.
    pub level: f32,
    /// Whether it belongs to the brighter areas of the print.
    pub is_bright: bool,
    /// Whether it belongs to the margin, which may be narrower than assumed.
    pub is_margin: bool,
}

/// Fills `samples` for the ring at a probe; false if there is no ring by its threshold.
pub(super) fn collect(
    frame: &Frame,
    probe: &Probe,
    scratch: &mut MeasureScratch,
    samples: &mut Vec<LightSample>,
) -> bool {
    dispatch!(scratch.level, simd => collect_with(simd, frame, probe, scratch, samples))
}

#[simd]
fn collect_with<S: Simd>(
    simd: S,
    frame: &Frame,
    probe: &Probe,
    scratch: &mut MeasureScratch,
    samples: &mut Vec<LightSample>,
) -> bool {
    let MeasureScratch { patch, spans, bands, .. } = scratch;
    samples.clear();
    Patch::load(simd, patch, frame, probe.bounds, probe.frame_threshold());
    let Ok(Segments { disc, ring, .. }) = Segments::find(simd, frame, patch, probe.center, spans)
    else {
        return false;
    };
    let bands = EdgeBands::round(
        simd,
        patch,
        FilledSegment { extent: &disc, spans: &spans.discs },
        FilledSegment { extent: &ring, spans: &spans.rings },
        bands,
    );
    let flip = probe.polarity.flip();
    let is_black_ring = probe.polarity == Polarity::BlackRing;
    let count = pixels_in(bands.disc_core) + pixels_in(bands.black) + pixels_in(bands.near);
    let every = (count as usize).div_ceil(MAX_SAMPLES).max(1);
    let mut place = 0;
    for (set, is_white, is_margin) in
        [(bands.disc_core, true, false), (bands.black, false, false), (bands.near, true, true)]
    {
        for (index, &bits) in set.iter().enumerate() {
            let index = bands.top * patch.words + index;
            // What lies beyond a narrow margin may be dark.
            let mut bits = if is_margin { bits & patch.white[index] } else { bits };
            let row = patch.window.top + index / patch.words;
            let first = patch.window.left + index % patch.words * WORD_PX;
            while bits != 0 {
                let column = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                place += 1;
                if place % every == 0 {
                    samples.push(LightSample {
                        u: (first + column) as f32 - probe.center.0 as f32,
                        v: row as f32 - probe.center.1 as f32,
                        level: f32::from(patch.grey[index][column] ^ flip),
                        is_bright: is_white == is_black_ring,
                        is_margin,
                    });
                }
            }
        }
    }
    true
}
