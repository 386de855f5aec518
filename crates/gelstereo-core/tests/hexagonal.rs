//! Hexagonal prints: rows, columns, and what is refused.

use gelstereo_core::lattice::{LabelError, Layout, RestLattice, Topology, rest_lattice};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, cos, sin, sqrt};
use gelstereo_core::params::{LatticeParams, PrintLayout};
use proptest::prelude::*;

const PITCH_PX: f64 = 22.0;

fn hexagonal() -> LatticeParams {
    LatticeParams { layout: PrintLayout::Hexagonal, max_missing_share: 0.2, ..Default::default() }
}

/// Markers of a hexagonal print, row by row, about its middle.
fn print(rows: usize, cols: usize, odd_rows_forward: bool) -> Vec<DVec2> {
    let topology = Topology::hexagonal(rows, cols, odd_rows_forward);
    let at = |i: usize| DVec2::new(topology.along(i), sqrt(0.75) * (i / cols) as f64);
    let middle = DVec2::new((cols - 1) as f64, sqrt(0.75) * (rows - 1) as f64) * 0.5;
    (0..rows * cols).map(|i| at(i) - middle).collect()
}

/// How a camera sees a print.
#[derive(Clone, Copy, Debug)]
struct Look {
    degrees: f64,
    /// Smaller over larger scale, and the direction of the smaller one.
    squeeze: f64,
    squeezed_degrees: f64,
    /// Change of the scale from the print's middle to its farthest marker.
    perspective: f64,
}

fn turned(at: DVec2, degrees: f64) -> DVec2 {
    let (c, s) = (cos(degrees.to_radians()), sin(degrees.to_radians()));
    DVec2::new(c * at.x - s * at.y, s * at.x + c * at.y)
}

fn seen(print: &[DVec2], look: Look, seed: u64) -> Vec<DVec2> {
    let mut stream = Stream::new(seed, "shaken");
    let reach = print.iter().map(|at| at.length()).fold(0.0, f64::max);
    print
        .iter()
        .map(|&at| {
            let across = turned(turned(at, look.degrees), -look.squeezed_degrees);
            let at = turned(DVec2::new(across.x * look.squeeze, across.y), look.squeezed_degrees);
            let (x, y) = stream.normal_pair();
            let scale = PITCH_PX / (1.0 + look.perspective * at.y / reach);
            DVec2::new(320.0, 240.0) + at * scale + DVec2::new(x, y) * 0.3
        })
        .collect()
}

fn looks(degrees: f64, least_squeeze: f64) -> impl Strategy<Value = Look> {
    (-degrees..degrees, least_squeeze..1.0_f64, 0.0..180.0_f64, -0.15..0.15_f64).prop_map(
        |(degrees, squeeze, squeezed_degrees, perspective)| Look {
            degrees,
            squeeze,
            squeezed_degrees,
            perspective,
        },
    )
}

