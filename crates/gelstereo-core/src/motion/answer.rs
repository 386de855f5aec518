//! What is known of a part's motion.

use super::travel::{MotionKind, Travel};
use crate::math::{DVec3, Pose};
use crate::slip::{RigidMotion, Slip};

/// How well a motion is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[repr(u8)]
pub enum MotionStatus {
    /// First frame of a contact: the motion is the identity by definition.
    #[default]
    Started = 0,
    /// All directions are determined.
    Tracked = 1,
    /// Some directions are not determined; their variance is that of `motion.free_turn_rad` and
    /// `motion.free_shift_mm` for each frame.
    Partial = 2,
    /// Neither markers nor surface determine a direction.
    Predicted = 3,
}

impl MotionStatus {
    /// All values with their names.
    pub const ALL: [(&'static str, Self); 4] = [
        ("STARTED", Self::Started),
        ("TRACKED", Self::Tracked),
        ("PARTIAL", Self::Partial),
        ("PREDICTED", Self::Predicted),
    ];
}

/// What a motion is found from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[repr(u8)]
pub enum MotionSource {
    /// Nothing: the part is where it was, with a larger variance.
    #[default]
    Nothing = 0,
    /// Markers that stick.
    Markers = 1,
    /// The surface of the contact.
    Surface = 2,
    /// Both.
    Both = 3,
}

impl MotionSource {
    /// All values with their names.
    pub const ALL: [(&'static str, Self); 4] = [
        ("NOTHING", Self::Nothing),
        ("MARKERS", Self::Markers),
        ("SURFACE", Self::Surface),
        ("BOTH", Self::Both),
    ];
}

/// Motion of a part in one frame of a contact. The part's frame is the sensor frame at first touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartMotion {
    /// How well it is known.
    pub status: MotionStatus,
    /// What it is found from.
    pub source: MotionSource,
    /// How the part moves along the gel.
    pub kind: MotionKind,
    /// Motion since first touch.
    pub since_touch: RigidMotion,
    /// Motion since the last frame.
    pub step: RigidMotion,
    /// Pose of the keyframe of this frame: the motion from first touch to there.
    pub keyframe_pose: Pose,
    /// Number of directions, of six, that markers and surface determine better than
    /// `motion.free_turn_rad` and `motion.free_shift_mm`.
    pub determined: u8,
    /// Contacts before this one.
    pub contact: u32,
    /// Keyframes of this contact before the one that this frame is compared with.
    pub keyframe: u32,
    /// Loops closed in this contact up to this frame. The pose jumps in the frame that closes one, and
    /// earlier poses are corrected: see [`MotionTracker::keyframes`](super::MotionTracker::keyframes).
    pub loops: u32,
    /// Markers that have stuck since the keyframe.
    pub stuck: u32,
    /// Markers compared with the keyframe's surface.
    pub surface: u32,
    /// How far the contact has moved over the part and over the gel.
    pub travel: Travel,
    /// Slip of the contact.
    pub slip: Slip,
}

/// A point of a part's surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position, part frame.
    pub point_mm: DVec3,
    /// Unit normal out of the part.
    pub normal: DVec3,
    /// Variance of the position along the normal, by the noise of the marker, and by edges that are sharper
    /// than the markers' distance shows.
    pub variance_mm2: f64,
}
