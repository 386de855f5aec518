//! The simulated world behind simulated sensors, grippers and robots.

use super::part::check_shape;
use super::range::{HOLE_MM, RATE_HZ, check, check_seed};
use super::{ConfigError, PoseConfig};
use gelstereo_core::params::{Params, Polarity, PrintLayout};
use gelstereo_core::rig::Rig;
use gelstereo_sim::effects::{Defocus, SensorNoise};
use gelstereo_sim::{Effects, Gel, Scene, Shape};
use serde::{Deserialize, Serialize};

/// The simulated world: the ground truth, which the job only measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatedConfig {
    /// Seed of the part's pose and of the images' noise. Valid: 0 to 9223372036854775807. Default: `1`.
    /// Change it to try another pose; the same seed gives identical results.
    pub seed: u64,
    /// Rate of the simulated camera. Valid: 0.1 to 1000 Hz. Default: `30` Hz. Change it to the rate of your
    /// planned camera.
    pub frame_rate_hz: f64,
    /// Largest offset of the part from its expected position, along each axis. Valid: 0 to 10 mm. Default:
    /// `1` mm. Raise it to try worse guesses.
    pub offset_mm: f64,
    /// Largest tilt of the part from its expected orientation, about each axis. The spin of a round part is
    /// arbitrary. Valid: 0 to 0.5 rad. Default: `0.05` rad. Raise it to try worse guesses.
    pub tilt_rad: f64,
    /// Diameter of the round hole. Valid: 0.1 to 1000 mm. Default: `8.2` mm, 0.2 mm more than the peg's.
    /// Change it with the part's diameter.
    pub hole_diameter_mm: f64,
    /// Edges of the rectangular hole along the x and y of a part that is a box. Valid: 0.1 to 1000 mm.
    /// Default: none, and then each is 0.2 mm more than the part's. Change it to try tighter and wider
    /// holes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hole_size_mm: Option<[f64; 2]>,
    /// Position errors of the faces of `task.edges` along their normals, unknown to the task. Valid: -10 to
    /// 10 mm. Default: none, no errors. Set it to see the effect of an error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edge_offset_mm: Option<f64>,
    /// Shape of the part in the holder, if it differs from the expected one. Default: none. Set it to try a
    /// wrong part.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shape: Option<Shape>,
    /// True pose of the simulated sensor in the sensor frame of `mount`, unknown to the task. Default: no
    /// error. Change it to see the effect of a mounting error.
    pub mount_error: PoseConfig,
    /// The gel and its lattice.
    pub gel: Gel,
    /// Effects of a real gel and camera. Default: shoulder, spread and drag of the gel, blur and noise of the
    /// camera. Change it to try other effects; docs/simulator.md lists all.
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
            hole_size_mm: None,
            edge_offset_mm: None,
            shape: None,
            mount_error: PoseConfig::default(),
            gel: Gel::default(),
            effects: Effects {
                defocus: Some(Defocus::default()),
                sensor_noise: Some(SensorNoise::default()),
                ..Effects::of_gel()
            },
        }
    }
}

/// Largest ratio of the simulated pitch to the configured one. With a larger difference the pipeline could
/// mistake a marker for its neighbour.
const MAX_PITCH_RATIO: f64 = 1.1;

impl SimulatedConfig {
    /// The scene of the simulated sensor, with the part in the holder.
    #[must_use]
    pub fn scene(&self, rig: Rig, shape: Shape) -> Scene {
        Scene {
            seed: self.seed,
            frame_rate_hz: self.frame_rate_hz,
            rig,
            gel: self.gel.clone(),
            indenter: Some(shape),
            effects: self.effects.clone(),
            ..Scene::default()
        }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        check_seed("simulated.seed", self.seed)?;
        RATE_HZ.check("simulated.frame_rate_hz", self.frame_rate_hz)?;
        HOLE_MM.check("simulated.hole_diameter_mm", self.hole_diameter_mm)?;
        for side_mm in self.hole_size_mm.into_iter().flatten() {
            HOLE_MM.check("simulated.hole_size_mm", side_mm)?;
        }
        if let Some(offset_mm) = self.edge_offset_mm {
            check(offset_mm.abs() <= 10.0, "simulated.edge_offset_mm", offset_mm, "-10 to 10 mm")?;
        }
        let (offset_mm, tilt_rad) = (self.offset_mm, self.tilt_rad);
        check((0.0..=10.0).contains(&offset_mm), "simulated.offset_mm", offset_mm, "0 to 10 mm")?;
        check((0.0..=0.5).contains(&tilt_rad), "simulated.tilt_rad", tilt_rad, "0 to 0.5 rad")?;
        self.mount_error.validate("simulated.mount_error")?;
        match &self.shape {
            Some(shape) => check_shape("simulated.shape", shape),
            None => Ok(()),
        }
    }

    /// Checks that the sensor can be simulated: the gel, its effects, and its visibility to the cameras.
    pub(super) fn validate_scene(&self, rig: &Rig, shape: &Shape) -> Result<(), ConfigError> {
        let scene = self.scene(rig.clone(), self.shape.as_ref().unwrap_or(shape).clone());
        scene.validate().map_err(|error| ConfigError::Scene { table: "simulated", error })
    }

    /// Checks that the pipeline expects the simulated gel.
    pub(super) fn validate_against(&self, params: &Params) -> Result<(), ConfigError> {
        let (expected, printed) = (params.lattice.pitch_mm, self.gel.pitch_mm);
        let differs = |(mm, printed_mm): (f64, f64)| (mm / printed_mm).max(printed_mm / mm) > MAX_PITCH_RATIO;
        if expected.axes_mm().into_iter().zip(printed.axes_mm()).any(differs) {
            return Err(ConfigError::Contradiction {
                name: "params.lattice.pitch_mm",
                found: format!("{expected} mm"),
                other: format!("simulated.gel.pitch_mm is {printed} mm"),
                advice: "make them agree to a tenth",
            });
        }
        if params.lattice.layout != self.gel.layout {
            let word = |layout| match layout {
                PrintLayout::Square => "square",
                PrintLayout::Hexagonal => "hexagonal",
            };
            return Err(ConfigError::Contradiction {
                name: "params.lattice.layout",
                found: format!("\"{}\"", word(params.lattice.layout)),
                other: format!("simulated.gel.layout is \"{}\"", word(self.gel.layout)),
                advice: "make them agree",
            });
        }
        let sides = [
            ("params.lattice.rows", params.lattice.rows, "rows", self.gel.rows),
            ("params.lattice.cols", params.lattice.cols, "cols", self.gel.cols),
        ];
        for (name, expected, side, printed) in sides {
            if let Some(expected) = expected.filter(|&expected| expected != printed) {
                let other = format!("simulated.gel.{side} is {printed}");
                let advice = "make them agree, or remove the former";
                return Err(ConfigError::Contradiction { name, found: expected.to_string(), other, advice });
            }
        }
        let bright = params.detect.polarity == Polarity::Bright;
        if bright != self.gel.bright_dots {
            let word = if bright { "bright" } else { "dark" };
            return Err(ConfigError::Contradiction {
                name: "params.detect.polarity",
                found: format!("\"{word}\""),
                other: format!("simulated.gel.bright_dots is {}", self.gel.bright_dots),
                advice: "make them agree",
            });
        }
        Ok(())
    }
}
