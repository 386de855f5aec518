//! Contacts of the layer: against closed forms where it is thick, and against what defines them anywhere.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::{hypot, sqrt};
use gelstereo_sim::layer::closed::{FlatPunch, HalfSpace, Hertz};
use gelstereo_sim::layer::{Grid, Layer, LayerContact, LayerError, Part, Start};
use proptest::prelude::*;

const NOTHING: f64 = f64::NEG_INFINITY;

fn contact(thickness_mm: f64, poisson_ratio: f64, cells: usize, cell_mm: f64) -> LayerContact {
    let layer = Layer { thickness_mm, poisson_ratio };
    LayerContact::new(layer, Grid { rows: cells, cols: cells, cell_mm: [cell_mm; 2] }, 0.0).unwrap()
}

fn part(heights_mm: &[f64]) -> Part<'_> {
    Part { heights_mm, carried_mm: None }
}

/// Distance of every cell from a point near the grid's middle, given in cells from it.
fn distances(grid: Grid, [x, y]: [f64; 2]) -> Vec<f64> {
    let middle = |cells: usize| 0.5 * (cells as f64 - 1.0);
    (0..grid.rows * grid.cols)
        .map(|i| {
            let (row, col) = ((i / grid.cols) as f64, (i % grid.cols) as f64);
            hypot(col - middle(grid.cols) - x, row - middle(grid.rows) - y) * grid.cell_mm[0]
        })
        .collect()
}

fn ball(distances: &[f64], radius: f64, depth: f64) -> Vec<f64> {
    // A parabola, as Hertz has it.
    distances.iter().map(|r| depth - 0.5 * r * r / radius).collect()
}

fn force(contact: &LayerContact) -> f64 {
    contact.pressure().iter().sum::<f64>() * contact.grid().cell_mm.iter().product::<f64>()
}

/// Whether pressures and heights solve the contact problem within `slack` mm: nothing pulls, no cell overlaps
/// the part, and what carries pressure touches.
fn complements(contact: &mut LayerContact, heights: &[f64], slack: f64) {
    let (mut into, mut aside) = (Vec::new(), [Vec::new(), Vec::new()]);
    contact.surface_mm(&mut into, &mut aside);
    for (i, (&p, &height)) in contact.pressure().iter().zip(heights).enumerate() {
        assert!(p >= 0.0, "cell {i} pulls: {p}");
        assert!(into[i] >= height - slack, "cell {i} overlaps: {} {height}", into[i]);
        assert!(p == 0.0 || (into[i] - height).abs() <= slack, "cell {i} carries {p} without touching");
    }
}

#[test]
fn a_ball_on_a_thick_layer_is_hertz_within_1_percent() {
    for poisson_ratio in [0.0, 0.3, 0.5] {
        // A layer 60 contact radii thick: its bottom takes about a / h = 1.7 % of the depth if nothing else.
        // So the depth that counts is where the half-space's would be: the load is what is compared, and the
        // shape at that load.
        let mut layer = contact(400.0, poisson_ratio, 64, 0.04);
        let hertz = Hertz { half_space: HalfSpace { poisson_ratio }, radius_mm: 4.0, depth_mm: 0.25 };
        let r = distances(layer.grid(), [0.0; 2]);
        let heights = ball(&r, 4.0, 0.25);
        let found = layer.press(part(&heights), 1e-9, Start::Afresh).unwrap();
        assert!(found.converged, "{found:?}");
        complements(&mut layer, &heights, 1e-8);
        // 25 cells along the contact's radius; a / h is 0.25 %.
        let ratio = force(&layer) / hertz.force_mm2();
        assert!((ratio - 1.0).abs() < 0.01, "{poisson_ratio}: force {ratio}");
        let (mut into, mut aside) = (Vec::new(), [Vec::new(), Vec::new()]);
        layer.surface_mm(&mut into, &mut aside);
        let p0 = hertz.pressure(0.0);
        for (i, &r) in r.iter().enumerate() {
            let [sink, out] = hertz.surface_mm(r);
            assert!(
                (into[i] - sink).abs() < 0.01 * hertz.depth_mm,
                "{poisson_ratio} {r}: {} {sink}",
                into[i]
            );
            let u = hypot(aside[0][i], aside[1][i]);
            assert!((u - out.abs()).abs() < 0.01 * hertz.depth_mm, "{poisson_ratio} {r}: {u} {out}");
            // The pressure's slope is infinite at the contact's rim, where cells are half covered.
            if (r - hertz.contact_mm()).abs() > 0.1 {
                assert!((layer.pressure()[i] - hertz.pressure(r)).abs() < 0.01 * p0, "{poisson_ratio} {r}");
            }
        }
    }
}

