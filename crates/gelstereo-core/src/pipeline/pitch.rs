//! The print's pitch as triangulated at rest, a check of rig and settings that needs no further measurement.

use crate::math::{DVec3, abs, median, sqrt};
use crate::params::Pitch;
use alloc::vec::Vec;
use core::fmt;

/// Median distances of neighbours in the rest frame, beside the setting. Arrays have the value along rows
/// first, then the one along columns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PitchCheck {
    /// Median distances of neighbouring markers, mm.
    pub measured_mm: [f64; 2],
    /// Their standard deviations from the scatter of the distances, mm.
    pub sigma_mm: [f64; 2],
    /// `lattice.pitch_mm`.
    pub expected: Pitch,
}

impl PitchCheck {
    /// Of markers at rest, row by row. `None` with fewer than two rows or columns.
    #[must_use]
    pub fn new(points_mm: &[DVec3], cols: usize, expected: Pitch) -> Option<Self> {
        let cols = cols.max(1);
        let right = (0..points_mm.len()).filter(|i| (i + 1) % cols != 0).map(|i| (i, i + 1));
        let below = (cols..points_mm.len()).map(|i| (i - cols, i));
        let apart_mm = |(i, j): (usize, usize)| Some(points_mm.get(i)?.distance(*points_mm.get(j)?));
        let (x_mm, x_sigma_mm) = spread(right.filter_map(apart_mm).collect())?;
        let (y_mm, y_sigma_mm) = spread(below.filter_map(apart_mm).collect())?;
        Some(Self { measured_mm: [x_mm, y_mm], sigma_mm: [x_sigma_mm, y_sigma_mm], expected })
    }

    /// Whether rig and settings are of another sensor altogether; one that ignores its layers is not.
    #[must_use]
    pub fn is_absurd(&self) -> bool {
        self.ratios().iter().any(|ratio| !(1.0 / ABSURD..=ABSURD).contains(ratio))
    }

    /// Whether a difference is beyond what noise and a print's scale explain.
    #[must_use]
    pub fn is_off(&self) -> bool {
        let axes = self.measured_mm.into_iter().zip(self.sigma_mm).zip(self.expected.axes_mm());
        axes.into_iter().any(|((measured_mm, sigma_mm), expected_mm)| {
            abs(measured_mm - expected_mm) > SIGMAS * sigma_mm + PRINT_SCALE * expected_mm
        })
    }

    /// Measured over expected pitch.
    fn ratios(&self) -> [f64; 2] {
        let [x_mm, y_mm] = self.measured_mm;
        [x_mm / self.expected.x_mm, y_mm / self.expected.y_mm]
    }
}

/// Median of distances and its standard deviation.
fn spread(mut apart_mm: Vec<f64>) -> Option<(f64, f64)> {
    let measured_mm = median(&mut apart_mm)?;
    let mut off_mm: Vec<f64> = apart_mm.iter().map(|apart| abs(apart - measured_mm)).collect();
    let scatter_mm = SIGMA_OF_MAD * median(&mut off_mm)?;
    Some((measured_mm, SIGMA_OF_MEDIAN * scatter_mm / sqrt(apart_mm.len() as f64)))
}

impl fmt::Display for PitchCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x_mm, y_mm], [x_sigma_mm, y_sigma_mm]) = (self.measured_mm, self.sigma_mm);
        let [x, y] = self.ratios().map(|ratio| 100.0 * (ratio - 1.0));
        write!(
            f,
            "the markers are {x_mm:.4} ± {x_sigma_mm:.4} mm apart along rows and {y_mm:.4} ± \
             {y_sigma_mm:.4} mm along columns at rest, but lattice.pitch_mm is {}: lengths would be wrong by \
             {x:+.1} % and {y:+.1} %. Check lattice.pitch_mm, the size of the chessboard's squares, the \
             baseline, and the layers before the gel",
            self.expected,
        )
    }
}

/// Standard deviation of normal values over their median absolute deviation: 1 / Φ⁻¹(3/4).
const SIGMA_OF_MAD: f64 = 1.4826;

/// Standard deviation of the median of many normal values over that of their mean: sqrt(π / 2).
const SIGMA_OF_MEDIAN: f64 = 1.2533;

/// Noise exceeds so many standard deviations once in 3.5 million first frames.
const SIGMAS: f64 = 5.0;

/// A pitch is stated to two digits, and printers are off by up to a per cent.
const PRINT_SCALE: f64 = 0.01;

/// Largest ratio of measured and configured pitch, either way: a rig that ignores its layers stays below it.
const ABSURD: f64 = 2.0;
