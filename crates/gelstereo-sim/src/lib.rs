//! A simulated stereo marker sensor: what its cameras would see of a gel in contact, with ground truth.
//!
//! A [`Scene`] lists what there is (rig, gel, indenter, trajectory) and which effects act. Every effect is a piece
//! of its own: it is built only when the scene lists it, and draws from a random stream of its own.
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

pub mod scene;
pub mod shapes;
pub mod simulator;

pub use scene::{Scene, SceneError};
pub use shapes::Shape;
pub use simulator::{ContactState, Simulator, Truth};
