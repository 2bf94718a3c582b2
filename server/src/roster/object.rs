//! Objects that are added, changed and removed: in the configuration's text, as cameras are, and in fusion, which goes on
//! with all others.

use std::{collections::BTreeMap, sync::MutexGuard};

use nalgebra::Vector3;
use roundel_core::{
    id::{BodyId, KindId, ObjectId},
    marker::Pattern,
    world::{Body, MotionClass},
};

use super::{Roster, RosterError, State, error::wrong, setup};
use crate::{
    config::{
        CameraPose, Carried, Config, ObjectConfig,
        edit::{self, Written, WrittenObject, WrittenRoundels},
    },
    fusion::{Known, ObjectOrder, Order},
    hub::{Change, Happening},
};

impl Roster {
    /// An object as it is written.
    pub fn written_object(&self, name: &str) -> Result<WrittenObject, RosterError> {
        Ok(edit::read(self.lock().config.file.text(), name)?)
    }

    /// Adds an object behind the last one. Says where that is kept.
    pub fn add_object(&self, object: &WrittenObject) -> Result<String, RosterError> {
        let mut state = self.alive()?;
        let text = edit::add(state.config.file.text(), object)?;
        let index = state.config.objects.len();
        let kept = self.take_objects(&mut state, text, index, None)?;
        let message = format!("Object \"{}\" was added; {kept}.", object.name);
        self.tell_configured(Change::Added, &object.name, message);
        Ok(kept)
    }

    /// Gives these keys of an object other values; its other keys are not looked at. Says where that is kept, and under
    /// which name the object goes now.
    pub fn change_object(
        &self,
        name: &str,
        object: &WrittenObject,
        keys: &[&str],
    ) -> Result<(String, String), RosterError> {
        let mut state = self.alive()?;
        let before: WrittenObject = edit::read(state.config.file.text(), name)?;
        let mut text = edit::change(state.config.file.text(), name, object, keys)?;
        let fresh = if keys.contains(&"name") { object.name.as_str() } else { name };
        if fresh != name {
            text = edit::rename_carrier(&text, name, fresh)?;
        }
        let index = state.config.objects.iter().position(|it| it.name == name).unwrap_or_default();
        let kept = self.take_objects(&mut state, text, index, Some((name, fresh)))?;
        let after: WrittenObject = edit::read(state.config.file.text(), fresh)?;
        let words = difference(&before, &after);
        if !words.is_empty() {
            let message = format!("Object \"{name}\" was changed ({words}); {kept}.");
            self.tell_configured(Change::Changed, fresh, message);
        }
        Ok((fresh.to_owned(), kept))
    }

    /// Removes an object. What carries its roundels goes on as what these are. Says where that is kept.
    pub fn remove_object(&self, name: &str) -> Result<String, RosterError> {
        let mut state = self.alive()?;
        let text = edit::remove::<WrittenObject>(state.config.file.text(), name)?;
        let object = self.hub.object_named(name);
        // A camera that rides on it is to blame then.
        let kept = self.take_objects(&mut state, text, usize::MAX, None)?;
        let message = format!("Object \"{name}\" was removed; {kept}.");
        self.tell(Happening::Configured(Change::Removed, object), message);
        Ok(kept)
    }

