//! Friction on the layer: closed forms where it is thick, and Coulomb's law anywhere.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::{DVec2, DVec3, hypot, sqrt};
use gelstereo_sim::layer::closed::{CattaneoMindlin, FlatPunch, HalfSpace, Hertz};
use gelstereo_sim::layer::{Grid, Layer, LayerContact, Part, Start};
use proptest::prelude::*;

const NOTHING: f64 = f64::NEG_INFINITY;
const CELLS: usize = 64;

fn contact(layer: (f64, f64), cell_mm: f64, friction: f64) -> LayerContact {
    let layer = Layer { thickness_mm: layer.0, poisson_ratio: layer.1 };
    LayerContact::new(layer, Grid { rows: CELLS, cols: CELLS, cell_mm: [cell_mm; 2] }, friction).unwrap()
}

/// Centre of a cell, from the grid's middle.
fn at(cell: usize, cell_mm: f64) -> [f64; 2] {
    let middle = 0.5 * (CELLS as f64 - 1.0);
    [(cell % CELLS) as f64 - middle, (cell / CELLS) as f64 - middle].map(|x| x * cell_mm)
}

fn field(cell_mm: f64, of: impl Fn([f64; 2]) -> f64) -> Vec<f64> {
    (0..CELLS * CELLS).map(|i| of(at(i, cell_mm))).collect()
}

/// Tractions are within the bound; where they are, the surface goes with the part, and where they are at it,
/// it lags behind along them. Returns how many cells stick and how many slip.
fn coulomb(contact: &mut LayerContact, carried: [&[f64]; 2], friction: f64, slack: f64) -> [usize; 2] {
    let (mut into, mut aside) = (Vec::new(), [Vec::new(), Vec::new()]);
    contact.surface_mm(&mut into, &mut aside);
    let ([qx, qy], mut counts) = (contact.traction(), [0; 2]);
    for (i, &p) in contact.pressure().iter().enumerate() {
        let (q, bound) = (hypot(qx[i], qy[i]), friction * p);
        assert!(q <= bound * (1.0 + 1e-12), "cell {i}: {q} beyond {bound}");
        if p == 0.0 {
            continue;
        }
        let lag = [carried[0][i] - aside[0][i], carried[1][i] - aside[1][i]];
        let behind = hypot(lag[0], lag[1]);
        if behind > slack {
            counts[1] += 1;
            assert!(q > bound * (1.0 - 1e-6), "cell {i} slips by {behind} at {q} of {bound}");
            let along = (lag[0] * qx[i] + lag[1] * qy[i]) / (behind * q);
            // A residual of `slack` turns it by slack / behind.
            assert!(
                along > 1.0 - 4.0 * (slack / behind) * (slack / behind) - 1e-9,
                "cell {i} is pulled {along}"
            );
        } else {
            counts[0] += 1;
        }
    }
    counts
}

#[test]
fn row_27_a_pulled_ball_is_cattaneo_and_mindlin() {
    let (cell, depth, friction) = (0.033, 0.25, 0.5);
    // At ν = 0.5 pressing moves nothing sideways and pulling moves nothing up: what the theory takes for
    // granted.
    let thick = (400.0, 0.5);
    let hertz = Hertz { half_space: HalfSpace { poisson_ratio: 0.5 }, radius_mm: 4.0, depth_mm: depth };
    let heights = field(cell, |[x, y]| depth - (x * x + y * y) / 8.0);
    let mut layer = contact(thick, cell, friction);
    let none = vec![0.0; CELLS * CELLS];
    let slip = CattaneoMindlin { hertz, friction, shift_mm: 0.0 }.slip_mm();
    for share in [0.0, 0.3, 0.7, 1.0, 1.5] {
        let exact = CattaneoMindlin { hertz, friction, shift_mm: share * slip };
        let pulled = vec![share * slip; CELLS * CELLS];
        let part = Part { heights_mm: &heights, carried_mm: Some([&pulled, &none]) };
        let found = layer.press(part, 1e-8, Start::Last).unwrap();
        assert!(found.converged, "{share}: {found:?}");
        let [stuck, slips] = coulomb(&mut layer, [&pulled, &none], friction, 1e-6);
        let force = layer.traction()[0].iter().sum::<f64>() * cell * cell;
        let whole = friction * hertz.force_mm2();
        // 30 cells on the contact's radius, and a / h is 0.25 %.
        assert!((force - exact.force_mm2()).abs() < 0.01 * whole, "{share}: {force} {}", exact.force_mm2());
        assert!((exact.shift_of_force_mm(exact.force_mm2()) - (share * slip).min(slip)).abs() < 1e-12);
        let c = exact.stuck_mm();
        for i in 0..CELLS * CELLS {
            let [x, y] = at(i, cell);
            let r = hypot(x, y);
            let rim = (r - c).abs().min((r - hertz.contact_mm()).abs()) < 0.1;
            let q = layer.traction()[0][i];
            assert!(
                rim || (q - exact.traction(r)).abs() < 0.01 * friction * hertz.pressure(0.0),
                "{share}: {r} {q}"
            );
        }
        if share < 1.0 {
            // At ν = 0 the stick circle's area says how many cells stick, to a cell around it.
            let expected = core::f64::consts::PI * c * c / (cell * cell);
            let around = 2.0 * core::f64::consts::PI * c / cell;
            assert!((stuck as f64 - expected).abs() <= around + 4.0, "{share}: {stuck} {expected}");
        } else {
            // Exactly at the limit the middle alone may still stick.
            assert!(stuck <= if share == 1.0 { 60 } else { 0 } && slips > 1000, "{share}: {stuck} {slips}");
        }
    }
}

