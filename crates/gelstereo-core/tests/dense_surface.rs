//! The surface between markers.

mod support;

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
            // Areas are differences of products of the lattice's extent, which rounds 1e2 eps of a cell's area.
            prop_assert!(frame.points_mm[cell].distance(expected) < 1e-11, "{cell}: {:?}", frame.points_mm[cell] - expected);
            prop_assert!(frame.normals[cell].distance(normal) < 1e-12);
            known += 1;
        }
        prop_assert!(known > 20);
    }
}

/// Weights are at least 0, add up to 1 and reproduce the cell's place, so the error is half of the curvature times the
/// weighted square of the distances to the neighbours. These stand at most where a cell of markers has its corners,
/// h / √2 from the cell's middle: h² / (4 R), twice that of a plain h² / 8 along one axis. A sphere's heights bend by 1 / R
/// times 1 / cos³ of the steepest slope.
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

/// Weights by counting: the spots of a fine raster that are nearer to the cell than to any marker, by the marker that was
/// nearest before (Park et al. 2006, "Discrete Sibson interpolation").
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

/// On the exact lattice every cell of markers is cocircular; its hull, its edges and its markers are met exactly.
#[test]
fn row_13_an_exact_lattice_has_weights_everywhere() {
    for centre in [DVec2::ZERO, DVec2::new(1e3, -1e3)] {
        let rest = lattice(25, 25, 1.0, centre, 0.0, 0.0);
        for step_mm in [0.125, 0.25, 0.5, 1.0, 0.3] {
            let surface = DenseSurface::new(&rest, step_mm).unwrap();
            for cell in 0..surface.rows() * surface.cols() {
                let at = surface.rest_mm(cell / surface.cols(), cell % surface.cols()) - centre;
                let inside = at.x.max(at.y) <= 12.0;
                assert_eq!(surface.is_known(cell), inside, "{at}");
                let sum: f64 = surface.weights_of(cell).iter().map(|&(_, w)| w).sum();
                assert!(!inside || (sum - 1.0).abs() < 1e-12, "{at}: {sum}");
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
}

/// Found by fuzzing: a step of 4e256 mm put all markers on one spot of the grid, and one of 1 mm did so with rows 1e-41 mm
/// apart; the interpolation of no triangles then panicked.
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
    let refused = DenseSurface::new(&at(1e-41), 1.0);
    assert!(matches!(refused, Err(DenseSurfaceError::Mesh(_))), "{refused:?}");
}
