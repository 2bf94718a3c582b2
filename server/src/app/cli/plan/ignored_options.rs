//! Options without an effect on the requested plan.

use super::PlanArgs;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Subject {
    Machine,
    Installation,
    Arena,
    Camera,
}

/// One line for each option without effect.
pub(super) fn ignored_options(arguments: &PlanArgs) -> Vec<String> {
    use Subject::{Arena, Camera, Installation, Machine};
    let (subject, of) = match arguments {
        PlanArgs { measure: true, .. } => (Machine, "with --measure"),
        PlanArgs { config: Some(_), .. } => (Installation, "for an installation"),
        PlanArgs { arena: Some(_), .. } => (Arena, "over an arena"),
        _ => (Camera, "for a single camera"),
    };
    let PlanArgs { camera, resolution, marker, code, mode, distance, tilt, count, speed, .. } =
        arguments;
    let PlanArgs { rate, lost, precision, height, arena, config, map, show, step, .. } = arguments;
    let all: &[Subject] = &[Installation, Arena, Camera];
    let places: &[Subject] = &[Installation, Arena];
    let pinhole: &[Subject] = &[Arena, Camera];
    // With a given roundel, only the number of cameras can be searched for.
    let searched = if marker.is_some() { &[Arena] } else { pinhole };
    // Name, whether it is given, the plans it affects, and why it does not affect others.
    let options: [(&str, bool, &[Subject], &str); 18] = [
        ("--camera", camera.is_some(), pinhole, ""),
        ("--resolution", resolution.is_some(), pinhole, ": camera files contain it"),
        ("--marker", marker.is_some(), all, ""),
        ("--code", code.is_some(), all, ""),
        ("--mode", mode.is_some(), all, ": both are measured"),
        ("--distance", distance.is_some(), &[Camera], ": cameras have positions"),
        ("--tilt", tilt.is_some(), &[Camera], ": roundels lie face up"),
        ("--count", count.is_some(), all, ""),
        ("--speed", speed.is_some(), all, ""),
        ("--rate", rate.is_some(), all, ""),
        ("--lost", lost.is_some(), all, ""),
        ("--precision", precision.is_some(), searched, ": the report shows the accuracy"),
        ("--height", height.is_some(), places, ": --distance replaces it"),
        ("--arena", arena.is_some(), &[Arena], ""),
        ("--config", config.is_some(), &[Installation], ""),
        ("--map", map.is_some(), all, ""),
        ("--show", show.is_some() && map.is_some(), places, ""),
        ("--step", step.is_some(), places, ": there is no map"),
    ];
    let mut lines: Vec<String> = options
        .into_iter()
        .filter(|(_, is_given, subjects, _)| *is_given && !subjects.contains(&subject))
        .map(|(name, _, _, why)| format!("{name} has no effect {of}{why}"))
        .collect();
    if show.is_some() && map.is_none() {
        lines.push("--show has no effect without --map".to_owned());
    }
    if arguments.machine.is_some() {
        lines.push("--machine has no effect: each plan measures its own frames".to_owned());
    }
    lines
}
