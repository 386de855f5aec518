//! Cameras' JPEG images: the decoder against another one's encoder, and against damage.
#![allow(clippy::unwrap_used)]

use gelstereo_host::source::Gray;
use gelstereo_host::source::jpeg::{DECODER, JpegDecoder, JpegError, trimmed};
use image::ExtendedColorType::{L8, Rgb8};
use image::codecs::jpeg::JpegEncoder;
use proptest::prelude::*;

const WIDTH: u32 = 256;
const HEIGHT: u32 = 48;

/// A slope with a pattern, as a file of one or three components.
fn file(colours: bool) -> (Vec<u8>, Vec<u8>) {
    let level = |i: u32| ((i % WIDTH) / 2 + (i / WIDTH) * 2 + (i % 5) * 3) as u8;
    let gray: Vec<u8> = (0..WIDTH * HEIGHT).map(level).collect();
    let mut jpeg = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut jpeg, 95);
    if colours {
        let rgb: Vec<u8> = gray.iter().flat_map(|&level| [level; 3]).collect();
        encoder.encode(&rgb, WIDTH, HEIGHT, Rgb8).unwrap();
    } else {
        encoder.encode(&gray, WIDTH, HEIGHT, L8).unwrap();
    }
    (jpeg, gray)
}

/// Without the segments that state Huffman tables.
fn without_tables(jpeg: &[u8]) -> Vec<u8> {
    let (mut out, mut at) = (jpeg[..2].to_vec(), 2);
    while jpeg[at + 1] != 0xda {
        let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] != 0xc4 {
            out.extend_from_slice(&jpeg[at..end]);
        }
        at = end;
    }
    out.extend_from_slice(&jpeg[at..]);
    out
}

#[test]
fn luma_is_the_encoders_within_its_rounding() {
    for colours in [false, true] {
        let (jpeg, levels) = file(colours);
        let mut gray = Gray { width: 1, height: 1, pixels: vec![9; 100_000] };
        JpegDecoder::default().decode(&jpeg, &mut gray).unwrap();
        assert_eq!((gray.width, gray.height), (WIDTH as usize, HEIGHT as usize));
        let worst = gray.pixels.iter().zip(&levels).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(gray.pixels.len() == levels.len() && worst <= 6, "{worst} levels, colours {colours}");
    }
}

#[test]
fn a_motion_jpeg_frame_without_tables_gives_the_same_pixels() {
    let (jpeg, _) = file(true);
    let bare = without_tables(&jpeg);
    assert!(bare.len() < jpeg.len());
    let mut images = [Gray::default(), Gray::default()];
    let mut decoder = JpegDecoder::default();
    decoder.decode(&jpeg, &mut images[0]).unwrap();
    decoder.decode(&bare, &mut images[1]).unwrap();
    assert_eq!(images[0], images[1]);
}

#[test]
fn padding_after_the_end_is_left_out() {
    let (jpeg, _) = file(false);
    let padded = [&jpeg[..], &[0; 300]].concat();
    assert_eq!(trimmed(&padded).unwrap(), jpeg);
    JpegDecoder::default().decode(&padded, &mut Gray::default()).unwrap();
}

#[test]
fn every_cut_is_an_error() {
    let (jpeg, _) = file(true);
    let (mut decoder, mut gray) = (JpegDecoder::default(), Gray::default());
    for cut in 0..jpeg.len() {
        let error = decoder.decode(&jpeg[..cut], &mut gray).unwrap_err();
        let expected = if cut < 2 { JpegError::NoStart } else { JpegError::NoEnd { bytes: cut } };
        assert_eq!(error, expected, "cut at {cut}");
        // A driver may put the end marker where the data was lost. The decoder holds up to 8 bytes, and takes
        // no notice when these run short.
        let ended = [&jpeg[..cut], &[0xff, 0xd9]].concat();
        let lost = (jpeg.len() - 2).saturating_sub(cut);
        assert!(decoder.decode(&ended, &mut gray).is_err() || lost <= 8, "{lost} bytes are missing");
    }
}

#[test]
fn the_decoder_named_in_recordings_is_the_pinned_one() {
    let version = DECODER.strip_prefix("zune-jpeg ").unwrap();
    assert!(include_str!("../Cargo.toml").contains(&format!("zune-jpeg = {{ version = \"={version}\"")));
}

proptest! {
    /// Damaged bytes give an error or an image of the stated size, never a panic.
    #[test]
    fn damage_does_not_panic(
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let (mut jpeg, _) = file(true);
        for (index, byte) in damage {
            let at = index.index(jpeg.len());
            jpeg[at] = byte;
        }
        let mut gray = Gray::default();
        if JpegDecoder::default().decode(&jpeg, &mut gray).is_ok() {
            prop_assert_eq!(gray.pixels.len(), gray.width * gray.height);
        }
    }
}
