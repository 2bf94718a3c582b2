//! Windows of a frame, and moments of runs of pixels.
//!
//! A run is a stretch of pixels of one class in a row. Its moments have a closed form, so the cost of a segment grows
//! with its rows, not its pixels (paper, algorithm 1).

use crate::frame::Frame;

/// A rectangle of pixels: columns `left..right`, rows `top..bottom`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// One past the last column.
    pub right: usize,
    /// One past the last row.
    pub bottom: usize,
}

impl Window {
    /// The whole frame.
    pub fn of(frame: &Frame) -> Self {
        Self { left: 0, top: 0, right: frame.width(), bottom: frame.height() }
    }

    /// The part of `frame` within the half sides `du`, `dv` (≥ 0) around (u, v); may be empty.
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

    /// Whether pixel (u, v) lies in the window.
    pub fn contains(&self, u: usize, v: usize) -> bool {
        (self.left..self.right).contains(&u) && (self.top..self.bottom).contains(&v)
    }

    /// Whether the window touches one of the frame's edges.
    pub fn touches_edge(&self, frame: &Frame) -> bool {
        self.left == 0
            || self.top == 0
            || self.right == frame.width()
            || self.bottom == frame.height()
    }
}

/// Sums over pixels of 1, u, v, u², uv, v², relative to an origin near the pixels. Exact: a frame's
/// side is at most 2¹⁴, so the largest sum stays below 2⁵⁶.
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
    /// Adds the pixels (u, v) with `first ≤ u < end` of row `v`.
    pub fn add_run(&mut self, v: i64, first: i64, end: i64) {
        let (n, u, uu) = powers(first, end);
        self.n += n;
        self.u += u;
        self.v += n * v;
        self.uu += uu;
        self.uv += u * v;
        self.vv += n * v * v;
    }

    /// The sums over the union of two disjoint sets.
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

/// Σ 1, Σ u, Σ u² over `first ≤ u < end`; zero for an empty range.
pub fn powers(first: i64, end: i64) -> (i64, i64, i64) {
    let n = (end - first).max(0);
    // Σ k = m (m + 1) / 2 and Σ k² = m (m + 1) (2 m + 1) / 6 over 0 ≤ k ≤ m = n - 1.
    let k = n * (n - 1) / 2;
    let kk = k * (2 * n - 1) / 3;
    (n, n * first + k, n * first * first + 2 * first * k + kk)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_equal_pixels() {
        let mut runs = Sums::default();
        let mut pixels = Sums::default();
        for (v, first, end) in [(-3, -7, 5), (0, 2, 3), (4, 6, 6), (9, 100, 140)] {
            runs.add_run(v, first, end);
            for u in first..end {
                pixels = pixels.joined(&Sums { n: 1, u, v, uu: u * u, uv: u * v, vv: v * v });
            }
        }
        assert_eq!(runs, pixels);
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
