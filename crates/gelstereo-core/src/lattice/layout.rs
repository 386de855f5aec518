//! Describes how markers are laid out that form no square lattice.

use crate::math::{DVec2, abs, median, sqrt};
use crate::params::PrintLayout;
use alloc::vec::Vec;

/// Largest number of markers whose neighbours are examined. It bounds the work.
const MAX_SAMPLED: usize = 256;
/// Smallest number of markers with a layout: three rows of three.
pub(super) const MIN_MARKERS: usize = 9;
/// Nearest neighbours considered per marker.
const NEAREST: usize = 6;
/// A cell is hexagonal if its longer side and its shorter diagonal are at most this long, in shorter sides.
/// Both are 1 in a hexagonal print. In a square one the diagonal is the root of 2: this is the geometric
/// mean.
const MAX_HEXAGONAL: f64 = 1.19;
/// Largest sum of two opposite steps, in steps. It is 0 in a lattice, and in perspective the share by which
/// the spacing changes from one marker to the next.
const MAX_OPPOSITE_OFF: f64 = 0.25;
/// Ratio of the spacings from which a print is called rectangular. A square print that is tilted by 37
/// degrees looks like this.
pub(super) const MIN_RECTANGULAR: f64 = 1.25;

/// How markers are laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Layout {
    /// Four neighbours at equal distances, at right angles.
    Square {
        /// Median distance of neighbours, pixels.
        pitch_px: f64,
    },
    /// Six neighbours at equal distances.
    Hexagonal,
    /// Rows and columns of different spacing.
    Rectangular {
        /// Median distance of neighbours in the direction of the closer ones, pixels.
        short_px: f64,
        /// The same across it, pixels.
        long_px: f64,
    },
    /// Unequal distances in all directions, as of random dots.
    Irregular {
        /// Distance to the nearest neighbour that a tenth of the markers are below, pixels.
        low_px: f64,
        /// The same of nine tenths, pixels.
        high_px: f64,
    },
}

impl core::fmt::Display for Layout {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Square { pitch_px } => {
                write!(f, "they stand {pitch_px:.1} px apart at right angles: the print is square")
            }
            Self::Hexagonal => {
                write!(f, "most have six neighbours at equal distances: the print is hexagonal")
            }
            Self::Rectangular { short_px, long_px } => write!(
                f,
                "they stand {short_px:.1} px apart in one direction and {long_px:.1} px across it: the print \
                is rectangular"
            ),
            Self::Irregular { low_px, high_px } => write!(
                f,
                "their spacing is unequal, from {low_px:.1} to {high_px:.1} px to the nearest neighbour: the \
                 print has no lattice, or much is detected that is no marker"
            ),
        }
    }
}

/// Steps from a marker to its nearest neighbours, in order of distance.
fn nearest(points: &[DVec2], centre: usize) -> [DVec2; NEAREST] {
    let mut steps = [DVec2::INFINITY; NEAREST];
    for (_, &point) in points.iter().enumerate().filter(|&(m, _)| m != centre) {
        let mut step = point - points[centre];
        for kept in &mut steps {
            if step.length_squared() < kept.length_squared() {
                core::mem::swap(kept, &mut step);
            }
        }
    }
    steps
}

/// Whether all six neighbours stand at about the same distance, each opposite another one.
fn is_hexagon(steps: &[DVec2; NEAREST]) -> bool {
    let length = steps[0].length();
    steps[NEAREST - 1].length() <= MAX_HEXAGONAL * length
        && steps.iter().all(|&step| opposite(steps, step).is_some())
}

/// The step opposite to one of them.
fn opposite(steps: &[DVec2], step: DVec2) -> Option<DVec2> {
    let max_off2 = MAX_OPPOSITE_OFF * MAX_OPPOSITE_OFF * step.length_squared();
    steps.iter().copied().find(|&other| (step + other).length_squared() <= max_off2)
}

/// Lengths of the shortest two pairs of opposite steps that stand square on each other.
fn two_axes(steps: &[DVec2; NEAREST]) -> Option<(f64, f64)> {
    let first = steps.iter().copied().find(|&step| opposite(steps, step).is_some())?;
    let across =
        |step: DVec2| abs(first.dot(step)) < 0.3 * sqrt(first.length_squared() * step.length_squared());
    let second = steps.iter().copied().find(|&step| across(step))?;
    Some((first.length(), second.length()))
}

/// Median distance of a marker from its nearest neighbour.
pub(super) fn usual_distance(points: &[DVec2]) -> Option<f64> {
    if points.len() < 2 || points.iter().any(|point| !point.is_finite()) {
        return None;
    }
    let stride = points.len().div_ceil(MAX_SAMPLED);
    let distance = |centre: usize| nearest(points, centre)[0].length();
    median(&mut (0..points.len()).step_by(stride).map(distance).collect::<Vec<f64>>())
}

impl Layout {
    /// Whether it is as printed.
    pub(super) const fn is(&self, printed: PrintLayout) -> bool {
        match self {
            Self::Hexagonal => matches!(printed, PrintLayout::Hexagonal),
            Self::Square { .. } => matches!(printed, PrintLayout::Square),
            Self::Rectangular { .. } | Self::Irregular { .. } => false,
        }
    }

    /// Describes the layout of markers; `None` for a square one, and where too few markers tell it.
    ///
    /// Its cost is that of up to 256 passes over the markers.
    #[must_use]
    pub fn of(points: &[DVec2]) -> Option<Self> {
        if points.len() < MIN_MARKERS || points.iter().any(|point| !(point.abs().max_element() < 1e6)) {
            return None;
        }
        let stride = points.len().div_ceil(MAX_SAMPLED);
        let around: Vec<[DVec2; NEAREST]> =
            (0..points.len()).step_by(stride).map(|centre| nearest(points, centre)).collect();
        let mut distances: Vec<f64> = around.iter().map(|steps| steps[0].length()).collect();
        distances.sort_unstable_by(f64::total_cmp);
        if distances[distances.len() / 2] <= 0.0 {
            return None;
        }
        // Markers at the border have fewer neighbours.
        if 4 * around.iter().filter(|steps| is_hexagon(steps)).count() >= around.len() {
            return Some(Self::Hexagonal);
        }
        let (mut short, mut long): (Vec<f64>, Vec<f64>) = around.iter().filter_map(two_axes).unzip();
        if 2 * short.len() >= around.len() {
            let (short_px, long_px) = (median(&mut short)?, median(&mut long)?);
            return (long_px > MIN_RECTANGULAR * short_px).then_some(Self::Rectangular { short_px, long_px });
        }
        let share = |tenths: usize| distances[(distances.len() - 1) * tenths / 10];
        Some(Self::Irregular { low_px: share(1), high_px: share(9) })
    }
}
