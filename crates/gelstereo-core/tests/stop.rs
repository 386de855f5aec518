//! Long work that is stopped, at any question, and work that could be but is not.

use crate::solids;
use gelstereo_core::math::DVec3;
use gelstereo_core::register::{Symmetry, Template, TemplateError};
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
    let (found, asked) = stopped_at(usize::MAX, |stop| Symmetry::of_unless(&TEMPLATE, 0.02, stop));
    assert_eq!(found.unwrap(), Symmetry::of(&TEMPLATE, 0.02));
    assert!(asked > 20, "{asked} questions");
    let (turned, _) = stopped_at(usize::MAX, |stop| MESH.turned_outward_unless(stop));
    assert_eq!(turned.unwrap(), MESH.turned_outward());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

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

        let find = |stop: Stop<'_>| Symmetry::of_unless(&TEMPLATE, 0.02, stop).map(|_| ());
        let question = at(stopped_at(usize::MAX, find).1);
        prop_assert_eq!(stopped_at(question, find), (Err(Stopped), question + 1));

        let turn = |stop: Stop<'_>| mesh.turned_outward_unless(stop).map(|_| ());
        let question = at(stopped_at(usize::MAX, turn).1);
        prop_assert_eq!(stopped_at(question, turn), (Err(Stopped), question + 1));

        prop_assert_eq!(&mesh, &*MESH);
        prop_assert_eq!(TEMPLATE.digest(), before);
    }
}
