//! Reports issued while sensing runs.

use super::contact::Crossing;
use super::histogram::Histogram;
use crate::notes::tracking_name;
use crate::source::SourceEvent;
use gelstereo_core::register::TrackingStatus;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Duration;

/// Median, 99th percentile and maximum of a set of durations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Quantiles {
    /// Median, to 4.4 %; absent where nothing was measured.
    pub p50_ms: Option<f64>,
    /// 99th percentile, to 4.4 %.
    pub p99_ms: Option<f64>,
    /// Maximum.
    pub max_ms: Option<f64>,
}

impl Quantiles {
    /// Quantiles of a histogram.
    #[must_use]
    pub fn of(histogram: &Histogram) -> Self {
        let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
        Self {
            p50_ms: histogram.quantile(0.5).map(ms),
            p99_ms: histogram.quantile(0.99).map(ms),
            max_ms: (histogram.total() > 0).then(|| ms(histogram.max())),
        }
    }
}

impl std::fmt::Display for Quantiles {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.p50_ms, self.p99_ms) {
            (Some(p50), Some(p99)) => write!(f, "{p50:.1} / {p99:.1} ms"),
            _ => write!(f, "not measured"),
        }
    }
}

/// Counts since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Totals {
    /// Stereo pairs taken.
    pub frames: u64,
    /// Number of pairs that could not be processed.
    pub bad_frames: u64,
    /// Pairs that the source lost or skipped.
    pub dropped: u64,
    /// Events of the source, such as lost connections, stalls and corrupt frames.
    pub source_events: u64,
}

/// Status of the last second, or at the end of the whole run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Status {
    /// Length of the interval in seconds.
    pub over_s: f64,
    /// Stereo pairs in the interval.
    pub frames: u64,
    /// Pairs per second in the interval.
    pub rate_hz: f64,
    /// Pairs that the source lost or skipped in the interval.
    pub dropped: u64,
    /// From the driver's timestamp to the result; absent where the source has no driver.
    pub latency: Quantiles,
    /// From the decoded pair to the result.
    pub compute: Quantiles,
    /// Counts since the start.
    pub totals: Totals,
    /// Messages that publishers dropped since the start because subscribers were too slow.
    pub unpublished: BTreeMap<String, u64>,
    /// Whether the rest state is learned.
    pub rest_known: bool,
    /// Whether the gel is in contact.
    pub touching: bool,
    /// Tracking status of the last pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<&'static str>,
    /// Description of the trouble, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trouble: Option<String>,
}

impl std::fmt::Display for Status {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { frames, rate_hz, dropped, latency, compute, totals, .. } = self;
        write!(
            f,
            "{frames} frames, {rate_hz:.1} Hz, latency {latency}, compute {compute} (p50 / p99), \
             {dropped} dropped ({} in all), {} bad in all",
            totals.dropped, totals.bad_frames
        )?;
        let contact = match (self.rest_known, self.touching) {
            (false, _) => "learning the rest state",
            (true, false) => "no contact",
            (true, true) => "contact",
        };
        write!(f, ", {contact}")?;
        if let Some(pose) = self.pose {
            write!(f, ", pose {pose}")?;
        }
        for (name, count) in self.unpublished.iter().filter(|&(_, &count)| count > 0) {
            write!(f, ", {count} messages not published by {name}")?;
        }
        self.trouble.iter().try_for_each(|trouble| write!(f, ", TROUBLE: {trouble}"))
    }
}

/// One report.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "report")]
pub enum Report {
    /// Sensing began.
    Started {
        /// Name of the source.
        source: String,
        /// Names of the outputs.
        outputs: Vec<String>,
    },
    /// An event of the source.
    Source(SourceEvent),
    /// The rest state was learned.
    RestLearned {
        /// Number of lattice markers.
        markers: usize,
        /// A pitch that differs from its setting, with the likely causes.
        #[serde(skip_serializing_if = "Option::is_none")]
        trouble: Option<String>,
    },
    /// The rest state is being learned again.
    RestForgotten {
        /// The reason.
        reason: &'static str,
    },
    /// Contact began or ended.
    Touch {
        /// Whether the gel is in contact now.
        touching: bool,
        /// Time on the frame source's clock.
        time_ns: u64,
    },
    /// A trigger was crossed.
    Trigger {
        /// The trigger, and whether the motion is above it now.
        #[serde(flatten)]
        crossing: Crossing,
        /// Time on the frame source's clock.
        time_ns: u64,
    },
    /// A pose was found, or the part was lost.
    Pose {
        /// Tracking status of the pose.
        tracking: &'static str,
        /// Time on the frame source's clock.
        time_ns: u64,
    },
    /// A frame could not be processed; only the first of a run is reported.
    BadFrame {
        /// The reason.
        reason: String,
        /// Time on the frame source's clock.
        time_ns: u64,
    },
    /// An output failed; sensing continues.
    OutputLost {
        /// Name of the output.
        output: String,
        /// The reason.
        reason: String,
    },
    /// Sent once per second.
    Status(Status),
    /// Sensing ended.
    Ended {
        /// Why it ended.
        reason: &'static str,
        /// Status over the whole run.
        #[serde(flatten)]
        status: Status,
    },
}

