//! What is another in a camera than before, and what that takes.

use crate::config::CameraConfig;

/// What differs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Difference {
    pub(super) name: bool,
    pub(super) source: bool,
    /// The images' size.
    pub(super) size: bool,
    pub(super) lens: bool,
    pub(super) pose: bool,
    pub(super) line_time: bool,
    pub(super) clock: bool,
    pub(super) rate: bool,
    pub(super) mode: bool,
    pub(super) mask: bool,
    /// How many roundels it may follow.
    pub(super) most: bool,
}

impl Difference {
    pub(super) fn of(before: &CameraConfig, after: &CameraConfig) -> Self {
        let size =
            |camera: &CameraConfig| (camera.calibration.width(), camera.calibration.height());
        Self {
            name: before.name != after.name,
            source: before.address != after.address,
            size: size(before) != size(after),
            lens: before.calibration.intrinsics() != after.calibration.intrinsics(),
            pose: before.pose != after.pose,
            line_time: before.line_time_s != after.line_time_s,
            clock: before.clock_uncertainty_s != after.clock_uncertainty_s,
            rate: before.rate_hz != after.rate_hz,
            mode: before.mode != after.mode,
            mask: before.mask != after.mask,
            most: false,
        }
    }

    /// Whether its worker has to begin anew. Lens and place are taken over between two frames instead, so that no track
    /// is lost.
    pub(super) fn restarts(&self) -> bool {
        let Self { name, source, size, line_time, rate, mode, mask, most, .. } = *self;
        name || source || size || line_time || rate || mode || mask || most
    }

    /// Whether it stands elsewhere, or looks through another lens: what a calibration found does not hold any more.
    pub(super) fn moves(&self) -> bool {
        self.lens || self.pose
    }

    /// Whether what was learned of its clock does not hold any more.
    pub(super) fn keeps_other_time(&self) -> bool {
        self.source || self.clock
    }

    /// In words, commas between; empty if nothing differs.
    pub(super) fn words(&self) -> String {
        let all = [
            (self.name, "name"),
            (self.source, "source"),
            (self.lens, "lens"),
            (self.pose, "pose"),
            (self.line_time, "line time"),
            (self.clock, "clock uncertainty"),
            (self.rate, "rate"),
            (self.mode, "mode"),
            (self.mask, "mask"),
            (self.most, "most roundels"),
        ];
        let words: Vec<&str> =
            all.iter().filter(|(differs, _)| *differs).map(|(_, word)| *word).collect();
        words.join(", ")
    }
}
