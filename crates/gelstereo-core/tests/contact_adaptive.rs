//! The adaptive saliency on gels of several closed laws, which share nothing with the rule.

use gelstereo_core::contact::{AdaptiveSaliency, ContactError, ContactRule, RestSurface};
use gelstereo_core::math::DVec3;
use gelstereo_core::track::MarkerState::{self, Held, Seen};
use proptest::prelude::*;

const SIDE: usize = 25;
const MARKERS: usize = SIDE * SIDE;
const PITCH_MM: f64 = 0.85;
/// Reach of a second difference.
const FAR_MM: f64 = PITCH_MM;
const SIGMA_MM: f64 = 0.005;

fn places() -> impl Iterator<Item = (f64, f64)> {
    let at = |k: usize| PITCH_MM * (k as f64 - 12.0);
    (0..MARKERS).map(move |i| (at(i % SIDE), at(i / SIDE)))
}

fn flat() -> RestSurface {
    RestSurface::new(&places().map(|(x, y)| DVec3::new(x, y, 27.0)).collect::<Vec<_>>()).unwrap()
}

/// How a gel returns to rest beside a contact, whose edge lies at this height, by the distance from the edge.
#[derive(Clone, Copy, Debug)]
enum Law {
    /// It does so at once.
    NoShoulder,
    /// Over this length.
    Exponential(f64),
    /// Down below its rest height: a gel that keeps its volume.
    Bulge(f64),
}

impl Law {
    fn height_mm(self, edge_mm: f64, distance_mm: f64) -> f64 {
        match self {
            Self::NoShoulder => 0.0,
            Self::Exponential(length_mm) => edge_mm * (-distance_mm / length_mm).exp(),
            Self::Bulge(length_mm) => {
                let over = distance_mm / length_mm;
                edge_mm * (1.0 - over) * (-over).exp()
            }
        }
    }
}

/// A ball that is in contact up to `radius_mm` around a place, where the gel leaves it at the height
/// `edge_mm`.
#[derive(Clone, Copy, Debug)]
struct Press {
    law: Law,
    ball_mm: f64,
    radius_mm: f64,
    edge_mm: f64,
    centre_mm: (f64, f64),
}

impl Press {
    /// Heights, and whether each marker touches.
    fn truth(&self) -> (Vec<f64>, Vec<bool>) {
        let sink_mm = |r: f64| (self.ball_mm * self.ball_mm - r * r).sqrt();
        let heights = places().map(|(x, y)| {
            let r = (x - self.centre_mm.0).hypot(y - self.centre_mm.1);
            let touches = r <= self.radius_mm;
            let height = if touches {
                self.edge_mm + sink_mm(r) - sink_mm(self.radius_mm)
            } else {
                self.law.height_mm(self.edge_mm, r - self.radius_mm)
            };
            (height, touches)
        });
        heights.unzip()
    }
}

fn run(heights_mm: &[f64], state: &[MarkerState]) -> (Vec<bool>, Option<ContactRule>) {
    let mut found = Vec::new();
    let mut adaptive = AdaptiveSaliency::new(&flat(), SIDE, SIDE, 2.5).unwrap();
    let variance = std::iter::repeat_n(SIGMA_MM * SIGMA_MM, heights_mm.len());
    let rule = adaptive.run(heights_mm, variance, state, &mut found).unwrap();
    (found, rule)
}

