//! Lens calibration over REST while a camera is served: the rendered board moves before the camera as an operator
//! would move it.

use std::{fs, path::Path, time::Duration};

use anyhow::{Context, ensure};
use roundel_tests::{
    board::{board_print, camera, imaging, pictures, poses},
    export::{camera_yaml, write_png},
    optics::{Distortion, Pinhole},
    process::Server,
    random::Random,
};
use serde_json::{Value, json};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::{sleep, timeout},
};

/// Only a stalled machine takes this long.
const PATIENCE: Duration = Duration::from_secs(120);
const VIEWS: usize = 26;
/// Frames for which each view is held.
const HELD: usize = 5;

/// A server with one camera that plays views of the board; its lens file is wrong by a tenth.
fn lab(folder: &Path) -> anyhow::Result<Server> {
    let truth = camera();
    let poses = poses(&truth, VIEWS, &mut Random::new(11, 0));
    let images = folder.join("images");
    fs::create_dir(&images)?;
    for (view, image) in pictures(&truth, imaging(), &board_print(), &poses, 11).iter().enumerate()
    {
        let first = images.join(format!("{view:03}-0.png"));
        write_png(&first, image)?;
        for again in 1..HELD {
            fs::hard_link(&first, images.join(format!("{view:03}-{again}.png")))?;
        }
    }
    let rough = Pinhole {
        focal_px: truth.focal_px.map(|px| 1.1 * px),
        distortion: Distortion::PlumbBob([0.0; 5]),
        ..truth
    };
    fs::write(folder.join("rough.yaml"), camera_yaml("north", &rough))?;
    let config = folder.join("lab.toml");
    fs::write(
        &config,
        "[server]\nlisten = \"127.0.0.1:0\"\n\
         [[roundel]]\nname = \"print\"\nouter_mm = 100.0\ninner_mm = 59.3\n\
         [[camera]]\nname = \"north\"\nsource = \"images:images/*.png?fps=12&loop=true\"\n\
         calibration = \"rough.yaml\"\n\
         pose = { position_m = [0.0, 0.0, 0.0], orientation_xyzw = [0.0, 0.0, 0.0, 1.0] }\n",
    )?;
    Server::serve(&config)
}

/// Status and body of a response.
async fn ask(
    server: &Server,
    method: &str,
    path: &str,
    body: &str,
) -> anyhow::Result<(u16, String)> {
    let mut stream = TcpStream::connect(server.address()).await?;
    let request = format!(
        "{method} /api/v1/{path} HTTP/1.1\r\nhost: {}\r\nconnection: close\r\ncontent-type: application/json\r\n\
         content-length: {}\r\n\r\n{body}",
        server.address(),
        body.len()
    );
    stream.write_all(request.as_bytes()).await?;
    let mut answer = Vec::new();
    timeout(PATIENCE, stream.read_to_end(&mut answer)).await??;
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let status = answer.split(' ').nth(1).context("no status line")?.parse()?;
    let (_, body) = answer.split_once("\r\n\r\n").context("no body")?;
    Ok((status, body.to_owned()))
}

async fn answered(server: &Server, method: &str, path: &str, body: &str) -> anyhow::Result<Value> {
    let (status, body) = ask(server, method, path, body).await?;
    ensure!(status == 200, "{method} {path}: {status}: {body}");
    Ok(serde_json::from_str(&body)?)
}

async fn until(server: &Server, is_so: impl Fn(&Value) -> bool) -> anyhow::Result<Value> {
    let looks = async {
        loop {
            let status = answered(server, "GET", "lens", "").await?;
            ensure!(status["stage"] != "failed" || is_so(&status), "{status}");
            if is_so(&status) {
                return Ok(status);
            }
            sleep(Duration::from_millis(100)).await;
        }
    };
    timeout(PATIENCE, looks).await.context("it never was so")?
}

/// The number in the first matching line of a camera file.
fn focal_px(yaml: &str) -> Option<f64> {
    let (_, data) = yaml.split_once("camera_matrix")?.1.split_once("data: [")?;
    data.split(',').next()?.trim().parse().ok()
}

