//! The cameras and objects of a server that runs: which there are, and that they can be added, changed and removed
//! meanwhile.
//!
//! | module | what it does |
//! | --- | --- |
//! | `crew` | the workers' threads |
//! | `difference` | diff between two versions of a camera, and the actions it requires |
//! | `configuration` | all of them, and what else can change, in one go |
//! | `effect` | what follows from a change that is written |
//! | `object` | the same of objects |
//! | [`bodies`] | which body each object is, and what fusion hears of when they change |
//! | [`setup`] | what the parts of a server are told of a camera |
//! | `error` | why something is not done |
//!
//! The configuration's text is what counts: a change is made in it, comments and all, and the whole is read and checked
//! as at a start. Only then it is written, and only what is written is done. Of the cameras that nobody changed nobody
//! takes notice: each has its own thread, id and port. Ids are never given twice.
//!
//! One change at a time; whoever asks waits for the one before. Each takes as long as its worker's source needs to let
//! go, which is milliseconds.

pub mod bodies;
mod configuration;
mod crew;
mod difference;
mod effect;
mod error;
mod lens;
mod object;
pub mod setup;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};

use roundel_core::id::CameraId;
use roundel_proto::v1::CameraSetup;

use self::{bodies::Bodies, crew::Crew, difference::Difference, effect::Begin, error::wrong};
use crate::{
    capture::{
        source::{
            OpenSource, Playback,
            push::{Port, Ports},
        },
        worker::{Sighted, Totals, pipeline::Pipeline},
    },
    fusion::calibration::Calibrator,
    model::{
        clock::Clock,
        command::Order,
        config::{CameraConfig, CameraPose, Config, edit},
        hub::{Happening, Hub},
        stop::Stop,
    },
};
pub use bodies::kind_names;
pub use configuration::{InForce, Plan, fusion_limits};
pub use error::RosterError;

/// What a source has to fit into.
pub struct CameraSetting<'a> {
    /// The camera's place in the configuration.
    pub index: usize,
    /// Its configuration.
    pub camera: &'a CameraConfig,
    /// The server's clock.
    pub clock: Clock,
    /// The time line of recorded and simulated frames.
    pub playback: Playback,
    /// Ends every wait of the source.
    pub stop: Stop,
    /// Where the frames of one with a `push:` source arrive.
    pub port: Option<Arc<Port>>,
}

