//! Numbers of the configured objects' bodies, and the diff of two versions of the objects for fusion.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use roundel_core::{
    id::{BodyId, KindId},
    world::{Body, MotionClass},
};

use crate::model::{
    command::ObjectUpdate,
    config::{ObjectConfig, ObjectRoundels},
};

/// Body numbers, which are never reused.
#[derive(Clone, Debug, Default)]
pub struct BodyTable {
    /// Body of each configured object; `None` if it is identified by its kind.
    pub numbers: Vec<Option<BodyId>>,
    /// Names of all bodies by number; empty if removed.
    pub names: Vec<String>,
}

impl BodyTable {
    /// Numbers of the bodies in a new fusion machine.
    pub fn of(objects: &[ObjectConfig]) -> Self {
        let mut bodies = Self::default();
        bodies.number(&BTreeMap::new(), objects);
        bodies
    }

    /// Numbers the objects of a new version, of which one may be renamed (old and new name), and returns the difference.
    pub fn update(
        &mut self,
        (before, after): (&[ObjectConfig], &[ObjectConfig]),
        renamed: Option<(&str, &str)>,
        motions: &[MotionClass],
    ) -> ObjectUpdate {
        let numbers = std::mem::take(&mut self.numbers);
        let known = before.iter().zip(&numbers).filter_map(|(object, number)| {
            let name = renamed.filter(|(from, _)| *from == object.name);
            Some((name.map_or(object.name.as_str(), |(_, to)| to), (*number)?))
        });
        self.number(&known.collect(), after);

        let (old, new) = (bodies(before, &numbers), bodies(after, &self.numbers));
        let removed = old.keys().filter(|id| !new.contains_key(id));
        let empty = Body { motion: MotionClass::default(), mounts: Vec::new() };
        let removed = removed.map(|id| (*id, empty.clone()));
        let changed = new.iter().filter(|(id, body)| old.get(id) != Some(body));
        let changed = changed.map(|(id, body)| (*id, (*body).clone()));
        let old_kinds = kinds(before, motions);
        let new_kinds = kinds(after, motions).into_iter();
        ObjectUpdate {
            bodies: removed.chain(changed).collect(),
            kinds: new_kinds
                .filter(|(kind, motion)| old_kinds.get(kind) != Some(motion))
                .map(|(kind, (offset_m, motion))| (kind, offset_m, motion))
                .collect(),
        }
    }

    /// Gives each body its known number, or a new one.
    fn number(&mut self, known: &BTreeMap<&str, BodyId>, objects: &[ObjectConfig]) {
        self.names.iter_mut().for_each(String::clear);
        for object in objects {
            let ObjectRoundels::Body(_) = object.carries else {
                self.numbers.push(None);
                continue;
            };
            let body = known.get(object.name.as_str()).copied().unwrap_or_else(|| {
                self.names.push(String::new());
                BodyId(self.names.len() as u32 - 1)
            });
            self.names[body.0 as usize].clone_from(&object.name);
            self.numbers.push(Some(body));
        }
    }
}

/// Names of the objects that are identified by their kind.
pub fn kind_names(objects: &[ObjectConfig]) -> BTreeMap<KindId, String> {
    let of = |object: &ObjectConfig| match object.carries {
        ObjectRoundels::Kind { kind, .. } => Some((kind, object.name.clone())),
        ObjectRoundels::Body(_) => None,
    };
    objects.iter().filter_map(of).collect()
}

/// Followed point and motion of each kind.
fn kinds(
    objects: &[ObjectConfig],
    motions: &[MotionClass],
) -> BTreeMap<KindId, (Vector3<f64>, MotionClass)> {
    let mut kinds: BTreeMap<_, _> =
        (0..).map(KindId).zip(motions.iter().map(|motion| (Vector3::zeros(), *motion))).collect();
    for object in objects {
        if let ObjectRoundels::Kind { kind, offset_m, motion } = object.carries {
            let of_kind = motions.get(usize::from(kind.0)).copied().unwrap_or_default();
            kinds.insert(kind, (offset_m, motion.unwrap_or(of_kind)));
        }
    }
    kinds
}

fn bodies<'a>(
    objects: &'a [ObjectConfig],
    numbers: &[Option<BodyId>],
) -> BTreeMap<BodyId, &'a Body> {
    let of = |(object, number): (&'a ObjectConfig, &Option<BodyId>)| match &object.carries {
        ObjectRoundels::Body(body) => Some(((*number)?, body)),
        ObjectRoundels::Kind { .. } => None,
    };
    objects.iter().zip(numbers).filter_map(of).collect()
}
