//! `roundel cameras`: lists the cameras of this computer, or tests a source.

use std::{fmt::Write as _, path::PathBuf, process::ExitCode};

use anyhow::Context;
use clap::Args;

use super::{Format, size};
use crate::{
    api,
    capture::{
        source::{
            Playback,
            v4l2::{ControlListing, DeviceListing, FormatListing, devices},
        },
        source_probe::{ProbeReport, SourceProbe},
    },
};

/// List the cameras of this computer with their formats and controls, or test one
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel cameras\n  \
    roundel cameras --test http://10.0.0.2:81/stream\n\n\
    In a configuration, a camera's address is its device file, followed by options:\n  \
    source = \"v4l2:/dev/video0?fps=30&auto_exposure=1&exposure_time_absolute=40\"")]
pub struct CamerasArgs {
    /// Format of the result
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
    /// Open this source for about two seconds and report what it delivers
    #[arg(long, value_name = "SOURCE")]
    test: Option<String>,
    /// Size to request from the source
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size, requires = "test")]
    size: Option<(usize, usize)>,
}

pub(super) fn run(arguments: &CamerasArgs) -> anyhow::Result<ExitCode> {
    if let Some(source) = &arguments.test {
        return probe(source, arguments);
    }
    arguments.format.print(&devices().context("cannot list /dev")?, |devices| table(devices))?;
    Ok(ExitCode::SUCCESS)
}

/// Tests a source. The exit code is 1 if it fails.
fn probe(source: &str, arguments: &CamerasArgs) -> anyhow::Result<ExitCode> {
    let (clock, playback) = Playback::begin(std::iter::empty())?;
    // Rings of any ratio are found.
    let source_probe = SourceProbe::new(Vec::new(), PathBuf::new(), clock, playback);
    let trial = source_probe.probe(source, arguments.size, |_| Ok(None))?;
    arguments.format.print(&api::source_probe::message(&trial), |_| describe_probe(&trial))?;
    Ok(if trial.error.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn describe_probe(trial: &ProbeReport) -> String {
    let mut text = String::new();
    let ProbeReport { width, height, frames, broken, rate_hz, promised_hz, .. } = trial;
    if *frames > 0 {
        let promised = match promised_hz {
            0.0 => String::new(),
            promised_hz => format!(" ({promised_hz:.1} promised)"),
        };
        let clock = trial.capture_clock.map_or(String::new(), |clock| {
            format!(", capture times: {:?} ± {:.0} ms", clock.base, clock.deviation_s * 1e3)
        });
        let _ = writeln!(text, "{width}x{height} at {rate_hz:.1} Hz{promised}{clock}");
        let _ = writeln!(
            text,
            "{frames} frames, {broken} broken; {} rings in the newest one; decoded in {:.2} ms, searched in {:.2} ms",
            trial.roundels, trial.decode_ms, trial.detect_ms
        );
    }
    if !trial.error.is_empty() {
        let _ = writeln!(text, "error: {}", trial.error);
    }
    text
}

fn table(devices: &[DeviceListing]) -> String {
    if devices.is_empty() {
        return "No camera found: this computer has no /dev/video*. Network cameras are not listed; configure them by \
                their address (http://…, rtsp://…).\n"
            .to_owned();
    }
    let mut text = String::new();
    for device in devices {
        let _ = match device.error.as_str() {
            "" => writeln!(text, "{}  {} ({})", device.path.display(), device.card, device.bus),
            error => writeln!(text, "{}  cannot be queried: {error}", device.path.display()),
        };
        for format in &device.formats {
            let _ = writeln!(text, "  {}", describe_format(format));
        }
        for control in &device.controls {
            let _ = writeln!(text, "  {}", describe_control(control));
        }
    }
    text
}

fn describe_format(format: &FormatListing) -> String {
    let FormatListing { width, height, rates_hz, .. } = format;
    let size = if *width == 0 { "any size".to_owned() } else { format!("{width}x{height}") };
    let rates: Vec<String> = rates_hz.iter().map(|rate| format!("{rate:.0}")).collect();
    let rates =
        if rates.is_empty() { String::new() } else { format!(" at {} Hz", rates.join(", ")) };
    let unread = if format.is_read { "" } else { "  (not read)" };
    format!("{:<4}  {size}{rates}{unread}", format.format)
}

fn describe_control(control: &ControlListing) -> String {
    let ControlListing { name, least, most, step, default, value, is_settable, .. } = control;
    let steps = if *step > 1 { format!(" in steps of {step}") } else { String::new() };
    let fixed = if *is_settable { "" } else { "  (cannot be set now)" };
    format!("{name}={value}  from {least} to {most}{steps}, default {default}{fixed}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_listed_as_its_address_wants_it() {
        let device = DeviceListing {
            path: "/dev/video0".into(),
            card: "Test Camera".into(),
            bus: "usb-1".into(),
            formats: vec![FormatListing {
                format: "YUYV".into(),
                description: "YUYV 4:2:2".into(),
                is_read: true,
                width: 640,
                height: 480,
                rates_hz: vec![30.0, 15.0],
                ..FormatListing::default()
            }],
            controls: vec![ControlListing {
                name: "gain".into(),
                least: 0,
                most: 255,
                step: 5,
                default: 0,
                value: 64,
                is_settable: false,
                ..ControlListing::default()
            }],
            error: String::new(),
        };
        let locked = DeviceListing {
            path: "/dev/video2".into(),
            formats: Vec::new(),
            controls: Vec::new(),
            error: "Permission denied".into(),
            ..device.clone()
        };
        assert_eq!(
            table(&[device, locked]),
            "/dev/video0  Test Camera (usb-1)\n  YUYV  640x480 at 30, 15 Hz\n  \
             gain=64  from 0 to 255 in steps of 5, default 0  (cannot be set now)\n\
             /dev/video2  cannot be queried: Permission denied\n"
        );
        assert!(table(&[]).starts_with("No camera found"));
    }
}
