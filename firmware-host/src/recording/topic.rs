//! Topics of a recording.

use super::schemas::{self, Schema};

/// Topics of a recording, one MCAP channel each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// Left image, mono8.
    LeftImage,
    /// Right image, mono8.
    RightImage,
    /// Left image, PNG or as sent by the camera.
    LeftCompressed,
    /// Right image, PNG or as sent by the camera.
    RightCompressed,
    /// Both images in one, as sent by the camera.
    StereoCompressed,
    /// All markers as a point cloud, metres.
    Points,
    /// Figures and digest of a frame, JSON.
    Frame,
    /// Part pose in the sensor frame with its covariance, metres and radians.
    Pose,
    /// Force and torque of the part on the gel, newtons and newton metres.
    Wrench,
    /// Gripper width, metres.
    Gripper,
    /// Gripper pose in the robot's base frame, metres.
    Robot,
    /// Stages of the job and pipeline actions, JSON.
    Stage,
    /// Capture data of a pair and events of its source, JSON.
    Capture,
    /// Contact state, JSON.
    Contact,
    /// Slip of the part along the gel, JSON.
    Slip,
}

impl Topic {
    /// All topics, in the order of their channels.
    pub const ALL: [Self; 15] = [
        Self::LeftImage,
        Self::RightImage,
        Self::LeftCompressed,
        Self::RightCompressed,
        Self::StereoCompressed,
        Self::Points,
        Self::Frame,
        Self::Pose,
        Self::Wrench,
        Self::Gripper,
        Self::Robot,
        Self::Stage,
        Self::Capture,
        Self::Contact,
        Self::Slip,
    ];

    /// Name of the topic.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LeftImage => "/gelstereo/left/image",
            Self::RightImage => "/gelstereo/right/image",
            Self::LeftCompressed => "/gelstereo/left/image/compressed",
            Self::RightCompressed => "/gelstereo/right/image/compressed",
            Self::StereoCompressed => "/gelstereo/stereo/image/compressed",
            Self::Points => "/gelstereo/points",
            Self::Frame => "/gelstereo/frame",
            Self::Pose => "/gelstereo/pose",
            Self::Wrench => "/gelstereo/wrench",
            Self::Gripper => "/gripper/state",
            Self::Robot => "/robot/gripper_pose",
            Self::Stage => "/gelstereo/stage",
            Self::Capture => "/gelstereo/capture",
            Self::Contact => "/gelstereo/contact",
            Self::Slip => "/gelstereo/slip",
        }
    }

    /// Message type of the topic.
    #[must_use]
    pub const fn schema(self) -> Schema {
        match self {
            Self::LeftImage | Self::RightImage => schemas::IMAGE,
            Self::LeftCompressed | Self::RightCompressed | Self::StereoCompressed => {
                schemas::COMPRESSED_IMAGE
            }
            Self::Points => schemas::POINT_CLOUD,
            Self::Frame | Self::Stage | Self::Capture | Self::Contact | Self::Slip => schemas::STRING,
            Self::Pose => schemas::POSE_WITH_COVARIANCE,
            Self::Wrench => schemas::WRENCH,
            Self::Gripper => schemas::JOINT_STATE,
            Self::Robot => schemas::POSE,
        }
    }

    /// Finds a topic by its name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }
}
