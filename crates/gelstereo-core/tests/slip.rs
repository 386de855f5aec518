//! Slip from markers whose motion is made: rigid where they stick, behind it where they slip.
#![allow(clippy::unwrap_used)]

use gelstereo_core::contact::RestSurface;
use gelstereo_core::force::MovedMarkers;
use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{SlipMethod, SlipParams};
use gelstereo_core::slip::{Slip, SlipError, SlipStatus, SlipTracker, Stick};
use gelstereo_core::track::MarkerState;
use proptest::prelude::*;

const SIDE: usize = 11;
const PITCH_MM: f64 = 0.9;
const Z_MM: f64 = 30.0;
const SIGMA_MM: [f64; 3] = [0.0015, 0.0015, 0.005];

fn rest_mm() -> Vec<DVec3> {
    let at = |i: usize| PITCH_MM * (i as f64 - (SIDE as f64 - 1.0) / 2.0);
    (0..SIDE * SIDE).map(|i| DVec3::new(at(i % SIDE), at(i / SIDE), Z_MM)).collect()
}

fn params(false_alarms_per_hour: f64) -> SlipParams {
    SlipParams { method: SlipMethod::Rigid, false_alarms_per_hour, ..SlipParams::default() }
}

fn tracker(false_alarms_per_hour: f64) -> SlipTracker {
    let rest = RestSurface::new(&rest_mm()).unwrap();
    SlipTracker::new(&params(false_alarms_per_hour), &rest, SIDE).unwrap()
}

/// A round contact, and what is seen of it.
struct Contact {
    /// Where the gel would be if it stuck.
    stuck_mm: Vec<DVec3>,
    points_mm: Vec<DVec3>,
    covariance_mm2: Vec<Symmetric<3>>,
    state: Vec<MarkerState>,
    patch: Vec<bool>,
    random: Stream,
}

impl Contact {
    /// Of this radius around the middle, on a ball.
    fn new(radius_mm: f64, seed: u64) -> Self {
        let mut points_mm = rest_mm();
        let away_mm = |p: &DVec3| p.truncate().length();
        for p in &mut points_mm {
            p.z -= 0.4 - away_mm(p) * away_mm(p) / 20.0;
        }
        let diagonal = |i: usize, k: usize| if i == k { SIGMA_MM[i] * SIGMA_MM[i] } else { 0.0 };
        let covariance = core::array::from_fn(|i| core::array::from_fn(|k| diagonal(i, k)));
        Self {
            patch: points_mm.iter().map(|p| away_mm(p) <= radius_mm).collect(),
            covariance_mm2: vec![covariance; points_mm.len()],
            state: vec![MarkerState::Seen; points_mm.len()],
            points_mm: points_mm.clone(),
            stuck_mm: points_mm,
            random: Stream::new(seed, "slip"),
        }
    }

    /// The gel follows the part's motion since touch, except that these markers stay behind by `lag`. Free
    /// gel follows half of it.
    fn moves(&mut self, pose: &Pose, lag: impl Fn(usize) -> DVec3) {
        let patch = self.patch.clone();
        self.moves_where(&patch, pose, lag);
    }

    /// As [`Self::moves`], where the part touches more than the patch.
    fn moves_where(&mut self, touches: &[bool], pose: &Pose, lag: impl Fn(usize) -> DVec3) {
        for i in 0..self.points_mm.len() {
            let noise = DVec3::from_array(SIGMA_MM.map(|sigma| sigma * self.random.normal()));
            let full_mm = pose.transform_point(self.stuck_mm[i]) - self.stuck_mm[i];
            let share = if touches[i] { 1.0 } else { 0.5 };
            self.points_mm[i] = self.stuck_mm[i] + full_mm * share - lag(i) + noise;
        }
    }

