//! Images of any content and positions of any kind through the search near expected positions: what it finds is what the
//! search of the whole image finds, within reach of the position it is given to, and nobody else's.
#![no_main]

use gelstereo_core::detect::{Detector, Markers};
use gelstereo_core::detect::{Found, WindowObservation};
use gelstereo_core::image::GrayView;
use gelstereo_core::math::DVec2;
use gelstereo_core::params::{Background, Centre, Params, Polarity, Threshold};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

/// Dots of one size over even ground, some of them anywhere, and then bytes as they come.
fn image(u: &mut Unstructured<'_>, width: usize, height: usize) -> Result<(Vec<u8>, Vec<DVec2>)> {
    let ground = u.int_in_range(100..=255_u8)?;
    let mut pixels = vec![ground; width * height];
    let (mut centres, radius) = (Vec::new(), u.int_in_range(1..=5_i64)?);
    for _ in 0..u.int_in_range(0..=24_u8)? {
        let (x, y) = (u.int_in_range(0..=width as i64 - 1)?, u.int_in_range(0..=height as i64 - 1)?);
        let level = u.int_in_range(0..=ground)?;
        centres.push(DVec2::new(x as f64, y as f64));
        for (n, pixel) in pixels.iter_mut().enumerate() {
            let (dx, dy) = ((n % width) as i64 - x, (n / width) as i64 - y);
            if dx * dx + dy * dy <= radius * radius {
                *pixel = level;
            }
        }
    }
    for _ in 0..u.int_in_range(0..=64_u8)? {
        let at = u.choose_index(pixels.len())?;
        pixels[at] = u.arbitrary()?;
    }
    Ok((pixels, centres))
}

/// Near one of the dots, or now and then anywhere.
fn position(u: &mut Unstructured<'_>, centres: &[DVec2]) -> Result<DVec2> {
    if centres.is_empty() || u.ratio(1, 16)? {
        return Ok(DVec2::new(u.arbitrary()?, u.arbitrary()?));
    }
    let off = DVec2::new(f64::from(u.arbitrary::<i8>()?), f64::from(u.arbitrary::<i8>()?)) / 16.0;
    Ok(*u.choose(centres)? + off)
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let mut params = Params::default();
    let detect = &mut params.detect;
    detect.background = *u.choose(&[Background::Blocks, Background::Gaussian])?;
    detect.centre = *u.choose(&[Centre::Binary, Centre::Grey, Centre::Fit])?;
    detect.threshold = *u.choose(&[Threshold::Fixed, Threshold::Auto])?;
    detect.polarity = *u.choose(&[Polarity::Dark, Polarity::Bright])?;
    detect.background_kernel_px = 2 * u.int_in_range(1..=30)? + 1;
    detect.morphology_kernel_px = 2 * u.int_in_range(0..=1)? + 1;
    detect.threshold_levels = u.int_in_range(1..=60)?;
    let reach_px = match u.int_in_range(0..=31_u8)? {
        0 => u.arbitrary()?,
        n => f64::from(n),
    };
    let (width, height) = (u.int_in_range(1..=96)?, u.int_in_range(1..=72)?);
    let (pixels, centres) = image(&mut u, width, height)?;
    let count = u.int_in_range(0..=30)?;
    let expected_px = (0..count).map(|_| position(&mut u, &centres)).collect::<Result<Vec<_>>>()?;
    let Ok(view) = GrayView::new(&pixels, width, height, width) else { return Ok(()) };
    if params.validate().is_err() {
        return Ok(());
    }
    let mut detector = Detector::new(&params.detect);
    let (mut all, mut found, mut again) = (Markers::default(), Found::default(), Found::default());
    let whole = detector.run(view, &mut all);
    let near = detector.run_near(view, &expected_px, reach_px, &mut found);
    assert_eq!(near, detector.run_near(view, &expected_px, reach_px, &mut again));
    assert_eq!(found, again);
    if near.is_err() {
        assert!(found.sights.is_empty() && found.markers.centres_px.is_empty());
        return Ok(());
    }
    assert_eq!(found.sights.len(), count);
    let mut given = vec![false; found.markers.centres_px.len()];
    for (sight, at) in found.sights.iter().zip(&expected_px) {
        let WindowObservation::Marker(m) = *sight else { continue };
        let (m, centre) = (m as usize, found.markers.centres_px[m as usize]);
        assert!(!core::mem::replace(&mut given[m], true), "a marker of two positions");
        assert!(
            centre.is_finite()
                && found.markers.covariance_px2[m].as_flattened().iter().all(|c| c.is_finite())
        );
        // The fit may move a centre by a pixel and more.
        let most_px = reach_px + if params.detect.centre == Centre::Fit { 4.0 } else { 1e-9 };
        assert!((centre - *at).abs().max_element() <= most_px, "{centre} for {at}");
        // With areas judged by the usual one, other candidates may make for another usual one.
        if whole.is_ok() && params.detect.centre != Centre::Fit && params.detect.threshold == Threshold::Fixed
        {
            assert!(all.centres_px.contains(&centre), "{centre} is not in the whole image");
        }
    }
    assert!(given.into_iter().all(|given| given));
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
