//! From a stereo frame of printed markers to the pose of the part in the hand.
//!
//! Modules in the order of the data flow:
//! [`image`] → [`detect`] → [`track`] → [`lattice`] → [`triangulate`] → [`contact`] → [`register`] →
//! [`frames`].
//! [`pipeline`] runs the sensing ones in that order, on scratch memory that is allocated once.
//!
//! The method is that of S. Cui et al., "In-Hand Object Localization Using a Novel High-Resolution
//! Visuotactile Sensor" (2021), called "the paper" throughout; `Eq. n`, `Algorithm 1` and `section` refer
//! to it.
//!
//! Names carry units and frames. Lengths are millimetres, angles radians and times seconds unless a name
//! states otherwise. `_px` is pixels, with the centre of the first pixel at (0, 0). `t_a_b` maps
//! coordinates of frame b to frame a. The sensor frame is the left camera's: x right, y down, z away from
//! the camera into the gel.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout))]

extern crate alloc;

pub mod camera;
pub mod color;
pub mod contact;
pub mod detect;
pub mod digest;
pub mod force;
pub mod frames;
pub mod image;
pub mod lattice;
pub mod layer;
pub mod math;
pub mod motion;
pub mod params;
pub mod pipeline;
pub mod register;
pub mod rig;
pub mod slip;
pub mod spatial;
pub mod stop;
pub mod surface;
pub mod track;
pub mod triangulate;
