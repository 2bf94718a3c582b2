//! Printed roundels: areas of even ink on a white sheet, in the roundel's plane.
//!
//! A [`Print`] is a design. [`Print::as_printed`] gives what a printer makes of it: another size, another ratio of the
//! diameters, ink that spreads. [`Bend`] is paper that is not flat.

use nalgebra::{Point3, Vector2};

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

    fn scaled(&self, factor: f64) -> Self {
        match self {
            Outline::Disc { diameter_m } => Outline::Disc { diameter_m: factor * diameter_m },
            Outline::Ellipse { along_m, across_m } => {
                Outline::Ellipse { along_m: factor * along_m, across_m: factor * across_m }
            }
            Outline::Polygon(corners) => {
                Outline::Polygon(corners.iter().map(|c| c.map(|it| factor * it)).collect())
            }
        }
    }

    /// The outline with its edge moved outwards. An ellipse remains an ellipse, which is exact at its four vertices.
    /// Corners of polygons remain sharp.
    fn grown(&self, by_m: f64) -> Self {
        match self {
            Outline::Disc { diameter_m } => Outline::Disc { diameter_m: diameter_m + 2.0 * by_m },
            Outline::Ellipse { along_m, across_m } => {
                Outline::Ellipse { along_m: along_m + 2.0 * by_m, across_m: across_m + 2.0 * by_m }
            }
            Outline::Polygon(corners) => Outline::Polygon(grown_polygon(corners, by_m)),
        }
    }
}

/// Moves each edge outwards and intersects it with its neighbours.
fn grown_polygon(corners: &[[f64; 2]], by_m: f64) -> Vec<[f64; 2]> {
    /// Closer corners count as one.
    const SAME_M: f64 = 1e-9;
    let mut distinct: Vec<Vector2<f64>> = Vec::new();
    for corner in corners.iter().map(|corner| Vector2::from(*corner)) {
        if distinct.last().is_none_or(|last| (corner - last).norm() > SAME_M) {
            distinct.push(corner);
        }
    }
    while distinct.len() > 1 && (distinct[0] - distinct[distinct.len() - 1]).norm() <= SAME_M {
        distinct.pop();
    }
    let count = distinct.len();
    let next = |i: usize| distinct[(i + 1) % count];
    let double_area: f64 = (0..count).map(|i| distinct[i].perp(&next(i))).sum();
    let outward = |i: usize| {
        let along = (next(i) - distinct[i]).normalize();
        Vector2::new(along.y, -along.x) * double_area.signum()
    };
    (0..count)
        .map(|i| {
            let (before, after) = (outward((i + count - 1) % count), outward(i));
            (distinct[i] + (before + after) * (by_m / (1.0 + before.dot(&after)))).into()
        })
        .collect()
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
    /// `None` for flat paper.
    pub bend: Option<Bend>,
}

/// Paper bent to a cylinder, which touches the roundel's plane at the centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend {
    /// Positive if the edges bend away from the viewer.
    pub radius_m: f64,
    /// Direction, in the roundel's plane, that remains straight.
    pub axis_rad: f64,
}

/// Differences between a design and its print.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Printing {
    /// Factor on all lengths.
    pub scale: f64,
    /// Further factor on the lengths of white ink, which changes the ratio of the diameters.
    pub ratio: f64,
    /// Distance that black spreads into white across every rim.
    pub spread_m: f64,
}

impl Default for Printing {
    fn default() -> Self {
        Self { scale: 1.0, ratio: 1.0, spread_m: 0.0 }
    }
}

