//! A camera while it is being looked for: a model with its parameters, and how the picture depends on them.

use nalgebra::{Matrix2xX, Vector3};

use super::distortion_model::Model;
use roundel_vision::camera::{Camera, Intrinsics};

/// Parameters beside the coefficients: fx, fy, cx, cy.
pub(crate) const PINHOLE: usize = 4;
/// Slopes by coefficients are taken over twice this.
const STEP: f64 = 1e-6;

/// A camera to be refined.
#[derive(Clone)]
pub(crate) struct Candidate {
    size: (usize, usize),
    model: Model,
    /// fx, fy, cx, cy, then all coefficients of the lens in ROS' order.
    parameters: Vec<f64>,
}

/// How images move with the estimated parameters.
pub(crate) struct Slopes {
    pub(crate) camera: Camera,
    /// Of each estimated coefficient, cameras with less and with more of it.
    nearby: Vec<[Camera; 2]>,
}

impl Candidate {
    /// Without distortion, the principal point in the middle of the picture of (columns, rows).
    pub(crate) fn new(size: (usize, usize), focal_px: f64, model: Model) -> Self {
        let (cx_px, cy_px) = ((size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0);
        let mut parameters = vec![focal_px, focal_px, cx_px, cy_px];
        parameters.resize(PINHOLE + model.coefficients(), 0.0);
        Self { size, model, parameters }
    }

    /// The same with another model, of whose coefficients the first is kept where it means the same.
    pub(crate) fn with_model(&self, model: Model) -> Self {
        let is_alike = model.ros_name() == self.model.ros_name();
        let mut parameters = self.parameters[..PINHOLE + usize::from(is_alike)].to_vec();
        parameters.resize(PINHOLE + model.coefficients(), 0.0);
        Self { size: self.size, model, parameters }
    }

    pub(crate) fn size(&self) -> (usize, usize) {
        self.size
    }

    pub(crate) fn model(&self) -> Model {
        self.model
    }

    /// How many parameters are estimated: fx, fy, cx, cy and the model's free coefficients.
    pub(crate) fn unknowns(&self) -> usize {
        PINHOLE + self.model.free().len()
    }

    /// `None`: there is no such camera.
    pub(crate) fn camera(&self) -> Option<Camera> {
        let lens = self.model.lens(&self.parameters[PINHOLE..])?;
        let (width, height) = self.size;
        Camera::new(Intrinsics {
            width,
            height,
            fx_px: self.parameters[0],
            fy_px: self.parameters[1],
            cx_px: self.parameters[2],
            cy_px: self.parameters[3],
            lens,
        })
        .ok()
    }

    /// Moves the estimated parameters by the first numbers of a step.
    pub(crate) fn step(&mut self, by: &[f64]) {
        let free = (0..PINHOLE).chain(self.model.free().iter().map(|index| PINHOLE + index));
        for (index, by) in free.zip(by) {
            self.parameters[index] += by;
        }
    }

    pub(crate) fn slopes(&self) -> Option<Slopes> {
        let nearby = |index: &usize| {
            let moved = |by: f64| {
                let mut moved = self.clone();
                moved.parameters[PINHOLE + index] += by;
                moved.camera()
            };
            Some([moved(-STEP)?, moved(STEP)?])
        };
        let nearby = self.model.free().iter().map(nearby).collect::<Option<_>>()?;
        Some(Slopes { camera: self.camera()?, nearby })
    }
}

impl Slopes {
    /// Derivatives of the image of a place in the camera's frame by the estimated parameters; `None` if it cannot be seen.
    pub(crate) fn at(&self, place_m: &Vector3<f64>) -> Option<Matrix2xX<f64>> {
        let pixel = self.camera.project(place_m).ok()?;
        let intrinsics = self.camera.intrinsics();
        let mut slopes = Matrix2xX::zeros(PINHOLE + self.nearby.len());
        slopes[(0, 0)] = (pixel.u - intrinsics.cx_px) / intrinsics.fx_px;
        slopes[(1, 1)] = (pixel.v - intrinsics.cy_px) / intrinsics.fy_px;
        (slopes[(0, 2)], slopes[(1, 3)]) = (1.0, 1.0);
        for (index, [below, above]) in self.nearby.iter().enumerate() {
            let (below, above) = (below.project(place_m).ok()?, above.project(place_m).ok()?);
            slopes[(0, PINHOLE + index)] = (above.u - below.u) / (2.0 * STEP);
            slopes[(1, PINHOLE + index)] = (above.v - below.v) / (2.0 * STEP);
        }
        Some(slopes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_what_a_step_does() {
        for model in Model::ALL {
            let mut candidate = Candidate::new((1280, 720), 900.0, model);
            candidate.step(&[3.0, -2.0, 5.0, 1.0, 0.05, -0.01]);
            let place_m = Vector3::new(0.12, -0.2, 0.6);
            let slopes = candidate.slopes().unwrap().at(&place_m).unwrap();
            assert_eq!(slopes.ncols(), candidate.unknowns());
            let before = candidate.camera().unwrap().project(&place_m).unwrap();
            for (index, slope) in slopes.column_iter().enumerate() {
                let mut by = vec![0.0; candidate.unknowns()];
                by[index] = 1e-4;
                let mut moved = candidate.clone();
                moved.step(&by);
                let after = moved.camera().unwrap().project(&place_m).unwrap();
                let (du, dv) = ((after.u - before.u) / 1e-4, (after.v - before.v) / 1e-4);
                let off = (slope.x - du).hypot(slope.y - dv);
                assert!(off < 1e-3 * (1.0 + slope.norm()), "{model:?} {index}: {slope} {du} {dv}");
            }
        }
    }

    #[test]
    fn another_model_keeps_the_first_coefficient_where_it_means_the_same() {
        let mut candidate = Candidate::new((1280, 720), 900.0, Model::Radial1);
        candidate.step(&[0.0, 0.0, 0.0, 0.0, 0.1]);
        let coefficients = |model: Model| {
            candidate.with_model(model).camera().unwrap().intrinsics().lens.coefficients().to_vec()
        };
        assert_eq!(coefficients(Model::PlumbBob), [0.1, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(coefficients(Model::Equidistant), [0.0; 4]);
    }
}
