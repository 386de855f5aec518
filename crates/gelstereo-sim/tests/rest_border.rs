//! Rest lattices whose outer rows the image's border cuts (simulated, noise 2 grey levels).
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use crate::common;

use common::images;
use gelstereo_core::detect::{Detector, Markers};
use gelstereo_core::image::GrayView;
use gelstereo_core::lattice::{LabelError, RestLattice, rest_lattice, rest_lattice_of};
use gelstereo_core::params::Params;
use gelstereo_sim::effects::{Defocus, Effects, SensorNoise};
use gelstereo_sim::{Scene, Sight, Truth};
use proptest::prelude::*;

/// The lowest row is moved over the image's border, by so much, and slants.
fn scene(down_mm: f64, rotation_rad: f64) -> Scene {
    let effects = Effects {
        defocus: Some(Defocus::default()),
        sensor_noise: Some(SensorNoise::default()),
        ..Effects::default()
    };
    let mut scene = Scene { effects, ..Scene::default() };
    scene.gel.centre_mm[1] = down_mm;
    scene.gel.rotation_rad = rotation_rad;
    scene
}

fn detect(scene: &Scene, params: &Params) -> (Markers, Truth) {
    let [left, _] = images(scene, 0);
    let mut markers = Markers::default();
    let view = GrayView::new(&left, 640, 480, 640).unwrap();
    Detector::new(&params.detect).run(view, &mut markers).unwrap();
    (markers, common::rest(scene))
}

/// Largest distance of a labelled marker from where the truth has that label, pixels; all rows but the lowest
/// are known to be in view.
fn worst_px(rest: &RestLattice, truth: &Truth) -> f64 {
    let off = |n: usize| rest.positions_px[n].distance(truth.left_px[n]);
    (0..rest.detection.len()).filter(|&n| rest.detection[n].is_some()).map(off).fold(0.0, f64::max)
}

fn cut(truth: &Truth) -> usize {
    truth.left_dots.iter().filter(|dot| dot.sight == Sight::Cut).count()
}

/// 14 of 25 markers of the lowest row are cut: the whole ones alone may be specks, and are left out.
#[test]
fn a_row_of_which_the_border_cuts_most_keeps_its_labels() {
    let params = Params::preset("balanced").unwrap();
    let mut rescued = 0;
    for step in 0..12 {
        let (markers, truth) = detect(&scene(1.3 + 0.02 * f64::from(step), 0.02), &params);
        let found = |rest: Result<RestLattice, LabelError>| rest.map(|r| (r.rows, r.cols, r.left_out));
        let tolerance = params.label.tolerance_pitches;
        let without = found(rest_lattice(&markers.centres_px, &params.lattice, tolerance));
        let with = rest_lattice_of(&markers, &params.lattice, tolerance);
        println!("{} cut, {} listed: {without:?}, {:?}", cut(&truth), markers.cut.len(), found(with.clone()));
        if let (Ok((24, 25, [0, 0, 1, 0])), Ok(rest)) = (&without, &with) {
            assert_eq!((rest.rows, rest.cols, rest.left_out), (25, 25, [0; 4]));
            assert!(worst_px(rest, &truth) < 1.0);
            let held = rest.detection.iter().filter(|d| d.is_none()).count();
            assert!(held > 12 && held <= cut(&truth) + 6, "{held} held");
            rescued += 1;
        }
    }
    assert!(rescued >= 2, "{rescued} of 12 heights");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Wherever the border cuts: the labels are right, or the frame is refused; and whole markers are
    /// labelled as they were.
    #[test]
    fn labels_beside_the_border_are_right_or_refused(down_mm in 1.0..2.0, rotation_rad in -0.04..0.04) {
        let params = Params::preset("balanced").unwrap();
        let (markers, truth) = detect(&scene(down_mm, rotation_rad), &params);
        let tolerance = params.label.tolerance_pitches;
        let without = rest_lattice(&markers.centres_px, &params.lattice, tolerance);
        let with = rest_lattice_of(&markers, &params.lattice, tolerance);
        if without.as_ref().is_ok_and(|rest| rest.left_out == [0; 4]) {
            prop_assert_eq!(&with, &without);
        }
        if let Ok(rest) = with {
            prop_assert!(rest.cols == 25 && (24..=25).contains(&rest.rows));
            prop_assert!(worst_px(&rest, &truth) < 1.0);
        }
    }
}
