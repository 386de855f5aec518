//! Recordings as files: what was written is read, and nothing before a cut is lost.
#![allow(clippy::unwrap_used)]

use gelstereo_host::config::{ImageFormat, RecordingConfig, RecordingMode};
use gelstereo_host::recording::{
    CaptureNote, Content, ImageDecoder, Item, LogClock, METADATA_CONFIG, METADATA_PART, MessageSink, Reader,
    Recording, RecordingReport, SharedBuffer, Store, Topic, messages, pixel_crc, recover,
};
use gelstereo_host::source::{Capture, Encoded, Gray, StereoLayout, StereoPair};
use proptest::prelude::*;
use std::io::Cursor;
use std::path::PathBuf;

const PERIOD_NS: u64 = 33_333_333;

fn content() -> Content {
    let attachments = vec![("part.stl".to_owned(), vec![1, 2, 3])];
    Content { config_toml: "preset = \"paper\"".to_owned(), attachments }
}

/// A recording into buffers, one for each part.
fn in_memory(settings: &RecordingConfig) -> (Recording, SharedParts) {
    let parts = SharedParts::default();
    let opened = parts.clone();
    let open = move |number: u32| {
        let buffer = SharedBuffer::default();
        opened.0.lock().unwrap().push(buffer.clone());
        Ok((PathBuf::from(number.to_string()), Box::new(buffer) as Box<dyn Store>))
    };
    let recording = Recording::with_stores(settings, content(), LogClock::Source, Box::new(open)).unwrap();
    (recording, parts)
}

#[derive(Clone, Default)]
struct SharedParts(std::sync::Arc<std::sync::Mutex<Vec<SharedBuffer>>>);

impl SharedParts {
    fn bytes(&self) -> Vec<Vec<u8>> {
        self.0.lock().unwrap().iter().map(SharedBuffer::bytes).collect()
    }
}

fn pair(frame: u64) -> StereoPair {
    let image = |salt: u64| Gray {
        width: 30,
        height: 20,
        pixels: (0..600_u64).map(|i| (i * (frame + 3) * 37 % 251 + salt) as u8).collect(),
    };
    StereoPair {
        time_ns: frame * PERIOD_NS,
        left: image(0),
        right: image(1),
        capture: Capture { sequence: frame, driver_ns: Some(5 + frame), ..Capture::default() },
        ..StereoPair::default()
    }
}

fn write_frame(recording: &mut Recording, frame: u64) {
    recording.write_pair(&pair(frame));
    recording.write(Topic::Frame, frame * PERIOD_NS, &messages::string(&frame.to_string()));
}

/// Frames on a clock that advances a second with each, so that each ends a chunk.
fn slow_frames(count: u64) -> Vec<u8> {
    let (mut recording, parts) = in_memory(&RecordingConfig::default());
    for frame in 0..count {
        let mut pair = pair(frame);
        pair.time_ns = frame * 1_000_000_000;
        recording.write_pair(&pair);
        recording.write(Topic::Frame, pair.time_ns + 900_000_000, &messages::string(&frame.to_string()));
    }
    assert_eq!(recording.finish().fault, None);
    parts.bytes().remove(0)
}

/// All items, and whether the end was missing.
fn read(bytes: &[u8]) -> (Vec<Item>, bool) {
    let mut reader = Reader::new(Box::new(Cursor::new(bytes.to_vec())));
    let mut items = Vec::new();
    while let Some(item) = reader.next_item().unwrap() {
        items.push(item);
    }
    assert_eq!(reader.next_item().unwrap(), None, "the end stays the end");
    (items, reader.truncated())
}

/// Texts on a topic.
fn texts(items: &[Item], wanted: Topic) -> Vec<String> {
    let text = |item: &Item| match item {
        Item::Message { topic, data, .. } if *topic == wanted => {
            Some(messages::read_string(data).unwrap().to_owned())
        }
        _ => None,
    };
    items.iter().filter_map(text).collect()
}

