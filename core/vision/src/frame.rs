//! A borrowed view of one 8-bit grey image, in which pixel (u, v) is `row(v)[u]`, and windows of it.

use thiserror::Error;

pub use crate::camera::MAX_SIDE_PX;
use crate::camera::PixelPoint;

/// An 8-bit grey image, row by row from the top, `stride` bytes from one row to the next.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
}

/// Why bytes do not form an image.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FrameError {
    /// A side is zero or too long.
    #[error("expected an image of 1 to {MAX_SIDE_PX} pixels a side, found {width} x {height}")]
    Size {
        /// Requested columns.
        width: usize,
        /// Requested rows.
        height: usize,
    },
    /// Rows overlap.
    #[error("expected a stride of at least the width {width}, found {stride}")]
    Stride {
        /// Requested columns.
        width: usize,
        /// Requested bytes per row.
        stride: usize,
    },
    /// Too few bytes.
    #[error("expected at least {expected} bytes of pixels, found {found}")]
    Length {
        /// Bytes required by size and stride.
        expected: usize,
        /// Bytes given.
        found: usize,
    },
}

impl<'a> Frame<'a> {
    /// A view of `pixels`, with `stride ≥ width` bytes between the starts of two rows.
    pub fn new(
        pixels: &'a [u8],
        width: usize,
        height: usize,
        stride: usize,
    ) -> Result<Self, FrameError> {
        if width == 0 || height == 0 || width > MAX_SIDE_PX || height > MAX_SIDE_PX {
            return Err(FrameError::Size { width, height });
        }
        if stride < width {
            return Err(FrameError::Stride { width, stride });
        }
        let expected = stride.saturating_mul(height - 1).saturating_add(width);
        if pixels.len() < expected {
            return Err(FrameError::Length { expected, found: pixels.len() });
        }
        Ok(Self { pixels, width, height, stride })
    }

    /// Columns, pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows, pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All bytes and the stride: pixel (u, v) is byte `v * stride + u`. Bytes beyond a row's width
    /// are padding.
    pub(crate) fn pixels(&self) -> (&'a [u8], usize) {
        (self.pixels, self.stride)
    }

    /// The grey values of row `v`, `width` of them. Panics if `v ≥ height`.
    pub fn row(&self, v: usize) -> &'a [u8] {
        assert!(v < self.height, "row {v} of an image of {} rows", self.height);
        &self.pixels[v * self.stride..v * self.stride + self.width]
    }

    /// Level at a point, bilinear between pixels; beyond the frame's edges that of the last pixels.
    pub(crate) fn level_at(&self, at: PixelPoint) -> f64 {
        let last = |size: usize| (size as f64 - 1.001).max(0.0);
        let (u, v) = (at.u.clamp(0.0, last(self.width)), at.v.clamp(0.0, last(self.height)));
        let (left, top) = (u as usize, v as usize);
        let (du, dv) = (u - left as f64, v - top as f64);
        let (right, bottom) = ((left + 1).min(self.width - 1), (top + 1).min(self.height - 1));
        let row = |v: usize| {
            let (here, next) = (f64::from(self.row(v)[left]), f64::from(self.row(v)[right]));
            here + (next - here) * du
        };
        let above = row(top);
        above + (row(bottom) - above) * dv
    }
}

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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_follow_the_stride() {
        let pixels: Vec<u8> = (0..12).collect();
        let frame = Frame::new(&pixels[..11], 3, 3, 4).unwrap();
        assert_eq!(frame.row(2), [8, 9, 10]);
    }

    #[test]
    fn errors_of_invalid_shapes_name_the_expectation() {
        assert_eq!(Frame::new(&[], 0, 1, 1).unwrap_err(), FrameError::Size { width: 0, height: 1 });
        assert_eq!(
            Frame::new(&[0; 9], 3, 3, 2).unwrap_err().to_string(),
            "expected a stride of at least the width 3, found 2"
        );
        assert_eq!(
            Frame::new(&[0; 8], 3, 3, 3).unwrap_err(),
            FrameError::Length { expected: 9, found: 8 }
        );
    }

    #[test]
    fn windows_are_clipped_to_the_frame() {
        let pixels = [0u8; 20];
        let frame = Frame::new(&pixels, 5, 4, 5).unwrap();
        assert_eq!(Window::around(&frame, (2.0, 2.0), (9.0, 9.0)), Window::of(&frame));
        let none = Window::around(&frame, (f64::NAN, -50.0), (1.0, 1.0));
        assert_eq!(none.height(), 0);
    }
}
