//! Slip of the part along the gel.

use super::{ParamsError, check};
use crate::math::ln;

const SECONDS_PER_HOUR: f64 = 3600.0;

/// How slip is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum SlipMethod {
    /// It is not.
    #[default]
    None,
    /// Markers in contact that do not move with the rigid motion of the others slip.
    Rigid,
}

/// Shape of the part where it touches the gel, which relates the stick ratio to the load.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum SlipShape {
    /// Not known, or with flat faces and edges, where nothing slips before the limit is near.
    #[default]
    Unknown,
    /// Round in all directions.
    Ball,
    /// Round across a line, and longer than the contact is wide.
    Cylinder,
}

/// Slip of the part along the gel, from the motion of the markers in contact.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct SlipParams {
    /// How slip is found. Default: `none`. Set `rigid` to find slip.
    pub method: SlipMethod,
    /// Rate of false alarms by the noise of the markers, while the part does not slip. Valid: 0.000001 to
    /// 3600 per hour. Default: `1` per hour. Raise it to find slip earlier.
    pub false_alarms_per_hour: f64,
    /// Rate of the frames, from which the probability of a false alarm in one frame follows. Valid: 0.001 to
    /// 100000 Hz. Default: `30` Hz. Change it to the camera's.
    pub frame_rate_hz: f64,
    /// Standard deviation per axis of a marker from the rigid motion of a part that sticks, apart from its
    /// noise: gel between skin and marker strains, and a recorder may smooth over time. Valid: 0 to 1 mm.
    /// Default: `0` mm, for the simulator's gels. Raise it until parts that stick are not reported to slip.
    pub strain_sigma_mm: f64,
    /// Standard deviation per axis of a marker from the rigid motion of a part that sticks, for each
    /// millimetre by which it was pressed deeper since it touched, or was let out. Valid: 0 to 1. Default:
    /// `0`, for the simulator's gels. Raise it until parts that are pressed or rolled are not reported to
    /// slip.
    pub strain_share: f64,
    /// Shape of the part where it touches the gel, for the margin from the stick ratio. Default: `unknown`,
    /// without such a margin. Set it for round parts whose friction or forces are not known.
    pub shape: SlipShape,
}

impl Default for SlipParams {
    fn default() -> Self {
        Self {
            method: SlipMethod::None,
            false_alarms_per_hour: 1.0,
            frame_rate_hz: 30.0,
            strain_sigma_mm: 0.0,
            strain_share: 0.0,
            shape: SlipShape::Unknown,
        }
    }
}

impl SlipParams {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let (alarms, rate_hz) = (self.false_alarms_per_hour, self.frame_rate_hz);
        let valid = "0.000001 to 3600 per hour";
        check((1e-6..=3600.0).contains(&alarms), "slip.false_alarms_per_hour", alarms, valid)?;
        check((1e-3..=1e5).contains(&rate_hz), "slip.frame_rate_hz", rate_hz, "0.001 to 100000 Hz")?;
        let sigma_mm = self.strain_sigma_mm;
        check((0.0..=1.0).contains(&sigma_mm), "slip.strain_sigma_mm", sigma_mm, "0 to 1 mm")?;
        check((0.0..=1.0).contains(&self.strain_share), "slip.strain_share", self.strain_share, "0 to 1")
    }

    /// Squared distance, in variances of two components, that one of `tests` in each frame exceeds by noise
    /// at the rate of false alarms.
    pub(crate) fn gate(&self, tests: usize) -> f64 {
        let tests_per_hour = SECONDS_PER_HOUR * self.frame_rate_hz * tests as f64;
        -2.0 * ln((self.false_alarms_per_hour / tests_per_hour).min(0.5))
    }
}
