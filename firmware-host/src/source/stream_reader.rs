//! The thread behind a stream, and the queue through which it hands frames over.

use super::clock::monotonic_ns;
use super::stream::StreamConfig;
use super::{FrameMode, SourceError, SourceEvent};
use crate::codec::frame_stream::{FrameDecoder, FrameHeader, FrameStreamError, PayloadFormat};
use std::collections::VecDeque;
use std::fs::File;
use std::io::Read;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Arrivals that may wait, frames and events; the thread waits when there are more.
const MAX_WAITING: usize = 64;
/// Frames that may wait with the mode `every`: at 30 Hz an eighth of a second.
const MAX_FRAMES: usize = 4;
/// Bytes read at once: what a Linux pipe holds by default.
const CHUNK_BYTES: usize = 1 << 16;
/// Sequence numbers that jump farther than this are an event, not a count of lost frames: a minute at 60 Hz.
const MAX_GAP: u64 = 3600;
/// Pause before a FIFO is opened again, so that a producer that fails at once is not started a thousand times
/// a second.
const REOPEN_AFTER: Duration = Duration::from_millis(100);

/// A frame as it arrived.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    pub header: FrameHeader,
    pub payload: Vec<u8>,
    /// When it was complete, [`monotonic_ns`].
    pub arrived_ns: u64,
    /// Frames lost since the last one that was handed over.
    pub dropped: u64,
}

/// What the thread found.
#[derive(Clone, Debug)]
pub(super) enum Arrival {
    Frame(Frame),
    Event(SourceEvent),
    End,
}

#[derive(Debug, Default)]
struct Content {
    arrivals: VecDeque<Arrival>,
    /// Buffers for the next payloads.
    spares: Vec<Vec<u8>>,
    closed: bool,
}

