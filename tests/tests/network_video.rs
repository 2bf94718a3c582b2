//! A real video through `roundel serve`, sent like that of a network camera.

use std::{
    collections::BTreeSet,
    fs,
    io::{BufRead, BufReader, Write},
    net::TcpListener,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, ensure};
use futures::StreamExt;
use jpeg_encoder::{ColorType, Encoder};
use roundel_client::{
    Client, Subscription, Update,
    v1::{CameraStatus, LifeStage, TimeBase},
};
use roundel_server::capture::image_file;
use roundel_tests::{process::Server, python::Python, shared_data::shared_data};
use tokio::time::timeout;

/// Folder for files made by Python.
const FOLDER: &str = env!("CARGO_TARGET_TMPDIR");
/// Only a stalled machine takes this long.
const PATIENCE: Duration = Duration::from_secs(120);
const INTERVAL: Duration = Duration::from_micros(33_367);

/// The camera was not calibrated; an assumed focal length only scales distances.
const CAMERA: &str = "image_width: 848\nimage_height: 480\ncamera_name: phone\n\
camera_matrix: {rows: 3, cols: 3, data: [700.0, 0.0, 423.5, 0.0, 700.0, 239.5, 0.0, 0.0, 1.0]}\n\
distortion_model: plumb_bob\n\
distortion_coefficients: {rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}\n";

/// Streams the pictures once, each when it is due, and repeats the last one.
fn serve_mjpeg(pictures: Vec<Vec<u8>>) -> anyhow::Result<String> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let url = format!("http://{}/stream", listener.local_addr()?);
    thread::spawn(move || -> std::io::Result<()> {
        let (mut socket, _) = listener.accept()?;
        let mut request = BufReader::new(socket.try_clone()?);
        let mut line = String::new();
        while request.read_line(&mut line)? > 2 {
            line.clear();
        }
        let head =
            "HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace;boundary=frame\r\n\r\n";
        socket.write_all(head.as_bytes())?;
        let started = Instant::now();
        let last = pictures.last().cloned().unwrap_or_default();
        for (index, picture) in (0..).zip(pictures.into_iter().chain(std::iter::repeat(last))) {
            thread::sleep((INTERVAL * index).saturating_sub(started.elapsed()));
            let length = picture.len();
            let part =
                format!("--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {length}\r\n\r\n");
            socket.write_all(&[part.as_bytes(), &picture, b"\r\n"].concat())?;
        }
        Ok(())
    });
    Ok(url)
}

fn as_jpeg(path: &Path) -> anyhow::Result<Vec<u8>> {
    let image = image_file::load(path)?;
    let mut jpeg = Vec::new();
    let (width, height) = (u16::try_from(image.width)?, u16::try_from(image.height)?);
    Encoder::new(&mut jpeg, 92).encode(&image.pixels, width, height, ColorType::Luma)?;
    Ok(jpeg)
}

fn configuration(folder: &Path, source: &str) -> anyhow::Result<PathBuf> {
    fs::write(folder.join("phone.yaml"), CAMERA)?;
    let config = folder.join("lab.toml");
    let text = format!(
        "[server]\nlisten = \"127.0.0.1:0\"\n\
         [[roundel]]\nname = \"print\"\nouter_mm = 100.0\ninner_mm = 59.3\n\
         [[camera]]\nname = \"phone\"\nsource = \"{source}\"\ncalibration = \"phone.yaml\"\n\
         pose = {{ position_m = [0.0, 0.0, 0.0], orientation_xyzw = [0.0, 0.0, 0.0, 1.0] }}\n"
    );
    fs::write(&config, text)?;
    Ok(config)
}

/// Follows the only object through `wanted` frames; its id never changes, and it is never lost.
async fn follow(server: &Server, wanted: u64) -> anyhow::Result<()> {
    let client = Client::connect(&server.url()).await?;
    let mut snapshots = client.snapshots(Subscription::default());
    let mut ids = BTreeSet::new();
    let mut is_tracked = false;
    let all = async {
        loop {
            let Some(update) = snapshots.next().await else { anyhow::bail!("the stream ended") };
            if let Update::Snapshot(snapshot) = update? {
                for object in &snapshot.objects {
                    ids.insert(object.object_id);
                    is_tracked |= object.stage() == LifeStage::Tracked;
                    ensure!(object.stage() != LifeStage::Lost, "lost: {object:?}");
                }
                ensure!(snapshot.objects.len() <= 1, "{:?}", snapshot.objects);
            }
            let camera = client.cameras().await?.pop().context("no camera")?;
            ensure!(camera.status() != CameraStatus::Failed, "{}", camera.error);
            if camera.frames + camera.dropped >= wanted {
                return Ok(camera);
            }
        }
    };
    let camera = timeout(PATIENCE, all).await.context("the frames do not come")??;
    println!("{} frames searched, {} gave way to newer ones", camera.frames, camera.dropped);
    ensure!(ids.len() == 1 && is_tracked, "{} objects, tracked: {is_tracked}", ids.len());
    ensure!((camera.broken, camera.restarts) == (0, 0), "{camera:?}");
    let clock = camera.capture_clock.context("no clock")?;
    ensure!(clock.base() == TimeBase::Arrival && clock.deviation_ms == 50.0, "{clock:?}");
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_real_video_over_mjpeg_is_one_unbroken_track() -> anyhow::Result<()> {
    const NAME: &str = "a_real_video_over_mjpeg_is_one_unbroken_track";
    let Some(data) = shared_data(NAME, "real/ring") else { return Ok(()) };
    let Some(python) = Python::new(NAME, Path::new(FOLDER)) else { return Ok(()) };
    let video = data.join("video.mp4");
    let frames = python.folder(NAME, "mjpeg", "video.py", &[video.as_os_str()]);
    let Some(frames) = frames else { return Ok(()) };
    let mut paths: Vec<PathBuf> =
        fs::read_dir(frames)?.map(|entry| Ok(entry?.path())).collect::<anyhow::Result<_>>()?;
    paths.sort();
    ensure!(paths.len() == 280, "{} frames", paths.len());
    let pictures = paths.iter().map(|path| as_jpeg(path)).collect::<anyhow::Result<_>>()?;
    let folder = tempfile::tempdir()?;
    let config = configuration(folder.path(), &serve_mjpeg(pictures)?)?;
    let server = Server::serve(&config)?;
    follow(&server, 280).await
}
