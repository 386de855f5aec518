//! Stereo pairs from a pipe: standard input, a FIFO or a file.
//!
//! A thread reads and decodes the stream, so that a producer that stalls or dies never blocks the
//! reader. Its results wait in a short queue.

use super::clock::monotonic_ns;
use super::jpeg::JpegDecoder;
use super::stream_reader::{Arrival, Frame, Queue, Reader};
use super::{
    Capture, Encoded, FrameMode, FrameSource, Gray, Next, SourceError, SourceEvent, StereoLayout, StereoPair,
};
use crate::codec::frame_stream::PayloadFormat;
use gelstereo_core::image::GrayView;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Path that stands for standard input.
pub const STANDARD_INPUT: &str = "-";

/// A stream of frames through a pipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StreamConfig {
    /// A FIFO or a file, or `-` for standard input. A FIFO is opened again when its producer has gone.
    /// Default: `-`. Set it to your FIFO.
    pub path: PathBuf,
    /// Which frames are handed over: `latest` for a camera, `every` for a file or a pipe that can wait.
    /// Default: `latest`. Change it to `every` where no frame may be passed over.
    pub mode: FrameMode,
    /// Width and height in pixels of frames without headers, both views together: grey bytes and nothing
    /// else. Valid: 1 to 16384 px, an even width. Default: none, the frames have headers. Set it for
    /// producers that write plain pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub raw_size_px: Option<[u32; 2]>,
    /// Where both views stand in frames without headers; a header says it itself. Default: `side_by_side`.
    /// Change it to your camera's.
    pub layout: StereoLayout,
    /// Rate of frames without headers and of frames whose header has no time, for their times: frame i is at
    /// i / rate. Valid: 0.1 to 1000 Hz. Default: none, the moment of arrival is a frame's time. Set it where
    /// frames come at another pace than they were taken.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_rate_hz: Option<f64>,
    /// A producer that sends nothing for so long is reported as stalled. Valid: 10 to 3600000 ms. Default:
    /// `2000` ms. Raise it for producers that pause.
    pub stall_timeout_ms: u64,
}

impl Default for StreamConfig {
    fn default() -> Self {
        Self {
            path: PathBuf::from(STANDARD_INPUT),
            mode: FrameMode::default(),
            raw_size_px: None,
            layout: StereoLayout::default(),
            frame_rate_hz: None,
            stall_timeout_ms: 2000,
        }
    }
}

impl StreamConfig {
    /// Whether the stream comes from standard input.
    #[must_use]
    pub fn is_standard_input(&self) -> bool {
        self.path == Path::new(STANDARD_INPUT)
    }

    /// Name of the stream in events.
    #[must_use]
    pub fn name(&self) -> String {
        if self.is_standard_input() { "standard input".to_owned() } else { self.path.display().to_string() }
    }
}

/// Stereo pairs from a stream.
#[derive(Debug)]
pub struct StreamSource {
    config: StreamConfig,
    queue: Arc<Queue>,
    jpeg: JpegDecoder,
    /// Decoded JPEG image with both views.
    joint: Gray,
    /// Images of the next pair, until they are known to be valid.
    views: [Gray; 2],
    /// Frames lost since the last pair.
    lost: u64,
    /// Offset from the capture clock to the clock of a pair's time: the epoch for a live stream, as for
    /// a camera. It is 0 for a stream that can wait, so that its times are reproducible.
    offset_ns: u64,
    heard: Instant,
    /// Duration of silence until the next report.
    patience: Duration,
    ended: bool,
}

impl Drop for StreamSource {
    fn drop(&mut self) {
        self.queue.close();
    }
}

impl StreamSource {
    /// Opens the file or FIFO on its own thread, so that this call returns at once.
    ///
    /// # Errors
    /// [`SourceError::Io`] if the file does not exist.
    pub fn open(config: &StreamConfig) -> Result<Self, SourceError> {
        let queue = Arc::new(Queue::default());
        Reader::spawn(config, Arc::clone(&queue))?;
        Ok(Self::new(config, queue))
    }

    /// Reads from `input`; its end is the end of the source.
    ///
    /// # Errors
    /// [`SourceError::Device`] if the system cannot create a thread.
    pub fn from_reader(
        config: &StreamConfig,
        input: Box<dyn std::io::Read + Send>,
    ) -> Result<Self, SourceError> {
        let queue = Arc::new(Queue::default());
        Reader::spawn_on(config, Arc::clone(&queue), input)?;
        Ok(Self::new(config, queue))
    }

    fn new(config: &StreamConfig, queue: Arc<Queue>) -> Self {
        Self {
            queue,
            jpeg: JpegDecoder::default(),
            joint: Gray::default(),
            views: Default::default(),
            lost: 0,
            offset_ns: if config.mode == FrameMode::Latest { epoch_offset_ns() } else { 0 },
            heard: Instant::now(),
            patience: Duration::from_millis(config.stall_timeout_ms),
            ended: false,
            config: config.clone(),
        }
    }

