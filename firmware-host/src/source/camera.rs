//! Stereo pairs from a camera: one device with both views, or two devices paired by time.

use super::pairing::{Match, Pairing, Stamped};
use super::{
    Capture, Encoded, FrameMode, FrameSource, Gray, Next, SourceError, SourceEvent, StereoPair, epoch_ns,
    monotonic_ns,
};
use crate::camera::{
    CameraConfig, CameraHandle, CameraInfo, CameraStatistics, CaptureError, Control, ControlSettings,
    FrameDecoder, FrameFault, Mailbox, Message, PixelFormat, RawFrame, Side, Statistics, trim_jpeg,
};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A stereo camera that keeps itself streaming: a device that is unplugged, reset or silent is reopened
/// and reported as an event. Dropping it closes the devices.
#[derive(Debug)]
pub struct CameraSource {
    config: CameraConfig,
    left: CameraHandle,
    right: Option<CameraHandle>,
    mailbox: Arc<Mailbox>,
    pairing: Pairing<RawFrame>,
    /// Frames waiting to be decoded: at most one in the mode `latest`.
    ready: VecDeque<RawPair>,
    events: VecDeque<SourceEvent>,
    /// Pairs lost since the last one delivered, excluding those counted by the next pair itself.
    lost: u64,
    /// Offset from the drivers' clock to the epoch, measured once, so that setting the wall clock does
    /// not change intervals.
    epoch_offset_ns: u64,
    decoder: FrameDecoder,
    /// Images of the next pair, while those of the last one stay unchanged.
    views: [Gray; 2],
    statistics: Statistics,
}

/// A pair before decoding.
#[derive(Debug)]
struct RawPair {
    left: RawFrame,
    right: Option<RawFrame>,
    skew_ns: i64,
    dropped: u64,
}

impl CameraSource {
    /// Opens the devices, sets format, rate and controls, and starts the streams. Returns within 20
    /// seconds for each device, even if a driver hangs.
    ///
    /// # Errors
    /// [`CaptureError`].
    pub fn open(config: &CameraConfig) -> Result<Self, CaptureError> {
        config.validate()?;
        let queue_frames = config.queue_frames as usize;
        let mailbox = Arc::new(Mailbox::new(queue_frames));
        let left = CameraHandle::open(Side::Left, &config.device, config, &mailbox)?;
        let right = match &config.right_device {
            Some(device) => Some(CameraHandle::open(Side::Right, device, config, &mailbox)?),
            None => None,
        };
        Ok(Self {
            config: config.clone(),
            left,
            right,
            mailbox,
            pairing: Pairing::new(config.max_skew_ns(), queue_frames),
            ready: VecDeque::new(),
            events: VecDeque::new(),
            lost: 0,
            epoch_offset_ns: epoch_ns().saturating_sub(monotonic_ns()),
            decoder: FrameDecoder::default(),
            views: Default::default(),
            statistics: Statistics::default(),
        })
    }

    /// Configuration at opening.
    #[must_use]
    pub const fn config(&self) -> &CameraConfig {
        &self.config
    }

    /// Devices as found at opening: the stereo device, or the left and the right one.
    #[must_use]
    pub fn devices(&self) -> Vec<&CameraInfo> {
        self.handles().map(|handle| &handle.info).collect()
    }

    /// Rate, latency and losses since opening.
    #[must_use]
    pub fn statistics(&self) -> CameraStatistics {
        let mut summary = self.statistics.summary();
        summary.lost_events = self.mailbox.lost_events();
        summary
    }

    /// All controls of one device with their values. Waits for the driver, up to 12 seconds.
    ///
    /// # Errors
    /// [`CaptureError`]; a stereo device has no right side.
    pub fn controls(&self, side: Side) -> Result<Vec<Control>, CaptureError> {
        let handle = match (side, &self.right) {
            (Side::Left, _) => &self.left,
            (Side::Right, Some(right)) => right,
            (Side::Right, None) => {
                return Err(CaptureError::Setting {
                    name: "side",
                    found: "right".to_owned(),
                    valid: "left: this camera is one device".to_owned(),
                });
            }
        };
        handle.controls()
    }

