//! Background subtraction row by row: which pixels are darker (or brighter) than the background by the
//! threshold.

use super::blocks::{BLOCK_PX, Blocks};
use super::blur::{FRACTION_BITS, GaussianBlur};
use super::noise_level::NoiseLevel;
use super::reflections::Reflections;
use super::smooth::Smoother;
use super::threshold::Thresholds;
use crate::image::GrayView;
use crate::params::{Background, DetectParams, Polarity, Threshold};
use alloc::vec::Vec;

/// Background subtraction by the chosen [`Background`] and [`Threshold`] rungs, with its scratch.
#[derive(Clone, Debug)]
pub struct Difference {
    polarity: Polarity,
    threshold: Threshold,
    threshold_levels: u8,
    rung: Rung,
    smoother: Smoother,
    noise: NoiseLevel,
    radius: usize,
    blocks: Blocks,
    thresholds: Thresholds,
    reflections: Reflections,
    /// Whether the current row of blocks is in a reflection or beside one.
    is_beside_reflection: bool,
    /// Smoothed image in whole levels, dark markers on a bright gel.
    smoothed: Vec<u8>,
    /// For each block, the level below which a smoothed pixel belongs to a marker.
    block_limits: Vec<u8>,
    /// Limits of the current row, per pixel: level to stay below, or least difference.
    limits: Limits,
}

#[derive(Clone, Debug)]
enum Rung {
    /// Both filtered images at full precision, as in the paper.
    Rows { smooth: GaussianBlur, background: GaussianBlur, smooth_row: Vec<u16>, background_row: Vec<u16> },
    /// Smoothed image against one background level per block.
    Blocks,
}

#[derive(Clone, Debug, Default)]
struct Limits {
    below: Vec<u8>,
    min: Vec<u16>,
}

impl Difference {
    /// Creates the stage from its settings.
    #[must_use]
    pub fn new(params: &DetectParams) -> Self {
        let kernel_px = params.background_kernel_px;
        Self {
            polarity: params.polarity,
            threshold: params.threshold,
            threshold_levels: params.threshold_levels,
            rung: match params.background {
                Background::Gaussian => Rung::Rows {
                    smooth: GaussianBlur::new(params.smooth_kernel_px),
                    background: GaussianBlur::new(kernel_px),
                    smooth_row: Vec::new(),
                    background_row: Vec::new(),
                },
                Background::Blocks => Rung::Blocks,
            },
            smoother: Smoother::new(params.smooth_kernel_px, params.polarity),
            noise: NoiseLevel::default(),
            radius: Blocks::radius_of(kernel_px),
            blocks: Blocks::default(),
            thresholds: Thresholds::default(),
            reflections: Reflections::new(kernel_px),
            is_beside_reflection: false,
            smoothed: Vec::new(),
            block_limits: Vec::new(),
            limits: Limits::default(),
        }
    }

    /// Prepares an image: computes the thresholds and, for the block rung, the background.
    pub fn survey(&mut self, image: GrayView<'_>) {
        let (width, height) = (image.width(), image.height());
        if self.threshold == Threshold::Auto || matches!(self.rung, Rung::Blocks) {
            self.smoothed.resize(width * height, 0);
            self.blocks.start(width, height);
            for (first, rows) in (0..).step_by(BLOCK_PX).zip(self.smoothed.chunks_mut(BLOCK_PX * width)) {
                for (y, row) in (first..).zip(rows.chunks_exact_mut(width)) {
                    self.smoother.row(image, y, row);
                }
                self.blocks.push(rows);
            }
            self.blocks.finish(self.radius, self.thresholds.scratch());
        }
        match self.threshold {
            Threshold::Fixed => self.thresholds.set_all(self.threshold_levels, width, height),
            Threshold::Auto => {
                let noise_levels = self.noise.sigma_levels(image) * self.smoother.noise_gain();
                self.thresholds.derive(&mut self.blocks, self.radius, noise_levels);
            }
        }
        if matches!(self.rung, Rung::Blocks) {
            self.block_limits.clear();
            let levels = self.thresholds.levels().iter().zip(self.blocks.background());
            self.block_limits.extend(levels.map(|(&min, &background)| {
                // A whole level differs by at least `min` if it is below the next whole limit.
                background.checked_sub(min).map_or(0, |limit| (limit >> FRACTION_BITS) as u8 + 1)
            }));
            if self.sees_reflections() {
                self.reflections.start(width);
            }
        }
    }

