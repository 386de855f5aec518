//! Integer weights for every disc and sub-pixel position that an image has needed so far.

use super::correlate::{SHARE_BITS, columns, numbers};
use super::design::{Design, MAX_SUPPORT_PX, Weights};
use super::disc::Disc;
use super::support::Support;
use crate::detect::centre::noise::Noise;
use crate::math::{DVec2, abs, exp, floor, ln, round};
use alloc::vec::Vec;

/// Sub-pixel positions of a centre, per axis.
pub(super) const PLACES: usize = 4;
/// Kernels of one position, in storage order.
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
/// Largest weight: only sums of more than 1000 pixels could overflow 31 bits.
const MAX_WEIGHT: i32 = 8191;
/// Numbers of this magnitude are integers: adding it rounds.
const LIFT: f64 = 1.5 * (1_u64 << 52) as f64;
/// Largest number of sets, for discs as large as those of the first image. The markers of an image need
/// two or three.
const MAX_SETS: usize = 12;
/// Margin for discs larger than in the first image: additional pixels per side of their support.
const WIDER_PX: usize = 4;
/// Grain sizes over that of the design for which the variance is computed.
const SIZES: [f64; 3] = [0.7, 1.0, 1.4];

/// Design conditions of the weights, quantised so finely that a neighbouring step costs nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Conditions {
    blur: u8,
    /// Quarters of a pixel to the middle between neighbours; the largest value for distant ones.
    half_way: u8,
    grain: u8,
    grain_size: u8,
    /// Quarters of the contrast over the gel's level.
    dot_slope: i8,
}

impl Conditions {
    /// `half_way_px` is half the distance to the nearest neighbour, `per_ground` the contrast over the
    /// gel's level.
    pub fn new(blur_px: f64, half_way_px: f64, noise: &Noise, per_ground: f64) -> Self {
        let step = |value: f64, first: f64, ratio: f64, most: f64| {
            round(ln(value / first) / ln(ratio)).clamp(0.0, most) as u8
        };
        let share = noise.grain_levels2 / noise.white_levels2;
        let grain = if share < 0.03 { 0 } else { 1 + step(share, 0.125, 2.0, 6.0) };
        Self {
            blur: step(blur_px, MIN_BLUR_PX, BLUR_STEP, 40.0),
            half_way: floor(4.0 * half_way_px) as u8,
            grain,
            grain_size: if grain == 0 { 2 } else { step(noise.grain_size_px, 0.7, 1.5, 5.0) },
            dot_slope: round(4.0 * per_ground).clamp(-4.0, 16.0) as i8,
        }
    }

    /// Whether weights for the other conditions are suitable here too: they differ by at most one step,
    /// which costs less than a percent of precision.
    pub fn is_near(self, other: Self) -> bool {
        let (dot_slope, other_slope) = (self.dot_slope, other.dot_slope);
        let steps = [
            self.blur.abs_diff(other.blur),
            self.half_way.abs_diff(other.half_way),
            self.grain.abs_diff(other.grain),
            dot_slope.abs_diff(other_slope),
        ];
        // Without grain its size is irrelevant.
        let sizes =
            if self.grain.min(other.grain) <= 2 { 0 } else { self.grain_size.abs_diff(other.grain_size) };
        steps.into_iter().chain([sizes]).all(|steps| steps <= 1)
    }

    /// Radius of the support of a disc: at most to the middle between neighbours; `None` if they are too
    /// near.
    fn reach_px(self, radius_px: f64) -> Option<f64> {
        let half_way = if self.half_way == u8::MAX { f64::INFINITY } else { 0.25 * f64::from(self.half_way) };
        (half_way >= radius_px + MIN_REACH_PX).then(|| half_way.min(radius_px + REACH_PX))
    }

    pub fn blur_px(self) -> f64 {
        MIN_BLUR_PX * exp(f64::from(self.blur) * ln(BLUR_STEP))
    }

    fn noise(self) -> Noise {
        let grain_levels2 =
            if self.grain == 0 { 0.0 } else { 0.125 * exp(f64::from(self.grain - 1) * ln(2.0)) };
        let grain_size_px = 0.7 * exp(f64::from(self.grain_size) * ln(1.5));
        Noise { white_levels2: 1.0, grain_levels2, grain_size_px, gel_level: 0.0 }
    }
}

