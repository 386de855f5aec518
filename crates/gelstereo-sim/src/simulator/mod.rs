//! Simulator: from a scene to marker positions and images.

mod contacts;
mod deepest;
mod history;
mod layered;
mod loads;
mod parts;
mod press;
mod sheet;
mod shutter;
mod truth;

use layered::Layered;
pub use loads::{Loads, PartLoads};
use parts::{Highest, Parts};
pub use truth::{DotImage, OUT_OF_SIGHT_PX, Sight, Truth};

use crate::effects::{Bridge, Grip, Print, Pull, Sag, Speck, Spreading, Worn};
use crate::lattice::Lattice;
use crate::plan::{Plan, Switch};
use crate::render::{Dot, Exposure, Renderer};
use crate::scene::{Gel, Scene, SceneError};
use crate::shapes::Solid;
use crate::trajectory::Trajectory;
use alloc::boxed::Box;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_core::rig::Rig;
use gelstereo_core::surface::TriangleMesh;

/// Contact of a part with the gel at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct ContactState {
    /// Object frame to sensor frame at this moment: after shear and twist.
    pub t_sensor_object: Pose,
    /// Motion of the surface with the part since touch, sensor x and y.
    #[cfg_attr(feature = "serde", serde(default))]
    pub shear_mm: [f64; 2],
    /// Rotation of the surface about the contact's centre since touch, from x towards y, radians.
    #[cfg_attr(feature = "serde", serde(default))]
    pub twist_rad: f64,
}

impl ContactState {
    /// A part that has moved along z only.
    #[must_use]
    pub const fn pressed(t_sensor_object: Pose) -> Self {
        Self { t_sensor_object, shear_mm: [0.0; 2], twist_rad: 0.0 }
    }

    /// Checks that the numbers describe a contact.
    ///
    /// # Errors
    /// [`SceneError::Invalid`].
    pub fn validate(&self) -> Result<(), SceneError> {
        let check = SceneError::check;
        let Pose { rotation, translation_mm } = self.t_sensor_object;
        let norm = rotation.length_squared();
        check((norm - 1.0).abs() < 1e-6, "contact rotation's squared norm", norm, "1 within 1e-6")?;
        for t in translation_mm.to_array() {
            check(t.abs() <= 1e4, "contact position_mm", t, "-10000 to 10000 mm")?;
        }
        for shear in self.shear_mm {
            check(shear.abs() <= 1e3, "contact shear_mm", shear, "-1000 to 1000 mm")?;
        }
        check(self.twist_rad.abs() <= 7.0, "contact twist_rad", self.twist_rad, "-7 to 7 rad")
    }
}

/// A scene prepared for simulation.
#[derive(Clone, Debug)]
pub struct Simulator {
    plan: Plan,
    rig: Rig,
    gel: Gel,
    /// The lattice at the gel's current place.
    lattice: Lattice,
    /// Depth of the skin at rest, at each node.
    skin_mm: Vec<f64>,
    /// The lattice's current centre.
    centre_mm: DVec2,
    /// Current places of the nodes without contact.
    rest: Vec<DVec2>,
    print: Option<Print>,
    worn: Option<Worn>,
    specks: Vec<Speck>,
    parts: Parts,
    shoulder: Option<Sag>,
    spread: Option<Spreading>,
    drag: Option<Pull>,
    layered: Option<Box<Layered>>,
    /// Whether the centroid of a disc's image is offset from the image of its centre.
    ellipse_bias: bool,
    trajectory: Trajectory,
    /// Exposure time; `None` without motion blur.
    exposure_s: Option<f64>,
    /// Delivered frames, if some are dropped.
    delivered: Option<Vec<usize>>,
    renderer: Renderer,
    scratch: Scratch,
}

/// Fields over the lattice's nodes, kept between frames.
#[derive(Clone, Debug, Default)]
struct Scratch {
    motion: Vec<DVec2>,
    /// The parts over the nodes.
    obstacle: Highest,
    /// Contact of each part at this moment, and of one in the course of it.
    contacts: Vec<Option<ContactState>>,
    meanwhile: Vec<Option<ContactState>>,
    /// Motion of each part in the plane since touch, and in space within a step.
    grips: Vec<Grip>,
    motions: Vec<Pose>,
    heights: Vec<f64>,
    stuck: Vec<bool>,
    fields: [Vec<f64>; 2],
    dots: Vec<Dot>,
    /// Marker positions at the opening and closing of the shutter; empty without known motion.
    ends_mm: [Vec<DVec3>; 2],
}

