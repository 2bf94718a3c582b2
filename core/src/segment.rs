//! Segments: connected pixels of one class, found by flood fill from one pixel of them.
//!
//! In: a frame, a seed, a class and the threshold τ. Out: the segment's box, its exact integer
//! moments and its mean grey level. A pixel is *black* if I < τ and *white* otherwise; it is
//! classified when the fill first looks at it and never before (paper, sections 3.1 and 3.2,
//! algorithm 1), so the cost grows with the segment and not with the frame.
//!
//! Unlike the paper's fill, which queues single pixels, this one queues *runs*: the longest
//! stretches of one class in a row. Moments of a run have a closed form, and a run has been seen if
//! and only if its first pixel is marked, so that one bit a run has to be set and cleared.
//! Neighbours are the four nearest pixels.

use crate::frame::Frame;

/// Which side of the threshold a segment's pixels are on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// I < τ.
    Black,
    /// I ≥ τ.
    White,
}

/// A rectangle of pixels: columns `left..right`, rows `top..bottom`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// Column after the last.
    pub right: usize,
    /// Row after the last.
    pub bottom: usize,
}

impl Window {
    /// The whole frame.
    pub fn of(frame: &Frame) -> Self {
        Self { left: 0, top: 0, right: frame.width(), bottom: frame.height() }
    }

    /// The part of `frame` within the half sides `du`, `dv` (≥ 0) of (u, v); possibly empty.
    pub fn around(frame: &Frame, (u, v): (f64, f64), (du, dv): (f64, f64)) -> Self {
        // The casts saturate, so a far or non-finite centre gives an empty window, not a panic.
        let column = |x: f64| (x.max(0.0) as usize).min(frame.width());
        let row = |x: f64| (x.max(0.0) as usize).min(frame.height());
        Self {
            left: column((u - du).ceil()),
            top: row((v - dv).ceil()),
            right: column((u + du).floor() + 1.0),
            bottom: row((v + dv).floor() + 1.0),
        }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.right.saturating_sub(self.left)
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.bottom.saturating_sub(self.top)
    }

    /// Whether pixel (u, v) lies in it.
    pub fn contains(&self, u: usize, v: usize) -> bool {
        (self.left..self.right).contains(&u) && (self.top..self.bottom).contains(&v)
    }

    /// Whether it reaches one of the frame's four edges.
    pub fn touches_edge(&self, frame: &Frame) -> bool {
        self.left == 0
            || self.top == 0
            || self.right == frame.width()
            || self.bottom == frame.height()
    }
}

/// Sums over pixels of 1, u, v, u², uv, v², with u and v counted from an origin near the pixels.
/// Exact: a frame's side is at most 2¹⁴, so the largest sum stays below 2⁵⁶.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sums {
    /// Σ 1.
    pub n: i64,
    /// Σ u.
    pub u: i64,
    /// Σ v.
    pub v: i64,
    /// Σ u².
    pub uu: i64,
    /// Σ u v.
    pub uv: i64,
    /// Σ v².
    pub vv: i64,
}

impl Sums {
    /// Adds the pixels (u, v) with `first ≤ u < end` of row `v`, in closed form.
    pub fn add_run(&mut self, v: i64, first: i64, end: i64) {
        let (n, u, uu) = powers(first, end);
        self.n += n;
        self.u += u;
        self.v += n * v;
        self.uu += uu;
        self.uv += u * v;
        self.vv += n * v * v;
    }

    /// The sums of two disjoint sets taken together.
    pub fn joined(&self, other: &Sums) -> Sums {
        Sums {
            n: self.n + other.n,
            u: self.u + other.u,
            v: self.v + other.v,
            uu: self.uu + other.uu,
            uv: self.uv + other.uv,
            vv: self.vv + other.vv,
        }
    }
}

/// Σ 1, Σ u, Σ u² over `first ≤ u < end`; zeros if there is no such u.
pub fn powers(first: i64, end: i64) -> (i64, i64, i64) {
    let n = (end - first).max(0);
    // Σ k = m (m + 1) / 2 and Σ k² = m (m + 1) (2 m + 1) / 6 over 0 ≤ k ≤ m = n - 1.
    let k = n * (n - 1) / 2;
    let kk = k * (2 * n - 1) / 3;
    (n, n * first + k, n * first * first + 2 * first * k + kk)
}

/// A segment that lay wholly inside the bounds given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Smallest window that holds it.
    pub window: Window,
    /// Moments about the fill's origin.
    pub sums: Sums,
    /// Mean grey level, μ of the paper's algorithm 1.
    pub mean: f64,
}

