//! From ink to grey levels: the gel below it, light, smears, noise and rounding.

use super::lens::Lens;
use crate::effects::{Blur, Gain, Noise, Shots, SmearsOfView, Texture};
use alloc::vec::Vec;
use gelstereo_core::math::random::Stream;

/// What turns the ink of one view into an image.
pub(crate) struct Finish<'a> {
    pub(crate) base: &'a Base,
    /// Level of full ink less that of the gel.
    pub(crate) contrast: f32,
    /// `None` when the ink is lit already, or light is even.
    pub(crate) gain: Option<&'a Gain>,
    pub(crate) smears: Option<&'a SmearsOfView>,
    pub(crate) time_s: f64,
    /// As `noise`.
    pub(crate) shots: Option<(&'a Shots, Stream)>,
    /// The noise and its numbers for this image.
    pub(crate) noise: Option<(&'a Noise, Stream)>,
}

/// The gel without ink, as the lens shows it: nothing of it moves, so it is worked out once.
#[derive(Clone, Debug)]
pub(crate) enum Base {
    /// One row for all.
    Even(Vec<f32>),
    Uneven(Vec<f32>),
}

impl Base {
    pub(crate) fn new(
        gel_level: f32,
        grain: Option<&Texture>,
        gain: Option<&Gain>,
        lens: Option<Lens>,
        [width, height]: [usize; 2],
    ) -> Self {
        if grain.is_none() && gain.is_none() {
            return Self::Even(alloc::vec![gel_level; width]);
        }
        let mut levels = alloc::vec![gel_level; width * height];
        if let Some(grain) = grain {
            grain.apply(&mut levels);
        }
        if let Some(gain) = gain {
            let rows = levels.chunks_exact_mut(width).enumerate();
            for (y, row) in rows {
                row.iter_mut().zip(gain.of_row(y)).for_each(|(level, gain)| *level *= gain);
            }
        }
        if let Some(lens) = lens {
            Blur::of_pixels(lens).apply(&mut levels, width);
        }
        Self::Uneven(levels)
    }

    fn row(&self, y: usize, width: usize) -> &[f32] {
        match self {
            Self::Even(row) => row,
            Self::Uneven(levels) => &levels[y * width..][..width],
        }
    }
}

impl Finish<'_> {
    /// Turns the ink that every pixel sees into levels, and leaves none of it. `levels` holds a row meanwhile.
    pub(crate) fn develop(
        mut self,
        ink: &mut [f32],
        width: usize,
        levels: &mut Vec<f32>,
        image: &mut Vec<u8>,
    ) {
        levels.resize(width, 0.0);
        image.resize(ink.len(), 0);
        let rows = ink.chunks_exact_mut(width).zip(image.chunks_exact_mut(width));
        for (y, (ink, image)) in rows.enumerate() {
            self.lay(y, ink, levels);
            if let Some(smears) = self.smears {
                smears.apply(self.time_s, y, levels);
            }
            if let Some((shots, stream)) = &mut self.shots {
                shots.add(stream, levels);
            }
            if let Some((noise, stream)) = &mut self.noise {
                noise.add(stream, levels);
            }
            round(levels, image);
        }
    }

    /// Ink over the gel, of which none is left.
    fn lay(&self, y: usize, ink: &mut [f32], levels: &mut [f32]) {
        let gel = self.base.row(y, ink.len());
        let inked = levels.iter_mut().zip(ink).zip(gel);
        match self.gain {
            Some(gain) => inked.zip(gain.of_row(y)).for_each(|(((level, ink), gel), gain)| {
                *level = gel + self.contrast * gain * core::mem::take(ink);
            }),
            None => inked.for_each(|((level, ink), gel)| *level = gel + self.contrast * core::mem::take(ink)),
        }
    }
}

/// To the nearest level from 0 to 255. Beyond 2^23 numbers are whole, so that adding it rounds, and the lowest bits are
/// the level.
fn round(levels: &[f32], image: &mut [u8]) {
    const WHOLE: f32 = 8_388_608.0;
    for (pixel, &level) in image.iter_mut().zip(levels) {
        // `f32::clamp` keeps a NaN, which nobody hands over, and takes longer.
        let positive = if level > 0.0 { level } else { 0.0 };
        let within = if positive < 255.0 { positive } else { 255.0 };
        *pixel = (within + WHOLE).to_bits() as u8;
    }
}
