//! Channels of colour images.

use gelstereo_core::color::ColorView;
use gelstereo_core::params::{Channel, DetectParams, Polarity};
use proptest::prelude::*;

const SIDE: usize = 96;

/// Dots of 6 px, 16 px apart, whose contrast each channel (blue, green, red) shows in its own way.
fn dots(contrast: [i32; 3], noise: i32, seed: u32) -> Vec<u8> {
    let mut state = seed.wrapping_mul(2_654_435_761).max(1);
    let mut bytes = Vec::new();
    for y in 0..SIDE {
        for x in 0..SIDE {
            let dot = (x % 16).abs_diff(8).pow(2) + (y % 16).abs_diff(8).pow(2) <= 9;
            for levels in contrast {
                state ^= state << 13;
                state ^= state >> 17;
                state ^= state << 5;
                let random = (state % (2 * noise as u32 + 1)) as i32 - noise;
                bytes.push((128 - if dot { levels } else { 0 } + random).clamp(0, 255) as u8);
            }
        }
    }
    bytes
}

#[test]
fn channels_are_in_the_order_of_opencv() {
    let view = ColorView::new(&[1, 2, 3, 10, 20, 30, 9, 9, 9], 2, 1, 9).unwrap();
    assert_eq!((view.width(), view.height()), (2, 1));
    let channel = |channel| {
        let mut out = vec![7; 5];
        view.write(channel, &mut out);
        out
    };
    assert_eq!(channel(Channel::Blue), [1, 10]);
    assert_eq!(channel(Channel::Green), [2, 20]);
    assert_eq!(channel(Channel::Red), [3, 30]);
    // 0.114 b + 0.587 g + 0.299 r.
    assert_eq!(channel(Channel::Grey), [2, 22]);
    assert_eq!(channel(Channel::Auto), channel(Channel::Grey));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_channel_that_shows_the_print_is_chosen(
        place in 0_usize..3, levels in 40_i32..100, noise in 1_i32..6, bright: bool, seed: u32,
    ) {
        let mut contrast = [0; 3];
        contrast[place] = if bright { -levels } else { levels };
        let bytes = dots(contrast, noise, seed);
        let params = DetectParams {
            polarity: if bright { Polarity::Bright } else { Polarity::Dark },
            ..DetectParams::default()
        };
        let found = ColorView::new(&bytes, SIDE, SIDE, 3 * SIDE).unwrap().best_channel(&params);
        // Grey has six tenths of the green and six tenths of its noise: both show the print as well.
        let as_well = place == 1 && found == Channel::Grey;
        prop_assert!(as_well || found == [Channel::Blue, Channel::Green, Channel::Red][place], "{:?}", found);
    }

    #[test]
    fn a_print_in_all_channels_keeps_grey(levels in 20_i32..100, noise in 1_i32..12, seed: u32) {
        let bytes = dots([levels; 3], noise, seed);
        let view = ColorView::new(&bytes, SIDE, SIDE, 3 * SIDE).unwrap();
        prop_assert_eq!(view.best_channel(&DetectParams::default()), Channel::Grey);
    }

    #[test]
    fn tiny_and_plain_images_have_a_channel(width in 1_usize..9, height in 1_usize..9, level: u8) {
        let bytes = vec![level; 3 * width * height];
        let view = ColorView::new(&bytes, width, height, 3 * width).unwrap();
        prop_assert_eq!(view.best_channel(&DetectParams::default()), Channel::Grey);
    }
}
