//! The skin over a print that lies below it.

use gelstereo_core::contact::RestSurface;
use gelstereo_core::lattice::Topology;
use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::{DMat3, DQuat, DVec3};
use gelstereo_core::pipeline::{Skin, SkinDepth};
use proptest::prelude::*;

const COLS: usize = 7;

fn print() -> Vec<DVec3> {
    (0..5 * COLS).map(|i| DVec3::new((i % COLS) as f64 * 0.9 - 2.0, (i / COLS) as f64 * 0.8, 28.0)).collect()
}

/// The skin of markers without noise.
fn skin(now_mm: &[DVec3], depth_mm: f64) -> (Vec<DVec3>, Vec<Symmetric<3>>) {
    with_sigma(now_mm, SkinDepth { mm: depth_mm, sigma_mm: 0.0 })
}

fn with_sigma(now_mm: &[DVec3], depth: SkinDepth) -> (Vec<DVec3>, Vec<Symmetric<3>>) {
    let mut skin =
        Skin::new(&RestSurface::new(&print()).unwrap(), Topology::square(print().len() / COLS, COLS), depth)
            .unwrap();
    let (mut points_mm, mut covariance_mm2) = (now_mm.to_vec(), vec![[[0.0; 3]; 3]; now_mm.len()]);
    skin.lift(&mut points_mm, &mut covariance_mm2);
    (points_mm, covariance_mm2)
}

proptest! {
    #[test]
    fn at_rest_and_moved_as_a_whole_it_keeps_its_depth(
        depth_mm in 0.0..2.0_f64, turn in prop::array::uniform3(-0.6..0.6_f64),
        shift in prop::array::uniform3(-2.0..2.0_f64),
    ) {
        let turn = DQuat::from_scaled_axis(DVec3::from_array(turn));
        let moved = |p: DVec3| turn * p + DVec3::from_array(shift);
        let (found, covariance_mm2) = skin(&print().iter().map(|&p| moved(p)).collect::<Vec<_>>(), depth_mm);
        for ((found, marker), covariance) in found.iter().zip(print()).zip(covariance_mm2) {
            // The camera is on the side of small z.
            prop_assert!(found.distance(moved(marker + DVec3::Z * depth_mm)) < 1e-12);
            prop_assert!(covariance.iter().flatten().all(|&entry| entry.abs() < 1e-24));
        }
    }

    /// An error of the depth moves every point as the gel at rest, and by what its covariance states.
    #[test]
    fn what_an_error_of_the_depth_moves_is_stated(
        depth_mm in 0.0..1.0_f64, sigma_mm in 0.01..0.3_f64, x in 0.7..1.6_f64, tilt in -0.5..0.5_f64,
    ) {
        let change = DMat3::from_cols(DVec3::new(x, 0.0, tilt), DVec3::Y, DVec3::Z);
        let now: Vec<DVec3> = print().iter().map(|&p| change * p).collect();
        let (here, _) = skin(&now, 0.0);
        let (one, _) = skin(&now, 1.0);
        let (_, exact) = skin(&now, depth_mm);
        let (_, stated) = with_sigma(&now, SkinDepth { mm: depth_mm, sigma_mm });
        for i in 0..now.len() {
            // The skin is linear in the depth. At rest it moves along z.
            let beyond = (sigma_mm * (one[i] - here[i] - DVec3::Z)).to_array();
            for (k, l) in (0..9).map(|kl| (kl / 3, kl % 3)) {
                let added = stated[i][k][l] - exact[i][k][l];
                prop_assert!((added - beyond[k] * beyond[l]).abs() < 1e-12, "{i} {k} {l} {added}");
            }
        }
    }

    /// A layer that is stretched by x and y becomes thinner by their product.
    #[test]
    fn the_layer_between_print_and_skin_keeps_its_volume(
        depth_mm in 0.05..1.0_f64, x in 0.7..1.6_f64, y in 0.7..1.6_f64, shear in -0.3..0.3_f64,
    ) {
        let stretch = DMat3::from_cols(DVec3::new(x, 0.0, 0.0), DVec3::new(shear, y, 0.0), DVec3::Z);
        let now: Vec<DVec3> = print().iter().map(|&p| stretch * p).collect();
        let (found, covariance_mm2) = skin(&now, depth_mm);
        let distance_mm = depth_mm / (x * y);
        for ((found, marker), covariance) in found.iter().zip(now).zip(covariance_mm2) {
            prop_assert!(found.distance(marker + DVec3::Z * distance_mm) < 1e-12);
            // The law's own error is a share of the change.
            let share = covariance[2][2].sqrt() / (distance_mm - depth_mm).abs().max(1e-9);
            prop_assert!(share < 0.21);
        }
    }

    #[test]
    fn neighbours_in_one_place_and_far_ones_give_finite_points(
        coordinates in proptest::collection::vec(
            prop::array::uniform3(prop_oneof![Just(0.0), -1e3..1e3_f64]), 5 * COLS,
        ),
    ) {
        let now: Vec<DVec3> = coordinates.into_iter().map(DVec3::from_array).collect();
        let (found, covariance_mm2) = skin(&now, 0.5);
        prop_assert!(found.iter().all(|point| point.is_finite()));
        prop_assert!(covariance_mm2.iter().flatten().flatten().all(|entry| entry.is_finite()));
    }
}

/// The stated covariance beside that of noisy samples, of a marker in the middle.
#[test]
fn noise_of_the_neighbours_is_stated() {
    const SAMPLES: usize = 20_000;
    let (depth_mm, middle) = (0.8, 2 * COLS + 3);
    // Noise of a stereo camera: most along its line of sight.
    let sigma_mm = [0.004, 0.003, 0.015];
    let mut state = 1_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut normal = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
    let mut layer = Skin::new(
        &RestSurface::new(&print()).unwrap(),
        Topology::square(print().len() / COLS, COLS),
        SkinDepth { mm: depth_mm, sigma_mm: 0.0 },
    )
    .unwrap();
    let diagonal: Symmetric<3> = std::array::from_fn(|i| {
        std::array::from_fn(|k| if i == k { sigma_mm[i] * sigma_mm[i] } else { 0.0 })
    });
    let (mut sum, mut squares) = ([0.0; 3], [0.0; 3]);
    for _ in 0..SAMPLES {
        let noisy = |p: DVec3| p + DVec3::from_array(sigma_mm.map(|sigma| sigma * normal()));
        let mut points_mm: Vec<DVec3> = print().into_iter().map(noisy).collect();
        layer.lift(&mut points_mm, &mut vec![diagonal; 5 * COLS]);
        for axis in 0..3 {
            sum[axis] += points_mm[middle][axis];
            squares[axis] += points_mm[middle][axis] * points_mm[middle][axis];
        }
    }
    let (mut points_mm, mut stated) = (print(), vec![diagonal; 5 * COLS]);
    layer.lift(&mut points_mm, &mut stated);
    for axis in 0..3 {
        let mean = sum[axis] / SAMPLES as f64;
        let variance = squares[axis] / SAMPLES as f64 - mean * mean;
        let ratio = variance / stated[middle][axis][axis];
        // Five standard deviations of a variance of so many samples are 5 %.
        assert!((0.94..1.06).contains(&ratio), "axis {axis}: {ratio}");
    }
}
