//! Small windows of an image: their position, classification and components.

pub(super) mod classifier;
pub(super) mod components;
mod lanes;
pub(super) mod pixels;
pub(super) mod roi;
pub(super) mod size;
pub(super) mod sized;
