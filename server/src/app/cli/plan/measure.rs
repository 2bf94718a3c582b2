//! `roundel plan --measure`: time per frame of some typical cases on this computer.

use roundel_core::{
    marker::{CodeLayout, Kind, Mode, Pattern},
    plan::Imaging,
};
use serde_json::json;

use super::Format;
use crate::{
    lab::plan::timing::TimingCase,
    model::config::{MODES, word},
};

/// Columns and rows, number of roundels, diameter and motion per frame in pixels, and whether they are coded.
type Situation = ((usize, usize), usize, f64, f64, bool);

const SITUATIONS: [Situation; 5] = [
    ((640, 480), 10, 24.0, 1.0, false),
    ((1280, 720), 24, 20.0, 1.5, false),
    ((1920, 1080), 24, 40.0, 3.0, false),
    ((1920, 1080), 100, 24.0, 1.0, false),
    ((1920, 1080), 24, 50.0, 1.5, true),
];

pub(super) fn run(format: Format) -> anyhow::Result<()> {
    let mut rows = Vec::new();
    let mut text = "mode     megapixels  roundels         px  px / frame  searched  median ms  95th percentile ms\n".to_owned();
    for (size, roundels, diameter_px, motion_px, is_coded) in SITUATIONS {
        let kind = if is_coded {
            let pattern = Pattern::Coded(CodeLayout { bits: 8, min_distance: 1 });
            Kind { pattern, ..Kind::plain("robot", 0.16, 0.16 * CodeLayout::RATIO) }
        } else {
            Kind::plain("robot", 0.16, 0.064)
        };
        for mode in [Mode::Precise, Mode::Fast] {
            let (kind, imaging) = (kind.clone(), Imaging::default());
            let case = TimingCase { size, kind, mode, imaging, roundels, diameter_px, motion_px };
            let times = case.measure()?;
            let (mode, image_px) = (word(&MODES, mode), size.0 * size.1);
            for searched_share in [0.0, 1.0] {
                let (median_s, p95_s) =
                    (times.median_s(searched_share), times.p95_s(searched_share));
                text += &format!(
                    "{mode:8} {:10.2}  {:8}  {:6} {diameter_px:3.0}  {motion_px:10.1}  {:8}  {:9.3}  {:18.3}\n",
                    image_px as f64 * 1e-6,
                    times.followed,
                    if is_coded { "coded" } else { "" },
                    if searched_share > 0.0 { "yes" } else { "" },
                    median_s * 1e3,
                    p95_s * 1e3,
                );
                // `model_s` remains for programs that read earlier reports, which compared a fitted model.
                rows.push(json!({
                    "mode": mode,
                    "image_px": image_px,
                    "roundels": times.followed,
                    "diameter_px": diameter_px,
                    "motion_px": motion_px,
                    "coded": is_coded,
                    "searched_share": searched_share,
                    "measured_s": median_s,
                    "p95_s": p95_s,
                    "model_s": median_s,
                }));
            }
        }
    }
    let report = json!({"precise_s": null, "fast_s": null, "measured": rows});
    format.print(&report, |_| text)
}
