//! Localization from frame to frame: follow, notice that the part is lost, find it again.

use super::observe::PatchFrame;
use super::surface::UsualResiduals;
use super::template::Template;
use super::{Contact, Misfit, RegisterError, Registrar, Registration};
use crate::math::Pose;
use crate::params::{RegisterMethod, RegisterParams};
use crate::stop::{NEVER, Stop};

/// How far a part moves between two frames, over how far the guess may be off. On twenty ways in a soft gel, where it moves
/// by 0.04 mm a frame and slips by 0.15 mm at times, `surface_search` leaves 1.5 times as many frames wrong with 0.3, 1.3
/// times with 0.03, and twice as many with 1 (simulated, noise 0.03 mm).
const MOVED: f64 = 0.1;

/// How a localizer came to a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TrackingStatus {
    /// From the frame before, by the rung that follows.
    Tracking,
    /// By a search: the first pose, or the part again after it was lost.
    Relocalized,
    /// The search found nothing that explains the contact. The pose is its best one, and is not followed.
    Lost,
}

/// The pose in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// The pose, with its evidence.
    pub registration: Registration,
    /// How it was come by.
    pub tracking: TrackingStatus,
    /// How far the markers are from what the gel does there, where it was asked.
    pub misfit: Option<Misfit>,
}

/// Localizes one part frame by frame.
///
/// From the pose before, a rung that follows needs one start. With the `register.method` `surface_search` it is that one,
/// from the one start, which asks the gel; with `surface_track` that one, and `surface_close` if it fails; otherwise
/// `surface_close`. A part is said to move from frame to frame by a tenth of what a guess may be off by
/// (`register.start_sigma_deg`, `register.start_sigma_mm`): what a contact determines weakly does not wander.
///
/// Where the gel explained the contact in which the part was found, a pose is believed while its [`Misfit`] is as usual:
/// as at poses that were believed before and, at first, as noise and `register.outlier_share` would have it. Were markers
/// independent, a right pose at its peak would be doubted once in a million frames. That finds a part that was turned
/// while nothing touched it, if the gel shows it; a turn after which the gel looks the same cannot be told. Elsewhere (not
/// all markers given, a gel that comes back to rest within a pitch) a pose is believed while [`Registration::log_odds`] is
/// above 0, even odds. Otherwise the part is searched by `surface_search`, around the last pose that was believed and, if
/// that finds nothing either, around where it is expected. What the contact leaves free stays as it was, so that noise
/// does not make it wander.
///
/// Allocates nothing once patches as large have been followed and searched.
#[derive(Clone, Debug)]
pub struct Localizer {
    /// Those that follow, the quickest first.
    follow: [Option<Registrar>; 2],
    search: Registrar,
    expected: Pose,
    last: Option<Pose>,
    is_held: bool,
    outlier_share: f64,
    /// Whether the gel is as it is said to be: it explained what was found.
    asks_gel: bool,
    usual: UsualResiduals,
}

impl Localizer {
    /// With these settings, for a part that is expected at `expected` (`t_sensor_object`).
    #[must_use]
    pub fn new(params: &RegisterParams, expected: &Pose) -> Self {
        use RegisterMethod::{SurfaceClose, SurfaceSearch, SurfaceTrack};
        let near = RegisterParams {
            starts: 1,
            start_sigma_deg: MOVED * params.start_sigma_deg,
            start_sigma_mm: MOVED * params.start_sigma_mm,
            ..params.clone()
        };
        let rung = |method| Some(Registrar::new(&RegisterParams { method, ..near.clone() }));
        let follow = match params.method {
            SurfaceSearch => [rung(SurfaceSearch), None],
            SurfaceTrack => [rung(SurfaceTrack), rung(SurfaceClose)],
            _ => [rung(SurfaceClose), None],
        };
        Self {
            follow,
            search: Registrar::new(&RegisterParams { method: SurfaceSearch, ..params.clone() }),
            expected: *expected,
            last: None,
            is_held: false,
            outlier_share: params.outlier_share,
            asks_gel: false,
            usual: UsualResiduals::new(params.outlier_share),
        }
    }

    /// The part is expected there from now on, wherever it was before: the gripper has let go, or taken another.
    pub fn expect(&mut self, expected: &Pose) {
        self.expected = *expected;
        self.last = None;
        self.is_held = false;
        self.asks_gel = false;
        self.usual = UsualResiduals::new(self.outlier_share);
    }

    /// The last pose that was believed (`t_sensor_object`).
    #[must_use]
    pub const fn last(&self) -> Option<&Pose> {
        self.last.as_ref()
    }

    /// Localizes the part in the next frame.
    ///
    /// # Errors
    /// [`RegisterError`], for one when nothing touches the gel; the last pose is kept, and the next contact is looked for
    /// there first.
    pub fn run(&mut self, contact: &Contact<'_>, template: &Template) -> Result<Located, RegisterError> {
        self.run_unless(contact, template, NEVER)
    }

    /// As [`Self::run`], unless it is stopped: then the next frame is localized as if this one had not been.
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
            for k in 0..self.follow.len() {
                let Some(registrar) = &mut self.follow[k] else { continue };
                // Out of reach is one way to be lost; what else is refused the search refuses as well.
                let found = match registrar.register_unless(contact, template, &last, stop) {
                    Ok(found) => found,
                    Err(RegisterError::Stopped) => return Err(RegisterError::Stopped),
                    Err(_) => continue,
                };
                let mut followed = self.judge(found, (contact, template), TrackingStatus::Tracking);
                if followed.tracking == TrackingStatus::Tracking {
                    // Along what is free it is where it was first guessed to be, however far it has been followed.
                    followed.registration.guess_sigma = self.search.params().guess_sigma();
                    hold_free(&mut followed.registration, &last);
                    return Ok(self.believe(followed));
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
        let found = self.search.register_unless(contact, template, around, stop)?;
        Ok(self.judge(found, (contact, template), TrackingStatus::Relocalized))
    }

    /// A pose that was come by in some way, or lost if it does not explain the contact.
    fn judge(
        &mut self,
        registration: Registration,
        of: (&Contact<'_>, &Template),
        tracking: TrackingStatus,
    ) -> Located {
        let asks = self.asks_gel || registration.gel_decay.is_some();
        // Most of what is followed is right, and that is soon seen once it is known what is usual.
        let is_soon = tracking == TrackingStatus::Tracking && self.usual.is_enough();
        let usual = is_soon.then_some(&self.usual);
        let told = if asks { self.search.misfit(of, &registration.t_sensor_object, usual) } else { None };
        let is_usual = told.as_ref().is_some_and(|misfit| !self.usual.is_exceeded(misfit));
        if let Some(misfit) = &told
            && is_usual
        {
            self.asks_gel = true;
            if !is_soon {
                self.usual.learn(misfit);
            }
        }
        // A gel that has explained nothing yet may be another than it is said to be.
        let goes_by_odds = told.is_none() || !self.asks_gel;
        let is_explained = is_usual || (goes_by_odds && registration.log_odds.is_some_and(|odds| odds > 0.0));
        let tracking = if is_explained { tracking } else { TrackingStatus::Lost };
        Located { registration, tracking, misfit: told }
    }

    /// Takes a pose for what to follow, unless the part is lost.
    fn believe(&mut self, located: Located) -> Located {
        if located.tracking != TrackingStatus::Lost {
            self.last = Some(located.registration.t_sensor_object);
            self.is_held = true;
        }
        located
    }
}

/// Takes back the motion since `last` along the directions that the contact leaves free.
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
