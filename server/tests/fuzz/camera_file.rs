//! Camera files.

use roundel_server::model::camera_file;

use super::lab::with_file;

/// A camera that is read has finite numbers, and writing and reading it again does not change it.
pub fn run(data: &[u8]) {
    match with_file("camera.yaml", data, camera_file::load_with_uncertainty) {
        Err(error) => assert!(!error.without_content().is_empty() && !error.to_string().is_empty()),
        Ok((camera, uncertainty)) => {
            let numbers = camera.intrinsics();
            let lens = numbers.lens.coefficients();
            let all = [numbers.fx_px, numbers.fy_px, numbers.cx_px, numbers.cy_px];
            assert!(all.iter().chain(lens).all(|number| number.is_finite()), "{numbers:?}");
            let text = camera_file::write_with_uncertainty("camera", &camera, uncertainty.as_ref());
            let again =
                with_file("again.yaml", text.as_bytes(), camera_file::load_with_uncertainty);
            let (again, _) = again.unwrap_or_else(|error| panic!("{error} in\n{text}"));
            assert_eq!(again.intrinsics(), camera.intrinsics());
        }
    }
}
