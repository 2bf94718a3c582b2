//! Core's path from rendered frames to detections and to tracks, assembled as in the server but without it. The only
//! place where this crate's arenas are converted to core's types.

use anyhow::Context;
use nalgebra::Vector3;
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    frame::Frame,
    id::{CameraId, KindId},
    marker::{Code, CodeLayout, Detector, Kind, Params, Pattern, Ring, TrackedRing, Tracker},
    pose::{Detection, Located, Locator, PoseError},
    rigid::{self, Covariance6},
    time::Timestamp,
    world::{
        self, CameraMount, CameraPlacement, Carrier, ClockPrior, FrameObservations, Fusion,
        FusionParams, Landmark,
    },
};
use roundel_proto::v1;

use crate::{
    arena::{self, Arena, SiteClock},
    optics::{Distortion, Pinhole},
    render::Image,
};

pub fn core_camera(optics: &Pinhole) -> anyhow::Result<Camera> {
    let lens = match optics.distortion {
        Distortion::PlumbBob(d) => Lens::PlumbBob(d),
        Distortion::Equidistant(d) => Lens::Equidistant(d),
    };
    let intrinsics = Intrinsics {
        width: optics.width,
        height: optics.height,
        fx_px: optics.focal_px[0],
        fy_px: optics.focal_px[1],
        cx_px: optics.center_px[0],
        cy_px: optics.center_px[1],
        lens,
    };
    Camera::new(intrinsics).context("core refuses the camera")
}

pub fn core_kinds(kinds: &[arena::Kind]) -> Vec<Kind> {
    let kind = |kind: &arena::Kind| {
        let pattern = match (kind.inner_minor_m, kind.code_bits) {
            (Some(minor_diameter_m), _) => Pattern::Elliptical { minor_diameter_m },
            (None, Some(bits)) => Pattern::Coded(CodeLayout { bits, min_distance: 1 }),
            (None, None) => Pattern::Plain,
        };
        let plain = Kind::plain(&kind.name, kind.outer_diameter_m, kind.inner_diameter_m);
        Kind { pattern, ..plain }
    };
    kinds.iter().map(kind).collect()
}

/// One camera's detector, tracker and pose estimation.
pub struct Observer {
    tracker: Tracker,
    locator: Locator,
    /// Results for the rings of the newest frame.
    located: Vec<Result<Located, PoseError>>,
    line_time_s: f64,
    work: u64,
}

impl Observer {
    /// For a camera with this lens and shutter and these kinds of roundel.
    pub fn new(optics: &Pinhole, kinds: &[arena::Kind], line_time_s: f64) -> anyhow::Result<Self> {
        Self::with_params(optics, kinds, line_time_s, Params::default())
    }

    /// Like [`Self::new`], with another mode or other limits.
    pub fn with_params(
        optics: &Pinhole,
        kinds: &[arena::Kind],
        line_time_s: f64,
        params: Params,
    ) -> anyhow::Result<Self> {
        let kinds = core_kinds(kinds);
        let camera = core_camera(optics)?;
        let locator = Locator::new(camera, kinds.clone(), params.mode).with_line_time(line_time_s);
        let tracker = Tracker::new(Detector::new(kinds, params)?);
        Ok(Self { tracker, locator, located: Vec::new(), line_time_s, work: 0 })
    }

    /// Work of all precise fits so far, as core counts it.
    pub fn work(&self) -> u64 {
        self.work
    }

    /// Detections in the next frame, whose centre row was exposed at `capture_ns`.
    pub fn observe(&mut self, image: &Image, capture_ns: i64) -> anyhow::Result<Vec<Detection>> {
        self.observe_with(image, capture_ns, true)
    }

    /// The same for a frame in which no code can be read.
    pub fn observe_unread(&mut self, image: &Image) -> anyhow::Result<Vec<Detection>> {
        self.observe_with(image, 0, false)
    }

    fn observe_with(
        &mut self,
        image: &Image,
        capture_ns: i64,
        reads: bool,
    ) -> anyhow::Result<Vec<Detection>> {
        let frame = Frame::new(&image.pixels, image.width, image.height, image.width)?;
        let middle = (image.height as f64 - 1.0) / 2.0;
        let mut detections = Vec::new();
        let mut rings = self.tracker.process(&frame);
        let without_codes: Vec<TrackedRing>;
        if !reads {
            let unread = |ring: Ring| Ring { code: None, ..ring };
            without_codes =
                rings.iter().map(|one| TrackedRing { ring: unread(one.ring), ..*one }).collect();
            rings = &without_codes;
        }
        let time = Timestamp::from_ns(capture_ns);
        self.locator.locate_all_at(&frame, time, rings, &mut self.located);
        for (tracked, located) in rings.iter().zip(self.located.drain(..)) {
            self.work += located.as_ref().map_or(0, |it| it.work);
            let (ring, pose) = located.map_or((tracked.ring, None), |it| (it.ring, Some(it.pose)));
            let row_s = (tracked.ring.outer.center.v - middle) * self.line_time_s;
            let capture_time = time.plus_seconds(row_s);
            detections.push(Detection { track: tracked.track, ring, capture_time, pose });
        }
        Ok(detections)
    }
}

