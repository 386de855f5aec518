//! Which fingers and mounts make sense.

use gelstereo_core::frames::{FingerKinematics, SensorMount};
use gelstereo_core::math::{DVec3, Pose};
use proptest::prelude::*;

fn parallelogram() -> impl Strategy<Value = FingerKinematics> {
    (0.0..200.0_f64, 0.0..200.0_f64, -100.0..100.0_f64, -500.0..500.0_f64, 0.001..1.57_f64).prop_map(
        |(a_mm, b_mm, offset_mm, reach_mm, max_theta_rad)| FingerKinematics::Parallelogram {
            a_mm,
            b_mm,
            offset_mm,
            reach_mm,
            max_theta_rad,
        },
    )
}

proptest! {
    /// Fingers that are valid have a pad at every width of their range, and it advances steadily while they
    /// close.
    #[test]
    fn valid_fingers_have_a_pad_at_every_width(
        kinematics in parallelogram(), shares in prop::array::uniform2(0.0..=1.0_f64),
    ) {
        prop_assume!(kinematics.validate().is_ok());
        let (min_mm, max_mm) = kinematics.width_range_mm();
        prop_assert!(max_mm > min_mm);
        for share in shares {
            let width_mm = min_mm + share * (max_mm - min_mm);
            let pad = kinematics.pad_mm(width_mm.clamp(min_mm, max_mm)).unwrap();
            prop_assert!(pad.is_finite() && pad.length() < 3000.0);
        }
    }

    /// Whatever is not within a metre is another unit, or no gripper's.
    #[test]
    fn numbers_that_are_no_mount_are_refused(
        which in 0usize..5,
        number in prop::sample::select(vec![f64::NAN, f64::INFINITY, -1e300, 1e300, 4e9, 9e18, -2e3]),
    ) {
        let mut numbers = [37.6, 43.0, 5.08, 87.3, 0.8];
        numbers[which] = number;
        let [a_mm, b_mm, offset_mm, reach_mm, max_theta_rad] = numbers;
        let kinematics =
            FingerKinematics::Parallelogram { a_mm, b_mm, offset_mm, reach_mm, max_theta_rad };
        let error = kinematics.validate().unwrap_err();
        let fields = ["a_mm", "b_mm", "offset_mm", "reach_mm", "max_theta_rad"];
        prop_assert_eq!(error.field, format!("kinematics.{}", fields[which]));
    }
}

#[test]
fn a_mount_four_thousand_kilometres_away_is_refused() {
    let mut mount = SensorMount::facing(FingerKinematics::robotiq_2f85(), DVec3::new(4.0, 0.0, 28.7));
    assert_eq!(mount.validate(), Ok(()));
    mount.t_pad_sensor = Pose::from_translation_mm(DVec3::new(0.0, 4e9, 0.0));
    let message = mount.validate().unwrap_err().to_string();
    assert_eq!(message, "t_pad_sensor.translation_mm is 4000000000; valid is -1000 to 1000 mm");
}
