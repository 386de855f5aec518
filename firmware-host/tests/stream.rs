//! Stereo pairs through pipes: producers that are slow, die, or send rubbish.
#![cfg(unix)]
#![allow(clippy::unwrap_used)]

use gelstereo_host::codec::frame_stream::{FrameHeader, HEADER_BYTES, PayloadFormat};
use gelstereo_host::source::FrameMode;
use gelstereo_host::source::stream::{StreamConfig, StreamSource};
use gelstereo_host::source::{
    Encoded, FrameSource, Next, SourceError, SourceEvent, StereoLayout, StereoPair,
};
use std::io::{Cursor, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

const SIZE: (u32, u32) = (8, 2);
/// Far beyond what a busy machine needs.
const LIMIT: Duration = Duration::from_secs(20);

fn header(sequence: u64) -> FrameHeader {
    FrameHeader {
        sequence,
        captured_ns: Some(1_000 + sequence),
        width_px: SIZE.0,
        height_px: SIZE.1,
        format: PayloadFormat::Grey8,
        layout: StereoLayout::SideBySide,
        payload_bytes: SIZE.0 * SIZE.1,
        payload_crc: None,
    }
}

/// Left halves hold the number, right halves its complement.
fn frame(sequence: u64) -> Vec<u8> {
    let [half, rest] = [[sequence as u8; 4], [!sequence as u8; 4]];
    [&header(sequence).encode()[..], &half, &rest, &half, &rest].concat()
}

fn every() -> StreamConfig {
    StreamConfig { mode: FrameMode::Every, ..StreamConfig::default() }
}

fn open(config: &StreamConfig, bytes: Vec<u8>) -> StreamSource {
    StreamSource::from_reader(config, Box::new(Cursor::new(bytes))).unwrap()
}

/// Numbers of the pairs and the events up to the end.
fn drain(source: &mut StreamSource) -> (Vec<u64>, Vec<SourceEvent>) {
    let (mut pair, mut numbers, mut events) = (StereoPair::default(), Vec::new(), Vec::new());
    loop {
        match source.next_pair(LIMIT, &mut pair).unwrap() {
            Next::Pair => {
                assert!(!pair.stale);
                numbers.push(pair.capture.sequence);
            }
            Next::Event(event) => {
                assert!(pair.stale);
                events.push(event);
            }
            Next::End => return (numbers, events),
        }
    }
}

#[test]
fn a_pair_comes_with_its_views_time_and_number() {
    let mut source = open(&every(), frame(5));
    let mut pair = StereoPair::default();
    assert_eq!(source.next_pair(LIMIT, &mut pair).unwrap(), Next::Pair);
    assert_eq!((pair.left.pixels.as_slice(), pair.right.pixels.as_slice()), (&[5; 8][..], &[250; 8][..]));
    assert_eq!((pair.left.width, pair.left.height), (4, 2));
    assert_eq!((pair.time_ns, pair.capture.driver_ns, pair.capture.sequence), (1_005, Some(1_005), 5));
    assert!(pair.capture.received_ns.is_some());
    for _ in 0..2 {
        assert_eq!(source.next_pair(LIMIT, &mut pair).unwrap(), Next::End, "and it stays at its end");
    }
}

#[test]
fn losses_are_counted_and_numbers_that_cannot_be_are_events() {
    let bytes = [frame(1), frame(2), frame(7), frame(3), frame(4)].concat();
    let mut source = open(&every(), bytes);
    let mut pair = StereoPair::default();
    let mut seen = Vec::new();
    loop {
        match source.next_pair(LIMIT, &mut pair).unwrap() {
            Next::Pair => seen.push(Ok((pair.capture.sequence, pair.capture.dropped))),
            Next::Event(event) => seen.push(Err(event)),
            Next::End => break,
        }
    }
    let back = SourceEvent::Sequence { expected: 8, found: 3 };
    assert_eq!(seen, [Ok((1, 0)), Ok((2, 0)), Ok((7, 4)), Err(back), Ok((3, 0)), Ok((4, 0))]);
}

#[test]
fn garbage_and_a_cut_end_are_events() {
    let mut bytes = [b"hello".to_vec(), frame(1), b"there".to_vec(), frame(2), frame(3)].concat();
    bytes.truncate(bytes.len() - 3);
    let (numbers, events) = drain(&mut open(&every(), bytes));
    assert_eq!(numbers, [1, 2]);
    let reasons: Vec<String> = events.iter().map(ToString::to_string).collect();
    let total = HEADER_BYTES + 16;
    let cut =
        format!("frame 3 cannot be used: the stream ended after {} of a frame's {total} bytes", total - 3);
    assert_eq!(
        reasons,
        [
            "frame 0 cannot be used: 5 bytes belong to no frame",
            "frame 2 cannot be used: 5 bytes belong to no frame",
            cut.as_str(),
        ]
    );
}

#[test]
fn a_jpeg_is_decoded_and_kept_as_it_came() {
    let mut joint = Vec::new();
    let pixels: Vec<u8> = (0..64 * 16).map(|i| if i % 64 < 32 { 40 } else { 200 }).collect();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut joint, 95);
    image::ImageEncoder::write_image(encoder, &pixels, 64, 16, image::ExtendedColorType::L8).unwrap();
    let make = |sequence, width_px, jpeg: &[u8]| {
        let header = FrameHeader {
            format: PayloadFormat::Jpeg,
            width_px,
            height_px: 16,
            payload_bytes: jpeg.len() as u32,
            ..header(sequence)
        };
        [&header.encode()[..], jpeg].concat()
    };
    let bytes = [make(0, 64, &joint), make(1, 64, &joint[..joint.len() - 9]), make(2, 32, &joint)].concat();
    let mut source = open(&every(), bytes);
    let mut pair = StereoPair::default();
    assert_eq!(source.next_pair(LIMIT, &mut pair).unwrap(), Next::Pair);
    assert!(pair.left.pixels.iter().all(|&p| p.abs_diff(40) < 4), "{:?}", pair.left.pixels);
    assert!(pair.right.pixels.iter().all(|&p| p.abs_diff(200) < 4));
    assert_eq!(pair.encoded, Encoded::Joint { layout: StereoLayout::SideBySide, jpeg: joint });
    let left = pair.left.clone();
    for words in ["no end marker", "its header says (32, 16)"] {
        let Next::Event(SourceEvent::Corrupt { reason, .. }) = source.next_pair(LIMIT, &mut pair).unwrap()
        else {
            panic!("a bad image is an event");
        };
        assert!(reason.contains(words), "{reason}");
    }
    assert_eq!((pair.left, pair.stale), (left, true), "the last good pair stays");
}