    fn run(&self, tracker: &mut SlipTracker) -> (Vec<Stick>, Option<Slip>) {
        let mut out = Vec::new();
        let Self { points_mm, covariance_mm2, state, patch, .. } = self;
        let slip = tracker.run(&MovedMarkers { points_mm, covariance_mm2, state, patch }, &mut out).unwrap();
        (out, slip)
    }
}

fn about_contact(omega: [f64; 3], v_mm: [f64; 3]) -> Pose {
    let centre = Pose::from_translation_mm(DVec3::Z * Z_MM);
    centre * Pose::exp(DVec3::from_array(omega), DVec3::from_array(v_mm)) * centre.inverse()
}

const fn nothing(_: usize) -> DVec3 {
    DVec3::ZERO
}

/// Squared error of a motion at its point of reference, normalised by its covariance (6 components).
fn squared_error(slip: &Slip, truth: &Pose) -> f64 {
    let found = slip.motion.unwrap();
    let to = Pose::from_translation_mm(-found.about_mm);
    let (omega, v) = (to * *truth * found.pose.inverse() * to.inverse()).log();
    let error = stacked([omega, v]);
    let solved = solve(&found.covariance, &error);
    (0..6).map(|i| error[i] * solved[i]).sum()
}

fn stacked([omega, v]: [DVec3; 2]) -> [f64; 6] {
    let [a, b] = [omega.to_array(), v.to_array()];
    [a[0], a[1], a[2], b[0], b[1], b[2]]
}

/// Gaussian elimination without pivoting; the matrix is positive definite.
fn solve(matrix: &Symmetric<6>, right: &[f64; 6]) -> [f64; 6] {
    let (mut a, mut b) = (*matrix, *right);
    for i in 0..6 {
        for j in i + 1..6 {
            let share = a[j][i] / a[i][i];
            for k in i..6 {
                a[j][k] -= share * a[i][k];
            }
            b[j] -= share * b[i];
        }
    }
    for i in (0..6).rev() {
        b[i] = (b[i] - (i + 1..6).map(|k| a[i][k] * b[k]).sum::<f64>()) / a[i][i];
    }
    b
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// However a part moves, as long as it does not slip no marker is said to, and the motion is the part's.
    #[test]
    fn a_part_that_sticks_is_followed(
        seed in any::<u64>(), radius_mm in 1.6..4.5f64,
        omega in prop::array::uniform3(-0.004..0.004f64), v in prop::array::uniform3(-0.03..0.03f64),
    ) {
        let (mut tracker, mut contact) = (tracker(1.0), Contact::new(radius_mm, seed));
        contact.moves(&Pose::IDENTITY, nothing);
        let (_, first) = contact.run(&mut tracker);
        prop_assert_eq!(first.unwrap().status, SlipStatus::Unknown);
        for step in 1..20 {
            let by = |x: f64| x * f64::from(step);
            let pose = about_contact(omega.map(by), v.map(by));
            contact.moves(&pose, nothing);
            let (stick, slip) = contact.run(&mut tracker);
            let slip = slip.unwrap();
            prop_assert_eq!((slip.status, slip.stick_ratio), (SlipStatus::Stuck, Some(1.0)));
            prop_assert_eq!(slip.stick_range[1], 1.0);
            prop_assert!(stick.iter().zip(&contact.patch).all(|(&s, &t)| (s == Stick::Stuck) == t));
            // Chance of a larger one: 1e-9 a frame.
            prop_assert!(squared_error(&slip, &pose) < 55.0, "{}", squared_error(&slip, &pose));
        }
    }

    /// Markers that stay behind slip, the others do not, and the motion is still the part's.
    #[test]
    fn markers_that_stay_behind_slip(
        seed in any::<u64>(), angle in -3.2..3.2f64, lag_mm in 0.02..0.04f64, twist in -0.004..0.004f64,
    ) {
        let (mut tracker, mut contact) = (tracker(1.0), Contact::new(3.5, seed));
        let slips: Vec<bool> = contact.stuck_mm.iter().map(|p| p.truncate().length() > 2.8).collect();
        contact.moves(&Pose::IDENTITY, nothing);
        contact.run(&mut tracker);
        let towards = DVec3::new(angle.cos(), angle.sin(), 0.0);
        for step in 1..12 {
            let n = f64::from(step);
            let pose = about_contact([0.0, 0.0, twist * n], (towards * 0.05 * n).to_array());
            contact.moves(&pose, |i| if slips[i] { towards * lag_mm * n } else { DVec3::ZERO });
            let (stick, slip) = contact.run(&mut tracker);
            if step < 3 {
                continue;
            }
            let expected = |i: usize| match (contact.patch[i], slips[i]) {
                (false, _) => Stick::Free,
                (_, true) => Stick::Slips,
                _ => Stick::Stuck,
            };
            prop_assert!((0..stick.len()).all(|i| stick[i] == expected(i)), "{step} {stick:?}");
            let slip = slip.unwrap();
            prop_assert_eq!(slip.status, SlipStatus::Incipient);
            let truth = slip.stick_ratio.unwrap();
            prop_assert!(slip.stick_range[0] < truth && truth <= slip.stick_range[1]);
            prop_assert!(squared_error(&slip, &pose) < 55.0, "{}", squared_error(&slip, &pose));
        }
    }
}

