//! Trajectories of other systems.

use std::collections::BTreeMap;

use roundel_server::archive::eval::{
    Trajectory,
    estimate::{RecordedObject, RecordedTrajectories},
    metrics::{EvalSettings, evaluate},
    truth,
};

/// Times increase, numbers are finite, and a recording of the same trajectories can be compared with them.
pub fn run(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let trajectories = match truth::read("truth.csv", text) {
        Ok(trajectories) => trajectories,
        Err(error) => {
            assert!(error.to_string().starts_with("truth.csv:"), "{error}");
            return;
        }
    };
    for Trajectory { samples, .. } in &trajectories {
        assert!(samples.windows(2).all(|pair| pair[0].time < pair[1].time));
        for sample in samples {
            assert!(sample.position_m.iter().all(|number| number.is_finite()));
            let turn = sample.orientation.map_or(1.0, |turn| turn.norm());
            assert!((turn - 1.0).abs() < 1e-9, "{turn}");
        }
    }
    let object = |trajectory: &Trajectory| RecordedObject {
        trajectory: trajectory.clone(),
        ..RecordedObject::default()
    };
    let objects: BTreeMap<u64, RecordedObject> =
        (1..).zip(trajectories.iter().map(object)).collect();
    let mut times: Vec<_> =
        trajectories.iter().flat_map(|it| &it.samples).map(|sample| sample.time).collect();
    times.sort_unstable();
    let recorded = RecordedTrajectories { objects, times, ..RecordedTrajectories::default() };
    let _ = evaluate(&recorded, &trajectories, &EvalSettings::default());
}