fn label(points: &[DVec2], params: &LatticeParams) -> Result<RestLattice, LabelError> {
    rest_lattice(points, params, 1.0 / 3.0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// Squeezing by 0.8 is a tilt by 37 degrees.
    #[test]
    fn rows_and_columns_are_named(
        (rows, cols) in (5..20_usize, 5..20_usize), forward in any::<bool>(), look in looks(70.0, 0.8),
        hidden in prop::collection::vec(any::<prop::sample::Index>(), 0..4), seed in any::<u64>(),
    ) {
        let truth = seen(&print(rows, cols, forward), look, seed);
        // Whole border lines tell where the print ends.
        let inside = |i: &usize| {
            (2..rows - 2).contains(&(i / cols)) && (2..cols - 2).contains(&(i % cols))
        };
        let hidden: Vec<usize> =
            hidden.iter().map(|index| index.index(rows * cols)).filter(inside).collect();
        let kept: Vec<usize> = (0..truth.len()).filter(|i| !hidden.contains(i)).collect();
        let points: Vec<DVec2> = kept.iter().map(|&i| truth[i]).collect();
        let found = label(&points, &hexagonal()).map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert_eq!((found.rows, found.cols), (rows, cols));
        for (i, detection) in found.detection.iter().enumerate() {
            prop_assert_eq!(detection.map(|m| kept[m as usize]), (!hidden.contains(&i)).then_some(i));
        }
        for (found, truth) in found.positions_px.iter().zip(&truth) {
            prop_assert!(found.distance(*truth) < 0.2 * PITCH_PX);
        }
        let topology = Topology::in_image(PrintLayout::Hexagonal, cols, &found.positions_px);
        prop_assert_eq!(topology, Topology::hexagonal(rows, cols, forward));
    }

    /// Of a print that is larger than the view, whatever its tilt up to 33 degrees.
    #[test]
    fn row_52_a_hexagonal_print_is_no_square_one(look in looks(180.0, 0.84), seed in any::<u64>()) {
        let points = in_view(&seen(&print(60, 60, true), look, seed));
        let error = label(&points, &LatticeParams { max_missing_share: 0.2, ..Default::default() });
        let is_named = matches!(
            error, Err(LabelError::Layout { layout: Layout::Hexagonal, expected: PrintLayout::Square, .. })
        );
        prop_assert!(is_named, "{error:?}");
        let found = label(&points, &hexagonal()).map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert!(found.rows.min(found.cols) >= 5);
        // Neighbours in the result are neighbours in the print.
        let topology = Topology::in_image(PrintLayout::Hexagonal, found.cols, &found.positions_px);
        for i in 0..found.positions_px.len() {
            for next in topology.neighbours(i) {
                let apart_px = found.positions_px[i].distance(found.positions_px[next]);
                prop_assert!(apart_px < 1.45 * PITCH_PX, "{apart_px}");
            }
        }
    }

    /// The same of a sheared print whose rows and columns look whole: a parallelogram.
    #[test]
    fn row_52_a_parallelogram_is_no_square(look in looks(180.0, 0.92), seed in any::<u64>()) {
        let cells: Vec<DVec2> = (0..144)
            .map(|i| {
                let (row, col) = (f64::from(i / 12) - 5.5, f64::from(i % 12) - 5.5);
                DVec2::new(col + 0.5 * row, sqrt(0.75) * row)
            })
            .collect();
        let error = label(&seen(&cells, look, seed), &LatticeParams::default());
        let is_named = matches!(error, Err(LabelError::Layout { layout: Layout::Hexagonal, .. }));
        prop_assert!(is_named, "{error:?}");
    }

    /// A square or rectangular print, tilted by up to 33 degrees, is not taken for a hexagonal one.
    #[test]
    fn a_square_print_is_no_hexagonal_one(
        look in looks(180.0, 0.84), down in 1.0..1.5_f64, seed in any::<u64>(),
    ) {
        let (down, forward) = (if down < 1.1 { 1.0 } else { down }, 14);
        let cells: Vec<DVec2> = (0..forward * forward)
            .map(|i| DVec2::new(f64::from(i % forward) - 6.5, (f64::from(i / forward) - 6.5) * down))
            .collect();
        let points = seen(&cells, look, seed);
        let error = label(&points, &hexagonal());
        prop_assert!(matches!(error, Err(LabelError::Layout { .. })), "{error:?}");
        let found = label(&points, &LatticeParams::default());
        prop_assert!(found.is_ok(), "{found:?}");
    }
}

fn in_view(points: &[DVec2]) -> Vec<DVec2> {
    points.iter().copied().filter(|p| p.x > 6.0 && p.y > 6.0 && p.x < 634.0 && p.y < 474.0).collect()
}

/// Dots beside the print's own hide none of these.
#[test]
fn specks_take_no_place() {
    for seed in 0..40 {
        let look = Look { degrees: 5.0, squeeze: 0.95, squeezed_degrees: 20.0, perspective: 0.1 };
        let mut points = seen(&print(12, 14, true), look, seed);
        let mut stream = Stream::new(seed, "specks");
        let (low, high) = points.iter().fold((points[0], points[0]), |(l, h), &p| (l.min(p), h.max(p)));
        let specks = (0..5).map(|_| low + (high - low) * DVec2::new(stream.uniform(), stream.uniform()));
        let far = |speck: &DVec2| points.iter().all(|p| p.distance(*speck) > 0.4 * PITCH_PX);
        let specks: Vec<DVec2> = specks.filter(far).collect();
        points.extend(specks);
        let found = label(&points, &hexagonal()).unwrap();
        assert_eq!((found.rows, found.cols), (12, 14), "{seed}");
        assert!(found.detection.iter().flatten().all(|&m| m < 168), "{seed}");
    }
}

/// Prints whose rows have a marker less in turn: the missing places are filled in.
#[test]
fn shorter_rows_are_completed() {
    let look = Look { degrees: 8.0, squeeze: 0.95, squeezed_degrees: 40.0, perspective: 0.1 };
    for (rows, forward, short) in [(11, true, 1), (12, true, 1), (11, false, 0), (12, false, 0)] {
        let all = seen(&print(rows, 13, forward), look, rows as u64);
        let is_short = |i: usize| i / 13 % 2 == short && i % 13 == 12;
        let kept: Vec<usize> = (0..all.len()).filter(|&i| !is_short(i)).collect();
        let points: Vec<DVec2> = kept.iter().map(|&i| all[i]).collect();
        let found = label(&points, &hexagonal()).unwrap();
        assert_eq!((found.rows, found.cols), (rows, 13), "{rows} {forward}");
        let labels: Vec<Option<usize>> =
            found.detection.iter().map(|m| m.map(|m| kept[m as usize])).collect();
        let expected: Vec<Option<usize>> = (0..all.len()).map(|i| (!is_short(i)).then_some(i)).collect();
        // A row that begins half a pitch before its neighbours may count as shifted either way.
        let other: Vec<Option<usize>> = (0..all.len())
            .map(|i| if i / 13 % 2 == short { (i % 13).checked_sub(1).map(|_| i - 1) } else { Some(i) })
            .collect();
        assert!(labels == expected || labels == other, "{rows} {forward}: {labels:?}");
    }
}

#[test]
fn every_second_row_is_shifted() {
    for forward in [true, false] {
        let topology = Topology::hexagonal(7, 6, forward);
        let at = |i: usize| DVec2::new(topology.along(i), sqrt(0.75) * (i / 6) as f64);
        for i in 0..topology.places() {
            let near: Vec<usize> = (0..42).filter(|&k| k != i && at(k).distance(at(i)) < 1.1).collect();
            let mut found: Vec<usize> = topology.neighbours(i).collect();
            found.sort_unstable();
            assert_eq!(found, near);
            for axis in 0..3 {
                if let (Some(before), Some(after)) = (topology.step(i, axis, -2), topology.step(i, axis, 2)) {
                    assert!((at(before) + at(after)).distance(at(i) * 2.0) < 1e-12);
                }
            }
        }
    }
}
