//! The robot bridge against the example program that users start from.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::{DQuat, DVec3, Pose};
use gelstereo_host::robot::{BridgeRobot, Robot, RobotError};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

struct Bridge {
    child: Child,
    /// Kept open: the example writes to it when it stops the robot.
    _output: BufReader<ChildStdout>,
    address: String,
}

impl Drop for Bridge {
    fn drop(&mut self) {
        let _ = (self.child.kill(), self.child.wait());
    }
}

/// The example on a free port; `None` where there is no Python.
fn example() -> Option<Bridge> {
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let port = address.rsplit_once(':').unwrap().1.to_owned();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/robot_bridge.py");
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let Ok(mut child) = Command::new(python).args([script, &port]).stdout(Stdio::piped()).spawn() else {
        eprintln!("skipped: there is no python3");
        return None;
    };
    let mut line = String::new();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    output.read_line(&mut line).unwrap();
    assert!(line.starts_with("listening"), "{line}");
    Some(Bridge { child, _output: output, address })
}

fn connect(bridge: &Bridge, watchdog_ms: u64) -> BridgeRobot {
    let (timeout, watchdog) = (Duration::from_secs(5), Duration::from_millis(watchdog_ms));
    BridgeRobot::connect(&bridge.address, timeout, watchdog).unwrap()
}

#[test]
fn the_example_moves_stops_and_says_where_it_is() {
    let Some(bridge) = example() else { return };
    let mut robot = connect(&bridge, 5000);
    let start = robot.status().unwrap();
    assert!(!start.moving);
    let goal =
        Pose { rotation: DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0), translation_mm: DVec3::new(30.0, 0.0, 200.0) };
    robot.move_to(&goal, 300.0).unwrap();
    assert!(robot.status().unwrap().moving);
    let deadline = Instant::now() + Duration::from_secs(10);
    while robot.status().unwrap().moving {
        assert!(Instant::now() < deadline);
        std::thread::sleep(Duration::from_millis(5));
    }
    let there = robot.status().unwrap().t_base_gripper;
    assert!((there.translation_mm - goal.translation_mm).length() < 1e-9);
    robot.move_to(&start.t_base_gripper, 1.0).unwrap();
    robot.stop().unwrap();
    assert!(!robot.status().unwrap().moving);
    assert!(matches!(robot.move_to(&goal, 0.0), Err(RobotError::Speed { .. })));
}

/// The host goes away without a word, as when it is killed: the next one finds the robot at rest.
#[test]
fn the_example_stops_when_the_host_vanishes_or_is_silent() {
    let Some(bridge) = example() else { return };
    let far =
        Pose { rotation: DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0), translation_mm: DVec3::new(1e4, 0.0, 200.0) };
    let mut robot = connect(&bridge, 5000);
    robot.move_to(&far, 10.0).unwrap();
    drop(robot);
    let mut robot = connect(&bridge, 200);
    assert!(!robot.status().unwrap().moving, "the connection was closed");
    robot.move_to(&far, 10.0).unwrap();
    std::thread::sleep(Duration::from_millis(600));
    assert!(
        matches!(robot.status(), Err(RobotError::Connection { .. })),
        "the watchdog closed the connection"
    );
    assert!(!connect(&bridge, 5000).status().unwrap().moving);
}

/// What a bridge may answer wrongly, and what is said of it.
#[test]
fn wrong_answers_are_errors_in_words() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let answers = [
        ("{\"id\":1,\"version\":2}", "speaks version 2 of the protocol; valid is 1"),
        ("{\"id\":1,\"error\":\"protective stop\"}", "robot: protective stop"),
        ("hello", "is not an answer of the bridge's protocol"),
    ];
    std::thread::spawn(move || {
        for (answer, _) in answers {
            let (mut stream, _) = listener.accept().unwrap();
            // The answer to an earlier request comes first and is passed over.
            writeln!(stream, "{{\"id\":0}}\n{answer}").ok();
            let mut line = String::new();
            BufReader::new(stream).read_line(&mut line).ok();
        }
    });
    for (answer, words) in answers {
        let result = BridgeRobot::connect(&address, Duration::from_secs(5), Duration::from_secs(5));
        let error = result.err().unwrap().to_string();
        assert!(error.contains(words), "{answer}: {error}");
    }
}
