//! The map of predicted precision and coverage over REST.

use axum::http::StatusCode;
use nalgebra::DMatrix;
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    id::CameraId,
    plan::precision::LensUncertainty,
    rigid::{Covariance6, Rigid},
    world::CameraPlacement,
};
use roundel_server::model::hub::{CameraInfo, CameraPoseState, PoseStatus};

use super::rig::Rig;

/// Places a camera 4 m above the floor, looking down.
fn hang(rig: &Rig, camera: CameraId, x_m: f64) {
    let intrinsics = Intrinsics {
        width: 1280,
        height: 720,
        fx_px: 730.0,
        fy_px: 730.0,
        cx_px: 639.5,
        cy_px: 359.5,
        lens: Lens::PlumbBob([-0.08, 0.02, 0.0, 0.0, 0.0]),
    };
    let half_turn = nalgebra::UnitQuaternion::from_axis_angle(
        &nalgebra::Vector3::x_axis(),
        std::f64::consts::PI,
    );
    let world_from_camera =
        Rigid::from_parts(nalgebra::Translation3::new(x_m, 0.0, 4.0), half_turn);
    let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
    rig.hub.update_camera(camera, |state| {
        state.camera = Some(Camera::new(intrinsics).unwrap());
        state.pose = CameraPoseState::fixed(PoseStatus::Configured, placement);
    });
}

#[tokio::test]
async fn serves_the_map_as_numbers_and_as_drawings() {
    let rig = Rig::start().await;
    let ids: Vec<CameraId> = rig.hub.installation().cameras.keys().copied().collect();
    hang(&rig, ids[0], -1.0);
    let one = rig.get("/api/v1/plan?step=0.25").await;
    assert_eq!(one.status, StatusCode::OK, "{}", one.text());
    let one = one.json();
    assert_eq!(one["roundel"], "robot");
    let (columns, rows) = (one["columns"].as_u64().unwrap(), one["rows"].as_u64().unwrap());
    assert_eq!(one["deviation_m"].as_array().unwrap().len() as u64, columns * rows);
    // 3.7 m above the roundels the image covers 6.5 m; a roundel of 160 mm measures 32 px there.
    assert!((one["max_m"][0].as_f64().unwrap() - 2.3).abs() < 0.3, "{}", one["max_m"]);
    let median_m = one["summary"]["median_m"].as_f64().unwrap();
    assert!((3e-4..3e-3).contains(&median_m), "{median_m}");
    assert_eq!(one["summary"]["twice_share"], 0.0);
    assert!(one["stations"][1]["reason"].as_str().unwrap().contains("lens is unknown"));

    // A second camera improves the precision where both see the roundel.
    hang(&rig, ids[1], 1.0);
    let query = "/api/v1/plan?step=0.25&min=-1,-1&max=1,1";
    let both = rig.get(query).await.json();
    assert!(both["summary"]["twice_share"].as_f64().unwrap() > 0.9, "{}", both["summary"]);
    assert!(both["summary"]["median_m"].as_f64().unwrap() < 0.8 * median_m);
    let svg = rig.get(&format!("{query}&format=svg&show=cameras")).await;
    assert_eq!(svg.header("content-type"), "image/svg+xml");
    assert!(svg.text().contains("cameras that see robot"), "{}", svg.text());
    let png = rig.get(&format!("{query}&format=png&marker=80:32")).await;
    assert_eq!(png.header("content-type"), "image/png");
    assert!(png.body.starts_with(b"\x89PNG"));

    // A coded roundel counts where its code is readable, which is nowhere for a code of 16 bits.
    for (code, is_seen) in [("5", true), ("16", false)] {
        let map = rig.get(&format!("{query}&marker=220&code={code}")).await.json();
        let share = map["summary"]["seen_share"].as_f64().unwrap();
        assert_eq!(share > 0.5, is_seen, "{code}: {}", map["summary"]);
    }

    // Uncertain lenses increase the predicted deviation.
    let installation = rig.hub.installation();
    for (id, info) in &installation.cameras {
        let covariance = DMatrix::from_diagonal_element(4, 4, 5.0 * 5.0);
        let lens_uncertainty = Some(LensUncertainty { free: Vec::new(), covariance });
        rig.hub.set_camera(*id, CameraInfo { lens_uncertainty, ..info.as_ref().clone() });
    }
    let doubtful = rig.get(query).await.json();
    let exact_m = both["summary"]["median_m"].as_f64().unwrap();
    assert!(doubtful["summary"]["median_m"].as_f64().unwrap() > 2.0 * exact_m, "{doubtful}");
    rig.stop().await;
}

#[tokio::test]
async fn rejects_impossible_maps_with_a_reason() {
    let rig = Rig::start().await;
    let none = rig.get("/api/v1/plan").await;
    assert_eq!(none.error().0, "failed_precondition");
    assert!(none.error().1.contains("lens is unknown"), "{}", none.text());
    let ids: Vec<CameraId> = rig.hub.installation().cameras.keys().copied().collect();
    hang(&rig, ids[0], 0.0);
    for (query, expected) in [
        ("format=doc", "format: expected json, svg or png"),
        ("show=everything", "show: expected precision or cameras"),
        ("marker=160", "marker: expected OUTER_MM:INNER_MM"),
        ("marker=160:10", "expected an inner diameter of 0.2 to 0.8"),
        ("marker=160&code=40", "code: expected codes of 2 to 16 bits"),
        ("code=8:2", "code: expected a `marker` as well"),
        ("marker=160:64&roundel=robot", "marker: expected either `roundel` or `marker`"),
        ("min=1", "min: expected x,y in metres"),
        ("min=1,1&max=0,0", "arena along x: expected a side"),
        ("step=0.001", "spots of the map: expected at most 1000000"),
        ("step=0.02", "step: expected a step that gives"),
        ("step=0", "step: expected 0.000001 to 10000 m, found 0"),
        ("height=high", "height: expected metres"),
        ("height=9", "height: no camera sees the plane"),
        ("height=NaN", "height: expected -1000 to 1000 metres, found NaN"),
        ("colour=red", "query: expected one of"),
    ] {
        let answer = rig.get(&format!("/api/v1/plan?{query}")).await;
        assert_eq!(answer.status, StatusCode::BAD_REQUEST, "{query}: {}", answer.text());
        assert!(answer.error().1.contains(expected), "{query}: {}", answer.error().1);
    }
    let unknown = rig.get("/api/v1/plan?roundel=plate").await;
    assert_eq!(unknown.status, StatusCode::NOT_FOUND);
    assert!(
        unknown.error().1.contains("the configured kinds are robot, cart"),
        "{}",
        unknown.text()
    );
    rig.stop().await;
}