fn pairs_of(items: &[Item]) -> Vec<StereoPair> {
    let (mut decoder, mut current, mut pairs) = (ImageDecoder::default(), StereoPair::default(), Vec::new());
    let mut layout = StereoLayout::default();
    for item in items {
        let Item::Message { topic, data, .. } = item else { continue };
        if *topic == Topic::Capture {
            let note: CaptureNote = serde_json::from_str(messages::read_string(data).unwrap()).unwrap();
            layout = note.layout.unwrap_or_default();
        } else if decoder.take(*topic, data, layout, &mut current).unwrap() {
            pairs.push(current.clone());
        }
    }
    pairs
}

#[test]
fn what_was_written_is_read_in_its_order_in_every_format() {
    for images in [ImageFormat::Png, ImageFormat::Raw] {
        let (mut recording, parts) = in_memory(&RecordingConfig { images, ..RecordingConfig::default() });
        (0..3).for_each(|frame| write_frame(&mut recording, frame));
        let report = recording.finish();
        assert_eq!((report.messages, report.fault, report.lost_messages), (12, None, 0));
        let (items, truncated) = read(&parts.bytes()[0]);
        assert!(!truncated);
        let Item::Metadata(entries) = &items[0] else { panic!("{:?}", items[0]) };
        assert_eq!(entries[METADATA_CONFIG], "preset = \"paper\"");
        assert_eq!(items[1], Item::Attachment { name: "part.stl".to_owned(), data: vec![1, 2, 3] });
        assert_eq!(items.len(), 2 + 3 * 4);
        assert_eq!(texts(&items, Topic::Frame), ["0", "1", "2"]);
        for (frame, read) in pairs_of(&items).iter().enumerate() {
            let written = pair(frame as u64);
            assert_eq!(
                (read.time_ns, &read.left, &read.right),
                (written.time_ns, &written.left, &written.right)
            );
        }
        let note: CaptureNote = serde_json::from_str(&texts(&items, Topic::Capture)[1]).unwrap();
        assert_eq!((note.capture.sequence, note.capture.driver_ns, note.stale), (1, Some(6), false));
        assert_eq!(note.right_crc32, pixel_crc(&pair(1).right));
    }
}

/// A camera's JPEG stays what it was, byte for byte, and gives the pixels whose check sum is recorded.
#[test]
fn a_cameras_jpeg_is_stored_as_it_came() {
    let mut jpeg = Vec::new();
    let joint: Vec<u8> = (0..64 * 16_u32).map(|i| (i % 64 * 3 + i / 64) as u8).collect();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 90);
    encoder.encode(&joint, 64, 16, image::ExtendedColorType::L8).unwrap();
    let mut decoded = Gray::default();
    gelstereo_host::source::jpeg::JpegDecoder::default().decode(&jpeg, &mut decoded).unwrap();
    let layout = StereoLayout::SideBySideSwapped;
    let mut pair = StereoPair { encoded: Encoded::Joint { layout, jpeg: jpeg.clone() }, ..pair(0) };
    layout.split(decoded.view().unwrap(), &mut pair.left, &mut pair.right).unwrap();

    let (mut recording, parts) = in_memory(&RecordingConfig::default());
    recording.write_pair(&pair);
    let _ = recording.finish();
    let (items, _) = read(&parts.bytes()[0]);
    let Some(Item::Message { topic: Topic::StereoCompressed, data, .. }) = items.last() else {
        panic!("{items:?}")
    };
    let image = messages::read_compressed_image(data).unwrap();
    assert_eq!((image.format, image.file), ("jpeg", &jpeg[..]));
    let again = pairs_of(&items).remove(0);
    assert_eq!((again.left, again.right), (pair.left.clone(), pair.right.clone()));

    let separate = Encoded::Separate { left_jpeg: jpeg.clone(), right_jpeg: jpeg };
    let (mut recording, parts) = in_memory(&RecordingConfig::default());
    recording.write_pair(&StereoPair { encoded: separate, ..pair });
    let _ = recording.finish();
    let again = pairs_of(&read(&parts.bytes()[0]).0).remove(0);
    assert_eq!((&again.left, &again.right), (&decoded, &decoded));
}

