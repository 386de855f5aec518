//! Common parts of the grippers with one bus servo.

use super::{GripperStatus, WidthTable};

/// Number of attempts before the servo counts as silent. One lost byte must not stop a robot.
pub(super) const ATTEMPTS: u32 = 3;
/// A goal missed by more counts than this was blocked by an object: 2 degrees at 4096 counts per turn,
/// the play of a geared finger. Not measured on a servo.
const MISSED_COUNTS: i32 = 23;

/// Status of a servo with this `goal` that moves or rests at `position`.
pub(super) fn status(widths: &WidthTable, goal: Option<i32>, moving: bool, position: i32) -> GripperStatus {
    let missed = goal.is_some_and(|goal| goal.abs_diff(position) > MISSED_COUNTS.unsigned_abs());
    GripperStatus { width_mm: widths.width_mm(position.into()), moving, object_detected: !moving && missed }
}
