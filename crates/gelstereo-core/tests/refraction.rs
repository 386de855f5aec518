//! Light through flat layers against Snell's law in its vector form, and the limits in which the answer is
//! known.
#![allow(clippy::unwrap_used)]

use gelstereo_core::camera::{Camera, CameraError, Layer, Layers, Ray};
use gelstereo_core::math::{DVec2, DVec3, Pose, so3, sqrt};
use gelstereo_core::rig::{Rig, RigError, View};
use proptest::prelude::*;

const EPS: f64 = f64::EPSILON;

fn camera() -> Camera {
    let (fx_px, fy_px, cx_px, cy_px) = (600.0, 600.0, 319.5, 239.5);
    Camera {
        width_px: 640,
        height_px: 480,
        fx_px,
        fy_px,
        cx_px,
        cy_px,
        distortion: [-0.1, 0.02, 0.001, -0.001, 0.0],
    }
}

/// 20 mm of air, 3 mm of acrylic, then gel.
fn acrylic_and_gel(normal: DVec3) -> Layers {
    let plates = vec![Layer { thickness_mm: 3.0, index: 1.49 }];
    Layers { normal: normal.normalize(), gap_mm: 20.0, plates, gel_index: 1.41 }
}

fn rig(layers: Option<Layers>) -> Rig {
    let rotation = so3::exp(DVec3::new(0.01, -0.08, 0.02));
    let t_right_left = Pose { rotation, translation_mm: DVec3::new(-10.0, 0.1, -0.2) };
    Rig { left: camera(), right: camera(), t_right_left, layers }
}

/// Parallel cameras without distortion.
fn plain(layers: Option<Layers>) -> Rig {
    Rig { layers, ..Rig::parallel(Camera { distortion: [0.0; 5], ..camera() }, 10.0) }
}

/// Snell's law for unit vectors: the part along the interface is scaled by n1 / n2. `None` is total
/// reflection.
fn snell(direction: DVec3, normal: DVec3, n1: f64, n2: f64) -> Option<DVec3> {
    let along = (direction - normal * normal.dot(direction)) * (n1 / n2);
    let ahead2 = 1.0 - along.length_squared();
    (ahead2 > 0.0).then(|| along + normal * sqrt(ahead2))
}

/// Follows a ray from a camera through the layers, interface by interface.
fn follow(centre: DVec3, direction: DVec3, layers: &Layers) -> Ray {
    let n = layers.normal;
    let (mut at, mut direction, mut index) = (centre, direction.normalize(), 1.0);
    let mut interface = layers.gap_mm;
    let media = layers.plates.iter().map(|p| (p.thickness_mm, p.index)).chain([(0.0, layers.gel_index)]);
    for (thickness, next) in media {
        at += direction * ((interface - n.dot(at)) / n.dot(direction));
        direction = snell(direction, n, index, next).unwrap();
        index = next;
        interface += thickness;
    }
    Ray { origin_mm: at, direction }
}

fn normals() -> impl Strategy<Value = DVec3> {
    (-0.3..0.3_f64, -0.3..0.3_f64).prop_map(|(x, y)| DVec3::new(x, y, 1.0).normalize())
}

fn stacks() -> impl Strategy<Value = Layers> {
    let plate = (0.0..5.0_f64, 1.0..2.0_f64).prop_map(|(thickness_mm, index)| Layer { thickness_mm, index });
    (normals(), 5.0..30.0_f64, prop::collection::vec(plate, 0..3), 1.0..2.0_f64)
        .prop_map(|(normal, gap_mm, plates, gel_index)| Layers { normal, gap_mm, plates, gel_index })
}

