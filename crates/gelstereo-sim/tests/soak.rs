//! A day at 30 frames a second is 2.6 million frames: identities must not wander, and memory must not grow.
//!
//! The test runs as many as a test may; `GELSTEREO_SOAK_FRAMES=2600000` runs them all (in release mode 25
//! minutes).
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use crate::counting;

use counting::{ALLOCATIONS, HELD};
use gelstereo_core::contact::RestSurface;
use gelstereo_core::detect::Markers;
use gelstereo_core::lattice;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_core::params::Params;
use gelstereo_core::rig::Rig;
use gelstereo_core::track::{Certainty, MarkerState, Tracks, VerifiedTracker};
use gelstereo_core::triangulate::{Centre, Triangulator};
use gelstereo_sim::effects::Effects;
use gelstereo_sim::{ContactState, Scene, Shape, Simulator, Truth};

const SIGMA_PX: f64 = 0.05;
const SIZE_PX: (usize, usize) = (640, 480);
/// Detections that are no marker, in each view.
const SPECKS: usize = 3;
/// Radius of what hides all markers below it.
const SMEAR_PX: f64 = 40.0;

/// Where all markers are in one moment.
#[derive(Clone)]
struct Moment {
    points_mm: Vec<DVec3>,
    views_px: [Vec<DVec2>; 2],
}

/// A ball is pressed 1.6 mm deep, moved to another place and pressed again, over and over.
fn moments(scene: &Scene) -> Vec<Moment> {
    let mut simulator = Simulator::new(scene, None).unwrap();
    let mut truth = Truth::default();
    (0..240)
        .map(|k| {
            let phase = f64::from(k % 40) / 20.0;
            let depth_mm = 1.6 * (1.0 - (phase - 1.0).abs());
            let place = f64::from(k / 40);
            let at = DVec3::new(4.0 + 1.7 * place - 4.0, 3.0 - 1.2 * place, 40.0);
            let contact = simulator.pressed(Pose::from_translation_mm(at), depth_mm);
            let contact = contact.filter(|_| depth_mm > 0.0).map(ContactState::pressed);
            simulator.truth(contact.as_ref(), &mut truth);
            let views_px = [truth.left_px.clone(), truth.right_px.clone()];
            Moment { points_mm: truth.points_mm.clone(), views_px }
        })
        .collect()
}

/// One view's detections: noise, two markers of a hundred missed, those under a smear, specks, in another
/// order every time; gives how many markers are shown.
fn detect(
    truth_px: &[DVec2],
    missing: f64,
    smear_px: Option<DVec2>,
    random: &mut Stream,
    out: &mut Markers,
) -> usize {
    out.centres_px.clear();
    for &at in truth_px {
        let (x, y) = random.normal_pair();
        let hidden = smear_px.is_some_and(|smear| at.distance(smear) < SMEAR_PX);
        if random.uniform() >= missing && !hidden {
            out.centres_px.push(at + DVec2::new(x, y) * SIGMA_PX);
        }
    }
    let shown = out.centres_px.len();
    for _ in 0..if missing > 0.0 { SPECKS } else { 0 } {
        let at = DVec2::new(random.uniform() * SIZE_PX.0 as f64, random.uniform() * SIZE_PX.1 as f64);
        let other = random.below(out.centres_px.len() + 1);
        out.centres_px.push(at);
        let last = out.centres_px.len() - 1;
        out.centres_px.swap(other, last);
    }
    // No two frames are known equally well.
    let variance_px2 = SIGMA_PX * SIGMA_PX * (0.9 + 0.2 * random.uniform());
    finish(variance_px2, out);
    shown
}

fn finish(variance_px2: f64, out: &mut Markers) {
    let count = out.centres_px.len();
    out.covariance_px2.clear();
    out.covariance_px2.resize(count, [[variance_px2, 0.0], [0.0, variance_px2]]);
    out.area_px2.clear();
    out.area_px2.resize(count, 60);
}

/// For half of the time a smear hides some of the markers, long enough for them to be lost.
fn smear(frame: usize) -> Option<DVec2> {
    let place = (frame / 40) as f64;
    (frame % 40 < 20).then(|| DVec2::new(200.0 + 47.0 * (place % 6.0), 150.0 + 31.0 * (place % 7.0)))
}

