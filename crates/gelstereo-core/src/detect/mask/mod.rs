//! From an image to marker components: background, threshold, closing, connected components and blob filter.

mod background;
pub(super) mod bit_rows;
pub(super) mod blob_filter;
pub mod blocks;
pub mod blur;
pub mod components;
pub mod morphology;
pub mod noise_level;
mod reflections;
pub(super) mod segmentation;
pub mod smooth;
pub mod threshold;
pub(super) mod usual_area;
mod walls;
