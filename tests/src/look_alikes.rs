//! Shapes that resemble a roundel, as found in a lab: wheels, gears, broken rings, rings with a misshapen or
//! misplaced disc, targets, chain links, zeros, square markers.
//!
//! In: the size in the image. Out: areas of one grey each, from bottom to top, painted by [`crate::clutter`]. A shape
//! is defined in units of its radius and mapped into the image by a rotation and a foreshortening, like a tilted
//! print. The feature that distinguishes it from a roundel is never smaller than [`MIN_DEFECT_PX`] before blur, so
//! that a person sees it too.

use std::f64::consts::TAU;

use nalgebra::{Matrix2, Rotation2, Vector2};

use crate::{coverage::Contour, random::Random};

/// Smallest size of the feature that distinguishes a look-alike from a roundel.
pub const MIN_DEFECT_PX: f64 = 2.5;

/// One area of even grey.
pub type Area = (Contour, f64);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LookAlike {
    /// A ring with a gap, from a Landolt C to half a ring.
    Broken,
    /// The disc is off the ring's centre.
    Eccentric,
    /// A round ring with a square, triangular or narrow hole.
    Hole,
    /// A square, triangular or pentagonal frame with a round disc.
    Frame,
    /// A ring with spokes across its disc.
    Wheel,
    /// A ring with a black dot in its disc.
    Target,
    /// A ring with teeth outside.
    Gear,
    /// Two overlapping rings.
    Links,
    /// The digit 0: a narrow ring of even stroke, whose hole is narrower than its outline.
    Zero,
    /// A square marker: black frame, bits of cells.
    Marker,
    /// A square marker with a white disc at its centre.
    MarkerDisc,
}

impl LookAlike {
    pub const ALL: [LookAlike; 11] = [
        LookAlike::Broken,
        LookAlike::Eccentric,
        LookAlike::Hole,
        LookAlike::Frame,
        LookAlike::Wheel,
        LookAlike::Target,
        LookAlike::Gear,
        LookAlike::Links,
        LookAlike::Zero,
        LookAlike::Marker,
        LookAlike::MarkerDisc,
    ];

    /// Areas of this shape about `center`, from bottom to top.
    pub fn areas(self, center: Vector2<f64>, radius_px: f64, random: &mut Random) -> Vec<Area> {
        let mut pen = Pen::new(center, radius_px, random);
        match self {
            LookAlike::Broken => pen.broken(),
            LookAlike::Eccentric => pen.eccentric(),
            LookAlike::Hole => pen.hole(),
            LookAlike::Frame => pen.frame(),
            LookAlike::Wheel => pen.wheel(),
            LookAlike::Target => pen.target(),
            LookAlike::Gear => pen.gear(),
            LookAlike::Links => pen.links(),
            LookAlike::Zero => pen.zero(),
            LookAlike::Marker => pen.marker(false),
            LookAlike::MarkerDisc => pen.marker(true),
        }
        pen.areas
    }
}

fn polar(angle_rad: f64) -> Vector2<f64> {
    Vector2::new(angle_rad.cos(), angle_rad.sin())
}

/// Draws in units of the radius.
struct Pen<'a> {
    center: Vector2<f64>,
    from_unit: Matrix2<f64>,
    /// [`MIN_DEFECT_PX`] in units, along the most foreshortened direction.
    min_defect: f64,
    black: f64,
    white: f64,
    areas: Vec<Area>,
    random: &'a mut Random,
}

impl<'a> Pen<'a> {
    fn new(center: Vector2<f64>, radius_px: f64, random: &'a mut Random) -> Self {
        let foreshortening = random.uniform(0.55, 1.0);
        let turn = |random: &mut Random| Rotation2::new(random.uniform(0.0, TAU)).into_inner();
        let squeeze = Matrix2::new(1.0, 0.0, 0.0, foreshortening);
        let from_unit = turn(random) * squeeze * turn(random) * radius_px;
        let min_defect = MIN_DEFECT_PX / (radius_px * foreshortening);
        let (black, white) = (random.uniform(25.0, 70.0), random.uniform(175.0, 225.0));
        Self { center, from_unit, min_defect, black, white, areas: Vec::new(), random }
    }

    fn draw(&mut self, contour: Option<Contour>, grey: f64) {
        self.areas.extend(contour.map(|contour| (contour, grey)));
    }

    fn ellipse(&mut self, at: [f64; 2], semiaxes: [f64; 2], grey: f64) {
        let longest_px = self.from_unit.norm() * semiaxes[0].max(semiaxes[1]);
        let count = (TAU * longest_px / 0.6).ceil().max(48.0) as usize;
        let (center, from_unit) = (self.center, self.from_unit);
        let contour = Contour::smooth(count, |t| {
            let unit = Vector2::new(at[0] + semiaxes[0] * t.cos(), at[1] + semiaxes[1] * t.sin());
            Some(center + from_unit * unit)
        });
        self.draw(contour, grey);
    }

    fn disc(&mut self, radius: f64, grey: f64) {
        self.ellipse([0.0; 2], [radius; 2], grey);
    }

    fn polygon(&mut self, corners: &[Vector2<f64>], grey: f64) {
        let corners: Vec<_> =
            corners.iter().map(|corner| self.center + self.from_unit * corner).collect();
        self.draw(Contour::polygon(&corners, 1.0, Some), grey);
    }

    fn regular(&mut self, corners: usize, radius: f64, grey: f64) {
        let corner = |i: usize| polar(TAU * i as f64 / corners as f64) * radius;
        self.polygon(&(0..corners).map(corner).collect::<Vec<_>>(), grey);
    }

