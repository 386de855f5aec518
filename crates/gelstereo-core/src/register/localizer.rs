//! Frame-to-frame localization: follow the part, detect loss, and relocalize.

use super::observe::PatchFrame;
use super::surface::{Rung, UsualResiduals};
use super::template::Template;
use super::{Contact, Misfit, RegisterError, Registrar, Registration};
use crate::math::Pose;
use crate::params::{RegisterMethod, RegisterParams, SurfaceSearchParams};
use crate::stop::{NEVER, Stop};

/// Motion of a part between two frames, as a share of the guess's uncertainty. Tested on twenty simulated
/// trajectories in a soft gel, with motion of 0.04 mm a frame, occasional slips of 0.15 mm, and noise
/// 0.03 mm. Compared with 0.1, `surface_search` has 1.5 times as many wrong frames with 0.3, 1.3 times with
/// 0.03, and twice as many with 1.
const MOVED: f64 = 0.1;

/// How the pose was obtained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TrackingStatus {
    /// From the previous frame, by the tracking rung.
    Tracking,
    /// By a search: the first pose, or after the part was lost.
    Relocalized,
    /// The search found nothing that explains the contact. The pose is its best one, and is not tracked.
    Lost,
}

/// The pose in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// The pose, with its evidence.
    pub registration: Registration,
    /// How it was obtained.
    pub tracking: TrackingStatus,
    /// Deviation of the markers from the gel model, if evaluated.
    pub misfit: Option<Misfit>,
}

/// Localizes one part frame by frame.
///
/// Tracking needs one start, from the previous pose. With the `register.method` `surface_search` it uses
/// that method from one start, which includes the gel model; otherwise it uses `surface_close`. The prior
/// of the motion between frames is a tenth of the guess's (`register.start_sigma_deg`,
/// `register.start_sigma_mm`), so that weakly determined directions do not drift.
///
/// If the gel model explained the contact in which the part was found, a pose is accepted while its
/// [`Misfit`] is typical: as at earlier accepted poses and, at first, as expected from noise and
/// `register.advanced.outlier_share`. For independent markers a correct pose at its optimum would be rejected
/// once in a million frames. This detects a part that was rotated while out of contact, if the gel shows it;
/// a rotation with the same gel shape is undetectable.
///
/// Otherwise (not all markers given, or a gel that returns to rest within a pitch) a pose is accepted
/// while [`Registration::log_odds`] is above 0, even odds. After a rejection the part is searched with
/// `surface_search` around the last accepted pose, then around the expected one. Free directions keep
/// their value, so that noise does not make them drift.
///
/// Does not allocate once patches as large have been tracked and searched.
#[derive(Clone, Debug)]
pub struct Localizer {
    near: Registrar,
    /// By which it is tracked.
    follow: Rung,
    search: Registrar,
    expected: Pose,
    last: Option<Pose>,
    is_held: bool,
    outlier_share: f64,
    /// Whether the gel model is confirmed: it explained the contact in which the part was found.
    asks_gel: bool,
    usual: UsualResiduals,
}

impl Localizer {
    /// With these settings, for a part expected at `expected` (`t_sensor_object`).
    #[must_use]
    pub fn new(params: &RegisterParams, expected: &Pose) -> Self {
        let near = RegisterParams {
            surface_search: SurfaceSearchParams { starts: 1, ..params.surface_search.clone() },
            start_sigma_deg: MOVED * params.start_sigma_deg,
            start_sigma_mm: MOVED * params.start_sigma_mm,
            ..params.clone()
        };
        let is_search = params.method == RegisterMethod::SurfaceSearch;
        Self {
            near: Registrar::new(&near),
            follow: if is_search { Rung::Search } else { Rung::Close },
            search: Registrar::new(params),
            expected: *expected,
            last: None,
            is_held: false,
            outlier_share: params.advanced.outlier_share,
            asks_gel: false,
            usual: UsualResiduals::new(params.advanced.outlier_share),
        }
    }

    /// Sets a new expected pose and discards the last one: the gripper has released the part or taken
    /// another.
    pub fn expect(&mut self, expected: &Pose) {
        self.expected = *expected;
        self.last = None;
        self.is_held = false;
        self.asks_gel = false;
        self.usual = UsualResiduals::new(self.outlier_share);
    }

    /// The last accepted pose (`t_sensor_object`).
    #[must_use]
    pub const fn last(&self) -> Option<&Pose> {
        self.last.as_ref()
    }

    /// Localizes the part in the next frame.
    ///
    /// # Errors
    /// [`RegisterError`], for example when nothing touches the gel. The last pose is kept, and the next
    /// search starts there.
    pub fn run(&mut self, contact: &Contact<'_>, template: &Template) -> Result<Located, RegisterError> {
        self.run_unless(contact, template, NEVER)
    }

