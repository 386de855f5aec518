//! What registration is built of, where it is hardest: Gaussian sums, nearest neighbours, the template.
//!
//! Constants come from mpmath with 50 digits, rounded once.
// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use crate::contact_patch;

use contact_patch::Shape;
use gelstereo_core::math::DVec3;
use gelstereo_core::math::random::Stream;
use gelstereo_core::register::{Template, TemplateError, soft_match};
use gelstereo_core::spatial::KdTree;
use proptest::prelude::*;

const EPS: f64 = f64::EPSILON;

fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-limit..limit).prop_map(DVec3::from_array)
}

// Rows 7 and 8: Gaussian sums.

/// Points along x with normals along z.
fn along_x(x: &[f64]) -> Template {
    let points: Vec<DVec3> = x.iter().map(|&x| DVec3::new(x, 0.0, 0.0)).collect();
    Template::new(&points, &vec![DVec3::Z; x.len()], 0.1).unwrap()
}

#[test]
fn row_07_weights_that_all_underflow_keep_their_ratios() {
    // σ 0.02, distances 1, 1.001 and 1.3: every exp(-d²/2σ²) is below 1e-542.
    let soft = soft_match(&along_x(&[1.0, 1.001, 1.3]), DVec3::ZERO, 0.02);
    // d²/2σ² = 1250 is rounded by eps/2, and so are both squares: 3 eps of it in the exponent.
    assert!((soft.log_mass + 1249.9212050336832).abs() <= 3.0 * EPS * 1250.0);
    assert!((soft.offset_mm.x - 1.0000757705968215).abs() <= 4.0 * EPS * 1250.0 * 1e-3 + EPS);
    assert!((soft.spread_mm2 / 7.002941347888961e-08 - 1.0).abs() <= 8.0 * EPS * 1250.0);
}

#[test]
fn row_08_a_vanishing_width_sees_the_nearest_point_alone() {
    // The last one's square is 0.
    for sigma in [1e-2, 1e-4, 1e-8, 1e-12, 1e-170] {
        let soft = soft_match(&along_x(&[1.0, 2.0, 1.5]), DVec3::new(0.7, 0.0, 0.0), sigma);
        assert_eq!((soft.nearest, soft.spread_mm2), (0, 0.0), "{sigma}");
        assert!((soft.offset_mm.x - 0.3).abs() <= EPS);
        // Found by the fuzz target `points`: on a point, 0 over the square of a width that has none.
        let on = soft_match(&along_x(&[1.0, 2.0, 1.5]), DVec3::X, sigma);
        assert_eq!((on.log_mass, on.offset_mm, on.distance_mm), (0.0, DVec3::ZERO, 0.0), "{sigma}");
    }
}

proptest! {
    #[test]
    fn row_08_the_spread_is_never_negative_and_moves_with_the_offset(
        points in prop::collection::vec(vector(1e-3), 3..40), offset in vector(1e6), power in -4.0..1.0_f64,
    ) {
        let sigma = 10.0_f64.powf(power);
        let normals = vec![DVec3::Z; points.len()];
        let make = |offset: DVec3| {
            let moved: Vec<DVec3> = points.iter().map(|&p| p + offset).collect();
            let moved: Vec<DVec3> = moved.into_iter().collect();
            Template::new(&moved, &normals, 1e-4)
        };
        let (Ok(here), Ok(there)) = (make(DVec3::ZERO), make(offset)) else { return Ok(()) };
        let (a, b) = (soft_match(&here, DVec3::ZERO, sigma), soft_match(&there, offset, sigma));
        prop_assert!(a.spread_mm2 >= 0.0 && b.spread_mm2 >= 0.0);
        // Coordinates moved to 1e6 mm are rounded by eps/2 1e6 = 1.1e-10 each; distances of 1e-3 carry that
        // over, and a weight changes by d δ / σ² of itself.
        let rounding = 2.0 * EPS * 1e6;
        let gain = 1.0 + 4e-6 / (sigma * sigma);
        prop_assert!((a.offset_mm - b.offset_mm).length() <= 8.0 * rounding * gain);
        prop_assert!((a.spread_mm2 - b.spread_mm2).abs() <= 8.0 * rounding * 2e-3 * gain);
    }
}

