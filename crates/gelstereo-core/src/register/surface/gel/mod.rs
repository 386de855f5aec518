//! Gel model: predicted gel height over an indenter, and the pose that explains the measured heights best.

pub mod edges;
pub mod fit;
pub mod information;
pub mod lattice;
pub mod linear;
pub mod model;
pub mod objective;
pub mod prediction;
pub mod rest;
pub mod unsupported;
