//! What is asked of a scene.

use crate::effects::Switches;
use crate::plan::Bound;
use crate::scene::SceneError;

/// What is asked of a scene, and how far it may be from the truth of all listed effects.
///
/// In a file: `asked = { kind = "positions", tolerance_px = 0.01 }`. What hides, adds or drops dots (smears, specks,
/// merged dots) changes no position and no point: who needs it asks for images.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)
)]
pub enum Asked {
    /// Where the dots are in both images: the centroids of their outlines.
    Positions {
        /// The most that a position may be off.
        tolerance_px: f64,
    },
    /// Where the markers are in space.
    Points {
        /// The most that a point may be off.
        tolerance_um: f64,
    },
    /// Every pixel of both images.
    Images {
        /// The most that a pixel may be off before it is rounded, grey levels.
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

    /// Whether it takes the cameras: dots where they are seen, or images.
    #[must_use]
    pub const fn views(&self) -> bool {
        !matches!(self, Self::Points { .. })
    }

    /// Whether it takes images.
    #[must_use]
    pub const fn images(&self) -> bool {
        matches!(self, Self::Images { .. })
    }

    /// The bound of what is asked.
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

/// How an effect is switched. Without a word it is [`Self::Auto`] where something is asked, else [`Self::On`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Switch {
    /// Off where what is asked hardly depends on it.
    Auto,
    /// Computed whatever is asked.
    On,
    /// As if the scene did not have it.
    Off,
}

impl Switches {
    /// Switches that make no sense: what is on must be there, and auto needs a tolerance.
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
