//! Signed distances on a grid against the exact ones.
// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use crate::solids;

use gelstereo_core::math::DVec3;
use gelstereo_core::math::random::Stream;
use gelstereo_core::surface::{Field, Solid, TriangleMesh};
use proptest::prelude::*;
use solids::{block, star};

fn solid((vertices, triangles): (Vec<DVec3>, Vec<[u32; 3]>)) -> Solid {
    Solid::new(&TriangleMesh::new(vertices, triangles).unwrap()).unwrap()
}

fn points(seed: u64, half: f64, count: usize) -> impl Iterator<Item = DVec3> {
    let mut random = Stream::new(seed, "points");
    let mut coordinate = move || half * (2.0 * random.uniform() - 1.0);
    (0..count).map(move |_| DVec3::new(coordinate(), coordinate(), coordinate()))
}

/// Rounding of one value to 16 bits, of which a cell's eight take a mean.
fn step(field: &Field) -> f64 {
    (field.reach_mm() + 3.0_f64.sqrt() * field.cell_mm()) / f64::from(i16::MAX)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn the_error_is_within_the_bound_everywhere(seed in any::<u64>(), n in 1_usize..4, cell in 0.2_f64..0.6) {
        let mut random = Stream::new(seed, "radii");
        let solid = solid(star(n, |_, _| 2.0 + 3.0 * random.uniform()));
        let field = Field::new(&solid, cell, 1.3).unwrap();
        prop_assert_eq!(field.cell_mm(), cell);
        let bound = 0.75_f64.sqrt() * cell + step(&field);
        let mut known = 0;
        for p in points(seed, 5.0, 1000) {
            let exact = solid.closest(p).distance_mm;
            match field.distance(p) {
                Some((distance, _)) => {
                    known += 1;
                    prop_assert!((distance - exact).abs() <= bound, "{} {} {}", p, distance, exact);
                    prop_assert!(distance.abs() <= 1.3);
                }
                None => prop_assert!(exact.abs() > 1.3 - bound, "{} {}", p, exact),
            }
        }
        prop_assert!(known > 50);
    }

    #[test]
    fn the_gradient_is_that_of_the_interpolated_distance(seed in any::<u64>()) {
        let solid = solid(star(2, |d, _| 3.0 + d.x * d.y));
        let field = Field::new(&solid, 0.25, 2.0).unwrap();
        for p in points(seed, 5.0, 500) {
            let Some((middle, gradient)) = field.distance(p) else { continue };
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                // Within a cell it is linear along every axis, so that this difference is exact but for
                // rounding.
                let h = 1e-6;
                let Some((above, _)) = field.distance(p + axis * h) else { continue };
                let Some((below, _)) = field.distance(p - axis * h) else { continue };
                if ((above - middle) - (middle - below)).abs() < 1e-13 {
                    prop_assert!((gradient.dot(axis) - (above - below) / (2.0 * h)).abs() < 1e-7);
                }
            }
        }
    }
}

#[test]
fn over_a_face_it_is_exact_and_its_gradient_is_the_normal() {
    let solid = solid(block(DVec3::splat(-10.0), DVec3::splat(10.0), 1));
    let field = Field::new(&solid, 0.25, 2.0).unwrap();
    let step = step(&field);
    for (k, p) in points(1, 6.0, 1000).enumerate() {
        let p = DVec3::new(p.x, p.y, 10.0 + p.z * 0.33);
        let (distance, gradient) = field.distance(p).unwrap();
        assert!((distance - (p.z - 10.0)).abs() <= 0.5 * step + 1e-12, "{k} {p}");
        assert!(gradient.distance(DVec3::Z) <= 3.0_f64.sqrt() * step / field.cell_mm());
    }
}

#[test]
fn around_a_ball_the_error_is_what_its_radius_says() {
    let radius = 5.0;
    let solid = solid(star(40, |_, _| radius));
    let field = Field::new(&solid, 0.25, 1.0).unwrap();
    let mut largest = 0.0_f64;
    for p in points(3, 6.0, 20_000) {
        let Some((distance, _)) = field.distance(p) else { continue };
        largest = largest.max((distance - solid.closest(p).distance_mm).abs());
    }
    // h² / 8 for each of two curvatures; level sets inside have a radius of 4 at least. A facet with the
    // circumradius ρ, at most half the diagonal of a square of a 40th of the cube's side, lies up to ρ² / 2R
    // within the ball.
    let bound = field.cell_mm().powi(2) / 8.0 * 2.0 / (radius - 1.0);
    let flat = (radius / 20.0).powi(2) / 2.0 / (2.0 * radius);
    assert!(largest < bound + flat + step(&field) && largest > 0.5 * bound, "{largest} {bound} {flat}");
}

#[test]
fn every_node_has_the_exact_distance_whichever_block_it_is_in() {
    let solid = solid(star(3, |d, _| 3.0 + d.x * d.y));
    let field = Field::new(&solid, 0.25, 1.0).unwrap();
    let low = solid.bounds_mm().0 - 1.0;
    let mut seen = 0;
    for k in 0..40 * 40 * 40 {
        let node = DVec3::new((k % 40) as f64, (k / 40 % 40) as f64, (k / 1600) as f64);
        let p = low + node * 0.25;
        let exact = solid.closest(p).distance_mm;
        if let Some((distance, _)) = field.distance(p) {
            assert!((distance - exact).abs() <= 0.5 * step(&field) + 1e-12, "{node} {distance} {exact}");
            seen += 1;
        } else {
            assert!(exact.abs() > 1.0 - 1e-4 || p.cmplt(low).any(), "{node} {exact}");
        }
    }
    assert!(seen > 5000);
}

