//! Small windows of an image: where they lie, what they show, and the pieces that their mask falls into.

pub(super) mod classifier;
mod lanes;
pub(super) mod pieces;
pub(super) mod pixels;
pub(super) mod roi;
pub(super) mod size;
pub(super) mod sized;
