//! Opens what servers left on the disk: configuration, calibration, history and recordings.

use std::{fs, path::Path};

use roundel_core::time::Timestamp;
use roundel_server::{
    archive::{
        history::store::{HistoryQuery, MAX_POINTS, Store},
        record::{file_reader::FileReader, schema::Topic},
    },
    fusion::calibration::file::CalibrationFile,
    model::config::Config,
};

use super::operator::Confirmed;

/// What may be wrong with files.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// All servers were stopped, and the disk always worked: recordings are complete.
    pub complete_recordings: bool,
    /// The disk always worked, so something was stored.
    pub stored: bool,
}

/// Problems with the files in a folder.
pub fn problems(folder: &Path, confirmed: &Confirmed, expected: Expected) -> Vec<String> {
    let mut problems = Vec::new();
    match Config::load(&folder.join("lab.toml")) {
        Ok(config) => check_objects(&config, confirmed, &mut problems),
        Err(error) => problems.push(format!("the configuration cannot be opened: {error:?}")),
    }
    if let Err(error) = CalibrationFile::load(&folder.join("lab.calibration.toml")) {
        problems.push(format!("the calibration cannot be opened: {error}"));
    }
    check_history(folder, expected, &mut problems);
    check_recordings(&folder.join("recordings"), expected, &mut problems);
    problems
}

fn check_objects(config: &Config, confirmed: &Confirmed, problems: &mut Vec<String>) {
    let confirmed = confirmed.lock().map(|it| it.clone()).unwrap_or_default();
    for (name, exists) in confirmed.iter().filter_map(|(name, exists)| Some((name, (*exists)?))) {
        if config.objects.iter().any(|it| it.name == *name) != exists {
            let change = if exists { "added" } else { "removed" };
            problems.push(format!("the object \"{name}\" was {change}, but not in the file"));
        }
    }
}

fn check_history(folder: &Path, expected: Expected, problems: &mut Vec<String>) {
    let path = folder.join("history.sqlite");
    let query = HistoryQuery {
        objects: Vec::new(),
        region_m: None,
        from: Timestamp::from_ns(0),
        until: Timestamp::from_ns(i64::MAX),
        max_points: MAX_POINTS,
        step_s: None,
    };
    match Store::open(&path).and_then(|store| store.query(&query)) {
        Ok(result) if result.objects.is_empty() && expected.stored => {
            problems.push("the history is empty".to_owned());
        }
        Ok(_) => {}
        Err(error) => problems.push(format!("the history cannot be opened: {error}")),
    }
    let files = fs::read_dir(folder).into_iter().flatten().flatten();
    for file in files.filter(|it| it.file_name().to_string_lossy().contains(".damaged-")) {
        problems.push(format!("the history was damaged: {:?}", file.file_name()));
    }
}

fn check_recordings(folder: &Path, expected: Expected, problems: &mut Vec<String>) {
    let mut snapshots = 0;
    for file in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = file.path();
        if path.extension().is_none_or(|it| it != "mcap") {
            continue;
        }
        let name = file.file_name();
        let mut reader = match FileReader::open(&path) {
            Ok(reader) => reader,
            // A server that is killed while it creates a file leaves nothing in it.
            Err(_) if fs::metadata(&path).is_ok_and(|it| it.len() == 0) => continue,
            Err(error) => {
                problems.push(format!("the recording {name:?} cannot be opened: {error}"));
                continue;
            }
        };
        match reader.collect(Topic::Snapshots) {
            Ok(messages) => snapshots += messages.len(),
            Err(error) => problems.push(format!("the recording {name:?} cannot be read: {error}")),
        }
        let damage = reader.damage();
        if expected.complete_recordings && (damage.is_cut_off || !damage.sentences.is_empty()) {
            problems.push(format!("the recording {name:?} is incomplete: {damage:?}"));
        }
    }
    if expected.stored && snapshots == 0 {
        problems.push("nothing was recorded".to_owned());
    }
}
