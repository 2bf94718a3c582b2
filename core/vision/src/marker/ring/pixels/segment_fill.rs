//! Fills the white disc and the black ring around it, on words of pixels.
//!
//! A segment is filled row by row from a seed pixel: in the next row, the runs of its class that
//! touch the row before belong to it (4-connectivity). Bit scans find the ends of a run without a loop over pixels. Each
//! row is kept as one span, from its first run's start to its last run's end; pixels of the other class between them
//! (noise, the teeth of a code) lie inside the segment. A segment that turns back, so that a row is reached only from
//! beyond, is filled again until nothing is added.
//!
//! The fill is bounded by the segment, not the window: neighbours and sheets in the window stay outside, and a
//! segment that reaches the window's edge is rejected.

use fearless_simd::Simd;
use fearless_simd_macros::simd;

/// Columns `first..end` of a row; empty if `end ≤ first`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Span {
    pub first: u32,
    pub end: u32,
}

impl Span {
    /// The smallest span that contains both; neither may be empty.
    fn joined(self, other: Span) -> Span {
        Span { first: self.first.min(other.first), end: self.end.max(other.end) }
    }

    /// Its columns in one word, as bits.
    #[inline(always)]
    pub fn bits(self, word: usize) -> u64 {
        let from = word as u32 * 64;
        let first = self.first.saturating_sub(from);
        let end = self.end.saturating_sub(from).min(64);
        if first >= end { 0 } else { (u64::MAX << first) & (u64::MAX >> (64 - end)) }
    }
}

/// Rows and columns of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Extent {
    pub top: usize,
    /// One past the last row.
    pub bottom: usize,
    pub columns: Span,
}

impl Extent {
    pub fn width(&self) -> usize {
        (self.columns.end - self.columns.first) as usize
    }

    pub fn height(&self) -> usize {
        self.bottom - self.top
    }
}

/// A segment: its extent, and its spans by row of the patch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FilledSegment<'a> {
    pub extent: &'a Extent,
    pub spans: &'a [Span],
}

impl FilledSegment<'_> {
    /// The spans of its own rows.
    pub fn rows(&self) -> &[Span] {
        &self.spans[self.extent.top..self.extent.bottom]
    }
}

/// Why there is no segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FillError {
    /// The seed is not of the class.
    Seed,
    /// It reaches an edge of the given rows and columns, with this extent so far.
    Edge(Extent),
}

/// Rows of bits of one class.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BitRows<'a> {
    bits: &'a [u64],
    words: usize,
    rows: usize,
    columns: u32,
}

impl<'a> BitRows<'a> {
    /// `rows` rows of `words` words, of which `columns` columns are valid.
    pub fn new(bits: &'a [u64], words: usize, (rows, columns): (usize, usize)) -> Self {
        Self { bits: &bits[..words * rows], words, rows, columns: columns as u32 }
    }

    #[inline(always)]
    fn row<const ONE: bool>(&self, v: usize) -> &'a [u64] {
        if ONE { &self.bits[v..=v] } else { &self.bits[v * self.words..(v + 1) * self.words] }
    }
}

/// Fills the segment of pixel (u, v); returns its extent, and its spans by row.
#[simd]
pub(crate) fn fill_disc<S: Simd>(
    simd: S,
    white: &BitRows,
    (u, v): (u32, usize),
    spans: &mut [Span],
) -> Result<Extent, FillError> {
    if white.words == 1 {
        disc::<true>(white, (u, v), spans)
    } else {
        disc::<false>(white, (u, v), spans)
    }
}

/// Fills the black around the disc, including its inside.
#[simd]
pub(crate) fn fill_ring<S: Simd>(
    simd: S,
    black: &BitRows,
    disc: FilledSegment,
    spans: &mut [Span],
) -> Result<Extent, FillError> {
    if black.words == 1 {
        ring::<true>(black, disc, spans)
    } else {
        ring::<false>(black, disc, spans)
    }
}

#[inline(always)]
fn disc<const ONE: bool>(
    white: &BitRows,
    (u, v): (u32, usize),
    spans: &mut [Span],
) -> Result<Extent, FillError> {
    let seed = Span { first: u, end: u + 1 };
    let run = runs_touching(white.row::<ONE>(v), seed).ok_or(FillError::Seed)?;
    spans[v] = run;
    let mut extent = Extent { top: v, bottom: v + 1, columns: run };
    upwards::<ONE>(white, &mut extent, spans)?;
    downwards::<ONE>(white, &mut extent, spans)?;
    close::<ONE>(white, &mut extent, spans)?;
    Ok(extent)
}

