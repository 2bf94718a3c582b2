//! Cost of decoding per codec: video files of 1280x720 with twenty moving roundels, read as fast as possible.
//!
//! ```sh
//! cargo bench -p roundel-server --features gst --bench decode
//! cargo bench -p roundel-server --features gst --bench decode -- --frames 300
//! ```
//!
//! GStreamer's encoders (`gst-launch-1.0`) make the files from noisy frames at 30 Hz, with about 4 Mbit/s, or JPEG of
//! quality 85. The processor time covers all threads from the first frame to the last: reading, decoding and copying the
//! luma. Nothing is detected. For comparison, Roundel's own decoder for HTTP and V4L2 cameras decodes the luma of the
//! same JPEG pictures.

mod shared;

use std::{fs, path::Path, process::Command, time::Instant};

use roundel_server::{
    capture::{
        image_file,
        source::{OpenSource, Playback, SourceError, SourceOpener},
    },
    model::{address::SourceAddress, stop::StopSignal},
};
use shared::{ROUND, SIZE, draw, processor_s};

/// Name, encoder and container.
const CODECS: [(&str, &str); 3] = [
    ("MJPEG", "jpegenc quality=85 ! avimux"),
    ("H.264", "x264enc bitrate=4000 speed-preset=veryfast key-int-max=30 ! h264parse ! mp4mux"),
    ("H.265", "x265enc bitrate=4000 speed-preset=ultrafast key-int-max=30 ! h265parse ! mp4mux"),
];

fn main() {
    let mut frames = 120;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--frames" => {
                let number = arguments.next().and_then(|value| value.parse().ok());
                frames = number.expect("--frames takes a number");
            }
            // Passed by cargo.
            "--bench" => {}
            other => panic!("unknown option {other}: expected --frames"),
        }
    }
    let folder = std::env::temp_dir().join(format!("roundel-decode-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder");
    let pixels: Vec<u8> = (0..frames).flat_map(|number| draw(number % ROUND)).collect();
    fs::write(folder.join("raw"), &pixels).expect("raw frames");
    println!("{frames} frames of {}x{}, processor time of all threads", SIZE.0, SIZE.1);
    for (name, encoder) in CODECS {
        let path = encode(&folder, encoder);
        let (received, processor_ms, elapsed_ms) = play(&path);
        assert_eq!(received, frames, "{name}: frames");
        let size_kb = fs::metadata(&path).expect("the file").len() as f64 / 1e3;
        println!(
            "{name:6} by GStreamer: {:.2} ms a frame, {:.0} frames/s ({:.0} kB a frame)",
            processor_ms / frames as f64,
            1e3 * frames as f64 / elapsed_ms,
            size_kb / frames as f64
        );
    }
    own(&folder);
    let _ = fs::remove_dir_all(&folder);
}

fn launch(pipeline: &str) {
    let mut command = Command::new("gst-launch-1.0");
    let status = command.arg("-q").args(pipeline.split_whitespace()).status();
    assert!(status.expect("gst-launch-1.0").success(), "{pipeline}");
}

fn raw(folder: &Path) -> String {
    format!(
        "filesrc location={}/raw ! rawvideoparse format=gray8 width={} height={} framerate=30/1 ! videoconvert",
        folder.display(),
        SIZE.0,
        SIZE.1
    )
}

fn encode(folder: &Path, encoder: &str) -> String {
    let path = folder.join("video").display().to_string();
    launch(&format!(
        "{} ! video/x-raw,format=I420 ! {encoder} ! filesink location={path}",
        raw(folder)
    ));
    path
}

/// Plays a file; returns the number of frames, and processor and real time from the first to the last, ms.
fn play(path: &str) -> (usize, f64, f64) {
    let url = format!("file:{path}?speed=max");
    let address = SourceAddress::parse(&url, Path::new("/")).expect("an address");
    let (clock, playback) = Playback::begin(std::iter::once(&address)).expect("a time line");
    let mut opener = SourceOpener::new(address, SIZE, clock, playback, StopSignal::default());
    let mut source = opener.open().expect("a source");
    let (processor, begun) = (processor_s(), Instant::now());
    let mut frames = 0;
    loop {
        match source.next_frame() {
            Ok(_) => frames += 1,
            Err(SourceError::Finished) => break,
            Err(error) => panic!("{error}"),
        }
    }
    (frames, (processor_s() - processor) * 1e3, begun.elapsed().as_secs_f64() * 1e3)
}

/// Decodes the first pictures as JPEG files with Roundel's own decoder.
fn own(folder: &Path) {
    let pattern = folder.join("%05d.jpg");
    launch(&format!(
        "{} ! video/x-raw,format=I420 ! jpegenc quality=85 ! multifilesink location={}",
        raw(folder),
        pattern.display()
    ));
    let files: Vec<Vec<u8>> = (0..ROUND)
        .map_while(|number| fs::read(folder.join(format!("{number:05}.jpg"))).ok())
        .collect();
    let processor = processor_s();
    for _ in 0..5 {
        for file in &files {
            image_file::decode(file, folder).expect("a picture");
        }
    }
    let frames = 5 * files.len();
    println!(
        "{:6} by Roundel:   {:.2} ms a frame, luma only ({:.0} kB a frame)",
        "MJPEG",
        (processor_s() - processor) * 1e3 / frames as f64,
        files.iter().map(Vec::len).sum::<usize>() as f64 / 1e3 / files.len() as f64
    );
}