fn presses() -> impl Strategy<Value = Press> {
    let law = prop_oneof![
        Just(Law::NoShoulder),
        (0.5..2.0_f64).prop_map(Law::Exponential),
        (0.5..2.0_f64).prop_map(Law::Bulge),
    ];
    // Without a shoulder the gel leaves the ball at its rest height; elsewhere at up to the depth of the cap
    // (Hertz).
    (law, 3.0..8.0_f64, 0.35..0.6_f64, 0.3..1.0_f64, (-2.0..2.0_f64, -2.0..2.0_f64)).prop_map(
        |(law, ball_mm, share, edge, centre_mm)| {
            let radius_mm = share * ball_mm;
            let cap_mm = ball_mm - (ball_mm * ball_mm - radius_mm * radius_mm).sqrt();
            let edge_mm = if matches!(law, Law::NoShoulder) { 0.0 } else { edge * cap_mm };
            Press { law, ball_mm, radius_mm, edge_mm, centre_mm }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Balls in gels of three laws. A second difference reaches one pitch. Markers more than a pitch from the
    /// edge must get the right label.
    #[test]
    fn row_36_a_ball_is_found_whatever_the_law_of_the_gel(
        press in presses(), noise in prop::collection::vec(-1.7..1.7_f64, MARKERS),
    ) {
        let (heights, truth) = press.truth();
        let heights: Vec<f64> = heights.iter().zip(&noise).map(|(h, e)| h + SIGMA_MM * e).collect();
        let (found, rule) = run(&heights, &[Seen; MARKERS]);
        prop_assert!(rule.is_some());
        for ((i, &touches), (x, y)) in truth.iter().enumerate().zip(places()) {
            let from_edge_mm = (x - press.centre_mm.0).hypot(y - press.centre_mm.1) - press.radius_mm;
            prop_assert!(
                from_edge_mm.abs() < FAR_MM || found[i] == touches,
                "{from_edge_mm} mm {rule:?} {press:?}"
            );
        }
    }

    /// Whatever is said of a marker that is not seen, it is not salient and changes nothing else.
    #[test]
    fn markers_that_are_not_seen_change_nothing(
        press in presses(), gone in prop::collection::vec(0..MARKERS, 1..20), height in -5.0..5.0_f64,
    ) {
        let (mut heights, _) = press.truth();
        let mut state = [Seen; MARKERS];
        gone.iter().for_each(|&i| state[i] = Held);
        let found = run(&heights, &state);
        gone.iter().for_each(|&i| heights[i] = if i % 2 == 0 { height } else { f64::NAN });
        prop_assert_eq!(&run(&heights, &state), &found);
        prop_assert!(gone.iter().all(|&i| !found.0[i]));
    }
}

/// A plate on the whole gel leaves no border: the first rule's answer stands.
#[test]
fn a_gel_that_is_pressed_all_over_is_in_contact_all_over() {
    let (found, rule) = run(&[0.8; MARKERS], &[Seen; MARKERS]);
    assert!(found.iter().all(|&touches| touches));
    assert_eq!(rule, Some(ContactRule::Pressure { decay_mm: 2.5 }));
}

#[test]
fn a_gel_at_rest_touches_nothing() {
    assert_eq!(run(&[0.0; MARKERS], &[Seen; MARKERS]), (vec![false; MARKERS], None));
}

#[test]
fn what_cannot_be_judged_is_refused() {
    let mismatch = |found| ContactError::LengthMismatch { rest: MARKERS, found };
    assert_eq!(AdaptiveSaliency::new(&flat(), SIDE, 24, 2.5).unwrap_err(), mismatch(600));
    for decay_mm in [f64::NAN, 0.0, 2e3] {
        assert!(matches!(
            AdaptiveSaliency::new(&flat(), SIDE, SIDE, decay_mm),
            Err(ContactError::Decay { .. })
        ));
    }
    let mut adaptive = AdaptiveSaliency::new(&flat(), SIDE, SIDE, 2.5).unwrap();
    let mut out = vec![true];
    for (heights, variances, states) in
        [(624, MARKERS, MARKERS), (MARKERS, 624, MARKERS), (MARKERS, MARKERS, 624)]
    {
        let variance = std::iter::repeat_n(25e-6, variances);
        let error = adaptive.run(&vec![0.0; heights], variance, &vec![Seen; states], &mut out);
        assert_eq!(error, Err(mismatch(624)));
        assert!(out.is_empty());
    }
    let mut heights = [0.0; MARKERS];
    heights[9] = f64::NAN;
    let variance = || std::iter::repeat_n(25e-6, MARKERS);
    let error = adaptive.run(&heights, variance(), &[Seen; MARKERS], &mut out);
    assert_eq!(error, Err(ContactError::NotFinite { index: 9 }));
}
