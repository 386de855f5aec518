//! Solids: their closed forms, their triangles, and how the two agree.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, rigid, simulator};
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::surface::{TriangleMesh, area_vector};
use gelstereo_sim::shapes::BOARD_THICKNESS_MM;
use gelstereo_sim::{ContactState, Scene, Shape, Simulator, Truth};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::PI;

const SPHERE: Shape = Shape::Sphere { radius_mm: 4.0 };
const CYLINDER: Shape = Shape::Cylinder { radius_mm: 2.5, length_mm: 14.0 };
const BOX: Shape = Shape::Box { size_mm: [3.0, 7.0, 11.0] };
const BOARD: Shape = Shape::Board { size_mm: [18.0, 16.0], block_mm: [6.0, 4.0], protrusion_mm: 1.4 };

/// A solid that lies within the mesh of `shape`, and one that contains it. The meshes are inscribed, so
/// curved radii shrink by the tolerance; the 1e-9 decides for lines that graze an edge.
fn bracket(shape: &Shape, tolerance: f64) -> [Shape; 2] {
    let of = |curved: f64, flat: f64| match shape {
        Shape::Sphere { radius_mm } => Shape::Sphere { radius_mm: radius_mm + curved },
        Shape::Cylinder { radius_mm, length_mm } => {
            Shape::Cylinder { radius_mm: radius_mm + curved, length_mm: length_mm + flat }
        }
        Shape::Box { size_mm } => Shape::Box { size_mm: size_mm.map(|s| s + flat) },
        Shape::Board { size_mm, block_mm, protrusion_mm } => Shape::Board {
            size_mm: size_mm.map(|s| s + flat),
            block_mm: block_mm.map(|s| s + flat),
            protrusion_mm: protrusion_mm + flat,
        },
        Shape::Mesh { .. } => shape.clone(),
    };
    [of(-tolerance - 1e-9, -1e-9), of(1e-9, 1e-9)]
}

fn heights(scene: &Scene, mesh: Option<&TriangleMesh>, contact: &ContactState) -> Vec<f64> {
    let mut truth = Truth::default();
    Simulator::new(scene, mesh).unwrap().truth(Some(contact), &mut truth);
    truth.indentation_mm
}

fn as_file() -> Scene {
    rigid(Shape::Mesh { path: "part.stl".into(), units: "mm".into() })
}

fn any_solid() -> impl Strategy<Value = Shape> {
    prop_oneof![Just(SPHERE), Just(CYLINDER), Just(BOX), Just(BOARD)]
}

fn any_turn() -> impl Strategy<Value = DVec3> {
    [-3.0..3.0, -3.0..3.0, -3.0..3.0_f64].prop_map(DVec3::from_array)
}

fn any_offset() -> impl Strategy<Value = DVec2> {
    [-6.0..6.0, -6.0..6.0_f64].prop_map(DVec2::from_array)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn closed_form_agrees_with_the_shapes_own_mesh(
        shape in any_solid(), turn in any_turn(), offset in any_offset(), depth in 0.1..4.0,
    ) {
        let tolerance = 0.01;
        let mesh = shape.mesh(tolerance).unwrap();
        let contact = press(&rigid(shape.clone()), turn, offset, depth);
        let found = heights(&as_file(), Some(&mesh), &contact);
        let [inner, outer] = bracket(&shape, tolerance).map(|s| heights(&rigid(s), None, &contact));
        // A board's corner may come down beside the lattice.
        prop_assume!(outer.iter().any(|&h| h > 0.0));
        for i in 0..found.len() {
            prop_assert!(
                inner[i] - 1e-9 <= found[i] && found[i] <= outer[i] + 1e-9,
                "marker {}: {} is not within {} to {}", i, found[i], inner[i], outer[i]
            );
        }
    }

    #[test]
    fn pressed_reaches_the_depth_that_was_asked_for(
        shape in any_solid(), turn in any_turn(), offset in any_offset(), depth in 0.0..4.0,
    ) {
        let scene = rigid(shape.clone());
        let pose = press(&scene, turn, offset, depth).t_sensor_object;
        // Inscribed triangles end at most the tolerance before the solid does.
        let mesh = shape.mesh(1e-3).unwrap();
        let nearest =
            mesh.vertices_mm().iter().map(|&v| pose.transform_point(v).z).fold(f64::INFINITY, f64::min);
        let reached = scene.gel.surface_mm - nearest;
        prop_assert!((depth - 1e-3 - 1e-9..=depth + 1e-9).contains(&reached), "{reached} for {depth}");
        let again = Simulator::new(&as_file(), Some(&mesh)).unwrap().pressed(pose, reached).unwrap();
        prop_assert!((again.translation_mm - pose.translation_mm).length() < 1e-9);
    }
}

#[test]
fn meshes_are_watertight_and_face_outwards() {
    let board = 18.0 * 16.0 * BOARD_THICKNESS_MM + 6.0 * 4.0 * 1.4;
    let volumes =
        [(SPHERE, 4.0 / 3.0 * PI * 64.0), (CYLINDER, PI * 6.25 * 14.0), (BOX, 231.0), (BOARD, board)];
    for (shape, volume) in volumes {
        let mesh = shape.mesh(1e-3).unwrap();
        let mut edges = BTreeMap::new();
        for [a, b, c] in mesh.triangles().iter().copied() {
            for edge in [(a, b), (b, c), (c, a)] {
                *edges.entry(edge).or_insert(0) += 1;
            }
        }
        let closed = edges.iter().all(|(&(a, b), &count)| count == 1 && edges.get(&(b, a)) == Some(&1));
        assert!(closed, "{shape:?} has an edge without exactly one neighbour");
        // Divergence theorem; a shell of the tolerance is missing at most.
        let found: f64 = mesh.corners().map(|c| c[0].dot(area_vector(&c)) / 3.0).sum();
        let area: f64 = mesh.corners().map(|c| area_vector(&c).length()).sum();
        assert!(found <= volume + 1e-9 && found >= volume - 1.01e-3 * area, "{shape:?}: {found} of {volume}");
    }
}

#[test]
fn a_cylinder_stands_on_its_end_without_a_slope_to_divide_by() {
    let scene = rigid(CYLINDER);
    let contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 1.0);
    let inside = |&h: &&f64| (h - 1.0).abs() < 1e-12;
    let touched = common::truth(&scene, Some(&contact)).indentation_mm;
    // Lattice points at 0.9 mm within a circle of 2.5 mm: |(i, j)|² <= 7.7.
    assert_eq!(touched.iter().filter(inside).count(), 21);
    assert!(touched.iter().all(|h| *h == 0.0 || inside(&h)));
}

#[test]
fn dimensions_that_make_no_solid_are_refused() {
    let bad = [
        Shape::Sphere { radius_mm: 0.0 },
        Shape::Sphere { radius_mm: f64::NAN },
        Shape::Cylinder { radius_mm: 1.0, length_mm: f64::INFINITY },
        Shape::Box { size_mm: [1.0, -1.0, 1.0] },
        Shape::Board { size_mm: [5.0, 5.0], block_mm: [5.0, 1.0], protrusion_mm: 1.0 },
    ];
    for shape in bad {
        assert!(shape.validate().is_err(), "{shape:?}");
        assert!(shape.mesh(0.01).is_none(), "{shape:?}");
    }
    // A tolerance of nothing is as fine as it gets, not endless.
    assert!(SPHERE.mesh(0.0).unwrap().triangles().len() < 300_000);
    assert!(simulator(&rigid(SPHERE)).frames() == 1);
}
