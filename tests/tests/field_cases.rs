//! Small inputs that once failed (`../shared/data/field-cases`); the README beside each says what was wrong.

use nalgebra::Vector3;
use roundel_core::{
    marker::{Detector, Kind, Mode, Params, Scratch},
    pose::Locator,
};
use roundel_server::{capture::image_file, model::camera_file};
use roundel_tests::shared_data::shared_data;

#[test]
fn samples_of_ten_and_twelve_bits_are_scaled() {
    const NAME: &str = "samples_of_ten_and_twelve_bits_are_scaled";
    let Some(folder) = shared_data(NAME, "field-cases/png-12-bits-in-16") else { return };
    let kinds = vec![Kind::plain("robot", 0.16, 0.064)];
    let camera = camera_file::load(&folder.join("camera.yaml")).unwrap();
    let detector = Detector::new(kinds.clone(), Params::default()).unwrap();
    let mut locator = Locator::new(camera, kinds.clone(), Mode::Precise);
    for file in ["mono10.png", "mono12.png"] {
        let image = image_file::load(&folder.join(file)).unwrap();
        let frame = image.frame().unwrap();
        let rings = detector.detect(&frame, &mut Scratch::default()).to_vec();
        let [ring] = rings[..] else { panic!("{file}: {rings:?}") };
        let position_m = locator.locate_single(&frame, &kinds[0], &ring).unwrap().pose.position_m;
        let off_m = (position_m - Vector3::new(0.010, -0.005, 2.2)).norm();
        assert!(off_m < 0.01, "{file}: {position_m:?}");
    }
}
