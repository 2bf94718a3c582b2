//! Objects that are added, changed and removed: in the configuration's text, as cameras are, and in fusion, which goes on
//! with all others.

use std::sync::MutexGuard;

use roundel_core::{id::ObjectId, marker::Pattern, world::LifeStage};
use roundel_proto::v1::ObjectSetup;

use super::{
    CameraManager, CameraManagerError, State, bodies::kind_names, error::invalid, redacted_text,
    setup,
};
use crate::model::{
    command::{AppliedConfig, CameraModel, FusionCommand, FusionLimits, FusionSettings},
    config::{
        Config, ObjectConfig, PoseConfig,
        edit::{self, EditError},
    },
    hub::{ConfigChange, EventKind, ObjectRecord},
};

impl CameraManager {
    pub fn object_setup(&self, name: &str) -> Result<ObjectSetup, CameraManagerError> {
        Ok(edit::read(self.lock().config.file.text(), name)?)
    }

    /// Adds an object behind the last one. Says where that is kept.
    pub fn add_object(&self, object: &ObjectSetup) -> Result<String, CameraManagerError> {
        let mut state = self.lock_running()?;
        let text = edit::add(state.config.file.text(), object)?;
        let index = state.config.objects.len();
        let kept = self.apply_objects(&mut state, text, index, None)?;
        let message = format!("Object \"{}\" was added; {kept}.", object.name);
        self.report_object_change(ConfigChange::Added, &object.name, message);
        Ok(kept)
    }

    /// Gives these keys of an object other values; its other keys are not looked at. Says where that is kept, and under
    /// which name the object goes now.
    pub fn change_object(
        &self,
        name: &str,
        object: &ObjectSetup,
        keys: &[&str],
    ) -> Result<(String, String), CameraManagerError> {
        let mut state = self.lock_running()?;
        let before: ObjectSetup = edit::read(state.config.file.text(), name)?;
        let mut text = edit::change(state.config.file.text(), name, object, keys)?;
        let fresh = if keys.contains(&"name") { object.name.as_str() } else { name };
        if fresh != name {
            text = edit::rename_carrier(&text, name, fresh)?;
        }
        let index = state.config.objects.iter().position(|it| it.name == name).unwrap_or_default();
        let kept = self.apply_objects(&mut state, text, index, Some((name, fresh)))?;
        let after: ObjectSetup = edit::read(state.config.file.text(), fresh)?;
        let words = difference(&before, &after)?;
        if !words.is_empty() {
            let message = format!("Object \"{name}\" was changed ({words}); {kept}.");
            self.report_object_change(ConfigChange::Changed, fresh, message);
        }
        Ok((fresh.to_owned(), kept))
    }

    /// Removes an object. What carries its roundels goes on as what these are. Says where that is kept.
    pub fn remove_object(&self, name: &str) -> Result<String, CameraManagerError> {
        let mut state = self.lock_running()?;
        let text = edit::remove::<ObjectSetup>(state.config.file.text(), name)?;
        let object = self.hub.object_by_name(name);
        // A camera that rides on it is to blame then.
        let kept = self.apply_objects(&mut state, text, usize::MAX, None)?;
        let message = format!("Object \"{name}\" was removed; {kept}.");
        self.report(EventKind::ObjectConfigured(ConfigChange::Removed, object), message);
        Ok(kept)
    }

    /// Gives a name to what is seen. Says where that is kept.
    pub fn name_object(&self, object: ObjectId, name: &str) -> Result<String, CameraManagerError> {
        let records = self.hub.objects();
        let record = records.iter().find(|record| record.id == object);
        let record = record.ok_or(CameraManagerError::NotSeen(object.0))?;
        let installation = self.hub.installation();
        let before = installation.object_name(record.kind, record.body);
        let fresh = ObjectSetup { name: name.to_owned(), ..ObjectSetup::default() };
        if !before.is_empty() {
            return self.change_object(before, &fresh, &["name"]).map(|(_, kept)| kept);
        }
        let kind = installation.kind_name(record.kind).to_owned();
        let kinds = self.lock().config.kinds.clone();
        let is_coded = record.kind.is_some_and(|kind| {
            let kind = kinds.get(usize::from(kind.0));
            kind.is_some_and(|kind| matches!(kind.pattern, Pattern::Coded(_)))
        });
        if is_coded && record.code.is_none() {
            return Err(CameraManagerError::CodeNotRead(object.0));
        }
        // Those that were lost within the last minute are in the list as well: this one, under another number, as a rule.
        let is_other = |other: &ObjectRecord| {
            other.kind == record.kind && other.id != object && other.stage != LifeStage::Lost
        };
        if record.code.is_none() && records.iter().any(is_other) {
            return Err(CameraManagerError::Ambiguous { object: object.0, kind });
        }
        let code = record.code.map(|code| code.number.into());
        self.add_object(&ObjectSetup { roundel: kind, code, ..fresh })
    }

