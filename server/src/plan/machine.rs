//! What a machine takes for a frame (the constants of the paper's equation 20): measured with the real tracker on
//! rendered frames, kept in a small TOML file, read again.

use std::{
    env, fs,
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::{Context, bail};
use roundel_core::{
    frame::Frame,
    marker::{Detector, Kind, Mode, Params, Scratch, Tracker},
    plan::time::{Constants, Load, fit},
    pose::Locator,
    sim::{CameraMount, Renderer, Scenario, ScenarioParams},
};
use serde::{Deserialize, Serialize};

/// Frames of a case, played to and fro.
const FRAMES: u64 = 6;
/// Repetitions of which the quickest counts, since others use the machine.
const ROUNDS: usize = 12;
/// What is rendered: width and height, outer diameter in metres, robots, height of the camera in metres.
const CASES: [((usize, usize), f64, usize, f64); 12] = [
    ((640, 480), 0.16, 4, 4.0),
    ((640, 480), 0.25, 12, 4.0),
    ((1280, 720), 0.10, 4, 4.0),
    ((1280, 720), 0.16, 8, 6.0),
    ((1280, 720), 0.16, 24, 6.0),
    ((1280, 720), 0.25, 8, 3.5),
    ((1920, 1080), 0.10, 24, 6.0),
    ((1920, 1080), 0.16, 4, 6.0),
    ((1920, 1080), 0.16, 24, 6.0),
    ((1920, 1080), 0.25, 8, 3.5),
    ((1920, 1080), 0.25, 24, 6.0),
    ((2592, 1944), 0.16, 16, 6.0),
];

/// Of both modes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Machine {
    /// Of precise mode.
    pub precise: Constants,
    /// Of fast mode.
    pub fast: Constants,
    /// Whether they were measured, or are those that stand in for it.
    pub is_measured: bool,
}

impl Default for Machine {
    fn default() -> Self {
        Self { precise: Constants::PRECISE, fast: Constants::FAST, is_measured: false }
    }
}

/// One measured time.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// In which mode.
    pub mode: Mode,
    /// Of what.
    pub load: Load,
    /// Seconds a frame.
    pub time_s: f64,
}

/// The file.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Document {
    precise: Entry,
    fast: Entry,
}

/// Nanoseconds, each as in [`Constants`].
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    frame_ns: f64,
    image_px_ns: f64,
    searched_px_ns: f64,
    roundel_ns: f64,
    roundel_side_px_ns: f64,
    roundel_area_px_ns: f64,
    searched_roundel_ns: f64,
}

impl Entry {
    fn of(constants: &Constants) -> Self {
        let [frame, image, searched, roundel, side, area, found] =
            constants.0.map(|seconds| seconds * 1e9);
        Self {
            frame_ns: frame,
            image_px_ns: image,
            searched_px_ns: searched,
            roundel_ns: roundel,
            roundel_side_px_ns: side,
            roundel_area_px_ns: area,
            searched_roundel_ns: found,
        }
    }

    fn constants(&self) -> Option<Constants> {
        let all = [
            self.frame_ns,
            self.image_px_ns,
            self.searched_px_ns,
            self.roundel_ns,
            self.roundel_side_px_ns,
            self.roundel_area_px_ns,
            self.searched_roundel_ns,
        ];
        let sound =
            all.iter().all(|ns| (0.0..=1e12).contains(ns)) && all.iter().any(|ns| *ns > 0.0);
        sound.then(|| Constants(all.map(|ns| ns * 1e-9)))
    }
}

impl Machine {
    /// Of a mode.
    pub fn of(&self, mode: Mode) -> &Constants {
        match mode {
            Mode::Precise => &self.precise,
            Mode::Fast => &self.fast,
        }
    }

