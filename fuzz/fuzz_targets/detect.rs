//! Images of any size and content, through every rung of detection: centres are finite and lie within the
//! image, and the same image gives the same markers again.
#![no_main]

use gelstereo_core::detect::{Detector, Markers};
use gelstereo_core::image::GrayView;
use gelstereo_core::params::{Background, Centre, Params, Polarity, Threshold};
use libfuzzer_sys::arbitrary::{Arbitrary, Result, Unstructured};
use libfuzzer_sys::fuzz_target;

#[derive(Debug)]
struct Input {
    params: Params,
    width: usize,
    stride: usize,
    pixels: Vec<u8>,
}

impl<'a> Arbitrary<'a> for Input {
    fn arbitrary(u: &mut Unstructured<'a>) -> Result<Self> {
        let mut params = Params::default();
        let detect = &mut params.detect;
        detect.background = *u.choose(&[Background::Gaussian, Background::Blocks])?;
        detect.centre = *u.choose(&[Centre::Binary, Centre::Grey, Centre::SoftThreshold, Centre::Fit])?;
        detect.threshold = *u.choose(&[Threshold::Fixed, Threshold::Auto])?;
        detect.polarity = *u.choose(&[Polarity::Dark, Polarity::Bright])?;
        detect.smooth_kernel_px = 2 * u.int_in_range(0..=15)? + 1;
        detect.background_kernel_px = 2 * u.int_in_range(0..=127)? + 1;
        detect.morphology_kernel_px = 2 * u.int_in_range(0..=3)? + 1;
        detect.threshold_levels = u.int_in_range(1..=255)?;
        detect.min_area_px2 = u.int_in_range(1..=30)?;
        let width = u.int_in_range(1..=80)?;
        let stride = width + u.int_in_range(0..=3)?;
        let pixels = u.bytes(u.len())?.to_vec();
        Ok(Self { params, width, stride, pixels })
    }
}

fuzz_target!(|input: Input| {
    if input.params.validate().is_err() {
        return;
    }
    let height = (input.pixels.len() + input.stride - input.width) / input.stride;
    let Ok(image) = GrayView::new(&input.pixels, input.width, height, input.stride) else { return };
    let mut detector = Detector::new(&input.params.detect);
    let (mut markers, mut again) = (Markers::default(), Markers::default());
    let found = detector.run(image, &mut markers);
    assert_eq!(found, detector.run(image, &mut again));
    assert_eq!(markers, again);
    let lists = [markers.centres_px.len(), markers.covariance_px2.len(), markers.area_px2.len()];
    assert!(lists.iter().all(|&n| n == lists[0]));
    for (centre, covariance) in markers.centres_px.iter().zip(&markers.covariance_px2) {
        assert!(centre.x >= -0.5 && centre.x <= input.width as f64 - 0.5, "{centre}");
        assert!(centre.y >= -0.5 && centre.y <= height as f64 - 0.5, "{centre}");
        assert!(covariance.as_flattened().iter().all(|c| c.is_finite()));
    }
});