#[test]
fn beside_a_hole_there_is_no_answer_rather_than_a_wrong_one() {
    let (vertices, triangles) = block(DVec3::splat(-3.0), DVec3::splat(3.0), 6);
    // The last face looks to +z: a square window in it.
    let mesh = TriangleMesh::new(vertices, triangles).unwrap();
    let inside = |t: &[u32; 3]| {
        t.iter().all(|&i| {
            let v = mesh.vertices_mm()[i as usize];
            v.z == 3.0 && v.truncate().abs().max_element() <= 1.0
        })
    };
    let rest: Vec<[u32; 3]> = mesh.triangles().iter().copied().filter(|t| !inside(t)).collect();
    assert_eq!(mesh.triangles().len() - rest.len(), 8);
    let open = solid((mesh.vertices_mm().to_vec(), rest));
    let field = Field::new(&open, 0.25, 1.5).unwrap();
    let mut unknown = 0;
    for p in points(5, 4.4, 20_000) {
        let exact = open.closest(p).distance_mm;
        match field.distance(p) {
            Some((distance, _)) => {
                let bound = 0.75_f64.sqrt() * 0.25 + step(&field);
                assert!((distance.abs() - exact.abs()).abs() <= bound, "{p} {distance} {exact}");
            }
            None if exact.abs() < 1.5 => {
                // Over the window alone.
                assert!(p.z > 1.0 && p.truncate().abs().max_element() < 2.5 || exact.abs() > 1.2, "{p}");
                unknown += 1;
            }
            None => {}
        }
    }
    assert!(unknown > 10);
}

#[test]
fn between_sheets_that_face_one_way_the_sign_jumps_and_the_error_is_bounded() {
    let square = [(-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)];
    for gap in [0.2, 0.45, 0.5, 0.7, 1.0, 1.4] {
        let vertices =
            [0.0, gap].into_iter().flat_map(|z| square.map(|(x, y)| DVec3::new(x, y, z))).collect();
        let sheets = solid((vertices, vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]));
        assert!(!sheets.is_closed());
        let field = Field::new(&sheets, 0.5, 1.0).unwrap();
        // Of two nodes beside each other with different signs one is within half a cell of the surface, and a
        // point within the diagonal from there.
        let bound = (0.5 + 3.0_f64.sqrt()) * 0.5 + 2.0 * step(&field);
        let mut largest = 0.0_f64;
        for p in points(2, 4.0, 4000) {
            let p = p * DVec3::new(1.0, 1.0, 0.3);
            let Some((distance, _)) = field.distance(p) else { continue };
            largest = largest.max((distance.abs() - sheets.closest(p).distance_mm.abs()).abs());
        }
        assert!(largest <= bound, "{gap} {largest}");
    }
}

#[test]
fn a_closed_surface_that_crosses_itself_is_bounded_too() {
    // A block within a block that is closed and inside out: found by fuzzing, as only surfaces with holes
    // were looked through.
    let (mut vertices, mut triangles) = block(DVec3::splat(-3.0), DVec3::splat(3.0), 2);
    let (inner, same_way) = block(DVec3::new(-2.0, -2.0, 0.0), DVec3::new(2.0, 2.0, 1.2), 2);
    let first = vertices.len() as u32;
    vertices.extend(inner);
    triangles.extend(same_way.iter().map(|t| t.map(|i| first + i)));
    let solid = solid((vertices, triangles));
    assert!(solid.is_closed());
    let field = Field::new(&solid, 0.25, 1.0).unwrap();
    let bound = (0.5 + 3.0_f64.sqrt()) * 0.25 + 2.0 * step(&field);
    for p in points(7, 4.0, 20_000) {
        let Some((distance, _)) = field.distance(p) else { continue };
        assert!((distance.abs() - solid.closest(p).distance_mm.abs()).abs() <= bound, "{p}");
    }
}

#[test]
fn too_fine_a_grid_gets_wider_cells_and_senseless_ones_are_refused() {
    let solid = solid(block(DVec3::ZERO, DVec3::new(200.0, 200.0, 200.0), 1));
    let field = Field::new(&solid, 0.5, 1.0).unwrap();
    assert!(field.cell_mm() > 0.5 && field.bytes() < 5_000_000, "{}", field.cell_mm());
    assert!((field.distance(DVec3::new(100.0, 100.0, 200.5)).unwrap().0 - 0.5).abs() < 1e-3);
    for (cell, reach) in [(0.0, 1.0), (-1.0, 1.0), (1.0, 1.0), (1e-4, 1.0), (f64::NAN, 1.0), (1.0, f64::NAN)]
    {
        assert_eq!(Field::new(&solid, cell, reach), None);
    }
    for x in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1e300, -1e300] {
        assert_eq!(field.distance(DVec3::splat(x)), None);
    }
}
