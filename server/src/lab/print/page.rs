//! Pages: their sizes, and their drawing.

use kurbo::{BezPath, Rect, Size};
use roundel_core::marker::Kind;
use thiserror::Error;

use crate::lab::drawing::{self, Drawing, Shape};

/// So much of a page's edges printers leave white, millimetres.
pub(super) const EDGE_MM: f64 = 6.0;
/// What ruler and small print take at the foot and at the right, millimetres.
pub(super) const FOOT_MM: f64 = 13.0;
pub(super) const RULER_MM: f64 = 6.0;

#[derive(Clone, Debug, PartialEq)]
pub struct PrintItem {
    pub kind: Kind,
    pub number: Option<u16>,
    /// Small print in its corner, such as `#17`.
    pub label: String,
}

/// Sizes that have a name, millimetres upright.
const NAMED: [(&str, f64, f64); 6] = [
    ("A2", 420.0, 594.0),
    ("A3", 297.0, 420.0),
    ("A4", 210.0, 297.0),
    ("A5", 148.0, 210.0),
    ("Letter", 215.9, 279.4),
    ("Legal", 215.9, 355.6),
];
/// Sides that a page may have, millimetres: what a plotter's roll has, and what a PDF may.
const SIDE_LIMITS_MM: (f64, f64) = (50.0, 5000.0);

/// The size of a page, millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageSize {
    /// Across.
    pub width_mm: f64,
    /// Down.
    pub height_mm: f64,
}

#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "expected a page of {names} or WIDTHxHEIGHT in millimetres, each {} to {}, found `{found}`",
    SIDE_LIMITS_MM.0, SIDE_LIMITS_MM.1, names = names()
)]
pub struct PageSizeError {
    found: String,
}

fn names() -> String {
    NAMED.map(|(name, ..)| name).join(", ")
}

impl PageSize {
    /// Reads a name, or `WIDTHxHEIGHT` in millimetres.
    pub fn parse(text: &str) -> Result<Self, PageSizeError> {
        let text = text.trim();
        let named = NAMED.iter().find(|(name, ..)| name.eq_ignore_ascii_case(text));
        if let Some(&(_, width_mm, height_mm)) = named {
            return Ok(Self { width_mm, height_mm });
        }
        let wrong = || PageSizeError { found: text.to_owned() };
        let (width, height) = text.split_once(['x', 'X', '×']).ok_or_else(wrong)?;
        let side = |side: &str| {
            let (least, most) = SIDE_LIMITS_MM;
            side.trim().parse().ok().filter(|side| (least..=most).contains(side)).ok_or_else(wrong)
        };
        Ok(Self { width_mm: side(width)?, height_mm: side(height)? })
    }

    /// Turned by a right angle.
    pub fn rotated(self) -> Self {
        Self { width_mm: self.height_mm, height_mm: self.width_mm }
    }

    /// What people call it.
    pub fn name(&self) -> String {
        let named = NAMED.iter().find(|&&(_, width_mm, height_mm)| {
            (width_mm, height_mm) == (self.width_mm, self.height_mm)
                || (height_mm, width_mm) == (self.width_mm, self.height_mm)
        });
        match named {
            Some((name, ..)) => (*name).to_owned(),
            None => format!("{} x {} mm", self.width_mm, self.height_mm),
        }
    }
}

/// How thick lines are, millimetres.
pub const LINE_MM: f64 = 0.15;

/// A page: black on white, in millimetres from its top left corner.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    /// How large it is.
    pub size: PageSize,
    /// The part that holds the prints. It cuts off the rest of a print, which another page shows.
    pub window: Rect,
    pub prints: Vec<BezPath>,
    /// Cut marks, rulers and small print.
    pub marks: Vec<Shape>,
}

impl Page {
    pub(super) fn drawing(&self) -> Drawing {
        let prints = Shape::Clipped { window: self.window, paths: self.prints.clone() };
        Drawing {
            size: Size::new(self.size.width_mm, self.size.height_mm),
            shapes: std::iter::once(prints).chain(self.marks.iter().cloned()).collect(),
        }
    }

    /// The page as an SVG file.
    pub fn svg(&self) -> String {
        self.drawing().svg("mm")
    }
}

/// Pages as a PDF file.
pub fn pdf(pages: &[Page], title: &str) -> Vec<u8> {
    drawing::pdf(pages.iter().map(Page::drawing), title)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_by_name_or_in_millimetres() {
        let a4 = PageSize { width_mm: 210.0, height_mm: 297.0 };
        assert_eq!(PageSize::parse("a4"), Ok(a4));
        assert_eq!(a4.rotated().name(), "A4");
        let roll = PageSize::parse("914.4x2000").unwrap();
        assert_eq!(roll, PageSize { width_mm: 914.4, height_mm: 2000.0 });
        assert_eq!(roll.name(), "914.4 x 2000 mm");
        for wrong in ["A9", "", "10x10", "210", "210x", "nanx300", "-210x297", "210x9999"] {
            let error = PageSize::parse(wrong).unwrap_err().to_string();
            assert!(
                error.contains("A4") && error.ends_with(&format!("found `{wrong}`")),
                "{error}"
            );
        }
    }
}
