//! What a request may name while another configuration is in use.

use std::{path::Path, sync::Arc};

use super::CameraConfig;
use crate::model::{
    address::SourceAddress,
    source_rules::{SourceRuleError, SourceRules},
};

/// What the cameras in use have, and what the rules allow.
#[derive(Clone, Copy)]
pub(super) struct RequestScope<'a> {
    pub(super) rules: &'a Arc<SourceRules>,
    pub(super) cameras: &'a [CameraConfig],
}

impl RequestScope<'_> {
    /// Checks a source. Returns the rules that bind it; `None` for one of the configuration file.
    pub(super) fn admit_source(
        &self,
        address: &SourceAddress,
    ) -> Result<Option<Arc<SourceRules>>, SourceRuleError> {
        if let Some(camera) = self.cameras.iter().find(|camera| camera.address == *address) {
            return Ok(camera.source_rules.clone());
        }
        self.rules.check(address)?;
        Ok(Some(self.rules.clone()))
    }

    pub(super) fn admit_file(&self, path: &Path) -> Result<(), SourceRuleError> {
        let is_used = |camera: &CameraConfig| camera.calibration_file.as_deref() == Some(path);
        if self.cameras.iter().any(is_used) { Ok(()) } else { self.rules.check_file(path) }
    }
}
