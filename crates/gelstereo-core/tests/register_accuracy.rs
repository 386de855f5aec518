//! How often and how exactly the rungs find simulated contacts (noise 0.03 mm per axis, starts 5 degrees and 1 mm off).
//!
//! `cargo nextest run -p gelstereo-core --test register_accuracy --no-capture` prints the table.

mod contact_patch;

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

/// Share of runs within 4 x the bound, and the median ratio.
fn summary(scene: &Scene, method: RegisterMethod) -> (f64, f64) {
    let runs = runs(scene, method);
    let mut ratios: Vec<f64> = runs.iter().map(|(ratio, _)| *ratio).collect();
    ratios.sort_by(f64::total_cmp);
    let within = ratios.iter().filter(|&&ratio| ratio < 4.0).count() as f64 / CONTACTS as f64;
    let mean = |of: &dyn Fn(&Registration) -> f64| {
        runs.iter().map(|(_, found)| of(found)).sum::<f64>() / CONTACTS as f64
    };
    println!(
        "{:11} {:15} {:4.0} points  success {:4.2}  error/bound median {:6.2} p90 {:6.2}  converged {:4.2}  \
         iterations {:4.0}  right free {:4.2}  rmse {:.3} mm",
        scene.name,
        format!("{method:?}"),
        mean(&|found| found.points as f64),
        within,
        ratios[CONTACTS / 2],
        ratios[CONTACTS * 9 / 10],
        mean(&|found| f64::from(u8::from(found.converged))),
        mean(&|found| f64::from(found.iterations)),
        mean(&|found| f64::from(u8::from(found.free.len() == scene.free))),
        mean(&|found| found.rmse_mm),
    );
    (within, ratios[CONTACTS / 2])
}

#[test]
fn plane_rungs_reach_the_bound() {
    for scene in scenes() {
        for method in [RegisterMethod::FilterregPlane, RegisterMethod::IcpPlane] {
            let (_within, _median) = summary(&scene, method);
        }
    }
}

#[test]
fn point_rungs_do_what_they_can() {
    for scene in scenes() {
        for method in [RegisterMethod::FilterregPoint, RegisterMethod::RansacIcp] {
            let (_within, _median) = summary(&scene, method);
        }
    }
}
