//! Identities of markers in any layout: right, or not claimed.

use gelstereo_core::detect::Markers;
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::TrackParams;
use gelstereo_core::track::{
    Certainty, MIN_MARKERS, MarkerState, ScatteredTracker, TooFewMarkers, Tracks, pair_views,
};
use proptest::prelude::*;

const SIZE_PX: (usize, usize) = (640, 480);
const SIGMA_PX: f64 = 0.05;

/// Prints that are no square lattice, some 20 px apart.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Layout {
    Random,
    Hexagonal,
    Rectangular,
    /// A square lattice of which one in six markers is missing.
    Gaps,
}

const LAYOUTS: [Layout; 4] = [Layout::Random, Layout::Hexagonal, Layout::Rectangular, Layout::Gaps];

/// Rest positions at least 60 px inside the image.
fn print(layout: Layout, stream: &mut Stream) -> Vec<DVec2> {
    let steps = match layout {
        Layout::Hexagonal => [DVec2::new(22.0, 0.0), DVec2::new(11.0, 19.05)],
        Layout::Rectangular => [DVec2::new(17.0, 0.0), DVec2::new(0.0, 25.0)],
        _ => [DVec2::new(20.0, 0.0), DVec2::new(0.0, 20.0)],
    };
    let inside = |p: &DVec2| p.x >= 60.0 && p.x <= 580.0 && p.y >= 60.0 && p.y <= 420.0;
    if layout == Layout::Random {
        // At least 14 px apart, so that dots do not merge.
        let mut points: Vec<DVec2> = Vec::new();
        for _ in 0..4000 {
            let at = DVec2::new(60.0, 60.0) + DVec2::new(520.0 * stream.uniform(), 360.0 * stream.uniform());
            if points.iter().all(|p| p.distance(at) > 14.0) {
                points.push(at);
            }
        }
        return points;
    }
    let places = (-30..60).flat_map(|i| (0..40).map(move |j| (f64::from(i), f64::from(j))));
    let points: Vec<DVec2> =
        places.map(|(i, j)| DVec2::new(60.0, 60.0) + steps[0] * i + steps[1] * j).filter(inside).collect();
    points.into_iter().filter(|_| layout != Layout::Gaps || stream.uniform() > 1.0 / 6.0).collect()
}

/// A smooth deformation of the gel: shift, turn about the middle, and a press that spreads the markers.
#[derive(Clone, Copy, Debug, Default)]
struct Warp {
    shift_px: DVec2,
    turn_rad: f64,
    press_px: f64,
}

impl Warp {
    fn apply(&self, rest_px: DVec2) -> DVec2 {
        let middle = DVec2::new(320.0, 240.0);
        let apart = rest_px - middle;
        let (sin, cos) = self.turn_rad.sin_cos();
        let turned = DVec2::new(cos * apart.x - sin * apart.y, sin * apart.x + cos * apart.y);
        // Largest strain 0.86 press / 60 px, at 42 px.
        let press = turned * (self.press_px / 60.0 * (-apart.length_squared() / 3600.0).exp());
        middle + turned + press + self.shift_px
    }

    fn scaled(&self, share: f64) -> Self {
        Self {
            shift_px: self.shift_px * share,
            turn_rad: self.turn_rad * share,
            press_px: self.press_px * share,
        }
    }
}

/// Detections in random order, and the marker of each.
fn see(
    rest_px: &[DVec2],
    warp: &Warp,
    missing: f64,
    specks: usize,
    stream: &mut Stream,
) -> (Markers, Vec<Option<usize>>) {
    let mut all: Vec<(f64, DVec2, Option<usize>)> = Vec::new();
    for (n, &rest) in rest_px.iter().enumerate() {
        let noise = DVec2::new(stream.normal(), stream.normal()) * SIGMA_PX;
        if stream.uniform() >= missing {
            all.push((stream.uniform(), warp.apply(rest) + noise, Some(n)));
        }
    }
    for _ in 0..specks {
        let at = DVec2::new(640.0 * stream.uniform(), 480.0 * stream.uniform());
        all.push((stream.uniform(), at, None));
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let identity = all.iter().map(|one| one.2).collect();
    (Markers::at(all.into_iter().map(|one| one.1).collect(), SIGMA_PX), identity)
}

/// Result of a frame: numbers of seen markers, of those that have the name of another one, and of specks that
/// were taken for a marker.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    certainty: Certainty,
    seen: usize,
    wrong: usize,
    specks: usize,
}

struct Run {
    rest_px: Vec<DVec2>,
    tracker: ScatteredTracker,
    tracks: Tracks,
    stream: Stream,
}

impl Run {
    fn start(layout: Layout, seed: u64) -> Self {
        let mut stream = Stream::new(seed, "scattered");
        let rest_px = print(layout, &mut stream);
        let mut tracker = ScatteredTracker::new(&TrackParams::default(), SIZE_PX);
        let mut tracks = Tracks::default();
        tracker.initialise(&Markers::at(rest_px.clone(), SIGMA_PX), 2000, &mut tracks).unwrap();
        Self { rest_px, tracker, tracks, stream }
    }