    /// Gives a name to what is seen. Says where that is kept.
    pub fn name_object(&self, object: ObjectId, name: &str) -> Result<String, RosterError> {
        let records = self.hub.objects();
        let record = records.iter().find(|record| record.id == object);
        let record = record.ok_or(RosterError::Unseen(object.0))?;
        let installation = self.hub.installation();
        let before = installation.object_name(record.kind, record.body);
        let fresh = WrittenObject { name: name.to_owned(), ..WrittenObject::default() };
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
            return Err(RosterError::Unread(object.0));
        }
        let is_alone = || records.iter().filter(|other| other.kind == record.kind).count() == 1;
        if record.code.is_none() && !is_alone() {
            return Err(RosterError::Alike { object: object.0, kind });
        }
        let code = record.code.map(|code| code.number.into());
        let roundel = Some(WrittenRoundels::One(kind));
        self.add_object(&WrittenObject { roundel, code, ..fresh })
    }

    /// The state, if the server is not going down.
    pub(super) fn alive(&self) -> Result<MutexGuard<'_, State>, RosterError> {
        let state = self.lock();
        if state.ended { Err(RosterError::Ending) } else { Ok(state) }
    }

    /// Takes over the objects of a changed text, in which one may have another name; what is wrong with it is the fault
    /// of the object at `index`. Cameras are not read anew. Says where the text is kept.
    fn take_objects(
        &self,
        state: &mut State,
        text: String,
        index: usize,
        renamed: Option<(&str, &str)>,
    ) -> Result<String, RosterError> {
        let objects = Config::parse(&text, &state.config.folder)
            .map_err(|problems| wrong::<WrittenObject>(&text, index, &problems))?
            .objects;
        state.config.file.replace(text)?;
        self.follow(state, objects, renamed);
        Ok(state.config.file.kept())
    }

    /// Has everybody know of other objects than before.
    pub(super) fn follow(
        &self,
        state: &mut State,
        objects: Vec<ObjectConfig>,
        renamed: Option<(&str, &str)>,
    ) {
        let now = |name: &str| match renamed {
            Some((before, after)) if before == name => after.to_owned(),
            _ => name.to_owned(),
        };
        let before = std::mem::replace(&mut state.config.objects, objects);
        let numbers = std::mem::take(&mut state.bodies);
        let known: BTreeMap<String, Option<BodyId>> =
            before.iter().map(|object| now(&object.name)).zip(numbers.iter().copied()).collect();
        let State { config, bodies, body_names, .. } = state;
        for object in &config.objects {
            bodies.push(match object.carries {
                Carried::Kind { .. } => None,
                Carried::Body(_) => {
                    Some(known.get(&object.name).copied().flatten().unwrap_or_else(|| {
                        body_names.push(String::new());
                        BodyId(body_names.len() as u32 - 1)
                    }))
                }
            });
        }
        let order = order((&before, &numbers), (&config.objects, bodies), &config.motions);
        // Names come first, so that nobody hears of one that is not known yet.
        body_names.iter_mut().for_each(String::clear);
        for (object, body) in config.objects.iter().zip(&*bodies) {
            body.iter().for_each(|body| body_names[body.0 as usize].clone_from(&object.name));
        }
        self.hub.set_object_names(kind_names(&config.objects), body_names.clone());
        // Fusion is gone only when the server goes down.
        let _ = state.orders.send(Order::Objects(order));
        let place = |name: &str| state.config.objects.iter().position(|object| object.name == name);
        for (index, id) in state.ids.iter().enumerate() {
            let CameraPose::Rides(ride) = &mut state.config.cameras[index].pose else { continue };
            let carrier = &before[ride.object].name;
            ride.object = place(&now(carrier)).unwrap_or(ride.object);
            if renamed.is_some_and(|(before, after)| before != after && before == carrier) {
                let camera = &state.config.cameras[index];
                self.hub.set_camera(*id, setup::info(camera, &state.config));
                let stand = setup::stand(camera, &state.config, &state.bodies);
                let known = Known { place: Some(stand), clock: None };
                let _ = state.orders.send(Order::Set(*id, Box::new(known)));
            }
        }
    }

    /// The same, when several may have changed, each by its name; each change is told.
    pub(super) fn follow_and_tell(&self, state: &mut State, objects: Vec<ObjectConfig>) {
        let before = state.config.objects.clone();
        let is_in = |all: &[ObjectConfig], name: &str| all.iter().any(|it| it.name == name);
        let gone: Vec<_> = before.iter().filter(|old| !is_in(&objects, &old.name)).collect();
        let gone: Vec<_> =
            gone.iter().map(|old| (&old.name, self.hub.object_named(&old.name))).collect();
        self.follow(state, objects, None);
        let kept = state.config.file.kept();
        for (name, object) in gone {
            let message = format!("Object \"{name}\" was removed; {kept}.");
            self.tell(Happening::Configured(Change::Removed, object), message);
        }
        for object in &state.config.objects {
            let (change, word) = match before.iter().find(|old| old.name == object.name) {
                None => (Change::Added, "added"),
                Some(old) if old != object => (Change::Changed, "changed"),
                Some(_) => continue,
            };
            let message = format!("Object \"{}\" was {word}; {kept}.", object.name);
            self.tell_configured(change, &object.name, message);
        }
    }

    fn tell_configured(&self, change: Change, name: &str, message: String) {
        self.tell(Happening::Configured(change, self.hub.object_named(name)), message);
    }
}

