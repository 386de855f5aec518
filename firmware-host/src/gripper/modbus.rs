//! A Modbus master: one request at a time, each with its own reply.

use super::GripperError;
use super::line::Line;
use crate::codec::modbus::{ModbusError, Reply, Request, rtu, tcp};
use std::time::{Duration, Instant};

/// A request is sent so often before the gripper counts as silent. One lost byte must not stop a robot.
const ATTEMPTS: u32 = 3;
/// Exceptions that ask to try again: the device acknowledges, or is busy.
const TRY_AGAIN: [u8; 2] = [5, 6];

/// How requests are framed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Framing {
    /// Serial lines, and serial lines behind a TCP port.
    Rtu,
    /// Modbus TCP.
    Tcp,
}

/// The master on a line to one unit.
pub struct Master {
    line: Box<dyn Line>,
    framing: Framing,
    unit: u8,
    timeout: Duration,
    transaction: u16,
}

/// A reader of either framing.
enum Reader<'a> {
    Rtu(rtu::ReplyReader<'a>),
    Tcp(tcp::ReplyReader<'a>),
}

impl Master {
    /// For a unit on a line; `timeout` is what one reply may take.
    #[must_use]
    pub fn new(line: Box<dyn Line>, framing: Framing, unit: u8, timeout: Duration) -> Self {
        Self { line, framing, unit, timeout, transaction: 0 }
    }

    /// When the last bytes were sent; see [`Line::sent_ns`].
    #[must_use]
    pub fn sent_ns(&self) -> Option<u64> {
        self.line.sent_ns()
    }

    /// Sends a request and waits for its reply. What came before is dropped; a late reply is told apart by its
    /// transaction number, or on serial lines by waiting until the line is quiet.
    ///
    /// # Errors
    /// [`GripperError::Silent`], [`GripperError::Port`] or [`GripperError::Device`].
    pub fn ask(&mut self, request: Request<'_>) -> Result<Reply, GripperError> {
        let begun = Instant::now();
        let mut last = None;
        for _ in 0..ATTEMPTS {
            match self.attempt(request)? {
                Some(Ok(reply)) => return Ok(reply),
                Some(Err(error @ ModbusError::Exception { code, .. })) if !TRY_AGAIN.contains(&code) => {
                    return Err(device(&error));
                }
                Some(Err(error @ ModbusError::Count { .. })) => return Err(device(&error)),
                Some(Err(error)) => last = Some(error),
                None => {}
            }
            self.wait_for_quiet()?;
        }
        let waited_ms = begun.elapsed().as_millis() as u64;
        Err(last.map_or_else(
            || GripperError::Silent { port: self.line.name().to_owned(), waited_ms },
            |error| device(&error),
        ))
    }

    /// Reads registers.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub fn read<const N: usize>(&mut self, request: Request<'_>) -> Result<[u16; N], GripperError> {
        match self.ask(request)? {
            Reply::Registers(values) => values.try_into().map_err(|_| wrong_reply()),
            Reply::Written => Err(wrong_reply()),
        }
    }

    /// One request; nothing when no reply came in time.
    fn attempt(&mut self, request: Request<'_>) -> Result<Option<Result<Reply, ModbusError>>, GripperError> {
        self.line.discard_input()?;
        self.transaction = self.transaction.wrapping_add(1);
        let frame = match self.framing {
            Framing::Rtu => rtu::encode(self.unit, &request),
            Framing::Tcp => tcp::encode(self.transaction, self.unit, &request),
        };
        let mut reader = match self.framing {
            Framing::Rtu => Reader::Rtu(rtu::ReplyReader::new(self.unit, request)),
            Framing::Tcp => Reader::Tcp(tcp::ReplyReader::new(self.transaction, self.unit, request)),
        };
        self.line.send(&frame.map_err(|error| device(&error))?)?;
        let deadline = Instant::now() + self.timeout;
        let mut buffer = [0; rtu::MAX_FRAME];
        loop {
            let count = self.line.receive(&mut buffer, deadline)?;
            let reply = match &mut reader {
                Reader::Rtu(reader) => reader.push(&buffer[..count]),
                Reader::Tcp(reader) => reader.push(&buffer[..count]),
            };
            if reply.is_some() {
                return Ok(reply);
            }
            // A line that babbles must not hold the request up beyond its time.
            if count == 0 || Instant::now() >= deadline {
                return Ok(None);
            }
        }
    }

    /// After a failure a reply may still be under way; on a serial line nothing but time tells it from the next one.
    fn wait_for_quiet(&mut self) -> Result<(), GripperError> {
        if self.framing == Framing::Rtu {
            let (mut buffer, begun) = ([0; rtu::MAX_FRAME], Instant::now());
            while begun.elapsed() < self.timeout
                && self.line.receive(&mut buffer, Instant::now() + self.timeout)? > 0
            {}
        }
        Ok(())
    }
}

fn device(error: &ModbusError) -> GripperError {
    GripperError::Device { message: error.to_string() }
}

fn wrong_reply() -> GripperError {
    GripperError::Device {
        message: "the reply has another number of registers than was asked for".to_owned(),
    }
}
