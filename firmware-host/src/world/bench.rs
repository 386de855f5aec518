//! A peg in its holder, the simulated sensor, a hole, and the faces of the cell that a part may touch.
//!
//! The peg stands loosely in its holder until the robot moves with the peg between the fingers. Until
//! then a single touching finger pushes it along, and two equally soft fingers centre it. From then on it
//! is rigid in the hand except for the gel: if a hole or a face holds the peg back while the hand moves
//! on, the gel's surface is dragged along.

use super::fixture::Fixture;
use super::hole::{Fit, Hole, Mouth};
use super::peg::{Peg, Section};
use super::{Hand, WorldError};
use crate::config::Config;
use crate::source::StereoPair;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose, so3};
use gelstereo_sim::{ContactState, Scene, Shape, Simulator, Truth};

/// What holds the peg.
#[derive(Clone, Copy, Debug)]
enum Hold {
    Holder {
        t_base_object: Pose,
    },
    Hand {
        t_gripper_object: Pose,
    },
    /// It was placed in the hole, which holds it.
    Hole {
        t_base_object: Pose,
    },
    /// Released: it stays in place; its previous pose in the hand is kept.
    Released {
        t_base_object: Pose,
        t_gripper_object: Pose,
    },
}

/// Initial place of the part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Loosely in its holder, near its expected pose.
    Holder,
    /// In the hole, anywhere within the clearance.
    Goal,
}

/// Clearance of a rectangular hole whose size is not configured.
const CLEARANCE_MM: f64 = 0.2;
/// Indentation at which the gripper stalls, as a fraction of the gel thickness.
const STALL_SHARE: f64 = 0.75;

/// Simulated environment of the hand.
#[derive(Debug)]
pub struct Bench {
    simulator: Simulator,
    size_px: [(usize, usize); 2],
    peg: Peg,
    hole: Hole,
    fixtures: Vec<Fixture>,
    stall_mm: f64,
    hold: Hold,
    /// Position of the part's origin in the sensor frame at the first contact with the gel.
    touch_mm: Option<DVec3>,
    deepest_mm: f64,
    /// The fit at the deepest position of the hand in the hole.
    deepest_fit: Option<Fit>,
    truth: Truth,
}

/// Ground truth for judging a simulated job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BenchTruth {
    /// Part in the gripper as grasped.
    pub t_gripper_object: Pose,
    /// Peg relative to the hole at the deepest position of the hand, as if nothing held the peg back.
    pub fit: Fit,
    /// Largest depth of the peg in the hole; negative if it never reached the rim.
    pub deepest_mm: f64,
    /// Half the peg's length.
    pub half_length_mm: f64,
}

impl Bench {
    /// Bench with the peg at its initial place.
    ///
    /// # Errors
    /// [`WorldError`].
    pub fn new(config: &Config, place: Place) -> Result<Self, WorldError> {
        let (simulated, task) = (&config.simulated, &config.task);
        let shape = simulated.shape.as_ref().unwrap_or(&config.part.shape).clone();
        let peg = Peg::of(&shape, config.insertion_axis()).ok_or(WorldError::NoPeg)?;
        let rig = config.rig.clone().unwrap_or_else(Scene::default_rig);
        let size_px = [&rig.left, &rig.right].map(|camera| (camera.width_px, camera.height_px));
        let scene = simulated.scene(rig, shape);
        let goal = task.goal_pose.pose();
        let inwards = goal.transform_vector(peg.axis);
        let bottom_mm = goal.transform_point(peg.axis * peg.half_length_mm);
        let hole = Hole {
            rim_mm: bottom_mm - inwards * task.insertion_depth_mm,
            inwards,
            mouth: mouth(config, &peg),
            depth_mm: task.insertion_depth_mm,
        };
        let fixtures =
            task.edges.iter().map(|edge| Fixture::of(edge, simulated.edge_offset_mm.unwrap_or(0.0)));
        let hold = match place {
            Place::Holder => Hold::Holder { t_base_object: misplaced(config, &peg) },
            Place::Goal => Hold::Hole { t_base_object: placed(config, &hole, &peg) },
        };
        Ok(Self {
            simulator: Simulator::new(&scene, None).map_err(WorldError::Scene)?,
            size_px,
            peg,
            hole,
            fixtures: fixtures.collect(),
            stall_mm: STALL_SHARE * simulated.gel.thickness_mm,
            hold,
            touch_mm: None,
            deepest_mm: f64::NEG_INFINITY,
            deepest_fit: None,
            truth: Truth::default(),
        })
    }