#[test]
fn row_27_no_friction_and_very_much() {
    let heights = field(0.4, |[x, y]| 1.0 - 4.0 + sqrt((16.0 - x * x - y * y).max(0.0)));
    let (along, across) = (field(0.4, |_| 0.3), field(0.4, |_| -0.1));
    let part = Part { heights_mm: &heights, carried_mm: Some([&along, &across]) };
    let mut slippery = contact((5.0, 0.48), 0.4, 0.0);
    assert!(slippery.press(part, 1e-6, Start::Afresh).unwrap().converged);
    assert!(slippery.traction().iter().all(|q| q.iter().all(|&q| q == 0.0)));
    // As little friction as there may be is none.
    let mut nearly = contact((5.0, 0.48), 0.4, 1e-9);
    assert!(nearly.press(part, 1e-6, Start::Afresh).unwrap().converged);
    let apart =
        slippery.pressure().iter().zip(nearly.pressure()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-6, "{apart}");

    let mut sticky = contact((5.0, 0.48), 0.4, 1e4);
    let found = sticky.press(part, 1e-6, Start::Afresh).unwrap();
    assert!(found.converged, "{found:?}");
    let [stuck, slips] = coulomb(&mut sticky, [&along, &across], 1e4, 3e-6);
    assert!(stuck > 50 && slips == 0, "everything sticks: {stuck} {slips}");
}

/// One cell that is pressed, and pressed and pulled: from eight cells on it is a point, whose square is seen
/// as (cell / r)² / 8 < 0.2 % of the motion.
#[test]
fn a_cell_far_away_is_boussinesqs_and_cerrutis_point() {
    let (cell, middle) = (0.1, CELLS / 2 * CELLS + CELLS / 2);
    let half_space = HalfSpace { poisson_ratio: 0.3 };
    let heights: Vec<f64> = (0..CELLS * CELLS).map(|i| if i == middle { 0.1 } else { NOTHING }).collect();
    for pull_mm in [0.0, 0.05] {
        let mut layer = contact((4000.0, half_space.poisson_ratio), cell, 1e4);
        let none = vec![0.0; CELLS * CELLS];
        let rest = Part { heights_mm: &heights, carried_mm: Some([&none, &none]) };
        assert!(layer.press(rest, 1e-8, Start::Afresh).unwrap().converged);
        let along = vec![pull_mm; CELLS * CELLS];
        let pulled = Part { heights_mm: &heights, carried_mm: Some([&along, &none]) };
        assert!(layer.press(pulled, 1e-8, Start::Last).unwrap().converged);
        let force = layer.pressure()[middle] * cell * cell;
        let [pull, aside] = layer.traction().map(|traction| traction[middle] * cell * cell);
        assert!(force > 0.0 && aside.abs() < 1e-6 * force && (pull > 0.1 * force) == (pull_mm > 0.0));
        let (mut into, mut moved) = (Vec::new(), [Vec::new(), Vec::new()]);
        layer.surface_mm(&mut into, &mut moved);
        let [x0, y0] = at(middle, cell);
        for i in 0..CELLS * CELLS {
            let from = DVec2::from_array(at(i, cell)) - DVec2::new(x0, y0);
            let r = from.length();
            if r < 8.0 * cell {
                continue;
            }
            let [sink, out] = half_space.boussinesq_mm(r).map(|motion| motion * force);
            let [x, y, z] = half_space.cerruti_mm(from).map(|motion| motion * pull);
            let exact = (from * (out / r)).extend(sink) + DVec3::new(x, y, z);
            let found = DVec3::new(moved[0][i], moved[1][i], into[i]);
            assert!((found - exact).length() < 0.01 * exact.length(), "{from}: {found} {exact}");
        }
    }
}

