//! Printed roundels: areas of even ink on a white sheet, in the roundel's plane.

/// Outline of one printed area, in the roundel's plane (x right, y up).
#[derive(Clone, Debug, PartialEq)]
pub enum Outline {
    /// A disc about the centre.
    Disc { diameter_m: f64 },
    /// An elliptical disc about the centre.
    Ellipse {
        /// Along the print's x.
        along_m: f64,
        /// Along its y.
        across_m: f64,
    },
    /// A closed polygon. Curved outlines need enough corners.
    Polygon(Vec<[f64; 2]>),
}

impl Outline {
    /// Largest distance from the origin.
    pub fn radius_m(&self) -> f64 {
        match self {
            Outline::Disc { diameter_m } => diameter_m / 2.0,
            Outline::Ellipse { along_m, across_m } => along_m.max(*across_m) / 2.0,
            Outline::Polygon(corners) => {
                corners.iter().map(|c| c[0].hypot(c[1])).fold(0.0, f64::max)
            }
        }
    }
}

/// One area of even ink, printed over the areas below.
///
/// An area must lie wholly inside one area of the other ink, so that blur adds up exactly.
#[derive(Clone, Debug, PartialEq)]
pub struct Ink {
    pub outline: Outline,
    pub white: bool,
}

/// A print: a white sheet and inked areas, each inside an earlier one.
#[derive(Clone, Debug, PartialEq)]
pub struct Print {
    pub sheet: Outline,
    /// From bottom to top.
    pub inks: Vec<Ink>,
}

impl Print {
    /// A plain roundel on a round sheet. The margin is `margin` times the outer diameter.
    pub fn plain(outer_diameter_m: f64, inner_diameter_m: f64, margin: f64) -> Self {
        let disc = |diameter_m, white| Ink { outline: Outline::Disc { diameter_m }, white };
        Self {
            sheet: Outline::Disc { diameter_m: outer_diameter_m * (1.0 + 2.0 * margin) },
            inks: vec![disc(outer_diameter_m, false), disc(inner_diameter_m, true)],
        }
    }

    /// Like [`Self::plain`] with an elliptical disc, its longer diameter along x.
    pub fn elliptical(outer_diameter_m: f64, disc_m: (f64, f64), margin: f64) -> Self {
        let mut print = Self::plain(outer_diameter_m, disc_m.0, margin);
        print.inks[1].outline = Outline::Ellipse { along_m: disc_m.0, across_m: disc_m.1 };
        print
    }

    /// The negative: a white ring round a black disc, on a black sheet.
    pub fn inverted(mut self) -> Self {
        let sheet = Ink { outline: self.sheet.clone(), white: false };
        self.inks.iter_mut().for_each(|ink| ink.white = !ink.white);
        self.inks.insert(0, sheet);
        self
    }

    /// Largest distance of ink from the centre; the sheet does not count.
    pub fn radius_m(&self) -> f64 {
        self.inks.iter().map(|ink| ink.outline.radius_m()).fold(0.0, f64::max)
    }
}
