//! The configured rule for the markers in contact, with its memory.

use super::{AdaptiveSaliency, ContactError, ContactRule, Decay, DecayFit, Pressure, RestSurface, saliency};
use crate::lattice::Topology;
use crate::math::abs;
use crate::params::{ContactParams, Saliency};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Relative accuracy from which a learned decay length is used, and relative change from which it is
/// updated.
const DECAY_KNOWN: f64 = 0.02;

/// What one frame shows of the markers, for contact detection.
#[derive(Clone, Copy, Debug)]
pub struct MarkerHeights<'a> {
    /// Height above rest along the rest plane's normal.
    pub indentation_mm: &'a [f64],
    /// Its variance.
    pub variance_mm2: &'a [f64],
    /// Whether the marker was seen.
    pub state: &'a [MarkerState],
}

/// Finds the markers in contact by the rule of `contact.saliency`.
#[derive(Clone, Debug)]
pub struct ContactDetector {
    params: ContactParams,
    rung: Rung,
    rule: Option<ContactRule>,
    decay: DecayFit,
    /// The decay length in use before the last frame's contact was learned from.
    decay_mm: f64,
}

#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one for each pipeline")]
enum Rung {
    Depth,
    Pressure(Pressure),
    Adaptive(AdaptiveSaliency),
}

impl Rung {
    fn new(params: &ContactParams, rest: &RestSurface, topology: Topology) -> Result<Self, ContactError> {
        Ok(match params.saliency {
            Saliency::Depth => Self::Depth,
            Saliency::Pressure => Self::Pressure(Pressure::on(rest, topology, params.decay_mm)?),
            Saliency::Adaptive => Self::Adaptive(AdaptiveSaliency::on(rest, topology, params.decay_mm)?),
        })
    }
}

impl ContactDetector {
    /// With these settings. It judges by depth until [`Self::start`].
    #[must_use]
    pub fn new(params: &ContactParams) -> Self {
        Self {
            params: params.clone(),
            rung: Rung::Depth,
            rule: None,
            decay: DecayFit::default(),
            decay_mm: params.decay_mm,
        }
    }

    /// Starts from this rest surface of a print, row by row. Reserves all memory.
    ///
    /// # Errors
    /// As [`Pressure::new`].
    pub fn start(&mut self, rest: &RestSurface, topology: Topology) -> Result<(), ContactError> {
        self.rung = Rung::new(&self.params, rest, topology)?;
        self.decay.start(if self.params.learn_decay { topology.places() } else { 0 });
        self.decay_mm = self.params.decay_mm;
        Ok(())
    }

    /// Clears all that was learned since [`Self::start`].
    pub fn forget(&mut self) {
        self.rule = None;
        self.decay.start(0);
    }

    /// Finds the markers in contact. `salient` is cleared first.
    ///
    /// # Errors
    /// As [`Pressure::run`].
    pub fn run(&mut self, seen: &MarkerHeights<'_>, salient: &mut Vec<bool>) -> Result<(), ContactError> {
        let MarkerHeights { indentation_mm, variance_mm2, state } = *seen;
        let variances = variance_mm2.iter().copied();
        match &mut self.rung {
            Rung::Depth => saliency(indentation_mm, state, self.params.saliency_mm, salient),
            Rung::Pressure(pressure) => {
                pressure.run(indentation_mm, variances, state, salient)?;
                self.decay_mm = pressure.decay_mm();
                if self.params.learn_decay {
                    self.decay.add(pressure, indentation_mm, state, salient);
                    if let Some(found) = self.decay.decay().filter(|found| is_news(found, self.decay_mm)) {
                        pressure.set_decay(found.decay_mm)?;
                    }
                }
            }
            Rung::Adaptive(adaptive) => {
                self.rule = adaptive.run(indentation_mm, variances, state, salient)?;
            }
        }
        Ok(())
    }

    /// The decay length by which the last frame was judged, or would have been.
    #[must_use]
    pub const fn decay_mm(&self) -> f64 {
        self.decay_mm
    }

    /// The decay length learned from the contacts since [`Self::start`]; `None` until they suffice, or
    /// without `contact.learn_decay`.
    #[must_use]
    pub fn decay(&self) -> Option<Decay> {
        self.decay.decay()
    }

    /// The rule that found the last frame's contact with `contact.saliency = adaptive`; `None` otherwise,
    /// and without contact.
    #[must_use]
    pub const fn rule(&self) -> Option<ContactRule> {
        self.rule
    }
}

/// Whether a decay length is known well enough to be used, and differs from the one in use.
fn is_news(found: &Decay, used_mm: f64) -> bool {
    found.sigma_mm < DECAY_KNOWN * found.decay_mm && abs(found.decay_mm - used_mm) > DECAY_KNOWN * used_mm
}
