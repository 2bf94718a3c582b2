//! Options without an effect on the requested plan.

use super::PlanArgs;

/// One line for each option without effect.
pub(super) fn ignored_options(arguments: &PlanArgs) -> Vec<String> {
    let PlanArgs { camera, resolution, marker, code, mode, distance, tilt, count, speed, .. } =
        arguments;
    let PlanArgs { rate, lost, precision, height, arena, config, map, show, step, .. } = arguments;
    let is_plan = !arguments.measure;
    let is_installation = is_plan && config.is_some();
    let is_arena = is_plan && !is_installation && arena.is_some();
    let is_single = is_plan && !is_installation && !is_arena;
    let of = if is_installation {
        "for an installation"
    } else if is_arena {
        "over an arena"
    } else if is_single {
        "for a single camera"
    } else {
        "with --measure"
    };
    // With a given roundel, only the number of cameras can be searched for.
    let is_searched = is_arena || is_single && marker.is_none();
    // Name, whether it is given, whether it has an effect, and why it has none.
    let options = [
        ("--camera", camera.is_some(), is_arena || is_single, ""),
        ("--resolution", resolution.is_some(), is_arena || is_single, ": camera files contain it"),
        ("--marker", marker.is_some(), is_plan, ""),
        ("--code", code.is_some(), is_plan, ""),
        ("--mode", mode.is_some(), is_plan, ": both are measured"),
        ("--distance", distance.is_some(), is_single, ": cameras have positions"),
        ("--tilt", tilt.is_some(), is_single, ": roundels lie face up"),
        ("--count", count.is_some(), is_plan, ""),
        ("--speed", speed.is_some(), is_plan, ""),
        ("--rate", rate.is_some(), is_plan, ""),
        ("--lost", lost.is_some(), is_plan, ""),
        ("--precision", precision.is_some(), is_searched, ": the report shows the accuracy"),
        ("--height", height.is_some(), is_arena || is_installation, ": --distance replaces it"),
        ("--arena", arena.is_some(), is_arena, ""),
        ("--config", config.is_some(), is_installation, ""),
        ("--map", map.is_some(), is_plan, ""),
        ("--show", show.is_some() && map.is_some(), is_arena || is_installation, ""),
        ("--step", step.is_some(), is_arena || is_installation, ": there is no map"),
    ];
    let mut lines: Vec<String> = options
        .into_iter()
        .filter(|(_, is_given, has_effect, _)| *is_given && !has_effect)
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
