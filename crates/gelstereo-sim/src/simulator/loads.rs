//! Tractions between part and gel.

use super::Simulator;
use super::layered::Layered;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec3, sqrt};

/// Newtons of a kilopascal on a square millimetre.
const N_PER_KPA_MM2: f64 = 1e-3;
/// A cell slips if its traction is at least this fraction of Coulomb's bound. The solver ends within 0.1 um
/// of the part, and slipping cells lie at the bound up to rounding.
const SLIPS: f64 = 1.0 - 1e-9;

/// Whether the gel around a marker moves with the part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Stick {
    /// The part does not press here.
    #[default]
    Free = 0,
    /// It moves with the part.
    Stuck = 1,
    /// It slips along the part.
    Slips = 2,
}

impl Stick {
    /// All values with their names.
    pub const ALL: [(&'static str, Self); 3] =
        [("FREE", Self::Free), ("STUCK", Self::Stuck), ("SLIPS", Self::Slips)];
}

/// Loads that the part exerts on the gel; known with `effects.elastic_layer`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Loads {
    /// Force, newtons along the sensor's axes.
    pub force_n: DVec3,
    /// Torque about [`Self::about_mm`], newton millimetres.
    pub torque_nmm: DVec3,
    /// Centroid of the markers at rest, sensor frame.
    pub about_mm: DVec3,
    /// Mean traction over the square around each marker, kilopascals along the sensor's axes.
    pub traction_kpa: Vec<DVec3>,
    /// Whether the gel sticks to the part, at each marker's place.
    pub stick: Vec<Stick>,
}

impl Layered {
    /// Traction of a cell in the sensor frame, in units of Young's modulus.
    fn traction(&self, cell: usize, axes: [DVec3; 2]) -> DVec3 {
        let (p, [x, y]) = (self.contact.pressure()[cell], self.contact.traction());
        axes[0] * x[cell] + axes[1] * y[cell] - DVec3::Z * p
    }

    fn stick(&self, cell: usize) -> Stick {
        let (p, [x, y]) = (self.contact.pressure()[cell], self.contact.traction());
        let shear = sqrt(x[cell] * x[cell] + y[cell] * y[cell]);
        if p == 0.0 {
            Stick::Free
        } else if shear >= SLIPS * self.friction * p {
            Stick::Slips
        } else {
            Stick::Stuck
        }
    }
}

impl Simulator {
    /// Writes the loads of the present contact; returns whether the gel is a layer that has them.
    pub(super) fn write_loads(&self, out: &mut Loads) -> bool {
        let Some(layered) = &self.layered else { return false };
        let axes = self.lattice.axes.map(|axis| axis.extend(0.0));
        let grid = layered.contact.grid();
        let scale = layered.young_kpa * N_PER_KPA_MM2 * grid.cell_mm * grid.cell_mm;
        let sum: DVec3 = self.rest.iter().map(|rest| rest.extend(self.surface_mm)).sum();
        out.about_mm = sum / self.rest.len() as f64;
        (out.force_n, out.torque_nmm) = (DVec3::ZERO, DVec3::ZERO);
        for (cell, place) in layered.rest.iter().enumerate() {
            let force_n = layered.traction(cell, axes) * scale;
            out.force_n += force_n;
            out.torque_nmm += (place.extend(self.surface_mm) - out.about_mm).cross(force_n);
        }
        out.traction_kpa.clear();
        out.stick.clear();
        for marker in 0..self.rest.len() {
            let cell = layered.places.cell(marker);
            out.traction_kpa.push(mean_around(layered, cell, axes) * layered.young_kpa);
            out.stick.push(layered.stick(cell));
        }
        true
    }
}

/// Mean traction over the square of a marker's pitch around a cell; cells on its border count in part.
fn mean_around(layered: &Layered, cell: usize, axes: [DVec3; 2]) -> DVec3 {
    let (grid, step) = (layered.contact.grid(), layered.places.step);
    let half = step / 2;
    let (row, col) = ((cell / grid.cols) as isize, (cell % grid.cols) as isize);
    // With an even step, the square's border runs through the middle of cells.
    let weight = |d: isize| if step.is_multiple_of(2) && d.unsigned_abs() == half { 0.5 } else { 1.0 };
    let range = || -(half as isize)..=half as isize;
    let mut sum = DVec3::ZERO;
    for (down, right) in range().flat_map(|down| range().map(move |right| (down, right))) {
        let (row, col) = (row + down, col + right);
        if (0..grid.rows as isize).contains(&row) && (0..grid.cols as isize).contains(&col) {
            let other = row as usize * grid.cols + col as usize;
            sum += layered.traction(other, axes) * (weight(down) * weight(right));
        }
    }
    sum / (step * step) as f64
}
