//! Latency from an image to the stop command that it causes, step by step, on this computer's clock.

use crate::sense::{Histogram, Quantiles};
use crate::source::{Capture, monotonic_ns};
use serde::Serialize;
use std::time::Duration;

/// Times of one frame, nanoseconds of `CLOCK_MONOTONIC`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FrameTimes {
    /// Arrival of the image at the driver; absent where the source has no driver.
    driver_ns: Option<u64>,
    /// Arrival of the decoded pair at the task.
    received_ns: u64,
    sensed_ns: u64,
}

impl FrameTimes {
    /// Times of a pair that was just received.
    pub(super) fn received(capture: &Capture) -> Self {
        let received_ns = capture.received_ns.unwrap_or_else(monotonic_ns);
        Self { driver_ns: capture.driver_ns, received_ns, sensed_ns: received_ns }
    }

    /// Marks the pair as just processed.
    pub(super) fn sensed(&mut self) {
        self.sensed_ns = monotonic_ns();
    }

    /// Latency from the image to its result: from the driver's timestamp, or from the receipt without a
    /// driver.
    pub(super) fn image_to_sensed(&self) -> Duration {
        since(self.image_ns(), self.sensed_ns)
    }

    fn image_ns(&self) -> u64 {
        self.driver_ns.unwrap_or(self.received_ns)
    }
}

fn since(begin_ns: u64, end_ns: u64) -> Duration {
    Duration::from_nanos(end_ns.saturating_sub(begin_ns))
}

fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// One stop caused by a trigger.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StopReport {
    /// Name of the trigger: `grasp` or `insertion`.
    pub cause: &'static str,
    /// From the driver's timestamp of the image to the decoded pair; absent where the source has no driver.
    pub driver_to_received_ms: Option<f64>,
    /// From the decoded pair to the marker motion.
    pub received_to_sensed_ms: f64,
    /// From the marker motion to the last byte of the stop command on the wire.
    pub sensed_to_wire_ms: f64,
    /// From the driver's timestamp, or the decoded pair where there is none, to the last byte on the wire.
    pub image_to_wire_ms: f64,
    /// Pairs that the source lost or skipped just before this image.
    pub dropped: u64,
}

/// Latencies from images to results and to stop commands. Wall times, also in simulation.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LatencyReport {
    /// Each frame, from the driver's timestamp to the decoded pair.
    pub driver_to_received: Quantiles,
    /// Each frame, from the decoded pair to the marker motion.
    pub received_to_sensed: Quantiles,
    /// Each stop by a trigger, from the marker motion to the last byte on the wire.
    pub sensed_to_wire: Quantiles,
    /// Each stop by a trigger, from the image to the last byte on the wire.
    pub image_to_wire: Quantiles,
    /// The stops.
    pub stops: Vec<StopReport>,
}

/// Collects the figures of a report.
#[derive(Default)]
pub(super) struct LatencyMeter {
    driver_to_received: Histogram,
    received_to_sensed: Histogram,
    sensed_to_wire: Histogram,
    image_to_wire: Histogram,
    stops: Vec<StopReport>,
}

impl LatencyMeter {
    pub(super) fn frame(&mut self, times: &FrameTimes) {
        if let Some(driver_ns) = times.driver_ns {
            self.driver_to_received.add(since(driver_ns, times.received_ns));
        }
        self.received_to_sensed.add(since(times.received_ns, times.sensed_ns));
    }

    /// Adds a stop by a trigger; its last byte was on the wire at `wire_ns`.
    pub(super) fn stop(&mut self, cause: &'static str, times: &FrameTimes, wire_ns: u64, dropped: u64) {
        let sensed_to_wire = since(times.sensed_ns, wire_ns);
        let image_to_wire = since(times.image_ns(), wire_ns);
        self.sensed_to_wire.add(sensed_to_wire);
        self.image_to_wire.add(image_to_wire);
        self.stops.push(StopReport {
            cause,
            driver_to_received_ms: times.driver_ns.map(|driver_ns| ms(since(driver_ns, times.received_ns))),
            received_to_sensed_ms: ms(since(times.received_ns, times.sensed_ns)),
            sensed_to_wire_ms: ms(sensed_to_wire),
            image_to_wire_ms: ms(image_to_wire),
            dropped,
        });
    }

    pub(super) fn report(&self) -> LatencyReport {
        LatencyReport {
            driver_to_received: Quantiles::of(&self.driver_to_received),
            received_to_sensed: Quantiles::of(&self.received_to_sensed),
            sensed_to_wire: Quantiles::of(&self.sensed_to_wire),
            image_to_wire: Quantiles::of(&self.image_to_wire),
            stops: self.stops.clone(),
        }
    }
}