/// Patches leave out the border of a contact. Markers beside the patch that move with the part touch it, and
/// their slip is found although all of the patch sticks. Free gel beside them never counts.
#[test]
fn gel_beside_the_patch_that_moves_with_the_part_touches() {
    for seed in 0..20 {
        let (mut tracker, mut contact) = (tracker(1.0), Contact::new(2.6, seed));
        let touches = Contact::new(3.3, seed).patch;
        let is_left_out = |i: usize| touches[i] && !contact.patch[i];
        let left_out: Vec<usize> = (0..touches.len()).filter(|&i| is_left_out(i)).collect();
        assert!(left_out.len() > 5);
        contact.moves_where(&touches, &Pose::IDENTITY, nothing);
        contact.run(&mut tracker);
        let pose = |x_mm: f64| about_contact([0.0; 3], [x_mm, 0.0, 0.0]);
        for step in 1..9 {
            contact.moves_where(&touches, &pose(0.02 * f64::from(step)), nothing);
            let (stick, slip) = contact.run(&mut tracker);
            assert_eq!(slip.unwrap().status, SlipStatus::Stuck);
            // Free gel lags by a fifth of the motion or more: 4 um are not known from none, 32 um are.
            let expected = if step < 3 { Stick::Free } else { Stick::Stuck };
            let is_known = step < 3 || step == 8;
            assert!(!is_known || left_out.iter().all(|&i| stick[i] == expected), "{step} {stick:?}");
        }
        contact.moves_where(&touches, &pose(0.18), |i| {
            if left_out.contains(&i) { DVec3::X * 0.03 } else { DVec3::ZERO }
        });
        let (stick, slip) = contact.run(&mut tracker);
        let slip = slip.unwrap();
        assert_eq!(slip.status, SlipStatus::Incipient);
        for i in 0..stick.len() {
            let expected = match (contact.patch[i], touches[i]) {
                (true, _) => Stick::Stuck,
                (_, true) => Stick::Slips,
                _ => Stick::Free,
            };
            assert_eq!(stick[i], expected);
        }
        // They may be free gel, so that the whole contact may stick.
        assert!(slip.stick_range[0] < slip.stick_ratio.unwrap() && slip.stick_range[1] == 1.0);
    }
}

