//! A server with two cameras that play images of a roundel, and a small HTTP client.

use std::{fs, path::Path, time::Duration};

use axum::{
    body::Body,
    http::{Method, Request, StatusCode, header},
};
use http_body_util::BodyExt;
use hyper_util::{client::legacy, rt::TokioExecutor};
use roundel_core::camera::{Camera, Intrinsics, Lens};
use roundel_server::{
    app::serve::Server,
    model::{camera_file, config::Config, hub::CameraState},
};
use serde_json::{Value, json};
use tokio::time::{sleep, timeout};

/// Timeout of every wait; only a stalled machine reaches it.
pub const TIMEOUT: Duration = Duration::from_secs(60);

pub const SIZE: (usize, usize) = (160, 120);

pub const CONFIG: &str = r#"# The lab's own words.
name = "lab"

[server]
listen = "127.0.0.1:0" # any

[[roundel]]
name = "robot"
outer_mm = 160.0
inner_mm = 64.0

# ---- Cameras ----

# By the door.
[[camera]]
name = "a"  # as on its label
source = "images:a/*.pgm?fps=25&loop=true"
calibration = "camera.yaml"
pose = { position_m = [0.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }

[[camera]]
name = "b"
source = "images:b/*.pgm?fps=25&loop=true"
calibration = "camera.yaml"
pose = { position_m = [5.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }

# ---- The end ----
"#;

pub struct Rig {
    pub server: Server,
    pub folder: tempfile::TempDir,
}

/// A pinhole camera of [`SIZE`].
pub fn lens(focal_px: f64) -> Camera {
    let (width, height) = SIZE;
    let camera = Camera::new(Intrinsics {
        width,
        height,
        fx_px: focal_px,
        fy_px: focal_px,
        cx_px: 79.5,
        cy_px: 59.5,
        lens: Lens::PlumbBob([0.0; 5]),
    });
    camera.unwrap()
}

/// A white image with a black ring of 20 px around a white disc, off the centre by `offset_px`.
fn picture(offset_px: f64) -> Vec<u8> {
    let (width, height) = SIZE;
    let level = |u: usize, v: usize| {
        let radius = (u as f64 - 79.5 - offset_px).hypot(v as f64 - 59.5);
        let ink = (20.5 - radius).clamp(0.0, 1.0) - (8.5 - radius).clamp(0.0, 1.0);
        (220.0 - 190.0 * ink).round() as u8
    };
    let pixels = (0..height).flat_map(|v| (0..width).map(move |u| level(u, v)));
    format!("P5 {width} {height} 255\n").into_bytes().into_iter().chain(pixels).collect()
}

pub fn write_lens(folder: &Path, name: &str, focal_px: f64) {
    fs::write(folder.join(name), camera_file::write(name, &lens(focal_px))).unwrap();
}

/// A folder with a configuration, a camera file and images.
pub fn lab(config: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_lens(folder.path(), "camera.yaml", 300.0);
    fs::write(folder.path().join("lab.toml"), config).unwrap();
    for camera in ["a", "b", "c"] {
        fs::create_dir(folder.path().join(camera)).unwrap();
        for frame in 0..3 {
            let path = folder.path().join(camera).join(format!("{frame}.pgm"));
            fs::write(path, picture(f64::from(frame) * 0.1)).unwrap();
        }
    }
    folder
}

impl Rig {
    pub async fn start() -> Self {
        Self::start_with(CONFIG).await
    }

    pub async fn start_with(config: &str) -> Self {
        let folder = lab(config);
        let config = Config::load(&folder.path().join("lab.toml")).unwrap();
        Self { server: Server::start(config).await.unwrap(), folder }
    }

    /// The current content of the configuration file.
    pub fn file(&self) -> String {
        fs::read_to_string(self.folder.path().join("lab.toml")).unwrap()
    }

    pub fn url(&self) -> String {
        format!("http://{}", self.server.local_addr())
    }

    pub fn camera(&self, name: &str) -> Option<CameraState> {
        let hub = self.server.hub();
        hub.installation().camera_id(name).and_then(|id| hub.camera(id))
    }

    /// Waits until `is_reached` accepts the camera.
    pub async fn until(
        &self,
        what: &str,
        name: &str,
        is_reached: impl Fn(&CameraState) -> bool,
    ) -> CameraState {
        wait_for(what, || self.camera(name).filter(&is_reached), || self.camera(name)).await
    }

    /// Waits until a camera has delivered more than five further frames.
    pub async fn running(&self, name: &str) -> CameraState {
        let before = self.camera(name).map_or(0, |state| state.frames);
        self.until("frames", name, |state| state.frames > before + 5 && state.error.is_empty())
            .await
    }

    /// Sends a request and returns the status and the JSON of the response.
    pub async fn send(
        &self,
        method: Method,
        path: &str,
        body: Option<Value>,
    ) -> (StatusCode, Value) {
        let client = legacy::Client::builder(TokioExecutor::new()).build_http();
        let request = Request::builder().method(method).uri(format!("{}/api/v1{path}", self.url()));
        let request = request.header(header::CONTENT_TYPE, "application/json");
        let body = body.map_or_else(Body::empty, |body| Body::from(body.to_string()));
        let response = timeout(TIMEOUT, client.request(request.body(body).unwrap())).await;
        let (head, body) = response.unwrap().unwrap().into_parts();
        let body = body.collect().await.unwrap().to_bytes();
        (head.status, serde_json::from_slice(&body).unwrap_or(Value::Null))
    }

    /// The response to a request that must succeed.
    pub async fn accepted(&self, method: Method, path: &str, body: Option<Value>) -> Value {
        let (status, answer) = self.send(method, path, body).await;
        assert_eq!(status, StatusCode::OK, "{answer}");
        answer
    }

    /// Status and error message of a request that must fail.
    pub async fn rejected(&self, method: Method, path: &str, body: Option<Value>) -> (u16, String) {
        let (status, answer) = self.send(method, path, body).await;
        assert!(!status.is_success(), "{answer}");
        (status.as_u16(), answer["error"]["message"].as_str().unwrap().to_owned())
    }

    /// Messages of the events after this sequence number.
    pub fn events_since(&self, sequence: u64) -> Vec<String> {
        let (events, _) = self.server.hub().events(1000);
        let new = events.iter().filter(|event| event.sequence > sequence);
        new.map(|event| event.message.clone()).collect()
    }

    pub fn newest_event(&self) -> u64 {
        self.server.hub().events(1).0.last().map_or(0, |event| event.sequence)
    }
}

/// The request that adds a third camera.
pub fn third_camera() -> Value {
    json!({
        "name": "c",
        "source": "images:c/*.pgm?fps=25&loop=true",
        "calibration": "camera.yaml",
        "pose": { "pose": {
            "position": { "x": -5.0, "y": 0.0, "z": 3.0 },
            "orientation": { "x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0 },
        } },
    })
}

/// The text that [`third_camera`] adds to the configuration file.
pub const THIRD_CAMERA_TOML: &str = r#"
[[camera]]
name = "c"
source = "images:c/*.pgm?fps=25&loop=true"
calibration = "camera.yaml"
pose = { position_m = [-5.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
"#;

/// Polls `look` until it returns a value; `state` describes the system if that takes too long.
pub async fn wait_for<T, S: std::fmt::Debug>(
    what: &str,
    mut look: impl FnMut() -> Option<T>,
    state: impl Fn() -> S,
) -> T {
    let wait = async {
        loop {
            if let Some(found) = look() {
                return found;
            }
            sleep(Duration::from_millis(5)).await;
        }
    };
    match timeout(TIMEOUT, wait).await {
        Ok(found) => found,
        Err(_) => panic!("{what} did not happen: {:#?}", state()),
    }
}
