//! A localizer over many frames: the same bits in two runs, no byte more, and no less right at the end
//! (simulated, noise 0.03 mm along z).
// A test may stop at what it did not expect, and print its counts.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use crate::counting;
use crate::problems;

use counting::{ALLOCATIONS, HELD};
use gelstereo_core::digest::Digest;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::RegisterMethod;
use gelstereo_core::register::{Contact, Localizer, Template, TrackingStatus};
use problems::follow::{METHODS, is_right, localizer, moved, part, sense};
use problems::gel::{Gel, SOFT_MM};
use problems::{Problem, Sensing};
use std::f64::consts::TAU;

/// Frames on the way that is gone again and again.
const ROUND: usize = 100;
/// In this one another part is pressed.
const OTHER: usize = 70;

/// What is sensed on a round: the part goes in a circle, turns to and fro and slips at times; twice nothing
/// touches, and once another part does.
fn round(seed: u64) -> (Vec<Option<Problem>>, Template, Pose) {
    let ((part, template), (other, _)) = (part("irregular peg"), part("key"));
    let mut random = Stream::new(seed, "round");
    let start = Problem::press_into(SOFT_MM, &part, Sensing::GOOD, &mut random).t_sensor_object;
    let frames = (0..ROUND).map(|k| match k {
        49 | 99 => None,
        OTHER => Some(Problem::press_into(SOFT_MM, &other, Sensing::GOOD, &mut random)),
        _ => {
            let (s, c) = (TAU * k as f64 / ROUND as f64).sin_cos();
            let slip_mm = if k % 20 == 19 { 0.15 } else { 0.0 };
            let shift = DVec3::new(0.6 * s + slip_mm, 0.6 * (c - 1.0), 0.0);
            let pose = moved(start, DVec3::Z * (0.05 * s), shift);
            Some(sense(&Gel::press_into(SOFT_MM, &part, &pose), pose, &mut random))
        }
    });
    (frames.collect(), template, start)
}

/// What was counted, and the digest of all that was found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counted {
    digest: Digest,
    believed: usize,
    wrong: usize,
    /// Where another part was.
    taken: usize,
    searched: usize,
    refused: usize,
}

impl Counted {
    fn step(&mut self, localizer: &mut Localizer, k: usize, frame: Option<&Problem>, template: &Template) {
        let contact = frame.map_or(Contact::new(&[]), |p| Contact { decay_mm: SOFT_MM, ..p.contact() });
        let Ok(located) = localizer.run(&contact, template) else {
            self.refused += 1;
            return;
        };
        self.digest = self.digest.u64(located.registration.digest()).u64(located.tracking as u64);
        self.searched += usize::from(located.tracking != TrackingStatus::Tracking);
        if located.tracking != TrackingStatus::Lost {
            self.believed += 1;
            self.taken += usize::from(k == OTHER);
            self.wrong += usize::from(frame.is_some_and(|problem| !is_right(problem, &located)));
        }
    }
}

/// Round by round, and after how many frames of the second and later ones there was another allocation.
fn follow(
    localizer: &mut Localizer,
    frames: &[Option<Problem>],
    template: &Template,
    rounds: usize,
) -> (Vec<Counted>, usize) {
    let (mut all, mut grown) = (Vec::with_capacity(rounds), 0);
    for round in 0..rounds {
        let mut counted = Counted::default();
        for (k, frame) in frames.iter().enumerate() {
            let before = (ALLOCATIONS.get(), HELD.get());
            counted.step(localizer, k, frame.as_ref(), template);
            grown += usize::from(round > 0 && (ALLOCATIONS.get(), HELD.get()) != before);
        }
        all.push(counted);
    }
    (all, grown)
}

#[test]
fn row_35_a_localizer_gives_the_same_bits_twice_and_takes_no_byte_more_over_thousands_of_frames() {
    let wanted = std::env::var("GELSTEREO_SOAK_FRAMES").ok().and_then(|text| text.parse().ok());
    let rounds: usize = wanted.unwrap_or(500) / ROUND;
    let (frames, template, start) = round(61);
    let mut localizer = localizer(RegisterMethod::SurfaceClose, &start);
    let before = ALLOCATIONS.get();
    let (first, grown) = follow(&mut localizer, &frames, &template, rounds);
    assert!(ALLOCATIONS.get() > before, "the counter counts");
    // Each of its two rungs makes room when it is first asked, and when it first sees more markers than then;
    // that may be rounds later.
    assert!(grown <= 2 * 2, "{grown} frames took more room");
    // Told to expect the part it is as new, with the room that it has.
    localizer.expect(&start);
    let (second, grown) = follow(&mut localizer, &frames, &template, rounds);
    assert_eq!(grown, 0);
    assert_eq!(first, second);
    let all = |of: fn(&Counted) -> usize| first.iter().map(of).sum::<usize>();
    let (believed, wrong, taken) = (all(|c| c.believed), all(|c| c.wrong), all(|c| c.taken));
    println!(
        "{rounds} rounds: {believed} believed, {wrong} of them wrong; another part taken for it {taken} times"
    );
    // What is usual does not creep up from frame to frame until another part is: where it was learned from
    // the frames that were doubted, the other one was taken 82 times in 100 rounds. It stands near the limit:
    // with other steps of the search 0 to 9 of 100 have been seen.
    assert!(4 * taken <= rounds, "{taken} of {rounds}");
    assert!(10 * wrong <= believed && believed >= 95 * rounds, "{wrong} of {believed}");
}

/// How many rounds are gone, each once; `GELSTEREO_WAYS=20` for the documented shares.
fn ways() -> u64 {
    std::env::var("GELSTEREO_WAYS").map_or(6, |count| count.parse().unwrap())
}

/// What the markers beside the contact tell keeps a way from going astray where the soft shoulder looks like
/// a face.
#[test]
#[ignore = "takes a minute: make test-long"]
fn the_gel_keeps_more_frames_right_than_the_distance_from_the_part_does() {
    let wrong = METHODS.map(|method| {
        let (mut believed, mut wrong) = (0, 0);
        for seed in 61..61 + ways() {
            let (frames, template, start) = round(seed);
            let (all, _) = follow(&mut localizer(method, &start), &frames, &template, 1);
            println!("{method:?} {seed}: {} of {} believed are wrong", all[0].wrong, all[0].believed);
            believed += all[0].believed;
            wrong += all[0].wrong;
        }
        println!("{method:?}: {wrong} of {believed}");
        wrong
    });
    assert!(2 * wrong[1] < wrong[0], "{wrong:?}");
}