/// Between the thread and the source.
#[derive(Debug, Default)]
pub(super) struct Queue {
    content: Mutex<Content>,
    changed: Condvar,
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, Content> {
        // A thread that panicked in here left whole arrivals behind.
        self.content.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next arrival, if one comes within `timeout`.
    pub fn take(&self, timeout: Duration) -> Option<Arrival> {
        let empty = |content: &mut Content| content.arrivals.is_empty();
        let waited = self.changed.wait_timeout_while(self.lock(), timeout, empty);
        let (mut content, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let arrival = content.arrivals.pop_front();
        drop(content);
        self.changed.notify_all();
        arrival
    }

    /// Gives a payload's buffer back.
    pub fn give_back(&self, buffer: Vec<u8>) {
        let mut content = self.lock();
        if content.spares.len() < MAX_FRAMES && buffer.capacity() > 0 {
            content.spares.push(buffer);
        }
    }

    /// The source is gone: the thread ends as soon as it comes back from reading.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    /// Hands an arrival over; `false` when nobody takes it any more.
    fn put(&self, mut arrival: Arrival, mode: FrameMode) -> bool {
        let mut content = self.lock();
        if let (FrameMode::Latest, Arrival::Frame(newest)) = (mode, &mut arrival) {
            let older = content.arrivals.iter().position(|waiting| matches!(waiting, Arrival::Frame(_)));
            if let Some(Arrival::Frame(older)) = older.and_then(|at| content.arrivals.remove(at)) {
                newest.dropped += older.dropped + 1;
                content.spares.push(older.payload);
            }
        }
        let is_full = |content: &mut Content| {
            let frames = content.arrivals.iter().filter(|a| matches!(a, Arrival::Frame(_))).count();
            !content.closed && (frames >= MAX_FRAMES || content.arrivals.len() >= MAX_WAITING)
        };
        let mut content = self.changed.wait_while(content, is_full).unwrap_or_else(PoisonError::into_inner);
        content.arrivals.push_back(arrival);
        let open = !content.closed;
        drop(content);
        self.changed.notify_all();
        open
    }

    fn spare(&self) -> Vec<u8> {
        self.lock().spares.pop().unwrap_or_default()
    }
}

/// Where the bytes come from.
enum Input {
    /// Opened already; the stream ends with it.
    Once(Box<dyn Read + Send>),
    /// Opened on the thread, since a FIFO is not open before it has a producer; and again after each
    /// producer.
    Fifo(PathBuf),
}

/// The thread's own.
pub(super) struct Reader {
    name: String,
    mode: FrameMode,
    queue: Arc<Queue>,
    framing: Framing,
    /// Number that the next frame should have; unknown before a producer's first one.
    expected: Option<u64>,
}

/// How frames are told apart.
enum Framing {
    Headers(Box<FrameDecoder>),
    Fixed(FixedFrames),
}

/// Frames without headers, one after the other.
struct FixedFrames {
    header: FrameHeader,
    payload: Vec<u8>,
}

impl FixedFrames {
    fn next_frame(&mut self, bytes: &mut &[u8]) -> Option<FrameHeader> {
        let missing = self.header.payload_bytes as usize - self.payload.len();
        let (taken, rest) = bytes.split_at(missing.min(bytes.len()));
        self.payload.extend_from_slice(taken);
        *bytes = rest;
        (taken.len() == missing).then(|| {
            let header = self.header;
            self.header.sequence += 1;
            header
        })
    }
}

impl Framing {
    fn new(config: &StreamConfig) -> Self {
        match config.raw_size_px {
            None => Self::Headers(Box::default()),
            Some([width_px, height_px]) => Self::Fixed(FixedFrames {
                header: FrameHeader {
                    sequence: 0,
                    captured_ns: None,
                    width_px,
                    height_px,
                    format: PayloadFormat::Grey8,
                    layout: config.layout,
                    payload_bytes: width_px * height_px,
                    payload_crc: None,
                },
                payload: Vec::new(),
            }),
        }
    }

    /// The next frame in these bytes, its payload swapped for `buffer`.
    fn next_frame(
        &mut self,
        bytes: &mut &[u8],
        buffer: impl FnOnce() -> Vec<u8>,
    ) -> Option<Result<(FrameHeader, Vec<u8>), FrameStreamError>> {
        let (header, payload) = match self {
            Self::Headers(decoder) => match decoder.next_frame(bytes)? {
                Ok(header) => {
                    let mut payload = buffer();
                    decoder.swap_payload(&mut payload);
                    (header, payload)
                }
                Err(error) => return Some(Err(error)),
            },
            Self::Fixed(frames) => {
                let header = frames.next_frame(bytes)?;
                let mut payload = buffer();
                payload.clear();
                std::mem::swap(&mut payload, &mut frames.payload);
                (header, payload)
            }
        };
        Some(Ok((header, payload)))
    }

    /// What the end of the input cut off.
    fn finish(&mut self) -> Result<(), FrameStreamError> {
        match self {
            Self::Headers(decoder) => decoder.finish(),
            Self::Fixed(frames) => {
                let found = std::mem::take(&mut frames.payload).len();
                let expected = frames.header.payload_bytes as usize;
                if found == 0 { Ok(()) } else { Err(FrameStreamError::Cut { found, expected }) }
            }
        }
    }
}

impl Reader {
    /// Reads what the configuration names.
    ///
    /// # Errors
    /// [`SourceError::Io`] when a file cannot be opened.
    pub fn spawn(config: &StreamConfig, queue: Arc<Queue>) -> Result<(), SourceError> {
        let io = |error| SourceError::Io { path: config.path.clone(), error };
        let input = if config.is_standard_input() {
            Input::Once(Box::new(std::io::stdin()))
        } else if is_fifo(&std::fs::metadata(&config.path).map_err(io)?) {
            Input::Fifo(config.path.clone())
        } else {
            Input::Once(Box::new(File::open(&config.path).map_err(io)?))
        };
        Self::start(config, queue, input)
    }

    /// Reads from `input`.
    ///
    /// # Errors
    /// [`SourceError::Device`] when the system has no more threads.
    pub fn spawn_on(
        config: &StreamConfig,
        queue: Arc<Queue>,
        input: Box<dyn Read + Send>,
    ) -> Result<(), SourceError> {
        Self::start(config, queue, Input::Once(input))
    }

    fn start(config: &StreamConfig, queue: Arc<Queue>, input: Input) -> Result<(), SourceError> {
        let mut reader = Self {
            name: config.name(),
            mode: config.mode,
            queue,
            framing: Framing::new(config),
            expected: None,
        };
        let thread = std::thread::Builder::new().name("frame stream".to_owned());
        thread
            .spawn(move || reader.run(input))
            .map(drop)
            .map_err(|error| SourceError::Device { message: format!("no thread for the stream: {error}") })
    }

    fn run(&mut self, input: Input) {
        match input {
            Input::Once(input) => {
                if self.read(input).is_some() {
                    self.queue.put(Arrival::End, self.mode);
                }
            }
            Input::Fifo(path) => while self.read_fifo(&path).is_some() {},
        }
    }

    /// One producer of a FIFO, from its start to its end; `None` when nobody listens any more.
    fn read_fifo(&mut self, path: &std::path::Path) -> Option<()> {
        let reason = match File::open(path) {
            Ok(file) => {
                self.event(SourceEvent::Connected { device: self.name.clone() })?;
                self.read(Box::new(file))?;
                "its producer closed the pipe".to_owned()
            }
            Err(error) => error.to_string(),
        };
        let retry_in_ms = REOPEN_AFTER.as_millis() as u64;
        self.event(SourceEvent::Disconnected { device: self.name.clone(), reason, retry_in_ms })?;
        std::thread::sleep(REOPEN_AFTER);
        Some(())
    }

    /// Reads to the end; `None` when nobody listens any more.
    fn read(&mut self, mut input: Box<dyn Read + Send>) -> Option<()> {
        let mut chunk = vec![0; CHUNK_BYTES];
        self.expected = None;
        loop {
            let count = match input.read(&mut chunk) {
                Ok(0) => break,
                Ok(count) => count,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                Err(error) => {
                    self.corrupt(&error)?;
                    break;
                }
            };
            let mut bytes = &chunk[..count];
            while let Some(found) = self.framing.next_frame(&mut bytes, || self.queue.spare()) {
                match found {
                    Ok((header, payload)) => self.frame(header, payload)?,
                    Err(error) => self.corrupt(&error)?,
                }
            }
        }
        if let Err(error) = self.framing.finish() {
            self.corrupt(&error)?;
        }
        Some(())
    }

    fn frame(&mut self, header: FrameHeader, payload: Vec<u8>) -> Option<()> {
        let (found, mut dropped) = (header.sequence, 0);
        if let Some(expected) = self.expected.replace(found.wrapping_add(1)) {
            match found.checked_sub(expected) {
                Some(gap) if gap <= MAX_GAP => dropped = gap,
                _ => self.event(SourceEvent::Sequence { expected, found })?,
            }
        }
        self.put(Arrival::Frame(Frame { header, payload, arrived_ns: monotonic_ns(), dropped }))
    }

    fn corrupt(&self, error: &dyn std::error::Error) -> Option<()> {
        let sequence = self.expected.unwrap_or(0);
        self.event(SourceEvent::Corrupt { sequence, reason: error.to_string() })
    }

    fn event(&self, event: SourceEvent) -> Option<()> {
        self.put(Arrival::Event(event))
    }

    fn put(&self, arrival: Arrival) -> Option<()> {
        self.queue.put(arrival, self.mode).then_some(())
    }
}

#[cfg(unix)]
fn is_fifo(metadata: &std::fs::Metadata) -> bool {
    std::os::unix::fs::FileTypeExt::is_fifo(&metadata.file_type())
}

#[cfg(not(unix))]
fn is_fifo(_: &std::fs::Metadata) -> bool {
    false
}
