//! Conversion of the messages of remote programs: proto types → core types, with a check of every number.

use nalgebra::Vector3;
use roundel_core::{
    camera, ellipse,
    id::{CameraId, KindId, TrackNumber},
    marker::{Code, CodeLayout, CodeReading, Ring},
    pose,
    rigid::from_upper_triangle,
    time::Timestamp,
    world,
};
use roundel_proto::v1;
use thiserror::Error;

use crate::{
    capture::source::push::{Payload, RemoteStats, SenderClock, SentPicture},
    model::{
        capture_clock::{CaptureClock, TimeBase},
        convert::{self, capture_clock, intrinsics, pixels},
        hub::{CameraState, Installation},
        untrusted_text::{MAX_TEXT_BYTES, sanitized},
    },
};

/// Largest deviation of a sender's clock; more is a mistake of units.
const MAX_DEVIATION_MS: f64 = 3.6e6;
/// Metres, pixels and variances far beyond any arena; their powers are finite in fusion.
const MAX_NUMBER: f64 = 1e9;

/// A field with an invalid value.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{field}: expected {expected}, found {found}")]
pub struct WireFieldError {
    pub field: String,
    pub expected: String,
    pub found: String,
}

fn wire_error(
    field: impl Into<String>,
    expected: impl Into<String>,
    found: impl ToString,
) -> WireFieldError {
    WireFieldError { field: field.into(), expected: expected.into(), found: found.to_string() }
}

pub fn sender_clock(times: i32) -> Result<SenderClock, WireFieldError> {
    match v1::PushTimes::try_from(times) {
        Ok(v1::PushTimes::Unspecified) => Ok(SenderClock::Arrival),
        Ok(v1::PushTimes::Server) => Ok(SenderClock::Server),
        Ok(v1::PushTimes::Counter) => Ok(SenderClock::Counter),
        Ok(v1::PushTimes::Unix) => Ok(SenderClock::Unix),
        Err(_) => Err(wire_error("greeting.times", "a value of PushTimes", times)),
    }
}

/// A frame's pixels and its clock.
pub fn frame(frame: v1::PushedFrame) -> Result<(Payload, Option<CaptureClock>), WireFieldError> {
    let clock = frame.clock.map(|clock| sent_clock("frame.clock", clock)).transpose()?;
    let capture = Timestamp::from_ns(frame.capture_time_ns);
    let picture = match frame.picture {
        Some(v1::pushed_frame::Picture::Jpeg(file)) => SentPicture::Jpeg(file),
        Some(v1::pushed_frame::Picture::Grey(grey)) => grey_picture(grey),
        None => return Err(wire_error("frame.picture", "`jpeg` or `grey`", "neither")),
    };
    Ok((Payload::Frame(picture, capture), clock))
}

fn grey_picture(grey: v1::GreyPicture) -> SentPicture {
    SentPicture::Grey(grey.pixels, (grey.width as usize, grey.height as usize))
}

/// A picture to show, with its detections, or why there is none.
pub fn still_image(
    installation: &Installation,
    picture: v1::PushedPicture,
) -> Result<Result<(SentPicture, world::FrameObservations), String>, WireFieldError> {
    let v1::PushedPicture { error, picture, observations } = picture;
    let still = match picture {
        _ if !error.is_empty() => return Ok(Err(sanitized(&error))),
        Some(v1::pushed_picture::Picture::Jpeg(file)) => SentPicture::Jpeg(file),
        Some(v1::pushed_picture::Picture::Grey(grey)) => grey_picture(grey),
        None => return Err(wire_error("picture", "`jpeg`, `grey` or `error`", "neither")),
    };
    let seen =
        read_observations(installation, observations.unwrap_or_default(), "picture.observations")?;
    Ok(Ok((still, seen)))
}

/// Detections of a frame, and the clock of their times.
pub fn pushed_detections(
    installation: &Installation,
    message: v1::PushedObservations,
) -> Result<(Payload, Option<CaptureClock>), WireFieldError> {
    let clock = message.clock.map(|clock| sent_clock("observations.clock", clock)).transpose()?;
    let Some(frame) = message.observations else {
        return Err(wire_error(
            "observations.observations",
            "the detections of a frame",
            "nothing",
        ));
    };
    let observations = read_observations(installation, frame, "observations")?;
    let figures = message.figures.map(|figures| RemoteStats {
        width: figures.width as usize,
        height: figures.height as usize,
        dropped: figures.dropped,
        broken: figures.broken,
        detect_ms: figures.detect_ms,
        decode_ms: figures.decode_ms,
        blur_px: figures.blur_px,
        noise: figures.noise,
    });
    Ok((Payload::Detections(Box::new(observations), figures), clock))
}

