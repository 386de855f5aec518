//! Contacts with a history: the gel drags, sticks and slips along the part's path.
//!
//! A cell in contact is asked to follow the part's motion since the last step, from where it was, within
//! Coulomb's bound of the present pressure (implicit steps of Coulomb's law; Kalker 1990, section 1.3).

use super::Simulator;
use super::layered::Layered;
use crate::effects::ElasticLayer;
use crate::layer::Start;
use crate::scene::SceneError;
use crate::simulator::{ContactState, Truth};
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, DVec3, Pose, ceil};

/// Largest motion of the part along or into the gel within one step. With 0.01, 0.02, 0.05 and 0.1 mm, shear
/// forces of a ball that is dragged there and back differ by less than 0.2 % of the largest.
const MAX_STEP_MM: f64 = 0.05;
/// Steps of one call; beyond, they become longer.
const MAX_STEPS: f64 = 256.0;
/// Corrections for cells that have moved to another place under the part. With 0, 1 and 2, these forces
/// differ by at most 0.5, 0.2 and 0.04 % of the largest from those with 4.
const ROUNDS: usize = 2;

/// Where the part and the cells were after the last step.
#[derive(Clone, Debug, Default)]
pub(super) struct History {
    /// `None` before the first contact.
    t_sensor_object: Option<Pose>,
    touching: Vec<bool>,
    /// Motion of every cell: into the layer, and along the lattice's axes.
    into: Vec<f64>,
    aside: [Vec<f64>; 2],
}

impl Simulator {
    /// Moves the part to a pose along the shortest path from the last call, and gives the markers there.
    /// Cells in contact are dragged along, and slip where friction does not hold them: the result depends on
    /// all calls since the part was last taken away, by `None`. The first pose after that is pressed in
    /// without sideways motion. Steps are at most 0.05 mm long, or more on a path of more than 256 of them.
    /// `frame` sets the time of gel motion and smears; nothing is blurred by motion.
    ///
    /// # Errors
    /// [`SceneError::NeedsHistory`] unless the scene has `elastic_layer` and no `relaxation`;
    /// [`SceneError::Invalid`] for a pose that is no contact.
    pub fn advance(
        &mut self,
        t_sensor_object: Option<Pose>,
        frame: u64,
        out: &mut Truth,
    ) -> Result<(), SceneError> {
        let contact = t_sensor_object.map(ContactState::pressed);
        contact.as_ref().map_or(Ok(()), ContactState::validate)?;
        let mut layered = match self.layered.take() {
            Some(layered) if !layered.has_memory() => layered,
            layered => {
                self.layered = layered;
                return Err(SceneError::NeedsHistory);
            }
        };
        self.settle(self.time_s(frame));
        match &contact {
            Some(contact) if self.part.is_some() => self.travel(&mut layered, contact.t_sensor_object),
            _ => {
                layered.contact.release();
                layered.history.t_sensor_object = None;
            }
        }
        layered.forget_solved();
        self.scratch.motion.clear();
        self.scratch.motion.resize(self.rest.len(), DVec2::ZERO);
        layered.nodes.motion(&layered.contact, &mut layered.motion);
        self.follow(&layered.motion);
        self.meet(contact.as_ref().filter(|_| self.part.is_some()), &layered);
        self.layered = Some(layered);
        self.write_field(out);
        out.forget_views();
        Ok(())
    }

    /// Takes all steps to a pose.
    fn travel(&mut self, layered: &mut Layered, to: Pose) {
        let Some(from) = layered.history.t_sensor_object else {
            layered.history.begin(layered.cells());
            layered.place(self.centre_mm, self.lattice.axes, None);
            return self.step(layered, to);
        };
        let (omega, v_mm) = (from.inverse() * to).log();
        let longest_mm = self.longest_mm(layered, &(to * from.inverse()), &to);
        let steps = ceil(longest_mm / MAX_STEP_MM).clamp(1.0, MAX_STEPS);
        let mut before = from;
        for step in 1..=steps as u32 {
            let share = f64::from(step) / steps;
            let next = if share < 1.0 { from * Pose::exp(omega * share, v_mm * share) } else { to };
            layered.carry(self.centre_mm, self.lattice.axes, self.surface_mm, &(next * before.inverse()));
            self.step(layered, next);
            before = next;
        }
    }

    /// Largest motion of the part at a cell that it touches now or then.
    fn longest_mm(&mut self, layered: &mut Layered, motion: &Pose, to: &Pose) -> f64 {
        layered.carry(self.centre_mm, self.lattice.axes, self.surface_mm, motion);
        self.heights(&ContactState::pressed(*to), &layered.at, &mut layered.heights);
        let mut longest_mm = 0.0_f64;
        for (cell, (&height, rest)) in layered.heights.iter().zip(&layered.rest).enumerate() {
            if height > 0.0 || layered.history.touching[cell] {
                let point = rest.extend(self.surface_mm - layered.history.into[cell]);
                longest_mm = longest_mm.max((motion.transform_point(point) - point).length());
            }
        }
        longest_mm
    }

    /// Solves the contact at a pose, with the cells asked to where they were carried.
    fn step(&mut self, layered: &mut Layered, pose: Pose) {
        let contact = ContactState::pressed(pose);
        self.heights(&contact, &layered.at, &mut layered.heights);
        // Other contacts may have been solved since the last step.
        layered.solve(Start::Afresh);
        for _round in 0..ROUNDS {
            if layered.replace(self.lattice.axes) <= ElasticLayer::TOLERANCE_MM {
                break;
            }
            self.heights(&contact, &layered.at, &mut layered.heights);
            layered.solve(Start::Last);
        }
        layered.remember_step(pose);
    }
}

impl History {
    fn begin(&mut self, cells: usize) {
        self.touching.clear();
        self.touching.resize(cells, false);
        let [x, y] = &mut self.aside;
        for field in [&mut self.into, x, y] {
            field.clear();
            field.resize(cells, 0.0);
        }
    }
}

impl Layered {
    fn cells(&self) -> usize {
        self.contact.pressure().len()
    }

    /// Asks every cell to follow a motion of the part from where it is.
    fn carry(&mut self, middle_mm: DVec2, axes: [DVec2; 2], surface_mm: f64, motion: &Pose) {
        self.place(middle_mm, axes, None);
        let Self { history, rest, at, carried, .. } = self;
        for (cell, (at, rest)) in at.iter_mut().zip(rest).enumerate() {
            let [along, across] = [history.aside[0][cell], history.aside[1][cell]];
            let here = *rest + axes[0] * along + axes[1] * across;
            let point: DVec3 = here.extend(surface_mm - history.into[cell]);
            let moved = (motion.transform_point(point) - point).truncate();
            carried[0][cell] = along + moved.dot(axes[0]);
            carried[1][cell] = across + moved.dot(axes[1]);
            // Gel that the part does not touch stays.
            *at = if history.touching[cell] { here + moved } else { here };
        }
    }

    fn remember_step(&mut self, pose: Pose) {
        let History { t_sensor_object, touching, into, aside } = &mut self.history;
        *t_sensor_object = Some(pose);
        touching.clear();
        touching.extend(self.contact.pressure().iter().map(|&p| p > 0.0));
        self.contact.surface_mm(into, aside);
    }
}
