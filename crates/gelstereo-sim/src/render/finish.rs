//! From ink to grey levels: the gel below it, light, smears, noise and rounding.

use super::lens::Lens;
use crate::effects::{Blur, Gain, Noise, RUN, Shots, SmearsOfView, Texture};
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

/// Pixels that are finished at once: a random number's worth of noise.
const PIECE: usize = 2 * RUN;

type Piece = [f32; PIECE];

impl Finish<'_> {
    /// Turns the ink that every pixel sees into levels, and leaves none of it. `row` holds levels where an effect takes a
    /// row of them.
    pub(crate) fn develop(mut self, ink: &mut [f32], width: usize, row: &mut Vec<f32>, image: &mut Vec<u8>) {
        image.resize(ink.len(), 0);
        row.resize(width, 0.0);
        let mut noise = self.noise.take();
        let rows = ink.chunks_exact_mut(width).zip(image.chunks_exact_mut(width));
        for (y, (ink, image)) in rows.enumerate() {
            let (gel, gain) = (self.base.row(y, width), self.gain.map(|gain| gain.of_row(y)));
            if self.smears.is_some() || self.shots.is_some() {
                lay(self.contrast, (gel, gain), ink, row);
                self.spoil(y, row);
                for (levels, image) in row.chunks(PIECE).zip(image.chunks_mut(PIECE)) {
                    image.copy_from_slice(&expose(padded(levels), &mut noise)[..levels.len()]);
                }
                continue;
            }
            let (inks, ink) = ink.as_chunks_mut::<PIECE>();
            let (images, image) = image.as_chunks_mut::<PIECE>();
            let (gels, gel) = gel.as_chunks::<PIECE>();
            let (share, columns) = gain.unwrap_or_default();
            let (gains, last) = columns.as_chunks::<PIECE>();
            for (k, ((ink, gel), image)) in inks.iter_mut().zip(gels).zip(images).enumerate() {
                let levels = match gains.get(k) {
                    Some(columns) => lit(self.contrast, share, *columns, *gel, *ink),
                    None => even(self.contrast, *gel, *ink),
                };
                *ink = [0.0; PIECE];
                *image = expose(levels, &mut noise);
            }
            if !ink.is_empty() {
                let levels = &mut row[..ink.len()];
                lay(self.contrast, (gel, gain.map(|_| (share, last))), ink, levels);
                image.copy_from_slice(&expose(padded(levels), &mut noise)[..levels.len()]);
            }
        }
    }

    /// What acts on whole rows.
    fn spoil(&mut self, y: usize, row: &mut [f32]) {
        if let Some(smears) = self.smears {
            smears.apply(self.time_s, y, row);
        }
        if let Some((shots, stream)) = &mut self.shots {
            shots.add(stream, row);
        }
    }
}

/// Ink over the gel, of which none is left. The gain is a row's share and the columns'.
fn lay(contrast: f32, (gel, gain): (&[f32], Option<(f32, &[f32])>), ink: &mut [f32], levels: &mut [f32]) {
    let inked = levels.iter_mut().zip(ink).zip(gel);
    match gain {
        Some((row, columns)) => inked.zip(columns).for_each(|(((level, ink), gel), &column)| {
            *level = gel + contrast * Gain::of(row, column) * core::mem::take(ink);
        }),
        None => inked.for_each(|((level, ink), gel)| *level = gel + contrast * core::mem::take(ink)),
    }
}

/// The same of a piece. (By value, as all that follows: so it becomes vectors.)
#[inline(always)]
fn lit(contrast: f32, row: f32, columns: Piece, gel: Piece, ink: Piece) -> Piece {
    core::array::from_fn(|k| gel[k] + contrast * Gain::of(row, columns[k]) * ink[k])
}

/// The same in even light.
#[inline(always)]
fn even(contrast: f32, gel: Piece, ink: Piece) -> Piece {
    core::array::from_fn(|k| gel[k] + contrast * ink[k])
}

fn padded(levels: &[f32]) -> Piece {
    let mut piece = [0.0; PIECE];
    piece[..levels.len()].copy_from_slice(levels);
    piece
}

/// Noise, and rounding to the nearest level from 0 to 255. Beyond 2^23 numbers are whole, so that adding it rounds, and the
/// lowest bits are the level.
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
        // `f32::clamp` keeps a NaN, which nobody hands over, and takes longer.
        let within = if level < 255.0 { level } else { 255.0 };
        let positive = if within > 0.0 { within } else { 0.0 };
        (positive + WHOLE).to_bits() as u8
    })
}
