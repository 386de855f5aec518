//! A wide part whose face covers the gel, and the touch of a known face (simulated: noise 2 grey levels,
//! blur 0.8 px, gel with shoulder, spread, drag).
#![allow(clippy::unwrap_used)]

use crate::quick_world;

use gelstereo_core::math::random::Stream;
use gelstereo_host::config::{Config, EdgeConfig, PoseConfig};
use gelstereo_host::replay::replay;
use gelstereo_host::report::{JobReport, Outcome, Stage, StageReport};
use gelstereo_host::robot::Robot;
use gelstereo_host::run::{Setup, run_with};
use gelstereo_host::world::SimulatedRobot;
use gelstereo_sim::Shape;
use quick_world::{quick, run};
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A face 20 mm wide beside the holder, which looks along -y.
fn wall() -> EdgeConfig {
    EdgeConfig {
        point_mm: [460.0, 0.0, 30.0],
        normal: [0.0, -1.0, 0.0],
        size_mm: 20.0,
        sigma_mm: 0.02,
        robot_sigma_mm: 0.02,
        approach_mm: 2.0,
        speed_mm_s: 1.0,
    }
}

/// A blade of 6 x 30 x 30 mm, held by its wide faces near its upper edge: the gel, 22 mm wide, sees this
/// edge and the face, but neither of the sides. The slot is 5 mm deep and 0.2 mm wider than the blade along
/// both of its sides.
fn blade(seed: u64) -> Config {
    let mut config = quick(seed);
    config.part.shape = Shape::Box { size_mm: [6.0, 30.0, 30.0] };
    let at = |position_mm| PoseConfig { position_mm, rotation_rad: [0.0; 3] };
    config.task.part_pose = at([400.0, -60.0, 15.0]);
    config.task.goal_pose = at([400.0, 60.0, 10.0]);
    config.task.insertion_depth_mm = 5.0;
    let pad_mm = config.mount.kinematics.pad_mm(6.0).unwrap();
    config.task.grasp_pose.position_mm[2] = 15.0 + 8.0 + pad_mm.z;
    config.task.clearance_mm = Some(0.2);
    config.task.max_looks = 5;
    config
}

fn with_wall(seed: u64) -> Config {
    let mut config = blade(seed);
    config.task.edges = vec![wall()];
    config
}

/// A level face 40 mm wide, on which the blade's end can be put down.
fn with_wall_and_floor(seed: u64) -> Config {
    let mut config = with_wall(seed);
    let floor = EdgeConfig { point_mm: [520.0, 0.0, 20.0], normal: [0.0, 0.0, 1.0], size_mm: 40.0, ..wall() };
    config.task.edges.push(floor);
    config
}

fn touches(report: &JobReport) -> usize {
    report.stages.iter().filter(|stage| stage.stage == Stage::Touch).count()
}

fn inserted(report: &JobReport) -> bool {
    matches!(report.outcome, Outcome::Inserted { .. })
}

/// No grasp tells where the blade is along its face, and turned by a quarter it does not fit between the
/// fingers.
#[test]
fn a_blade_that_covers_the_gel_goes_in_after_it_touched_a_known_face() {
    let mut config = blade(11);
    config.task.max_looks = 1;
    let report = run(&config);
    assert!(matches!(report.outcome, Outcome::Declined { .. }), "{}", report.why);
    let forecast = report.localized.unwrap().forecast.unwrap();
    assert!(forecast.chance < 0.3 && forecast.weakest.starts_with("slide along"), "{forecast:?}");

    let report = run(&with_wall(11));
    assert!(inserted(&report), "{}", report.why);
    let localized = report.localized.as_ref().unwrap();
    assert_eq!(localized.touches as usize, touches(&report));
    let grasps = report.stages.iter().filter(|stage| stage.stage == Stage::Close).count();
    assert_eq!(localized.looks, grasps as u32 + localized.touches);
    assert!(localized.touches > 0);
    let truth = report.truth.unwrap();
    assert!(truth.outcome_is_true && truth.tip_error_mm < 0.1, "{truth:?}");
}

/// Only the left and the right side can be brought to the wall, each once: the third touch is the end's.
#[test]
fn the_end_touches_a_level_face_where_both_sides_do_not_tell_enough() {
    let report = run(&with_wall(45));
    assert!(matches!(report.outcome, Outcome::Declined { .. }), "{}", report.why);
    assert_eq!(touches(&report), 2);
    let report = run(&with_wall_and_floor(45));
    assert!(inserted(&report), "{}", report.why);
    assert_eq!(touches(&report), 3);
    let truth = report.truth.unwrap();
    assert!(truth.outcome_is_true && truth.tip_error_mm < 0.1, "{truth:?}");
}

