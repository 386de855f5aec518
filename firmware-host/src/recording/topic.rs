//! What a recording holds.

use super::schemas::{self, Schema};

/// What a recording holds, one MCAP channel each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// Left image, mono8.
    LeftImage,
    /// Right image, mono8.
    RightImage,
    /// All markers as a cloud, metres.
    Points,
    /// Evidence of a frame and its digest, JSON.
    Frame,
    /// The part in the sensor frame with its covariance, metres and radians.
    Pose,
    /// The gripper's width, metres.
    Gripper,
    /// The gripper in the robot's base, metres.
    Robot,
    /// Stages of the job and what was asked of the pipeline, JSON.
    Stage,
    /// How a pair was captured, and what happened to its source, JSON.
    Capture,
}

impl Topic {
    /// All of them, in the order of their channels.
    pub const ALL: [Self; 9] = [
        Self::LeftImage,
        Self::RightImage,
        Self::Points,
        Self::Frame,
        Self::Pose,
        Self::Gripper,
        Self::Robot,
        Self::Stage,
        Self::Capture,
    ];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LeftImage => "/gelstereo/left/image",
            Self::RightImage => "/gelstereo/right/image",
            Self::Points => "/gelstereo/points",
            Self::Frame => "/gelstereo/frame",
            Self::Pose => "/gelstereo/pose",
            Self::Gripper => "/gripper/state",
            Self::Robot => "/robot/gripper_pose",
            Self::Stage => "/gelstereo/stage",
            Self::Capture => "/gelstereo/capture",
        }
    }

    /// Its message type.
    #[must_use]
    pub const fn schema(self) -> Schema {
        match self {
            Self::LeftImage | Self::RightImage => schemas::IMAGE,
            Self::Points => schemas::POINT_CLOUD,
            Self::Frame | Self::Stage | Self::Capture => schemas::STRING,
            Self::Pose => schemas::POSE_WITH_COVARIANCE,
            Self::Gripper => schemas::JOINT_STATE,
            Self::Robot => schemas::POSE,
        }
    }

    /// The topic of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }
}
