//! Parameters of a scenario, and the reference installations as presets.

use thiserror::Error;

use roundel_vision::{
    camera::{CameraError, Lens, LensError},
    frame::MAX_SIDE_PX,
    marker::{CodeError, CodeLayout, Kind, Pattern},
};

/// Parameters of a scenario. Equal parameters give equal pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct ScenarioParams {
    /// Seed of all random choices: paths, phases, marks on the floor, noise.
    pub seed: u64,
    /// Sides of the arena along world x and y, centred on the origin, metres.
    pub arena_m: [f64; 2],
    /// Number of robots.
    pub robots: usize,
    /// Number of robots that are parked.
    pub still: usize,
    /// Share of `robots` that fly (rounded), 0 to 1.
    pub flying_share: f64,
    /// Kinds of roundel, assigned to the robots in turn.
    pub kinds: Vec<Kind>,
    /// Height of the roundels of ground robots, metres.
    pub roundel_height_m: f64,
    /// Maximum height of flying robots' roundels, metres.
    pub flying_top_m: f64,
    /// Maximum acceleration of a robot, m/s².
    pub acceleration_limit_m_s2: f64,
    /// Positions of the cameras, named `camera-0`, `camera-1`, ….
    pub mounts: Vec<CameraMount>,
    /// Common properties of all cameras.
    pub optics: Optics,
    /// Image quality.
    pub image: ImageParams,
    /// Number of beams that swing slowly above the robots and hide some.
    pub booms: usize,
}

/// Position and target of a camera; see [`super::look_at`] for the rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraMount {
    /// World, metres.
    pub position_m: [f64; 3],
    /// World, metres.
    pub target_m: [f64; 3],
}

/// Common properties of a scenario's cameras.
#[derive(Clone, Debug, PartialEq)]
pub struct Optics {
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Focal length, pixels.
    pub focal_px: f64,
    /// Distortion.
    pub lens: Lens,
    /// Maximum offset of each principal point from the image's centre, pixels.
    pub center_offset_px: f64,
    /// Nominal rate, hertz.
    pub rate_hz: f64,
    /// Maximum offset of each camera's frames from the common phase, seconds.
    pub phase_range_s: f64,
    /// Maximum relative deviation of each camera's rate.
    pub rate_error: f64,
    /// Exposure of a row, seconds.
    pub exposure_s: f64,
    /// Time from one row's exposure to the next one's, seconds; 0 for a global shutter.
    pub line_time_s: f64,
}

/// Image quality.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageParams {
    /// Standard deviation of the lens' blur, pixels.
    pub blur_px: f64,
    /// Standard deviation of the noise, grey levels of 255.
    pub noise_levels: f64,
    /// Brightness of white paper in the middle of the arena, as a share of full scale.
    pub light: f64,
    /// Relative brightness increase at the brightest edge of the arena, as a share of `light`; the opposite edge is
    /// darker by the same amount.
    pub light_gradient: f64,
}

