//! Flat layers between a camera and the markers: air, glass, gel.

use crate::math::DVec3;
use alloc::vec::Vec;

/// One flat layer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct Layer {
    /// Thickness, millimetres.
    pub thickness_mm: f64,
    /// Refractive index against air.
    pub index: f64,
}

/// A stack of flat, parallel layers in the sensor frame. The cameras are in air; the markers lie in the
/// last medium, which is unbounded.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct Layers {
    /// Unit normal of all interfaces, away from the cameras (sensor frame).
    pub normal: DVec3,
    /// Distance from the left camera's centre of projection to the first interface, along the normal,
    /// millimetres.
    pub gap_mm: f64,
    /// Layers between the first interface and the gel, starting from the cameras.
    pub plates: Vec<Layer>,
    /// Refractive index of the gel, in which the markers lie.
    pub gel_index: f64,
}

/// An invalid number in a layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayersError {
    /// Which field.
    pub field: &'static str,
    /// What was found.
    pub found: f64,
    /// What would be valid.
    pub valid: &'static str,
}

impl core::fmt::Display for LayersError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "layers.{} is {}; valid is {}", self.field, self.found, self.valid)
    }
}

impl core::error::Error for LayersError {}

/// Larger than any sensor: ten metres.
const FAR_MM: f64 = 1e4;

impl Layers {
    /// Checks that the numbers describe valid layers.
    ///
    /// # Errors
    /// [`LayersError`] naming the field.
    pub fn validate(&self) -> Result<(), LayersError> {
        let check = |ok: bool, field, found, valid| {
            if ok { Ok(()) } else { Err(LayersError { field, found, valid }) }
        };
        let length = self.normal.length();
        check((length - 1.0).abs() < 1e-9, "normal's length", length, "1 within 1e-9")?;
        check(self.normal.z > 0.0, "normal.z", self.normal.z, "above 0: away from the cameras")?;
        let gap = self.gap_mm;
        check((0.0..=FAR_MM).contains(&gap), "gap_mm", gap, "0 to 10000 mm")?;
        for plate in &self.plates {
            let thickness = plate.thickness_mm;
            let ok = (0.0..=FAR_MM).contains(&thickness);
            check(ok, "plates.thickness_mm", thickness, "0 to 10000 mm")?;
        }
        for index in self.plates.iter().map(|plate| plate.index).chain([self.gel_index]) {
            check((1.0..=4.0).contains(&index), "index", index, "1 to 4")?;
        }
        Ok(())
    }
}
