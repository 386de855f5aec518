//! The gel as an elastic layer under the parts.

use super::Simulator;
use super::history::History;
use super::parts::Highest;
use super::press::carried_mm;
use super::sheet::skin_mm;
use crate::effects::ElasticLayer;
use crate::lattice;
use crate::layer::{self, Grid, LayerContact, Memory, Motion, Nodes, Places, Sides, Start};
use crate::scene::{Scene, SceneError};
use crate::simulator::ContactState;
use alloc::sync::Arc;
use alloc::vec::Vec;
use gelstereo_core::math::DVec2;

/// Most solves with the motion by the sides. Each changes it by a tenth to a third of the last change.
const SIDE_ROUNDS: usize = 6;

/// An elastic layer and the buffers of its solves.
#[derive(Clone, Debug)]
pub(super) struct Layered {
    pub(super) contact: LayerContact,
    pub(super) places: Places,
    pub(super) young_kpa: f64,
    pub(super) friction: f64,
    pub(super) nodes: Arc<Nodes>,
    sticks: bool,
    /// Further solves with the cells at their displaced places.
    rounds: usize,
    memory: Option<Memory>,
    rim_mm: Option<f64>,
    sides: Option<Sides>,
    /// Motion of the cells in contact by the sides: into the layer, and along its axes.
    pub(super) beside: [Vec<f64>; 3],
    /// Heights of the parts in the last solve, before anything was subtracted.
    bare_mm: Vec<f64>,
    pub(super) history: History,
    /// Trajectory frame of the last solve.
    solved: Option<u64>,
    /// Depth of the skin at rest, at each cell.
    pub(super) skin_mm: Arc<[f64]>,
    /// Rest places of the cells, and their places after the last solve, sensor x and y.
    pub(super) rest: Vec<DVec2>,
    pub(super) now: Vec<DVec2>,
    /// The parts over the cells.
    pub(super) obstacle: Highest,
    /// Motion of the cells with the parts that they are under, along the lattice's axes.
    pub(super) carried: [Vec<f64>; 2],
    /// Motion of the cells under the tractions.
    into: Vec<f64>,
    aside: [Vec<f64>; 2],
    pub(super) motion: Motion,
}

impl Layered {
    /// The layer of a scene that has one, at rest. It shares the tables of `before` if these are the same.
    pub(super) fn of(scene: &Scene, before: Option<&Self>) -> Result<Option<Self>, SceneError> {
        let (gel, effects) = (&scene.gel, &scene.effects);
        let Some(effect) = &effects.elastic_layer else { return Ok(None) };
        let (layer, grid, places) = effect.cells(gel);
        let same = |before: &&Self| {
            (before.contact.layer(), before.contact.grid(), before.places) == (layer, grid, places)
        };
        let (contact, nodes) = match before.filter(same) {
            Some(before) => (before.contact.with_friction(effect.friction), Some(before.nodes.clone())),
            None => (LayerContact::new(layer, grid, effect.friction), None),
        };
        let contact = contact.map_err(SceneError::Layer)?;
        let nodes = nodes.unwrap_or_else(|| Arc::new(Nodes::new(&contact, places)));
        let cells = grid.rows * grid.cols;
        let known = before.filter(same).filter(|before| before.rim_mm == effect.rim_mm);
        let sides = match known {
            Some(before) => before.sides.clone(),
            None => effect.rim_mm.map(|rim_mm| Sides::new(&contact, places, rim_mm)),
        };
        let memory =
            effects.relaxation.as_ref().map(|gel| Memory::new(&gel.terms, 1.0 / scene.frame_rate_hz, cells));
        let none = || Vec::with_capacity(cells);
        Ok(Some(Self {
            contact,
            places,
            young_kpa: effect.young_kpa,
            friction: effect.friction,
            nodes,
            sticks: effect.friction > 0.0,
            rounds: effects.large_strain.as_ref().map_or(0, |effect| effect.rounds),
            memory,
            rim_mm: effect.rim_mm,
            sides,
            beside: effect.rim_mm.map_or_else(Default::default, |_| [none(), none(), none()]),
            bare_mm: none(),
            history: History::default(),
            solved: None,
            skin_mm: skin_mm(gel, (0..cells).map(|cell| from_middle(grid, cell))).into(),
            rest: Vec::with_capacity(cells),
            now: Vec::with_capacity(cells),
            obstacle: Highest::with_capacity(cells),
            carried: [none(), none()],
            into: none(),
            aside: [none(), none()],
            motion: Motion::default(),
        }))
    }

