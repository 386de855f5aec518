//! The covariance of a registration, whatever the contact: positive definite, and the guess's along what is
//! free.

// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Registrar, Registration, Template};
use gelstereo_core::surface::TriangleMesh;
use proptest::prelude::*;
use std::sync::OnceLock;

const METHODS: [RegisterMethod; 4] = [
    RegisterMethod::FilterregPoint,
    RegisterMethod::RansacIcp,
    RegisterMethod::SurfaceClose,
    RegisterMethod::SurfaceSearch,
];
const HALF_MM: DVec3 = DVec3::new(3.0, 4.0, 5.0);
/// The camera, from the part.
const AWAY_MM: DVec3 = DVec3::new(4.0, -3.0, 30.0);

/// A box, with its surface.
fn template() -> &'static Template {
    static MADE: OnceLock<Template> = OnceLock::new();
    MADE.get_or_init(|| {
        let corner = |k: usize| {
            let sign = |bit: usize| if k >> bit & 1 == 0 { -1.0 } else { 1.0 };
            HALF_MM * DVec3::new(sign(0), sign(1), sign(2))
        };
        let faces = [
            [0, 2, 1],
            [1, 2, 3],
            [4, 5, 6],
            [5, 7, 6],
            [0, 1, 4],
            [1, 5, 4],
            [2, 6, 3],
            [3, 6, 7],
            [0, 4, 2],
            [2, 4, 6],
            [1, 3, 5],
            [3, 7, 5],
        ];
        let mesh = TriangleMesh::new((0..8).map(corner).collect(), faces.to_vec()).unwrap();
        let made = Template::from_mesh(&mesh, 0.5, 1).unwrap();
        made.with_field(Template::DEFAULT_CELL_MM, Template::DEFAULT_REACH_MM)
    })
}

/// Cholesky's pivots, all of them positive.
fn is_positive_definite(matrix: &Symmetric<6>) -> bool {
    let mut l = [[0.0_f64; 6]; 6];
    for i in 0..6 {
        for k in 0..=i {
            let rest = matrix[i][k] - (0..k).map(|j| l[i][j] * l[k][j]).sum::<f64>();
            if i == k && !(rest > 0.0) {
                return false;
            }
            l[i][k] = if i == k { rest.sqrt() } else { rest / l[k][k] };
        }
    }
    true
}

fn at_camera(points: Vec<DVec3>) -> Vec<DVec3> {
    points.into_iter().map(|p| p + AWAY_MM).collect()
}

fn found(method: RegisterMethod, points_mm: &[DVec3]) -> Registration {
    let mut params = RegisterParams { method, ..Default::default() };
    (params.ransac_icp.hypotheses, params.surface_search.starts) = (100, 8);
    Registrar::new(&params).run(points_mm, template(), &Pose::from_translation_mm(AWAY_MM)).unwrap()
}

/// zᵀ M z of a turn and shift about the patch's centroid, for a matrix about the frame's origin.
fn quadratic(matrix: &Symmetric<6>, z: &[f64; 6]) -> f64 {
    (0..6).map(|i| (0..6).map(|k| z[i] * matrix[i][k] * z[k]).sum::<f64>()).sum()
}

/// Variance of the shift of the patch's centroid along `v`: the perturbation (ω, v') moves a point c by v' +
/// ω × c.
fn shift_variance(found: &Registration, v: DVec3) -> f64 {
    let turn = found.observability.centre_mm.cross(v);
    quadratic(&found.covariance(), &[turn.x, turn.y, turn.z, v.x, v.y, v.z])
}

#[test]
fn a_hundred_copies_of_one_point_leave_what_was_guessed() {
    let points = at_camera(vec![DVec3::new(0.4, -0.7, -5.0); 100]);
    let guess = RegisterParams::default();
    for method in METHODS {
        let found = found(method, &points);
        assert!(is_positive_definite(&found.covariance()), "{method:?}");
        assert_eq!(found.free.len(), 5, "{method:?}");
        for v in [DVec3::X, DVec3::Y] {
            let sigma_mm = shift_variance(&found, v).sqrt();
            assert!((sigma_mm / guess.start_sigma_mm - 1.0).abs() < 1e-6, "{method:?}: {sigma_mm}");
        }
        let along_mm = shift_variance(&found, DVec3::Z).sqrt();
        assert!(along_mm > 0.0 && along_mm < 0.1 * guess.start_sigma_mm, "{method:?}: {along_mm}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Patches anywhere on the box, some of them one point many times, and points known exactly or hardly at
    /// all.
    #[test]
    fn a_covariance_is_positive_definite_whatever_the_contact(
        places in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f64), 1..40),
        copies in 1_usize..30,
        face in 0_usize..3,
        sigma_mm in prop_oneof![Just(0.03), 1e-4..1.0_f64],
        guess in (1e-3..90.0_f64, 1e-3..20.0_f64),
        method in 0..METHODS.len(),
    ) {
        let on_face = |p: &[f64; 3]| {
            let mut p = DVec3::from_array(*p) * HALF_MM;
            p[face] = -HALF_MM[face];
            p
        };
        let points: Vec<DVec3> = places.iter().flat_map(|p| vec![on_face(p); copies]).collect();
        let mut params = RegisterParams {
            method: METHODS[method],
            point_sigma_mm: sigma_mm,
            start_sigma_deg: guess.0,
            start_sigma_mm: guess.1,
            ..Default::default()
        };
        (params.ransac_icp.hypotheses, params.surface_search.starts) = (100, 8);
        let at = Pose::from_translation_mm(AWAY_MM);
        let Ok(found) = Registrar::new(&params).run(&at_camera(points), template(), &at) else {
            return Ok(());
        };
        let covariance = found.covariance();
        prop_assert!(is_positive_definite(&covariance), "{covariance:?}");
        for v in [DVec3::X, DVec3::Y, DVec3::Z] {
            // Nothing is known worse than it was guessed, and what is free no better.
            let share = shift_variance(&found, v) / (guess.1 * guess.1);
            prop_assert!(share > 0.0 && share < 1.0 + 1e-6, "{share}");
        }
        // The matrix without the guess inverts the information over what is determined.
        let (information, alone) = (found.information, found.determined_covariance());
        let trace: f64 = (0..6).map(|i| (0..6).map(|k| information[i][k] * alone[k][i]).sum::<f64>()).sum();
        prop_assert!((trace - (6 - found.observability.free_count()) as f64).abs() < 1e-3, "{trace}");
    }
}
