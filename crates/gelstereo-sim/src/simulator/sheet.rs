//! The printed sheet without contact.

use super::Simulator;
use crate::lattice::Lattice;
use crate::scene::Gel;
use alloc::vec::Vec;
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

    /// Sets the depth of the skin at every node, under a marker at its printed place: the relief moves with
    /// the lattice.
    pub(super) fn curve(&mut self) {
        let Self { lattice, gel, print, .. } = self;
        let shift_mm = print.as_ref().and_then(|print| print.shift_mm());
        let at = |node: usize| {
            let shift_mm = shift_mm.zip(lattice.marker_on(node));
            let shift_mm = shift_mm.map_or(DVec2::ZERO, |(shift_mm, marker)| shift_mm[marker]);
            lattice.printed_mm(node / lattice.cols, node % lattice.cols) + shift_mm
        };
        self.skin_mm = skin_mm(gel, (0..lattice.nodes()).map(at));
    }

    /// Sets the rest positions of all nodes of a lattice centred at `centre_mm`.
    pub(super) fn lay(&mut self, centre_mm: DVec2) {
        self.centre_mm = centre_mm;
        let Self { lattice, rest, print, .. } = self;
        rest.clear();
        rest.extend(lattice.rest_mm(centre_mm));
        if let Some(shift_mm) = print.as_ref().and_then(|print| print.shift_mm()) {
            for (marker, shift) in shift_mm.iter().enumerate() {
                rest[lattice.node(marker)] += lattice.axes[0] * shift.x + lattice.axes[1] * shift.y;
            }
        }
    }
}

/// Depth of the skin at rest, at places in the lattice's frame.
pub(super) fn skin_mm(gel: &Gel, places: impl Iterator<Item = DVec2>) -> Vec<f64> {
    let above = |at: DVec2| gel.relief.as_ref().map_or(0.0, |relief| relief.height_mm(at));
    places.map(|at| gel.surface_mm + above(at)).collect()
}