#[test]
fn every_nth_pair_keeps_its_images_and_all_pairs_their_results() {
    let (mut recording, parts) = in_memory(&RecordingConfig { every_nth: 3, ..RecordingConfig::default() });
    (0..7).for_each(|frame| write_frame(&mut recording, frame));
    let _ = recording.finish();
    let (items, _) = read(&parts.bytes()[0]);
    let frames: Vec<u64> = pairs_of(&items).iter().map(|pair| pair.time_ns / PERIOD_NS).collect();
    assert_eq!(frames, [0, 3, 6]);
    assert_eq!(texts(&items, Topic::Frame).len(), 7);
}

#[test]
fn parts_begin_with_whole_frames_and_hold_everything_between_them() {
    let settings = RecordingConfig { split_mb: 1, images: ImageFormat::Raw, ..RecordingConfig::default() };
    let (mut recording, parts) = in_memory(&settings);
    // Noise, so that no compression of chunks makes it small.
    let mut state = 1_u64;
    for frame in 0..60 {
        let mut pair = pair(frame);
        for view in [&mut pair.left, &mut pair.right] {
            (view.width, view.height) = (200, 200);
            view.pixels = (0..40_000)
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (state >> 56) as u8
                })
                .collect();
        }
        recording.write_pair(&pair);
        recording.write(Topic::Frame, pair.time_ns, &messages::string(&frame.to_string()));
    }
    let report = recording.finish();
    assert!(report.files.len() == parts.bytes().len() && report.files.len() >= 4, "{report:?}");
    let mut frames = Vec::new();
    for (number, bytes) in parts.bytes().iter().enumerate() {
        let (items, truncated) = read(bytes);
        let Item::Metadata(entries) = &items[0] else { panic!("{:?}", items[0]) };
        assert_eq!(entries[METADATA_PART], number.to_string());
        assert!(
            !truncated && matches!(items[2], Item::Message { topic: Topic::Capture, .. }),
            "{:?}",
            items[2]
        );
        assert!(bytes.len() < 1_200_000, "{} bytes", bytes.len());
        assert_eq!(pairs_of(&items).len(), texts(&items, Topic::Frame).len());
        frames.extend(texts(&items, Topic::Frame));
    }
    assert_eq!(frames, (0..60).map(|frame| frame.to_string()).collect::<Vec<_>>());
}

#[test]
fn a_ring_keeps_the_time_around_each_trigger() {
    let settings = RecordingConfig {
        mode: RecordingMode::Ring,
        ring_s: 1.0,
        ring_after_s: 0.5,
        ..RecordingConfig::default()
    };
    let (mut recording, parts) = in_memory(&settings);
    for frame in 0..300 {
        write_frame(&mut recording, frame);
        if frame == 100 || frame == 110 || frame == 200 {
            recording.trigger(frame * PERIOD_NS, "test");
        }
    }
    let report = recording.finish();
    assert_eq!((report.files.len(), report.fault), (2, None));
    let parts = parts.bytes();
    // A second is 30 frames, half of one 15; the second trigger prolongs the first file.
    for (bytes, expected) in parts.iter().zip([70..=125, 170..=215]) {
        let kept = texts(&read(bytes).0, Topic::Frame);
        assert_eq!(kept, expected.map(|frame| frame.to_string()).collect::<Vec<_>>());
    }
}

