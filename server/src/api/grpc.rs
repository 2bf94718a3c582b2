//! The service of `proto/roundel/v1/roundel.proto`, with reflection (v1) and health.
//!
//! Health has two names: the empty one is serving while the process is alive, the service's own
//! while `/readyz` reports readiness.

mod snapshots;

use std::{future::ready, pin::Pin, sync::Arc};

use axum::{Json, Router, extract::State};
use futures::{Stream, StreamExt, stream};
use roundel_proto::v1::{self, roundel_server::RoundelServer};
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status, service::Routes};
use tonic_health::server::HealthReporter;
use tower::service_fn;

use super::{
    ApiState, MAX_REQUEST_BYTES, calibration, configuration,
    error::{ApiError, SHUTTING_DOWN},
    handler::{Answer, Api, Body, Changes, Segment},
    history,
    listener::stream_permit,
    objects,
    observation_subscription::ObservationSubscription,
    picture, push, queries, recording, replay, rest,
    selection::{MESSAGE_FIELDS, Selection},
    setup, simulation, source_probe,
};

type Messages<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

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
        // A test reads the descriptors compiled into this binary.
        .expect("the compiled descriptors are valid");
    let routes = Routes::new(service).add_service(reflection).add_service(health);
    let (subscribing, pushing) = (api.clone(), api.clone());
    let subscribe = service_fn(move |request| snapshots::subscribe(subscribing.clone(), request));
    let push = service_fn(move |request| push::send(pushing.clone(), request));
    let router = routes.prepare().into_axum_router();
    let router = router.route_service(snapshots::PATH, subscribe).route_service(push::PATH, push);
    (router, reporter)
}

/// Ends a stream with UNAVAILABLE on shutdown.
fn until_shutdown<T: Send + 'static>(
    messages: impl Stream<Item = Result<T, Status>> + Send + 'static,
    cancel: CancellationToken,
) -> Messages<T> {
    let end = ready(Err(ApiError::Unavailable(SHUTTING_DOWN.into()).into()));
    Box::pin(messages.take_until(cancel.cancelled_owned()).chain(stream::once(end)))
}

/// Implements the service. A stream calls the function of its name below; a method calls a handler,
/// mostly that of REST.
macro_rules! implement_roundel {
    (
        streams {
            $($stream:ident: $subscribe:ident($subscription:ident) -> $item:ident;)*
        }
        methods {
            $($method:ident($request:ident) -> $answer:ident
                = |$api:pat_param, $message:pat_param| $call:expr;)*
        }
    ) => {
        #[tonic::async_trait]
        impl v1::roundel_server::Roundel for Service {
            $(
                type $stream = Messages<v1::$item>;

                async fn $subscribe(
                    &self,
                    request: Request<v1::$subscription>,
                ) -> Result<Response<Messages<v1::$item>>, Status> {
                    Ok(Response::new($subscribe(&self.api, request)?))
                }
            )*
            $(
                async fn $method(
                    &self,
                    request: Request<v1::$request>,
                ) -> Result<Response<v1::$answer>, Status> {
                    let ($api, $message) = (State(self.api.clone()), request.into_inner());
                    let Json(answer) = $call.await?;
                    Ok(Response::new(answer))
                }
            )*
        }
    };
}