    /// Whether the gel remembers earlier frames of the trajectory.
    pub(super) const fn has_memory(&self) -> bool {
        self.memory.is_some()
    }

    /// The present solution is of no frame of the trajectory.
    pub(super) const fn forget_solved(&mut self) {
        self.solved = None;
    }

    /// Sets the rest places of the cells.
    pub(super) fn lay(&mut self, middle_mm: DVec2, axes: [DVec2; 2]) {
        let grid = self.contact.grid();
        let place = |at: DVec2| middle_mm + axes[1] * at.y + axes[0] * at.x;
        self.rest.clear();
        self.rest.extend((0..grid.rows * grid.cols).map(|cell| place(from_middle(grid, cell))));
    }

    /// Finds every cell's place after the last solve. Returns the largest change of a cell in contact.
    pub(super) fn displace(&mut self, rest: &[DVec2], axes: [DVec2; 2]) -> f64 {
        self.contact.surface_mm(&mut self.into, &mut self.aside);
        let remembered = self.memory.as_ref().map(Memory::remembered);
        let mut farthest = 0.0_f64;
        self.now.clear();
        for (cell, at) in self.obstacle.at.iter().enumerate() {
            let own = |axis: usize| {
                let beside = self.beside[1 + axis].get(cell).map_or(0.0, |u| *u);
                beside + remembered.map_or(0.0, |fields| fields[1 + axis][cell])
            };
            let [along, across] = [0, 1].map(|axis| self.aside[axis][cell] + own(axis));
            let now = rest[cell] + axes[0] * along + axes[1] * across;
            if self.contact.pressure()[cell] > 0.0 {
                farthest = farthest.max((now - *at).length());
            }
            self.now.push(now);
        }
        farthest
    }

    /// Solves for the parts' heights, minus the remembered motion. Every cell is asked to follow the part
    /// that it is under: `carried_mm(part, cell)`, along the lattice's axes.
    pub(super) fn solve(&mut self, start: Start, carried_mm: impl Fn(usize, usize) -> [f64; 2]) {
        let Self { contact, obstacle: Highest { heights, part, .. }, carried, memory, beside, .. } = self;
        carried.iter_mut().for_each(Vec::clear);
        for (cell, &part) in part.iter().enumerate() {
            let carried_mm = carried_mm(part.into(), cell);
            carried.iter_mut().zip(carried_mm).for_each(|(field, carried_mm)| field.push(carried_mm));
        }
        self.bare_mm.clone_from(heights);
        let remembered = memory.as_ref().map(Memory::remembered);
        for [into, along, across] in remembered.into_iter().chain(self.sides.is_some().then_some(&*beside)) {
            // The support plate limits the depth as before.
            let max_mm = contact.layer().thickness_mm;
            heights.iter_mut().zip(into).for_each(|(height, own)| *height = (*height - own).min(max_mm));
            for (carried, own) in carried.iter_mut().zip([along, across]) {
                carried.iter_mut().zip(own).for_each(|(carried, own)| *carried -= own);
            }
        }
        if let Some(sides) = &self.sides {
            let beyond = heights.iter_mut().enumerate().filter(|(cell, _)| !sides.holds(*cell));
            beyond.for_each(|(_, height)| *height = f64::NEG_INFINITY);
        }
        let [x, y] = &*carried;
        let part = layer::Part { heights_mm: heights, carried_mm: self.sticks.then_some([x, y]) };
        // A valid scene gives valid inputs; a solve that gives up keeps its last state.
        let _ = contact.press(part, ElasticLayer::TOLERANCE_MM, start);
    }

    /// Before a contact is solved anew.
    pub(super) fn forget_sides(&mut self) {
        let cells = self.skin_mm.len();
        if self.sides.is_some() {
            self.beside.iter_mut().for_each(|field| {
                field.clear();
                field.resize(cells, 0.0);
            });
        }
    }

    /// Finds how the sides move the cells in contact. Returns the largest change since the last time.
    fn feel_sides(&mut self) -> f64 {
        let Some(sides) = &mut self.sides else { return 0.0 };
        sides.take(&self.contact);
        let mut farthest = 0.0_f64;
        for (cell, (&pressure, &height)) in
            self.contact.pressure().iter().zip(&self.obstacle.heights).enumerate()
        {
            if pressure > 0.0 || height > 0.0 {
                for (field, now) in self.beside.iter_mut().zip(sides.motion(cell)) {
                    farthest = farthest.max((now - field[cell]).abs());
                    field[cell] = now;
                }
            }
        }
        farthest
    }

