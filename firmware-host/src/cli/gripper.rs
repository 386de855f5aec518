//! `gelstereo-host gripper`: manual control of the configured gripper for bench work.

use super::{CliError, load, say, stop_flag};
use clap::{Args, Subcommand};
use gelstereo_host::config::Config;
use gelstereo_host::gripper::{Gripper, GripperError, GripperStatus};
use gelstereo_host::run::HostError;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

#[derive(Args)]
pub struct Arguments {
    /// Configuration with a real `[gripper]`.
    #[arg(long, value_name = "TOML")]
    config: PathBuf,
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    /// Print width and state; nothing moves.
    Status,
    /// Make the gripper ready. Some sweep their fingers, unless they are already active.
    Activate,
    /// Move to a width and wait until the fingers stop.
    Move {
        /// Opening between the pads.
        width_mm: f64,
        /// Speed.
        #[arg(long, default_value_t = 50.0)]
        speed_mm_s: f64,
        /// Fraction of the gripper's force range, 0 to 1.
        #[arg(long, default_value_t = 0.2)]
        force: f64,
    },
    /// Stop the fingers at their position.
    Stop,
}

/// The longest stroke at the slowest speed of the supported grippers takes some 8 s.
const MAX_MOVE: Duration = Duration::from_secs(30);
/// Polling period of a move; a Robotiq gripper expects communication once per second.
const POLL: Duration = Duration::from_millis(20);

pub fn command(Arguments { config, action }: &Arguments) -> Result<bool, CliError> {
    let config: Config = load(Some(config))?;
    let Some(mut gripper) = config.gripper.open().map_err(HostError::Gripper)? else {
        let kinds = "robotiq, robotiq_urcap, dh, on_robot, dynamixel or feetech";
        let message = format!("[gripper] kind is \"simulated\"; this command needs a real one: {kinds}");
        return Err(HostError::Gripper(GripperError::Device { message }).into());
    };
    let stop = stop_flag()?;
    let status = act(gripper.as_mut(), action, &stop).map_err(HostError::Gripper)?;
    let GripperStatus { width_mm, moving, object_detected } = status;
    say(format_args!("width_mm {width_mm:.2}  moving {moving}  object_detected {object_detected}"))?;
    Ok(!stop.load(Ordering::Relaxed))
}

fn act(gripper: &mut dyn Gripper, action: &Action, stop: &AtomicBool) -> Result<GripperStatus, GripperError> {
    match *action {
        Action::Status => {}
        Action::Activate => activate(gripper, stop)?,
        Action::Stop => gripper.stop()?,
        Action::Move { width_mm, speed_mm_s, force } => {
            activate(gripper, stop)?;
            if !stop.load(Ordering::Relaxed) {
                gripper.move_to(width_mm, speed_mm_s, force)?;
                wait(gripper, stop)?;
            }
        }
    }
    gripper.status()
}

fn activate(gripper: &mut dyn Gripper, stop: &AtomicBool) -> Result<(), GripperError> {
    gripper.activate()?;
    wait(gripper, stop)
}

/// Waits until the fingers stop; stops them if requested.
fn wait(gripper: &mut dyn Gripper, stop: &AtomicBool) -> Result<(), GripperError> {
    let deadline = Instant::now() + MAX_MOVE;
    while gripper.status()?.moving {
        if stop.load(Ordering::Relaxed) || Instant::now() > deadline {
            return gripper.stop();
        }
        std::thread::sleep(POLL);
    }
    Ok(())
}
