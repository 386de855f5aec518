//! Which hardware a configuration needs, and what of it is there.

use crate::config::{Config, SourceConfig};
use crate::finding::Finding;

/// One line for each device that the job has: the camera, its light, the gripper and the robot.
pub(crate) fn examine(config: &Config) -> Vec<Finding> {
    vec![
        camera(config),
        Finding::ok("light", "none is set; lights with their own switch need no setting"),
        Finding::ok("gripper", "simulated; no hardware needed"),
        Finding::ok("robot", "simulated; no hardware needed"),
    ]
}

fn camera(config: &Config) -> Finding {
    const SUBJECT: &str = "camera";
    match &config.source {
        SourceConfig::Simulated => Finding::ok(SUBJECT, "simulated; no hardware needed"),
        SourceConfig::Folder { path, .. } => {
            Finding::ok(SUBJECT, format!("none needed; images come from {}", path.display()))
        }
    }
}
