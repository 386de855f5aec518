//! Work of a frame, predicted from the sizes of its images and its lattice, and from what the rest frame
//! showed.

use crate::detect::{MAX_PROFILE_MARKERS, MarkerSize, Workload};
use crate::math::sqrt;
use crate::params::{
    Background, Centre, DetectParams, DiscBias, FindAt, Params, Saliency, TriangulateMethod,
};
use core::f64::consts::FRAC_1_PI;

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
    /// Width and height of the region that is searched in a whole image.
    pub size_px: (usize, usize),
    /// Markers of the lattice.
    pub markers: usize,
    /// Area of the usual marker, px².
    pub marker_px2: f64,
    /// Of the configured rung, and of the cheaper one.
    pub configured: Workload,
    pub cheaper: Workload,
}

// Units of work, 1000 instructions each. Fitted to instruction counts by `gelstereo frontier cost`;
// docs/accuracy-vs-time.md has the residuals.
//
// Components of a whole image: for a kilopixel, by blocks and by Gaussian backgrounds, and for a row of a
// marker.
const SEGMENT_KILOPIXEL: f64 = 6.95;
const GAUSSIAN_KILOPIXEL: f64 = 218.0;
const SEGMENT_ROW: f64 = 0.352;
/// For a kilopixel that is closed around a reflection.
const CLOSED_KILOPIXEL: f64 = 22.4;
/// Noise: for a kilopixel of the rows read, and for a row of a marker that is left out there.
const NOISE_KILOPIXEL: f64 = 2.12;
const NOISE_ROW: f64 = 0.0596;
/// Centroids of components: for a row of a marker.
const GREY_ROW: f64 = 0.44;
/// Windows of a marker: for a row of 16 pixels.
const WINDOW_ROW: f64 = 0.0272;
/// Reflections beside windows: for a kilopixel.
const GLARE_KILOPIXEL: f64 = 0.276;
/// Profile of soft thresholds: for a pixel of the windows from which it is learned.
const PROFILE_PIXEL: f64 = 0.0487;
/// Fits: what is learned from an image; for a marker; for a group of pixels in its window.
const LEARN_FIT: f64 = 7970.0;
const FIT_MARKER: f64 = 3.42;
const FIT_GROUP: f64 = 0.483;
/// What a fine fit takes beyond that, and for a group if its steps sum over pixels.
const FINE_MARKER: f64 = 5.68;
const FINE_GROUP: f64 = 1.64;
const FINE_SUM_GROUP: f64 = 2.48;
/// Labels, points by polynomials, heights and the patch, for a marker; with what every marker costs in
/// windows.
const FRAME: f64 = 9.03;
/// More than polynomials.
const RAYS: f64 = 1.26;
const DISC_BIAS: f64 = 3.47;
const PRESSURE: f64 = 1.33;
const ADAPTIVE: f64 = 1.91;

impl ViewSize {
    fn workload(&self, rung: DetectRung) -> &Workload {
        match rung {
            DetectRung::Configured => &self.configured,
            DetectRung::Cheaper => &self.cheaper,
        }
    }

    fn kilopixels(&self) -> f64 {
        1e-3 * (self.size_px.0 * self.size_px.1) as f64
    }

    fn markers(&self) -> f64 {
        self.markers as f64
    }

    /// Rows of all markers, which are the runs of their components.
    fn rows(&self) -> f64 {
        self.markers() * 2.0 * sqrt(self.marker_px2 * FRAC_1_PI)
    }

    /// Components of the whole image. Half its size has a quarter of the pixels.
    fn segment(&self, found_at: FindAt) -> f64 {
        let scale = if found_at == FindAt::HalfSize { 0.5 } else { 1.0 };
        SEGMENT_KILOPIXEL * self.kilopixels() * scale * scale + SEGMENT_ROW * self.rows() * scale
    }

    fn closed(&self, workload: &Workload) -> f64 {
        CLOSED_KILOPIXEL * 1e-3 * workload.closed_px as f64
    }

    fn noise(&self, workload: &Workload) -> f64 {
        let (width, height) = self.size_px;
        let rows_at_once = self.rows() / height.max(1) as f64;
        NOISE_KILOPIXEL * 1e-3 * (workload.noise_rows * width) as f64
            + NOISE_ROW * workload.rows_beside_noise as f64 * rows_at_once
    }

    /// Soft thresholds in a window around every marker.
    fn windows(&self) -> f64 {
        let rows = MarkerSize::of(self.marker_px2).map_or(0, |size| size.rows_of_16());
        WINDOW_ROW * self.markers() * rows as f64
    }

    fn profile(&self) -> f64 {
        let side_px = MarkerSize::of(self.marker_px2).map_or(0, |size| size.side_px);
        PROFILE_PIXEL * (self.markers.min(MAX_PROFILE_MARKERS) * side_px * side_px) as f64
    }

    fn fits(&self, params: &DetectParams, workload: &Workload) -> f64 {
        let groups = workload.fit_groups as f64;
        let mut of_marker = FIT_MARKER + FIT_GROUP * groups;
        if params.fit.step_px < FINE_STEP_PX {
            let of_group = if workload.sums_pixels { FINE_GROUP + FINE_SUM_GROUP } else { FINE_GROUP };
            of_marker += FINE_MARKER + of_group * groups;
        }
        self.markers() * of_marker
    }
}