impl Print {
    /// A plain roundel on a round sheet. The margin is `margin` times the outer diameter.
    pub fn plain(outer_diameter_m: f64, inner_diameter_m: f64, margin: f64) -> Self {
        let disc = |diameter_m, white| Ink { outline: Outline::Disc { diameter_m }, white };
        Self {
            sheet: Outline::Disc { diameter_m: outer_diameter_m * (1.0 + 2.0 * margin) },
            inks: vec![disc(outer_diameter_m, false), disc(inner_diameter_m, true)],
            bend: None,
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

    /// The print that a printer makes of this design. The sheet is cut to the design's scaled margin.
    pub fn as_printed(&self, printing: &Printing) -> Self {
        let Printing { scale, ratio, spread_m } = *printing;
        let ink = |ink: &Ink| {
            let (factor, by_m) =
                if ink.white { (scale * ratio, -spread_m) } else { (scale, spread_m) };
            Ink { outline: ink.outline.scaled(factor).grown(by_m), white: ink.white }
        };
        Self {
            sheet: self.sheet.scaled(scale),
            inks: self.inks.iter().map(ink).collect(),
            bend: self.bend,
        }
    }

    /// Place of a printed point in the roundel's frame.
    pub fn point(&self, x_m: f64, y_m: f64) -> Point3<f64> {
        let Some(Bend { radius_m, axis_rad }) = self.bend else {
            return Point3::new(x_m, y_m, 0.0);
        };
        let axis = Vector2::new(axis_rad.cos(), axis_rad.sin());
        let across = Vector2::new(-axis.y, axis.x);
        let flat = Vector2::new(x_m, y_m);
        let angle = across.dot(&flat) / radius_m;
        let level = axis * axis.dot(&flat) + across * (radius_m * angle.sin());
        Point3::new(level.x, level.y, radius_m * (angle.cos() - 1.0))
    }

    /// Largest distance of ink from the centre; the sheet does not count.
    pub fn radius_m(&self) -> f64 {
        self.inks.iter().map(|ink| ink.outline.radius_m()).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_spreads_over_both_rims() {
        let printing = Printing { scale: 0.97, ratio: 1.015, spread_m: 4e-4 };
        let printed = Print::plain(0.16, 0.064, 0.1).as_printed(&printing);
        let diameter = |ink: &Ink| 2.0 * ink.outline.radius_m();
        assert!((diameter(&printed.inks[0]) - (0.16 * 0.97 + 8e-4)).abs() < 1e-12);
        assert!((diameter(&printed.inks[1]) - (0.064 * 0.97 * 1.015 - 8e-4)).abs() < 1e-12);
        assert!((printed.sheet.radius_m() - 0.096 * 0.97).abs() < 1e-12);
    }

    #[test]
    fn polygons_grow_by_their_edges_in_either_orientation() {
        // An L, with a repeated corner.
        let corners = [[0.0, 0.0], [3.0, 0.0], [3.0, 0.0], [3.0, 1.0], [1.0, 1.0], [1.0, 2.0]];
        let corners: Vec<[f64; 2]> = corners.into_iter().chain([[0.0, 2.0]]).collect();
        let reversed: Vec<_> = corners.iter().rev().copied().collect();
        let expected = [[-0.1, -0.1], [3.1, -0.1], [3.1, 1.1], [1.1, 1.1], [1.1, 2.1], [-0.1, 2.1]];
        for corners in [corners, reversed] {
            let grown = grown_polygon(&corners, 0.1);
            assert_eq!(grown.len(), expected.len());
            for corner in grown {
                let near = |e: &[f64; 2]| (e[0] - corner[0]).hypot(e[1] - corner[1]) < 1e-12;
                assert!(expected.iter().any(near), "{corner:?}");
            }
        }
    }

    #[test]
    fn bent_paper_keeps_its_lengths() {
        let bend = Bend { radius_m: 0.5, axis_rad: 0.4 };
        let print = Print { bend: Some(bend), ..Print::plain(0.16, 0.064, 0.1) };
        let along = print.point(0.08 * bend.axis_rad.cos(), 0.08 * bend.axis_rad.sin());
        assert!(along.z.abs() < 1e-12 && (along.coords.norm() - 0.08).abs() < 1e-12);
        let edge = print.point(-0.08 * bend.axis_rad.sin(), 0.08 * bend.axis_rad.cos());
        // Sagitta of an arc of 80 mm: about s²/2R.
        assert!((edge.z + 0.08f64.powi(2) / 1.0).abs() < 2e-5, "{edge}");
        let chord = 2.0 * 0.5 * (0.08 / (2.0 * 0.5f64)).sin();
        assert!((edge.coords.norm() - chord).abs() < 1e-12);
    }
}
