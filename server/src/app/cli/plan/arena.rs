//! Several cameras over an arena: those of an installation, or the fewest that do it.

use std::{io::Write as _, path::Path};

use anyhow::{Context, bail};
use roundel_core::{
    marker::Kind,
    plan::{
        Trials,
        map::{Field, Map, map},
        search::{Grid, Wish, fewest as search, fewest_of_any_size as search_with_size, scaled},
    },
};
use serde_json::json;

use super::{
    Format, ModeArg, PlanArgs,
    load::{ApparentSize, load},
    optics, roundel,
};
use crate::{
    fusion::calibration::file::CalibrationFile,
    lab::plan::{
        DEFAULT_SPOTS,
        plan_map::{PlanMap, PlanSummary, usable_stations},
        planned_camera::{PlannedCamera, from_config as planned_camera},
    },
    model::config::Config,
};

/// What an installation sees.
pub(super) fn plan_installation(arguments: &PlanArgs, path: &Path) -> anyhow::Result<()> {
    let mut config = Config::load(path)?;
    // Where a calibration has found the cameras counts, as at a start of the server.
    if let Some(path) = config.server.calibration.clone()
        && let Some(mut kept) = CalibrationFile::load(&path)?
    {
        kept.merge_into(&mut config).iter().for_each(|why| eprintln!("{why}"));
    }
    if let Some(word) = arguments.mode {
        let mode = match word {
            ModeArg::Precise => roundel_core::marker::Mode::Precise,
            ModeArg::Fast => roundel_core::marker::Mode::Fast,
        };
        config.cameras.iter_mut().for_each(|camera| camera.mode = mode);
    }
    let kind = configured_kind(arguments, &config)?;
    let imaging = arguments.imaging();
    let trials = Trials::default();
    let cameras: Vec<PlannedCamera> =
        config.cameras.iter().map(|camera| planned_camera(camera, imaging, &trials)).collect();
    let stations = usable_stations(&cameras);
    if stations.is_empty() {
        let reasons: Vec<String> = cameras
            .iter()
            .filter_map(|camera| {
                Some(format!("{}: {}", camera.name, camera.station.as_ref().err()?))
            })
            .collect();
        bail!("expected a camera that stands at a known place, found none; {}", reasons.join("; "));
    }
    let seen = Field::seen_by(&stations, arguments.height(), DEFAULT_SPOTS).with_context(|| {
        format!("no camera looks down on the plane --height {} m", arguments.height())
    })?;
    let field = Field { step_m: arguments.step.unwrap_or(seen.step_m), ..seen };
    let map = PlanMap::of(&map(&stations, &kind, field)?, &kind.name, &cameras);
    let times = times(arguments, &kind, &cameras)?;
    print_plan(arguments, &ArenaPlan { kind, size: Size::Said, map, grid: None, times })
}

fn configured_kind(arguments: &PlanArgs, config: &Config) -> anyhow::Result<Kind> {
    if arguments.marker.is_some() {
        return Ok(Kind { name: "the roundel".to_owned(), ..arguments.kind()? });
    }
    if arguments.code.is_some() {
        bail!(
            "--code: expected --marker beside it, since the configuration says which roundels it has; --kind NAME takes \
             another of those"
        );
    }
    let Some(name) = &arguments.kind else {
        return config.kinds.first().cloned().context("expected a [[roundel]], found none");
    };
    let known: Vec<&str> = config.kinds.iter().map(|kind| kind.name.as_str()).collect();
    let found = config.kinds.iter().find(|kind| kind.name == *name);
    found.cloned().with_context(|| {
        format!("--kind: no roundel \"{name}\"; the configuration has {}", known.join(", "))
    })
}

/// The fewest cameras that do it.
pub(super) fn plan_arena(arguments: &PlanArgs, arena_m: [f64; 2]) -> anyhow::Result<()> {
    let (sensor, doubt, _) = optics::sensor(arguments)?;
    let kind = Kind { name: "the roundel".to_owned(), ..arguments.kind()? };
    let Some(mount_m) = arguments.mount else {
        bail!("how high can the cameras hang? Say --mount M, or --mount LOWEST:HIGHEST");
    };
    let half_m = arena_m.map(|side| 0.5 * side);
    let step_m = arguments.step.unwrap_or((arena_m[0] * arena_m[1] / DEFAULT_SPOTS as f64).sqrt());
    let field = Field {
        low_m: half_m.map(|half| -half),
        high_m: half_m,
        height_m: arguments.height(),
        step_m,
    };
    let most_m = arguments.most_m();
    let wish = Wish { field, mount_m, views: arguments.views, share: arguments.share, most_m };
    let (kind, size, grid) = match (arguments.marker, most_m) {
        (None, Some(_)) => {
            let (outer_m, grid) = search_with_size(&sensor, doubt.as_ref(), &kind, &wish)?;
            (scaled(&kind, outer_m), Size::Searched, grid)
        }
        (marker, _) => {
            let size = if marker.is_some() { Size::Said } else { Size::Assumed };
            let grid = search(&sensor, doubt.as_ref(), &kind, &wish)?;
            (kind, size, grid)
        }
    };
    let cameras: Vec<PlannedCamera> = (1..)
        .zip(&grid.stations)
        .map(|(number, station)| PlannedCamera {
            name: number.to_string(),
            station: Ok(Box::new(station.clone())),
        })
        .collect();
    let fine: Map = map(&grid.stations, &kind, field)?;
    let map = PlanMap::of(&fine, &kind.name, &cameras);
    let times = times(arguments, &kind, &cameras)?;
    print_plan(arguments, &ArenaPlan { kind, size, map, grid: Some(grid), times })
}

