//! Configurations of models from JSON.

use serde::de::DeserializeOwned;

use crate::{Error, Result};

/// A configuration from JSON.
pub(crate) fn parse<C: DeserializeOwned>(config: &str) -> Result<C> {
    serde_json::from_str(config).map_err(|error| Error::ConfigFile {
        file: "the configuration".to_owned(),
        reason: error.to_string(),
    })
}
