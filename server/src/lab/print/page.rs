//! Pages: their sizes, and what is on them.

use thiserror::Error;

use super::path::{Area, Path, Place};

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
    pub width_mm: f64,
    pub height_mm: f64,
}

/// No such page.
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

    pub fn rotated(self) -> Self {
        Self { width_mm: self.height_mm, height_mm: self.width_mm }
    }

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

/// How a text stands at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextAnchor {
    /// The place is where the text begins.
    Begin,
    /// The place is the text's middle.
    Middle,
    /// The place is where the text ends.
    End,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    Line {
        /// One end.
        from: Place,
        /// The other end.
        to: Place,
    },
    /// A line of small print, on its base line.
    Text {
        at: Place,
        /// How the place and the text go together.
        anchor: TextAnchor,
        /// Height of a capital, millimetres.
        height_mm: f64,
        text: String,
    },
}

/// How thick lines are, millimetres.
pub const LINE_MM: f64 = 0.15;

/// A page: black on white.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    pub size: PageSize,
    /// The part in which the prints are; what reaches beyond is cut off, and goes on on another page.
    pub window: Area,
    pub prints: Vec<Path>,
    /// What is round them: cut marks, ruler, small print.
    pub marks: Vec<Shape>,
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
