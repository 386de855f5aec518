//! The sensor file that `gelstereo setup` writes: rig, settings and measured lengths of one sensor.

use super::{Config, ConfigError, overlay};
use gelstereo_core::rig::Rig;
use serde::Deserialize;

/// A sensor file. The measured lengths of the gel are for people and for the simulator.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SensorFile {
    preset: String,
    #[serde(default)]
    params: toml::Table,
    rig: Rig,
    #[serde(default, rename = "gel")]
    _gel: toml::Table,
}

impl SensorFile {
    pub fn parse(text: &str, origin: &str) -> Result<Self, ConfigError> {
        toml::from_str(text).map_err(|error| ConfigError::Parse { origin: origin.to_owned(), error })
    }

    /// Sets the rig, and what the configuration's text leaves open: preset and settings. Settings of the text
    /// take precedence.
    pub fn complete(self, text: &str, origin: &str, config: &mut Config) -> Result<(), ConfigError> {
        if config.rig.is_some() || config.rig_file.is_some() {
            return Err(ConfigError::RigSource {
                message: "sensor_file has a rig of its own; remove rig and rig_file",
            });
        }
        let fail = |error| ConfigError::Parse { origin: origin.to_owned(), error };
        let mut given: toml::Table = toml::from_str(text).map_err(fail)?;
        let mut params = self.params;
        if let Some(toml::Value::Table(given)) = given.remove("params") {
            overlay(&mut params, given);
        }
        let preset = given.remove("preset").unwrap_or(toml::Value::String(self.preset));
        let merged = toml::Table::from_iter([
            ("preset".to_owned(), preset),
            ("params".to_owned(), toml::Value::Table(params)),
        ]);
        let merged = Config::parse(&toml::to_string(&merged).map_err(ConfigError::Write)?, origin)?;
        (config.preset, config.params, config.rig) = (merged.preset, merged.params, Some(self.rig));
        Ok(())
    }
}
