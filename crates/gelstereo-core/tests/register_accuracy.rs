//! How often and how exactly the rungs find simulated contacts (noise 0.03 mm per axis, starts 5 degrees and
//! 1 mm off).
//!
//! `cargo nextest run -p gelstereo-core register_accuracy:: --no-capture` prints the table.
// A test may stop at what it did not expect, and print its table.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use crate::contact_patch;

use contact_patch::{Contact, Shape};
use gelstereo_core::math::linalg::eigen;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Registrar, Registration};

const NOISE_MM: f64 = 0.03;
const CONTACTS: usize = 20;

struct Scene {
    name: &'static str,
    shape: Shape,
    turn: DVec3,
    /// Depths of the contacts run from the first to the second.
    depths_mm: (f64, f64),
    free: usize,
}

fn scenes() -> [Scene; 6] {
    let cuboid = Shape::Cuboid { half_mm: DVec3::new(3.0, 4.0, 5.0) };
    let plate = Shape::Cuboid { half_mm: DVec3::new(15.0, 15.0, 3.0) };
    let cylinder = Shape::Cylinder { a_mm: 4.0, b_mm: 4.0, half_length_mm: 15.0 };
    let scene = |name, shape, turn: [f64; 3], depths_mm, free| {
        let turn = DVec3::from_array(turn);
        Scene { name, shape, turn, depths_mm, free }
    };
    [
        scene("sphere", Shape::Sphere { radius_mm: 5.0 }, [0.3, 0.2, 0.1], (0.7, 1.5), 3),
        scene("cylinder", cylinder, [0.05, 1.5, 0.1], (0.6, 1.5), 2),
        scene("plate", plate, [0.05, 0.03, 0.3], (0.6, 1.2), 3),
        scene("box face", cuboid, [0.03, 0.05, 0.3], (0.8, 1.5), 3),
        scene("box edge", cuboid, [0.05, 0.8, 0.3], (1.2, 1.8), 1),
        scene("box corner", cuboid, [0.6, 0.6, 0.3], (1.8, 2.2), 0),
    ]
}

/// Error over the bound along the directions that the bound determines, root mean square.
fn over_bound(contact: &Contact, pose: &Pose, free: usize) -> f64 {
    let spectrum = eigen(&contact.bound(NOISE_MM));
    let error = contact.error(pose);
    let along = |u: &[f64; 6]| u.iter().zip(error).map(|(a, b)| a * b).sum::<f64>();
    let sum: f64 = (free..6).map(|k| spectrum.values[k] * along(&spectrum.vectors[k]).powi(2)).sum();
    (sum / (6 - free) as f64).sqrt()
}

fn runs(scene: &Scene, method: RegisterMethod) -> Vec<(f64, Registration)> {
    let template = scene.shape.template(0.3);
    let mut registrar = Registrar::new(&RegisterParams { method, ..Default::default() });
    let mut random = Stream::new(7, scene.name);
    let mut out = Vec::new();
    while out.len() < CONTACTS {
        let depth = scene.depths_mm.0 + (scene.depths_mm.1 - scene.depths_mm.0) * random.uniform();
        let turn = Pose::exp(scene.turn, DVec3::ZERO);
        let contact = Contact::press(&scene.shape, turn, depth, NOISE_MM, &mut random);
        let guess = contact.guess(5.0_f64.to_radians(), 1.0, &mut random);
        // Fewer than six points cannot carry six degrees of freedom.
        if contact.points_mm.len() >= 6 {
            let found = registrar.run(&contact.points_mm, &template, &guess).unwrap();
            out.push((over_bound(&contact, &found.t_sensor_object, scene.free), found));
        }
    }
    out
}

struct Summary {
    /// Share of runs with an error below four times the bound.
    success: f64,
    /// Error over the bound.
    median: f64,
    /// Share of runs that name exactly the free directions of the closed form, and that name at least as
    /// many.
    exactly_free: f64,
    at_least_free: f64,
}