/// What went wrong, and how good what went right was.
#[derive(Clone, Copy, Debug, Default)]
struct Counters {
    frames: usize,
    uncertain: usize,
    /// Markers detected, and markers seen by the trackers.
    shown: usize,
    seen: usize,
    lost: usize,
    /// Seen markers whose covariance is not this frame's.
    stale: usize,
    /// Seen markers that stand nearer to where another one is.
    renamed: usize,
    points: usize,
    square_mm2: f64,
}

impl Counters {
    fn rms_mm(&self) -> f64 {
        (self.square_mm2 / self.points as f64).sqrt()
    }
}

struct Sensor {
    trackers: [VerifiedTracker; 2],
    tracks: [Tracks; 2],
    markers: Markers,
    triangulator: Triangulator,
    rest: RestSurface,
    points_mm: Vec<DVec3>,
    indentation_mm: Vec<f64>,
    random: Stream,
    frame: usize,
}

/// All that a frame says.
#[derive(Debug, PartialEq)]
struct Sensed {
    tracks: [Tracks; 2],
    points_mm: Vec<DVec3>,
    indentation_mm: Vec<f64>,
}

impl Sensor {
    fn new(rig: &Rig, params: &Params, moment: &Moment) -> Self {
        let mut random = Stream::new(1, "soak");
        let mut markers = Markers::at(Vec::with_capacity(1000), SIGMA_PX);
        markers.covariance_px2.reserve(1000);
        markers.area_px2.reserve(1000);
        let mut tracks = [Tracks::default(), Tracks::default()];
        let mut trackers = [0; 2].map(|_| VerifiedTracker::new(&params.track, SIZE_PX));
        for ((tracker, tracks), px) in trackers.iter_mut().zip(&mut tracks).zip(&moment.views_px) {
            detect(px, 0.0, None, &mut random, &mut markers);
            let rest =
                lattice::rest_lattice(&markers.centres_px, &params.lattice, params.label.tolerance_pitches)
                    .unwrap();
            tracker.initialise(&rest, &markers, 1000, tracks);
        }
        let mut triangulator = Triangulator::new(rig, &params.triangulate).unwrap();
        triangulator.fit_map(&moment.points_mm);
        let rest = RestSurface::new(&moment.points_mm).unwrap();
        let points_mm = moment.points_mm.clone();
        Self {
            trackers,
            tracks,
            markers,
            triangulator,
            rest,
            points_mm,
            indentation_mm: Vec::with_capacity(625),
            random,
            frame: 0,
        }
    }

    /// What it makes of two frames without noise, all markers in the first, every seventh missing in the
    /// second: nothing but these and the rest frame may show in it.
    fn sense_twice(&mut self, moment: &Moment) -> Sensed {
        for missing in [false, true] {
            for (k, truth) in moment.views_px.iter().enumerate() {
                let shown = truth.iter().enumerate().filter(|(n, _)| !(missing && n % 7 == 3));
                self.markers.centres_px.clear();
                self.markers.centres_px.extend(shown.map(|(_, &at)| at));
                finish(SIGMA_PX * SIGMA_PX, &mut self.markers);
                assert_eq!(self.trackers[k].run(&self.markers, &mut self.tracks[k]), Certainty::Certain);
            }
        }
        let ready = self.triangulator.ready();
        let centre =
            |t: &Tracks, n: usize| Centre { at_px: t.positions_px[n], covariance_px2: t.covariance_px2[n] };
        for (n, point_mm) in self.points_mm.iter_mut().enumerate() {
            let [l, r] = [0, 1].map(|k| centre(&self.tracks[k], n));
            *point_mm = ready.point(n, &l, &r).unwrap().point_mm;
        }
        self.rest.indentation_mm(&self.points_mm, &mut self.indentation_mm).unwrap();
        let (points_mm, indentation_mm) = (self.points_mm.clone(), self.indentation_mm.clone());
        Sensed { tracks: self.tracks.clone(), points_mm, indentation_mm }
    }

