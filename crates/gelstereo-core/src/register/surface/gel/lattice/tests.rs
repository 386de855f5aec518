use super::*;
use crate::math::random::Stream;
use crate::math::{DVec3, cos, sin};
use crate::register::surface::point::Sample;

fn relaxation<T>(stiffness: f64, tolerance: T) -> Relaxation<T> {
    Relaxation { stiffness, max_sweeps: 500, tolerance }
}

/// Markers of a rotated lattice with disorder and holes, sorted row by row, and their true columns and rows.
fn markers(random: &mut Stream, sides: [i32; 2], disorder: f64) -> (Vec<Node>, Vec<[i32; 2]>) {
    let angle = core::f64::consts::TAU * random.uniform();
    let (x, y) = (DVec2::new(cos(angle), sin(angle)), DVec2::new(-sin(angle), cos(angle)));
    let mut all = Vec::new();
    for at in (0..sides[0] * sides[1]).map(|k| [k % sides[0], k / sides[0]]) {
        let off = DVec2::new(random.uniform() - 0.5, random.uniform() - 0.5) * (2.0 * disorder);
        let across_mm = f64::from(at[0]) * x + f64::from(at[1]) * y + off;
        if random.uniform() < 0.95 {
            let sample = Sample::new(DVec3::ZERO, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
            all.push((Node { sample, across_mm, along_mm: 0.0, index: 0 }, at));
        }
    }
    let low = all.iter().map(|one| one.0.across_mm.y).fold(f64::INFINITY, f64::min);
    all.sort_by_key(|one| (one.0.across_mm.y - low) as i64);
    all.into_iter().unzip()
}

/// Reference solution to the last digits, by sweeps over the true neighbours.
fn slowly(at: &[[i32; 2]], stiffness: f64, obstacle_mm: &[f64]) -> Vec<f64> {
    let near = |k: usize| {
        let beside = move |j: &usize| (at[*j][0] - at[k][0]).abs() + (at[*j][1] - at[k][1]).abs() == 1;
        (0..at.len()).filter(beside).collect::<Vec<_>>()
    };
    let near: Vec<Vec<usize>> = (0..at.len()).map(near).collect();
    let mut heights_mm = alloc::vec![0.0; at.len()];
    for _ in 0..2000 {
        for k in 0..at.len() {
            let sum: f64 = near[k].iter().map(|&j| heights_mm[j]).sum();
            let free = stiffness * sum / (1.0 + stiffness * near[k].len() as f64);
            heights_mm[k] = free.max(obstacle_mm[k]);
        }
    }
    heights_mm
}

#[test]
fn heights_are_those_of_the_true_neighbours_one_by_one() {
    let mut random = Stream::new(1, "lattice");
    let (mut lattice, mut sweeps) = (Lattice::default(), Sweeps::default());
    for (sides, disorder) in [([9, 7], 0.0), ([8, 8], 0.1), ([12, 5], 0.12), ([5, 12], 0.12), ([1, 30], 0.05)]
    {
        let (nodes, at) = markers(&mut random, sides, disorder);
        assert!(lattice.find(&nodes, 1.0));
        lattice.lay_out(&mut sweeps);
        let stiffness = 1.0 + 8.0 * random.uniform();
        let touch = |random: &mut Stream| random.uniform() < 0.3;
        let obstacle_mm: Vec<f64> = (0..at.len())
            .map(|_| if touch(&mut random) { random.uniform() } else { f64::NEG_INFINITY })
            .collect();
        let mut heights_mm = alloc::vec![0.0; at.len()];
        let taken = lattice.settle(&relaxation(stiffness, 1e-10), &obstacle_mm, &mut heights_mm, &mut sweeps);
        let truth_mm = slowly(&at, stiffness, &obstacle_mm);
        assert!(taken < 500);
        for (found, truth) in heights_mm.iter().zip(&truth_mm) {
            assert!((found - truth).abs() < 1e-8, "{sides:?} {disorder} {found} {truth}");
        }
        // Derivatives by the obstacle.
        let (h, mut cells) = (1e-5, Vec::new());
        let touches = |k: usize| heights_mm[k] <= obstacle_mm[k];
        let mut changes: Vec<[f64; 2]> =
            (0..at.len()).map(|k| [f64::from(u8::from(touches(k))), 0.0]).collect();
        lattice.follow(
            &relaxation(stiffness, [1e-10; 2]),
            touches,
            &heights_mm,
            &mut changes,
            &mut sweeps,
            &mut cells,
        );
        let raised: Vec<f64> = obstacle_mm.iter().map(|x| x + h).collect();
        let raised = slowly(&at, stiffness, &raised);
        for k in 0..at.len() {
            let slow = (raised[k] - truth_mm[k]) / h;
            assert!((changes[k][0] - slow).abs() < 1e-3, "{k} {} {slow}", changes[k][0]);
            assert!(changes[k][1] == 0.0 || !touches(k));
        }
    }
}

#[test]
fn markers_without_neighbours_stand_on_the_part_alone() {
    let node = |x: f64, y: f64| Node {
        sample: Sample::new(DVec3::ZERO, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]),
        across_mm: DVec2::new(x, y),
        along_mm: 0.0,
        index: 0,
    };
    let mut nodes: Vec<Node> = (0..36).map(|k| node(f64::from(k % 6), f64::from(k / 6))).collect();
    // One almost at another marker, and one far from all.
    nodes.extend([node(5.0, 5.01), node(2.0, 9.0)]);
    let mut lattice = Lattice::default();
    assert!(lattice.find(&nodes, 1.0));
    let mut obstacle_mm = [f64::NEG_INFINITY; 38];
    obstacle_mm[37] = 0.7;
    let mut heights_mm = [0.3; 38];
    let mut sweeps = Sweeps::default();
    lattice.lay_out(&mut sweeps);
    lattice.settle(&relaxation(4.0, 1e-10), &obstacle_mm, &mut heights_mm, &mut sweeps);
    assert!(heights_mm[37] == 0.7 && heights_mm[..37].iter().all(|x| x.abs() < 1e-8), "{heights_mm:?}");
}
