//! The surface between markers.

use crate::support;

use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::surface::{DenseFrame, DenseSurface, DenseSurfaceError, MarkerMeshError};
use proptest::prelude::*;
use support::lattice;

/// Points over the rest positions at heights `z(x, y)`.
fn cloud(rest: &[DVec2], z: impl Fn(DVec2) -> f64) -> Vec<DVec3> {
    rest.iter().map(|&p| p.extend(z(p))).collect()
}

proptest! {
    /// Sibson's weights reproduce the place they belong to, so that planes are exact.
    #[test]
    fn planes_are_exact(
        turn_deg in 0.0..360.0_f64, shear in -0.2..0.2_f64, slope in prop::array::uniform2(-1.0..1.0_f64),
        step_mm in 0.15..0.9_f64, jitter in prop::collection::vec(-0.2..0.2_f64, 126),
    ) {
        let mut rest = lattice(9, 7, 0.9, DVec2::new(4.0, -1.0), turn_deg, shear);
        rest.iter_mut().zip(jitter.chunks(2)).for_each(|(p, j)| *p += DVec2::new(j[0], j[1]));
        let slope = DVec2::from_array(slope);
        let mut surface = DenseSurface::new(&rest, step_mm).unwrap();
        let mut frame = DenseFrame::default();
        surface.run(&cloud(&rest, |p| 28.7 + slope.dot(p)), &mut frame).unwrap();
        let normal = slope.extend(-1.0).normalize();
        let mut known = 0;
        for cell in (0..frame.points_mm.len()).filter(|&cell| surface.is_known(cell)) {
            let at = surface.rest_mm(cell / surface.cols(), cell % surface.cols());
            let expected = at.extend(28.7 + slope.dot(at));
            // Areas are differences of products of the lattice's extent, which rounds 1e2 eps of a cell's
            // area.
            prop_assert!(
                frame.points_mm[cell].distance(expected) < 1e-11,
                "{cell}: {:?}",
                frame.points_mm[cell] - expected
            );
            prop_assert!(frame.normals[cell].distance(normal) < 1e-12);
            known += 1;
        }
        prop_assert!(known > 20);
    }
}

/// Weights are at least 0, add up to 1 and reproduce the cell's place, so the error is half of the curvature
/// times the weighted square of the distances to the neighbours. These stand at most where a cell of markers
/// has its corners, h / √2 from the cell's middle: h² / (4 R), twice that of a plain h² / 8 along one axis. A
/// sphere's heights bend by 1 / R times 1 / cos³ of the steepest slope.
#[test]
fn a_sphere_is_found_within_the_curvature_bound() {
    let (pitch_mm, radius_mm) = (0.9, 20.0_f64);
    let rest = lattice(15, 15, pitch_mm, DVec2::ZERO, 0.0, 0.0);
    let sphere = |p: DVec2| 40.0 - (radius_mm * radius_mm - p.length_squared()).sqrt();
    let mut surface = DenseSurface::new(&rest, 0.1).unwrap();
    let mut frame = DenseFrame::default();
    surface.run(&cloud(&rest, sphere), &mut frame).unwrap();
    let far2 = 2.0 * (7.0 * pitch_mm).powi(2);
    let bend = 1.0 / radius_mm * (1.0 - far2 / (radius_mm * radius_mm)).powf(-1.5);
    let bound_mm = 0.5 * bend * 0.5 * pitch_mm * pitch_mm;
    let mut worst_mm = 0.0_f64;
    for cell in (0..frame.points_mm.len()).filter(|&cell| surface.is_known(cell)) {
        let p = frame.points_mm[cell];
        worst_mm = worst_mm.max((p.z - sphere(p.truncate())).abs());
    }
    assert!(worst_mm <= bound_mm, "{worst_mm} mm, bound {bound_mm} mm");
    assert!(worst_mm > 0.2 * bound_mm, "the bound is a loose one: {worst_mm} mm of {bound_mm} mm");
}