    /// Reads what [`Machine::save`] wrote.
    pub fn load(path: &Path) -> anyhow::Result<Self> {
        let text = fs::read_to_string(path).with_context(|| {
            format!(
                "cannot read {}; `roundel plan --measure` writes such a file of this machine",
                path.display()
            )
        })?;
        let again = "measure again with `roundel plan --measure`";
        let document: Document = toml::from_str(&text).with_context(|| {
            format!("{}: not what a measurement wrote; {again}", path.display())
        })?;
        let constants = |name: &str, entry: &Entry| {
            entry.constants().with_context(|| {
                format!(
                    "{}: [{name}]: expected times from 0 to 1000 s in nanoseconds, not all 0; {again}",
                    path.display()
                )
            })
        };
        Ok(Self {
            precise: constants("precise", &document.precise)?,
            fast: constants("fast", &document.fast)?,
            is_measured: true,
        })
    }

    /// Writes them, and the folder if it is not there.
    pub fn save(&self, path: &Path) -> anyhow::Result<()> {
        let document = Document { precise: Entry::of(&self.precise), fast: Entry::of(&self.fast) };
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
pub fn usual_path(config: Option<&Path>) -> Option<PathBuf> {
    if let Some(config) = config {
        return Some(config.with_extension("machine.toml"));
    }
    let absolute = |name: &str| env::var_os(name).map(PathBuf::from).filter(|it| it.is_absolute());
    let folder = absolute("XDG_CONFIG_HOME").or_else(|| Some(absolute("HOME")?.join(".config")))?;
    Some(folder.join("roundel").join("machine.toml"))
}

/// Measures this machine, one core; `progress` is told after each of so many cases.
pub fn measure(mut progress: impl FnMut(usize, usize)) -> anyhow::Result<(Machine, Vec<Measured>)> {
    let mut measured = Vec::new();
    for (number, case) in CASES.iter().enumerate() {
        measured.extend(measure_case(*case)?);
        progress(number + 1, CASES.len());
    }
    let constants = |mode: Mode| {
        let own: Vec<_> = measured
            .iter()
            .filter(|one| one.mode == mode)
            .map(|one| (one.load, one.time_s))
            .collect();
        fit(&own).context("the times that were measured fit no model; is the machine very busy?")
    };
    let machine = Machine {
        precise: constants(Mode::Precise)?,
        fast: constants(Mode::Fast)?,
        is_measured: true,
    };
    Ok((machine, measured))
}

type Case = ((usize, usize), f64, usize, f64);

fn scenario((size, outer_m, robots, above_m): Case) -> anyhow::Result<Scenario> {
    let mut params = ScenarioParams::r4_lite(1);
    params.robots = robots;
    params.still = 0;
    params.flying_share = 0.0;
    params.flying_top_m = 1.5;
    params.booms = 0;
    params.kinds = vec![Kind::plain("robot", outer_m, 0.4 * outer_m)];
    params.mounts =
        vec![CameraMount { position_m: [0.2, 0.0, above_m], target_m: [0.0, 0.0, 0.0] }];
    params.optics.focal_px *= size.0 as f64 / params.optics.width as f64;
    (params.optics.width, params.optics.height) = size;
    Ok(Scenario::new(params)?)
}

fn measure_case(case: Case) -> anyhow::Result<Vec<Measured>> {
    let scenario = scenario(case)?;
    let (width, height) = case.0;
    let mut renderer = Renderer::new(&scenario, 0)?;
    let mut pictures = Vec::new();
    for frame in 0..FRAMES {
        let mut pixels = vec![0; width * height];
        renderer.render(frame, &mut pixels)?;
        pictures.push(pixels);
    }
    let frames = pictures
        .iter()
        .map(|pixels| Frame::new(pixels, width, height, width))
        .collect::<Result<Vec<_>, _>>()?;
    let camera = &renderer.camera().camera;
    let kinds = &scenario.params().kinds;
    let mut measured = Vec::new();
    for mode in [Mode::Precise, Mode::Fast] {
        let detector = Detector::new(kinds.clone(), Params { mode, ..Params::default() })?;
        let mut locator = Locator::new(camera.clone(), kinds.clone(), mode);
        let image_px = (width * height) as f64;
        let mut push = |roundels: f64, diameters_px: f64, searched_share: f64, time_s: f64| {
            let diameter_px = diameters_px / roundels;
            let load = Load { image_px, roundels, diameter_px, searched_share };
            measured.push(Measured { mode, load, time_s });
        };
        let mut scratch = Scratch::default();
        let rings = detector.detect(&frames[0], &mut scratch).to_vec();
        if rings.is_empty() {
            bail!("no roundel was found in the frames that were rendered to measure with");
        }
        let sizes = rings.iter().map(|ring| 2.0 * ring.outer.mean_radius_px());
        let (count, sum_px) = (rings.len() as f64, sizes.sum::<f64>());
        let search_s = quickest(|| {
            for ring in detector.detect(&frames[0], &mut scratch) {
                // Whether a ring has a pose does not matter to the time.
                let _ = locator.locate_single(&frames[0], &kinds[0], ring);
            }
        });
        let mut tracker = Tracker::new(detector);
        let (mut located, mut seen, mut sizes_px) = (Vec::new(), 0.0, 0.0);
        let to_and_fro = || frames.iter().chain(frames[1..frames.len() - 1].iter().rev());
        let turns = to_and_fro().count() as f64;
        let follow_s = quickest(|| {
            (seen, sizes_px) = (0.0, 0.0);
            for frame in to_and_fro() {
                let tracked = tracker.process(frame);
                locator.locate_all(frame, tracked, &mut located);
                seen += tracked.len() as f64 / turns;
                let size =
                    |one: &roundel_core::marker::TrackedRing| one.ring.outer.mean_radius_px();
                sizes_px += 2.0 * tracked.iter().map(size).sum::<f64>() / turns;
            }
        });
        if seen >= 1.0 {
            push(seen, sizes_px, 0.0, follow_s / turns);
        }
        // A frame that is searched costs its search beside what follows.
        push(count, sum_px, 1.0, search_s.max(follow_s / turns));
    }
    Ok(measured)
}

/// The quickest of some calls, seconds, once it is warm.
fn quickest(mut call: impl FnMut()) -> f64 {
    call();
    let mut least = f64::INFINITY;
    for _ in 0..ROUNDS {
        let begun = Instant::now();
        call();
        least = least.min(begun.elapsed().as_secs_f64());
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_measured_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new").join("machine.toml");
        let machine = Machine { is_measured: true, ..Machine::default() };
        machine.save(&path).unwrap();
        let again = Machine::load(&path).unwrap();
        for (one, other) in [(machine.precise, again.precise), (machine.fast, again.fast)] {
            for (one, other) in one.0.iter().zip(other.0) {
                assert!((one - other).abs() <= 1e-12 * one, "{one} {other}");
            }
        }
    }

    #[test]
    fn what_is_no_measurement_says_how_to_get_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("machine.toml");
        let error = |path: &Path| format!("{:#}", Machine::load(path).unwrap_err());
        assert!(error(&path).contains("`roundel plan --measure` writes such a file"));
        Machine::default().save(&path).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        for (from, to, expected) in [
            ("frame_ns", "frame_s", "unknown field `frame_s`"),
            ("frame_ns = ", "frame_ns = -", "[precise]: expected times from 0"),
            ("[fast]", "[quick]", "unknown field `quick`"),
        ] {
            fs::write(&path, text.replacen(from, to, 1)).unwrap();
            assert!(error(&path).contains(expected), "{}", error(&path));
        }
    }

    #[test]
    fn every_case_can_be_rendered_and_is_found() {
        for case in CASES {
            scenario(case).unwrap();
        }
        let measured = measure_case(CASES[0]).unwrap();
        assert_eq!(measured.len(), 4, "{measured:?}");
        assert!(measured.iter().all(|one| one.time_s > 0.0 && one.load.roundels >= 3.0));
    }
}