/// Why parameters are invalid.
#[derive(Clone, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the comments of the variants cover their fields")]
pub enum ScenarioError {
    /// A number is out of range.
    #[error("scenario: expected {field} to be {expected}, found {found}")]
    Value { field: &'static str, expected: &'static str, found: f64 },
    /// Too many robots for the arena that are `driving`, `flying` or `parked`.
    #[error(
        "scenario: expected at most {max} {role} robots in this arena, found {found}; \
         enlarge the arena, or ask for fewer"
    )]
    Crowded { role: &'static str, max: usize, found: usize },
    /// More coded robots than codes.
    #[error("scenario: expected at most {max} robots with codes of {bits} bits, found {found}")]
    Codes { bits: u8, max: usize, found: usize },
    /// Invalid code layout.
    #[error("scenario: {0}")]
    NoCodes(#[from] CodeError),
    /// The cameras see too little of the arena at these heights.
    #[error(
        "scenario: expected the cameras to see a connected middle of the arena at heights of \
         {low_m} to {high_m} m, found none; hang them higher or nearer to the middle"
    )]
    Uncovered { low_m: f64, high_m: f64 },
    /// Invalid intrinsics.
    #[error("scenario: {0}")]
    Camera(#[from] CameraError),
    /// The lens model does not cover the whole image.
    #[error("scenario: expected a lens that reaches to the image's corners, found none: {0}")]
    Lens(#[from] LensError),
    /// There is no such camera.
    #[error("scenario: expected a camera from 0 to {last}, found {found}")]
    NoSuchCamera { last: usize, found: usize },
}

impl ScenarioParams {
    /// R4, the reference installation: 10 × 8 m, four cameras 1920x1080 at 60 Hz, 24 robots with coded roundels of
    /// 160 mm (8 bits), a third of them flying, 4 parked.
    pub fn r4(seed: u64) -> Self {
        let mounts = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(x, y)| {
            CameraMount { position_m: [2.5 * x, 2.0 * y, 5.0], target_m: [1.25 * x, y, 0.0] }
        });
        let pattern = Pattern::Coded(CodeLayout { bits: 8, min_distance: 1 });
        let kind = Kind { pattern, ..Kind::plain("robot", 0.160, 0.160 * CodeLayout::RATIO) };
        Self {
            seed,
            arena_m: [10.0, 8.0],
            robots: 24,
            still: 4,
            flying_share: 1.0 / 3.0,
            kinds: vec![kind],
            roundel_height_m: 0.3,
            flying_top_m: 2.0,
            acceleration_limit_m_s2: 2.0,
            mounts: mounts.to_vec(),
            optics: Optics {
                width: 1920,
                height: 1080,
                focal_px: 1100.0,
                lens: Lens::PlumbBob([-0.08, 0.015, 0.0004, -0.0003, 0.0]),
                center_offset_px: 6.0,
                rate_hz: 60.0,
                phase_range_s: 0.040,
                rate_error: 50e-6,
                exposure_s: 0.004,
                line_time_s: 12e-6,
            },
            image: ImageParams {
                blur_px: 0.7,
                noise_levels: 2.0,
                light: 0.85,
                light_gradient: 0.15,
            },
            booms: 2,
        }
    }

    /// R4 for the demo: 1280x720 pixels at 30 Hz, too few for codes, so with plain roundels.
    pub fn r4_lite(seed: u64) -> Self {
        let mut params = Self::r4(seed);
        let optics = &mut params.optics;
        (optics.width, optics.height) = (1280, 720);
        optics.focal_px *= 1280.0 / 1920.0;
        optics.center_offset_px *= 1280.0 / 1920.0;
        optics.rate_hz = 30.0;
        params.kinds = vec![Kind::plain("robot", 0.160, 0.064)];
        params
    }

    /// The demo's installation with roundels of three kinds with elliptical discs, which show the heading up to
    /// 180°.
    pub fn r4_elliptical(seed: u64) -> Self {
        let kind = |name: &str, along_m: f64, minor_diameter_m: f64| Kind {
            pattern: Pattern::Elliptical { minor_diameter_m },
            ..Kind::plain(name, 0.160, along_m)
        };
        let kinds = vec![
            kind("broad", 0.112, 0.072),
            kind("small", 0.096, 0.064),
            kind("slim", 0.112, 0.056),
        ];
        Self { kinds, ..Self::r4_lite(seed) }
    }

    /// Number of flying robots.
    pub fn flying(&self) -> usize {
        (self.robots as f64 * self.flying_share).round() as usize
    }

    /// Checks the range of each number; [`super::Scenario::new`] also checks the number of robots.
    pub fn validate(&self) -> Result<(), ScenarioError> {
        within("arena_m[0]", self.arena_m[0], [2.0, 1000.0], "2 to 1000 m")?;
        within("arena_m[1]", self.arena_m[1], [2.0, 1000.0], "2 to 1000 m")?;
        within("booms", self.booms as f64, [0.0, 16.0], "0 to 16")?;
        within("mounts", self.mounts.len() as f64, [1.0, 1000.0], "1 to 1000 cameras")?;
        for mount in &self.mounts {
            let clear_m = mount.position_m[2] - self.flying_top_m;
            within("mounts' height above flying_top_m", clear_m, [1.0, 100.0], "1 to 100 m")?;
        }
        self.validate_robots()?;
        self.optics.validate()?;
        self.image.validate()
    }

    fn validate_robots(&self) -> Result<(), ScenarioError> {
        within("flying_share", self.flying_share, [0.0, 1.0], "0 to 1")?;
        let max_still = (self.robots - self.flying().min(self.robots)) as f64;
        let role = "0 to the number of robots that do not fly";
        within("still", self.still as f64, [0.0, max_still], role)?;
        within("kinds", self.kinds.len() as f64, [1.0, 65_536.0], "1 to 65536 kinds")?;
        for kind in &self.kinds {
            let outer_m = kind.outer_diameter_m;
            within("kinds' outer_diameter_m", outer_m, [0.01, 0.25], "0.01 to 0.25 m")?;
            let ratio = kind.inner_diameter_m / outer_m;
            within("kinds' inner over outer diameter", ratio, [0.1, 0.9], "0.1 to 0.9")?;
            if let Pattern::Elliptical { minor_diameter_m } = kind.pattern {
                let share = minor_diameter_m / kind.inner_diameter_m;
                within("kinds' shorter over longer inner diameter", share, [0.1, 1.0], "0.1 to 1")?;
            }
        }
        within("roundel_height_m", self.roundel_height_m, [0.05, 0.6], "0.05 to 0.6 m")?;
        within("flying_top_m", self.flying_top_m, [1.5, 100.0], "1.5 to 100 m")?;
        let limit_m_s2 = self.acceleration_limit_m_s2;
        within("acceleration_limit_m_s2", limit_m_s2, [0.01, 2.5], "0.01 to 2.5 m/s²")
    }
}