pub fn read_observations(
    installation: &Installation,
    frame: v1::FrameObservations,
    field: &str,
) -> Result<world::FrameObservations, WireFieldError> {
    let detections = frame.detections.iter().enumerate().map(|(index, detection)| {
        read_detection(installation, detection).map_err(|error| {
            let field = format!("{field}.detections[{index}].{}", error.field);
            WireFieldError { field, ..error }
        })
    });
    Ok(world::FrameObservations {
        camera: CameraId(0),
        frame: 0,
        capture_time: Timestamp::from_ns(frame.capture_time_ns),
        received_time: Timestamp::from_ns(frame.received_time_ns),
        calibration_version: frame.calibration_version,
        detections: detections.collect::<Result<_, _>>()?,
    })
}

fn sent_clock(field: &str, clock: v1::CaptureClock) -> Result<CaptureClock, WireFieldError> {
    let base = match v1::TimeBase::try_from(clock.base) {
        Ok(v1::TimeBase::Server) => TimeBase::Server,
        Ok(v1::TimeBase::Arrival) => TimeBase::Arrival,
        Ok(v1::TimeBase::Camera) => TimeBase::Camera,
        Ok(v1::TimeBase::Unspecified | v1::TimeBase::Driver) => TimeBase::Driver,
        Ok(v1::TimeBase::Synchronized) => TimeBase::Synchronized,
        Err(_) => {
            return Err(wire_error(format!("{field}.base"), "a value of TimeBase", clock.base));
        }
    };
    if !(0.0..=MAX_DEVIATION_MS).contains(&clock.deviation_ms) {
        let expected = format!("0 to {MAX_DEVIATION_MS} milliseconds");
        return Err(wire_error(format!("{field}.deviation_ms"), expected, clock.deviation_ms));
    }
    Ok(CaptureClock { base, deviation_s: clock.deviation_ms * 1e-3 })
}

/// Errors name fields relative to the detection.
fn read_detection(
    installation: &Installation,
    detection: &v1::Detection,
) -> Result<pose::Detection, WireFieldError> {
    check_text(&detection.roundel, "roundel")?;
    let kind = match detection.roundel.as_str() {
        "" => None,
        name => Some(kind_named(installation, name)?),
    };
    let outer = read_ellipse(detection.outer.as_ref(), "outer")?;
    let inner = read_ellipse(detection.inner.as_ref(), "inner")?;
    let threshold = u8::try_from(detection.threshold)
        .map_err(|_| wire_error("threshold", "0 to 255", detection.threshold))?;
    let ring = Ring {
        kind,
        threshold,
        black: detection.black,
        white: detection.white,
        code: detection.code.as_ref().map(read_code).transpose()?,
        ..Ring::of_rims(outer, inner)
    };
    Ok(pose::Detection {
        track: TrackNumber(detection.track),
        ring,
        capture_time: Timestamp::from_ns(detection.capture_time_ns),
        pose: detection.pose.as_ref().map(read_pose).transpose()?,
    })
}

/// Rejects a long text; errors repeat short ones.
pub fn check_text(text: &str, field: &str) -> Result<(), WireFieldError> {
    if text.len() > MAX_TEXT_BYTES {
        let expected = format!("at most {MAX_TEXT_BYTES} bytes");
        return Err(wire_error(field, expected, format!("{} bytes", text.len())));
    }
    Ok(())
}

fn kind_named(installation: &Installation, name: &str) -> Result<KindId, WireFieldError> {
    let kind = installation.kinds.iter().position(|kind| kind == name);
    kind.and_then(|kind| u16::try_from(kind).ok()).map(KindId).ok_or_else(|| {
        let known = installation.kinds.join("\", \"");
        let expected = format!("a [[roundel]] of the server's configuration (\"{known}\")");
        wire_error("roundel", expected, format!("\"{name}\""))
    })
}

fn read_ellipse(
    ellipse: Option<&v1::Ellipse>,
    field: &str,
) -> Result<ellipse::Ellipse, WireFieldError> {
    let whole = ellipse.and_then(|ellipse| Some((ellipse, ellipse.center.as_ref()?)));
    let Some((ellipse, center)) = whole else {
        return Err(wire_error(field, "an ellipse with its centre", "none"));
    };
    let (semi_major_px, semi_minor_px, angle_rad) =
        (ellipse.semi_major_px, ellipse.semi_minor_px, ellipse.angle_rad);
    check_numbers(&[center.u, center.v, semi_major_px, semi_minor_px, angle_rad], field)?;
    if let Some(negative) = [semi_major_px, semi_minor_px].into_iter().find(|axis| *axis < 0.0) {
        return Err(wire_error(field, "semi-axes of 0 pixels or more", negative));
    }
    let center = camera::PixelPoint { u: center.u, v: center.v };
    Ok(ellipse::Ellipse { center, semi_major_px, semi_minor_px, angle_rad })
}