#[inline(always)]
fn ring<const ONE: bool>(
    black: &BitRows,
    disc: FilledSegment,
    spans: &mut [Span],
) -> Result<Extent, FillError> {
    let mut columns = disc.extent.columns;
    for (v, filled) in (disc.extent.top..).zip(disc.rows()) {
        let row = black.row::<ONE>(v);
        let span = Span {
            first: start_of_run::<ONE>(row, filled.first),
            end: end_of_run::<ONE>(row, filled.end),
        };
        columns = columns.joined(span);
        spans[v] = span;
    }
    let mut extent = Extent { columns, ..*disc.extent };
    upwards::<ONE>(black, &mut extent, spans)?;
    downwards::<ONE>(black, &mut extent, spans)?;
    close::<ONE>(black, &mut extent, spans)?;
    Ok(extent)
}

/// Fills upwards from the top row.
#[inline(always)]
fn upwards<const ONE: bool>(
    bits: &BitRows,
    extent: &mut Extent,
    spans: &mut [Span],
) -> Result<(), FillError> {
    loop {
        if extent.columns.first == 0 || extent.columns.end >= bits.columns || extent.top == 0 {
            return Err(FillError::Edge(*extent));
        }
        let above = extent.top - 1;
        let Some(span) = runs_touching(bits.row::<ONE>(above), spans[extent.top]) else {
            return Ok(());
        };
        spans[above] = span;
        extent.top = above;
        extent.columns = extent.columns.joined(span);
    }
}

/// Fills downwards from the bottom row.
#[inline(always)]
fn downwards<const ONE: bool>(
    bits: &BitRows,
    extent: &mut Extent,
    spans: &mut [Span],
) -> Result<(), FillError> {
    loop {
        if extent.columns.first == 0
            || extent.columns.end >= bits.columns
            || extent.bottom == bits.rows
        {
            return Err(FillError::Edge(*extent));
        }
        let below = extent.bottom;
        let Some(span) = runs_touching(bits.row::<ONE>(below), spans[below - 1]) else {
            return Ok(());
        };
        spans[below] = span;
        extent.bottom = below + 1;
        extent.columns = extent.columns.joined(span);
    }
}

/// Adds pixels that touch the segment from the side until there are none.
#[inline(always)]
fn close<const ONE: bool>(
    bits: &BitRows,
    extent: &mut Extent,
    spans: &mut [Span],
) -> Result<(), FillError> {
    while leaks(bits, extent, spans) {
        for v in extent.top + 1..extent.bottom {
            spread::<ONE>(bits, v, spans[v - 1], &mut spans[v], extent);
        }
        for v in (extent.top..extent.bottom - 1).rev() {
            spread::<ONE>(bits, v, spans[v + 1], &mut spans[v], extent);
        }
        upwards::<ONE>(bits, extent, spans)?;
        downwards::<ONE>(bits, extent, spans)?;
    }
    Ok(())
}

#[inline(always)]
fn spread<const ONE: bool>(
    bits: &BitRows,
    v: usize,
    neighbor: Span,
    span: &mut Span,
    extent: &mut Extent,
) {
    if let Some(runs) = runs_touching(bits.row::<ONE>(v), neighbor) {
        *span = span.joined(runs);
        extent.columns = extent.columns.joined(runs);
    }
}

/// Whether a pixel of the class lies above or below a span, but outside the segment.
#[inline(always)]
fn leaks(bits: &BitRows, extent: &Extent, spans: &[Span]) -> bool {
    let rows = extent.top + 1..extent.bottom;
    let mut leaking = 0;
    for word in 0..bits.words {
        for v in rows.clone() {
            let (above, below) = (spans[v - 1].bits(word), spans[v].bits(word));
            let (over, under) =
                (bits.bits[(v - 1) * bits.words + word], bits.bits[v * bits.words + word]);
            leaking |= (under & above & !below) | (over & below & !above);
        }
    }
    leaking != 0
}

/// The smallest span that contains every run of the row that touches `span`.
#[inline(always)]
fn runs_touching(row: &[u64], span: Span) -> Option<Span> {
    if let [word] = *row {
        let touched = word & (u64::MAX << span.first) & (u64::MAX >> (64 - span.end));
        if touched == 0 {
            return None;
        }
        let (lowest, highest) = (touched.trailing_zeros(), 63 - touched.leading_zeros());
        let below = !word & !(u64::MAX << lowest);
        let above = !word & (u64::MAX << highest);
        return Some(Span { first: 64 - below.leading_zeros(), end: above.trailing_zeros() });
    }
    let touched = |word: usize| row[word] & span.bits(word);
    let words = span.first as usize / 64..(span.end as usize).div_ceil(64);
    let low = words.clone().find(|&word| touched(word) != 0)?;
    let high = words.rev().find(|&word| touched(word) != 0)?;
    let lowest = low as u32 * 64 + touched(low).trailing_zeros();
    let highest = high as u32 * 64 + 63 - touched(high).leading_zeros();
    Some(Span { first: start_of_run::<false>(row, lowest), end: end_of_run::<false>(row, highest) })
}

