//! Finding markers in one image.

use super::{ParamsError, RoiParams, check};
use crate::math::ceil;
use core::f64::consts::PI;

/// Whether markers are darker or brighter than the gel around them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Polarity {
    /// Dark dots on a bright gel (the paper).
    #[default]
    Dark,
    /// Bright dots on a dark gel.
    Bright,
}

/// Which channel of a colour image is searched for markers. A grey image is used as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Channel {
    /// The one in which the print stands out most from its noise; grey, unless another one is better by a
    /// quarter.
    #[default]
    Auto,
    /// The weighted sum of all three, as OpenCV's.
    Grey,
    /// Red alone.
    Red,
    /// Green alone.
    Green,
    /// Blue alone.
    Blue,
}

/// How the background's brightness is estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Background {
    /// Gaussian of `background_kernel_px` (the paper): the slowest stage of all.
    #[default]
    Gaussian,
    /// Mean over a square of blocks of 8 x 8 px, about `background_kernel_px` wide, one level for each block;
    /// smoothed to whole grey levels. The fastest.
    Blocks,
}

/// How different from its background a pixel of a marker must be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Threshold {
    /// By `threshold_levels` (the paper): markers of less contrast are missed.
    #[default]
    Fixed,
    /// By about half the contrast of the markers around, but by 5 standard deviations of the image's noise at
    /// least; components much smaller than the others are dropped. Finds markers of 25 levels of contrast
    /// among noise of 2, and of 120 among 18, whatever the light.
    Auto,
}

/// How a component becomes a centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Centre {
    /// Mean position of the component's pixels (the paper): about 0.13 px rms.
    #[default]
    Binary,
    /// Mean position weighted by contrast over the component and its border: about 0.06 px rms.
    Grey,
    /// Mean position over a square around the marker, weighted by contrast between a fifth and seven tenths
    /// of the largest: 0.045 px rms, 0.2 µs a marker. Markers that do not lie alone in that square get the
    /// `grey` centre.
    SoftThreshold,
    /// Fit of a blurred ellipse in the image's noise and grain: 0.029 px rms, with a covariance for each
    /// marker. A step with weights computed once an image serves most markers; others get steps of their own.
    /// A centroid serves where a fit does not converge (beside the border, merged, smeared).
    Fit,
}

/// Where later frames are searched for markers. The rest frame is always searched whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Search {
    /// The whole image (the paper).
    #[default]
    Whole,
    /// With `threshold` = `auto` and `centre` = `soft_threshold` or `fit`, as long as the labels are certain:
    /// half a pitch around each marker's predicted position, and around places one pitch outside the lattice.
    /// The same frame is searched whole when one of those places shows a marker, when many windows show none,
    /// or when the labels are not certain. Nothing else of the image is read: light and threshold are each
    /// window's own, a frame of 625 markers takes a third to a half of the time, and centres differ from
    /// those of the whole search by a part of their noise: rms errors agree within 3 %. Markers too large or
    /// too close for such a window, and other settings, are searched for in the whole image.
    Windows,
}

/// At which size of the image markers are found. They are centred at its own size always.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum FindAt {
    /// The image's own (the paper).
    #[default]
    FullSize,
    /// With `centre` = `soft_threshold`, half of it in each direction, means of 2 x 2 pixels, where that
    /// shows clearly all there is: markers of 24 px² and more, each alone and away from the border, and
    /// specks. Same rms errors within 1 %; 625 markers are found in three fifths of the instructions at 640 x
    /// 480, in half of them at 1280 x 720. Any other image is searched again at its own size, with the bits
    /// of that search and a fifth more instructions, and so is every image with other rungs of `centre` at no
    /// cost.
    HalfSize,
}

/// The model fit, `Centre::Fit`.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct FitParams {
    /// Standard deviation of all blur, a pixel's own width (0.29 px) included; absent: estimated from every
    /// image. Valid: 0.3 to 5 px. Default: absent. Set it where the lens was measured, to save the estimate.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub blur_px: Option<f64>,
    /// A fit has converged when a step moves the centre by less than this; what is left is a fraction of it.
    /// Below 0.01 px every marker gets steps with its own outline, which take three times as long. Valid:
    /// 1e-12 to 1 px. Default: `0.02` px. Lower it for the least error.
    pub step_px: f64,
}

impl Default for FitParams {
    fn default() -> Self {
        Self { blur_px: None, step_px: 0.02 }
    }
}