    /// Renders a stereo pair; `frame` seeds its noise.
    pub fn expose(&mut self, hand: &Hand, frame: u64, pair: &mut StereoPair) {
        self.push(hand);
        self.release(hand);
        let (t_base_object, fit) = self.t_base_object(hand);
        let t_sensor_object = (hand.t_base_gripper * hand.t_gripper_sensor).inverse() * t_base_object;
        // The part sticks to the gel at its first contact.
        let dragged_mm = self.touch_mm.map_or(DVec3::ZERO, |touch| t_sensor_object.translation_mm - touch);
        let shear_mm = [dragged_mm.x, dragged_mm.y];
        let contact = ContactState { t_sensor_object, shear_mm, twist_rad: 0.0 };
        self.simulator.truth(Some(&contact), &mut self.truth);
        match (self.touch_mm, self.truth.in_contact.contains(&true)) {
            (None, true) => self.touch_mm = Some(t_sensor_object.translation_mm),
            // Opening fingers leave a peg in place.
            (Some(_), false) if matches!(self.hold, Hold::Holder { .. }) => self.touch_mm = None,
            _ => {}
        }
        if matches!(self.hold, Hold::Hand { .. }) {
            self.deepest_mm = self.deepest_mm.max(fit.depth_mm.min(fit.limit_mm));
            if self.deepest_fit.is_none_or(|deepest| fit.depth_mm > deepest.depth_mm) {
                self.deepest_fit = Some(fit);
            }
        }
        for (gray, size_px) in [&mut pair.left, &mut pair.right].into_iter().zip(self.size_px) {
            (gray.width, gray.height) = size_px;
        }
        self.simulator.render(&self.truth, frame, &mut pair.left.pixels, &mut pair.right.pixels);
    }

    /// Whether the gel is pressed so far that the gripper stalls.
    #[must_use]
    pub fn stalls(&self) -> bool {
        self.truth.indentation_mm.iter().any(|&h| h > self.stall_mm)
    }

    /// The robot starts to move and takes along the part between the fingers.
    pub fn depart(&mut self, t_base_gripper: &Pose) {
        if let (Hold::Holder { t_base_object }, Some(_)) = (self.hold, self.touch_mm) {
            self.hold = Hold::Hand { t_gripper_object: t_base_gripper.inverse() * t_base_object };
        }
    }

    /// The ground truth.
    #[must_use]
    pub fn truth(&self, hand: &Hand) -> BenchTruth {
        BenchTruth {
            t_gripper_object: match self.hold {
                Hold::Holder { t_base_object } | Hold::Hole { t_base_object } => {
                    hand.t_base_gripper.inverse() * t_base_object
                }
                Hold::Hand { t_gripper_object } | Hold::Released { t_gripper_object, .. } => t_gripper_object,
            },
            fit: self.deepest_fit.unwrap_or_else(|| self.t_base_object(hand).1),
            deepest_mm: self.deepest_mm,
            half_length_mm: self.peg.half_length_mm,
        }
    }

    /// The fingers push a peg in its holder along the closing direction, until it is centred between them.
    fn push(&mut self, hand: &Hand) {
        let Hold::Holder { t_base_object } = &mut self.hold else { return };
        let closing = hand.t_base_gripper.transform_vector(DVec3::X);
        let x_mm = (t_base_object.translation_mm - hand.t_base_gripper.translation_mm).dot(closing);
        let half_mm = self.peg.half_width_mm(t_base_object.inverse().transform_vector(closing));
        let room_mm = (0.5 * hand.width_mm - half_mm).max(0.0);
        let shift_mm = closing * (x_mm.clamp(-room_mm, room_mm) - x_mm);
        *t_base_object = Pose::from_translation_mm(shift_mm) * *t_base_object;
    }

    /// Releases the peg in place once the fingers no longer reach it.
    fn release(&mut self, hand: &Hand) {
        let Hold::Hand { t_gripper_object } = self.hold else { return };
        let half_mm = self.peg.half_width_mm(t_gripper_object.inverse().transform_vector(DVec3::X));
        if 0.5 * hand.width_mm > half_mm {
            let (t_base_object, _) = self.t_base_object(hand);
            self.hold = Hold::Released { t_base_object, t_gripper_object };
            self.touch_mm = None;
        }
    }

    /// Part in the base frame, as if nothing held it back.
    fn t_base_object_free(&self, hand: &Hand) -> Pose {
        match self.hold {
            Hold::Holder { t_base_object }
            | Hold::Hole { t_base_object }
            | Hold::Released { t_base_object, .. } => t_base_object,
            Hold::Hand { t_gripper_object } => hand.t_base_gripper * t_gripper_object,
        }
    }