    /// Solves again with the motion by the sides, until it stays.
    pub(super) fn meet_sides(&mut self, carried_mm: impl Fn(usize, usize) -> [f64; 2]) {
        for _round in 0..SIDE_ROUNDS {
            if self.feel_sides() <= ElasticLayer::TOLERANCE_MM {
                break;
            }
            self.obstacle.heights.clone_from(&self.bare_mm);
            self.solve(Start::Last, &carried_mm);
        }
    }

    /// Motion of the markers under the loads of the last solve.
    pub(super) fn move_markers(&mut self) {
        self.nodes.motion(&self.contact, &mut self.motion);
        if let Some(sides) = &mut self.sides {
            sides.take(&self.contact);
            sides.add(self.places, &mut self.motion);
        }
    }

    /// Adds the cells' remembered motion to the markers' motion.
    fn recall(&mut self) {
        let Some(memory) = &self.memory else { return };
        let [x, y] = &mut self.motion.aside;
        for (motion, own) in [&mut self.motion.into, x, y].into_iter().zip(memory.remembered()) {
            motion.iter_mut().enumerate().for_each(|(marker, u)| *u += own[self.places.cell(marker)]);
        }
    }
}

/// Place of a cell in the lattice's frame.
fn from_middle(grid: Grid, cell: usize) -> DVec2 {
    lattice::from_middle([cell / grid.cols, cell % grid.cols], [grid.rows, grid.cols], grid.cell_mm)
}

impl Simulator {
    /// [`Self::press`] on the elastic layer, at a time close to that of a frame.
    pub(super) fn press_layer(&mut self, contacts: &[Option<ContactState>], frame: u64, time_s: f64) {
        let Some(mut layered) = self.layered.take() else { return };
        self.remember(&mut layered, frame);
        self.settle(time_s);
        self.deform(&mut layered, contacts);
        let planned = || contacts.iter().enumerate().all(|(n, c)| *c == self.trajectory.contact(n, time_s));
        let of_frame = time_s == self.trajectory.time_s(frame) && planned();
        layered.solved = of_frame.then_some(frame);
        layered.move_markers();
        layered.recall();
        self.follow(&layered.motion);
        self.meet(contacts, &layered);
        self.layered = Some(layered);
    }

    /// Brings the memory to its state before a frame of the trajectory.
    fn remember(&mut self, layered: &mut Layered, frame: u64) {
        let frames = |layered: &Layered| layered.memory.as_ref().map_or(frame, Memory::frames);
        if frames(layered) > frame {
            layered.memory.iter_mut().for_each(Memory::forget);
        }
        while frames(layered) < frame {
            let before = frames(layered);
            // Usually the last solve was of that frame.
            if layered.solved.take() != Some(before) {
                let time_s = self.trajectory.time_s(before);
                self.settle(time_s);
                let mut contacts = core::mem::take(&mut self.scratch.meanwhile);
                self.plan_contacts(time_s, &mut contacts);
                self.deform(layered, &contacts);
                self.scratch.meanwhile = contacts;
            }
            layered.contact.surface_mm(&mut layered.into, &mut layered.aside);
            let [x, y] = &layered.aside;
            layered.memory.iter_mut().for_each(|memory| memory.add([&layered.into, x, y]));
        }
    }

    /// Solves the contact.
    fn deform(&mut self, layered: &mut Layered, contacts: &[Option<ContactState>]) {
        if contacts.iter().all(Option::is_none) {
            layered.contact.release();
            return;
        }
        let grips = self.grips(layered.sticks, contacts);
        layered.lay(self.centre_mm, self.lattice.axes);
        let (rest, axes) = (core::mem::take(&mut layered.rest), self.lattice.axes);
        let moved = |part: usize, cell: usize| carried_mm(&grips, part, rest[cell]);
        let place = |part: usize, cell: usize| rest[cell] + moved(part, cell);
        let carried = |part: usize, cell: usize| axes.map(|axis| moved(part, cell).dot(axis));
        self.parts.highest(contacts, (&layered.skin_mm, place), &mut layered.obstacle);
        layered.forget_sides();
        layered.solve(Start::Afresh, carried);
        layered.meet_sides(carried);
        self.meet_displaced(layered, contacts, (layered.rounds, &rest), carried);
        (layered.rest, self.scratch.grips) = (rest, grips);
    }