/// Largest and least width of gel around the outline that is used: farther pixels carry little
/// information on the light.
pub(super) const REACH_PX: f64 = 3.0;
const MIN_REACH_PX: f64 = 1.0;
const MIN_BLUR_PX: f64 = 0.4;
const BLUR_STEP: f64 = 1.12;

/// Steps of the radius, and their number.
const RADIUS_STEP_PX: f64 = 0.25;
const RADII: usize = 60;

/// The weights of one disc.
#[derive(Clone, Copy, Debug)]
pub(super) struct Set {
    radius: u8,
    /// Pixels per side.
    pub side: usize,
    /// Number of pixels used.
    pub pixels: u32,
    first: usize,
    pub radius_px: f64,
    /// Pixels, and shares of the contrast, per unit of a sum.
    pub px_per_unit: f64,
    pub contrast_per_unit: f64,
    pub form_per_unit: f64,
    pub bend_per_px2: f64,
    /// Variances for a contrast of 1, per unit variance of white noise and of grain of the design's size
    /// times [`SIZES`].
    gains: [f64; 4],
    /// The same for the response.
    response_gains: [f64; 4],
    grain_size_px: f64,
}

impl Set {
    /// Variances of one coordinate for a contrast of one level, px²: from white noise and from grain.
    fn variances(&self, noise: &Noise) -> [f64; 2] {
        self.variances_of(self.gains, noise)
    }

    /// Variance of the response over that of a coordinate, 1/px²: the weights' mean square wave number in
    /// this noise.
    pub fn response_per_px2(&self, noise: &Noise) -> f64 {
        let [response, coordinate] = [self.response_gains, self.gains]
            .map(|gains| self.variances_of(gains, noise).iter().sum::<f64>());
        response / coordinate
    }

    fn variances_of(&self, [white, grain @ ..]: [f64; 4], noise: &Noise) -> [f64; 2] {
        // Lagrange's parabola over the logarithm of the size.
        let at = SIZES.map(ln);
        let size = ln(noise.grain_size_px / self.grain_size_px).clamp(2.0 * at[0], 2.0 * at[2]);
        let mut gain = 0.0;
        for k in 0..3 {
            let others = (0..3).filter(|&j| j != k).map(|j| (size - at[j]) / (at[k] - at[j]));
            gain += grain[k] * others.product::<f64>();
        }
        [white * noise.white_levels2, gain.max(0.0) * noise.grain_levels2]
    }
}

/// State of a radius under the current conditions.
#[derive(Clone, Copy, Debug, Default)]
enum Known {
    #[default]
    Nothing,
    /// There are no weights for it.
    None,
    /// Index of the set, and [`Set::variances`].
    Set(usize, [f64; 2]),
}

/// The weights computed for the current conditions.
#[derive(Clone, Debug, Default)]
pub(super) struct Tables {
    numbers: Vec<i16>,
    sets: Vec<Set>,
    chosen: bool,
    conditions: Conditions,
    blur_px: f64,
    noise: Noise,
    by_radius: Vec<Known>,
    /// Largest number of entries, and of pixels per side of a support.
    room: usize,
    most_side: usize,
    disc: Disc,
    design: Design,
}

impl Tables {
    /// Sets the conditions and the noise that determines the variances. Discards weights for other
    /// conditions. Reserves memory for discs of about this radius, again only for much larger ones.
    pub fn choose(&mut self, conditions: Conditions, noise: &Noise, usual_px: f64) {
        let widest = Support::new((usual_px + REACH_PX).clamp(4.0, 0.5 * MAX_SUPPORT_PX as f64));
        let wider = widest.side > self.most_side;
        if wider {
            self.most_side = (widest.side + WIDER_PX).min(MAX_SUPPORT_PX);
            self.room = MAX_SETS * needed(widest.side);
            self.design.reserve(self.most_side);
            self.by_radius.resize(RADII, Known::Nothing);
        }
        if wider || self.chosen().is_none_or(|chosen| chosen != conditions) {
            self.blur_px = conditions.blur_px();
            self.sets.clear();
            self.numbers.clear();
            self.numbers.reserve(self.room);
            self.sets.reserve(MAX_SETS);
        }
        self.by_radius.fill(Known::Nothing);
        (self.chosen, self.conditions, self.noise) = (true, conditions, *noise);
    }

    /// The current conditions, if any were chosen.
    pub fn chosen(&self) -> Option<Conditions> {
        self.chosen.then_some(self.conditions)
    }

