//! Prints whose rows and columns have different pitches.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, rest, rigid, truth, with_effects};
use gelstereo_core::math::{DVec2, DVec3, sqrt};
use gelstereo_core::params::Pitch;
use gelstereo_sim::effects::{ElasticLayer, Specks};
use gelstereo_sim::{Effects, Gel, Scene, Shape, Truth};
use proptest::prelude::*;

const BALL: Shape = Shape::Sphere { radius_mm: 4.0 };

fn on(pitch_mm: Pitch, [rows, cols]: [usize; 2], effects: Effects) -> Scene {
    let gel = Gel { rows, cols, pitch_mm, ..Gel::default() };
    Scene { gel, ..with_effects(BALL, effects) }
}

fn layer() -> Effects {
    Effects { elastic_layer: Some(ElasticLayer::default()), ..Effects::default() }
}

/// Root mean square of the differences of the heights, over that of the heights.
fn off(found: &[f64], expected: &[f64]) -> f64 {
    let square: f64 = found.iter().zip(expected).map(|(a, b)| (a - b) * (a - b)).sum();
    sqrt(square / expected.iter().map(|x| x * x).sum::<f64>())
}

/// Heights of the markers that both lattices have when every second row of the finer one is taken.
fn every_second_row(found: &Truth, cols: usize) -> Vec<f64> {
    found.indentation_mm.chunks(cols).step_by(2).flatten().copied().collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn markers_stand_on_both_pitches(
        x_mm in 0.5..1.5_f64, y_mm in 0.5..1.5_f64, rows in 2..12_usize, cols in 2..12_usize,
        rotation_rad in -3.0..3.0_f64,
    ) {
        let gel = Gel { rows, cols, rotation_rad, pitch_mm: Pitch { x_mm, y_mm }, ..Gel::default() };
        let scene = Scene { gel, ..rigid(BALL) };
        let found = rest(&scene).points_mm;
        let (along, centre) = (DVec2::from_angle(rotation_rad), DVec2::new(4.0, 0.0));
        for (marker, point) in found.iter().enumerate() {
            let from_middle = |i: usize, n: usize| i as f64 - (n as f64 - 1.0) / 2.0;
            let col_mm = from_middle(marker % cols, cols) * x_mm;
            let row_mm = from_middle(marker / cols, rows) * y_mm;
            let expected = (centre + along * col_mm + along.perp() * row_mm).extend(28.7);
            prop_assert!((*point - expected).length() < 1e-12);
        }
        let text = toml::to_string(&scene).unwrap();
        prop_assert_eq!(toml::from_str::<Scene>(&text).unwrap(), scene);
    }

    /// A gel that is turned by 90 degrees is the same gel with rows for columns.
    #[test]
    fn rows_are_as_good_as_columns(
        x_mm in 0.7..1.2_f64, y_mm in 0.7..1.2_f64, x in -2.0..2.0_f64, y in -2.0..2.0_f64,
        of_layer in prop::bool::ANY,
    ) {
        let effects = || if of_layer { layer() } else { Effects::of_gel() };
        let flat = on(Pitch { x_mm, y_mm }, [11, 13], effects());
        let mut turned = on(Pitch { x_mm: y_mm, y_mm: x_mm }, [13, 11], effects());
        turned.gel.rotation_rad = core::f64::consts::FRAC_PI_2;
        let mut contact = press(&flat, DVec3::ZERO, DVec2::new(x, y), 1.0);
        contact.shear_mm = [0.2, 0.1];
        let [flat, turned] = [flat, turned].map(|scene| truth(&scene, Some(&contact)).points_mm);
        for (marker, point) in flat.iter().enumerate() {
            let (row, col) = (marker / 13, marker % 13);
            let other = turned[(12 - col) * 11 + row];
            prop_assert!((*point - other).length() < 2e-4, "{point} {other}");
        }
    }
}

#[test]
fn a_square_print_is_the_rectangular_one_of_equal_sides() {
    let text = "[gel]\npitch_mm = [0.9, 0.9]";
    assert_eq!(toml::from_str::<Scene>(text).unwrap(), Scene::default());
    for (text, message) in [
        ("[gel]\npitch_mm = [0.9, 0.4]", "gel.dot_radius_mm is 0.22; valid is below half of gel.pitch_mm"),
        ("[gel]\npitch_mm = [0.9, 0.0]", "gel.pitch_mm is 0; valid is 0.001 to 1000 mm"),
        (
            "[gel]\npitch_mm = [0.9, 6]\n[effects.elastic_layer]\ncells_per_pitch = 1",
            "is 6; valid is at most",
        ),
    ] {
        let error = toml::from_str::<Scene>(text).unwrap().validate().unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    let wrong = toml::from_str::<Scene>("[gel]\npitch_mm = [1.0]").unwrap_err().to_string();
    assert!(wrong.contains("a number, or two as [x, y]"), "{wrong}");
}

/// Both lattices discretise the same membranes and the same layer, so a finer one differs little.
#[test]
fn the_gel_hardly_depends_on_the_print() {
    let wide = Pitch { x_mm: 0.7, y_mm: 1.0 };
    let fine = Pitch { x_mm: 0.7, y_mm: 0.5 };
    for (effects, most) in [(Effects::of_gel(), 0.02), (layer(), 0.005)] {
        let [wide, fine] = [on(wide, [17, 23], effects.clone()), on(fine, [33, 23], effects)];
        let contact = press(&wide, DVec3::ZERO, DVec2::new(0.3, 0.2), 1.2);
        let [wide, fine] = [wide, fine].map(|scene| truth(&scene, Some(&contact)));
        let found = off(&wide.indentation_mm, &every_second_row(&fine, 23));
        assert!(found < most, "{found}");
        let forces = [&wide, &fine].map(|truth| truth.loads.as_ref().map_or(1.0, |loads| loads.force_n.z));
        assert!((forces[0] / forces[1] - 1.0).abs() < 0.02, "{forces:?}");
    }
}

/// A speck and a dot are round whatever the pitches.
#[test]
fn dots_at_rest_are_round() {
    let effects = Effects { specks: Some(Specks { count: 9, ..Specks::default() }), ..Effects::default() };
    let found = rest(&on(Pitch { x_mm: 0.8, y_mm: 1.3 }, [9, 13], effects));
    let outlines = found.left_dots.iter().map(|dot| dot.outline).chain(found.left_specks);
    for outline in outlines {
        let [a, b] = outline.half_px.map(|half| half.length());
        assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");
    }
}