    fn step(&mut self, moment: &Moment, counters: &mut Counters) {
        counters.frames += 1;
        self.frame += 1;
        for k in 0..2 {
            let (truth, tracks) = (&moment.views_px[k], &mut self.tracks[k]);
            counters.shown += detect(truth, 0.02, smear(self.frame), &mut self.random, &mut self.markers);
            let covariance_px2 = self.markers.covariance_px2[0];
            let verdict = self.trackers[k].run(&self.markers, tracks);
            counters.uncertain += usize::from(verdict == Certainty::Uncertain);
            for (n, &at) in tracks.positions_px.iter().enumerate() {
                counters.lost += usize::from(tracks.state[n] == MarkerState::Lost);
                if tracks.state[n] == MarkerState::Seen {
                    counters.seen += 1;
                    counters.stale += usize::from(tracks.covariance_px2[n] != covariance_px2);
                    counters.renamed += usize::from(is_another(truth, n, at));
                }
            }
        }
        let ready = self.triangulator.ready();
        let [left, right] = &self.tracks;
        for n in 0..moment.points_mm.len() {
            if left.state[n].max(right.state[n]) != MarkerState::Seen {
                continue;
            }
            let [l, r] = [left, right]
                .map(|t| Centre { at_px: t.positions_px[n], covariance_px2: t.covariance_px2[n] });
            // A speck beside a marker that was missed may pass for it: that is no point of the marker.
            let near = |at: DVec2, truth: DVec2| at.distance(truth) < 6.0 * SIGMA_PX;
            if near(l.at_px, moment.views_px[0][n]) && near(r.at_px, moment.views_px[1][n]) {
                self.points_mm[n] = ready.point(n, &l, &r).unwrap().point_mm;
                counters.points += 1;
                counters.square_mm2 += self.points_mm[n].distance_squared(moment.points_mm[n]);
            }
        }
        self.rest.indentation_mm(&self.points_mm, &mut self.indentation_mm).unwrap();
    }
}

/// Whether some marker beside this one is nearer.
fn is_another(truth_px: &[DVec2], n: usize, at: DVec2) -> bool {
    let own = at.distance_squared(truth_px[n]);
    let around = [n.wrapping_sub(1), n + 1, n.wrapping_sub(25), n + 25];
    around.into_iter().filter_map(|m| truth_px.get(m)).any(|other| at.distance_squared(*other) < own)
        || own > 17.0 * 17.0
}

#[test]
fn row_35_a_day_of_frames_keeps_every_name_and_every_byte() {
    let wanted = std::env::var("GELSTEREO_SOAK_FRAMES").ok().and_then(|text| text.parse().ok());
    let frames: usize = wanted.unwrap_or(2000);
    let scene = Scene {
        indenter: Some(Shape::Sphere { radius_mm: 5.0 }),
        effects: Effects::of_gel(),
        ..Scene::default()
    };
    let moments = moments(&scene);
    let mut sensor = Sensor::new(&scene.rig, &Params::preset("balanced").unwrap(), &moments[0]);
    let mut first = Counters::default();
    moments.iter().for_each(|moment| sensor.step(moment, &mut first));
    let early = sensor.sense_twice(&moments[0]);
    let before = (ALLOCATIONS.get(), HELD.get());
    assert!(before.0 > 0, "the counter counts");
    let (mut all, mut last) = (Counters::default(), Counters::default());
    for k in 0..frames {
        sensor.step(&moments[k % moments.len()], &mut all);
    }
    let after = (ALLOCATIONS.get(), HELD.get());
    assert_eq!(sensor.sense_twice(&moments[0]), early, "what was seen in between shows");
    moments.iter().for_each(|moment| sensor.step(moment, &mut last));
    println!("{frames} frames: {all:?}, rms {:.5} mm; first round {first:?}, last {last:?}", all.rms_mm());
    assert_eq!(after, before, "allocations, and bytes held");
    assert_eq!((all.renamed, first.renamed, last.renamed), (0, 0, 0), "{all:?}");
    assert_eq!(all.uncertain, 0, "{all:?}");
    assert_eq!(all.stale, 0, "{all:?}");
    // Specks take away and give few; what was lost under a smear is seen as soon as it shows.
    assert!(all.lost > 0 && all.seen as f64 > 0.99 * all.shown as f64, "{all:?}");
    // 150 000 points each have an rms known to 0.2 %.
    assert!((last.rms_mm() / first.rms_mm() - 1.0).abs() < 0.01, "{first:?} {last:?}");
}
