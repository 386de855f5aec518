//! Settings by name.

use super::{
    Background, Centre, ContactParams, DetectParams, LabelMethod, LabelParams, Params, RegisterMethod,
    RegisterParams, TriangulateMethod, TriangulateParams,
};

impl Params {
    /// The preset of that name, or `None`; [`Self::PRESETS`] lists them.
    ///
    /// `paper` is the paper's pipeline to the letter, `balanced` its cheaper and more accurate variant: box
    /// background, grey centroids, labels kept through tracks, points by a polynomial fitted to the rays, the gel's
    /// shoulder left out, point-to-plane registration.
    #[must_use]
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "paper" => Some(Self::default()),
            "balanced" => Some(Self {
                detect: DetectParams {
                    background: Background::Box,
                    centre: Centre::Grey,
                    centre_sigma_px: 0.04,
                    ..Default::default()
                },
                label: LabelParams { method: LabelMethod::Temporal, ..Default::default() },
                triangulate: TriangulateParams {
                    method: TriangulateMethod::Polynomial,
                    ..Default::default()
                },
                contact: ContactParams { patch_share: 0.65, ..Default::default() },
                register: RegisterParams { method: RegisterMethod::FilterregPlane, ..Default::default() },
                ..Self::default()
            }),
            _ => None,
        }
    }

    /// Names that [`Self::preset`] knows.
    pub const PRESETS: [&'static str; 2] = ["paper", "balanced"];
}
