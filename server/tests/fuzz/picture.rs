//! Picture files, and pictures that remote programs send.

use roundel_core::frame::MAX_SIDE_PX;
use roundel_server::capture::{
    image_file::{self, Expectation, ImageError},
    source::push::SentPicture,
};

use super::lab::{SIZE, with_file};

/// A picture has the size that it states, and only one of the expected size is decoded.
pub fn run(data: &[u8]) {
    if let Ok(image) = with_file("picture", data, image_file::load) {
        let sides = [image.width, image.height];
        assert!(sides.iter().all(|side| (1..=MAX_SIDE_PX).contains(side)), "{sides:?}");
        assert_eq!(image.pixels.len(), image.width * image.height);
        image.frame().unwrap();
        let sized = with_file("picture", data, |path| {
            let mut expected = Expectation { size: Some(SIZE), ..Expectation::default() };
            image_file::load_expected(path, &mut expected)
        });
        match sized {
            Ok(sized) => assert_eq!(sized, image),
            Err(ImageError::Size { found, .. }) => assert_eq!(found, (image.width, image.height)),
            Err(other) => panic!("{other}"),
        }
    }
    if let Ok(pixels) = SentPicture::Jpeg(data.to_vec()).pixels(SIZE) {
        assert_eq!(pixels.len(), SIZE.0 * SIZE.1);
    }
}
