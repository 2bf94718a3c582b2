//! The service of `proto/roundel/v1/roundel.proto`, with reflection (v1) and health.
//!
//! Health knows two names: the empty one serves as long as the process works; that of the service
//! serves while `/readyz` says so, too.

mod snapshots;

use std::{pin::Pin, sync::Arc};

use axum::Router;
use futures::{Stream, StreamExt, stream};
use roundel_proto::v1::{self, roundel_server::RoundelServer};
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status, service::Routes};
use tonic_health::server::HealthReporter;
use tower::service_fn;

use super::{
    ApiState, MAX_REQUEST_BYTES, calibration, configuration,
    error::{ApiError, SHUTTING_DOWN},
    history, objects as configured,
    observation_subscription::ObservationSubscription,
    picture, push,
    queries::{
        self, cameras, checked_backlog, newest_observations, newest_snapshot, next_event, objects,
    },
    recording, replay,
    selection::{self, MESSAGE_FIELDS, Selection},
    setup, simulation, source_probe,
};
use crate::api::convert;

type Messages<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// Answers gRPC requests out of the hub.
#[derive(Clone)]
pub struct Service {
    api: Arc<ApiState>,
}

/// The routes of the service, reflection and health, and the handle that sets the health.
pub fn router(api: &Arc<ApiState>) -> (Router, HealthReporter) {
    let (reporter, health) = tonic_health::server::health_reporter();
    let service = RoundelServer::new(Service { api: api.clone() })
        .max_decoding_message_size(MAX_REQUEST_BYTES);
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(roundel_proto::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()
        // The descriptors are compiled into this binary; a test reads them through this very path.
        .expect("the compiled descriptors are valid");
    let routes = Routes::new(service)
        .add_service(push::service(api))
        .add_service(reflection)
        .add_service(health);
    let subscribing = api.clone();
    let subscribe = service_fn(move |request| snapshots::subscribe(subscribing.clone(), request));
    let router = routes.prepare().into_axum_router().route_service(snapshots::PATH, subscribe);
    (router, reporter)
}

/// Ends a stream with UNAVAILABLE when the server goes down.
fn until_shutdown<T: Send + 'static>(
    messages: impl Stream<Item = Result<T, Status>> + Send + 'static,
    cancel: CancellationToken,
) -> Messages<T> {
    let end = stream::once(async move {
        cancel.cancelled_owned().await;
        None
    });
    // `None` marks the end; nothing after it is sent.
    let marked = stream::select(messages.map(Some), end);
    Box::pin(marked.scan(false, |ended, message| {
        let next = match message {
            _ if *ended => None,
            Some(message) => Some(message),
            None => {
                *ended = true;
                Some(Err(ApiError::Unavailable(SHUTTING_DOWN.into()).into()))
            }
        };
        std::future::ready(next)
    }))
}

#[tonic::async_trait]
impl v1::roundel_server::Roundel for Service {
    type SubscribeSnapshotsStream = Messages<v1::Snapshot>;
    type SubscribeObservationsStream = Messages<v1::FrameObservations>;
    type SubscribeEventsStream = Messages<v1::Event>;

    async fn subscribe_snapshots(
        &self,
        _: Request<v1::SubscribeSnapshotsRequest>,
    ) -> Result<Response<Self::SubscribeSnapshotsStream>, Status> {
        Err(Status::internal(
            "internal error, please report it: `snapshots::subscribe` serves this method",
        ))
    }

    async fn subscribe_observations(
        &self,
        request: Request<v1::SubscribeObservationsRequest>,
    ) -> Result<Response<Self::SubscribeObservationsStream>, Status> {
        let observation_subscription =
            ObservationSubscription::new(&self.api, request.into_inner().cameras)?;
        let messages =
            stream::unfold(observation_subscription, |mut observation_subscription| async move {
                let message = observation_subscription.next().await?.map_err(Status::from);
                Some((message, observation_subscription))
            });
        Ok(Response::new(until_shutdown(messages, self.api.cancel.clone())))
    }

    async fn get_observations(
        &self,
        request: Request<v1::GetObservationsRequest>,
    ) -> Result<Response<v1::GetObservationsResponse>, Status> {
        Ok(Response::new(newest_observations(&self.api, &request.into_inner().cameras)?))
    }

    async fn subscribe_events(
        &self,
        request: Request<v1::SubscribeEventsRequest>,
    ) -> Result<Response<Self::SubscribeEventsStream>, Status> {
        let backlog = checked_backlog(request.into_inner().backlog, "backlog")?;
        let api = self.api.clone();
        let (remembered, receiver) = api.hub.events(backlog);
        let new = stream::unfold(receiver, |mut receiver| async move {
            let event = next_event(&mut receiver).await?;
            Some((event, receiver))
        });
        let messages = stream::iter(remembered).chain(new).map(|event| Ok(convert::event(&event)));
        Ok(Response::new(until_shutdown(messages, self.api.cancel.clone())))
    }

