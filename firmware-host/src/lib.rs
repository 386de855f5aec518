//! gelstereo on the robot's computer: frame sources, grippers, robots, recordings and the job.
//!
//! The only crate with clocks, files and threads. The job knows its devices by their traits; the simulated world
//! stands behind all three of them, or real devices do.

pub mod check;
pub mod config;
pub mod gripper;
pub mod job;
pub mod notes;
pub mod part;
pub mod recording;
pub mod replay;
pub mod report;
pub mod robot;
pub mod run;
pub mod sensing;
pub mod simulate;
pub mod source;
pub mod world;
