//! Poses of cameras that are mounted on objects.

use crate::v1::{Camera, LifeStage, Pose, Quaternion, Snapshot, Vector3};

/// world_from_camera at the snapshot's pose time. A fixed camera has its `pose`; a mounted camera has the pose of its object
/// (`carrier`) composed with `mount`. `None` if unknown; `pose_status` and `pose_reason` give the cause.
///
/// `camera` comes from [`crate::Client::cameras`] and stays valid until `mount` changes.
pub fn camera_pose_at(camera: &Camera, snapshot: &Snapshot) -> Option<Pose> {
    let Some(mount) = &camera.mount else { return camera.pose };
    let mut carriers = snapshot.objects.iter().filter(|object| {
        let is_tracked = matches!(object.stage(), LifeStage::Tracked | LifeStage::Predicted);
        is_tracked && object.name == camera.carrier
    });
    let object =
        carriers.next().filter(|object| object.yaw_observed && object.yaw_symmetry <= 1)?;
    // Two objects with that name make the pose ambiguous.
    if carriers.next().is_some() {
        return None;
    }
    let (rotation, offset) = (object.orientation?, mount.position?);
    let (position, offset) = (object.position?, rotated(&rotation, &offset));
    Some(Pose {
        position: Some(Vector3 {
            x: position.x + offset.x,
            y: position.y + offset.y,
            z: position.z + offset.z,
        }),
        orientation: Some(product(&rotation, &mount.orientation?)),
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

fn rotated(rotation: &Quaternion, v: &Vector3) -> Vector3 {
    let inverse = Quaternion { x: -rotation.x, y: -rotation.y, z: -rotation.z, w: rotation.w };
    let rotated =
        product(&product(rotation, &Quaternion { x: v.x, y: v.y, z: v.z, w: 0.0 }), &inverse);
    Vector3 { x: rotated.x, y: rotated.y, z: rotated.z }
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
    fn a_mounted_camera_has_the_pose_of_its_object_and_mount() {
        let pose = pose(vec![drone()]).unwrap();
        let (p, q) = (pose.position.unwrap(), pose.orientation.unwrap());
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(near(p.x, 1.0) && near(p.y, 2.5) && near(p.z, 2.9), "{p:?}");
        // Its x axis is the object's, and it looks down.
        let right = rotated(&q, &Vector3 { x: 1.0, y: 0.0, z: 0.0 });
        let ahead = rotated(&q, &Vector3 { x: 0.0, y: 0.0, z: 1.0 });
        assert!(near(right.y, 1.0) && near(ahead.z, -1.0), "{right:?}, {ahead:?}");
    }

    #[test]
    fn a_mounted_camera_without_its_object_has_no_pose() {
        assert_eq!(pose(vec![]), None);
        assert_eq!(pose(vec![drone(), drone()]), None);
        assert_eq!(pose(vec![ObjectState { yaw_observed: false, ..drone() }]), None);
        assert_eq!(pose(vec![ObjectState { name: "other".into(), ..drone() }]), None);
        assert_eq!(pose(vec![ObjectState { stage: LifeStage::Lost as i32, ..drone() }]), None);
        let fixed = Camera { pose: Some(Pose::default()), ..Default::default() };
        assert_eq!(camera_pose_at(&fixed, &Snapshot::default()), Some(Pose::default()));
    }
}