#[test]
fn row_08_the_cut_off_changes_nothing() {
    let template = Shape::Sphere { radius_mm: 5.0 }.template(0.4);
    let mut random = Stream::new(1, "cut-off");
    for sigma in [0.2, 0.7] {
        let x = DVec3::new(random.normal(), random.normal(), 4.8);
        let soft = soft_match(&template, x, sigma);
        let weights: Vec<f64> = template
            .points_mm()
            .iter()
            .map(|y| (-0.5 * y.distance_squared(x) / (sigma * sigma)).exp())
            .collect();
        let mass: f64 = weights.iter().sum();
        let mean: DVec3 = weights.iter().zip(template.points_mm()).map(|(&w, &y)| (y - x) * (w / mass)).sum();
        // Plain sums of 1963 terms and West's update both err by a few times √N roundings.
        assert!((soft.log_mass - mass.ln()).abs() < 100.0 * EPS);
        assert!((soft.offset_mm - mean).length() < 100.0 * EPS);
        let over = |of: &dyn Fn(DVec3, DVec3) -> f64| -> f64 {
            let each = template.points_mm().iter().zip(template.normals()).zip(&weights);
            each.map(|((&y, &n), w)| of(y - x, n) * (w / mass)).sum()
        };
        let spread = over(&|y, _| y.distance_squared(mean));
        assert!((soft.spread_mm2 - spread).abs() < 100.0 * EPS * (spread + mean.length_squared()));
        assert!((soft.plane_distance_mm - over(&|y, n| n.dot(y))).abs() < 100.0 * EPS);
        let normal: DVec3 = template.normals().iter().zip(&weights).map(|(&n, &w)| n * (w / mass)).sum();
        assert!(soft.normal.distance(normal.normalize()) < 100.0 * EPS);
        let (nearest, squared) = brute_force(template.points_mm(), x);
        assert_eq!((soft.nearest, soft.distance_mm), (nearest, squared.sqrt()));
    }
}

/// Between the faces of a thin plate normals cancel, and the nearest one is taken.
#[test]
fn row_08_normals_that_cancel_leave_the_nearest() {
    let faces = [DVec3::ZERO, DVec3::Z * 0.5, DVec3::X * 9.0];
    let template = Template::new(&faces, &[-DVec3::Z, DVec3::Z, DVec3::X], 0.1).unwrap();
    assert_eq!(soft_match(&template, DVec3::Z * 0.25, 1.0).normal, -DVec3::Z);
}

// Row 12: the tree.

fn brute_force(points: &[DVec3], query: DVec3) -> (usize, f64) {
    let mut best = (0, f64::INFINITY);
    for (index, p) in points.iter().enumerate() {
        let distance_squared = query.distance_squared(*p);
        if distance_squared < best.1 {
            best = (index, distance_squared);
        }
    }
    best
}

/// Lattices, duplicates, planes, lines and denormal distances.
fn awkward_points() -> impl Strategy<Value = Vec<DVec3>> {
    let coordinate = prop_oneof![
        (-4_i32..4).prop_map(f64::from),
        -1.0..1.0_f64,
        Just(0.0),
        Just(-0.0),
        Just(5e-324),
        Just(-1e-310),
        Just(1e9),
    ];
    prop::collection::vec(prop::array::uniform3(coordinate).prop_map(DVec3::from_array), 1..300)
}

proptest! {
    #[test]
    fn row_12_the_tree_agrees_with_brute_force(
        points in awkward_points(), queries in awkward_points(),
        squared in prop_oneof![(0..10_u8).prop_map(f64::from), 0.0..9.0_f64],
    ) {
        let tree = KdTree::new(&points);
        for &query in queries.iter().take(40) {
            prop_assert_eq!(tree.nearest(query), Some(brute_force(&points, query)));
            let mut found = Vec::new();
            tree.within(query, squared, &mut |k, _| found.push(k));
            found.sort_unstable();
            let inside = |k: &usize| query.distance_squared(points[*k]) <= squared;
            prop_assert_eq!(found, (0..points.len()).filter(inside).collect::<Vec<_>>());
        }
    }
}

#[test]
fn row_12_thousands_of_duplicates_and_a_flat_face() {
    let duplicates = vec![DVec3::new(1.0, 2.0, 3.0); 5000];
    assert_eq!(KdTree::new(&duplicates).nearest(DVec3::ZERO), Some((0, 14.0)));
    let face: Vec<DVec3> =
        (0..10_000).map(|k| DVec3::new(f64::from(k % 100), f64::from(k / 100), 0.0)).collect();
    let tree = KdTree::new(&face);
    // Four corners of a cell tie; the lowest index wins.
    assert_eq!(tree.nearest(DVec3::new(10.5, 20.5, 1.0)), Some((2010, 1.5)));
    assert_eq!(KdTree::new(&[]).nearest(DVec3::ZERO), None);
}

// The template.

