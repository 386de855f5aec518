//! Motion of a part in the hand without a model of it.
//!
//! [`MotionTracker`] follows a part from keyframe to keyframe. Markers that stick are points of the part;
//! its motion since the keyframe is the rigid motion of these points. Other markers in contact are on the
//! part's surface; their distances from the surface of the keyframe determine the motion of a part that
//! slides. Each marker is used once, so that its noise is not counted twice.
//!
//! A surface that comes back closes a loop: the motion between both keyframes is measured once more, and all
//! keyframes between are corrected by their covariance with it.
//!
//! A part rolls if the contact moves over the part and over the gel in the same direction (Montana 1988,
//! "The kinematics of contact and grasp").

mod answer;
mod chain;
mod cloud;
mod fit;
mod joint;
mod loops;
mod recognize;
mod tracker;
mod travel;

pub use answer::{MotionSource, MotionStatus, PartMotion, SurfacePoint};
pub use recognize::{KnownSurface, Recognition, RecognitionStatus};
pub use tracker::MotionTracker;
pub use travel::{MotionKind, Travel};
