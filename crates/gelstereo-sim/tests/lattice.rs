//! The lattice of single frames under full contact, as the simulator presses: no place is wrong.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{press, simulator, with_effects};
use gelstereo_core::lattice::{FoundLattice, LatticeFinder};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_sim::{Effects, Shape, Truth};

const SIDE: usize = 25;
const SCENES: u64 = 20;

/// Largest shear and twist, to either side.
#[derive(Clone, Copy)]
struct Drag {
    shear_mm: f64,
    twist_rad: f64,
}

fn parts() -> [(&'static str, Shape, DVec3); 4] {
    let board = |side, protrusion_mm| Shape::Board { size_mm: [30.0; 2], block_mm: [side; 2], protrusion_mm };
    let upside_down = DVec3::X * core::f64::consts::PI;
    [
        ("ball", Shape::Sphere { radius_mm: 6.0 }, DVec3::ZERO),
        ("small ball", Shape::Sphere { radius_mm: 3.0 }, DVec3::ZERO),
        (
            "cylinder",
            Shape::Cylinder { radius_mm: 4.0, length_mm: 15.0 },
            DVec3::Y * core::f64::consts::FRAC_PI_2,
        ),
        ("board", board(10.0, 2.0), upside_down),
    ]
}

/// Places that most agree on, up to a turn and a shift; the others are wrong.
fn right(found: &FoundLattice) -> usize {
    let agreeing = |turns| {
        let shift = |(label, place): (usize, &Option<gelstereo_core::lattice::Place>)| {
            let at = (*place)?.turned(turns);
            Some(((label / SIDE) as i32 - at.row, (label % SIDE) as i32 - at.col))
        };
        let mut shifts: Vec<(i32, i32)> = found.places.iter().enumerate().filter_map(shift).collect();
        shifts.sort_unstable();
        shifts.chunk_by(|a, b| a == b).map(<[_]>::len).max().unwrap_or(0)
    };
    (0..4).map(agreeing).max().unwrap()
}

/// Complete frames, refused ones, and wrong places over 2 mm presses of a part, both views; any turn of the
/// lattice.
fn pressed(name: &str, shape: Shape, rotation: DVec3, drag: Drag) -> (usize, usize, usize) {
    let Drag { shear_mm, twist_rad } = drag;
    let (shoulder, spread, drag) =
        (Some(Default::default()), Some(Default::default()), Some(Default::default()));
    let mut scene = with_effects(shape, Effects { shoulder, spread, drag, ..Effects::default() });
    let (mut finder, mut found, mut truth) =
        (LatticeFinder::default(), FoundLattice::default(), Truth::default());
    let (mut complete, mut refused, mut wrong) = (0, 0, 0);
    for seed in 0..SCENES {
        let mut stream = Stream::new(seed, name);
        let mut either_way = |most: f64| (2.0 * stream.uniform() - 1.0) * most;
        scene.gel.rotation_rad = either_way(3.0);
        let offset = DVec2::new(either_way(6.0), either_way(6.0));
        let mut contact = press(&scene, rotation + DVec3::Z * either_way(0.5), offset, 2.0);
        contact.shear_mm = [either_way(shear_mm), either_way(shear_mm)];
        contact.twist_rad = either_way(twist_rad);
        simulator(&scene).truth(Some(&contact), &mut truth);
        for points in [&truth.left_px, &truth.right_px] {
            if finder.run(points, Some((640, 480)), &mut found).is_ok() {
                complete += usize::from(right(&found) == SIDE * SIDE);
                wrong += found.placed - right(&found);
            } else {
                refused += 1;
            }
        }
    }
    println!("{name}, {shear_mm} mm, {twist_rad} rad: {complete} complete, {refused} refused, {wrong} wrong");
    (complete, refused, wrong)
}

#[test]
fn row_15_presses_of_two_millimetres_are_placed_completely() {
    for (name, shape, rotation) in parts() {
        let (complete, _, wrong) = pressed(name, shape, rotation, Drag { shear_mm: 0.0, twist_rad: 0.0 });
        // A board's edge compresses single cells to half a pitch: 75 of 80 views were complete.
        assert!(complete >= 37 && wrong == 0, "{name}: {complete} of 40 complete, {wrong} wrong");
    }
}

/// The contact sticks: all of the shear lies in the pitch or two around it. Beyond 1 mm or 0.5 rad
/// cells fold, or slip by a whole place, which no single frame can tell.
#[test]
fn row_15_presses_with_shear_and_twist_are_never_misplaced() {
    for (name, shape, rotation) in parts() {
        for (shear_mm, twist_rad) in [(0.6, 0.0), (0.3, 0.15), (1.0, 0.0)] {
            let drag = Drag { shear_mm, twist_rad };
            let (complete, _, wrong) = pressed(name, shape.clone(), rotation, drag);
            assert!(complete >= 20 && wrong == 0, "{name}: {complete} of 40 complete, {wrong} wrong");
        }
    }
}
