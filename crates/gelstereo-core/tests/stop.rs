//! Long work that is stopped, at any question, and work that could be but is not.

use crate::solids;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{RegisterMethod, RegisterParams};
use gelstereo_core::register::{
    Contact, Localizer, RegisterError, Registrar, Template, TemplateBytesError, TemplateError, TrackingStatus,
};
use gelstereo_core::stop::{Stop, Stopped};
use gelstereo_core::surface::TriangleMesh;
use proptest::prelude::*;
use std::cell::Cell;
use std::sync::LazyLock;

const SPACING_MM: f64 = 0.8;
const CELL_MM: f64 = 0.3;
const REACH_MM: f64 = 2.0;

static MESH: LazyLock<TriangleMesh> = LazyLock::new(|| {
    let (vertices, triangles) = solids::block(DVec3::splat(-4.0), DVec3::new(4.0, 4.0, 7.0), 12);
    TriangleMesh::new(vertices, triangles).unwrap()
});
static TEMPLATE: LazyLock<Template> = LazyLock::new(|| Template::from_mesh(&MESH, SPACING_MM, 1).unwrap());

/// What comes of work that is stopped at a question, and how many it asked.
fn stopped_at<T>(question: usize, work: impl FnOnce(Stop<'_>) -> T) -> (T, usize) {
    let asked = Cell::new(0);
    let made = work(&|| {
        asked.set(asked.get() + 1);
        asked.get() > question
    });
    (made, asked.get())
}

#[test]
fn work_that_is_not_stopped_gives_the_same_bits() {
    let (made, asked) = stopped_at(usize::MAX, |stop| Template::from_mesh_unless(&MESH, SPACING_MM, 1, stop));
    assert_eq!(made.unwrap().to_bytes(), TEMPLATE.to_bytes());
    assert!(asked > 10, "{asked} questions");
    let gridded = TEMPLATE.clone().with_field(CELL_MM, REACH_MM);
    let (made, asked) =
        stopped_at(usize::MAX, |stop| TEMPLATE.clone().with_field_unless(CELL_MM, REACH_MM, stop));
    assert_eq!(made.unwrap().digest(), gridded.digest());
    assert!(asked > 20, "{asked} questions");
    let (found, asked) = stopped_at(usize::MAX, |stop| TEMPLATE.find_symmetries_unless(0.02, stop));
    assert_eq!(found.unwrap(), TEMPLATE.find_symmetries(0.02));
    assert!(asked > 20, "{asked} questions");
    let (turned, _) = stopped_at(usize::MAX, |stop| MESH.turned_outward_unless(stop));
    assert_eq!(turned.unwrap(), MESH.turned_outward());
}

/// The top of the block, 0.4 mm off, and a template of points with their surface.
fn patch() -> Vec<DVec3> {
    let at = |k: i32| DVec3::new(f64::from(k % 13) * 0.5 - 3.0, f64::from(k / 13) * 0.5 - 3.0, 7.4);
    (0..169).map(at).collect()
}

static SCAN: LazyLock<Template> = LazyLock::new(|| {
    Template::new(TEMPLATE.points_mm(), TEMPLATE.normals(), SPACING_MM).unwrap().with_surfels()
});

const METHODS: [RegisterMethod; 4] = [
    RegisterMethod::FilterregPoint,
    RegisterMethod::RansacIcp,
    RegisterMethod::SurfaceClose,
    RegisterMethod::SurfaceSearch,
];

fn registrar(method: RegisterMethod) -> Registrar {
    let mut params = RegisterParams { method, ..Default::default() };
    (params.ransac_icp.hypotheses, params.surface_search.starts) = (50, 16);
    Registrar::new(&params)
}

#[test]
fn registration_that_is_not_stopped_gives_the_same_bits() {
    let points = patch();
    for method in METHODS {
        let contact = Contact::new(&points);
        let plain = registrar(method).register(&contact, &TEMPLATE, &Pose::IDENTITY).unwrap();
        let mut asking = registrar(method);
        let (found, asked) =
            stopped_at(usize::MAX, |stop| asking.register_unless(&contact, &TEMPLATE, &Pose::IDENTITY, stop));
        assert_eq!(found.unwrap().digest(), plain.digest(), "{method:?}");
        assert!(asked >= 3, "{method:?}: {asked} questions");
    }
}

/// A registration that was stopped at any of its questions leaves nothing behind: the next one has the bits
/// of a first one.
#[test]
fn a_registration_that_is_stopped_leaves_nothing_behind() {
    let points = patch();
    let contact = Contact::new(&points);
    for method in METHODS {
        let mut asking = registrar(method);
        let register = |registrar: &mut Registrar, stop: Stop<'_>| {
            registrar.register_unless(&contact, &TEMPLATE, &Pose::IDENTITY, stop)
        };
        let (found, all) = stopped_at(usize::MAX, |stop| register(&mut asking, stop));
        let whole = found.unwrap().digest();
        for question in (0..9).map(|k| k * (all - 1) / 8) {
            let (stopped, _) = stopped_at(question, |stop| register(&mut asking, stop));
            assert_eq!(stopped, Err(RegisterError::Stopped), "{method:?} at {question} of {all}");
            let (again, _) = stopped_at(usize::MAX, |stop| register(&mut asking, stop));
            assert_eq!(again.unwrap().digest(), whole, "{method:?} after {question} of {all}");
        }
    }
}

