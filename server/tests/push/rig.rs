//! A server with `push:` cameras, nodes with drawn frames, and a helper that waits for conditions.

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use roundel_client::Client;
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    frame::Frame,
    id::CameraId,
};
use roundel_server::{
    app::serve::{
        Server,
        node::{Node, NodeReport},
    },
    capture::source::{FrameInfo, FrameSource, LentFrame, OpenSource, SourceError},
    model::{camera_file, clock::Clock, config::Config, hub::CameraState, stop::StopSignal},
};
use tokio::time::{sleep, timeout};

/// Timeout of every wait; only a stalled machine reaches it.
pub const TIMEOUT: Duration = Duration::from_secs(60);
pub const SIZE: (usize, usize) = (320, 240);
pub const CAMERAS: [&str; 2] = ["north", "south"];

fn lens() -> Camera {
    Camera::new(Intrinsics {
        width: SIZE.0,
        height: SIZE.1,
        fx_px: 300.0,
        fy_px: 300.0,
        cx_px: 159.5,
        cy_px: 119.5,
        lens: Lens::PlumbBob([0.0; 5]),
    })
    .unwrap()
}

/// A white image with a black ring of 20 px around a white disc of 8 px.
pub fn picture() -> Vec<u8> {
    let level = |u: f64, v: f64| {
        let radius = (u - 160.0).hypot(v - 120.0);
        let ink = (20.5 - radius).clamp(0.0, 1.0) - (8.5 - radius).clamp(0.0, 1.0);
        (220.0 - 190.0 * ink).round() as u8
    };
    let pixels = (0..SIZE.1).flat_map(|v| (0..SIZE.0).map(move |u| (u, v)));
    pixels.map(|(u, v)| level(u as f64, v as f64)).collect()
}

/// A configuration of these cameras, 3 m above the floor, each looking down at another place.
pub fn config(names: &[&str], source: &str, listen: &str, folder: &Path) -> Config {
    std::fs::write(folder.join("camera.yaml"), camera_file::write("a", &lens())).unwrap();
    let mut text = format!(
        "[server]\nlisten = \"{listen}\"\n[[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n"
    );
    for (x_m, name) in names.iter().enumerate() {
        text.push_str(&format!(
            "[[camera]]\nname = \"{name}\"\nsource = \"{source}\"\ncalibration = \"camera.yaml\"\n\
             pose = {{ position_m = [{x_m}.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }}\n"
        ));
    }
    Config::parse(&text, folder).map_err(|problems| format!("{problems:#?}")).unwrap()
}

pub struct Rig {
    pub server: Server,
    _folder: tempfile::TempDir,
}

impl Rig {
    pub async fn start() -> Self {
        Self::start_at("127.0.0.1:0").await
    }

    pub async fn start_at(listen: &str) -> Self {
        Self::start_with_rate(listen, None).await
    }

    /// Starts a server whose cameras have the configured rate `rate_hz`.
    pub async fn start_with_rate(listen: &str, rate_hz: Option<f64>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut config = config(&CAMERAS, "push:", listen, folder.path());
        config.cameras.iter_mut().for_each(|camera| camera.rate_hz = rate_hz);
        let server = Server::start(config).await.unwrap();
        Self { server, _folder: folder }
    }

    pub fn url(&self) -> String {
        format!("http://{}", self.server.local_addr())
    }

    pub fn camera(&self, index: u32) -> CameraState {
        self.server.hub().camera(CameraId(index)).unwrap()
    }

    /// Waits until `is_reached` accepts the camera.
    pub async fn until(
        &self,
        what: &str,
        index: u32,
        is_reached: impl Fn(&CameraState) -> bool,
    ) -> CameraState {
        wait_for(
            what,
            || Some(self.camera(index)).filter(|it| is_reached(it)),
            || self.camera(index),
        )
        .await
    }
}

/// Polls `look` until it returns a value; `state` describes the system if that takes too long.
pub async fn wait_for<T, S: std::fmt::Debug>(
    what: &str,
    mut look: impl FnMut() -> Option<T>,
    state: impl Fn() -> S,
) -> T {
    let looking = async {
        loop {
            if let Some(found) = look() {
                return found;
            }
            sleep(Duration::from_millis(5)).await;
        }
    };
    match timeout(TIMEOUT, looking).await {
        Ok(found) => found,
        Err(_) => panic!("{what} did not happen: {:#?}", state()),
    }
}

/// Turns the camera of a node on and off.
#[derive(Clone, Default)]
pub struct Switch(Arc<AtomicBool>);

impl Switch {
    pub fn set(&self, on: bool) {
        self.0.store(on, Ordering::Release);
    }

    fn is_on(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

struct DrawnSource {
    pixels: Arc<Vec<u8>>,
    clock: Clock,
    interval: Duration,
    switch: Switch,
    stop: StopSignal,
}

impl OpenSource for DrawnSource {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
        if !self.switch.is_on() {
            return Err(SourceError::Failed("unplugged: plug it in".to_owned()));
        }
        let Self { pixels, clock, interval, switch, stop } = self;
        let (pixels, switch, stop) = (pixels.clone(), switch.clone(), stop.clone());
        Ok(Box::new(DrawnSource { pixels, clock: *clock, interval: *interval, switch, stop }))
    }

    fn pause(&mut self, _: Duration, stop: &StopSignal) -> bool {
        stop.wait(Duration::from_millis(20))
    }
}

impl FrameSource for DrawnSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        if self.stop.wait(self.interval) {
            return Err(SourceError::Stopped);
        }
        if !self.switch.is_on() {
            return Err(SourceError::Failed("unplugged: plug it in".to_owned()));
        }
        let frame = Frame::new(&self.pixels, SIZE.0, SIZE.1, SIZE.0).unwrap();
        Ok(LentFrame { frame, info: FrameInfo::at(self.clock.now()) })
    }
}

/// A node whose only camera repeats one frame while it is on; it is off at first.
pub struct TestNode {
    pub node: Node,
    pub switch: Switch,
}

impl TestNode {
    pub fn start(camera: &str, server: &str, interval: Duration) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let config = config(&[camera], "sim:", "127.0.0.1:0", folder.path());
        let client = Client::connect_lazily(server).unwrap();
        let switch = Switch::default();
        let pixels = Arc::new(picture());
        let node = Node::start_with_sources(&config, &client, |setting| {
            let (pixels, switch, stop) = (pixels.clone(), switch.clone(), setting.stop);
            Box::new(DrawnSource { pixels, clock: setting.clock, interval, switch, stop })
        });
        Self { node: node.unwrap(), switch }
    }

    pub fn report(&self) -> NodeReport {
        self.node.reports().remove(0)
    }

    /// Waits until the node is connected.
    pub async fn connected(&self) {
        let look = || Some(()).filter(|()| self.report().pushed.connected);
        wait_for("a connection", look, || self.report()).await;
    }
}
