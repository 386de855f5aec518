//! The print's pitch as triangulated at rest, a check of rig and settings that needs no further measurement.

use crate::math::{DVec3, abs, median, sqrt};
use alloc::vec::Vec;
use core::fmt;

/// Median distance of neighbours in a row of the rest frame, beside the setting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PitchCheck {
    /// Median distance of neighbouring markers, mm.
    pub measured_mm: f64,
    /// Its standard deviation from the scatter of the distances, mm.
    pub sigma_mm: f64,
    /// `lattice.pitch_mm`.
    pub expected_mm: f64,
}

impl PitchCheck {
    /// Of markers at rest, row by row. `None` with fewer than two columns.
    #[must_use]
    pub fn new(points_mm: &[DVec3], cols: usize, expected_mm: f64) -> Option<Self> {
        let rows = points_mm.chunks(cols.max(1));
        let mut apart_mm: Vec<f64> =
            rows.flat_map(|row| row.windows(2).map(|pair| pair[0].distance(pair[1]))).collect();
        let measured_mm = median(&mut apart_mm)?;
        let mut off_mm: Vec<f64> = apart_mm.iter().map(|apart| abs(apart - measured_mm)).collect();
        let scatter_mm = SIGMA_OF_MAD * median(&mut off_mm)?;
        let sigma_mm = SIGMA_OF_MEDIAN * scatter_mm / sqrt(apart_mm.len() as f64);
        Some(Self { measured_mm, sigma_mm, expected_mm })
    }

    /// Whether rig and settings are of another sensor altogether; one that ignores its layers is not.
    #[must_use]
    pub fn is_absurd(&self) -> bool {
        let ratio = self.measured_mm / self.expected_mm;
        !(1.0 / ABSURD..=ABSURD).contains(&ratio)
    }

    /// Whether the difference is beyond what noise and a print's scale explain.
    #[must_use]
    pub fn is_off(&self) -> bool {
        abs(self.measured_mm - self.expected_mm) > SIGMAS * self.sigma_mm + PRINT_SCALE * self.expected_mm
    }
}

impl fmt::Display for PitchCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the markers are {:.4} ± {:.4} mm apart at rest, but lattice.pitch_mm is {}: lengths would be \
             wrong by {:+.1} %. Check lattice.pitch_mm, the size of the chessboard's squares, the baseline, \
             and the layers before the gel",
            self.measured_mm,
            self.sigma_mm,
            self.expected_mm,
            100.0 * (self.measured_mm / self.expected_mm - 1.0)
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