    /// Sets controls of all devices, now and whenever they are reopened. Waits for the driver, up to 12
    /// seconds for each device.
    ///
    /// # Errors
    /// [`CaptureError`]. Of two devices, the left one may then be set already.
    pub fn set_controls(&self, settings: &ControlSettings) -> Result<(), CaptureError> {
        self.handles().try_for_each(|handle| handle.set(settings.clone()))
    }

    fn handles(&self) -> impl Iterator<Item = &CameraHandle> {
        std::iter::once(&self.left).chain(&self.right)
    }

    /// Processes messages of the device threads up to an event, or in the mode `every` up to a pair.
    fn receive(&mut self) -> Result<(), SourceError> {
        let latest = self.config.mode == FrameMode::Latest;
        while self.events.is_empty() && (latest || self.ready.is_empty()) {
            let Some((side, message)) = self.mailbox.take() else { break };
            match message {
                Message::Frame(frame) => self.take_frame(side, frame),
                Message::Event(event) => self.take_event(event),
                Message::Ended => {
                    let right = self.right.as_ref().filter(|_| side == Side::Right);
                    let device = right.unwrap_or(&self.left).info.to_string();
                    return Err(SourceError::Camera(CaptureError::Ended { device }));
                }
            }
        }
        Ok(())
    }

    fn take_frame(&mut self, side: Side, frame: RawFrame) {
        if self.right.is_none() {
            let dropped = frame.dropped;
            return self.offer(RawPair { left: frame, right: None, skew_ns: 0, dropped });
        }
        let stamped = Stamped { time_ns: frame.time_ns, dropped: frame.dropped, image: frame };
        if let Some(lost) = self.pairing.push(side, stamped) {
            self.mailbox.give_back(lost.image.bytes);
        }
        while let Some(found) = self.pairing.compare() {
            match found {
                Match::Pair { left, right, skew_ns, dropped } => {
                    self.offer(RawPair { left: left.image, right: Some(right.image), skew_ns, dropped });
                }
                Match::Refused { image, skew_ns, .. } => {
                    self.mailbox.give_back(image.image.bytes);
                    self.take_event(SourceEvent::Skewed { skew_ns, max_skew_ns: self.config.max_skew_ns() });
                }
            }
        }
    }

    /// Queues a pair for decoding; in the mode `latest` it replaces an older one.
    fn offer(&mut self, pair: RawPair) {
        if self.config.mode == FrameMode::Latest
            && let Some(passed_over) = self.ready.pop_front()
        {
            self.discard(passed_over);
        }
        self.ready.push_back(pair);
    }

    fn discard(&mut self, pair: RawPair) {
        self.lost += pair.dropped + 1;
        for frame in std::iter::once(pair.left).chain(pair.right) {
            self.mailbox.give_back(frame.bytes);
        }
    }

    fn take_event(&mut self, event: SourceEvent) {
        let counts = &mut self.statistics.counts;
        match &event {
            SourceEvent::Connected { .. } => {
                counts.connects += 1;
                self.statistics.restart();
            }
            SourceEvent::Disconnected { .. } => counts.disconnects += 1,
            SourceEvent::Stalled { .. } => counts.stalls += 1,
            SourceEvent::Corrupt { .. } => counts.corrupt += 1,
            SourceEvent::Sequence { .. } => counts.sequence_faults += 1,
            SourceEvent::Timestamp { .. } => counts.timestamp_faults += 1,
            SourceEvent::Skewed { .. } => counts.skewed += 1,
        }
        if matches!(event, SourceEvent::Disconnected { .. } | SourceEvent::Stalled { .. }) {
            // Waiting images will get no partner from the lost device, and pairs from before are outdated.
            for lost in self.pairing.clear() {
                self.mailbox.give_back(lost.image.bytes);
            }
            while let Some(pair) = self.ready.pop_front() {
                self.discard(pair);
            }
        }
        self.events.push_back(event);
    }

