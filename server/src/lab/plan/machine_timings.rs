//! What a machine takes for a frame (the constants of the paper's equation 20): measured with the real tracker on
//! rendered frames, kept in a small TOML file, read again.

use std::{
    collections::{BTreeMap, BTreeSet},
    env, fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, anyhow};
use roundel_core::{
    marker::Mode,
    plan::time::{Constants, TERM_NAMES, TERMS, fit},
};
use serde::{Deserialize, Serialize};

use super::{
    contention::ContentionProbe,
    timing::{TimedCase, TimingSample, cases, time},
};

/// Share of the cases that are enough to tell the constants by.
const MIN_CASE_SHARE: f64 = 0.75;

/// Of both modes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MachineTimings {
    pub precise: Constants,
    pub fast: Constants,
    /// Whether they were measured, or are those that stand in for it.
    pub is_measured: bool,
}

impl Default for MachineTimings {
    fn default() -> Self {
        Self { precise: Constants::PRECISE, fast: Constants::FAST, is_measured: false }
    }
}

#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct TimingsFile {
    precise: ModeEntry,
    fast: ModeEntry,
}

#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct ModeEntry {
    followed: Terms,
    searched: Terms,
}

/// Nanoseconds, by [`TERM_NAMES`].
type Terms = BTreeMap<String, f64>;

impl ModeEntry {
    fn of(constants: &Constants) -> Self {
        let terms = |of: &[f64; TERMS]| {
            let each = TERM_NAMES.into_iter().zip(of);
            each.map(|(name, seconds)| (name.to_owned(), seconds * 1e9)).collect()
        };
        Self { followed: terms(&constants.followed), searched: terms(&constants.searched) }
    }

    fn constants(&self) -> Result<Constants, String> {
        let [followed, searched] = [("followed", &self.followed), ("searched", &self.searched)]
            .map(|(name, terms)| read(terms).map_err(|message| format!("{name}: {message}")));
        Ok(Constants { followed: followed?, searched: searched? })
    }
}

fn read(terms: &Terms) -> Result<[f64; TERMS], String> {
    if !terms.keys().map(String::as_str).eq(BTreeSet::from(TERM_NAMES)) {
        let found: Vec<&str> = terms.keys().map(String::as_str).collect();
        let (expected, found) = (TERM_NAMES.join(", "), found.join(", "));
        return Err(format!("expected {expected}, found {found}"));
    }
    let is_time = |ns: &f64| (0.0..=1e12).contains(ns);
    if !terms.values().all(is_time) || terms.values().all(|ns| *ns == 0.0) {
        return Err("expected times from 0 to 1000 s in nanoseconds, not all 0".to_owned());
    }
    Ok(TERM_NAMES.map(|name| terms[name] * 1e-9))
}

impl MachineTimings {
    pub fn of(&self, mode: Mode) -> &Constants {
        match mode {
            Mode::Precise => &self.precise,
            Mode::Fast => &self.fast,
        }
    }

    /// Reads what [`MachineTimings::save`] wrote.
    pub fn load(path: &Path) -> anyhow::Result<Self> {
        let text = fs::read_to_string(path).with_context(|| {
            format!(
                "cannot read {}; `roundel plan --measure` writes such a file of this machine",
                path.display()
            )
        })?;
        let again = "measure again with `roundel plan --measure`";
        let document: TimingsFile = toml::from_str(&text).with_context(|| {
            format!("{}: not what a measurement wrote; {again}", path.display())
        })?;
        let constants = |name: &str, entry: &ModeEntry| {
            entry
                .constants()
                .map_err(|message| anyhow!("{}: {name}.{message}; {again}", path.display()))
        };
        Ok(Self {
            precise: constants("precise", &document.precise)?,
            fast: constants("fast", &document.fast)?,
            is_measured: true,
        })
    }