implement_roundel! {
    streams {
        SubscribeSnapshotsStream: subscribe_snapshots(SubscribeSnapshotsRequest) -> Snapshot;
        SubscribeObservationsStream:
            subscribe_observations(SubscribeObservationsRequest) -> FrameObservations;
        SubscribeEventsStream: subscribe_events(SubscribeEventsRequest) -> Event;
        WatchCalibrationStream: watch_calibration(WatchCalibrationRequest) -> Calibration;
    }
    methods {
        get_snapshot(GetSnapshotRequest) -> Snapshot = |api, request| get_snapshot(api, request);
        get_observations(GetObservationsRequest) -> GetObservationsResponse
            = |api, request| get_observations(api, request);
        list_cameras(ListCamerasRequest) -> ListCamerasResponse = |api, _| rest::cameras(api);
        get_picture(GetPictureRequest) -> CameraPicture = |api, request| get_picture(api, request);
        list_objects(ListObjectsRequest) -> ListObjectsResponse = |api, _| rest::objects(api);
        list_print_sizes(ListPrintSizesRequest) -> ListPrintSizesResponse
            = |api, _| rest::print_sizes(api);
        get_time(GetTimeRequest) -> ServerTime = |api, request| get_time(api, request);
        get_server_info(GetServerInfoRequest) -> ServerInfo = |api, _| rest::info(api);

        start_calibration(StartCalibrationRequest) -> Calibration
            = |api, request| calibration::start(api, Body(request));
        get_calibration(GetCalibrationRequest) -> Calibration = |api, _| calibration::show(api);
        cancel_calibration(CancelCalibrationRequest) -> Calibration
            = |api, _| calibration::cancel(api);
        apply_calibration(ApplyCalibrationRequest) -> Calibration
            = |api, _| calibration::apply(api);

        start_recording(StartRecordingRequest) -> Recording
            = |api, request| recording::start(api, Body(request));
        stop_recording(StopRecordingRequest) -> Recording = |api, _| recording::stop(api);
        get_recording(GetRecordingRequest) -> Recording = |api, _| recording::show(api);
        list_recordings(ListRecordingsRequest) -> ListRecordingsResponse
            = |api, _| recording::files(api);
        get_replay(GetReplayRequest) -> Replay = |api, _| replay::show(api);
        control_replay(ControlReplayRequest) -> Replay
            = |api, request| replay::control(api, Body(request));
        query_history(QueryHistoryRequest) -> QueryHistoryResponse
            = |api, request| history::query(api, request);

        test_source(TestSourceRequest) -> SourceTest
            = |api, request| source_probe::test(api, Body(request));
        get_camera_setup(GetCameraSetupRequest) -> CameraSetup
            = |api, request| setup::show(api, Segment(request.name));
        add_camera(AddCameraRequest) -> CameraChange
            = |api, request| setup::add(api, Body(request.camera.unwrap_or_default()));
        change_camera(ChangeCameraRequest) -> CameraChange = |api, request| setup::change(
            api, Segment(request.name), changes(request.camera, request.fields)
        );
        remove_camera(RemoveCameraRequest) -> CameraChange
            = |api, request| setup::remove(api, Segment(request.name));
        get_object_setup(GetObjectSetupRequest) -> ObjectSetup
            = |api, request| objects::show(api, Segment(request.name));
        add_object(AddObjectRequest) -> ObjectChange
            = |api, request| objects::add(api, Body(request.object.unwrap_or_default()));
        change_object(ChangeObjectRequest) -> ObjectChange = |api, request| objects::change(
            api, Segment(request.name), changes(request.object, request.fields)
        );
        remove_object(RemoveObjectRequest) -> ObjectChange
            = |api, request| objects::remove(api, Segment(request.name));
        name_object(NameObjectRequest) -> ObjectChange = |api, request| objects::name(
            api, Segment(request.object_id.to_string()), Body(objects::Name { name: request.name })
        );

        get_configuration(GetConfigurationRequest) -> Configuration
            = |api, _| configuration::show(api);
        check_configuration(CheckConfigurationRequest) -> ConfigurationCheck
            = |api, request| configuration::check_text(api, request);
        apply_configuration(ApplyConfigurationRequest) -> AppliedConfiguration
            = |api, request| configuration::apply_text(api, request);

        drive_robots(DriveRobotsRequest) -> DriveRobotsResponse
            = |api, request| simulation::drive(api, Body(request));
        push_robot(PushRobotRequest) -> PushRobotResponse
            = |api, request| simulation::push(api, Body(request));
    }
}

