//! The print's pitch at rest as a check of rig and settings.

use gelstereo_core::math::DVec3;
use gelstereo_core::params::Pitch;
use gelstereo_core::pipeline::PitchCheck;
use proptest::prelude::*;

const SIDE: usize = 20;

/// A print of this pitch, facing the camera, its markers off by `noise_mm` along every axis at most.
fn print(pitch: Pitch, noise_mm: &[[f64; 3]]) -> Vec<DVec3> {
    let at = |i: usize| DVec3::new((i % SIDE) as f64 * pitch.x_mm, (i / SIDE) as f64 * pitch.y_mm, 28.0);
    noise_mm.iter().enumerate().map(|(i, &noise)| at(i) + DVec3::from_array(noise)).collect()
}

fn noise(most_mm: f64) -> impl Strategy<Value = Vec<[f64; 3]>> {
    proptest::collection::vec(proptest::array::uniform3(-most_mm..=most_mm), SIDE * SIDE)
}

proptest! {
    #[test]
    fn both_pitches_are_measured_within_their_own_uncertainty(
        x_mm in 0.3..3.0_f64, ratio in 0.6..1.7_f64, noise in noise(0.01),
    ) {
        let pitch = Pitch { x_mm, y_mm: ratio * x_mm };
        let check = PitchCheck::new(&print(pitch, &noise), SIDE, pitch).unwrap();
        for (k, pitch_mm) in pitch.axes_mm().into_iter().enumerate() {
            let bias_mm = 0.01 * 0.01 / pitch_mm;
            prop_assert!((check.measured_mm[k] - pitch_mm).abs() < 5.0 * check.sigma_mm[k] + bias_mm);
        }
        prop_assert!(!check.is_off());
    }

    #[test]
    fn a_rig_or_setting_two_per_cent_off_is_named(
        scale in prop_oneof![0.5..0.98_f64, 1.02..2.0], along in 0..3, noise in noise(0.01),
    ) {
        let scaled = |off: bool| if off { scale * 0.9 } else { 0.9 };
        let pitch = Pitch { x_mm: scaled(along != 1), y_mm: scaled(along != 0) };
        let check = PitchCheck::new(&print(pitch, &noise), SIDE, 0.9.into()).unwrap();
        prop_assert!(check.is_off());
        let text = check.to_string();
        prop_assert!(text.contains("lattice.pitch_mm is 0.9") && text.contains("baseline"), "{text}");
    }

    #[test]
    fn half_and_double_are_another_sensor(scale in prop_oneof![0.1..0.49_f64, 2.05..9.0], along in 0..2) {
        let [x_mm, y_mm] = if along == 0 { [scale, 1.0] } else { [1.0, scale] };
        let pitch = Pitch { x_mm, y_mm };
        let check = PitchCheck::new(&print(pitch, &[[0.0; 3]; SIDE * SIDE]), SIDE, 1.0.into()).unwrap();
        prop_assert!(check.is_absurd());
    }
}

#[test]
fn one_column_or_row_has_no_pitch() {
    assert_eq!(PitchCheck::new(&print(1.0.into(), &[[0.0; 3]; 9]), 1, 1.0.into()), None);
    assert_eq!(PitchCheck::new(&print(1.0.into(), &[[0.0; 3]; 9]), 9, 1.0.into()), None);
    assert_eq!(PitchCheck::new(&[], 5, 1.0.into()), None);
}
