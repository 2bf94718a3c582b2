//! `roundel plan --measure`: what this machine takes for a frame.

use std::{fs, io::Write as _, path::Path};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use roundel_core::plan::time::{Constants, TERM_NAMES, TERMS};
use serde_json::{Map, Value, json};

use super::{Format, PlanArgs};
use crate::{
    app::cli::check_writable,
    lab::plan::{
        machine_timings::{MachineTimings, default_path, measure},
        timing::TimingSample,
    },
};

pub(super) fn run(arguments: &PlanArgs) -> anyhow::Result<()> {
    let usual = || default_path(arguments.config.as_deref());
    let path = arguments.machine.clone().or_else(usual).context(
        "where to keep it? There is neither HOME nor XDG_CONFIG_HOME: say --machine FILE",
    )?;
    create_parent_folder(&path)
        .with_context(|| format!("--machine {} cannot be written", path.display()))?;
    eprintln!("Measuring for about a minute: let nothing else run meanwhile.");
    let style = ProgressStyle::with_template("measuring {bar:30} {pos}/{len} {eta}")
        .context("a template of our own")?;
    let bar = ProgressBar::new(0).with_style(style);
    let (machine, measured) = measure(|done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    machine.save(&path)?;
    let text = match arguments.format {
        Format::Json => format!("{:#}\n", report(&machine, &measured)),
        Format::Table => table(&machine, &measured),
    };
    std::io::stdout().write_all(text.as_bytes()).context("cannot write to the standard output")?;
    eprintln!("wrote {}", path.display());
    Ok(())
}

/// Whether the times can be kept there, before a minute is spent on them; makes the folder that they are kept in.
fn create_parent_folder(path: &Path) -> std::io::Result<()> {
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder)?;
    }
    check_writable(path)
}

fn report(machine: &MachineTimings, measured: &[TimingSample]) -> serde_json::Value {
    let each: Vec<_> = measured
        .iter()
        .map(|one| {
            json!({
                "mode": format!("{:?}", one.mode).to_lowercase(),
                "image_px": one.load.image_px,
                "roundels": one.load.roundels,
                "diameter_px": one.load.diameter_px,
                "motion_px": one.load.motion_px,
                "coded": one.load.is_coded,
                "searched_share": one.load.searched_share,
                "measured_s": one.time_s,
                "model_s": machine.of(one.mode).frame_s(&one.load),
            })
        })
        .collect();
    let [precise, fast] = [&machine.precise, &machine.fast].map(constants);
    json!({"precise_s": precise, "fast_s": fast, "measured": each})
}

fn constants(of: &Constants) -> Value {
    let named = |terms: &[f64; TERMS]| -> Map<String, Value> {
        let each = TERM_NAMES.into_iter().zip(terms);
        each.map(|(name, seconds)| (name.to_owned(), json!(seconds))).collect()
    };
    json!({"followed": named(&of.followed), "searched": named(&of.searched)})
}

fn table(machine: &MachineTimings, measured: &[TimingSample]) -> String {
    let mut text = "mode     megapixels  roundels         px  px a frame  searched  measured ms  model/measured\n"
        .to_owned();
    for one in measured {
        let load = &one.load;
        text.push_str(&format!(
            "{:8} {:10.2}  {:8.1}  {:6} {:3.0}  {:10.1}  {:8}  {:11.3}  {:14.2}\n",
            format!("{:?}", one.mode).to_lowercase(),
            load.image_px * 1e-6,
            load.roundels,
            if load.is_coded { "coded" } else { "" },
            load.diameter_px,
            load.motion_px,
            if load.searched_share > 0.0 { "yes" } else { "" },
            one.time_s * 1e3,
            machine.of(one.mode).frame_s(load) / one.time_s,
        ));
    }
    text
}