/// A marker that was free beside the patch, lagged, and then touches, is anchored where it touches.
#[test]
fn a_marker_that_touches_later_is_anchored_there() {
    let (mut tracker, mut contact) = (tracker(1.0), Contact::new(2.6, 6));
    let wide = Contact::new(3.3, 6).patch;
    let pose = |x_mm: f64| about_contact([0.0; 3], [x_mm, 0.0, 0.0]);
    for step in 0..5 {
        contact.moves(&pose(0.05 * f64::from(step)), nothing);
        contact.run(&mut tracker);
    }
    let gap: Vec<DVec3> = (0..wide.len())
        .map(|i| if wide[i] && !contact.patch[i] { DVec3::X * 0.1 } else { DVec3::ZERO })
        .collect();
    contact.patch = wide;
    for step in 4..8 {
        contact.moves(&pose(0.05 * f64::from(step)), |i| gap[i]);
        assert_eq!(contact.run(&mut tracker).1.unwrap().status, SlipStatus::Stuck);
    }
}

/// One of many markers that slips is no slip of the contact: it may be free gel beside an edge.
#[test]
fn one_marker_of_many_is_no_slip_of_the_contact() {
    for (radius_mm, expected) in [(3.5, SlipStatus::Stuck), (2.6, SlipStatus::Incipient)] {
        let (mut tracker, mut contact) = (tracker(1.0), Contact::new(radius_mm, 7));
        let last = contact.patch.iter().rposition(|&touches| touches).unwrap();
        contact.moves(&Pose::IDENTITY, nothing);
        contact.run(&mut tracker);
        let lag = |i: usize| if i == last { DVec3::X * 0.04 } else { DVec3::ZERO };
        contact.moves(&about_contact([0.0; 3], [0.05, 0.0, 0.0]), lag);
        let (stick, slip) = contact.run(&mut tracker);
        assert_eq!((stick[last], slip.unwrap().status), (Stick::Slips, expected), "{radius_mm} mm");
    }
}

/// The mean normalised squared error of the motion is 6 times what the anchors share: between touch and now,
/// both positions have noise.
#[test]
fn the_covariance_of_the_motion_holds() {
    let mut sum = 0.0;
    let count = 400;
    for seed in 0..count {
        let (mut tracker, mut contact) = (tracker(1.0), Contact::new(3.0, seed));
        contact.moves(&Pose::IDENTITY, nothing);
        contact.run(&mut tracker);
        let pose = about_contact([0.002, -0.003, 0.004], [0.02, 0.03, -0.01]);
        contact.moves(&pose, nothing);
        sum += squared_error(&contact.run(&mut tracker).1.unwrap(), &pose);
    }
    let mean = sum / count as f64;
    // Weights of Cauchy cost efficiency: 3 % of the variance here. The mean's standard deviation is 0.17.
    assert!((5.3..7.2).contains(&mean), "{mean}");
}

/// At a rate of one false alarm in ten frames, no more are counted. The fit uses the markers it judges, so
/// that fewer are.
#[test]
fn false_alarms_keep_their_rate() {
    let params = SlipParams { frame_rate_hz: 10.0, ..params(3600.0) };
    let rest = RestSurface::new(&rest_mm()).unwrap();
    let mut tracker = SlipTracker::new(&params, &rest, SIDE).unwrap();
    let mut alarms = 0;
    for seed in 0..1000 {
        let mut contact = Contact::new(3.0, seed);
        tracker.restart();
        contact.moves(&Pose::IDENTITY, nothing);
        contact.run(&mut tracker);
        contact.moves(&about_contact([0.0; 3], [0.03, 0.0, 0.0]), nothing);
        alarms += usize::from(contact.run(&mut tracker).1.unwrap().status != SlipStatus::Stuck);
    }
    // 0.1 expected at most: 100 and four standard deviations.
    assert!((40..140).contains(&alarms), "{alarms} of 1000 frames");
}

