//! The server's clock, and commands for simulated robots on a server without a simulation.

use axum::{
    body::Body,
    http::{Request, StatusCode},
};
use roundel_proto::v1;
use tonic::Code;

use super::{
    grpc::connect,
    rig::{Rig, objects},
};

#[tokio::test]
async fn clock_readings_lie_between_request_and_response() {
    let rig = Rig::start().await;
    let before = rig.clock.now().as_ns();
    let request = v1::GetTimeRequest { sent_time_ns: -5 };
    let time = connect(&rig).await.get_time(request).await.unwrap().into_inner();
    assert_eq!(time.sent_time_ns, -5);
    assert!(before <= time.received_time_ns && time.received_time_ns <= time.replied_time_ns);
    assert!(time.replied_time_ns <= rig.clock.now().as_ns());
    rig.stop().await;
}

#[tokio::test]
async fn real_robots_cannot_be_driven() {
    let rig = Rig::start().await;
    rig.publish(objects(2));
    let mut client = connect(&rig).await;
    let velocity = Some(v1::Vector3 { x: 0.5, y: 0.0, z: 0.0 });
    let robots = vec![v1::RobotDrive { object_id: 1, velocity }];
    let status = client.drive_robots(v1::DriveRobotsRequest { robots }).await.unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    assert!(status.message().starts_with("nothing is simulated here"), "{status}");
    let push = v1::PushRobotRequest { object_id: 1, velocity, duration_ms: 10.0 };
    let status = client.push_robot(push).await.unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    rig.stop().await;
}

#[tokio::test]
async fn an_invalid_velocity_names_its_field() {
    let rig = Rig::start().await;
    rig.publish(objects(2));
    let mut client = connect(&rig).await;
    let drive = |object_id, velocity| v1::RobotDrive { object_id, velocity };
    let along = |x| Some(v1::Vector3 { x, y: 0.0, z: 0.0 });
    for (robots, expected) in [
        (
            vec![drive(1, along(0.5)), drive(2, along(1.01))],
            "robots[1].velocity: expected a velocity",
        ),
        (vec![drive(1, along(f64::NAN))], "robots[0].velocity"),
        (vec![drive(1, None)], "found nothing"),
        (
            vec![drive(1, along(0.1)), drive(1, along(0.1))],
            "robots[1].object_id: expected each object once",
        ),
    ] {
        let status = client.drive_robots(v1::DriveRobotsRequest { robots }).await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument);
        assert!(status.message().contains(expected), "{status}");
    }
    for duration_ms in [0.0, -1.0, 5001.0, f64::NAN] {
        let push = v1::PushRobotRequest { object_id: 1, velocity: along(1.0), duration_ms };
        let status = client.push_robot(push).await.unwrap_err();
        assert!(status.message().starts_with("duration_ms: expected"), "{status}");
    }
    let body = r#"{"object_id": 1, "velocity": {"x": 9, "y": 0, "z": 0}, "duration_ms": 100}"#;
    let request = Request::post(format!("{}/api/v1/simulation/push", rig.url()))
        .header("content-type", "application/json")
        .body(Body::from(body))
        .unwrap();
    let answer = rig.request(request).await;
    assert_eq!(answer.status, StatusCode::BAD_REQUEST);
    assert!(answer.error().1.contains("at most 2 m/s"), "{}", answer.text());
    rig.stop().await;
}
