//! From stereo images to points and contact. The build script runs this too, for the digests to expect.

use crate::rig::{SIZE_PX, rig};
use alloc::boxed::Box;
use gelstereo_core::image::{GrayView, ImageError};
use gelstereo_core::params::Params;
use gelstereo_core::pipeline::{Frame, Pipeline};

/// A result, or an error to print.
pub type Outcome<T> = Result<T, Box<dyn core::error::Error>>;

/// Frames that are sensed. The map from pixels to points is fitted in steps over the first ones, so that
/// later ones take less work.
pub const FRAMES: usize = 16;

/// Image pairs: at rest, then pressed deeper and deeper.
pub const PAIRS: usize = 4;

/// The pair of a frame: the part comes, goes, and comes again. The last frame has the deepest press.
pub const fn pair_of(frame: usize) -> usize {
    let place = frame % (2 * PAIRS - 2);
    if place < PAIRS { place } else { 2 * PAIRS - 2 - place }
}

/// The settings of a preset.
pub fn preset(name: &str) -> Outcome<Params> {
    Ok(Params::preset(name).ok_or("there is no such preset; Params::PRESETS lists them")?)
}

/// The pipeline, and the results of the last frame.
pub struct Sensing {
    pipeline: Pipeline,
    pub frame: Frame,
}

impl Sensing {
    pub fn new(params: &Params) -> Outcome<Self> {
        Ok(Self { pipeline: Pipeline::new(&rig(), params)?, frame: Frame::default() })
    }

    /// Processes a pair: the pixels of the left image, then those of the right one.
    pub fn sense(&mut self, pair: &[u8]) -> Outcome<()> {
        let (left, right) = pair.split_at(pair.len() / 2);
        Ok(self.pipeline.process(view(left)?, view(right)?, &mut self.frame)?)
    }
}

fn view(pixels: &[u8]) -> Result<GrayView<'_>, ImageError> {
    let [width_px, height_px] = SIZE_PX;
    GrayView::new(pixels, width_px, height_px, width_px)
}
