//! The pitch of a print, which may differ along rows and columns.

use crate::math::sqrt;
use core::fmt;

/// Distances between neighbouring markers of a lattice. A file gives one number for a square lattice and
/// `[x, y]` for a rectangular one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pitch {
    /// Distance along a row, mm.
    pub x_mm: f64,
    /// Distance along a column, mm.
    pub y_mm: f64,
}

impl Pitch {
    /// Of a square lattice.
    #[must_use]
    pub const fn square(mm: f64) -> Self {
        Self { x_mm: mm, y_mm: mm }
    }

    /// Side of the square with the area of a cell, mm.
    #[must_use]
    pub fn mean_mm(&self) -> f64 {
        if self.x_mm == self.y_mm { self.x_mm } else { sqrt(self.x_mm * self.y_mm) }
    }

    /// Both distances, along a row first.
    #[must_use]
    pub const fn axes_mm(&self) -> [f64; 2] {
        [self.x_mm, self.y_mm]
    }
}

impl From<f64> for Pitch {
    fn from(mm: f64) -> Self {
        Self::square(mm)
    }
}

impl fmt::Display for Pitch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.x_mm == self.y_mm { self.x_mm.fmt(f) } else { write!(f, "[{}, {}]", self.x_mm, self.y_mm) }
    }
}

#[cfg(feature = "serde")]
mod file {
    use super::Pitch;
    use core::fmt;
    use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};
    use serde::ser::{Serialize, Serializer};

    impl Serialize for Pitch {
        fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            if self.x_mm == self.y_mm {
                serializer.serialize_f64(self.x_mm)
            } else {
                self.axes_mm().serialize(serializer)
            }
        }
    }

    struct PitchVisitor;

    impl<'de> Visitor<'de> for PitchVisitor {
        type Value = Pitch;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a number, or two as [x, y]")
        }

        fn visit_f64<E: Error>(self, mm: f64) -> Result<Pitch, E> {
            Ok(Pitch::square(mm))
        }

        fn visit_i64<E: Error>(self, mm: i64) -> Result<Pitch, E> {
            Ok(Pitch::square(mm as f64))
        }

        fn visit_u64<E: Error>(self, mm: u64) -> Result<Pitch, E> {
            Ok(Pitch::square(mm as f64))
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut axes: A) -> Result<Pitch, A::Error> {
            let mut next = |n| axes.next_element()?.ok_or_else(|| Error::invalid_length(n, &self));
            let pitch = Pitch { x_mm: next(0)?, y_mm: next(1)? };
            match axes.next_element::<f64>()? {
                None => Ok(pitch),
                Some(_) => Err(Error::invalid_length(3, &self)),
            }
        }
    }

    impl<'de> Deserialize<'de> for Pitch {
        fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
            deserializer.deserialize_any(PitchVisitor)
        }
    }
}
