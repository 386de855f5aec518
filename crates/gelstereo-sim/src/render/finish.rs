//! From ink to grey levels: the gel behind the ink, light, smears, noise and rounding.

use super::lens::Lens;
use crate::effects::{Blur, Gain, Noise, RUN, Shots, SmearsOfView, Texture};
use alloc::vec::Vec;
use gelstereo_core::math::random::Stream;

/// Converts the ink of one view into an image.
pub(crate) struct Finish<'a> {
    pub(crate) base: &'a Base,
    /// Level of full ink minus that of the gel.
    pub(crate) contrast: f32,
    /// `None` when the ink is already lit, or the light is even.
    pub(crate) gain: Option<&'a Gain>,
    pub(crate) smears: Option<&'a SmearsOfView>,
    pub(crate) time_s: f64,
    /// The shot noise and its random stream for this image.
    pub(crate) shots: Option<(&'a Shots, Stream)>,
    /// The noise and its random stream for this image.
    pub(crate) noise: Option<(&'a Noise, Stream)>,
}

/// The gel without ink, behind the lens: it is static and computed once.
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
                let (share, columns) = gain.of_row(y);
                row.iter_mut().zip(columns).for_each(|(level, column)| *level *= Gain::of(share, *column));
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

/// Pixels that are finished at once: they share one random number for noise.
const PIECE: usize = 2 * RUN;

type Piece = [f32; PIECE];

impl Finish<'_> {
    /// Converts the ink of every pixel to levels, and resets the ink to 0. `row` is a buffer for effects
    /// that act on whole rows.
    pub(crate) fn develop(mut self, ink: &mut [f32], width: usize, row: &mut Vec<f32>, image: &mut Vec<u8>) {
        image.resize(ink.len(), 0);
        row.resize(width, 0.0);
        let mut noise = self.noise.take();
        let rows = ink.chunks_exact_mut(width).zip(image.chunks_exact_mut(width));
        for (y, (ink, image)) in rows.enumerate() {
            let behind = (self.base.row(y, width), self.gain.map(|gain| gain.of_row(y)));
            if self.smears.is_none() && self.shots.is_none() {
                noise = lay(self.contrast, behind, ink, image, noise);
                continue;
            }
            lay(self.contrast, behind, ink, row, None);
            self.spoil(y, row);
            for (levels, image) in row.chunks(PIECE).zip(image.chunks_mut(PIECE)) {
                image.copy_from_slice(&expose(padded(levels), &mut noise)[..levels.len()]);
            }
        }
    }

    /// Effects that act on whole rows.
    fn spoil(&mut self, y: usize, row: &mut [f32]) {
        if let Some(smears) = self.smears {
            smears.apply(self.time_s, y, row);
        }
        if let Some((shots, stream)) = &mut self.shots {
            shots.add(stream, row);
        }
    }
}

/// Output of a piece of levels. (By value and in one place, so that it vectorises.)
trait Kept: Copy {
    fn of(levels: Piece, noise: &mut Option<(&Noise, Stream)>) -> [Self; PIECE];
}

/// The levels, before noise.
impl Kept for f32 {
    #[inline(always)]
    fn of(levels: Piece, _noise: &mut Option<(&Noise, Stream)>) -> Piece {
        levels
    }
}

/// The pixels.
impl Kept for u8 {
    #[inline(always)]
    fn of(levels: Piece, noise: &mut Option<(&Noise, Stream)>) -> [Self; PIECE] {
        expose(levels, noise)
    }
}

/// Composites a row's ink over the gel, with the gain (the row's term and the columns' terms), and
/// resets the ink to 0. Returns the noise.
fn lay<'a, T: Kept>(
    contrast: f32,
    (gel, gain): (&[f32], Option<(f32, &[f32])>),
    ink: &mut [f32],
    kept: &mut [T],
    mut noise: Option<(&'a Noise, Stream)>,
) -> Option<(&'a Noise, Stream)> {
    let (inks, ink) = ink.as_chunks_mut();
    let (all_kept, kept) = kept.as_chunks_mut();
    let (gels, gel) = gel.as_chunks();
    let (share, columns) = gain.unwrap_or_default();
    let (gains, last) = columns.as_chunks();
    for (k, ((ink, gel), kept)) in inks.iter_mut().zip(gels).zip(all_kept).enumerate() {
        *kept = T::of(lit(contrast, (share, gains.get(k)), *gel, *ink), &mut noise);
        *ink = [0.0; PIECE];
    }
    if !ink.is_empty() {
        let last = gain.map(|_| padded(last));
        let levels = lit(contrast, (share, last.as_ref()), padded(gel), padded(ink));
        kept.copy_from_slice(&T::of(levels, &mut noise)[..ink.len()]);
        ink.fill(0.0);
    }
    noise
}

/// Levels of ink over the gel, with the gain's terms if light is uneven.
#[inline(always)]
fn lit(contrast: f32, (row, columns): (f32, Option<&Piece>), gel: Piece, ink: Piece) -> Piece {
    match columns {
        Some(columns) => over(gel, core::array::from_fn(|k| contrast * Gain::of(row, columns[k])), ink),
        None => over(gel, [contrast; PIECE], ink),
    }
}

#[inline(always)]
fn over(gel: Piece, contrast: Piece, ink: Piece) -> Piece {
    core::array::from_fn(|k| gel[k] + contrast[k] * ink[k])
}

fn padded(levels: &[f32]) -> Piece {
    let mut piece = [0.0; PIECE];
    piece[..levels.len()].copy_from_slice(levels);
    piece
}

/// Adds noise and rounds to the nearest level from 0 to 255. Numbers above 2^23 are whole, so adding
/// 2^23 rounds, and the lowest bits are the level.
#[inline(always)]
fn expose(levels: Piece, noise: &mut Option<(&Noise, Stream)>) -> [u8; PIECE] {
    const WHOLE: f32 = 8_388_608.0;
    let levels = match noise {
        Some((noise, stream)) => {
            let noise = noise.next(stream);
            core::array::from_fn(|k| levels[k] + noise[k])
        }
        None => levels,
    };
    levels.map(|level| {
        // `f32::clamp` keeps NaN, which does not occur here, and is slower.
        let within = if level < 255.0 { level } else { 255.0 };
        let positive = if within > 0.0 { within } else { 0.0 };
        (positive + WHOLE).to_bits() as u8
    })
}