    /// Part in the base frame: the hole limits the depth of a held peg, and faces block it.
    fn t_base_object(&self, hand: &Hand) -> (Pose, Fit) {
        let free = self.t_base_object_free(hand);
        let fit = self.hole.fit(&self.peg, &free);
        if !matches!(self.hold, Hold::Hand { .. }) {
            return (free, fit);
        }
        let excess_mm = (fit.depth_mm - fit.limit_mm).max(0.0);
        let held = Pose::from_translation_mm(-self.hole.inwards * excess_mm) * free;
        let held = self.fixtures.iter().fold(held, |held, fixture| {
            let shift_mm = fixture.normal * fixture.penetration_mm(&self.peg, &held);
            Pose::from_translation_mm(shift_mm) * held
        });
        (held, fit)
    }
}

/// The hole's outline: the peg's section, with walls along the part's sides at the goal.
fn mouth(config: &Config, peg: &Peg) -> Mouth {
    let simulated = &config.simulated;
    match peg.section {
        Section::Round { .. } => Mouth::Round { diameter_mm: simulated.hole_diameter_mm },
        Section::Rectangle { half_mm } => {
            let expected = match config.part.shape {
                Shape::Box { size_mm: [x, y, _] } => [x, y],
                _ => half_mm.map(|half| 2.0 * half),
            };
            let goal = config.task.goal_pose.pose();
            Mouth::Rectangle {
                normals: [DVec3::X, DVec3::Y].map(|side| goal.transform_vector(side)),
                size_mm: simulated.hole_size_mm.unwrap_or(expected.map(|side| side + CLEARANCE_MM)),
            }
        }
    }
}

/// True pose of the part in its holder: a random offset, tilt and spin from the expected pose.
fn misplaced(config: &Config, peg: &Peg) -> Pose {
    let simulated = &config.simulated;
    let mut stream = Stream::new(simulated.seed, "part in its holder");
    let mut within = |limit: f64| (2.0 * stream.uniform() - 1.0) * limit;
    let mut vector = |limit: f64| DVec3::new(within(limit), within(limit), within(limit));
    let offset_mm = vector(simulated.offset_mm);
    let tilt = vector(simulated.tilt_rad);
    // A holder also fixes the spin of a part with corners; only the tilt vector contributes some.
    let spin = config.insertion_axis() * within(if peg.is_round() { core::f64::consts::PI } else { 0.0 });
    let off = Pose { rotation: so3::exp(tilt) * so3::exp(spin), translation_mm: offset_mm };
    config.task.part_pose.pose() * off
}

/// Number of poses tried within the clearance; about one in ten fits.
const MAX_TRIES: usize = 1000;

/// Pose of a part placed in the hole: at the bottom, with a random offset and tilt within the clearance.
fn placed(config: &Config, hole: &Hole, peg: &Peg) -> Pose {
    let goal = config.task.goal_pose.pose();
    let Room { room_mm, spin_rad } = room(&hole.mouth, peg);
    let mut stream = Stream::new(config.simulated.seed, "part in its goal");
    let mut within = |limit: f64| (2.0 * stream.uniform() - 1.0) * limit;
    let candidates = (0..MAX_TRIES).map(|_| {
        let tilt = DVec3::new(within(1.0), within(1.0), 0.0) * (room_mm / hole.depth_mm);
        let offset_mm = DVec3::new(within(room_mm), within(room_mm), 0.0);
        let spin = peg.axis * within(spin_rad);
        let turn = so3::exp(tilt) * so3::exp(spin);
        // The tip is offset at the bottom; the rest of the part leans.
        let tip_mm = peg.axis * peg.half_length_mm;
        goal * Pose { rotation: turn, translation_mm: tip_mm + offset_mm - turn * tip_mm }
    });
    let fits = |pose: &Pose| hole.fit(peg, pose).limit_mm >= hole.depth_mm;
    candidates.into_iter().find(fits).unwrap_or(goal)
}

/// Largest deviation of a part in its hole.
struct Room {
    /// To each side.
    room_mm: f64,
    /// About its axis.
    spin_rad: f64,
}

fn room(mouth: &Mouth, peg: &Peg) -> Room {
    match (*mouth, peg.section) {
        (Mouth::Round { diameter_mm }, Section::Round { radius_mm }) => {
            Room { room_mm: (0.5 * diameter_mm - radius_mm).max(0.0), spin_rad: core::f64::consts::PI }
        }
        (Mouth::Rectangle { size_mm, .. }, Section::Rectangle { half_mm: [x, y] }) => {
            let room_mm = (0.5 * size_mm[0] - x).min(0.5 * size_mm[1] - y).max(0.0);
            Room { room_mm, spin_rad: room_mm / x.max(y) }
        }
        _ => Room { room_mm: 0.0, spin_rad: 0.0 },
    }
}