/// First column of the run that ends before column `u`; `u` if column `u - 1` is not of the class.
#[inline(always)]
fn start_of_run<const ONE: bool>(row: &[u64], u: u32) -> u32 {
    if ONE {
        let others = !row[0] & !u64::MAX.checked_shl(u).unwrap_or(0);
        return 64 - others.leading_zeros();
    }
    let mut word = u as usize / 64;
    let mut others = if word < row.len() { !row[word] & !(u64::MAX << (u % 64)) } else { 0 };
    while others == 0 && word > 0 {
        word -= 1;
        others = !row[word];
    }
    (word as u32 + 1) * 64 - others.leading_zeros()
}

/// One past the run that begins with column `u`; `u` if it is not of the class.
#[inline(always)]
fn end_of_run<const ONE: bool>(row: &[u64], u: u32) -> u32 {
    if ONE {
        let others = !row[0] & u64::MAX.checked_shl(u).unwrap_or(0);
        return others.trailing_zeros();
    }
    let mut word = u as usize / 64;
    if word >= row.len() {
        return u;
    }
    let mut others = !row[word] & (u64::MAX << (u % 64));
    while others == 0 && word + 1 < row.len() {
        word += 1;
        others = !row[word];
    }
    word as u32 * 64 + others.trailing_zeros()
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};
    use proptest::prelude::*;

    /// The rule pixel by pixel: spans grow by the runs that touch a neighbouring row's span until
    /// none does.
    fn plain(rows: &[Vec<bool>], (u, v): (usize, usize)) -> Vec<Option<(usize, usize)>> {
        let run = |row: &[bool], u: usize| {
            let first = (0..u).rev().take_while(|&u| row[u]).last().unwrap_or(u);
            (first, (u..row.len()).take_while(|&u| row[u]).last().unwrap_or(u) + 1)
        };
        let mut spans = vec![None; rows.len()];
        spans[v] = Some(run(&rows[v], u));
        loop {
            let before = spans.clone();
            for v in 0..rows.len() {
                let near = [v.checked_sub(1), Some(v + 1)].into_iter().flatten();
                for (first, end) in near.filter_map(|near| *before.get(near)?) {
                    for u in (first..end).filter(|&u| rows[v][u]) {
                        let (a, b) = run(&rows[v], u);
                        let (first, end) = spans[v].unwrap_or((a, b));
                        spans[v] = Some((first.min(a), end.max(b)));
                    }
                }
            }
            if spans == before {
                return spans;
            }
        }
    }

    proptest! {
        #[test]
        fn filled_words_equal_filled_pixels(
            width in 3usize..140,
            height in 3usize..12,
            bits in proptest::collection::vec(proptest::bool::weighted(0.6), 1680),
            at in 0usize..1680,
        ) {
            let mut rows: Vec<Vec<bool>> = bits.chunks(width).take(height).map(<[bool]>::to_vec).collect();
            // With a border, so that not all segments reach an edge.
            for (v, row) in rows.iter_mut().enumerate() {
                row[0] = false;
                row[width - 1] = false;
                if v == 0 || v == height - 1 {
                    row.fill(false);
                }
            }
            let (u, v) = (at % width, at / width % height);
            let words = width.div_ceil(64);
            let packed: Vec<u64> = rows
                .iter()
                .flat_map(|row| {
                    (0..words).map(move |word| {
                        let part = row.iter().skip(word * 64).take(64).enumerate();
                        part.fold(0, |bits, (k, &set)| bits | u64::from(set) << k)
                    })
                })
                .collect();
            let white = BitRows::new(&packed, words, (height, width));
            let mut spans = vec![Span::default(); height];
            let found = dispatch!(Level::new(), simd => {
                fill_disc(simd, &white, (u as u32, v), &mut spans)
            });
            if !rows[v][u] {
                prop_assert_eq!(found, Err(FillError::Seed));
                return Ok(());
            }
            let extent = found.unwrap();
            for (v, valid) in plain(&rows, (u, v)).into_iter().enumerate() {
                prop_assert_eq!((extent.top..extent.bottom).contains(&v), valid.is_some());
                if let Some((first, end)) = valid {
                    prop_assert_eq!((spans[v].first as usize, spans[v].end as usize), (first, end));
                    prop_assert!(extent.columns.first as usize <= first);
                    prop_assert!(extent.columns.end as usize >= end);
                }
            }
        }
    }

    #[test]
    fn a_segment_that_reaches_the_edge_is_rejected() {
        let rows = [0b0000u64, 0b1110, 0b0100, 0b0000];
        let white = BitRows::new(&rows, 1, (4, 4));
        let mut spans = [Span::default(); 4];
        let found = dispatch!(Level::new(), simd => fill_disc(simd, &white, (2, 2), &mut spans));
        assert!(matches!(found, Err(FillError::Edge(_))), "{found:?}");
    }
}
