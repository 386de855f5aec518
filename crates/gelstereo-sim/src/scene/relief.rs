//! Curved gels.

use super::error::SceneError;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, cos, sin, sqrt};

/// Shape of the unloaded skin, instead of the plane z = `surface_mm`. It is given in the lattice's frame: x
/// along the rows and y along the columns, from the lattice's centre.
///
/// The gel stays a layer of equal thickness: skin and plate are parallel, and the layer's flat solution is
/// applied to the gap between part and skin along z. Where the skin has a slope s, this neglects s² / 2 of
/// lengths along the skin and of the gap, 8 % at the steepest slope that is valid, 0.4. Tractions and dots
/// lie in planes across z.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)
)]
pub enum Relief {
    /// Part of a ball, with its top at the lattice's centre.
    Dome {
        /// Radius; negative for a hollow. Valid: 1 to 1000000 mm either way, and no slope above 0.4. Change
        /// it to the gel's.
        radius_mm: f64,
    },
    /// Part of a cylinder, with its top along a line through the lattice's centre.
    Cylinder {
        /// Radius; negative for a hollow. Valid: 1 to 1000000 mm either way, and no slope above 0.4. Change
        /// it to the gel's.
        radius_mm: f64,
        /// Direction of that line, from x towards y. Valid: -7 to 7 rad. Change it to the gel's.
        #[cfg_attr(feature = "serde", serde(default))]
        axis_rad: f64,
    },
    /// A map of heights, linear between them, and constant beyond.
    Heights {
        /// Sides of the map along x and y, centred. Valid: 0.001 to 10000 mm. Change it to the gel's.
        size_mm: [f64; 2],
        /// Heights of the skin above the plane, towards the parts: rows along x, from the smallest y. Valid:
        /// -100 to 100 mm, and no slope above 0.4. Change it to the gel's.
        heights_mm: Vec<Vec<f64>>,
    },
}

/// A dome of this slope at its border is 7 % of its radius high.
const MAX_SLOPE: f64 = 0.4;

impl Relief {
    /// Height of the skin above the plane, towards the parts.
    pub(crate) fn height_mm(&self, at: DVec2) -> f64 {
        match self {
            Self::Dome { radius_mm } => sagged(*radius_mm, at.length_squared()),
            Self::Cylinder { radius_mm, axis_rad } => {
                let across = at.y * cos(*axis_rad) - at.x * sin(*axis_rad);
                sagged(*radius_mm, across * across)
            }
            Self::Heights { size_mm, heights_mm } => {
                let [(left, right, x), (up, down, y)] =
                    [(at.x, size_mm[0], heights_mm[0].len()), (at.y, size_mm[1], heights_mm.len())]
                        .map(|(at, size, count)| between(at / size + 0.5, count));
                let row = |row: usize| mix(heights_mm[row][left], heights_mm[row][right], x);
                mix(row(up), row(down), y)
            }
        }
    }

    /// Lowest and highest of all heights within a distance of the centre.
    pub(crate) fn range_mm(&self, reach_mm: f64) -> [f64; 2] {
        match self {
            Self::Dome { radius_mm } | Self::Cylinder { radius_mm, .. } => {
                let rim_mm = sagged(*radius_mm, reach_mm * reach_mm);
                [rim_mm.min(0.0), rim_mm.max(0.0)]
            }
            Self::Heights { heights_mm, .. } => heights_mm
                .iter()
                .flatten()
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &h| [low.min(h), high.max(h)]),
        }
    }

    /// Steepest slope within a distance of the centre.
    pub(crate) fn steepest(&self, reach_mm: f64) -> f64 {
        match self {
            Self::Dome { radius_mm } | Self::Cylinder { radius_mm, .. } => {
                let height2 = radius_mm * radius_mm - reach_mm * reach_mm;
                if height2 > 0.0 { reach_mm / sqrt(height2) } else { f64::INFINITY }
            }
            Self::Heights { size_mm, heights_mm } => {
                let (cols, rows) = (heights_mm[0].len(), heights_mm.len());
                let per_mm = [(cols - 1) as f64 / size_mm[0], (rows - 1) as f64 / size_mm[1]];
                let along = heights_mm.iter().flat_map(|row| row.windows(2).map(|pair| pair[1] - pair[0]));
                let down =
                    heights_mm.windows(2).flat_map(|pair| pair[1].iter().zip(&pair[0]).map(|(b, a)| b - a));
                let most = |steps: &mut dyn Iterator<Item = f64>| {
                    steps.fold(0.0_f64, |most, step| most.max(step.abs()))
                };
                // Within a cell, each of both slopes lies between those along its sides.
                let slopes = [most(&mut { along }) * per_mm[0], most(&mut { down }) * per_mm[1]];
                DVec2::from_array(slopes).length()
            }
        }
    }

    /// `reach_mm` is the largest distance of a marker or a cell from the centre.
    pub(super) fn validate(&self, reach_mm: f64) -> Result<(), SceneError> {
        let check = SceneError::check;
        match self {
            Self::Dome { radius_mm } | Self::Cylinder { radius_mm, .. } => {
                let ok = (1.0..=1e6).contains(&radius_mm.abs());
                check(ok, "gel.relief.radius_mm", *radius_mm, "1 to 1000000 mm, negative for a hollow")?;
            }
            Self::Heights { size_mm, heights_mm } => {
                for &size in size_mm {
                    check((1e-3..=1e4).contains(&size), "gel.relief.size_mm", size, "0.001 to 10000 mm")?;
                }
                let (rows, cols) = (heights_mm.len(), heights_mm.first().map_or(0, Vec::len));
                for (name, count) in
                    [("rows of gel.relief.heights_mm", rows), ("columns of gel.relief.heights_mm", cols)]
                {
                    check((2..=1000).contains(&count), name, count as f64, "2 to 1000")?;
                }
                for row in heights_mm {
                    let name = "length of a row of gel.relief.heights_mm";
                    check(row.len() == cols, name, row.len() as f64, "that of the first")?;
                    for &height in row {
                        check(height.abs() <= 100.0, "gel.relief.heights_mm", height, "-100 to 100 mm")?;
                    }
                }
            }
        }
        if let Self::Cylinder { axis_rad, .. } = self {
            check(axis_rad.abs() <= 7.0, "gel.relief.axis_rad", *axis_rad, "-7 to 7 rad")?;
        }
        let valid =
            "0 to 0.4: the gel is solved as a flat layer; choose a larger radius or a smaller lattice";
        let slope = self.steepest(reach_mm);
        check(slope <= MAX_SLOPE, "steepest slope of gel.relief", slope, valid)
    }
}

/// Height of a ball's surface beside its top, for a squared distance from the axis.
fn sagged(radius_mm: f64, square_mm2: f64) -> f64 {
    let root = sqrt((radius_mm * radius_mm - square_mm2).max(0.0));
    -square_mm2 / (radius_mm.abs() + root) * radius_mm.signum()
}

/// Neighbours of a place from 0 to 1 among a number of nodes, and its share of the way between them.
fn between(share: f64, count: usize) -> (usize, usize, f64) {
    let nodes = share.clamp(0.0, 1.0) * (count - 1) as f64;
    let before = (nodes as usize).min(count - 2);
    (before, before + 1, nodes - before as f64)
}

fn mix(a: f64, b: f64, share: f64) -> f64 {
    a + (b - a) * share
}
