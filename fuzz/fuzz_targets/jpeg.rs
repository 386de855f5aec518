//! Motion JPEG of cameras: whatever the bytes, an image of the stated size, or refused by name; twice the
//! same.
#![no_main]

use gelstereo_host::source::Gray;
use gelstereo_host::source::jpeg::{JpegDecoder, trimmed};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

/// Noise of 32 x 16 pixels as grey and as YCbCr 4:2:2, without Huffman tables, as many cameras send it.
const GREY: &str = "\
    ffd8ffdb0043000d090a0b0a080d0b0a0b0e0e0d0f13201513121213271c1e17202e2931302e292d2c333a4a3e333646\
    372c2d405741464c4e525352323e5a615a50604a51524fffc0000b080010002001011100ffda0008010100003f008247\
    cd342eea9e1422a6738aa2a326a755c55841c6691b9affd9";
const COLOR: &str = "\
    ffd8ffdb0043000d090a0b0a080d0b0a0b0e0e0d0f13201513121213271c1e17202e2931302e292d2c333a4a3e333646\
    372c2d405741464c4e525352323e5a615a50604a51524fffdb0043010e0e0e131113261515264f352d354f4f4f4f4f4f\
    4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4fffc00011\
    080010002003012100021101031101ffda000c03010002110311003f00ea5db34817359417b2823e426fda4d92c6a454\
    8c715e4d792a954f4e8a70a4550326a50315e962a7f64f3f0f1ea4a9d286e6bc54fdf6cf5daf7123ffd9";

fn bytes_of(hex: &str) -> Vec<u8> {
    let digit = |digit: u8| char::from(digit).to_digit(16).expect("a hexadecimal digit") as u8;
    hex.as_bytes().chunks(2).map(|pair| digit(pair[0]) << 4 | digit(pair[1])).collect()
}

/// An image with a few of its bytes changed, put in, or cut off.
fn damaged(u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let mut image = bytes_of(if u.arbitrary()? { GREY } else { COLOR });
    for _ in 0..u.int_in_range(0..=12_u8)? {
        let at = u.choose_index(image.len())?;
        match u.int_in_range(0..=7_u8)? {
            0 => image.truncate(at + 1),
            1 => image.insert(at, u.arbitrary()?),
            2 => drop(image.remove(at)),
            3 => image[at] ^= 1 << u.int_in_range(0..=7_u8)?,
            _ => image[at] = u.arbitrary()?,
        }
        if image.len() < 2 {
            break;
        }
    }
    Ok(image)
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let image = if u.ratio(1, 8)? { u.bytes(u.len())?.to_vec() } else { damaged(&mut u)? };
    if let Ok(cut) = trimmed(&image) {
        assert!(cut.starts_with(&[0xff, 0xd8]) && cut.ends_with(&[0xff, 0xd9]));
    }
    let (mut decoder, mut first, mut again) = (JpegDecoder::default(), Gray::default(), Gray::default());
    match decoder.decode(&image, &mut first) {
        Ok(()) => {
            assert_eq!(first.pixels.len(), first.width * first.height);
            // What the decoder kept of the last image has no influence.
            decoder.decode(&image, &mut again).expect("it was decoded before");
            assert_eq!(first, again);
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
