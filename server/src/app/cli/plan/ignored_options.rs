//! What was said and does not count, for whoever believes that it does.

use super::PlanArgs;

/// What is planned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Subject {
    Machine,
    Installation,
    Arena,
    Camera,
}

/// A line for each option that changes nothing.
pub(super) fn ignored_options(arguments: &PlanArgs) -> Vec<String> {
    use Subject::{Arena, Camera, Installation, Machine};
    let (subject, of) = match arguments {
        PlanArgs { measure: true, .. } => (Machine, "with --measure"),
        PlanArgs { config: Some(_), .. } => (Installation, "of an installation"),
        PlanArgs { arena: Some(_), .. } => (Arena, "over an arena"),
        _ => (Camera, "of one camera without a place"),
    };
    let face_up = "roundels lie face up";
    let options: [(&str, bool, &[Subject], &str); 18] = [
        ("--camera", arguments.camera.is_some(), &[Arena, Camera], ""),
        ("--resolution", arguments.resolution.is_some(), &[Arena, Camera], "its files say it"),
        ("--marker", arguments.marker.is_some(), &[Installation, Arena, Camera], ""),
        ("--code", arguments.code.is_some(), &[Installation, Arena, Camera], ""),
        ("--mode", arguments.mode.is_some(), &[Installation, Arena, Camera], "both are measured"),
        ("--distance", arguments.distance.is_some(), &[Camera], "places and heights say it"),
        ("--tilt", arguments.tilt.is_some(), &[Camera], face_up),
        ("--count", arguments.count.is_some(), &[Installation, Arena, Camera], ""),
        ("--speed", arguments.speed.is_some(), &[Installation, Arena, Camera], ""),
        ("--rate", arguments.rate.is_some(), &[Installation, Arena, Camera], ""),
        ("--lost", arguments.lost.is_some(), &[Installation, Arena, Camera], ""),
        (
            "--precision",
            arguments.precision.is_some(),
            if arguments.marker.is_some() { &[Arena] } else { &[Arena, Camera] },
            "what is told is what is reached",
        ),
        ("--height", arguments.height.is_some(), &[Installation, Arena], "--distance says it"),
        ("--arena", arguments.arena.is_some(), &[Arena], ""),
        ("--config", arguments.config.is_some(), &[Installation, Machine], ""),
        ("--map", arguments.map.is_some(), &[Installation, Arena, Camera], ""),
        ("--show", arguments.show.is_some() && arguments.map.is_some(), &[Installation, Arena], ""),
        ("--step", arguments.step.is_some(), &[Installation, Arena], "there is no map"),
    ];
    let is_idle = |(_, is_said, counts, _): &(&str, bool, &[Subject], &str)| {
        *is_said && !counts.contains(&subject)
    };
    let mut lines: Vec<String> = options
        .into_iter()
        .filter(is_idle)
        .map(|(name, _, _, why)| match why {
            "" => format!("{name} does not count {of}"),
            _ => format!("{name} does not count {of}: {why}"),
        })
        .collect();
    if arguments.show.is_some() && arguments.map.is_none() {
        lines.push("--show does not count without --map".to_owned());
    }
    lines
}
