//! Whether the matches of a frame agree: correctly matched neighbours have moved alike.

use super::extended_lattice::{ExtendedLattice, NONE};
use crate::math::DVec2;

/// Consistent neighbours have residuals that differ by less than this, in pitches. A slip makes the
/// difference one pitch minus the true one.
pub(super) const NEIGHBOURS_AGREE: f64 = 0.35;

/// Neighbours whose residuals differ by more than this, in pitches, have slipped relative to each other:
/// for a prediction from the last frame, and for a stale one.
const SLIPPED: f64 = 0.5;
const SLIPPED_STALE: f64 = 0.3;

/// Largest distance of a marker from the midpoint of its neighbours, in pitches; a slip gives half a
/// pitch.
pub(super) const BENT: f64 = 1.0 / 3.0;

/// If all residuals lie this close to their mean, in pitches, every pair agrees.
const ALL_AGREE: f64 = 0.5 * NEIGHBOURS_AGREE;

/// Matches without neighbours between them agree up to this share of the distance to the nearest
/// neighbour, which is less than a pitch where the gel is compressed. Beyond one half, the match would be
/// that neighbour.
const ALONE_AGREE: f64 = 0.35;

/// State from previous frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct Before<'a> {
    /// Number of consecutive certain frames in which each marker was missed.
    pub missed_frames: &'a [u32],
    /// Whether the positions are from an earlier frame than the last one.
    pub stale: bool,
    pub pitch_px: f64,
}

impl Before<'_> {
    pub fn missed(&self, canvas: &ExtendedLattice, site: usize) -> Option<u32> {
        canvas.marker(site).map(|n| self.missed_frames[n])
    }

    /// Whether the marker of a place was seen in the last certain frame.
    pub fn is_fresh(&self, canvas: &ExtendedLattice, site: usize) -> bool {
        self.missed(canvas, site) == Some(0)
    }
}

/// Whether every match but the first agrees with its left or upper neighbour, so that all are connected.
/// This holds in most frames; where it fails, nothing follows.
pub(super) fn in_one_piece(canvas: &ExtendedLattice, agree_px2: f64) -> bool {
    let (width, found) = (canvas.width(), &canvas.found);
    let mut matched = (0..found.len()).filter(|&s| found[s] != NONE);
    let _first = matched.next();
    matched.all(|site| {
        let agrees = |other: usize| {
            found[other] != NONE
                && canvas.residual_px[other].distance_squared(canvas.residual_px[site]) < agree_px2
        };
        (!site.is_multiple_of(width) && agrees(site - 1)) || site.checked_sub(width).is_some_and(agrees)
    })
}

/// Whether two neighbours have slipped relative to each other: their motions differ too much, or a marker
/// is far from the midpoint of its neighbours. The latter is allowed if all three were seen in the
/// previous frame and moved alike, since twisted gel bends as far at the rim of the contact.
pub(super) fn torn(canvas: &ExtendedLattice, before: Before<'_>) -> bool {
    let most_slip = if before.stale { SLIPPED_STALE } else { SLIPPED };
    let (slip, bent) = (most_slip * before.pitch_px, BENT * before.pitch_px);
    let (width, height) = (canvas.width(), canvas.height());
    let found = |site: usize| canvas.found[site] != NONE;
    let tears = |row: usize, col: usize| {
        let site = row * width + col;
        let between = |one: usize, other: usize| {
            let off2 = |[a, b, c]: [DVec2; 3]| ((a + c) * 0.5).distance_squared(b);
            let line = [one, site, other];
            found(one)
                && found(other)
                && off2(line.map(|s| canvas.position_px(s))) > bent * bent
                && !(line.iter().all(|&s| before.is_fresh(canvas, s))
                    && off2(line.map(|s| canvas.residual_px[s])) < bent * bent)
        };
        let slipped = |other: usize| {
            let apart = canvas.residual_px[site] - canvas.residual_px[other];
            found(other) && apart.length_squared() > slip * slip
        };
        let (inner, below) = (col > 0 && col + 1 < width, row + 1 < height);
        // Each pair of neighbours once.
        found(site)
            && ((inner && between(site - 1, site + 1))
                || (row > 0 && below && between(site - width, site + width))
                || (col + 1 < width && slipped(site + 1))
                || (below && slipped(site + width))
                || (below && col > 0 && slipped(site + width - 1))
                || (below && col + 1 < width && slipped(site + width + 1)))
    };
    (0..height).any(|row| (0..width).any(|col| tears(row, col)))
}

/// Mean residual of all matches if all lie closer to it than `most_px`.
fn common_residual(canvas: &ExtendedLattice, most_px: f64) -> Option<DVec2> {
    let matched =
        || canvas.found.iter().zip(&canvas.residual_px).filter(|&(&m, _)| m != NONE).map(|(_, &r)| r);
    let (sum, count) = matched().fold((DVec2::ZERO, 0.0), |(sum, count), r| (sum + r, count + 1.0));
    let mean = sum / count;
    (count > 0.0 && matched().all(|r| r.distance_squared(mean) < most_px * most_px)).then_some(mean)
}

/// Mean residual of all matches if each is closer to it than to a residual one neighbour off. Then none
/// slipped, not even unconnected ones.
pub(super) fn moved_alike(canvas: &ExtendedLattice, pitch_px: f64) -> Option<DVec2> {
    let mean = common_residual(canvas, NEIGHBOURS_AGREE * pitch_px)?;
    let near = |s: usize| canvas.residual_px[s].distance(mean) < ALONE_AGREE * canvas.step_px(s);
    (0..canvas.found.len()).filter(|&s| canvas.found[s] != NONE).all(near).then_some(mean)
}

/// Whether all matches agree with each other, and each reappearing one is next to one that was seen
/// before. If so, places without a match get the mean residual.
pub(super) fn agree_all(canvas: &mut ExtendedLattice, before: Before<'_>) -> bool {
    let Some(mean) = common_residual(canvas, ALL_AGREE * before.pitch_px) else { return false };
    let fresh_match = |s: usize| canvas.found[s] != NONE && before.is_fresh(canvas, s);
    let joined = |s: usize| before.is_fresh(canvas, s) || canvas.around(s).any(fresh_match);
    let agree = (0..canvas.found.len()).filter(|&s| canvas.found[s] != NONE).all(joined);
    if agree {
        for (residual, &m) in canvas.residual_px.iter_mut().zip(&canvas.found) {
            if m == NONE {
                *residual = mean;
            }
        }
    }
    agree
}
