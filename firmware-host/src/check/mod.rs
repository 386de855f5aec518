//! Whether a configuration would work here, point by point.

use crate::config::{Config, SourceConfig};
use crate::part::Part;
use crate::run::Setup;
use std::path::Path;

/// One point that was checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// What was checked.
    pub subject: &'static str,
    /// What was found, or what is wrong and what would be valid.
    pub result: Result<String, String>,
}

/// Checks the configuration's values, the part, the devices and where the recording would go. Nothing moves, and no
/// existing recording is touched.
#[must_use]
pub fn check(config: &Config) -> Vec<Finding> {
    let text = |result: Result<String, &dyn std::error::Error>| result.map_err(|error| error.to_string());
    let values = config.validate();
    let mut findings = vec![Finding {
        subject: "configuration",
        result: match &values {
            Ok(()) => Ok(format!("valid, preset \"{}\"", config.preset)),
            Err(error) => text(Err(error)),
        },
    }];
    let part = Part::load(&config.part.shape).and_then(|part| {
        let template = part.template(&config.part)?;
        let (low, high) = part.mesh.bounds_mm();
        let size = high - low;
        Ok(format!(
            "{:.2} x {:.2} x {:.2} mm, template of {} points",
            size.x,
            size.y,
            size.z,
            template.points_mm().len()
        ))
    });
    findings.push(Finding { subject: "part", result: part.map_err(|error| error.to_string()) });
    if values.is_ok() {
        findings.push(Finding {
            subject: "devices",
            result: match Setup::new(config) {
                Ok(setup) => Ok(describe(config, &setup)),
                Err(error) => text(Err(&error)),
            },
        });
    }
    findings.push(Finding { subject: "recording", result: writable(&config.recording.path) });
    findings
}

fn describe(config: &Config, setup: &Setup) -> String {
    match &config.source {
        SourceConfig::Simulated => "simulated sensor, gripper and robot".to_owned(),
        SourceConfig::Folder { path, .. } => format!(
            "{} pairs in {}, simulated gripper and robot",
            setup.devices.source.len_hint().unwrap_or(0),
            path.display()
        ),
    }
}

/// Tries to write beside the recording.
fn writable(path: &Path) -> Result<String, String> {
    let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let wrong = |error: std::io::Error| {
        format!("cannot write in {}: {error}; choose another recording.path", folder.display())
    };
    std::fs::create_dir_all(folder).map_err(wrong)?;
    let probe = folder.join(".gelstereo-host-check");
    std::fs::write(&probe, []).map_err(wrong)?;
    std::fs::remove_file(&probe).map_err(wrong)?;
    Ok(path.display().to_string())
}
