//! Simulated stereo marker sensor: renders the camera images of a gel in contact, with ground truth.
//!
//! A [`Scene`] lists the parts of the simulation (rig, gel, indenter, trajectory) and the active
//! effects. Effects are independent: each is built only when the scene lists it, and draws from its own
//! random stream.
//!
//! The part presses from beyond the gel (larger z) and moves markers towards the camera (smaller z). The
//! base model is the rigid imprint: a marker under the part lies on the part, and every other marker
//! stays at rest. [`effects`] add the behaviour of a real gel and a real camera.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout))]

extern crate alloc;

pub mod effects;
mod lattice;
pub mod layer;
mod membrane;
pub mod plan;
mod render;
pub mod scene;
mod screened;
pub mod shapes;
pub mod simulator;
mod trajectory;

pub use effects::Effects;
pub use plan::{Asked, Plan, Switch, Switches};
pub use render::Ellipse;
pub use scene::{Gel, GelKeyframe, Images, Keyframe, OtherPart, Relief, Scene, SceneError};
pub use shapes::Shape;
pub use simulator::{ContactState, DotImage, Loads, PartLoads, Sight, Simulator, Truth};