    /// Whether gel beside reflections has its own limits. Reflections are no brighter than bright markers.
    fn sees_reflections(&self) -> bool {
        self.threshold == Threshold::Auto && self.polarity == Polarity::Dark
    }

    /// Thresholds of the prepared image.
    pub const fn thresholds(&self) -> &Thresholds {
        &self.thresholds
    }

    /// Pixels of the last image that were closed around reflections, counted each time.
    pub const fn closed_px(&self) -> usize {
        self.reflections.closed_px()
    }

    /// Writes 255 where a pixel of row `y` of the prepared image differs by the threshold, else 0. Rows
    /// must be passed in order, from row 0 on.
    pub fn row(&mut self, image: GrayView<'_>, y: usize, mask: &mut [u8]) {
        let width = image.width();
        let sees_reflections = self.sees_reflections();
        let levels = self.thresholds.row(y);
        let Limits { below, min } = &mut self.limits;
        match &mut self.rung {
            Rung::Blocks => {
                let limits = &self.block_limits[y / BLOCK_PX * levels.len()..][..levels.len()];
                if y.is_multiple_of(BLOCK_PX) {
                    let floor_levels = self.thresholds.floor_levels();
                    self.is_beside_reflection = sees_reflections
                        && self.reflections.close_around(
                            y,
                            &self.smoothed,
                            width,
                            &self.blocks,
                            floor_levels,
                        );
                }
                if y.is_multiple_of(BLOCK_PX) || self.is_beside_reflection {
                    spread(limits, width, below);
                }
                if self.is_beside_reflection {
                    self.reflections.limit(y, width, &self.blocks, below);
                }
                darker(&self.smoothed[y * width..][..width], below, mask);
            }
            Rung::Rows { smooth, background, smooth_row, background_row } => {
                if y.is_multiple_of(BLOCK_PX) {
                    spread(levels, width, min);
                }
                smooth_row.resize(width, 0);
                background_row.resize(width, 0);
                smooth.row(image, y, smooth_row);
                background.row(image, y, background_row);
                let (bright, dark) = match self.polarity {
                    Polarity::Dark => (background_row, smooth_row),
                    Polarity::Bright => (smooth_row, background_row),
                };
                differing(bright, dark, min, mask);
            }
        }
    }
}

/// Expands one value per block to one value per pixel.
fn spread<T: Copy + Default>(blocks: &[T], width: usize, out: &mut Vec<T>) {
    out.resize(width, T::default());
    let (whole, last) = out.as_chunks_mut::<BLOCK_PX>();
    whole.iter_mut().zip(blocks).for_each(|(out, &value)| *out = [value; BLOCK_PX]);
    if let Some(&value) = blocks.last() {
        last.fill(value);
    }
}

fn darker(levels: &[u8], below: &[u8], mask: &mut [u8]) {
    for ((mask, &level), &below) in mask.iter_mut().zip(levels).zip(below) {
        *mask = if level < below { u8::MAX } else { 0 };
    }
}

fn differing(bright: &[u16], dark: &[u16], min: &[u16], mask: &mut [u8]) {
    for (((mask, &bright), &dark), &min) in mask.iter_mut().zip(bright).zip(dark).zip(min) {
        *mask = if bright.saturating_sub(dark) >= min { u8::MAX } else { 0 };
    }
}