    /// Up to `max` corners, as long as those of a regular polygon of this radius stand out. `None` if three do not.
    fn corners(&mut self, max: usize, radius: f64) -> Option<usize> {
        let corners = 3 + (self.random.next_u64() % (max as u64 - 2)) as usize;
        let stands_out =
            |n: usize| radius * (1.0 - (TAU / (2 * n) as f64).cos()) >= self.min_defect;
        (3..=corners).rev().find(|&n| stands_out(n))
    }

    fn square(&mut self, at: [f64; 2], half: f64, grey: f64) {
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
            .map(|c| Vector2::new(at[0] + c[0] * half, at[1] + c[1] * half));
        self.polygon(&corners, grey);
    }

    /// Draws a label, a black disc on it, and a white disc inside, whose radius it returns.
    fn ring(&mut self) -> f64 {
        let ratio = self.random.uniform(0.4, 0.6);
        self.disc(1.45, self.white);
        self.disc(1.0, self.black);
        self.disc(ratio, self.white);
        ratio
    }

    fn broken(&mut self) {
        self.ring();
        let half = (0.5 * self.min_defect).max(self.random.uniform(0.15, 1.0));
        // A wedge that opens to twice the gap's width at the rim of the label.
        let corners = [[0.0, -0.5], [1.3, -1.0], [1.3, 1.0], [0.0, 0.5]];
        let corners = corners.map(|[x, y]| Vector2::new(x, y * 1.5 * half));
        self.polygon(&corners, self.white);
    }

    fn eccentric(&mut self) {
        self.disc(1.45, self.white);
        self.disc(1.0, self.black);
        let ratio = self.random.uniform(0.3, 0.45);
        let off = self.random.uniform(0.25, 0.4).max(self.min_defect).min(0.95 - ratio);
        self.ellipse([off, 0.0], [ratio; 2], self.white);
    }

    fn hole(&mut self) {
        self.disc(1.45, self.white);
        self.disc(1.0, self.black);
        match self.random.next_u64() % 3 {
            0 => self.ellipse([0.0; 2], [0.7, 0.3], self.white),
            _ => {
                if let Some(corners) = self.corners(4, 0.75) {
                    self.regular(corners, 0.75, self.white);
                }
            }
        }
    }

    fn frame(&mut self) {
        let Some(corners) = self.corners(5, 1.3) else { return };
        self.regular(corners, 2.0, self.white);
        self.regular(corners, 1.3, self.black);
        let disc = self.random.uniform(0.3, 0.5);
        self.disc(disc, self.white);
    }

    fn wheel(&mut self) {
        let ratio = self.random.uniform(0.7, 0.85);
        self.disc(1.45, self.white);
        self.disc(1.0, self.black);
        self.disc(ratio, self.white);
        let half = (0.5 * self.min_defect).max(self.random.uniform(0.05, 0.12));
        let spokes = 2 + (self.random.next_u64() % 4) as usize;
        for spoke in 0..spokes {
            let along = polar(TAU * spoke as f64 / (2 * spokes) as f64);
            let across = Vector2::new(-along.y, along.x) * half;
            let far = along * 0.95;
            self.polygon(&[far + across, far - across, -far - across, -far + across], self.black);
        }
    }

    fn target(&mut self) {
        self.disc(1.45, self.white);
        self.disc(1.0, self.black);
        self.disc(0.75, self.white);
        let dot = self.random.uniform(0.25, 0.4).max(0.5 * self.min_defect).min(0.6);
        self.disc(dot, self.black);
    }

    fn gear(&mut self) {
        self.disc(1.7, self.white);
        let depth = self.random.uniform(0.15, 0.3).max(self.min_defect);
        // Narrower teeth would blur into an even rim.
        let max = (TAU / (2.0 * self.min_defect)).clamp(5.0, 12.0) as u64;
        let teeth = (5 + self.random.next_u64() % (max - 4)) as usize;
        let corner = |i: usize| {
            let radius = if (i / 2).is_multiple_of(2) { 1.0 + depth } else { 1.0 };
            polar(TAU * i as f64 / (4 * teeth) as f64) * radius
        };
        self.polygon(&(0..4 * teeth).map(corner).collect::<Vec<_>>(), self.black);
        let disc = self.random.uniform(0.4, 0.6);
        self.disc(disc, self.white);
    }

    fn links(&mut self) {
        let apart = self.random.uniform(0.55, 0.8);
        for side in [-apart, apart] {
            self.ellipse([side, 0.0], [1.45; 2], self.white);
        }
        for side in [-apart, apart] {
            self.ellipse([side, 0.0], [1.0; 2], self.black);
        }
        for side in [-apart, apart] {
            self.ellipse([side, 0.0], [0.45; 2], self.white);
        }
    }

    fn zero(&mut self) {
        let stroke = self.random.uniform(0.3, 0.36).max(self.min_defect.min(0.36));
        self.ellipse([0.0; 2], [1.4, 1.0], self.white);
        self.ellipse([0.0; 2], [1.0, 0.5], self.black);
        self.ellipse([0.0; 2], [1.0 - stroke, 0.5 - stroke], self.white);
    }

    fn marker(&mut self, disc: bool) {
        const CELLS: usize = 5;
        let cell = 2.0 / (CELLS + 2) as f64;
        self.square([0.0; 2], 1.4, self.white);
        self.square([0.0; 2], 1.0, self.black);
        if disc {
            let disc = self.random.uniform(0.3, 0.6);
            self.disc(disc, self.white);
            return;
        }
        for index in 0..CELLS * CELLS {
            if self.random.next_u64() & 1 == 1 {
                let place = |i: usize| (i as f64 - 0.5 * (CELLS - 1) as f64) * cell;
                let at = [place(index % CELLS), place(index / CELLS)];
                self.square(at, 0.5 * cell, self.white);
            }
        }
    }
}
