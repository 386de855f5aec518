//! A simulated stereo marker sensor: what its cameras would see of a gel in contact, with ground truth.
//!
//! A [`Scene`] lists what there is (rig, gel, indenter, trajectory) and which effects act. Every effect is a
//! piece of its own: it is built only when the scene lists it, and draws from a random stream of its own.
//!
//! The part presses from beyond (larger z) and moves markers towards the camera (smaller z). The base is the
//! rigid imprint: a marker under the part lies on the part, every other one stays at rest. [`effects`] add what
//! a real gel and a real camera do to that.
#![no_std]
#![forbid(unsafe_code)]

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
pub use scene::{Gel, GelKeyframe, Images, Keyframe, Scene, SceneError};
pub use shapes::Shape;
pub use simulator::{ContactState, DotImage, Sight, Simulator, Truth};
