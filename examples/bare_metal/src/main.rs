//! Senses a press and locates the part by every preset, from one static heap, without an operating system.
//!
//! It prints what it found and what that took, and fails where a result differs from that of the machine that
//! built it, or where a frame after the second one allocates.
#![no_std]
#![no_main]

extern crate alloc;

mod board;
mod heap;
#[cfg(feature = "pose")]
mod pose;
mod rig;
mod sensing;
mod stack;

/// Images, template and expected digests, from the build script.
mod scene {
    include!(concat!(env!("OUT_DIR"), "/scene.rs"));
}

use gelstereo_core::digest::Digest;
use gelstereo_core::params::Params;
use gelstereo_core::track::MarkerState;
use heap::StaticHeap;
use rig::{MARKERS, SIZE_PX};
use semihosting::{println, process};
use sensing::{FRAMES, Outcome, Sensing, pair_of, preset};

#[global_allocator]
static HEAP: StaticHeap = StaticHeap::empty();

/// Rounds of the loop that checks the counter, of two instructions each.
const CHECK_ROUNDS: usize = 1_000_000;

/// Called by the board's start code.
fn main() -> ! {
    // SAFETY: nothing is allocated before.
    let heap_bytes = unsafe { HEAP.start() };
    let [width_px, height_px] = SIZE_PX;
    println!("images {width_px} x {height_px}, markers {MARKERS} x {MARKERS}");
    println!("heap {heap_bytes} bytes, images and template {} bytes", scene::BYTES);
    if let Err(error) = every_preset() {
        println!("failed: {error}");
        process::exit(1)
    }
    println!("all results have the bits of the machine that built this");
    process::exit(0)
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    println!("{info}; {} bytes of the heap were in use at most", HEAP.used().peak_bytes);
    process::exit(1)
}

fn every_preset() -> Outcome<()> {
    board::start_counter();
    let counted = instructions_of(|| board::counted_loop(CHECK_ROUNDS)).0;
    println!("a loop of {} instructions counts as {counted}", 2 * CHECK_ROUNDS);
    for (index, name) in Params::PRESETS.into_iter().enumerate() {
        println!("preset {name}");
        one_preset(index, &preset(name)?)?;
    }
    Ok(())
}

fn one_preset(index: usize, params: &Params) -> Outcome<()> {
    HEAP.forget();
    stack::paint();
    let mut sensing = Sensing::new(params)?;
    sense(&mut sensing, scene::SENSED[index])?;
    let used = HEAP.used();
    println!(
        "  sensing: heap {} bytes, reach {} bytes, stack {} bytes",
        used.peak_bytes,
        used.reach_bytes,
        stack::peak_bytes()
    );
    #[cfg(feature = "pose")]
    locate(&sensing, params, scene::LOCATED[index])?;
    Ok(())
}

fn sense(sensing: &mut Sensing, expected: u64) -> Outcome<()> {
    let (mut digest, mut early) = (Digest::new(), 0);
    for frame in 0..FRAMES {
        let (count, done) = instructions_of(|| sensing.sense(scene::PAIRS[pair_of(frame)]));
        done?;
        let found = &sensing.frame;
        digest = digest.u64(found.digest());
        let seen = found.state.iter().filter(|&&state| state == MarkerState::Seen).count();
        let touching = found.patch.iter().filter(|&&is_in_patch| is_in_patch).count();
        println!("  frame {frame}: {seen} points, {touching} in contact, {count} instructions");
        if frame == 1 {
            early = HEAP.used().allocations;
        }
    }
    let later = HEAP.used().allocations - early;
    println!("  {early} allocations in two frames, {later} in the next {}", FRAMES - 2);
    if later > 0 {
        return Err("a frame after the second one allocated".into());
    }
    compare("frames", digest.value(), expected)
}

#[cfg(feature = "pose")]
fn locate(sensing: &Sensing, params: &Params, expected: u64) -> Outcome<()> {
    use gelstereo_core::math::Pose;

    let t_sensor_part = Pose::from_rows(&scene::T_SENSOR_PART)?;
    stack::paint();
    let mut locator = pose::Locator::new(params, scene::TEMPLATE)?;
    let guess = pose::guess(&t_sensor_part);
    let (count, found) = instructions_of(|| locator.locate(&sensing.frame, &guess));
    let found = found?;
    let used = HEAP.used();
    println!("  registration: {count} instructions, {:?}", found.verdict);
    println!(
        "  pose: heap {} bytes, reach {} bytes, stack {} bytes",
        used.peak_bytes,
        used.reach_bytes,
        stack::peak_bytes()
    );
    let (turn_rad, _) = (t_sensor_part.inverse() * found.t_sensor_object).log();
    let [x, y, z] = found.t_sensor_object.translation_mm.to_array();
    let off_mm = found.t_sensor_object.translation_mm.distance(t_sensor_part.translation_mm);
    println!(
        "  part at ({x:.3}, {y:.3}, {z:.3}) mm, off by {off_mm:.3} mm and {:.2} deg",
        turn_rad.length().to_degrees()
    );
    compare("pose", found.digest(), expected)
}

/// Instructions that work takes, and its result.
fn instructions_of<T>(work: impl FnOnce() -> T) -> (u64, T) {
    let before = board::instructions();
    let result = work();
    (board::instructions() - before, result)
}

/// Fails unless the results have the bits of the machine that built this.
fn compare(what: &str, found: u64, expected: u64) -> Outcome<()> {
    println!("  {what}: digest {found:016x}");
    if found == expected {
        return Ok(());
    }
    Err(alloc::format!(
        "the digest of the {what} is {found:016x}; on the machine that built this it is {expected:016x}"
    )
    .into())
}
