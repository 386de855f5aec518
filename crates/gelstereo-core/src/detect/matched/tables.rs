//! Weights as whole numbers for every disc and place within a pixel that an image has needed so far.

use super::design::{Design, MOST_SIDE_PX, Support, Weights};
use super::disc::Disc;
use crate::detect::fit::Noise;
use crate::math::{DVec2, abs, exp, floor, ln, round};
use alloc::vec::Vec;

/// Places of a centre within a pixel, per axis.
pub(super) const PLACES: usize = 4;
/// Kernels of one place, one after the other.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    X,
    Y,
    Contrast,
    Share,
    Radius,
    Blur,
}
const KINDS: usize = 6;
/// Largest weight: its products with levels fill 31 bits only for sums of more than 1000 pixels.
const MOST_WEIGHT: f64 = 8191.0;
/// The share of a disc is stored times this.
pub(super) const WHOLE: f64 = 1024.0;
/// Room for numbers: a dozen discs 4 px wide at four places by four. Without room all are forgotten.
const ROOM: usize = 1 << 18;
const MOST_SETS: usize = 64;
/// Sizes of grain over that of the design for which the variance is known.
const SIZES: [f64; 3] = [0.7, 1.0, 1.4];

/// What the weights are made for, in steps: nothing is lost by a neighbour's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Conditions {
    blur: u8,
    /// Half pixels of gel around the outline.
    reach: u8,
    grain: u8,
    grain_size: u8,
    bright: bool,
}

impl Conditions {
    pub fn new(blur_px: f64, reach_px: f64, noise: &Noise, bright: bool) -> Self {
        let step = |value: f64, first: f64, ratio: f64, most: f64| {
            round(ln(value / first) / ln(ratio)).clamp(0.0, most) as u8
        };
        let share = noise.grain_levels2 / noise.white_levels2;
        let grain = if share < 0.03 { 0 } else { 1 + step(share, 0.125, 4.0, 3.0) };
        Self {
            blur: step(blur_px, LEAST_BLUR_PX, BLUR_STEP, 40.0),
            reach: floor(2.0 * reach_px) as u8,
            grain,
            grain_size: if grain == 0 { 2 } else { step(noise.grain_size_px, 0.7, 1.5, 5.0) },
            bright,
        }
    }

    pub fn blur_px(self) -> f64 {
        LEAST_BLUR_PX * exp(f64::from(self.blur) * ln(BLUR_STEP))
    }

    fn noise(self) -> Noise {
        let grain_levels2 =
            if self.grain == 0 { 0.0 } else { 0.125 * exp(f64::from(self.grain - 1) * ln(4.0)) };
        let grain_size_px = 0.7 * exp(f64::from(self.grain_size) * ln(1.5));
        Noise { white_levels2: 1.0, grain_levels2, grain_size_px }
    }
}

const LEAST_BLUR_PX: f64 = 0.4;
const BLUR_STEP: f64 = 1.12;

/// Steps of the radius: a quarter of a pixel up to 4 px, and a sixteenth of it beyond.
pub(super) fn radius_step(radius_px: f64) -> usize {
    let steps = if radius_px < 4.0 { 4.0 * radius_px } else { 16.0 + 16.0 * ln(radius_px / 4.0) };
    round(steps.clamp(0.0, (RADII - 1) as f64)) as usize
}

fn stepped_radius_px(step: usize) -> f64 {
    if step < 16 { 0.25 * step as f64 } else { 4.0 * exp((step as f64 - 16.0) / 16.0) }
}

const RADII: usize = 40;

/// The weights of one disc.
#[derive(Clone, Copy, Debug)]
pub(super) struct Set {
    conditions: Conditions,
    radius: u8,
    /// Pixels on a side, and columns with those of no weight that fill rows up to a multiple of eight.
    pub side: usize,
    pub columns: usize,
    /// Pixels that count.
    pub pixels: u32,
    first: usize,
    pub radius_px: f64,
    /// Pixels, and shares of the contrast, per unit of a sum.
    pub px_per_unit: f64,
    pub contrast_per_unit: f64,
    pub form_per_unit: f64,
    pub bend_per_px2: f64,
    /// Variances for a contrast of 1 and of white noise, and of grain of the design's size times [`SIZES`].
    gains: [f64; 4],
    grain_size_px: f64,
}