impl Report {
    /// Report of a pose's tracking status.
    #[must_use]
    pub const fn pose(tracking: TrackingStatus, time_ns: u64) -> Self {
        Self::Pose { tracking: tracking_name(tracking), time_ns }
    }

    /// Log level: `error`, `warning` or `info`.
    #[must_use]
    pub fn level(&self) -> &'static str {
        match self {
            Self::OutputLost { .. } => "error",
            Self::Source(SourceEvent::Connected { .. }) => "info",
            Self::Source(_) | Self::BadFrame { .. } => "warning",
            Self::Status(status) if status.trouble.is_some() => "warning",
            _ => "info",
        }
    }
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Started { source, outputs } if outputs.is_empty() => {
                write!(f, "sensing on {source}; results go only to this log")
            }
            Self::Started { source, outputs } => {
                write!(f, "sensing on {source}; results go to {}", outputs.join(", "))
            }
            Self::Source(event) => event.fmt(f),
            Self::RestLearned { markers, trouble } => {
                write!(f, "rest state learned: {markers} markers")?;
                trouble.iter().try_for_each(|trouble| write!(f, "; WARNING: {trouble}"))
            }
            Self::RestForgotten { reason } => write!(f, "the rest state is learned anew: {reason}"),
            Self::Touch { touching: true, .. } => write!(f, "contact begins"),
            Self::Touch { touching: false, .. } => write!(f, "contact ends"),
            Self::Trigger { crossing, .. } => {
                let side = if crossing.above { "above" } else { "below" };
                write!(f, "motion is {side} the {:?} trigger", crossing.trigger)
            }
            Self::Pose { tracking, .. } => write!(f, "pose {tracking}"),
            Self::BadFrame { reason, .. } => write!(f, "a frame cannot be sensed: {reason}"),
            Self::OutputLost { output, reason } => write!(f, "{output} stopped: {reason}"),
            Self::Status(status) => status.fmt(f),
            Self::Ended { reason, status } => write!(f, "ended ({reason}): {status}"),
        }
    }
}

/// Collects the figures of [`Status`].
#[derive(Clone, Debug, Default)]
pub struct Meter {
    latency: [Histogram; 2],
    compute: [Histogram; 2],
    frames: u64,
    dropped: u64,
    /// Counts since the start.
    pub totals: Totals,
}

/// Contribution of one pair.
#[derive(Clone, Copy, Debug)]
pub struct PairCost {
    /// From the driver's timestamp to the result.
    pub latency: Option<Duration>,
    /// From the decoded pair to the result.
    pub compute: Duration,
    /// Pairs lost before this one.
    pub dropped: u64,
    /// Whether it was processed successfully.
    pub good: bool,
}

impl Meter {
    /// Adds a pair.
    pub fn pair(&mut self, cost: &PairCost) {
        if let Some(latency) = cost.latency {
            self.latency[0].add(latency);
        }
        self.compute[0].add(cost.compute);
        self.frames += 1;
        self.dropped += cost.dropped;
        self.totals.frames += 1;
        self.totals.dropped += cost.dropped;
        self.totals.bad_frames += u64::from(!cost.good);
    }

    /// Status since the last call, `over` ago.
    pub fn interval(&mut self, over: Duration) -> Status {
        let status = Status {
            dropped: self.dropped,
            ..self.status(over, self.frames, &self.latency[0], &self.compute[0])
        };
        self.close_interval();
        status
    }

    /// Status of the whole run, `over` long.
    pub fn whole(&mut self, over: Duration) -> Status {
        self.close_interval();
        let Totals { frames, dropped, .. } = self.totals;
        Status { dropped, ..self.status(over, frames, &self.latency[1], &self.compute[1]) }
    }

    fn status(&self, over: Duration, frames: u64, latency: &Histogram, compute: &Histogram) -> Status {
        let over_s = over.as_secs_f64();
        Status {
            over_s,
            frames,
            rate_hz: if over_s > 0.0 { frames as f64 / over_s } else { 0.0 },
            latency: Quantiles::of(latency),
            compute: Quantiles::of(compute),
            totals: self.totals,
            ..Status::default()
        }
    }

    fn close_interval(&mut self) {
        for [now, all] in [&mut self.latency, &mut self.compute] {
            all.merge(now);
            now.clear();
        }
        (self.frames, self.dropped) = (0, 0);
    }
}
