//! Clocks of capture times, and their accuracy.

pub use roundel_proto::v1::TimeBase;

/// Clock of a source's capture times, and their accuracy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CaptureClock {
    pub base: TimeBase,
    /// Standard deviation of the common error of all capture times before estimation, seconds; 0: exact.
    pub deviation_s: f64,
}

impl CaptureClock {
    /// Times without error.
    pub const EXACT: Self = Self { base: TimeBase::Server, deviation_s: 0.0 };
    /// A network camera without time stamps: exposure, compression, buffers and network.
    pub const ARRIVAL: Self = Self { base: TimeBase::Arrival, deviation_s: 0.05 };
    /// A network camera's counter: the same without the jitter.
    pub const CAMERA: Self = Self { base: TimeBase::Camera, deviation_s: 0.05 };
    /// Time stamps of a local driver, usually of the first or last packet of the frame.
    pub const DRIVER: Self = Self { base: TimeBase::Driver, deviation_s: 0.02 };
    /// NTP of a camera over a local network.
    pub const SYNCHRONIZED: Self = Self { base: TimeBase::Synchronized, deviation_s: 0.005 };
}