impl Set {
    /// Variance of one coordinate, px², for a contrast of one level.
    pub fn variance(&self, noise: &Noise) -> f64 {
        let [white, grain @ ..] = self.gains;
        // Lagrange's parabola over the logarithm of the size.
        let at = |k: usize| ln(SIZES[k]);
        let size = ln(noise.grain_size_px / self.grain_size_px).clamp(2.0 * at(0), 2.0 * at(2));
        let mut gain = 0.0;
        for k in 0..3 {
            let others = (0..3).filter(|&j| j != k).map(|j| (size - at(j)) / (at(k) - at(j)));
            gain += grain[k] * others.product::<f64>();
        }
        white * noise.white_levels2 + gain.max(0.0) * noise.grain_levels2
    }
}

/// All weights, and those of the conditions that hold.
#[derive(Clone, Debug, Default)]
pub(super) struct Tables {
    numbers: Vec<i16>,
    sets: Vec<Set>,
    conditions: Conditions,
    /// For each radius: 0 for not looked for yet, 1 for none, else 2 more than the set's index.
    by_radius: Vec<u8>,
    disc: Disc,
    design: Design,
}

impl Tables {
    /// Chooses the conditions that hold from now on. Room is taken when first called.
    pub fn choose(&mut self, conditions: Conditions) {
        if self.by_radius.is_empty() {
            self.numbers.reserve(ROOM);
            self.sets.reserve(MOST_SETS);
            self.by_radius.resize(RADII, 0);
            self.design.reserve();
        } else if conditions != self.conditions {
            self.by_radius.fill(0);
        }
        self.conditions = conditions;
    }

    pub const fn conditions(&self) -> Conditions {
        self.conditions
    }

    /// Index of the weights for a disc of this radius, made if need be; `None` if there are none for it.
    #[inline]
    pub fn find(&mut self, radius_px: f64) -> Option<usize> {
        let step = radius_step(radius_px);
        match self.by_radius.get(step)? {
            0 => {
                let found = self.look(step);
                self.by_radius[step] = found.map_or(1, |set| set as u8 + 2);
                found
            }
            1 => None,
            set => Some(usize::from(*set) - 2),
        }
    }

    #[inline]
    pub fn set(&self, index: usize) -> &Set {
        &self.sets[index]
    }

    /// The weights of one kind for one place within the pixel.
    #[inline]
    pub fn kernel(&self, set: &Set, place: usize, kind: Kind) -> &[i16] {
        let count = set.side * set.columns;
        &self.numbers[set.first + (place * KINDS + kind as usize) * count..][..count]
    }

    /// -1 where a pixel counts, otherwise 0.
    #[inline]
    pub fn mask(&self, set: &Set) -> &[i16] {
        let count = set.side * set.columns;
        &self.numbers[set.first + PLACES * PLACES * KINDS * count..][..count]
    }

    fn look(&mut self, step: usize) -> Option<usize> {
        let same = |set: &Set| set.conditions == self.conditions && usize::from(set.radius) == step;
        self.sets.iter().position(same).or_else(|| self.make(step))
    }

    fn make(&mut self, step: usize) -> Option<usize> {
        let radius_px = stepped_radius_px(step);
        let support = Support::new(radius_px + 0.5 * f64::from(self.conditions.reach));
        if !(radius_px >= 0.75 && support.side <= MOST_SIDE_PX) {
            return None;
        }
        let (side, columns) = (support.side, support.side.next_multiple_of(8));
        let count = side * columns;
        let needed = (PLACES * PLACES * KINDS + 1) * count;
        if self.sets.len() == MOST_SETS || self.numbers.len() + needed > ROOM {
            self.sets.clear();
            self.numbers.clear();
            self.by_radius.fill(0);
        }
        let first = self.numbers.len();
        self.numbers.resize(first + needed, 0);
        let found = self.fill(first, support, columns, radius_px);
        let Some([px_per_unit, contrast_per_unit, form_per_unit, bend_per_px2, gains @ ..]) = found else {
            self.numbers.truncate(first);
            return None;
        };
        let mut pixels = 0;
        for (row, numbers) in self.numbers[first + needed - count..].chunks_exact_mut(columns).enumerate() {
            for (column, number) in numbers[..side].iter_mut().enumerate() {
                let half = support.half() as f64;
                let inside = support.has(DVec2::new(column as f64 - half, row as f64 - half));
                *number = -i16::from(inside);
                pixels += u32::from(inside);
            }
        }
        self.sets.push(Set {
            conditions: self.conditions,
            radius: step as u8,
            side,
            columns,
            pixels,
            first,
            radius_px,
            px_per_unit,
            contrast_per_unit,
            form_per_unit,
            bend_per_px2,
            gains,
            grain_size_px: self.conditions.noise().grain_size_px,
        });
        Some(self.sets.len() - 1)
    }