proptest! {
    /// The pixel's ray, followed by Snell's vector law through every interface, is the ray in the gel.
    #[test]
    fn a_pixels_ray_obeys_snell(layers in stacks(), x in 0.0..639.0_f64, y in 0.0..479.0_f64) {
        let rig = rig(Some(layers.clone()));
        prop_assume!(rig.validate().is_ok());
        let from_right = rig.t_right_left.inverse();
        for (view, centre) in [(View::Left, DVec3::ZERO), (View::Right, from_right.translation_mm)] {
            let view = rig.view(view);
            let in_air = view.camera().undistort(DVec2::new(x, y)).unwrap().extend(1.0);
            let in_air = if centre == DVec3::ZERO { in_air } else { from_right.transform_vector(in_air) };
            let expected = follow(centre, in_air, &layers);
            let found = view.ray(DVec2::new(x, y)).unwrap();
            // Some 30 roundings, each of an ulp of 60 mm at most; slopes up to 1.2 gain (1 + 1.2²) on the
            // interfaces.
            prop_assert!(
                (found.origin_mm - expected.origin_mm).length() < 200.0 * EPS * 60.0,
                "{found:?} {expected:?}"
            );
            prop_assert!(
                (found.direction - expected.direction).length() < 50.0 * EPS,
                "{found:?} {expected:?}"
            );
        }
    }

    /// A point on a pixel's ray is seen at that pixel.
    #[test]
    fn projection_inverts_the_ray(
        layers in stacks(), x in 0.0..639.0_f64, y in 0.0..479.0_f64, along in 0.0..20.0_f64,
    ) {
        let rig = rig(Some(layers));
        prop_assume!(rig.validate().is_ok());
        for view in [View::Left, View::Right] {
            let view = rig.view(view);
            let pixel = DVec2::new(x, y);
            let ray = view.ray(pixel).unwrap();
            let found = view.project(ray.origin_mm + ray.direction * along).unwrap();
            // A point carries some 10 ulp of 60 mm, seen from 5 mm at least: 600 px / 5 mm, times (1 + 1.2²).
            prop_assert!(
                (found - pixel).length() < 10.0 * EPS * 60.0 * 120.0 * 2.5 + 1e-12,
                "{found:?} {pixel:?}"
            );
        }
    }

    /// The search for the light's path may begin anywhere, and ends at the same place.
    #[test]
    fn the_start_of_the_search_does_not_matter(
        layers in stacks(), at in prop::array::uniform3(-8.0..8.0_f64), start in 0.0..100.0_f64,
    ) {
        let rig = rig(Some(layers.clone()));
        prop_assume!(rig.validate().is_ok());
        let point = DVec3::from_array(at) + DVec3::Z * 50.0;
        for view in [View::Left, View::Right] {
            let from_0 = rig.view(view).project(point).unwrap();
            let from_far = rig.view(view).project_with_jacobian(point, start).unwrap().pixel_px;
            prop_assert!((from_0 - from_far).length() < 1e-12, "{from_0:?} {from_far:?}");
        }
    }

    /// Central differences: their own error is 1e-16 · 700 px / 1e-4 mm of round-off and h² / 6 of the third
    /// derivative, below 600 / 5³ px/mm³: 1e-8 px/mm in all.
    #[test]
    fn derivatives_agree_with_differences(layers in stacks(), at in prop::array::uniform3(-8.0..8.0_f64)) {
        let rig = rig(Some(layers.clone()));
        prop_assume!(rig.validate().is_ok());
        let point = DVec3::from_array(at) + DVec3::Z * 50.0;
        for view in [View::Left, View::Right] {
            let view = rig.view(view);
            let found = view.project_with_jacobian(point, 0.0).unwrap();
            prop_assert_eq!(found.pixel_px, view.project(point).unwrap());
            for axis in 0..3 {
                let h = 1e-4 * DVec3::AXES[axis];
                let slope = (view.project(point + h).unwrap() - view.project(point - h).unwrap()) / 2e-4;
                let [u, v] = found.jacobian;
                prop_assert!((slope - DVec2::new(u[axis], v[axis])).length() < 1e-7, "{slope:?} {found:?}");
            }
        }
    }

    /// In a vacuum there is nothing to refract: the same bits as without layers, before and behind the
    /// interfaces.
    #[test]
    fn row_20_layers_of_air_are_the_pinhole_to_the_bit(
        normal in normals(), gap_mm in 0.0..40.0_f64, at in prop::array::uniform3(-8.0..8.0_f64),
    ) {
        let plates = vec![Layer { thickness_mm: 3.0, index: 1.0 }];
        let layers = Layers { normal, gap_mm, plates, gel_index: 1.0 };
        let point = DVec3::from_array(at) + DVec3::Z * 30.0;
        prop_assert_eq!(rig(Some(layers)).project(point), rig(None).project(point));
    }

    /// A layer without thickness does nothing, wherever it is put.
    #[test]
    fn row_20_a_layer_without_thickness_changes_no_bit(
        layers in stacks(), index in 1.0..4.0_f64, at in prop::array::uniform3(-8.0..8.0_f64),
    ) {
        let point = DVec3::from_array(at) + DVec3::Z * 40.0;
        let bare = rig(Some(layers.clone()));
        let ray = |rig: &Rig| rig.view(View::Left).ray(DVec2::new(320.0, 240.0) + point.truncate() * 10.0);
        for place in 0..=layers.plates.len() {
            let mut thicker = layers.clone();
            thicker.plates.insert(place, Layer { thickness_mm: 0.0, index });
            let thicker = rig(Some(thicker));
            prop_assert_eq!(thicker.project(point), bare.project(point));
            prop_assert_eq!(ray(&thicker), ray(&bare));
        }
    }

    /// Two plates of the gel's own index are gel.
    #[test]
    fn row_20_plates_of_gel_are_gel(
        normal in normals(), index in 1.0..4.0_f64, at in prop::array::uniform3(-8.0..8.0_f64),
    ) {
        let point = DVec3::from_array(at) + DVec3::Z * 35.0;
        let plain = Layers { normal, gap_mm: 20.0, plates: vec![], gel_index: index };
        let plate = Layer { thickness_mm: 2.0, index };
        let split = Layers { plates: vec![plate, plate], ..plain.clone() };
        let (a, b) = (rig(Some(plain)).project(point).unwrap(), rig(Some(split)).project(point).unwrap());
        // Sums in another order: some 10 roundings of a pixel of 1000.
        prop_assert!((a.0 - b.0).length().max((a.1 - b.1).length()) < 10.0 * EPS * 1000.0);
    }

    /// A point on the first interface is seen in air; crossing an interface moves no pixel.
    #[test]
    fn row_20_pixels_are_continuous_across_the_interfaces(
        layers in stacks(), x in -6.0..6.0_f64, y in -6.0..6.0_f64,
    ) {
        let rig = rig(Some(layers.clone()));
        prop_assume!(rig.validate().is_ok());
        let mut height = layers.gap_mm;
        for thickness in layers.plates.iter().map(|p| p.thickness_mm).chain([0.0]) {
            let across = DVec3::new(x, y, 0.0);
            let on = across + layers.normal * (height - layers.normal.dot(across));
            let (below, above) = (on - layers.normal * 1e-9, on + layers.normal * 1e-9);
            if let (Ok(b), Ok(a)) = (rig.project(below), rig.project(above)) {
                // 2e-9 mm at 600 px / z, z > 1 mm, and a slope of at most 10.
                prop_assert!((a.0 - b.0).length() < 2e-9 * 600.0 * 11.0, "{a:?} {b:?}");
            }
            height += thickness;
        }
    }

    /// A tilt by 1e-12 moves the pixels by a millionth of what a tilt by 1e-6 does, one in between by its
    /// share.
    #[test]
    fn row_21_a_tilt_of_1e_12_is_continuous(
        tilt in prop::sample::select(vec![1e-12, 1e-11, 1e-10, 9e-10]), turn in 0.0..6.3_f64,
        at in prop::array::uniform3(-8.0..8.0_f64),
    ) {
        let point = DVec3::from_array(at) + DVec3::Z * 35.0;
        let tilted = |tilt: f64| {
            let normal = DVec3::new(tilt * turn.cos(), tilt * turn.sin(), 1.0);
            let (left, right) = rig(Some(acrylic_and_gel(normal))).project(point).unwrap();
            [left, right]
        };
        let (none, tiny, small) = (tilted(0.0), tilted(tilt), tilted(1e-6));
        for view in 0..2 {
            let expected = (small[view] - none[view]) * (tilt / 1e-6);
            // Two pixels of up to 1000, some 10 ulp each; the second order of 1e-6 is 1e-12 · 600 px, times
            // tilt / 1e-6.
            prop_assert!((tiny[view] - none[view] - expected).length() < 20.0 * EPS * 1000.0);
        }
    }
}