    fn take(&mut self, arrival: Arrival, pair: &mut StereoPair) -> Next {
        self.heard = Instant::now();
        self.patience = Duration::from_millis(self.config.stall_timeout_ms);
        match arrival {
            Arrival::Event(event) => Next::Event(event),
            Arrival::Frame(frame) => {
                self.lost += frame.dropped;
                self.hand_over(frame, pair)
            }
            Arrival::End => {
                self.ended = true;
                Next::End
            }
        }
    }

    fn hand_over(&mut self, frame: Frame, pair: &mut StereoPair) -> Next {
        let sequence = frame.header.sequence;
        if let Err(reason) = self.decode(&frame) {
            self.queue.give_back(frame.payload);
            self.lost += 1;
            return Next::Event(SourceEvent::Corrupt { sequence, reason });
        }
        let received_ns = monotonic_ns();
        let [left, right] = &mut self.views;
        std::mem::swap(&mut pair.left, left);
        std::mem::swap(&mut pair.right, right);
        let by_rate = self.config.frame_rate_hz.map(|rate_hz| (sequence as f64 * 1e9 / rate_hz) as u64);
        let captured_ns = frame.header.captured_ns;
        let moment_ns = captured_ns.unwrap_or(frame.arrived_ns).saturating_add(self.offset_ns);
        pair.time_ns = captured_ns.map_or(by_rate, |_| None).unwrap_or(moment_ns);
        pair.capture = Capture {
            sequence,
            driver_ns: captured_ns,
            // A stream with times computed from the rate is bit-identical whenever it is read.
            received_ns: by_rate.is_none().then_some(received_ns),
            dropped: std::mem::take(&mut self.lost),
            skew_ns: 0,
        };
        pair.stale = false;
        let spent = match frame.header.format {
            PayloadFormat::Jpeg => {
                let next = Encoded::Joint { layout: frame.header.layout, jpeg: frame.payload };
                match std::mem::replace(&mut pair.encoded, next) {
                    Encoded::Joint { jpeg, .. } => jpeg,
                    _ => Vec::new(),
                }
            }
            PayloadFormat::Grey8 => {
                pair.encoded = Encoded::None;
                frame.payload
            }
        };
        self.queue.give_back(spent);
        Next::Pair
    }

    /// Decodes both views of a frame into the spare images.
    fn decode(&mut self, frame: &Frame) -> Result<(), String> {
        let header = &frame.header;
        let size = (header.width_px as usize, header.height_px as usize);
        let joint = match header.format {
            PayloadFormat::Grey8 => GrayView::new(&frame.payload, size.0, size.1, size.0),
            PayloadFormat::Jpeg => {
                let decoded = self.jpeg.decode(&frame.payload, &mut self.joint);
                decoded.map_err(|error| error.to_string())?;
                let found = (self.joint.width, self.joint.height);
                if found != size {
                    let (found, said) = (format!("{found:?}"), format!("{size:?}"));
                    return Err(format!("the JPEG image is {found} pixels, but its header says {said}"));
                }
                self.joint.view()
            }
        };
        let joint = joint.map_err(|error| error.to_string())?;
        let [left, right] = &mut self.views;
        header.layout.split(joint, left, right).map_err(|error| error.to_string())
    }

    /// Reports long silence; each further report waits for twice the duration.
    fn stalled(&mut self) -> Option<SourceEvent> {
        let silent = self.heard.elapsed();
        (silent >= self.patience).then(|| {
            self.patience = silent * 2;
            let silent_ms = silent.as_millis().min(u128::from(u64::MAX)) as u64;
            SourceEvent::Stalled { device: self.config.name(), silent_ms }
        })
    }
}

/// Wall clock minus capture clock, measured once, so that setting the wall clock does not change intervals.
fn epoch_offset_ns() -> u64 {
    let epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(epoch.as_nanos()).unwrap_or(u64::MAX).saturating_sub(monotonic_ns())
}

impl FrameSource for StreamSource {
    fn next_pair(&mut self, timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError> {
        if self.ended {
            return Ok(Next::End);
        }
        pair.stale = true;
        let asked = Instant::now();
        loop {
            let left = timeout.saturating_sub(asked.elapsed());
            let until_stall = self.patience.saturating_sub(self.heard.elapsed());
            if let Some(arrival) = self.queue.take(left.min(until_stall)) {
                return Ok(self.take(arrival, pair));
            } else if let Some(event) = self.stalled() {
                return Ok(Next::Event(event));
            } else if asked.elapsed() >= timeout {
                return Err(SourceError::Timeout { waited: timeout });
            }
        }
    }
}
