//! `roundel node` on another network, whose link to `roundel serve` is interrupted and restored: two processes, two
//! network namespaces, and consistent counters.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use anyhow::{Context, ensure};
use roundel_client::{
    Client,
    v1::{Camera, CameraStatus},
};
use roundel_tests::process::{Server, roundel};
use tokio::time::sleep;

/// Only a stalled machine takes this long.
const PATIENCE: Duration = Duration::from_secs(90);
const CUT: Duration = Duration::from_secs(11);

const CAMERA: &str = "image_width: 320\nimage_height: 240\ncamera_name: robot\n\
camera_matrix: {rows: 3, cols: 3, data: [300.0, 0.0, 159.5, 0.0, 300.0, 119.5, 0.0, 0.0, 1.0]}\n\
distortion_model: plumb_bob\n\
distortion_coefficients: {rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}\n";
const ROUNDEL: &str = "[[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n";

/// A network namespace, connected to this one by a virtual cable.
struct Network {
    name: String,
    cable: String,
    here: String,
}

fn ip(arguments: &str) -> anyhow::Result<()> {
    let output = Command::new("ip").args(arguments.split_whitespace()).output().context("ip")?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "ip {arguments}: {}", said.trim());
    Ok(())
}

impl Network {
    fn new() -> anyhow::Result<Self> {
        let number = std::process::id() % 10_000;
        let (name, cable) = (format!("roundel-{number}"), format!("rt{number}h"));
        // An address of 198.18.0.0/15, which is reserved for network tests.
        let subnet = format!("198.18.{}", number % 256);
        ip(&format!("netns add {name}"))?;
        let network = Self { name, cable, here: format!("{subnet}.1") };
        let Self { name, cable, .. } = &network;
        ip(&format!("link add {cable} type veth peer name rt{number}n netns {name}"))?;
        ip(&format!("addr add {subnet}.1/30 dev {cable}"))?;
        ip(&format!("link set {cable} up"))?;
        ip(&format!("-n {name} addr add {subnet}.2/30 dev rt{number}n"))?;
        ip(&format!("-n {name} link set rt{number}n up"))?;
        ip(&format!("-n {name} link set lo up"))?;
        Ok(network)
    }

    fn set_cable(&self, state: &str) -> anyhow::Result<()> {
        ip(&format!("link set {} {state}", self.cable))
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        // Deletes the cable too.
        let _ = ip(&format!("netns del {}", self.name));
    }
}

/// A running node in that network; killed when dropped.
struct Node(Child);

