//! Triangles that touch, cross, repeat and vanish, through the exact surface: finite answers that a first
//! guess does not change, no triangle nearer than the one named, a grid within its bound; and bytes of
//! templates.
#![no_main]

use gelstereo_core::math::DVec3;
use gelstereo_core::register::Template;
use gelstereo_core::surface::{Facing, Field, Solid, TriangleMesh};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

/// A coordinate of a coarse lattice, or now and then a little off it, or any number.
fn coordinate(u: &mut Unstructured<'_>) -> Result<f64> {
    Ok(match u.int_in_range(0..=63_u8)? {
        0 => u.arbitrary()?,
        1..=8 => f64::from(u.arbitrary::<i16>()?) / 4096.0,
        9..=12 => 1.0 + f64::from(u.arbitrary::<i8>()?) * f64::EPSILON,
        _ => f64::from(u.int_in_range(0..=3_u8)?),
    })
}

fn point(u: &mut Unstructured<'_>) -> Result<DVec3> {
    Ok(DVec3::new(coordinate(u)?, coordinate(u)?, coordinate(u)?))
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let places = (0..u.int_in_range(3..=24)?).map(|_| point(&mut u)).collect::<Result<Vec<_>>>()?;
    let most = places.len() as u32 - 1;
    let name = |u: &mut Unstructured<'_>| u.int_in_range(0..=most);
    let triangles = (0..u.int_in_range(1..=40)?)
        .map(|_| Ok([name(&mut u)?, name(&mut u)?, name(&mut u)?]))
        .collect::<Result<Vec<_>>>()?;
    let Ok(mesh) = TriangleMesh::new(places, triangles) else { return Ok(()) };
    let (turned, _) = mesh.turned_outward();
    assert_eq!(turned.triangles().len(), mesh.triangles().len());
    let Ok(solid) = Solid::new(&mesh) else { return Ok(()) };
    let (low, high) = solid.bounds_mm();
    let size = (high - low).length();
    for k in 0..8 {
        let p = point(&mut u)?;
        let found = solid.closest(p);
        assert!(found.point_mm.is_finite() && (found.normal.length() - 1.0).abs() < 1e-12);
        assert_eq!(solid.closest_from(p, k), found);
        if found.distance_mm.is_finite() {
            let slack = 1e-12 * (size + p.abs().max_element() + found.distance_mm.abs());
            assert!((found.point_mm.distance(p) - found.distance_mm.abs()).abs() <= slack);
            let nearest = mesh.vertices_mm();
            let faces = mesh.triangles().iter().enumerate();
            let faces = faces.filter(|&(t, _)| solid.face_normal(t as u32) != DVec3::ZERO);
            let to_corner = |&i: &u32| nearest[i as usize].distance(p);
            assert!(
                faces
                    .flat_map(|(_, t)| t.iter().map(to_corner))
                    .all(|d| d + slack >= found.distance_mm.abs())
            );
            let facing = Facing { direction: found.normal, least_cosine: -1.0 };
            assert!(solid.closest_facing(p, &facing, f64::INFINITY, None).is_some());
        }
        if let Some((distance, _)) = (k == 0 && size < 8.0)
            .then(|| Field::new(&solid, 0.5, 1.0))
            .flatten()
            .and_then(|field| field.distance(p))
        {
            // Where signs jump, half a cell and a diagonal.
            assert!((distance.abs() - found.distance_mm.abs()).abs() < 1.12);
        }
    }
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
    let _ = Template::from_bytes(bytes);
});