/// Along the normal no ray bends; beside it, the gel looks shallower by the index: 20 + 3 / 1.49 + 5 / 1.41.
#[test]
fn row_19_normal_incidence() {
    let rig = plain(Some(acrylic_and_gel(DVec3::Z)));
    let view = rig.view(View::Left);
    assert_eq!(view.project(DVec3::Z * 28.0), Ok(DVec2::new(319.5, 239.5)));
    assert_eq!(
        view.ray(DVec2::new(319.5, 239.5)),
        Ok(Ray { origin_mm: DVec3::Z * 23.0, direction: DVec3::Z })
    );
    let paraxial = 600.0 / (20.0 + 3.0 / 1.49 + 5.0 / 1.41);
    for offset in [1e-3, 1e-6, 1e-9, 1e-100] {
        let column = view.project(DVec3::new(offset, 0.0, 28.0)).unwrap().x - 319.5;
        // The next term is of the order of (offset / 25 mm)²; the difference of pixels rounds at an ulp of
        // 319.5.
        let bound = paraxial * offset * (offset * offset / 600.0 + 2.0 * EPS) + EPS * 319.5;
        assert!((column - paraxial * offset).abs() < bound, "{offset}: {column}");
    }
    assert_eq!(view.project_with_jacobian(DVec3::Z * 28.0, 0.0).unwrap().jacobian[0].y, 0.0);
}

