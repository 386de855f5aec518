//! Sequences that make it hard to know which marker is which, rendered and run through whole pipelines
//! (simulated, sensor noise 2 grey levels): no marker is ever taken for another one, and all that is shown is
//! seen again at once.
#![allow(clippy::unwrap_used)]

use gelstereo_core::image::GrayView;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_core::params::Params;
use gelstereo_core::pipeline::{Frame, Pipeline};
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::{
    Defocus, Drag, Grain, Misprint, Patch, SensorNoise, Shoulder, Smears, Spread, UnevenLight,
};
use gelstereo_sim::{ContactState, Effects, GelKeyframe, Scene, Shape, Simulator, Truth};

const SIDE: usize = 25;
const PITCH_MM: f64 = 0.9;
const PITCH_PX: f64 = PITCH_MM * 560.0 / 28.7;

/// One stereo frame and where its markers are.
struct Shot {
    left: Vec<u8>,
    right: Vec<u8>,
    left_px: Vec<DVec2>,
    right_px: Vec<DVec2>,
    /// Printed, and within both images.
    shown: Vec<bool>,
}

fn scene() -> Scene {
    let effects = Effects {
        shoulder: Some(Shoulder::default()),
        spread: Some(Spread::default()),
        drag: Some(Drag::default()),
        grain: Some(Grain::default()),
        uneven_light: Some(UnevenLight::default()),
        defocus: Some(Defocus::default()),
        sensor_noise: Some(SensorNoise::default()),
        ..Effects::default()
    };
    Scene { indenter: Some(Shape::Sphere { radius_mm: 6.0 }), effects, ..Scene::default() }
}

/// Takes frames of a scene.
struct Camera {
    simulator: Simulator,
    missing: Vec<[usize; 2]>,
    truth: Truth,
}

impl Camera {
    fn new(scene: &Scene) -> Self {
        let simulator = Simulator::new(scene, None).unwrap();
        Self { simulator, missing: scene.gel.missing.clone(), truth: Truth::default() }
    }

    /// A ball pressed so deep, dragged along x and turned.
    fn take(&mut self, press_mm: f64, shear_mm: f64, twist_deg: f64, frame: u64) -> Shot {
        let over = Pose::from_translation_mm(DVec3::new(4.0 + shear_mm, 0.0, 40.0));
        let t_sensor_object = self.simulator.pressed(over, press_mm).unwrap();
        let twist_rad = twist_deg.to_radians();
        let contact = ContactState { t_sensor_object, shear_mm: [shear_mm, 0.0], twist_rad };
        let Self { simulator, truth, missing } = self;
        simulator.moment((press_mm > 0.0).then_some(&contact), frame, truth);
        let (mut left, mut right) = (Vec::new(), Vec::new());
        simulator.render(truth, frame, &mut left, &mut right);
        let inside = |p: &DVec2| p.cmpge(DVec2::ZERO).all() && p.cmple(DVec2::new(639.0, 479.0)).all();
        let printed = |n: usize| !missing.contains(&[n / SIDE, n % SIDE]);
        let views = truth.left_px.iter().zip(&truth.right_px).enumerate();
        let shown = views.map(|(n, (l, r))| inside(l) && inside(r) && printed(n)).collect();
        Shot { left, right, left_px: truth.left_px.clone(), right_px: truth.right_px.clone(), shown }
    }
}

/// Shares from 0 to 1 and back to 0, and three frames of rest.
fn there_and_back(steps: u32) -> impl Iterator<Item = f64> {
    let up = (0..steps).chain((0..steps - 1).rev());
    up.map(move |k| f64::from(k) / f64::from(steps - 1)).chain([0.0; 3])
}

/// What a preset made of a sequence.
#[derive(Clone, Copy, Debug, Default)]
struct Score {
    right: usize,
    /// Called seen, but elsewhere: the worst that can happen.
    wrong: usize,
    /// Shown, but held or lost.
    unseen: usize,
    /// Of the frames after the disturbance, those before all shown markers were seen.
    late: usize,
}

/// Runs a sequence whose frames from `calm` on are undisturbed.
fn score(shots: &[Shot], calm: usize, params: &Params) -> Score {
    let mut pipeline = Pipeline::new(&Scene::default_rig(), params).unwrap();
    let (mut frame, mut score) = (Frame::default(), Score::default());
    let mut names: Option<Vec<usize>> = None;
    let mut complete = false;
    for (k, shot) in shots.iter().enumerate() {
        let view = |pixels| GrayView::new(pixels, 640, 480, 640).unwrap();
        pipeline.process(view(&shot.left), view(&shot.right), &mut frame).unwrap();
        assert_eq!((frame.rows, frame.cols), (SIDE, SIDE));
        let names = names.get_or_insert_with(|| names_of(&frame, shot));
        let mut unseen = 0;
        for (n, &name) in names.iter().enumerate() {
            let near = |found: DVec2, truth: DVec2| found.distance(truth) < PITCH_PX / 3.0;
            let right =
                near(frame.left_px[name], shot.left_px[n]) && near(frame.right_px[name], shot.right_px[n]);
            match (frame.state[name], right && shot.shown[n]) {
                (MarkerState::Seen, true) => score.right += 1,
                (MarkerState::Seen, false) => score.wrong += 1,
                _ => unseen += usize::from(shot.shown[n]),
            }
        }
        score.unseen += unseen;
        complete |= k >= calm && unseen == 0;
        score.late += usize::from(k >= calm && !complete);
    }
    score
}

