//! Calibration of an arena while it is served: started over the network, applied to the cameras, saved, and loaded at
//! the next start. Frames are empty; observations come from the simulated sensors.

use std::{fs, path::Path, sync::Arc, time::Duration};

use anyhow::{Context, ensure};
use futures::StreamExt;
use nalgebra::Vector3;
use roundel_client::{
    Client, Error,
    v1::{self, CalibrationApply, CalibrationStage, PoseStatus, StartCalibrationRequest},
};
use roundel_core::frame::Frame;
use roundel_server::{
    app::serve::{Server, SourceContext},
    capture::source::{FrameInfo, FrameSource, LentFrame, OpenSource, SourceError},
    model::config::Config,
};
use roundel_tests::{
    arena::Arena, export::Export, sensor::Sensing, sensor::Stream, survey::Survey,
};

/// Noise of precise detections.
const SENSING: Sensing = Sensing { noise_px: 0.03, ..Sensing::DEFAULT };
/// Seconds of driving. The recording itself has the minimum duration.
const DRIVEN_S: f64 = 25.0;
const RECORDED_S: f64 = 2.0;
/// Frames that the hub keeps until they are processed.
const AT_ONCE: usize = 60;
const HANG: Duration = Duration::from_secs(120);

/// A source of black frames, twenty a second.
struct Black(CameraPace, Vec<u8>);

#[derive(Clone)]
struct CameraPace {
    size: (usize, usize),
    clock: roundel_server::model::clock::Clock,
    stop: roundel_server::model::stop::StopSignal,
}

impl OpenSource for Black {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
        Ok(Box::new(Black(self.0.clone(), self.1.clone())))
    }
}

impl FrameSource for Black {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        if self.0.stop.wait(Duration::from_millis(50)) {
            return Err(SourceError::Stopped);
        }
        let (width, height) = self.0.size;
        let frame = Frame::new(&self.1, width, height, width).unwrap();
        Ok(LentFrame { frame, info: FrameInfo::at(self.0.clock.now()) })
    }
}

async fn serve(config: &Path) -> anyhow::Result<(Server, Client)> {
    let mut config = Config::load(config)?;
    config.server.listen = "127.0.0.1:0".parse()?;
    let server = Server::start_with_sources(config, |setting: SourceContext<'_>| {
        let SourceContext { camera, clock, stop, .. } = setting;
        let size = (camera.calibration.width(), camera.calibration.height());
        Box::new(Black(CameraPace { size, clock, stop }, vec![0; size.0 * size.1]))
    })
    .await?;
    let client = Client::connect(&format!("http://{}", server.local_addr())).await?;
    Ok((server, client))
}

/// Writes the installation's configuration with unknown poses and stated references.
fn write(survey: &Survey, folder: &Path, shift_m: f64) -> anyhow::Result<std::path::PathBuf> {
    let installation = Export::lab(1).write(&survey.arena, folder)?;
    let text = fs::read_to_string(&installation.config)?;
    let mut config: String = text
        .lines()
        .map(|line| if line.starts_with("pose = ") { "pose = \"unknown\"" } else { line })
        .flat_map(|line| [line, "\n"])
        .collect();
    for (index, reference) in survey.references.iter().enumerate() {
        let code = reference.code.context("a reference with a code")?.number;
        let shift_m = if index == 1 { Vector3::new(shift_m, 0.0, 0.0) } else { Vector3::zeros() };
        let [x, y, z]: [f64; 3] = (reference.position_m + shift_m).into();
        let name = &survey.arena.kinds[0].name;
        config += &format!(
            "\n[[reference]]\nroundel = \"{name}\"\ncode = {code}\nposition_m = [{x:?}, {y:?}, {z:?}]\n"
        );
    }
    fs::write(&installation.config, config)?;
    Ok(installation.config)
}

/// Publishes observations of robots that drive.
async fn drive(survey: &Survey, server: &Server) {
    for (index, frame) in Stream::new(&survey.arena, SENSING, DRIVEN_S).enumerate() {
        server.hub().publish_observations(Arc::new(survey.without_references(frame)));
        if index % AT_ONCE == AT_ONCE - 1 {
            tokio::time::sleep(Duration::from_millis(12)).await;
        }
    }
}

