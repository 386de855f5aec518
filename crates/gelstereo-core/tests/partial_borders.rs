//! Lattices of which the view shows a part: what is not whole is left out, and every label is right.

use crate::disturbed;

use disturbed::{PITCH, Scene};
use gelstereo_core::lattice::rest_lattice;
use gelstereo_core::math::DVec2;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::LatticeParams;

const TOLERANCE: f64 = 1.0 / 3.0;

/// Any turn, with few markers missing and with more. All markers near the middle are seen; some rows end
/// outside.
#[test]
fn row_51_a_lattice_wider_than_the_view_is_labelled() {
    let mut left_out = 0;
    for (degrees, share) in (0..90).flat_map(|degrees| [0.01, 0.1].map(|share| (degrees, share))) {
        let mut stream = Stream::new(degrees, "wider than the view");
        let shift = DVec2::new(stream.uniform(), stream.uniform()) * PITCH;
        let scene = Scene::new(61, 61, degrees as f64).moved(|p| p + shift).shaken(0.1, &mut stream).cut();
        let seen = scene.points.len();
        let scene = scene.shuffled(&mut stream);
        let lattice = LatticeParams { max_missing_share: share, ..LatticeParams::default() };
        let rest = rest_lattice(&scene.points, &lattice, TOLERANCE)
            .unwrap_or_else(|error| panic!("{degrees} degrees, {share}: {error}"));
        assert!(scene.is_part(&rest), "{degrees} degrees, {share}");
        let labelled = rest.detection.iter().flatten().count();
        assert!(3 * labelled >= seen, "{degrees} degrees, {share}: {labelled} of {seen}");
        left_out += usize::from(rest.left_out != [0; 4]);
    }
    assert!(left_out > 150, "{left_out} of 180 leave out rows or columns");
}

/// 500 markers, at the far side 0.4 to 0.8 as far apart as at the near one, some of them out of view.
#[test]
fn row_51_a_dense_print_in_perspective_is_labelled() {
    for (seed, turn) in (0..40).flat_map(|seed| [0.0, 5.0, 45.0].map(|turn| (seed, turn))) {
        let mut stream = Stream::new(seed, "perspective");
        let (x, y) = (stream.uniform() - 0.5, 0.3 + 0.4 * stream.uniform());
        let scene = Scene::new(22, 23, turn)
            .moved(|p| 1.2 * p / (1.0 + (p.x * x + p.y * y) / 500.0))
            .shaken(0.1, &mut stream)
            .cut()
            .thinned(0.01, &mut stream, |_, _| true)
            .shuffled(&mut stream);
        let lattice = LatticeParams { max_missing_share: 0.05, ..LatticeParams::default() };
        let rest = rest_lattice(&scene.points, &lattice, TOLERANCE)
            .unwrap_or_else(|error| panic!("seed {seed}, turned by {turn}: {error}"));
        assert!(scene.is_part(&rest), "seed {seed}, turned by {turn}");
        assert!(3 * rest.detection.iter().flatten().count() >= scene.points.len());
    }
}

/// Of a worn print, the rectangle without the worn corner; where all are seen alike, the one in the middle.
#[test]
fn row_51_fewer_rows_and_columns_choose_the_best_seen_rectangle() {
    let lattice = LatticeParams { rows: Some(8), cols: Some(11), ..LatticeParams::default() };
    let scene = Scene::new(20, 21, 3.0);
    let rest = rest_lattice(&scene.points, &lattice, TOLERANCE).unwrap();
    assert_eq!((rest.rows, rest.cols, rest.left_out), (8, 11, [6, 5, 6, 5]));
    assert!(scene.is_part(&rest));
    let worn: Vec<DVec2> =
        (0..20 * 21).filter(|n| n / 21 >= 11 || n % 21 >= 9 || n % 2 == 0).map(|n| scene.truth[n]).collect();
    let rest = rest_lattice(&worn, &lattice, TOLERANCE).unwrap();
    assert_eq!((rest.rows, rest.cols), (8, 11));
    assert!(rest.detection.iter().all(Option::is_some) && scene.is_part(&rest));
    let one_axis = LatticeParams { rows: Some(8), ..LatticeParams::default() };
    let rest = rest_lattice(&scene.points, &one_axis, TOLERANCE).unwrap();
    assert_eq!((rest.rows, rest.cols, rest.left_out), (8, 21, [6, 0, 6, 0]));
}

/// Without a border in the way, holes anywhere are not hidden by a smaller rectangle.
#[test]
fn a_print_with_holes_is_refused_and_not_cut_down() {
    for seed in 0..40 {
        let mut stream = Stream::new(seed, "holes");
        let scene = Scene::new(25, 25, 10.0).thinned(0.1, &mut stream, |_, _| true);
        assert!(rest_lattice(&scene.points, &LatticeParams::default(), TOLERANCE).is_err(), "{seed}");
    }
}
