//! Contacts with a history: the gel drags, sticks and slips along the part's path.
//!
//! A cell in contact is asked to follow the part's motion since the last step, from where it was, within
//! Coulomb's bound of the present pressure (implicit steps of Coulomb's law; Kalker 1990, section 1.3).

use super::Simulator;
use super::layered::Layered;
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

/// Where the parts and the cells were after the last step.
#[derive(Clone, Debug, Default)]
pub(super) struct History {
    /// Paths of the parts; the last pose of each is `None` before it touches.
    paths: Vec<Path>,
    touching: Vec<bool>,
    /// The part that each cell is under.
    part: Vec<u8>,
    /// Motion of every cell: into the layer, and along the lattice's axes.
    into: Vec<f64>,
    aside: [Vec<f64>; 2],
}

/// Shortest path of a part from its last pose to the next.
#[derive(Clone, Copy, Debug)]
struct Path {
    from: Option<Pose>,
    to: Option<Pose>,
    /// Twist of the whole path.
    omega: DVec3,
    v_mm: DVec3,
    /// Where it is on the path, and its motion since the last step.
    now: Option<Pose>,
    motion: Pose,
}

impl Path {
    /// Of a part that has not touched.
    const NONE: Self = Self {
        from: None,
        to: None,
        omega: DVec3::ZERO,
        v_mm: DVec3::ZERO,
        now: None,
        motion: Pose::IDENTITY,
    };

    /// Begins a path from the end of this one.
    fn begin(&mut self, to: Option<Pose>) {
        let from = self.now.or(to);
        let (omega, v_mm) = match (from, to) {
            (Some(from), Some(to)) if self.now.is_some() => (from.inverse() * to).log(),
            _ => (DVec3::ZERO, DVec3::ZERO),
        };
        *self = Self { from, to, omega, v_mm, now: self.now, motion: Pose::IDENTITY };
    }

    /// Motion from the beginning to the end.
    fn whole(&self) -> Pose {
        match (self.now, self.to) {
            (Some(from), Some(to)) => to * from.inverse(),
            _ => Pose::IDENTITY,
        }
    }

    /// Goes on to a share of the path.
    fn go(&mut self, share: f64) {
        let Self { from, omega, v_mm, .. } = *self;
        let along = |from: Pose| from * Pose::exp(omega * share, v_mm * share);
        let next = if share < 1.0 { self.to.and(from).map(along) } else { self.to };
        self.motion = match (self.now, next) {
            (Some(before), Some(next)) => next * before.inverse(),
            _ => Pose::IDENTITY,
        };
        self.now = next;
    }
}

