//! Calls for the whole configuration.

use crate::{Client, Error, v1};

impl Client {
    /// The current configuration, as text and as message.
    ///
    /// # Errors
    /// [`Error::Refused`] if the server does not let clients change its configuration, and connection errors.
    pub async fn configuration(&self) -> Result<v1::Configuration, Error> {
        self.response(self.service().get_configuration(v1::GetConfigurationRequest {}).await)
    }

    /// The errors of a configuration, or what applying it would change. Changes nothing.
    ///
    /// # Errors
    /// As for [`Client::configuration`].
    pub async fn check_configuration(&self, toml: &str) -> Result<v1::ConfigurationCheck, Error> {
        let request = v1::CheckConfigurationRequest { toml: toml.to_owned() };
        self.response(self.service().check_configuration(request).await)
    }

    /// Replaces the current configuration if it still has this version (empty: any). Everything that both have in common
    /// keeps running.
    ///
    /// # Errors
    /// [`Error::Refused`] if it is invalid or requires a restart of the server, [`Error::Conflict`] if the current one has
    /// another version by now, and connection errors. On an error nothing is changed.
    pub async fn apply_configuration(
        &self,
        toml: &str,
        version: &str,
    ) -> Result<v1::AppliedConfiguration, Error> {
        let (toml, version) = (toml.to_owned(), version.to_owned());
        let request = v1::ApplyConfigurationRequest { toml, version };
        self.response(self.long_service().apply_configuration(request).await)
    }
}
