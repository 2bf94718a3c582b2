//! Where cameras that ride on objects are, as often as snapshots come.

use crate::v1::{Camera, LifeStage, Pose, Quaternion, Snapshot, Vector3};

/// world_from_camera at the snapshot's pose time: of a camera that stands its pose, of one that rides its
/// object's pose with the camera's place on it (`mount`). `None` while it is not known: `pose_status` and
/// `pose_reason` say why.
///
/// [`crate::Client::cameras`] gives the camera; asked once, it does for as long as `mount` stays.
pub fn camera_pose_at(camera: &Camera, snapshot: &Snapshot) -> Option<Pose> {
    let Some(mount) = &camera.mount else { return camera.pose };
    let mut own = snapshot.objects.iter().filter(|object| {
        let is_followed = matches!(object.stage(), LifeStage::Tracked | LifeStage::Predicted);
        is_followed && object.name == camera.carrier
    });
    let object = own.next().filter(|object| object.yaw_observed && object.yaw_symmetry <= 1)?;
    // Seen twice it is nowhere.
    if own.next().is_some() {
        return None;
    }
    let (turn, arm) = (object.orientation?, mount.position?);
    let (place, arm) = (object.position?, rotated(&turn, &arm));
    Some(Pose {
        position: Some(Vector3 { x: place.x + arm.x, y: place.y + arm.y, z: place.z + arm.z }),
        orientation: Some(product(&turn, &mount.orientation?)),
    })
}

/// The rotation by `b`, then by `a`.
fn product(a: &Quaternion, b: &Quaternion) -> Quaternion {
    Quaternion {
        x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
        y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
        z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
        w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
    }
}

fn rotated(turn: &Quaternion, v: &Vector3) -> Vector3 {
    let back = Quaternion { x: -turn.x, y: -turn.y, z: -turn.z, w: turn.w };
    let turned = product(&product(turn, &Quaternion { x: v.x, y: v.y, z: v.z, w: 0.0 }), &back);
    Vector3 { x: turned.x, y: turned.y, z: turned.z }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1::ObjectState;

    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;

    fn camera() -> Camera {
        let mount = Pose {
            position: Some(Vector3 { x: 0.5, y: 0.0, z: -0.1 }),
            orientation: Some(Quaternion { x: 1.0, y: 0.0, z: 0.0, w: 0.0 }),
        };
        Camera { carrier: "drone".into(), mount: Some(mount), ..Default::default() }
    }

    /// At (1, 2, 3), a quarter turn to the left.
    fn drone() -> ObjectState {
        ObjectState {
            name: "drone".into(),
            stage: LifeStage::Tracked as i32,
            position: Some(Vector3 { x: 1.0, y: 2.0, z: 3.0 }),
            orientation: Some(Quaternion { x: 0.0, y: 0.0, z: HALF, w: HALF }),
            yaw_observed: true,
            yaw_symmetry: 1,
            ..Default::default()
        }
    }

    fn pose(objects: Vec<ObjectState>) -> Option<Pose> {
        camera_pose_at(&camera(), &Snapshot { objects, ..Default::default() })
    }

    #[test]
    fn a_camera_is_where_its_object_has_carried_it() {
        let pose = pose(vec![drone()]).unwrap();
        let (p, q) = (pose.position.unwrap(), pose.orientation.unwrap());
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(near(p.x, 1.0) && near(p.y, 2.5) && near(p.z, 2.9), "{p:?}");
        // Its right is where the object's x is, and it looks down.
        let right = rotated(&q, &Vector3 { x: 1.0, y: 0.0, z: 0.0 });
        let ahead = rotated(&q, &Vector3 { x: 0.0, y: 0.0, z: 1.0 });
        assert!(near(right.y, 1.0) && near(ahead.z, -1.0), "{right:?}, {ahead:?}");
    }

    #[test]
    fn without_its_object_it_is_nowhere() {
        assert_eq!(pose(vec![]), None);
        assert_eq!(pose(vec![drone(), drone()]), None);
        assert_eq!(pose(vec![ObjectState { yaw_observed: false, ..drone() }]), None);
        assert_eq!(pose(vec![ObjectState { name: "other".into(), ..drone() }]), None);
        assert_eq!(pose(vec![ObjectState { stage: LifeStage::Lost as i32, ..drone() }]), None);
        let standing = Camera { pose: Some(Pose::default()), ..Default::default() };
        assert_eq!(camera_pose_at(&standing, &Snapshot::default()), Some(Pose::default()));
    }
}
