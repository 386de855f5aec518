//! gelstereo on the robot's computer: frame sources, grippers, robots, recordings and the robot task.
//!
//! The only crate with clocks, files, threads and devices. The task accesses its devices through traits;
//! the simulated world or real devices implement all three.
//!
//! Without the feature `host` only the parts shared with the Python bindings are compiled: codecs,
//! cameras and HID devices.
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout))]

pub mod camera;
#[cfg(feature = "host")]
pub mod check;
pub mod codec;
#[cfg(feature = "host")]
pub mod compliance;
#[cfg(feature = "host")]
pub mod config;
#[cfg(feature = "host")]
pub mod doctor;
#[cfg(feature = "host")]
pub mod finding;
pub mod gripper;
pub mod hid;
#[cfg(feature = "host")]
pub mod light;
#[cfg(feature = "host")]
pub mod notes;
#[cfg(feature = "host")]
pub mod part;
#[cfg(feature = "host")]
pub mod publish;
#[cfg(feature = "host")]
pub mod recording;
#[cfg(feature = "host")]
pub mod replay;
#[cfg(feature = "host")]
pub mod report;
#[cfg(feature = "host")]
mod rest_noise;
#[cfg(feature = "host")]
pub mod robot;
#[cfg(feature = "host")]
pub mod run;
#[cfg(feature = "host")]
pub mod sense;
#[cfg(feature = "host")]
pub mod sensing;
#[cfg(feature = "host")]
pub mod simulate;
pub mod source;
#[cfg(feature = "host")]
pub mod task;
#[cfg(feature = "host")]
pub mod taught;
#[cfg(feature = "host")]
pub mod world;
