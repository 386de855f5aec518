//! Localization from frame to frame: follow, notice that the part is lost, find it again.

use super::observe::PatchFrame;
use super::template::Template;
use super::{Contact, RegisterError, Registrar, Registration};
use crate::math::Pose;
use crate::params::{RegisterMethod, RegisterParams};

/// How a localizer came to a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// From the frame before, by the rung that follows.
    Followed,
    /// By a search: the first pose, or the part again after it was lost.
    Found,
    /// The search found nothing that explains the contact. The pose is its best one, and is not followed.
    Lost,
}

/// The pose in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// The pose, with its evidence.
    pub registration: Registration,
    /// How it was come by.
    pub standing: Standing,
}

/// Localizes one part frame by frame.
///
/// From the pose before, a rung that follows needs one start: `surface_track` if that is the `register.method`, and then
/// `surface_close` if it fails, otherwise `surface_close`. A pose is believed while [`Registration::log_odds`] is above
/// 0, even odds. Below that the part is searched by `surface_search`, around the last pose that was believed and, if that
/// finds nothing either, around where it is expected. What the contact leaves free stays as it was, so
/// that noise does not make it wander.
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
}

impl Localizer {
    /// With these settings, for a part that is expected at `expected` (`t_sensor_object`).
    #[must_use]
    pub fn new(params: &RegisterParams, expected: &Pose) -> Self {
        let rung = |method| Registrar::new(&RegisterParams { method, ..params.clone() });
        let is_quick = params.method == RegisterMethod::SurfaceTrack;
        Self {
            follow: [
                is_quick.then(|| rung(RegisterMethod::SurfaceTrack)),
                Some(rung(RegisterMethod::SurfaceClose)),
            ],
            search: rung(RegisterMethod::SurfaceSearch),
            expected: *expected,
            last: None,
            is_held: false,
        }
    }

    /// The part is expected there from now on, wherever it was before: the gripper has let go, or taken another.
    pub fn expect(&mut self, expected: &Pose) {
        self.expected = *expected;
        self.last = None;
        self.is_held = false;
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
        if let Some(last) = self.last.filter(|_| self.is_held) {
            for registrar in self.follow.iter_mut().flatten() {
                // Out of reach is one way to be lost; what else is refused the search refuses as well.
                let Ok(mut found) = registrar.register(contact, template, &last) else { continue };
                if explains(&found) {
                    hold_free(&mut found, &last);
                    return Ok(self.believe(found, Standing::Followed));
                }
            }
        }
        self.is_held = false;
        self.search(contact, template)
    }

    fn search(&mut self, contact: &Contact<'_>, template: &Template) -> Result<Located, RegisterError> {
        let around = self.last.unwrap_or(self.expected);
        let first = self.search.register(contact, template, &around);
        if let Ok(found) = &first
            && explains(found)
        {
            return Ok(self.believe(found.clone(), Standing::Found));
        }
        if around == self.expected {
            return first.map(lost);
        }
        match (first, self.search.register(contact, template, &self.expected)) {
            (_, Ok(found)) if explains(&found) => Ok(self.believe(found, Standing::Found)),
            (Ok(first), Ok(second)) => {
                Ok(lost(if first.log_odds >= second.log_odds { first } else { second }))
            }
            (Ok(one), Err(_)) | (Err(_), Ok(one)) => Ok(lost(one)),
            (Err(error), Err(_)) => Err(error),
        }
    }

    fn believe(&mut self, registration: Registration, standing: Standing) -> Located {
        self.last = Some(registration.t_sensor_object);
        self.is_held = true;
        Located { registration, standing }
    }
}

fn lost(registration: Registration) -> Located {
    Located { registration, standing: Standing::Lost }
}

fn explains(found: &Registration) -> bool {
    found.log_odds.is_some_and(|odds| odds > 0.0)
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
