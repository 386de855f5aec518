//! Other poses that explain a contact about as well as the best.

use crate::math::Pose;

/// Another pose that explains the contact about as well as the best: at least 1 % as likely, and apart from it and from
/// every other one by five standard deviations over what the contact determines. It stands where the best one does along
/// the directions that the contact leaves free, or where a turn that shows the part alike puts that pose. How far the guess
/// is off counts in the likelihood.
///
/// Turns after which the whole part looks the same are tried on every answer, and motions that brought one answer to
/// another. A pose that looks the same in this contact alone is missing if no start came near it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Alternative {
    /// Maps object coordinates to sensor coordinates.
    pub t_sensor_object: Pose,
    /// As [`super::Registration::log_likelihood`].
    pub log_likelihood: f64,
}

/// The other poses, the likelier one first, up to [`Self::MOST`] of them, without allocation; it reads, and prints, as a
/// slice.
#[derive(Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Alternatives {
    all: [Alternative; Self::MOST],
    count: usize,
    is_cut: bool,
}

impl Alternatives {
    /// Most that are kept.
    pub const MOST: usize = 8;

    /// None.
    pub const NONE: Self = Self {
        all: [Alternative { t_sensor_object: Pose::IDENTITY, log_likelihood: 0.0 }; Self::MOST],
        count: 0,
        is_cut: false,
    };

    /// Whether there may be more: there was no room for all, or the budget of work was spent before all were looked at. The
    /// likelier ones come first.
    #[must_use]
    pub const fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// None yet of a list.
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
