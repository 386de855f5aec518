//! Requirements of a scene.

use crate::effects::Switches;
use crate::plan::Bound;
use crate::scene::SceneError;

/// The required output, and its tolerance relative to the simulation with all listed effects.
///
/// In a file: `asked = { kind = "positions", tolerance_px = 0.01 }`. Effects that hide, add or drop dots
/// (smears, specks, merged dots) change no position and no point; require images to keep them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)
)]
pub enum Asked {
    /// Positions of the dots in both images: the centroids of their outlines.
    Positions {
        /// Largest error of a position.
        tolerance_px: f64,
    },
    /// Positions of the markers in space.
    Points {
        /// Largest error of a point.
        tolerance_um: f64,
    },
    /// Every pixel of both images.
    Images {
        /// Largest error of a pixel before rounding, grey levels.
        tolerance_levels: f64,
    },
}

impl Asked {
    /// The tolerance, in [`Self::unit`].
    #[must_use]
    pub const fn tolerance(&self) -> f64 {
        match *self {
            Self::Positions { tolerance_px } => tolerance_px,
            Self::Points { tolerance_um } => tolerance_um,
            Self::Images { tolerance_levels } => tolerance_levels,
        }
    }

    /// `px`, `um` or `levels`.
    #[must_use]
    pub const fn unit(&self) -> &'static str {
        match self {
            Self::Positions { .. } => "px",
            Self::Points { .. } => "um",
            Self::Images { .. } => "levels",
        }
    }

    /// Whether the cameras are needed: dot positions in the images, or images.
    #[must_use]
    pub const fn views(&self) -> bool {
        !matches!(self, Self::Points { .. })
    }

    /// Whether images are needed.
    #[must_use]
    pub const fn images(&self) -> bool {
        matches!(self, Self::Images { .. })
    }

    /// The bound in the unit of the requirement.
    #[must_use]
    pub const fn of(&self, bound: &Bound) -> f64 {
        match self {
            Self::Positions { .. } => bound.px,
            Self::Points { .. } => bound.um,
            Self::Images { .. } => bound.levels,
        }
    }

    pub(crate) fn validate(&self) -> Result<(), SceneError> {
        let (name, valid) = match self {
            Self::Positions { .. } => ("asked.tolerance_px", "0 to 1000000 px"),
            Self::Points { .. } => ("asked.tolerance_um", "0 to 1000000 um"),
            Self::Images { .. } => ("asked.tolerance_levels", "0 to 1000000 grey levels"),
        };
        let tolerance = self.tolerance();
        SceneError::check((0.0..=1e6).contains(&tolerance), name, tolerance, valid)
    }
}

/// Switch of an effect. Unset means [`Self::Auto`] if the scene has a requirement, else [`Self::On`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Switch {
    /// Off if the required output hardly depends on it.
    Auto,
    /// Always computed.
    On,
    /// Treated as absent.
    Off,
}

impl Switches {
    /// Rejects invalid switches: an effect that is on must exist, and auto needs a tolerance.
    pub(crate) fn validate(&self, asked: bool, has: impl Fn(&str) -> bool) -> Result<(), SceneError> {
        for (effect, switch) in self.all() {
            match switch {
                Some(Switch::On) if !has(effect) => return Err(SceneError::NothingToSwitchOn { effect }),
                Some(Switch::Auto) if !asked => return Err(SceneError::NothingAsked { effect }),
                _ => {}
            }
        }
        Ok(())
    }
}
