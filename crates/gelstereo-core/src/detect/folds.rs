//! Covariances of the centres in a single image, with the effect of gel that folds within the dots.

use super::fold_law::{add_moved, add_weighed};
use super::markers::Markers;
use crate::math::{DVec2, abs, median, sqrt};
use crate::spatial::Grid;
use alloc::vec::Vec;
use core::f64::consts::PI;

/// Nearest markers among which a marker's neighbours are looked for: those around it on a square lattice.
const NEAREST: usize = 8;
/// Largest distance of a neighbour from the place opposite to another one, over the shorter of both steps.
/// Folds of the path-traced working images reach 0.4.
const MAX_OFF: f64 = 0.5;
/// Least sine of the angle between the two axes of a marker.
const MIN_SINE: f64 = 0.7;
/// Largest radius of a dot in pitches: dots that touch.
const MAX_RADIUS_PITCHES: f64 = 0.5;
/// Mean square of the averaged second differences, over the image's median, that errors of the print explain.
/// Path-traced development half, `exact`, with 1.5, 1.75, 2 and 3 times: mean normalised squared error of
/// all centres 1.18, 1.27, 1.34 and 1.57, and of gels at rest 0.83, 0.88, 0.91 and 0.99.
const MAX_CHANCE: f64 = 1.5;
/// The same for a marker that moves alone. Normal errors make its square four times as large, and 0.2 % of
/// them exceed 6 times their median.
const MAX_CHANCE_ALONE: f64 = 6.0 * 4.0;
/// Largest root of that median, in steps from the marker before to the one after, of a print with rows.
/// Errors of 1 % of the pitch give 0.012, and dots at random 0.15 to 0.3.
const MAX_USUAL: f64 = 0.05;

/// Widens the covariances of the centres in single images by the effect of gel that folds within the dots.
///
/// A stereo pipeline measures folds from the motion since rest. One image has no rest positions, but in a
/// print, second differences of the positions along rows and columns are zero up to the errors of print and
/// perspective. What exceeds these bends the gel. The errors are taken from the median over the image, so
/// that gel at rest keeps its covariances, and a fold much smaller than the print's errors is not seen. In a
/// print without rows nothing stands out.
///
/// A fold lies along a line. Second differences are therefore averaged over the markers beside them, across
/// their own direction. Where between the markers it lies is unknown: its square is the mean over the marker
/// (half) and its neighbours on both sides (a quarter each). At a corner of a part, a marker may move
/// without those beside it, which counts if it explains more. No labels are needed.
#[derive(Clone, Debug, Default)]
pub struct Folds {
    grid: Grid,
    neighbours: Vec<Neighbours>,
    /// Mean second differences along both axes of every marker, pixels.
    bends_px: Vec<[Option<DVec2>; 2]>,
    squares_px2: Vec<f64>,
}

/// Markers before and after one along its two axes; the marker itself where there is none.
type Neighbours = [[u32; 2]; 2];

/// Folds near a marker along an axis, each with its share, and their mean square.
struct Folded {
    folds_px: [(f64, DVec2); 3],
    square_px2: f64,
}