impl Node {
    fn start(network: &Network, folder: &Path) -> anyhow::Result<Self> {
        let mut child = Command::new("ip")
            .args(["netns", "exec", &network.name])
            .arg(roundel()?)
            .args(["node", "--format", "json", "--config"])
            .arg(folder.join("node.toml"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()?;
        let mut line = String::new();
        BufReader::with_capacity(1, child.stdout.as_mut().context("no output")?)
            .read_line(&mut line)?;
        ensure!(
            line.starts_with("sending to http://"),
            "expected where it sends to, found {line:?}"
        );
        Ok(Self(child))
    }

    /// Stops it, and returns its final report.
    fn end(mut self) -> anyhow::Result<serde_json::Value> {
        let id = self.0.id().to_string();
        ensure!(Command::new("kill").args(["-s", "TERM", &id]).status()?.success(), "kill {id}");
        let mut text = String::new();
        self.0.stdout.take().context("no output")?.read_to_string(&mut text)?;
        ensure!(self.0.wait()?.success(), "{text}");
        Ok(serde_json::from_str(&text)?)
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Ten pictures of a ring of 20 px on white.
fn draw(folder: &Path) -> anyhow::Result<()> {
    let level = |u: f64, v: f64| {
        let radius = (u - 160.0).hypot(v - 120.0);
        let ink = (20.5 - radius).clamp(0.0, 1.0) - (8.5 - radius).clamp(0.0, 1.0);
        (220.0 - 190.0 * ink).round() as u8
    };
    let pixels = (0..240).flat_map(|v| (0..320).map(move |u| level(f64::from(u), f64::from(v))));
    let file: Vec<u8> = b"P5\n320 240\n255\n".iter().copied().chain(pixels).collect();
    for number in 0..10 {
        fs::write(folder.join(format!("{number}.pgm")), &file)?;
    }
    Ok(())
}

async fn until(
    client: &Client,
    what: &str,
    wanted: impl Fn(&Camera) -> bool,
) -> anyhow::Result<Camera> {
    let started = Instant::now();
    loop {
        let camera = client.cameras().await?.pop().context("no camera")?;
        if wanted(&camera) {
            return Ok(camera);
        }
        ensure!(started.elapsed() < PATIENCE, "{what} did not come about: {camera:#?}");
        sleep(Duration::from_millis(20)).await;
    }
}

/// Sum of a metric's values in `/metrics`.
fn metric(address: &str, name: &str) -> anyhow::Result<u64> {
    let mut socket = TcpStream::connect(address)?;
    write!(socket, "GET /metrics HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut page = String::new();
    socket.read_to_string(&mut page)?;
    let values = page.lines().filter(|line| line.starts_with(name));
    let numbers = values.filter_map(|line| line.rsplit(' ').next()?.parse::<f64>().ok());
    Ok(numbers.sum::<f64>() as u64)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_on_another_network_loses_its_link_and_the_counts_add_up() -> anyhow::Result<()> {
    let network = match Network::new() {
        Ok(network) => network,
        Err(why) => {
            println!(
                "skipped a_node_on_another_network_loses_its_link_and_the_counts_add_up: no network namespaces ({why})"
            );
            return Ok(());
        }
    };
    let folder = tempfile::tempdir()?;
    let path = folder.path();
    draw(path)?;
    fs::write(path.join("camera.yaml"), CAMERA)?;
    let camera = |source: &str| {
        format!(
            "[[camera]]\nname = \"north\"\nsource = \"{source}\"\ncalibration = \"camera.yaml\"\n"
        )
    };
    let pose = "pose = { position_m = [0.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }\n";
    let listen = format!("[server]\nlisten = \"{}:0\"\ninsecure = true\n", network.here);
    fs::write(path.join("lab.toml"), format!("{listen}{ROUNDEL}{}{pose}", camera("push:")))?;
    let server = Server::serve(&path.join("lab.toml"))?;
    let source = camera("images:*.pgm?fps=30&loop=true");
    let text =
        format!("name = \"robot 7\"\n[node]\nserver = \"{}\"\n{ROUNDEL}{source}", server.url());
    fs::write(path.join("node.toml"), text)?;
    let client = Client::connect(&server.url()).await?;
    let node = Node::start(&network, path)?;

    until(&client, "frames", |camera| camera.frames > 30 && camera.detections == 1).await?;
    network.set_cable("down")?;
    let failed =
        until(&client, "a failure", |camera| camera.status() == CameraStatus::Failed).await?;
    ensure!(failed.error.contains("nothing from node robot 7 (198.18."), "{}", failed.error);
    sleep(CUT).await;
    network.set_cable("up")?;
    let back = until(&client, "frames after the cut", |camera| {
        camera.frames > failed.frames + 60 && camera.status() == CameraStatus::Running
    })
    .await?;
    ensure!(back.error.is_empty(), "{}", back.error);

    let report = node.end()?;
    let number = |key: &str| report[0][key].as_u64().with_context(|| format!("{key}: {report}"));
    let (frames, taken, dropped) = (number("frames")?, number("taken")?, number("dropped")?);
    println!("{report:#}");
    ensure!(frames == taken + dropped && frames == number("searched")?, "{report}");
    ensure!(dropped as f64 > 30.0 * 0.7 * CUT.as_secs_f64(), "it goes on searching: {report}");
    let gone = |camera: &Camera| camera.link.as_ref().is_some_and(|link| !link.connected);
    let camera = until(&client, "the end", gone).await?;
    let link = camera.link.context("no link")?;
    ensure!((link.received, camera.frames) == (taken, taken), "{link:?} {report}");
    // The server does not know of drops before the first connection.
    ensure!(link.missing <= dropped && link.missing > 0, "{link:?} {report}");
    ensure!(metric(server.address(), "roundel_fusion_frames_total")? == taken, "{report}");
    ensure!(metric(server.address(), "roundel_fusion_detections_total")? == taken, "{report}");
    Ok(())
}
