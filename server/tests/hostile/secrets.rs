//! Passwords in a configuration, wherever an operator may have written them, are shown nowhere.

use std::{
    fs::{self, File},
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    path::Path,
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use prost::Message;
use prost_types::FileDescriptorSet;
use roundel_server::archive::record::file_reader::FileReader;
use serde_json::{Value, json};

use crate::setup::rig::write_lens;

/// Part of every planted secret; it occurs nowhere else.
const CANARY: &str = "zq7";
/// Time for an answer.
const STREAM_TIMEOUT: Duration = Duration::from_secs(2);

/// Cameras whose sources contain secrets: in the URL, its query, a pipeline, and behind escapes.
const CONFIG: &str = r##"# The cameras' password is zq7a.
name = "lab"
[server]
listen = "127.0.0.1:0" # token: zq7b
setup = true
[[roundel]]
name = "robot"
outer_mm = 160.0
inner_mm = 64.0
[[reference]]
roundel = "robot"
position_m = [0.0, 0.0, 0.0]
# source = "rtsp://admin:zq7c@192.168.1.20/live"
[[camera]]
name = "user"
source = "http://admin:zq7d@127.0.0.1:9/stream"
calibration = "camera.yaml"
pose = { position_m = [0.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
[[camera]]
name = "query"
source = "http://127.0.0.1:9/cgi?usr=zq7e&pwd=zq7f&p%61ssword=zq7g&token=zq7%68#stall=5"
calibration = "camera.yaml"
pose = { position_m = [1.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
[[camera]]
name = "slash"
source = """
rtsp://admin:zq7%2fi@127.0.0.1:9/live?next=rtsp%3A%2F%2Fadmin%3Azq7j%40127.0.0.1"""
calibration = "camera.yaml"
pose = { position_m = [2.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
[[camera]]
name = "escape"
source = "http:\u002f\u002fadmin:zq7k\u0040127.0.0.1:9/"
calibration = "camera.yaml"
pose = { position_m = [3.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
[[camera]]
name = "pipeline"
source = 'gst:rtspsrc location=rtsp://admin:zq7l@127.0.0.1:9/ user-id=zq7m user-pw="zq7 n" ! decodebin'
calibration = "camera.yaml"
pose = { position_m = [4.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
[recording]
start = true
min_free_mb = 0
[history]
"##;

struct Answers {
    address: String,
    /// Everything that the server has answered, with the request.
    all: Vec<(String, Vec<u8>)>,
}

impl Answers {
    fn request(&mut self, request: &str, content_type: &str, body: &[u8]) -> Vec<u8> {
        let mut socket = TcpStream::connect(&self.address).unwrap();
        socket.set_read_timeout(Some(STREAM_TIMEOUT)).unwrap();
        let head = format!(
            "{request} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\nContent-Type: {content_type}\r\nContent-Length: {}\r\n\r\n",
            self.address,
            body.len()
        );
        socket.write_all(&[head.as_bytes(), body].concat()).unwrap();
        let (mut answer, mut buffer, begun) = (Vec::new(), [0; 65536], Instant::now());
        // A stream does not end.
        while begun.elapsed() < STREAM_TIMEOUT {
            match socket.read(&mut buffer) {
                Ok(0) | Err(_) => break,
                Ok(length) => answer.extend_from_slice(&buffer[..length]),
            }
        }
        self.all.push((request.to_owned(), answer.clone()));
        answer
    }

    fn json(&mut self, request: &str, body: &Value) -> String {
        let answer = self.request(request, "application/json", body.to_string().as_bytes());
        let text = String::from_utf8_lossy(&answer).into_owned();
        text.split_once("\r\n\r\n").map_or_else(String::new, |(_, body)| body.to_owned())
    }
}

fn read_every_path(answers: &mut Answers) {
    let document = answers.json("GET /openapi.json", &Value::Null);
    let document: Value = serde_json::from_str(&document).unwrap();
    let paths: Vec<String> = document["paths"].as_object().unwrap().keys().cloned().collect();
    for camera in ["user", "query", "slash", "escape", "pipeline"] {
        for path in paths.iter().filter(|path| path.contains("cameras/{name}")) {
            answers.json(&format!("GET {}", path.replace("{name}", camera)), &Value::Null);
        }
    }
    for path in &paths {
        let path = path.replace("{name}", "robot").replace("{id}", "1");
        answers.json(&format!("GET {path}"), &Value::Null);
        if !path.contains("recording") {
            answers.json(&format!("POST {path}"), &json!({}));
        }
    }
}

fn call_every_method(answers: &mut Answers) {
    let set = FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap();
    for file in &set.file {
        for service in &file.service {
            for method in service.method.iter().filter(|it| it.name() != "StopRecording") {
                let path = format!("{}.{}/{}", file.package(), service.name(), method.name());
                let empty = [0; 5];
                answers.request(&format!("POST /{path}"), "application/grpc-web+proto", &empty);
            }
        }
    }
    for camera in ["user", "query", "slash", "escape", "pipeline"] {
        // A message whose first field is the camera's name.
        let name =
            [&[0, 0, 0, 0, camera.len() as u8 + 2, 10, camera.len() as u8], camera.as_bytes()];
        let path = "POST /roundel.v1.Roundel/GetCameraSetup";
        answers.request(path, "application/grpc-web+proto", &name.concat());
    }
}

/// Requests that fail at a line, a value or an address with a secret.
fn provoke_errors(answers: &mut Answers) {
    let shown = answers.json("GET /api/v1/configuration", &Value::Null);
    let shown: Value = serde_json::from_str(&shown).unwrap();
    let text = shown["toml"].as_str().unwrap();
    assert!(text.contains("http://127.0.0.1:9/stream") && text.contains("user-pw"), "{text}");
    for wrong in [
        text.replace("#stall=5", "#stall=0"),
        text.replace("decodebin'", "decodebin' wrong"),
        text.replace("name = \"user\"", "name = \"user\"\nname = \"user\""),
        CONFIG.replace("stream\"", "stream\" wrong"),
        CONFIG.replace("gst:", "gts:").replace("pwd=", "pwd=\\q"),
        CONFIG.replace("127.0.0.1:9/stream", "127.0.0.1:port/"),
    ] {
        answers.json("POST /api/v1/configuration/check", &json!({ "toml": wrong }));
    }
    for source in [
        "http://admin:zq7@127.0.0.1:9/?pwd=zq7",
        "http://admin:zq7/a@127.0.0.1:9",
        "rtsp://admin:zq7@127.0.0.1:9/",
        "v4l2:/dev/video0?password=zq7",
        "gst:rtspsrc user-pw=zq7 location=rtsp://127.0.0.1:9 ! nothing",
        "password=zq7",
    ] {
        answers.json("POST /api/v1/sources/test", &json!({ "source": source }));
        answers.json("PATCH /api/v1/cameras/user", &json!({ "source": source, "rate_hz": -1.0 }));
    }
}

fn leaks(what: &str, bytes: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(bytes);
    let at = text.find(CANARY)?;
    let around: String = text[..at].chars().rev().take(200).collect();
    let around: String = around.chars().rev().chain(text[at..].chars().take(60)).collect();
    Some(format!("{what}: {around}"))
}

fn recorded(folder: &Path) -> Vec<u8> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).unwrap().flatten() {
        all.extend(fs::read(entry.path()).unwrap());
        let mut reader = FileReader::open(&entry.path()).unwrap();
        while let Some(messages) = reader.next_chunk().unwrap() {
            messages.iter().for_each(|message| all.extend(&message.data));
        }
    }
    all
}

#[test]
fn no_secret_is_shown_in_answers_the_log_or_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    write_lens(folder.path(), "camera.yaml", 300.0);
    let config = folder.path().join("lab.toml");
    fs::write(&config, CONFIG).unwrap();
    let log = folder.path().join("log");
    let mut child = Command::new(env!("CARGO_BIN_EXE_roundel"))
        .args(["serve", "--config"])
        .arg(&config)
        .env("RUST_LOG", "debug")
        .stdout(Stdio::piped())
        .stderr(File::create(&log).unwrap())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim().strip_prefix("listening on http://").expect(&line).to_owned();
    let mut answers = Answers { address, all: Vec::new() };
    // The cameras fail meanwhile.
    sleep(Duration::from_secs(1));
    read_every_path(&mut answers);
    call_every_method(&mut answers);
    provoke_errors(&mut answers);
    sleep(Duration::from_secs(1));
    assert!(Command::new("kill").arg(child.id().to_string()).status().unwrap().success());
    child.wait().unwrap();

    let log = fs::read(&log).unwrap();
    let recording = recorded(&folder.path().join("recordings"));
    let text = String::from_utf8_lossy(&recording);
    assert!(text.contains("[[camera]]"), "the configuration is recorded");
    assert!(answers.all.len() > 80, "{} answers", answers.all.len());
    let found = answers.all.iter().filter_map(|(request, answer)| leaks(request, answer));
    let found: Vec<String> =
        found.chain(leaks("log", &log)).chain(leaks("recording", &recording)).collect();
    assert!(found.is_empty(), "{} leaks:\n{}", found.len(), found.join("\n---\n"));
    let kept = fs::read_to_string(&config).unwrap();
    assert!(kept == CONFIG, "the file has changed:\n{kept}");
}