/// Work of searching a whole view.
pub(super) fn whole(params: &DetectParams, rung: DetectRung, size: &ViewSize) -> u64 {
    let workload = size.workload(rung);
    let segment = size.segment(workload.found_at) + size.closed(workload);
    let soft = || segment + size.noise(workload) + size.windows() + size.profile();
    let work = match (rung, params.background, params.centre) {
        (DetectRung::Cheaper, ..) => soft(),
        (_, Background::Gaussian, _) => {
            GAUSSIAN_KILOPIXEL * size.kilopixels() + (SEGMENT_ROW + GREY_ROW) * size.rows()
        }
        (.., Centre::Binary | Centre::Grey) => segment + GREY_ROW * size.rows(),
        (.., Centre::SoftThreshold) => soft(),
        (.., Centre::Fit) => segment + size.noise(workload) + LEARN_FIT + size.fits(params, workload),
    };
    work as u64
}

/// Work of searching windows of a view.
pub(super) fn windows(params: &DetectParams, rung: DetectRung, size: &ViewSize) -> u64 {
    let fits = match (rung, params.centre) {
        (DetectRung::Configured, Centre::Fit) => size.fits(params, &size.configured),
        _ => 0.0,
    };
    (size.windows() + GLARE_KILOPIXEL * size.kilopixels() + fits) as u64
}

/// Work of all that follows detection.
pub(super) fn after_detection(params: &Params, size: &ViewSize) -> u64 {
    let points = if params.triangulate.method == TriangulateMethod::Rays { RAYS } else { 0.0 };
    let bias = if params.triangulate.disc_bias == DiscBias::Corrected { DISC_BIAS } else { 0.0 };
    let contact = match params.contact.saliency {
        Saliency::Depth => 0.0,
        Saliency::Pressure => PRESSURE,
        Saliency::Adaptive => ADAPTIVE,
    };
    ((FRAME + points + bias + contact) * size.markers()) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn settings(centre: Centre, step_px: f64) -> DetectParams {
        let mut params = DetectParams { centre, ..DetectParams::default() };
        params.background = Background::Blocks;
        params.fit.step_px = step_px;
        params
    }

    prop_compose! {
        fn sizes()(
            size_px in (320_usize..2000, 240_usize..1500), side in 5_usize..72, marker_px2 in 6.0..300.0_f64,
            is_half: bool, closed_px in 0_usize..5_000_000,
            noise_rows in 0_usize..2000, fit_groups in 1_usize..17, sums_pixels: bool,
        ) -> ViewSize {
            let rows_beside_noise = 7 * noise_rows;
            let of_all = Workload { closed_px, noise_rows, rows_beside_noise, ..Workload::default() };
            let found_at = if is_half { FindAt::HalfSize } else { FindAt::FullSize };
            let configured = Workload { fit_groups, sums_pixels, ..of_all };
            let cheaper = Workload { found_at, ..of_all };
            ViewSize { size_px, markers: side * side, marker_px2, configured, cheaper }
        }
    }

    proptest! {
        /// In the order in which rungs are given up. What a detector showed counts for that detector alone.
        #[test]
        fn cheaper_rungs_are_cheaper(size in sizes()) {
            let (fine, fit) = (settings(Centre::Fit, 0.001), settings(Centre::Fit, 0.02));
            let by_windows = |params| windows(params, DetectRung::Configured, &size);
            let soft = windows(&fit, DetectRung::Cheaper, &size);
            prop_assert!(soft < by_windows(&fit) && by_windows(&fit) < by_windows(&fine));
            prop_assert!(by_windows(&fine) < whole(&fine, DetectRung::Configured, &size));
            prop_assert!(soft < whole(&fit, DetectRung::Cheaper, &size));
        }

        /// Reflections, larger windows and steps that sum over pixels take more, by the same for all rungs.
        #[test]
        fn work_grows_with_what_the_rest_frame_showed(size in sizes(), more in 1_usize..100) {
            let (fine, rung) = (settings(Centre::Fit, 0.001), DetectRung::Configured);
            let with = |configured: Workload| ViewSize { configured, ..size };
            let Workload { closed_px, fit_groups, .. } = size.configured;
            let closed = with(Workload { closed_px: closed_px + 100_000 * more, ..size.configured });
            let by_closing = whole(&fine, rung, &closed) - whole(&fine, rung, &size);
            prop_assert!(by_closing.abs_diff((100.0 * CLOSED_KILOPIXEL * more as f64) as u64) <= 1);
            prop_assert_eq!(windows(&fine, rung, &closed), windows(&fine, rung, &size));
            let wide = with(Workload { fit_groups: fit_groups + more, ..size.configured });
            let fit = settings(Centre::Fit, 0.02);
            let by_groups = windows(&fit, rung, &wide) - windows(&fit, rung, &size);
            prop_assert!(by_groups.abs_diff((FIT_GROUP * (more * size.markers) as f64) as u64) <= 1);
            prop_assert!(windows(&fine, rung, &wide) - windows(&fine, rung, &size) > by_groups);
            let summed = with(Workload { sums_pixels: true, ..size.configured });
            let quick = with(Workload { sums_pixels: false, ..size.configured });
            prop_assert!(windows(&fine, rung, &summed) > windows(&fine, rung, &quick));
        }
    }
}