    fn step(&mut self, warp: &Warp, missing: f64, specks: usize) -> Step {
        let (detected, identity) = see(&self.rest_px, warp, missing, specks, &mut self.stream);
        let certainty = self.tracker.run(&detected, &mut self.tracks);
        let mut step = Step { certainty, seen: 0, wrong: 0, specks: 0 };
        for n in (0..self.rest_px.len()).filter(|&n| self.tracks.state[n] == MarkerState::Seen) {
            let is_it = |centre: &DVec2| *centre == self.tracks.positions_px[n];
            let m = detected.centres_px.iter().position(is_it).unwrap();
            step.seen += 1;
            step.wrong += usize::from(identity[m].is_some_and(|marker| marker != n));
            step.specks += usize::from(identity[m].is_none());
        }
        step
    }
}

fn layouts() -> impl Strategy<Value = Layout> {
    prop::sample::select(LAYOUTS.to_vec())
}

proptest! {
    /// Over a gentle sequence, nothing has a wrong name, and all that is detected has a name.
    #[test]
    fn markers_of_any_layout_keep_their_names(
        layout in layouts(), seed in 0..10_000_u64, x in -20.0..20.0, y in -20.0..20.0,
        turn_deg in -10.0..10.0_f64, press_px in 0.0..15.0,
    ) {
        let warp = Warp { shift_px: DVec2::new(x, y), turn_rad: turn_deg.to_radians(), press_px };
        let mut run = Run::start(layout, seed);
        for k in 1..=8 {
            let step = run.step(&warp.scaled(f64::from(k) / 8.0), 0.05, 10);
            prop_assert_eq!((step.certainty, step.wrong), (Certainty::Certain, 0), "frame {}", k);
            // A speck beside the place of a marker that is not detected looks like this marker.
            prop_assert!(step.specks <= 4, "frame {}: {:?}", k, step);
            prop_assert!(step.seen * 100 >= run.rest_px.len() * 88, "frame {}: {:?}", k, step);
        }
    }

    /// A step between two frames by up to two spacings keeps the names, or nothing is claimed.
    #[test]
    fn a_large_step_is_followed_or_not_claimed(
        layout in layouts(), seed in 0..10_000_u64, x in -40.0..40.0, y in -40.0..40.0,
        turn_deg in -3.0..3.0_f64,
    ) {
        let warp = Warp { shift_px: DVec2::new(x, y), turn_rad: turn_deg.to_radians(), press_px: 0.0 };
        let mut run = Run::start(layout, seed);
        let step = run.step(&warp, 0.02, 5);
        prop_assert_eq!(step.wrong, 0);
        if layout == Layout::Random || layout == Layout::Gaps {
            prop_assert_eq!(step.certainty, Certainty::Certain);
        }
    }

    /// Frames of clutter are not claimed, and the print is found again afterwards.
    #[test]
    fn clutter_is_not_claimed(layout in layouts(), seed in 0..10_000_u64, share in 0.3..2.0_f64) {
        let mut run = Run::start(layout, seed);
        let specks = (share * run.rest_px.len() as f64) as usize;
        for _ in 0..3 {
            let step = run.step(&Warp::default(), 1.0, specks);
            prop_assert_eq!((step.certainty, step.seen), (Certainty::Uncertain, 0));
            prop_assert!(!run.tracks.is_current());
        }
        let step = run.step(&Warp::default(), 0.0, 0);
        prop_assert_eq!((step.certainty, step.seen, step.wrong), (Certainty::Certain, run.rest_px.len(), 0));
    }

    /// Whatever the detections are, the result is finite and the same again.
    #[test]
    fn any_detections_give_finite_tracks(
        points in prop::collection::vec((0..640_i32, 0..480_i32), 0..200), seed in 0..100_u64,
    ) {
        let mut run = Run::start(Layout::Random, seed);
        let centres = points.iter().map(|&(x, y)| DVec2::new(f64::from(x), f64::from(y))).collect();
        let detected = Markers::at(centres, SIGMA_PX);
        let (mut again, mut tracks) = (run.tracker.clone(), run.tracks.clone());
        let _ = run.tracker.run(&detected, &mut run.tracks);
        let _ = again.run(&detected, &mut tracks);
        prop_assert_eq!(&run.tracks, &tracks);
        prop_assert!(tracks.positions_px.iter().all(|p| p.is_finite()));
        prop_assert!(tracks.covariance_px2.iter().flatten().flatten().all(|v| v.is_finite()));
    }
}