/// The name of every marker: nothing in a first frame tells the quarter turns of a square lattice apart.
fn names_of(frame: &Frame, shot: &Shot) -> Vec<usize> {
    let turned = |turns: usize| -> Vec<usize> {
        let turn = |(row, col): (usize, usize)| (col, SIDE - 1 - row);
        (0..SIDE * SIDE)
            .map(|n| (0..turns).fold((n / SIDE, n % SIDE), |place, _| turn(place)))
            .map(|(row, col)| row * SIDE + col)
            .collect()
    };
    let off = |names: &Vec<usize>| {
        let each = names.iter().zip(&shot.left_px).map(|(&name, truth)| frame.left_px[name].distance(*truth));
        each.sum::<f64>()
    };
    (0..4).map(turned).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap()
}

/// Runs presets fast and exact: nothing wrong, all back at once, and at most so many per thousand held while
/// shown.
fn check(name: &str, runs: &[(Vec<Shot>, usize)], change: impl Fn(&mut Params), most_held: usize) {
    for preset in ["fast", "exact"] {
        let mut params = Params::preset(preset).unwrap();
        change(&mut params);
        let mut total = Score::default();
        for (shots, calm) in runs {
            let Score { right, wrong, unseen, late } = score(shots, *calm, &params);
            total.right += right;
            total.wrong += wrong;
            total.unseen += unseen;
            total.late += late;
        }
        println!("{name}, {preset}: {total:?}");
        assert_eq!(total.wrong, 0, "{name}, {preset}: {total:?}");
        assert_eq!(total.late, 0, "{name}, {preset}: {total:?}");
        let shown = total.right + total.unseen;
        assert!(1000 * total.unseen <= most_held * shown, "{name}, {preset}: {total:?}");
    }
}

/// A grip 1 mm deep that drags and turns, seen in every so many frames.
fn grip(pitches: f64, twist_deg: f64, every: usize) -> (Vec<Shot>, usize) {
    let mut camera = Camera::new(&scene());
    let mut shots: Vec<Shot> =
        [0.0, 0.35, 0.7].into_iter().zip(0..).map(|(mm, k)| camera.take(mm, 0.0, 0.0, k)).collect();
    let shares: Vec<f64> = there_and_back(11).collect();
    let (moving, still) = shares.split_at(21);
    let calm = shots.len() + moving.iter().step_by(every).count();
    for (&share, k) in moving.iter().step_by(every).chain(still).zip(3..) {
        shots.push(camera.take(1.0, share * pitches * PITCH_MM, share * twist_deg, k));
    }
    (shots, calm)
}

#[test]
fn a_press_to_two_millimetres() {
    let mut camera = Camera::new(&scene());
    let shots: Vec<Shot> =
        there_and_back(9).zip(0..).map(|(share, k)| camera.take(2.0 * share, 0.0, 0.0, k)).collect();
    check("press", &[(shots, 17)], |_| {}, 0);
}

#[test]
fn shear_by_two_pitches() {
    // At the rim of the drag, neighbours tear apart by half a pitch; some of them are held until it is
    // undone.
    check("shear", &[grip(2.0, 0.0, 1)], |_| {}, 6);
}

#[test]
fn twist_by_thirty_degrees() {
    check("twist", &[grip(0.0, 30.0, 1), grip(0.0, -30.0, 1)], |_| {}, 2);
}

/// Two of three frames lost: neighbours move by 0.6 pitches at once.
#[test]
fn dropped_frames() {
    check("dropped +", &[grip(2.0, 0.0, 3)], |_| {}, 1);
    check("dropped -", &[grip(-2.0, 0.0, 3)], |_| {}, 2);
    check("dropped twist", &[grip(0.0, 30.0, 2)], |_| {}, 1);
}

#[test]
fn any_turn_of_the_lattice() {
    let runs: Vec<_> = (0..360)
        .step_by(24)
        .map(|degrees| {
            let mut scene = scene();
            // Smaller, so that no corner leaves the image.
            (scene.gel.pitch_mm, scene.gel.dot_radius_mm) = (0.62.into(), 0.16);
            scene.gel.rotation_rad = f64::from(degrees).to_radians();
            let mut camera = Camera::new(&scene);
            let shots: Vec<Shot> =
                [0.0, 0.7, 1.4].into_iter().zip(0..).map(|(mm, k)| camera.take(mm, 0.0, 0.0, k)).collect();
            (shots, 2)
        })
        .collect();
    check("turned", &runs, |_| {}, 1);
}

