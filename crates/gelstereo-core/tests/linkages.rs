//! Pads of four-bar grippers against a numeric solution of their linkages, from joints that published models
//! give.

#![allow(clippy::unwrap_used)]

use gelstereo_core::frames::FingerKinematics;
use proptest::prelude::*;

/// A point or vector in the plane of a finger: across (outwards) and along (towards the tip), millimetres.
type Plane = [f64; 2];

/// A finger on two cranks. All at the pose where `crank_mm` holds; the coupler carries the pad.
struct FourBar {
    name: &'static str,
    kinematics: FingerKinematics,
    outer_pivot_mm: Plane,
    inner_pivot_mm: Plane,
    outer_crank_mm: Plane,
    inner_crank_mm: Plane,
    /// From the outer joint of the coupler to the pad.
    pad_mm: Plane,
}

/// Outer and inner pivot, crank, pad: joints of the ROS-Industrial models of Robotiq's grippers and of
/// OnRobot's own models.
fn grippers() -> [FourBar; 4] {
    let four_bar = |name, kinematics, outer_pivot_mm, inner_pivot_mm, crank_mm, pad_mm| FourBar {
        name,
        kinematics,
        outer_pivot_mm,
        inner_pivot_mm,
        outer_crank_mm: crank_mm,
        inner_crank_mm: crank_mm,
        pad_mm,
    };
    let (rg2, rg6) = (FingerKinematics::on_robot_rg2(), FingerKinematics::on_robot_rg6());
    let (small, large) = (FingerKinematics::robotiq_2f85(), FingerKinematics::robotiq_2f140());
    [
        four_bar("2F-85", small, [30.6011, 54.904], [12.7, 61.42], [37.6, 43.0], [-25.5203, 32.42]),
        // The model's crank is (18.220 + 81.755, 26.002 - 28.220) mm, turned by 90 degrees and 0.725 rad.
        four_bar("2F-140", large, [30.601, 54.905], [12.7, 61.42], [64.63, 76.31], [-30.97, 45.755]),
        four_bar("RG2", rg2, [17.0, 123.34], [7.5, 139.84], [-2.5, 54.943], [-14.5, 36.5]),
        four_bar("RG6", rg6, [23.8, 135.3], [10.5, 158.4], [-4.2, 79.8897], [-19.6, 47.9]),
    ]
}

fn plus(a: Plane, b: Plane) -> Plane {
    [a[0] + b[0], a[1] + b[1]]
}

fn minus(a: Plane, b: Plane) -> Plane {
    [a[0] - b[0], a[1] - b[1]]
}

fn turned(v: Plane, angle: f64) -> Plane {
    let (sin, cos) = angle.sin_cos();
    [cos * v[0] - sin * v[1], sin * v[0] + cos * v[1]]
}

impl FourBar {
    /// The pad with the outer crank turned by `angle`: Newton's method closes the loop over the coupler and
    /// the inner crank, from a start that is off.
    fn pad(&self, angle: f64) -> (Plane, f64) {
        let coupler = minus(
            plus(self.inner_pivot_mm, self.inner_crank_mm),
            plus(self.outer_pivot_mm, self.outer_crank_mm),
        );
        let joint = plus(self.outer_pivot_mm, turned(self.outer_crank_mm, angle));
        let (mut coupler_angle, mut inner_angle) = (0.05, angle + 0.05);
        for _ in 0..30 {
            let (across, crank) = (turned(coupler, coupler_angle), turned(self.inner_crank_mm, inner_angle));
            let gap = minus(plus(joint, across), plus(self.inner_pivot_mm, crank));
            // Derivatives of a turned vector are the vector turned on by a right angle.
            let columns = [[-across[1], across[0]], [crank[1], -crank[0]]];
            let determinant = columns[0][0] * columns[1][1] - columns[1][0] * columns[0][1];
            coupler_angle -= (gap[0] * columns[1][1] - gap[1] * columns[1][0]) / determinant;
            inner_angle -= (gap[1] * columns[0][0] - gap[0] * columns[0][1]) / determinant;
        }
        (plus(joint, turned(self.pad_mm, coupler_angle)), coupler_angle)
    }
}

proptest! {
    /// The pad is where the linkage puts it, to what the constants were rounded by, and does not turn.
    #[test]
    fn pads_are_where_the_linkage_puts_them(which in 0_usize..4, share in 0.02..0.98_f64) {
        let gripper = &grippers()[which];
        let (closed_mm, open_mm) = gripper.kinematics.width_range_mm();
        let width_mm = closed_mm + share * (open_mm - closed_mm);
        // The pad's place across grows with the angle that opens: bisection finds the one with this width.
        let (mut low, mut high) = (-1.4, 1.4);
        let open_angle = |angle: f64| gripper.pad(-angle).0[0];
        let start = gripper.outer_crank_mm[0].atan2(gripper.outer_crank_mm[1]);
        (low, high) = (f64::max(low, -start - 0.2), f64::min(high, 1.5 - start));
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if 2.0 * open_angle(middle) < width_mm { low = middle } else { high = middle }
        }
        let (pad, turn) = gripper.pad(-low);
        prop_assert!((2.0 * pad[0] - width_mm).abs() < 1e-9, "{}: {pad:?} for {width_mm}", gripper.name);
        prop_assert!(turn.abs() < 1e-9, "{}: the pad turns by {turn}", gripper.name);
        let found = gripper.kinematics.pad_mm(width_mm).unwrap();
        prop_assert!((found.z - pad[1]).abs() < 0.02, "{}: {} against {}", gripper.name, found.z, pad[1]);
    }
}

/// Strokes of the makers' data sheets; closed fingers can be asked for.
#[test]
fn strokes_are_the_makers() {
    for (gripper, stroke_mm) in grippers().iter().zip([85.0, 140.0, 110.0, 160.0]) {
        let (min_mm, max_mm) = gripper.kinematics.width_range_mm();
        assert_eq!(gripper.kinematics.validate(), Ok(()));
        assert!((0.0..1.0).contains(&min_mm), "{}: {min_mm}", gripper.name);
        assert!((max_mm - stroke_mm).abs() < 0.5, "{}: {max_mm}", gripper.name);
    }
}

/// The page from which users copy the figures has these.
#[test]
fn the_page_has_the_same_figures() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/grippers.md");
    let page = std::fs::read_to_string(path).unwrap();
    for gripper in grippers() {
        let FingerKinematics::Parallelogram { a_mm, b_mm, offset_mm, reach_mm, max_theta_rad } =
            gripper.kinematics
        else {
            panic!("{} is a four-bar gripper", gripper.name)
        };
        let figures = format!(
            "`a_mm = {a_mm:?}`, `b_mm = {b_mm:?}`, `offset_mm = {offset_mm:?}`, `reach_mm = {reach_mm:?}`, \
             `max_theta_rad = {max_theta_rad:?}`"
        );
        assert!(page.contains(&figures), "{}: {figures}", gripper.name);
    }
}
