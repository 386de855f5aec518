//! Byte streams to a device: serial ports and TCP connections.

use super::GripperError;
use crate::source::monotonic_ns;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

/// Connecting to a device on the robot's own network takes a few milliseconds.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
/// If a write of some twenty bytes takes longer, the receiver has stopped reading.
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);

/// Replies have some twenty bytes: 16 kB that are queued, or arrive faster than they are read, are not a
/// reply.
const MAX_DISCARDS: usize = 64;
const BABBLES: &str = "something sends without end; are baud rate and wiring right?";

/// Byte stream to a device. All errors are [`GripperError::Port`].
pub trait Line: Send {
    /// Sends all bytes.
    ///
    /// # Errors
    /// [`GripperError::Port`].
    fn send(&mut self, bytes: &[u8]) -> Result<(), GripperError>;

    /// Waits for bytes until `deadline`. Returns their number, 0 if none came.
    ///
    /// # Errors
    /// [`GripperError::Port`], also if the other side closed the line.
    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> Result<usize, GripperError>;

    /// Name for error messages.
    fn name(&self) -> &str;

    /// Time at which the last bytes were sent, nanoseconds of `CLOCK_MONOTONIC`: a serial port has
    /// drained, a TCP connection has passed them to the system. `None` for lines that do not measure it.
    fn sent_ns(&self) -> Option<u64> {
        None
    }

    /// Drops received bytes that were not read.
    ///
    /// # Errors
    /// [`GripperError::Port`].
    fn discard_input(&mut self) -> Result<(), GripperError> {
        let mut buffer = [0; 256];
        for _ in 0..MAX_DISCARDS {
            if self.receive(&mut buffer, Instant::now())? == 0 {
                return Ok(());
            }
        }
        Err(GripperError::Port { port: self.name().to_owned(), message: BABBLES.to_owned() })
    }
}

/// Opens `tcp://host:port`, or a serial port by its path, with 8 data bits, no parity and one stop bit.
///
/// Without the feature `host` there are no serial ports: the Python bindings use pyserial.
///
/// # Errors
/// [`GripperError::Port`].
pub fn open(port: &str, baud_rate: u32) -> Result<Box<dyn Line>, GripperError> {
    match port.strip_prefix("tcp://") {
        Some(address) => Ok(Box::new(TcpLine::connect(address)?)),
        #[cfg(feature = "host")]
        None => Ok(Box::new(SerialLine::open(port, baud_rate)?)),
        #[cfg(not(feature = "host"))]
        None => {
            Err(fail(port, format!("no serial ports at {baud_rate} baud here; valid is tcp://host:port")))
        }
    }
}

fn fail(port: &str, error: impl std::fmt::Display) -> GripperError {
    GripperError::Port { port: port.to_owned(), message: error.to_string() }
}

/// A serial port.
#[cfg(feature = "host")]
pub struct SerialLine {
    port: Box<dyn serialport::SerialPort>,
    name: String,
    sent_ns: Option<u64>,
}

#[cfg(feature = "host")]
impl SerialLine {
    /// Opens the port exclusively for this process.
    ///
    /// # Errors
    /// [`GripperError::Port`].
    pub fn open(path: &str, baud_rate: u32) -> Result<Self, GripperError> {
        let port = serialport::new(path, baud_rate).open().map_err(|error| fail(path, error))?;
        Ok(Self { port, name: path.to_owned(), sent_ns: None })
    }
}

#[cfg(feature = "host")]
impl Line for SerialLine {
    fn send(&mut self, bytes: &[u8]) -> Result<(), GripperError> {
        self.port.set_timeout(WRITE_TIMEOUT).map_err(|error| fail(&self.name, error))?;
        self.port.write_all(bytes).map_err(|error| fail(&self.name, error))?;
        // Wait until the last byte has left the port's buffer.
        self.port.flush().map_err(|error| fail(&self.name, error))?;
        self.sent_ns = Some(monotonic_ns());
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> Result<usize, GripperError> {
        let read = until(deadline, |wait| {
            self.port.set_timeout(wait)?;
            self.port.read(buffer)
        });
        match read {
            Ok(0) => Err(fail(&self.name, "the port is closed; was the adapter unplugged?")),
            Ok(count) => Ok(count),
            Err(error) if is_timeout(&error) => Ok(0),
            Err(error) => Err(fail(&self.name, error)),
        }
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn sent_ns(&self) -> Option<u64> {
        self.sent_ns
    }
}

/// A TCP connection.
pub struct TcpLine {
    stream: TcpStream,
    name: String,
    sent_ns: Option<u64>,
}

impl TcpLine {
    /// Connects to `host:port`.
    ///
    /// # Errors
    /// [`GripperError::Port`].
    pub fn connect(address: &str) -> Result<Self, GripperError> {
        let name = format!("tcp://{address}");
        let mut last = fail(&name, "the name has no address");
        for candidate in address.to_socket_addrs().map_err(|error| fail(&name, error))? {
            match TcpStream::connect_timeout(&candidate, CONNECT_TIMEOUT) {
                Ok(stream) => {
                    // A command must not wait for the acknowledgement of the previous one.
                    stream.set_nodelay(true).map_err(|error| fail(&name, error))?;
                    stream.set_write_timeout(Some(WRITE_TIMEOUT)).map_err(|error| fail(&name, error))?;
                    return Ok(Self { stream, name, sent_ns: None });
                }
                Err(error) => last = fail(&name, error),
            }
        }
        Err(last)
    }
}

impl Line for TcpLine {
    fn send(&mut self, bytes: &[u8]) -> Result<(), GripperError> {
        self.stream.write_all(bytes).map_err(|error| fail(&self.name, error))?;
        self.sent_ns = Some(monotonic_ns());
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> Result<usize, GripperError> {
        let read = until(deadline, |wait| {
            // A timeout of zero would block for ever.
            self.stream.set_read_timeout(Some(wait.max(Duration::from_micros(1))))?;
            self.stream.read(buffer)
        });
        match read {
            Ok(0) => Err(fail(&self.name, "the other side closed the connection")),
            Ok(count) => Ok(count),
            Err(error) if is_timeout(&error) => Ok(0),
            Err(error) => Err(fail(&self.name, error)),
        }
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn sent_ns(&self) -> Option<u64> {
        self.sent_ns
    }
}

/// Reads until `deadline` and retries after a signal, because a reply is still outstanding.
fn until(
    deadline: Instant,
    mut read: impl FnMut(Duration) -> std::io::Result<usize>,
) -> std::io::Result<usize> {
    loop {
        let wait = deadline.saturating_duration_since(Instant::now());
        match read(wait) {
            Err(error) if error.kind() == ErrorKind::Interrupted && !wait.is_zero() => {}
            result => return result,
        }
    }
}

fn is_timeout(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
