//! Rms reprojection error of each camera against the others: the most sensitive sign of a wrong lens, pose or clock.
//!
//! The others' estimate is as old as their newest measurements, so the motion since then adds to the error: 0.1 mm at
//! 1.5 m/s² and 16 ms.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use roundel_core::{
    camera::Camera,
    id::CameraId,
    time::Timestamp,
    world::{Fusion, LeaveOneOut},
};

use crate::model::hub::Hub;

/// Time between two measurements of a camera.
const PERIOD_NS: i64 = 1_000_000_000;
/// Objects in one measurement, in turns: more would delay waiting frames.
const OBJECTS_PER_UPDATE: usize = 2;
/// Measurements in the average: eight seconds.
const WINDOW_LEN: usize = 8;
/// Observations up to this age are compared.
const MAX_AGE_NS: i64 = 250_000_000;

#[derive(Debug, Default)]
pub(super) struct ReprojectionMonitor {
    windows: BTreeMap<CameraId, ErrorWindow>,
}

#[derive(Debug, Default)]
struct ErrorWindow {
    newest: Option<Timestamp>,
    count: usize,
    /// Squared errors of each measurement, pixels².
    kept: VecDeque<Vec<f64>>,
}

impl ReprojectionMonitor {
    /// Measures the camera that was measured longest ago, if it is due: at most one in a call.
    pub(super) fn advance(
        &mut self,
        now: Timestamp,
        cameras: &BTreeSet<CameraId>,
        (fusion, hub): (&mut Fusion, &Hub),
    ) {
        self.windows.retain(|camera, _| cameras.contains(camera));
        let newest = |camera: &CameraId| self.windows.get(camera).and_then(|window| window.newest);
        let Some(&camera) = cameras.iter().min_by_key(|camera| newest(camera)) else { return };
        if newest(&camera).is_some_and(|time| now.ns_since(time) < PERIOD_NS) {
            return;
        }
        let Some(state) = hub.camera(camera) else { return };
        let window = self.windows.entry(camera).or_default();
        window.newest = Some(now);
        let turn = window.count * OBJECTS_PER_UPDATE;
        window.count += 1;
        let squares_px2 =
            state.camera.map(|lens| squared_errors_px2((camera, &lens), now, turn, fusion));
        window.kept.push_back(squares_px2.unwrap_or_default());
        if window.kept.len() > WINDOW_LEN {
            window.kept.pop_front();
        }
        let count = window.kept.iter().flatten().count().max(1);
        let mean_px2 = window.kept.iter().flatten().sum::<f64>() / count as f64;
        hub.update_camera(camera, |state| state.reprojection_px = mean_px2.sqrt());
    }
}

/// Squared distances in the image between where a camera and the others see objects.
fn squared_errors_px2(
    (camera, lens): (CameraId, &Camera),
    now: Timestamp,
    turn: usize,
    fusion: &mut Fusion,
) -> Vec<f64> {
    let compared = fusion.leave_one_out(camera, now, MAX_AGE_NS, turn, OBJECTS_PER_UPDATE);
    let squared_error_px2 = |compared: LeaveOneOut| {
        let world_from_camera =
            fusion.camera_placement(camera, compared.time).ok()?.world_from_camera;
        let pixel = |point_m: nalgebra::Vector3<f64>| {
            let own = world_from_camera.inverse_transform_point(&point_m.into());
            lens.project(&own.coords).ok().filter(|_| own.z > 0.0)
        };
        let (own, others) = (pixel(compared.measured_m)?, pixel(compared.others_m)?);
        Some((own.u - others.u).powi(2) + (own.v - others.v).powi(2))
    };
    compared.into_iter().filter_map(squared_error_px2).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use roundel_core::{
        camera::{Intrinsics, Lens},
        rigid::{Covariance6, Rigid},
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

    /// Error of each camera after two seconds, for cameras displaced along x by `offsets_m`.
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
    fn the_displaced_camera_has_the_largest_error() {
        assert!(reported_px(&[0.0, 0.0, 0.0]).iter().all(|px| *px < 1e-6));
        let off_m = 0.006;
        let off = reported_px(&[0.0, 0.0, off_m]);
        // Each of the first two is compared with one correct and one displaced camera, the third with two correct ones.
        let expected = [off_m / 2.0, off_m / 2.0, off_m];
        for (px, expected_m) in off.iter().zip(expected) {
            let expected_px = expected_m / DEPTH_M * FOCAL_PX;
            assert!((px - expected_px).abs() < 0.15 * expected_px, "{px} is not {expected_px}");
        }
    }

    #[test]
    fn a_single_camera_has_no_error() {
        assert_eq!(reported_px(&[0.0]), [0.0]);
    }
}