#[test]
fn frames_without_headers_are_cut_by_their_size() {
    let config = StreamConfig {
        raw_size_px: Some([4, 2]),
        layout: StereoLayout::Interleaved,
        frame_rate_hz: Some(10.0),
        ..every()
    };
    let mut source = open(&config, (0..19).collect());
    let mut pair = StereoPair::default();
    let mut times = Vec::new();
    for n in 0..2_u8 {
        assert_eq!(source.next_pair(LIMIT, &mut pair).unwrap(), Next::Pair);
        assert_eq!(pair.left.pixels, [0, 2, 4, 6].map(|i| 8 * n + i));
        assert_eq!(pair.right.pixels, [1, 3, 5, 7].map(|i| 8 * n + i));
        times.push(pair.time_ns);
        assert_eq!(pair.capture.received_ns, None, "made-up times repeat to the bit");
    }
    assert_eq!(times, [0, 100_000_000]);
    let (_, events) = drain(&mut source);
    assert!(matches!(&events[..], [SourceEvent::Corrupt { reason, .. }] if reason.contains("after 3 of")));
}

/// In the mode `latest` the producer never waits: what was not fetched is dropped and counted.
#[test]
fn the_newest_frame_is_handed_over_and_the_others_are_counted() {
    let (mut producer, input) = UnixStream::pair().unwrap();
    let mut source = StreamSource::from_reader(&StreamConfig::default(), Box::new(input)).unwrap();
    for n in 0..5000 {
        producer.write_all(&frame(n)).unwrap();
    }
    drop(producer);
    let (mut pair, mut handed_over, mut counted, mut last) = (StereoPair::default(), 0, 0, None);
    while source.next_pair(LIMIT, &mut pair).unwrap() != Next::End {
        assert!(last < Some(pair.capture.sequence), "in order");
        last = Some(pair.capture.sequence);
        handed_over += 1;
        counted += pair.capture.dropped + 1;
    }
    // Frames before the first one that was handed over count as lost too.
    assert_eq!((last, counted), (Some(4999), 5000));
    assert!(handed_over < 5000, "the reader came late");
}

