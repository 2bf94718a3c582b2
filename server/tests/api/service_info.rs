//! Lists of cameras and objects, server info, gRPC reflection and health.

use std::time::Duration;

use futures::StreamExt;
use roundel_core::{id::CameraId, world::ClockEstimate};
use roundel_proto::v1;
use roundel_server::model::{capture_clock::CaptureClock, hub::CameraStatus};
use tokio::time::{sleep, timeout};
use tonic::Code;
use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client};
use tonic_reflection::pb::v1 as reflection;

use super::{
    grpc::{channel, connect},
    rig::{Rig, TIMEOUT, objects},
};

#[tokio::test]
async fn lists_name_cameras_objects_and_the_server() {
    let rig = Rig::start().await;
    rig.publish(objects(2));
    rig.publish(objects(1));
    rig.hub.update_camera(CameraId(1), |camera| {
        camera.status = CameraStatus::Failed;
        camera.error = "no such file".into();
        (camera.restarts, camera.broken) = (4, 9);
        camera.capture_clock = Some(CaptureClock::ARRIVAL);
        camera.clock = Some(ClockEstimate {
            offset_s: -0.0125,
            skew: 2e-5,
            deviation_s: 5e-5,
            skew_deviation: 1e-6,
        });
    });
    let mut client = connect(&rig).await;
    let cameras =
        client.list_cameras(v1::ListCamerasRequest {}).await.unwrap().into_inner().cameras;
    assert_eq!(cameras.len(), 2);
    assert_eq!(
        (cameras[0].name.as_str(), cameras[0].status()),
        ("north", v1::CameraStatus::Starting)
    );
    assert_eq!(cameras[1].status(), v1::CameraStatus::Failed);
    assert_eq!((cameras[1].error.as_str(), cameras[1].restarts), ("no such file", 4));
    assert_eq!((cameras[1].broken, cameras[0].capture_clock), (9, None));
    let arrival = v1::CaptureClock { base: v1::TimeBase::Arrival as i32, deviation_ms: 50.0 };
    assert_eq!(cameras[1].capture_clock, Some(arrival));
    assert_eq!(cameras[0].clock, None);
    let clock = v1::CameraClock { offset_ms: -12.5, skew_ppm: 20.0, deviation_ms: 0.05 };
    assert_eq!(cameras[1].clock, Some(clock));
    let objects =
        client.list_objects(v1::ListObjectsRequest {}).await.unwrap().into_inner().objects;
    let stages: Vec<_> = objects.iter().map(|o| (o.object_id, o.stage(), o.observations)).collect();
    assert_eq!(stages, [(1, v1::LifeStage::Tracked, 180), (2, v1::LifeStage::Lost, 180)]);
    let info = client.get_server_info(v1::GetServerInfoRequest {}).await.unwrap().into_inner();
    assert_eq!((info.name.as_str(), info.source_id.as_str()), ("lab", "run"));
    assert_eq!(info.snapshot_rate_hz, 60.0);
    assert_eq!(info.version, env!("CARGO_PKG_VERSION"));
    rig.stop().await;
}

#[tokio::test]
async fn reflection_describes_the_service() {
    use reflection::{
        ServerReflectionRequest, server_reflection_client::ServerReflectionClient,
        server_reflection_request::MessageRequest, server_reflection_response::MessageResponse,
    };
    let rig = Rig::start().await;
    let mut client = ServerReflectionClient::new(channel(&rig).await);
    let ask =
        |request| ServerReflectionRequest { host: String::new(), message_request: Some(request) };
    let questions = futures::stream::iter([
        ask(MessageRequest::ListServices(String::new())),
        ask(MessageRequest::FileContainingSymbol("roundel.v1.ObjectState".into())),
    ]);
    let mut answers = client.server_reflection_info(questions).await.unwrap().into_inner();
    let first = answers.next().await.unwrap().unwrap().message_response;
    let Some(MessageResponse::ListServicesResponse(list)) = first else { panic!("{first:?}") };
    let names: Vec<String> = list.service.into_iter().map(|service| service.name).collect();
    assert!(names.contains(&"roundel.v1.Roundel".to_owned()), "{names:?}");
    assert!(names.contains(&"grpc.health.v1.Health".to_owned()), "{names:?}");
    let second = answers.next().await.unwrap().unwrap().message_response;
    assert!(matches!(second, Some(MessageResponse::FileDescriptorResponse(_))), "{second:?}");
    rig.stop().await;
}

#[tokio::test]
async fn health_follows_readiness() {
    let rig = Rig::start().await;
    let mut client = health_client::HealthClient::new(channel(&rig).await);
    let mut status = async |service: &str| {
        let request = HealthCheckRequest { service: service.to_owned() };
        client.check(request).await.unwrap().into_inner().status()
    };
    assert_eq!(status("").await, ServingStatus::Serving);
    assert_eq!(status("roundel.v1.Roundel").await, ServingStatus::NotServing);
    rig.set_camera_status(CameraStatus::Running);
    let serving = async {
        while status("roundel.v1.Roundel").await != ServingStatus::Serving {
            rig.publish(objects(1));
            sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(TIMEOUT, serving).await.expect("the service never becomes healthy");
    rig.stop().await;
}

#[tokio::test]
async fn an_unknown_method_is_unimplemented() {
    let rig = Rig::start().await;
    let request = axum::http::Request::post(format!("{}/roundel.v1.Roundel/Fly", rig.url()))
        .header("content-type", "application/grpc")
        .body(axum::body::Body::empty())
        .unwrap();
    let answer = rig.request(request).await;
    assert_eq!(answer.header("grpc-status"), (Code::Unimplemented as i32).to_string());
    rig.stop().await;
}
