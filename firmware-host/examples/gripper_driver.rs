//! A gripper's driver: how a device that gelstereo does not know becomes a [`Gripper`].
//!
//! `cargo run -p gelstereo-host --example gripper_driver`
//!
//! The device here speaks lines of text over TCP: `move 20.0 50.0 0.30` (mm, mm/s, share of the force),
//! `stop` and `status`, which it answers with the width in mm, `1` while it moves, and `1` when it holds
//! something. A thread plays the device. CONTRIBUTING.md lists what a driver of this crate needs besides.
#![allow(clippy::print_stdout, reason = "it is a program")]

use gelstereo_host::gripper::line::{Line, open};
use gelstereo_host::gripper::{Gripper, GripperError, GripperStatus};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::time::{Duration, Instant};

const WIDTHS_MM: (f64, f64) = (0.0, 85.0);
const SPEEDS_MM_S: (f64, f64) = (20.0, 150.0);
/// The device answers within some milliseconds; silence for this long is a fault.
const PATIENCE: Duration = Duration::from_millis(500);

/// The driver. It holds a line to the device, and no port or thread of its own.
struct TextGripper {
    line: Box<dyn Line>,
    activated: bool,
}

impl TextGripper {
    /// Sends a request and returns the line of the answer.
    fn ask(&mut self, request: &str) -> Result<String, GripperError> {
        // What is left of an old answer must not be taken for the new one.
        self.line.discard_input()?;
        self.line.send(format!("{request}\n").as_bytes())?;
        let (start, mut answer) = (Instant::now(), Vec::new());
        while !answer.ends_with(b"\n") {
            let mut bytes = [0; 64];
            let count = self.line.receive(&mut bytes, start + PATIENCE)?;
            if count == 0 {
                let port = self.line.name().to_owned();
                return Err(GripperError::Silent { port, waited_ms: PATIENCE.as_millis() as u64 });
            }
            answer.extend_from_slice(&bytes[..count]);
        }
        Ok(String::from_utf8_lossy(&answer).trim().to_owned())
    }

    /// Sends a request that the device confirms by `ok`.
    fn order(&mut self, request: &str) -> Result<(), GripperError> {
        match self.ask(request)?.as_str() {
            "ok" => Ok(()),
            other => Err(GripperError::Device { message: format!("the answer to `{request}` is `{other}`") }),
        }
    }
}

impl Gripper for TextGripper {
    /// This device is ready at once. Others sweep their fingers; their status is moving until they are ready.
    fn activate(&mut self) -> Result<(), GripperError> {
        self.status()?;
        self.activated = true;
        Ok(())
    }

    /// Checks every number before it is sent, starts the move and returns.
    fn move_to(&mut self, width_mm: f64, speed_mm_s: f64, force: f64) -> Result<(), GripperError> {
        if !self.activated {
            return Err(GripperError::NotActivated);
        }
        if !(WIDTHS_MM.0..=WIDTHS_MM.1).contains(&width_mm) {
            return Err(GripperError::Width { width_mm, min_mm: WIDTHS_MM.0, max_mm: WIDTHS_MM.1 });
        }
        if !(SPEEDS_MM_S.0..=SPEEDS_MM_S.1).contains(&speed_mm_s) {
            let (min_mm_s, max_mm_s) = SPEEDS_MM_S;
            return Err(GripperError::Speed { speed_mm_s, min_mm_s, max_mm_s });
        }
        if !(0.0..=1.0).contains(&force) {
            return Err(GripperError::Force { force });
        }
        self.order(&format!("move {width_mm:.2} {speed_mm_s:.1} {force:.2}"))
    }

    fn stop(&mut self) -> Result<(), GripperError> {
        self.order("stop")
    }

    fn status(&mut self) -> Result<GripperStatus, GripperError> {
        let answer = self.ask("status")?;
        let words: Vec<&str> = answer.split_whitespace().collect();
        let [width, moving, holds] = words.as_slice() else {
            return Err(GripperError::Device { message: format!("`{answer}` is no status") });
        };
        let width_mm =
            width.parse().map_err(|_| GripperError::Device { message: format!("`{width}` is no width") })?;
        Ok(GripperStatus { width_mm, moving: *moving == "1", object_detected: *holds == "1" })
    }

    /// When the stop command really left: recordings hold it.
    fn sent_ns(&self) -> Option<u64> {
        self.line.sent_ns()
    }
}

/// Plays the device until the connection ends: a part of 20 mm stops its fingers.
fn play_device(listener: &TcpListener) -> std::io::Result<()> {
    let (connection, _) = listener.accept()?;
    let mut output = connection.try_clone()?;
    let (mut width_mm, mut target_mm) = (85.0_f64, 85.0_f64);
    for request in BufReader::new(connection).lines() {
        let request = request?;
        let words: Vec<&str> = request.split_whitespace().collect();
        let answer = match words.as_slice() {
            ["move", target, ..] => {
                target_mm = target.parse().unwrap_or(width_mm);
                "ok".to_owned()
            }
            ["stop"] => {
                target_mm = width_mm;
                "ok".to_owned()
            }
            ["status"] => {
                // Ten millimetres for each status, down to the part.
                let holds = width_mm <= 20.0 && target_mm < 20.0;
                width_mm += (target_mm.max(20.0) - width_mm).clamp(-10.0, 10.0);
                let moving = !holds && (width_mm - target_mm).abs() > 1e-9;
                format!("{width_mm:.2} {} {}", u8::from(moving), u8::from(holds))
            }
            _ => "what?".to_owned(),
        };
        writeln!(output, "{answer}")?;
    }
    Ok(())
}

/// Closes on the part; the statuses on the way.
fn close() -> Result<Vec<GripperStatus>, Box<dyn std::error::Error>> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let port = format!("tcp://{}", listener.local_addr()?);
    let device = std::thread::spawn(move || play_device(&listener));
    let mut statuses = Vec::new();
    {
        let mut gripper = TextGripper { line: open(&port, 115_200)?, activated: false };
        gripper.activate()?;
        gripper.move_to(10.0, 50.0, 0.3)?;
        loop {
            let status = gripper.status()?;
            statuses.push(status);
            if !status.moving {
                break;
            }
        }
        gripper.stop()?;
    }
    // The connection is closed, so the device ends.
    device.join().map_err(|_| "the device failed")??;
    Ok(statuses)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for status in close()? {
        println!("{status:?}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_fingers_stop_at_the_part() {
        let statuses = super::close().unwrap();
        let last = statuses.last().unwrap();
        assert!(last.object_detected && (last.width_mm - 20.0).abs() < 0.01);
        assert!(statuses.len() > 3 && statuses[0].moving);
    }
}
