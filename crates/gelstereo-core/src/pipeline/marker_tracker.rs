//! Markers of any layout in one camera: detection and tracking without a rig.

use crate::detect::{DetectError, Detector, Folds, Markers, max_markers};
use crate::image::GrayView;
use crate::params::{Params, Region};
use crate::track::{Certainty, ScatteredTracker, TooFewMarkers, Tracks};
use core::fmt;

/// Why an image gave no tracks. The tracks keep their positions, and their markers are held.
#[derive(Clone, Debug, PartialEq)]
pub enum MarkerTrackerError {
    /// The image shows nothing that can be measured.
    Detect(DetectError),
    /// The first image has too few markers.
    TooFew(TooFewMarkers),
    /// An image has another size than the first one.
    Size {
        /// Width and height found, pixels.
        found: (usize, usize),
        /// Width and height of the first image, pixels.
        expected: (usize, usize),
    },
}

impl fmt::Display for MarkerTrackerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Detect(error) => error.fmt(f),
            Self::TooFew(error) => error.fmt(f),
            Self::Size { found, expected } => write!(
                f,
                "the image is {} x {} pixels, but the first one was {} x {}: reset the tracker before images \
                 of another size",
                found.0, found.1, expected.0, expected.1
            ),
        }
    }
}

impl core::error::Error for MarkerTrackerError {}

/// Detects and tracks the markers of one camera, in any layout. The first image is the rest image.
///
/// It uses `detect` and `track` of the settings; `lattice` has no effect. See [`ScatteredTracker`] for the
/// method.
#[derive(Clone, Debug)]
pub struct MarkerTracker {
    params: Params,
    detector: Detector,
    folds: Folds,
    tracker: Option<ScatteredTracker>,
    size_px: (usize, usize),
    detected: Markers,
    tracks: Tracks,
}

impl MarkerTracker {
    /// A tracker that waits for its rest image. The search is within a region of interest.
    #[must_use]
    pub fn new(params: &Params, region: Region<'_>) -> Self {
        Self {
            detector: Detector::new(&params.detect).within(region),
            folds: Folds::default(),
            params: params.clone(),
            tracker: None,
            size_px: (0, 0),
            detected: Markers::default(),
            tracks: Tracks::default(),
        }
    }

    /// Processes an image. Does not allocate after the first two of a print, of which the first is the rest
    /// image.
    ///
    /// # Errors
    /// [`MarkerTrackerError`]; the next image is processed as usual.
    pub fn process(&mut self, image: GrayView<'_>) -> Result<Certainty, MarkerTrackerError> {
        let found = (image.width(), image.height());
        let Some(tracker) = &mut self.tracker else {
            self.detector.run(image, &mut self.detected).map_err(MarkerTrackerError::Detect)?;
            self.folds.reserve(max_markers(&self.params.detect, found));
            self.folds.widen(&mut self.detected);
            let mut tracker = ScatteredTracker::new(&self.params.track, found);
            tracker
                .initialise(&self.detected, max_markers(&self.params.detect, found), &mut self.tracks)
                .map_err(MarkerTrackerError::TooFew)?;
            (self.tracker, self.size_px) = (Some(tracker), found);
            return Ok(Certainty::Certain);
        };
        if found != self.size_px {
            return Err(MarkerTrackerError::Size { found, expected: self.size_px });
        }
        if let Err(error) = self.detector.run(image, &mut self.detected) {
            tracker.hold(&mut self.tracks);
            return Err(MarkerTrackerError::Detect(error));
        }
        self.folds.widen(&mut self.detected);
        Ok(tracker.run(&self.detected, &mut self.tracks))
    }

    /// Positions, covariances and states after the last image, in the order of the rest image's markers.
    #[must_use]
    pub const fn tracks(&self) -> &Tracks {
        &self.tracks
    }

    /// The tracker, once there was a rest image.
    #[must_use]
    pub const fn tracker(&self) -> Option<&ScatteredTracker> {
        self.tracker.as_ref()
    }

    /// Forgets the print: the next image is the rest image.
    pub fn reset(&mut self) {
        self.detector.reset();
        (self.tracker, self.tracks) = (None, Tracks::default());
    }
}
