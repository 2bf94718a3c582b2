//! The annotated camera picture: `/api/v1/cameras/{name}/frame.jpg` and gRPC.

use std::{sync::Arc, time::Duration};

use axum::http::StatusCode;
use roundel_client::{Client, Code, Error};
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, TrackNumber},
    marker::{self, CodeReading, Ring},
    pose::Detection,
    time::Timestamp,
    world::FrameObservations,
};
use roundel_server::model::hub::{CameraStatus, Picture};
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

use super::rig::{Answer, Rig};

const WIDTH: usize = 160;
const HEIGHT: usize = 120;
const CAPTURE_NS: i64 = 1_700_000_000_000_000_001;

fn picture(frame: u64, outer: Ellipse) -> Picture {
    coded_picture(frame, outer, None)
}

fn coded_picture(frame: u64, outer: Ellipse, code: Option<CodeReading>) -> Picture {
    let inner = Ellipse {
        semi_major_px: outer.semi_major_px / 2.0,
        semi_minor_px: outer.semi_minor_px / 2.0,
        ..outer
    };
    let ring = Ring { code, ..Ring::of_rims(outer, inner) };
    let time = Timestamp::from_ns(CAPTURE_NS);
    let detection = Detection { track: TrackNumber(42), ring, capture_time: time, pose: None };
    let observations = Arc::new(FrameObservations {
        camera: CameraId(0),
        frame,
        capture_time: time,
        received_time: time,
        calibration_version: 1,
        detections: vec![detection],
    });
    Picture::new((WIDTH, HEIGHT), vec![128; WIDTH * HEIGHT], observations)
}

fn ellipse(u: f64, v: f64, semi_major_px: f64, semi_minor_px: f64) -> Ellipse {
    Ellipse { center: PixelPoint { u, v }, semi_major_px, semi_minor_px, angle_rad: 0.0 }
}

/// Stands in for a worker: publishes `picture` when the hub requests one.
async fn with_worker(rig: &Rig, picture: Picture) -> Answer {
    let worker = async {
        while !rig.hub.take_picture_request(CameraId(0)) {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        rig.hub.publish_picture(CameraId(0), picture);
    };
    let (answer, ()) = tokio::join!(rig.get("/api/v1/cameras/north/frame.jpg"), worker);
    answer
}

fn decoded(answer: &Answer) -> Vec<u8> {
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&answer.body), options);
    let pixels = decoder.decode().unwrap();
    assert_eq!(decoder.dimensions(), Some((WIDTH, HEIGHT)));
    pixels
}

/// The maximum of red, green and blue over 3 x 3 pixels: the encoder smears colours.
fn strongest(pixels: &[u8], u: usize, v: usize) -> [i32; 3] {
    let mut found = [0; 3];
    for v in v - 1..=v + 1 {
        for u in u - 1..=u + 1 {
            for (channel, best) in found.iter_mut().enumerate() {
                *best = (*best).max(i32::from(pixels[3 * (v * WIDTH + u) + channel]));
            }
        }
    }
    found
}

#[tokio::test]
async fn the_picture_shows_frame_mask_and_detections() {
    let rig = Rig::start().await;
    let answer = with_worker(&rig, picture(1, ellipse(60.0, 50.0, 40.0, 20.0))).await;
    assert_eq!(answer.status, StatusCode::OK);
    assert_eq!(answer.header("content-type"), "image/jpeg");
    assert_eq!(answer.header("cache-control"), "no-store");
    assert_eq!(answer.header("roundel-capture-time-ns"), CAPTURE_NS.to_string());
    let pixels = decoded(&answer);
    let [red, green, blue] = strongest(&pixels, 20, 50);
    assert!(
        green > red + 40 && green > blue + 40,
        "left end of the outer rim: {red} {green} {blue}"
    );
    let [red, green, blue] = strongest(&pixels, 60, 60);
    assert!(blue > red + 20 && green > red, "lower end of the inner rim: {red} {green} {blue}");
    let [red, green, blue] = strongest(&pixels, 60, 50);
    assert!(red > green + 40 && red > blue + 40, "centre: {red} {green} {blue}");
    let number = (104..118).flat_map(|u| (46..55).map(move |v| (u, v)));
    let yellow = number.filter(|&(u, v)| {
        let [red, green, blue] = strongest(&pixels, u, v);
        red > 180 && green > 160 && blue < 160
    });
    assert!(yellow.count() > 20, "the track's number");
    let [red, green, blue] = strongest(&pixels, 4, 9);
    assert!(red > green + 30 && blue > green + 30, "the mask's edge: {red} {green} {blue}");
    let [red, green, blue] = strongest(&pixels, 130, 100);
    assert!(
        [red, green, blue].iter().all(|c| (c - 128).abs() < 6),
        "the rest of the frame is unchanged"
    );
    rig.stop().await;
}

