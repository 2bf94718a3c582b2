//! The print job that the command line or an installation's configuration describes.

use anyhow::bail;
use roundel_core::{
    id::KindId,
    marker::{CodeLayout, Pattern},
};

use super::PrintArgs;
use crate::{
    lab::print::{
        BOARD_LAYOUT, PrintItem, PrintJob, coded_item, config_lines, items_of_kind, millimetres,
        spec::{CodeNumbers, PrintSpec},
    },
    model::{
        config::{Config, ObjectRoundels},
        suggestion::list,
    },
};

pub(super) fn print_job(arguments: &PrintArgs) -> anyhow::Result<PrintJob> {
    let &PrintArgs { board, marker: diameters, pitch, code, .. } = arguments;
    if let Some(sides) = board {
        let board = PrintJob::board(sides, diameters, pitch, code.unwrap_or(BOARD_LAYOUT))?;
        return Ok(PrintJob::Board(board));
    }
    let numbers = arguments.ids.as_ref();
    let items = if let Some(file) = &arguments.config {
        let config = Config::load_without_cameras(file)?;
        items_of_config(&config, arguments.kind.as_deref(), numbers)?
    } else if diameters.is_some() {
        let polarity = arguments.polarity.unwrap_or_default().into();
        PrintJob::roundels(&PrintSpec { diameters, code, polarity }, numbers)?
    } else {
        bail!(
            "expected --marker OUTER_MM[:INNER_MM], --config FILE for the roundels of an installation, or \
             --board COLUMNSxROWS"
        )
    };
    Ok(PrintJob::Roundels(items).copies(arguments.copies.unwrap_or(1).into()))
}

/// Describes the job; `prints` counts the outlines on all pages.
pub(super) fn describe(job: &PrintJob, prints: usize) -> String {
    match job {
        PrintJob::Roundels(items) => {
            let roundels = match items.len() {
                1 => "one roundel".to_owned(),
                count => format!("{count} roundels"),
            };
            let spread = if prints > items.len() { " over several pages" } else { "" };
            roundels + spread
        }
        PrintJob::Board(board) => {
            format!("a board of {} x {} roundels", board.columns(), board.rows())
        }
    }
}

/// The lines for the configuration, or the next command.
pub(super) fn next_steps(job: &PrintJob) -> Vec<String> {
    match job {
        PrintJob::Board(board) => {
            let kind = board.kind();
            let Pattern::Coded(CodeLayout { bits, min_distance }) = kind.pattern else {
                return Vec::new();
            };
            vec![format!(
                "Then: roundel calibrate lens --board {}x{} --marker {} --pitch {} --code {bits}:{min_distance} \
                 --output CAMERA.yaml SOURCE",
                board.columns(),
                board.rows(),
                millimetres(kind.outer_diameter_m * 1e3),
                millimetres(board.pitch_m() * 1e3),
            )]
        }
        PrintJob::Roundels(items) => match items.first() {
            Some(item) if item.kind.name.is_empty() => {
                let lines = config_lines(&item.kind).into_iter().map(|line| format!("  {line}"));
                std::iter::once("In the configuration:".to_owned()).chain(lines).collect()
            }
            _ => Vec::new(),
        },
    }
}

/// The roundels that the objects and references of an installation carry, by kind; with `wanted`, only that kind.
fn items_of_config(
    config: &Config,
    wanted: Option<&str>,
    numbers: Option<&CodeNumbers>,
) -> anyhow::Result<Vec<PrintItem>> {
    let names = || config.kinds.iter().map(|kind| kind.name.as_str());
    if let Some(name) = wanted
        && !names().any(|known| known == name)
    {
        bail!("no kind of roundel is called \"{name}\"; there are {}", list(names()));
    }
    if numbers.is_some() && wanted.is_none() && config.kinds.len() > 1 {
        bail!("--ids are code numbers of one kind: select it with --kind NAME");
    }
    let mut items = Vec::new();
    for (kind, id) in config.kinds.iter().zip((0..).map(KindId)) {
        if wanted.is_some_and(|name| name != kind.name) {
            continue;
        }
        let carried = carried(config, id);
        if numbers.is_none() && !carried.is_empty() {
            items
                .extend(carried.iter().map(|(number, name)| coded_item(kind, *number, Some(name))));
        } else {
            items.extend(items_of_kind(kind, numbers)?);
        }
    }
    Ok(items)
}

/// Numbers of a kind's codes that an object or reference carries, with its name.
fn carried(config: &Config, kind: KindId) -> Vec<(u16, String)> {
    let mut carried = Vec::new();
    for object in &config.objects {
        if let ObjectRoundels::Body(body) = &object.carries {
            let of_kind = body.mounts.iter().filter(|mount| mount.kind == kind);
            let numbers = of_kind.filter_map(|mount| Some(mount.code?.number));
            carried.extend(numbers.map(|number| (number, object.name.clone())));
        }
    }
    let references = config.references.iter().filter(|reference| reference.kind == kind);
    let numbers = references.filter_map(|reference| Some(reference.code?.number));
    carried.extend(numbers.map(|number| (number, "reference".to_owned())));
    carried.sort();
    carried.dedup();
    carried
}
