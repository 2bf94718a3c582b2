//! Adds, changes, removes and names objects, in the configuration and in fusion.

use roundel_core::{
    id::ObjectId,
    marker::Pattern,
    world::{FusionParams, LifeStage},
};
use roundel_proto::v1::ObjectSetup;

use super::{
    CameraManager, CameraManagerError, State, bodies::kind_names, error::invalid, redacted_text,
    replaced, setup,
};
use crate::model::{
    command::{AppliedConfig, CameraModel, FusionCommand, FusionSettings},
    config::{
        Config, ObjectConfig, PoseConfig,
        edit::{self, EditError},
    },
    hub::{EventKind, ObjectRecord},
};

impl CameraManager {
    pub fn object_setup(&self, name: &str) -> Result<ObjectSetup, CameraManagerError> {
        Ok(edit::read(self.config().file.text(), name)?)
    }

    /// Adds an object after the last one. Returns where the configuration is stored.
    pub fn add_object(&self, object: &ObjectSetup) -> Result<String, CameraManagerError> {
        self.change_with(|| {
            let before = self.running_config()?;
            let text = edit::add(before.file.text(), object)?;
            let index = before.objects.len();
            let (kept, _) = self.apply_objects(&before, text, index, None)?;
            let message = format!("Object \"{}\" was added; {kept}.", object.name);
            let tracked = self.hub.object_by_name(&object.name);
            self.report_object(EventKind::ObjectAdded, tracked, message);
            Ok(kept)
        })
    }

    /// Sets these keys of an object. Returns where the configuration is stored, and the name of the object now.
    pub fn change_object(
        &self,
        name: &str,
        object: &ObjectSetup,
        keys: &[&str],
    ) -> Result<(String, String), CameraManagerError> {
        self.change_with(|| {
            let config = self.running_config()?;
            let before: ObjectSetup = edit::read(config.file.text(), name)?;
            let mut text = edit::change(config.file.text(), name, object, keys)?;
            let fresh = if keys.contains(&"name") { object.name.as_str() } else { name };
            if fresh != name {
                text = edit::rename_carrier(&text, name, fresh)?;
            }
            let index = config.objects.iter().position(|it| it.name == name).unwrap_or_default();
            let (kept, text) = self.apply_objects(&config, text, index, Some((name, fresh)))?;
            let after: ObjectSetup = edit::read(&text, fresh)?;
            let words = difference(&before, &after)?;
            if !words.is_empty() {
                let message = format!("Object \"{name}\" was changed ({words}); {kept}.");
                let tracked = self.hub.object_by_name(fresh);
                self.report_object(EventKind::ObjectChanged, tracked, message);
            }
            Ok((fresh.to_owned(), kept))
        })
    }

    /// Removes an object; its roundels are tracked without a name. Returns where the configuration is stored.
    pub fn remove_object(&self, name: &str) -> Result<String, CameraManagerError> {
        self.change_with(|| {
            let before = self.running_config()?;
            let text = edit::remove::<ObjectSetup>(before.file.text(), name)?;
            let object = self.hub.object_by_name(name);
            // Errors are attributed to cameras that are mounted on it.
            let (kept, _) = self.apply_objects(&before, text, usize::MAX, None)?;
            let message = format!("Object \"{name}\" was removed; {kept}.");
            self.report_object(EventKind::ObjectRemoved, object, message);
            Ok(kept)
        })
    }

