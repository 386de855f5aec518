//! Prints whose markers have six neighbours.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, rest, rigid, truth, with_effects};
use gelstereo_core::lattice::Topology;
use gelstereo_core::math::{DVec2, DVec3, sqrt};
use gelstereo_core::params::{Pitch, PrintLayout};
use gelstereo_sim::effects::{ElasticLayer, Misprint, Specks};
use gelstereo_sim::{Effects, Ellipse, Gel, Scene, Shape, Simulator, Truth};
use proptest::prelude::*;

const BALL: Shape = Shape::Sphere { radius_mm: 4.0 };
const PITCH_MM: f64 = 0.9;

fn gel(rows: usize, cols: usize, odd_rows_forward: bool) -> Gel {
    Gel { rows, cols, odd_rows_forward, layout: PrintLayout::Hexagonal, ..Gel::default() }
}

fn on(gel: Gel, effects: Effects) -> Scene {
    Scene { gel, ..with_effects(BALL, effects) }
}

fn layer() -> Effects {
    // Cells under all places of markers, so that they are those of the rectangular print.
    let layer = ElasticLayer { cells_per_pitch: 1, border_pitches: 0, ..ElasticLayer::default() };
    Effects { elastic_layer: Some(layer), ..Effects::default() }
}

/// The rectangular print with a place at every marker and between any two markers of a row.
fn with_places_between(hexagonal: &Gel) -> Gel {
    let pitch_mm = Pitch { x_mm: 0.5 * PITCH_MM, y_mm: sqrt(0.75) * PITCH_MM };
    Gel { cols: 2 * hexagonal.cols, layout: PrintLayout::Square, pitch_mm, ..hexagonal.clone() }
}

/// The marker of that print for each of a hexagonal one.
fn of_both(gel: &Gel) -> impl Iterator<Item = usize> {
    let (cols, first) = (gel.cols, usize::from(!gel.odd_rows_forward));
    (0..gel.rows).flat_map(move |row| (0..cols).map(move |col| 2 * (row * cols + col) + (row + first) % 2))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// The names of rows and columns are the core's.
    #[test]
    fn markers_stand_where_the_core_says(
        rows in 2..12_usize, cols in 2..12_usize, forward in any::<bool>(), rotation_rad in -3.0..3.0_f64,
    ) {
        let scene = Scene { gel: Gel { rotation_rad, ..gel(rows, cols, forward) }, ..rigid(BALL) };
        let found = rest(&scene).points_mm;
        let topology = Topology::of(PrintLayout::Hexagonal, cols, &found);
        prop_assert_eq!(topology, Topology::hexagonal(rows, cols, forward));
        let at = |i: usize| DVec2::new(topology.along(i), sqrt(0.75) * (i / cols) as f64) * PITCH_MM;
        let along = DVec2::from_angle(rotation_rad);
        for (i, point) in found.iter().enumerate() {
            let step = at(i) - at(0);
            let expected = found[0].truncate() + along * step.x + along.perp() * step.y;
            prop_assert!((*point - expected.extend(28.7)).length() < 1e-12);
        }
        let text = toml::to_string(&scene).unwrap();
        prop_assert_eq!(toml::from_str::<Scene>(&text).unwrap(), scene);
    }

    /// The gel is that of a rectangular print, of which only some markers are printed.
    #[test]
    fn the_gel_is_that_of_the_rectangular_print(
        forward in any::<bool>(), x in -2.0..2.0_f64, y in -2.0..2.0_f64, of_layer in any::<bool>(),
    ) {
        let gel = Gel { dot_radius_mm: 0.2, ..gel(11, 12, forward) };
        let effects = || if of_layer { layer() } else { Effects::of_gel() };
        let between = on(with_places_between(&gel), effects());
        let hexagonal = on(gel, effects());
        let mut contact = press(&hexagonal, DVec3::ZERO, DVec2::new(x, y), 1.0);
        contact.shear_mm = [0.2, 0.1];
        let [found, expected] = [&hexagonal, &between].map(|scene| truth(scene, Some(&contact)));
        for (marker, other) in of_both(&hexagonal.gel).enumerate() {
            prop_assert!((found.points_mm[marker] - expected.points_mm[other]).length() < 1e-12);
            prop_assert_eq!(found.in_contact[marker], expected.in_contact[other]);
            prop_assert_eq!(found.touched_by[marker], expected.touched_by[other]);
        }
        let force_n = |truth: &Truth| truth.loads.as_ref().map_or(DVec3::ZERO, |loads| loads.force_n);
        prop_assert!((force_n(&found) - force_n(&expected)).length() < 1e-9);
    }

    /// A dot takes part in the strain between its neighbours, also at the border and with misprints.
    #[test]
    fn an_evenly_strained_gel_has_equal_dots(
        strain in prop::array::uniform4(-0.1..0.1_f64), forward in any::<bool>(), shift_mm in 0.0..0.1_f64,
    ) {
        let misprint = Some(Misprint { shift_mm, ..Misprint::default() });
        let scene = on(gel(6, 5, forward), Effects { misprint, ..Effects::default() });
        let [xx, xy, yx, yy] = strain;
        let of_strain = |at: &DVec3| DVec3::new(xx * at.x + xy * at.y, yx * at.x + yy * at.y, 0.0);
        let strained = |at: &DVec3| *at + of_strain(at);
        let points_mm: Vec<DVec3> = rest(&scene).points_mm.iter().map(strained).collect();
        let mut found = Truth::default();
        Simulator::new(&scene, None).unwrap().placed(&points_mm, 0, &mut found).unwrap();
        let px = 560.0 / 28.7 * scene.gel.dot_radius_mm;
        for dot in &found.left_dots {
            let Ellipse { half_px: [a, b], .. } = dot.outline;
            prop_assert!((a - DVec2::new(1.0 + xx, yx) * px).length() < 1e-9, "{a}");
            prop_assert!((b - DVec2::new(xy, 1.0 + yy) * px).length() < 1e-9, "{b}");
        }
    }
}

