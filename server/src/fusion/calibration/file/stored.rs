//! One camera of a calibration file, and its comparison with the configuration.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    rigid::{Rigid, from_upper_triangle, upper_triangle},
    world::CameraPlacement,
};
use serde::{Deserialize, Serialize};

use crate::model::config::{CameraConfig, Config, PoseConfig};

/// Tolerance for numbers that were written and read back, relative to themselves plus 1.
const SAME: f64 = 1e-9;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredCamera {
    pub name: String,
    /// 6x6 over (position m, rotation rad), world frame, left perturbation: upper triangle.
    pub covariance: Vec<f64>,
    pub pose: StoredPose,
    /// The lens that the pose was estimated with.
    pub lens: StoredLens,
    pub configured: StoredConfig,
}

/// world_from_camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredPose {
    position_m: Vec<f64>,
    orientation_xyzw: Vec<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredLens {
    model: String,
    size_px: [usize; 2],
    focal_px: [f64; 2],
    center_px: [f64; 2],
    distortion: Vec<f64>,
}

/// The configuration that the result belongs to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredConfig {
    /// `None`: unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<StoredPose>,
    pub lens: StoredLens,
}

impl StoredCamera {
    pub fn new(
        name: String,
        placement: &CameraPlacement,
        lens: &Camera,
        configured: StoredConfig,
    ) -> Self {
        Self {
            name,
            covariance: upper_triangle(&placement.covariance),
            pose: StoredPose::of(&placement.world_from_camera),
            lens: StoredLens::of(lens),
            configured,
        }
    }

    pub(super) fn merge_into(&self, config: &mut Config) -> Result<(), String> {
        let name = &self.name;
        let camera = config.cameras.iter_mut().find(|camera| camera.name == *name);
        let camera = camera.ok_or_else(|| {
            format!(
                "The calibration of camera {name} is dropped: no camera has that name any more."
            )
        })?;
        if let Some(what) = StoredConfig::of(camera).difference(&self.configured) {
            return Err(format!(
                "The calibration of camera {name} is dropped: the configuration has another {what} for it than it had \
                 then. The configuration's is used; calibrate the arena again."
            ));
        }
        let (placement, lens) = self.read()?;
        camera.pose = PoseConfig::Calibrated(Box::new(placement));
        camera.calibration = lens;
        Ok(())
    }

    pub(super) fn read(&self) -> Result<(CameraPlacement, Camera), String> {
        let world_from_camera = self.pose.read()?;
        let is_finite = self.covariance.iter().all(|it| it.is_finite());
        let covariance = from_upper_triangle(&self.covariance).filter(|_| is_finite);
        let covariance = covariance.ok_or_else(|| {
            format!("`covariance`: expected 21 finite numbers, found {:?}", self.covariance)
        })?;
        Ok((CameraPlacement { world_from_camera, covariance }, self.lens.read()?))
    }
}

impl StoredPose {
    fn of(pose: &Rigid) -> Self {
        let quaternion = pose.rotation.quaternion();
        Self {
            position_m: pose.translation.vector.as_slice().to_vec(),
            orientation_xyzw: vec![quaternion.i, quaternion.j, quaternion.k, quaternion.w],
        }
    }

    fn read(&self) -> Result<Rigid, String> {
        let expected = || {
            format!(
                "expected a `position_m` of three numbers and an `orientation_xyzw` of four and of length 1, \
                 found {:?} and {:?}",
                self.position_m, self.orientation_xyzw
            )
        };
        let (&[x, y, z], &[i, j, k, w]) = (&self.position_m[..], &self.orientation_xyzw[..]) else {
            return Err(expected());
        };
        let (place_m, quaternion) = (Vector3::new(x, y, z), Quaternion::new(w, i, j, k));
        let is_unit = (quaternion.norm() - 1.0).abs() < 1e-6;
        if !(is_unit && place_m.iter().all(|it| it.is_finite())) {
            return Err(expected());
        }
        let turn = UnitQuaternion::from_quaternion(quaternion);
        Ok(Rigid::from_parts(place_m.into(), turn))
    }

    fn numbers(&self) -> Vec<f64> {
        [&self.position_m[..], &self.orientation_xyzw].concat()
    }
}

impl StoredLens {
    fn of(lens: &Camera) -> Self {
        let it = lens.intrinsics();
        Self {
            model: it.lens.name().to_owned(),
            size_px: [it.width, it.height],
            focal_px: [it.fx_px, it.fy_px],
            center_px: [it.cx_px, it.cy_px],
            distortion: it.lens.coefficients().to_vec(),
        }
    }

    fn read(&self) -> Result<Camera, String> {
        let Some(lens) = Lens::from_ros(&self.model, &self.distortion) else {
            let count = self.distortion.len();
            return Err(format!(
                "`lens`: expected a model of ROS with its coefficients, found \"{}\" with {count}",
                self.model
            ));
        };
        let ([width, height], [fx_px, fy_px]) = (self.size_px, self.focal_px);
        let [cx_px, cy_px] = self.center_px;
        let intrinsics = Intrinsics { width, height, fx_px, fy_px, cx_px, cy_px, lens };
        Camera::new(intrinsics).map_err(|error| format!("`lens`: {error}"))
    }

    fn numbers(&self) -> Vec<f64> {
        let size_px = self.size_px.map(|it| it as f64);
        [&size_px[..], &self.focal_px, &self.center_px, &self.distortion].concat()
    }
}

impl StoredConfig {
    /// `camera`: before a calibration was merged.
    pub fn of(camera: &CameraConfig) -> Self {
        let pose = match &camera.pose {
            PoseConfig::Known(pose) => Some(StoredPose::of(pose)),
            _ => None,
        };
        Self { pose, lens: StoredLens::of(&camera.calibration) }
    }

    fn difference(&self, other: &Self) -> Option<&'static str> {
        let are_same = |these: Vec<f64>, others: Vec<f64>| {
            let is_same = |(a, b): (&f64, &f64)| (a - b).abs() <= SAME * (1.0 + a.abs());
            these.len() == others.len() && these.iter().zip(&others).all(is_same)
        };
        let pose =
            |config: &Self| config.pose.as_ref().map(StoredPose::numbers).unwrap_or_default();
        let (lens, other_lens) = (&self.lens, &other.lens);
        if lens.model != other_lens.model || !are_same(lens.numbers(), other_lens.numbers()) {
            return Some("lens");
        }
        (!are_same(pose(self), pose(other))).then_some("pose")
    }
}
