//! Plans touches: faces of the cell that the held part can reach, and their expected information.

use super::belief::Belief;
use super::cell::Cell;
use super::chance::Flank;
use super::localize::{Held, Side, TouchedSide};
use super::touch_point::{TouchPoint, touch_point};
use crate::config::EdgeConfig;
use gelstereo_core::math::{DVec3, Pose, atan2, sqrt};
use gelstereo_core::register::{FusionError, PlaneContact, PoseEstimate};

/// Largest angle between a side and the face; beyond it the side's corner would touch.
const MAX_ASKEW_RAD: f64 = 0.2;
/// Standard deviations of the touching point's position covered by the slow move on either side.
const REACH_SIGMAS: f64 = 4.0;

/// A touch, and the chance of insertion expected after it.
pub(super) struct TouchPlan {
    pub(super) touched: TouchedSide,
    /// The face.
    pub(super) edge: EdgeConfig,
    /// Pose of the hand at the start of the slow move, base frame.
    pub(super) start: Pose,
    /// Unit direction of the slow move, base frame.
    pub(super) way: DVec3,
    /// Travel of the move if nothing stops it; the face is expected at its middle.
    pub(super) max_travel_mm: f64,
    /// Points of the part that may touch, part frame.
    pub(super) points_mm: Vec<DVec3>,
    pub(super) chance: f64,
    /// Expected belief afterwards, gripper frame.
    pub(super) expected: Belief,
}

impl TouchPlan {
    /// Constraint on a pose in the gripper frame, if the part touched after this travel from the start.
    /// It is a plane in the gripper frame, because the hand does not turn during the move.
    pub(super) fn contact(
        &self,
        cell: &Cell,
        known: &PoseEstimate,
        travel_mm: f64,
        onset_sigma_mm: f64,
    ) -> PlaneContact {
        let edge = &self.edge;
        let t_gripper_base = self.start.inverse();
        let normal = t_gripper_base.transform_vector(self.way);
        let face_mm = t_gripper_base.transform_point(edge.middle_mm()).dot(normal) - travel_mm;
        let point = self.point(cell, known);
        let sigma_mm = hypotenuse(&[
            edge.sigma_mm,
            edge.robot_sigma_mm,
            frame_way_sigma_mm(cell, edge),
            point.residual_sigma_mm,
            onset_sigma_mm,
        ]);
        let offset_mm = face_mm - point.ahead_mm;
        PlaneContact { point_mm: point.point_mm, normal, offset_mm, sigma_mm }
    }

    fn point(&self, cell: &Cell, known: &PoseEstimate) -> TouchPoint {
        let task = &cell.config.task;
        let way = self.start.inverse().transform_vector(self.way);
        touch_point(&self.points_mm, known, way, task.part_sigma_rad, task.part_sigma_mm)
    }
}

/// Plans all possible touches that were not made yet.
pub(super) fn touch_plans(cell: &Cell, flank: &Flank, held: &Held, t_base_gripper: &Pose) -> Vec<TouchPlan> {
    let edges = cell.config.task.edges.iter().enumerate();
    edges
        .flat_map(|(index, edge)| Side::ALL.map(|side| (TouchedSide { edge: index, side }, edge)))
        .filter(|(touched, _)| !held.touched.contains(touched))
        .filter_map(|(touched, edge)| {
            let mut plan = posed(cell, flank, held, t_base_gripper, touched, edge)?;
            plan.expected = expected_belief(cell, held, &plan).ok()?;
            let task = &cell.config.task;
            plan.chance = flank.forecast(&plan.expected, task.part_sigma_rad, task.part_sigma_mm).chance;
            Some(plan)
        })
        .collect()
}

/// A plan with the hand's pose, without its chance; `None` where the hand would have to lean.
fn posed(
    cell: &Cell,
    flank: &Flank,
    held: &Held,
    t_base_gripper: &Pose,
    touched: TouchedSide,
    edge: &EdgeConfig,
) -> Option<TouchPlan> {
    let known = held.belief.likeliest();
    let way = -edge.unit_normal();
    let towards = t_base_gripper.transform_vector(match touched.side {
        Side::Left => DVec3::Y,
        Side::Right => DVec3::NEG_Y,
        Side::End => known.pose.transform_vector(cell.config.insertion_axis()),
    });
    let turn = turn_about_z(towards, way);
    let turned = turn.transform_vector(towards);
    if !(atan2(turned.cross(way).length(), turned.dot(way)) <= MAX_ASKEW_RAD) {
        return None;
    }
    let hand = Pose { rotation: turn.rotation * t_base_gripper.rotation, translation_mm: DVec3::ZERO };
    let t_hand_object = hand * known.pose;
    let tip_mm = t_hand_object.transform_point(flank.tip_mm());
    let before_face = |point: &DVec3| {
        let beside = t_hand_object.transform_point(*point) - tip_mm;
        edge.sides().iter().all(|side| side.dot(beside).abs() <= 0.5 * edge.size_mm)
    };
    let points_mm: Vec<DVec3> =
        cell.sensing.template().points_mm().iter().copied().filter(before_face).collect();
    if points_mm.is_empty() {
        return None;
    }
    let (edge, expected) = (edge.clone(), held.belief.clone());
    let mut plan =
        TouchPlan { touched, edge, start: hand, way, max_travel_mm: 0.0, points_mm, chance: 0.0, expected };
    let point = plan.point(cell, known);
    let edge = &plan.edge;
    let reach_mm = edge.approach_mm.max(REACH_SIGMAS * point.place_sigma_mm);
    let ahead_mm = (t_hand_object.transform_point(point.point_mm) - tip_mm).dot(way) + point.ahead_mm;
    plan.start.translation_mm = edge.middle_mm() - tip_mm - way * (reach_mm + ahead_mm);
    plan.max_travel_mm = 2.0 * reach_mm;
    Some(plan)
}

/// The turn about the vertical that brings one direction nearest to another.
fn turn_about_z(from: DVec3, to: DVec3) -> Pose {
    let (cross, dot) = (from.x * to.y - from.y * to.x, from.x * to.x + from.y * to.y);
    // For vertical directions the small horizontal component is meaningless.
    let angle = if from.truncate().length() * to.truncate().length() > 0.1 { atan2(cross, dot) } else { 0.0 };
    Pose::exp(DVec3::Z * angle, DVec3::ZERO)
}

/// Belief after a touch at the expected position. The uncertainty of the line fit is omitted: it is known
/// only afterwards.
fn expected_belief(cell: &Cell, held: &Held, plan: &TouchPlan) -> Result<Belief, FusionError> {
    let known = Belief::alone(*held.belief.likeliest());
    let half_mm = 0.5 * plan.max_travel_mm;
    Ok(known.touching(|estimate| plan.contact(cell, estimate, half_mm, 0.0))?.belief)
}

/// The robot's position may date from up to one frame period before or after the image. Its error is
/// uniform within ± the travel between two frames.
fn frame_way_sigma_mm(cell: &Cell, edge: &EdgeConfig) -> f64 {
    let config = cell.config;
    let period_s = 1.0 / config.source.frame_rate_hz(config.simulated.frame_rate_hz);
    edge.speed_mm_s * period_s / sqrt(3.0)
}

fn hypotenuse(sides: &[f64]) -> f64 {
    sqrt(sides.iter().map(|side| side * side).sum())
}
