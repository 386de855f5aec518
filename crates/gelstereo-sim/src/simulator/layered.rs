//! The gel as an elastic layer under a part.

use super::Simulator;
use crate::effects::{ElasticLayer, Grip};
use crate::layer::{self, LayerContact, Motion, Nodes, Places, Start};
use crate::scene::{Gel, SceneError};
use crate::simulator::ContactState;
use alloc::vec::Vec;
use gelstereo_core::math::DVec2;

/// An elastic layer and what its solves need.
#[derive(Clone, Debug)]
pub(super) struct Layered {
    contact: LayerContact,
    places: Places,
    nodes: Nodes,
    sticks: bool,
    /// Where the cells' gel would be if it stuck to the part, sensor x and y.
    at: Vec<DVec2>,
    heights: Vec<f64>,
    /// How far the part carries them, along the lattice's axes.
    carried: [Vec<f64>; 2],
    motion: Motion,
}

impl Layered {
    pub(super) fn new(effect: &ElasticLayer, gel: &Gel) -> Result<Self, SceneError> {
        let (layer, grid, places) = effect.cells(gel);
        let contact = LayerContact::new(layer, grid, effect.friction).map_err(SceneError::Layer)?;
        let nodes = Nodes::new(&contact, places);
        Ok(Self {
            contact,
            places,
            nodes,
            sticks: effect.friction > 0.0,
            at: Vec::new(),
            heights: Vec::new(),
            carried: Default::default(),
            motion: Motion::default(),
        })
    }

    /// Puts every cell where it is when it stands still or, with a grip, moves with the part.
    fn place(&mut self, middle_mm: DVec2, axes: [DVec2; 2], grip: Option<&Grip>) {
        let grid = self.contact.grid();
        let from_middle = |i: usize, n: usize| (i as f64 - 0.5 * (n as f64 - 1.0)) * grid.cell_mm;
        self.at.clear();
        self.carried.iter_mut().for_each(Vec::clear);
        for row in 0..grid.rows {
            let down = middle_mm + axes[1] * from_middle(row, grid.rows);
            for col in 0..grid.cols {
                let rest = down + axes[0] * from_middle(col, grid.cols);
                let carried = grip.map_or(DVec2::ZERO, |grip| grip.motion_mm(rest));
                self.at.push(rest + carried);
                for (axis, carried_mm) in axes.iter().zip(&mut self.carried) {
                    carried_mm.push(carried.dot(*axis));
                }
            }
        }
    }
}

impl Simulator {
    /// [`Self::press`] on the elastic layer.
    pub(super) fn press_layer(&mut self, contact: &ContactState) {
        let Some(mut layered) = self.layered.take() else { return };
        let grip = layered.sticks.then(|| self.grip(contact));
        layered.place(self.centre_mm, self.lattice.axes, grip.as_ref());
        self.heights(contact, &layered.at, &mut layered.heights);
        let Layered { contact: solver, heights, carried: [x, y], .. } = &mut *layered;
        let part = layer::Part { heights_mm: heights, carried_mm: grip.is_some().then_some([x, y]) };
        // Numbers of a valid scene are valid here; a solve that gives up leaves what it has.
        let _ = solver.press(part, ElasticLayer::TOLERANCE_MM, Start::Afresh);
        layered.nodes.motion(&layered.contact, &mut layered.motion);
        self.follow(&layered.motion);
        self.meet(contact, &layered);
        self.layered = Some(layered);
    }

    /// Moves markers as the surface does where they were printed.
    fn follow(&mut self, motion: &Motion) {
        let Self { scratch, lattice, print, .. } = self;
        let shift_mm = print.as_ref().and_then(|print| print.shift_mm());
        let at = |field: &[f64], marker: usize| {
            let beside = shift_mm.map_or(0.0, |shift_mm| {
                let shift = lattice.axes[0] * shift_mm[marker].x + lattice.axes[1] * shift_mm[marker].y;
                lattice.gradient(field, marker).dot(shift)
            });
            field[marker] + beside
        };
        for (marker, u) in scratch.motion.iter_mut().enumerate() {
            *u = lattice.axes[0] * at(&motion.aside[0], marker)
                + lattice.axes[1] * at(&motion.aside[1], marker);
        }
        scratch.heights.clear();
        scratch.heights.extend((0..motion.into.len()).map(|marker| at(&motion.into, marker)));
    }

    /// Markers that the part touches lie on it, where they are now; no other one lies within it.
    fn meet(&mut self, contact: &ContactState, layered: &Layered) {
        let Self { scratch, rest, .. } = self;
        scratch.places.clear();
        scratch.places.extend(rest.iter().zip(&scratch.motion).map(|(&rest, &u)| rest + u));
        self.touch(contact);
        let scratch = &mut self.scratch;
        scratch.stuck.clear();
        for (marker, (height, &obstacle)) in scratch.heights.iter_mut().zip(&scratch.obstacle).enumerate() {
            let pressed = layered.contact.pressure()[layered.places.cell(marker)] > 0.0;
            let touches = obstacle > *height || (pressed && obstacle > f64::NEG_INFINITY);
            if touches {
                *height = obstacle;
            }
            scratch.stuck.push(touches);
        }
    }
}