/// Light along the interface enters the gel at the critical angle, and that beyond it never meets the layers.
#[test]
fn row_19_grazing_incidence() {
    // The interface stands almost along the ray of pixel (919.5, 239.5), direction (1, 0, 1).
    let graze = |angle: f64| {
        let tilt = core::f64::consts::FRAC_PI_4 + angle;
        let normal = DVec3::new(-tilt.cos(), 0.0, tilt.sin());
        let layers = Layers { normal, gap_mm: 20.0, plates: vec![], gel_index: 1.41 };
        (normal, Rig { layers: Some(layers), ..plain(None) }.view(View::Left).ray(DVec2::new(919.5, 239.5)))
    };
    for angle in [1e-2, 1e-4, 1e-6] {
        let (normal, ray) = graze(angle);
        let ray = ray.unwrap();
        // cos θ_gel = sqrt(1 - cos² angle / n²); the angle itself carries a few ulp of 1.
        let expected = sqrt(1.0 - angle.cos() * angle.cos() / (1.41 * 1.41));
        assert!((normal.dot(ray.direction) - expected).abs() < 10.0 * EPS * (1.0 + angle), "{angle}");
        // 20 mm of gap are crossed over 20 / sin(angle); ulps of the angle count by 1 / angle.
        let run = ray.origin_mm.length();
        assert!((run * angle.sin() / 20.0 - 1.0).abs() < 10.0 * EPS / angle, "{angle}: {run}");
    }
    for angle in [-1e-12, -1e-6, -1.0] {
        assert!(matches!(graze(angle).1, Err(CameraError::MissesLayers { .. })), "{angle}");
    }
}