/// Makes the sources of cameras.
pub type Sources = Box<dyn FnMut(CameraSetting<'_>) -> Box<dyn OpenSource> + Send>;

/// What a roster is made of.
pub struct RosterParts {
    /// As it is written.
    pub config: Config,
    /// The newest of everything.
    pub hub: Arc<Hub>,
    /// The server's clock.
    pub clock: Clock,
    /// The time line of recorded and simulated frames.
    pub playback: Playback,
    /// Finds where cameras stand.
    pub calibrator: Arc<Calibrator>,
    /// Where remote programs feed cameras.
    pub ports: Arc<Ports>,
    /// Where workers send what they see.
    pub to_fusion: mpsc::SyncSender<Sighted>,
    /// Where fusion hears of cameras.
    pub orders: mpsc::Sender<Order>,
    /// Makes the sources of cameras.
    pub sources: Sources,
}

/// The cameras of a server that runs.
pub struct Roster {
    hub: Arc<Hub>,
    clock: Clock,
    playback: Playback,
    calibrator: Arc<Calibrator>,
    ports: Arc<Ports>,
    state: Mutex<State>,
}

struct State {
    config: Config,
    /// Of each of its cameras.
    ids: Vec<CameraId>,
    next_id: u32,
    /// Of its objects.
    bodies: Bodies,
    crew: Crew,
    to_fusion: mpsc::SyncSender<Sighted>,
    orders: mpsc::Sender<Order>,
    sources: Sources,
    ended: bool,
}

impl Roster {
    /// Starts every camera, of which the calibrator, fusion's task and the hub know already, in the order of the
    /// configuration; where a calibration has found them, `calibrated` says so.
    pub fn start(parts: RosterParts, calibrated: &Config) -> Result<Self, RosterError> {
        let RosterParts { config, hub, clock, playback, calibrator, ports, .. } = parts;
        let RosterParts { to_fusion, orders, sources, .. } = parts;
        let ids: Vec<CameraId> = (0..).map(CameraId).take(config.cameras.len()).collect();
        let state = State {
            next_id: ids.len() as u32,
            bodies: Bodies::of(&config.objects),
            config,
            ids: ids.clone(),
            crew: Crew::default(),
            to_fusion,
            orders,
            sources,
            ended: false,
        };
        let state = Mutex::new(state);
        let roster = Self { hub, clock, playback, calibrator, ports, state };
        for (index, (id, camera)) in ids.into_iter().zip(&calibrated.cameras).enumerate() {
            let mut state = roster.lock();
            let pipeline = Pipeline::new(setup::pipeline(camera, calibrated, Default::default())?)?;
            roster.introduce(&state, id, camera, calibrated);
            let is_calibrated = matches!(camera.pose, CameraPose::Calibrated(_));
            let version = if is_calibrated { roster.calibrator.version() } else { 0 };
            let (place, before) = (setup::place(camera, calibrated), Totals::default());
            let begin = Begin { id, index, camera, pipeline, place, version, before };
            roster.begin(&mut state, begin)?;
        }
        Ok(roster)
    }

    /// A camera as configured, without user and password.
    pub fn camera_setup(&self, name: &str) -> Result<CameraSetup, RosterError> {
        Ok(edit::read(&edit::without_credentials(self.lock().config.file.text())?, name)?)
    }

    /// The configuration's text as it is now, without users and passwords of sources.
    pub fn text_without_passwords(&self) -> String {
        text_without_passwords(&self.lock().config)
    }

    /// Adds a camera behind the last one. Says where that is kept.
    pub fn add(&self, camera: &CameraSetup) -> Result<String, RosterError> {
        let mut state = self.ready()?;
        let text = edit::add(state.config.file.text(), camera)?;
        let index = state.ids.len();
        let mut config = state.read_again(&text, index)?;
        config.cameras.splice(..index, state.config.cameras.iter().cloned());
        // That it can be searched for is known before anything is done.
        Pipeline::new(setup::pipeline(&config.cameras[index], &config, Default::default())?)?;
        config.file.replace(text)?;
        let id = CameraId(state.next_id);
        state.next_id += 1;
        let before = std::mem::replace(&mut state.config, config);
        state.ids.push(id);
        if let Err(error) = self.enter(&mut state, (id, index)) {
            self.forget(&state, id);
            state.ids.pop();
            // What is written is what runs.
            let mut file = state.config.file.clone();
            file.replace(before.file.text().to_owned())?;
            state.config = Config { file, ..before };
            return Err(error);
        }
        Ok(state.config.file.kept())
    }

    /// Gives these keys of a camera other values; its other keys are not looked at. Files that it names are read anew.
    /// Says where that is kept, and under which name the camera goes now.
    pub fn change(
        &self,
        name: &str,
        camera: &CameraSetup,
        keys: &[&str],
    ) -> Result<(String, String), RosterError> {
        let mut state = self.ready()?;
        let (index, id) = state.place_of(name)?;
        let text = edit::change(state.config.file.text(), name, camera, keys)?;
        let mut config = state.read_again(&text, index)?;
        let after = config.cameras[index].clone();
        config.cameras.clone_from(&state.config.cameras);
        let before = std::mem::replace(&mut config.cameras[index], after.clone());
        let difference = Difference::of(&before, &after);
        // That the keys can be searched for is known before anything is done.
        Pipeline::new(setup::pipeline(&after, &config, Default::default())?)?;
        config.file.replace(text)?;
        state.config = config;
        let kept = state.config.file.kept();
        if difference.is_empty() {
            return Ok((after.name, kept));
        }
        self.put_into_effect(&mut state, (id, index), &difference)?;
        let message = format!("Camera {} was changed ({}); {kept}.", name, difference.words());
        self.tell(Happening::Changed(id), message);
        Ok((after.name, kept))
    }

    /// Removes a camera: its thread, its port, and all that is held of it. Says where that is kept.
    pub fn remove(&self, name: &str) -> Result<String, RosterError> {
        let mut state = self.ready()?;
        let (index, id) = state.place_of(name)?;
        if state.ids.len() == 1 {
            return Err(RosterError::Last);
        }
        let text = edit::remove::<CameraSetup>(state.config.file.text(), name)?;
        // Whom it carried, and who found its place by it, may need it. The others are not read anew.
        let mut config = state.read_again(&text, usize::MAX)?;
        config.cameras.clone_from(&state.config.cameras);
        config.cameras.remove(index);
        config.file.replace(text)?;
        state.config = config;
        state.ids.remove(index);
        state.crew.end(id);
        let kept = state.config.file.kept();
        self.tell(Happening::Removed(id), format!("Camera {name} was removed; {kept}."));
        self.forget(&state, id);
        Ok(kept)
    }

    /// Ends every camera for good, and gives their threads to be waited for.
    pub fn end(&self) -> Vec<std::thread::JoinHandle<Totals>> {
        let mut state = self.lock();
        state.ended = true;
        state.crew.end_all()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The state, if it may be changed now.
    fn ready(&self) -> Result<MutexGuard<'_, State>, RosterError> {
        let state = self.lock();
        if self.calibrator.is_running() {
            return Err(RosterError::Calibrating);
        }
        if state.ended { Err(RosterError::Ending) } else { Ok(state) }
    }

    fn tell(&self, happening: Happening, message: String) {
        tracing::info!("{message}");
        self.hub.publish_event(self.clock.now(), happening, message);
    }
}

/// The text of a configuration without users and passwords of sources.
pub fn text_without_passwords(config: &Config) -> String {
    // A text that cannot be parsed may contain passwords.
    edit::without_credentials(config.file.text()).unwrap_or_default()
}

impl State {
    /// Place and id of a camera.
    fn place_of(&self, name: &str) -> Result<(usize, CameraId), RosterError> {
        let place = self.config.cameras.iter().position(|camera| camera.name == name);
        let place = place.ok_or_else(|| RosterError::NoCamera(name.to_owned()))?;
        Ok((place, self.ids[place]))
    }

    /// A changed text as a configuration, kept where the one before is; what is wrong is the fault of the camera at
    /// `index`.
    fn read_again(&self, text: &str, index: usize) -> Result<Config, RosterError> {
        let cameras = Config::parse(text, &self.config.folder)
            .map_err(|problems| wrong::<CameraSetup>(text, index, &problems))?
            .cameras;
        Ok(Config { cameras, ..self.config.clone() })
    }
}
