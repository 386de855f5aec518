//! What grippers of one bus servo have in common.

use super::{GripperStatus, WidthTable};

/// An instruction is sent so often before the servo counts as silent. One lost byte must not stop a robot.
pub(super) const ATTEMPTS: u32 = 3;
/// A goal that is missed by more counts than this was stopped by something: 2 degrees of 4096 counts a turn, the play of a
/// geared finger. No servo was at hand to measure it.
const MISSED_COUNTS: i32 = 23;

/// The state of a servo that went to `goal` and stands, or moves, at `position`.
pub(super) fn status(widths: &WidthTable, goal: Option<i32>, moving: bool, position: i32) -> GripperStatus {
    let missed = goal.is_some_and(|goal| goal.abs_diff(position) > MISSED_COUNTS.unsigned_abs());
    GripperStatus { width_mm: widths.width_mm(position.into()), moving, object_detected: !moving && missed }
}
