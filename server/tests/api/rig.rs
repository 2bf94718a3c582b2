//! A server with a hub that the test feeds, and a small HTTP client.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use axum::{
    body::Body,
    http::{HeaderMap, Request, StatusCode},
};
use http_body_util::BodyExt;
use hyper_util::{client::legacy, rt::TokioExecutor};
use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    camera::PixelPoint,
    id::{CameraId, KindId, ObjectId},
    marker::{Code, Kind},
    rigid::Covariance6,
    world::{LifeStage, ObjectState, ProcessNoise, Snapshot},
};
use roundel_server::{
    api::{self, AllowedOrigins, ApiLimits, ApiState, access::AccessControl},
    model::{
        access::AccessConfig,
        clock::Clock,
        hub::{CameraInfo, CameraStatus, Hub, Installation},
    },
};
use serde_json::Value;
use tokio::{net::TcpListener, task::JoinHandle};
use tokio_util::sync::CancellationToken;

/// Timeout of every wait; nothing here takes a tenth of it.
pub const TIMEOUT: Duration = Duration::from_secs(30);

pub const ORIGIN: &str = "https://lab.example.org";

pub struct Rig {
    pub hub: Arc<Hub>,
    pub clock: Clock,
    pub address: String,
    pub cancel: CancellationToken,
    server: JoinHandle<()>,
}

pub fn hub(source_id: &str) -> Arc<Hub> {
    // The upper left corner of every camera is masked.
    let corners = [(4.0, 4.0), (14.0, 4.0), (4.0, 14.0)].map(|(u, v)| PixelPoint { u, v });
    let camera = |name: &str| CameraInfo {
        name: name.into(),
        source: format!("sim:?of={name}"),
        mask: vec![corners.to_vec()],
        ride: None,
        lens_uncertainty: None,
    };
    Arc::new(Hub::new(Installation {
        name: "lab".into(),
        source_id: source_id.into(),
        started: Clock::anchored_now().now(),
        snapshot_rate_hz: 60.0,
        cameras: Installation::number_cameras([camera("north"), camera("south side")]),
        kinds: vec!["robot".into(), "cart".into()],
        object_names: BTreeMap::from([(KindId(1), "cart \"one\"".into())]),
        body_names: vec!["carrier".into()],
    }))
}

impl Rig {
    pub async fn start() -> Self {
        Self::start_with(hub("run"), ApiLimits::default(), "127.0.0.1:0").await
    }

    pub async fn start_with(hub: Arc<Hub>, limits: ApiLimits, listen: &str) -> Self {
        let origins = AllowedOrigins(vec![ORIGIN.into()]);
        Self::start_server(hub, limits, listen, (&AccessConfig::default(), origins)).await
    }

    /// Starts a server that allows only its own pages.
    pub async fn start_with_own_origin() -> Self {
        let rules = (&AccessConfig::default(), AllowedOrigins::default());
        Self::start_server(hub("run"), ApiLimits::default(), "127.0.0.1:0", rules).await
    }

    pub async fn start_with_access(access: &AccessConfig) -> Self {
        let rules = (access, AllowedOrigins(vec![ORIGIN.into()]));
        Self::start_server(hub("run"), ApiLimits::default(), "127.0.0.1:0", rules).await
    }

    async fn start_server(
        hub: Arc<Hub>,
        limits: ApiLimits,
        listen: &str,
        (access, origins): (&AccessConfig, AllowedOrigins),
    ) -> Self {
        let listener = TcpListener::bind(listen).await.unwrap();
        let address = listener.local_addr().unwrap();
        let access = Arc::new(AccessControl::new(access, origins, address, true));
        let (clock, cancel) = (Clock::anchored_now(), CancellationToken::new());
        let state = ApiState {
            kinds: vec![Kind::plain("robot", 0.16, 0.064), Kind::plain("cart", 0.16, 0.08)],
            access,
            limits,
            cancel: cancel.clone(),
            ..ApiState::new(hub.clone(), clock)
        };
        let server = tokio::spawn(api::serve(listener, state));
        Self { hub, clock, address: address.to_string(), cancel, server }
    }

    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Shuts down and waits until the server has ended.
    pub async fn stop(self) {
        self.cancel.cancel();
        tokio::time::timeout(TIMEOUT, self.server)
            .await
            .expect("the server does not shut down")
            .unwrap();
    }

