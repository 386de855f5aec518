//! Any robot behind a TCP connection, one JSON object per line; protocol in docs/robot-bridge.md.

use super::{Robot, RobotError, RobotStatus};
use crate::source::monotonic_ns;
use gelstereo_core::math::{DQuat, DVec3, Pose};
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

/// Protocol version, sent by both sides at the start.
const VERSION: u32 = 1;
/// Longest valid line.
const MAX_LINE: u64 = 4096;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);

/// A pose on the wire.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WirePose {
    position_mm: [f64; 3],
    quaternion_xyzw: [f64; 4],
}

impl From<&Pose> for WirePose {
    fn from(pose: &Pose) -> Self {
        Self { position_mm: pose.translation_mm.to_array(), quaternion_xyzw: pose.rotation.to_array() }
    }
}

impl WirePose {
    /// Normalises a rounded quaternion; rejects one that is far from a unit quaternion.
    fn pose(&self) -> Option<Pose> {
        let rotation = DQuat::from_array(self.quaternion_xyzw);
        let near_unit = (rotation.length() - 1.0).abs() < 1e-3;
        let finite = self.position_mm.iter().all(|value| value.is_finite());
        (near_unit && finite).then(|| Pose {
            rotation: rotation.normalize(),
            translation_mm: DVec3::from_array(self.position_mm),
        })
    }
}

/// A request, with a number that its response repeats.
#[derive(Serialize)]
struct Request {
    id: u64,
    #[serde(flatten)]
    body: Body,
}

#[derive(Clone, Copy, Serialize)]
#[serde(rename_all = "snake_case", tag = "request")]
enum Body {
    Hello { version: u32, watchdog_ms: u64 },
    Move { t_base_gripper: WirePose, speed_mm_s: f64 },
    Stop,
    Status,
}

/// A response.
#[derive(Deserialize)]
struct Answer {
    id: u64,
    error: Option<String>,
    version: Option<u32>,
    t_base_gripper: Option<WirePose>,
    moving: Option<bool>,
}

/// A robot behind a bridge.
pub struct BridgeRobot {
    stream: TcpStream,
    reader: BufReader<TcpStream>,
    address: String,
    timeout: Duration,
    id: u64,
    sent_ns: Option<u64>,
}

impl BridgeRobot {
    /// Connects to `host:port` and sends the watchdog time, after which the robot must stop if it
    /// receives nothing.
    ///
    /// # Errors
    /// [`RobotError`].
    pub fn connect(address: &str, timeout: Duration, watchdog: Duration) -> Result<Self, RobotError> {
        let fail = |error: std::io::Error| connection(address, error);
        let mut last = connection(address, "the name has no address");
        for candidate in address.to_socket_addrs().map_err(fail)? {
            match TcpStream::connect_timeout(&candidate, CONNECT_TIMEOUT) {
                Ok(stream) => return Self::greet(stream, address, timeout, watchdog),
                Err(error) => last = fail(error),
            }
        }
        Err(last)
    }

    fn greet(
        stream: TcpStream,
        address: &str,
        timeout: Duration,
        watchdog: Duration,
    ) -> Result<Self, RobotError> {
        let fail = |error: std::io::Error| connection(address, error);
        stream.set_nodelay(true).map_err(fail)?;
        stream.set_write_timeout(Some(timeout)).map_err(fail)?;
        let reader = BufReader::new(stream.try_clone().map_err(fail)?);
        let mut robot = Self { stream, reader, address: address.to_owned(), timeout, id: 0, sent_ns: None };
        let watchdog_ms = watchdog.as_millis() as u64;
        let answer = robot.ask(Body::Hello { version: VERSION, watchdog_ms })?;
        match answer.version {
            Some(VERSION) => Ok(robot),
            found => {
                let found = found.map_or_else(|| "none".to_owned(), |version| version.to_string());
                let message =
                    format!("the bridge speaks version {found} of the protocol; valid is {VERSION}");
                Err(RobotError::Device { message })
            }
        }
    }

    /// Sends a request and waits for its response; late responses to earlier requests are skipped.
    fn ask(&mut self, body: Body) -> Result<Answer, RobotError> {
        self.id += 1;
        let mut line = serde_json::to_string(&Request { id: self.id, body })
            .map_err(|error| RobotError::Device { message: error.to_string() })?;
        line.push('\n');
        self.stream.write_all(line.as_bytes()).map_err(|error| connection(&self.address, error))?;
        self.sent_ns = Some(monotonic_ns());
        let begun = Instant::now();
        loop {
            let answer = self.read_line(begun)?;
            let answer: Answer = serde_json::from_str(&answer).map_err(|error| RobotError::Device {
                message: format!(
                    "{:?} is not an answer of the bridge's protocol: {error}",
                    answer.trim_end()
                ),
            })?;
            if answer.id == self.id {
                return match answer.error {
                    Some(message) => Err(RobotError::Device { message }),
                    None => Ok(answer),
                };
            }
        }
    }

    fn read_line(&mut self, begun: Instant) -> Result<String, RobotError> {
        let left = self.timeout.saturating_sub(begun.elapsed());
        let silent = || RobotError::Silent {
            address: self.address.clone(),
            waited_ms: begun.elapsed().as_millis() as u64,
        };
        if left.is_zero() {
            return Err(silent());
        }
        self.stream.set_read_timeout(Some(left)).map_err(|error| connection(&self.address, error))?;
        let mut line = String::new();
        match (&mut self.reader).take(MAX_LINE).read_line(&mut line) {
            Ok(_) if line.ends_with('\n') => Ok(line),
            Ok(0) => Err(connection(&self.address, "the bridge closed the connection")),
            Ok(_) => Err(connection(&self.address, "a line does not end")),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                Err(silent())
            }
            Err(error) => Err(connection(&self.address, error)),
        }
    }
}

fn connection(address: &str, error: impl std::fmt::Display) -> RobotError {
    RobotError::Connection { address: address.to_owned(), message: error.to_string() }
}

impl Robot for BridgeRobot {
    fn move_to(&mut self, t_base_gripper: &Pose, speed_mm_s: f64) -> Result<(), RobotError> {
        if !(speed_mm_s > 0.0 && speed_mm_s.is_finite()) {
            return Err(RobotError::Speed { speed_mm_s });
        }
        self.ask(Body::Move { t_base_gripper: t_base_gripper.into(), speed_mm_s }).map(|_| ())
    }

    fn stop(&mut self) -> Result<(), RobotError> {
        self.ask(Body::Stop).map(|_| ())
    }

    fn status(&mut self) -> Result<RobotStatus, RobotError> {
        let answer = self.ask(Body::Status)?;
        let pose = answer.t_base_gripper.and_then(|pose| pose.pose());
        match (pose, answer.moving) {
            (Some(t_base_gripper), Some(moving)) => Ok(RobotStatus { t_base_gripper, moving }),
            _ => Err(RobotError::Device {
                message: "the answer to status needs t_base_gripper with a unit quaternion, and moving"
                    .to_owned(),
            }),
        }
    }

    fn sent_ns(&self) -> Option<u64> {
        self.sent_ns
    }
}
