//! Collects the documentation of every setting from the doc comments of the configuration's types, for
//! `gelstereo-host check --print-default`, for errors and for docs/configuration.md.
// Cargo reads a build script's output.
#![allow(clippy::print_stdout)]

#[cfg(feature = "host")]
mod reference;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    #[cfg(feature = "host")]
    reference::generate()?;
    Ok(())
}
