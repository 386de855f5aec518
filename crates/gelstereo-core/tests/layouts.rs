//! Prints that are no square lattice are named.

use crate::support::lattice;
use gelstereo_core::lattice::{LabelError, Layout, rest_lattice};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, cos, sin};
use gelstereo_core::params::LatticeParams;

const PITCH: f64 = 20.0;

/// Rows `down` pitches apart, every other one shifted by `aside`; what lies in an image of 640 x 480 px.
fn rows(down: f64, along: f64, aside: f64, degrees: f64) -> Vec<DVec2> {
    let (c, s) = (cos(degrees.to_radians()), sin(degrees.to_radians()));
    let at = |row: i32, col: i32| {
        let x = (f64::from(col) + aside * f64::from(row.rem_euclid(2))) * along * PITCH;
        let y = f64::from(row) * down * PITCH;
        DVec2::new(320.0 + c * x - s * y, 240.0 + s * x + c * y)
    };
    let all = (-40..=40).flat_map(|row| (-40..=40).map(move |col| at(row, col)));
    all.filter(|p| p.x > 6.0 && p.y > 6.0 && p.x < 634.0 && p.y < 474.0).collect()
}

fn shaken(points: &[DVec2], seed: u64) -> Vec<DVec2> {
    let mut stream = Stream::new(seed, "shaken");
    points
        .iter()
        .map(|&p| {
            let (x, y) = stream.normal_pair();
            p + DVec2::new(x, y) * 0.3
        })
        .collect()
}

fn error(points: &[DVec2]) -> LabelError {
    rest_lattice(points, &LatticeParams::default(), 1.0 / 3.0).unwrap_err()
}

#[test]
fn row_52_other_layouts_are_named() {
    for turn in 0..30 {
        let degrees = 3.0 * f64::from(turn);
        let hexagonal = shaken(&rows(0.75_f64.sqrt(), 1.0, 0.5, degrees), turn as u64);
        let found = error(&hexagonal);
        assert!(matches!(found, LabelError::Layout { layout: Layout::Hexagonal, .. }), "{degrees}: {found}");
        assert!(found.to_string().contains("six neighbours"), "{found}");
        let rectangular = shaken(&rows(2.2, 1.0, 0.0, degrees), turn as u64);
        let found = error(&rectangular);
        let LabelError::Layout { layout: Layout::Rectangular { short_px, long_px }, .. } = found else {
            panic!("{degrees}: {found}");
        };
        assert!((short_px - PITCH).abs() < 0.5 && (long_px - 2.2 * PITCH).abs() < 0.5, "{found}");
        let random = random_dots(turn as u64);
        let found = error(&random);
        assert!(matches!(found, LabelError::Layout { layout: Layout::Irregular { .. }, .. }), "{found}");
    }
    assert_eq!(Layout::of(&lattice(25, 25, PITCH, DVec2::new(320.0, 240.0), 7.0, 0.0)), None);
    assert_eq!(Layout::of(&[DVec2::ONE; 40]), None);
    assert_eq!(Layout::of(&[DVec2::NAN; 40]), None);
}

/// 250 dots, at least 12 px apart.
fn random_dots(seed: u64) -> Vec<DVec2> {
    let mut stream = Stream::new(seed, "random dots");
    let mut dots: Vec<DVec2> = Vec::new();
    while dots.len() < 250 {
        let at = DVec2::new(10.0 + 620.0 * stream.uniform(), 10.0 + 460.0 * stream.uniform());
        if dots.iter().all(|dot| dot.distance(at) > 12.0) {
            dots.push(at);
        }
    }
    dots
}