    /// Publishes these objects as a snapshot with the current time.
    pub fn publish(&self, objects: Vec<ObjectState>) {
        let now = self.clock.now();
        let snapshot = Snapshot { pose_time: now, capture_time: Some(now.plus_ns(-7)), objects };
        self.hub.publish_snapshot(snapshot, now);
    }

    pub fn set_camera_status(&self, status: CameraStatus) {
        self.hub.update_camera(CameraId(0), |camera| camera.status = status);
    }

    pub async fn get(&self, path: &str) -> Answer {
        self.request(Request::get(format!("{}{path}", self.url())).body(Body::empty()).unwrap())
            .await
    }

    pub async fn request(&self, request: Request<Body>) -> Answer {
        let client = legacy::Client::builder(TokioExecutor::new()).build_http();
        let response =
            tokio::time::timeout(TIMEOUT, client.request(request)).await.unwrap().unwrap();
        let (head, body) = response.into_parts();
        let body = body.collect().await.unwrap().to_bytes().to_vec();
        Answer { status: head.status, headers: head.headers, body }
    }
}

pub struct Answer {
    pub status: StatusCode,
    pub headers: HeaderMap,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn text(&self) -> &str {
        std::str::from_utf8(&self.body).unwrap()
    }

    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }

    pub fn json(&self) -> Value {
        assert_eq!(self.header("content-type"), "application/json", "{}", self.text());
        serde_json::from_slice(&self.body).unwrap()
    }

    /// The error's code and message.
    pub fn error(&self) -> (String, String) {
        let body = self.json();
        let text = |key: &str| body["error"][key].as_str().unwrap().to_owned();
        (text("code"), text("message"))
    }
}

/// An object at (id, -id, 0.5 id) metres, moving with (1, 2, 0) m/s. Even IDs are carts that are currently not
/// observed, with the ID as code.
pub fn object(id: u64) -> ObjectState {
    let place = id as f64;
    let time = Clock::anchored_now().now();
    let mut covariance = Covariance6::identity() * 1e-4;
    covariance[(0, 1)] = 1e-5;
    covariance[(1, 0)] = 1e-5;
    ObjectState {
        id: ObjectId(id),
        kind: Some(KindId(if id.is_multiple_of(2) { 1 } else { 0 })),
        body: None,
        code: id.is_multiple_of(2).then_some(Code { bits: 8, number: id as u16 }),
        stage: if id.is_multiple_of(2) { LifeStage::Predicted } else { LifeStage::Tracked },
        position_m: Vector3::new(place, -place, 0.5 * place),
        orientation: UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3 * place),
        yaw_observed: false,
        yaw_symmetry: 1,
        velocity_m_s: Vector3::new(1.0, 2.0, 0.0),
        acceleration_m_s2: Vector3::zeros(),
        angular_velocity_rad_s: Vector3::zeros(),
        covariance,
        motion_covariance: covariance,
        rotation_covariance: Covariance6::identity() * 1e-4,
        process_noise: ProcessNoise {
            acceleration_density_m2_s3: Vector3::repeat(1.0),
            angular_density_rad2_s3: Vector3::repeat(1.0),
        },
        cameras: vec![CameraId(0), CameraId(1)],
        trust: 1,
        newest_observation: time,
        residual: 0.75,
        first_observation: time.plus_seconds(-3.0),
        observations: 180,
    }
}

pub fn objects(count: u64) -> Vec<ObjectState> {
    (1..=count).map(object).collect()
}
