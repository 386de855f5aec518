//! The frame stream's codec: any chunks, any garbage, any damage.
#![allow(clippy::unwrap_used)]

use gelstereo_host::codec::frame_stream::{
    FrameDecoder, FrameHeader, FrameStreamError, HEADER_BYTES, MAX_PAYLOAD_BYTES, PayloadFormat,
};
use gelstereo_host::source::StereoLayout;
use proptest::collection::vec;
use proptest::prelude::*;

const LAYOUTS: [StereoLayout; 4] = [
    StereoLayout::SideBySide,
    StereoLayout::SideBySideSwapped,
    StereoLayout::Interleaved,
    StereoLayout::InterleavedSwapped,
];

#[derive(Clone, Debug, PartialEq)]
struct Sent {
    header: FrameHeader,
    payload: Vec<u8>,
}

impl Sent {
    fn bytes(&self) -> Vec<u8> {
        [&self.header.encode()[..], &self.payload].concat()
    }
}

fn frame() -> impl Strategy<Value = Sent> {
    let shape = (1..20_u32, 1..10_u32, vec(any::<u8>(), 1..300), any::<bool>());
    let words = (any::<u64>(), any::<u64>(), 0..LAYOUTS.len(), any::<bool>());
    (shape, words).prop_map(|((half, height_px, bytes, is_jpeg), (sequence, ns, layout, has_crc))| {
        let width_px = 2 * half;
        let payload: Vec<u8> = if is_jpeg {
            bytes
        } else {
            bytes.iter().copied().cycle().take((width_px * height_px) as usize).collect()
        };
        let header = FrameHeader {
            sequence,
            captured_ns: (ns != 0).then_some(ns),
            width_px,
            height_px,
            format: if is_jpeg { PayloadFormat::Jpeg } else { PayloadFormat::Grey8 },
            layout: LAYOUTS[layout],
            payload_bytes: payload.len() as u32,
            payload_crc: has_crc.then(|| crc32fast::hash(&payload)),
        };
        Sent { header, payload }
    })
}

/// Bytes, more of them than by chance the first ones of a header.
fn garbage() -> impl Strategy<Value = Vec<u8>> {
    vec(prop_oneof![4 => any::<u8>(), 1 => Just(0x89), 1 => Just(b'G')], 0..80)
}

type Found = Result<Sent, FrameStreamError>;

/// Everything that a decoder says of these bytes in chunks of these sizes, over and over.
fn decode(bytes: &[u8], chunks: &[usize]) -> Vec<Found> {
    let (mut decoder, mut found, mut rest) = (FrameDecoder::default(), Vec::new(), bytes);
    for &size in chunks.iter().cycle() {
        let (mut chunk, after) = rest.split_at(size.min(rest.len()));
        rest = after;
        while let Some(next) = decoder.next_frame(&mut chunk) {
            found.push(next.map(|header| Sent { header, payload: decoder.payload().to_vec() }));
        }
        assert!(chunk.is_empty(), "all bytes are taken");
        if rest.is_empty() {
            break;
        }
    }
    found.extend(decoder.finish().err().map(Err));
    found
}

proptest! {
    #[test]
    fn frames_come_back_in_any_chunks(
        frames in vec(frame(), 0..5),
        chunks in vec(1..400_usize, 1..6),
    ) {
        let bytes = frames.iter().map(Sent::bytes).collect::<Vec<_>>().concat();
        let expected: Vec<Found> = frames.into_iter().map(Ok).collect();
        prop_assert_eq!(decode(&bytes, &chunks), expected);
    }

    /// Garbage may hold the start of a header anywhere; the frames after it are found all the same.
    #[test]
    fn every_frame_is_found_between_garbage(
        frames in vec((garbage(), frame()), 1..4),
        chunks in vec(1..400_usize, 1..6),
    ) {
        let bytes = frames
            .iter()
            .flat_map(|(garbage, sent)| [garbage.clone(), sent.bytes()].concat())
            .collect::<Vec<_>>();
        let mut expected: Vec<Found> = Vec::new();
        for (garbage, sent) in frames {
            if !garbage.is_empty() {
                expected.push(Err(FrameStreamError::Skipped { bytes: garbage.len() as u64 }));
            }
            expected.push(Ok(sent));
        }
        prop_assert_eq!(decode(&bytes, &chunks), expected);
    }

    /// Whatever the bytes are, the chunks make no difference, and nothing panics.
    #[test]
    fn chunks_make_no_difference_to_damaged_streams(
        frames in vec(frame(), 1..4),
        damage in vec((any::<prop::sample::Index>(), any::<u8>(), 0..3_u8), 1..5),
        chunks in vec(1..400_usize, 1..6),
    ) {
        let mut bytes = frames.iter().map(Sent::bytes).collect::<Vec<_>>().concat();
        for (at, byte, kind) in damage {
            let at = at.index(bytes.len());
            match kind {
                0 => bytes[at] = byte,
                1 => bytes.insert(at, byte),
                _ if bytes.len() > 1 => drop(bytes.remove(at)),
                _ => {}
            }
        }
        prop_assert_eq!(decode(&bytes, &chunks), decode(&bytes, &[bytes.len()]));
    }

    /// A frame that lost bytes is an error, and at most one frame after it is lost with it.
    #[test]
    fn a_lost_byte_costs_two_frames_at_most(
        frames in vec(frame(), 3..6),
        lost in any::<prop::sample::Index>(),
    ) {
        // Payloads shorter than the first one are swallowed with it: pipes carry frames of one size.
        let first = frames[0].clone();
        let mut frames: Vec<Sent> = (0..frames.len() as u64)
            .map(|k| Sent { header: FrameHeader { sequence: k, ..first.header }, ..first.clone() })
            .collect();
        for sent in &mut frames {
            sent.header.payload_crc = Some(crc32fast::hash(&sent.payload));
        }
        let mut bytes = frames.iter().map(Sent::bytes).collect::<Vec<_>>().concat();
        bytes.remove(lost.index(frames[0].bytes().len()));
        let found = decode(&bytes, &[bytes.len()]);
        let whole: Vec<&Sent> = found.iter().filter_map(|f| f.as_ref().ok()).collect();
        prop_assert!(whole.len() + 2 >= frames.len(), "{found:?}");
        prop_assert!(whole.iter().all(|sent| frames.contains(sent)));
        prop_assert!(found.iter().any(Result::is_err));
    }
}