impl Simulator {
    /// Prepares a scene: plans the effects it needs and builds only those. `meshes` are the surfaces of
    /// the parts whose shapes are mesh files, in the order of the parts: one or `None` without
    /// [`Scene::others`].
    ///
    /// # Errors
    /// [`SceneError`].
    pub fn new<'a>(
        scene: &'a Scene,
        meshes: impl IntoIterator<Item = &'a TriangleMesh>,
    ) -> Result<Self, SceneError> {
        Self::build(scene, meshes, None)
    }

    /// [`Self::new`], sharing with this simulator what is laborious to build and the same for both scenes:
    /// the elastic layer's tables, the grain, the image of the gel without ink, the order of the noise. The
    /// new simulator has the same bits as one that shares nothing; neither affects the other.
    ///
    /// # Errors
    /// [`SceneError`].
    pub fn replaced<'a>(
        &self,
        scene: &'a Scene,
        meshes: impl IntoIterator<Item = &'a TriangleMesh>,
    ) -> Result<Self, SceneError> {
        Self::build(scene, meshes, Some(self))
    }

    fn build<'a>(
        scene: &'a Scene,
        meshes: impl IntoIterator<Item = &'a TriangleMesh>,
        before: Option<&Self>,
    ) -> Result<Self, SceneError> {
        let meshes: Vec<_> = meshes.into_iter().collect();
        let plan = Plan::of(scene, meshes.iter().copied())?;
        let scene = &plan.scene;
        let parts = Parts::new(Solid::of(scene, meshes)?, scene.gel.thickness_mm);
        let (gel, effects, seed) = (&scene.gel, &scene.effects, scene.seed);
        let trajectory = Trajectory::new(scene);
        let misprint = effects.misprint.as_ref();
        let bridges = misprint.map_or_else(Vec::new, |misprint| Bridge::all(misprint, gel.cols));
        let lattice = Lattice::new(gel);
        let centre_mm = DVec2::from_array(gel.centre_mm);
        let mut simulator = Self {
            rig: scene.rig.clone(),
            gel: gel.clone(),
            lattice,
            skin_mm: Vec::new(),
            centre_mm,
            rest: Vec::new(),
            print: misprint.map(|misprint| Print::new(misprint, seed, gel.rows * gel.cols)),
            worn: effects.wear.as_ref().map(|wear| Worn::new(wear, seed, gel.rows * gel.cols)),
            specks: effects.specks.as_ref().map_or_else(Vec::new, |specks| Speck::all(specks, seed, gel)),
            parts,
            shoulder: effects.shoulder.as_ref().map(|shoulder| Sag::new(shoulder, &lattice)),
            spread: effects.spread.as_ref().map(|spread| Spreading::new(spread, &lattice)),
            drag: effects.drag.as_ref().map(|drag| Pull::new(drag, &lattice)),
            layered: Layered::of(scene, before.and_then(|before| before.layered.as_deref()))?.map(Box::new),
            delivered: effects
                .dropped_frames
                .as_ref()
                .map(|drops| drops.delivered(seed, trajectory.frames())),
            renderer: Renderer::new(
                scene,
                trajectory.span_s(),
                bridges,
                before.map(|before| &before.renderer),
            ),
            ellipse_bias: scene.switches.ellipse_bias != Some(Switch::Off),
            exposure_s: effects.motion_blur.as_ref().map(|blur| blur.exposure_s),
            trajectory,
            scratch: Scratch { obstacle: Highest::with_capacity(lattice.nodes()), ..Scratch::default() },
            plan,
        };
        simulator.lay(centre_mm);
        simulator.curve();
        Ok(simulator)
    }

    /// Which effects are computed, with reasons; [`Plan::scene`] is the simulated scene.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Frames of the trajectory (1 when nothing moves), including those that [`Self::delivered`] skips.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.trajectory.frames()
    }

    /// Number of delivered frames; fewer than [`Self::frames`] when the scene drops some.
    #[must_use]
    pub fn delivered(&self) -> usize {
        self.delivered.as_ref().map_or_else(|| self.frames(), Vec::len)
    }

    /// Trajectory frame that is delivered after `arrived` others; `None` after the last.
    #[must_use]
    pub fn frame_of(&self, arrived: usize) -> Option<usize> {
        match &self.delivered {
            Some(delivered) => delivered.get(arrived).copied(),
            None => (arrived < self.frames()).then_some(arrived),
        }
    }

    /// Time of a frame, seconds on the keyframes' clock.
    #[must_use]
    pub fn time_s(&self, frame: u64) -> f64 {
        self.trajectory.time_s(frame)
    }

    /// Number of parts: the indenter and the others.
    #[must_use]
    pub fn parts(&self) -> usize {
        self.parts.len()
    }

    /// Contact of the indenter on its trajectory at a frame (beyond the end: the last); `None` without
    /// keyframes.
    #[must_use]
    pub fn contact(&self, frame: usize) -> Option<ContactState> {
        self.trajectory.contact(0, self.time_s(frame as u64))
    }

    /// As [`Self::contact`], of all parts.
    #[must_use]
    pub fn planned(&self, frame: usize) -> Vec<Option<ContactState>> {
        let mut contacts = Vec::new();
        self.plan_contacts(self.time_s(frame as u64), &mut contacts);
        contacts
    }

    /// The pose moved along z until the indenter reaches `press_mm` into the gel, at the place where it is
    /// deepest; `None` without an indenter.
    #[must_use]
    pub fn pressed(&self, t_sensor_object: Pose, press_mm: f64) -> Option<Pose> {
        self.pressed_of(0, t_sensor_object, press_mm)
    }

    /// As [`Self::pressed`], of any part; `None` if there is no such part.
    #[must_use]
    pub fn pressed_of(&self, part: usize, t_sensor_object: Pose, press_mm: f64) -> Option<Pose> {
        let nearest_mm = self.parts.nearest_z_mm(part, &t_sensor_object)?;
        let mut pose = t_sensor_object;
        pose.translation_mm.z += self.gel.surface_mm - press_mm - nearest_mm;
        if let Some(relief) = &self.gel.relief {
            // Heights change as the part moves along z.
            pose.translation_mm.z +=
                self.deepest_mm(part, &pose, relief).map_or(0.0, |deepest| deepest - press_mm);
        }
        Some(pose)
    }

    /// [`Self::moment`] of the first frame. For scenes without gel motion and smears it holds for any
    /// frame.
    pub fn truth(&mut self, contact: Option<&ContactState>, out: &mut Truth) {
        self.moment(contact, 0, out);
    }

    /// Marker positions and camera views for a contact of the indenter, with the gel and the smears of a
    /// frame. The other parts are where their trajectories have them. `None`, or a contact that
    /// [`ContactState::validate`] rejects, means no contact.
    pub fn moment(&mut self, contact: Option<&ContactState>, frame: u64, out: &mut Truth) {
        self.pose(contact, frame);
        self.posed_moment(frame, out);
    }

    /// [`Self::moment`] for a contact of each part, by its number; those that are missing do not touch.
    pub fn moment_of(&mut self, contacts: &[Option<ContactState>], frame: u64, out: &mut Truth) {
        self.pose_all(contacts);
        self.posed_moment(frame, out);
    }

    fn posed_moment(&mut self, frame: u64, out: &mut Truth) {
        let contacts = core::mem::take(&mut self.scratch.contacts);
        self.expose(&contacts, frame);
        self.stand(&contacts, frame, self.time_s(frame));
        self.scratch.contacts = contacts;
        self.write(self.time_s(frame), out);
    }

    /// [`Self::moment`] of the markers in space only, for point clouds. Projections and dot images are
    /// not computed and their lists are left empty; [`Self::look`] fills them in.
    pub fn field(&mut self, contact: Option<&ContactState>, frame: u64, out: &mut Truth) {
        self.pose(contact, frame);
        self.posed_field(frame, out);
    }

    /// [`Self::field`] for a contact of each part, by its number; those that are missing do not touch.
    pub fn field_of(&mut self, contacts: &[Option<ContactState>], frame: u64, out: &mut Truth) {
        self.pose_all(contacts);
        self.posed_field(frame, out);
    }

    fn posed_field(&mut self, frame: u64, out: &mut Truth) {
        let contacts = core::mem::take(&mut self.scratch.contacts);
        self.stand(&contacts, frame, self.time_s(frame));
        self.scratch.contacts = contacts;
        self.write_field(out);
        out.forget_views();
    }

    /// Adds both cameras' views to a [`Self::field`] of a frame. Without motion blur the result is
    /// [`Self::moment`]. A field has no motion during the exposure, so nothing moves.
    ///
    /// # Errors
    /// [`SceneError::Invalid`] if there are more or fewer points than the gel has markers.
    pub fn look(&mut self, frame: u64, out: &mut Truth) -> Result<(), SceneError> {
        let (found, markers) = (out.points_mm.len(), self.lattice.markers());
        SceneError::check(found == markers, "number of points_mm", found as f64, "gel.rows * gel.cols")?;
        self.scratch.ends_mm.iter_mut().for_each(Vec::clear);
        self.write_views(self.time_s(frame), out);
        Ok(())
    }

    /// Computes the markers of a moment into the scratch; a gel with memory first simulates the frames
    /// before.
    fn stand(&mut self, contacts: &[Option<ContactState>], frame: u64, time_s: f64) {
        self.settle(time_s);
        self.scratch.motion.clear();
        self.scratch.motion.resize(self.rest.len(), DVec2::ZERO);
        if self.layered.is_some() {
            self.press_layer(contacts, frame, time_s);
        } else {
            self.press(contacts);
        }
    }

    /// Renders both views of a moment, `height * width` bytes each. `frame` seeds the noise and sets the
    /// time of the smears. A truth with a different number of markers shows none.
    pub fn render(&mut self, truth: &Truth, frame: u64, left: &mut Vec<u8>, right: &mut Vec<u8>) {
        let exposure = Exposure { frame, time_s: self.time_s(frame) };
        self.renderer.draw(0, truth, exposure, left);
        self.renderer.draw(1, truth, exposure, right);
    }
}
