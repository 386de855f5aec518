//! Registration allocates nothing once it has seen a patch as large, and questions to a surface never do.

// A test may stop at what it did not expect.
#![allow(clippy::unwrap_used)]

use crate::contact_patch;
use crate::counting;
use crate::problems;

use contact_patch::{Contact, Shape};
use counting::ALLOCATIONS;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{Contact as Patch, Localizer, Registrar, Template, TrackingStatus};
use gelstereo_core::surface::Facing;
use problems::follow::METHODS;

#[test]
fn a_second_run_allocates_nothing() {
    // A box, whose template has its surface too.
    let shape = Shape::Cuboid { half_mm: DVec3::new(3.0, 4.0, 5.0) };
    let template = shape.template(0.5).with_field(0.4, 4.0);
    let mut random = Stream::new(1, "allocation");
    let contact = Contact::press(&shape, Pose::exp(DVec3::X * 0.1, DVec3::ZERO), 1.2, 0.03, &mut random);
    let guess = contact.guess(0.05, 0.5, &mut random);
    for method in [
        RegisterMethod::FilterregPoint,
        RegisterMethod::RansacIcp,
        RegisterMethod::SurfaceClose,
        RegisterMethod::SurfaceSearch,
    ] {
        let mut settings = RegisterParams { method, ..Default::default() };
        settings.ransac_icp.hypotheses = 100;
        let mut registrar = Registrar::new(&settings);
        let before = ALLOCATIONS.get();
        registrar.run(&contact.points_mm, &template, &guess).unwrap();
        let first = ALLOCATIONS.get() - before;
        assert!(first > 0, "the counter counts");
        registrar.run(&contact.points_mm, &template, &guess).unwrap();
        assert_eq!(ALLOCATIONS.get() - before - first, 0, "{method:?}");
    }
}

#[test]
fn what_the_gel_is_asked_allocates_nothing() {
    let parts = problems::parts::parts();
    let template = Template::from_mesh(&parts[0].mesh, 0.5, 1).unwrap();
    let mut random = Stream::new(3, "gel");
    let decay_mm = problems::gel::SOFT_MM;
    let problem = problems::Problem::press_into(decay_mm, &parts[0], problems::Sensing::GOOD, &mut random);
    let contact = Patch { decay_mm, ..problem.contact() };
    let guess = problem.guess(0.05, 0.5, &mut random);
    let settings = RegisterParams { method: RegisterMethod::SurfaceSearch, ..Default::default() };
    let mut registrar = Registrar::new(&settings);
    let first = registrar.register(&contact, &template, &guess).unwrap();
    let before = ALLOCATIONS.get();
    let second = registrar.register(&contact, &template, &guess).unwrap();
    assert_eq!(ALLOCATIONS.get(), before);
    assert_eq!(second, first);
    // A gel at rest within a pitch is not asked, and another answer comes of it.
    let stiff = Patch { decay_mm: 0.1, ..contact };
    assert_ne!(registrar.register(&stiff, &template, &guess).unwrap().log_likelihood, first.log_likelihood);
    // With less work than one of several candidates takes the answer is as valid.
    let mut short = settings;
    short.surface_search.budget = 60_000;
    let short = Registrar::new(&short).register(&contact, &template, &guess).unwrap();
    assert!(short.covariance().iter().flatten().all(|x| x.is_finite()));
}

#[test]
fn a_followed_part_allocates_nothing_whether_held_or_lost() {
    let shape = Shape::Cuboid { half_mm: DVec3::new(3.0, 4.0, 5.0) };
    // A box has three axes of two turns each.
    let template = shape.template(0.5);
    let symmetries = template.find_symmetries(0.02);
    assert_eq!(symmetries.len(), 3);
    let template = template.with_symmetries(symmetries);
    let mut random = Stream::new(2, "tracking");
    let press = Contact::press(&shape, Pose::exp(DVec3::X * 0.1, DVec3::ZERO), 1.2, 0.03, &mut random);
    let guess = press.guess(0.02, 0.2, &mut random);
    // No part looks like this.
    let noise: Vec<DVec3> = press.points_mm.iter().map(|&p| p + DVec3::Z * 1.5 * random.uniform()).collect();
    for method in METHODS {
        let settings = RegisterParams { method, ..Default::default() };
        let mut localizer = Localizer::new(&settings, &guess);
        let round = |localizer: &mut Localizer| {
            [&press.points_mm, &press.points_mm, &noise, &press.points_mm]
                .map(|points| localizer.run(&Patch::new(points), &template).unwrap().tracking)
        };
        let first = round(&mut localizer);
        assert_eq!(
            first,
            [
                TrackingStatus::Relocalized,
                TrackingStatus::Tracking,
                TrackingStatus::Lost,
                TrackingStatus::Relocalized
            ]
        );
        let before = ALLOCATIONS.get();
        let second = round(&mut localizer);
        assert_eq!(ALLOCATIONS.get(), before, "{method:?}");
        assert_eq!(second[1..], first[1..]);
    }
}

#[test]
fn a_part_that_the_gel_is_asked_about_allocates_nothing_followed() {
    let parts = problems::parts::parts();
    let template = Template::from_mesh(&parts[0].mesh, 0.5, 1).unwrap();
    let mut random = Stream::new(4, "followed gel");
    let (decay_mm, good) = (problems::gel::SOFT_MM, problems::Sensing::GOOD);
    let problem = problems::Problem::press_into(decay_mm, &parts[0], good, &mut random);
    let contact = Patch { decay_mm, ..problem.contact() };
    for method in METHODS {
        let settings = RegisterParams { method, ..Default::default() };
        let mut localizer = Localizer::new(&settings, &problem.t_sensor_object);
        assert_eq!(localizer.run(&contact, &template).unwrap().tracking, TrackingStatus::Relocalized);
        localizer.run(&contact, &template).unwrap();
        let before = ALLOCATIONS.get();
        // Longer than it takes to know what is usual.
        for _ in 0..30 {
            let located = localizer.run(&contact, &template).unwrap();
            assert!(located.tracking == TrackingStatus::Tracking && located.misfit.is_some());
        }
        assert_eq!(ALLOCATIONS.get(), before, "{method:?}");
    }
}

#[test]
fn questions_to_a_surface_allocate_nothing() {
    let mesh = contact_patch::cuboid(DVec3::new(3.0, 4.0, 5.0));
    let template = Template::from_mesh(&mesh, 0.5, 1).unwrap().with_field(0.5, 2.0);
    let (solid, field) = (template.solid().unwrap(), template.field().unwrap());
    let facing = Facing { direction: DVec3::Z, least_cosine: 0.5 };
    let before = ALLOCATIONS.get();
    let mut sum = 0.0;
    for k in 0..1000 {
        let p = DVec3::new(0.006, 0.008, 0.011) * f64::from(k);
        let found = solid.closest_from(p, k as u32);
        sum += found.distance_mm + solid.closest(p).distance_mm;
        sum += solid.closest_facing(p, &facing, 3.0, Some(found.triangle)).map_or(0.0, |c| c.distance_mm);
        sum += field.distance(p).map_or(0.0, |(distance, gradient)| distance + gradient.x);
    }
    assert!(sum.is_finite());
    assert_eq!(ALLOCATIONS.get(), before);
}
