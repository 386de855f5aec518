//! The simulated world behind simulated sensors, grippers and robots.

use super::ConfigError;
use super::range::{LENGTH_MM, RATE_HZ, check};
use gelstereo_sim::effects::{Defocus, SensorNoise};
use gelstereo_sim::{Effects, Gel, Shape};
use serde::{Deserialize, Serialize};

/// The simulated world: what is really there, of which the job knows only what it measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatedConfig {
    /// Seed of the part's place and of the images' noise. Default: `1`.
    pub seed: u64,
    /// Default: `30` Hz.
    pub frame_rate_hz: f64,
    /// Largest distance of the part from where it is expected, along each axis. Default: `1` mm.
    pub offset_mm: f64,
    /// Largest tilt from where it is expected, about each axis; the spin about a round part's axis is any. Default:
    /// `0.05` rad.
    pub tilt_rad: f64,
    /// Diameter of the round hole. Default: `8.2` mm, 0.2 mm more than the peg's.
    pub hole_diameter_mm: f64,
    /// What stands in the holder, if it is not the part that the job expects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shape: Option<Shape>,
    /// The gel and its lattice.
    pub gel: Gel,
    /// What a real gel and camera do. Default: shoulder, spread and drag of the gel, blur and noise of the camera.
    pub effects: Effects,
}

impl Default for SimulatedConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            frame_rate_hz: 30.0,
            offset_mm: 1.0,
            tilt_rad: 0.05,
            hole_diameter_mm: 8.2,
            shape: None,
            gel: Gel::default(),
            effects: Effects {
                defocus: Some(Defocus::default()),
                sensor_noise: Some(SensorNoise::default()),
                ..Effects::of_gel()
            },
        }
    }
}

impl SimulatedConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        RATE_HZ.check("simulated.frame_rate_hz", self.frame_rate_hz)?;
        LENGTH_MM.check("simulated.hole_diameter_mm", self.hole_diameter_mm)?;
        let (offset_mm, tilt_rad) = (self.offset_mm, self.tilt_rad);
        check((0.0..=10.0).contains(&offset_mm), "simulated.offset_mm", offset_mm, "0 to 10 mm")?;
        check((0.0..=0.5).contains(&tilt_rad), "simulated.tilt_rad", tilt_rad, "0 to 0.5 rad")
    }
}
