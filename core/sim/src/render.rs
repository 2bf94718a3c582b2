//! Renders the 8-bit frames of a scenario's cameras.
//!
//! The static background (floor, clutter, light) is painted once, through the lens. A frame then costs the windows of
//! visible robots and one pass for the noise; see `benches/sim.rs`. A robot is shown as it is at the middle of the exposure
//! of its centre's image row; other rows are shifted with its velocity for the rolling shutter.

use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use thiserror::Error;

use super::{
    albedo::Teeth,
    canvas::Canvas,
    floor::Floor,
    light::Light,
    noise::{SensorNoise, mix},
    params::ScenarioError,
    patch::{Inside, Patch, Setting, Shape, Sheet},
    ray::RayGrid,
    scenario::{RobotTruth, Scenario},
    sim_camera::SimCamera,
};
use roundel_vision::{marker::Pattern, rigid::Rigid};

/// Renders the frames of one camera. Each frame depends on scenario, camera and frame number only.
pub struct Renderer {
    scenario: Scenario,
    camera: SimCamera,
    light: Light,
    noise: SensorNoise,
    grid: RayGrid,
    canvas: Canvas,
}

/// Buffer of a wrong length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("expected a buffer of {expected} bytes, one for each pixel, found {found}")]
pub struct BufferError {
    /// Width times height.
    pub expected: usize,
    /// Length of the buffer.
    pub found: usize,
}

impl Renderer {
    /// Renderer for one camera of a scenario. Paints the background, which takes about as long as a hundred frames.
    pub fn new(scenario: &Scenario, camera_index: usize) -> Result<Self, ScenarioError> {
        let cameras = scenario.cameras();
        let camera = cameras
            .get(camera_index)
            .ok_or(ScenarioError::NoSuchCamera { last: cameras.len() - 1, found: camera_index })?;
        let params = scenario.params();
        let grid = RayGrid::new(&camera.camera)?;
        let light = Light::new(params);
        let background = Floor::new(params).picture(camera, &grid, &light, params.image.blur_px);
        let width = camera.camera.width();
        let noise_seed = mix(mix(params.seed, 0x0153), camera_index as u64);
        Ok(Self {
            scenario: scenario.clone(),
            camera: camera.clone(),
            light,
            noise: SensorNoise::new(noise_seed, width, params.image.noise_levels),
            grid,
            canvas: Canvas::new(width, background),
        })
    }

    /// The rendered camera.
    pub fn camera(&self) -> &SimCamera {
        &self.camera
    }

    /// Adopts the commands of another scenario with the same parameters.
    pub fn follow(&mut self, scenario: &Scenario) {
        self.scenario.follow(scenario);
    }

    /// Renders a frame into `pixels`, row by row without gaps, and returns its capture time (middle of the exposure
    /// at the middle row), seconds after the scenario's start. The same number always gives the same pixels.
    pub fn render(&mut self, frame: u64, pixels: &mut [u8]) -> Result<f64, BufferError> {
        let (width, height) = (self.camera.camera.width(), self.camera.camera.height());
        if pixels.len() != width * height {
            return Err(BufferError { expected: width * height, found: pixels.len() });
        }
        let time_s = self.camera.frame_time_s(frame);
        self.paint_robots(time_s);
        self.paint_booms(time_s);
        for (v, row) in pixels.chunks_exact_mut(width).enumerate() {
            self.noise.develop(frame, v, self.canvas.row(v), row);
        }
        self.canvas.restore();
        Ok(time_s)
    }