#[test]
fn a_recording_with_a_touch_gives_the_same_bits_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = with_wall(11);
    config.recording.path = folder.path().join("touch.mcap");
    let report = gelstereo_host::run::run(&config, &AtomicBool::new(false), &mut |_| {}).unwrap();
    assert!(touches(&report) > 0, "{}", report.why);
    let again = replay(&[&config.recording.path], None, &mut |_| {}).unwrap();
    assert_eq!((again.differing, again.truncated), (0, false), "{again}");
}

#[test]
fn an_interrupted_touch_stops_the_robot() {
    let config = with_wall(11);
    let stages = run(&config).stages;
    let before = stages.iter().position(|stage| stage.stage == Stage::Touch).unwrap();
    let setup = Setup::new(&config).unwrap();
    let world = Rc::clone(&setup.world);
    let (stop, mut ended) = (AtomicBool::new(false), 0);
    let mut interrupt = |_: &StageReport| {
        ended += 1;
        stop.store(ended == before, Ordering::Relaxed);
    };
    let report = run_with(&config, setup, None, &stop, &mut interrupt).unwrap();
    assert_eq!(report.outcome, Outcome::Interrupted { stage: Stage::Touch });
    let mut robot = SimulatedRobot(world);
    assert!(!robot.status().unwrap().moving);
}

/// What a second grasp tells of a round peg, a touch does not tell as well.
#[test]
fn a_round_peg_does_not_touch_a_face_that_is_there() {
    let mut config = quick(1);
    config.simulated.hole_diameter_mm = 8.012;
    config.task.clearance_mm = Some(0.012);
    (config.task.look_sigma_mm, config.task.look_sigma_rad) = (0.001, 1e-4);
    let without = run(&config);
    config.task.edges = vec![wall()];
    let with = run(&config);
    assert!(inserted(&with) && with.localized.as_ref().unwrap().looks > 1, "{}", with.why);
    assert_eq!((touches(&with), &with.digest), (0, &without.digest));
}

#[test]
fn a_face_that_is_not_there_ends_the_move_and_the_task() {
    let mut config = with_wall(11);
    config.simulated.edge_offset_mm = Some(-10.0);
    let report = run(&config);
    let Outcome::EdgeNotFelt { edge: 0, travel_mm } = report.outcome else { panic!("{}", report.why) };
    assert!((4.0..8.0).contains(&travel_mm), "{travel_mm} mm");
    assert_eq!(report.stages.last().unwrap().stage, Stage::Touch);
    assert!(report.truth.unwrap().outcome_is_true);
}

/// `GELSTEREO_SEEDS=12 cargo test -p gelstereo-host --test all -- edge:: --ignored --nocapture` prints the
/// table of docs/second-look.md. Both faces really stand off by their own sigma and the robot's, at random.
#[test]
#[ignore = "takes minutes: make test-long"]
fn blades_with_and_without_faces_over_many_seeds() {
    let seeds: u64 = std::env::var("GELSTEREO_SEEDS").map_or(12, |text| text.parse().unwrap());
    for name in ["none", "wall", "wall and floor"] {
        let mut reports = Vec::new();
        for seed in 1..=seeds {
            let mut config = match name {
                "none" => blade(seed),
                "wall" => with_wall(seed),
                _ => with_wall_and_floor(seed),
            };
            let sigma_mm = wall().sigma_mm.hypot(wall().robot_sigma_mm);
            config.simulated.edge_offset_mm = Some(sigma_mm * Stream::new(seed, "wall").normal());
            let report = run(&config);
            println!("seed {seed} {name}: {}", report.why);
            assert!(report.truth.as_ref().unwrap().outcome_is_true, "seed {seed}: {}", report.why);
            reports.push(report);
        }
        println!("| {name} | {}", row(&reports));
    }
}

/// Cells of the table: attempted, inserted, jammed, median number of touches, seconds of all touches of a
/// task.
fn row(reports: &[JobReport]) -> String {
    let count = |wanted: fn(&JobReport) -> bool| reports.iter().filter(|report| wanted(report)).count();
    let jammed = count(|report| matches!(report.outcome, Outcome::Jammed { .. }));
    let attempted = count(|report| report.stages.iter().any(|stage| stage.stage == Stage::Insert));
    let seconds = |report: &JobReport| -> f64 {
        report
            .stages
            .iter()
            .filter(|stage| stage.stage == Stage::Touch)
            .map(|stage| stage.source_s)
            .fold(0.0, |sum, s| sum + s)
    };
    let mut times_s: Vec<f64> = reports.iter().map(seconds).collect();
    times_s.sort_by(f64::total_cmp);
    let mut numbers: Vec<usize> = reports.iter().map(touches).collect();
    numbers.sort_unstable();
    let middle = reports.len() / 2;
    format!(
        "{attempted} of {} | {} | {jammed} | {} | {:.1} |",
        reports.len(),
        count(inserted),
        numbers[middle],
        times_s[middle]
    )
}