    /// Writes them, and the folder if it is not there.
    pub fn save(&self, path: &Path) -> anyhow::Result<()> {
        let document =
            TimingsFile { precise: ModeEntry::of(&self.precise), fast: ModeEntry::of(&self.fast) };
        let text = format!(
            "# What a frame takes on one core of this machine, measured by `roundel plan --measure`.\n\n{}",
            toml::to_string(&document).context("cannot put the times into TOML")?
        );
        let failed = || format!("cannot write {}", path.display());
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            fs::create_dir_all(folder).with_context(failed)?;
        }
        fs::write(path, text).with_context(failed)
    }
}

/// Where a machine's times are kept: beside a configuration, else in the user's folder of configurations; `None` if
/// there is neither.
pub fn default_path(config: Option<&Path>) -> Option<PathBuf> {
    if let Some(config) = config {
        return Some(config.with_extension("machine.toml"));
    }
    let absolute = |name: &str| env::var_os(name).map(PathBuf::from).filter(|it| it.is_absolute());
    let folder = absolute("XDG_CONFIG_HOME").or_else(|| Some(absolute("HOME")?.join(".config")))?;
    Some(folder.join("roundel").join("machine.toml"))
}

/// Measures this machine, one core; `progress` is told after each of so many cases.
pub fn measure(
    mut progress: impl FnMut(usize, usize),
) -> anyhow::Result<(MachineTimings, Vec<TimingSample>)> {
    let cases = cases();
    let mut probe = ContentionProbe::new()?;
    let mut timed = Vec::new();
    for (number, case) in cases.iter().enumerate() {
        timed.push(time(case, &mut probe)?);
        progress(number + 1, cases.len());
    }
    // What was timed while others used the machine would only mislead, unless there is little else.
    let was_uncontended = |timed: &&TimedCase| timed.was_uncontended(&probe);
    let is_enough =
        timed.iter().filter(was_uncontended).count() as f64 >= MIN_CASE_SHARE * cases.len() as f64;
    let used = timed.iter().filter(|timed| !is_enough || was_uncontended(timed));
    let measured: Vec<_> = used.flat_map(|timed| timed.measured(&probe)).collect();
    let constants = |mode: Mode| {
        let own: Vec<_> = measured
            .iter()
            .filter(|one| one.mode == mode)
            .map(|one| (one.load, one.time_s))
            .collect();
        fit(&own).context("the times that were measured fit no model; is the machine very busy?")
    };
    let machine = MachineTimings {
        precise: constants(Mode::Precise)?,
        fast: constants(Mode::Fast)?,
        is_measured: true,
    };
    Ok((machine, measured))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_measured_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new").join("machine.toml");
        let machine = MachineTimings { is_measured: true, ..MachineTimings::default() };
        machine.save(&path).unwrap();
        let again = MachineTimings::load(&path).unwrap();
        for (one, other) in [(machine.precise, again.precise), (machine.fast, again.fast)] {
            let pairs = [(one.followed, other.followed), (one.searched, other.searched)];
            for (one, other) in pairs.iter().flat_map(|(one, other)| one.iter().zip(other)) {
                assert!((one - other).abs() <= 1e-12 * one, "{one} {other}");
            }
        }
    }

    #[test]
    fn what_is_no_measurement_says_how_to_get_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("machine.toml");
        let error = |path: &Path| format!("{:#}", MachineTimings::load(path).unwrap_err());
        assert!(error(&path).contains("`roundel plan --measure` writes such a file"));
        MachineTimings::default().save(&path).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        for (from, to, expected) in [
            ("plain_wide", "plain_width", "precise.followed: expected frame, image_px, plain"),
            ("image_px = ", "image_px = -", "precise.followed: expected times from 0"),
            ("[fast.", "[quick.", "unknown field `quick`"),
        ] {
            fs::write(&path, text.replace(from, to)).unwrap();
            assert!(error(&path).contains(expected), "{}", error(&path));
        }
        // As it was written before sizes, motion and codes had constants of their own.
        fs::write(&path, "[precise]\nframe_ns = 1.0\n\n[fast]\nframe_ns = 1.0\n").unwrap();
        let old = error(&path);
        assert!(old.contains("measure again with `roundel plan --measure`"), "{old}");
    }
}