impl Optics {
    fn validate(&self) -> Result<(), ScenarioError> {
        let side = MAX_SIDE_PX as f64;
        let (width, height) = (self.width as f64, self.height as f64);
        within("optics.width", width, [64.0, side], "64 to 16384 px")?;
        within("optics.height", height, [64.0, side], "64 to 16384 px")?;
        within("optics.focal_px", self.focal_px, [10.0, 1e5], "10 to 100000 px")?;
        let center_px = [0.0, 0.2 * width.min(height)];
        let share = "0 to a fifth of the image's smaller side";
        within("optics.center_offset_px", self.center_offset_px, center_px, share)?;
        within("optics.rate_hz", self.rate_hz, [0.1, 1000.0], "0.1 to 1000 Hz")?;
        within("optics.phase_range_s", self.phase_range_s, [0.0, 10.0], "0 to 10 s")?;
        within("optics.rate_error", self.rate_error, [0.0, 0.1], "0 to 0.1")?;
        within("optics.exposure_s", self.exposure_s, [0.0, 0.05], "0 to 0.05 s")?;
        within("optics.line_time_s", self.line_time_s, [0.0, 1e-3], "0 to 0.001 s")
    }
}

impl ImageParams {
    fn validate(&self) -> Result<(), ScenarioError> {
        within("image.blur_px", self.blur_px, [0.0, 3.0], "0 to 3 px")?;
        within("image.noise_levels", self.noise_levels, [0.0, 30.0], "0 to 30 levels")?;
        within("image.light", self.light, [0.1, 1.0], "0.1 to 1")?;
        within("image.light_gradient", self.light_gradient, [0.0, 0.8], "0 to 0.8")
    }
}

fn within(
    field: &'static str,
    found: f64,
    [low, high]: [f64; 2],
    expected: &'static str,
) -> Result<(), ScenarioError> {
    // Also false for NaN.
    if (low..=high).contains(&found) {
        Ok(())
    } else {
        Err(ScenarioError::Value { field, expected, found })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid() {
        assert_eq!(ScenarioParams::r4(1).validate(), Ok(()));
        assert_eq!(ScenarioParams::r4_lite(2).validate(), Ok(()));
        assert_eq!(ScenarioParams::r4_elliptical(2).validate(), Ok(()));
    }

    #[test]
    fn values_out_of_range_are_named() {
        let mut params = ScenarioParams::r4_lite(1);
        params.image.blur_px = f64::NAN;
        assert!(params.validate().unwrap_err().to_string().contains("image.blur_px"));
        let mut params = ScenarioParams::r4_lite(1);
        params.still = 17;
        assert_eq!(
            params.validate().unwrap_err().to_string(),
            "scenario: expected still to be 0 to the number of robots that do not fly, found 17"
        );
    }
}
