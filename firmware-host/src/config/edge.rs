//! A face of the cell that a part in the hand may touch.

use super::ConfigError;
use super::range::{FAR_MM, LENGTH_MM, SIGMA_MM, SPEED_MM_S, check};
use gelstereo_core::math::DVec3;
use serde::{Deserialize, Serialize};

/// A flat face of a fixture with a known position in the robot's base frame. The hand slowly moves the part's
/// side or end towards it until the gel shows the contact.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EdgeConfig {
    /// Middle of the face, base frame. The middle of the part's tip is moved in front of it, so up to half of
    /// the face touches the part, as far as the part protrudes from the fingers. Valid: -10000 to 10000 mm.
    /// Change it to your cell's.
    pub point_mm: [f64; 3],
    /// Outward direction of the face, base frame, of any length. The part's sides touch faces with a
    /// horizontal normal, its end touches faces with a vertical normal. Valid: -1000000 to 1000000. Change it
    /// to your cell's.
    pub normal: [f64; 3],
    /// Width and height of the face, larger than the side of the part that touches it. Valid: 0.001 to 1000
    /// mm. Default: `20` mm. Change it to your fixture's.
    #[serde(default = "default_size_mm")]
    pub size_mm: f64,
    /// Standard deviation of the face's position along its normal. Valid: 0.0001 to 100 mm. Default: `0.02`
    /// mm. Change it to how well the face was measured.
    #[serde(default = "default_sigma_mm")]
    pub sigma_mm: f64,
    /// Standard deviation of the robot's position between the face and the hole. Valid: 0.0001 to 100 mm.
    /// Default: `0.02` mm. Change it to your robot's repeatability.
    #[serde(default = "default_sigma_mm")]
    pub robot_sigma_mm: f64,
    /// Distance of the slow move's start from the expected contact, larger if the part is more uncertain. The
    /// move ends at the same distance behind. Valid: 0.001 to 1000 mm. Default: `2` mm. Raise it where the
    /// part may be farther from where it is expected.
    #[serde(default = "default_approach_mm")]
    pub approach_mm: f64,
    /// Speed of the slow move. Valid: 0.01 to 10000 mm/s. Default: `1` mm/s. Raise it to save time; the
    /// travel between two frames adds to the part's uncertainty.
    #[serde(default = "default_speed_mm_s")]
    pub speed_mm_s: f64,
}

const fn default_size_mm() -> f64 {
    20.0
}

const fn default_sigma_mm() -> f64 {
    0.02
}

const fn default_approach_mm() -> f64 {
    2.0
}

const fn default_speed_mm_s() -> f64 {
    1.0
}

impl EdgeConfig {
    /// Middle of the face, base frame.
    #[must_use]
    pub const fn middle_mm(&self) -> DVec3 {
        DVec3::from_array(self.point_mm)
    }

    /// Unit direction out of the face, base frame.
    #[must_use]
    pub fn unit_normal(&self) -> DVec3 {
        DVec3::from_array(self.normal).normalize_or_zero()
    }

    /// Unit directions of the face's width and height, base frame. The height of an upright face is z.
    #[must_use]
    pub fn sides(&self) -> [DVec3; 2] {
        let normal = self.unit_normal();
        let upright = if normal.z.abs() < 0.9 { DVec3::Z } else { DVec3::Y };
        let width = upright.cross(normal).normalize_or_zero();
        [width, normal.cross(width)]
    }

    pub(super) fn validate(&self, stage_timeout_s: f64) -> Result<(), ConfigError> {
        for found in self.point_mm {
            check(found.abs() <= FAR_MM, "task.edges.point_mm", found, "-10000 to 10000 mm")?;
        }
        for found in self.normal {
            check(found.abs() <= 1e6, "task.edges.normal", found, "-1000000 to 1000000")?;
        }
        let length = DVec3::from_array(self.normal).length();
        check(length > 1e-6, "task.edges.normal", length, "a direction, not zero")?;
        LENGTH_MM.check("task.edges.size_mm", self.size_mm)?;
        SIGMA_MM.check("task.edges.sigma_mm", self.sigma_mm)?;
        SIGMA_MM.check("task.edges.robot_sigma_mm", self.robot_sigma_mm)?;
        LENGTH_MM.check("task.edges.approach_mm", self.approach_mm)?;
        SPEED_MM_S.check("task.edges.speed_mm_s", self.speed_mm_s)?;
        let planned_s = 2.0 * self.approach_mm / self.speed_mm_s;
        if planned_s > stage_timeout_s {
            let (name, limit_s) = ("task.edges.speed_mm_s", stage_timeout_s);
            return Err(ConfigError::TooSlow { name, planned_s, limit_s });
        }
        Ok(())
    }
}
