//! Prints the pose of each plain roundel in a picture of an ideal camera:
//!
//! `cargo run --release -p roundel-vision --example poses -- PICTURE.png FOCAL_PX [OUTER_MM INNER_MM]`

use std::{env, error::Error, fs::File, io::BufReader, process::ExitCode};

use roundel_vision::{
    camera::{Camera, Intrinsics, Lens},
    frame::Frame,
    marker::{Detector, Kind, Mode, Params, Scratch},
    pose::Locator,
};

/// Diameters of a roundel printed by `roundel print`, millimetres.
const DIAMETERS_MM: [f64; 2] = [160.0, 64.0];

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let (picture, focal_px, diameters_mm) = match arguments.as_slice() {
        [picture, focal_px] => (picture, number(focal_px)?, DIAMETERS_MM),
        [picture, focal_px, outer_mm, inner_mm] => {
            (picture, number(focal_px)?, [number(outer_mm)?, number(inner_mm)?])
        }
        _ => return Err("expected PICTURE.png FOCAL_PX [OUTER_MM INNER_MM]".into()),
    };
    let (width, height, pixels) = read_grey(picture)
        .map_err(|error| format!("{picture}: expected a PNG picture: {error}"))?;
    let frame = Frame::new(&pixels, width, height, width)?;
    let camera = Camera::new(Intrinsics {
        width,
        height,
        fx_px: focal_px,
        fy_px: focal_px,
        cx_px: 0.5 * (width as f64 - 1.0),
        cy_px: 0.5 * (height as f64 - 1.0),
        lens: Lens::PlumbBob([0.0; 5]),
    })?;

    let [outer_m, inner_m] = diameters_mm.map(|it| it * 1e-3);
    let kind = Kind::plain("roundel", outer_m, inner_m);
    let mode = Mode::Precise;
    let detector = Detector::new(vec![kind.clone()], Params { mode, ..Params::default() })?;
    let mut locator = Locator::new(camera, vec![kind.clone()], mode);
    let mut scratch = Scratch::default();
    let rings = detector.detect(&frame, &mut scratch);
    println!("{} roundels", rings.len());
    for ring in rings {
        let pose = locator.locate_single(&frame, &kind, ring)?.pose;
        let deviation_m = pose.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
        println!(
            "({:.1}, {:.1}) px: position {:.4?} m ± {:.1e} m, normal {:.3?}",
            ring.outer.center.u,
            ring.outer.center.v,
            pose.position_m.as_slice(),
            deviation_m,
            pose.normal.as_slice()
        );
    }
    Ok(())
}

fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| format!("expected a number, found `{text}`"))
}

/// Columns, rows and grey levels of a PNG file.
fn read_grey(path: &str) -> Result<(usize, usize, Vec<u8>), Box<dyn Error>> {
    let mut decoder = png::Decoder::new(BufReader::new(File::open(path)?));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info()?;
    let mut bytes = vec![0; reader.output_buffer_size().ok_or("the picture is too large")?];
    let info = reader.next_frame(&mut bytes)?;
    let samples = info.color_type.samples();
    let grey = |pixel: &[u8]| match pixel {
        [red, green, blue, ..] => {
            ((u32::from(*red) * 77 + u32::from(*green) * 150 + u32::from(*blue) * 29) >> 8) as u8
        }
        [grey, ..] => *grey,
        [] => 0,
    };
    let pixels = bytes[..info.buffer_size()].chunks(samples).map(grey).collect();
    Ok((info.width as usize, info.height as usize, pixels))
}