fn read_code(code: &v1::CodeReading) -> Result<CodeReading, WireFieldError> {
    let (least, most) = CodeLayout::BITS;
    let bits = u8::try_from(code.bits).ok().filter(|bits| (least..=most).contains(bits));
    let expected = || format!("{least} to {most}");
    let bits = bits.ok_or_else(|| wire_error("code.bits", expected(), code.bits))?;
    let number = u16::try_from(code.number).ok().filter(|&number| number > 0);
    let number = number.ok_or_else(|| wire_error("code.number", "1 to 65535", code.number))?;
    // A likelihood ratio, which may be very large.
    if !code.confidence.is_finite() {
        return Err(wire_error("code.confidence", "a finite number", code.confidence));
    }
    let (u, v) = code.zero.as_ref().map_or((f64::NAN, f64::NAN), |zero| (zero.u, zero.v));
    let corrected = u8::try_from(code.corrected_bits).unwrap_or(u8::MAX);
    let certain = CodeReading::certain(Code { bits, number }, camera::PixelPoint { u, v });
    Ok(CodeReading { confidence: code.confidence, corrected, ..certain })
}

fn read_pose(pose: &v1::RoundelPose) -> Result<pose::RoundelPose, WireFieldError> {
    let position_m = read_vector(pose.position.as_ref(), "pose.position")?;
    let normal = read_direction(pose.normal.as_ref(), "pose.normal")?;
    let other_normal = read_direction(pose.other_normal.as_ref(), "pose.other_normal")?;
    check_numbers(&[pose.normal_likelihood, pose.yaw_rad.unwrap_or(0.0)], "pose")?;
    check_numbers(&pose.covariance, "pose.covariance")?;
    let covariance = from_upper_triangle(&pose.covariance).ok_or_else(|| {
        let expected = "the 21 numbers of a covariance's upper triangle";
        wire_error("pose.covariance", expected, pose.covariance.len())
    })?;
    Ok(pose::RoundelPose {
        position_m,
        normal,
        normal_likelihood: pose.normal_likelihood,
        other_normal,
        yaw_rad: pose.yaw_rad,
        yaw_symmetry: pose.yaw_symmetry.max(1),
        covariance,
    })
}

fn read_vector(vector: Option<&v1::Vector3>, field: &str) -> Result<Vector3<f64>, WireFieldError> {
    let vector = vector.ok_or_else(|| wire_error(field, "three numbers", "none"))?;
    check_numbers(&[vector.x, vector.y, vector.z], field)?;
    Ok(Vector3::new(vector.x, vector.y, vector.z))
}

fn read_direction(
    vector: Option<&v1::Vector3>,
    field: &str,
) -> Result<Vector3<f64>, WireFieldError> {
    let vector = read_vector(vector, field)?;
    let length = vector.norm();
    if (length - 1.0).abs() > 1e-3 {
        return Err(wire_error(field, "a vector of length 1", format!("one of {length}")));
    }
    // A length that differs from 1 only by rounding leaves the vector unchanged to the last bit.
    Ok(if (length - 1.0).abs() < 1e-12 { vector } else { vector / length })
}

/// Rejects numbers that are not finite, or too large to compute with.
fn check_numbers(numbers: &[f64], field: &str) -> Result<(), WireFieldError> {
    let is_wrong = |number: &&f64| !(-MAX_NUMBER..=MAX_NUMBER).contains(*number);
    match numbers.iter().find(is_wrong) {
        Some(number) => {
            let expected = format!("numbers of at most {MAX_NUMBER:e}");
            Err(wire_error(field, expected, format!("{number:e}")))
        }
        None => Ok(()),
    }
}

/// The message of a node for its camera's detections.
pub fn pushed_observations(
    installation: &Installation,
    seen: &world::FrameObservations,
    state: &CameraState,
) -> v1::PushedObservations {
    v1::PushedObservations {
        // Assigned when it is sent.
        sequence: 0,
        clock: state.capture_clock.map(capture_clock),
        observations: Some(convert::observations(installation, seen)),
        figures: Some(v1::PushedFigures {
            width: pixels(state.width),
            height: pixels(state.height),
            dropped: state.dropped,
            broken: state.broken,
            detect_ms: state.detect_ms,
            decode_ms: state.decode_ms,
            blur_px: state.blur_px,
            noise: state.noise,
        }),
    }
}

/// The message of a server for its camera's calibration.
pub fn pushed_calibration(state: &CameraState) -> Option<v1::PushedCalibration> {
    let model = state.camera.as_ref()?;
    Some(v1::PushedCalibration {
        width: pixels(model.width()),
        height: pixels(model.height()),
        intrinsics: Some(intrinsics(model)),
        version: state.calibration_version,
    })
}

/// The camera of a server's calibration; `None` if this version does not know the lens model.
pub fn calibration_camera(calibration: &v1::PushedCalibration) -> Option<camera::Camera> {
    let sent = calibration.intrinsics.as_ref()?;
    camera::Camera::new(camera::Intrinsics {
        width: calibration.width as usize,
        height: calibration.height as usize,
        fx_px: sent.fx_px,
        fy_px: sent.fy_px,
        cx_px: sent.cx_px,
        cy_px: sent.cy_px,
        lens: camera::Lens::from_ros(&sent.lens, &sent.distortion)?,
    })
    .ok()
}