    fn paint_robots(&mut self, time_s: f64) {
        let eye = self.camera.world_from_camera.translation.vector;
        let mut robots: Vec<(f64, RobotTruth)> = (0..self.scenario.params().robots)
            .filter_map(|index| self.exposed(index, time_s))
            .map(|robot| {
                let distance_m = (robot.world_from_roundel.translation.vector - eye).norm();
                (distance_m, robot)
            })
            .collect();
        // Nearer robots hide farther ones.
        robots.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, robot) in &robots {
            self.paint_shadow(robot);
        }
        for (_, robot) in &robots {
            self.paint_body(robot);
            self.paint_roundel(robot);
        }
    }

    /// A robot when the row of its centre is exposed; `None` if far outside of the image.
    fn exposed(&self, index: usize, time_s: f64) -> Option<RobotTruth> {
        let robot = self.scenario.robot(index, time_s);
        let center = Point3::from(robot.world_from_roundel.translation.vector);
        // A robot with its shadow spans less than an eighth of the image's width.
        let margin_px = self.camera.camera.width() as f64 / 6.0;
        if !self.camera.sees(&center, -margin_px) {
            return None;
        }
        let row_v_px = self.camera.project(&center)?.v;
        Some(self.scenario.robot(index, self.camera.row_time_s(time_s, row_v_px)))
    }

    fn paint_shadow(&mut self, robot: &RobotTruth) {
        let position = robot.world_from_roundel.translation.vector;
        let height_m = position.z as f32;
        // Slightly oblique light.
        let on_floor =
            Vector3::new(position.x + 0.12 * position.z, position.y - 0.08 * position.z, 0.0);
        let plane = Rigid::from_parts(Translation3::from(on_floor), UnitQuaternion::identity());
        let shadow = Shape::Shadow {
            radius_m: 0.22 + 0.07 * height_m,
            opacity: 0.6 / (1.0 + 0.5 * height_m),
        };
        self.paint_on(&plane, &Vector3::zeros(), &shadow);
    }

    fn paint_body(&mut self, robot: &RobotTruth) {
        let shade = mix(self.scenario.params().seed, robot.index as u64) % 8;
        let albedo = 0.08 + 0.02 * shade as f32;
        let place = |x_m: f64, y_m: f64, z_m: f64| {
            robot.world_from_roundel * Rigid::translation(x_m, y_m, z_m)
        };
        let velocity = robot.velocity_m_s;
        if robot.flying {
            for quarter in [0.5, 1.5, 2.5, 3.5] {
                let angle_rad = quarter * std::f64::consts::FRAC_PI_2;
                let (sine, cosine) = angle_rad.sin_cos();
                let arm = place(0.14 * cosine, 0.14 * sine, -0.04)
                    * Rigid::rotation(Vector3::z() * angle_rad);
                let bar = Shape::Bar { half_m: [0.07, 0.012], albedo };
                self.paint_on(&arm, &velocity, &bar);
                let blades = Shape::Shadow { radius_m: 0.1, opacity: 0.6 };
                self.paint_on(&place(0.2 * cosine, 0.2 * sine, -0.02), &velocity, &blades);
            }
        } else {
            let base = Shape::Disc { radius_m: 0.175, albedo };
            self.paint_on(&place(0.0, 0.0, -0.06), &velocity, &base);
            // Headlights mark the front.
            for side in [-1.0, 1.0] {
                let lamp = Shape::Disc { radius_m: 0.014, albedo: 0.8 };
                self.paint_on(&place(0.148, 0.045 * side, -0.06), &velocity, &lamp);
            }
        }
    }

    fn paint_roundel(&mut self, robot: &RobotTruth) {
        let kind = &self.scenario.params().kinds[usize::from(robot.kind.0)];
        let outer_radius_m = (kind.outer_diameter_m / 2.0) as f32;
        // The white margin is at least 1.35 outer diameters wide in total.
        let sheet = if robot.flying {
            Sheet::Disc(1.4 * outer_radius_m)
        } else {
            Sheet::Square(1.35 * outer_radius_m)
        };
        let inner_radius_m = (kind.inner_diameter_m / 2.0) as f32;
        let teeth = match (kind.pattern, self.scenario.word(robot.index)) {
            (Pattern::Coded(layout), Some(word)) => Some(Teeth::new(layout, word, inner_radius_m)),
            _ => None,
        };
        let inside = match (&teeth, kind.pattern) {
            (Some(teeth), _) => Inside::Teeth(teeth),
            (None, Pattern::Elliptical { minor_diameter_m }) => {
                Inside::Ellipse([inner_radius_m, (minor_diameter_m / 2.0) as f32])
            }
            (None, _) => Inside::Disc(inner_radius_m),
        };
        let shape = Shape::Roundel { outer_radius_m, inside, sheet };
        self.paint_on(&robot.world_from_roundel, &robot.velocity_m_s, &shape);
    }

    fn paint_booms(&mut self, time_s: f64) {
        for boom in self.scenario.booms_at(time_s) {
            let bar = Shape::Bar { half_m: boom.half_m.map(|half| half as f32), albedo: 0.3 };
            self.paint_on(&boom.world_from_boom, &Vector3::zeros(), &bar);
        }
    }

    /// Paints a shape on a moving plane.
    fn paint_on(&mut self, world_from_plane: &Rigid, velocity_m_s: &Vector3<f64>, shape: &Shape) {
        let camera_from_world = self.camera.world_from_camera.inverse();
        let velocity_m_s = camera_from_world.rotation * velocity_m_s;
        let setting = Setting {
            light: self.light_on(world_from_plane),
            motion_m: velocity_m_s * self.camera.exposure_s,
            per_row_m: velocity_m_s * self.camera.line_time_s,
            blur_px: self.scenario.params().image.blur_px,
        };
        let camera = &self.camera.camera;
        if let Some(patch) = Patch::new(camera, camera_from_world * world_from_plane, &setting) {
            self.canvas.paint(camera, &self.grid, &patch, shape);
        }
    }

    /// Light at a plane's origin and its slope along X and Y; a tilted plane receives less.
    fn light_on(&self, world_from_plane: &Rigid) -> [f64; 3] {
        const STEP_M: f64 = 0.1;
        let up = (world_from_plane.rotation * Vector3::z()).z.max(0.2);
        let at = |x_m: f64, y_m: f64| {
            let point = world_from_plane * Point3::new(x_m, y_m, 0.0);
            up * self.light.at(point.x, point.y)
        };
        let here = at(0.0, 0.0);
        [here, (at(STEP_M, 0.0) - here) / STEP_M, (at(0.0, STEP_M) - here) / STEP_M]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ScenarioParams;
    use roundel_vision::{
        camera::PixelPoint,
        frame::Frame,
        marker::{Detector, Mode, Params, Scratch},
        pose::Locator,
    };

    /// Capture time and pixels.
    fn rendered(scenario: &Scenario, camera: usize, frame: u64) -> (f64, Vec<u8>) {
        let mut renderer = Renderer::new(scenario, camera).unwrap();
        let mut pixels = vec![0; renderer.camera.camera.width() * renderer.camera.camera.height()];
        (renderer.render(frame, &mut pixels).unwrap(), pixels)
    }

    #[test]
    fn frames_repeat_bit_by_bit_in_any_order() {
        let scenario = Scenario::r4_lite(4);
        let mut renderer = Renderer::new(&scenario, 1).unwrap();
        let [mut one, mut other] = [vec![0; 1280 * 720], vec![0; 1280 * 720]];
        renderer.render(500, &mut one).unwrap();
        renderer.render(3, &mut other).unwrap();
        renderer.render(500, &mut other).unwrap();
        assert!(one == other, "the frame between left traces");
        assert!(one == rendered(&scenario, 1, 500).1, "two renderers differ");
        renderer.render(501, &mut other).unwrap();
        assert!(one != other, "consecutive frames are the same");
        assert!(one != rendered(&Scenario::r4_lite(5), 1, 500).1, "two seeds give the same frame");
    }

    #[test]
    fn pixels_use_the_range_without_clipping() {
        let mut params = ScenarioParams::r4_lite(6);
        // Includes the brightest corners.
        params.image.light_gradient = 0.2;
        let scenario = Scenario::new(params).unwrap();
        for camera in 0..4 {
            let (_, pixels) = rendered(&scenario, camera, 9);
            let share = |from: u8, to: u8| {
                let count = pixels.iter().filter(|pixel| (from..=to).contains(pixel)).count();
                count as f64 / pixels.len() as f64
            };
            assert_eq!(share(255, 255), 0.0, "camera {camera} clips");
            assert_eq!(share(0, 0), 0.0, "camera {camera} is black somewhere");
            assert!(share(60, 140) > 0.7, "camera {camera}: the floor is grey");
            assert!(share(150, 254) > 0.005, "camera {camera}: sheets are white");
            assert!(share(1, 35) > 0.002, "camera {camera}: rings are black");
        }
    }

    #[test]
    fn codes_identify_robots_and_their_heading() {
        let scenario = Scenario::r4(3);
        let params = scenario.params();
        let detector = Detector::new(params.kinds.clone(), Params::default()).unwrap();
        let (mut read, mut large) = (0, 0);
        for (index, camera) in scenario.cameras().iter().enumerate() {
            let (width, height) = (camera.camera.width(), camera.camera.height());
            let (time_s, pixels) = rendered(&scenario, index, 70);
            let frame = Frame::new(&pixels, width, height, width).unwrap();
            for ring in detector.detect(&frame, &mut Scratch::default()) {
                let seen = ring.outer.center;
                let time_s = camera.row_time_s(time_s, seen.v);
                let off_px = |at: PixelPoint, x_m: f64, robot: &RobotTruth| {
                    let place = robot.world_from_roundel * Point3::new(x_m, 0.0, 0.0);
                    let pixel = camera.project(&place).unwrap();
                    (pixel.u - at.u).hypot(pixel.v - at.v)
                };
                let robots = scenario.truth(time_s);
                let robot = robots
                    .iter()
                    .min_by(|a, b| off_px(seen, 0.0, a).total_cmp(&off_px(seen, 0.0, b)))
                    .unwrap();
                large += usize::from(2.0 * ring.outer.semi_minor_px >= 36.0);
                let Some(reading) = ring.code else { continue };
                read += 1;
                assert_eq!(Some(reading.code), robot.code, "at {seen:?}");
                let radius_m = 0.5 * params.kinds[0].inner_diameter_m;
                assert!(off_px(reading.zero, radius_m, robot) < 1.5, "at {seen:?}");
            }
        }
        assert!(large >= 5 && read >= large, "{read} read, {large} of 36 px and more");
    }

    #[test]
    fn elliptical_discs_identify_kind_and_heading() {
        let scenario = Scenario::new(ScenarioParams::r4_elliptical(3)).unwrap();
        let params = scenario.params();
        let detector = Detector::new(params.kinds.clone(), Params::default()).unwrap();
        let mut seen = 0;
        for (index, camera) in scenario.cameras().iter().enumerate() {
            let (width, height) = (camera.camera.width(), camera.camera.height());
            let (time_s, pixels) = rendered(&scenario, index, 70);
            let frame = Frame::new(&pixels, width, height, width).unwrap();
            let mut locator =
                Locator::new(camera.camera.clone(), params.kinds.clone(), Mode::Precise);
            for ring in detector.detect(&frame, &mut Scratch::default()) {
                let kind = &params.kinds[usize::from(ring.kind.unwrap().0)];
                let pose = locator.locate_single(&frame, kind, ring).unwrap().pose;
                let place = camera.world_from_camera * Point3::from(pose.position_m);
                let robots = scenario.truth(camera.row_time_s(time_s, ring.outer.center.v));
                let off_m = |robot: &RobotTruth| {
                    (robot.world_from_roundel.translation.vector - place.coords).norm()
                };
                let robot = robots.iter().min_by(|a, b| off_m(a).total_cmp(&off_m(b))).unwrap();
                if off_m(robot) > 0.1 {
                    continue;
                }
                assert_eq!(ring.kind, Some(robot.kind), "at {:?}", ring.outer.center);
                let yaw =
                    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.yaw_rad.unwrap());
                let x = camera.world_from_camera.rotation
                    * roundel_vision::rigid::orientation_of_normal(&pose.normal)
                    * yaw
                    * Vector3::x();
                let along = (robot.world_from_roundel * Vector3::x()).dot(&x).abs();
                assert!(along > 6f64.to_radians().cos(), "{along} at {:?}", ring.outer.center);
                seen += 1;
            }
        }
        assert!(seen >= 20, "{seen}");
    }

    #[test]
    fn wrong_buffers_and_cameras_are_rejected() {
        let scenario = Scenario::r4_lite(1);
        let missing = Renderer::new(&scenario, 4).err().unwrap();
        assert_eq!(missing.to_string(), "scenario: expected a camera from 0 to 3, found 4");
        let mut renderer = Renderer::new(&scenario, 3).unwrap();
        assert_eq!(
            renderer.render(0, &mut [0; 10]),
            Err(BufferError { expected: 921_600, found: 10 })
        );
    }
}
