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
    /// For a marker without area; less the larger it is, and nothing from `small_px2` on.
    per_small_marker: f64,
    small_px2: f64,
}

impl Cost {
    const fn with_small(self, per_small_marker: f64, small_px2: f64) -> Self {
        Self { per_small_marker, small_px2, ..self }
    }

    fn of(&self, size: &ViewSize) -> u64 {
        let ViewSize { pixels, markers, marker_px2 } = *size;
        let smallness = (1.0 - marker_px2 / self.small_px2).max(0.0);
        let of_marker =
            self.per_marker + self.per_marker_px2 * marker_px2 + self.per_small_marker * smallness;
        (self.base + self.per_kilopixel * 1e-3 * pixels as f64 + of_marker * markers as f64) as u64
    }
}

const fn cost(base: f64, per_kilopixel: f64, per_marker: f64, per_marker_px2: f64) -> Cost {
    Cost { base, per_kilopixel, per_marker, per_marker_px2, per_small_marker: 0.0, small_px2: 1.0 }
}

// Fitted to instruction counts by `gelstereo frontier cost`; docs/accuracy-vs-time.md has the residuals.
const WHOLE_GAUSSIAN: Cost = cost(188.0, 217.0, 1.96, 0.0873);
const WHOLE_GREY: Cost = cost(671.0, 6.37, 2.13, 0.0559);
const WHOLE_SOFT: Cost = cost(7080.0, 12.0, 4.68, 0.0504);
const WHOLE_SOFT_HALF: Cost = cost(4750.0, 8.83, 6.07, 0.0342);
const WHOLE_FIT: Cost = cost(9200.0, 0.0, 8.37, 0.118).with_small(99.3, SMALL_PX2);
const WHOLE_FINE_FIT: Cost = cost(33.3, 2.34, 36.8, 0.163).with_small(80.3, SMALL_PX2);
const WINDOWS_SOFT: Cost = cost(0.0, 0.0, 0.0, 0.008_88);
const WINDOWS_FIT: Cost = cost(0.0, 0.0, 5.03, 0.0369).with_small(73.6, SMALL_IN_WINDOWS_PX2);
const WINDOWS_FINE_FIT: Cost = cost(0.0, 0.0, 25.8, 0.0539).with_small(51.2, SMALL_IN_WINDOWS_PX2);
/// Labels, points by polynomials, heights and the patch; with what every marker costs in windows.
const FRAME: Cost = cost(0.0, 0.0, 8.77, 0.0);
/// More than polynomials.
const RAYS: Cost = cost(0.0, 0.0, 1.26, 0.0);
const DISC_BIAS: Cost = cost(0.0, 0.0, 3.26, 0.0);
const PRESSURE: Cost = cost(0.0, 0.0, 0.816, 0.0);
const ADAPTIVE: Cost = cost(0.0, 0.0, 1.25, 0.0);
/// Areas below which fits need steps of their own. In whole images they take three times as long for a marker
/// of 14 px² as for one of 24 px²; in windows four times for 7 px² as for 14 px².
const SMALL_PX2: f64 = 24.0;
const SMALL_IN_WINDOWS_PX2: f64 = 14.0;

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
