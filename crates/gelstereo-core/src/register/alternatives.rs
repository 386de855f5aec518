//! Other poses that explain a contact about as well as the best one.

use crate::math::Pose;

/// Another pose that explains the contact about as well as the best: at least 1 % as likely, and five
/// standard deviations apart from it and all others over the determined directions. Along free directions
/// it equals the best pose or its copy under a symmetry. The likelihood includes the prior of the guess.
///
/// Symmetry rotations of the whole part are tried on every optimum, as are motions that relate two
/// optima. A pose that is equivalent in this contact only is missing if no start converged near it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Alternative {
    /// Maps object coordinates to sensor coordinates.
    pub t_sensor_object: Pose,
    /// As [`super::Registration::log_likelihood`].
    pub log_likelihood: f64,
}

/// The other poses, most likely first, at most [`Self::MAX_COUNT`], without allocation. Dereferences to, and
/// prints as, a slice.
#[derive(Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Alternatives {
    all: [Alternative; Self::MAX_COUNT],
    count: usize,
    is_cut: bool,
}

impl Alternatives {
    /// Largest number kept.
    pub const MAX_COUNT: usize = 8;

    /// No other poses.
    pub const NONE: Self = Self {
        all: [Alternative { t_sensor_object: Pose::IDENTITY, log_likelihood: 0.0 }; Self::MAX_COUNT],
        count: 0,
        is_cut: false,
    };

    /// Whether there may be more: the list was full, or the work budget ran out first. The most likely
    /// ones are kept.
    #[must_use]
    pub const fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// An empty list.
    pub(super) const fn none_of(is_cut: bool) -> Self {
        Self { is_cut, ..Self::NONE }
    }

    pub(super) fn push(&mut self, one: Alternative) {
        match self.all.get_mut(self.count) {
            Some(place) => {
                *place = one;
                self.count += 1;
            }
            None => self.is_cut = true,
        }
    }
}

impl core::ops::Deref for Alternatives {
    type Target = [Alternative];

    fn deref(&self) -> &[Alternative] {
        &self.all[..self.count]
    }
}

impl core::fmt::Debug for Alternatives {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}
