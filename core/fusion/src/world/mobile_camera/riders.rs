//! All cameras that ride on tracked objects.

use std::collections::BTreeMap;

use super::{
    localize::Localizer,
    mount::{CameraMount, Ride, Unplaced, carried_by},
};
use crate::world::{identity::Subject, lifecycle::Track};
use roundel_vision::{id::CameraId, marker::Code, time::Timestamp};

/// A carrier turned by more than this, rms, nobody knows where to, gives no place, radians.
const MOST_TURN_RAD: f64 = 0.2;

/// One camera that rides.
#[derive(Clone, Debug)]
pub(in crate::world) struct Rider {
    pub(in crate::world) mount: CameraMount,
    pub(in crate::world) localizer: Localizer,
    before: Option<Timestamp>,
    period_s: Option<f64>,
}

/// All cameras that ride.
#[derive(Clone, Debug, Default)]
pub(in crate::world) struct Riders {
    cameras: BTreeMap<CameraId, Rider>,
}

impl Riders {
    pub(in crate::world) fn set(&mut self, camera: CameraId, mount: Option<CameraMount>) {
        match mount {
            Some(mount) => {
                let localizer = Localizer::default();
                let rider = Rider { mount, localizer, before: None, period_s: None };
                self.cameras.insert(camera, rider);
            }
            None => {
                self.cameras.remove(&camera);
            }
        }
    }

    pub(in crate::world) fn get_mut(&mut self, camera: CameraId) -> Option<&mut Rider> {
        self.cameras.get_mut(&camera)
    }

    /// Every mount, to be changed.
    pub(in crate::world) fn mounts_mut(&mut self) -> impl Iterator<Item = &mut CameraMount> {
        self.cameras.values_mut().map(|rider| &mut rider.mount)
    }

    pub(in crate::world) fn has(&self, camera: CameraId) -> bool {
        self.cameras.contains_key(&camera)
    }

    /// Whether what is seen as this is something that carries a camera.
    pub(in crate::world) fn is_carrier(&self, subject: &Subject, code: Option<Code>) -> bool {
        self.cameras.values().any(|rider| rider.mount.carrier.is(subject, code))
    }

    /// Notes that a frame was exposed.
    pub(in crate::world) fn expose(&mut self, camera: CameraId, time: Timestamp) {
        let Some(rider) = self.cameras.get_mut(&camera) else { return };
        if let Some(before) = rider.before {
            rider.period_s = Some(time.seconds_since(before).abs());
        }
        rider.before = rider.before.max(Some(time));
    }

    /// A camera's carrier at `time`.
    pub(in crate::world) fn ride(
        &self,
        camera: CameraId,
        tracks: &mut [Track],
        (time, clock_s): (Timestamp, f64),
    ) -> Result<Ride, Unplaced> {
        let rider = self.cameras.get(&camera).ok_or(Unplaced::Unknown)?;
        let index = carried_by(&rider.mount.carrier, tracks).ok_or(Unplaced::CarrierUnseen)?;
        let track = &mut tracks[index];
        let model = track.model;
        let estimate = track.history.at(time, &model);
        let attitude = estimate.attitude.estimate(0.0, &model);
        if attitude.yaw_symmetry != Some(1) {
            return Err(Unplaced::CarrierWithoutYaw);
        }
        let turn = attitude.covariance.fixed_view::<3, 3>(0, 0).trace();
        if turn > MOST_TURN_RAD * MOST_TURN_RAD {
            return Err(Unplaced::CarrierUncertain);
        }
        Ok(Ride { estimate, model, mount: rider.mount, period_s: rider.period_s, clock_s })
    }
}
