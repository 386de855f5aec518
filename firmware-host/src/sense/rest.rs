//! Learns the rest state from the first good frames of a gel at rest.

use crate::config::SenseConfig;
use gelstereo_core::pipeline::Frame;

/// Effect of a good frame on learning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestStep {
    /// More frames are needed.
    Learning,
    /// The gel moves or is touched: the next frame becomes the rest frame.
    Restart,
    /// This frame completed the rest state.
    Learned,
    /// The rest state was already known.
    Known,
}

/// Progress of learning the rest state.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RestState {
    steady: u32,
    known: bool,
}

impl RestState {
    /// Whether the rest state is learned.
    #[must_use]
    pub const fn is_known(&self) -> bool {
        self.known
    }

    /// Starts learning again.
    pub const fn forget(&mut self) {
        (self.steady, self.known) = (0, false);
    }

    /// Takes the next good frame. The first becomes the rest frame; the others must show the same gel state.
    pub fn step(&mut self, frame: &Frame, settings: &SenseConfig) -> RestStep {
        if self.known {
            return RestStep::Known;
        }
        let salient = frame.salient.iter().filter(|&&salient| salient).count();
        if frame.motion_px > settings.max_rest_motion_px || salient >= settings.min_salient as usize {
            self.steady = 0;
            return RestStep::Restart;
        }
        self.steady += 1;
        if self.steady < settings.rest_frames {
            return RestStep::Learning;
        }
        self.known = true;
        RestStep::Learned
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gel_that_moves_is_not_at_rest() {
        let settings = SenseConfig { rest_frames: 3, ..SenseConfig::default() };
        let frame = |motion_px| Frame { motion_px, ..Frame::default() };
        let mut rest = RestState::default();
        let steps: Vec<RestStep> =
            [0.0, 0.1, 0.9, 0.0, 0.2, 0.1, 7.0].map(|px| rest.step(&frame(px), &settings)).into();
        use RestStep::{Known, Learned, Learning, Restart};
        assert_eq!(steps, [Learning, Learning, Restart, Learning, Learning, Learned, Known]);
        rest.forget();
        let touched = Frame { salient: vec![true; 3], ..Frame::default() };
        assert_eq!(rest.step(&touched, &settings), Restart);
        assert!(!rest.is_known());
    }
}
