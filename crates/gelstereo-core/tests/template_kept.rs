//! Templates as bytes and back, and the symmetries that are kept with them.
// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use crate::solids;

use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::register::{Symmetry, Template, TemplateBytesError};
use gelstereo_core::surface::TriangleMesh;
use proptest::prelude::*;
use solids::{block, star};
use std::collections::BTreeSet;

const TOLERANCE_MM: f64 = 0.02;

fn template((vertices, triangles): (Vec<DVec3>, Vec<[u32; 3]>)) -> Template {
    Template::from_mesh(&TriangleMesh::new(vertices, triangles).unwrap(), 0.4, 1).unwrap()
}

/// An upright prism over a polygon with corners at radius(k) and even angles.
fn prism(corners: usize, half_height: f64, radius: impl Fn(usize) -> f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let n = corners as u32;
    let mut vertices = vec![DVec3::Z * -half_height, DVec3::Z * half_height];
    for z in [-half_height, half_height] {
        for k in 0..corners {
            let (s, c) = (core::f64::consts::TAU * k as f64 / corners as f64).sin_cos();
            vertices.push(DVec3::new(radius(k) * c, radius(k) * s, z));
        }
    }
    let mut triangles = Vec::new();
    for k in 0..n {
        let (a, b) = (2 + k, 2 + (k + 1) % n);
        triangles.extend([[0, b, a], [1, a + n, b + n], [a, b, b + n], [a, b + n, a + n]]);
    }
    (vertices, triangles)
}

fn moved((vertices, triangles): (Vec<DVec3>, Vec<[u32; 3]>), pose: &Pose) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    (vertices.into_iter().map(|v| pose.transform_point(v)).collect(), triangles)
}

fn orders(template: &Template) -> Vec<Option<u32>> {
    template.find_symmetries(TOLERANCE_MM).iter().map(|s| s.order).collect()
}

#[test]
fn bytes_give_the_same_template_back() {
    let whole = template(block(DVec3::ZERO, DVec3::new(3.0, 4.0, 5.0), 3)).with_field(0.3, 1.0);
    let symmetries = whole.find_symmetries(TOLERANCE_MM);
    assert_eq!(symmetries.len(), 3);
    let whole = whole.with_symmetries(symmetries);
    let points = Template::new(whole.points_mm(), whole.normals(), 0.4).unwrap();
    for template in [whole, points] {
        let bytes = template.to_bytes();
        let again = Template::from_bytes(&bytes).unwrap();
        assert_eq!(again.digest(), template.digest());
        assert_eq!(again.to_bytes(), bytes);
        assert_eq!(again.field(), template.field());
        assert_eq!(again.symmetries(), template.symmetries());
        assert_eq!(again.curvatures_per_mm(), template.curvatures_per_mm());
        let p = DVec3::new(1.1, 5.0, 2.2);
        assert_eq!(again.solid().map(|s| s.closest(p)), template.solid().map(|s| s.closest(p)));
        assert_eq!(again.solid().map(|s| *s.report()), template.solid().map(|s| *s.report()));
    }
}

/// Registration answers with the copy that is nearest to the guess, so they are part of what a template is.
#[test]
fn templates_of_other_symmetries_have_other_digests() {
    let plain = template(block(DVec3::splat(-1.0), DVec3::ONE, 1));
    let of =
        |axis: DVec3, centre_mm: DVec3, order: Option<u32>| Symmetry::new(axis, centre_mm, order).unwrap();
    let half = of(DVec3::Z, DVec3::ZERO, Some(2));
    let said = [
        vec![],
        vec![half],
        vec![of(DVec3::Z, DVec3::ZERO, Some(4))],
        vec![of(DVec3::Z, DVec3::ZERO, None)],
        vec![of(DVec3::X, DVec3::ZERO, Some(2))],
        vec![of(DVec3::Z, DVec3::X, Some(2))],
        vec![half, of(DVec3::X, DVec3::ZERO, Some(2))],
    ];
    let templates = said.map(|symmetries| plain.clone().with_symmetries(symmetries));
    let digests: BTreeSet<u64> = templates.iter().map(Template::digest).collect();
    assert_eq!(digests.len(), templates.len());
    for template in templates {
        assert_eq!(Template::from_bytes(&template.to_bytes()).unwrap().digest(), template.digest());
    }
}

