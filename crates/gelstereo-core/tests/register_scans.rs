//! Scans as templates: points with noise and holes, and meshes that are not closed (simulated, noise 0.03 mm,
//! shoulder).
// A test may stop at what it did not expect, and print its table.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use crate::problems;

use gelstereo_core::math::DVec3;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Registrar, Template};
use gelstereo_core::surface::TriangleMesh;
use problems::parts::{Part, parts};
use problems::{CLASSES, Problem, Sensing, Tally};

const SPACING_MM: f64 = 0.25;

/// Points of a scanner: 0.01 mm off along the normal, normals off by 0.03 rad, and nothing where light did
/// not go: in balls of 0.7 mm, one in 15 mm of the part's length.
fn scan(whole: &Template, random: &mut Stream) -> Template {
    let points = whole.points_mm();
    let holes: Vec<DVec3> =
        (0..3).map(|_| points[(random.uniform() * points.len() as f64) as usize]).collect();
    let (mut at, mut normals) = (Vec::new(), Vec::new());
    for (&point, &normal) in points.iter().zip(whole.normals()) {
        if holes.iter().all(|hole| hole.distance(point) > 0.7) {
            at.push(point + normal * (0.01 * random.normal()));
            let off = DVec3::new(random.normal(), random.normal(), random.normal());
            normals.push(normal + off * 0.03);
        }
    }
    Template::new(&at, &normals, SPACING_MM).unwrap().with_surfels()
}

/// One triangle in twenty is missing.
fn torn(part: &Part, random: &mut Stream) -> Template {
    let kept = part.mesh.triangles().iter().filter(|_| random.uniform() > 0.05).copied().collect();
    let mesh = TriangleMesh::new(part.mesh.vertices_mm().to_vec(), kept).unwrap();
    let template = Template::from_mesh(&mesh, SPACING_MM, 1).unwrap();
    assert!(!template.solid().unwrap().is_closed());
    template
}

/// Contacts found from starts within 5 degrees and 1 mm.
fn tally(part: &Part, template: &Template, method: RegisterMethod) -> Tally {
    let mut settings = RegisterParams { method, ..Default::default() };
    settings.advanced.surface_sigma_mm = 0.01;
    let mut registrar = Registrar::new(&CLASSES[0].params(&settings));
    let mut random = Stream::new(21, part.name);
    let mut out = Tally::default();
    for _ in 0..5 {
        let problem = Problem::press(part, Sensing::GOOD, &mut random);
        let guess = problem.guess_within(&CLASSES[0], &mut random);
        let found = registrar.register(&problem.contact(), template, &guess).ok();
        out.count(found.map(|found| problem.score(&found.t_sensor_object)), 0.0);
    }
    out
}

#[test]
fn scans_are_about_as_good_as_the_mesh() {
    let mut random = Stream::new(22, "scans");
    let mut all = [(); 3].map(|()| Tally::default());
    // Of those with few triangles a missing one is half a face.
    for part in parts().into_iter().filter(|part| part.mesh.triangles().len() > 200) {
        let mesh = Template::from_mesh(&part.mesh, SPACING_MM, 1).unwrap();
        let templates = [scan(&mesh, &mut random), torn(&part, &mut random), mesh];
        for (template, all) in templates.iter().zip(&mut all) {
            all.add(&tally(&part, template, RegisterMethod::SurfaceSearch));
        }
    }
    let [scans, torn, meshes] = all;
    println!("scans {scans}\ntorn {torn}\nmeshes {meshes}");
    // A hole may be where the part touches: of some thirty contacts three.
    assert!(scans.runs >= 15 && scans.share() > meshes.share() - 0.1 && torn.share() > meshes.share() - 0.1);
    // Noise of 0.01 mm on the surface adds 5 % to the points' 0.03 mm; edges of squares add theirs.
    assert!(scans.median() < 2.0 * meshes.median(), "{} {}", scans.median(), meshes.median());
}

#[test]
fn a_scan_that_was_kept_registers_to_the_same_bits() {
    let part = parts().into_iter().find(|part| part.name == "key").unwrap();
    let mut random = Stream::new(23, "kept");
    let whole = scan(&Template::from_mesh(&part.mesh, SPACING_MM, 1).unwrap(), &mut random);
    let again = Template::from_bytes(&whole.to_bytes()).unwrap();
    let problem = Problem::press(&part, Sensing::GOOD, &mut random);
    let guess = problem.guess(0.02, 0.2, &mut random);
    let settings = RegisterParams { method: RegisterMethod::SurfaceClose, ..Default::default() };
    let digests = [&whole, &again].map(|template| {
        Registrar::new(&settings).register(&problem.contact(), template, &guess).unwrap().digest()
    });
    assert_eq!(digests[0], digests[1]);
    assert!(whole.solid().is_none() && whole.field().is_none(), "what is made of points is not exact");
}
