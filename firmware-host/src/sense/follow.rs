//! Decides when the part is localized during contact.

use crate::config::{Config, LocalizeWhen};
use crate::sensing::Action;
use gelstereo_core::frames::WidthError;
use gelstereo_core::math::Pose;
use gelstereo_core::register::TrackingStatus;

/// Schedules localizations. The start of contact triggers a search around the expected pose. Every later
/// frame tracks the part; after a loss, a search runs at most once per pause.
#[derive(Clone, Debug)]
pub struct Follower {
    when: LocalizeWhen,
    expected: Pose,
    pause_ns: u64,
    in_contact: bool,
    /// Time of the last search that found nothing.
    lost_at_ns: Option<u64>,
    tracking: Option<TrackingStatus>,
}

impl Follower {
    /// Starts without contact.
    ///
    /// # Errors
    /// [`WidthError`] when the mount cannot reach the grasp width.
    pub fn new(config: &Config) -> Result<Self, WidthError> {
        let settings = &config.sense;
        let expected = match settings.t_sensor_object {
            Some(pose) => pose.pose(),
            None => {
                let t_gripper_sensor = config.mount.t_gripper_sensor(settings.grasp_width_mm)?;
                t_gripper_sensor.inverse() * config.expected_t_gripper_object()
            }
        };
        Ok(Self {
            when: settings.localize,
            expected,
            pause_ns: (settings.search_pause_s * 1e9) as u64,
            in_contact: false,
            lost_at_ns: None,
            tracking: None,
        })
    }

    /// Tracking status of the last pose; `None` without contact.
    #[must_use]
    pub const fn tracking(&self) -> Option<TrackingStatus> {
        self.tracking
    }

    /// Pipeline actions for the frame at this time.
    pub fn actions(&mut self, touching: bool, time_ns: u64) -> Vec<Action> {
        if !touching || self.when == LocalizeWhen::Never {
            self.let_go();
            return Vec::new();
        }
        let begins = !std::mem::replace(&mut self.in_contact, true);
        let pauses = self.lost_at_ns.is_some_and(|at| time_ns.saturating_sub(at) < self.pause_ns);
        match (begins, pauses) {
            (true, _) => vec![Action::expect(&self.expected), Action::Follow],
            (false, true) => Vec::new(),
            (false, false) => vec![Action::Follow],
        }
    }

    /// Takes the result of [`Action::Follow`]; `None` means no pose at all. Returns whether the tracking
    /// status changed.
    pub fn take(&mut self, tracking: Option<TrackingStatus>, time_ns: u64) -> bool {
        let is_lost = matches!(tracking, None | Some(TrackingStatus::Lost));
        self.lost_at_ns = is_lost.then_some(time_ns);
        let tracking = tracking.unwrap_or(TrackingStatus::Lost);
        self.tracking.replace(tracking) != Some(tracking)
    }

    /// Ends contact: nothing touches the gel.
    pub const fn let_go(&mut self) {
        self.in_contact = false;
        self.lost_at_ns = None;
        self.tracking = None;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const FRAME_NS: u64 = 33_000_000;

    #[test]
    fn a_lost_part_is_searched_after_a_pause_and_anew_at_each_contact() {
        let mut follower = Follower::new(&Config::default()).unwrap();
        assert!(follower.actions(false, 0).is_empty());
        assert!(matches!(follower.actions(true, FRAME_NS)[..], [Action::Expect { .. }, Action::Follow]));
        assert!(follower.take(Some(TrackingStatus::Relocalized), FRAME_NS));
        assert_eq!(follower.actions(true, 2 * FRAME_NS), [Action::Follow]);
        assert!(follower.take(Some(TrackingStatus::Lost), 2 * FRAME_NS));
        let asked: Vec<u64> = (3..40).filter(|&k| !follower.actions(true, k * FRAME_NS).is_empty()).collect();
        assert_eq!(asked.first(), Some(&18), "half a second after the loss");
        assert!(!follower.take(None, 18 * FRAME_NS), "still lost");
        assert!(follower.actions(false, 41 * FRAME_NS).is_empty());
        assert_eq!(follower.tracking(), None);
        assert_eq!(follower.actions(true, 42 * FRAME_NS).len(), 2);
    }
}
