//! Checks point by point whether a configuration would work on this computer.

pub mod disk;
mod hardware;

use crate::compliance;
use crate::config::{Config, RobotConfig, SourceConfig};
use crate::finding::Finding;
use crate::part::Part;
use crate::run::Setup;
use crate::source::FolderSource;

/// Checks the configuration's values, the part, the devices and the location of the recording. Nothing
/// moves, and existing recordings are not modified.
#[must_use]
pub fn check(config: &Config) -> Vec<Finding> {
    let values = config.validate();
    let mut findings = vec![match &values {
        Ok(()) => Finding::ok("configuration", format!("valid, preset \"{}\"", config.preset)),
        Err(error) => Finding::wrong("configuration", error.to_string()),
    }];
    let task = config.validate_task();
    findings.extend(task.as_ref().err().map(|error| Finding::wrong("task", error.to_string())));
    findings.push(part(config));
    findings.extend(compliance(config));
    findings.extend(hardware::examine(config));
    if values.is_ok() && task.is_ok() {
        findings.extend(devices(config));
    }
    // An empty path is already reported with the values.
    if config.recording.path.file_name().is_some() {
        findings.push(disk::examine(config));
    }
    findings
}

fn part(config: &Config) -> Finding {
    let part = Part::load(&config.part.shape).and_then(|part| {
        let template = part.template(&config.part)?;
        let (low, high) = part.mesh.bounds_mm();
        let size = high - low;
        let points = template.points_mm().len();
        Ok(format!("{:.2} x {:.2} x {:.2} mm, template of {points} points", size.x, size.y, size.z))
    });
    match part {
        Ok(found) => Finding::ok("part", found),
        Err(error) => Finding::wrong("part", error.to_string()),
    }
}

/// Reads the compliance matrix, if there is one, and compares it with the settings.
fn compliance(config: &Config) -> Option<Finding> {
    const SUBJECT: &str = "compliance";
    let matrix = match compliance::load(config) {
        Ok(matrix) => matrix?,
        Err(error) => return Some(Finding::wrong(SUBJECT, error.to_string())),
    };
    let (gel, fit) = (matrix.gel(), matrix.check_settings(&config.params));
    let found = format!("{} x {} markers, gel {} mm thick", gel.rows, gel.cols, gel.layer.thickness_mm);
    Some(match fit {
        Ok(()) => Finding::ok(SUBJECT, found),
        Err(error) => Finding::wrong(SUBJECT, error.to_string()),
    })
}

/// Opens the devices that the job opens.
fn devices(config: &Config) -> Vec<Finding> {
    let mut findings = Vec::new();
    match Setup::new(config) {
        Ok(setup) => findings.push(Finding::ok("devices", describe(config, &setup))),
        Err(error) => findings.push(Finding::wrong("devices", error.to_string())),
    }
    if let SourceConfig::Folder { path, frame_rate_hz } = &config.source
        && let Ok(mut source) = FolderSource::open(path, *frame_rate_hz)
    {
        findings.push(images(config, &mut source));
    }
    findings
}

/// Checks that the image size matches the rig, and counts missing images.
fn images(config: &Config, source: &mut FolderSource) -> Finding {
    const SUBJECT: &str = "images";
    let dropped = source.dropped();
    let (size, rig) = match (source.size_px(), config.rig()) {
        (Ok(size), Ok(rig)) => (size, rig),
        (Err(error), _) => return Finding::wrong(SUBJECT, error.to_string()),
        (_, Err(error)) => return Finding::wrong(SUBJECT, error.to_string()),
    };
    let found = format!("{} x {} px", size.0, size.1);
    for camera in [&rig.left, &rig.right] {
        if size != (camera.width_px, camera.height_px) {
            let rig = format!("the rig is of {} x {} px", camera.width_px, camera.height_px);
            let advice = "calibrate with images of this size, or take the images at the rig's";
            return Finding::wrong(SUBJECT, format!("{found}, but {rig}")).with_advice(advice);
        }
    }
    if dropped > 0 {
        let advice = "time goes on over the gaps; rename the files if there are none";
        return Finding::warn(
            SUBJECT,
            format!("{found}; {dropped} pairs are missing in the numbering"),
            advice,
        );
    }
    Finding::ok(SUBJECT, found)
}

fn describe(config: &Config, setup: &Setup) -> String {
    let source = match &config.source {
        SourceConfig::Simulated => "simulated sensor".to_owned(),
        SourceConfig::Folder { path, .. } => {
            format!("{} pairs in {}", setup.devices.source.len_hint().unwrap_or(0), path.display())
        }
        SourceConfig::Camera(camera) => {
            let right = camera.right_device.iter().map(|right| format!(" and {right}"));
            format!("camera {}{}", camera.device, right.collect::<String>())
        }
        SourceConfig::Stream(stream) => format!("frames through {}", stream.name()),
    };
    let gripper = config.gripper.port().map_or_else(|| "simulated gripper".to_owned(), gripper_on);
    let robot = match &config.robot {
        RobotConfig::Simulated => "simulated robot".to_owned(),
        RobotConfig::Bridge { address, .. } => format!("robot at {address}"),
    };
    format!("{source}, {gripper}, {robot}")
}

fn gripper_on(port: &str) -> String {
    format!("gripper on {port}")
}
