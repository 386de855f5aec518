//! gelstereo-host
fn main() {}
