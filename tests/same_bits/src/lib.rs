//! Digests of what gelstereo computes, by name, for comparison between machines: `docs/same-bits.md`.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout))]

extern crate alloc;

mod arithmetic;
mod compare;
mod functions;
mod part;
mod registration;
mod sensing;
mod sensor;

pub use compare::{Comparison, Fault, compare};

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;

/// A result, or whatever went wrong.
pub type Outcome<T> = Result<T, Box<dyn core::error::Error>>;

/// Digests by name, in the order in which they were computed. A name starts with its group's.
pub type Digests = Vec<(String, u64)>;

/// What is computed together.
#[derive(Clone, Copy, Debug)]
pub struct Group {
    /// What its digests' names start with, up to the first `/`.
    pub name: &'static str,
    /// Computes and adds them.
    pub run: fn(&mut Digests) -> Outcome<()>,
}

/// All that needs no files, the smallest operations first: where a machine differs, the first difference is
/// the cause.
pub const GROUPS: [Group; 9] = [
    Group { name: "arithmetic", run: arithmetic::run },
    Group { name: "function", run: functions::run },
    Group { name: "preset", run: sensing::presets },
    Group { name: "rung", run: sensing::rungs },
    Group { name: "replay", run: sensing::replays },
    Group { name: "sensor", run: sensing::sensors },
    Group { name: "template", run: part::templates },
    Group { name: "register", run: registration::methods },
    Group { name: "follow", run: registration::followed },
];

/// The committed digests, `name digest` on each line.
pub const COMMITTED: &str = include_str!("../digests.txt");
