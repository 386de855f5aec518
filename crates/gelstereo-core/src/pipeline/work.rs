//! Work of a frame, predicted from the sizes of its images and its lattice.

use crate::params::{
    Background, Centre, DetectParams, DiscBias, FindAt, Params, Saliency, TriangulateMethod,
};

/// Step of the fit below which every marker gets steps of its own ([`FitParams`](crate::params::FitParams)).
const FINE_STEP_PX: f64 = 0.01;

/// Which centring rung detects a frame's markers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum DetectRung {
    /// That of the settings.
    #[default]
    Configured,
    /// Centroids by soft threshold, found at half size.
    Cheaper,
}

/// What the work of a view grows with.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ViewSize {
    /// Pixels searched in a whole image.
    pub pixels: usize,
    /// Markers of the lattice.
    pub markers: usize,
    /// Area of the usual marker, px².
    pub marker_px2: f64,
}

/// Units of work, 1000 instructions each.
#[derive(Clone, Copy, Debug)]
struct Cost {
    base: f64,
    per_kilopixel: f64,
    per_marker: f64,
    per_marker_px2: f64,
}

impl Cost {
    fn of(&self, size: &ViewSize) -> u64 {
        let ViewSize { pixels, markers, marker_px2 } = *size;
        let of_marker = self.per_marker + self.per_marker_px2 * marker_px2;
        (self.base + self.per_kilopixel * 1e-3 * pixels as f64 + of_marker * markers as f64) as u64
    }
}

const fn cost(base: f64, per_kilopixel: f64, per_marker: f64, per_marker_px2: f64) -> Cost {
    Cost { base, per_kilopixel, per_marker, per_marker_px2 }
}

// Fitted to instruction counts by `gelstereo frontier cost`; docs/accuracy-vs-time.md has the residuals.
const WHOLE_GAUSSIAN: Cost = cost(165.0, 217.0, 2.0, 0.0877);
const WHOLE_GREY: Cost = cost(463.0, 5.96, 2.12, 0.0691);
const WHOLE_SOFT: Cost = cost(7070.0, 12.0, 4.71, 0.0505);
const WHOLE_SOFT_HALF: Cost = cost(4860.0, 8.59, 6.04, 0.0381);
const WHOLE_FIT: Cost = cost(9940.0, 0.573, 8.88, 0.11);
const WHOLE_FINE_FIT: Cost = cost(6410.0, 9.17, 24.4, 0.132);
const WINDOWS_SOFT: Cost = cost(0.0, 0.0, 0.0, 0.009_32);
const WINDOWS_FIT: Cost = cost(154.0, 0.0, 4.75, 0.0434);
const WINDOWS_FINE_FIT: Cost = cost(0.0, 0.0, 19.5, 0.113);
/// Labels, points by polynomials, heights and the patch; with what every marker costs in windows.
const FRAME: Cost = cost(0.0, 0.0, 8.69, 0.0);
/// More than polynomials.
const RAYS: Cost = cost(0.0, 0.0, 1.31, 0.0);
const DISC_BIAS: Cost = cost(0.0, 0.0, 3.46, 0.0);
const PRESSURE: Cost = cost(0.0, 0.0, 0.82, 0.0);
const ADAPTIVE: Cost = cost(0.0, 0.0, 1.26, 0.0);

/// Work of searching a whole view.
pub(super) fn whole(params: &DetectParams, rung: DetectRung, size: &ViewSize) -> u64 {
    let cost = match (rung, params.background, params.centre) {
        (DetectRung::Cheaper, ..) => WHOLE_SOFT_HALF,
        (_, Background::Gaussian, _) => WHOLE_GAUSSIAN,
        (.., Centre::Binary | Centre::Grey) => WHOLE_GREY,
        (.., Centre::SoftThreshold) if params.find_at == FindAt::HalfSize => WHOLE_SOFT_HALF,
        (.., Centre::SoftThreshold) => WHOLE_SOFT,
        (.., Centre::Fit) if params.fit.step_px < FINE_STEP_PX => WHOLE_FINE_FIT,
        (.., Centre::Fit) => WHOLE_FIT,
    };
    cost.of(size)
}

/// Work of searching windows of a view.
pub(super) fn windows(params: &DetectParams, rung: DetectRung, size: &ViewSize) -> u64 {
    let cost = match (rung, params.centre) {
        (DetectRung::Configured, Centre::Fit) if params.fit.step_px < FINE_STEP_PX => WINDOWS_FINE_FIT,
        (DetectRung::Configured, Centre::Fit) => WINDOWS_FIT,
        _ => WINDOWS_SOFT,
    };
    cost.of(size)
}

/// Work of all that follows detection.
pub(super) fn after_detection(params: &Params, size: &ViewSize) -> u64 {
    let points = (params.triangulate.method == TriangulateMethod::Rays).then_some(RAYS);
    let bias = (params.triangulate.disc_bias == DiscBias::Corrected).then_some(DISC_BIAS);
    let contact = match params.contact.saliency {
        Saliency::Depth => None,
        Saliency::Pressure => Some(PRESSURE),
        Saliency::Adaptive => Some(ADAPTIVE),
    };
    [Some(FRAME), points, bias, contact].iter().flatten().map(|cost| cost.of(size)).sum()
}
