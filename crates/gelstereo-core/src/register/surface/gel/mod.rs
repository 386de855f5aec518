//! The gel's model: how high it stands over a part that is pressed into it, and the pose that explains the heights best.

pub mod edges;
pub mod fit;
pub mod information;
pub mod lattice;
pub mod linear;
pub mod model;
pub mod prediction;
pub mod rest;
pub mod unsupported;
