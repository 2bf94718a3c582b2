//! Diff between two versions of a camera's configuration, and the actions it requires.

use crate::model::config::{CAMERA_SCHEMA, CameraConfig, Effect};

/// Label and effect of each change.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct CameraDiff(Vec<(&'static str, Effect)>);

impl CameraDiff {
    pub(super) fn of(before: &CameraConfig, after: &CameraConfig) -> Self {
        let effects = CAMERA_SCHEMA.iter().map(|key| (key.label, (key.effect)(before, after)));
        Self(effects.filter_map(|(label, effect)| Some((label, effect?))).collect())
    }

    /// Adds a change of `[limits] max_roundels_per_camera`.
    pub(super) fn add_max_roundels(&mut self) {
        self.0.push(("most roundels", Effect::Restart));
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn has(&self, effect: Effect) -> bool {
        self.0.iter().any(|(_, found)| *found == effect)
    }

    /// Whether the worker has to be restarted.
    pub(super) fn requires_restart(&self) -> bool {
        use Effect::{Rename, Resize, Restart, Source};
        [Restart, Rename, Source, Resize].into_iter().any(|effect| self.has(effect))
    }

    /// Whether lens or pose are others than those that were calibrated.
    pub(super) fn invalidates_calibration(&self) -> bool {
        self.has(Effect::Pose) || self.has(Effect::Resize)
    }

    /// Whether the clock estimate has to start over.
    pub(super) fn resets_clock(&self) -> bool {
        self.has(Effect::Source) || self.has(Effect::Clock)
    }

    /// The labels, commas between; empty if nothing differs.
    pub(super) fn describe(&self) -> String {
        let labels: Vec<&str> = self.0.iter().map(|(label, _)| *label).collect();
        labels.join(", ")
    }
}