    async fn get_snapshot(
        &self,
        request: Request<v1::GetSnapshotRequest>,
    ) -> Result<Response<v1::Snapshot>, Status> {
        let request = selection::subscribe_request(request.into_inner());
        let kinds = &self.api.hub.installation().kinds;
        let selection = Selection::new(request, kinds, &MESSAGE_FIELDS)?;
        Ok(Response::new(newest_snapshot(&self.api, &selection)?))
    }

    async fn list_cameras(
        &self,
        _: Request<v1::ListCamerasRequest>,
    ) -> Result<Response<v1::ListCamerasResponse>, Status> {
        Ok(Response::new(v1::ListCamerasResponse { cameras: cameras(&self.api) }))
    }

    async fn get_picture(
        &self,
        request: Request<v1::GetPictureRequest>,
    ) -> Result<Response<v1::CameraPicture>, Status> {
        let (jpeg, capture_time) = picture::newest(&self.api, &request.into_inner().camera).await?;
        let capture_time_ns = capture_time.as_ns();
        Ok(Response::new(v1::CameraPicture { jpeg: jpeg.to_vec(), capture_time_ns }))
    }

    async fn list_objects(
        &self,
        _: Request<v1::ListObjectsRequest>,
    ) -> Result<Response<v1::ListObjectsResponse>, Status> {
        Ok(Response::new(v1::ListObjectsResponse { objects: objects(&self.api) }))
    }

    type WatchCalibrationStream = Messages<v1::Calibration>;

    async fn start_calibration(
        &self,
        request: Request<v1::StartCalibrationRequest>,
    ) -> Result<Response<v1::Calibration>, Status> {
        Ok(Response::new(calibration::begin(&self.api, &request.into_inner())?))
    }

    async fn get_calibration(
        &self,
        _: Request<v1::GetCalibrationRequest>,
    ) -> Result<Response<v1::Calibration>, Status> {
        Ok(Response::new(calibration::newest(&self.api)))
    }

    async fn watch_calibration(
        &self,
        _: Request<v1::WatchCalibrationRequest>,
    ) -> Result<Response<Self::WatchCalibrationStream>, Status> {
        let api = self.api.clone();
        let mut status = api.calibrator.status();
        status.mark_changed();
        let messages = stream::unfold((api, status), |(api, mut status)| async move {
            status.changed().await.ok()?;
            let _ = status.borrow_and_update();
            let message = calibration::newest(&api);
            Some((Ok(message), (api, status)))
        });
        Ok(Response::new(until_shutdown(messages, self.api.cancel.clone())))
    }

    async fn cancel_calibration(
        &self,
        _: Request<v1::CancelCalibrationRequest>,
    ) -> Result<Response<v1::Calibration>, Status> {
        self.api.calibrator.cancel().map_err(ApiError::from)?;
        Ok(Response::new(calibration::newest(&self.api)))
    }

    async fn apply_calibration(
        &self,
        _: Request<v1::ApplyCalibrationRequest>,
    ) -> Result<Response<v1::Calibration>, Status> {
        Ok(Response::new(calibration::take_over(&self.api).await?))
    }

    async fn start_recording(
        &self,
        request: Request<v1::StartRecordingRequest>,
    ) -> Result<Response<v1::Recording>, Status> {
        Ok(Response::new(recording::begin(&self.api, request.into_inner()).await?))
    }

    async fn stop_recording(
        &self,
        _: Request<v1::StopRecordingRequest>,
    ) -> Result<Response<v1::Recording>, Status> {
        Ok(Response::new(recording::end(&self.api).await?))
    }

    async fn get_recording(
        &self,
        _: Request<v1::GetRecordingRequest>,
    ) -> Result<Response<v1::Recording>, Status> {
        Ok(Response::new(recording::newest(&self.api)?))
    }

    async fn list_recordings(
        &self,
        _: Request<v1::ListRecordingsRequest>,
    ) -> Result<Response<v1::ListRecordingsResponse>, Status> {
        Ok(Response::new(recording::list(&self.api).await?))
    }

    async fn query_history(
        &self,
        request: Request<v1::QueryHistoryRequest>,
    ) -> Result<Response<v1::QueryHistoryResponse>, Status> {
        Ok(Response::new(history::query(&self.api, request.into_inner()).await?))
    }

    async fn get_replay(
        &self,
        _: Request<v1::GetReplayRequest>,
    ) -> Result<Response<v1::Replay>, Status> {
        Ok(Response::new(replay::newest(&self.api)?))
    }