impl Folds {
    /// Adds what folds do to the covariances of an image's centres. Does not allocate after
    /// [`Self::reserve`] of as many markers.
    pub fn widen(&mut self, markers: &mut Markers) {
        let Markers { centres_px, covariance_px2, area_px2, .. } = markers;
        self.reserve(centres_px.len());
        self.grid.build_evenly(centres_px.iter().copied(), 0.0);
        for own in 0..centres_px.len() {
            let squared = |other: usize| centres_px[other].distance_squared(centres_px[own]);
            let nearest = self.grid.nearest_others::<NEAREST>(own, centres_px[own], squared);
            self.neighbours.push(neighbours(centres_px, own, nearest.map(|(_, other)| other)));
        }
        let print = Print { centres_px, neighbours: &self.neighbours };
        self.bends_px.extend((0..centres_px.len()).map(|own| [0, 1].map(|axis| print.bend_px(own, axis))));
        let axes = (0..centres_px.len()).flat_map(|own| [(own, 0), (own, 1)]);
        let folded = |(own, axis)| Some((own, axis, print.folded(own, axis, &self.bends_px)?));
        self.squares_px2.extend(axes.clone().filter_map(folded).map(|(.., folded)| folded.square_px2));
        let Some(usual_px2) = median(&mut self.squares_px2) else { return };
        let steps_px2 =
            axes.clone().map(|(own, axis)| print.step_px(own, axis).length_squared()).sum::<f64>();
        if usual_px2 > MAX_USUAL * MAX_USUAL * steps_px2 / (2 * centres_px.len()) as f64 {
            return;
        }
        for (own, axis, near) in axes.filter_map(folded) {
            let alone = print.alone(own, axis, self.bends_px[own][axis]);
            let [near_px2, alone_px2] = [(&near, MAX_CHANCE), (&alone, MAX_CHANCE_ALONE)]
                .map(|(folded, most)| folded.square_px2 - most * usual_px2);
            let (folded, left_px2) = if alone_px2 > near_px2 { (alone, alone_px2) } else { (near, near_px2) };
            if left_px2 > 0.0 {
                let (cube, covariance) = (print.cube(own, area_px2[own]), &mut covariance_px2[own]);
                for (share, fold_px) in folded.folds_px {
                    add_moved(covariance, cube, share * left_px2 / folded.square_px2, fold_px.to_array());
                }
                let along = print.step_px(own, axis).normalize_or_zero();
                add_weighed(covariance, cube, left_px2, along.to_array());
            }
        }
    }

    /// Reserves memory for images of this many markers.
    pub fn reserve(&mut self, markers: usize) {
        self.grid.reserve_evenly(markers);
        self.neighbours.clear();
        self.neighbours.reserve(markers);
        self.bends_px.clear();
        self.bends_px.reserve(markers);
        self.squares_px2.clear();
        self.squares_px2.reserve(2 * markers);
    }
}

/// Markers of an image and their neighbours.
struct Print<'a> {
    centres_px: &'a [DVec2],
    neighbours: &'a [Neighbours],
}

impl Print<'_> {
    /// From the marker before to the one after along an axis.
    fn step_px(&self, own: usize, axis: usize) -> DVec2 {
        let [before, after] = self.neighbours[own][axis];
        self.centres_px[after as usize] - self.centres_px[before as usize]
    }

    /// A marker (half) and its neighbours along an axis (a quarter each), with the axis of each that is most
    /// nearly parallel to `direction_px`.
    fn beside(&self, own: usize, axis: usize, direction_px: DVec2) -> [Option<(f64, usize, usize)>; 3] {
        let [before, after] = self.neighbours[own][axis].map(|other| other as usize);
        [(0.5, own), (0.25, before), (0.25, after)].map(|(share, marker)| {
            let along = |axis| abs(self.step_px(marker, axis).normalize_or_zero().dot(direction_px));
            let parallel = usize::from(along(1) > along(0));
            (share == 0.5 || marker != own).then_some((share, marker, parallel))
        })
    }

    /// Second difference along an axis; `None` at the border.
    fn second_px(&self, own: usize, axis: usize) -> Option<DVec2> {
        let [before, after] = self.neighbours[own][axis].map(|other| other as usize);
        (before != own && after != own)
            .then(|| self.centres_px[before] + self.centres_px[after] - self.centres_px[own] * 2.0)
    }

    /// The mean of it across the axis.
    fn bend_px(&self, own: usize, axis: usize) -> Option<DVec2> {
        let (mut sum_px, mut shares) = (DVec2::ZERO, 0.0);
        for (share, marker, axis) in self.beside(own, 1 - axis, self.step_px(own, axis)).into_iter().flatten()
        {
            if let Some(second_px) = self.second_px(marker, axis) {
                sum_px += second_px * share;
                shares += share;
            }
        }
        (shares > 0.0).then(|| sum_px / shares)
    }

    /// The fold of a marker that moves without those beside it, which halve its mean second difference.
    fn alone(&self, own: usize, axis: usize, bend_px: Option<DVec2>) -> Folded {
        let apart_px = self.second_px(own, axis).zip(bend_px).map(|(second_px, bend_px)| second_px - bend_px);
        let fold_px = 2.0 * apart_px.unwrap_or_default();
        Folded {
            folds_px: [(1.0, fold_px), (0.0, fold_px), (0.0, fold_px)],
            square_px2: fold_px.length_squared(),
        }
    }

    /// The folds near a marker, along an axis, from the mean second differences of all.
    fn folded(&self, own: usize, axis: usize, bends_px: &[[Option<DVec2>; 2]]) -> Option<Folded> {
        let near = self.beside(own, axis, self.step_px(own, axis)).map(|near| {
            let (share, marker, axis) = near?;
            Some((share, bends_px[marker][axis]?))
        });
        let shares: f64 = near.iter().flatten().map(|(share, _)| share).sum();
        let folds_px =
            near.map(|near| near.map_or((0.0, DVec2::ZERO), |(share, bend)| (share / shares, bend)));
        let square_px2 = folds_px.iter().map(|(share, fold)| share * fold.length_squared()).sum();
        (shares > 0.0).then_some(Folded { folds_px, square_px2 })
    }

    /// Cube of a dot's radius in pitches, from its share of the cell between its neighbours.
    fn cube(&self, own: usize, area_px2: u32) -> f64 {
        let step_px = |axis: usize| {
            let [before, after] = self.neighbours[own][axis].map(|other| other as usize);
            let steps = f64::from(u8::from(before != own) + u8::from(after != own));
            self.step_px(own, axis) / steps.max(1.0)
        };
        let cell_px2 = abs(step_px(0).perp_dot(step_px(1)));
        let square = (f64::from(area_px2) / (PI * cell_px2)).min(MAX_RADIUS_PITCHES * MAX_RADIUS_PITCHES);
        square * sqrt(square)
    }
}

