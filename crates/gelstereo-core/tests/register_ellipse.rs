//! Row 11: a cylinder that is nearly round, by the rungs on its surface.
// A test may stop at what it did not expect, and print its table.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Registrar, Registration, Template};
use gelstereo_core::surface::TriangleMesh;
use std::f64::consts::TAU;

const RADIUS_MM: f64 = 4.0;
/// Facets lie up to R (π / n)² / 2 = 0.03 µm under the ellipse.
const FACETS: u32 = 800;

/// Half axes R (1 + e) along x and R along y, from z = -8 to 8 mm.
fn template(ellipticity: f64) -> Template {
    let at = |k: u32, z: f64| {
        let (sin, cos) = (TAU * f64::from(k % FACETS) / f64::from(FACETS)).sin_cos();
        DVec3::new(RADIUS_MM * (1.0 + ellipticity) * cos, RADIUS_MM * sin, z)
    };
    let vertices = (0..FACETS).flat_map(|k| [at(k, -8.0), at(k, 8.0)]).collect();
    let triangles = (0..FACETS).flat_map(|k| {
        let (a, b) = (2 * k, 2 * ((k + 1) % FACETS));
        [[a, b, b + 1], [a, b + 1, a + 1]]
    });
    Template::from_mesh(&TriangleMesh::new(vertices, triangles.collect()).unwrap(), 0.5, 1).unwrap()
}

/// Points from 10 to 80 degrees of the ellipse's angle and 4 mm long, pressed on along their mean normal; and
/// one that hangs beside it, the lowest: saliency begins there, and not at points of the contact's rim, which
/// would be in or out by chance.
fn registered(method: RegisterMethod, ellipticity: f64, sigma_mm: f64) -> Registration {
    let on_it = (0..45).map(|k| {
        let (sin, cos) = (0.175 + 1.22 * f64::from(k % 9) / 8.0_f64).sin_cos();
        let x = RADIUS_MM * (1.0 + ellipticity) * cos;
        DVec3::new(x, RADIUS_MM * sin, f64::from(k / 9) - 2.0)
    });
    let points: Vec<DVec3> = on_it.chain([DVec3::new(RADIUS_MM + 0.3, -0.5, 0.0)]).collect();
    let mut settings = RegisterParams { method, point_sigma_mm: sigma_mm, ..Default::default() };
    settings.advanced.surface_sigma_mm = 0.1 * sigma_mm;
    settings.advanced.outlier_share = 0.01;
    let press = DVec3::new(1.0, 1.0, 0.0).normalize();
    let contact = gelstereo_core::register::Contact {
        press_direction: press,
        ..gelstereo_core::register::Contact::new(&points)
    };
    Registrar::new(&settings).register(&contact, &template(ellipticity), &Pose::IDENTITY).unwrap()
}

#[test]
fn row_11_surface_rungs_let_the_covariance_grow_smoothly() {
    // A spin by δ moves the ellipse along its normal by e R sin 2φ δ: the information about it grows as e².
    let sigma_mm = 1e-4;
    for method in [RegisterMethod::SurfaceClose, RegisterMethod::SurfaceSearch] {
        let round = registered(method, 0.0, sigma_mm);
        let words: Vec<String> = round.free.iter().map(ToString::to_string).collect();
        assert_eq!(words.len(), 2, "{method:?} {words:?}");
        let spin = |ellipticity: f64| {
            let found = registered(method, ellipticity, sigma_mm);
            assert_eq!(found.free.len(), 1, "{method:?} at {ellipticity}: {:?}", found.free);
            assert!(found.free[0].to_string().starts_with("slide along z"));
            found.observability.values[1]
        };
        let at = [1e-3, 2e-3, 4e-3, 8e-3].map(spin);
        println!("{method:?} {at:?}");
        for pair in at.windows(2) {
            // Four times as much, but for terms of order e, 1 %, and for the noise of normals: that takes 3 %
            // off the first, which is thirty times what noise alone would make.
            let growth = pair[1] / pair[0];
            assert!((3.9..4.3).contains(&growth), "{method:?}: {growth}");
        }
        // And under more noise the spin is lost, and stays lost.
        let counts = [1e-5, 1e-4, 1e-3, 1e-2].map(|s| registered(method, 1e-3, s).free.len());
        assert!(counts.is_sorted() && counts[0] == 1 && counts[3] == 2, "{method:?} {counts:?}");
    }
}