#[test]
fn templates_without_meaning_are_refused() {
    let p = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::ONE];
    let n = [DVec3::Z; 4];
    let refused =
        |p: &[DVec3], n: &[DVec3], spacing: f64| Template::new(p, n, spacing).map(|_| ()).unwrap_err();
    assert_eq!(refused(&p[..2], &n[..2], 0.1), TemplateError::TooFew { found: 2, min_points: 3 });
    assert_eq!(refused(&p, &n[..3], 0.1), TemplateError::Lengths { points: 4, normals: 3 });
    assert_eq!(refused(&[DVec3::NAN; 3], &n[..3], 0.1), TemplateError::NotFinite { index: 0 });
    assert_eq!(
        refused(&p, &[DVec3::Z, DVec3::ZERO, DVec3::Z, DVec3::Z], 0.1),
        TemplateError::ZeroNormal { index: 1 }
    );
    for spacing in [0.0, -1.0, f64::NAN, f64::INFINITY, 2.0, 1e-9] {
        assert!(matches!(refused(&p, &n, spacing), TemplateError::Spacing { .. }), "{spacing}");
    }
    let mesh = contact_patch::cuboid(DVec3::ONE);
    let sampled = |spacing: f64| Template::from_mesh(&mesh, spacing, 1).map(|_| ()).unwrap_err();
    assert!(matches!(sampled(10.0), TemplateError::TooFew { .. }));
    assert!(matches!(sampled(1e-3), TemplateError::TooMany { .. }));
    assert!(matches!(sampled(f64::NAN), TemplateError::Spacing { .. }));
}

#[test]
fn meshes_are_sampled_evenly_and_repeatably() {
    let mesh = contact_patch::cuboid(DVec3::new(3.0, 4.0, 5.0));
    let template = Template::from_mesh(&mesh, 0.3, 1).unwrap();
    let area = 8.0 * (3.0 * 4.0 + 4.0 * 5.0 + 5.0 * 3.0);
    let expected = area / 0.09;
    // The cover of random discs is known to a per cent; edges, where faces do not see each other, add their
    // share.
    assert!((template.points_mm().len() as f64 / expected - 1.0).abs() < 0.05);
    for (k, (p, n)) in template.points_mm().iter().zip(template.normals()).enumerate() {
        let mut closest = f64::INFINITY;
        template.tree().within(*p, 0.09, &mut |j, d| {
            if j != k && template.normals()[j].dot(*n) > 0.5 {
                closest = closest.min(d);
            }
        });
        assert!(closest.sqrt() >= 0.81 * 0.3 - 1e-12);
        assert!((p.abs() / DVec3::new(3.0, 4.0, 5.0)).max_element() > 1.0 - 1e-12);
        assert!((n.length() - 1.0).abs() < 4.0 * EPS);
    }
    assert_eq!(template.digest(), Template::from_mesh(&mesh, 0.3, 1).unwrap().digest());
    assert_ne!(template.digest(), Template::from_mesh(&mesh, 0.3, 2).unwrap().digest());
}

#[test]
fn a_template_of_a_mesh_keeps_its_exact_surface() {
    let mesh = contact_patch::cuboid(DVec3::new(3.0, 4.0, 5.0));
    let template = Template::from_mesh(&mesh, 0.3, 1).unwrap();
    let solid = template.solid().unwrap();
    assert!(solid.is_closed());
    for (&p, &n) in template.points_mm().iter().zip(template.normals()) {
        let found = solid.closest(p + n * 0.125);
        assert!((found.distance_mm - 0.125).abs() < 16.0 * EPS && found.normal.distance(n) < 4.0 * EPS);
    }
    let points = Template::new(template.points_mm(), template.normals(), 0.3).unwrap();
    assert!(points.solid().is_none());
    assert_ne!(points.digest(), template.digest());
}

#[test]
fn a_template_of_a_mesh_keeps_distances_on_a_grid_and_others_if_it_is_asked_to() {
    let mesh = contact_patch::cuboid(DVec3::new(3.0, 4.0, 5.0));
    let whole = Template::from_mesh(&mesh, 0.3, 1).unwrap();
    let field = whole.field().unwrap();
    assert_eq!((field.cell_mm(), field.reach_mm()), (Template::DEFAULT_CELL_MM, Template::DEFAULT_REACH_MM));
    let bare = whole.clone().without_field();
    let template = bare.clone().with_field(0.25, 1.0);
    let (distance_mm, gradient) = template.field().unwrap().distance(DVec3::new(3.5, 1.0, 1.0)).unwrap();
    assert!((distance_mm - 0.5).abs() < 1e-4 && gradient.distance(DVec3::X) < 1e-3);
    assert!(bare.field().is_none() && bare.clone().with_field(0.0, 1.0).field().is_none());
    assert!(bare.digest() != template.digest() && whole.digest() != template.digest());
    // Numbers that make no grid leave the one there was.
    assert_eq!(whole.clone().with_field(0.0, 1.0).field(), whole.field());
}
