//! Which body each configured object is, and what fusion has to hear of when objects change.

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

/// The numbers that bodies were given, none of them twice.
#[derive(Clone, Debug, Default)]
pub struct BodyTable {
    /// Of each object of the configuration; `None`: it is known by a whole kind.
    pub numbers: Vec<Option<BodyId>>,
    /// Names of all bodies that there ever were, by number; empty of one that was removed.
    pub names: Vec<String>,
}

impl BodyTable {
    /// As a fusion machine numbers them that begins with these objects.
    pub fn of(objects: &[ObjectConfig]) -> Self {
        let mut bodies = Self::default();
        bodies.number(&BTreeMap::new(), objects);
        bodies
    }

    /// Takes over other objects than `before`, of which one may have another name (`renamed`, from and to): what is
    /// another for fusion.
    pub fn update(
        &mut self,
        (before, after): (&[ObjectConfig], &[ObjectConfig]),
        renamed: Option<(&str, &str)>,
        motions: &[MotionClass],
    ) -> ObjectUpdate {
        let now = |name: &str| match renamed {
            Some((before, after)) if before == name => after.to_owned(),
            _ => name.to_owned(),
        };
        let numbers = std::mem::take(&mut self.numbers);
        let named = before.iter().map(|object| now(&object.name)).zip(numbers.iter().copied());
        let known = named.filter_map(|(name, number)| Some((name, number?))).collect();
        self.number(&known, after);
        diff((before, &numbers), (after, &self.numbers), motions)
    }

    /// Gives each body the number that is known of its name, or a new one.
    fn number(&mut self, known: &BTreeMap<String, BodyId>, objects: &[ObjectConfig]) {
        self.names.iter_mut().for_each(String::clear);
        for object in objects {
            let ObjectRoundels::Body(_) = object.carries else {
                self.numbers.push(None);
                continue;
            };
            let body = known.get(&object.name).copied().unwrap_or_else(|| {
                self.names.push(String::new());
                BodyId(self.names.len() as u32 - 1)
            });
            self.names[body.0 as usize].clone_from(&object.name);
            self.numbers.push(Some(body));
        }
    }
}

/// Names of the objects that are known by a whole kind.
pub fn kind_names(objects: &[ObjectConfig]) -> BTreeMap<KindId, String> {
    let of = |object: &ObjectConfig| match object.carries {
        ObjectRoundels::Kind { kind, .. } => Some((kind, object.name.clone())),
        ObjectRoundels::Body(_) => None,
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
        ObjectRoundels::Kind { kind, offset_m, motion } => {
            Some((kind, (offset_m, motion.unwrap_or_else(|| of_kind(kind)))))
        }
        ObjectRoundels::Body(_) => None,
    };
    let mut kinds: BTreeMap<_, _> = (0..motions.len() as u16)
        .map(|index| (KindId(index), (Vector3::zeros(), of_kind(KindId(index)))))
        .collect();
    kinds.extend(objects.iter().filter_map(of));
    kinds
}

fn diff(
    (before, numbers): (&[ObjectConfig], &[Option<BodyId>]),
    (after, bodies): (&[ObjectConfig], &[Option<BodyId>]),
    motions: &[MotionClass],
) -> ObjectUpdate {
    let gather = |objects: &[ObjectConfig], numbers: &[Option<BodyId>]| -> BTreeMap<BodyId, Body> {
        let of = |(object, number): (&ObjectConfig, &Option<BodyId>)| match &object.carries {
            ObjectRoundels::Body(body) => number.map(|number| (number, body.clone())),
            ObjectRoundels::Kind { .. } => None,
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
    ObjectUpdate { bodies, kinds }
}
