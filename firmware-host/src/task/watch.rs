//! Limits on camera silence and on the lateness of results while something moves.

use super::TaskError;
use crate::config::{Config, TaskConfig};
use crate::report::Stage;
use std::time::Duration;

/// Whether a trigger ends a move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Guard {
    /// Yes: only the camera detects contact meanwhile.
    Triggered,
    /// No: the path is known to be free.
    Free,
}

impl Guard {
    const fn max_blind_mm(self, task: &TaskConfig) -> f64 {
        match self {
            Self::Triggered => task.max_blind_travel_mm,
            Self::Free => task.max_blind_free_travel_mm,
        }
    }
}

/// The limits in force.
pub(super) struct Watch {
    at_rest: Duration,
    /// While something moves.
    moving: Option<Duration>,
    /// From an image to its result; `None` for sources that wait for the task.
    max_late: Option<Duration>,
    is_live: bool,
}

impl Watch {
    pub(super) fn new(config: &Config) -> Self {
        let is_live = config.source.is_live();
        let period_s = 1.0 / config.source.frame_rate_hz(config.simulated.frame_rate_hz);
        let late_s = config.task.max_late_periods * period_s;
        Self {
            at_rest: Duration::from_secs_f64(config.task.frame_timeout_s),
            moving: None,
            max_late: is_live.then(|| Duration::from_secs_f64(late_s)),
            is_live,
        }
    }

    /// Something starts to move at this speed. Without images it may travel `task.max_blind_travel_mm`,
    /// or `task.max_blind_free_travel_mm` on a free path.
    pub(super) fn moves(&mut self, task: &TaskConfig, guard: Guard, speed_mm_s: f64) {
        let limit = Duration::from_secs_f64(guard.max_blind_mm(task) / speed_mm_s).min(self.at_rest);
        // The stricter limit holds for two simultaneous moves.
        self.moving = Some(self.moving.map_or(limit, |other| other.min(limit)));
    }

    /// Nothing moves any more.
    pub(super) fn rests(&mut self) {
        self.moving = None;
    }

    pub(super) const fn moving(&self) -> bool {
        self.moving.is_some()
    }

    /// Longest wait for the next stereo pair. A source that waits for the task is never silent.
    pub(super) fn patience(&self) -> Duration {
        self.moving.filter(|_| self.is_live).unwrap_or(self.at_rest)
    }

    /// Checks whether a result came in time for the present motion.
    pub(super) fn check_result(&self, stage: Stage, took: Duration) -> Result<(), TaskError> {
        match self.max_late {
            Some(limit) if self.moving() && took > limit => Err(TaskError::Late { stage, took, limit }),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::SourceConfig;
    use crate::source::stream::StreamConfig;

    fn live() -> Config {
        Config { source: SourceConfig::Stream(StreamConfig::default()), ..Config::default() }
    }

    #[test]
    fn patience_follows_from_speed_and_travel() {
        let config = live();
        let mut watch = Watch::new(&config);
        assert_eq!(watch.patience(), Duration::from_secs(2));
        watch.moves(&config.task, Guard::Free, 400.0);
        assert_eq!(watch.patience(), Duration::from_millis(300));
        watch.moves(&config.task, Guard::Triggered, 20.0);
        assert_eq!(watch.patience(), Duration::from_millis(150));
        watch.moves(&config.task, Guard::Free, 400.0);
        assert_eq!(watch.patience(), Duration::from_millis(150), "the stricter of two moves");
        watch.rests();
        assert_eq!(watch.patience(), Duration::from_secs(2));
        watch.moves(&config.task, Guard::Triggered, 0.01);
        assert_eq!(watch.patience(), Duration::from_secs(2), "never longer than at rest");
    }

    #[test]
    fn results_are_late_only_while_something_moves_and_the_source_is_live() {
        let late = Duration::from_millis(101);
        let config = live();
        let mut watch = Watch::new(&config);
        assert!(watch.check_result(Stage::Close, late).is_ok());
        watch.moves(&config.task, Guard::Triggered, 20.0);
        assert!(watch.check_result(Stage::Close, Duration::from_millis(99)).is_ok());
        let error = watch.check_result(Stage::Close, late).unwrap_err().to_string();
        assert!(error.starts_with("close: a result came 101 ms after its image"), "{error}");
        let config = Config::default();
        let mut watch = Watch::new(&config);
        watch.moves(&config.task, Guard::Triggered, 20.0);
        assert!(watch.check_result(Stage::Close, late).is_ok(), "the simulated sensor waits");
        assert_eq!(watch.patience(), Duration::from_secs(2));
    }
}
