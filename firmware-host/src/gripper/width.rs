//! Opening width as a function of the gripper's counts, from a measured table.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Pairs of a gripper's count and the width between the pads, with straight lines between them.
///
/// A gripper's documents give two points at best. A table that was measured with gauge blocks has more, and
/// its uncertainty is the blocks'.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "WidthTableFields", into = "WidthTableFields")]
pub struct WidthTable {
    /// Counts increase from point to point; widths are strictly monotonic.
    points: Vec<[f64; 2]>,
    max_error_mm: f64,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WidthTableFields {
    /// Pairs of count and width in millimetres, in the order of the counts. Set it to what gauge blocks show.
    points: Vec<[f64; 2]>,
    /// How far the true width may be from the table's, mm. Set it to the uncertainty of the measurement.
    max_error_mm: f64,
}

/// Reason why pairs are not a valid table.
#[derive(Clone, Debug, PartialEq)]
pub enum WidthTableError {
    /// A line needs two points.
    TooFew {
        /// Points found.
        found: usize,
    },
    /// Counts must increase, widths must be monotonic, and all must be finite.
    Order {
        /// Index of the first violating point.
        index: usize,
    },
    /// The error bound is negative or not finite.
    Bound {
        /// Bound found.
        found: f64,
    },
}

impl fmt::Display for WidthTableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFew { found } => write!(f, "the width table has {found} points; valid is two or more"),
            Self::Order { index } => write!(
                f,
                "point {index} of the width table is out of order; counts must rise, and widths fall or rise \
                all the way"
            ),
            Self::Bound { found } => write!(f, "max_error_mm is {found}; valid is 0 or more"),
        }
    }
}

impl std::error::Error for WidthTableError {}

impl TryFrom<WidthTableFields> for WidthTable {
    type Error = WidthTableError;

    fn try_from(fields: WidthTableFields) -> Result<Self, WidthTableError> {
        Self::new(fields.points, fields.max_error_mm)
    }
}

impl From<WidthTable> for WidthTableFields {
    fn from(table: WidthTable) -> Self {
        Self { points: table.points, max_error_mm: table.max_error_mm }
    }
}

impl WidthTable {
    /// Table from pairs of count and width in millimetres. `max_error_mm` bounds the error of the
    /// table's width.
    ///
    /// # Errors
    /// [`WidthTableError`].
    pub fn new(points: Vec<[f64; 2]>, max_error_mm: f64) -> Result<Self, WidthTableError> {
        if points.len() < 2 {
            return Err(WidthTableError::TooFew { found: points.len() });
        }
        if !(max_error_mm >= 0.0 && max_error_mm.is_finite()) {
            return Err(WidthTableError::Bound { found: max_error_mm });
        }
        let falls = points[1][1] < points[0][1];
        for (index, pair) in points.windows(2).enumerate() {
            let [[count, width_mm], [next_count, next_width_mm]] = [pair[0], pair[1]];
            let finite = [count, width_mm, next_count, next_width_mm].iter().all(|value| value.is_finite());
            let moves = if falls { next_width_mm < width_mm } else { next_width_mm > width_mm };
            if !(finite && next_count > count && moves) {
                return Err(WidthTableError::Order { index: index + 1 });
            }
        }
        Ok(Self { points, max_error_mm })
    }

    /// Largest error of the table's width.
    #[must_use]
    pub const fn max_error_mm(&self) -> f64 {
        self.max_error_mm
    }

    /// Smallest and largest width.
    #[must_use]
    pub fn range_mm(&self) -> (f64, f64) {
        let (first, last) = (self.points[0][1], self.points[self.points.len() - 1][1]);
        (first.min(last), first.max(last))
    }

    /// Width at a count. The first and last segments are extrapolated, since a gripper's end stops wear.
    #[must_use]
    pub fn width_mm(&self, count: f64) -> f64 {
        let last = self.points.len() - 2;
        let segment = self.points.partition_point(|&[at, _]| at <= count).saturating_sub(1).min(last);
        let [[low, from_mm], [high, to_mm]] = [self.points[segment], self.points[segment + 1]];
        from_mm + (to_mm - from_mm) * (count - low) / (high - low)
    }

    /// Count at a width; `None` outside the range.
    #[must_use]
    pub fn count(&self, width_mm: f64) -> Option<f64> {
        let (min_mm, max_mm) = self.range_mm();
        if !(width_mm >= min_mm && width_mm <= max_mm) {
            return None;
        }
        let pair = self.points.windows(2).find(|pair| {
            let (a, b) = (pair[0][1], pair[1][1]);
            width_mm >= a.min(b) && width_mm <= a.max(b)
        })?;
        let [[low, from_mm], [high, to_mm]] = [pair[0], pair[1]];
        Some(low + (high - low) * (width_mm - from_mm) / (to_mm - from_mm))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Widths of a table have their counts, those at its ends included; beyond them there is none.
        #[test]
        fn counts_and_widths_undo_each_other(
            start_mm in 1.0..50.0_f64, steps in prop::collection::vec((1.0..90.0_f64, 0.1..20.0_f64), 1..8),
            falls in any::<bool>(), share in 0.0..=1.0_f64,
        ) {
            let sign = if falls { -1.0 } else { 1.0 };
            let mut points = vec![[3.0, start_mm]];
            for (count, mm) in steps {
                let [last_count, last_mm] = points[points.len() - 1];
                points.push([last_count + count, last_mm + sign * mm]);
            }
            let table = WidthTable::new(points.clone(), 0.5).unwrap();
            let (min_mm, max_mm) = table.range_mm();
            let between = min_mm + share * (max_mm - min_mm);
            for width_mm in points.iter().map(|point| point[1]).chain([between.clamp(min_mm, max_mm)]) {
                let count = table.count(width_mm).unwrap();
                prop_assert!((table.width_mm(count) - width_mm).abs() < 1e-9, "{width_mm} at {count}");
            }
            for width_mm in [min_mm - 1e-6, max_mm + 1e-6, f64::NAN] {
                prop_assert_eq!(table.count(width_mm), None);
            }
        }
    }
}