    /// Names a tracked object. Returns where the configuration is stored.
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
        let kinds = self.config().kinds;
        let is_coded = record.kind.is_some_and(|kind| {
            let kind = kinds.get(usize::from(kind.0));
            kind.is_some_and(|kind| matches!(kind.pattern, Pattern::Coded(_)))
        });
        if is_coded && record.code.is_none() {
            return Err(CameraManagerError::CodeNotRead(object.0));
        }
        // The list contains recently lost objects, often the same one under another id.
        let is_other = |other: &ObjectRecord| {
            other.kind == record.kind && other.id != object && other.stage != LifeStage::Lost
        };
        if record.code.is_none() && records.iter().any(is_other) {
            return Err(CameraManagerError::Ambiguous { object: object.0, kind });
        }
        let code = record.code.map(|code| code.number.into());
        self.add_object(&ObjectSetup { roundel: kind, code, ..fresh })
    }

    /// Applies the objects of an edited text, in which one may be renamed; errors are attributed to the object at
    /// `index`. Returns where the configuration is stored, and its text.
    fn apply_objects(
        &self,
        before: &Config,
        text: String,
        index: usize,
        renamed: Option<(&str, &str)>,
    ) -> Result<(String, String), CameraManagerError> {
        let objects = before
            .parse_request(&text)
            .map_err(|problems| invalid::<ObjectSetup>(&text, index, &problems))?
            .objects;
        let file = replaced(&before.file, text.clone())?;
        let kept = file.kept();
        let state = &mut *self.lock_running()?;
        state.config.file = file;
        self.replace_objects(state, objects, renamed, None);
        Ok((kept, text))
    }

    /// Replaces the objects in hub and fusion, and the parameters of fusion.
    pub(super) fn replace_objects(
        &self,
        state: &mut State,
        objects: Vec<ObjectConfig>,
        renamed: Option<(&str, &str)>,
        params: Option<FusionParams>,
    ) {
        let before = std::mem::replace(&mut state.config.objects, objects);
        let State { config, bodies, .. } = &mut *state;
        let order = bodies.update((&before, &config.objects), renamed, &config.motions);
        // Names come first: snapshots must not refer to unknown bodies.
        self.hub.set_object_names(kind_names(&config.objects), bodies.names.clone());
        let owned = |(before, after): (&str, &str)| (before.to_owned(), after.to_owned());
        let text = redacted_text(config);
        let written = AppliedConfig { text, renamed: renamed.map(owned) };
        // Fails only during shutdown.
        let _ = state.commands.send(FusionCommand::SetParams(Box::new(FusionSettings {
            params,
            objects: order,
            config: written,
        })));
        let place = |name: &str| state.config.objects.iter().position(|object| object.name == name);
        for (index, id) in state.ids.iter().enumerate() {
            let PoseConfig::Mounted(ride) = &mut state.config.cameras[index].pose else { continue };
            let carrier = &before[ride.object].name;
            let renamed = renamed.filter(|(before, _)| before == carrier);
            let name = renamed.map_or(carrier.as_str(), |(_, after)| after);
            ride.object = place(name).unwrap_or(ride.object);
            if name != carrier {
                let camera = &state.config.cameras[index];
                self.hub.set_camera(*id, setup::camera_info(camera, &state.config));
                let pose = setup::camera_pose(camera, &state.config, &state.bodies.numbers);
                let model = CameraModel { pose: Some(pose), ..CameraModel::default() };
                state.set_model(*id, model);
            }
        }
    }

    /// Replaces the objects, matched by name, and reports each change.
    pub(super) fn replace_and_report_objects(
        &self,
        state: &mut State,
        objects: Vec<ObjectConfig>,
        params: Option<FusionParams>,
    ) {
        let mut changes = object_changes(&state.config.objects, &objects);
        // Events of removed objects come first, with the ids that they had.
        changes.sort_by_key(|(_, kind)| *kind != EventKind::ObjectRemoved);
        let tracked = |name: &String| self.hub.object_by_name(name);
        let before: Vec<_> = changes.iter().map(|(name, _)| tracked(name)).collect();
        self.replace_objects(state, objects, None, params);
        let kept = state.config.file.kept();
        for ((name, kind), before) in changes.iter().zip(before) {
            let (object, word) = match kind {
                EventKind::ObjectRemoved => (before, "removed"),
                EventKind::ObjectAdded => (tracked(name), "added"),
                _ => (tracked(name), "changed"),
            };
            self.report_object(*kind, object, format!("Object \"{name}\" was {word}; {kept}."));
        }
    }

    fn report_object(&self, kind: EventKind, object: Option<ObjectId>, message: String) {
        tracing::info!("{message}");
        self.hub.publish_object_event(self.clock.now(), kind, object, message);
    }
}

/// Names of the objects that differ, and how: added, changed or removed.
pub(super) fn object_changes(
    before: &[ObjectConfig],
    after: &[ObjectConfig],
) -> Vec<(String, EventKind)> {
    let find = |all: &[ObjectConfig], name: &str| all.iter().position(|it| it.name == name);
    let changed = after.iter().filter_map(|object| match find(before, &object.name) {
        None => Some((object.name.clone(), EventKind::ObjectAdded)),
        Some(index) if before[index] != *object => {
            Some((object.name.clone(), EventKind::ObjectChanged))
        }
        Some(_) => None,
    });
    let removed = before.iter().filter(|object| find(after, &object.name).is_none());
    let removed = removed.map(|object| (object.name.clone(), EventKind::ObjectRemoved));
    changed.chain(removed).collect()
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