    /// The state, if the server is not going down.
    pub(super) fn lock_running(&self) -> Result<MutexGuard<'_, State>, CameraManagerError> {
        let state = self.lock();
        if state.is_shut_down { Err(CameraManagerError::ShuttingDown) } else { Ok(state) }
    }

    /// Takes over the objects of a changed text, in which one may have another name; what is wrong with it is the fault
    /// of the object at `index`. Cameras are not read anew. Says where the text is kept.
    fn apply_objects(
        &self,
        state: &mut State,
        text: String,
        index: usize,
        renamed: Option<(&str, &str)>,
    ) -> Result<String, CameraManagerError> {
        let objects = Config::parse(&text, &state.config.folder)
            .map_err(|problems| invalid::<ObjectSetup>(&text, index, &problems))?
            .objects;
        state.config.file.replace(text)?;
        self.replace_objects(state, objects, renamed, None);
        Ok(state.config.file.kept())
    }

    /// Has everybody know of other objects than before, and fusion of other limits.
    pub(super) fn replace_objects(
        &self,
        state: &mut State,
        objects: Vec<ObjectConfig>,
        renamed: Option<(&str, &str)>,
        limits: Option<FusionLimits>,
    ) {
        let now = |name: &str| match renamed {
            Some((before, after)) if before == name => after.to_owned(),
            _ => name.to_owned(),
        };
        let before = std::mem::replace(&mut state.config.objects, objects);
        let State { config, bodies, .. } = &mut *state;
        let order = bodies.update((&before, &config.objects), renamed, &config.motions);
        // Names come first, so that nobody hears of one that is not known yet.
        self.hub.set_object_names(kind_names(&config.objects), bodies.names.clone());
        let owned = |(before, after): (&str, &str)| (before.to_owned(), after.to_owned());
        let text = redacted_text(config);
        let written = AppliedConfig { text, renamed: renamed.map(owned) };
        // Fusion is gone only when the server goes down.
        let _ = state.commands.send(FusionCommand::SetParams(Box::new(FusionSettings {
            limits,
            objects: order,
            config: written,
        })));
        let place = |name: &str| state.config.objects.iter().position(|object| object.name == name);
        for (index, id) in state.ids.iter().enumerate() {
            let PoseConfig::Mounted(ride) = &mut state.config.cameras[index].pose else { continue };
            let carrier = &before[ride.object].name;
            ride.object = place(&now(carrier)).unwrap_or(ride.object);
            if renamed.is_some_and(|(before, after)| before != after && before == carrier) {
                let camera = &state.config.cameras[index];
                self.hub.set_camera(*id, setup::camera_info(camera, &state.config));
                let pose = setup::camera_pose(camera, &state.config, &state.bodies.numbers);
                let known = CameraModel { pose: Some(pose), clock: None };
                let _ = state.commands.send(FusionCommand::SetCamera(*id, Box::new(known)));
            }
        }
    }

    /// The same, when several may have changed, each by its name; each change is told.
    pub(super) fn replace_and_report_objects(
        &self,
        state: &mut State,
        objects: Vec<ObjectConfig>,
        limits: Option<FusionLimits>,
    ) {
        let before = state.config.objects.clone();
        let is_in = |all: &[ObjectConfig], name: &str| all.iter().any(|it| it.name == name);
        let gone: Vec<_> = before.iter().filter(|old| !is_in(&objects, &old.name)).collect();
        let gone: Vec<_> =
            gone.iter().map(|old| (&old.name, self.hub.object_by_name(&old.name))).collect();
        self.replace_objects(state, objects, None, limits);
        let kept = state.config.file.kept();
        for (name, object) in gone {
            let message = format!("Object \"{name}\" was removed; {kept}.");
            self.report(EventKind::ObjectConfigured(ConfigChange::Removed, object), message);
        }
        for object in &state.config.objects {
            let (change, word) = match before.iter().find(|old| old.name == object.name) {
                None => (ConfigChange::Added, "added"),
                Some(old) if old != object => (ConfigChange::Changed, "changed"),
                Some(_) => continue,
            };
            let message = format!("Object \"{}\" was {word}; {kept}.", object.name);
            self.report_object_change(change, &object.name, message);
        }
    }

    fn report_object_change(&self, change: ConfigChange, name: &str, message: String) {
        self.report(EventKind::ObjectConfigured(change, self.hub.object_by_name(name)), message);
    }
}

/// Labels of the keys that differ, commas between.
fn difference(before: &ObjectSetup, after: &ObjectSetup) -> Result<String, EditError> {
    let label = |key: &'static str| match key {
        "offset_m" => "followed point",
        "height_m" => "height",
        "roundel" => "roundels",
        key => key,
    };
    let labels = edit::difference(before, after)?.into_iter().map(label);
    Ok(labels.collect::<Vec<_>>().join(", "))
}
