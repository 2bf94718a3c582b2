//! Several cameras over an arena: the cameras of an installation, or the fewest that meet the requirements.

use std::path::Path;

use anyhow::{Context, bail};
use roundel_core::{
    marker::{Kind, Pattern},
    plan::{
        TrialCache,
        map::{MapArea, map},
        search::{Layout, Requirements, fewest_cameras, fewest_cameras_of_any_size, scaled},
    },
};
use serde_json::{Value, json};

use super::{
    PlanArgs,
    inputs::{self, timing_case},
    report::{self, times_source},
};
use crate::{
    fusion::calibration::file::CalibrationFile,
    lab::plan::{
        map_area,
        plan_map::{PlanMap, PlanSummary},
        planned_camera::{PlannedCamera, from_config as planned_camera, usable_stations},
        timing::{FrameTimes, TimingCase},
    },
    model::config::Config,
};

/// Plans with the cameras of a configuration.
pub(super) fn plan_installation(arguments: &PlanArgs, path: &Path) -> anyhow::Result<PlanMap> {
    let mut config = Config::load(path)?;
    // Poses from a stored calibration take precedence, as when the server starts.
    if let Some(path) = config.server.calibration.clone()
        && let Some(mut kept) = CalibrationFile::load(&path)?
    {
        kept.merge_into(&mut config).iter().for_each(|why| eprintln!("{why}"));
    }
    if let Some(mode) = arguments.mode {
        config.cameras.iter_mut().for_each(|camera| camera.mode = mode);
    }
    let kind = configured_kind(arguments, &config)?;
    let imaging = arguments.imaging();
    let trials = TrialCache::default();
    let cameras: Vec<PlannedCamera> =
        config.cameras.iter().map(|camera| planned_camera(camera, imaging, &trials)).collect();
    let stations = usable_stations(&cameras).map_err(anyhow::Error::msg)?;
    let height_m = arguments.height();
    let corners_m = MapArea::seen_corners_m(&stations, height_m)
        .with_context(|| format!("no camera sees the plane --height {height_m} m from above"))?;
    let area = map_area(corners_m, height_m, arguments.step);
    let map = PlanMap::of(&map(&stations, &kind, area)?, &kind.name, &cameras);
    ArenaPlan { kind, size: Size::Given, map, grid: None }.report(arguments, &cameras)
}

