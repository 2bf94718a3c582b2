//! `file:` and `gst:` sources: playback timing, looping, `speed=max`, pixel formats and error messages.

use std::{path::Path, process::Command};

use roundel_server::{capture::source::SourceError, model::capture_clock::TimeBase};

use super::{SIZE, failure, open, run_exclusively};

/// GStreamer's environment variable that changes the rank of elements; rank `NONE` disables automatic use.
const RANKS: &str = "GST_PLUGIN_FEATURE_RANK";
/// Disables all H.264 decoders in Debian's packages.
const NO_H264: &str = "avdec_h264:NONE,openh264dec:NONE,vah264dec:NONE,vaapih264dec:NONE,nvh264dec:NONE,v4l2h264dec:NONE";

/// Writes a white video of 20 frames at 40 Hz.
fn video(folder: &Path, name: &str, encode: &str) -> String {
    let path = folder.join(name);
    let launch = format!(
        "videotestsrc num-buffers=20 pattern=white ! \
         video/x-raw,format=I420,width={},height={},framerate=40/1 ! {encode} ! filesink location={}",
        SIZE.0,
        SIZE.1,
        path.display()
    );
    let made = Command::new("gst-launch-1.0").arg("-q").args(launch.split_whitespace()).status();
    assert!(made.unwrap().success(), "{launch}");
    path.to_string_lossy().into_owned()
}

#[test]
fn plays_files_in_real_time_to_the_last_frame() {
    let _guard = run_exclusively();
    let folder = tempfile::tempdir().unwrap();
    for (name, encode) in [
        ("run.avi", "jpegenc ! avimux"),
        ("run.mp4", "x264enc ! mp4mux"),
        ("run.mkv", "x265enc ! h265parse ! matroskamux"),
    ] {
        let path = video(folder.path(), name, encode);
        let (mut source, clock) = open(&format!("file:{path}"));
        let (mut frames, mut skipped, mut times) = (0, 0, Vec::new());
        let end = loop {
            match source.next_frame() {
                Ok(lent) => {
                    frames += 1;
                    skipped += lent.info.skipped;
                    assert_eq!(lent.info.clock.base, TimeBase::Server);
                    // White in the limited range of video.
                    assert!(
                        lent.frame.row(10)[100].abs_diff(235) < 8,
                        "{}",
                        lent.frame.row(10)[100]
                    );
                    let late_s = clock.now().seconds_since(lent.info.capture_time);
                    assert!(late_s > -0.005, "{name}: shown {late_s} s before it is due");
                    times.push(lent.info.capture_time);
                }
                Err(error) => break error,
            }
        };
        assert_eq!(end, SourceError::Finished, "{name}");
        assert_eq!(frames + skipped, 20, "{name}: {frames} frames, {skipped} skipped");
        if skipped == 0 {
            let rest_ms = times.windows(2).map(|pair| pair[1].seconds_since(pair[0]) * 1e3 - 25.0);
            assert!(
                rest_ms.clone().all(|rest| rest.abs() < 2.0),
                "{:?}",
                rest_ms.collect::<Vec<_>>()
            );
        }
    }
}

#[test]
fn loops_a_file() {
    let _guard = run_exclusively();
    let folder = tempfile::tempdir().unwrap();
    let path = video(folder.path(), "run.avi", "jpegenc ! avimux");
    let (mut source, _) = open(&format!("file:{path}?loop=true"));
    let mut newest = None;
    for _ in 0..45 {
        let time = source.next_frame().unwrap().info.capture_time;
        assert!(
            newest.is_none_or(|newest| time > newest),
            "times must increase from round to round"
        );
        newest = Some(time);
    }
}

