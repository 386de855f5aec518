//! Damaged JPEG images of cameras: an error, or an image of the stated size that comes out the same again.
#![no_main]

use gelstereo_host::source::jpeg::{JpegDecoder, trimmed};
use gelstereo_host::source::{Gray, StereoLayout};
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

const FILES: [&[u8]; 2] = [include_bytes!("../seeds/gray.jpg"), include_bytes!("../seeds/colour.jpg")];

/// One of the files with some bytes written over, others put in, and maybe its end cut off.
fn damaged(u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let mut jpeg = u.choose(&FILES)?.to_vec();
    for _ in 0..u.int_in_range(0..=16)? {
        let at = u.choose_index(jpeg.len())?;
        jpeg[at] = u.arbitrary()?;
    }
    if u.ratio(1, 4)? {
        // As a bus puts a piece of another frame in.
        let at = u.choose_index(jpeg.len())?;
        let count = u.int_in_range(0..=64)?;
        jpeg.splice(at..at, u.bytes(count)?.iter().copied());
    }
    if u.ratio(1, 4)? {
        let cut = u.choose_index(jpeg.len())?;
        jpeg.truncate(cut);
        if u.arbitrary()? {
            jpeg.extend_from_slice(&[0xff, 0xd9]);
        }
    }
    Ok(jpeg)
}

fuzz_target!(|bytes: &[u8]| {
    let Ok(jpeg) = damaged(&mut Unstructured::new(bytes)) else { return };
    let (mut decoder, mut first, mut second) = (JpegDecoder::default(), Gray::default(), Gray::default());
    let result = decoder.decode(&jpeg, &mut first);
    assert_eq!(result, decoder.decode(&jpeg, &mut second));
    if result.is_ok() {
        assert!(first == second && first.pixels.len() == first.width * first.height);
        assert!(trimmed(&jpeg).is_ok());
        let (mut left, mut right) = (Gray::default(), Gray::default());
        let view = first.view().expect("a decoded image is an image");
        let split = StereoLayout::SideBySide.split(view, &mut left, &mut right);
        assert_eq!(split.is_ok(), first.width % 2 == 0);
    } else {
        assert!(first.width == 0 && first.height == 0);
    }
});