/// Anchors are means of up to eight positions. A lag of 11 um is more than noise explains by such a mean,
/// which is 9 um, and less than by one position, which is 12 um.
#[test]
fn averaged_anchors_show_less_slip() {
    let (mut found, mut all) = (0, 0);
    for seed in 0..20 {
        let (mut tracker, mut contact) = (tracker(1.0), Contact::new(4.0, seed));
        let lags: Vec<bool> = contact.stuck_mm.iter().map(|p| p.x > 2.0).collect();
        for step in 0..9 {
            contact.moves(&about_contact([0.0; 3], [0.02 * f64::from(step), 0.0, 0.0]), nothing);
            contact.run(&mut tracker);
        }
        let lag = |i: usize| if lags[i] { DVec3::X * 0.011 } else { DVec3::ZERO };
        contact.moves(&about_contact([0.0; 3], [0.2, 0.0, 0.0]), lag);
        let (stick, _) = contact.run(&mut tracker);
        assert!((0..stick.len()).all(|i| stick[i] != Stick::Slips || lags[i]));
        let touching = (0..stick.len()).filter(|&i| lags[i] && contact.patch[i]);
        all += touching.clone().count();
        found += touching.filter(|&i| stick[i] == Stick::Slips).count();
    }
    // By one position it is a quarter.
    assert!(10 * found > 4 * all, "{found} of {all}");
}

/// Patches hold free markers beside an edge. As the part presses deeper, or less deep, they stay behind and
/// move sideways. They are free, and no slip.
#[test]
fn markers_that_do_not_go_as_deep_are_free() {
    for (seed, deeper_mm) in [(8, 0.02), (9, -0.02)] {
        let (mut tracker, mut contact) = (tracker(1.0), Contact::new(3.0, seed));
        let is_free = |p: &DVec3| p.truncate().length() > 2.5;
        let free: Vec<bool> = contact.stuck_mm.iter().map(is_free).collect();
        let mut seen_free = 0;
        for step in 0..15 {
            let depth_mm = deeper_mm * f64::from(step);
            let lag = |i: usize| if free[i] { DVec3::new(0.08, 0.0, -0.8) * depth_mm } else { DVec3::ZERO };
            contact.moves(&about_contact([0.0; 3], [0.0, 0.0, -depth_mm]), lag);
            let (stick, slip) = contact.run(&mut tracker);
            assert!(
                [SlipStatus::Unknown, SlipStatus::Stuck].contains(&slip.unwrap().status),
                "{step} {stick:?}"
            );
            assert!((0..stick.len()).all(|i| free[i] || !contact.patch[i] || stick[i] != Stick::Free));
            seen_free += (0..stick.len()).filter(|&i| contact.patch[i] && stick[i] == Stick::Free).count();
        }
        assert!(seen_free > 20, "{seen_free}");
    }
}

/// Gross slip is reported until the part has left the gel, even if all markers rest.
#[test]
fn gross_slip_lasts_until_the_part_is_away() {
    let (mut tracker, mut contact) = (tracker(1.0), Contact::new(4.4, 1));
    contact.moves(&Pose::IDENTITY, nothing);
    contact.run(&mut tracker);
    for step in 1..12 {
        let x_mm = 0.06 * f64::from(step);
        // No three of them move together.
        let share = |i: usize| 0.3 + 0.7 * ((i * 37) % 101) as f64 / 101.0;
        contact.moves(&about_contact([0.0; 3], [x_mm, 0.0, 0.0]), |i| DVec3::X * x_mm * share(i));
        contact.run(&mut tracker);
    }
    let slip = contact.run(&mut tracker).1.unwrap();
    assert_eq!((slip.status, slip.stick_ratio, slip.motion), (SlipStatus::Gross, None, None));
    contact.patch.fill(false);
    let (stick, none) = contact.run(&mut tracker);
    assert!(none.is_none() && stick.iter().all(|&s| s == Stick::Free));
    contact = Contact::new(3.0, 2);
    let statuses: Vec<SlipStatus> = (0..3).map(|_| contact.run(&mut tracker).1.unwrap().status).collect();
    assert_eq!(statuses, [SlipStatus::Unknown, SlipStatus::Stuck, SlipStatus::Stuck]);
}