/// With `speed=max`, a slow reader loses no frame, and a fast one does not wait for the due time.
#[test]
fn speed_max_skips_nothing_and_does_not_wait() {
    let _guard = run_exclusively();
    let folder = tempfile::tempdir().unwrap();
    let path = video(folder.path(), "run.mp4", "x264enc ! mp4mux");
    let (mut source, clock) = open(&format!("file:{path}?speed=max"));
    let (mut frames, mut newest) = (0, clock.start());
    let end = loop {
        match source.next_frame() {
            Ok(lent) => {
                frames += 1;
                assert_eq!(lent.info.skipped, 0, "at frame {frames}");
                assert!(lent.info.decoding.as_nanos() > 0, "at frame {frames}");
                assert!(lent.info.capture_time > newest, "times must increase");
                newest = lent.info.capture_time;
                assert!(clock.now() >= newest);
                if frames <= 5 {
                    // Two frame intervals: in real time, a frame would be skipped.
                    std::thread::sleep(std::time::Duration::from_millis(60));
                }
            }
            Err(error) => break error,
        }
    };
    assert_eq!((end, frames), (SourceError::Finished, 20));
}

#[test]
fn pipelines_deliver_luma_of_every_pixel_format() {
    let _guard = run_exclusively();
    for format in ["GRAY8", "NV12", "YUY2", "UYVY", "GRAY16_LE", "RGB"] {
        let pipeline = format!(
            "gst:videotestsrc is-live=true pattern=white ! video/x-raw,format={format},width={},height={},framerate=30/1",
            SIZE.0, SIZE.1
        );
        let (mut source, clock) = open(&pipeline);
        for _ in 0..3 {
            let lent = source.next_frame().unwrap();
            let level = lent.frame.row(SIZE.1 - 1)[SIZE.0 - 1];
            assert!(level >= 230, "{format}: {level}");
            assert_eq!(lent.info.clock.base, TimeBase::Driver);
            let age_s = clock.now().seconds_since(lent.info.capture_time);
            assert!((0.0..1.0).contains(&age_s), "{format}: {age_s} s old");
        }
        assert_eq!(source.promised_hz(), Some(30.0), "{format}");
    }
}

#[test]
fn wrong_sources_give_errors_with_a_remedy() {
    let _guard = run_exclusively();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("note.txt"), "no video\n".repeat(500)).unwrap();
    let note = format!("file:{}", folder.path().join("note.txt").display());
    let small = "gst:videotestsrc ! video/x-raw,width=64,height=48";
    for (url, expected) in [
        ("file:/nowhere/run.mp4", "file:/nowhere/run.mp4: "),
        ("file:/nowhere/run.mp4", "; check the path"),
        (note.as_str(), "note.txt: "),
        ("gst:wondersrc", "GStreamer has no element `wondersrc`: check its name"),
        (
            "gst:libcamerasrc",
            "GStreamer has no element `libcamerasrc`: install gstreamer1.0-libcamera",
        ),
        ("gst:videotestsrc ! !", "GStreamer cannot read the pipeline"),
        (small, "expected an image of 320 x 64 pixels as the camera file says, found 64 x 48"),
        ("gst:videotestsrc num-buffers=0", "the stream has ended"),
        ("rtsp://127.0.0.1:1/x", "nothing listens there; check host and port"),
    ] {
        let message = failure(url, SIZE);
        assert!(message.contains(expected), "{url}: {message}");
    }
}

/// Runs in a child process in which no element decodes H.264.
#[test]
fn a_missing_decoder_is_named_with_its_package() {
    let _guard = run_exclusively();
    if std::env::var_os(RANKS).is_none() {
        let name = "media::file::a_missing_decoder_is_named_with_its_package";
        let this = std::env::current_exe().unwrap();
        let mut again = Command::new(this);
        let again = again.args(["--exact", name, "--nocapture"]).env(RANKS, NO_H264).output();
        let again = again.unwrap();
        assert!(again.status.success(), "{}", String::from_utf8_lossy(&again.stderr));
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = video(folder.path(), "run.mp4", "x264enc ! mp4mux");
    let message = failure(&format!("file:{path}"), SIZE);
    assert!(message.contains("GStreamer lacks: H.264"), "{message}");
    assert!(message.ends_with("; install gstreamer1.0-libav"), "{message}");
}