/// In the mode `every` the producer waits for the reader, and memory stays bounded.
#[test]
fn a_producer_waits_for_a_slow_reader() {
    let (mut producer, input) = UnixStream::pair().unwrap();
    let mut source = StreamSource::from_reader(&every(), Box::new(input)).unwrap();
    let written = std::sync::atomic::AtomicU64::new(0);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for n in 0..50_000 {
                producer.write_all(&frame(n)).unwrap();
                written.store(n, std::sync::atomic::Ordering::Relaxed);
            }
            drop(producer);
        });
        std::thread::sleep(Duration::from_millis(300));
        let before = written.load(std::sync::atomic::Ordering::Relaxed);
        assert!(before < 20_000, "{before} frames went into a pipe that nobody reads");
        let (numbers, events) = drain(&mut source);
        assert!(events.is_empty() && numbers.iter().copied().eq(0..50_000));
    });
}

#[test]
fn a_silent_producer_is_a_timeout_then_a_stall_and_never_a_hang() {
    let (mut producer, input) = UnixStream::pair().unwrap();
    let config = StreamConfig { stall_timeout_ms: 300, ..every() };
    let mut source = StreamSource::from_reader(&config, Box::new(input)).unwrap();
    let mut pair = StereoPair::default();
    producer.write_all(&frame(0)).unwrap();
    assert_eq!(source.next_pair(LIMIT, &mut pair).unwrap(), Next::Pair);
    let begun = Instant::now();
    let waited = Duration::from_millis(20);
    let first = source.next_pair(waited, &mut pair);
    assert!(matches!(first, Err(SourceError::Timeout { .. })) && pair.stale, "{first:?}");
    let mut stalls = Vec::new();
    while stalls.len() < 2 {
        match source.next_pair(waited, &mut pair) {
            Ok(Next::Event(SourceEvent::Stalled { device, silent_ms })) => {
                assert_eq!(device, "standard input");
                stalls.push(silent_ms);
            }
            Err(SourceError::Timeout { .. }) => {}
            other => panic!("{other:?}"),
        }
        assert!(begun.elapsed() < LIMIT);
    }
    assert!(stalls[0] >= 300 && stalls[1] >= 2 * stalls[0], "{stalls:?}");
    producer.write_all(&frame(1)).unwrap();
    assert_eq!(source.next_pair(LIMIT, &mut pair).unwrap(), Next::Pair);
    drop(producer);
    assert_eq!(source.next_pair(LIMIT, &mut pair).unwrap(), Next::End);
}

/// A FIFO outlives its producers: each one's end is an event, and the next one's frames come on.
#[test]
fn a_fifo_is_opened_again_for_the_next_producer() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames");
    assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
    let config = StreamConfig { path: path.clone(), ..every() };
    let mut source = StreamSource::open(&config).unwrap();
    let mut pair = StereoPair::default();
    let begun = Instant::now();
    let nothing = source.next_pair(Duration::from_millis(50), &mut pair);
    assert!(matches!(nothing, Err(SourceError::Timeout { .. })), "{nothing:?}");
    for _ in 0..2 {
        let mut seen = Vec::new();
        {
            let mut producer = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
            producer.write_all(&frame(3)).unwrap();
            producer.write_all(&frame(4)[..10]).unwrap();
        }
        while seen.last() != Some(&"gone") {
            seen.push(match source.next_pair(LIMIT, &mut pair).unwrap() {
                Next::Pair => "pair",
                Next::Event(SourceEvent::Connected { .. }) => "connected",
                Next::Event(SourceEvent::Corrupt { .. }) => "cut",
                Next::Event(SourceEvent::Disconnected { .. }) => "gone",
                other => panic!("{other:?}"),
            });
            assert!(begun.elapsed() < LIMIT);
        }
        assert_eq!(seen, ["connected", "pair", "cut", "gone"]);
    }
}

#[test]
fn a_path_that_is_not_there_is_an_error_in_words() {
    let config = StreamConfig { path: "nowhere/frames".into(), ..every() };
    let error = StreamSource::open(&config).unwrap_err().to_string();
    assert!(error.starts_with("cannot read nowhere/frames: "), "{error}");
}
