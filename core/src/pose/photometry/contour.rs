//! Contours of the print in its own plane, as quadrature nodes.
//!
//! Lengths are in outer radii, x along the print's right and y up. A node is a place (x, y) and its
//! share (dx, dy) of the way round; ∮ f dx is then the sum of f(x, y) dx. The black area is positive:
//! the outer rim runs counter-clockwise, what is white in it clockwise.
//!
//! Round a smooth closed curve equal steps of the angle converge exponentially (a spacing of h against
//! a blur of σ errs by about 2 exp(-2π²σ²/h²)).

use crate::marker::Kind;

/// Nodes come in whole packs, so that vectors of any width divide them.
pub const PACK: usize = 16;
/// Contours that are kept; beyond them all are made anew.
const MAX_KEPT: usize = 512;

/// Nodes of all contours of one print.
#[derive(Clone, Debug, Default)]
pub struct Contour {
    /// Places.
    pub x: Vec<f32>,
    /// Places.
    pub y: Vec<f32>,
    /// Shares of the way.
    pub dx: Vec<f32>,
    /// Shares of the way.
    pub dy: Vec<f32>,
    /// How many nodes are the outer rim's: the first ones.
    pub outer: usize,
}

/// What a contour was made for.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Key {
    /// The disc's semiaxes.
    inner: (f64, f64),
    outer_packs: usize,
    inner_packs: usize,
}

/// Contours by print and number of nodes, each made when it is first needed.
#[derive(Clone, Debug, Default)]
pub struct Contours(Vec<(Key, Contour)>);

impl Contours {
    /// Contours of a print whose outer rim is at most `around_px` long, with nodes at most
    /// `spacing_px` apart.
    pub fn of(&mut self, kind: &Kind, around_px: f64, spacing_px: f64) -> &Contour {
        let (least, most) = kind.ratios();
        let packs = |share: f64| {
            let nodes = (share * around_px / spacing_px).min(65_536.0);
            ((nodes / PACK as f64).ceil() as usize).max(1)
        };
        let key = Key { inner: (most, least), outer_packs: packs(1.0), inner_packs: packs(most) };
        if let Some(index) = self.0.iter().position(|(known, _)| *known == key) {
            return &self.0[index].1;
        }
        if self.0.len() == MAX_KEPT {
            self.0.clear();
        }
        let mut contour = Contour::default();
        contour.ellipse((1.0, 1.0), key.outer_packs * PACK, 1.0);
        contour.outer = contour.x.len();
        contour.ellipse(key.inner, key.inner_packs * PACK, -1.0);
        self.0.push((key, contour));
        &self.0[self.0.len() - 1].1
    }
}

impl Contour {
    fn ellipse(&mut self, (a, b): (f64, f64), count: usize, sign: f64) {
        let step = std::f64::consts::TAU / count as f64;
        for i in 0..count {
            let (sin, cos) = (step * i as f64).sin_cos();
            self.x.push((a * cos) as f32);
            self.y.push((b * sin) as f32);
            self.dx.push((-sign * step * a * sin) as f32);
            self.dy.push((sign * step * b * cos) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::Pattern;

    #[test]
    fn contours_enclose_the_black_area() {
        let mut contours = Contours::default();
        let kind = Kind::plain("", 0.2, 0.08);
        let contour = contours.of(&kind, 90.0, 0.8);
        let terms = contour.x.iter().zip(&contour.dy);
        let area: f64 = terms.map(|(x, dy)| f64::from(x * dy)).sum();
        assert!((area - std::f64::consts::PI * (1.0 - 0.16)).abs() < 1e-5, "{area}");
        let pattern = Pattern::Elliptical { minor_diameter_m: 0.06 };
        let contour = contours.of(&Kind { pattern, ..kind }, 90.0, 0.8);
        let moment = |x: &[f32], dy: &[f32]| -> f64 {
            x.iter().zip(dy).map(|(x, dy)| f64::from(x * x * x * dy)).sum::<f64>() / 3.0
        };
        // Of an ellipse ∬ x² is π a³ b/4; its longer axis lies along x.
        let expected = std::f64::consts::FRAC_PI_4 * (1.0 - 0.4f64.powi(3) * 0.3);
        assert!((moment(&contour.x, &contour.dy) - expected).abs() < 1e-5);
    }
}
