//! The mesh between markers.

use crate::support;

use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::surface::{MarkerMesh, MarkerMeshError};
use support::lattice;

/// Every cell of an exact lattice is cocircular: Euler's formula gives 2 (25 - 1)² triangles however they are
/// cut.
#[test]
fn row_13_an_exact_lattice_has_1152_triangles() {
    for (centre, turn_deg) in [(DVec2::ZERO, 0.0), (DVec2::new(320.0, 240.0), 0.0), (DVec2::splat(1e6), 0.0)]
    {
        let markers = lattice(25, 25, 16.0, centre, turn_deg, 0.0);
        let mesh = MarkerMesh::new(&markers).unwrap();
        assert_eq!(mesh.triangles().len(), 1152);
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| markers[i as usize]);
            (b - a).perp_dot(c - a) * 0.5
        };
        // With y down, counter-clockwise as seen is negative; half a cell each.
        assert!(mesh.triangles().iter().all(|t| (area(t) + 128.0).abs() < 1e-6));
    }
}

#[test]
fn row_14_input_without_a_triangulation_is_refused_by_name() {
    let line: Vec<DVec2> = (0..5).map(|i| DVec2::new(f64::from(i), 2.0 * f64::from(i))).collect();
    assert_eq!(MarkerMesh::new(&line), Err(MarkerMeshError::Collinear { markers: 5 }));
    for markers in 0..3 {
        assert_eq!(MarkerMesh::new(&line[..markers]), Err(MarkerMeshError::Collinear { markers }));
    }
    let square = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::ONE];
    let with = |extra: DVec2| MarkerMesh::new(&[&square[..], &[extra]].concat());
    assert_eq!(with(DVec2::X), Err(MarkerMeshError::Duplicate { first: 1, second: 4 }));
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e200, 1e-300] {
        assert_eq!(with(DVec2::new(0.5, bad)), Err(MarkerMeshError::NotFinite { marker: 4 }), "{bad}");
    }
}

#[test]
fn normals_point_to_the_camera_and_follow_a_tilt() {
    let rest = lattice(9, 7, 0.9, DVec2::ZERO, 4.0, 0.0);
    let mesh = MarkerMesh::new(&rest).unwrap();
    for (slope_x, slope_y) in [(0.0, 0.0), (0.3, 0.0), (-0.2, 0.7)] {
        let cloud: Vec<DVec3> =
            rest.iter().map(|p| DVec3::new(p.x, p.y, 28.7 + slope_x * p.x + slope_y * p.y)).collect();
        let mut normals = Vec::new();
        mesh.normals(&cloud, &mut normals).unwrap();
        let expected = DVec3::new(slope_x, slope_y, -1.0).normalize();
        assert!(normals.len() == 63 && normals.iter().all(|n| n.distance(expected) < 1e-12));
    }
}

#[test]
fn a_cloud_without_normals_is_refused_by_name() {
    let mesh = MarkerMesh::new(&lattice(3, 3, 1.0, DVec2::ZERO, 0.0, 0.0)).unwrap();
    let mut normals = Vec::new();
    let short = mesh.normals(&[DVec3::ZERO; 8], &mut normals);
    assert_eq!(short, Err(MarkerMeshError::LengthMismatch { points: 8, markers: 9 }));
    for cloud in [[DVec3::ZERO; 9], [DVec3::NAN; 9]] {
        assert_eq!(mesh.normals(&cloud, &mut normals), Err(MarkerMeshError::NoNormal { marker: 0 }));
        assert!(normals.is_empty());
    }
}
