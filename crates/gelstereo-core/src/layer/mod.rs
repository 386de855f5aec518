//! The gel as an elastic layer: linear elasticity, bonded to a rigid plate below, unbounded sideways.
//!
//! [`Layer`] has the compliances by wave number, and [`Influence`] the motion of the surface around one
//! rectangular cell under a traction. Tractions are in units of Young's modulus.

mod free_sides;
mod influence;
mod kernel;
mod uneven;

pub use free_sides::{FreeSides, Image};
pub use influence::Influence;
pub use kernel::{Compliance, Layer};
pub use uneven::Uneven;

/// Newtons of a kilopascal on a square millimetre.
pub const N_PER_KPA_MM2: f64 = 1e-3;
