//! Clouds through the rest surface, saliency and the mesh between the markers: refused by name, or finite.
#![no_main]

use gelstereo_core::contact::RestSurface;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::surface::MarkerMesh;
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

/// Coordinates on a coarse lattice, so that points coincide and lie on lines and circles, or now and then any
/// number.
fn coordinate(u: &mut Unstructured<'_>) -> Result<f64> {
    Ok(match u.int_in_range(0..=31_u8)? {
        0 => u.arbitrary()?,
        1..=8 => f64::from(u.arbitrary::<i16>()?) / 512.0,
        _ => f64::from(u.int_in_range(0..=7_u8)?) * 0.9,
    })
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let count = u.int_in_range(0..=60)?;
    let mut cloud = || -> Result<Vec<DVec3>> {
        (0..count)
            .map(|_| Ok(DVec3::new(coordinate(&mut u)?, coordinate(&mut u)?, 28.0 + coordinate(&mut u)?)))
            .collect()
    };
    let (rest_mm, now_mm) = (cloud()?, cloud()?);
    if let Ok(rest) = RestSurface::new(&rest_mm) {
        assert!(rest.normal().is_finite());
        let mut indentation_mm = Vec::new();
        if rest.indentation_mm(&now_mm, &mut indentation_mm).is_ok() {
            assert_eq!(indentation_mm.len(), count);
        }
    }
    let places: Vec<DVec2> = rest_mm.iter().map(|p| p.truncate()).collect();
    if let Ok(mesh) = MarkerMesh::new(&places) {
        assert!(mesh.triangles().iter().flatten().all(|&i| (i as usize) < count));
        let mut normals = Vec::new();
        if mesh.normals(&now_mm, &mut normals).is_ok() {
            assert!(normals.iter().all(|n| n.is_finite()));
        }
    }
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