/// Loads are those of the part; the print only decides the cells.
#[test]
fn the_loads_hardly_depend_on_the_print() {
    let effects = || Effects { elastic_layer: Some(ElasticLayer::default()), ..Effects::default() };
    let [hexagonal, square] = [gel(19, 17, true), Gel { rows: 17, cols: 17, ..Gel::default() }];
    let [hexagonal, square] = [hexagonal, square].map(|gel| on(gel, effects()));
    let contact = press(&square, DVec3::ZERO, DVec2::new(0.3, 0.2), 1.2);
    let [found, expected] = [hexagonal, square].map(|scene| truth(&scene, Some(&contact)).loads.unwrap());
    assert!((found.force_n.z / expected.force_n.z - 1.0).abs() < 0.02, "{found:?}");
    let area_mm2 = sqrt(0.75) * PITCH_MM * PITCH_MM;
    let sum: DVec3 = found.traction_kpa.iter().sum();
    assert!((1e-3 * area_mm2 * sum - found.force_n).length() < 0.01 * found.force_n.length());
}

#[test]
fn specks_are_round_and_lie_between_three_dots() {
    for forward in [true, false] {
        let specks = Some(Specks { count: 40, ..Specks::default() });
        let found = rest(&on(gel(9, 10, forward), Effects { specks, ..Effects::default() }));
        for speck in found.left_specks {
            let [a, b] = speck.half_px.map(|half| half.length());
            assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");
            let away = |px: &DVec2| (*px - speck.centre_px).length() / (560.0 / 28.7 * PITCH_MM);
            let nearest = found.left_px.iter().map(away).fold(f64::MAX, f64::min);
            // The middle of three dots is 0.577 pitches from each, and a speck up to 0.11 off it.
            assert!(nearest > 0.46, "{nearest} pitches");
        }
    }
}

#[test]
fn a_hexagonal_print_has_one_pitch() {
    let text = "[gel]\nlayout = \"hexagonal\"\npitch_mm = [0.9, 0.8]";
    let error = toml::from_str::<Scene>(text).unwrap().validate().unwrap_err().to_string();
    assert!(error.contains("valid is one pitch, the distance of nearest markers"), "{error}");
}
