//! How far from where all other cameras have objects each camera sees them, in pixels of its picture: the sharpest sign that
//! a lens, a place or a clock is not as it is said to be.
//!
//! The others' estimate is that of what they measured until then, so that a robot which speeds up adds what it has gone
//! farther since their last frames: at 1.5 m/s² and 16 ms a tenth of a millimetre.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use roundel_core::{
    camera::Camera,
    id::CameraId,
    rigid::Rigid,
    time::Timestamp,
    world::{Compared, Fusion},
};

use crate::model::hub::Hub;

/// From one look at a camera to the next.
const PERIOD_NS: i64 = 1_000_000_000;
/// Objects that are looked at each time, in turns: more would be felt by frames that wait meanwhile.
const OBJECTS_PER_UPDATE: usize = 2;
/// Looks that are told of together: eight seconds.
const WINDOW_LEN: usize = 8;
/// What was measured so long before a look belongs to it.
const MAX_AGE_NS: i64 = 250_000_000;

/// Sum of the squares, pixels², and of how many objects.
type SquaredSum = (f64, usize);

#[derive(Debug, Default)]
pub(super) struct ReprojectionMonitor {
    windows: BTreeMap<CameraId, ErrorWindow>,
}

#[derive(Debug, Default)]
struct ErrorWindow {
    newest: Option<Timestamp>,
    count: usize,
    kept: VecDeque<SquaredSum>,
}

impl ReprojectionMonitor {
    /// Looks at the camera that it looked at longest ago, if that is due: never at several in one turn.
    pub(super) fn advance(
        &mut self,
        now: Timestamp,
        cameras: &BTreeSet<CameraId>,
        (fusion, hub): (&mut Fusion, &Hub),
    ) {
        self.windows.retain(|camera, _| cameras.contains(camera));
        let newest =
            |camera: &CameraId| self.windows.get(camera).and_then(|windows| windows.newest);
        let Some(&camera) = cameras.iter().min_by_key(|camera| newest(camera)) else { return };
        if newest(&camera).is_some_and(|time| now.ns_since(time) < PERIOD_NS) {
            return;
        }
        let Some(state) = hub.camera(camera) else { return };
        let windows = self.windows.entry(camera).or_default();
        windows.newest = Some(now);
        let turn = windows.count * OBJECTS_PER_UPDATE;
        windows.count += 1;
        let squares =
            state.camera.map_or((0.0, 0), |lens| measure((camera, &lens), now, turn, fusion));
        windows.kept.push_back(squares);
        if windows.kept.len() > WINDOW_LEN {
            windows.kept.pop_front();
        }
        let reprojection_px = windows.rms_px();
        hub.update_camera(camera, |state| state.reprojection_px = reprojection_px);
    }
}

impl ErrorWindow {
    /// 0 where nothing was seen.
    fn rms_px(&self) -> f64 {
        let add =
            |(sum, count): SquaredSum, (more, others): &SquaredSum| (sum + more, count + others);
        let (sum_px2, count) = self.kept.iter().fold((0.0, 0), add);
        if count == 0 { 0.0 } else { (sum_px2 / count as f64).sqrt() }
    }
}

/// What a camera has seen of late.
fn measure(
    (camera, lens): (CameraId, &Camera),
    now: Timestamp,
    turn: usize,
    fusion: &mut Fusion,
) -> SquaredSum {
    let compared = fusion.compare(camera, (now, MAX_AGE_NS), (turn, OBJECTS_PER_UPDATE));
    let mut squares = (0.0, 0);
    for seen in compared {
        let Ok(placement) = fusion.camera_place(camera, seen.time) else { continue };
        let Some(squared_error_px2) = squared_error_px2(&seen, lens, &placement.world_from_camera)
        else {
            continue;
        };
        squares = (squares.0 + squared_error_px2, squares.1 + 1);
    }
    squares
}

/// The square of how far the two are from each other in the picture; `None` if either is not in it.
fn squared_error_px2(seen: &Compared, lens: &Camera, world_from_camera: &Rigid) -> Option<f64> {
    let pixel = |point_m: nalgebra::Vector3<f64>| {
        let own = world_from_camera.inverse_transform_point(&point_m.into());
        lens.project(&own.coords).ok().filter(|_| own.z > 0.0)
    };
    let (own, others) = (pixel(seen.seen_m)?, pixel(seen.others_m)?);
    Some((own.u - others.u).powi(2) + (own.v - others.v).powi(2))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use roundel_core::{
        camera::{Intrinsics, Lens},
        rigid::Covariance6,
        world::{CameraPlacement, FusionParams},
    };

    use super::{
        super::fixtures::{DEPTH_M, MIDDLE, frame, hub},
        *,
    };

    const FOCAL_PX: f64 = 600.0;
    const START: Timestamp = Timestamp::from_ns(1_700_000_000_000_000_000);
    const CAMERAS: [CameraId; 3] = [CameraId(0), CameraId(1), CameraId(2)];

    fn lens() -> Camera {
        Camera::new(Intrinsics {
            width: 640,
            height: 480,
            fx_px: FOCAL_PX,
            fy_px: FOCAL_PX,
            cx_px: MIDDLE.u,
            cy_px: MIDDLE.v,
            lens: Lens::PlumbBob([0.0; 5]),
        })
        .unwrap()
    }

    /// What the hub says of each camera after cameras that are off by so much along x have seen the same for two seconds.
    fn reported_px(offsets_m: &[f64]) -> Vec<f64> {
        let (hub, mut fusion) =
            (Arc::new(hub(&["0", "1", "2"], START)), Fusion::new(FusionParams::default()));
        let cameras: BTreeSet<CameraId> = CAMERAS[..offsets_m.len()].iter().copied().collect();
        for (camera, offset_m) in cameras.iter().zip(offsets_m) {
            let world_from_camera = Rigid::translation(*offset_m, 0.0, 0.0);
            let covariance = Covariance6::zeros();
            let placement = CameraPlacement { world_from_camera, covariance };
            fusion.set_camera(*camera, Some(placement));
            hub.update_camera(*camera, |state| state.camera = Some(lens()));
        }
        let mut reprojection = ReprojectionMonitor::default();
        for number in 1..=120_u32 {
            let time = START.plus_seconds(f64::from(number) / 60.0);
            cameras.iter().for_each(|camera| fusion.observe(&frame(*camera, number.into(), time)));
            fusion.snapshot(time);
            reprojection.advance(time, &cameras, (&mut fusion, &hub));
        }
        let state = |camera: &CameraId| hub.camera(*camera).unwrap();
        cameras.iter().map(|camera| state(camera).reprojection_px).collect()
    }

    #[test]
    fn cameras_that_agree_have_no_error_and_one_that_is_off_the_largest() {
        assert!(reported_px(&[0.0, 0.0, 0.0]).iter().all(|px| *px < 1e-6));
        let off_m = 0.006;
        let off = reported_px(&[0.0, 0.0, off_m]);
        // Of the first two each has the other and the one that is off beside it, which has both of them.
        let expected = [off_m / 2.0, off_m / 2.0, off_m];
        for (px, expected_m) in off.iter().zip(expected) {
            let expected_px = expected_m / DEPTH_M * FOCAL_PX;
            assert!((px - expected_px).abs() < 0.15 * expected_px, "{px} is not {expected_px}");
        }
    }

    #[test]
    fn of_a_camera_alone_nothing_is_said() {
        assert_eq!(reported_px(&[0.0]), [0.0]);
    }
}
