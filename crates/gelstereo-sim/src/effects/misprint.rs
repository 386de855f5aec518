//! Printing errors of the lattice.

use crate::plan::{Bound, Effect, Facts};
use crate::scene::{Gel, SceneError};
use crate::simulator::DotImage;
use alloc::vec::Vec;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::{DVec2, cos, random::Stream, sin, sqrt};

/// Displaced dots, dots of other sizes, and ink between neighbours. The ground truth has the printed
/// centres, both of them for merged dots.
///
/// In a file: `[effects.misprint] shift_mm = 0.05, merged = [[3, 4, 3, 5]]`.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Misprint {
    /// Largest displacement of a dot. Displacements are uniformly distributed within this distance. Default:
    /// `0`, at most a quarter of the pitch.
    pub shift_mm: f64,
    /// Largest relative change of a dot's radius, uniformly distributed. Default: `0`, at most 0.5.
    pub radius_share: f64,
    /// (row, column, row, column) of neighbours that are joined by a bar of ink. Default: none.
    pub merged: Vec<[usize; 4]>,
    /// Width of that bar relative to the dots' diameter. Default: `0.7`.
    pub bridge_share: f64,
}

impl Default for Misprint {
    fn default() -> Self {
        Self { shift_mm: 0.0, radius_share: 0.0, merged: Vec::new(), bridge_share: 0.7 }
    }
}

impl Effect for Misprint {
    fn validate(&self, gel: &Gel) -> Result<(), SceneError> {
        let check = SceneError::check;
        let (shift, radius, bridge) = (self.shift_mm, self.radius_share, self.bridge_share);
        let max_mm = 0.25 * gel.least_pitch_mm();
        check(
            (0.0..=max_mm).contains(&shift),
            "effects.misprint.shift_mm",
            shift,
            "0 to a quarter of gel.pitch_mm",
        )?;
        check((0.0..=0.5).contains(&radius), "effects.misprint.radius_share", radius, "0 to 0.5")?;
        check(bridge > 0.0 && bridge <= 1.0, "effects.misprint.bridge_share", bridge, "above 0, at most 1")?;
        for &[row, col, other_row, other_col] in &self.merged {
            for (row, col) in [(row, col), (other_row, other_col)] {
                if row >= gel.rows || col >= gel.cols {
                    return Err(SceneError::NoSuchMarker { row, col, rows: gel.rows, cols: gel.cols });
                }
            }
            let steps = row.abs_diff(other_row) + col.abs_diff(other_col);
            let name = "steps between two effects.misprint.merged";
            check(steps == 1, name, steps as f64, "1: neighbours along a row or a column")?;
        }
        Ok(())
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let sideways_mm = self.shift_mm + facts.when_contact_changes_mm();
        let shifted = match self.shift_mm > 0.0 {
            true => facts.moved(sideways_mm, facts.height_mm(sideways_mm)),
            false => Bound::NONE,
        };
        let ink = if self.merged.is_empty() { 0.0 } else { facts.contrast_levels() };
        let radius_px = facts.optics.lateral_px_per_mm * facts.scene.gel.dot_radius_mm * self.radius_share;
        let levels = (shifted.levels + facts.levels_of_outlines(radius_px)).min(facts.contrast_levels());
        let px = if self.radius_share > 0.0 { shifted.px + 2.0 * facts.ellipse_px() } else { shifted.px };
        Bound { px, levels: levels.max(ink), ..shifted }
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        15.0 * facts.markers() + 2e3 * self.merged.len() as f64
    }

    fn sideways_mm(&self, _facts: &Facts<'_>) -> f64 {
        self.shift_mm
    }
}

/// The printed lattice, marker by marker.
#[derive(Clone, Debug)]
pub(crate) struct Print {
    /// Offset of each dot from its nominal place, along the lattice's rows and columns; empty without
    /// offsets.
    shift_mm: Vec<DVec2>,
    /// Each dot's radius over the nominal one.
    radius: Vec<f64>,
}

/// A bar of ink between two markers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bridge {
    markers: [usize; 2],
    /// Which of a dot's two half diameters crosses the bar: 1 for two markers of one row.
    crosswise: usize,
    share: f64,
}

impl Print {
    pub(crate) fn new(misprint: &Misprint, seed: u64, markers: usize) -> Self {
        let mut stream = Stream::new(Digest::new().u64(seed).value(), "misprint");
        let (mut shift_mm, mut radius) = (Vec::new(), Vec::new());
        for _ in 0..markers {
            let away = misprint.shift_mm * sqrt(stream.uniform());
            let angle = core::f64::consts::TAU * stream.uniform();
            if misprint.shift_mm > 0.0 {
                shift_mm.push(DVec2::new(cos(angle), sin(angle)) * away);
            }
            radius.push(1.0 + misprint.radius_share * (2.0 * stream.uniform() - 1.0));
        }
        Self { shift_mm, radius }
    }

    /// Offsets of the dots from their nominal places along the lattice's rows and columns; `None`
    /// without offsets.
    pub(crate) fn shift_mm(&self) -> Option<&[DVec2]> {
        (!self.shift_mm.is_empty()).then_some(&self.shift_mm)
    }

    /// A dot's radius over the nominal one.
    pub(crate) fn radius(&self, marker: usize) -> f64 {
        self.radius[marker]
    }
}

impl Bridge {
    pub(crate) fn all(misprint: &Misprint, cols: usize) -> Vec<Self> {
        let bridge = |&[row, col, other_row, other_col]: &[usize; 4]| Self {
            markers: [row * cols + col, other_row * cols + other_col],
            crosswise: usize::from(row == other_row),
            share: misprint.bridge_share,
        };
        misprint.merged.iter().map(bridge).collect()
    }

    pub(crate) fn joins(&self, marker: usize) -> bool {
        self.markers.contains(&marker)
    }

    /// Motion of the bar for these motions of its dots.
    pub(crate) fn way_px(&self, motion_px: &[DVec2]) -> DVec2 {
        let [a, b] = self.markers;
        0.5 * (motion_px[a] + motion_px[b])
    }

    /// The bar in the image.
    pub(crate) fn corners(&self, dots: &[DotImage]) -> [DVec2; 4] {
        let [(p, a), (q, b)] = self.markers.map(|marker| {
            let outline = dots[marker].outline;
            (outline.centre_px, outline.half_px[self.crosswise] * self.share)
        });
        [p - a, p + a, q + b, q - b]
    }
}
