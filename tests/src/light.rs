//! Uneven light: shadow edges, lamps on one side, glare, vignetting.
//!
//! All but the shadow change slowly over the width of the lens' blur, so they modify the blurred image. A shadow falls
//! on the print before the lens blurs both, so [`crate::render`] computes it from the parts of each area inside it.

use nalgebra::Vector2;

use crate::half_plane::HalfPlane;

/// None of them by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Light {
    pub shadow: Option<Shadow>,
    pub ramp: Option<Ramp>,
    pub glare: Option<Glare>,
    pub vignetting: Option<Vignetting>,
}

/// A shadow with a hard, straight edge, over all that it falls on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shadow {
    pub area: HalfPlane,
    /// Share of the light that is lost.
    pub loss: f64,
}

/// Light that falls from 4/3 to 2/3 over a length, and beyond it to 3/2 and 1/2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ramp {
    pub center_px: [f64; 2],
    pub heading_rad: f64,
    pub length_px: f64,
}

/// A bright spot with a Gaussian profile, added to what is below.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glare {
    pub center_px: [f64; 2],
    /// Standard deviation.
    pub radius_px: f64,
    /// Grey levels at the centre.
    pub peak: f64,
}

/// Natural vignetting, by the fourth power of the cosine of the angle to the optical axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vignetting {
    pub center_px: [f64; 2],
    pub focal_px: f64,
}

impl Light {
    /// Whether [`Self::at`] leaves every level as it is.
    pub fn is_even(&self) -> bool {
        self.ramp.is_none() && self.glare.is_none() && self.vignetting.is_none()
    }

    /// Grey level of a pixel that has this one in even light.
    pub fn at(&self, grey: f64, pixel: Vector2<f64>) -> f64 {
        let mut lit = grey;
        if let Some(ramp) = self.ramp {
            let along = Vector2::new(ramp.heading_rad.cos(), ramp.heading_rad.sin());
            let place = along.dot(&(pixel - Vector2::from(ramp.center_px))) / ramp.length_px;
            // tanh is 2/3 at half the length.
            lit *= 1.0 - 0.5 * (2.0 * f64::atanh(2.0 / 3.0) * place).tanh();
        }
        if let Some(glare) = self.glare {
            let away = (pixel - Vector2::from(glare.center_px)).norm() / glare.radius_px;
            lit += glare.peak * (-0.5 * away * away).exp();
        }
        if let Some(vignetting) = self.vignetting {
            let away = (pixel - Vector2::from(vignetting.center_px)).norm() / vignetting.focal_px;
            lit /= (1.0 + away * away).powi(2);
        }
        lit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_has_the_requested_strength() {
        let at = |light: Light, u: f64, v: f64| light.at(90.0, Vector2::new(u, v));
        let ramp = Ramp { center_px: [10.0, 20.0], heading_rad: 0.0, length_px: 40.0 };
        let lamp = Light { ramp: Some(ramp), ..Light::default() };
        assert!((at(lamp, -10.0, 5.0) - 120.0).abs() < 1e-9);
        assert!((at(lamp, 30.0, 5.0) - 60.0).abs() < 1e-9);
        let glare = Glare { center_px: [10.0, 20.0], radius_px: 5.0, peak: 100.0 };
        let spot = Light { glare: Some(glare), ..Light::default() };
        assert!((at(spot, 10.0, 20.0) - 190.0).abs() < 1e-9);
        assert!((at(spot, 60.0, 20.0) - 90.0).abs() < 1e-9);
        let vignetting = Vignetting { center_px: [0.0; 2], focal_px: 50.0 };
        let corner = Light { vignetting: Some(vignetting), ..Light::default() };
        assert!((at(corner, 30.0, 40.0) - 22.5).abs() < 1e-9);
    }
}
