//! An object as the configuration says it.

use roundel_proto::v1;

use crate::config::edit::{WrittenMount, WrittenObject, WrittenRoundels};

/// For clients.
pub fn object_setup(object: &WrittenObject) -> v1::ObjectSetup {
    let (roundel, roundels) = match &object.roundel {
        None => (String::new(), Vec::new()),
        Some(WrittenRoundels::One(kind)) => (kind.clone(), Vec::new()),
        Some(WrittenRoundels::Several(mounts)) => {
            (String::new(), mounts.iter().map(mounted).collect())
        }
    };
    v1::ObjectSetup {
        name: object.name.clone(),
        roundel,
        roundels,
        code: object.code,
        offset_m: object.offset_m.map(vector),
        motion: object.motion.clone().unwrap_or_default(),
        height_m: object.height_m,
    }
}

fn mounted(mount: &WrittenMount) -> v1::MountedRoundel {
    v1::MountedRoundel {
        kind: mount.kind.clone(),
        code: mount.code,
        position_m: mount.position_m.map(vector),
        yaw_deg: mount.yaw_deg,
        right: mount.right.map(vector),
        top: mount.top.map(vector),
    }
}

/// As a client has it written. Whether it makes sense is for the configuration to say.
pub fn written_object(object: v1::ObjectSetup) -> WrittenObject {
    let text = |text: String| (!text.is_empty()).then_some(text);
    WrittenObject {
        name: object.name,
        // One kind beside a list contradicts it: the list is what would be lost by mistake.
        roundel: match object.roundels.is_empty() {
            true => text(object.roundel).map(WrittenRoundels::One),
            false => {
                let mounts = object.roundels.into_iter().map(written_mount).collect();
                Some(WrittenRoundels::Several(mounts))
            }
        },
        code: object.code,
        offset_m: object.offset_m.map(array),
        motion: text(object.motion),
        height_m: object.height_m,
    }
}

fn written_mount(mount: v1::MountedRoundel) -> WrittenMount {
    WrittenMount {
        kind: mount.kind,
        code: mount.code,
        position_m: mount.position_m.map(array),
        yaw_deg: mount.yaw_deg,
        right: mount.right.map(array),
        top: mount.top.map(array),
    }
}

fn vector([x, y, z]: [f64; 3]) -> v1::Vector3 {
    v1::Vector3 { x, y, z }
}

fn array(v1::Vector3 { x, y, z }: v1::Vector3) -> [f64; 3] {
    [x, y, z]
}