    /// Solves again with the cells at their displaced places, until they stay there.
    pub(super) fn meet_displaced(
        &mut self,
        layered: &mut Layered,
        contacts: &[Option<ContactState>],
        (rounds, rest): (usize, &[DVec2]),
        carried_mm: impl Fn(usize, usize) -> [f64; 2],
    ) {
        for _round in 0..rounds {
            if layered.displace(rest, self.lattice.axes) <= ElasticLayer::TOLERANCE_MM {
                break;
            }
            let Layered { now, skin_mm, obstacle, .. } = layered;
            self.parts.highest(contacts, (skin_mm, |_, cell: usize| now[cell]), obstacle);
            layered.solve(Start::Last, &carried_mm);
        }
    }

    /// Moves the nodes with the surface, under markers at their printed places.
    pub(super) fn follow(&mut self, motion: &Motion) {
        let Self { scratch, lattice, print, .. } = self;
        let shift_mm = print.as_ref().and_then(|print| print.shift_mm());
        let at = |field: &[f64], node: usize| {
            let beside = shift_mm.zip(lattice.marker_on(node)).map_or(0.0, |(shift_mm, marker)| {
                let shift = lattice.axes[0] * shift_mm[marker].x + lattice.axes[1] * shift_mm[marker].y;
                lattice.gradient(field, node).dot(shift)
            });
            field[node] + beside
        };
        for (node, u) in scratch.motion.iter_mut().enumerate() {
            *u = lattice.axes[0] * at(&motion.aside[0], node) + lattice.axes[1] * at(&motion.aside[1], node);
        }
        scratch.heights.clear();
        scratch.heights.extend((0..motion.into.len()).map(|node| at(&motion.into, node)));
    }

    /// Markers in contact lie on the part at their displaced places, and no other marker lies inside a
    /// part.
    pub(super) fn meet(&mut self, contacts: &[Option<ContactState>], layered: &Layered) {
        self.touch(contacts, |_, rest, motion| rest + motion);
        let scratch = &mut self.scratch;
        scratch.stuck.clear();
        let obstacles = &scratch.obstacle.heights;
        for (marker, (height, &obstacle)) in scratch.heights.iter_mut().zip(obstacles).enumerate() {
            let pressed = layered.contact.pressure()[layered.places.cell(marker)] > 0.0;
            let touches = obstacle > *height || (pressed && obstacle > f64::NEG_INFINITY);
            if touches {
                *height = obstacle;
            }
            scratch.stuck.push(touches);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Effects, LargeStrain};
    use crate::shapes::Shape;
    use crate::simulator::Truth;
    use gelstereo_core::math::{DVec3, Pose};

    /// Largest distance between the layer's solution and the part at the cells' displaced places.
    fn off_the_part(large_strain: Option<LargeStrain>) -> f64 {
        let elastic_layer =
            Some(ElasticLayer { poisson_ratio: 0.5, friction: 0.0, ..ElasticLayer::default() });
        let effects = Effects { elastic_layer, large_strain, ..Effects::default() };
        let indenter = Some(Shape::Sphere { radius_mm: 3.0 });
        let mut simulator = Simulator::new(&Scene { effects, indenter, ..Scene::default() }, None).unwrap();
        let contact =
            ContactState::pressed(Pose { translation_mm: DVec3::new(4.1, 0.2, 30.2), ..Pose::IDENTITY });
        simulator.truth(Some(&contact), &mut Truth::default());
        let mut layered = simulator.layered.take().unwrap();
        let rest = layered.rest.clone();
        layered.displace(&rest, simulator.lattice.axes);
        let mut heights = Vec::new();
        let pose = contact.t_sensor_object;
        simulator.parts.heights(0, &pose, (&layered.now, &layered.skin_mm), &mut heights);
        let touching = (0..heights.len()).filter(|&cell| layered.contact.pressure()[cell] > 0.0);
        touching.map(|cell| (heights[cell] - layered.into[cell]).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn the_part_meets_the_gel_where_it_has_moved_to() {
        let (small, large) = (off_the_part(None), off_the_part(Some(LargeStrain::default())));
        assert!(small > 0.02, "{small} mm");
        // The contact's tolerance, and the last round's motion along a slope of one.
        assert!(large < 3.0 * ElasticLayer::TOLERANCE_MM, "{large} mm");
    }
}