fn summary(scene: &Scene, method: RegisterMethod) -> Summary {
    let runs = runs(scene, method);
    let share = |of: &dyn Fn(&(f64, Registration)) -> f64| runs.iter().map(of).sum::<f64>() / CONTACTS as f64;
    let is = |yes: bool| f64::from(u8::from(yes));
    let mut ratios: Vec<f64> = runs.iter().map(|(ratio, _)| *ratio).collect();
    ratios.sort_by(f64::total_cmp);
    let out = Summary {
        success: share(&|(ratio, _)| is(*ratio < 4.0)),
        median: ratios[CONTACTS / 2],
        exactly_free: share(&|(_, found)| is(found.free.len() == scene.free)),
        at_least_free: share(&|(_, found)| is(found.free.len() >= scene.free)),
    };
    println!(
        "{:11} {:15} {:4.0} points  success {:4.2}  error/bound {:6.2} (p90 {:6.2})  converged {:4.2} after \
         {:3.0}  free {:4.2} {:4.2}  rmse {:.3} mm",
        scene.name,
        format!("{method:?}"),
        share(&|(_, found)| found.points as f64),
        out.success,
        out.median,
        ratios[CONTACTS * 9 / 10],
        share(&|(_, found)| is(found.converged)),
        share(&|(_, found)| f64::from(found.iterations)),
        out.exactly_free,
        out.at_least_free,
        share(&|(_, found)| found.rmse_mm),
    );
    out
}

// At the bound the squared ratio is χ² with d degrees of freedom over d: its median is just below 1, and
// ratios of 4 do not occur. What is asserted leaves room for the sampled template (1.4 x) and for the starts
// that fail.

#[test]
fn row_10_smooth_contacts_leave_their_directions_free_for_every_rung() {
    use RegisterMethod::{FilterregPoint, RansacIcp};
    for scene in &scenes()[..2] {
        for method in [FilterregPoint, RansacIcp] {
            assert_eq!(summary(scene, method).exactly_free, 1.0, "{} {method:?}", scene.name);
        }
    }
}

#[test]
fn filterreg_point_finds_what_a_point_to_point_fit_can() {
    for scene in scenes() {
        let found = summary(&scene, RegisterMethod::FilterregPoint);
        assert!(found.success >= 0.8 && found.median < 3.0, "{}", scene.name);
    }
}

#[test]
fn ransac_finds_broad_contacts() {
    for scene in &scenes()[..4] {
        let found = summary(scene, RegisterMethod::RansacIcp);
        // Nearest samples hold a point-to-point fit: twice the bound at this spacing.
        assert!(found.success >= 0.9 && found.median < 3.0, "{}", scene.name);
    }
}

/// Points twice as noisy as the settings say: the covariance follows what the residuals say (Birge 1932).
#[test]
fn residuals_that_exceed_the_noise_widen_the_covariance() {
    let scene = &scenes()[2];
    let template = scene.shape.template(0.3);
    let mut random = Stream::new(8, scene.name);
    let trace = |m: &[[f64; 6]; 6]| (0..6).map(|k| m[k][k]).sum::<f64>();
    let mut shares = 0.0;
    for _ in 0..CONTACTS {
        let contact = Contact::press(
            &scene.shape,
            Pose::exp(scene.turn, DVec3::ZERO),
            0.9,
            2.0 * NOISE_MM,
            &mut random,
        );
        let guess = contact.guess(5.0_f64.to_radians(), 1.0, &mut random);
        let [told, untold] = [2.0, 1.0].map(|share| {
            let params = RegisterParams {
                method: RegisterMethod::FilterregPoint,
                point_sigma_mm: share * NOISE_MM,
                ..Default::default()
            };
            Registrar::new(&params).run(&contact.points_mm, &template, &guess).unwrap()
        });
        shares += trace(&untold.information) / trace(&told.information);
    }
    // Four if nothing were widened. Not quite one: of what lies over the part the farthest points count for
    // nothing, and their residuals are those that show the noise.
    let share = shares / CONTACTS as f64;
    assert!((1.0..2.0).contains(&share), "{share}");
}
