//! The frame stream: headers with a right checksum and wrong content, cut payloads, garbage. However the
//! bytes are cut into chunks, the decoder says the same of them, takes all, and holds no more than came.
#![no_main]

use gelstereo_host::codec::frame_stream::{
    FrameDecoder, FrameHeader, FrameStreamError, HEADER_BYTES, MAX_PAYLOAD_BYTES, PayloadFormat,
};
use gelstereo_host::source::StereoLayout;
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;

type Found = std::result::Result<(FrameHeader, Vec<u8>), FrameStreamError>;

/// The CRC-32 of zlib, PNG and this format, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg()))
    })
}

/// A header, most of them valid; one whose bytes were changed afterwards gets a right checksum again.
fn header(u: &mut Unstructured<'_>, payload: &[u8]) -> Result<[u8; HEADER_BYTES]> {
    let width_px = 2 * u.int_in_range(1..=8)?;
    let mut bytes = FrameHeader {
        sequence: u.arbitrary()?,
        captured_ns: None,
        width_px,
        height_px: 1,
        format: PayloadFormat::Jpeg,
        layout: *u.choose(&[StereoLayout::SideBySide, StereoLayout::InterleavedSwapped])?,
        payload_bytes: payload.len() as u32,
        payload_crc: u.arbitrary::<bool>()?.then(|| crc32(payload)),
    }
    .encode();
    for _ in 0..u.int_in_range(0..=2_u8)? {
        bytes[u.int_in_range(0..=HEADER_BYTES - 5)?] = u.arbitrary()?;
    }
    let crc = crc32(&bytes[..HEADER_BYTES - 4]);
    bytes[HEADER_BYTES - 4..].copy_from_slice(&crc.to_le_bytes());
    Ok(bytes)
}

fn stream(u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    for _ in 0..u.int_in_range(1..=6_u8)? {
        let count = u.int_in_range(1..=60)?;
        let content = u.bytes(count)?.to_vec();
        match u.int_in_range(0..=3_u8)? {
            0 => bytes.extend(content),
            1 => bytes.extend(&header(u, &content)?[..count.min(HEADER_BYTES)]),
            _ => {
                bytes.extend(header(u, &content)?);
                bytes.extend(content);
            }
        }
    }
    Ok(bytes)
}

fn decode(mut rest: &[u8], mut size: impl FnMut() -> usize) -> Vec<Found> {
    let (mut decoder, mut found, total) = (FrameDecoder::default(), Vec::new(), rest.len());
    while !rest.is_empty() {
        let (mut chunk, after) = rest.split_at(size().clamp(1, rest.len()));
        while let Some(next) = decoder.next_frame(&mut chunk) {
            assert!(decoder.payload().len() <= total.min(MAX_PAYLOAD_BYTES as usize));
            found.push(next.map(|header| (header, decoder.payload().to_vec())));
        }
        assert!(chunk.is_empty());
        rest = after;
    }
    found.extend(decoder.finish().err().map(Err));
    for (header, payload) in found.iter().flatten() {
        assert!(header.validate().is_ok() && header.payload_bytes as usize == payload.len());
    }
    found
}

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let bytes = stream(&mut u)?;
    let whole = decode(&bytes, || bytes.len());
    let cut = decode(&bytes, || u.int_in_range(1..=50).unwrap_or(1));
    assert_eq!(whole, cut);
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});