/// Held markers: their stated covariance against their true error, over all layouts.
#[test]
fn the_covariance_of_held_markers_fits_their_errors() {
    for layout in LAYOUTS {
        let (mut squares, mut count, mut beyond) = (0.0, 0.0, 0);
        for seed in 0..20 {
            let mut run = Run::start(layout, seed);
            for k in 1..=6 {
                let warp = Warp { shift_px: DVec2::new(2.0, -1.0), turn_rad: 0.01, press_px: 2.0 };
                let warp = warp.scaled(f64::from(k));
                let _ = run.step(&warp, 0.1, 0);
                for n in (0..run.rest_px.len()).filter(|&n| run.tracks.state[n] == MarkerState::Held) {
                    let variance = run.tracks.covariance_px2[n][0][0];
                    let square =
                        run.tracks.positions_px[n].distance_squared(warp.apply(run.rest_px[n])) / variance;
                    squares += square;
                    count += 2.0;
                    beyond += i32::from(square > 25.0);
                }
            }
        }
        assert!(count > 400.0);
        assert!((0.7..1.3).contains(&(squares / count)), "{layout:?}: {}", squares / count);
        assert!(f64::from(beyond) < 0.02 * count, "{layout:?}: {beyond} of {count}");
    }
}

#[test]
fn markers_are_held_then_lost_then_seen_again() {
    let mut run = Run::start(Layout::Random, 1);
    let gone = 30;
    for frame in 1..=20_u32 {
        let mut rest = run.rest_px.clone();
        rest.remove(gone);
        let _ = run.tracker.run(&Markers::at(rest, SIGMA_PX), &mut run.tracks);
        let expected = if frame <= 15 { MarkerState::Held } else { MarkerState::Lost };
        assert_eq!(run.tracks.state[gone], expected, "frame {frame}");
        assert!(run.tracks.positions_px[gone].distance(run.rest_px[gone]) < 0.2);
    }
    let _ = run.step(&Warp::default(), 0.0, 0);
    assert_eq!(run.tracks.state[gone], MarkerState::Seen);
}

#[test]
fn too_few_markers_are_refused_and_nothing_is_lost() {
    let mut run = Run::start(Layout::Random, 1);
    let before = run.tracks.clone();
    let few = Markers::at(run.rest_px[..MIN_MARKERS - 1].to_vec(), SIGMA_PX);
    assert_eq!(
        run.tracker.initialise(&few, 2000, &mut run.tracks),
        Err(TooFewMarkers { found: MIN_MARKERS - 1 })
    );
    assert_eq!(run.tracks, before);
    assert_eq!(run.step(&Warp::default(), 0.0, 0).certainty, Certainty::Certain);
}

/// A regular print wider than the view, moved by half its pitch, may have moved either way: nothing is
/// claimed.
#[test]
fn two_displacements_that_fit_equally_well_are_not_claimed() {
    let seen = |shift_px: f64| -> Markers {
        let places = (-40..80).flat_map(|i| (-40..80).map(move |j| DVec2::new(f64::from(i), f64::from(j))));
        let points = places.map(|place| place * 20.0 + DVec2::new(10.0 + shift_px, 10.0));
        let in_view = |p: &DVec2| p.x > 8.0 && p.x < 632.0 && p.y > 8.0 && p.y < 472.0;
        let centres_px: Vec<DVec2> = points.filter(in_view).collect();
        let covariance_px2 = vec![[[SIGMA_PX * SIGMA_PX, 0.0], [0.0, SIGMA_PX * SIGMA_PX]]; centres_px.len()];
        Markers { centres_px, covariance_px2, ..Markers::default() }
    };
    let (mut tracker, mut tracks) =
        (ScatteredTracker::new(&TrackParams::default(), SIZE_PX), Tracks::default());
    tracker.initialise(&seen(0.0), 1000, &mut tracks).unwrap();
    assert_eq!(tracker.run(&seen(2.0), &mut tracks), Certainty::Certain);
    assert_eq!(tracker.run(&seen(12.0), &mut tracks), Certainty::Uncertain);
}

/// Where the rows of both views differ by more than a quarter of the spacing, nothing is paired.
#[test]
fn markers_on_other_rows_are_not_paired() {
    let left_px = print(Layout::Random, &mut Stream::new(3, "print"));
    let spacing_px = {
        let (mut tracker, mut tracks) =
            (ScatteredTracker::new(&TrackParams::default(), SIZE_PX), Tracks::default());
        let covariance_px2 = vec![[[1e-3, 0.0], [0.0, 1e-3]]; left_px.len()];
        let rest = Markers { centres_px: left_px.clone(), covariance_px2, ..Markers::default() };
        tracker.initialise(&rest, 1000, &mut tracks).unwrap();
        tracker.spacing_px()
    };
    // Rows that agree in the middle, and differ by 0.4 spacings at both sides.
    let off_px = |p: DVec2| 0.4 * spacing_px * (p.x - 320.0) / 260.0;
    let right_px: Vec<DVec2> = left_px.iter().map(|&p| p - DVec2::new(50.0, off_px(p))).collect();
    let pairs = pair_views(&left_px, &right_px).unwrap();
    assert!(pairs.len() < left_px.len(), "{} of {}", pairs.len(), left_px.len());
    for (n, m) in pairs {
        assert!(n == m && off_px(left_px[n as usize]).abs() <= 0.25 * spacing_px);
    }
}
