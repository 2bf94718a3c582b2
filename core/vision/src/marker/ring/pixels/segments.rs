//! The two segments of a ring in a patch: its disc, and the black around it.
//!
//! The disc is filled from the probe's centre, and the black from the disc ([`crate::marker::ring::pixels::segment_fill`]).

use fearless_simd::Simd;
use fearless_simd_macros::simd;

use crate::{
    frame::Frame,
    marker::{
        reject::Reject,
        ring::pixels::{
            patch::Patch,
            segment_fill::{BitRows, Extent, FillError, FilledSegment, Span, fill_disc, fill_ring},
        },
    },
    scratch::reserve_total,
};

/// Spans of both segments, by the patch's rows.
#[derive(Debug, Default)]
pub(crate) struct Spans {
    pub discs: Vec<Span>,
    pub rings: Vec<Span>,
}

impl Spans {
    /// Reserves memory for `rows` rows.
    pub fn reserve(&mut self, rows: usize) {
        reserve_total(&mut self.discs, rows);
        reserve_total(&mut self.rings, rows);
    }
}

/// Size of a segment: its pixels, and the sides of its bounding box.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SegmentSize {
    pub pixels: f64,
    pub width: f64,
    pub height: f64,
}

impl SegmentSize {
    pub fn new(pixels: u32, extent: &Extent) -> Self {
        let (width, height) = (extent.width() as f64, extent.height() as f64);
        Self { pixels: f64::from(pixels), width, height }
    }
}

/// Extents and sizes of both segments.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Segments {
    pub disc: Extent,
    pub ring: Extent,
    pub disc_size: SegmentSize,
    pub ring_size: SegmentSize,
}

impl Segments {
    /// The disc at or near a pixel of the frame, and its ring.
    #[simd]
    pub fn find<S: Simd>(
        simd: S,
        frame: &Frame,
        patch: &Patch,
        center: (usize, usize),
        Spans { discs, rings }: &mut Spans,
    ) -> Result<Self, Reject> {
        let (rows, columns) = (patch.rows(), patch.columns());
        if discs.len() < rows {
            discs.resize(rows, Span::default());
            rings.resize(rows, Span::default());
        }
        let center = (center.0 - patch.window.left, center.1 - patch.window.top);
        let white = BitRows::new(&patch.white, patch.words, (rows, columns));
        let black = BitRows::new(&patch.black, patch.words, (rows, columns));
        let disc = seeds(patch, center)
            .map(|seed| fill_disc(simd, &white, seed, discs))
            .find(|disc| disc.is_ok())
            .unwrap_or(Err(FillError::Seed));
        let disc = disc.map_err(|error| match error {
            FillError::Seed => Reject::NoWhite,
            FillError::Edge(_) => Reject::WhiteTooLarge,
        })?;
        let ring = fill_ring(simd, &black, FilledSegment { extent: &disc, spans: discs }, rings)
            .map_err(|error| match error {
                FillError::Seed => Reject::NoBlack,
                FillError::Edge(extent) if at_frame_edge(frame, patch, &extent) => {
                    Reject::FrameEdge
                }
                FillError::Edge(_) => Reject::BlackTooLarge,
            })?;
        let disc_size =
            size(patch.words, FilledSegment { extent: &disc, spans: discs }, &patch.white);
        let ring_size =
            size(patch.words, FilledSegment { extent: &ring, spans: rings }, &patch.black);
        Ok(Self { disc, ring, disc_size, ring_size })
    }
}

/// White pixels to seed the disc: the centre if it is white. A small ring that moved may have black
/// there; then the closest white ones along row and column.
fn seeds(patch: &Patch, (u, v): (usize, usize)) -> impl Iterator<Item = (u32, usize)> {
    let white = |u: usize, v: usize| patch.white[v * patch.words + u / 64] >> (u % 64) & 1 == 1;
    let seeds = if white(u, v) {
        [Some((u, v)), None, None, None]
    } else {
        let left = (0..u).rev().find(|&u| white(u, v)).map(|u| (u, v));
        let right = (u + 1..patch.columns()).find(|&u| white(u, v)).map(|u| (u, v));
        let up = (0..v).rev().find(|&v| white(u, v)).map(|v| (u, v));
        let down = (v + 1..patch.rows()).find(|&v| white(u, v)).map(|v| (u, v));
        [left, right, up, down]
    };
    seeds.into_iter().flatten().map(|(u, v)| (u as u32, v))
}

/// Whether a segment reached an edge of the patch that is one of the frame's.
fn at_frame_edge(frame: &Frame, patch: &Patch, extent: &Extent) -> bool {
    let window = &patch.window;
    (extent.columns.first == 0 && window.left == 0)
        || (extent.columns.end as usize == patch.columns() && window.right == frame.width())
        || (extent.top == 0 && window.top == 0)
        || (extent.bottom == patch.rows() && window.bottom == frame.height())
}

/// Size of a segment of the class with these bits.
#[inline(always)]
fn size(words: usize, segment: FilledSegment, bits: &[u64]) -> SegmentSize {
    let Extent { top, bottom, .. } = *segment.extent;
    let bits = &bits[top * words..bottom * words];
    let mut pixels = 0;
    if words == 1 {
        for (bits, span) in bits.iter().zip(segment.rows()) {
            pixels += (bits & span.bits(0)).count_ones();
        }
    } else {
        for (row, span) in bits.chunks_exact(words).zip(segment.rows()) {
            for (word, bits) in row.iter().enumerate() {
                pixels += (bits & span.bits(word)).count_ones();
            }
        }
    }
    SegmentSize::new(pixels, segment.extent)
}
