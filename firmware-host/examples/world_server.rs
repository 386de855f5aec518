//! The simulated hand, part, hole and sensor as a process of its own, at the pace of the clock.
//!
//! The tests of the whole task put a camera, a gripper and a robot between this program and `gelstereo-host`.
//! The host then sees the world through its drivers alone, and this program has the truth about what
//! happened.
//!
//! ```text
//! cargo run --release --example world_server -- --config world.toml --log world.jsonl
//! ```
//!
//! Prints `listening ADDRESS`. Each connection sends lines of JSON and gets one line for each; [`Ask`] lists
//! them. After `{"ask":"frames"}` the connection carries the frame stream instead (docs/frame-stream.md). A
//! robot stops when the connection that moved it closes, as a controller does that loses its master; fingers
//! finish their move.
#![allow(clippy::print_stdout)]

use clap::Parser;
use gelstereo_core::math::{DQuat, DVec3, Pose};
use gelstereo_host::codec::frame_stream::{FrameHeader, PayloadFormat};
use gelstereo_host::config::Config;
use gelstereo_host::gripper::Gripper;
use gelstereo_host::robot::Robot;
use gelstereo_host::source::{StereoLayout, StereoPair};
use gelstereo_host::world::{Place, SimulatedGripper, SimulatedRobot, World};
use rustix::time::{ClockId, clock_gettime};
use serde::Deserialize;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::error::Error;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::time::Duration;

/// Serve the simulated world of a configuration.
#[derive(Parser)]
struct Arguments {
    /// Configuration of the cell; `[simulated]`, `[task]`, `[part]`, `[mount]` and `[rig]` are used.
    #[arg(long, value_name = "TOML")]
    config: PathBuf,
    /// Where to write what happened, one line of JSON for each command and each exposure.
    #[arg(long, value_name = "JSONL")]
    log: PathBuf,
    /// Address to listen at.
    #[arg(long, default_value = "127.0.0.1:0")]
    listen: String,
}

/// What a connection can ask.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case", tag = "ask")]
enum Ask {
    GripperMove { width_mm: f64, speed_mm_s: f64 },
    GripperStop,
    GripperStatus,
    RobotMove { position_mm: [f64; 3], quaternion_xyzw: [f64; 4], speed_mm_s: f64 },
    RobotStop,
    RobotStatus,
    Truth,
    Frames,
}

impl Ask {
    /// Name in the log; looking alone is not logged.
    const fn logged(&self) -> Option<&'static str> {
        match self {
            Self::GripperMove { .. } => Some("gripper_move"),
            Self::GripperStop => Some("gripper_stop"),
            Self::RobotMove { .. } => Some("robot_move"),
            Self::RobotStop => Some("robot_stop"),
            _ => None,
        }
    }
}

/// What connections send to the world's thread.
enum Message {
    Ask {
        ask: Ask,
        answer: Sender<Value>,
    },
    /// Wants every picture from now on.
    Watch(SyncSender<Arc<Vec<u8>>>),
    /// The connection that moved the robot has closed.
    RobotMasterLeft,
}

type Failure = Box<dyn Error>;

fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// The world, its clock and its log.
struct Server {
    world: Rc<RefCell<World>>,
    gripper: SimulatedGripper,
    robot: SimulatedRobot,
    hole_depth_mm: f64,
    log: File,
    /// The world is as it was at this moment.
    now_ns: u64,
    frame: u64,
    pair: StereoPair,
    watchers: Vec<SyncSender<Arc<Vec<u8>>>>,
}

impl Server {
    fn new(config: &Config, log: File) -> Result<Self, Failure> {
        let world = World::shared(config, Place::Holder)?;
        let (mut gripper, robot) = (SimulatedGripper(Rc::clone(&world)), SimulatedRobot(Rc::clone(&world)));
        // The peers before it have their own activation.
        gripper.activate()?;
        Ok(Self {
            world,
            gripper,
            robot,
            hole_depth_mm: config.task.insertion_depth_mm,
            log,
            now_ns: monotonic_ns(),
            frame: 0,
            pair: StereoPair::default(),
            watchers: Vec::new(),
        })
    }