/// Why a fill gave no segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spill {
    /// The seed is not of the class, or outside the bounds.
    Seed,
    /// The segment goes on past the bounds.
    Bounds,
}

/// What to fill and how far.
#[derive(Clone, Copy, Debug)]
pub struct Fill {
    /// A pixel (u, v) of the segment.
    pub seed: (usize, usize),
    /// Class of the segment.
    pub class: Class,
    /// Threshold τ.
    pub threshold: u8,
    /// The fill gives up as soon as the segment leaves this window, so that a seed in a large dark
    /// region costs no more than a roundel of the size looked for.
    pub bounds: Window,
    /// Pixel that moments are counted from; the same for segments whose sums are to be joined.
    pub origin: (usize, usize),
}

#[derive(Clone, Copy, Debug)]
struct Run {
    v: u32,
    first: u32,
    end: u32,
}

/// Memory of the fill, kept from call to call. Between calls no bit is set.
#[derive(Debug, Default)]
pub struct FillScratch {
    seen: Vec<u64>,
    runs: Vec<Run>,
}

impl FillScratch {
    /// Makes room for frames of this size; allocates only when they grow.
    fn fit(&mut self, frame: &Frame) {
        let words = (frame.width() * frame.height()).div_ceil(64);
        if self.seen.len() < words {
            self.seen.resize(words, 0);
        }
    }

    fn mark(&mut self, bit: usize) -> bool {
        let (word, mask) = (&mut self.seen[bit / 64], 1u64 << (bit % 64));
        let fresh = *word & mask == 0;
        *word |= mask;
        fresh
    }

    fn unmark_runs(&mut self, width: usize) {
        for run in &self.runs {
            let bit = run.v as usize * width + run.first as usize;
            self.seen[bit / 64] &= !(1u64 << (bit % 64));
        }
        self.runs.clear();
    }
}

/// Fills the segment that holds the seed (paper, algorithm 1, step 1).
pub fn fill(frame: &Frame, what: &Fill, scratch: &mut FillScratch) -> Result<Segment, Spill> {
    scratch.fit(frame);
    let result = match what.class {
        Class::Black => fill_class::<false>(frame, what, scratch),
        Class::White => fill_class::<true>(frame, what, scratch),
    };
    scratch.unmark_runs(frame.width());
    result
}

fn fill_class<const WHITE: bool>(
    frame: &Frame,
    what: &Fill,
    scratch: &mut FillScratch,
) -> Result<Segment, Spill> {
    let Fill { seed, threshold, bounds, .. } = *what;
    let inside = |value: u8| (value >= threshold) == WHITE;
    if !bounds.contains(seed.0, seed.1) || !inside(frame.row(seed.1)[seed.0]) {
        return Err(Spill::Seed);
    }
    let width = frame.width();
    let origin = (what.origin.0 as i64, what.origin.1 as i64);
    let mut sums = Sums::default();
    let mut grey = 0u64;
    let mut window = Window { left: seed.0, top: seed.1, right: seed.0 + 1, bottom: seed.1 + 1 };

    let mut next = 0;
    let first = whole_run::<WHITE>(frame.row(seed.1), seed.0, threshold);
    take(scratch, width, seed.1, first);
    while let Some(&run) = scratch.runs.get(next) {
        next += 1;
        let (v, first, end) = (run.v as usize, run.first as usize, run.end as usize);
        if first < bounds.left || end > bounds.right {
            return Err(Spill::Bounds);
        }
        sums.add_run(v as i64 - origin.1, first as i64 - origin.0, end as i64 - origin.0);
        grey += frame.row(v)[first..end].iter().map(|&i| u64::from(i)).sum::<u64>();
        window.left = window.left.min(first);
        window.right = window.right.max(end);
        window.top = window.top.min(v);
        window.bottom = window.bottom.max(v + 1);

        for neighbour in [v.wrapping_sub(1), v + 1] {
            if neighbour >= frame.height() {
                continue;
            }
            let row = frame.row(neighbour);
            let mut u = first;
            while u < end {
                if !inside(row[u]) {
                    u += 1;
                    continue;
                }
                if neighbour < bounds.top || neighbour >= bounds.bottom {
                    return Err(Spill::Bounds);
                }
                let run = whole_run::<WHITE>(row, u, threshold);
                take(scratch, width, neighbour, run);
                u = run.1;
            }
        }
    }
    Ok(Segment { window, sums, mean: grey as f64 / sums.n as f64 })
}

