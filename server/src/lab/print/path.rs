//! Outlines in millimetres: what every format of a print is drawn from.
//!
//! x grows to the right of the page and y down it, from the page's top left corner. Arcs are cubic
//! curves of at most 15°, which leave a circle by less than 2e-8 of its radius.

use std::f64::consts::{PI, TAU};

/// The widest arc that one cubic curve draws, radians.
const WIDEST_ARC_RAD: f64 = PI / 12.0;

/// A place on the page, millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    pub x: f64,
    pub y: f64,
}

impl Place {
    /// So far to the right and down of the top left corner.
    pub fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// Moved to the right and down.
    pub fn moved(self, x: f64, y: f64) -> Self {
        Self { x: self.x + x, y: self.y + y }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// A new outline begins.
    Move(Place),
    Line(Place),
    /// A cubic Bézier curve: both handles, then where it ends.
    Cubic(Place, Place, Place),
    /// Back to where the outline began.
    Close,
}

/// Closed outlines; what an odd number of them surrounds is inside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path {
    /// In the order of drawing.
    pub steps: Vec<Step>,
}

impl Path {
    /// A rectangle with its sides along the page's.
    pub fn add_rectangle(&mut self, area: &Area) {
        let Area { left, top, right, bottom } = *area;
        self.steps.push(Step::Move(Place::new(left, top)));
        for (x, y) in [(right, top), (right, bottom), (left, bottom)] {
            self.steps.push(Step::Line(Place::new(x, y)));
        }
        self.steps.push(Step::Close);
    }

    /// An ellipse with its axes along the page's; a circle where both are alike.
    pub fn add_ellipse(&mut self, center: Place, across: f64, down: f64) {
        self.steps.push(Step::Move(center.moved(across, 0.0)));
        self.arc(center, (across, down), 0.0, TAU);
        self.steps.push(Step::Close);
    }

    /// Begins an outline on a circle; angles are counter-clockwise from the page's right.
    pub fn begin_on_circle(&mut self, center: Place, radius: f64, angle_rad: f64) {
        self.steps.push(Step::Move(on_ellipse(center, (radius, radius), angle_rad)));
    }

    /// Straight to a place on a circle.
    pub fn line_to_circle(&mut self, center: Place, radius: f64, angle_rad: f64) {
        self.steps.push(Step::Line(on_ellipse(center, (radius, radius), angle_rad)));
    }

    /// Along a circle, counter-clockwise where `to_rad` is above `from_rad`, where the outline is.
    pub fn arc_on_circle(&mut self, center: Place, radius: f64, from_rad: f64, to_rad: f64) {
        self.arc(center, (radius, radius), from_rad, to_rad);
    }

    /// Ends an outline where it began.
    pub fn close(&mut self) {
        self.steps.push(Step::Close);
    }

    fn arc(&mut self, center: Place, radii: (f64, f64), from_rad: f64, to_rad: f64) {
        let count = ((to_rad - from_rad).abs() / WIDEST_ARC_RAD).ceil().max(1.0);
        let step_rad = (to_rad - from_rad) / count;
        let reach = 4.0 / 3.0 * (step_rad / 4.0).tan();
        for index in 0..count as usize {
            let begin_rad = from_rad + step_rad * index as f64;
            let end_rad = begin_rad + step_rad;
            let (begin, end) =
                (on_ellipse(center, radii, begin_rad), on_ellipse(center, radii, end_rad));
            // The tangents, turned counter-clockwise; y grows downwards.
            let tangent = |angle_rad: f64| (-radii.0 * angle_rad.sin(), -radii.1 * angle_rad.cos());
            let (out, back) = (tangent(begin_rad), tangent(end_rad));
            self.steps.push(Step::Cubic(
                begin.moved(reach * out.0, reach * out.1),
                end.moved(-reach * back.0, -reach * back.1),
                end,
            ));
        }
    }
}

fn on_ellipse(center: Place, (across, down): (f64, f64), angle_rad: f64) -> Place {
    center.moved(across * angle_rad.cos(), -down * angle_rad.sin())
}

/// A rectangle of the page, millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    /// Least x.
    pub left: f64,
    /// Least y.
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
}

impl Area {
    /// A square round its middle.
    pub fn square(center: Place, side: f64) -> Self {
        Self {
            left: center.x - side / 2.0,
            top: center.y - side / 2.0,
            right: center.x + side / 2.0,
            bottom: center.y + side / 2.0,
        }
    }

    pub fn width(&self) -> f64 {
        self.right - self.left
    }

    pub fn height(&self) -> f64 {
        self.bottom - self.top
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_circle_of_curves_is_a_circle() {
        let mut path = Path::default();
        let center = Place::new(30.0, 40.0);
        path.add_ellipse(center, 25.0, 25.0);
        let Some(Step::Move(mut at)) = path.steps.first().copied() else {
            panic!("no beginning: {path:?}");
        };
        let mut curves = 0;
        for step in &path.steps {
            let Step::Cubic(first, second, end) = *step else { continue };
            curves += 1;
            for share in [0.0, 0.2, 0.5, 0.8, 1.0] {
                let weight =
                    |power: i32| f64::powi(1.0 - share, 3 - power) * f64::powi(share, power);
                let mix = |of: fn(Place) -> f64| {
                    weight(0) * of(at)
                        + 3.0 * weight(1) * of(first)
                        + 3.0 * weight(2) * of(second)
                        + weight(3) * of(end)
                };
                let radius =
                    (mix(|place| place.x) - center.x).hypot(mix(|place| place.y) - center.y);
                assert!((radius - 25.0).abs() < 25.0 * 2e-8, "{radius}");
            }
            at = end;
        }
        assert_eq!(curves, 24);
        assert!((at.x - 55.0).abs() < 1e-12 && (at.y - 40.0).abs() < 1e-12);
    }
}
