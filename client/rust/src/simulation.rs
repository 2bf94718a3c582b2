//! Commands for simulated robots.

use std::time::Duration;

use crate::{Client, Error, v1};

impl Client {
    /// Sets the velocities of simulated robots, by `object_id`, in the world frame, at most 1 m/s. Returns the server time
    /// of effect, ns. Robots stop half a second after the last command.
    ///
    /// # Errors
    /// [`Error::Refused`] if the server does not simulate, for an object that is not a robot, and for a velocity above
    /// the limit; and connection errors.
    pub async fn drive(
        &self,
        velocities_m_s: impl IntoIterator<Item = (u64, [f64; 3])>,
    ) -> Result<i64, Error> {
        let command =
            |(object_id, velocity)| v1::RobotDrive { object_id, velocity: vector(velocity) };
        let robots = velocities_m_s.into_iter().map(command).collect();
        let answer = self.service().drive_robots(v1::DriveRobotsRequest { robots }).await;
        let answer = answer.map_err(|status| self.error(&status))?;
        Ok(answer.into_inner().effective_time_ns)
    }

    /// Pushes a simulated robot with up to 2 m/s for up to five seconds, regardless of its commanded velocity. Returns the
    /// server time of effect, ns.
    ///
    /// # Errors
    /// As for [`Client::drive`].
    pub async fn push_robot(
        &self,
        object_id: u64,
        velocity_m_s: [f64; 3],
        duration: Duration,
    ) -> Result<i64, Error> {
        let request = v1::PushRobotRequest {
            object_id,
            velocity: vector(velocity_m_s),
            duration_ms: duration.as_secs_f64() * 1e3,
        };
        let answer = self.service().push_robot(request).await;
        let answer = answer.map_err(|status| self.error(&status))?;
        Ok(answer.into_inner().effective_time_ns)
    }
}

fn vector([x, y, z]: [f64; 3]) -> Option<v1::Vector3> {
    Some(v1::Vector3 { x, y, z })
}
