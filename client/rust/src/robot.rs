//! Simulated robots that are driven.

use std::time::Duration;

use crate::{Client, Error, v1};

impl Client {
    /// Tells simulated robots how to move, by `object_id`, world frame, m/s (at most 1 m/s); when they begin to,
    /// server's ns. They go on for half a second and then stop, unless they are told again.
    ///
    /// # Errors
    /// [`Error::Refused`] where nothing is simulated, for an object that is no robot's, and for too fast a velocity;
    /// and those of the connection.
    pub async fn drive(
        &self,
        velocities_m_s: impl IntoIterator<Item = (u64, [f64; 3])>,
    ) -> Result<i64, Error> {
        let told = |(object_id, velocity)| v1::RobotDrive { object_id, velocity: vector(velocity) };
        let robots = velocities_m_s.into_iter().map(told).collect();
        let answer = self.service().drive_robots(v1::DriveRobotsRequest { robots }).await;
        let answer = answer.map_err(|status| self.error(&status))?;
        Ok(answer.into_inner().effective_time_ns)
    }

    /// Pushes a simulated robot, against what it is told, with up to 2 m/s for up to five seconds; from when on,
    /// server's ns.
    ///
    /// # Errors
    /// As of [`Client::drive`].
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