fn configured_kind(arguments: &PlanArgs, config: &Config) -> anyhow::Result<Kind> {
    if arguments.marker.is_some() {
        return Ok(Kind { name: "the roundel".to_owned(), ..arguments.kind()? });
    }
    if arguments.code.is_some() {
        bail!(
            "--code: expected --marker as well, since configured roundels have their own codes; --kind NAME selects one of \
             them"
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

/// Searches for the fewest cameras, and without `--marker` also for the roundel.
pub(super) fn plan_arena(arguments: &PlanArgs, arena_m: [f64; 2]) -> anyhow::Result<PlanMap> {
    let (sensor, _) = inputs::sensor(arguments)?;
    let kind = Kind { name: "the roundel".to_owned(), ..arguments.kind()? };
    let mount_m = arguments.mount.context(
        "--arena: expected the mounting height of the cameras: add --mount M, or --mount LOWEST:HIGHEST",
    )?;
    let corners_m = [-0.5, 0.5].map(|share| arena_m.map(|side| share * side));
    let area = map_area(corners_m, arguments.height(), arguments.step);
    let requirements = Requirements {
        area,
        mount_m,
        views: arguments.views,
        share: arguments.share,
        max_m: arguments.most_m(),
    };
    let (size, grid) = match arguments.marker {
        None if requirements.max_m.is_some() => {
            (Size::Searched, fewest_cameras_of_any_size(&sensor, &kind, &requirements)?)
        }
        None => (Size::Assumed, fewest_cameras(&sensor, &kind, &requirements)?),
        Some(_) => (Size::Given, fewest_cameras(&sensor, &kind, &requirements)?),
    };
    let kind = scaled(&kind, grid.outer_m);
    let cameras: Vec<PlannedCamera> = (1..)
        .zip(&grid.stations)
        .map(|(number, station)| PlannedCamera {
            name: number.to_string(),
            station: Ok(Box::new(station.clone())),
        })
        .collect();
    let map = PlanMap::of(&map(&grid.stations, &kind, area)?, &kind.name, &cameras);
    ArenaPlan { kind, size, map, grid: Some(grid.layout) }.report(arguments, &cameras)
}

/// Origin of the roundel's size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Size {
    Given,
    /// The default.
    Assumed,
    Searched,
}

struct ArenaPlan {
    kind: Kind,
    size: Size,
    map: PlanMap,
    grid: Option<Layout>,
}

/// Measures each camera's frames with `--count` roundels straight below it, where they appear largest.
fn measure<'a>(
    arguments: &PlanArgs,
    kind: &Kind,
    cameras: &'a [PlannedCamera],
) -> anyhow::Result<Vec<(&'a str, TimingCase, FrameTimes)>> {
    let mut all: Vec<(&str, TimingCase, FrameTimes)> = Vec::new();
    for camera in cameras {
        let Ok(station) = &camera.station else { continue };
        let lens = station.sensor.camera.intrinsics();
        let above_m = station.place.world_from_camera.translation.vector.z - arguments.height();
        let px_per_m = 0.5 * (lens.fx_px + lens.fy_px) / above_m.abs().max(kind.outer_diameter_m);
        // In steps of 5 %, so that similar cameras are timed once.
        let px_per_m = ((px_per_m.ln() / 0.05).round() * 0.05).exp();
        let diameter_px = px_per_m * kind.outer_diameter_m;
        let case = timing_case(arguments, &station.sensor, kind, diameter_px, px_per_m)?;
        let times = match all.iter().find(|(_, timed, _)| *timed == case) {
            Some((_, _, times)) => times.clone(),
            None => case.measure()?,
        };
        all.push((&camera.name, case, times));
    }
    Ok(all)
}

impl ArenaPlan {
    /// Prints the report and returns the map.
    fn report(self, arguments: &PlanArgs, cameras: &[PlannedCamera]) -> anyhow::Result<PlanMap> {
        let Self { kind, size, map, grid } = &self;
        let lost = arguments.lost();
        let all = measure(arguments, kind, cameras)?;
        let together_s: f64 = all.iter().map(|(_, _, times)| times.median_s(lost)).sum();
        let longest = all.iter().max_by(|a, b| a.2.median_s(lost).total_cmp(&b.2.median_s(lost)));
        let (name, _, longest) = longest.context("expected a camera, found none")?;
        let grid = grid.map(|Layout { counts, mount_m, is_turned }| {
            json!({"counts": counts, "mount_m": mount_m, "turned": is_turned})
        });
        let report = json!({
            "roundel": map.roundel,
            "outer_m": kind.outer_diameter_m,
            "inner_m": kind.inner_diameter_m,
            "code": report::code(kind),
            "size_is_assumed": *size == Size::Assumed,
            "outer_was_searched": *size == Size::Searched,
            "height_m": map.height_m,
            "min_m": map.min_m,
            "max_m": map.max_m,
            "summary": map.summary,
            "stations": map.stations,
            "grid": grid,
            "longest_frame_s": longest.median_s(lost),
            "longest_frame_p95_s": longest.p95_s(lost),
            "frames_together_s": together_s,
            "times": times_source(arguments, longest),
        });
        let table = |_: &Value| self.table(arguments, name, longest, together_s);
        arguments.format.print(&report, table)?;
        Ok(self.map)
    }

    fn table(
        &self,
        arguments: &PlanArgs,
        name: &str,
        longest: &FrameTimes,
        together_s: f64,
    ) -> String {
        let Self { kind, size, map, grid } = self;
        let size = match size {
            Size::Given => "",
            Size::Assumed => " (default size; --marker sets another one)",
            Size::Searched => " (the size that needs the fewest cameras)",
        };
        let mut lines = vec![format!("{}: {}{size}", map.roundel, report::roundel(kind))];
        if let Some(Layout { counts: [columns, rows], mount_m, is_turned }) = *grid {
            lines.push(format!(
                "{}, at {:.2} m, looking straight down, top of the image towards {}",
                match columns * rows {
                    1 => "1 camera in the middle".to_owned(),
                    count => format!("{count} cameras: {columns} along x, {rows} along y"),
                },
                mount_m,
                if is_turned { "-x" } else { "+y" }
            ));
        }
        for station in &map.stations {
            lines.push(match station.position_m {
                Some([x, y, z]) => {
                    let share = match station.seen_share {
                        Some(share) if share > 0.0 => {
                            format!("sees {:.1} % of the map", share * 100.0)
                        }
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
        let is_coded = matches!(kind.pattern, Pattern::Coded(_));
        let [wide, deep] = [0, 1].map(|axis| map.max_m[axis] - map.min_m[axis]);
        lines.push(format!(
            "{wide:.1} x {deep:.1} m at {} m: {:.1} % {}, {:.1} % by two or more; rms error {} (median), {} (95 %)",
            map.height_m,
        seen_share * 100.0,
        if is_coded { "seen and the code read" } else { "seen" },
        twice_share * 100.0,
        millimetres(median_m),
        millimetres(p95_m)
    ));
        if map.summary.seen_share > 0.0 {
            let lost = arguments.lost();
            lines.push(format!(
                "time per frame with {} roundels straight below: median {:.3} ms, 95th percentile {:.3} ms (slowest camera, \
                 {name}); all cameras at {} Hz load {:.2} cores",
                arguments.count(),
                longest.median_s(lost) * 1e3,
                longest.p95_s(lost) * 1e3,
                arguments.rate(),
                together_s * arguments.rate()
            ));
            lines.push(format!("Times are {}.", times_source(arguments, longest)));
        } else {
            lines.push("No spot is seen well enough, so no times are reported.".to_owned());
        }
        lines.join("\n") + "\n"
    }
}