/// The gel at these places, pitches right and down, from frame to frame.
fn moved(shifts: &[DVec2]) -> Vec<Shot> {
    let mut scene = scene();
    scene.gel_motion = shifts
        .iter()
        .zip(0_u32..)
        .map(|(&shift, k)| GelKeyframe {
            time_s: f64::from(k) / 30.0,
            shift_mm: (shift * PITCH_MM).to_array(),
            rotation_rad: 0.0,
        })
        .collect();
    let mut camera = Camera::new(&scene);
    (0..shifts.len() as u64).map(|k| camera.take(0.0, 0.0, 0.0, k)).collect()
}

/// By 1.3 pitches from frame to frame: along rows, columns and across.
#[test]
fn jumps_by_more_than_a_pitch() {
    let runs: Vec<_> = [0.0_f64, 90.0, 45.0]
        .into_iter()
        .map(|degrees| {
            let half = DVec2::from_angle(degrees.to_radians()) * 0.65;
            let mut shifts = vec![DVec2::ZERO];
            shifts.extend([half, -half].into_iter().cycle().take(6));
            shifts.extend([-half; 3]);
            (moved(&shifts), 7)
        })
        .collect();
    check("jumps", &runs, |_| {}, 0);
}

/// Two border rows leave the view and come back. A dot that the border cuts is shown, but not seen.
#[test]
fn border_rows_leave_the_view() {
    let shares = there_and_back(9);
    let shifts: Vec<DVec2> = shares.map(|share| DVec2::new(0.0, share * 3.0 / PITCH_MM)).collect();
    check("border", &[(moved(&shifts), 17)], |_| {}, 6);
}

#[test]
fn a_fifth_not_printed() {
    let mut inner: Vec<[usize; 2]> =
        (1..SIDE - 1).flat_map(|row| (1..SIDE - 1).map(move |col| [row, col])).collect();
    let mut stream = Stream::new(1, "not printed");
    let mut scene = scene();
    for _ in 0..125 {
        scene.gel.missing.push(inner.swap_remove(stream.below(inner.len())));
    }
    let mut camera = Camera::new(&scene);
    let shots: Vec<Shot> =
        there_and_back(9).zip(0..).map(|(share, k)| camera.take(1.5 * share, 0.0, 0.0, k)).collect();
    check("not printed", &[(shots, 17)], |params| params.lattice.max_missing_share = 0.25, 0);
}

/// Frames 2 to 15 of a press are of another scene.
fn disturbed_press(mut disturbed: Scene, change: impl Fn(&mut Scene)) -> (Vec<Shot>, usize) {
    let mut clean = Camera::new(&disturbed);
    change(&mut disturbed);
    let mut camera = Camera::new(&disturbed);
    let shots = there_and_back(9).zip(0..).map(|(share, k)| {
        let camera = if (2..16).contains(&k) { &mut camera } else { &mut clean };
        camera.take(1.5 * share, 0.0, 0.0, k)
    });
    (shots.collect(), 16)
}

#[test]
fn smears_over_a_press() {
    let run = disturbed_press(scene(), |scene| {
        let mut stream = Stream::new(2, "smears");
        let mut patches = Vec::new();
        for _ in 0..6 {
            let mut between = |low: f64, high: f64| low + (high - low) * stream.uniform();
            let (x, y) = (between(150.0, 550.0), between(60.0, 420.0));
            let (rotation_rad, half_length) = (between(0.0, 3.1), between(20.0, 60.0));
            let half_size_px = [half_length, 7.0];
            // They travel: each frame has patches of its own.
            for k in 2..16 {
                let from_s = (f64::from(k) - 0.5) / 30.0;
                let centre_px = [x + 6.0 * f64::from(k), y + 3.0 * f64::from(k)];
                let until_s = from_s + 1.0 / 30.0;
                let patch = Patch {
                    centre_px,
                    half_size_px,
                    rotation_rad,
                    level: 60,
                    opacity: 0.7,
                    ..Patch::default()
                };
                patches.push(Patch { from_s, until_s, ..patch });
            }
        }
        scene.effects.smears = Some(Smears { patches, ..Smears::default() });
    });
    check("smears", &[run], |_| {}, 60);
}

#[test]
fn merged_pairs_in_a_press() {
    let run = disturbed_press(scene(), |scene| {
        let mut stream = Stream::new(3, "pairs");
        let mut place = || 1 + stream.below(SIDE - 3);
        let merged = (0..12)
            .map(|k| {
                let (row, col) = (place(), place());
                if k % 2 == 0 { [row, col, row, col + 1] } else { [row, col, row + 1, col] }
            })
            .collect();
        scene.effects.misprint = Some(Misprint { merged, ..Misprint::default() });
    });
    check("merged", &[run], |_| {}, 26);
}
