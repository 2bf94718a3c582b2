//! Camera parameters during optimization, and the derivatives of projections by them.

use nalgebra::{Matrix2x3, Matrix2x6, Matrix2xX, UnitQuaternion, Vector3, Vector6};

use super::distortion_model::DistortionModel;
use roundel_vision::{
    camera::{Camera, Intrinsics},
    rigid::Rigid,
};

/// Parameters besides the distortion coefficients: fx, fy, cx, cy.
pub(crate) const PINHOLE_COUNT: usize = 4;
/// Half of the interval of numerical derivatives by coefficients.
const DIFFERENCE_STEP: f64 = 1e-6;

#[derive(Clone)]
pub(crate) struct CameraParameters {
    pub(crate) size: (usize, usize),
    pub(crate) model: DistortionModel,
    /// fx, fy, cx, cy, then all coefficients of the lens in ROS order.
    parameters: Vec<f64>,
}

/// Derivatives of projections by the free parameters.
pub(crate) struct CameraJacobian {
    pub(crate) camera: Camera,
    /// For each estimated coefficient, cameras with a smaller and a larger value.
    neighbours: Vec<[Camera; 2]>,
}

impl CameraParameters {
    /// Without distortion, the principal point in the middle of a picture of (columns, rows).
    pub(crate) fn new(size: (usize, usize), focal_px: f64, model: DistortionModel) -> Self {
        let (cx_px, cy_px) = ((size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0);
        let mut parameters = vec![focal_px, focal_px, cx_px, cy_px];
        parameters.resize(PINHOLE_COUNT + model.coefficients(), 0.0);
        Self { size, model, parameters }
    }

    /// The same with another model. The first coefficient is kept if both models belong to the same family.
    pub(crate) fn with_model(&self, model: DistortionModel) -> Self {
        let is_same_family = model.ros_name() == self.model.ros_name();
        let mut parameters =
            self.parameters[..PINHOLE_COUNT + usize::from(is_same_family)].to_vec();
        parameters.resize(PINHOLE_COUNT + model.coefficients(), 0.0);
        Self { size: self.size, model, parameters }
    }

    /// Number of estimated parameters: fx, fy, cx, cy and the model's free coefficients.
    pub(crate) fn unknowns(&self) -> usize {
        PINHOLE_COUNT + self.model.free().len()
    }

    /// Returns `None` if the parameters are invalid.
    pub(crate) fn camera(&self) -> Option<Camera> {
        let lens = self.model.lens(&self.parameters[PINHOLE_COUNT..])?;
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

    /// Adds a step to the free parameters.
    pub(crate) fn step(&mut self, by: &[f64]) {
        let free =
            (0..PINHOLE_COUNT).chain(self.model.free().iter().map(|index| PINHOLE_COUNT + index));
        for (index, by) in free.zip(by) {
            self.parameters[index] += by;
        }
    }

    pub(crate) fn jacobian(&self) -> Option<CameraJacobian> {
        let neighbours = |index: &usize| {
            let moved = |by: f64| {
                let mut moved = self.clone();
                moved.parameters[PINHOLE_COUNT + index] += by;
                moved.camera()
            };
            Some([moved(-DIFFERENCE_STEP)?, moved(DIFFERENCE_STEP)?])
        };
        let neighbours = self.model.free().iter().map(neighbours).collect::<Option<_>>()?;
        Some(CameraJacobian { camera: self.camera()?, neighbours })
    }
}

impl CameraJacobian {
    /// Derivatives of the image of a point in the camera frame by the free parameters; `None` if it has no image.
    pub(crate) fn at(&self, place_m: &Vector3<f64>) -> Option<Matrix2xX<f64>> {
        let pixel = self.camera.project(place_m).ok()?;
        let intrinsics = self.camera.intrinsics();
        let mut jacobian = Matrix2xX::zeros(PINHOLE_COUNT + self.neighbours.len());
        jacobian[(0, 0)] = (pixel.u - intrinsics.cx_px) / intrinsics.fx_px;
        jacobian[(1, 1)] = (pixel.v - intrinsics.cy_px) / intrinsics.fy_px;
        (jacobian[(0, 2)], jacobian[(1, 3)]) = (1.0, 1.0);
        for (index, [below, above]) in self.neighbours.iter().enumerate() {
            let (below, above) = (below.project(place_m).ok()?, above.project(place_m).ok()?);
            jacobian[(0, PINHOLE_COUNT + index)] = (above.u - below.u) / (2.0 * DIFFERENCE_STEP);
            jacobian[(1, PINHOLE_COUNT + index)] = (above.v - below.v) / (2.0 * DIFFERENCE_STEP);
        }
        Some(jacobian)
    }
}

/// Derivatives of an image by the pose that carries a point into the camera: rotation (left perturbation), then
/// translation. `jacobian` is that by the point, and `rotated_m` the point before the translation.
pub(crate) fn pose_jacobian(jacobian: &Matrix2x3<f64>, rotated_m: &Vector3<f64>) -> Matrix2x6<f64> {
    let mut by_pose = Matrix2x6::zeros();
    by_pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-jacobian * rotated_m.cross_matrix()));
    by_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(jacobian);
    by_pose
}

/// The pose after a step of its rotation and translation.
pub(crate) fn stepped_pose(pose: &Rigid, step: &Vector6<f64>) -> Rigid {
    let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
    let translation = pose.translation.vector + step.fixed_rows::<3>(3);
    Rigid::from_parts(translation.into(), turn * pose.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jacobian_matches_finite_differences() {
        for model in DistortionModel::ALL {
            let mut parameters = CameraParameters::new((1280, 720), 900.0, model);
            parameters.step(&[3.0, -2.0, 5.0, 1.0, 0.05, -0.01]);
            let place_m = Vector3::new(0.12, -0.2, 0.6);
            let jacobian = parameters.jacobian().unwrap().at(&place_m).unwrap();
            assert_eq!(jacobian.ncols(), parameters.unknowns());
            let before = parameters.camera().unwrap().project(&place_m).unwrap();
            for (index, slope) in jacobian.column_iter().enumerate() {
                let mut by = vec![0.0; parameters.unknowns()];
                by[index] = 1e-4;
                let mut moved = parameters.clone();
                moved.step(&by);
                let after = moved.camera().unwrap().project(&place_m).unwrap();
                let (du, dv) = ((after.u - before.u) / 1e-4, (after.v - before.v) / 1e-4);
                let off = (slope.x - du).hypot(slope.y - dv);
                assert!(off < 1e-3 * (1.0 + slope.norm()), "{model:?} {index}: {slope} {du} {dv}");
            }
        }
    }

    #[test]
    fn a_model_of_the_same_family_keeps_the_first_coefficient() {
        let mut parameters = CameraParameters::new((1280, 720), 900.0, DistortionModel::Radial1);
        parameters.step(&[0.0, 0.0, 0.0, 0.0, 0.1]);
        let coefficients = |model: DistortionModel| {
            parameters.with_model(model).camera().unwrap().intrinsics().lens.coefficients().to_vec()
        };
        assert_eq!(coefficients(DistortionModel::PlumbBob), [0.1, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(coefficients(DistortionModel::Equidistant), [0.0; 4]);
    }
}