/// A part so large that its grid has to be coarser than was asked for, by more than its reach allows.
#[test]
fn the_bytes_of_a_large_part_give_its_grid_back() {
    let large = block(DVec3::ZERO, DVec3::new(900.0, 800.0, 700.0), 1);
    let large = Template::from_mesh(&TriangleMesh::new(large.0, large.1).unwrap(), 20.0, 1).unwrap();
    let field = large.field().unwrap();
    assert!(field.cell_mm() > 0.5 * Template::DEFAULT_REACH_MM && field.reach_mm() >= 2.0 * field.cell_mm());
    let again = Template::from_bytes(&large.to_bytes()).unwrap();
    assert_eq!(again.field(), large.field());
    assert_eq!(again.digest(), large.digest());
}

#[test]
fn damage_is_seen_wherever_it_is() {
    let bytes = template(block(DVec3::ZERO, DVec3::ONE, 1)).to_bytes();
    for end in 0..bytes.len() {
        assert!(Template::from_bytes(&bytes[..end]).is_err(), "cut off at {end}");
    }
    for k in 0..bytes.len() {
        let mut changed = bytes.clone();
        changed[k] ^= 1 << (k % 8);
        let error = Template::from_bytes(&changed).map(|_| ()).unwrap_err();
        match k {
            0..8 => assert_eq!(error, TemplateBytesError::NotATemplate),
            8..12 => assert!(matches!(error, TemplateBytesError::Version { .. })),
            _ => assert!(matches!(error, TemplateBytesError::Damaged { .. }), "{k}: {error}"),
        }
    }
    assert_eq!(Template::from_bytes(b"").map(|_| ()), Err(TemplateBytesError::NotATemplate));
}

/// With other bytes at a place, and the digest of that.
fn forged(mut bytes: Vec<u8>, at: usize, other: &[u8]) -> Vec<u8> {
    bytes[at..at + other.len()].copy_from_slice(other);
    let end = bytes.len() - 8;
    let digest = gelstereo_core::digest::Digest::new().bytes(&bytes[..end]).value();
    bytes[end..].copy_from_slice(&digest.to_le_bytes());
    bytes
}

