//! The configuration as a whole, from afar.

use crate::{Client, Error, v1};

impl Client {
    /// The configuration in force, as text and as message.
    ///
    /// # Errors
    /// [`Error::Refused`] by a server that lets no client change what is configured; and those of the connection.
    pub async fn configuration(&self) -> Result<v1::Configuration, Error> {
        let answer = self.service().get_configuration(v1::GetConfigurationRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// What is wrong with a configuration, or what applying it would change. Nothing is changed.
    ///
    /// # Errors
    /// As of [`Client::configuration`].
    pub async fn check_configuration(&self, toml: &str) -> Result<v1::ConfigurationCheck, Error> {
        let request = v1::CheckConfigurationRequest { toml: toml.to_owned() };
        let answer = self.service().check_configuration(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Puts a configuration in the place of the one in force, if that has this version still (empty: any), while
    /// everything that is the same in both goes on.
    ///
    /// # Errors
    /// [`Error::Refused`] says what is wrong with it, or what takes a start of the server; [`Error::Conflict`] that the
    /// one in force has another version by now. Nothing is changed then. And those of the connection.
    pub async fn apply_configuration(
        &self,
        toml: &str,
        version: &str,
    ) -> Result<v1::AppliedConfiguration, Error> {
        let (toml, version) = (toml.to_owned(), version.to_owned());
        let request = v1::ApplyConfigurationRequest { toml, version };
        let answer = self.long_service().apply_configuration(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }
}
