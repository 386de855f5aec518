//! Settings by name.

use super::{
    Background, Centre, ContactParams, DetectParams, DiscBias, FindAt, FitParams, ForceParams, LabelMethod,
    LabelParams, LatticeParams, Motion, MotionParams, Params, RegisterMethod, RegisterParams, Saliency,
    Search, SlipParams, Threshold, TrackParams, TriangulateMethod, TriangulateParams,
};

impl Params {
    /// The preset of that name, or `None`; [`Self::PRESETS`] lists them.
    ///
    /// - `paper`: the paper's pipeline to the letter;
    /// - `fast`: the cheapest rung of every stage that keeps identities safe;
    /// - `balanced`: what to begin with: as `fast`, with centres by a model fit and the part searched for
    ///   from many starts;
    /// - `exact`: the most accurate rung of every stage.
    ///
    /// All but `paper` derive the threshold from the image, check every identity against the lattice,
    /// tolerate a fifth of the markers missing, find contacts without knowing the gel's law, and see through
    /// the rig's layers.
    #[must_use]
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "paper" => Some(Self::default()),
            "fast" => Some(Self::fast()),
            "balanced" => Some(Self::balanced()),
            "exact" => Some(Self::exact()),
            _ => None,
        }
    }

    /// Names that [`Self::preset`] knows.
    pub const PRESETS: [&'static str; 4] = ["paper", "fast", "balanced", "exact"];

    fn fast() -> Self {
        let balanced = Self::balanced();
        Self {
            detect: DetectParams {
                centre: Centre::SoftThreshold,
                find_at: FindAt::HalfSize,
                ..balanced.detect
            },
            register: RegisterParams { method: RegisterMethod::SurfaceClose, ..balanced.register },
            ..balanced
        }
    }

    fn balanced() -> Self {
        Self {
            lattice: LatticeParams { max_missing_share: 0.2, ..Default::default() },
            detect: DetectParams {
                background: Background::Blocks,
                threshold: Threshold::Auto,
                centre: Centre::Fit,
                search: Search::Windows,
                centre_sigma_px: 0.04,
                // 71 x 71 dots in 640 x 480 pixels have pieces of 5; what is a speck beside others the
                // threshold's rung tells.
                min_area_px2: 4,
                ..Default::default()
            },
            track: TrackParams { motion: Motion::ConstantVelocity, ..Default::default() },
            label: LabelParams { method: LabelMethod::Lattice, ..Default::default() },
            triangulate: TriangulateParams { method: TriangulateMethod::Polynomial, ..Default::default() },
            contact: ContactParams { saliency: Saliency::Adaptive, ..Default::default() },
            force: ForceParams::default(),
            slip: SlipParams::default(),
            motion: MotionParams::default(),
            register: RegisterParams { method: RegisterMethod::SurfaceSearch, ..Default::default() },
        }
    }

    fn exact() -> Self {
        let balanced = Self::balanced();
        Self {
            detect: DetectParams {
                search: Search::Whole,
                fit: FitParams { step_px: 0.005, ..balanced.detect.fit },
                ..balanced.detect
            },
            triangulate: TriangulateParams {
                method: TriangulateMethod::Rays,
                disc_bias: DiscBias::Corrected,
                ..balanced.triangulate
            },
            ..balanced
        }
    }
}
