//! Modbus master: one request at a time, each with its own reply.

use super::GripperError;
use super::line::Line;
use crate::codec::modbus::{ModbusError, Reply, Request, rtu, tcp};
use std::time::{Duration, Instant};

/// Number of attempts before the gripper counts as silent. One lost byte must not stop a robot.
const ATTEMPTS: u32 = 3;
/// Exceptions after which a request is repeated: acknowledge and busy.
const TRY_AGAIN: [u8; 2] = [5, 6];

/// Framing of requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Framing {
    /// Serial lines, and serial lines behind a TCP port.
    Rtu,
    /// Modbus TCP.
    Tcp,
}

/// Master for one unit on a line.
pub struct Master {
    line: Box<dyn Line>,
    framing: Framing,
    unit: u8,
    timeout: Duration,
    transaction: u16,
}

/// Reader for either framing.
enum Reader<'a> {
    Rtu(rtu::ReplyReader<'a>),
    Tcp(tcp::ReplyReader<'a>),
}

impl Master {
    /// Master for a unit on a line; `timeout` is the longest wait for one reply.
    #[must_use]
    pub fn new(line: Box<dyn Line>, framing: Framing, unit: u8, timeout: Duration) -> Self {
        Self { line, framing, unit, timeout, transaction: 0 }
    }

    /// Time at which the last bytes were sent; see [`Line::sent_ns`].
    #[must_use]
    pub fn sent_ns(&self) -> Option<u64> {
        self.line.sent_ns()
    }

    /// Sends a request and waits for its reply. Earlier input is dropped. A late reply is recognised by
    /// its transaction number; on serial lines the master waits until the line is quiet.
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

    /// Sends one request; `None` if no reply came in time.
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
            // Continuous input must not extend the wait beyond the deadline.
            if count == 0 || Instant::now() >= deadline {
                return Ok(None);
            }
        }
    }

    /// After a failure a reply may still be in transit; on a serial line only waiting separates it from
    /// the next one.
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