/// Found by the fuzz target `registers`.
#[test]
fn forged_flags_grids_and_axes_are_refused() {
    let cube = template(block(DVec3::splat(-1.0), DVec3::ONE, 1));
    let quarter = Symmetry::new(DVec3::Z, DVec3::ZERO, Some(4)).unwrap();
    let bytes = cube.with_symmetries(vec![quarter]).to_bytes();
    assert!(Template::from_bytes(&forged(bytes.clone(), 12, &3_u32.to_le_bytes())).is_ok());
    // Before the digest: axis, centre and order of one symmetry, their number, and the grid's two.
    let end = bytes.len() - 8;
    let (order, axis, grid) = (end - 4, end - 52, end - 76);
    let cases: [(usize, &[u8]); 9] = [
        (12, &7_u32.to_le_bytes()),
        (12, &2_u32.to_le_bytes()),
        (12, &8_u32.to_le_bytes()),
        (order, &1_u32.to_le_bytes()),
        (axis, &f64::NAN.to_le_bytes()),
        (axis + 16, &1.5_f64.to_le_bytes()),
        (axis + 24, &f64::INFINITY.to_le_bytes()),
        (grid, &f64::NAN.to_le_bytes()),
        (grid, &1e-3_f64.to_le_bytes()),
    ];
    for (at, other) in cases {
        let found = Template::from_bytes(&forged(bytes.clone(), at, other)).map(|_| ());
        assert!(matches!(found, Err(TemplateBytesError::Damaged { .. })), "{at}: {found:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whole by its digest, and yet nonsense: counts that are not there, points, grids and axes that are
    /// none.
    #[test]
    fn forged_bytes_are_refused_or_a_template(
        back in 16_usize..1200,
        value in prop_oneof![any::<u64>(), any::<f64>().prop_map(f64::to_bits), 0..40_u64],
    ) {
        let made = template(block(DVec3::ZERO, DVec3::ONE, 1));
        let symmetries = made.find_symmetries(TOLERANCE_MM);
        let bytes = made.with_symmetries(symmetries).to_bytes();
        let at = bytes.len().saturating_sub(back).max(12);
        let bytes = forged(bytes, at, &value.to_le_bytes());
        if let Ok(template) = Template::from_bytes(&bytes) {
            prop_assert!(template.points_mm().iter().all(|p| p.is_finite()));
            prop_assert!(template.normals().iter().all(|n| (n.length() - 1.0).abs() < 1e-8));
            prop_assert!(template
                .symmetries()
                .iter()
                .all(|s| (s.axis.length() - 1.0).abs() < 1e-8 && s.order != Some(1)));
            // Places that were made one are one from then on.
            let kept = template.to_bytes();
            prop_assert!(Template::from_bytes(&kept).is_ok_and(|again| again.to_bytes() == kept));
        }
    }

    #[test]
    fn a_prism_has_the_axes_of_its_polygon_wherever_it_stands(
        n in 3_usize..12, omega in prop::array::uniform3(-3.0..3.0),
        shift in prop::array::uniform3(-50.0..50.0),
    ) {
        let pose = Pose::exp(DVec3::from_array(omega), DVec3::from_array(shift));
        let template = template(moved(prism(n, 7.0, |_| 5.0), &pose));
        let found = template.find_symmetries(TOLERANCE_MM);
        // Around itself, and over every corner or side.
        prop_assert_eq!(found.len(), if n == 4 { 5 } else { n + 1 }, "{:?}", found);
        prop_assert_eq!(found[0].order, Some(n as u32));
        prop_assert!(found[1..].iter().all(|s| s.order == Some(2)));
        prop_assert!(found[0].axis.dot(pose.transform_vector(DVec3::Z)).abs() > 1.0 - 1e-12);
        let middle = pose.translation_mm;
        for symmetry in &found {
            prop_assert!(symmetry.centre_mm.distance(middle) < 1e-9);
        }
    }
}

#[test]
fn axes_are_those_of_the_shape() {
    let cube = orders(&template(block(DVec3::splat(-3.0), DVec3::splat(3.0), 1)));
    let count = |n: u32| cube.iter().filter(|&&order| order == Some(n)).count();
    assert_eq!((count(4), count(3), count(2), cube.len()), (3, 4, 6, 13));
    let cuboid = orders(&template(block(DVec3::ZERO, DVec3::new(3.0, 4.0, 5.0), 2)));
    assert_eq!(cuboid, [Some(2); 3]);
    // 128 facets of a radius of 5 mm are 0.0015 mm deep, 16 are 0.096.
    let round = template(prism(128, 7.0, |_| 5.0)).find_symmetries(TOLERANCE_MM);
    assert_eq!(round.iter().map(|s| s.order).collect::<Vec<_>>(), [None, Some(2)]);
    assert!(round[0].axis.distance(DVec3::Z) < 1e-9 && round[1].axis.z.abs() < 1e-9);
    assert_eq!(orders(&template(prism(16, 7.0, |_| 5.0)))[0], Some(16));
    // 17 turns bring the corners of these to within 0.018 mm of a face once, 8 of them do not; nor do 29 of
    // 24.
    assert_eq!(orders(&template(prism(16, 7.0, |_| 4.0)))[0], Some(16));
    assert_eq!(orders(&template(prism(24, 7.0, |_| 4.0)))[0], Some(24));
    // 34 facets of 0.043 mm, which turns by the golden section seldom meet.
    assert_eq!(orders(&template(prism(34, 7.0, |_| 10.0)))[0], Some(34));
    // A ball, and a lump without any.
    assert_eq!(orders(&template(star(24, |_, _| 5.0))), [None; 3]);
    assert_eq!(orders(&template(star(3, |d, _| 4.0 + d.x + 0.7 * d.y * d.z + 0.5 * d.z))), []);
    // A keyway in a shaft leaves one of its sides up.
    assert_eq!(orders(&template(prism(128, 7.0, |k| if k < 8 { 4.0 } else { 5.0 }))).len(), 1);
    // A gear of twenty teeth.
    assert_eq!(orders(&template(prism(80, 3.0, |k| if k / 2 % 2 == 0 { 8.0 } else { 7.0 })))[0], Some(20));
}

#[test]
fn a_turn_leaves_the_axis_where_it_is() {
    let axis = Symmetry::new(DVec3::new(0.0, 3.0, 4.0), DVec3::new(1.0, 2.0, 3.0), Some(3)).unwrap();
    let turn = axis.turned(1.0);
    let on = axis.centre_mm + axis.axis * 7.0;
    assert!(turn.transform_point(on).distance(on) < 1e-14);
    assert!((axis.axis.length() - 1.0).abs() < 1e-15);
    assert_eq!(Symmetry::new(DVec3::ZERO, DVec3::ZERO, None), None);
    assert_eq!(Symmetry::new(DVec3::X, DVec3::ZERO, Some(1)), None);
    assert_eq!(Symmetry::new(DVec3::X, DVec3::NAN, Some(2)), None);
}
