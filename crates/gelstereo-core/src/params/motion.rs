//! Motion of a part without a model.

use super::{ParamsError, check, share};

/// Motion of a part without a model, from markers that stick and the contact's surface.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct MotionParams {
    /// Share of the markers in contact that have stuck since the keyframe, below which a new keyframe is set.
    /// Valid: 0 to 0.999. Default: `0.5`, at which two keyframes in a row share no marker, and their errors
    /// are independent. Raise it if markers soon slip.
    pub keyframe_share: f64,
    /// Standard deviation of the rotation from one frame to the next, about axes that neither markers nor
    /// surface determine. Valid: 0.000001 to 1 rad. Default: `0.02` rad. Set it to how fast parts turn.
    pub free_turn_rad: f64,
    /// Standard deviation of the shift from one frame to the next, in directions that neither markers nor
    /// surface determine. Valid: 0.000001 to 100 mm. Default: `0.3` mm. Set it to how fast parts slide.
    pub free_shift_mm: f64,
    /// Standard deviation of the distance between two views of one surface, in addition to the noise of the
    /// markers. Valid: 0 to 1 mm. Default: `0.005` mm. Raise it for rough parts.
    pub surface_sigma_mm: f64,
    /// Rolling and sliding are measured over at least this many frames, and at most twice as many. Valid: 1
    /// to 1000000. Default: `15`, half a second at 30 Hz. Raise it for slow motions.
    pub window_frames: u32,
    /// Number of keyframes that are remembered. A surface that comes back is recognized among them, and
    /// corrects the poses in between. Each takes 9 KB, and 300 bytes for each of the others. Valid: 0 to 64;
    /// less than 3 close no loop. Default: `32`, two to three turns of a cylinder. Raise it for large parts.
    pub loop_keyframes: u32,
}

impl Default for MotionParams {
    fn default() -> Self {
        Self {
            keyframe_share: 0.5,
            free_turn_rad: 0.02,
            free_shift_mm: 0.3,
            surface_sigma_mm: 0.005,
            window_frames: 15,
            loop_keyframes: 32,
        }
    }
}

impl MotionParams {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let Self { keyframe_share, free_turn_rad, free_shift_mm, surface_sigma_mm, .. } = *self;
        let Self { window_frames, loop_keyframes, .. } = *self;
        share("motion.keyframe_share", keyframe_share)?;
        let turn = (1e-6..=1.0).contains(&free_turn_rad);
        check(turn, "motion.free_turn_rad", free_turn_rad, "0.000001 to 1 rad")?;
        let shift = (1e-6..=100.0).contains(&free_shift_mm);
        check(shift, "motion.free_shift_mm", free_shift_mm, "0.000001 to 100 mm")?;
        let sigma = (0.0..=1.0).contains(&surface_sigma_mm);
        check(sigma, "motion.surface_sigma_mm", surface_sigma_mm, "0 to 1 mm")?;
        let frames = (1..=1_000_000).contains(&window_frames);
        check(frames, "motion.window_frames", f64::from(window_frames), "1 to 1000000")?;
        let loops = (0..=64).contains(&loop_keyframes);
        check(loops, "motion.loop_keyframes", f64::from(loop_keyframes), "0 to 64")
    }
}
