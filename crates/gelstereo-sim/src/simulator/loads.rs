//! Tractions between part and gel.

use super::layered::Layered;
use super::{ContactState, Simulator, Truth};
use crate::scene::SceneError;
use alloc::vec::Vec;
use gelstereo_core::layer::N_PER_KPA_MM2;
use gelstereo_core::math::{DVec3, Pose, abs, sqrt};
use gelstereo_core::slip::Stick;

/// A cell slips if its traction is at least this fraction of Coulomb's bound. The last step of the solver
/// may end on a chord of the bound's circle: with 1 - 1e-9 whole slipping zones counted as stuck in single
/// frames of steady drags. With 1e-4, 1e-3 and 1e-2 less than 1, none did.
const SLIPS: f64 = 1.0 - 1e-3;

/// Largest depth of a press with a given force, in thicknesses of the gel.
const MAX_DEPTH: f64 = 0.8;
/// Relative error at which such a press has converged.
const CLOSE: f64 = 1e-4;
/// Halvings of the depth: 40 reach the rounding of a double.
const MAX_TRIALS: usize = 40;

/// Loads that the parts exert on the gel; known with `effects.elastic_layer`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Loads {
    /// Force, newtons along the sensor's axes.
    pub force_n: DVec3,
    /// Torque about [`Self::about_mm`], newton millimetres.
    pub torque_nmm: DVec3,
    /// Centroid of the markers at rest, sensor frame.
    pub about_mm: DVec3,
    /// What each part contributes, by its number.
    pub parts: Vec<PartLoads>,
    /// Mean traction over the rectangle of a pitch, or of a pitch by a row's distance, around each marker,
    /// kilopascals along the sensor's axes.
    pub traction_kpa: Vec<DVec3>,
    /// Whether the gel sticks to a part, at each marker's place; never unknown.
    pub stick: Vec<Stick>,
}

/// Loads of one part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PartLoads {
    /// As [`Loads::force_n`].
    pub force_n: DVec3,
    /// As [`Loads::torque_nmm`], about the same point.
    pub torque_nmm: DVec3,
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
    /// The pose moved along z until the indenter alone presses with this force, within 0.01 % and without
    /// sideways motion; `None` without an indenter or an elastic layer.
    ///
    /// # Errors
    /// [`SceneError::Invalid`] if the force is not above 0, is less than the layer's solver resolves, or
    /// needs more than 0.8 of the gel's thickness.
    pub fn pressed_with(&mut self, t_sensor_object: Pose, force_n: f64) -> Result<Option<Pose>, SceneError> {
        SceneError::check(force_n > 0.0 && force_n.is_finite(), "force_n", force_n, "above 0")?;
        if self.layered.is_none() || self.parts.len() == 0 {
            return Ok(None);
        }
        let mut truth = Truth::default();
        let mut excess_n = |simulator: &mut Self, depth_mm: f64| {
            let contact = simulator.pressed(t_sensor_object, depth_mm).map(ContactState::pressed);
            simulator.field_of(&[contact], 0, &mut truth);
            truth.loads.as_ref().map_or(0.0, |loads| -loads.force_n.z) - force_n
        };
        let (mut low, mut high) = (0.0, MAX_DEPTH * self.gel.thickness_mm);
        let deepest_n = excess_n(self, high);
        SceneError::check(deepest_n >= 0.0, "force_n", force_n, "less than that at 0.8 of the thickness")?;
        for _ in 0..MAX_TRIALS {
            let depth_mm = 0.5 * (low + high);
            let excess_n = excess_n(self, depth_mm);
            if abs(excess_n) <= CLOSE * force_n {
                return Ok(self.pressed(t_sensor_object, depth_mm));
            }
            *(if excess_n > 0.0 { &mut high } else { &mut low }) = depth_mm;
        }
        let valid = "one that the layer's solver resolves, which ends within 0.1 um of the part";
        Err(SceneError::Invalid { name: "force_n", found: force_n, valid })
    }

    /// Writes the loads of the present contact; returns whether the gel is a layer that has them.
    pub(super) fn write_loads(&self, out: &mut Loads) -> bool {
        let Some(layered) = &self.layered else { return false };
        let axes = self.lattice.axes.map(|axis| axis.extend(0.0));
        let grid = layered.contact.grid();
        let scale = layered.young_kpa * N_PER_KPA_MM2 * grid.cell_mm[0] * grid.cell_mm[1];
        let Self { lattice, rest, skin_mm, .. } = self;
        let places = lattice.of_markers(rest).zip(lattice.of_markers(skin_mm));
        let sum: DVec3 = places.map(|(rest, skin)| rest.extend(skin)).sum();
        out.about_mm = sum / lattice.markers() as f64;
        (out.force_n, out.torque_nmm) = (DVec3::ZERO, DVec3::ZERO);
        out.parts.clear();
        out.parts.resize(self.parts.len(), PartLoads::default());
        for (cell, (place, &part)) in layered.rest.iter().zip(&layered.obstacle.part).enumerate() {
            let force_n = layered.traction(cell, axes) * scale;
            let torque_nmm = (place.extend(layered.skin_mm[cell]) - out.about_mm).cross(force_n);
            out.force_n += force_n;
            out.torque_nmm += torque_nmm;
            if let Some(part) = out.parts.get_mut(usize::from(part)) {
                part.force_n += force_n;
                part.torque_nmm += torque_nmm;
            }
        }
        out.traction_kpa.clear();
        out.stick.clear();
        let [down, across] = layered.places.step;
        let steps = [down, across * lattice.apart];
        for marker in 0..lattice.markers() {
            let cell = layered.places.cell(lattice.node(marker));
            out.traction_kpa.push(mean_around(layered, cell, steps, axes) * layered.young_kpa);
            out.stick.push(layered.stick(cell));
        }
        true
    }
}

/// Mean traction over a marker's rectangle of so many cells around a cell; cells on its border count in part.
fn mean_around(layered: &Layered, cell: usize, steps: [usize; 2], axes: [DVec3; 2]) -> DVec3 {
    let grid = layered.contact.grid();
    let (row, col) = ((cell / grid.cols) as isize, (cell % grid.cols) as isize);
    // With an even step, the rectangle's border runs through the middle of cells.
    let weight = |d: isize, step: usize| {
        if step.is_multiple_of(2) && d.unsigned_abs() == step / 2 { 0.5 } else { 1.0 }
    };
    let [downs, rights] = steps.map(|step| -((step / 2) as isize)..=(step / 2) as isize);
    let mut sum = DVec3::ZERO;
    for (down, right) in downs.flat_map(|down| rights.clone().map(move |right| (down, right))) {
        let (row, col) = (row + down, col + right);
        if (0..grid.rows as isize).contains(&row) && (0..grid.cols as isize).contains(&col) {
            let other = row as usize * grid.cols + col as usize;
            sum += layered.traction(other, axes) * (weight(down, steps[0]) * weight(right, steps[1]));
        }
    }
    sum / (steps[0] * steps[1]) as f64
}