    /// Discards the conditions and all weights.
    pub fn forget(&mut self) {
        self.chosen = false;
        self.sets.clear();
        self.numbers.clear();
        self.by_radius.fill(Known::None);
    }

    /// Standard deviation of the blur that the weights are for, pixels.
    pub const fn blur_px(&self) -> f64 {
        self.blur_px
    }

    pub const fn conditions(&self) -> Conditions {
        self.conditions
    }

    /// Index of the weights for a disc of this radius, computed if needed, and variances for a contrast
    /// of one level, px²: from white noise and from grain. `None` if there are no weights.
    #[inline]
    pub fn find(&mut self, radius_px: f64) -> Option<(usize, [f64; 2])> {
        let step = (radius_px * (1.0 / RADIUS_STEP_PX) + 0.5) as usize;
        match *self.by_radius.get(step)? {
            Known::Set(set, variances) => Some((set, variances)),
            Known::None => None,
            Known::Nothing => {
                let found = self.look(step).map(|set| (set, self.sets[set].variances(&self.noise)));
                self.by_radius[step] =
                    found.map_or(Known::None, |(set, variances)| Known::Set(set, variances));
                found
            }
        }
    }

    #[inline]
    pub fn set(&self, index: usize) -> &Set {
        &self.sets[index]
    }

    /// Weights of one kind for one sub-pixel position.
    #[inline]
    pub fn kernel(&self, set: &Set, place: usize, kind: Kind) -> &[i16] {
        let count = numbers(set.side);
        &self.numbers[set.first + (place * KINDS + kind as usize) * count..][..count]
    }

    /// -1 for pixels used, otherwise 0.
    #[inline]
    pub fn mask(&self, set: &Set) -> &[i16] {
        let count = numbers(set.side);
        &self.numbers[set.first + PLACES * PLACES * KINDS * count..][..count]
    }

    fn look(&mut self, step: usize) -> Option<usize> {
        let same = |set: &Set| usize::from(set.radius) == step;
        self.sets.iter().position(same).or_else(|| self.make(step))
    }

    fn make(&mut self, step: usize) -> Option<usize> {
        let radius_px = RADIUS_STEP_PX * step as f64;
        let support = Support::new(self.conditions.reach_px(radius_px)?);
        let needed = needed(support.side);
        let room = self.sets.len() < MAX_SETS && self.numbers.len() + needed <= self.room;
        if !(radius_px >= 0.75 && support.side <= self.most_side && room) {
            return None;
        }
        let side = support.side;
        let count = numbers(side);
        let first = self.numbers.len();
        self.numbers.resize(first + needed, 0);
        let found = self.fill(first, support, radius_px);
        let Some(([px_per_unit, contrast_per_unit, form_per_unit], bend_per_px2, gains)) = found else {
            self.numbers.truncate(first);
            return None;
        };
        let mut pixels = 0;
        for (row, numbers) in
            self.numbers[first + needed - count..].chunks_exact_mut(columns(side)).take(side).enumerate()
        {
            for (column, number) in numbers[..side].iter_mut().enumerate() {
                let half = support.half() as f64;
                let inside = support.has(DVec2::new(column as f64 - half, row as f64 - half));
                *number = -i16::from(inside);
                pixels += u32::from(inside);
            }
        }
        self.sets.push(Set {
            radius: step as u8,
            side,
            pixels,
            first,
            radius_px,
            px_per_unit,
            contrast_per_unit,
            form_per_unit,
            bend_per_px2,
            gains: gains[0],
            response_gains: gains[1],
            grain_size_px: self.conditions.noise().grain_size_px,
        });
        Some(self.sets.len() - 1)
    }