    async fn control_replay(
        &self,
        request: Request<v1::ControlReplayRequest>,
    ) -> Result<Response<v1::Replay>, Status> {
        Ok(Response::new(replay::apply_control(&self.api, &request.into_inner())?))
    }

    async fn test_source(
        &self,
        request: Request<v1::TestSourceRequest>,
    ) -> Result<Response<v1::SourceTest>, Status> {
        Ok(Response::new(source_probe::probe(&self.api, request.into_inner()).await?))
    }

    async fn get_camera_setup(
        &self,
        request: Request<v1::GetCameraSetupRequest>,
    ) -> Result<Response<v1::CameraSetup>, Status> {
        Ok(Response::new(setup::written(&self.api, request.into_inner().name).await?))
    }

    async fn add_camera(
        &self,
        request: Request<v1::AddCameraRequest>,
    ) -> Result<Response<v1::CameraChange>, Status> {
        let camera = request.into_inner().camera.unwrap_or_default();
        Ok(Response::new(setup::add_camera(&self.api, camera).await?))
    }

    async fn change_camera(
        &self,
        request: Request<v1::ChangeCameraRequest>,
    ) -> Result<Response<v1::CameraChange>, Status> {
        Ok(Response::new(setup::change_camera(&self.api, request.into_inner()).await?))
    }

    async fn remove_camera(
        &self,
        request: Request<v1::RemoveCameraRequest>,
    ) -> Result<Response<v1::CameraChange>, Status> {
        Ok(Response::new(setup::remove_camera(&self.api, request.into_inner().name).await?))
    }

    async fn get_object_setup(
        &self,
        request: Request<v1::GetObjectSetupRequest>,
    ) -> Result<Response<v1::ObjectSetup>, Status> {
        Ok(Response::new(configured::written(&self.api, request.into_inner().name).await?))
    }

    async fn add_object(
        &self,
        request: Request<v1::AddObjectRequest>,
    ) -> Result<Response<v1::ObjectChange>, Status> {
        let object = request.into_inner().object.unwrap_or_default();
        Ok(Response::new(configured::add_object(&self.api, object).await?))
    }

    async fn change_object(
        &self,
        request: Request<v1::ChangeObjectRequest>,
    ) -> Result<Response<v1::ObjectChange>, Status> {
        Ok(Response::new(configured::change_object(&self.api, request.into_inner()).await?))
    }

    async fn remove_object(
        &self,
        request: Request<v1::RemoveObjectRequest>,
    ) -> Result<Response<v1::ObjectChange>, Status> {
        Ok(Response::new(configured::remove_object(&self.api, request.into_inner().name).await?))
    }

    async fn name_object(
        &self,
        request: Request<v1::NameObjectRequest>,
    ) -> Result<Response<v1::ObjectChange>, Status> {
        Ok(Response::new(configured::name_object(&self.api, request.into_inner()).await?))
    }

    async fn get_configuration(
        &self,
        _: Request<v1::GetConfigurationRequest>,
    ) -> Result<Response<v1::Configuration>, Status> {
        Ok(Response::new(configuration::in_force(&self.api).await?))
    }

    async fn check_configuration(
        &self,
        request: Request<v1::CheckConfigurationRequest>,
    ) -> Result<Response<v1::ConfigurationCheck>, Status> {
        Ok(Response::new(configuration::check_text(&self.api, request.into_inner()).await?))
    }

    async fn apply_configuration(
        &self,
        request: Request<v1::ApplyConfigurationRequest>,
    ) -> Result<Response<v1::AppliedConfiguration>, Status> {
        Ok(Response::new(configuration::apply_text(&self.api, request.into_inner()).await?))
    }

    async fn get_time(
        &self,
        request: Request<v1::GetTimeRequest>,
    ) -> Result<Response<v1::ServerTime>, Status> {
        let received_time_ns = self.api.clock.now().as_ns();
        let sent_time_ns = request.into_inner().sent_time_ns;
        let replied_time_ns = self.api.clock.now().as_ns();
        Ok(Response::new(v1::ServerTime { sent_time_ns, received_time_ns, replied_time_ns }))
    }

    async fn drive_robots(
        &self,
        request: Request<v1::DriveRobotsRequest>,
    ) -> Result<Response<v1::DriveRobotsResponse>, Status> {
        Ok(Response::new(simulation::drive_robots(&self.api, &request.into_inner())?))
    }

    async fn push_robot(
        &self,
        request: Request<v1::PushRobotRequest>,
    ) -> Result<Response<v1::PushRobotResponse>, Status> {
        Ok(Response::new(simulation::push_robot(&self.api, &request.into_inner())?))
    }

    async fn get_server_info(
        &self,
        _: Request<v1::GetServerInfoRequest>,
    ) -> Result<Response<v1::ServerInfo>, Status> {
        Ok(Response::new(queries::server_info(&self.api)))
    }
}