/// A server's prior for clocks without configuration.
const UNSET_CLOCK: ClockPrior = ClockPrior { offset_s: 0.05, skew: 1e-4 };

/// Fusion of an arena's cameras with exactly known poses. Clocks that are off get [`UNSET_CLOCK`].
pub fn fusion(arena: &Arena, params: FusionParams) -> Fusion {
    let mut fusion = Fusion::new(params);
    for (index, site) in arena.sites.iter().enumerate() {
        let camera = CameraId(index as u32);
        if let Some(mount) = site.mount {
            fusion.set_mount(camera, Some(core_mount(arena, &mount)));
        } else {
            let world_from_camera = site.world_from_camera;
            let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
            fusion.set_camera(camera, Some(placement));
        }
        if site.clock != SiteClock::default() {
            fusion.set_clock(camera, UNSET_CLOCK);
        }
    }
    let landmark = |landmark: &arena::Landmark| Landmark {
        position_deviation_m: EXACT,
        orientation: Some(landmark.pose.rotation),
        orientation_deviation_rad: EXACT,
        ..Landmark::new(
            KindId(landmark.kind as u16),
            core_code(&arena.kinds[landmark.kind], Some(landmark.code)),
            landmark.pose.translation.vector,
        )
    };
    fusion.set_landmarks(arena.landmarks.iter().map(landmark).collect());
    fusion
}

/// Deviation of values that are exactly known, m and rad.
const EXACT: f64 = 1e-5;

/// A camera on a robot with a coded roundel.
fn core_mount(arena: &Arena, mount: &arena::Mount) -> CameraMount {
    let robot = &arena.robots[mount.robot];
    let kind = arena.kinds.iter().position(|kind| kind.name == robot.kind).unwrap_or_default();
    let code = core_code(&arena.kinds[kind], robot.code).expect("a carrier has a code");
    CameraMount {
        carrier: Carrier::Roundel { kind: KindId(kind as u16), code },
        object_from_camera: mount.robot_from_camera,
        covariance: Covariance6::zeros(),
        localizes: !arena.landmarks.is_empty(),
    }
}

fn core_code(kind: &arena::Kind, number: Option<u16>) -> Option<Code> {
    let (bits, number) = kind.code_bits.zip(number)?;
    Some(Code { bits, number })
}

/// A frame's detections in fusion's type, received when they were captured.
pub fn observations(
    camera: usize,
    frame: usize,
    capture_ns: i64,
    detections: Vec<Detection>,
) -> FrameObservations {
    FrameObservations {
        camera: CameraId(camera as u32),
        frame: frame as u64 + 1,
        capture_time: Timestamp::from_ns(capture_ns),
        received_time: Timestamp::from_ns(capture_ns),
        calibration_version: 1,
        detections,
    }
}

/// The scored part of a snapshot, as a message.
pub fn message(snapshot: &world::Snapshot) -> v1::Snapshot {
    let vector = |v: &Vector3<f64>| v1::Vector3 { x: v.x, y: v.y, z: v.z };
    let object = |state: &world::ObjectState| {
        let q = state.orientation;
        let velocity_block = state.motion_covariance.fixed_view::<3, 3>(3, 3).into_owned();
        v1::ObjectState {
            object_id: state.id.0,
            stage: match state.stage {
                world::LifeStage::Tentative => v1::LifeStage::Tentative,
                world::LifeStage::Tracked => v1::LifeStage::Tracked,
                world::LifeStage::Predicted => v1::LifeStage::Predicted,
                world::LifeStage::Lost => v1::LifeStage::Lost,
            } as i32,
            position: Some(vector(&state.position_m)),
            orientation: Some(v1::Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
            velocity: Some(vector(&state.velocity_m_s)),
            yaw_observed: state.yaw_observed,
            yaw_symmetry: if state.yaw_observed { state.yaw_symmetry } else { 0 },
            code: state
                .code
                .map(|code| v1::Code { bits: code.bits.into(), number: code.number.into() }),
            covariance: rigid::upper_triangle(&state.covariance),
            velocity_covariance: rigid::upper_triangle(&velocity_block),
            ..Default::default()
        }
    };
    v1::Snapshot {
        pose_time_ns: snapshot.pose_time.as_ns(),
        objects: snapshot.objects.iter().map(object).collect(),
        ..Default::default()
    }
}
