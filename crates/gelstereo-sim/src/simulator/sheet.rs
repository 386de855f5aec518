//! The printed sheet without contact.

use super::Simulator;
use crate::lattice::Lattice;
use gelstereo_core::math::{DVec2, cos, sin};

impl Simulator {
    /// Moves lattice and rest positions to the gel's place at that time.
    pub(super) fn settle(&mut self, time_s: f64) {
        if let Some(moved) = self.trajectory.gel_at(time_s) {
            let home = Lattice::new(&self.gel);
            let (s, c) = (sin(moved.rotation_rad), cos(moved.rotation_rad));
            self.lattice.axes = home.axes.map(|axis| axis * c + axis.perp() * s);
            self.lay(DVec2::from_array(self.gel.centre_mm) + DVec2::from_array(moved.shift_mm));
        }
    }

    /// Sets the rest positions of all markers of a lattice centred at `centre_mm`.
    pub(super) fn lay(&mut self, centre_mm: DVec2) {
        self.centre_mm = centre_mm;
        let Self { lattice, rest, print, .. } = self;
        rest.clear();
        rest.extend(lattice.rest_mm(centre_mm));
        if let Some(shift_mm) = print.as_ref().and_then(|print| print.shift_mm()) {
            for (place, shift) in rest.iter_mut().zip(shift_mm) {
                *place += lattice.axes[0] * shift.x + lattice.axes[1] * shift.y;
            }
        }
    }
}
