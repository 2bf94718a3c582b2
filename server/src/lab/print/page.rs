//! Pages: their sizes, and their drawing.

use kurbo::{BezPath, Rect, Size};
use roundel_core::marker::Kind;

use crate::lab::drawing::{self, Drawing, Shape};

/// Edge of a page that printers leave white, millimetres.
pub(super) const EDGE_MM: f64 = 6.0;
/// Space for rulers and small print at the foot and at the right, millimetres.
pub(super) const FOOT_MM: f64 = 13.0;
pub(super) const RULER_MM: f64 = 6.0;

#[derive(Clone, Debug, PartialEq)]
pub struct PrintItem {
    pub kind: Kind,
    pub number: Option<u16>,
    /// Small print in its corner, such as `#17`.
    pub label: String,
}

/// Named sizes in portrait orientation, millimetres.
const NAMED: [(&str, f64, f64); 6] = [
    ("A2", 420.0, 594.0),
    ("A3", 297.0, 420.0),
    ("A4", 210.0, 297.0),
    ("A5", 148.0, 210.0),
    ("Letter", 215.9, 279.4),
    ("Legal", 215.9, 355.6),
];
/// Least and greatest side of a page, millimetres; the greatest is that of a PDF.
const SIDE_LIMITS_MM: (f64, f64) = (50.0, 5000.0);

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageSize {
    pub width_mm: f64,
    pub height_mm: f64,
}

impl PageSize {
    /// Parses a name, or `WIDTHxHEIGHT` in millimetres.
    pub fn parse(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let named = NAMED.iter().find(|(name, ..)| name.eq_ignore_ascii_case(text));
        if let Some(&(_, width_mm, height_mm)) = named {
            return Ok(Self { width_mm, height_mm });
        }
        let (least, most) = SIDE_LIMITS_MM;
        let side = |side: &str| side.trim().parse().ok().filter(|mm| (least..=most).contains(mm));
        let sides = text.split_once(['x', 'X', '×']);
        let sides = sides.and_then(|(width, height)| Some((side(width)?, side(height)?)));
        let (width_mm, height_mm) = sides.ok_or_else(|| {
            let names = NAMED.map(|(name, ..)| name).join(", ");
            format!(
                "expected a page of {names} or WIDTHxHEIGHT in millimetres, each {least} to {most}, found `{text}`"
            )
        })?;
        Ok(Self { width_mm, height_mm })
    }

    /// Rotated by a right angle.
    pub fn rotated(self) -> Self {
        Self { width_mm: self.height_mm, height_mm: self.width_mm }
    }

    /// The size's name in either orientation, or its sides.
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

/// Width of lines, millimetres.
pub const LINE_MM: f64 = 0.15;

/// A page: black on white, in millimetres from its top left corner.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    pub size: PageSize,
    /// The part that holds the prints; the rest of a print is clipped, and continues on another page.
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

    pub fn svg(&self) -> String {
        self.drawing().svg("mm")
    }
}

pub fn pdf(pages: &[Page], title: &str) -> Vec<u8> {
    drawing::pdf(pages.iter().map(Page::drawing), title)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_parsed_by_name_or_in_millimetres() {
        let a4 = PageSize { width_mm: 210.0, height_mm: 297.0 };
        assert_eq!(PageSize::parse("a4"), Ok(a4));
        assert_eq!(a4.rotated().name(), "A4");
        let roll = PageSize::parse("914.4x2000").unwrap();
        assert_eq!(roll, PageSize { width_mm: 914.4, height_mm: 2000.0 });
        assert_eq!(roll.name(), "914.4 x 2000 mm");
        for wrong in ["A9", "", "10x10", "210", "210x", "nanx300", "-210x297", "210x9999"] {
            let error = PageSize::parse(wrong).unwrap_err();
            assert!(
                error.contains("A4") && error.ends_with(&format!("found `{wrong}`")),
                "{error}"
            );
        }
    }
}
