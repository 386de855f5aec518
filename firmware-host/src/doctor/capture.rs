//! Rate and latency of a camera, measured over a short capture.

use crate::camera::{CameraConfig, CameraStatistics};
use crate::finding::Finding;
use crate::source::{CameraSource, FrameSource, Next, SourceError, StereoPair};
use std::time::{Duration, Instant};

/// Long enough for the first frame of a slow camera and some tens of frames after it.
const TRIAL: Duration = Duration::from_secs(3);
/// A camera below this fraction of the requested rate is slowed down by exposure, bus or load.
const MIN_RATE_SHARE: f64 = 0.9;

/// Captures pairs for some seconds.
pub(super) fn examine(config: &CameraConfig) -> Finding {
    const SUBJECT: &str = "capture";
    let mut source = match CameraSource::open(config) {
        Ok(source) => source,
        Err(error) => return Finding::wrong(SUBJECT, error.to_string()),
    };
    let (began, mut pair, mut last_event) = (Instant::now(), StereoPair::default(), None);
    while let Some(left) = TRIAL.checked_sub(began.elapsed()).filter(|left| !left.is_zero()) {
        match source.next_pair(left, &mut pair) {
            Ok(Next::Pair) => {}
            Ok(Next::Event(event)) => last_event = Some(event.to_string()),
            Ok(Next::End) | Err(SourceError::Timeout { .. }) => break,
            Err(error) => return Finding::wrong(SUBJECT, error.to_string()),
        }
    }
    judge(&source.statistics(), config.frame_rate_hz, last_event)
}

/// Finding from the measurement and the requested rate.
pub(super) fn judge(measured: &CameraStatistics, asked_hz: f64, last_event: Option<String>) -> Finding {
    const SUBJECT: &str = "capture";
    let last = last_event.map_or(String::new(), |event| format!("; at last: {event}"));
    let Some(rate_hz) = measured.camera_rate_hz else {
        let found = format!("{} pairs came in {} s{last}", measured.pairs, TRIAL.as_secs());
        return Finding::wrong(SUBJECT, found).with_advice("does another program use the camera?");
    };
    let ms = |value: Option<f64>| value.map_or("unknown".to_owned(), |ms| format!("{ms:.1} ms"));
    let found = format!(
        "{rate_hz:.1} of {asked_hz:.1} Hz, latency to the decoded pair p50 {}, p99 {}, {} pairs lost, {} \
        corrupt{last}",
        ms(measured.latency_p50_ms),
        ms(measured.latency_p99_ms),
        measured.dropped,
        measured.corrupt
    );
    if rate_hz < MIN_RATE_SHARE * asked_hz {
        let advice = "shorten the exposure, use format mjpg, or give the camera a USB controller of its own";
        return Finding::warn(SUBJECT, found, advice);
    }
    if measured.corrupt > 0 || measured.skewed > 0 {
        let advice = "try another cable or port; two cameras need a common trigger or a larger max_skew_ms";
        return Finding::warn(SUBJECT, found, advice);
    }
    Finding::ok(SUBJECT, found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;

    #[test]
    fn a_slow_camera_is_a_warning_and_a_silent_one_wrong() {
        let of =
            |rate_hz| CameraStatistics { pairs: 60, camera_rate_hz: rate_hz, ..CameraStatistics::default() };
        assert_eq!(judge(&of(Some(29.9)), 30.0, None).level, Level::Ok);
        assert_eq!(judge(&of(Some(15.0)), 30.0, None).level, Level::Warn);
        let silent = judge(&of(None), 30.0, Some("camera x is gone".to_owned()));
        assert!(
            silent.level == Level::Wrong && silent.found.ends_with("at last: camera x is gone"),
            "{silent}"
        );
    }
}