#[test]
fn markers_that_are_not_seen_are_unknown() {
    let (mut tracker, mut contact) = (tracker(1.0), Contact::new(3.0, 3));
    contact.moves(&Pose::IDENTITY, nothing);
    contact.run(&mut tracker);
    let middle = SIDE * SIDE / 2;
    contact.state[middle] = MarkerState::Held;
    contact.points_mm[middle + 1] = DVec3::NAN;
    let (stick, slip) = contact.run(&mut tracker);
    assert_eq!([stick[middle], stick[middle + 1]], [Stick::Unknown; 2]);
    let slip = slip.unwrap();
    assert!(slip.status == SlipStatus::Stuck && slip.stick_range[1] == 1.0 && slip.motion.is_some());
    // A marker whose noise is not known is not judged.
    contact.covariance_mm2[middle + 2] = [[0.0; 3]; 3];
    tracker.restart();
    for _ in 0..2 {
        assert_eq!(contact.run(&mut tracker).0[middle + 2], Stick::Unknown);
    }
    // Two markers do not determine a motion.
    contact.patch.fill(false);
    contact.patch[..2].fill(true);
    let (_, slip) = contact.run(&mut tracker);
    assert_eq!(slip.unwrap().status, SlipStatus::Unknown);
}

#[test]
fn what_cannot_be_used_is_refused() {
    let rest = RestSurface::new(&rest_mm()).unwrap();
    let invalid = SlipParams { frame_rate_hz: f64::NAN, ..params(1.0) };
    assert!(matches!(SlipTracker::new(&invalid, &rest, SIDE), Err(SlipError::Params(_))));
    let refused = SlipTracker::new(&params(1.0), &rest, 7).unwrap_err();
    assert_eq!(refused, SlipError::Lattice { markers: 121, cols: 7 });
    let contact = Contact::new(3.0, 4);
    let Contact { points_mm, covariance_mm2, state, .. } = &contact;
    let short = MovedMarkers { points_mm, covariance_mm2, state, patch: &[true] };
    assert_eq!(tracker(1.0).run(&short, &mut Vec::new()), Err(SlipError::Lengths { rest: 121, found: 1 }));
}

/// After a frame in which fewer than three markers stick, anchors from before it would give a motion since
/// the first touch, and markers of two origins.
#[test]
fn motion_begins_anew_after_a_gap() {
    for left in [0, 2] {
        let (mut tracker, mut contact) = (tracker(1.0), Contact::new(3.0, 5));
        let pose = |x_mm: f64| about_contact([0.0, 0.0, x_mm / 20.0], [x_mm, 0.0, 0.0]);
        for x_mm in [0.0, 0.05, 0.1] {
            contact.moves(&pose(x_mm), nothing);
            contact.run(&mut tracker);
        }
        let touched: Vec<usize> = (0..SIDE * SIDE).filter(|&i| contact.patch[i]).collect();
        touched[left..].iter().for_each(|&i| contact.state[i] = MarkerState::Held);
        contact.moves(&pose(0.15), nothing);
        let gap = contact.run(&mut tracker).1.unwrap();
        assert_eq!((gap.status, gap.motion), (SlipStatus::Unknown, None));
        contact.state.fill(MarkerState::Seen);
        contact.moves(&pose(0.2), nothing);
        assert_eq!(contact.run(&mut tracker).1.unwrap().motion, None);
        contact.moves(&pose(0.25), nothing);
        let (stick, slip) = contact.run(&mut tracker);
        let slip = slip.unwrap();
        assert_eq!(slip.status, SlipStatus::Stuck, "{left} markers left");
        assert!(stick.iter().zip(&contact.patch).all(|(&s, &t)| (s == Stick::Stuck) == t));
        // All are anchored in the first frame after the gap.
        let since = pose(0.25) * pose(0.2).inverse();
        assert!(squared_error(&slip, &since) < 55.0, "{left} left: {}", squared_error(&slip, &since));
    }
}