#[tokio::test]
async fn grpc_serves_the_same_file() {
    let rig = Rig::start().await;
    let rest = with_worker(&rig, picture(1, ellipse(60.0, 50.0, 40.0, 20.0))).await;
    let client = Client::connect(&rig.url()).await.unwrap();
    // No worker answers this request, so the server returns the last picture.
    let picture = client.picture("north").await.unwrap();
    assert_eq!((picture.capture_time_ns, picture.jpeg == rest.body), (CAPTURE_NS, true));
    let error = client.picture("east").await.unwrap_err();
    let Error::Refused { code: Code::NotFound, message, .. } = &error else { panic!("{error:?}") };
    assert!(message.contains("there are: north, south side"), "{message}");
    let error = client.picture("south side").await.unwrap_err();
    assert!(
        error.is_temporary() && error.to_string().contains("no frame has arrived yet"),
        "{error}"
    );
    rig.stop().await;
}

#[tokio::test]
async fn draws_the_code_above_the_track_number() {
    let rig = Rig::start().await;
    let zero = PixelPoint { u: 80.0, v: 50.0 };
    let code = CodeReading::certain(marker::Code { bits: 8, number: 17 }, zero);
    let coded = coded_picture(1, ellipse(60.0, 50.0, 40.0, 20.0), Some(code));
    let pixels = decoded(&with_worker(&rig, coded).await);
    // The upper line is white, the lower one yellow; both are at the right end of the ring.
    let bright = |rows: std::ops::Range<usize>, is_wanted: fn([i32; 3]) -> bool| {
        let places = (104..126).flat_map(|u| rows.clone().map(move |v| (u, v)));
        places.filter(|&(u, v)| is_wanted(strongest(&pixels, u, v))).count()
    };
    let white = bright(40..48, |[_, _, blue]| blue > 190);
    let yellow = bright(52..60, |[red, _, blue]| red > 180 && blue < 160);
    assert!(white > 20 && yellow > 20, "{white} {yellow}");
    assert_eq!(bright(52..60, |[_, _, blue]| blue > 220), 0);
    rig.stop().await;
}

#[tokio::test]
async fn draws_pictures_with_extreme_detections() {
    let rig = Rig::start().await;
    for (u, v, a, b) in [
        (f64::NAN, 10.0, 5.0, 5.0),
        (10.0, f64::INFINITY, f64::INFINITY, 5.0),
        (-1e300, 1e300, 1e300, 0.0),
        (0.0, 0.0, 200.0, -3.0),
        (159.0, 119.0, 30.0, 30.0),
    ] {
        let answer = with_worker(&rig, picture(1, ellipse(u, v, a, b))).await;
        assert_eq!(answer.status, StatusCode::OK);
        decoded(&answer);
    }
    let mut short = picture(1, ellipse(1.0, 1.0, 1.0, 1.0));
    short.pixels.pop();
    let answer = with_worker(&rig, short).await;
    assert_eq!(answer.status, StatusCode::INTERNAL_SERVER_ERROR);
    assert!(answer.error().1.contains("expected 19200 pixels for 160 x 120, found 19199"));
    rig.stop().await;
}

#[tokio::test]
async fn without_frames_the_error_gives_the_cameras_reason() {
    let rig = Rig::start().await;
    rig.hub.update_camera(CameraId(0), |camera| {
        camera.status = CameraStatus::Failed;
        camera.error = "no such folder".into();
    });
    let answer = rig.get("/api/v1/cameras/north/frame.jpg").await;
    assert_eq!(answer.status, StatusCode::SERVICE_UNAVAILABLE);
    assert_eq!(
        answer.error().1,
        "no picture from camera \"north\" within a second: it is failed (no such folder)"
    );
    // The last picture is served although it is old; its header gives the capture time.
    rig.hub.publish_picture(CameraId(0), picture(1, ellipse(60.0, 50.0, 40.0, 20.0)));
    assert_eq!(rig.get("/api/v1/cameras/north/frame.jpg").await.status, StatusCode::OK);
    rig.stop().await;
}
