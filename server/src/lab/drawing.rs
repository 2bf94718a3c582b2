//! Vector drawings: one list of shapes, written as SVG or PDF, or painted as pixels.
//!
//! x grows to the right and y downwards from the top left corner. Each drawing has its unit: pages use millimetres,
//! maps and charts use pixels. Text stays text in SVG and PDF. In pixels it is drawn with a bitmap font ([`glyph`]), so
//! that the result does not depend on installed fonts.

mod axes;
mod glyph;
mod overlay;
mod pdf;
mod raster;
mod svg;

use kurbo::{BezPath, Line, PathEl, Point, Rect, Shape as _, Size};

pub(crate) use axes::{Axes, LETTER_PX};
pub(crate) use glyph::width as text_width;
pub(crate) use overlay::Overlay;
pub(crate) use pdf::pdf;

/// Largest distance between a curve and its cubic Bézier segments, in units of the drawing.
pub(crate) const TOLERANCE: f64 = 1e-6;
/// Height of capitals over the font size of common sans-serif fonts.
const CAPITAL: f64 = 0.718;

pub(crate) type Color = [u8; 3];
pub(crate) const BLACK: Color = [0; 3];
pub(crate) const WHITE: Color = [255; 3];

/// The point of a text that is at its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

impl Anchor {
    /// Share of the text's width that lies left of its position.
    fn share(self) -> f64 {
        match self {
            Self::Start => 0.0,
            Self::Middle => 0.5,
            Self::End => 1.0,
        }
    }
}

/// A part of a drawing. Its paths consist of lines and cubic curves.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A filled area (even-odd rule).
    Fill { path: BezPath, color: Color },
    /// A line along a path. Painted without antialiasing, a width of 0 is one pixel.
    Line { path: BezPath, width: f64, color: Color },
    /// A line of text on its base line; `height` is that of a capital.
    Text { at: Point, anchor: Anchor, height: f64, text: String, color: Color },
    /// Black areas, clipped to a window.
    Clipped { window: Rect, paths: Vec<BezPath> },
}

impl Shape {
    pub(crate) fn fill(shape: impl kurbo::Shape, color: Color) -> Self {
        Self::Fill { path: shape.to_path(TOLERANCE), color }
    }

    pub(crate) fn line(from: Point, to: Point, width: f64) -> Self {
        Self::Line { path: Line::new(from, to).to_path(TOLERANCE), width, color: BLACK }
    }

    pub(crate) fn polyline(
        points: impl IntoIterator<Item = Point>,
        width: f64,
        color: Color,
    ) -> Self {
        let elements = points.into_iter().enumerate();
        let path = elements.map(|(index, point)| match index {
            0 => PathEl::MoveTo(point),
            _ => PathEl::LineTo(point),
        });
        Self::Line { path: path.collect(), width, color }
    }

    pub(crate) fn text(at: Point, anchor: Anchor, height: f64, text: impl Into<String>) -> Self {
        Self::Text { at, anchor, height, text: text.into(), color: BLACK }
    }
}

/// A white area with shapes on it; later ones cover earlier ones.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Drawing {
    pub(crate) size: Size,
    pub(crate) shapes: Vec<Shape>,
}