impl Simulator {
    /// Moves the indenter to a pose along the shortest path from the last call, and gives the markers there.
    /// The other parts move to where their trajectories have them at the frame. Cells in contact are dragged
    /// along, and slip where friction does not hold them: the result depends on all calls since a part was
    /// last taken away, by `None`. The first pose after that is pressed in without sideways motion. Steps
    /// are at most 0.05 mm long, or more on a path of more than 256 of them. `frame` sets the time of gel
    /// motion and smears; nothing is blurred by motion.
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
        self.pose(contact.as_ref(), frame);
        self.posed_advance(frame, out)
    }

    /// [`Self::advance`] of every part to a pose, by its number; those that are missing are taken away.
    ///
    /// # Errors
    /// As [`Self::advance`].
    pub fn advance_of(
        &mut self,
        t_sensor_objects: &[Option<Pose>],
        frame: u64,
        out: &mut Truth,
    ) -> Result<(), SceneError> {
        let contacts: Vec<_> = t_sensor_objects.iter().map(|pose| pose.map(ContactState::pressed)).collect();
        contacts.iter().flatten().try_for_each(ContactState::validate)?;
        self.pose_all(&contacts);
        self.posed_advance(frame, out)
    }

    fn posed_advance(&mut self, frame: u64, out: &mut Truth) -> Result<(), SceneError> {
        let mut layered = match self.layered.take() {
            Some(layered) if !layered.has_memory() => layered,
            layered => {
                self.layered = layered;
                return Err(SceneError::NeedsHistory);
            }
        };
        self.settle(self.time_s(frame));
        let contacts = core::mem::take(&mut self.scratch.contacts);
        self.travel(&mut layered, &contacts);
        layered.forget_solved();
        self.scratch.motion.clear();
        self.scratch.motion.resize(self.rest.len(), DVec2::ZERO);
        layered.move_markers();
        self.follow(&layered.motion);
        self.meet(&contacts, &layered);
        (self.scratch.contacts, self.layered) = (contacts, Some(layered));
        self.write_field(out);
        out.forget_views();
        Ok(())
    }

    /// Takes all steps to these poses.
    fn travel(&mut self, layered: &mut Layered, contacts: &[Option<ContactState>]) {
        let cells = layered.contact.pressure().len();
        let history = &mut layered.history;
        history.paths.resize(contacts.len(), Path::NONE);
        if history.paths.iter().all(|path| path.now.is_none()) {
            history.begin(cells);
        }
        for (path, contact) in history.paths.iter_mut().zip(contacts) {
            path.begin(contact.map(|contact| contact.t_sensor_object));
        }
        if contacts.iter().all(Option::is_none) {
            history.paths.iter_mut().for_each(|path| path.go(1.0));
            return layered.contact.release();
        }
        layered.lay(self.centre_mm, self.lattice.axes);
        let longest_mm = self.longest_mm(layered, contacts);
        let steps = ceil(longest_mm / MAX_STEP_MM).clamp(1.0, MAX_STEPS);
        for step in 1..=steps as u32 {
            layered.history.paths.iter_mut().for_each(|path| path.go(f64::from(step) / steps));
            self.step(layered);
        }
    }

    /// Largest motion of a part at a cell that it touches now or then.
    fn longest_mm(&mut self, layered: &mut Layered, contacts: &[Option<ContactState>]) -> f64 {
        let mut whole = core::mem::take(&mut self.scratch.motions);
        whole.clear();
        whole.extend(layered.history.paths.iter().map(Path::whole));
        self.find(layered, contacts, &whole);
        let Layered { history, obstacle, rest, skin_mm, .. } = layered;
        let mut longest_mm = 0.0_f64;
        for (cell, &rest) in rest.iter().enumerate() {
            let point = rest.extend(skin_mm[cell] - history.into[cell]);
            let then = (obstacle.heights[cell] > 0.0).then_some(obstacle.part[cell]);
            let now = history.touching[cell].then_some(history.part[cell]);
            for part in then.into_iter().chain(now) {
                let moved_mm = (whole[usize::from(part)].transform_point(point) - point).length();
                longest_mm = longest_mm.max(moved_mm);
            }
        }
        self.scratch.motions = whole;
        longest_mm
    }

    /// Finds the parts over the cells, each moved by the part that it touched in the last step.
    fn find(&mut self, layered: &mut Layered, contacts: &[Option<ContactState>], motions: &[Pose]) {
        let axes = self.lattice.axes;
        let Layered { history, obstacle, rest, skin_mm, .. } = layered;
        let place = |_: usize, cell: usize| {
            let (here, point) = history.here(cell, rest[cell].extend(skin_mm[cell]), axes);
            let moved = |part: u8| (motions[usize::from(part)].transform_point(point) - point).truncate();
            // Gel that no part touches stays.
            if history.touching[cell] { here + moved(history.part[cell]) } else { here }
        };
        self.parts.highest(contacts, (skin_mm, place), obstacle);
    }

    /// Solves the contact with the parts where they are on their paths: every cell is asked to follow its
    /// part from where it is.
    fn step(&mut self, layered: &mut Layered) {
        let mut contacts = core::mem::take(&mut self.scratch.meanwhile);
        let mut motions = core::mem::take(&mut self.scratch.motions);
        contacts.clear();
        contacts.extend(layered.history.paths.iter().map(|path| path.now.map(ContactState::pressed)));
        motions.clear();
        motions.extend(layered.history.paths.iter().map(|path| path.motion));
        self.find(layered, &contacts, &motions);
        let (axes, skin_mm) = (self.lattice.axes, layered.skin_mm.clone());
        let (history, rest) = (core::mem::take(&mut layered.history), core::mem::take(&mut layered.rest));
        let carried = |part: usize, cell: usize| {
            let (_, point) = history.here(cell, rest[cell].extend(skin_mm[cell]), axes);
            let moved = (motions[part].transform_point(point) - point).truncate();
            [0, 1].map(|axis| history.aside[axis][cell] + moved.dot(axes[axis]))
        };
        // Other contacts may have been solved since the last step.
        layered.forget_sides();
        layered.solve(Start::Afresh, carried);
        layered.meet_sides(carried);
        self.meet_displaced(layered, &contacts, (ROUNDS, &rest), carried);
        (layered.history, layered.rest) = (history, rest);
        (self.scratch.meanwhile, self.scratch.motions) = (contacts, motions);
        layered.remember_step();
    }
}

impl History {
    fn begin(&mut self, cells: usize) {
        self.touching.clear();
        self.touching.resize(cells, false);
        self.part.clear();
        self.part.resize(cells, 0);
        let [x, y] = &mut self.aside;
        for field in [&mut self.into, x, y] {
            field.clear();
            field.resize(cells, 0.0);
        }
    }

    /// Where a cell is in the plane and in space.
    fn here(&self, cell: usize, rest: DVec3, axes: [DVec2; 2]) -> (DVec2, DVec3) {
        let here = rest.truncate() + axes[0] * self.aside[0][cell] + axes[1] * self.aside[1][cell];
        (here, here.extend(rest.z - self.into[cell]))
    }
}

impl Layered {
    fn remember_step(&mut self) {
        let History { touching, part, into, aside, .. } = &mut self.history;
        touching.clear();
        touching.extend(self.contact.pressure().iter().map(|&p| p > 0.0));
        part.clone_from(&self.obstacle.part);
        self.contact.surface_mm(into, aside);
        let [x, y] = aside;
        for (field, own) in [into, x, y].into_iter().zip(&self.beside) {
            field.iter_mut().zip(own).for_each(|(u, own)| *u += own);
        }
    }
}