    /// Decodes a pair to the spare views.
    fn decode(&mut self, raw: &RawPair) -> Result<(), String> {
        let [left, right] = &mut self.views;
        let said = |view: &'static str| move |fault: FrameFault| format!("{view} image: {fault}");
        match &raw.right {
            None => {
                let layout = self.config.layout;
                let decoded = self.decoder.stereo(&raw.left.bytes, raw.left.shape, layout, left, right);
                decoded.map_err(|fault| fault.to_string())
            }
            Some(frame) => {
                self.decoder.single(&raw.left.bytes, raw.left.shape, left).map_err(said("left"))?;
                self.decoder.single(&frame.bytes, frame.shape, right).map_err(said("right"))
            }
        }
    }

    /// Decodes and delivers a pair, or reports why it is unusable.
    fn hand_over(&mut self, raw: RawPair, pair: &mut StereoPair) -> Next {
        let sequence = raw.left.sequence;
        if let Err(reason) = self.decode(&raw) {
            self.discard(raw);
            self.statistics.counts.corrupt += 1;
            return Next::Event(SourceEvent::Corrupt { sequence, reason });
        }
        let driver_ns =
            raw.right.as_ref().map_or(raw.left.time_ns, |right| right.time_ns.max(raw.left.time_ns));
        let received_ns = monotonic_ns();
        let dropped = raw.dropped + std::mem::take(&mut self.lost);
        self.statistics.pair(driver_ns, received_ns, dropped);
        let [left, right] = &mut self.views;
        std::mem::swap(&mut pair.left, left);
        std::mem::swap(&mut pair.right, right);
        pair.time_ns = driver_ns + self.epoch_offset_ns;
        pair.capture = Capture {
            sequence,
            driver_ns: Some(driver_ns),
            received_ns: Some(received_ns),
            dropped,
            skew_ns: raw.skew_ns,
        };
        pair.stale = false;
        self.keep_encoded(raw, &mut pair.encoded);
        Next::Pair
    }

    fn keep_encoded(&self, raw: RawPair, encoded: &mut Encoded) {
        let keep = self.config.keep_encoded && self.config.format == PixelFormat::Mjpg;
        let RawPair { left, right, .. } = raw;
        let next = match (keep, right) {
            (true, None) => Encoded::Joint { layout: self.config.layout, jpeg: trim_jpeg(left.bytes) },
            (true, Some(right)) => {
                Encoded::Separate { left_jpeg: trim_jpeg(left.bytes), right_jpeg: trim_jpeg(right.bytes) }
            }
            (false, right) => {
                self.mailbox.give_back(left.bytes);
                right.into_iter().for_each(|right| self.mailbox.give_back(right.bytes));
                Encoded::None
            }
        };
        match std::mem::replace(encoded, next) {
            Encoded::None => {}
            Encoded::Joint { jpeg, .. } => self.mailbox.give_back(jpeg),
            Encoded::Separate { left_jpeg, right_jpeg } => {
                self.mailbox.give_back(left_jpeg);
                self.mailbox.give_back(right_jpeg);
            }
        }
    }
}

impl FrameSource for CameraSource {
    fn next_pair(&mut self, timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError> {
        // A timeout beyond the range of the clock means no deadline.
        let deadline = Instant::now().checked_add(timeout);
        pair.stale = true;
        loop {
            self.receive()?;
            if let Some(event) = self.events.pop_front() {
                return Ok(Next::Event(event));
            }
            if let Some(raw) = self.ready.pop_front() {
                return Ok(self.hand_over(raw, pair));
            }
            if !self.mailbox.wait_until(deadline) {
                return Err(SourceError::Timeout { waited: timeout });
            }
        }
    }
}