    /// Fills a set's kernels: units of displacement, contrast and form, bend and four gains.
    fn fill(&mut self, first: usize, support: Support, columns: usize, radius_px: f64) -> Option<[f64; 8]> {
        let noise = self.conditions.noise();
        self.disc.draw(radius_px, self.conditions.blur_px());
        let (mut units, mut bend, mut gains) = ([0.0; 3], 0.0, [0.0; 4]);
        let half = PLACES / 2;
        let off = |k: usize| (k as f64 + 0.5) / PLACES as f64 - 0.5;
        // One quarter of the places; the others are its mirror images.
        for (n, (row, column)) in (0..half * half).map(|n| (n, (half + n / half, half + n % half))) {
            let at = DVec2::new(off(column), off(row));
            self.design.run(&self.disc, support, at, &noise, self.conditions.bright)?;
            let sizes = SIZES.map(|size| size * noise.grain_size_px);
            for (sum, gain) in gains.iter_mut().zip(self.design.gains(support, &sizes)) {
                *sum += gain / (half * half) as f64;
            }
            let weights = &self.design.weights;
            bend += weights.bend_per_px2 / (half * half) as f64;
            if n == 0 {
                // Others differ little; 1/2 leaves room.
                let unit = |list: &[f64]| {
                    list.iter().fold(0.0, |most: f64, &w| most.max(abs(w))) / (0.5 * MOST_WEIGHT)
                };
                units = [
                    unit(&weights.x).max(unit(&weights.y)),
                    unit(&weights.contrast),
                    unit(&weights.radius).max(unit(&weights.blur)),
                ];
            }
            let mirrors = [(false, false), (true, false), (false, true), (true, true)];
            for (left, up) in mirrors {
                let place = |at: usize, mirrored: bool| if mirrored { PLACES - 1 - at } else { at };
                let place = place(row, up) * PLACES + place(column, left);
                let count = support.side * columns;
                let numbers = &mut self.numbers[first + place * KINDS * count..][..KINDS * count];
                write(numbers, weights, &units, (support.side, columns), (left, up));
            }
        }
        Some([units[0], units[1], units[2], bend, gains[0], gains[1], gains[2], gains[3]])
    }
}

/// Writes the kernels of one place, mirrored about the middle column, row or both.
fn write(
    numbers: &mut [i16],
    weights: &Weights,
    units: &[f64; 3],
    (side, columns): (usize, usize),
    (left, up): (bool, bool),
) {
    let lists: [(&[f64], f64); KINDS] = [
        (&weights.x, if left { -1.0 } else { 1.0 } / units[0]),
        (&weights.y, if up { -1.0 } else { 1.0 } / units[0]),
        (&weights.contrast, 1.0 / units[1]),
        (&weights.share, WHOLE),
        (&weights.radius, 1.0 / units[2]),
        (&weights.blur, 1.0 / units[2]),
    ];
    for (kernel, (list, per_unit)) in numbers.chunks_exact_mut(side * columns).zip(lists) {
        // What rounding leaves goes to the next pixel, so that sums and slopes stay right.
        let mut left_over = 0.0;
        for row in 0..side {
            for column in 0..side {
                let from = |at: usize, mirrored: bool| if mirrored { side - 1 - at } else { at };
                let exact = list[from(row, up) * side + from(column, left)] * per_unit;
                let number = if exact == 0.0 { 0.0 } else { round(exact + left_over) };
                left_over += exact - number;
                kernel[row * columns + column] = number.clamp(-MOST_WEIGHT, MOST_WEIGHT) as i16;
            }
        }
    }
}
