//! Several cameras over an arena: those of an installation, or the fewest that do it.

use std::{io::Write as _, path::Path};

use anyhow::{Context, bail};
use roundel_core::{
    marker::Kind,
    plan::{
        map::{Field, Map, map},
        search::{Grid, Wish, fewest as search},
    },
};
use serde_json::json;

use super::{Format, ModeWord, PlanArgs, optics, roundel};
use crate::{
    calibration::file::CalibrationFile,
    config::Config,
    plan::{
        SPOTS,
        report::{PlanMap, PlanSummary, used},
        station::{Named, configured as station},
    },
};

/// What an installation sees.
pub(super) fn configured(arguments: &PlanArgs, path: &Path) -> anyhow::Result<()> {
    let mut config = Config::load(path)?;
    // Where a calibration has found the cameras counts, as at a start of the server.
    if let Some(path) = config.server.calibration.clone()
        && let Some(mut kept) = CalibrationFile::load(&path)?
    {
        kept.merge_into(&mut config).iter().for_each(|why| eprintln!("{why}"));
    }
    if let Some(word) = arguments.mode {
        let mode = match word {
            ModeWord::Precise => roundel_core::marker::Mode::Precise,
            ModeWord::Fast => roundel_core::marker::Mode::Fast,
        };
        config.cameras.iter_mut().for_each(|camera| camera.mode = mode);
    }
    let kind = configured_kind(arguments, &config)?;
    let imaging = arguments.imaging();
    let cameras: Vec<Named> =
        config.cameras.iter().map(|camera| station(camera, imaging)).collect();
    let stations = used(&cameras);
    if stations.is_empty() {
        let reasons: Vec<String> = cameras
            .iter()
            .filter_map(|camera| {
                Some(format!("{}: {}", camera.name, camera.station.as_ref().err()?))
            })
            .collect();
        bail!("expected a camera that stands at a known place, found none; {}", reasons.join("; "));
    }
    let seen = Field::seen_by(&stations, arguments.height, SPOTS).with_context(|| {
        format!("no camera looks down on the plane --height {} m", arguments.height)
    })?;
    let field = Field { step_m: arguments.step.unwrap_or(seen.step_m), ..seen };
    let map = PlanMap::of(&map(&stations, &kind, field)?, &kind.name, &cameras);
    told(arguments, &kind, &map, None)
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
pub(super) fn fewest(arguments: &PlanArgs, arena_m: [f64; 2]) -> anyhow::Result<()> {
    let (sensor, doubt, _) = optics::sensor(arguments)?;
    let kind = Kind { name: "the roundel".to_owned(), ..arguments.kind()? };
    let Some(mount_m) = arguments.mount else {
        bail!("how high can the cameras hang? Say --mount M, or --mount LOWEST:HIGHEST");
    };
    let half_m = arena_m.map(|side| 0.5 * side);
    let step_m = arguments.step.unwrap_or((arena_m[0] * arena_m[1] / SPOTS as f64).sqrt());
    let field = Field {
        low_m: half_m.map(|half| -half),
        high_m: half_m,
        height_m: arguments.height,
        step_m,
    };
    let most_m = arguments.precision.map(|mm| mm * 1e-3);
    let wish = Wish { field, mount_m, views: arguments.views, share: arguments.share, most_m };
    let grid = search(&sensor, doubt.as_ref(), &kind, &wish)?;
    let cameras: Vec<Named> = (1..)
        .zip(&grid.stations)
        .map(|(number, station)| Named {
            name: number.to_string(),
            station: Ok(Box::new(station.clone())),
        })
        .collect();
    let fine: Map = map(&grid.stations, &kind, field)?;
    let map = PlanMap::of(&fine, &kind.name, &cameras);
    told(arguments, &kind, &map, Some(&grid))
}

fn told(
    arguments: &PlanArgs,
    kind: &Kind,
    map: &PlanMap,
    grid: Option<&Grid>,
) -> anyhow::Result<()> {
    // Of an arena whose roundels nobody has described the usual ones are assumed; of an installation never.
    let is_assumed = grid.is_some() && arguments.marker.is_none();
    let text = match arguments.format {
        Format::Json => {
            let grid = grid.map(|grid| {
                json!({"counts": grid.counts, "mount_m": grid.mount_m, "turned": grid.is_turned})
            });
            format!(
                "{:#}\n",
                json!({
                    "roundel": map.roundel,
                    "outer_m": kind.outer_diameter_m,
                    "inner_m": kind.inner_diameter_m,
                    "code": roundel::code(kind),
                    "size_is_assumed": is_assumed,
                    "height_m": map.height_m,
                    "min_m": map.min_m,
                    "max_m": map.max_m,
                    "summary": map.summary,
                    "stations": map.stations,
                    "grid": grid,
                })
            )
        }
        Format::Table => table((kind, is_assumed), map, grid),
    };
    std::io::stdout().write_all(text.as_bytes()).context("cannot write to the standard output")?;
    arguments.write_map(map)
}

fn table((kind, is_assumed): (&Kind, bool), map: &PlanMap, grid: Option<&Grid>) -> String {
    let assumed = if is_assumed { ", assumed since --marker says none" } else { "" };
    let mut lines = vec![format!("{}: {}{assumed}", map.roundel, roundel::words(kind))];
    if let Some(grid) = grid {
        let [columns, rows] = grid.counts;
        lines.push(format!(
            "{} cameras: {columns} along x, {rows} along y, {:.2} m high, straight down, the picture's top towards {}",
            columns * rows,
            grid.mount_m,
            if grid.is_turned { "-x" } else { "+y" }
        ));
    }
    for station in &map.stations {
        lines.push(match station.position_m {
            Some([x, y, z]) => format!("  {:12} at {x:7.2} {y:7.2} {z:6.2} m", station.name),
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
    lines.push(String::new());
    lines.join("\n")
}
