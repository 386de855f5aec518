//! Collects the documentation of every setting from the doc comments of the configuration's types, for
//! `gelstereo-host check --print-default`, for errors and for docs/configuration.md.

#[cfg(feature = "host")]
mod reference;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    #[cfg(feature = "host")]
    reference::generate()?;
    Ok(())
}