fn header() -> FrameHeader {
    FrameHeader {
        sequence: 7,
        captured_ns: Some(1),
        width_px: 4,
        height_px: 2,
        format: PayloadFormat::Grey8,
        layout: StereoLayout::SideBySide,
        payload_bytes: 8,
        payload_crc: None,
    }
}

fn with_crc(mut bytes: [u8; HEADER_BYTES]) -> [u8; HEADER_BYTES] {
    let crc = crc32fast::hash(&bytes[..HEADER_BYTES - 4]);
    bytes[HEADER_BYTES - 4..].copy_from_slice(&crc.to_le_bytes());
    bytes
}

/// By hand from the table of docs/frame-stream.md.
#[test]
fn the_table_of_bytes_holds() {
    let bytes = header().encode();
    let expected: [u8; HEADER_BYTES - 4] = [
        0x89, b'G', b'S', b'F', 1, 0, 0, 0, // magic, version, format, layout, flags
        7, 0, 0, 0, 0, 0, 0, 0, // sequence
        1, 0, 0, 0, 0, 0, 0, 0, // capture time
        4, 0, 0, 0, 2, 0, 0, 0, // width, height
        8, 0, 0, 0, 0, 0, 0, 0, // payload length, payload checksum
    ];
    assert_eq!(bytes[..HEADER_BYTES - 4], expected);
    assert_eq!(bytes, with_crc(bytes));
}

#[test]
fn headers_that_say_nonsense_are_refused_by_name() {
    type Change = fn(&mut [u8; HEADER_BYTES]);
    let cases: [(Change, FrameStreamError); 8] = [
        (|b| b[4] = 2, FrameStreamError::Version { found: 2 }),
        (|b| b[5] = 9, FrameStreamError::Format { found: 9 }),
        (|b| b[6] = 4, FrameStreamError::Layout { found: 4 }),
        (|b| b[7] = 6, FrameStreamError::Flags { found: 6 }),
        (|b| b[24] = 3, FrameStreamError::Size { width_px: 3, height_px: 2 }),
        (|b| b[30] = 1, FrameStreamError::Size { width_px: 4, height_px: 0x1_0002 }),
        (|b| b[32] = 9, FrameStreamError::Length { found: 9, expected: Some(8) }),
        (|b| (b[5], b[35]) = (1, 0x80), FrameStreamError::Length { found: 0x8000_0008, expected: None }),
    ];
    for (change, expected) in cases {
        let mut bytes = header().encode();
        change(&mut bytes);
        // Another frame follows, and is found.
        let next = Sent { header: header(), payload: vec![5; 8] };
        let found = decode(&[&with_crc(bytes)[..], &next.bytes()].concat(), &[1]);
        assert_eq!(found, vec![Err(expected), Ok(next)], "{expected}");
    }
}

#[test]
fn a_stream_of_another_kind_is_noticed_and_memory_stays() {
    let (mut decoder, mut skipped) = (FrameDecoder::default(), 0);
    for _ in 0..64 {
        let mut bytes = &vec![0x89; 100_000][..];
        while let Some(found) = decoder.next_frame(&mut bytes) {
            match found {
                Err(FrameStreamError::Skipped { bytes }) => skipped += bytes,
                other => panic!("{other:?}"),
            }
        }
    }
    assert!(skipped > 5_000_000, "{skipped}");
    // A header that claims the longest payload takes no memory before bytes come.
    let claim = FrameHeader { format: PayloadFormat::Jpeg, payload_bytes: MAX_PAYLOAD_BYTES, ..header() };
    let mut decoder = FrameDecoder::default();
    assert_eq!(decoder.next_frame(&mut &claim.encode()[..]), None);
    assert!(decoder.payload().is_empty());
    let expected = HEADER_BYTES + MAX_PAYLOAD_BYTES as usize;
    assert_eq!(decoder.finish(), Err(FrameStreamError::Cut { found: HEADER_BYTES, expected }));
}
