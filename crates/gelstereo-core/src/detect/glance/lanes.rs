//! Sums over the rows of a window, its columns side by side: loops of fixed length, which compile to vector code.

use super::MOST_SIDE_PX;

/// Sums of a window's weights by lane and by row: at most 32 of at most 255.
pub(super) struct Weights<const L: usize> {
    pub columns: [i16; L],
    pub rows: [i16; L],
}

/// The darkest level of the lanes that are on.
#[inline(never)]
pub(super) fn darkest<'a, const L: usize>(
    rows: impl Iterator<Item = &'a [u8; L]>,
    flip: u8,
    on: &[u8; L],
) -> u8 {
    let mut darkest = [u8::MAX; L];
    for row in rows {
        darkest = core::array::from_fn(|x| darkest[x].min(row[x] ^ flip));
    }
    least(&darkest, on)
}

/// Sums of how far rows, with what is added to each, stay below a limit, up to `band`.
#[inline(never)]
pub(super) fn weigh<'a, const L: usize>(
    rows: impl Iterator<Item = (&'a [u8; L], u8)>,
    limit: &[u8; L],
    band: u8,
    flip: u8,
) -> Weights<L> {
    let [mut columns, mut sums] = [[0_i16; L]; 2];
    for ((row, less), total) in rows.zip(&mut sums) {
        let weight: [u8; L] =
            core::array::from_fn(|x| limit[x].saturating_sub((row[x] ^ flip).saturating_add(less)).min(band));
        columns = core::array::from_fn(|x| columns[x] + i16::from(weight[x]));
        *total = weight.iter().map(|&w| u32::from(w)).sum::<u32>() as i16;
    }
    Weights { columns, rows: sums }
}

#[inline(never)]
fn least<const L: usize>(levels: &[u8; L], on: &[u8; L]) -> u8 {
    levels.iter().zip(on).fold(u8::MAX, |low, (&level, &on)| low.min(level | !on))
}

#[inline(never)]
pub(super) fn sum_columns<'a, const L: usize>(rows: impl Iterator<Item = &'a [u8; L]>, flip: u8) -> [i16; L] {
    let mut columns = [0; L];
    for row in rows {
        columns = core::array::from_fn(|x| columns[x] + i16::from(row[x] ^ flip));
    }
    columns
}

/// Sum of products. There is one instruction for eight of them, which is found here but not where one list is known.
#[inline(never)]
pub(super) fn products<const L: usize>(a: &[i16; L], b: &[i16; L]) -> i32 {
    a.iter().zip(b).map(|(&a, &b)| i32::from(a) * i32::from(b)).sum()
}

/// Sum, mean place and variance of weights along a line.
pub(super) fn moments<const L: usize>(line: &[i16; L]) -> (i32, f64, f64) {
    let sum: i32 = line.iter().map(|&weight| i32::from(weight)).sum();
    let first = products(line, &const { powers(1) });
    let second = products(line, &const { powers(2) });
    let per = 1.0 / f64::from(sum.max(1));
    let mean = f64::from(first) * per;
    (sum, mean, f64::from(second) * per - mean * mean)
}

/// Powers of places.
const fn powers<const L: usize>(exponent: u32) -> [i16; L] {
    let mut powers = [0; L];
    let mut at = 0;
    while at < L {
        powers[at] = (at as i16).pow(exponent);
        at += 1;
    }
    powers
}

/// Nothing, and all ones from a lane on.
pub(super) fn step_up<const L: usize>(lane: usize) -> [u8; L] {
    const STEP: [u8; 2 * MOST_SIDE_PX] = {
        let mut step = [0; 2 * MOST_SIDE_PX];
        let mut at = MOST_SIDE_PX;
        while at < step.len() {
            step[at] = u8::MAX;
            at += 1;
        }
        step
    };
    *STEP[MOST_SIDE_PX - lane..].first_chunk::<L>().unwrap_or(&[0; L])
}