/// Neighbours of a marker along two axes, among those nearest to it: along each axis the nearest two that are
/// opposite each other or, at a border, the nearest one.
fn neighbours(centres_px: &[DVec2], own: usize, nearest: [u32; NEAREST]) -> Neighbours {
    let alone = [own as u32; 2];
    let step_px = |other: u32| centres_px[other as usize] - centres_px[own];
    let pair = |first: Option<DVec2>| {
        let is_across = |step_px: DVec2| {
            first.is_none_or(|first| {
                abs(first.perp_dot(step_px)) >= MIN_SINE * first.length() * step_px.length()
            })
        };
        let candidates =
            || nearest.iter().copied().filter(|&other| other != own as u32 && is_across(step_px(other)));
        let (mut best, mut least_px) = (None, f64::INFINITY);
        for (k, one) in candidates().enumerate() {
            for other in candidates().skip(k + 1) {
                let (a_px, b_px) = (step_px(one), step_px(other));
                let (a, b) = (a_px.length(), b_px.length());
                if (a_px + b_px).length() <= MAX_OFF * a.min(b) && a + b < least_px {
                    (best, least_px) = (Some([one, other]), a + b);
                }
            }
        }
        best.or_else(|| candidates().next().map(|other| [own as u32, other])).unwrap_or(alone)
    };
    let first = pair(None);
    let along_px = centres_px[first[1] as usize] - centres_px[first[0] as usize];
    [first, pair(Some(along_px))]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::linalg::Symmetric;
    use crate::math::random::Stream;
    use proptest::prelude::*;

    const SIDE: usize = 15;
    const MIDDLE: usize = SIDE * SIDE / 2;
    /// Radius of the dots in pitches.
    const RADIUS: f64 = 0.25;
    /// Large, so that areas in whole pixels have no error.
    const PITCH_PX: f64 = 1000.0;

    fn place(k: usize) -> DVec2 {
        let half = (SIDE / 2) as f64;
        DVec2::new((k % SIDE) as f64 - half, (k / SIDE) as f64 - half)
    }

    /// Covariance that folds add to every marker at these places.
    fn added(centres_px: Vec<DVec2>, area_px2: f64) -> Vec<Symmetric<2>> {
        let mut markers = Markers::at(centres_px, 0.0);
        markers.area_px2.fill(area_px2 as u32);
        Folds::default().widen(&mut markers);
        markers.covariance_px2
    }

    /// Of a lattice with pitch `PITCH_PX`, turned, whose markers are moved by this many pitches.
    fn added_by(turn: f64, moved: impl Fn(DVec2) -> DVec2) -> Vec<Symmetric<2>> {
        let turned = |k| DVec2::from_angle(turn).rotate(place(k) + moved(place(k))) * PITCH_PX;
        added((0..SIDE * SIDE).map(turned).collect(), PI * RADIUS * RADIUS * PITCH_PX * PITCH_PX)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// A fold anywhere near the middle adds on average what the law says: across its direction of motion
        /// by the moved far side, and along the lattice by its changed weight.
        #[test]
        fn folds_anywhere_add_the_mean_square_of_what_they_move(turn in 0.0..6.3_f64) {
            const ANGLE: f64 = 0.01;
            let (mut found, mut expected) = ([[0.0; 2]; 2], [[0.0; 2]; 2]);
            for n in 0..160 {
                let at = (f64::from(n) + 0.5) / 40.0 - 2.0;
                let covariance = added_by(turn, |p| DVec2::Y * ANGLE * (p.x - at).max(0.0))[MIDDLE];
                (0..4).for_each(|k| found[k / 2][k % 2] += covariance[k / 2][k % 2] / 40.0);
            }
            let (cube, fold) = (RADIUS * RADIUS * RADIUS, ANGLE * PITCH_PX);
            let axes = [DVec2::X, DVec2::Y].map(|axis| DVec2::from_angle(turn).rotate(axis));
            // A second difference of a fold by 1 has the mean square 2/3 over all of its places.
            add_moved(&mut expected, cube, 2.0 / 3.0 * fold * fold, axes[1].to_array());
            add_weighed(&mut expected, cube, 2.0 / 3.0 * fold * fold, axes[0].to_array());
            // To the order of the angle, by which the steps' directions and the cell differ.
            let most = 0.05 * (expected[0][0] + expected[1][1]);
            for k in 0..4 {
                let off = found[k / 2][k % 2] - expected[k / 2][k % 2];
                prop_assert!(abs(off) < most, "{found:?} {expected:?}");
            }
        }

        /// Errors of the print widen the variances of a gel at rest by a fifth on average, also in
        /// perspective, with a twentieth of the markers missing.
        #[test]
        fn errors_of_the_print_are_no_folds(
            turn in 0.0..6.3_f64, tilt in -0.01..0.01_f64, seed in any::<u64>(), hexagonal in any::<bool>(),
        ) {
            // Errors of 1 % of the pitch, and centres known to a tenth of that.
            let mut random = Stream::new(seed, "print");
            let mut error = || DVec2::new(random.normal(), random.normal()) * 0.01;
            let all = (0..SIDE * SIDE).map(|k| {
                let p = if hexagonal {
                    DVec2::new(place(k).x + 0.5 * (k / SIDE % 2) as f64, place(k).y * sqrt(0.75))
                } else {
                    place(k)
                };
                DVec2::from_angle(turn).rotate((p + error()) / (1.0 + tilt * p.x)) * PITCH_PX
            });
            let centres_px: Vec<DVec2> = all.collect();
            let kept = centres_px.into_iter().filter(|_| random.uniform() > 0.05).collect();
            let variances = added(kept, PI * RADIUS * RADIUS * PITCH_PX * PITCH_PX);
            let own_px2 = 1e-6 * PITCH_PX * PITCH_PX;
            let shares = variances.iter().map(|v| own_px2 / (own_px2 + 0.5 * (v[0][0] + v[1][1])));
            let share = shares.sum::<f64>() / variances.len() as f64;
            prop_assert!(share > 0.8, "{share}");
        }

        /// Nothing is added to dots at random, and nothing that is not finite to any, coincident ones
        /// included.
        #[test]
        fn dots_without_rows_have_no_folds(
            seed in any::<u64>(), count in 0_usize..300, coarse in any::<bool>(),
        ) {
            let mut random = Stream::new(seed, "dots");
            let mut at = || {
                let at = DVec2::new(random.uniform(), random.uniform()) * 20.0;
                if coarse { DVec2::new(f64::from(at.x as u8 / 5), 0.0) } else { at }
            };
            let variances = added((0..count).map(|_| at() * PITCH_PX).collect(), 1e5);
            let traces = variances.iter().map(|v| v[0][0] + v[1][1]);
            prop_assert!(traces.clone().all(f64::is_finite));
            let widest_px = sqrt(traces.fold(0.0, f64::max));
            prop_assert!(widest_px == 0.0 || coarse || count < 40, "{widest_px}");
        }
    }
}
