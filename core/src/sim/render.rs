//! A scenario's camera pictures, as 8-bit frames.
//!
//! What never changes (floor, clutter, light) is painted once, through the lens. A frame then costs
//! the windows of the robots in view and one pass that adds noise; see `benches/sim.rs`. Each robot
//! is shown as it is in the middle of the exposure at the image row of its own centre; within one
//! roundel the rolling shutter's shear (below 0.1 px for the reference installations) is left out.

use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use thiserror::Error;

use super::{
    floor::Floor,
    light::Light,
    noise::{SensorNoise, mix},
    params::ScenarioError,
    patch::{Canvas, Patch, Setting, Shape, Sheet, Tone},
    ray::RayGrid,
    rig::SimCamera,
    scenario::{RobotTruth, Scenario},
};
use crate::rigid::Rigid;

/// Paints the frames of one camera. Each frame depends on scenario, camera and frame number alone.
pub struct Renderer {
    scenario: Scenario,
    camera: SimCamera,
    light: Light,
    noise: SensorNoise,
    grid: RayGrid,
    canvas: Canvas,
}

/// A buffer of the wrong length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("expected a buffer of {expected} bytes, one for each pixel, found {found}")]
pub struct BufferError {
    /// Width times height.
    pub expected: usize,
    /// The buffer's length.
    pub found: usize,
}

impl Renderer {
    /// A renderer for one camera of a scenario; paints the background, so it takes about as long as
    /// a hundred frames.
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

    /// The camera whose frames these are.
    pub fn camera(&self) -> &SimCamera {
        &self.camera
    }

    /// Paints frame number `frame` into `pixels`, row by row without gaps, and gives its capture
    /// time (middle of the exposure at the middle row), seconds after the scenario's start. The same
    /// number always gives the same pixels.
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
        // The nearer ones hide the farther ones.
        robots.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, robot) in &robots {
            self.paint_shadow(robot);
        }
        for (_, robot) in &robots {
            self.paint_body(robot);
            self.paint_roundel(robot);
        }
    }

    /// A robot as it is when the row of its own centre is exposed; `None` if far out of the image.
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
        // The light falls in a little from the side.
        let on_floor =
            Vector3::new(position.x + 0.12 * position.z, position.y - 0.08 * position.z, 0.0);
        let plane = Rigid::from_parts(Translation3::from(on_floor), UnitQuaternion::identity());
        let tone = Tone {
            albedo: 0.0,
            opacity: 0.5 / (1.0 + 0.8 * height_m),
            softness_m: 0.015 + 0.04 * height_m,
        };
        let velocity = Vector3::new(robot.velocity_m_s.x, robot.velocity_m_s.y, 0.0);
        self.paint_on(&plane, &velocity, &[Shape::Disc { radius_m: 0.16, tone }]);
    }

    fn paint_body(&mut self, robot: &RobotTruth) {
        let albedo =
            0.08 + 0.14 * (mix(self.scenario.params().seed, robot.index as u64) % 8) as f32 / 8.0;
        let solid = |albedo: f32| Tone { albedo, opacity: 1.0, softness_m: 0.0 };
        let place = |x_m: f64, y_m: f64, z_m: f64| {
            robot.world_from_roundel * Rigid::translation(x_m, y_m, z_m)
        };
        let velocity = robot.velocity_m_s;
        if robot.flying {
            for angle_rad in
                [0.25, 0.75, 1.25, 1.75].map(|half_turns| half_turns * std::f64::consts::PI)
            {
                let (sine, cosine) = f64::sin_cos(angle_rad);
                let arm = place(0.12 * cosine, 0.12 * sine, -0.04)
                    * Rigid::rotation(Vector3::z() * angle_rad);
                self.paint_on(
                    &arm,
                    &velocity,
                    &[Shape::Bar { half_m: [0.08, 0.012], tone: solid(albedo) }],
                );
                let rotor = place(0.2 * cosine, 0.2 * sine, -0.02);
                let blades = Tone { albedo: 0.12, opacity: 0.45, softness_m: 0.004 };
                let hub = Shape::Disc { radius_m: 0.018, tone: solid(albedo) };
                self.paint_on(
                    &rotor,
                    &velocity,
                    &[Shape::Disc { radius_m: 0.075, tone: blades }, hub],
                );
            }
        } else {
            let base = Shape::Disc { radius_m: 0.175, tone: solid(albedo) };
            self.paint_on(&place(0.0, 0.0, -0.06), &velocity, &[base]);
            // Headlights show where the front is.
            for side in [-1.0, 1.0] {
                let lamp = Shape::Disc { radius_m: 0.014, tone: solid(0.8) };
                self.paint_on(&place(0.148, 0.045 * side, -0.06), &velocity, &[lamp]);
            }
        }
    }

    fn paint_roundel(&mut self, robot: &RobotTruth) {
        let kind = &self.scenario.params().kinds[usize::from(robot.kind.0)];
        let outer_radius_m = (kind.outer_diameter_m / 2.0) as f32;
        // The white margin is at least 1.35 outer diameters wide in all.
        let sheet = if robot.flying {
            Sheet::Disc(1.4 * outer_radius_m)
        } else {
            Sheet::Square(1.35 * outer_radius_m)
        };
        let inner_radius_m = (kind.inner_diameter_m / 2.0) as f32;
        let shape = Shape::Roundel { outer_radius_m, inner_radius_m, sheet };
        self.paint_on(&robot.world_from_roundel, &robot.velocity_m_s, &[shape]);
    }

    fn paint_booms(&mut self, time_s: f64) {
        for boom in self.scenario.booms_at(time_s) {
            let half_m = boom.half_m.map(|half| half as f32);
            let tone = Tone { albedo: 0.3, opacity: 1.0, softness_m: 0.0 };
            let stripe = Tone { albedo: 0.5, ..tone };
            let shapes = [
                Shape::Bar { half_m, tone },
                Shape::Bar { half_m: [half_m[0], 0.3 * half_m[1]], tone: stripe },
            ];
            self.paint_on(&boom.world_from_boom, &Vector3::zeros(), &shapes);
        }
    }

    /// Paints shapes, one over the other, on a plane of the world that moves.
    fn paint_on(
        &mut self,
        world_from_plane: &Rigid,
        velocity_m_s: &Vector3<f64>,
        shapes: &[Shape],
    ) {
        let camera_from_world = self.camera.world_from_camera.inverse();
        let setting = Setting {
            light: self.light_on(world_from_plane),
            motion_m: camera_from_world.rotation * velocity_m_s * self.camera.exposure_s,
            blur_px: self.scenario.params().image.blur_px,
        };
        let camera = &self.camera.camera;
        if let Some(patch) = Patch::new(camera, camera_from_world * world_from_plane, &setting) {
            for shape in shapes {
                self.canvas.paint(camera, &self.grid, &patch, shape);
            }
        }
    }

    /// Light at a plane's origin and its slope along X and Y; a tilted plane gets less of it.
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
