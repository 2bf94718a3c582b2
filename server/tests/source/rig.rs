//! A server with one camera.

use std::{path::Path, time::Duration};

use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    id::CameraId,
};
use roundel_server::{
    app::serve::Server,
    model::{
        camera_file,
        config::Config,
        hub::{CameraState, CameraStatus, EventKind},
    },
};
use tokio::time::{sleep, timeout};

/// Timeout of every wait; only a stalled machine reaches it.
pub const TIMEOUT: Duration = Duration::from_secs(60);
/// Image size in the camera file.
pub const SIZE: (u16, u16) = (64, 48);

pub struct Rig {
    pub server: Server,
    _folder: tempfile::TempDir,
}

/// A configuration with one camera of this source.
pub fn config(source: &str, folder: &Path) -> Config {
    let camera = Camera::new(Intrinsics {
        width: SIZE.0.into(),
        height: SIZE.1.into(),
        fx_px: 60.0,
        fy_px: 60.0,
        cx_px: 31.5,
        cy_px: 23.5,
        lens: Lens::PlumbBob([0.0; 5]),
    });
    std::fs::write(folder.join("camera.yaml"), camera_file::write("a", &camera.unwrap())).unwrap();
    let text = format!(
        "[server]\nlisten = \"127.0.0.1:0\"\n\
         [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n\
         [[camera]]\nname = \"north\"\nsource = \"{source}\"\ncalibration = \"camera.yaml\"\n\
         pose = {{ position_m = [0.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }}\n"
    );
    Config::parse(&text, folder).map_err(|problems| format!("{problems:#?}")).unwrap()
}

impl Rig {
    pub async fn start(source: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let server = Server::start(config(source, folder.path())).await.unwrap();
        Self { server, _folder: folder }
    }

    /// Waits until `is_reached` accepts the camera.
    pub async fn until(
        &self,
        what: &str,
        is_reached: impl Fn(&CameraState) -> bool,
    ) -> CameraState {
        let look = async {
            loop {
                let state = self.server.hub().camera(CameraId(0)).unwrap();
                if is_reached(&state) {
                    return state;
                }
                sleep(Duration::from_millis(5)).await;
            }
        };
        match timeout(TIMEOUT, look).await {
            Ok(state) => state,
            Err(_) => panic!("{what} did not happen: {:#?}", self.server.hub().cameras()),
        }
    }

    /// Waits until the camera has failed, and returns its error.
    pub async fn failure(&self) -> String {
        self.until("a failure", |state| state.status == CameraStatus::Failed).await.error
    }

    /// Messages of the events of this kind.
    pub fn events(&self, kind: EventKind) -> Vec<String> {
        let (events, _) = self.server.hub().events(100);
        let about = events.into_iter().filter(|event| event.kind() == kind);
        about.map(|event| event.message.clone()).collect()
    }
}

pub fn running(state: &CameraState) -> bool {
    state.status == CameraStatus::Running
}