/// Weights by counting: the spots of a fine raster that are nearer to the cell than to any marker, by the
/// marker that was nearest before (Park et al. 2006, "Discrete Sibson interpolation").
#[test]
fn weights_agree_with_counted_areas() {
    let mut rest = lattice(6, 5, 0.9, DVec2::ZERO, 17.0, 0.1);
    rest.iter_mut().enumerate().for_each(|(i, p)| p.x += 0.13 * ((i * 7 % 5) as f64 - 2.0) / 2.0);
    let surface = DenseSurface::new(&rest, 0.37).unwrap();
    let fine_mm = 0.005;
    let mut compared = 0;
    for cell in 0..surface.rows() * surface.cols() {
        let at = surface.rest_mm(cell / surface.cols(), cell % surface.cols());
        // Far from the hull, where regions are small: the raster is 2 mm wide.
        if !surface.is_known(cell) || at.length() > 1.0 {
            continue;
        }
        let mut taken = vec![0.0; rest.len()];
        for n in 0..400 * 400 {
            let spot = at + DVec2::new(f64::from(n % 400) - 199.5, f64::from(n / 400) - 199.5) * fine_mm;
            let nearest = |&a: &usize, &b: &usize| {
                rest[a].distance_squared(spot).total_cmp(&rest[b].distance_squared(spot))
            };
            let marker = (0..rest.len()).min_by(nearest).unwrap();
            if spot.distance_squared(at) < spot.distance_squared(rest[marker]) {
                taken[marker] += 1.0;
            }
        }
        let all: f64 = taken.iter().sum();
        for &(marker, weight) in surface.weights_of(cell) {
            // A region's outline of about 2 mm crosses 400 spots of which half are counted wrong at random.
            assert!((taken[marker as usize] / all - weight).abs() < 0.005, "{cell} {marker} {weight}");
            taken[marker as usize] = 0.0;
        }
        assert!(taken.iter().all(|&t| t < 0.005 * all));
        compared += 1;
    }
    assert!(compared > 10);
}

/// On the exact lattice every cell of markers is cocircular; its hull, its edges and its markers are met
/// exactly, or but for round-off where the lattice is turned. Cells reach as far as the markers; their
/// weights are shares, and reproduce the place to the rounding of areas, 1e2 eps of a cell's, over which
/// coordinates of up to 1e3 mm round as well.
#[test]
fn row_13_an_exact_lattice_has_weights_everywhere() {
    let placed = [(DVec2::ZERO, 0.0_f64), (DVec2::new(1e3, -1e3), 0.0), (DVec2::ZERO, 45.0)];
    // 24 x 0.9 / 0.3 is 72.00000000000001 in floating point.
    for ((centre, turn_deg), pitch_mm) in placed.into_iter().flat_map(|place| [(place, 1.0), (place, 0.9)]) {
        let rest = lattice(25, 25, pitch_mm, centre, turn_deg, 0.0);
        let side = |of: fn(&DVec2) -> f64| {
            let (low, high) =
                rest.iter().map(of).fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
            high - low
        };
        for step_mm in [0.125, 0.25, 0.5, 1.0, 0.3, core::f64::consts::FRAC_1_SQRT_2] {
            let surface = DenseSurface::new(&rest, step_mm).unwrap();
            let reach = |cells: usize| (cells - 1) as f64 * step_mm;
            for (cells, length) in [(surface.cols(), side(|p| p.x)), (surface.rows(), side(|p| p.y))] {
                // The last cell stands on the last marker or beyond it, by less than a step.
                assert!(
                    (-1e-9..step_mm - 1e-9).contains(&(reach(cells) - length)),
                    "{cells} {length} {step_mm}"
                );
            }
            for cell in 0..surface.rows() * surface.cols() {
                let at = surface.rest_mm(cell / surface.cols(), cell % surface.cols());
                let along = DVec2::from_angle(-turn_deg.to_radians()).rotate(at - centre);
                let outside_mm = along.abs().max_element() - 12.0 * pitch_mm;
                let known = surface.is_known(cell);
                assert!(known == (outside_mm <= 0.0) || turn_deg > 0.0 && outside_mm.abs() < 1e-12, "{at}");
                let weights = surface.weights_of(cell);
                assert!(weights.iter().all(|&(_, w)| (-1e-9..=1.0 + 1e-9).contains(&w)), "{at}: {weights:?}");
                let sum: f64 = weights.iter().map(|&(_, w)| w).sum();
                let place: DVec2 = weights.iter().map(|&(m, w)| (rest[m as usize] - at) * w).sum();
                assert!(!known || (sum - 1.0).abs() < 1e-12 && place.length() < 1e-11, "{at}: {sum} {place}");
            }
        }
    }
}