/// From a camera that touches the gel, only points within the critical angle asin(1 / n) can be seen.
#[test]
fn row_19_total_internal_reflection() {
    let layers = Layers { normal: DVec3::Z, gap_mm: 0.0, plates: vec![], gel_index: 1.41 };
    let rig = plain(Some(layers.clone()));
    let view = rig.view(View::Left);
    let limit = 1.0 / sqrt(1.41 * 1.41 - 1.0); // tangent of the critical angle
    let at = |share: f64| DVec3::new(5.0 * limit * share, 0.0, 5.0);
    for share in [0.5, 0.99, 1.0 - 1e-9] {
        let column = (view.project(at(share)).unwrap().x - 319.5) / 600.0;
        // tan θ_air = n s / sqrt(1 - n² s²), s the sine in the gel; 1 - n² s² loses 1 / (1 - share).
        let tangent = limit * share;
        let s2 = tangent * tangent / (1.0 + tangent * tangent) * 1.41 * 1.41;
        let expected = sqrt(s2 / (1.0 - s2));
        assert!((column / expected - 1.0).abs() < 20.0 * EPS / (1.0 - share), "{share}: {column} {expected}");
    }
    for share in [1.0 + 1e-9, 1.5, 1e9] {
        assert_eq!(view.project(at(share)), Err(CameraError::TotalReflection { point_mm: at(share) }));
    }
    // The least gap of air lets every point be seen, if only along the interface.
    for gap_mm in [1e-9, 1e-6, 1e-3] {
        let rig = plain(Some(Layers { gap_mm, ..layers.clone() }));
        let pixel = rig.view(View::Left).project(at(3.0)).unwrap();
        assert!(pixel.x > 1000.0, "{gap_mm}: {pixel:?}");
    }
}

/// Whatever slope the search begins with, it ends at the same pixel. From far above, Newton's step ends below
/// nothing: where the gap is small, the light's reach has all but ended there.
#[test]
fn row_19_any_start_leads_to_the_same_slope() {
    for gap_mm in [0.0, 1e-3, 1.0, 20.0] {
        let layers = Layers { normal: DVec3::Z, gap_mm, plates: vec![], gel_index: 1.41 };
        let rig = plain(Some(layers));
        let view = rig.view(View::Left);
        for x in [0.0, 0.5, 2.0, 4.0] {
            let point_mm = DVec3::new(x, 0.3 * x, gap_mm + 5.0);
            let cold = view.project(point_mm).unwrap();
            for start in [1e-9, 0.1, 1.0, 10.0, 1e3, 1e6] {
                let warm = view.project_with_jacobian(point_mm, start).map(|p| p.pixel_px);
                // Both rest within 1e-16 of their slope, which the next step would not change, and round as
                // the pixel does.
                let off_px = warm.unwrap().distance(cold);
                assert!(off_px < 20.0 * EPS * (1000.0 + cold.length()), "{gap_mm} {x} {start}: {off_px} px");
            }
        }
    }
}

#[test]
fn points_behind_a_camera_and_rigs_within_their_layers_are_refused() {
    let through = rig(Some(acrylic_and_gel(DVec3::Z)));
    for point_mm in [DVec3::new(0.0, 0.0, -5.0), DVec3::ZERO, DVec3::NAN, DVec3::new(0.0, 0.0, f64::INFINITY)]
    {
        for rig in [&through, &rig(None)] {
            assert!(matches!(rig.project(point_mm), Err(CameraError::NotInFront { .. })), "{point_mm}");
        }
    }
    // The right camera, 10 mm aside, reaches through an interface that is tilted by 45 degrees and 5 mm away.
    let layers = Layers { gap_mm: 5.0, ..acrylic_and_gel(DVec3::new(1.0, 0.0, 1.0)) };
    let error = rig(Some(layers)).validate().unwrap_err();
    assert!(matches!(error, RigError::RightCameraInLayers { gap_mm } if gap_mm < 0.0), "{error:?}");
}