fn request(apply: CalibrationApply) -> StartCalibrationRequest {
    StartCalibrationRequest { seconds: Some(RECORDED_S), refine_lenses: false, apply: apply.into() }
}

/// Calibrates, and returns all reported stages and the final status.
async fn calibrate(
    survey: &Survey,
    server: &Server,
    client: &Client,
    apply: CalibrationApply,
) -> anyhow::Result<(Vec<CalibrationStage>, v1::Calibration)> {
    let started = client.start_calibration(request(apply)).await?;
    ensure!(started.stage() == CalibrationStage::Recording, "{started:?}");
    let mut changes = client.watch_calibration().await?;
    let follow = async {
        let mut stages = Vec::new();
        while let Some(calibration) = changes.next().await {
            let calibration = calibration?;
            stages.push(calibration.stage());
            stages.dedup();
            if matches!(calibration.stage(), CalibrationStage::Done | CalibrationStage::Failed) {
                return Ok((stages, calibration));
            }
        }
        anyhow::bail!("the stream ended at {stages:?}")
    };
    let (_, end) = tokio::join!(drive(survey, server), tokio::time::timeout(HANG, follow));
    end.context("the calibration does not end")?
}

async fn camera(
    client: &Client,
    index: usize,
    is_awaited: impl Fn(&v1::Camera) -> bool,
) -> anyhow::Result<v1::Camera> {
    for _ in 0..200 {
        let camera = client.cameras().await?.swap_remove(index);
        if is_awaited(&camera) {
            return Ok(camera);
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    anyhow::bail!("camera {index} does not come to that")
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arena_is_calibrated_while_it_is_served() -> anyhow::Result<()> {
    let survey = Survey::new(Arena::r4(3));
    let folder = tempfile::tempdir()?;
    let config = write(&survey, folder.path(), 0.0)?;
    let (server, client) = serve(&config).await?;
    ensure!(client.calibration().await?.stage() == CalibrationStage::Idle);
    let (stages, done) = calibrate(&survey, &server, &client, CalibrationApply::IfSound).await?;
    use CalibrationStage::{Done, Recording, Solving};
    assert_eq!(stages, [Recording, Solving, Done], "{}", done.error);
    assert_eq!((done.applied_version, done.version, done.error.as_str()), (1, 1, ""));

    let report = done.report.as_ref().context("a report")?;
    assert!(report.sound && report.cameras.len() == 4, "{report:?}");
    assert!(done.recorded.iter().all(|camera| camera.together.len() == 3), "{:?}", done.recorded);
    for (camera, site) in std::iter::zip(&report.cameras, &survey.arena.sites) {
        let place = camera.pose.and_then(|pose| pose.position).context("a place")?;
        let off_m =
            Vector3::new(place.x, place.y, place.z) - site.world_from_camera.translation.vector;
        // The references are stated to a millimetre.
        assert!(off_m.norm() < 3e-3 && camera.moved_m.is_none(), "{off_m:?} {camera:?}");
        assert!((0.5..2.0).contains(&camera.error_ratio), "{camera:?}");
    }
    // Every camera applies it with its next frame.
    for index in 0..4 {
        let taken = camera(&client, index, |camera| camera.calibration_version == 1).await?;
        assert_eq!(taken.pose_status(), PoseStatus::Calibrated);
        assert_eq!(taken.pose, report.cameras[index].pose);
    }
    let mut kinds = Vec::new();
    let mut events = client.events(50).await?;
    while !kinds.contains(&v1::EventKind::CalibrationApplied) {
        kinds.push(events.next().await.context("an event")??.kind());
    }
    assert!(kinds.contains(&v1::EventKind::CalibrationBegun), "{kinds:?}");
    server.shutdown().await;

    // The next start loads it.
    let (server, client) = serve(&config).await?;
    let kept = camera(&client, 2, |camera| camera.pose.is_some()).await?;
    let place =
        |camera: &v1::Camera| camera.pose.and_then(|pose| pose.position).unwrap_or_default();
    assert_eq!((kept.pose_status(), kept.calibration_version), (PoseStatus::Calibrated, 1));
    let found = report.cameras[2].pose.and_then(|pose| pose.position).unwrap_or_default();
    assert!((place(&kept).x - found.x).abs() < 1e-9, "{kept:?}");
    server.shutdown().await;

    // A pose that was configured afterwards takes precedence.
    let text = fs::read_to_string(&config)?.replacen(
        "pose = \"unknown\"",
        "pose = { position_m = [1.0, 2.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }",
        1,
    );
    fs::write(&config, text)?;
    let (server, client) = serve(&config).await?;
    let first = camera(&client, 0, |camera| camera.pose.is_some()).await?;
    assert_eq!((first.pose_status(), place(&first).z), (PoseStatus::Configured, 3.0));
    let event = client.events(50).await?.next().await.context("an event")??;
    assert!(event.message.contains("another pose"), "{}", event.message);
    server.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_doubtful_result_waits_for_approval() -> anyhow::Result<()> {
    let survey = Survey::new(Arena::r4(4));
    let folder = tempfile::tempdir()?;
    // The second reference is not where the configuration says.
    let config = write(&survey, folder.path(), 0.05)?;
    let (server, client) = serve(&config).await?;
    let (_, done) = calibrate(&survey, &server, &client, CalibrationApply::IfSound).await?;
    assert_eq!((done.stage(), done.applied_version), (CalibrationStage::Done, 0), "{}", done.error);
    let report = done.report.context("a report")?;
    let gravest = &report.findings[0];
    assert!(gravest.grave && gravest.message.contains("reference 2"), "{gravest:?}");
    assert!(!report.sound);
    let before = camera(&client, 0, |_| true).await?;
    assert_eq!(before.calibration_version, 0, "nothing has changed");
    let applied = client.apply_calibration().await?;
    assert_eq!((applied.applied_version, applied.version), (1, 1));
    camera(&client, 0, |camera| camera.calibration_version == 1).await?;
    server.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn impossible_requests_are_rejected_with_a_reason() -> anyhow::Result<()> {
    let survey = Survey::new(Arena::r4(5));
    let folder = tempfile::tempdir()?;
    let config = write(&survey, folder.path(), 0.0)?;
    let (server, client) = serve(&config).await?;
    let refused = |answer: Result<v1::Calibration, Error>| match answer {
        Err(Error::Refused { message, .. }) => message,
        other => panic!("not refused: {other:?}"),
    };
    let short = StartCalibrationRequest { seconds: Some(0.5), ..Default::default() };
    let message = refused(client.start_calibration(short).await);
    assert_eq!(message, "seconds: expected 2 to 600 seconds, found 0.5");
    let nan = StartCalibrationRequest { seconds: Some(f64::NAN), ..Default::default() };
    assert!(refused(client.start_calibration(nan).await).contains("found NaN"));
    assert!(refused(client.cancel_calibration().await).contains("no calibration is running"));
    assert!(refused(client.apply_calibration().await).contains("start one first"));

    client.start_calibration(request(CalibrationApply::Never)).await?;
    let message = refused(client.start_calibration(request(CalibrationApply::Never)).await);
    assert!(message.contains("running already"), "{message}");
    client.cancel_calibration().await?;
    let mut changes = client.watch_calibration().await?;
    let ended = loop {
        let calibration = changes.next().await.context("the stream ended")??;
        if calibration.stage() != CalibrationStage::Recording {
            break calibration;
        }
    };
    assert_eq!((ended.stage(), ended.error.as_str()), (CalibrationStage::Failed, "cancelled"));

    // Without any observation.
    client.start_calibration(request(CalibrationApply::Never)).await?;
    let mut changes = client.watch_calibration().await?;
    let ended = loop {
        let calibration = changes.next().await.context("the stream ended")??;
        if calibration.stage() == CalibrationStage::Failed {
            break calibration;
        }
    };
    assert!(ended.error.starts_with("no camera sees three references: camera "), "{}", ended.error);
    server.shutdown().await;

    let text = fs::read_to_string(&config)?;
    let without = text.split("[[reference]]").next().unwrap_or_default();
    let placed = without.replace(
        "pose = \"unknown\"",
        "pose = { position_m = [1.0, 2.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }",
    );
    fs::write(&config, placed)?;
    let (server, client) = serve(&config).await?;
    let message = refused(client.start_calibration(request(CalibrationApply::Never)).await);
    assert!(
        message.contains("0 reference roundels") && message.contains("[[reference]]"),
        "{message}"
    );
    server.shutdown().await;
    Ok(())
}
