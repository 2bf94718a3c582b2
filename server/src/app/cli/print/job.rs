//! What is to be printed, as told on the command line or by an installation's configuration.

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

/// What the arguments ask for.
pub(super) fn print_job(arguments: &PrintArgs) -> anyhow::Result<PrintJob> {
    if let Some(sides) = arguments.board {
        let layout = arguments.code.unwrap_or(BOARD_LAYOUT);
        return Ok(PrintJob::Board(PrintJob::board(
            sides,
            arguments.marker,
            arguments.pitch,
            layout,
        )?));
    }
    let numbers = arguments.ids.as_ref();
    let items = match (&arguments.config, arguments.marker) {
        (Some(file), _) => items_of_config(
            &Config::load_without_cameras(file)?,
            arguments.kind.as_deref(),
            numbers,
        )?,
        (None, Some(_)) => {
            let polarity = arguments.polarity.unwrap_or_default().into();
            let (diameters, code) = (arguments.marker, arguments.code);
            PrintJob::roundels(&PrintSpec { diameters, code, polarity }, numbers)?
        }
        (None, None) => bail!(
            "expected --marker OUTER_MM[:INNER_MM] for the size, --config FILE for what an installation \
             uses, or --board COLUMNSxROWS"
        ),
    };
    Ok(PrintJob::Roundels(items).copies(arguments.copies.unwrap_or(1).into()))
}

/// What was printed, in words; `prints`: outlines on all pages.
pub(super) fn describe(order: &PrintJob, prints: usize) -> String {
    let roundels = |count: usize| match count {
        1 => "one roundel".to_owned(),
        _ => format!("{count} roundels"),
    };
    match order {
        PrintJob::Roundels(items) if prints > items.len() => {
            format!("{} over several pages", roundels(items.len()))
        }
        PrintJob::Roundels(items) => roundels(items.len()),
        PrintJob::Board(board) => {
            format!("a board of {} x {} roundels", board.columns(), board.rows())
        }
    }
}

/// What has to be said of them elsewhere: the lines of a configuration, or the next command.
pub(super) fn next_steps(order: &PrintJob) -> Vec<String> {
    match order {
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

/// What the objects and references of an installation carry, by kind, or of one kind the numbers given.
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
        bail!("--ids are numbers of one kind's codes: say which with --kind NAME");
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

/// The codes of a kind that are on something named, by number, with its name.
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