#[tokio::test]
async fn a_served_camera_is_calibrated_while_the_board_moves() -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let server = lab(folder.path())?;
    let truth = camera();
    answered(&server, "POST", "lens", r#"{"camera": "north"}"#).await?;

    // Progress is reported during the session.
    let early = until(&server, |it| it["taken"].as_u64() > Some(2)).await?;
    let missing = early["missing"].as_array().context("a list")?.len();
    let share = early["coverage"]["share"].as_f64().context("a share")?;
    assert_eq!((&early["width"], &early["height"]), (&json!(1280), &json!(720)));
    assert_eq!(
        early["outlines"].as_array().map(Vec::len),
        early["taken"].as_u64().map(|it| it as usize)
    );
    assert!(missing > 0, "{early}");
    let better = until(&server, |it| it["taken"].as_u64() >= Some(12)).await?;
    assert!(better["coverage"]["share"].as_f64() > Some(share), "{share} and {better}");
    assert!(better["missing"].as_array().map(Vec::len) < Some(missing), "{better}");
    answered(&server, "PUT", "lens/finished", "").await?;
    let done = until(&server, |it| it["stage"] == "done").await?;

    let parameters = done["report"]["parameters"].as_array().context("parameters")?;
    let parameter = |name: &str| {
        let found = parameters.iter().find(|it| it["name"] == name).unwrap_or(&Value::Null);
        (
            found["value"].as_f64().unwrap_or(f64::NAN),
            found["deviation"].as_f64().unwrap_or(f64::NAN),
        )
    };
    for (name, focal_px) in [("fx", truth.focal_px[0]), ("fy", truth.focal_px[1])] {
        let (value, deviation) = parameter(name);
        assert!((value / focal_px - 1.0).abs() < 1e-3, "{name}: {value} for {focal_px}");
        assert!((0.0..1.0).contains(&deviation), "{name} ± {deviation}");
    }
    assert!(done["report"]["rms_px"].as_f64() < Some(0.1), "{}", done["report"]);
    let (status, yaml) = ask(&server, "GET", "lens/file", "").await?;
    assert_eq!(status, 200);
    assert!(
        yaml.contains("camera_name: \"north\"") && yaml.contains("parameter_covariance"),
        "{yaml}"
    );
    assert_eq!(focal_px(&yaml), Some(parameter("fx").0));

    // Once applied, it is saved beside the configuration, which refers to it.
    assert_eq!(done["can_apply"], true);
    let applied = answered(&server, "PUT", "lens/applied", "").await?;
    assert_eq!(applied["applied"], "north.lens-1.yaml");
    assert_eq!(fs::read_to_string(folder.path().join("north.lens-1.yaml"))?, yaml);
    let config = fs::read_to_string(folder.path().join("lab.toml"))?;
    assert!(config.contains("calibration = \"north.lens-1.yaml\""), "{config}");
    let camera = answered(&server, "GET", "cameras/north", "").await?;
    let used = camera["intrinsics"]["fx_px"].as_f64();
    assert!(used.is_some_and(|used| (used / truth.focal_px[0] - 1.0).abs() < 1e-3), "{camera}");
    // A second one does not overwrite it.
    let again = answered(&server, "PUT", "lens/applied", "").await?;
    assert_eq!(again["applied"], "north.lens-2.yaml");
    Ok(())
}

#[tokio::test]
async fn a_source_is_calibrated_before_it_is_a_camera() -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let server = lab(folder.path())?;
    let wish = r#"{"source": "images:images/*.png?fps=25", "name": "south", "views": 14}"#;
    let started = answered(&server, "POST", "lens", wish).await?;
    assert_eq!((&started["camera"], &started["enough"]), (&json!(""), &json!(14)));
    // Ends automatically, after the requested number of views or at the end of the source.
    let done = until(&server, |it| it["stage"] == "done").await?;
    assert!(done["report"]["views"].as_u64() >= Some(8), "{}", done["report"]);
    let applied = answered(&server, "PUT", "lens/applied", "").await?;
    assert_eq!(applied["applied"], "south.lens-1.yaml");
    let config = fs::read_to_string(folder.path().join("lab.toml"))?;
    assert!(!config.contains("south"), "{config}");
    Ok(())
}
