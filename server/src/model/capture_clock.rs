//! Clocks of capture times, and their accuracy.

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TimeBase {
    /// The server's clock: simulated frames and played recordings.
    #[default]
    Server,
    /// Arrival of the frame: includes the delays of camera and network, with their jitter.
    Arrival,
    /// The camera's counter, mapped to the server's clock by the frames with the least delay: without jitter, but late
    /// by that delay.
    Camera,
    /// The driver's time stamp, on this machine's monotonic clock: late by exposure and readout.
    Driver,
    /// A camera clock that is synchronized, such as by NTP, according to the stream.
    Synchronized,
}

/// Clock of a source's capture times, and their accuracy.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CaptureClock {
    pub base: TimeBase,
    /// Standard deviation of what all these times are off by together, seconds, as long as nothing better is
    /// known; 0: they are right.
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
