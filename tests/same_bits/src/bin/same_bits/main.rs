//! Compares the digests of this machine with the committed ones; `--write` commits those of this machine in
//! their place.
#![allow(clippy::print_stdout, reason = "it is a program")]
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used))]

mod scenes;

use same_bits::{COMMITTED, Comparison, Digests, GROUPS, Group, Outcome, compare};
use std::fmt::Write as _;
use std::process::ExitCode;

/// All that needs no files, and what does.
fn groups() -> Vec<Group> {
    let mut groups = GROUPS.to_vec();
    groups.push(Group { name: "scene", run: scenes::run });
    groups
}

fn computed() -> Outcome<Digests> {
    let mut found = Digests::new();
    for group in groups() {
        (group.run)(&mut found).map_err(|error| format!("{}: {error}", group.name))?;
    }
    Ok(found)
}

fn compared() -> Outcome<Comparison> {
    let names: Vec<&str> = groups().iter().map(|group| group.name).collect();
    Ok(compare(COMMITTED, &names, &computed()?))
}

/// Writes what is computed here over the committed digests.
fn write() -> Outcome<()> {
    let mut text = String::new();
    for (name, digest) in computed()? {
        writeln!(text, "{name} {digest:016x}")?;
    }
    Ok(std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/digests.txt"), text)?)
}

fn main() -> Outcome<ExitCode> {
    if std::env::args().nth(1).as_deref() == Some("--write") {
        write()?;
        return Ok(ExitCode::SUCCESS);
    }
    let comparison = compared()?;
    println!("{comparison}");
    Ok(if comparison.is_good() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn row_34_every_digest_is_the_committed_one() {
        let comparison = compared().unwrap();
        assert!(comparison.is_good(), "{comparison}\nif results are meant to change: docs/same-bits.md");
    }
}
