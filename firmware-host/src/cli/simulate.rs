//! `gelstereo-host simulate`.

use super::{CliError, say, stop_flag};
use clap::Args;
use gelstereo_host::simulate::{self, Simulated};
use indicatif::ProgressBar;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

#[derive(Args)]
pub struct Arguments {
    /// Scene file.
    scene: PathBuf,
    /// Folder to create.
    folder: PathBuf,
}

pub fn command(Arguments { scene, folder }: &Arguments) -> Result<bool, CliError> {
    let stop = stop_flag()?;
    let bar = ProgressBar::new(0);
    let simulated = simulate::simulate(scene, folder, &stop, &mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let Simulated { frames, plan } = simulated.map_err(CliError::Simulate)?;
    say(plan.to_string().trim_end())?;
    say(format_args!("{frames} frames with truth in {}", folder.display()))?;
    Ok(!stop.load(Ordering::Relaxed))
}
