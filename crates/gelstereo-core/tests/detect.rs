//! Detection against dots whose centres are known.

mod support;

use gelstereo_core::detect::{DetectError, Detector, Markers};
use gelstereo_core::math::DVec2;
use gelstereo_core::params::{Background, Centre, DetectParams, Polarity};
use support::{Dots, errors, paper_lattice, view};

fn detect(params: &DetectParams, image: &[u8], width: usize) -> Result<Markers, DetectError> {
    let mut markers = Markers::default();
    Detector::new(params).run(view(image, width), &mut markers)?;
    Ok(markers)
}

fn every_rung() -> [DetectParams; 4] {
    [
        (Background::Gaussian, Centre::Binary),
        (Background::Gaussian, Centre::Grey),
        (Background::Box, Centre::Binary),
        (Background::Box, Centre::Grey),
    ]
    .map(|(background, centre)| DetectParams { background, centre, ..DetectParams::default() })
}

#[test]
fn every_rung_finds_every_dot() {
    let truth = paper_lattice();
    for noise in [0.0, 2.0] {
        let dots = Dots { noise, ..Dots::new(640, 480, truth.clone()) };
        for params in every_rung() {
            let markers = detect(&params, &dots.render(), 640).unwrap();
            let (rms, near) = errors(&markers.centres_px, &truth);
            println!("{:?} {:?} noise {noise}: rms {rms:.4} px", params.background, params.centre);
            assert_eq!((markers.centres_px.len(), near), (625, 625));
            let most = if params.centre == Centre::Grey { 0.05 } else { 0.13 };
            assert!(rms <= most, "{params:?} noise {noise}: {rms}");
        }
    }
}

#[test]
fn bright_dots_are_dark_dots_of_the_inverted_image() {
    let dark = Dots {
        noise: 2.0,
        ..Dots::new(160, 120, support::lattice(5, 7, 17.0, DVec2::new(80.2, 60.1), 3.0, 0.0))
    }
    .render();
    let bright: Vec<u8> = dark.iter().map(|v| 255 - v).collect();
    for params in every_rung() {
        let expected = detect(&params, &dark, 160).unwrap();
        assert_eq!(expected.centres_px.len(), 35);
        let found = detect(&DetectParams { polarity: Polarity::Bright, ..params }, &bright, 160).unwrap();
        assert_eq!(found.area_px2, expected.area_px2);
        for (a, b) in found.centres_px.iter().zip(&expected.centres_px) {
            // Rounding of the fixed-point filters is not symmetric.
            assert!(a.distance(*b) < 1e-3, "{a} {b}");
        }
    }
}