fn subscribe_snapshots(
    _: &Arc<ApiState>,
    _: Request<v1::SubscribeSnapshotsRequest>,
) -> Result<Messages<v1::Snapshot>, Status> {
    Err(Status::internal(
        "internal error, please report it: `snapshots::subscribe` serves this method",
    ))
}

fn subscribe_observations(
    api: &Arc<ApiState>,
    request: Request<v1::SubscribeObservationsRequest>,
) -> Result<Messages<v1::FrameObservations>, Status> {
    let permit = stream_permit(request.extensions())?;
    let subscription = ObservationSubscription::new(api, request.into_inner().cameras)?;
    let messages =
        stream::unfold((subscription, permit), |(mut subscription, permit)| async move {
            let message = subscription.next().await?.map_err(Status::from);
            Some((message, (subscription, permit)))
        });
    Ok(until_shutdown(messages, api.cancel.clone()))
}

fn subscribe_events(
    api: &Arc<ApiState>,
    request: Request<v1::SubscribeEventsRequest>,
) -> Result<Messages<v1::Event>, Status> {
    let permit = stream_permit(request.extensions())?;
    let backlog = queries::checked_backlog(request.into_inner().backlog)?;
    let (remembered, receiver) = api.hub.events(backlog);
    let new = stream::unfold((receiver, permit), |(mut receiver, permit)| async move {
        let event = queries::next_event(&mut receiver).await?;
        Some((event, (receiver, permit)))
    });
    let messages = stream::iter(remembered).chain(new).map(|event| Ok(Arc::unwrap_or_clone(event)));
    Ok(until_shutdown(messages, api.cancel.clone()))
}

fn watch_calibration(
    api: &Arc<ApiState>,
    request: Request<v1::WatchCalibrationRequest>,
) -> Result<Messages<v1::Calibration>, Status> {
    let permit = stream_permit(request.extensions())?;
    let mut status = api.calibrator.status();
    status.mark_changed();
    let start = (api.clone(), status, permit);
    let messages = stream::unfold(start, |(api, mut status, permit)| async move {
        status.changed().await.ok()?;
        let message = calibration::newest(&api);
        Some((Ok(message), (api, status, permit)))
    });
    Ok(until_shutdown(messages, api.cancel.clone()))
}

fn changes<T: Default>(values: Option<T>, fields: Vec<String>) -> Changes<T> {
    Changes { values: values.unwrap_or_default(), fields }
}

async fn get_observations(
    State(api): Api,
    request: v1::GetObservationsRequest,
) -> Answer<v1::GetObservationsResponse> {
    queries::newest_observations(&api, &request.cameras).map(Json)
}

async fn get_snapshot(State(api): Api, request: v1::GetSnapshotRequest) -> Answer<v1::Snapshot> {
    let request = v1::SubscribeSnapshotsRequest {
        object_ids: request.object_ids,
        region: request.region,
        horizon_ms: request.horizon_ms,
        omit_covariance: request.omit_covariance,
        roundels: request.roundels,
        names: request.names,
        codes: request.codes,
        max_rate_hz: None,
    };
    let selection = Selection::new(request, &api.hub.installation().kinds, &MESSAGE_FIELDS)?;
    queries::newest_snapshot(&api, &selection).map(Json)
}

async fn get_picture(State(api): Api, request: v1::GetPictureRequest) -> Answer<v1::CameraPicture> {
    let (jpeg, capture_time) = picture::newest(&api, &request.camera).await?;
    Ok(Json(v1::CameraPicture { jpeg: jpeg.to_vec(), capture_time_ns: capture_time.as_ns() }))
}

async fn get_time(State(api): Api, request: v1::GetTimeRequest) -> Answer<v1::ServerTime> {
    let received_time_ns = api.clock.now().as_ns();
    let sent_time_ns = request.sent_time_ns;
    let replied_time_ns = api.clock.now().as_ns();
    Ok(Json(v1::ServerTime { sent_time_ns, received_time_ns, replied_time_ns }))
}
