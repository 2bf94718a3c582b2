//! The two normals of an ellipse: views and motion decide between them, and a decision can be reversed.

use nalgebra::Vector3;
use roundel_core::world::{FrameObservations, FusionParams};

use super::{
    arena::{Arena, START, Setting},
    score::fusion_of,
};

fn setting(cameras: usize) -> Setting {
    Setting { objects: 1, still: 1, cameras, dropout: 0.0, ..Setting::default() }
}

/// Makes every detection list the wrong normal first, with this likelihood.
fn misled(arena: &Arena, frames: &mut [FrameObservations], likelihood: f64) {
    for frame in frames {
        let placement = arena.placements[frame.camera.0 as usize].world_from_camera;
        for pose in frame.detections.iter_mut().filter_map(|detection| detection.pose.as_mut()) {
            let up = |normal: &Vector3<f64>| (placement.rotation * normal).z;
            if up(&pose.normal) > up(&pose.other_normal) {
                std::mem::swap(&mut pose.normal, &mut pose.other_normal);
            }
            pose.normal_likelihood = likelihood;
        }
    }
}

fn right_one(arena: &Arena, frames: &mut [FrameObservations], likelihood: f64) {
    misled(arena, frames, likelihood);
    for pose in frames.iter_mut().flat_map(|frame| &mut frame.detections) {
        if let Some(pose) = &mut pose.pose {
            std::mem::swap(&mut pose.normal, &mut pose.other_normal);
        }
    }
}

fn tilt_rad(arena: &Arena, frames: &[FrameObservations]) -> f64 {
    let mut fusion = fusion_of(arena, FusionParams::default());
    for frame in frames {
        fusion.observe(frame);
    }
    let end = frames.last().unwrap().capture_time;
    let snapshot = fusion.snapshot(end);
    assert_eq!(snapshot.objects.len(), 1);
    (snapshot.objects[0].orientation * Vector3::z()).angle(&arena.truth(0, end).normal)
}

#[test]
fn several_views_outvote_wrong_likelihoods() {
    let arena = Arena::new(setting(4));
    let mut frames = arena.frames(2.0);
    misled(&arena, &mut frames, 0.7);
    assert!(tilt_rad(&arena, &frames) < 0.15);
}

#[test]
fn one_view_follows_its_likelihood_and_can_reverse() {
    let mut arena = Arena::new(setting(4));
    let camera = arena.frames(0.1).iter().find(|f| !f.detections.is_empty()).unwrap().camera;
    arena.setting.cameras = 4;
    let mut frames = arena.frames(6.0);
    frames.retain(|frame| frame.camera == camera);
    let half = frames.iter().position(|f| f.capture_time > START.plus_seconds(3.0)).unwrap();
    misled(&arena, &mut frames[..half], 0.9);
    right_one(&arena, &mut frames[half..], 0.9);
    assert!(tilt_rad(&arena, &frames[..half]) > 0.3);
    assert!(tilt_rad(&arena, &frames) < 0.15);
}

#[test]
fn undecided_normals_widen_the_covariance() {
    let arena = Arena::new(setting(4));
    let mut frames = arena.frames(2.0);
    let camera = frames.iter().find(|f| !f.detections.is_empty()).unwrap().camera;
    frames.retain(|frame| frame.camera == camera);
    right_one(&arena, &mut frames, 0.5);
    let rotation_rad = |frames: &[FrameObservations]| {
        let mut fusion = fusion_of(&arena, FusionParams::default());
        frames.iter().for_each(|frame| fusion.observe(frame));
        let snapshot = fusion.snapshot(frames.last().unwrap().capture_time);
        let object = &snapshot.objects[0];
        let across = object.orientation * Vector3::x();
        let along = object.orientation * Vector3::y();
        let block = object.covariance.fixed_view::<3, 3>(3, 3);
        (across.dot(&(block * across)) + along.dot(&(block * along))).sqrt()
    };
    let undecided = rotation_rad(&frames);
    let mut frames = arena.frames(2.0);
    right_one(&arena, &mut frames, 0.5);
    assert!(undecided > 3.0 * rotation_rad(&frames), "{undecided}");
}