/// At every byte of an unfinished file: no error, the items before the cut are those of the whole file, and
/// each frame whose chunk is whole is among them. `recover` makes a file of them that has its end.
#[test]
fn a_cut_anywhere_loses_nothing_before_it() {
    let bytes = slow_frames(4);
    let (whole, _) = read(&bytes);
    let folder = tempfile::tempdir().unwrap();
    let (broken, fixed) = (folder.path().join("broken.mcap"), folder.path().join("fixed.mcap"));
    let mut items_before = 0;
    for cut in 0..bytes.len() {
        let (items, truncated) = read(&bytes[..cut]);
        assert!(truncated, "cut at {cut} of {}", bytes.len());
        assert!(items.len() >= items_before && items[..] == whole[..items.len()], "cut at {cut}: {items:?}");
        items_before = items.len();
        if cut % 97 == 0 && cut > 8 {
            std::fs::write(&broken, &bytes[..cut]).unwrap();
            let recovered = recover(&broken, &fixed).unwrap();
            let (kept, truncated) = read(&std::fs::read(&fixed).unwrap());
            assert!(!truncated && kept == items, "cut at {cut}: {recovered:?}");
            std::fs::remove_file(&fixed).unwrap();
        }
    }
    assert_eq!(items_before, whole.len());
}

#[test]
fn recover_passes_over_a_damaged_chunk_and_never_replaces_a_file() {
    let mut bytes = slow_frames(6);
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    let folder = tempfile::tempdir().unwrap();
    let (broken, fixed) = (folder.path().join("broken.mcap"), folder.path().join("fixed.mcap"));
    std::fs::write(&broken, &bytes).unwrap();
    let recovered = recover(&broken, &fixed).unwrap();
    assert!(recovered.complete && recovered.damaged_chunks == 1, "{recovered:?}");
    let kept = texts(&read(&std::fs::read(&fixed).unwrap()).0, Topic::Frame);
    assert!(kept.len() >= 4 && kept.contains(&"0".to_owned()) && kept.contains(&"5".to_owned()), "{kept:?}");
    assert_eq!(std::fs::read(&broken).unwrap(), bytes, "the input is only read");
    let refused = recover(&broken, &fixed).unwrap_err().to_string();
    assert!(refused.starts_with("cannot create ") && refused.contains("fixed.mcap"), "{refused}");
}

#[test]
fn a_recording_that_nobody_finishes_is_closed_all_the_same() {
    let (mut recording, parts) = in_memory(&RecordingConfig::default());
    write_frame(&mut recording, 0);
    drop(recording);
    assert!(!read(&parts.bytes()[0]).1);
}

/// What a store was asked to do.
#[derive(Clone, Default)]
struct Watched {
    bytes: SharedBuffer,
    /// Length of the file at each sync.
    syncs: std::sync::Arc<std::sync::Mutex<Vec<usize>>>,
    /// Writing waits while this is locked.
    stopped: std::sync::Arc<std::sync::Mutex<()>>,
}