#[test]
fn a_flat_punch_on_a_thick_layer_is_boussinesq_within_1_percent() {
    let mut layer = contact(400.0, 0.4, 128, 0.03125);
    let punch = FlatPunch { half_space: HalfSpace { poisson_ratio: 0.4 }, radius_mm: 1.0 };
    let r = distances(layer.grid(), [0.0; 2]);
    let heights: Vec<f64> = r.iter().map(|&r| if r < 1.0 { 0.1 } else { NOTHING }).collect();
    assert!(layer.press(part(&heights), 1e-8, Start::Afresh).unwrap().converged);
    complements(&mut layer, &heights, 1e-7);
    // The pressure is infinite at the rim: cells there err by half a cell in 32.
    let ratio = force(&layer) / (0.1 * punch.stiffness_mm());
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
    let (mut into, mut aside) = (Vec::new(), [Vec::new(), Vec::new()]);
    layer.surface_mm(&mut into, &mut aside);
    for (i, &r) in r.iter().enumerate() {
        let [sink, _] = punch.surface_per_mm(r);
        assert!((r - 1.0).abs() < 0.05 || (into[i] - 0.1 * sink).abs() < 0.001, "{r}: {} {sink}", into[i]);
    }
}

/// Bulge beside a press: an incompressible layer rises by tens of micrometres beside a 1 mm press, a
/// half-space never.
#[test]
fn gel_rises_beside_the_contact() {
    let mut layer = contact(5.0, 0.5, 100, 0.225);
    let r = distances(layer.grid(), [0.0; 2]);
    let heights: Vec<f64> =
        r.iter().map(|&r| if r < 4.0 { 1.0 - 4.0 + sqrt(16.0 - r * r) } else { NOTHING }).collect();
    assert!(layer.press(part(&heights), 1e-5, Start::Afresh).unwrap().converged);
    complements(&mut layer, &heights, 1e-4);
    let (mut into, mut aside) = (Vec::new(), [Vec::new(), Vec::new()]);
    layer.surface_mm(&mut into, &mut aside);
    let rise = into.iter().fold(0.0_f64, |most, &w| most.max(-w));
    assert!((0.02..0.1).contains(&rise), "{rise} mm");
}