/// Finding markers in one image.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct DetectParams {
    /// Whether markers are darker or brighter than the gel. Default: `dark`. Change it for a gel with bright
    /// dots.
    pub polarity: Polarity,
    /// Which channel of a colour image is searched. Default: `auto`. Change it to the channel in which the
    /// print has the most contrast, where the light of coloured LEDs changes with contact. `gelstereo-host`
    /// decodes grey images only, and accepts `auto` and `grey`.
    pub channel: Channel,
    /// How the background's brightness is estimated. Default: `gaussian`. Change it to `blocks` to save time.
    pub background: Background,
    /// How a component becomes a centre. Default: `binary`. Change it to trade accuracy for time; see
    /// docs/accuracy-vs-time.md.
    pub centre: Centre,
    /// Where later frames are searched for markers. Default: `whole`. Change it to `windows` to save time.
    pub search: Search,
    /// At which size of the image markers are found. Default: `full_size`. Change it to `half_size` to save
    /// time with `centre = soft_threshold`.
    pub find_at: FindAt,
    /// Side of the Gaussian kernel that removes pixel noise, odd. Valid: 1 to 31 px. Default: `3` px. Raise
    /// it for a noisy camera; 1 smooths nothing.
    pub smooth_kernel_px: usize,
    /// Side of the kernel that estimates the background, odd. Valid: 1 to 255 px. Default: `51` px. Change it
    /// to two or three pitches in the image.
    pub background_kernel_px: usize,
    /// How different from its background a pixel of a marker must be. Default: `fixed`. Change it to `auto`
    /// where light or contrast vary.
    pub threshold: Threshold,
    /// A pixel belongs to a marker when it differs from its background by at least this, if `threshold` is
    /// `fixed`. The paper's threshold is 220 on the inverted, saturating difference, that is 255 - 220.
    /// Valid: 1 to 255 grey levels. Default: `35` grey levels. Lower it for faint markers, raise it when
    /// noise passes for markers.
    pub threshold_levels: u8,
    /// Side of the elliptic kernel of dilation and erosion, odd; 1 changes nothing. Valid: 1 to 31 px.
    /// Default: `1` px. Raise it to 3 where markers break into pieces.
    pub morphology_kernel_px: usize,
    /// Smallest marker. Valid: 1 to 1000000 px², up to `max_area_px2`. Default: `6` px². Raise it when specks
    /// pass for markers; lower it for dense prints.
    pub min_area_px2: u32,
    /// Largest marker. Valid: 1 to 100000000 px². Default: `2000` px². Raise it for large dots close to the
    /// camera.
    pub max_area_px2: u32,
    /// Least and largest diameter of a marker; it takes the place of `min_area_px2` and `max_area_px2`.
    /// Valid: 1 to 1000 px, the least first. Default: absent. Set it where objects of another size stand out
    /// behind the gel; `gelstereo inspect` states the diameter.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub dot_px: Option<[f64; 2]>,
    /// Least area over that of the bounding box's inscribed ellipse; scratches and merged pairs have less.
    /// Valid: 0 to 1. Default: `0.5`. Lower it for ragged dots; raise it when scratches pass for markers.
    pub min_fill: f64,
    /// Standard deviation of a centre per axis, for rungs that do not measure their own. Valid: 0.0001 to 100
    /// px. Default: `0.09` px, the paper's binary centroid. Change it to what a still gel shows.
    pub centre_sigma_px: f64,
    /// Where in the images markers are.
    pub roi: RoiParams,
    /// The model fit of `centre = fit`.
    pub fit: FitParams,
}

impl Default for DetectParams {
    fn default() -> Self {
        Self {
            polarity: Polarity::Dark,
            channel: Channel::Auto,
            background: Background::Gaussian,
            centre: Centre::Binary,
            search: Search::Whole,
            find_at: FindAt::FullSize,
            smooth_kernel_px: 3,
            background_kernel_px: 51,
            threshold: Threshold::Fixed,
            threshold_levels: 35,
            morphology_kernel_px: 1,
            min_area_px2: 6,
            max_area_px2: 2000,
            dot_px: None,
            min_fill: 0.5,
            centre_sigma_px: 0.09,
            roi: RoiParams::default(),
            fit: FitParams::default(),
        }
    }
}

impl DetectParams {
    /// Least and largest area of a marker, px²: those of `dot_px`, if it is set.
    #[must_use]
    pub fn areas_px2(&self) -> [u32; 2] {
        let area_px2 = |diameter_px: f64| 0.25 * PI * diameter_px * diameter_px;
        self.dot_px.map_or([self.min_area_px2, self.max_area_px2], |[least, most]| {
            [(area_px2(least) as u32).max(1), ceil(area_px2(most)) as u32]
        })
    }

    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let odd = |name, x: usize, most: usize| {
            check(
                x % 2 == 1 && x <= most,
                name,
                x as f64,
                if most == 255 { "odd, 1 to 255" } else { "odd, 1 to 31" },
            )
        };
        odd("detect.smooth_kernel_px", self.smooth_kernel_px, 31)?;
        odd("detect.background_kernel_px", self.background_kernel_px, 255)?;
        odd("detect.morphology_kernel_px", self.morphology_kernel_px, 31)?;
        let threshold = self.threshold_levels;
        check(threshold > 0, "detect.threshold_levels", f64::from(threshold), "1 to 255")?;
        let (min_area, max_area) = (self.min_area_px2, self.max_area_px2);
        let valid = "1 to 100000000 px²";
        check((1..=100_000_000).contains(&max_area), "detect.max_area_px2", f64::from(max_area), valid)?;
        let valid = "1 to 1000000 px², up to detect.max_area_px2";
        let areas_ok = (1..=max_area.min(1_000_000)).contains(&min_area);
        check(areas_ok, "detect.min_area_px2", f64::from(min_area), valid)?;
        if let Some([least, most]) = self.dot_px {
            let valid = "two diameters, 1 to 1000 px, the least first";
            check((1.0..=1000.0).contains(&least), "detect.dot_px", least, valid)?;
            check((least..=1000.0).contains(&most), "detect.dot_px", most, valid)?;
        }
        check((0.0..=1.0).contains(&self.min_fill), "detect.min_fill", self.min_fill, "from 0 to 1")?;
        let sigma = self.centre_sigma_px;
        check((1e-4..=100.0).contains(&sigma), "detect.centre_sigma_px", sigma, "0.0001 to 100 px")?;
        self.roi.validate()?;
        if let Some(blur) = self.fit.blur_px {
            check((0.3..=5.0).contains(&blur), "detect.fit.blur_px", blur, "0.3 to 5 px, or absent")?;
        }
        let step = self.fit.step_px;
        check((1e-12..=1.0).contains(&step), "detect.fit.step_px", step, "1e-12 to 1 px")
    }
}