/// Names of the objects that are known by a whole kind.
pub fn kind_names(objects: &[ObjectConfig]) -> BTreeMap<KindId, String> {
    let of = |object: &ObjectConfig| match object.carries {
        Carried::Kind { kind, .. } => Some((kind, object.name.clone())),
        Carried::Body(_) => None,
    };
    objects.iter().filter_map(of).collect()
}

/// Point that is followed, and motion, of those that are known by a whole kind; of the others there, none.
fn kinds(
    objects: &[ObjectConfig],
    motions: &[MotionClass],
) -> BTreeMap<KindId, (Vector3<f64>, MotionClass)> {
    let of_kind = |kind: KindId| motions.get(usize::from(kind.0)).copied().unwrap_or_default();
    let of = |object: &ObjectConfig| match object.carries {
        Carried::Kind { kind, offset_m, motion } => {
            Some((kind, (offset_m, motion.unwrap_or_else(|| of_kind(kind)))))
        }
        Carried::Body(_) => None,
    };
    let mut kinds: BTreeMap<_, _> = (0..motions.len() as u16)
        .map(|index| (KindId(index), (Vector3::zeros(), of_kind(KindId(index)))))
        .collect();
    kinds.extend(objects.iter().filter_map(of));
    kinds
}

/// What is another for fusion.
fn order(
    (before, numbers): (&[ObjectConfig], &[Option<BodyId>]),
    (after, bodies): (&[ObjectConfig], &[Option<BodyId>]),
    motions: &[MotionClass],
) -> ObjectOrder {
    let gather = |objects: &[ObjectConfig], numbers: &[Option<BodyId>]| -> BTreeMap<BodyId, Body> {
        let of = |(object, number): (&ObjectConfig, &Option<BodyId>)| match &object.carries {
            Carried::Body(body) => number.map(|number| (number, body.clone())),
            Carried::Kind { .. } => None,
        };
        objects.iter().zip(numbers).filter_map(of).collect()
    };
    let (old, new) = (gather(before, numbers), gather(after, bodies));
    let gone = old.keys().filter(|id| !new.contains_key(id));
    let gone = gone.map(|id| (*id, Body { motion: MotionClass::default(), mounts: Vec::new() }));
    let fresh = new.iter().filter(|(id, body)| old.get(id) != Some(body));
    let bodies = gone.chain(fresh.map(|(id, body)| (*id, body.clone()))).collect();
    let was = kinds(before, motions);
    let is = kinds(after, motions).into_iter().filter(|(kind, is)| was.get(kind) != Some(is));
    let kinds = is.map(|(kind, (offset_m, motion))| (kind, offset_m, motion)).collect();
    ObjectOrder { bodies, kinds }
}

/// What is written otherwise, in words, commas between.
fn difference(before: &WrittenObject, after: &WrittenObject) -> String {
    let text = |it: &WrittenObject, key: &str| it.value(key).map(|value| value.to_string());
    let keys = WrittenObject::KEYS.iter().filter(|key| text(before, key) != text(after, key));
    let word = |key: &&str| match *key {
        "offset_m" => "followed point",
        "height_m" => "height",
        "roundel" => "roundels",
        "code" => "code",
        "motion" => "motion",
        _ => "name",
    };
    keys.map(word).collect::<Vec<_>>().join(", ")
}