/// A disc of cells is none, and tractions are infinite at its rim: torque is off in proportion to the cells.
/// What is left of that is two cell sizes' difference away, and a disc of the cells' own area is the nearest
/// one.
#[test]
fn a_twisted_punchs_torque_is_reissner_and_sagocis() {
    let ratio = |cell: f64| {
        let heights = field(cell, |[x, y]| if hypot(x, y) < 0.8 { 0.1 } else { NOTHING });
        let cells = heights.iter().filter(|&&height| height > 0.0).count();
        let radius_mm = cell * sqrt(cells as f64 / core::f64::consts::PI);
        let punch = FlatPunch { half_space: HalfSpace { poisson_ratio: 0.4 }, radius_mm };
        torque_mm3(cell, 0.01, &heights) / (0.01 * punch.torque_mm3())
    };
    let [fine, coarse] = [0.03125, 0.0625].map(ratio);
    let exact = 2.0 * fine - coarse;
    assert!((exact - 1.0).abs() < 0.01, "{exact} from {fine} and {coarse}");
}

/// Torque of a punch that twists the surface, its press alone taken off.
fn torque_mm3(cell: f64, turn: f64, heights: &[f64]) -> f64 {
    let mut layer = contact((400.0, 0.4), cell, 1e4);
    let [x, y] = [field(cell, |[_, y]| -turn * y), field(cell, |[x, _]| turn * x)];
    let none = vec![0.0; CELLS * CELLS];
    let mut torque = |carried_mm| {
        let part = Part { heights_mm: heights, carried_mm: Some(carried_mm) };
        assert!(layer.press(part, 1e-8, Start::Afresh).unwrap().converged);
        let moment = |i| {
            let ([x, y], [qx, qy]) = (at(i, cell), layer.traction());
            (x * qy[i] - y * qx[i]) * cell * cell
        };
        (0..CELLS * CELLS).map(moment).sum::<f64>()
    };
    let before = torque([&none, &none]);
    torque([&x, &y]) - before
}

#[test]
fn a_twisted_punch_is_reissner_and_sagoci() {
    let (cell, turn) = (0.03125, 0.01);
    let punch = FlatPunch { half_space: HalfSpace { poisson_ratio: 0.4 }, radius_mm: 0.8 };
    let heights = field(cell, |[x, y]| if hypot(x, y) < 0.8 { 0.1 } else { NOTHING });
    let mut layer = contact((400.0, 0.4), cell, 1e4);
    let [x, y] = [field(cell, |[_, y]| -turn * y), field(cell, |[x, _]| turn * x)];
    let part = Part { heights_mm: &heights, carried_mm: Some([&x, &y]) };
    let found = layer.press(part, 1e-8, Start::Afresh).unwrap();
    assert!(found.converged, "{found:?}");
    let (mut into, mut aside) = (Vec::new(), [Vec::new(), Vec::new()]);
    layer.surface_mm(&mut into, &mut aside);
    for i in 0..CELLS * CELLS {
        let [x, y] = at(i, cell);
        let r = hypot(x, y);
        let around = (x * aside[1][i] - y * aside[0][i]) / r;
        let exact = turn * punch.twisted_mm(r);
        assert!(
            (r - 0.8).abs() < 0.16 || (around - exact).abs() < 0.01 * turn * 0.8,
            "{r}: {around} {exact}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    /// Whatever the part and the way it is carried, the solution obeys Coulomb.
    #[test]
    fn coulombs_law_holds(
        poisson_ratio in 0.0..=0.5_f64, thickness in 2.0..10.0, friction in 0.05..2.0,
        dx in -0.5..0.5, dy in -0.5..0.5, twist in -0.2..0.2, radius in 2.0..6.0, depth in 0.1..0.8,
    ) {
        let cell = 0.45;
        let heights = field(cell, |[x, y]| depth - 0.5 * (x * x + 1.5 * y * y) / radius);
        let along = field(cell, |[_, y]| dx - twist * y);
        let across = field(cell, |[x, _]| dy + twist * x);
        let mut layer = contact((thickness, poisson_ratio), cell, friction);
        let part = Part { heights_mm: &heights, carried_mm: Some([&along, &across]) };
        let found = layer.press(part, 1e-6, Start::Afresh).unwrap();
        prop_assert!(found.converged, "{found:?}");
        coulomb(&mut layer, [&along, &across], friction, 1e-5);
    }
}
