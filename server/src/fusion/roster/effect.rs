//! Applies changes of cameras to workers, ports, the hub, fusion and the calibrator.

use roundel_core::id::CameraId;

use super::{CameraSetting, Roster, RosterError, State, difference::Difference, setup};
use crate::{
    capture::worker::{Place, Totals, Worker, WorkerParts, adoption::Adoption, pipeline::Pipeline},
    model::{
        address::SourceAddress,
        command::{Known, Order},
        config::{CameraConfig, Config, Effect},
        hub::PoseStatus,
        stop::Stop,
    },
};

/// What a worker begins with.
pub(super) struct Begin<'a> {
    pub(super) id: CameraId,
    pub(super) index: usize,
    pub(super) camera: &'a CameraConfig,
    pub(super) pipeline: Pipeline,
    pub(super) place: Place,
    pub(super) version: u64,
    pub(super) before: Totals,
}

impl Roster {
    /// Tells fusion of a camera, and opens its port.
    pub(super) fn introduce(
        &self,
        state: &State,
        id: CameraId,
        camera: &CameraConfig,
        config: &Config,
    ) {
        let place = Some(setup::stand(camera, config, &state.bodies.numbers));
        state.order(id, Known { place, clock: Some(setup::timekeeping(camera)) });
        if matches!(camera.address, SourceAddress::Push(_)) {
            self.ports.open(id);
        }
    }

    pub(super) fn begin(&self, state: &mut State, begin: Begin<'_>) -> Result<(), RosterError> {
        let Begin { id, index, camera, pipeline, place, version, before } = begin;
        let stop = Stop::default();
        let opener = (state.sources)(CameraSetting {
            index,
            camera,
            clock: self.clock,
            playback: self.playback,
            stop: stop.clone(),
            port: self.ports.get(id),
        });
        let worker = Worker::new(WorkerParts {
            id,
            name: camera.name.clone(),
            opener,
            pipeline,
            place,
            calibration_version: version,
            inbox: self.calibrator.inbox(id),
            hub: self.hub.clone(),
            fusion: state.to_fusion.clone(),
            clock: self.clock,
            promised_hz: camera.rate_hz,
            before,
        });
        state.crew.begin(id, &camera.name, worker, stop).map_err(|source| RosterError::Thread {
            name: format!("camera {}", camera.name),
            source,
        })
    }

    /// Does what follows from a change that is written.
    pub(super) fn put_into_effect(
        &self,
        state: &mut State,
        (id, index): (CameraId, usize),
        difference: &Difference,
    ) -> Result<(), RosterError> {
        let config = state.config.clone();
        let camera = &config.cameras[index];
        // Nothing of the old source comes after fusion has heard of the new one.
        let before = difference.restarts().then(|| state.crew.end(id).unwrap_or_default());
        self.hub.set_camera(id, setup::info(camera, &config));
        if difference.moves() {
            self.calibrator.set(id, setup::calibrated(camera));
        } else if difference.has(Effect::Rename) {
            self.calibrator.rename(id, &camera.name);
        }
        let place =
            difference.moves().then(|| setup::stand(camera, &config, &state.bodies.numbers));
        let clock = difference.resets_clock().then(|| setup::timekeeping(camera));
        state.order(id, Known { place, clock });
        let is_fed = matches!(camera.address, SourceAddress::Push(_));
        if is_fed {
            self.ports.open(id);
        } else {
            self.ports.close(id);
        }
        let place = setup::place(camera, &config);
        self.hub.update_camera(id, |shown| {
            if !is_fed {
                shown.link = None;
            }
            if difference.has(Effect::Source) {
                shown.capture_clock = None;
            }
            if difference.moves() {
                shown.health = None;
                place.shown().into_iter().for_each(|place| shown.place = place);
                shown.camera = Some(camera.calibration.clone());
                shown.calibration_version = 0;
            }
        });
        if let Some(before) = before {
            return self.begin_again(state, (id, index), &config, (difference, before));
        }
        if difference.moves() {
            let lens = camera.calibration.clone();
            self.calibrator.inbox(id).put(Adoption { lens, place, version: 0 });
        }
        Ok(())
    }

    /// A worker in the place of the one before: it goes on to count, and a place and a lens that were found out and
    /// still hold are kept.
    fn begin_again(
        &self,
        state: &mut State,
        (id, index): (CameraId, usize),
        config: &Config,
        (difference, before): (&Difference, Totals),
    ) -> Result<(), RosterError> {
        let mut camera = config.cameras[index].clone();
        let shown = self.hub.camera(id).unwrap_or_default();
        let is_kept = !difference.moves() && shown.place.status != PoseStatus::Searching;
        let place = if is_kept { Place::Kept } else { setup::place(&camera, config) };
        let lens = shown.camera.filter(|_| !difference.moves());
        camera.calibration = lens.unwrap_or(camera.calibration);
        let pipeline = Pipeline::new(setup::pipeline(&camera, config, before.detection)?)?;
        let (version, camera) = (shown.calibration_version, &camera);
        self.begin(state, Begin { id, index, camera, pipeline, place, version, before })
    }

    /// Nothing knows of a camera any more.
    pub(super) fn forget(&self, state: &State, id: CameraId) {
        self.ports.close(id);
        // Fusion is gone only when the server goes down.
        let _ = state.orders.send(Order::Remove(id));
        self.calibrator.remove(id);
        self.hub.remove_camera(id);
    }
}

impl State {
    fn order(&self, id: CameraId, known: Known) {
        // Fusion is gone only when the server goes down.
        let _ = self.orders.send(Order::Set(id, Box::new(known)));
    }
}