/// The run that holds pixel `u`, as (first, end).
fn whole_run<const WHITE: bool>(row: &[u8], u: usize, threshold: u8) -> (usize, usize) {
    let outside = |&value: &u8| (value >= threshold) != WHITE;
    let first = row[..u].iter().rposition(outside).map_or(0, |last| last + 1);
    let end = row[u..].iter().position(outside).map_or(row.len(), |steps| u + steps);
    (first, end)
}

fn take(scratch: &mut FillScratch, width: usize, v: usize, (first, end): (usize, usize)) {
    if scratch.mark(v * width + first) {
        scratch.runs.push(Run { v: v as u32, first: first as u32, end: end as u32 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The paper's own way: a queue of pixels.
    fn fill_by_pixels(pixels: &[u8], width: usize, what: &Fill) -> (Sums, u64) {
        let height = pixels.len() / width;
        let inside = |u: usize, v: usize| {
            (pixels[v * width + u] >= what.threshold) == (what.class == Class::White)
        };
        let mut seen = vec![false; pixels.len()];
        let mut queue = vec![what.seed];
        seen[what.seed.1 * width + what.seed.0] = true;
        let (mut sums, mut grey) = (Sums::default(), 0);
        while let Some((u, v)) = queue.pop() {
            let (du, dv) = (u as i64 - what.origin.0 as i64, v as i64 - what.origin.1 as i64);
            sums = sums.joined(&Sums { n: 1, u: du, v: dv, uu: du * du, uv: du * dv, vv: dv * dv });
            grey += u64::from(pixels[v * width + u]);
            for (nu, nv) in [(u + 1, v), (u.wrapping_sub(1), v), (u, v + 1), (u, v.wrapping_sub(1))]
            {
                if nu < width && nv < height && inside(nu, nv) && !seen[nv * width + nu] {
                    seen[nv * width + nu] = true;
                    queue.push((nu, nv));
                }
            }
        }
        (sums, grey)
    }

    proptest! {
        #[test]
        fn runs_equal_pixels(
            width in 1usize..20,
            rows in 1usize..20,
            values in proptest::collection::vec(0u8..4, 400),
            threshold in 1u8..4,
            at in 0usize..400,
        ) {
            let pixels = &values[..width * rows];
            let frame = Frame::new(pixels, width, rows, width).unwrap();
            let at = at % pixels.len();
            let class = if pixels[at] >= threshold { Class::White } else { Class::Black };
            let what = Fill {
                seed: (at % width, at / width),
                class,
                threshold,
                bounds: Window::of(&frame),
                origin: (3, 2),
            };
            let mut scratch = FillScratch::default();
            let segment = fill(&frame, &what, &mut scratch).unwrap();
            let (sums, grey) = fill_by_pixels(pixels, width, &what);
            prop_assert_eq!(segment.sums, sums);
            prop_assert_eq!(segment.mean, grey as f64 / sums.n as f64);
            prop_assert!(scratch.seen.iter().all(|&word| word == 0));
        }
    }

    #[test]
    fn fill_stops_at_its_bounds() {
        let pixels = [0u8; 100];
        let frame = Frame::new(&pixels, 10, 10, 10).unwrap();
        let bounds = Window { left: 2, top: 2, right: 8, bottom: 8 };
        let mut what =
            Fill { seed: (5, 5), class: Class::Black, threshold: 9, bounds, origin: (5, 5) };
        let mut scratch = FillScratch::default();
        assert_eq!(fill(&frame, &what, &mut scratch), Err(Spill::Bounds));
        what.class = Class::White;
        assert_eq!(fill(&frame, &what, &mut scratch), Err(Spill::Seed));
        what.seed = (1, 5);
        assert_eq!(fill(&frame, &what, &mut scratch), Err(Spill::Seed));
        assert!(scratch.seen.iter().all(|&word| word == 0));
    }

    #[test]
    fn windows_are_clipped_to_the_frame() {
        let pixels = [0u8; 20];
        let frame = Frame::new(&pixels, 5, 4, 5).unwrap();
        let all = Window::around(&frame, (2.0, 2.0), (9.0, 9.0));
        assert_eq!(all, Window::of(&frame));
        assert!(all.touches_edge(&frame));
        let none = Window::around(&frame, (f64::NAN, -50.0), (1.0, 1.0));
        assert_eq!(none.height(), 0);
    }
}