/// Where the roundel's size comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Size {
    Said,
    /// Of an arena whose roundels nobody has described the usual ones; of an installation never.
    Assumed,
    /// Searched for, since only what it has to do is said.
    Searched,
}

/// Everything that is told.
struct ArenaPlan {
    kind: Kind,
    size: Size,
    map: PlanMap,
    grid: Option<Grid>,
    times: FrameTimes,
}

/// What frames take.
struct FrameTimes {
    /// Of the camera that takes longest, its name, and of all together, seconds.
    longest_s: f64,
    longest: String,
    together_s: f64,
    /// Where the constants come from.
    machine: String,
}

/// Of frames in which as many roundels as are said lie straight below each camera, where they are largest.
fn times(
    arguments: &PlanArgs,
    kind: &Kind,
    cameras: &[PlannedCamera],
) -> anyhow::Result<FrameTimes> {
    let (machine, from) = arguments.machine()?;
    let mut times =
        FrameTimes { longest_s: 0.0, longest: String::new(), together_s: 0.0, machine: from };
    for camera in cameras {
        let Ok(station) = &camera.station else { continue };
        let lens = station.sensor.camera.intrinsics();
        let above_m = station.place.world_from_camera.translation.vector.z - arguments.height();
        let per_m = 0.5 * (lens.fx_px + lens.fy_px) / above_m.abs().max(kind.outer_diameter_m);
        let seen = ApparentSize { diameter_px: per_m * kind.outer_diameter_m, per_m };
        let load = load(arguments, &station.sensor, kind, seen)?;
        let frame_s = machine.of(station.sensor.mode).frame_s(&load);
        times.together_s += frame_s;
        if frame_s > times.longest_s {
            (times.longest_s, times.longest) = (frame_s, camera.name.clone());
        }
    }
    Ok(times)
}

fn print_plan(arguments: &PlanArgs, plan: &ArenaPlan) -> anyhow::Result<()> {
    let ArenaPlan { kind, size, map, grid, times } = plan;
    let text = match arguments.format {
        Format::Json => {
            let grid = grid.as_ref().map(|grid| {
                json!({"counts": grid.counts, "mount_m": grid.mount_m, "turned": grid.is_turned})
            });
            format!(
                "{:#}\n",
                json!({
                    "roundel": map.roundel,
                    "outer_m": kind.outer_diameter_m,
                    "inner_m": kind.inner_diameter_m,
                    "code": roundel::code(kind),
                    "size_is_assumed": *size == Size::Assumed,
                    "outer_was_searched": *size == Size::Searched,
                    "height_m": map.height_m,
                    "min_m": map.min_m,
                    "max_m": map.max_m,
                    "summary": map.summary,
                    "stations": map.stations,
                    "grid": grid,
                    "longest_frame_s": times.longest_s,
                    "frames_together_s": times.together_s,
                    "times": times.machine,
                })
            )
        }
        Format::Table => table(arguments, plan),
    };
    std::io::stdout().write_all(text.as_bytes()).context("cannot write to the standard output")?;
    arguments.write_map(map)
}

fn table(arguments: &PlanArgs, ArenaPlan { kind, size, map, grid, times }: &ArenaPlan) -> String {
    let size = match size {
        Size::Said => "",
        Size::Assumed => ", assumed since --marker says none",
        Size::Searched => ", searched for: so few cameras do it",
    };
    let mut lines = vec![format!("{}: {}{size}", map.roundel, roundel::words(kind))];
    if let Some(grid) = grid {
        let [columns, rows] = grid.counts;
        lines.push(format!(
            "{}, {:.2} m high, straight down, the picture's top towards {}",
            match columns * rows {
                1 => "1 camera in the middle".to_owned(),
                count => format!("{count} cameras: {columns} along x, {rows} along y"),
            },
            grid.mount_m,
            if grid.is_turned { "-x" } else { "+y" }
        ));
    }
    for station in &map.stations {
        lines.push(match station.position_m {
            Some([x, y, z]) => {
                let share = match station.seen_share {
                    Some(share) if share > 0.0 => format!("sees {:.1} % of the map", share * 100.0),
                    _ => "sees nothing of the map".to_owned(),
                };
                format!("  {:12} at {x:7.2} {y:7.2} {z:6.2} m, {share}", station.name)
            }
            None => format!("  {:12} left out: {}", station.name, station.reason),
        });
    }
    let PlanSummary { seen_share, twice_share, median_m, p95_m } = &map.summary;
    let millimetres = |value: &Option<f64>| {
        value.map_or("-".to_owned(), |value| format!("{:.3} mm", value * 1e3))
    };
    let sides = [0, 1].map(|axis| map.max_m[axis] - map.min_m[axis]);
    lines.push(format!(
        "{:.1} x {:.1} m at {} m: {:.1} % {}, {:.1} % by two and more; rms error {} (median), {} (95 %)",
        sides[0],
        sides[1],
        map.height_m,
        seen_share * 100.0,
        if roundel::is_coded(kind) { "seen and the code read" } else { "seen" },
        twice_share * 100.0,
        millimetres(median_m),
        millimetres(p95_m)
    ));
    if map.summary.seen_share == 0.0 {
        lines.push(
            "No spot there is seen well enough, so that there is nothing to tell of times."
                .to_owned(),
        );
        lines.push(String::new());
        return lines.join("\n");
    }
    let FrameTimes { longest_s, longest, together_s, machine } = times;
    lines.push(format!(
        "a frame with {} of them straight below: at most {:.3} ms (camera {longest}); all cameras at {} Hz keep {:.2} of a core busy",
        arguments.count(),
        longest_s * 1e3,
        arguments.rate(),
        together_s * arguments.rate()
    ));
    lines.push(format!("Times are {machine}."));
    lines.push(String::new());
    lines.join("\n")
}
