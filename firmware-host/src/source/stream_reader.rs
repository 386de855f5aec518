//! Reader thread of a stream, and its queue of frames.

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

/// Largest number of waiting frames and events; beyond it the thread waits.
const MAX_WAITING: usize = 64;
/// Largest number of waiting frames in the mode `every`: an eighth of a second at 30 Hz.
const MAX_FRAMES: usize = 4;
/// Bytes per read: the default capacity of a Linux pipe.
const CHUNK_BYTES: usize = 1 << 16;
/// Largest jump of a sequence number counted as lost frames: a minute at 60 Hz. A larger one is an event.
const MAX_GAP: u64 = 3600;
/// Pause before a FIFO is reopened, so that a producer that fails at once is not restarted a thousand
/// times per second.
const REOPEN_AFTER: Duration = Duration::from_millis(100);

/// A received frame.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    pub header: FrameHeader,
    pub payload: Vec<u8>,
    /// Time of complete arrival, [`monotonic_ns`].
    pub arrived_ns: u64,
    /// Frames lost since the last one delivered.
    pub dropped: u64,
}

/// Frame or event from the thread.
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

/// Queue between the thread and the source.
#[derive(Debug, Default)]
pub(super) struct Queue {
    content: Mutex<Content>,
    changed: Condvar,
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, Content> {
        // A panic while the lock was held leaves only complete arrivals.
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

    /// Returns the buffer of a payload for reuse.
    pub fn give_back(&self, buffer: Vec<u8>) {
        let mut content = self.lock();
        if content.spares.len() < MAX_FRAMES && buffer.capacity() > 0 {
            content.spares.push(buffer);
        }
    }

    /// The source was dropped: the thread ends after its current read.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    /// Adds an arrival; `false` if the source was dropped.
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

/// Input of the thread.
enum Input {
    /// Already open; its end ends the stream.
    Once(Box<dyn Read + Send>),
    /// Opened on the thread, because opening a FIFO blocks until it has a producer; reopened after each
    /// producer.
    Fifo(PathBuf),
}

/// State of the thread.
pub(super) struct Reader {
    name: String,
    mode: FrameMode,
    queue: Arc<Queue>,
    framing: Framing,
    /// Expected number of the next frame; unknown before a producer's first one.
    expected: Option<u64>,
}

/// Method to find frame boundaries.
enum Framing {
    Headers(Box<FrameDecoder>),
    Fixed(FixedFrames),
}

/// Consecutive frames without headers.
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

    /// The next frame in these bytes; its payload is swapped for `buffer`.
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

    /// Reports a frame truncated by the end of the input.
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
    /// Starts a thread that reads the configured input.
    ///
    /// # Errors
    /// [`SourceError::Io`] if a file cannot be opened.
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

    /// Starts a thread that reads from `input`.
    ///
    /// # Errors
    /// [`SourceError::Device`] if the system cannot create a thread.
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

    /// Reads one producer of a FIFO from start to end; `None` if the source was dropped.
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

    /// Reads to the end; `None` if the source was dropped.
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