    fn run(&mut self, messages: &Receiver<Message>, period_ns: u64) -> Result<(), Failure> {
        let mut due_ns = self.now_ns + period_ns;
        loop {
            let wait = Duration::from_nanos(due_ns.saturating_sub(monotonic_ns()));
            match messages.recv_timeout(wait) {
                Ok(message) => self.take(message)?,
                Err(RecvTimeoutError::Timeout) => {
                    self.expose()?;
                    // A camera that is late leaves frames out.
                    due_ns += period_ns * (1 + self.now_ns.saturating_sub(due_ns) / period_ns);
                }
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
        }
    }

    fn catch_up(&mut self) {
        let now_ns = monotonic_ns();
        self.world.borrow_mut().advance((now_ns - self.now_ns) as f64 * 1e-9);
        self.now_ns = now_ns;
    }

    fn take(&mut self, message: Message) -> Result<(), Failure> {
        self.catch_up();
        match message {
            Message::Ask { ask, answer } => {
                let done = self.answer(&ask).unwrap_or_else(|error| json!({ "error": error.to_string() }));
                if let Some(name) = ask.logged() {
                    self.log(name)?;
                }
                // Whoever asked may have gone.
                let _ = answer.send(done);
            }
            Message::Watch(watcher) => self.watchers.push(watcher),
            Message::RobotMasterLeft => {
                self.robot.stop()?;
                self.log("robot_master_left")?;
            }
        }
        Ok(())
    }

    fn answer(&mut self, ask: &Ask) -> Result<Value, Failure> {
        match *ask {
            Ask::GripperMove { width_mm, speed_mm_s } => self.gripper.move_to(width_mm, speed_mm_s, 1.0)?,
            Ask::GripperStop => self.gripper.stop()?,
            Ask::RobotMove { position_mm, quaternion_xyzw, speed_mm_s } => {
                let goal = Pose {
                    rotation: DQuat::from_array(quaternion_xyzw).normalize(),
                    translation_mm: DVec3::from_array(position_mm),
                };
                self.robot.move_to(&goal, speed_mm_s)?;
            }
            Ask::RobotStop => self.robot.stop()?,
            Ask::Truth => return self.truth(),
            Ask::GripperStatus | Ask::RobotStatus | Ask::Frames => {}
        }
        self.state()
    }

    fn state(&mut self) -> Result<Value, Failure> {
        let (gripper, robot) = (self.gripper.status()?, self.robot.status()?);
        Ok(json!({
            "width_mm": gripper.width_mm,
            "fingers_move": gripper.moving,
            "object_detected": gripper.object_detected,
            "position_mm": robot.t_base_gripper.translation_mm.to_array(),
            "quaternion_xyzw": robot.t_base_gripper.rotation.to_array(),
            "robot_moves": robot.moving,
        }))
    }

    fn truth(&self) -> Result<Value, Failure> {
        let truth = self.world.borrow().truth()?.ok_or("the configuration has no simulated sensor")?;
        Ok(json!({
            // JSON has no infinity: a part that never left its holder is a metre above the hole.
            "inserted_mm": truth.deepest_mm.max(-1e3),
            "hole_depth_mm": self.hole_depth_mm,
            "depth_mm": truth.fit.depth_mm,
            "limit_mm": truth.fit.limit_mm,
            "lateral_mm": truth.fit.lateral_mm,
            "tilt_rad": truth.fit.tilt_rad,
        }))
    }

    fn log(&mut self, event: &str) -> Result<(), Failure> {
        let mut line = self.state()?;
        line["event"] = event.into();
        line["time_ns"] = self.now_ns.into();
        line["frame"] = self.frame.into();
        writeln!(self.log, "{line}")?;
        Ok(())
    }

    fn expose(&mut self) -> Result<(), Failure> {
        self.catch_up();
        self.frame += 1;
        if !self.world.borrow_mut().picture(&mut self.pair)? {
            return Err("the configuration has no simulated sensor".into());
        }
        self.log("exposed")?;
        let frame = Arc::new(self.encoded());
        // Who has not taken the frame before loses this one, and who has gone is forgotten.
        self.watchers.retain(|watcher| {
            !matches!(
                watcher.try_send(Arc::clone(&frame)),
                Err(std::sync::mpsc::TrySendError::Disconnected(_))
            )
        });
        Ok(())
    }

    /// The pair as a frame of the frame stream, side by side.
    fn encoded(&self) -> Vec<u8> {
        let (left, right) = (&self.pair.left, &self.pair.right);
        let rows = left.pixels.chunks(left.width).zip(right.pixels.chunks(right.width));
        let payload = rows.flat_map(|(left, right)| [left, right]).collect::<Vec<_>>().concat();
        let header = FrameHeader {
            sequence: self.frame,
            captured_ns: Some(self.now_ns),
            width_px: (left.width + right.width) as u32,
            height_px: left.height as u32,
            format: PayloadFormat::Grey8,
            layout: StereoLayout::SideBySide,
            payload_bytes: payload.len() as u32,
            payload_crc: Some(crc32fast::hash(&payload)),
        };
        [header.encode().as_slice(), &payload].concat()
    }
}

/// Serves one connection until it closes.
fn connection(stream: TcpStream, messages: &Sender<Message>) -> Result<(), Failure> {
    stream.set_nodelay(true)?;
    let mut writer = stream.try_clone()?;
    let mut moved_robot = false;
    for line in BufReader::new(stream).lines() {
        // A connection that is torn down ends like one that is closed.
        let Ok(line) = line else { break };
        let ask: Ask = match serde_json::from_str(&line) {
            Ok(ask) => ask,
            Err(error) => {
                writeln!(writer, "{}", json!({ "error": error.to_string() }))?;
                continue;
            }
        };
        if matches!(ask, Ask::Frames) {
            return watch(&mut writer, messages);
        }
        moved_robot |= matches!(ask, Ask::RobotMove { .. });
        let (answer, answered) = channel();
        messages.send(Message::Ask { ask, answer })?;
        if writeln!(writer, "{}", answered.recv()?).is_err() {
            break;
        }
    }
    if moved_robot {
        messages.send(Message::RobotMasterLeft)?;
    }
    Ok(())
}

fn watch(writer: &mut TcpStream, messages: &Sender<Message>) -> Result<(), Failure> {
    let (sender, frames) = sync_channel(1);
    messages.send(Message::Watch(sender))?;
    for frame in frames {
        writer.write_all(&frame)?;
    }
    Ok(())
}

fn main() -> Result<(), Failure> {
    let arguments = Arguments::parse();
    let config = Config::load(&arguments.config)?;
    let listener = TcpListener::bind(&arguments.listen)?;
    let mut server = Server::new(&config, File::create(&arguments.log)?)?;
    println!("listening {}", listener.local_addr()?);
    let (sender, messages) = channel();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let sender = sender.clone();
            std::thread::spawn(move || {
                // A client that vanishes is what the tests are about: its error is its own end, and no more.
                let _ = connection(stream, &sender);
            });
        }
    });
    server.run(&messages, (1e9 / config.simulated.frame_rate_hz) as u64)
}
