//! All cameras that are fixed to tracked objects.

use std::collections::BTreeMap;

use super::{
    localize::Localizer,
    mount::{CameraMount, CarrierState, Unplaced, find_carrier_track},
};
use crate::world::{identity::Subject, lifecycle::Track};
use roundel_vision::{id::CameraId, marker::Code, time::Timestamp};

/// Largest rms uncertainty of a carrier's rotation from which a camera pose is derived, radians.
const MAX_ROTATION_DEVIATION_RAD: f64 = 0.2;

#[derive(Clone, Debug)]
pub(crate) struct MobileCamera {
    pub(crate) mount: CameraMount,
    pub(crate) localizer: Localizer,
    last_exposure: Option<Timestamp>,
    period_s: Option<f64>,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct MobileCameras {
    cameras: BTreeMap<CameraId, MobileCamera>,
}

impl MobileCameras {
    pub(crate) fn set(&mut self, camera: CameraId, mount: Option<CameraMount>) {
        match mount {
            Some(mount) => {
                let localizer = Localizer::default();
                let mobile = MobileCamera { mount, localizer, last_exposure: None, period_s: None };
                self.cameras.insert(camera, mobile);
            }
            None => {
                self.cameras.remove(&camera);
            }
        }
    }

    pub(crate) fn get_mut(&mut self, camera: CameraId) -> Option<&mut MobileCamera> {
        self.cameras.get_mut(&camera)
    }

    pub(crate) fn mounts_mut(&mut self) -> impl Iterator<Item = &mut CameraMount> {
        self.cameras.values_mut().map(|mobile| &mut mobile.mount)
    }

    pub(crate) fn contains(&self, camera: CameraId) -> bool {
        self.cameras.contains_key(&camera)
    }

    /// Whether a subject with this code carries a camera.
    pub(crate) fn is_carrier(&self, subject: &Subject, code: Option<Code>) -> bool {
        self.cameras.values().any(|mobile| mobile.mount.carrier.is(subject, code))
    }

    /// Notes the exposure of a frame.
    pub(crate) fn note_exposure(&mut self, camera: CameraId, time: Timestamp) {
        let Some(mobile) = self.cameras.get_mut(&camera) else { return };
        if let Some(last_exposure) = mobile.last_exposure {
            mobile.period_s = Some(time.seconds_since(last_exposure).abs());
        }
        mobile.last_exposure = mobile.last_exposure.max(Some(time));
    }

    /// State of a camera's carrier at `time`. `clock_s` is the standard deviation of the camera's clock.
    pub(crate) fn carrier_state(
        &self,
        camera: CameraId,
        tracks: &mut [Track],
        time: Timestamp,
        clock_s: f64,
    ) -> Result<CarrierState, Unplaced> {
        let mobile = self.cameras.get(&camera).ok_or(Unplaced::Unknown)?;
        let index =
            find_carrier_track(&mobile.mount.carrier, tracks).ok_or(Unplaced::CarrierUnseen)?;
        let track = &mut tracks[index];
        let model = track.model;
        let state = track.history.state_at(time, &model);
        let attitude = state.attitude.estimate(0.0, &model);
        if attitude.yaw_symmetry != Some(1) {
            return Err(Unplaced::CarrierWithoutYaw);
        }
        let turn = attitude.covariance.fixed_view::<3, 3>(0, 0).trace();
        if turn > MAX_ROTATION_DEVIATION_RAD * MAX_ROTATION_DEVIATION_RAD {
            return Err(Unplaced::CarrierUncertain);
        }
        Ok(CarrierState { state, model, mount: mobile.mount, period_s: mobile.period_s, clock_s })
    }
}