/// A localizer that was stopped goes on as if the frame had not been.
#[test]
fn a_localizer_that_is_stopped_goes_on_as_before() {
    let points = patch();
    let contact = Contact::new(&points);
    let mut params = RegisterParams::default();
    params.surface_search.starts = 16;
    let mut plain = Localizer::new(&params, &Pose::IDENTITY);
    let digests: Vec<u64> =
        (0..3).map(|_| plain.run(&contact, &TEMPLATE).unwrap().registration.digest()).collect();
    let mut stopped = Localizer::new(&params, &Pose::IDENTITY);
    for digest in digests {
        let mut trial = stopped.clone();
        let (_, all) = stopped_at(usize::MAX, |stop| trial.run_unless(&contact, &TEMPLATE, stop).map(|_| ()));
        for question in [0, all / 3, 2 * all / 3, all - 1] {
            let (found, _) = stopped_at(question, |stop| stopped.run_unless(&contact, &TEMPLATE, stop));
            assert_eq!(found, Err(RegisterError::Stopped), "at {question} of {all}");
        }
        assert_eq!(stopped.run(&contact, &TEMPLATE).unwrap().registration.digest(), digest);
    }
}

/// A contact that the part does not explain is first followed and then searched for. A stop there leaves the
/// part held.
#[test]
fn a_search_that_is_stopped_leaves_the_part_followed() {
    let points = patch();
    let scattered: Vec<DVec3> =
        (0..points.len()).map(|k| points[k] + DVec3::Z * (k * 7 % 11) as f64).collect();
    let (contact, strange) = (Contact::new(&points), Contact::new(&scattered));
    let mut params = RegisterParams::default();
    params.surface_search.starts = 16;
    let mut held = Localizer::new(&params, &Pose::IDENTITY);
    held.run(&contact, &TEMPLATE).unwrap();
    let followed = held.clone().run(&contact, &TEMPLATE).unwrap();
    assert_eq!(followed.tracking, TrackingStatus::Tracking);
    let mut trial = held.clone();
    let (_, all) = stopped_at(usize::MAX, |stop| trial.run_unless(&strange, &TEMPLATE, stop).map(|_| ()));
    assert_ne!(trial.run(&contact, &TEMPLATE).unwrap().tracking, TrackingStatus::Tracking, "it was lost");
    for question in (0..9).map(|k| k * (all - 1) / 8) {
        let mut stopped = held.clone();
        let (found, _) = stopped_at(question, |stop| stopped.run_unless(&strange, &TEMPLATE, stop));
        assert_eq!(found, Err(RegisterError::Stopped), "at {question} of {all}");
        assert_eq!(stopped.run(&contact, &TEMPLATE).unwrap(), followed, "after {question} of {all}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// The same of templates of points, and of those that are read from bytes.
    #[test]
    fn a_stop_at_any_question_ends_reading_and_scans(share in 0.0..1.0_f64) {
        let at = |all: usize| (share * all as f64) as usize;
        let scan = |stop: Stop<'_>| {
            let points = Template::new_unless(TEMPLATE.points_mm(), TEMPLATE.normals(), SPACING_MM, stop)?;
            Ok::<_, TemplateError>(points.with_surfels_unless(stop)?.digest())
        };
        let (made, all) = stopped_at(usize::MAX, scan);
        prop_assert_eq!(made, Ok(SCAN.digest()));
        prop_assert_eq!(stopped_at(at(all), scan), (Err(TemplateError::Stopped), at(all) + 1));
        for template in [&*SCAN, &*TEMPLATE] {
            let bytes = template.to_bytes();
            let read = |stop: Stop<'_>| Template::from_bytes_unless(&bytes, stop).map(|read| read.digest());
            let (made, all) = stopped_at(usize::MAX, read);
            prop_assert_eq!(made, Ok(template.digest()));
            let stopped = Err(TemplateBytesError::Template(TemplateError::Stopped));
            prop_assert_eq!(stopped_at(at(all), read), (stopped, at(all) + 1));
        }
    }

    /// The question that says stop is the last one, and what there is stays as it was.
    #[test]
    fn a_stop_at_any_question_ends_the_work(share in 0.0..1.0_f64) {
        let (mesh, before) = (MESH.clone(), TEMPLATE.digest());
        let at = |all: usize| (share * all as f64) as usize;

        let make = |stop: Stop<'_>| Template::from_mesh_unless(&mesh, SPACING_MM, 1, stop).map(|_| ());
        let question = at(stopped_at(usize::MAX, make).1);
        prop_assert_eq!(stopped_at(question, make), (Err(TemplateError::Stopped), question + 1));

        let grid = |stop: Stop<'_>| TEMPLATE.clone().with_field_unless(CELL_MM, REACH_MM, stop).map(|_| ());
        let question = at(stopped_at(usize::MAX, grid).1);
        prop_assert_eq!(stopped_at(question, grid), (Err(Stopped), question + 1));

        let find = |stop: Stop<'_>| TEMPLATE.find_symmetries_unless(0.02, stop).map(|_| ());
        let question = at(stopped_at(usize::MAX, find).1);
        prop_assert_eq!(stopped_at(question, find), (Err(Stopped), question + 1));

        let turn = |stop: Stop<'_>| mesh.turned_outward_unless(stop).map(|_| ());
        let question = at(stopped_at(usize::MAX, turn).1);
        prop_assert_eq!(stopped_at(question, turn), (Err(Stopped), question + 1));

        prop_assert_eq!(&mesh, &*MESH);
        prop_assert_eq!(TEMPLATE.digest(), before);
    }
}