    /// Fills a set's kernels. Returns the units of displacement, contrast and form, the bend, and the
    /// gains of coordinates and response.
    fn fill(
        &mut self,
        first: usize,
        support: Support,
        radius_px: f64,
    ) -> Option<([f64; 3], f64, [[f64; 4]; 2])> {
        let noise = self.conditions.noise();
        self.disc.draw(radius_px, self.blur_px);
        self.design.start(support, &noise);
        let (mut units, mut bend) = ([0.0; 3], 0.0);
        let (mut gains, mut response_gains) = ([0.0; 4], [0.0; 4]);
        let half = PLACES / 2;
        let off = |k: usize| (k as f64 + 0.5) / PLACES as f64 - 0.5;
        let sizes = SIZES.map(|size| size * noise.grain_size_px);
        // Of a quarter of the positions, those on its diagonal and above; the others are mirror images.
        for (row, column) in (half..PLACES).flat_map(|row| (row..PLACES).map(move |column| (row, column))) {
            let at = DVec2::new(off(column), off(row));
            self.design.run(&self.disc, support, at, 0.25 * f64::from(self.conditions.dot_slope))?;
            // One pair of neighbours represents all, since they differ little.
            if (row, column) == (half, half) {
                self.design.keep_x();
            } else if (row, column) == (half, half + 1) {
                response_gains = self.design.response_gains(1.0 / PLACES as f64, &sizes);
            }
            let transposed = if row == column { &[false][..] } else { &[false, true] };
            for &transposed in transposed {
                for (sum, gain) in gains.iter_mut().zip(self.design.gains(transposed, &sizes)) {
                    *sum += gain / (half * half) as f64;
                }
                let weights = &self.design.weights;
                bend += weights.bends_per_px2[usize::from(transposed)] / (half * half) as f64;
                if (row, column) == (half, half) {
                    // The units of other positions differ little; 1/2 is the margin.
                    let unit = |list: &[f64]| {
                        list.iter().fold(0.0, |most: f64, &w| most.max(abs(w)))
                            / (0.5 * f64::from(MAX_WEIGHT))
                    };
                    units = [
                        unit(&weights.x).max(unit(&weights.y)),
                        unit(&weights.contrast),
                        unit(&weights.radius).max(unit(&weights.blur)),
                    ];
                }
                let (row, column) = if transposed { (column, row) } else { (row, column) };
                for (left, up) in [(false, false), (true, false), (false, true), (true, true)] {
                    let place = |at: usize, mirrored: bool| if mirrored { PLACES - 1 - at } else { at };
                    let place = place(row, up) * PLACES + place(column, left);
                    let count = numbers(support.side);
                    let kernels = &mut self.numbers[first + place * KINDS * count..][..KINDS * count];
                    write(kernels, weights, &units, support.side, Mirror { left, up, transposed });
                }
            }
        }
        Some((units, bend, [gains, response_gains]))
    }
}

/// Entries of a set whose support has `side` pixels per side.
const fn needed(side: usize) -> usize {
    (PLACES * PLACES * KINDS + 1) * numbers(side)
}

/// Derivation of another position's weights: transposed first, then mirrored about the middle column or row.
#[derive(Clone, Copy)]
struct Mirror {
    left: bool,
    up: bool,
    transposed: bool,
}

/// Writes the kernels of one position.
fn write(kernels: &mut [i16], weights: &Weights, units: &[f64; 3], side: usize, mirror: Mirror) {
    let Mirror { left, up, transposed } = mirror;
    let (x, y) = if transposed { (&weights.y, &weights.x) } else { (&weights.x, &weights.y) };
    let lists: [(&[f64], f64); KINDS] = [
        (x, if left { -1.0 } else { 1.0 } / units[0]),
        (y, if up { -1.0 } else { 1.0 } / units[0]),
        (&weights.contrast, 1.0 / units[1]),
        (&weights.share, f64::from(1 << SHARE_BITS)),
        (&weights.radius, 1.0 / units[2]),
        (&weights.blur, 1.0 / units[2]),
    ];
    // Index of the first entry's source, and the steps per row and column.
    let (row_step, column_step) = if transposed { (1, side) } else { (side, 1) };
    let from = |row: usize, column: usize| {
        let row = if up { side - 1 - row } else { row };
        let column = if left { side - 1 - column } else { column };
        row * row_step + column * column_step
    };
    for (kernel, (list, per_unit)) in kernels.chunks_exact_mut(numbers(side)).zip(lists) {
        // The rounding error is carried to the next pixel, so that sums and slopes stay accurate.
        let mut left_over = 0.0;
        for (row, kernel) in kernel.chunks_exact_mut(columns(side)).take(side).enumerate() {
            for (column, kernel) in kernel.iter_mut().take(side).enumerate() {
                let exact = list[from(row, column)] * per_unit;
                if exact != 0.0 {
                    // The lowest bits are the integer, which fits well within 31 bits.
                    let lifted = exact + left_over + LIFT;
                    left_over += exact - (lifted - LIFT);
                    *kernel = (lifted.to_bits() as i32).clamp(-MAX_WEIGHT, MAX_WEIGHT) as i16;
                }
            }
        }
    }
}