    /// As [`Self::run`], unless it is stopped; the next frame is then localized as if this one had not
    /// occurred.
    ///
    /// # Errors
    /// As [`Self::run`], and [`RegisterError::Stopped`].
    pub fn run_unless(
        &mut self,
        contact: &Contact<'_>,
        template: &Template,
        stop: Stop<'_>,
    ) -> Result<Located, RegisterError> {
        let before = (self.is_held, self.asks_gel, self.usual);
        let located = self.follow_or_search(contact, template, stop);
        if matches!(located, Err(RegisterError::Stopped)) {
            (self.is_held, self.asks_gel, self.usual) = before;
        }
        located
    }

    fn follow_or_search(
        &mut self,
        contact: &Contact<'_>,
        template: &Template,
        stop: Stop<'_>,
    ) -> Result<Located, RegisterError> {
        if let Some(last) = self.last.filter(|_| self.is_held) {
            // Out of reach counts as lost; any other error recurs in the search.
            match self.near.register_by(Some(self.follow), contact, template, &last, stop) {
                Err(RegisterError::Stopped) => return Err(RegisterError::Stopped),
                Err(_) => {}
                Ok(found) => {
                    let mut followed = self.judge(found, contact, template, TrackingStatus::Tracking);
                    if followed.tracking == TrackingStatus::Tracking {
                        // Free directions keep the uncertainty of the first guess, however long the part
                        // is tracked.
                        followed.registration.guess_sigma = self.search.params().guess_sigma();
                        hold_free(&mut followed.registration, &last);
                        return Ok(self.believe(followed));
                    }
                }
            }
        }
        self.is_held = false;
        self.search(contact, template, stop)
    }

    fn search(
        &mut self,
        contact: &Contact<'_>,
        template: &Template,
        stop: Stop<'_>,
    ) -> Result<Located, RegisterError> {
        let around = self.last.unwrap_or(self.expected);
        let first = self.search_around(&around, contact, template, stop);
        let is_found = first.as_ref().is_ok_and(|one| one.tracking == TrackingStatus::Relocalized);
        if is_found || around == self.expected {
            return first.map(|one| self.believe(one));
        }
        let expected = self.expected;
        let second = self.search_around(&expected, contact, template, stop);
        let best = match (first, second) {
            (Err(RegisterError::Stopped), _) | (_, Err(RegisterError::Stopped)) => {
                Err(RegisterError::Stopped)
            }
            (Ok(first), Ok(second)) => {
                let is_second = second.tracking == TrackingStatus::Relocalized
                    || second.registration.log_odds > first.registration.log_odds;
                Ok(if is_second { second } else { first })
            }
            (Ok(one), Err(_)) | (Err(_), Ok(one)) => Ok(one),
            (Err(error), Err(_)) => Err(error),
        };
        best.map(|one| self.believe(one))
    }

    fn search_around(
        &mut self,
        around: &Pose,
        contact: &Contact<'_>,
        template: &Template,
        stop: Stop<'_>,
    ) -> Result<Located, RegisterError> {
        let found = self.search.register_by(Some(Rung::Search), contact, template, around, stop)?;
        Ok(self.judge(found, contact, template, TrackingStatus::Relocalized))
    }

    /// The result with its status, or lost if the pose does not explain the contact.
    fn judge(
        &mut self,
        registration: Registration,
        contact: &Contact<'_>,
        template: &Template,
        tracking: TrackingStatus,
    ) -> Located {
        let asks = self.asks_gel || registration.gel_decay.is_some();
        // Most tracked poses are right; once typical residuals are known, few steps suffice to confirm one.
        let is_soon = tracking == TrackingStatus::Tracking && self.usual.is_enough();
        let usual = is_soon.then_some(&self.usual);
        let pose = &registration.t_sensor_object;
        let told = if asks { self.search.misfit(contact, template, pose, usual) } else { None };
        let is_usual = told.as_ref().is_some_and(|misfit| !self.usual.is_exceeded(misfit));
        if let Some(misfit) = &told
            && is_usual
        {
            self.asks_gel = true;
            if !is_soon {
                self.usual.learn(misfit);
            }
        }
        // An unconfirmed gel model may have wrong parameters, so the odds count too.
        let goes_by_odds = told.is_none() || !self.asks_gel;
        let is_explained = is_usual || (goes_by_odds && registration.log_odds.is_some_and(|odds| odds > 0.0));
        let tracking = if is_explained { tracking } else { TrackingStatus::Lost };
        Located { registration, tracking, misfit: told }
    }

    /// Accepts a pose for tracking, unless the part is lost.
    fn believe(&mut self, located: Located) -> Located {
        if located.tracking != TrackingStatus::Lost {
            self.last = Some(located.registration.t_sensor_object);
            self.is_held = true;
        }
        located
    }
}

/// Removes the motion since `last` along the free directions.
fn hold_free(found: &mut Registration, last: &Pose) {
    let seen = &found.observability;
    if seen.free_count() == 0 {
        return;
    }
    let frame = PatchFrame { centre_mm: seen.centre_mm, radius_mm: seen.radius_mm };
    let motion = found.t_sensor_object * last.inverse();
    let held = frame.motion(seen.determined(frame.twist(&motion))) * *last;
    found.t_sensor_object = held.normalized().unwrap_or(found.t_sensor_object);
}