impl std::io::Write for Watched {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let _free = self.stopped.lock().unwrap();
        self.bytes.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Store for Watched {
    fn sync(&mut self) -> std::io::Result<()> {
        self.syncs.lock().unwrap().push(self.bytes.bytes().len());
        Ok(())
    }
}

impl Watched {
    fn recording(&self, settings: &RecordingConfig, clock: LogClock) -> Recording {
        let store = self.clone();
        let open = move |_| Ok((PathBuf::new(), Box::new(store.clone()) as Box<dyn Store>));
        Recording::with_stores(settings, content(), clock, Box::new(open)).unwrap()
    }
}

/// What a power cut leaves is at least what was synced: each time complete chunks, with all but the last half
/// second.
#[test]
fn a_cameras_recording_is_synced_chunk_by_chunk() {
    let store = Watched::default();
    let mut recording = store.recording(&RecordingConfig::default(), LogClock::Wall);
    for frame in 0..60 {
        write_frame(&mut recording, frame);
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let before = std::time::SystemTime::now();
    assert_eq!(recording.finish().fault, None);
    let (bytes, syncs) = (store.bytes.bytes(), store.syncs.lock().unwrap().clone());
    assert!(syncs.len() >= 4 && syncs.last() == Some(&bytes.len()), "{syncs:?} of {}", bytes.len());
    let whole = read(&bytes).0;
    let mut kept = 0;
    for &sync in &syncs {
        let (items, _) = read(&bytes[..sync]);
        assert!(items.len() >= kept && items[..] == whole[..items.len()]);
        kept = items.len();
    }
    assert_eq!(kept, whole.len());
    // Log times are the wall clock's; the messages' own are the source's.
    let Some(Item::Message { time_ns, .. }) = whole.last() else { panic!("{whole:?}") };
    let now_ns = before.duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos();
    assert!(now_ns - u128::from(*time_ns) < 60_000_000_000, "{time_ns}");

    let store = Watched::default();
    let mut recording = store.recording(&RecordingConfig::default(), LogClock::Source);
    (0..90).for_each(|frame| write_frame(&mut recording, frame));
    assert_eq!(recording.finish().fault, None);
    assert_eq!(store.syncs.lock().unwrap().len(), 1, "what can be computed again is synced at its end");
}

/// A disk that takes nothing for a while: memory is bounded, the source does not wait, and the file says what
/// is missing.
#[test]
fn a_slow_disk_leaves_a_gap_that_the_recording_tells() {
    let store = Watched::default();
    let settings = RecordingConfig { images: ImageFormat::Raw, ..RecordingConfig::default() };
    let mut recording = store.recording(&settings, LogClock::Wall);
    let stopped = store.stopped.lock().unwrap();
    let mut large = pair(0);
    for view in [&mut large.left, &mut large.right] {
        (view.width, view.height, view.pixels) = (1000, 1000, vec![7; 1_000_000]);
    }
    for frame in 0..100 {
        large.time_ns = frame * PERIOD_NS;
        recording.write_pair(&large);
    }
    let lost = recording.lost_messages();
    // 64 MB, and a chunk that waits to be written.
    assert!((50..=70).contains(&lost), "{lost} of 100 pairs");
    drop(stopped);
    while recording.queued_bytes() > 0 {
        std::thread::yield_now();
    }
    recording.write_pair(&large);
    let report = recording.finish();
    assert_eq!((report.fault, report.lost_messages), (None, lost));
    let told: u64 = texts(&read(&store.bytes.bytes()).0, Topic::Capture)
        .iter()
        .filter_map(|text| serde_json::from_str::<serde_json::Value>(text).unwrap()["lost_messages"].as_u64())
        .sum();
    assert_eq!(told, lost);
}

/// The state of a recording whose disk is full is visible, and nothing waits for it.
#[cfg(target_os = "linux")]
#[test]
fn a_full_device_is_reported_and_takes_no_more() {
    let settings = RecordingConfig { path: PathBuf::from("/dev/full"), ..RecordingConfig::default() };
    let fault = match Recording::create(&settings, content(), LogClock::Wall) {
        Err(error) => error.to_string(),
        Ok(mut recording) => {
            for frame in 0..3000 {
                write_frame(&mut recording, frame);
            }
            let RecordingReport { fault, .. } = recording.finish();
            fault.unwrap()
        }
    };
    assert!(fault.contains("No space left"), "{fault}");
}

proptest! {
    /// Whatever the bytes are, reading ends, with items or with an error, and does not panic.
    #[test]
    fn damage_is_an_error_or_a_shorter_recording(at in any::<prop::sample::Index>(), mask in 1_u8..) {
        let mut bytes = slow_frames(3);
        let at = at.index(bytes.len());
        bytes[at] ^= mask;
        let mut reader = Reader::new(Box::new(Cursor::new(bytes)));
        let mut items = 0;
        while let Ok(Some(_)) = reader.next_item() {
            items += 1;
            prop_assert!(items <= 14, "more items than were written");
        }
    }
}
