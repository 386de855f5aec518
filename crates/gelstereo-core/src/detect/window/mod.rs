//! Small windows of an image: their position, classification and components.

pub(super) mod classifier;
mod lanes;
pub(super) mod pieces;
pub(super) mod pixels;
pub(super) mod roi;
pub(super) mod size;
pub(super) mod sized;