#[test]
fn row_14_input_without_a_dense_surface_is_refused_by_name() {
    let rest = lattice(5, 5, 0.9, DVec2::ZERO, 0.0, 0.0);
    let new = |rest: &[DVec2], step_mm| DenseSurface::new(rest, step_mm).map(|_| ());
    let line: Vec<DVec2> = (0..4).map(|i| DVec2::splat(f64::from(i))).collect();
    let mesh = |error| Err(DenseSurfaceError::Mesh(error));
    assert_eq!(new(&line, 0.1), mesh(MarkerMeshError::Collinear { markers: 4 }));
    assert_eq!(new(&[], 0.1), mesh(MarkerMeshError::Collinear { markers: 0 }));
    let twice = [&rest[..], &rest[3..4]].concat();
    assert_eq!(new(&twice, 0.1), mesh(MarkerMeshError::Duplicate { first: 3, second: 25 }));
    let nan = [&rest[..], &[DVec2::NAN]].concat();
    assert_eq!(new(&nan, 0.1), mesh(MarkerMeshError::NotFinite { marker: 25 }));
    for step_mm in [0.0, -0.1, f64::NAN, f64::INFINITY, 1e-6, 1e-300] {
        assert!(matches!(new(&rest, step_mm), Err(DenseSurfaceError::Step { .. })), "{step_mm}");
    }
    let (mut surface, mut frame) = (DenseSurface::new(&rest, 0.3).unwrap(), DenseFrame::default());
    let mut points = cloud(&rest, |_| 28.7);
    surface.run(&points, &mut frame).unwrap();
    points[7].y = f64::NAN;
    assert_eq!(surface.run(&points, &mut frame), Err(DenseSurfaceError::NotFinite { marker: 7 }));
    assert!(frame.points_mm.is_empty() && frame.normals.is_empty());
    let short = surface.run(&points[..7], &mut frame);
    assert_eq!(short, mesh(MarkerMeshError::LengthMismatch { points: 7, markers: 25 }));
    assert_eq!(surface.run(&[DVec3::ZERO; 25], &mut frame), mesh(MarkerMeshError::NoNormal { marker: 0 }));
    let mut out = Vec::new();
    assert_eq!(surface.sample(&[0.0; 7], &mut out), short);
    for bad in [f64::NAN, f64::INFINITY] {
        let values: Vec<f64> = (0..25).map(|n| if n == 9 { bad } else { 1.0 }).collect();
        assert_eq!(surface.sample(&values, &mut out), Err(DenseSurfaceError::NotFinite { marker: 9 }));
        assert!(out.is_empty());
    }
}

/// The larger of two triangles folded over the smaller one: every marker has a normal, but midway between the
/// corner of the one and a corner of both they cancel.
#[test]
fn row_14_a_fold_between_markers_is_refused_by_name() {
    let rest = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::splat(1.1)];
    let (mut surface, mut frame) = (DenseSurface::new(&rest, 0.5).unwrap(), DenseFrame::default());
    surface.run(&cloud(&rest, |_| 28.7), &mut frame).unwrap();
    let folded = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(-1.0, -1.0, 0.0)];
    assert_eq!(surface.run(&folded, &mut frame), Err(DenseSurfaceError::NoNormal { cell: 1 }));
    assert!(frame.points_mm.is_empty() && frame.normals.is_empty());
}

/// Found by fuzzing: a step of 4e256 mm put all markers on one spot of the grid, and one of 1 mm did so with
/// rows 1e-41 mm apart; the interpolation of no triangles then panicked.
#[test]
fn steps_that_leave_nothing_between_the_markers_are_refused() {
    let at = |height: f64| -> Vec<DVec2> {
        (0..4).map(|n| DVec2::new(f64::from(n % 2), f64::from(n / 2) * height)).collect()
    };
    for step_mm in [1.1, 1e3, 4e256] {
        let refused = DenseSurface::new(&at(1.0), step_mm);
        assert!(matches!(refused, Err(DenseSurfaceError::Step { .. })), "{step_mm}");
    }
    assert_eq!(DenseSurface::new(&at(1.0), 1.0).unwrap().rows(), 2);
    let twice = MarkerMeshError::Duplicate { first: 0, second: 2 };
    assert_eq!(DenseSurface::new(&at(1e-41), 1.0), Err(DenseSurfaceError::Mesh(twice)));
}