#[test]
fn row_26_no_overlap_full_overlap_a_single_cell_and_release() {
    let mut layer = contact(5.0, 0.48, 40, 0.45);
    let cells = 1600;
    let far = vec![-0.2; cells];
    let found = layer.press(part(&far), 1e-6, Start::Afresh).unwrap();
    assert!(found.converged && layer.pressure().iter().all(|&p| p == 0.0), "no overlap");
    assert!(
        layer.press(part(&vec![NOTHING; cells]), 1e-6, Start::Afresh).unwrap().converged,
        "no part at all"
    );
    assert!(
        layer.press(part(&vec![0.0; cells]), 1e-6, Start::Afresh).unwrap().converged,
        "touching without pressing"
    );
    assert!(layer.pressure().iter().all(|&p| p == 0.0));

    let mut single = far.clone();
    single[820] = 0.03;
    assert!(layer.press(part(&single), 1e-9, Start::Afresh).unwrap().converged);
    let loaded: Vec<usize> = (0..cells).filter(|&i| layer.pressure()[i] > 0.0).collect();
    assert_eq!(loaded, [820], "first touch");
    let first = layer.pressure()[820];
    single[820] = 0.06;
    layer.press(part(&single), 1e-9, Start::Afresh).unwrap();
    // One cell is a spring.
    assert!((layer.pressure()[820] / first - 2.0).abs() < 1e-6);

    let full = vec![0.5; cells];
    assert!(layer.press(part(&full), 1e-7, Start::Afresh).unwrap().converged);
    assert!(layer.pressure().iter().all(|&p| p > 0.0), "the whole grid touches");
    complements(&mut layer, &full, 1e-6);

    assert!(layer.press(part(&far), 1e-6, Start::Last).unwrap().converged);
    assert!(layer.pressure().iter().all(|&p| p == 0.0), "released");
}

#[test]
fn bad_input_is_refused() {
    let grid = Grid { rows: 8, cols: 8, cell_mm: [0.5; 2] };
    let layer = Layer { thickness_mm: 5.0, poisson_ratio: 0.5 };
    for bad in [-0.1, 0.51, f64::NAN] {
        assert!(LayerContact::new(Layer { poisson_ratio: bad, ..layer }, grid, 0.0).is_err());
    }
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(LayerContact::new(Layer { thickness_mm: bad, ..layer }, grid, 0.0).is_err());
    }
    for bad in [Grid { rows: 0, ..grid }, Grid { cols: 257, ..grid }, Grid { cell_mm: [0.5, 5.1], ..grid }] {
        assert!(LayerContact::new(layer, bad, 0.0).is_err());
    }
    let mut contact = LayerContact::new(layer, grid, 0.0).unwrap();
    let short = contact.press(part(&[0.0; 63]), 1e-6, Start::Afresh);
    assert_eq!(short.unwrap_err(), LayerError::Cells { found: 63, cells: 64 });
    for bad in [f64::NAN, f64::INFINITY, 5.01] {
        assert!(contact.press(part(&[bad; 64]), 1e-6, Start::Afresh).is_err());
    }
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(contact.press(part(&[0.1; 64]), bad, Start::Afresh).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever the part, the layer and the start are, the contact is solved; and from the last frame it is
    /// the same.
    #[test]
    fn any_part_is_in_equilibrium(
        poisson_ratio in 0.0..=0.5_f64,
        thickness in 1.0..20.0,
        bumps in prop::collection::vec((-16.0..16.0, -16.0..16.0, 0.5..6.0, -0.2..0.9_f64), 1..5),
        rough in 0.0..0.2,
    ) {
        let mut layer = contact(thickness, poisson_ratio, 33, 0.4);
        let grid = layer.grid();
        let mut heights = vec![NOTHING; 33 * 33];
        for &(x, y, radius, depth) in &bumps {
            for (height, r) in heights.iter_mut().zip(distances(grid, [x, y])) {
                if r < radius {
                    *height = height.max(depth - 0.5 * r * r / radius);
                }
            }
        }
        let mut stream = gelstereo_core::math::random::Stream::new(1, "rough");
        heights.iter_mut().for_each(|height| *height -= rough * stream.uniform());
        let found = layer.press(part(&heights), 1e-6, Start::Afresh).unwrap();
        prop_assert!(found.converged, "{found:?}");
        complements(&mut layer, &heights, 2e-6);
        let afresh = layer.pressure().to_vec();
        let again = layer.press(part(&heights), 1e-6, Start::Last).unwrap();
        prop_assert!(again.converged && again.products <= found.products);
        let once_more = layer.press(part(&heights), 1e-6, Start::Afresh).unwrap();
        prop_assert_eq!(once_more, found);
        prop_assert_eq!(layer.pressure(), &afresh[..]);
    }
}
