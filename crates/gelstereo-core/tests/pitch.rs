//! The print's pitch at rest as a check of rig and settings.

use gelstereo_core::math::DVec3;
use gelstereo_core::pipeline::PitchCheck;
use proptest::prelude::*;

const SIDE: usize = 20;

/// A print of this pitch, facing the camera, its markers off by `noise_mm` along every axis at most.
fn print(pitch_mm: f64, noise_mm: &[[f64; 3]]) -> Vec<DVec3> {
    let at = |i: usize| DVec3::new((i % SIDE) as f64 * pitch_mm, (i / SIDE) as f64 * pitch_mm, 28.0);
    noise_mm.iter().enumerate().map(|(i, &noise)| at(i) + DVec3::from_array(noise)).collect()
}

fn noise(most_mm: f64) -> impl Strategy<Value = Vec<[f64; 3]>> {
    proptest::collection::vec(proptest::array::uniform3(-most_mm..=most_mm), SIDE * SIDE)
}

proptest! {
    #[test]
    fn the_pitch_is_measured_within_its_own_uncertainty(pitch_mm in 0.3..3.0_f64, noise in noise(0.01)) {
        let check = PitchCheck::new(&print(pitch_mm, &noise), SIDE, pitch_mm).unwrap();
        let bias_mm = 0.01 * 0.01 / pitch_mm;
        prop_assert!((check.measured_mm - pitch_mm).abs() < 5.0 * check.sigma_mm + bias_mm);
        prop_assert!(!check.is_off());
    }

    #[test]
    fn a_rig_or_setting_two_per_cent_off_is_named(
        scale in prop_oneof![0.5..0.98_f64, 1.02..2.0], noise in noise(0.01),
    ) {
        let check = PitchCheck::new(&print(scale * 0.9, &noise), SIDE, 0.9).unwrap();
        prop_assert!(check.is_off());
        let text = check.to_string();
        prop_assert!(text.contains("lattice.pitch_mm is 0.9") && text.contains("baseline"), "{text}");
    }

    #[test]
    fn half_and_double_are_another_sensor(scale in prop_oneof![0.1..0.49_f64, 2.05..9.0]) {
        let check = PitchCheck::new(&print(scale, &[[0.0; 3]; SIDE * SIDE]), SIDE, 1.0).unwrap();
        prop_assert!(check.is_absurd());
    }
}

#[test]
fn one_column_has_no_pitch() {
    assert_eq!(PitchCheck::new(&print(1.0, &[[0.0; 3]; 9]), 1, 1.0), None);
    assert_eq!(PitchCheck::new(&[], 5, 1.0), None);
}
