//! Whether a part's numbers make sense.

use super::ConfigError;
use super::range::{SPACING_MM, check_seed};
use crate::part::PartConfig;
use gelstereo_sim::Shape;

pub(super) fn validate(part: &PartConfig) -> Result<(), ConfigError> {
    SPACING_MM.check("part.spacing_mm", part.spacing_mm)?;
    check_seed("part.seed", part.seed)?;
    check_shape("part.shape", &part.shape)
}

pub(super) fn check_shape(table: &'static str, shape: &Shape) -> Result<(), ConfigError> {
    shape.validate().map_err(|error| ConfigError::Scene { table, error })
}
